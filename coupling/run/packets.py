"""Packets of knots that fit the thread (`thread.packets`): made anew where it bends over another length at its holes.

Between steps alone: in a step the knots χ stay, and a hole takes its packet with it. New packets cost no transfer. The
thread's inertia is from the curves as they were solved, each on its own knots, and its shape is solved for anew.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from coupling.arrays import Array, Flags
from coupling.interfaces import Body
from coupling.reports.audit import initial_energies
from coupling.step.diagnosis import holds_in_force
from coupling.step.tension import lengths_bent_over
from coupling.system import State, System, solved_curve
from thread.packets import Hold, Travel, travelling
from thread.placed import Placed

Exchange = tuple[System[Body], State[Body], float]


def travel_of(system: System[Body]) -> Travel:
    """Return how the knots of a system's thread travel."""
    assert isinstance(system.thread.spline, Placed)
    return system.thread.spline.travel


def fits(system: System[Body], state: State[Body]) -> bool:
    """Whether the packets of a state are those of its holes, and as long as its tension asks for."""
    here = np.flatnonzero(holds_in_force(system, state))
    return travel_of(system).fits(here, bent_over(system, state), state.s)


def bent_over(system: System[Body], state: State[Body]) -> Array:
    """Return √(EI/T) of every hold, shape `(m,)` [m]."""
    return lengths_bent_over(system, state.s, state.N, state.lam, state.present)


def due(system: System[Body], state: State[Body], layers: Array, cuts: Sequence[float] = ()) -> Travel:
    """Return the knots for the holes of a state at which the thread bends over `layers` (m,) [m], with further `cuts`
    [m]."""
    travel, here = travel_of(system), np.flatnonzero(holds_in_force(system, state))
    first, directed = travel.wanted(layers), system.rows[:, 3]
    holds = [Hold(int(k), float(state.s[k]), bool(directed[k]), float(first[k])) for k in here]
    ends: list[float | None] = [None, None]
    for hold in holds:
        if hold.directed and not 0.0 < hold.s < system.thread.spline.end:
            ends[0 if hold.s <= 0.0 else 1] = hold.first
    of_ends = ends[0], ends[1]
    spline, total = system.thread.spline, system.holds
    every = sorted([*spline.cuts.tolist(), *cuts])
    return travelling(spline.end, holds, total, travel.longest, of_ends, travel.scale, every)


def fitted(system: System[Body], state: State[Body]) -> Exchange[Body]:
    """Return system and state on packets that fit, the same ones where they do, and the energy lost by that [J]."""
    system = system.at(state)
    if fits(system, state):
        return system, state, 0.0
    return put_on_knots(system, state, due(system, state, bent_over(system, state)))


def fitted_for(system: System[Body], state: State[Body], later: System[Body], end: State[Body]) -> Exchange[Body]:
    """Return system and state on packets that fit an `end` state, the same ones where those of the `later` system that
    it was found on do, and the energy that is lost by it [J]."""
    later, system = later.at(end), system.at(state)
    if fits(later, end):
        return system, state, 0.0
    travel = due(system, state, bent_over(later, end))
    if travel.is_like(travel_of(system)):  # it fits as well as knots that are made at the start can
        return system, state, 0.0
    return put_on_knots(system, state, travel)


def put_on_knots(system: System[Body], state: State[Body], travel: Travel) -> Exchange[Body]:
    """Return system and state on other knots, and the energy that is lost by it [J]: the shape is put on them before it
    is solved for there."""
    old, new = system.thread.spline, Placed(travel.knots, travel.places(state.s), travel)
    other = system.on(new)
    q, v = (new.through(old.curve(x, new.greville, new.home)[:, 0]) for x in (state.q, state.v))
    thread, known = other.thread, system.thread.axial
    N = old.interpolate(thread.axial.s, thread.axial.home, known.s, known.home, state.N)
    moved = replace(state, q=q, v=v, N=N, spline=new, solved=solved_curve(state))
    energies = [initial_energies(*pair) for pair in ((system, state), (other, moved))]
    stored = [e.kinetic + e.elastic_thread for e in energies]
    return other, moved, stored[0] - stored[1]


def with_holes(system: System[Body], state: State[Body], present: Flags) -> tuple[System[Body], State[Body]]:
    """Return system and state with knots for the holds `present` (m,), the same ones where knots stand still."""
    if not system.thread.travels:
        return system, state
    system, there = system.at(state), replace(state, present=present)
    other, moved, _ = put_on_knots(system, state, due(system, there, bent_over(system, state)))
    return other, moved
