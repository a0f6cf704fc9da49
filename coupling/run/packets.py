"""Packets of knots that fit the thread (`thread.packets`): made anew where it bends over another length at its holes.

Between steps alone: in a step the knots χ stay, and a hole takes its packet with it. New packets cost no transfer. The
thread's inertia is from the curves as they were solved, each on its own knots, and its shape is solved for anew.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from coupling.arrays import Array
from coupling.interfaces import Body
from coupling.reports.audit import initial_energies
from coupling.run.events import Event
from coupling.step.diagnosis import holds_in_force
from coupling.step.tension import lengths_bent_over
from coupling.system import State, System, solved_curve
from thread.packets import Hold, Travel, travelling
from thread.placed import Placed

FIRST = 0.5  # of √(EI/T): the span next to a hole
COARSE, FINE = 1.3, 0.4  # times that: a packet that begins with a longer or a shorter span is made anew
GROWN = 1.5  # ratio by which a strand may grow or shrink on the same spans


@dataclass(frozen=True)
class Packets:
    """How fine: spans no `longest` [m] away from holes, and next to them FIRST √(EI/T) times the `scale`."""

    longest: float
    scale: float = 1.0

    def first(self, layers: Array) -> Array:
        """Return the spans next to holes that bend over `layers` (m,) [m]."""
        return np.minimum(FIRST * self.scale * layers, self.longest)

    def fit(self, system: System[Body], state: State[Body]) -> bool:
        """Whether the packets of a state are as long as its tension asks for, and its strands about as long as they
        were."""
        spline = system.thread.spline
        assert isinstance(spline, Placed)
        here = np.flatnonzero(holds_in_force(system, state))
        if set(here.tolist()) != set(spline.travel.holds.tolist()):
            return False
        wanted, has = self.first(bent_over(system, state)), spline.travel.first
        lengths, made = spline.travel.strands(state.s), spline.travel.lengths
        alike = (has[here] <= COARSE * wanted[here]) & (has[here] >= FINE * wanted[here])
        return bool(alike.all() and (lengths < GROWN * made).all() and (lengths * GROWN > made).all())

    def due(self, system: System[Body], state: State[Body]) -> Travel:
        """Return the knots that fit a state."""
        here, first = np.flatnonzero(holds_in_force(system, state)), self.first(bent_over(system, state))
        directed, spline = system.rows[:, 3], system.thread.spline
        holds = [Hold(int(k), float(state.s[k]), bool(directed[k]), float(first[k])) for k in here]
        clamped = [float(first[k]) for k in here if k >= len(system.piercings)]
        ends: list[float | None] = [None, None]
        for side, value in zip(system.clamps, clamped, strict=False):
            ends[side] = value
        return travelling(spline.end, holds, system.holds, self.longest, (ends[0], ends[1]))


def bent_over(system: System[Body], state: State[Body]) -> Array:
    """Return √(EI/T) of every hold, shape `(m,)` [m]."""
    return lengths_bent_over(system, state.s, state.N, state.lam, state.present)


def fitted(
    packets: Packets, system: System[Body], state: State[Body]
) -> tuple[System[Body], State[Body], Sequence[Event]]:
    """Return system and state on packets that fit, the same ones where they do, and the event of it."""
    system = system.at(state)
    if packets.fit(system, state):
        return system, state, []
    return put_on_knots(system, state, packets.due(system, state))


def put_on_knots(
    system: System[Body], state: State[Body], travel: Travel
) -> tuple[System[Body], State[Body], Sequence[Event]]:
    """Return system and state on other knots, and the event that says what that changes of the energy."""
    old, new = system.thread.spline, Placed(travel.knots, travel.places(state.s), travel)
    other = system.on(new)
    q, v = (new.through(old.curve(x, new.greville)[:, 0]) for x in (state.q, state.v))
    thread, known = other.thread, system.thread.axial
    N = old.interpolate(thread.axial.s, thread.axial.home, known.s, known.home, state.N)
    moved = replace(state, q=q, v=v, N=N, spline=new, solved=solved_curve(state))
    energies = [initial_energies(*pair) for pair in ((system, state), (other, moved))]
    stored = [e.kinetic + e.elastic_thread for e in energies]
    return other, moved, [Event(state.time, "knots", loss=stored[0] - stored[1], control_points=new.n)]


def fitted_for(
    packets: Packets, system: System[Body], state: State[Body], later: System[Body], end: State[Body]
) -> tuple[System[Body], State[Body], Sequence[Event]]:
    """Return system and state on packets that fit an `end` state, the same ones where those of the `later` system that
    it was found on do, and the event of it."""
    if packets.fit(later.at(end), end):
        return system, state, []
    return put_on_knots(system.at(state), state, packets.due(later.at(end), replace(end, s=state.s)))
