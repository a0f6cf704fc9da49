"""The picture in a section, by matplotlib: needs no OpenGL."""

import sys
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from studies.arrays import Array
from studies.output.records import OrganTopology, Snapshot
from studies.pictures.view import (
    ARROW,
    KILO,
    MARKER,
    MILLI,
    SIZE,
    THREAD,
    Indices,
    caption,
    colours,
    label,
    limits,
    read_scene,
    view_box,
    view_width,
)

DPI = 150
ASIDE = 1e-3  # over the organ's width: a plane through nodes cuts tetrahedra into nothing


def draw_section(frame: Snapshot, topology: OrganTopology | None, path: Path, title: str = "") -> None:
    """Draw the view along y with matplotlib [mm]: the organ cut at the piercings, the thread projected."""
    figure = Figure(figsize=(SIZE[0] / DPI, SIZE[1] / DPI), layout="constrained")
    axes = figure.add_subplot()
    if topology is not None and frame.organ is not None:
        stress = _section_organ(axes, topology, frame)
        figure.colorbar(stress, ax=axes, label="von Mises stress [kPa]", shrink=0.8, pad=0.02)
    _section_thread(axes, frame)
    _section_frame(axes, frame, title)
    figure.savefig(path, dpi=DPI)


def _section_organ(axes: Axes, topology: OrganTopology, frame: Snapshot) -> Any:
    """Fill the cut of the deformed tetrahedra by the plane y = const through the piercings."""
    assert frame.organ is not None
    deformed = topology.points + frame.organ.displacement
    points, triangles, stress = cut(deformed, topology.cells[:, :4], frame.organ.von_mises, _section_y(frame, deformed))
    low, high = limits(frame.organ.von_mises / KILO)
    look: Any = {"triangles": triangles, "cmap": colours(), "vmin": low, "vmax": high}
    x, z = (points / MILLI).T
    axes.tripcolor(x, z, stress / KILO, edgecolors="face", linewidth=0.8, **look)  # behind the joints of the next
    return axes.tripcolor(x, z, stress / KILO, shading="gouraud", **look)


def cut(points: Array, cells: Indices, values: Array, y: float) -> tuple[Array, Indices, Array]:
    """Cut tetrahedra by the plane at ``y``: points (x, z), shape ``(k, 2)``, triangles, values there."""
    side = points[:, 1] > y
    count = side[cells].sum(axis=1)
    edges, triangles, start = [], [], 0
    for cell in cells[(count > 0) & (count < 4)]:
        above, below = cell[side[cell]], cell[~side[cell]]
        ring = [(a, b) for i, a in enumerate(above) for b in (below if i % 2 == 0 else below[::-1])]
        edges += ring
        triangles += [(start, start + k, start + k + 1) for k in range(1, len(ring) - 1)]
        start += len(ring)
    a, b = np.array(edges, dtype=np.int64).reshape(-1, 2).T
    weight = (y - points[a, 1]) / (points[b, 1] - points[a, 1])
    places = points[a] + weight[:, None] * (points[b] - points[a])
    return places[:, [0, 2]], np.array(triangles).reshape(-1, 3), values[a] + weight * (values[b] - values[a])


def _section_thread(axes: Axes, frame: Snapshot) -> None:
    for points in frame.thread.split():
        x, _, z = points.T / MILLI
        axes.plot(x, z, color=THREAD, linewidth=2.5, solid_capstyle="round", label="thread")
    largest = max((float(np.linalg.norm(hole.force)) for hole in frame.piercings), default=0.0)
    middle = float(np.mean([hole.x[0] for hole in frame.piercings] or [0.0])) / MILLI
    for hole in frame.piercings:
        x, _, z = hole.x / MILLI
        axes.plot(x, z, "o", color=MARKER, markersize=8, zorder=4)
        force = float(np.linalg.norm(hole.force))
        arrow = hole.force * (0.2 * view_width(frame) / MILLI / largest if largest else 0.0)
        if force > 1e-3 * largest:
            style = {"arrowstyle": "-|>", "color": ARROW, "linewidth": 1.8, "shrinkA": 0, "shrinkB": 0}
            axes.annotate("", (x + arrow[0], z + arrow[2]), (x, z), arrowprops=style, zorder=5)
        where, align = ((-12, 8), "right") if x < middle else ((12, -14), "left")
        axes.annotate(
            label(hole.name, force), (x, z), where, textcoords="offset points", ha=align, zorder=6,
            bbox={"boxstyle": "round,pad=0.25", "facecolor": "white", "edgecolor": "none", "alpha": 0.8},
        )  # fmt: skip


def _section_frame(axes: Axes, frame: Snapshot, title: str) -> None:
    low, high = view_box(frame)
    margin = 0.12 * view_width(frame)
    axes.set_xlim((low[0] - margin) / MILLI, (high[0] + margin) / MILLI)
    axes.set_ylim((low[2] - 2 * margin) / MILLI, (high[2] + margin) / MILLI)
    axes.set_aspect("equal", adjustable="box")
    axes.set_xlabel("x [mm]")
    axes.set_ylabel("z [mm]")
    axes.set_title(caption(frame, title), fontsize=11)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)


def _section_y(frame: Snapshot, deformed: Array) -> float:
    """Choose where to cut [m]: through the piercings, inside the organ, and off the nodes of a regular mesh."""
    low, high = deformed[:, 1].min(), deformed[:, 1].max()
    middle = np.mean([hole.x[1] for hole in frame.piercings] or frame.thread.points[:, 1])
    hair = ASIDE * (high - low)
    return float(np.clip(middle + hair, low + hair, high - hair))


if __name__ == "__main__":
    frame, topology, title = read_scene(sys.argv[1])
    draw_section(frame, topology, Path(sys.argv[2]), title)
