"""The picture of a frame or a mesh in a section, by matplotlib, without OpenGL."""

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from studies.arrays import KILO, MILLI, Array
from studies.figure import literal
from studies.output.fields import OrganTopology
from studies.pictures import view
from studies.pictures.camera import along_arrows, label_places
from studies.pictures.scene import Frame, MeshScene
from studies.pictures.view import write_frames

DPI = 150
LETTERS, LETTER = 20.0, 0.6  # pixels of the letters of a name, and mean width of a letter over its size
ASIDE = 1e-3  # of the organ's width: a plane through nodes would cut tetrahedra into empty parts


def draw_section(frames: Sequence[Frame], topology: OrganTopology | None, path: Path, title: str = "") -> None:
    """Draw a frame into a PNG file, or frames at one scale into a GIF file.

    It is the view along y [mm]: the organ cut at the piercings, the thread projected.
    """
    write_frames(frames, path, partial(draw_scaled, view.scale_of(frames), topology, title))


def draw_scaled(scale: view.Scale, topology: OrganTopology | None, title: str, frame: Frame, path: Path) -> None:
    """Draw a frame at a given scale into a PNG file."""
    figure = Figure(figsize=(view.SIZE[0] / DPI, view.SIZE[1] / DPI), layout="constrained", dpi=DPI)
    axes = figure.add_subplot()
    if topology is not None and frame.organ is not None:
        stress = _section_organ(axes, topology, frame, scale)
        figure.colorbar(stress, ax=axes, label=view.stress_words(frame), shrink=0.8, pad=0.02)
    figure.colorbar(_section_thread(axes, frame, scale), ax=axes, label=view.tension_words(frame), shrink=0.8, pad=0.02)
    _section_piercings(axes, frame, scale)
    _section_held(axes, frame)
    _section_frame(axes, frame, title, scale)
    figure.draw_without_rendering()  # from here on places have pixels
    _section_names(axes, frame, scale)
    figure.savefig(path, dpi=DPI)


def _section_organ(axes: Axes, topology: OrganTopology, frame: Frame, scale: view.Scale) -> Any:
    """Fill the cut of the deformed tetrahedra by the plane y = const through the piercings."""
    assert frame.organ is not None
    deformed = topology.points + frame.organ.displacement
    points, triangles, stress = cut(deformed, topology.cells[:, :4], frame.organ.von_mises, _section_y(frame, deformed))
    low, high = (value / KILO for value in scale.stress)
    look: Any = {"triangles": triangles, "cmap": ListedColormap(view.colours()), "vmin": low, "vmax": high}
    x, z = (points / MILLI).T
    axes.tripcolor(x, z, stress / KILO, edgecolors="face", linewidth=0.8, **look)  # fills the next plot's joints
    return axes.tripcolor(x, z, stress / KILO, shading="gouraud", **look)


def cut(points: Array, cells: view.Indices, values: Array, y: float) -> tuple[Array, view.Indices, Array]:
    """Return the cut of tetrahedra by the plane at ``y``.

    It has points (x, z), shape ``(k, 2)``, triangles, and the values at the points.
    """
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


def _section_thread(axes: Axes, frame: Frame, scale: view.Scale) -> Any:
    """Draw the thread coloured by its tension [N], without the gaps between its pieces."""
    thread = frame.thread
    first = np.setdiff1d(np.arange(len(thread.points) - 1), np.cumsum(thread.pieces, dtype=np.int64) - 1)
    places = thread.points[:, [0, 2]] / MILLI
    lines = LineCollection(list(np.stack([places[first], places[first + 1]], axis=1)), linewidth=2.5, capstyle="round")
    lines.set(array=thread.tension[first], clim=scale.tension, cmap=ListedColormap(view.tension_colours(scale)))
    axes.add_collection(lines)
    return lines


def _section_piercings(axes: Axes, frame: Frame, scale: view.Scale) -> None:
    """Draw the holes, with the force of each on the thread."""
    style = {"arrowstyle": "-|>", "color": view.ARROW, "linewidth": 1.8, "shrinkA": 0, "shrinkB": 0}
    for hole, tip in zip(frame.piercings, scale.tips(frame) / MILLI, strict=True):
        x, _, z = hole.x / MILLI
        axes.plot(x, z, "o", color=view.MARKER, markersize=8, zorder=4)
        axes.add_patch(Circle((x, z), hole.footprint / MILLI, color=view.MARKER, alpha=0.3, zorder=3))
        if scale.shows(float(np.linalg.norm(hole.force))):
            axes.annotate("", (tip[0], tip[2]), (x, z), arrowprops=style, zorder=5)


def _section_held(axes: Axes, frame: Frame) -> None:
    """Draw the places of held nodes."""
    if frame.held is not None:
        axes.plot(*frame.held[:, [0, 2]].T / MILLI, ".", color=view.THREAD, markersize=4, zorder=3)


def _section_names(axes: Axes, frame: Frame, scale: view.Scale) -> None:
    """Draw the name and force of each hole next to the scene, with a line to the hole."""
    named = [hole for hole in frame.piercings if hole.state != view.LEFT]
    words = [literal(view.label(hole.name, float(np.linalg.norm(hole.force)))) for hole in named]
    boxes = np.array([[LETTER * LETTERS * len(text), 1.4 * LETTERS] for text in words]).reshape(-1, 2)
    places = view.places_of(frame), scale.tips(frame), frame.thread.points
    holes, tips, thread = (axes.transData.transform(points[:, [0, 2]] / MILLI) for points in places)
    occupied = np.concatenate([thread, along_arrows(holes, tips)])
    anchors = axes.transData.transform(np.array([hole.x[[0, 2]] for hole in named]).reshape(-1, 2) / MILLI)
    for text, anchor, corner in zip(words, anchors, label_places(anchors, boxes, occupied, view.SIZE), strict=True):
        axes.annotate(
            text, anchor, corner, xycoords="figure pixels", textcoords="figure pixels", fontsize=LETTERS * 72 / DPI,
            ha="left", va="bottom", zorder=6, arrowprops={"arrowstyle": "-", "linewidth": 0.8, "shrinkA": 0},
        )  # fmt: skip


def _section_frame(axes: Axes, frame: Frame, title: str, scale: view.Scale) -> None:
    tips = scale.tips(frame)
    low, high = np.min([scale.low, *tips], axis=0), np.max([scale.high, *tips], axis=0)
    margin = 0.08 * scale.width
    ends = np.array([low - margin, high + margin]) / MILLI
    axes.set(xlim=ends[:, 0], ylim=ends[:, 2], xlabel="x [mm]", ylabel="z [mm]")
    axes.set_aspect("equal", adjustable="box")
    axes.set_title(f"{literal(view.caption(frame, title))}\n{view.legend(scale, frame)}".strip(), fontsize=10)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)


def _section_y(frame: Frame, deformed: Array) -> float:
    """Return the y of the cut [m].

    The cut is near the piercings, inside the organ, and not through nodes of a regular mesh.
    """
    middle = float(np.mean([hole.x[1] for hole in frame.piercings] or frame.thread.points[:, 1]))
    return beside_nodes(middle, deformed[:, 1].min(), deformed[:, 1].max())


def beside_nodes(middle: float, low: float, high: float) -> float:
    """Return the y near a middle [m] of a cut inside a body, and not through nodes of a regular mesh.

    The body lies between `low` and `high` [m].
    """
    hair = ASIDE * (high - low)
    return float(np.clip(middle + hair, low + hair, high - hair))


# --- a mesh -----------------------------------------------------------------------------------------------


def draw_mesh(scene: MeshScene, path: Path) -> None:
    """Draw the cut y = const through the piercings [mm].

    It is coloured by the mean edge length at each node.
    """
    figure = Figure(figsize=(view.SIZE[0] / DPI, view.SIZE[1] / DPI), layout="constrained")
    axes = figure.add_subplot()
    ends = scene.points[:, 1].min(), scene.points[:, 1].max()
    y = beside_nodes(float(np.mean(scene.sites[:, 1] if len(scene.sites) else ends)), *ends)
    points, triangles, size = cut(scene.points, np.asarray(scene.cells), _sizes(scene) / MILLI, y)
    x, z = (points / MILLI).T
    filled = axes.tripcolor(x, z, size, triangles=triangles, shading="gouraud", cmap=ListedColormap(view.colours()))
    axes.triplot(x, z, triangles, color="#55453c", linewidth=0.4)
    axes.plot(*(scene.sites[:, [0, 2]] / MILLI).T, "o", color=view.MARKER, markersize=8)
    figure.colorbar(filled, ax=axes, label="edge length [mm]", shrink=0.8)
    axes.set(aspect="equal", xlabel="x [mm]", ylabel="z [mm]")
    axes.set_title(f"{literal(scene.title) or 'mesh'}, y = {y / MILLI:.3g} mm", fontsize=11)
    figure.savefig(path, dpi=DPI)


def _sizes(scene: MeshScene) -> Array:
    """Return the mean length of the edges at each node [m].

    Each edge is weighted by the number of its cells.
    """
    pairs = np.asarray(scene.cells, dtype=np.int64)[:, [[0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3]]].reshape(-1, 2)
    length = np.linalg.norm(scene.points[pairs[:, 0]] - scene.points[pairs[:, 1]], axis=1)
    return view.nodal(length, pairs, len(scene.points))


if __name__ == "__main__":
    view.draw_given(draw_section, draw_mesh)
