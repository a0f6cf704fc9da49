"""The path of a thread that moves with the holes of an organ.

The organ comes to rest before the thread is laid. A wound gapes under prestretch, and an organ sags
under its weight. A thread that is then passed through its holes has the length of its path at this
time and is not stretched.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from studies.arrays import Array
from studies.scenario import Scenario
from studies.scenario.thread import FreeEnd, PulledEnd
from thread.path import RoundedPath

PARTS = 8  # per piece of a path, for the integration of its length
STILL = 1e-9  # of the path's length: smaller motions of holes are neglected
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
        return np.array([np.interp(at, self.at, component) for component in self.moves.T]).T

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
        at = np.interp(length, *self._lengths[::-1])
        return np.asarray(self.path.position(at) + self.move(at.ravel()).reshape(*at.shape, 3))


def laid_path(scenario: Scenario, path: RoundedPath, at: Array, moves: Array) -> LaidPath:
    """Return the path of a thread whose holes have moved.

    The holes at abscissae `at` (p,) of the path [m] have moved by `moves` (p, 3) [m]. Tails follow,
    held ends stay.
    """
    if np.abs(moves).max(initial=0.0) <= STILL * path.length:
        return LaidPath(path, np.zeros(1), np.zeros((1, 3)))
    places, where = np.unique(at, return_index=True)
    held = [not isinstance(end, FreeEnd | PulledEnd) for end in scenario.thread.ends]
    start, end = (np.zeros((int(is_held), 3)) for is_held in held)
    places = np.concatenate([[0.0] * len(start), places, [path.length] * len(end)])
    return LaidPath(path, places, np.concatenate([start, moves[where], end]))
