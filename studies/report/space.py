"""The three-dimensional view of a report: the organ's surface, the thread and the forces, frame by frame, packed.

Numbers are 16-bit integers in base64: displacements relative to the largest, a field relative to its range. If
this exceeds the budget of the page, frames are left out first. Then the surface is made coarser; its corners
remain nodes of the mesh.
"""

import base64
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from studies.arrays import Array
from studies.output.columns import STATE_CODES, UNITS
from studies.output.fields import OrganTopology
from studies.output.reading import FrameFiles, RunResults, cells_of, nodal, pieces, refused_if_torn
from studies.pictures.view import Indices, surface
from studies.report.charts import SHOWN, plain

BYTES = 9e6  # bytes of the page for the views of all its runs; in base64 4/3 of this
MOST_FRAMES = 51
FEWEST_NODES = 400  # of a surface
SHORT, WIDE = 2**15 - 1, 2**16 - 1  # largest 16-bit numbers with and without a sign
QUANTILE = 0.995  # of a field, at the end of its colours: high values at the holes must not hide the rest
STRESSES = ("xx", "yy", "zz", "xy", "yz", "xz")
THREAD_POINTS = 600  # largest number per frame


@dataclass(frozen=True)
class Skin:
    """The drawn part of an organ's surface.

    `nodes` are the numbers of its nodes in the mesh, shape `(n,)`, and `triangles` are places in `nodes`, shape
    `(k, 3)`.
    """

    nodes: Indices
    triangles: Indices


def view_record(run: RunResults, name: str, budget: float = BYTES) -> dict[str, Any]:
    """Return a run's view for the page; without an organ only the thread. Raises `ResultsError`."""
    with refused_if_torn(run.folder / "frames"):
        frames = [run.frames[int(k)] for k in chosen_frames(len(run.frames))]
        record: dict[str, Any] = {
            "name": name,
            "times": plain(np.array([frame.time for frame in frames])),
            "thread": [thread_record(frame.read("thread")) for frame in frames],
            "holes": [holes_record(frame, run.piercings) for frame in frames],
            "piercings": run.piercings,
        }
        if any("organ" in frame.parts for frame in frames):
            record["organ"] = organ_record(frames, budget)
        return record


def chosen_frames(count: int) -> NDArray[np.int64]:
    """Return at most `MOST_FRAMES` frame numbers, evenly spaced, with the first and the last frame."""
    return np.unique(np.linspace(0, count - 1, min(count, MOST_FRAMES)).round().astype(np.int64))


def organ_record(frames: Sequence[FrameFiles], budget: float) -> dict[str, Any]:
    """Return the organ of all frames, packed into about `budget` bytes."""
    first = frames[0].read("organ")
    cells, points = cells_of(first), np.asarray(first.points, dtype=np.float64)
    fields = field_names(first)
    per_node = 2.0 * (3 + len(fields)) * len(frames)
    skin = decimated(points, whole_skin(points, cells), max(FEWEST_NODES, int(budget / per_node)))
    moved, shown = [], []
    for frame in frames:
        organ = frame.read("organ")
        moved.append(np.asarray(organ.point_data["displacement"], dtype=np.float64)[skin.nodes])
        shown.append([values[skin.nodes] for values in field_values(organ, cells, fields)])
    largest = float(np.abs(moved).max()) or 1.0
    return {
        "points": packed(points[skin.nodes], np.float32),
        "triangles": packed(skin.triangles, np.int32),
        "displacement": packed(np.round(np.array(moved) / largest * SHORT), np.int16),
        "displacement_scale": largest / SHORT,
        "fields": [
            field_record(label, unit, np.array([frame[k] for frame in shown])) for k, (label, unit) in enumerate(fields)
        ],
        "nodes": len(skin.nodes),
        "of": len(points),
    }


def whole_skin(points: Array, cells: Indices) -> Skin:
    """Return the whole surface of an organ."""
    triangles = surface(OrganTopology(points, cells))
    nodes, places = np.unique(triangles, return_inverse=True)
    return Skin(nodes, places.reshape(triangles.shape))


def decimated(points: Array, skin: Skin, most: int) -> Skin:
    """Return a surface with about `most` nodes, all from the given surface."""
    if len(skin.nodes) <= most:
        return skin
    import pyvista as pv
    from scipy.spatial import cKDTree

    whole = pv.PolyData.from_regular_faces(points[skin.nodes], skin.triangles)
    coarse = whole.decimate_pro(1.0 - most / len(skin.nodes), preserve_topology=True)
    _, near = cKDTree(points[skin.nodes]).query(np.asarray(coarse.points))
    return Skin(skin.nodes[near], np.asarray(coarse.regular_faces, dtype=np.int64))


def field_names(organ: Any) -> list[tuple[str, str]]:
    """Return the names of the selectable fields, with units: von Mises stress first, then other nodal and cell
    fields."""
    scalars = [
        name
        for data in (organ.point_data, organ.cell_data)
        for name in data
        if np.ndim(data[name]) == 1 and np.isfinite(data[name]).all()
    ]
    first = [name for name in ("von_mises",) if name in scalars]
    names = [*first, "displacement", *(name for name in scalars if name not in first)]
    labels = [(name, UNITS.get(name, "")) for name in names]
    return labels + [(f"stress_{part}", UNITS["stress"]) for part in STRESSES if "stress" in organ.point_data]


def field_values(organ: Any, cells: Indices, fields: Sequence[tuple[str, str]]) -> list[Array]:
    """Return each field at the nodes, shape `(nodes,)`; a field of cells is averaged over the cells at a node."""
    nodes = organ.n_points
    out = []
    for name, _ in fields:
        if name == "displacement":
            values = np.linalg.norm(np.asarray(organ.point_data[name], dtype=np.float64), axis=1)
        elif name.startswith("stress_"):
            values = np.asarray(organ.point_data["stress"], dtype=np.float64)[:, STRESSES.index(name[-2:])]
        elif name in organ.point_data:
            values = np.asarray(organ.point_data[name], dtype=np.float64)
        else:
            values = nodal(np.asarray(organ.cell_data[name], dtype=np.float64), cells, nodes)
        out.append(values)
    return out


def field_record(name: str, unit: str, values: Array) -> dict[str, Any]:
    """Return a field of all frames, shape `(frames, n)`, in the unit of the charts, with the range of its colours."""
    factor, shown = SHOWN.get(unit, (1.0, unit))
    scaled = factor * values
    low, high = float(scaled.min()), float(scaled.max())
    span = high - low or 1.0
    ends = np.quantile(scaled, [1.0 - QUANTILE if low < 0.0 else 0.0, QUANTILE]).tolist()
    return {
        "name": name,
        "unit": shown,
        "low": low,
        "step": span / WIDE,
        "range": ends if ends[1] > ends[0] else [low, low + span],
        "values": packed(np.round((scaled - low) / span * WIDE), np.uint16),
    }


def thread_record(thread: Any) -> dict[str, Any]:
    """Return the thread of one frame: places in mm and tension, with a gap between its pieces."""
    points, tension = np.asarray(thread.points, dtype=np.float64), np.asarray(thread.point_data["tension"])
    s = np.asarray(thread.point_data["s"], dtype=np.float64)
    chain: list[int] = []
    for piece in pieces(thread):
        step = max(1, -(-len(points) // THREAD_POINTS))
        chain += [*piece[:-1:step].tolist(), int(piece[-1]), -1]
    held = np.array(chain[:-1], dtype=np.int64)
    gap = held < 0
    columns = {axis: 1e3 * points[held, k] for k, axis in enumerate("xyz")}
    columns |= {"tension": tension[held].astype(np.float64), "s": 1e3 * s[held]}
    return {name: plain(np.where(gap, np.nan, values)) for name, values in columns.items()}


def holes_record(frame: FrameFiles, names: Sequence[str]) -> list[dict[str, Any]]:
    """Return the piercings of one frame that contain the thread: name, place in mm, and force [N]."""
    holes = frame.read("piercings")
    if holes is None:
        return []
    data = holes.point_data
    return [
        {"name": name, "x": plain(1e3 * np.asarray(x, dtype=np.float64)), "force": plain(np.asarray(force))}
        for name, x, force, state in zip(names, holes.points, data["force"], data["state"], strict=True)
        if state != STATE_CODES["left"]
    ]


def packed(values: Array | Indices, kind: Any) -> str:
    """Return numbers as text: little-endian, of the given kind, in base64."""
    return base64.b64encode(np.ascontiguousarray(values, dtype=np.dtype(kind).newbyteorder("<")).tobytes()).decode()
