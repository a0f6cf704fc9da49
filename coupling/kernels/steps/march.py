"""Whole steps, one after another, as long as nothing unusual happens (`coupling.step.stepping`,
`coupling.run.run`).

Each step is predicted, solved, concluded, checked and audited. A step that does not converge, or
that is more than the next step of a smooth motion, is not made. The arrays then have the values of
its start, and the returned numbers give the reason.

A step with an event that changes no constraint is made if it is the first, and it is then the last.
In such an event a hold slips or sticks, a strand becomes taut or slack, or tissue tears. Python
finds the time of the event from the states on both sides.
"""

from typing import Any, NamedTuple

import numpy as np

from coupling.arrays import Array, Flags, Indices
from coupling.kernels.address import by_address
from coupling.kernels.friction import Law
from coupling.kernels.holes import AT_U, AT_V, FIRST
from coupling.kernels.iteration import (
    Bounds,
    Found,
    Given,
    Knots,
    Passing,
    Unknowns,
    copy_into,
    rounded_force,
    solve,
)
from coupling.kernels.steps.audit import (
    ELASTIC,
    Holes,
    Met,
    Motion,
    Works,
    audit_march,
    book,
    pass_holds,
)
from coupling.kernels.steps.organ import Going, Organ, Pace, audit_organ, bear, go_free
from coupling.kernels.steps.riding import (
    Fit,
    audit_ride,
    fits,
    pass_knots,
    place_along,
    place_field,
    put_curve,
    put_rates,
)
from coupling.kernels.steps.tautness import Strands, is_switched
from coupling.kernels.steps.tension import Along, is_pressed, put_stretch, put_tensions
from coupling.kernels.steps.watch import Shares, goes_uphill
from thread.kernels.curve import Curve, elastic_energy
from thread.kernels.loops import loop, outermost, sources
from thread.kernels.records import record
from thread.kernels.travel import Ridden, carry_points
from thread.kernels.vectors import cross, dot, norm, vector

# Reasons why no further step is made.
MADE, NOT_SOLVED, SQUEEZED, LEFT, CROSSED, TURNED, EVENT, UPHILL, TOO_NARROW = range(9)
HAPPENED, REFIT = 9, 10  # a step with an event was made and is the last; the packets no longer fit
ENERGIES = 9  # entries of `coupling.reports.audit.Energies` that change in steps
solve_at = by_address(solve)


@record
class Ends(NamedTuple):
    """Positions and loads of the two ends in each step, (steps, 2, 3) each.

    The `places` [m] and `forces` [N] are those at the end of the step. `more` [N] is the excess of
    the forces at its start.
    """

    places: Array
    forces: Array
    more: Array


@record
class Scene(NamedTuple):
    """The constant data of all steps.

    - `weight` (n, 3) [N]: weight of the thread.
    - `along`: abscissae of the thread.
    - `present` (m,): present holds; `here` (m,): those with an active point constraint.
    - `strength` (p,) [N]: largest force that the tissue bears at each piercing.
    - `damping` [1/s], `epsilon` [kg].
    - `by_place` [N/m]: largest stiffness of a control point against displacement.
    - `borne`: the pressure that the thread bears [N] over EA.
    - `shares`: shares of energies that a step may create.
    - `strands`: the strands between the holds.
    - `fit`: conditions under which the packets of travelling knots fit.
    """

    weight: Array
    along: Along
    present: Flags
    here: Flags
    strength: Array
    damping: float
    epsilon: float
    by_place: float
    borne: float
    shares: Shares
    strands: Strands
    fit: Fit


@record
class Scratch(NamedTuple):
    """Arrays for one step.

    - `z`, `end`: the unknowns and the state at the end, with shared arrays.
    - `found`: the residual.
    - `was`, `T` (m, 2): the holds and the tensions there at the start.
    - `at` (n, 3): reference q_a of the inertia.
    - `going`: the motion of modes without site forces.
    - `turns` (9,), `body` (7,) [J]: energy turnover of thread and organ.
    - `after` (9,): the energies after the step.
    - `part`: room for ∂Π/∂s of parts of the potential Π in the audit, if knots travel.
    """

    z: Unknowns
    end: Motion
    found: Found
    was: Passing
    at: Array
    T: Array
    going: Going
    turns: Array
    body: Array
    after: Array
    part: Ridden


@record
class Plan(NamedTuple):
    """The data that steps share as long as the same holds are present.

    The references and loads in these arrays are those of the present step. `solver` is the address
    of `coupling.kernels.iteration.solve` for arrays like these.
    """

    curve: Curve
    knots: Knots
    law: Law
    given: Given
    bounds: Bounds
    scene: Scene
    pace: Pace
    room: Scratch
    solver: int


@record
class Kept(NamedTuple):
    """The stored results of steps, (steps, …) each.

    - `ends`: the numbers of the states at their ends, `Motion.numbers`.
    - `elastic` (n, 3) [N], `strain` [-], `at`: the elastic forces on the thread there, its largest
      axial strain, and its passage through the holes.
    - `energies` (10,).
    """

    ends: Array
    elastic: Array
    strain: Array
    at: Passing
    energies: Array


@loop
def put_references(pace: Pace, scene: Scene, law: Law, given: Given, now: Motion, earlier: Motion, at: Array) -> float:
    """Write the references of the inertia, the damping and the law of sliding of a step.

    Returns the largest place in the reference of the inertia [m].
    """
    factor, largest = given.mass_factor, 0.0
    for i in range(len(now.q)):
        for x in range(3):
            place = pace.now * now.q[i, x] + pace.before * earlier.q[i, x]
            at[i, x] = place + (pace.now * now.v[i, x] + pace.before * earlier.v[i, x]) / pace.d
            given.q_ref[i, x] = (pace.a * at[i, x] + pace.d * scene.damping * place) / factor
            largest = max(largest, abs(given.q_ref[i, x]))
    for k in range(len(now.s)):
        place = pace.now * now.s[k] + pace.before * earlier.s[k]
        law.s_old[k] = law.s_held[k] = now.s[k]
        law.s_free[k] = place + (pace.now * now.s_dot[k] + pace.before * earlier.s_dot[k]) / pace.d
    if given.ride.on:
        by_v = pace.a / (factor * pace.d)
        for field, weight, past in ((given.fields[0], pace.now, now), (given.fields[1], pace.before, earlier)):
            place_field(field, given.ride, past.s)
            put_curve(field, weight, past.q, weight * by_v, past.v)
    return largest


@loop
def put_load(scene: Scene, given: Given, ends: Ends, step: int) -> None:
    """Write the weight and the pulls at the end of a step."""
    last = len(given.load) - 1
    for i in range(len(given.load)):
        for x in range(3):
            given.load[i, x] = 0.0 if given.ride.on else scene.weight[i, x]
    for x in range(3):
        given.load[0, x] += ends.forces[step, 0, x]
        given.load[last, x] += ends.forces[step, 1, x]


@loop
def predict(pace: Pace, given: Given, ends: Ends, step: int, now: Motion, z: Unknowns) -> None:
    """Write the first iterate: the thread continues with its velocity, and the forces are unchanged."""
    n = len(z.q)
    for i in range(n):
        for x in range(3):
            z.q[i, x] = now.q[i, x] + pace.dt * now.v[i, x]
    if given.ride.on:
        carry_points(given.ride, given.fields[0].S, now.q, now.s_dot, pace.dt, z.q)
    for end in range(2):
        for x in range(3):
            if given.held[end * (n - 1), x]:
                z.q[end * (n - 1), x] = ends.places[step, end, x]
    for e in range(len(z.N)):
        for g in range(z.N.shape[1]):
            z.N[e, g] = now.N[e, g]
    for k in range(len(z.s)):
        z.s[k], z.sigma[k] = now.s[k] + pace.dt * now.s_dot[k], now.sigma[k]
        for j in range(5):
            z.lam[k, j] = now.lam[k, j]
        for j in range(9):
            z.y[k, j] = now.y[k, j]


@loop
def conclude(pace: Pace, scene: Scene, given: Given, r: Found, now: Motion, earlier: Motion, new: Motion) -> None:
    """Write the results that follow from the solved unknowns of a step.

    They are the rates, the active forces, the reactions, and the sense in which the thread passes
    its holes.
    """
    n = len(new.q)
    if given.ride.on:
        put_curve(given.fields[0], pace.now, now.q, 0.0, now.v)
        put_curve(given.fields[1], pace.before, earlier.q, 0.0, earlier.v)
        put_rates(given.ride, given.fields, pace.d, r, new.q, new.v)
    else:
        for i in range(n):
            for x in range(3):
                new.v[i, x] = pace.d * (new.q[i, x] - (pace.now * now.q[i, x] + pace.before * earlier.q[i, x]))
    for k in range(len(new.s)):
        new.drive[k] = r.passing.drive[k] = -r.ridden.by_s[k]
        new.s_dot[k] = pace.d * (new.s[k] - (pace.now * now.s[k] + pace.before * earlier.s[k]))
        if new.sigma[k] == 0.0:
            new.s_dot[k] = 0.0
        for j in range(5):
            if not given.rows[k, j]:
                new.lam[k, j] = 0.0
        for j in range(9):
            new.f_y[k, j] = r.f_y[k, j]
        new.sense[k] = now.sense[k]
        if scene.present[k]:
            normal = cross(vector(new.y[k], AT_U), vector(new.y[k], AT_V))
            new.sense[k] = np.sign(dot(vector(r.passing.D[k, 1], FIRST), normal))
    for end in range(2):
        i = end * (n - 1)
        for x in range(3):
            held = given.held[i, x]
            weight = 0.0 if given.ride.on else scene.weight[i, x]
            new.reaction[end, x] = r.balance[i, x] if held else given.load[i, x] - weight


@loop
def what_happened(scene: Scene, law: Law, given: Given, strain: Array, now: Motion, new: Motion) -> int:
    """Return what is unusual in a solved step; MADE if nothing is."""
    if is_pressed(scene.along, strain, scene.borne, new.s, scene.here):
        return SQUEEZED
    event = is_switched(scene.strands, scene.along, new.s, new.N, new.v, scene.present)
    for k in range(len(new.s)):
        if scene.present[k]:
            if law.may_slide[k] and not given.piece[k, 0] <= new.s[k] <= given.piece[k, 1]:
                return LEFT
            if given.directed[k] and now.sense[k] * new.sense[k] < 0.0:
                return TURNED
            event |= law.rough[k] and now.sigma[k] != new.sigma[k]
    happened = at_piercings(scene, now, new)
    return EVENT if event and happened == MADE else happened


@loop
def at_piercings(scene: Scene, now: Motion, new: Motion) -> int:
    """Return CROSSED if one piercing passed another, EVENT if the tissue tears at one, else MADE."""
    torn = False
    for k in range(len(scene.strength)):
        for other in range(len(scene.strength)):
            both = scene.present[k] and scene.present[other]
            if both and now.s[k] < now.s[other] and new.s[k] >= new.s[other]:
                return CROSSED
        before, after = norm(vector(now.lam[k], FIRST)), norm(vector(new.lam[k], FIRST))
        torn |= scene.present[k] and before <= scene.strength[k] < after
    return EVENT if torn else MADE


@loop
def copy_all(a: Array, b: Array) -> None:
    """Write the entries of an array of two axes into another."""
    for i in range(a.shape[0]):
        for j in range(a.shape[1]):
            b[i, j] = a[i, j]


@loop
def keep(kept: Kept, step: int, r: Found, end: Motion, energies: Array) -> None:
    """Store the results of a step that is made."""
    copy_into(end.numbers, kept.ends[step])
    copy_all(r.elastic, kept.elastic[step])
    copy_into(energies, kept.energies[step])
    strain, at = r.stretched.strain, r.passing
    kept.strain[step] = strain[0, 0]
    for e in range(len(strain)):
        for g in range(strain.shape[1]):
            kept.strain[step] = max(kept.strain[step], strain[e, g])
    for k in range(len(at.first)):
        kept.at.first[step, k] = at.first[k]
        copy_all(at.b[k], kept.at.b[step, k])
        copy_all(at.D[k], kept.at.D[step, k])
        kept.at.drive[step, k] = end.drive[k]


@loop
def begin_step(plan: Plan, organ: Organ, ends: Ends, step: int, now: Motion, earlier: Motion) -> float:
    """Write the constant data of a step. Returns the largest place [m], for the round-off of its forces."""
    law, given, scene, room = plan.law, plan.given, plan.scene, plan.room
    largest = put_references(plan.pace, scene, law, given, now, earlier, room.at)
    put_load(scene, given, ends, step)
    if not organ.still:
        go_free(plan.pace, organ, given, now, earlier, room.going)
    if given.ride.on:
        place_along(given.ride, given.fields[0].S, given.fields[0], scene.along)
        pass_knots(given.ride, given.fields[0].S, now.q, now.drive, room.was)
        put_tensions(scene.along, now.s, now.N, scene.present, room.T)
        put_stretch(room.T, plan.curve.EA, law.stretch)
    else:
        pass_holds(plan.knots, given, now, room.was)
    return largest


@loop
def audit(plan: Plan, more: Array, now: Motion) -> None:
    """Write the energy turnover of the thread in a solved step; `more` is as for `Works`."""
    curve, law, given, scene, room = plan.curve, plan.law, plan.given, plan.scene, plan.room
    r, rides = room.found, given.ride.on
    works = Works(scene.damping, 0.0 if rides else plan.pace.a, room.at, plan.pace.two_step, more)
    holes = Holes(law.rough, law.by_hand, law.may_slide, law.inertia, law.s_free, scene.epsilon, rides)
    met = Met(room.was, r.passing)
    for i in range(len(room.turns)):
        room.turns[i] = 0.0
    if rides:
        audit_ride(curve, given, works, holes, r, room.part, now, room.end, met, room.turns)
        return
    room.turns[ELASTIC] = elastic_energy(curve, r.stretched)
    audit_march(plan.knots, given, works, holes, r, now, room.end, met, room.turns)


@loop
def end_step(plan: Plan, organ: Organ, ends: Ends, step: int, now: Motion, earlier: Motion, energies: Array) -> int:
    """Check a solved step and audit it. Returns why it is not made, or MADE, or EVENT.

    With EVENT the step is made although something happened.
    """
    pace, given, scene, room = plan.pace, plan.given, plan.scene, plan.room
    copy_into(plan.law.stretch, room.end.stretch)
    if given.ride.on:
        place_along(given.ride, room.found.ridden.S, given.fields[0], scene.along)
    conclude(pace, scene, given, room.found, now, earlier, room.end)
    happened = what_happened(scene, plan.law, given, room.found.stretched.strain, now, room.end)
    if happened != MADE and (happened != EVENT or step > 0):
        return happened
    audit(plan, ends.more[step], now)
    if not organ.still and not bear(pace, organ, now, room.end, room.going):
        return TOO_NARROW
    audit_organ(organ, pace.two_step, given.C, now, room.end, room.body)
    book(room.turns, room.body, energies, room.after)
    rounded = plan.bounds.rounded[0]
    return UPHILL if goes_uphill(scene.shares, rounded, pace.before, energies, room.after) else happened


@loop
def make_step(
    plan: Plan, organ: Organ, ends: Ends, step: int, now: Motion, earlier: Motion, energies: Array
) -> tuple[int, int]:
    """Make a step from `now` to the arrays of the plan. Returns the corrections, and why the step
    is not made, or MADE, or EVENT.
    """
    curve, knots, law, given, bounds, room = plan.curve, plan.knots, plan.law, plan.given, plan.bounds, plan.room
    span = (knots.breaks[-1] - knots.breaks[0]) / (len(knots.breaks) - 1)
    largest = begin_step(plan, organ, ends, step, now, earlier)
    if given.ride.on and not fits(plan.scene.fit, now.q, room.T, now.s, plan.scene.present):
        return 0, REFIT
    bounds.rounded[0] = rounded_force(curve.EA, plan.scene.by_place, span, largest)
    predict(plan.pace, given, ends, step, now, room.z)
    found = solve_at(plan.solver, (curve, knots, law, given, bounds, room.z, room.found))
    if found < 0:
        return found, NOT_SOLVED
    return found, end_step(plan, organ, ends, step, now, earlier, energies)


@loop
def book_step(kept: Kept, step: int, room: Scratch, now: Motion, earlier: Motion, energies: Array) -> None:
    """Store the results of a step that is made; the next one starts at its end."""
    copy_into(room.after, energies)
    keep(kept, step, room.found, room.end, energies)
    copy_into(now.numbers, earlier.numbers)
    copy_into(room.end.numbers, now.numbers)


def march_of(digest: int) -> Any:
    """Return the function that makes steps, cached on disk for the modules of this `digest`."""

    @outermost
    def march(
        plan: Plan, organ: Organ, ends: Ends, now: Motion, earlier: Motion, energies: Array, iterations: Indices,
        kept: Kept,
    ) -> tuple[int, int]:  # fmt: skip
        """Make as many steps as there are `iterations` (steps,). Returns the number of steps made
        and why there are no more.

        Steps change `now`, `earlier` and `energies` (10,), which are those of
        `coupling.reports.audit.Energies` in their order.
        """
        assert digest
        for step in range(len(iterations)):
            found, why = make_step(plan, organ, ends, step, now, earlier, energies)
            if why != MADE and (why != EVENT or step > 0):
                return step, why
            book_step(kept, step, plan.room, now, earlier, energies)
            iterations[step] = found
            if why == EVENT:
                return 1, HAPPENED
        return len(iterations), MADE

    return march


march = march_of(sources(__file__))
