"""Camera of a picture: its position, projections of points, and free places for labels.

The camera has no perspective. One scale bar is valid for the whole picture, and the pixel of a
point is a linear function of its place.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from studies.arrays import Array

TOWARDS = (0.25, -0.85, 0.46)  # from the scene to the camera: seen from the side and above
UP = (0.0, 0.0, 1.0)
STEPS = (1.0, 2.0, 5.0)  # lengths of a scale bar, times a power of ten
RINGS, ROUND = (0.6, 1.0, 1.6, 2.4, 3.4, 4.6), 16  # distances tried, in heights of a label, and number of directions
CLEAR = 6.0  # pixels around a label


@dataclass(frozen=True)
class Camera:
    """A view without perspective.

    It has unit vectors to the right, up and towards the camera, and the place in the middle of the
    picture. `scale` is in pixels per metre, and `size` in pixels.
    """

    right: Array  # (3,)
    up: Array  # (3,)
    towards: Array  # (3,)
    focus: Array  # (3,) [m]
    scale: float  # [1/m]
    size: tuple[int, int]

    def pixels(self, points: Array) -> Array:
        """Return the pixels `(n, 2)` of points `(n, 3)` [m] in the picture.

        They are counted from its lower left corner.
        """
        across = (np.atleast_2d(points) - self.focus) @ np.stack([self.right, self.up], axis=1)
        return np.asarray(self.scale * across + 0.5 * np.array(self.size))

    @property
    def half_height(self) -> float:
        """Half the picture's height [m]."""
        return 0.5 * self.size[1] / self.scale


def camera_on(points: Array, size: tuple[int, int], margins: tuple[float, float, float, float]) -> Camera:
    """Return the camera that shows points `(n, 3)` [m] as large as possible.

    `margins` are left, right, below and above [pixels].
    """
    away = np.asarray(TOWARDS) / np.linalg.norm(TOWARDS)
    right = np.cross(UP, away)
    right /= np.linalg.norm(right)
    up = np.cross(away, right)
    across = points @ np.stack([right, up], axis=1)
    low, high = across.min(axis=0), across.max(axis=0)
    left, aside, below, above = margins
    room = np.array([size[0] - left - aside, size[1] - below - above])
    scale = float((room / np.maximum(high - low, 1e-9)).min())
    shift = np.array([left - aside, below - above]) / 2 / scale
    middle = 0.5 * (low + high) - shift
    focus = middle[0] * right + middle[1] * up + (points @ away).mean() * away
    return Camera(right, up, away, focus, scale, size)


def scale_bar(scale: float, most: float) -> tuple[float, str]:
    """Return the length of a scale bar [m] of at most `most` pixels, and its text."""
    longest = most / scale
    power = 10.0 ** np.floor(np.log10(longest))
    length = max(step * power for step in STEPS if step * power <= longest * (1.0 + 1e-9))
    return float(length), f"{1e3 * length:g} mm"


def along_arrows(holes: Array, tips: Array) -> Array:
    """Return pixels along arrows, shape `(20 p, 2)`, from holes `(p, 2)` to tips."""
    share = np.linspace(0.0, 1.0, 20)[:, None, None]
    return np.asarray((holes + share * (tips - holes)).reshape(-1, 2))


def label_places(anchors: Array, boxes: Array, occupied: Array, size: tuple[int, int]) -> Array:
    """Return the lower left corners `(n, 2)` [pixels] of labels of sizes `boxes` `(n, 2)`.

    Each label is near its anchor `(n, 2)`. If there is room, labels cover neither each other nor
    `occupied` points `(k, 2)`.
    """
    placed: list[tuple[Array, Array]] = []
    for anchor, box in zip(anchors, boxes, strict=True):
        tries = [corner_at(anchor, box, ring, turn) for ring in RINGS for turn in range(ROUND)]
        costs = [covered(corner, box, occupied, placed, size) + 0.02 * k / ROUND for k, corner in enumerate(tries)]
        placed.append((tries[int(np.argmin(costs))], box))
    return np.array([corner for corner, _ in placed]).reshape(-1, 2)


def corner_at(anchor: Array, box: Array, ring: float, turn: int) -> Array:
    """Return the corner of a label at a distance from its anchor in one of the directions.

    The first direction is below.
    """
    angle = 2.0 * np.pi * turn / ROUND - 0.5 * np.pi
    way = np.array([np.cos(angle), np.sin(angle)])
    return np.asarray(anchor + ring * box[1] * way + 0.5 * box * way - 0.5 * box)


def covered(
    corner: Array, box: Array, occupied: Array, placed: Sequence[tuple[Array, Array]], size: tuple[int, int]
) -> float:
    """Return the cost of the area that a label covers.

    It is one per point, ten per label, and 1000 outside the picture.
    """
    low, high = corner - CLEAR, corner + box + CLEAR
    points = float(np.all((occupied >= low) & (occupied <= high), axis=1).sum()) if len(occupied) else 0.0
    others = sum(bool(np.all((low < there + wide) & (high > there))) for there, wide in placed)
    outside = bool(np.any(low < 0.0) or np.any(high > size))
    return points + 10.0 * others + 1000.0 * outside
