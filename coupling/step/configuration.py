"""The evaluated thread: its curve, its passage through the holes, and its elastic forces."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from coupling.arrays import Array, Flags
from coupling.interfaces import Body
from coupling.kernels.constraints import LOCAL, Passage, phi
from coupling.system import State, System
from thread.frames import Frame
from thread.kernels.travel import Ridden
from thread.thread import Points, Thread

PUT = 3  # times that control points are put on the constraints, at most
GAP_TOLERANCE = 1e-11  # of the thread's diameter


@dataclass(frozen=True)
class Configuration:
    """The thread evaluated once.

    `points` of the curve, the passage `at` the holes, the `elastic` forces ∂E/∂q, shape `(n, c)`
    [N, with twist N m], and the `thread` with its knots at their present abscissae.
    """

    points: Points
    at: Passage
    elastic: Array
    thread: Thread


def evaluate_thread(
    system: System[Body],
    q: Array,
    s: Array,
    frame: Frame | None = None,
    home: Array | None = None,
    drive: Array | None = None,
    ridden: Ridden | None = None,
) -> Configuration:
    """Evaluate the thread with control values `q` (n, c) at the abscissae `s` (m,) [m].

    `frame` is the reference of the twist. `home` (m,) [m] are abscissae on the pieces of a cut
    thread that contain `s`. If knots travel, `drive` (m,) [N] is −∂Π/∂s, and `ridden` contains it
    with the other derivatives.
    """
    thread = system.thread.placed(s)
    points = thread.points(q, frame)
    return Configuration(points, system.passage(q, s, home, drive, ridden), thread.gradient(points), thread)


def configuration_of(system: System[Body], state: State[Body]) -> Configuration:
    """Evaluate the thread of a state."""
    return evaluate_thread(system, state.q, state.s, state.frame, drive=state.drive)


class LocalRows(NamedTuple):
    """Φ_q of each hold over its four local control points, and its pseudo-inverse.

    `rows` (m, 5, 12) are zero for a constraint that is not in force, and at control points that are
    held; `inverse` (m, 12, 5).
    """

    rows: Array
    inverse: Array

    def put_back(self, at: Passage, off: Array, like: Array) -> Array:
        """Return the shortest move of control points, of the shape of `like` (n, c) [m], that changes Φ by `off`
        (m, 5).
        """
        out = np.zeros_like(like)
        np.add.at(out[:, :3], at.first[:, None] + LOCAL, np.matvec(self.inverse, off).reshape(-1, 4, 3))
        return out


def local_rows(system: System[Body], rows: Flags, at: Passage, y: Array) -> LocalRows:
    """Return Φ_q of each hold, with those of the constraints that are among the `rows` (m, 5) in force."""
    by_curve = np.zeros((len(y), 5, 2, 3))  # derivatives by P and T
    by_curve[:, :3, 0] = np.eye(3)
    by_curve[:, 3:, 1] = y[:, 3:].reshape(-1, 2, 3)
    free = ~system.held_flags[at.first[:, None] + LOCAL, :3]
    local = np.einsum("mcox,moi->mcix", by_curve, at.b[:, :2]) * free[:, None] * rows[:, :, None, None]
    local = local.reshape(-1, 5, 12)
    return LocalRows(local, np.linalg.pinv(local, rcond=1e-12))


def onto_constraints(
    system: System[Body], rows: Flags, q: Array, s: Array, y: Array, home: Array | None = None, times: int = PUT
) -> tuple[Array, LocalRows]:
    """Return control values `q` (n, c) moved the shortest way onto the constraints among the `rows`
    (m, 5) in force, and Φ_q.

    The abscissae `s` (m,) [m] and the sites `y` (m, 9) stay. Holds near one another share control
    points, so that the values are moved several `times`. They are the same object if they are on
    the constraints.
    """
    at = system.passage(q, s, home)
    local, tolerance = local_rows(system, rows, at, y), GAP_TOLERANCE * system.thread.section.diameter
    for _ in range(times):
        off = phi(at, np.zeros(rows.shape), y) * rows
        if np.abs(off).max(initial=0.0) <= tolerance:
            break
        q = q - local.put_back(at, off, q)
        at = system.passage(q, s, home)
    return q, local
