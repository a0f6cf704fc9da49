"""What the pictures of a frame have in common: the part to be seen, colours, labels."""

import pickle
from pathlib import Path

import numpy as np
from matplotlib.colors import LinearSegmentedColormap
from numpy.typing import NDArray

from studies.arrays import Array
from studies.output.records import OrganTopology, Snapshot

Indices = NDArray[np.int64]
Scene = tuple[Snapshot, OrganTopology | None, str]  # with a title

SIZE = (1500, 1000)  # pixels
THREAD, MARKER, ARROW = "#1f3a93", "#c0392b", "#222222"
TISSUE = ("#f7e6da", "#f0bd9f", "#dc7356", "#8e1b2c")
KILO, MILLI = 1e3, 1e-3


def read_scene(path: str) -> Scene:
    """Read the frame that ``draw_picture`` left for a child process."""
    read: Scene = pickle.loads(Path(path).read_bytes())
    return read


def surface(topology: OrganTopology) -> Indices:
    """Return the corner nodes of the boundary triangles, shape ``(facets, 3)``, seen anticlockwise from outside."""
    corners = topology.cells[:, :4].copy()
    edges = topology.points[corners[:, 1:]] - topology.points[corners[:, :1]]
    left_handed = np.linalg.det(edges) < 0
    corners[left_handed] = corners[left_handed][:, [0, 2, 1, 3]]
    faces = corners[:, [[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]]].reshape(-1, 3)
    _, first, counts = np.unique(np.sort(faces, axis=1), axis=0, return_index=True, return_counts=True)
    outer: Indices = faces[first[counts == 1]]
    return outer


def view_box(frame: Snapshot) -> tuple[Array, Array]:
    """Return the corners of the box to be seen: piercings, and the thread as far around them as they are apart."""
    points = frame.thread.points
    if frame.piercings:
        holes = np.array([hole.x for hole in frame.piercings])
        centre = holes.mean(axis=0)
        reach = max(1.6 * float(np.ptp(holes, axis=0).max()), 0.2 * float(np.ptp(points, axis=0).max()))
        near = np.linalg.norm(points - centre, axis=1) <= reach
        points = np.concatenate([points[near], holes])
    return points.min(axis=0), points.max(axis=0)


def view_width(frame: Snapshot) -> float:
    """Return the diagonal of the box to be seen [m]."""
    low, high = view_box(frame)
    return float(np.linalg.norm(high - low)) or 1.0


def limits(values: Array) -> tuple[float, float]:
    """Choose the range of the colours; the highest hundredth, at the holes, is not to drown the rest."""
    return 0.0, float(np.quantile(values, 0.995)) or 1.0


def label(name: str, force: float) -> str:
    """Name of a piercing and its force [N]."""
    return f"{name}  {force * KILO:.3g} mN" if force < 1.0 else f"{name}  {force:.3g} N"


def caption(frame: Snapshot, title: str) -> str:
    """Write the title and the time of a frame."""
    time = f"t = {frame.time:.4g} s"
    return f"{title}, {time}" if title else time


def colours() -> LinearSegmentedColormap:
    """Return the colours of the stress, from none to the highest."""
    return LinearSegmentedColormap.from_list("tissue", TISSUE)
