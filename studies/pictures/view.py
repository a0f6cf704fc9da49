"""Common parts of the pictures of a frame or a mesh: the visible region, colours, labels."""

import pickle
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from studies.arrays import KILO, Array
from studies.output.fields import OrganTopology
from studies.pictures.scene import FILM, Frame, MeshScene

Indices = NDArray[np.int64]

SIZE, FILM_SIZE = (1500, 1000), (900, 600)  # pixels, of a picture and of an animation
PAUSE, LAST = 120, 1500  # ms of each picture of an animation, and of the last one
THREAD, MARKER, ARROW = "#1f3a93", "#c0392b", "#222222"
TISSUE = ("#f7e6da", "#f0bd9f", "#dc7356", "#8e1b2c")
TENSION = ("#a6cee3", "#3b76b8", "#0b1a5e")
PRESSURE = ("#a6cee3", "#3f9b56", "#0f4a1f")  # of a compressed thread: from the same colour at zero
SHADES = 256
LEFT = "left"  # state of a hole without the thread
UNFELT = 1e-9  # N: below the weight of a millimetre of the thinnest suture, and above the round-off of a slack thread
LARGEST = 6.0  # diagonals of the box of the selected points: a larger organ is shown only around the thread
REACH = 0.16  # longest arrow over the diagonal of the scene
TICKS = 4  # largest number of labels at a colour bar
ROUND = np.array([1.0, 2.0, 5.0])  # possible steps between two labels, within a decade


def draw_given(draw: Callable[..., None], draw_mesh: Callable[[MeshScene, Path], None]) -> None:
    """Draw the scene that ``draw_scene`` wrote for this child process.

    Its arguments are the file of the scene and the path of the picture. A scene is a `MeshScene`, or frames for one
    file with the organ's mesh and a title.
    """
    scene, path = pickle.loads(Path(sys.argv[1]).read_bytes()), Path(sys.argv[2])
    if isinstance(scene, MeshScene):
        draw_mesh(scene, path)
    else:
        frames, topology, title = scene
        draw(frames, topology, path, title)


def nodal(values: Array, cells: Indices, nodes: int) -> Array:
    """Return values of cells `(cells,)`, averaged over the cells at each node, shape `(nodes,)`."""
    flat = cells.ravel()
    total = np.bincount(flat, np.repeat(values, cells.shape[1]), minlength=nodes)
    return np.asarray(total / np.maximum(np.bincount(flat, minlength=nodes), 1))


def surface(topology: OrganTopology) -> Indices:
    """Return the corner nodes of the boundary triangles, shape ``(facets, 3)``.

    They are anticlockwise as seen from outside.
    """
    corners = topology.cells[:, :4].copy()
    edges = topology.points[corners[:, 1:]] - topology.points[corners[:, :1]]
    left_handed = np.linalg.det(edges) < 0
    corners[left_handed] = corners[left_handed][:, [0, 2, 1, 3]]
    faces = corners[:, [[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]]].reshape(-1, 3)
    corners = np.sort(faces, axis=1)
    order = np.lexsort(corners.T)
    again = (corners[order[1:]] == corners[order[:-1]]).all(axis=1)  # equal to the face before it
    return np.asarray(faces[order[~(np.append(again, False) | np.append(False, again))]])


@dataclass(frozen=True)
class Scale:
    """The common scale of the pictures of frames.

    It has the corners of the box of the selected points [m], and the colour ranges of stress [Pa]
    and tension [N]. `force` is the largest force of a hole [N], zero without forces.
    """

    low: Array  # (3,)
    high: Array  # (3,)
    stress: tuple[float, float]
    tension: tuple[float, float]
    force: float

    @property
    def width(self) -> float:
        """The diagonal of the box [m]."""
        return float(np.linalg.norm(self.high - self.low)) or 1.0

    @property
    def reach(self) -> float:
        """The length of the longest arrow [m]."""
        return REACH * self.width

    def shows(self, force: float) -> bool:
        """Return whether a force [N] is large enough for an arrow."""
        return force > 1e-3 * self.force > 0.0

    def tips(self, frame: Frame) -> Array:
        """Return the tips of the arrows of the holes' forces, shape `(p, 3)` [m]."""
        return np.asarray(places_of(frame) + self.reach / (self.force or 1.0) * forces_of(frame))


def scale_of(frames: Sequence[Frame]) -> Scale:
    """Return the common scale of frames, which shows the selected points of each frame."""
    points = np.concatenate([part for frame in frames for part in (aimed_at(frame), places_of(frame))])
    stresses = [frame.organ.von_mises for frame in frames if frame.organ is not None]
    force = max((float(np.linalg.norm(hole.force)) for frame in frames for hole in frame.piercings), default=0.0)
    return Scale(
        points.min(axis=0),
        points.max(axis=0),
        limits(np.concatenate(stresses)) if stresses else (0.0, 1.0),
        limits(np.concatenate([frame.thread.tension for frame in frames]), UNFELT),
        force if force > UNFELT else 0.0,
    )


def aimed_at(frame: Frame) -> Array:
    """Return the points of the thread to be shown, shape `(k, 3)` [m].

    These are the pieces in holes, and free pieces at a distance of at most the extent of the
    former.
    """
    pieces, bounds = frame.thread.split(frame.thread.points), frame.thread.split(frame.thread.s)
    held = [hole.s for hole in frame.piercings if hole.state != LEFT]
    kept = [points for points, s in zip(pieces, bounds, strict=True) if any(s[0] <= at <= s[-1] for at in held)]
    if not kept or len(kept) == len(pieces):
        return frame.thread.points
    low, high = np.concatenate(kept).min(axis=0), np.concatenate(kept).max(axis=0)
    beyond = np.maximum(low - frame.thread.points, frame.thread.points - high).max(axis=1)
    return np.asarray(frame.thread.points[beyond <= np.linalg.norm(high - low)])


def shown_organ(frame: Frame, topology: OrganTopology | None, scale: Scale) -> Array:
    """Return the points `(n, 3)` [m] of an organ to be shown whole.

    Empty for a very large organ, which would make the thread hard to see.
    """
    if topology is None or frame.organ is None:
        return np.empty((0, 3))
    points = topology.points + frame.organ.displacement
    return np.asarray(points if np.linalg.norm(np.ptp(points, axis=0)) <= LARGEST * scale.width else points[:0])


def places_of(frame: Frame) -> Array:
    """Return the places of the holes, shape `(p, 3)` [m]."""
    return np.array([hole.x for hole in frame.piercings], dtype=np.float64).reshape(-1, 3)


def forces_of(frame: Frame) -> Array:
    """Return the forces of the holes on the thread, shape `(p, 3)` [N]."""
    return np.array([hole.force for hole in frame.piercings], dtype=np.float64).reshape(-1, 3)


def limits(values: Array, least: float = 0.0) -> tuple[float, float]:
    """Return the range of the colours, which includes zero.

    The highest and lowest 0.5 % have the end colours, and values up to `least` count as zero.
    """
    low, high = (value if abs(value) > least else 0.0 for value in np.quantile(values, [0.005, 0.995]))
    return min(0.0, float(low)), max(0.0, float(high)) or float(low >= 0.0)


def ticks(low: float, high: float) -> Array:
    """Return the labels of a colour bar for `low` ≤ 0 ≤ `high`.

    They are at most `TICKS` multiples of a round number, with zero.
    """
    decade = 10.0 ** np.floor(np.log10((high - low) / TICKS))
    parts = decade * np.append(ROUND, 10.0 * ROUND)
    first, last = np.ceil(low / parts), np.floor(high / parts)
    k = int(np.argmax(last - first < TICKS))
    return np.asarray(parts[k] * np.arange(first[k], last[k] + 1.0) + 0.0)


def stress_words(frame: Frame) -> str:
    """Return the title of the stress colours, with the largest stress [kPa].

    The largest stress can lie above the range.
    """
    most = "" if frame.organ is None else f", maximum {frame.organ.von_mises.max() / KILO:.3g}"
    return f"von Mises stress [kPa]{most}"


def tension_words(frame: Frame) -> str:
    """Return the title of the tension colours, with the largest tension [N].

    For a compressed thread also the smallest tension. Both can lie outside the range.
    """
    low, high = frame.thread.tension.min(), frame.thread.tension.max()
    reach = f"{low:.3g} to {high:.3g}" if low < -UNFELT else f"maximum {high:.3g}"
    return f"tension of the thread [N], {reach}"


def label(name: str, force: float) -> str:
    """Return the name of a piercing with its force [N]."""
    return f"{name}  {force_text(force)}"


def force_text(force: float) -> str:
    """Return a force [N] in words, with a suitable unit."""
    felt = force if force > UNFELT else 0.0
    return f"{felt * KILO:.3g} mN" if felt < 1.0 else f"{felt:.3g} N"


def legend(scale: Scale, frame: Frame) -> str:
    """Return the legend of the arrows, held nodes and footprints in the picture."""
    arrows = f"arrows: force of each hole on the thread, longest {force_text(scale.force)}" if scale.force else ""
    held = "blue: held nodes" if frame.held is not None and len(frame.held) else ""
    balls = "red: footprints" if any(hole.footprint for hole in frame.piercings) else ""
    return "; ".join(filter(None, (arrows, held, balls)))


def caption(frame: Frame, title: str) -> str:
    """Return the title and the time of a frame."""
    time = f"t = {frame.time:.4g} s"
    return f"{title}, {time}" if title else time


def rgb(colour: str) -> Array:
    """Return red, green and blue of a colour `#rrggbb`, shape `(3,)`, from 0 to 1."""
    return np.frombuffer(bytes.fromhex(colour[1:]), np.uint8) / 255.0


def blend(names: Sequence[str], shares: Array) -> Array:
    """Return the colours at `shares` (n,) of the way from the first to the last, shape `(n, 3)`."""
    places = np.linspace(0.0, 1.0, len(names))
    return np.stack([np.interp(shares, places, part) for part in np.array([rgb(name) for name in names]).T], axis=1)


def colours() -> Array:
    """Return the colours of the stress, from zero to the highest, shape `(SHADES, 3)`."""
    return blend(TISSUE, np.linspace(0.0, 1.0, SHADES))


def tension_colours(scale: Scale) -> Array:
    """Return the colours of the thread's tension, from the lowest on, shape `(SHADES, 3)`.

    Compression has its own colour, as strong as a tension of the same size.
    """
    low, high = scale.tension
    values = np.linspace(low, high, SHADES) / max(-low, high)
    return np.where(values[:, None] < 0.0, blend(PRESSURE, -values), blend(TENSION, values))


# --- frames in a file: one as a picture, or all as an animation -----------------------------------------------


def write_frames(frames: Sequence[Frame], path: Path, draw: Callable[[Frame, Path], None]) -> None:
    """Write the first frame as a PNG file, or all frames as an endless GIF.

    `draw` draws one frame into a picture.
    """
    if path.suffix.lower() != FILM:
        draw(frames[0], path)
        return
    scratch = path.with_name("frame.png")
    pictures = []
    for frame in frames:
        draw(frame, scratch)
        pictures.append(small(scratch))
    pauses = [PAUSE] * (len(pictures) - 1) + [LAST]
    pictures[0].save(path, format="GIF", save_all=True, append_images=pictures[1:], duration=pauses, loop=0)


def small(path: Path) -> Image.Image:
    """Return a picture in the size of an animation."""
    with Image.open(path) as picture:
        return picture.convert("RGB").resize(FILM_SIZE, Image.Resampling.LANCZOS)
