"""What the thread is at one place: its curve, its passage through the holes, and its elastic forces."""

from dataclasses import dataclass

from coupling.arrays import Array
from coupling.interfaces import Body
from coupling.kernels.constraints import Passage
from coupling.system import State, System
from thread.frames import Frame
from thread.kernels.travel import Ridden
from thread.thread import Points, Thread


@dataclass(frozen=True)
class Configuration:
    """The thread evaluated once: `points` of the curve, `at` the holes, and the `elastic` forces ∂E/∂q, shape `(n, c)`
    [N, with twist N m]. `thread`, with its knots where they are there."""

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

    `frame` is what the twist is measured from, `home` (m,) [m] names the pieces of a cut thread that hold `s`,
    `drive` (m,) [N] is −∂Π/∂s where knots travel, `ridden` that and more.
    """
    thread = system.thread.placed(s)
    points = thread.points(q, frame)
    return Configuration(points, system.passage(q, s, home, drive, ridden), thread.gradient(points), thread)


def configuration_of(system: System[Body], state: State[Body]) -> Configuration:
    """Evaluate the thread of a state."""
    return evaluate_thread(system, state.q, state.s, state.frame, drive=state.drive)
