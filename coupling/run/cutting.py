"""A thread that is cut during a run: at its place the spline gets a knot of multiplicity four, and nothing goes across.

Curve, angle of the section and velocity are the same functions on the other knots (`thread.refit.cut`), so that
momentum and energy stay what they are; the tension that was there drives the new ends apart in the steps that follow,
which remember nothing of those before. At rest they find another equilibrium at once (`coupling.run.run.Run.load`).
Where the cut falls into a span that holds a hole, the compliance that the spline lacks there changes, and what that
stored with it: this loss is in the event. So is what springs store more or less, which are spread anew on both
pieces. Knots that follow do so on either piece from then on (`coupling.run.adaptivity.Resolution.tree_of`).
"""

from dataclasses import dataclass, replace

from coupling.errors import CouplingError
from coupling.interfaces import Body
from coupling.run.adaptivity import exchange_spline
from coupling.run.events import Event
from coupling.system import State, System, forgetful
from thread.errors import ThreadError
from thread.refit import Refit, cut


@dataclass(frozen=True)
class Cut:
    """A cut at the abscissa `s` [m], at the first end of a step not before `time` [s]."""

    s: float
    time: float


def cut_thread(system: System[Body], state: State[Body], s: float) -> tuple[System[Body], State[Body], Event]:
    """Cut the thread at `s` [m], or at a knot next to it; returns system and state with the event.

    Raises `CouplingError` where the thread cannot be cut there.
    """
    thread, state = system.thread, forgetful(state)
    try:
        spline, place, fields = cut(thread.spline, s, [state.q, state.v])
    except ThreadError as error:
        raise CouplingError(str(error)) from None
    other, moved, (event,) = exchange_spline(system, state, Refit(spline, fields))
    return other, moved, replace(event, kind="cut", s=place)
