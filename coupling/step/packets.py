"""Packets of knots that fit the thread (`thread.packets`): made anew where it bends over another length at its holes.

Between steps, and at rest between the ties of a thread that goes a long way: in a solve the knots χ stay, and a hole
takes its packet with it. New packets cost no transfer. The thread's inertia is from the curves as they were solved,
each on its own knots, and its shape is solved for anew.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from coupling.arrays import Array, Flags
from coupling.interfaces import Body
from coupling.step.diagnosis import holds_in_force
from coupling.step.tension import lengths_bent_over
from coupling.system import State, System, solved_curve
from thread.packets import Hold, Travel, travelling
from thread.placed import Placed

Exchange = tuple[System[Body], State[Body]]


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
    """Return system and state on packets that fit, the same ones where they do."""
    system = system.at(state)
    if fits(system, state):
        return system, state
    return put_on_knots(system, state, due(system, state, bent_over(system, state)))


def put_on_knots(system: System[Body], state: State[Body], travel: Travel) -> Exchange[Body]:
    """Return system and state on other knots: the shape is put on them before it is solved for there."""
    old, new = system.thread.spline, Placed(travel.knots, travel.places(state.s), travel)
    other = system.on(new)
    q, v = (new.through(old.curve(x, new.greville, new.home)[:, 0]) for x in (state.q, state.v))
    thread, known = other.thread, system.thread.axial
    N = old.interpolate(thread.axial.s, thread.axial.home, known.s, known.home, state.N)
    return other, replace(state, q=q, v=v, N=N, spline=new, solved=solved_curve(state))


def put_alike(system: System[Body], state: State[Body], other: State[Body]) -> State[Body]:
    """Return a state on the knots that another one has, the same one where it is on them."""
    if state.spline is other.spline or not isinstance(other.spline, Placed):
        return state
    system, travel = system.at(state), other.spline.travel
    return state if travel is travel_of(system) else put_on_knots(system, state, travel)[1]


def with_holes(system: System[Body], state: State[Body], present: Flags) -> Exchange[Body]:
    """Return system and state with knots for the holds `present` (m,), the same ones where knots stand still."""
    if not system.thread.travels:
        return system, state
    system, there = system.at(state), replace(state, present=present)
    return put_on_knots(system, state, due(system, there, bent_over(system, state)))
