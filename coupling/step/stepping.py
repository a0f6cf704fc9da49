"""Implicit steps with the constraints at their end, and what a step that fails does: halve itself.

A step that did not converge is never accepted.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Generic

import numpy as np

from coupling.arrays import Array, Flags
from coupling.errors import InversionError, LentError, StepError, UphillError
from coupling.integrators import BDF2, BackwardEuler, Scheme
from coupling.interfaces import Answer, Body
from coupling.joins.contact import first_sets
from coupling.joins.strands import touching_organ
from coupling.kernels.constraints import Passage, passage
from coupling.step.configuration import Configuration, configuration_of
from coupling.step.diagnosis import diagnose, refuse_crossing, refuse_drawn_out, refuse_held_end
from coupling.step.motion import what_it_does
from coupling.step.newton import Iterate, Problem, Residual, Solution
from coupling.step.sliding import law_of
from coupling.step.solver import find, solve
from coupling.step.stability import go_aside
from coupling.step.tension import stretches_at
from coupling.system import State, System, forgetful, solved_curve
from coupling.ties import gap_left
from thread.placed import Placed
from thread.riding import carried, put_on
from thread.thread import Thread
from thread.vectors import cross, dot
from tissue.errors import OrganError

HALVINGS = 8  # a step is given up below dt / 2^8
RUN_OUT = 4  # halvings until a hole that the thread is about to run out of is let go before a step
CURVED = 4  # halvings that a step may take because it makes energy on a curved way
REFINED = 6  # halvings for accuracy: a jump of velocity is an error of first order in any step
MOST_TRIES = 256  # of steps and parts of steps until one is given up: as many as the smallest parts

GROWTH = 2.0  # largest ratio of a step to the one before; zero-stability ends at 1 + √2


@dataclass(frozen=True)
class Step(Generic[Body]):
    """One accepted step from `old` to `new` over `dt` [s], its solution, and the thread's configuration at its end;
    whether the tissue `snapped` to an equilibrium that was not near, and whether a load step was found `along` its
    branch (`coupling.rest.branch`); where the thread would have been `beyond` the holes that it left in it, one state
    for each time that the step was taken again."""

    old: State[Body]
    new: State[Body]
    dt: float
    solution: Solution[Body]
    end: Configuration
    snapped: bool = False
    along: bool = False
    beyond: tuple[State[Body], ...] = ()


def end_load(system: System[Body], time: float, share: float = 1.0) -> Array:
    """Return the weight and pulling forces on the control points at `time` [s], or in statics at a `share` of the load
    steps, which end at `time`, shape `(n, c)` [N]."""
    load = share * system.weight
    load[0, :3] += system.ends[0].force(time, share)
    load[-1, :3] += system.ends[1].force(time, share)
    return load


def prescribed_values(system: System[Body], time: float) -> list[tuple[int, slice, Array | float]]:
    """Return the control points that are held, which of their values, and these at `time`: P(start) = q_0 and
    P(end) = q_(n−1) [m], with twist angles [rad]."""
    out: list[tuple[int, slice, Array | float]] = []
    for point, end in zip((0, -1), system.ends, strict=True):
        place, angle = end.position(time), end.angle(time) if system.thread.twist else None
        out += [] if place is None else [(point, slice(3), place)]
        out += [] if angle is None else [(point, slice(3, 4), angle)]
    return out


def with_ends(q: Array, system: System[Body], time: float) -> Array:
    """Return the control values with the prescribed ends in place and turned."""
    q = q.copy()
    for point, held, values in prescribed_values(system, time):
        q[point, held] = values
    return q


def past_states(scheme: Scheme, state: State[Body]) -> tuple[State[Body], ...]:
    """Return the states that a scheme looks back at, the newest first."""
    states = (state,) if state.before is None else (state, state.before)
    return states[: len(scheme.weights)]


def thread_motion(scheme: Scheme, state: State[Body]) -> tuple[Array, ...]:
    """Return q, v of the thread at the start of the step, and of the one before where the scheme looks back."""
    return tuple(x for past in past_states(scheme, state) for x in (past.q, past.v))


def sliding_motion(scheme: Scheme, state: State[Body]) -> tuple[Array, ...]:
    """Return s, ds/dt of the holds, likewise."""
    return tuple(x for past in past_states(scheme, state) for x in (past.s, past.s_dot))


def organ_answer(system: System[Body], scheme: Scheme, state: State[Body]) -> Answer[Body]:
    """Return the organ's answer to the step of a scheme from a state. Raises `StepError` where it has none."""
    return ask_organ(system, scheme, past_states(scheme, state), state.time + scheme.dt)


def ask_organ(
    system: System[Body], scheme: Scheme, past: Sequence[State[Body]], time: float, share: float = 1.0
) -> Answer[Body]:
    """Return the organ's answer from the states `past`, the newest first, under a `share` of the loads at `time` [s].
    Raises `StepError` where it has none."""
    try:
        now, *before = past
        bodies = [touching_organ(system, now, now if scheme.a else past[-1]), *(each.organ for each in before)]
        return system.organ.answer(scheme, bodies, time, share)
    except OrganError as error:
        raise StepError(past[0].time, scheme.dt, str(error)) from error


def dynamic_problem(
    system: System[Body],
    state: State[Body],
    dt: float,
    answer: Answer[Body],
    scheme: Scheme | None = None,
) -> Problem[Body]:
    """Return the step of a scheme, backward Euler unless another is given, from `state` with the organ's `answer`."""
    scheme, system = scheme or BackwardEuler(dt), system.over(state, dt)
    thread, time = system.thread, state.time + dt
    if thread.travels:
        return travelling_problem(system, state, dt, answer, scheme)
    factor, motion = scheme.a + scheme.d * thread.damping, thread_motion(scheme, state)
    q_ref = (
        scheme.a * scheme.inertia_reference(*motion)
        + scheme.d * thread.damping * scheme.damping_reference(*motion[::2])
    ) / factor
    return problem_of(system, state, dt, answer, scheme, q_ref, end_load(system, time))


def travelling_problem(
    system: System[Body], state: State[Body], dt: float, answer: Answer[Body], scheme: Scheme
) -> Problem[Body]:
    """Return the step of a scheme, as `dynamic_problem` does, of a thread whose knots travel: its inertia is from where
    the earlier curves are at the material points."""
    damping, curves = scheme.d * system.thread.damping, [solved_curve(past) for past in past_states(scheme, state)]
    factor = scheme.a + damping
    fields = tuple(
        (curve.spline, w * (curve.q + scheme.a / (factor * scheme.d) * curve.v)[:, :3])
        for w, curve in zip(scheme.weights, curves, strict=True)
    )
    load = end_load(system, state.time + dt) - system.weight
    q_ref = put_on(system.thread, list(fields))
    return replace(problem_of(system, state, dt, answer, scheme, q_ref, load), fields=fields)


def problem_of(
    system: System[Body],
    state: State[Body],
    dt: float,
    answer: Answer[Body],
    scheme: Scheme,
    q_ref: Array,
    load: Array,
) -> Problem[Body]:
    """Return the step of a scheme whose inertia is from `q_ref` (n, c) under a `load` (n, c) [N]."""
    time, motion_s = state.time + dt, sliding_motion(scheme, state)
    s_free = np.where(system.of_ties, scheme.damping_reference(*motion_s[::2]), scheme.inertia_reference(*motion_s))
    rows = system.rows & state.present[:, None]
    return Problem(
        system=system,
        time=time,
        dt=dt,
        mass_factor=scheme.a + scheme.d * system.thread.damping,
        q_ref=q_ref,
        load=load,
        answer=answer,
        rows=rows,
        law=law_of(
            system,
            state.s,
            state.present,
            system.epsilon * scheme.a + scheme.d * system.yielding * system.drawn_ties(state.time),
            s_free,
            system.drawn_lengths(state.time, time),
            system.pulling_forces(time),
            state.time,
            stretches_at(system.at(state), state.s, state.N, state.present),
        ),
        frame=state.frame,
        gaps=tie_gaps(system, state, time),
        start=state if system.bears else None,
    )


def tie_gaps(system: System[Body], state: State[Body], time: float) -> Array:
    """Return the gaps at `time` [s] between the strands of the ties that are in force in a state, shape `(t, 3)`
    [m]."""
    one, other = system.strands.T
    gaps = gap_left(system.ties, state.y[one, :3] - state.y[other, :3], state.time, time)
    return gaps[state.present[one]]


def predict(problem: Problem[Body], state: State[Body]) -> Iterate:
    """Predict the first iterate: the thread goes on as it went, knots that travel with their holes, under the forces
    that it had, and the sites are where these forces held them. (From the sites of an organ without forces a step at
    rest in holes that turned far does not come back to its own answer.)"""
    q, spline = state.q + problem.dt * state.v, problem.system.thread.spline
    if isinstance(spline, Placed):
        q = q + carried(spline, problem.ride, state.q, state.s_dot, problem.dt)
    return replace(
        where_it_is(problem, state),
        q=with_ends(q, problem.system, problem.time),
        s=state.s + problem.dt * state.s_dot,
    )


def where_it_is(problem: Problem[Body], state: State[Body]) -> Iterate:
    """Return the iterate in which the thread stays where it is, but for its prescribed ends and the strands that they
    take along."""
    q = state.q + taken_along(problem.system, state, with_ends(state.q, problem.system, problem.time) - state.q)
    pressed, rubbing = first_sets(problem.contact, problem.system, state)
    return Iterate(q, state.N, state.s, state.lam, state.y, state.sigma, pressed=pressed, rubbing=rubbing)


def taken_along(system: System[Body], state: State[Body], moves: Array) -> Array:
    """Return how control points move that prescribed ends, which make the `moves` (n, c), take along: the less, the
    nearer they are to the next hole or the other end of their piece. A strand is then strained by a part of what its
    last span would be."""
    spline, out = system.thread.spline, np.zeros_like(moves)
    stops = np.concatenate([state.s[state.present], spline.piece_ends])
    for point, end, stop in (
        (0, spline.start, stops[stops > spline.start].min()),
        (-1, spline.end, stops[stops < spline.end].max()),
    ):
        out += np.clip((spline.greville - stop) / (end - stop), 0.0, 1.0)[:, None] * moves[point]
    return out


def try_step(system: System[Body], state: State[Body], dt: float, scheme: Scheme | None = None) -> Step[Body]:
    """Try one step of `dt` [s] by `scheme`, backward Euler unless another is given. Raises `StepError`,
    `InversionError`; the state is not touched."""
    scheme = scheme or BackwardEuler(dt)
    problem = dynamic_problem(system, state, dt, organ_answer(system, scheme, state), scheme)
    solution = find(problem, predict(problem, state), where_it_is(problem, state))
    return conclude(state, scheme, go_aside(solution))


def conclude(state: State[Body], scheme: Scheme, solution: Solution[Body]) -> Step[Body]:
    """Return the step from `state` that a solution of its problem makes. Raises `InversionError`."""
    problem, z, residual = solution.problem, solution.iterate, solution.residual
    system, thread = problem.system, residual.configuration.thread
    new: State[Body] = State(
        time=problem.time,
        q=z.q,
        v=scheme.d * (z.q - earlier_places(thread, scheme, state)),
        N=z.N,
        organ=accept_organ(solution),
        s=z.s,
        s_dot=abscissa_rates(scheme, state, z),
        lam=np.where(problem.rows, z.lam, 0.0),
        y=z.y,
        sigma=z.sigma,
        present=state.present,
        sense=state.sense,
        reaction=reactions(problem, residual.thread),
        frame=system.thread.transport_frame(state.frame, z.q),
        stretch=problem.law.stretch,
        **riding(residual),
    )
    new = with_sense(system, state, new, residual.passage)
    return Step(state, new, problem.dt, solution, end_configuration(new, solution))


def earlier_places(thread: Thread, scheme: Scheme, state: State[Body]) -> Array:
    """Return Σ w_k x_k of a scheme, shape `(n, c)` [m]; where knots travel, of the curves at the material points, put
    on the knots of the `thread` by its mass, which keeps momentum and moment of momentum."""
    if not thread.travels:
        return scheme.damping_reference(*thread_motion(scheme, state)[::2])
    curves = [solved_curve(past) for past in past_states(scheme, state)]
    return put_on(thread, [(curve.spline, w * curve.q) for w, curve in zip(scheme.weights, curves, strict=True)])


def riding(residual: Residual) -> dict[str, Any]:
    """Return what a state has besides: what the thread remembered in the step and, where knots travel, its spline and
    −∂Π/∂s."""
    thread = residual.configuration.thread
    known: dict[str, Any] = {"memory": thread.memory}
    return known | {"spline": thread.spline, "drive": residual.passage.drive} if thread.travels else known


def accept_organ(solution: Solution[Body]) -> Body:
    """Return the organ's state at the end of a solved step."""
    sites = len(solution.problem.system.piercings)
    return solution.problem.answer.accept(solution.residual.f_y[:sites].ravel(), solution.p)


def end_configuration(new: State[Body], solution: Solution[Body]) -> Configuration:
    """Return the thread's configuration at the end of a solved step: the one Newton ended with, but that the twist is
    measured from the frame carried to the end."""
    if new.frame is None or new.spline is not None:
        return solution.residual.configuration
    return configuration_of(solution.problem.system, new)


def abscissa_rates(scheme: Scheme, state: State[Body], z: Iterate) -> Array:
    """Return ds/dt of every hold at the end of the step, `(m,)` [m/s]: none where the thread sticks."""
    rate = scheme.d * (z.s - scheme.damping_reference(*sliding_motion(scheme, state)[::2]))
    return np.where(z.sigma == 0.0, 0.0, rate)


def reactions(problem: Problem[Body], residual: Array) -> Array:
    """Return the force of the holders on the thread's ends, `(2, c)` [N], with twist their torque too [N m]: the
    reaction where an end is held, else its load without the weight."""
    system, load = problem.system, problem.load
    weight = np.zeros_like(load) if system.thread.travels else problem.weights * system.weight
    out = np.array([load[k] - weight[k] for k in (0, -1)])
    for point, held, _ in prescribed_values(system, 0.0):
        out[point, held] = residual[point, held]
    return out


def with_sense(system: System[Body], old: State[Body], new: State[Body], at: Passage) -> State[Body]:
    """Return the new state with the sense in which the thread passes its holes. Raises `InversionError` where the
    tangent reversed in a directed hole.

    T·(u × v) may change its sign although the thread does not jump: a linear organ under a couple shrinks its frame by
    the cosine of the turn, to nothing at 90° and through itself beyond.
    """
    now = np.where(new.present, sense(at, new.y), new.sense)
    turned = (old.sense * now < 0.0) & system.rows[:, 3] & new.present
    if turned.any():
        flipped = turned & (dot(at.T, passage(system.at(old).thread.spline, old.q, old.s).T) < 0.0)
        if flipped.any():
            names = [p.name for p in system.piercings] + ["clamped end"] * len(system.clamps)
            raise InversionError(old.time, names[int(np.argmax(flipped))])
    return replace(new, sense=now)


def sense(at: Passage, y: Array) -> Array:
    """Return the sign of T·(u × v) of every hold, shape `(m,)`: +1 where the thread leaves along the frame's normal."""
    return np.sign(dot(at.T, cross(y[:, 3:6], y[:, 6:])))


def emptied_holds(system: System[Body], old: State[Body], new: State[Body]) -> Flags:
    """Return the holes that the thread has left, shape `(m,)`: present, with an abscissa beyond an end of the piece
    of thread that was in them, or as near to it as `System.width`; of a tie both strands."""
    spline, near = system.thread.spline, system.width
    piece, way = spline.piece_of(old.s), new.s - old.s
    low, high = spline.piece_ends[piece] + near, spline.piece_ends[piece + 1] - near
    out = ((new.s < low) & (way < 0.0)) | ((new.s > high) & (way > 0.0))
    gone = np.asarray(out & new.present & system.may_slide)
    gone[system.strands] = gone[system.strands].any(axis=1, keepdims=True)
    return gone


def further_on(state: State[Body], dt: float) -> State[Body]:
    """Return a state whose holes have gone on for `dt` [s] at the rate they have."""
    return replace(state, time=state.time + dt, s=state.s + dt * state.s_dot)


def release(state: State[Body], gone: Flags) -> State[Body]:
    """Release the holes `gone`; what the thread did in them is no guide to what it does next."""
    lam = np.where(gone[:, None], 0.0, state.lam)
    s_dot, sigma = (np.where(gone, 0.0, x) for x in (state.s_dot, state.sigma))
    return replace(forgetful(state), present=state.present & ~gone, lam=lam, s_dot=s_dot, sigma=sigma)


Take = Callable[[System[Body], State[Body], float], Step[Body]]
Watcher = Callable[[System[Body], Step[Body]], None]


def accept(system: System[Body], step: Step[Body]) -> None:
    """Accept any step."""


def advance(
    system: System[Body],
    state: State[Body],
    dt: float,
    take: Take[Body] = try_step,
    depth: int = 0,
    watch: Watcher[Body] = accept,
    tolerance: float = np.inf,
) -> list[Step[Body]]:
    """Go `dt` [s] further, in one step or, where it fails, in halves of it down to dt/2⁸. Parts of a step that fails
    are of backward Euler without memory: it is no smooth motion, and an organ with inertia then has one operator for
    each length of a part. One whose `local_error` exceeds the `tolerance` [m] is halved too, down to dt/2⁶, by the
    integrator that it has; the parts behind it are as long again as the motion allows.

    `take` makes one step and is the monolithic implicit one unless another is named; `watch` sees each before it is
    accepted, in their order, and raises `StepError` where it is not to be; one that makes energy is halved, down to
    dt/2⁴, by the integrator that it has, and one of BDF2 that still does, or gives back what a shock took, is taken
    again by backward Euler. A step at whose end the thread has left a hole is taken again without that hole, one in
    which it flipped through a hole in halves: it may have jumped where the motion would have gone. Raises `StepError`
    when the smallest step fails too or MOST_TRIES did not reach the end, `ConstraintError` where the constraints are at
    fault or a hand has drawn the thread out, `InversionError` where it flips in the smallest step.
    """
    taken: list[Step[Body]] = []
    pending, end, tries, beyond = [(dt, depth, True)], state.time + dt, 0, list[State[Body]]()
    while pending:
        part, level, remembers = pending.pop()
        forgetful_halves = [(0.5 * part, level + 1, False)] * 2
        tries += 1
        if tries > MOST_TRIES:
            raise diagnose(system, state, given_up(system, state, end - state.time))
        try:
            step = take(system, state if remembers else forgetful(state), part)
            gone = refuse_impossible(system, step)
            if gone.any():
                state, beyond = release(state, gone), [*beyond, step.new]
                pending.append((part, level, remembers))
                continue
            if tolerance < np.inf and level < depth + REFINED and local_error(step) > tolerance:
                pending += [(0.5 * part, level + 1, remembers)] * 2
                continue
            watch(system, step)
        except LentError:
            state = forgetful(state)
            pending.append((part, level, remembers))
            continue
        except (StepError, InversionError) as error:
            if system.thread.travels and level >= min(depth + RUN_OUT, HALVINGS):
                ahead = further_on(state, part)
                gone = left_by(system, state, ahead)
                if gone.any():
                    state, beyond = release(state, gone), [*beyond, ahead]
                    pending.append((part, level, remembers))
                    continue
            if isinstance(error, UphillError) and level < min(depth + CURVED, HALVINGS):
                pending += [(0.5 * part, level + 1, remembers)] * 2
                continue
            if isinstance(error, UphillError) and remembers and state.before is not None:
                state = forgetful(state)
                pending.append((part, level, remembers))
                continue
            if level >= HALVINGS:
                if isinstance(error, StepError):
                    raise diagnose(system, state, error) from error
                raise
            pending += forgetful_halves
            continue
        taken.append(replace(step, beyond=tuple(beyond)))
        beyond = []
        state = step.new if remembers else forgetful(step.new)
    return taken if state is taken[-1].new else [*taken[:-1], replace(taken[-1], new=state)]


def local_error(step: Step[Body]) -> float:
    """Return what a step adds to the error of the motion by itself: the largest of a control point that is not held,
    and of an abscissa in its hole [m] (`coupling.integrators.Scheme.local_error`)."""
    old, new, system = step.old, step.new, step.solution.problem.system
    scheme: Scheme = BackwardEuler(step.dt) if new.before is None else scheme_of(old, step.dt)
    past = past_states(scheme, old)
    thread, rates = step.solution.residual.configuration.thread, [each.v for each in (new, *past)]
    if thread.travels:  # the rates of the same material points, on the knots of the end
        rates[1:] = [put_on(thread, [(curve.spline, curve.v)]) for curve in map(solved_curve, past)]
    of_points = scheme.local_error(*(v[:, :3] for v in rates))
    of_holes = scheme.local_error(*(each.s_dot for each in (new, *past)))
    moving = np.abs(of_points[~system.held_flags[:, :3]])
    return float(max(moving.max(initial=0.0), np.abs(of_holes[new.present]).max(initial=0.0)))


def given_up(system: System[Body], state: State[Body], left: float) -> StepError:
    """Return the error of a step that went on for MOST_TRIES, with `left` [s] of it to go."""
    doing, piercing = what_it_does(system, state)
    cause = (
        f"{MOST_TRIES} parts of a step were tried and {left:.3g} s of it are left; {doing}; let the loads grow more "
        "slowly (ramp), take up the slack in the path, or take a smaller solve.dt"
    )
    return StepError(state.time, left, cause, piercing)


def refuse_impossible(system: System[Body], step: Step[Body]) -> Flags:
    """Refuse a step in which holes cross or a held end leaves one; returns the holes that it has left, shape `(m,)`."""
    gone = left_by(system, step.old, step.new)
    refuse_crossing(system, step.old, step.new)
    return gone


def left_by(system: System[Body], old: State[Body], new: State[Body]) -> Flags:
    """Return the holes that the thread has left, as `emptied_holds`. Raises `ConstraintError` where a hand has drawn it
    out, `StepError` where a held end cannot leave."""
    refuse_drawn_out(system, old, new)
    gone = emptied_holds(system, old, new)
    refuse_held_end(system, old, new, gone)
    return gone


def scheme_of(state: State[Body], dt: float) -> Scheme:
    """Return BDF2 where there is a step to look back at, else backward Euler."""
    if state.dt_before is None or dt > GROWTH * state.dt_before:
        return BackwardEuler(dt)
    return BDF2(dt, state.dt_before)


def bdf2_step(system: System[Body], state: State[Body], dt: float) -> Step[Body]:
    """Make one step of `dt` [s] by BDF2 where it can. Raises `StepError`, `InversionError`; the state is not
    touched.

    Where Newton's method does not come from the motion so far to that of BDF2, the thread snaps: a jump, and a step
    of backward Euler without memory, and so is the next.
    """
    scheme = scheme_of(state, dt)
    if isinstance(scheme, BackwardEuler):
        return remembering(try_step(system, state, dt), state, dt)
    problem = dynamic_problem(system, state, dt, organ_answer(system, scheme, state), scheme)
    try:
        solution = go_aside(solve(problem, predict(problem, state)))
        return remembering(conclude(state, scheme, solution), state, dt)
    except (StepError, InversionError):
        return try_step(system, forgetful(state), dt)


def remembering(step: Step[Body], old: State[Body], dt: float) -> Step[Body]:
    """Return the step with a new state that remembers the one from `old` that led to it."""
    return replace(step, new=replace(step.new, before=forgetful(old), dt_before=dt))
