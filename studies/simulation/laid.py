"""The path of a thread in an organ that comes to rest before the thread is there: it moves with the holes.

A wound gapes under prestretch, and an organ sags under its weight. A thread that is then led through its holes is as
long as its path there, and not stretched.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from studies.arrays import Array
from studies.scenario import Scenario
from studies.scenario.thread import FreeEnd, PulledEnd
from thread.path import RoundedPath

PARTS = 8  # of each piece of a path, over which its length is integrated
STILL = 1e-9  # of the path's length: holes that move by less stay where they are
GAUSS = 0.5 + 0.5 * np.array([-1.0, 1.0]) / np.sqrt(3.0)


@dataclass(frozen=True)
class LaidPath:
    """A `path` whose points at the abscissae `at` (k,) [m], rising, are moved by `moves` (k, 3) [m], those in between
    linearly, and those beyond as the nearest."""

    path: RoundedPath
    at: Array
    moves: Array

    def move(self, at: Array) -> Array:
        """Return by how much the points at abscissae of the path (m,) [m] are moved, `(m, 3)` [m]."""
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
        """Return the points of the moved path after lengths of any shape [m], with a last axis of 3 [m]."""
        at = np.interp(length, *self._lengths[::-1])
        return np.asarray(self.path.position(at) + self.move(at.ravel()).reshape(*at.shape, 3))


def laid_path(scenario: Scenario, path: RoundedPath, at: Array, moves: Array) -> LaidPath:
    """Return the path of a thread whose holes at abscissae `at` (p,) of the path [m] have moved by `moves` (p, 3) [m]:
    tails follow, ends that are held stay."""
    if np.abs(moves).max(initial=0.0) <= STILL * path.length:
        return LaidPath(path, np.zeros(1), np.zeros((1, 3)))
    first, last = (isinstance(end, FreeEnd | PulledEnd) for end in (scenario.thread.start, scenario.thread.end))
    places, where = np.unique(at, return_index=True)
    moved = moves[where]
    ends = [np.zeros((0 if free else 1, 3)) for free in (first, last)]
    places = np.concatenate([[0.0] * len(ends[0]), places, [path.length] * len(ends[1])])
    return LaidPath(path, places, np.concatenate([ends[0], moved, ends[1]]))
