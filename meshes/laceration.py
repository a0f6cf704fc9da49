"""The surface of a lacerated organ: an uneven ellipsoid with a wedge torn into its top.

`python -m meshes.laceration FILE.obj` writes the surface of the shipped scene.
"""

import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from meshes.errors import MeshError
from meshes.grading import require_positive
from meshes.skin import Skin

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

WAVES = 6  # number of waves in the unevenness
LONGEST, SHORTEST = 1.5, 4.0  # range of the radians of a wave over an axis of the ellipsoid
DIGITS = 5  # after the point, in millimetres: far below the precision of a surface


@dataclass(frozen=True)
class Laceration:
    """An uneven ellipsoid with a wedge torn into its top along y.

    The ellipsoid has the semi-axes `axes` [m]. `uneven` is the relative variation of its radius,
    from a random `seed`. The wedge has `length`, `width` and `depth` [m] at its middle, and closes
    like an ellipse towards its ends. `rings` is the number of facets from end to end along y, and
    `around` is the number around y. `layers` is the number of facets down each face of the wedge.
    """

    axes: tuple[float, float, float] = (0.03, 0.035, 0.02)
    uneven: float = 0.03
    length: float = 0.034
    width: float = 8e-4
    depth: float = 0.01
    rings: int = 40
    around: int = 40
    layers: int = 5
    seed: int = 1

    def __post_init__(self) -> None:
        for name in ("length", "width", "depth"):
            require_positive(name, getattr(self, name))
        if self.length >= 2.0 * self.axes[1] or self.depth >= self.axes[2]:
            raise MeshError(
                f"length = {self.length!r} and depth = {self.depth!r} of the wedge must be below twice the second and "
                f"the third of axes = {self.axes!r}: make it smaller"
            )


def lacerated(shape: Laceration) -> Skin:
    """Return the closed surface with the wedge, in metres."""
    points, triangles = ellipsoid(shape)
    top = 1 + np.arange(shape.rings - 1) * shape.around
    torn = top[np.abs(points[top, 1]) < 0.5 * shape.length]
    opening = np.sqrt(1.0 - (points[torn, 1] / (0.5 * shape.length)) ** 2)[:, None]
    rim, across = points[torn], 0.5 * shape.width * opening * [1.0, 0.0, 0.0]
    floor = rim - shape.depth * opening * [0.0, 0.0, 1.0]
    ends = top[[np.searchsorted(top, torn[0]) - 1, np.searchsorted(top, torn[-1]) + 1]]
    points[torn] = rim + across
    left = len(points) + np.arange(len(torn))
    points = np.vstack([points, rim - across])
    other = np.arange(len(points))
    other[torn] = left
    middles = points[triangles].mean(axis=1)
    triangles = np.where((middles[:, 0] < 0.0)[:, None], other[triangles], triangles)
    bottom = len(points) + np.arange(len(torn))
    points = np.vstack([points, floor])
    faces = []
    for side in (torn, left):
        points, face = sheet(points, side, bottom, ends, shape.layers)
        faces.append(face if side is torn else face[:, ::-1])
    return Skin(points, np.vstack([triangles, *faces]))


def ellipsoid(shape: Laceration) -> tuple[Array, Indices]:
    """Return points and triangles of the uneven ellipsoid without the wedge.

    The nodes are two poles at the ends of the y axis, and rings around this axis. The first node of
    each ring is on top, at x = 0.
    """
    tilt = np.pi * np.arange(1, shape.rings) / shape.rings
    turn = 2.0 * np.pi * np.arange(shape.around) / shape.around
    ring = np.stack(np.broadcast_arrays(np.sin(turn), 0.0, np.cos(turn)), axis=1)
    unit = np.sin(tilt)[:, None, None] * ring - np.cos(tilt)[:, None, None] * [0.0, 1.0, 0.0]
    unit = np.vstack([[0.0, -1.0, 0.0], unit.reshape(-1, 3), [0.0, 1.0, 0.0]])
    k, n = np.arange(shape.around), shape.around
    after = (k + 1) % n
    first = np.stack([0 * k, 1 + after, 1 + k], axis=1)
    low = 1 + n * np.arange(shape.rings - 2)[:, None]
    quads = [np.stack(np.broadcast_arrays(low + k, low + after, low + n + after), axis=-1).reshape(-1, 3)]
    quads.append(np.stack(np.broadcast_arrays(low + k, low + n + after, low + n + k), axis=-1).reshape(-1, 3))
    last = 1 + n * (shape.rings - 2)
    final = np.stack([last + k, last + after, 0 * k + last + n], axis=1)
    scale = 1.0 + shape.uneven * unevenness(unit, shape.seed)
    return scale[:, None] * unit * shape.axes, np.vstack([first, *quads, final])


def unevenness(unit: Array, seed: int) -> Array:
    """Return a smooth random function of directions `(n, 3)`, shape `(n,)`.

    Its values are of order 1.
    """
    random = np.random.default_rng(seed)
    waves = random.normal(size=(WAVES, 3))
    waves *= (random.uniform(LONGEST, SHORTEST, WAVES) / np.linalg.norm(waves, axis=1))[:, None]
    phases = random.uniform(0.0, 2.0 * np.pi, WAVES)
    return np.asarray(np.sin(unit @ waves.T + phases).sum(axis=1) * np.sqrt(2.0 / WAVES))


def sheet(points: Array, rim: Indices, bottom: Indices, ends: Indices, layers: int) -> tuple[Array, Indices]:
    """Return the points plus the points of one face of the wedge, and the triangles of the face.

    The face extends from the nodes of the `rim` down to the nodes of the `bottom`; both lines meet
    at the `ends`.
    """
    share = np.linspace(0.0, 1.0, layers + 1)[1:-1, None, None]
    between = (1.0 - share) * points[rim] + share * points[bottom]
    inner = len(points) + np.arange(between[..., 0].size).reshape(between.shape[:2])
    rows = np.vstack([rim, inner, bottom])
    a, b, c, d = rows[:-1, :-1], rows[:-1, 1:], rows[1:, :-1], rows[1:, 1:]
    squares = [np.stack([a, b, d], axis=-1).reshape(-1, 3), np.stack([a, d, c], axis=-1).reshape(-1, 3)]
    fans = [
        np.stack(np.broadcast_arrays(ends[0], rows[:-1, 0], rows[1:, 0]), axis=-1),
        np.stack(np.broadcast_arrays(ends[1], rows[1:, -1], rows[:-1, -1]), axis=-1),
    ]
    return np.vstack([points, between.reshape(-1, 3)]), np.vstack([*squares, *fans])


def as_obj(skin: Skin) -> str:
    """Return a surface as the text of an .obj file, in millimetres."""
    points = [f"v {x:.{DIGITS}f} {y:.{DIGITS}f} {z:.{DIGITS}f}" for x, y, z in 1e3 * skin.points + 0.0]
    return "\n".join([*points, *(f"f {a} {b} {c}" for a, b, c in skin.triangles + 1), ""])


if __name__ == "__main__":
    Path(sys.argv[1]).write_text(as_obj(lacerated(Laceration())), encoding="utf-8")
