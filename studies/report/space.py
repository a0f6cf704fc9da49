"""The three-dimensional view of a report, frame by frame, packed.

It has the organ's surface, the thread and the forces. Numbers are 16-bit integers in base64:
displacements relative to the largest, a field relative to its range. If this exceeds the budget of
the page, frames are left out first. Then the surface is made coarser; its corners remain nodes of
the mesh.
"""

import base64
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from studies.arrays import Array
from studies.output import reading
from studies.output.columns import UNITS
from studies.output.fields import OrganTopology, ThreadRecord
from studies.pictures.looking import read_holes, read_thread
from studies.pictures.scene import Hole
from studies.pictures.view import LEFT, Indices, nodal, surface
from studies.report.charts import SHOWN, plain

BYTES = 9e6  # bytes of the page for the views of all its runs; in base64 4/3 of this
MOST_FRAMES = 51
FEWEST_NODES = 400  # of a surface
SHORT, WIDE = 2**15 - 1, 2**16 - 1  # largest 16-bit numbers with and without a sign
QUANTILE = 0.995  # of a field, at the end of its colours: high values at the holes must not hide the rest
STRESSES = ("xx", "yy", "zz", "xy", "yz", "xz")
CORNERS = 4  # nodes of a tetrahedron without mid-edge nodes
THREAD_POINTS = 600  # largest number per frame


# The drawn part of an organ's surface: the numbers of its nodes in the mesh, `(n,)`, and its triangles as places in
# these numbers, `(k, 3)`.
Skin = tuple[Indices, Indices]


def view_record(run: reading.OpenRun, name: str, budget: float = BYTES) -> dict[str, Any]:
    """Return a run's view for the page; without an organ only the thread. Raises `ResultsError`."""
    with reading.refused_if_torn(run.folder / "frames"):
        frames = [run.frames[k] for k in reading.evenly_spaced(len(run.frames), MOST_FRAMES).tolist()]
        record: dict[str, Any] = {
            "name": name,
            "times": plain(np.array([frame.time for frame in frames])),
            "thread": [thread_record(read_thread(frame)) for frame in frames],
            "holes": [holes_record(read_holes(frame, run.piercings)) for frame in frames],
            "piercings": run.piercings,
        }
        if any("organ" in frame.parts for frame in frames):
            record["organ"] = organ_record(frames, budget)
        return record


def organ_record(frames: Sequence[reading.FrameFiles], budget: float) -> dict[str, Any]:
    """Return the organ of all frames, packed into about `budget` bytes."""
    first = frames[0].read("organ")
    topology: Any = reading.topology_of(frames[0])
    points, cells = topology.points, topology.cells[:, :CORNERS]
    names = field_names(field_values(first, cells))
    per_node = 2.0 * (3 + len(names)) * len(frames)
    nodes, triangles = decimated(points, whole_skin(points, cells), max(FEWEST_NODES, int(budget / per_node)))
    moved, shown = [], []
    for frame in frames:
        organ = frame.read("organ")
        moved.append(np.asarray(organ.point_data["displacement"], dtype=np.float64)[nodes])
        values = field_values(organ, cells)
        shown.append([values[name][nodes] for name in names])
    largest = float(np.abs(moved).max()) or 1.0
    fields = [field_record(name, np.array(values)) for name, *values in zip(names, *shown, strict=True)]
    return {
        "points": packed(points[nodes], np.float32),
        "triangles": packed(triangles, np.int32),
        "displacement": packed(np.round(np.array(moved) / largest * SHORT), np.int16),
        "displacement_scale": largest / SHORT,
        "fields": fields,
        "nodes": len(nodes),
        "of": len(points),
    }


def whole_skin(points: Array, cells: Indices) -> Skin:
    """Return the whole surface of an organ."""
    triangles = surface(OrganTopology(points, cells))
    nodes, places = np.unique(triangles, return_inverse=True)
    return nodes, places.reshape(triangles.shape)


def decimated(points: Array, skin: Skin, most: int) -> Skin:
    """Return a surface with about `most` nodes, all from the given surface."""
    nodes, triangles = skin
    if len(nodes) <= most:
        return skin
    import pyvista as pv
    from scipy.spatial import cKDTree

    whole = pv.PolyData.from_regular_faces(points[nodes], triangles)
    coarse = whole.decimate_pro(1.0 - most / len(nodes), preserve_topology=True)
    _, near = cKDTree(points[nodes]).query(np.asarray(coarse.points))
    return nodes[near], np.asarray(coarse.regular_faces, dtype=np.int64)


def field_names(fields: Mapping[str, Array]) -> list[str]:
    """Return the names of the fields without NaN.

    The von Mises stress and the displacement are first.
    """
    finite = [name for name, values in fields.items() if np.isfinite(values).all()]
    first = [name for name in ("von_mises", "displacement") if name in finite]
    return first + [name for name in finite if name not in first]


def field_values(organ: Any, cells: Indices) -> dict[str, Array]:
    """Return each field at the nodes by its name, shape `(nodes,)`.

    A field of cells is averaged over the cells at a node. Vectors are left out, except the length
    of the displacement and the components of the stress.
    """
    data, cell_data = reading.arrays_of(organ.point_data), reading.arrays_of(organ.cell_data)
    out = {name: values for name, values in data.items() if values.ndim == 1}
    scalars = {name: values for name, values in cell_data.items() if values.ndim == 1}
    out |= {name: nodal(values, cells, organ.n_points) for name, values in scalars.items()}
    out["displacement"] = np.linalg.norm(data["displacement"], axis=1)
    if "stress" in data:
        out |= {f"stress_{part}": data["stress"][:, k] for k, part in enumerate(STRESSES)}
    return out


def field_record(name: str, values: Array) -> dict[str, Any]:
    """Return a field of all frames, shape `(frames, n)`, with its colour range.

    It is in the unit of the charts.
    """
    unit = UNITS.get("stress" if name.startswith("stress_") else name, "")
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


def thread_record(thread: ThreadRecord) -> dict[str, Any]:
    """Return the thread of one frame: places in mm and tension, with a gap between its pieces."""
    count, chain = len(thread.points), list[int]()
    for piece in thread.split(np.arange(count)):
        step = max(1, -(-count // THREAD_POINTS))
        chain += [*piece[:-1:step].tolist(), int(piece[-1]), -1]
    held = np.array(chain[:-1], dtype=np.int64)
    columns = {axis: 1e3 * thread.points[held, k] for k, axis in enumerate("xyz")}
    columns |= {"tension": thread.tension[held], "s": 1e3 * thread.s[held]}
    return {name: plain(np.where(held < 0, np.nan, values)) for name, values in columns.items()}


def holes_record(holes: Sequence[Hole]) -> list[dict[str, Any]]:
    """Return the piercings of one frame that contain the thread.

    Each has its name, its place [mm] and its force [N].
    """
    there = (hole for hole in holes if hole.state != LEFT)
    return [{"name": hole.name, "x": plain(1e3 * hole.x), "force": plain(hole.force)} for hole in there]


def packed(values: Array | Indices, kind: Any) -> str:
    """Return numbers as text: little-endian, of the given kind, in base64."""
    return base64.b64encode(np.ascontiguousarray(values, dtype=np.dtype(kind).newbyteorder("<")).tobytes()).decode()
