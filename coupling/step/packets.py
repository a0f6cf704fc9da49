"""Packets of knots that fit the thread (`thread.packets`), made anew if the bending length at its
holes changes.

They are made between steps, and at rest on the way of a thread that moves far. In a solve the knots
χ do not change, and a hole takes its packet with it. New packets need no transfer: the inertia of
the thread is computed from the curves as they were solved, each on its own knots, and the shape is
solved again.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from coupling.arrays import Array, Flags
from coupling.errors import InversionError, StepError
from coupling.interfaces import Body
from coupling.kernels.steps.riding import Fit, knots_fit
from coupling.step.configuration import onto_constraints
from coupling.step.diagnosis import holds_in_force
from coupling.step.stepping import Step, Take
from coupling.step.tension import REST, lengths_bent_over, pull_at
from coupling.system import State, System, solved_curve
from thread import packets
from thread.packets import Bends, Hold, Travel, bends_of, travelling
from thread.placed import Placed
from thread.riding import plain
from thread.thread import Thread

Exchange = tuple[System[Body], State[Body]]


def travel_of(system: System[Body]) -> Travel:
    """Return the travel of the knots of a system's thread."""
    assert isinstance(system.thread.spline, Placed)
    return system.thread.spline.travel


def fits(system: System[Body], state: State[Body]) -> bool:
    """Return whether the knots of a state fit its holes, its tension and its bends."""
    if not know_holes(system, state):
        return False
    T = pull_at(system, state.s, state.N, state.present)
    given = plain(state.q[:, :3]), T, plain(state.s), np.ascontiguousarray(state.present)
    return bool(knots_fit(fit_of(system.thread), *given))


def know_holes(system: System[Body], state: State[Body]) -> bool:
    """Return whether the knots of a state are made for its present holes."""
    here = np.flatnonzero(holds_in_force(system, state))
    return not system.thread.travels or np.array_equal(here, np.sort(travel_of(system).holds))


def fit_of(thread: Thread) -> Fit:
    """Return the conditions under which the knots of a thread fit; empty if knots do not travel."""
    spline, least, of_bending = thread.spline, REST * float(thread.EA), float(thread.EI)
    if not isinstance(spline, Placed):
        none, no_ends, no_points = np.zeros(0), np.zeros((0, 2)), np.zeros(0, dtype=np.int64)
        never = (0.0,) * 7
        return Fit(none, none, none, no_points[:, None], no_ends, no_points, none > 0.0, *never, of_bending, 0.0, least)
    travel = spline.travel
    of_spans, turn = travel.strand_of_spans(), packets.TURN * travel.scale
    return Fit(
        first=plain(travel.first),
        rigid=plain(travel.rigid[of_spans]),
        made=plain(travel.middle[of_spans]),
        between=travel.between.astype(np.int64),
        limits=plain(travel.limits),
        strand=travel.strand.astype(np.int64),
        bent=travel.bent,
        part=packets.FIRST * travel.scale,
        longest=float(travel.longest),
        coarse=packets.COARSE,
        fine=packets.FINE,
        grown=packets.GROWN,
        turned=packets.TURNED * turn,
        flat=packets.FLAT * turn,
        EI=of_bending,
        length=float(spline.end),
        least=least,
    )


def bends_of_curve(system: System[Body], q: Array, solved: bool = True) -> Bends:
    """Return the bends of a thread at `q` (n, c) [m] between its packets, from the turns of its
    control polygon.

    There are none if its shape is not `solved` yet, because its oscillations would require more and
    more knots.
    """
    spline, travel = system.thread.spline, travel_of(system)
    legs, at = np.diff(q[:, :3], axis=0), spline.greville
    turn = np.arctan2(np.linalg.norm(np.cross(legs[:-1], legs[1:]), axis=1), np.vecdot(legs[:-1], legs[1:]))
    turn *= solved & (travel.strand[1:-1] >= 0)
    return bends_of(at[1:-1], turn / (0.5 * (at[2:] - at[:-2])), travel.scale)


def bent_over(system: System[Body], state: State[Body]) -> Array:
    """Return √(EI/T) of every hold, shape `(m,)` [m]."""
    return lengths_bent_over(system, state.s, state.N, state.present)


def due(
    system: System[Body], state: State[Body], layers: Array, cuts: Sequence[float] = (), solved: bool = True
) -> Travel:
    """Return the knots for the holes of a state, with bending lengths `layers` (m,) [m] and
    additional `cuts` [m].

    `solved` is as for `bends_of_curve`.
    """
    travel, here = travel_of(system), np.flatnonzero(holds_in_force(system, state))
    first, directed = travel.wanted(layers), system.rows[:, 3]
    holds = [Hold(int(k), float(state.s[k]), bool(directed[k]), float(first[k])) for k in here]
    ends: list[float | None] = [None, None]
    for hold in holds:
        if hold.directed and not 0.0 < hold.s < system.thread.spline.end:
            ends[0 if hold.s <= 0.0 else 1] = hold.first
    of_ends = ends[0], ends[1]
    spline, total = system.thread.spline, system.holds
    every, bends = sorted([*spline.cuts.tolist(), *cuts]), bends_of_curve(system, state.q, solved)
    return travelling(spline.end, holds, total, travel.longest, of_ends, travel.scale, every, bends)


def fitted(system: System[Body], state: State[Body], solved: bool = True) -> Exchange[Body]:
    """Return system and state on packets that fit; the same objects if they fit or if knots do not travel.

    `solved` is as for `bends_of_curve`.
    """
    system = system.at(state)
    if not system.thread.travels or fits(system, state):
        return system, state
    return put_on_knots(system, state, due(system, state, bent_over(system, state), solved=solved))


def fitting(take: Take[Body]) -> Take[Body]:
    """Return a way to make a step that is repeated on knots that fit its start if it fails.

    The step is from the original state, so that the change of its energy by other knots is booked
    as the integrator's.
    """

    def take_on_knots(system: System[Body], state: State[Body], dt: float) -> Step[Body]:
        try:
            return take(system, state, dt)
        except (StepError, InversionError):
            other, moved = fitted(system, state)
            if moved is state:
                raise
        return replace(take(other, moved, dt), old=state)

    return take_on_knots


def put_on_knots(system: System[Body], state: State[Body], travel: Travel) -> Exchange[Body]:
    """Return system and state on other knots: the shape is put on them before it is solved there."""
    old, new = system.thread.spline, Placed(travel.knots, travel.places(state.s), travel)
    other = system.on(new)
    q, v = (new.through(old.curve(x, new.greville, new.home)[:, 0]) for x in (state.q, state.v))
    thread, known = other.thread, system.thread.axial
    N = old.interpolate(thread.axial.s, thread.axial.home, known.s, known.home, state.N)
    # It passes neither a hole that begins nor one that it has left.
    passed = np.isin(np.arange(system.holds), np.intersect1d(travel_of(system).holds, travel.holds))
    q, _ = onto_constraints(other, other.rows & passed[:, None], q, state.s, state.y)
    return other, replace(state, q=q, v=v, N=N, spline=new, solved=solved_curve(state))


def points_at_start(system: System[Body], old: State[Body], new: State[Body]) -> Array:
    """Return the control values of an `old` state on the knots χ of a `new` one, shape `(n, c)`.

    The holes have their old abscissae. In a strand that has grown much, the abscissae of the
    control points need not rise.
    """
    if not isinstance(old.spline, Placed) or not isinstance(new.spline, Placed):
        return old.q
    if new.spline.travel.is_like(old.spline.travel):
        return old.q
    chi, before = new.spline.chi, system.at(old).thread.spline
    S = chi.curve(new.spline.travel.places(old.s)[:, None], chi.greville, chi.home)[:, 0, 0]
    place = np.clip(S, before.start, before.end)
    return new.spline.through(before.curve(old.q, place, new.spline.home)[:, 0])


def with_holes(system: System[Body], state: State[Body], present: Flags) -> Exchange[Body]:
    """Return system and state with knots for the holds `present` (m,); the same objects if knots do not travel."""
    if not system.thread.travels:
        return system, state
    system, there = system.at(state), replace(state, present=present)
    return put_on_knots(system, state, due(system, there, bent_over(system, state)))
