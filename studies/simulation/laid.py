"""The path of a thread through its holes and over surfaces, which moves with the holes of an organ.

The path rounds its corners and passes near its holes. It is moved so that it passes through them.

The organ comes to rest before the thread is laid. A wound gapes under prestretch, and an organ sags
under its weight. A thread that is then passed through its holes has the length of its path at this
time and is not stretched.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from studies.arrays import Array
from studies.scenario import FreeEnd, PulledEnd, Scenario
from thread.path import RoundedPath
from tissue.organs.skin import Skin

PARTS = 8  # per piece of a path, for the integration of its length
STILL = 1e-9  # of the path's length: smaller motions of holes, and smaller distances to them, are neglected
CORNER = 0.5  # of half an arc: a hole is at the corner if the path is nearest to it in this part of the arc
LOOKS = 4  # points of a path per diameter of the thread that are tested for lying below a surface
DIP = 0.15  # of a dip's length: greatest depth of a chord of an arc of 70°; a deeper dip is a bite without its holes
GAUSS = 0.5 + 0.5 * np.array([-1.0, 1.0]) / np.sqrt(3.0)


@dataclass(frozen=True)
class LaidPath:
    """A `path` with moved points.

    The points at the rising abscissae `at` (k,) [m] move by `moves` (k, 3) [m]. Points in between
    move linearly, points beyond like the nearest.
    """

    path: RoundedPath
    at: Array
    moves: Array

    def move(self, at: Array) -> Array:
        """Return the displacement of points of the path, shape `(m, 3)` [m].

        The points are at abscissae `at` (m,) [m].
        """
        return along(at, self.at, self.moves)

    def position(self, at: ArrayLike) -> Array:
        """Return the points of the moved path at abscissae of the path of any shape [m].

        The result has a last axis of 3 [m].
        """
        at = np.asarray(at, dtype=float)
        return np.asarray(self.path.position(at) + self.move(at.ravel()).reshape(*at.shape, 3))

    @cached_property
    def _lengths(self) -> tuple[Array, Array]:
        """Abscissae of the path (n,) [m], and lengths of the moved path up to them (n,) [m]."""
        ends = np.unique([*self.path.starts, *self.at, self.path.length])
        ends = ends[np.diff(ends, prepend=-np.inf) > STILL * self.path.length]
        low, share = ends[:-1, None], np.linspace(0.0, 1.0, PARTS + 1)
        nodes = np.append((low + np.diff(ends)[:, None] * share[:-1]).ravel(), ends[-1])
        steps = np.diff(nodes)[:, None]
        inside = nodes[:-1, None] + steps * GAUSS
        slope = (self.move(nodes[1:]) - self.move(nodes[:-1])) / steps
        rates = np.linalg.norm(self.path.tangent(inside) + slope[:, None], axis=2)
        return nodes, np.append(0.0, np.cumsum(rates.mean(axis=1) * steps[:, 0]))

    @property
    def length(self) -> float:
        """Length of the moved path [m]."""
        return float(self._lengths[1][-1])

    def length_to(self, at: Array) -> Array:
        """Return the length of the moved path up to abscissae of the path [m]."""
        return np.interp(at, *self._lengths)

    def points(self, length: Array) -> Array:
        """Return the points of the moved path at lengths of any shape [m].

        The result has a last axis of 3 [m].
        """
        return self.position(np.interp(length, *self._lengths[::-1]))


def through_holes(path: RoundedPath, at: Array, ways: Array) -> LaidPath:
    """Return a path through holes that are at abscissae `at` (p,) and `ways` (p, 3) from it [m].

    A corner is moved to the hole nearest to it: along its arc the thread then follows the two
    straight lines of the corner. The way to another hole is linear between the holes and the ends.
    """
    if np.abs(ways).max(initial=0.0) <= STILL * path.length:
        return LaidPath(path, np.zeros(1), np.zeros((1, 3)))
    piece = np.clip(np.searchsorted(path.starts, at, side="right") - 1, 0, len(path.starts) - 1)
    low, high = path.starts[piece], path.starts[piece] + path.lengths[piece]
    middle, half = 0.5 * (low + high), 0.5 * (high - low)
    off = np.where(path.curvatures[piece] > 0.0, np.abs(at - middle) / half, np.inf)
    share = np.linspace(0.0, 1.0, PARTS + 1)
    bumps = []
    for k in np.flatnonzero(off < CORNER):
        if off[k] == off[piece == piece[k]].min():
            places = np.append(low[k] + share * (at[k] - low[k]), high[k] - share[-2::-1] * (high[k] - at[k]))
            bumps.append((places, np.append(share, share[-2::-1])[:, None] ** 2 * ways[k]))
    rest = ways - sum(along(at, *bump) for bump in bumps)
    return sum_of(path, [with_zeros(np.array([0.0, path.length]), at, rest), *bumps])


def over_surface(through: LaidPath, at: Array, diameter: float, skin: Skin) -> LaidPath:
    """Return a path whose chords are lifted onto the reference surface `skin` where they dip below it.

    The thread with a `diameter` [m] then lies on the surface. Holes are at abscissae `at` (p,) of
    the path [m]. A dip with a hole is a bite, and one that leaves by another face passes through
    the organ.
    """
    places = np.linspace(0.0, through.path.length, int(LOOKS * through.path.length / diameter) + 2)
    still, labels = np.zeros_like(skin.body.points), np.zeros((len(places), 0))
    facing = skin.faced(still, through.position(places), labels)
    d, depth = facing[:, 4:7], np.maximum(0.5 * diameter - facing[:, 7], 0.0)
    ends = np.flatnonzero(np.diff(np.r_[0.0, depth > 0.0, 0.0])).reshape(-1, 2)
    for first, stop in ends:
        low, high = max(first - 1, 0), min(stop, len(places) - 1)
        pierced = ((at >= places[low]) & (at <= places[high])).any() or low == first or high < stop
        through_organ = (np.vecdot(d[first : stop - 1], d[first + 1 : stop]) <= 0.0).any()
        if pierced or through_organ or depth[first:stop].max() > DIP * (places[high] - places[low]):
            depth[first:stop] = 0.0
    if not depth.any():
        return through
    lift = -depth[:, None] * d / np.vecdot(d, d)[:, None]
    return sum_of(through.path, [(through.at, through.moves), (places, lift)])


def moved_with(scenario: Scenario, through: LaidPath, at: Array, moves: Array) -> LaidPath:
    """Return the path of a thread whose holes at abscissae `at` (p,) of the path [m] have moved by
    `moves` (p, 3) [m].

    Points between two holes move linearly. Tails follow, held ends stay.
    """
    path = through.path
    if np.abs(moves).max(initial=0.0) <= STILL * path.length:
        return through
    ends = np.array([0.0, path.length])
    held = ends[[not isinstance(end, FreeEnd | PulledEnd) for end in scenario.thread.ends]]
    return sum_of(path, [(through.at, through.moves), with_zeros(held, at, moves)])


def with_zeros(stays: Array, at: Array, moves: Array) -> tuple[Array, Array]:
    """Return rising abscissae and their displacements: zero at those that stay, unless a hole is there."""
    places, where = np.unique(np.concatenate([at, stays]), return_index=True)
    return places, np.concatenate([moves, np.zeros((len(stays), 3))])[where]


def sum_of(path: RoundedPath, parts: Sequence[tuple[Array, Array]]) -> LaidPath:
    """Return a path moved by the sum of displacements, each given at rising abscissae."""
    nodes = np.unique(np.concatenate([places for places, _ in parts]))
    return LaidPath(path, nodes, np.sum([along(nodes, *part) for part in parts], axis=0))


def along(at: Array, places: Array, moves: Array) -> Array:
    """Return displacements (m, 3) [m] at abscissae (m,) [m], linear between the rising `places`."""
    return np.array([np.interp(at, places, component) for component in moves.T]).T
