"""Implicit steps with the constraints at their end, and the halving of a failed step.

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
from coupling.joins.strands import Ahead, touching_organ
from coupling.kernels.constraints import Passage, passage
from coupling.step.configuration import Configuration, configuration_of
from coupling.step.diagnosis import diagnose, refuse_crossing, refuse_drawn_out, refuse_held_end
from coupling.step.motion import what_it_does
from coupling.step.newton import Iterate, Problem, Residual, Solution, allowed_share, failure
from coupling.step.sliding import law_of
from coupling.step.solver import find, solve
from coupling.step.stability import go_aside
from coupling.step.tension import stretches_at
from coupling.system import State, System, forgetful, solved_curve
from coupling.ties import gap_left
from thread.kernels.travel import Ride
from thread.placed import Placed
from thread.riding import carried, put_on, ride_of
from thread.spline import Spline
from thread.thread import Thread
from thread.vectors import cross, dot
from tissue.errors import OrganError
from tissue.organs.meshed import TimeScheme

HALVINGS = 8  # a step fails finally at dt / 2^8
RUN_OUT = 4  # halvings after which a hole is released before the step in which the thread would run out of it
CURVED = 4  # halvings of a step that creates energy on a curved way, at most
REFINED = 6  # halvings for accuracy, at most: a jump of velocity is an error of first order in every step
MOST_TRIES = 256  # steps and parts of steps, at most: the number of the smallest parts

GROWTH = 2.0  # largest ratio of a step to the one before; zero-stability ends at 1 + √2


@dataclass(frozen=True)
class Step(Generic[Body]):
    """One accepted step from `old` to `new` over `dt` [s].

    - `solution`, and the thread's configuration at its `end`.
    - `snapped`: whether the tissue snapped to a distant equilibrium.
    - `unstable`: whether no stable equilibrium of the tissue was found.
    - `along`: whether a load step was found along its branch (`coupling.rest.branch`).
    - `beyond`: the states of the thread beyond the holes that it left in the step, one for each
      time that the step was repeated.
    """

    old: State[Body]
    new: State[Body]
    dt: float
    solution: Solution[Body]
    end: Configuration
    snapped: bool = False
    unstable: bool = False
    along: bool = False
    beyond: tuple[State[Body], ...] = ()


def end_load(system: System[Body], time: float, share: float = 1.0) -> Array:
    """Return the weight and the pulling forces on the control points at `time` [s], shape `(n, c)` [N].

    In statics they are those at a `share` of the load steps, which end at `time`.
    """
    load = share * system.weight
    load[0, :3] += system.ends[0].force(time, share)
    load[-1, :3] += system.ends[1].force(time, share)
    return load


def prescribed_values(system: System[Body], time: float) -> list[tuple[int, slice, Array | float]]:
    """Return the held control points, which of their values are held, and these values at `time`.

    P(start) = q_0 and P(end) = q_(n−1) [m], with twist angles [rad].
    """
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
    """Return the earlier states that a scheme uses, newest first."""
    states = (state,) if state.before is None else (state, state.before)
    return states[: len(scheme.weights)]


def thread_motion(scheme: Scheme, state: State[Body]) -> tuple[Array, ...]:
    """Return q, v of the thread at the start of the step, and those of the state before if the scheme uses it."""
    return tuple(x for past in past_states(scheme, state) for x in (past.q, past.v))


def sliding_motion(scheme: Scheme, state: State[Body]) -> tuple[Array, ...]:
    """Return s, ds/dt of the holds at the start of the step, and those of the state before if the
    scheme uses it.
    """
    return tuple(x for past in past_states(scheme, state) for x in (past.s, past.s_dot))


def organ_answer(system: System[Body], scheme: Scheme, state: State[Body]) -> Answer[Body]:
    """Return the organ's answer to the step of a scheme from a state. Raises `StepError` if it has none."""
    return ask_organ(system, scheme, past_states(scheme, state), state.time + scheme.dt)


def ask_organ(
    system: System[Body], scheme: TimeScheme, past: Sequence[State[Body]], time: float, share: float = 1.0
) -> Answer[Body]:
    """Return the organ's answer from the states `past`, newest first, under a `share` of the loads
    at `time` [s].

    Raises `StepError` if the organ has no answer.
    """
    try:
        now, *before = past
        ahead = ahead_of(system, now, scheme.dt) if scheme.a else None
        first = touching_organ(system, now, now if scheme.a else past[-1], not scheme.a, ahead)
        bodies = [first, *(each.organ for each in before)]
        return system.organ.answer(scheme, bodies, time, share)
    except OrganError as error:
        raise StepError(past[0].time, scheme.dt, str(error)) from error


def ahead_of(system: System[Body], state: State[Body], dt: float) -> Ahead[Body] | None:
    """Return the expected end of a step of `dt` [s] from a state; None if the thread bears on nothing."""
    if not system.bears:
        return None
    thread, before = system.at(state).thread, state.before
    q = with_ends(moved_on(thread.spline, ride_of(thread, system.gravity), state, dt), system, state.time + dt)
    if before is None or state.dt_before is None:
        return Ahead(q)
    return Ahead(q, before.organ, dt / state.dt_before)


def moved_on(spline: Spline, how: Ride, state: State[Body], dt: float) -> Array:
    """Return the control values `dt` [s] after a state at its velocity, shape `(n, c)`.

    Travelling knots move with their holes.
    """
    q = state.q + dt * state.v
    return q + carried(spline, how, state.q, state.s_dot, dt) if isinstance(spline, Placed) else q


def dynamic_problem(
    system: System[Body],
    state: State[Body],
    dt: float,
    answer: Answer[Body],
    scheme: Scheme | None = None,
) -> Problem[Body]:
    """Return the problem of a step from `state` with the organ's `answer`; `scheme` None means backward Euler."""
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
    """Return the problem of a step, as `dynamic_problem`, of a thread whose knots travel.

    Its inertia is relative to the earlier curves at the material points.
    """
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
    """Return the problem of a step with the inertia relative to `q_ref` (n, c), under a `load` (n, c) [N]."""
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
    """Return the gaps at `time` [s] between the strands of the ties that are active in a state,
    shape `(t, 3)` [m].
    """
    one, other = system.strands.T
    gaps = gap_left(system.ties, state.y[one, :3] - state.y[other, :3], state.time, time)
    return gaps[state.present[one]]


def predict(problem: Problem[Body], state: State[Body]) -> Iterate:
    """Return the predicted first iterate.

    The thread continues with its velocity, and travelling knots with their holes. The forces are
    unchanged, and the sites are at their places under these forces. (If the sites start at their
    places without forces, a step at rest in holes that turned far does not return to its own
    solution.)
    """
    q = moved_on(problem.system.thread.spline, problem.ride, state, problem.dt)
    return replace(
        where_it_is(problem, state),
        q=with_ends(q, problem.system, problem.time),
        s=state.s + problem.dt * state.s_dot,
    )


def where_it_is(problem: Problem[Body], state: State[Body]) -> Iterate:
    """Return the iterate with the thread at its place, except for its prescribed ends and the
    strands that move with them.
    """
    q = state.q + taken_along(problem.system, state, with_ends(state.q, problem.system, problem.time) - state.q)
    pressed, rubbing = first_sets(problem.contact, problem.system, state)
    return Iterate(q, state.N, state.s, state.lam, state.y, state.sigma, pressed=pressed, rubbing=rubbing)


def taken_along(system: System[Body], state: State[Body], moves: Array) -> Array:
    """Return the moves of control points that follow the `moves` (n, c) of the prescribed ends.

    The moves decrease to zero at the next hole or the other end of the piece. The strain of the
    strand is then much smaller than that of its last span alone would be.
    """
    spline, out = system.thread.spline, np.zeros_like(moves)
    stops = np.concatenate([state.s[state.present], spline.piece_ends])
    for point, end, stop in (
        (0, spline.start, stops[stops > spline.start].min()),
        (-1, spline.end, stops[stops < spline.end].max()),
    ):
        out += np.clip((spline.greville - stop) / (end - stop), 0.0, 1.0)[:, None] * moves[point]
    return out


def try_step(system: System[Body], state: State[Body], dt: float, scheme: Scheme | None = None) -> Step[Body]:
    """Return one step of `dt` [s] by `scheme`; None means backward Euler. Raises `StepError`, `InversionError`."""
    scheme = scheme or BackwardEuler(dt)
    problem = dynamic_problem(system, state, dt, organ_answer(system, scheme, state), scheme)
    far = allowed_share(problem, dt * state.v) < 1.0  # further than a correction may go
    solution = find(problem, predict(problem, state), where_it_is(problem, state), far=far)
    return conclude(state, scheme, go_aside(solution))


def conclude(state: State[Body], scheme: Scheme, solution: Solution[Body]) -> Step[Body]:
    """Return the step from `state` of a solution of its problem. Raises `InversionError`."""
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
        by_hand=problem.law.by_hand,
        **riding(residual),
    )
    new = with_sense(system, state, new, residual.passage)
    return Step(state, new, problem.dt, solution, end_configuration(new, solution))


def earlier_places(thread: Thread, scheme: Scheme, state: State[Body]) -> Array:
    """Return Σ w_k x_k of a scheme, shape `(n, c)` [m].

    If knots travel, it is from the earlier curves at the material points. They are put on the knots
    of the `thread` by its mass, which conserves momentum and moment of momentum.
    """
    if not thread.travels:
        return scheme.damping_reference(*thread_motion(scheme, state)[::2])
    curves = [solved_curve(past) for past in past_states(scheme, state)]
    return put_on(thread, [(curve.spline, w * curve.q) for w, curve in zip(scheme.weights, curves, strict=True)])


def riding(residual: Residual) -> dict[str, Any]:
    """Return the additional fields of a state: the memory of the thread and, if knots travel, its
    spline and −∂Π/∂s.
    """
    thread = residual.configuration.thread
    known: dict[str, Any] = {"memory": thread.memory}
    return known | {"spline": thread.spline, "drive": residual.passage.drive} if thread.travels else known


def accept_organ(solution: Solution[Body]) -> Body:
    """Return the organ's state at the end of a solved step. Raises `StepError`."""
    problem, residual = solution.problem, solution.residual
    try:
        return problem.answer.accept(residual.f_y[: len(problem.system.piercings)].ravel(), solution.p)
    except OrganError as error:
        raise failure(problem, residual.holds, str(error)) from error


def end_configuration(new: State[Body], solution: Solution[Body]) -> Configuration:
    """Return the thread's configuration at the end of a solved step.

    It is that of the solution, but with twist it refers to the frame carried to the end.
    """
    if new.frame is None or new.spline is not None:
        return solution.residual.configuration
    return configuration_of(solution.problem.system, new)


def abscissa_rates(scheme: Scheme, state: State[Body], z: Iterate) -> Array:
    """Return ds/dt of every hold at the end of the step, `(m,)` [m/s]; zero if the thread sticks."""
    rate = scheme.d * (z.s - scheme.damping_reference(*sliding_motion(scheme, state)[::2]))
    return np.where(z.sigma == 0.0, 0.0, rate)


def reactions(problem: Problem[Body], residual: Array) -> Array:
    """Return the force of the holders on the thread's ends, `(2, c)` [N], with twist also their torque [N m].

    It is the reaction if an end is held, otherwise its load without the weight.
    """
    system, load = problem.system, problem.load
    weight = np.zeros_like(load) if system.thread.travels else problem.weights * system.weight
    out = np.array([load[k] - weight[k] for k in (0, -1)])
    for point, held, _ in prescribed_values(system, 0.0):
        out[point, held] = residual[point, held]
    return out


def with_sense(system: System[Body], old: State[Body], new: State[Body], at: Passage) -> State[Body]:
    """Return the new state with the sense in which the thread passes its holes.

    T·(u × v) can change its sign without a jump of the thread. A linear organ under a couple
    shrinks its frame by the cosine of the turn: to zero at 90°, and to a flipped frame beyond.
    Raises `InversionError` if the tangent reversed in a directed hole.
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
    """Return the sign of T·(u × v) of every hold, shape `(m,)`: +1 if the thread leaves along the
    frame's normal.
    """
    return np.sign(dot(at.T, cross(y[:, 3:6], y[:, 6:])))


def emptied_holds(system: System[Body], old: State[Body], new: State[Body]) -> Flags:
    """Return the holes that the thread has left, shape `(m,)`; of a tie both strands.

    They are present, and their abscissa is beyond an end of their piece of the thread, or closer to
    it than `System.width`.
    """
    spline, near = system.thread.spline, system.width
    piece, way = spline.piece_of(old.s), new.s - old.s
    low, high = spline.piece_ends[piece] + near, spline.piece_ends[piece + 1] - near
    out = ((new.s < low) & (way < 0.0)) | ((new.s > high) & (way > 0.0))
    gone = np.asarray(out & new.present & system.may_slide)
    gone[system.strands] = gone[system.strands].any(axis=1, keepdims=True)
    return gone


def release(state: State[Body], gone: Flags) -> State[Body]:
    """Return the state with the holes `gone` released and without memory: their motion does not
    predict the next one.
    """
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
    """Go `dt` [s] further in one step, or in halves of it down to dt/2⁸ if it fails; return the steps.

    - `take` makes one step; the default is the monolithic implicit step.
    - `watch` is called with each step before it is accepted, in their order, and raises `StepError`
      to refuse it.
    - `tolerance` [m]: a step with a larger `local_error` is halved.

    The parts of a failed step are backward Euler without memory: such a motion is not smooth, and
    an organ with inertia then has one operator for each length of a part. Two other kinds of steps
    keep their integrator in their halves: a step with a too large `local_error`, down to dt/2⁶, and
    a step that creates energy, down to dt/2⁴. A step of BDF2 that still creates energy, or returns
    the energy of a shock, is repeated by backward Euler.

    If the thread has left a hole at the end of a step, the step is repeated without this hole. If
    the thread flipped through a hole, the step is halved, because it may have jumped over the real
    motion.

    Raises `StepError` if the smallest step fails too, or if MOST_TRIES did not reach the end.
    Raises `ConstraintError` if the constraints are the cause or a hand has drawn the thread out.
    Raises `InversionError` if the thread flips in the smallest step.
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
                ahead = replace(state, time=state.time + part, s=state.s + part * state.s_dot)
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
    """Return the local error of a step [m]: the largest over free control points and abscissae of
    present holds.

    See `coupling.integrators.Scheme.local_error`.
    """
    old, new, system = step.old, step.new, step.solution.problem.system
    scheme: Scheme = BackwardEuler(step.dt) if new.before is None else scheme_of(old, step.dt)
    past = past_states(scheme, old)
    thread, rates = step.solution.residual.configuration.thread, [each.v for each in (new, *past)]
    if thread.travels:  # rates of the same material points, on the knots of the end
        rates[1:] = [put_on(thread, [(curve.spline, curve.v)]) for curve in map(solved_curve, past)]
    of_points = scheme.local_error(*(v[:, :3] for v in rates))
    of_holes = scheme.local_error(*(each.s_dot for each in (new, *past)))
    moving = np.abs(of_points[~system.held_flags[:, :3]])
    return float(max(moving.max(initial=0.0), np.abs(of_holes[new.present]).max(initial=0.0)))


def given_up(system: System[Body], state: State[Body], left: float) -> StepError:
    """Return the error of a step that used MOST_TRIES, with `left` [s] remaining."""
    doing, piercing = what_it_does(system, state)
    cause = (
        f"{MOST_TRIES} parts of a step were tried and {left:.3g} s of it are left; {doing}; let the loads grow more "
        "slowly (ramp), remove slack from the path, or use a smaller solve.dt"
    )
    return StepError(state.time, left, cause, piercing)


def refuse_impossible(system: System[Body], step: Step[Body]) -> Flags:
    """Refuse a step in which holes cross or a held end leaves a hole; return the holes that it has
    left, shape `(m,)`.
    """
    gone = left_by(system, step.old, step.new)
    refuse_crossing(system, step.old, step.new)
    return gone


def left_by(system: System[Body], old: State[Body], new: State[Body]) -> Flags:
    """Return the holes that the thread has left, as `emptied_holds`.

    Raises `ConstraintError` if a hand has drawn the thread out, and `StepError` if a held end would
    leave a hole.
    """
    refuse_drawn_out(system, old, new)
    gone = emptied_holds(system, old, new)
    refuse_held_end(system, old, new, gone)
    return gone


def scheme_of(state: State[Body], dt: float) -> Scheme:
    """Return BDF2 if there is an earlier step of suitable size, else backward Euler."""
    if state.dt_before is None or dt > GROWTH * state.dt_before:
        return BackwardEuler(dt)
    return BDF2(dt, state.dt_before)


def bdf2_step(system: System[Body], state: State[Body], dt: float) -> Step[Body]:
    """Return one step of `dt` [s] by BDF2, or by backward Euler if BDF2 is not possible.

    If Newton's method does not converge from the prediction to the solution of BDF2, the thread
    snaps. Such a jump is a step of backward Euler without memory, and so is the next step. Raises
    `StepError`, `InversionError`.
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
    """Return the step with a new state that keeps the earlier state `old`."""
    return replace(step, new=replace(step.new, before=forgetful(old), dt_before=dt))
