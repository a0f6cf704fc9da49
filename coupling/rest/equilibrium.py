"""Static equilibrium under the final loads, reached in load steps.

A thread goes downhill from where it is (`coupling.step.descent`). After each round of corrections its knots are made
anew where they do not fit it any more, and Newton's method is tried from there. What moves at no cost, as a thread that
slides freely in all its holes, or a piece of one that is cut, stays as near to where it is as the rest lets it.

A nonlinear organ may have no equilibrium near: beyond a limit point it snaps. Where load steps halve to nothing, it
creeps downhill from where it is, dragged back less and less, to the next equilibrium that holds.

A body of the organ that nothing but thread and contact holds is dragged too (`tissue.organs.floating`): the equilibrium
is found again from the last one until it is not any more.

A thread that runs out of a hole on its way there has left it: the load step is taken again without that hole.
"""

import logging
from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np

from coupling.arrays import Array, Flags
from coupling.calls import ask_before_correction, asked_before_corrections
from coupling.errors import (
    HOLD_IT,
    OTHER_WAYS,
    CouplingError,
    EquilibriumError,
    InversionError,
    LeavingError,
    OutError,
    SpentError,
    StepError,
    UnbalancedError,
)
from coupling.integrators import Equilibrium
from coupling.interfaces import Answer, Body, Creeping, Floats
from coupling.joins.strands import misplaced, touching_organ
from coupling.kernels.bordered import SingularError
from coupling.step.descent import BOWING
from coupling.step.diagnosis import (
    FARTHEST_TURN,
    refuse_held_end,
    refuse_together,
    refuse_turning,
    turn_of_holes,
)
from coupling.step.motion import what_it_does
from coupling.step.newton import (
    Iterate,
    Problem,
    Solution,
    UnfinishedError,
    correct,
    force_tolerance,
    rounded_force,
)
from coupling.step.packets import fitted
from coupling.step.sliding import law_of
from coupling.step.solver import find, solve
from coupling.step.stability import aside, costs_nothing, is_squeezed, would_stay
from coupling.step.stepping import (
    Step,
    accept_organ,
    ask_organ,
    emptied_holds,
    end_configuration,
    end_load,
    reactions,
    refuse_impossible,
    release,
    riding,
    tie_gaps,
    where_it_is,
    with_sense,
)
from coupling.step.tension import stretches_at
from coupling.system import State, System
from tissue.errors import OrganError

log = logging.getLogger(__name__)

AT_REST = 1e-10  # part by which 1 + T/EA at rest differs from that which the equilibrium was solved with
TENSIONS = 20  # equilibria with another 1 + T/EA at most
PAIRINGS = 8  # equilibria of a load step at most, further ones, until lips that slide face what they faced before
PAIRED = 1e-4  # of the thread's diameter: lips that slide no further face what they faced before
MISPLACED = 1e-3  # of the thread's diameter: nearer to the surface, a strand lies on it
DRIFTS = 30  # equilibria of a load step at most, further ones, until a body that floats has come to rest
DRAGGED = 1e-10  # of the forces on it: what may still drag it
ROUNDS = 40  # of corrections, on knots that fit where each begins; a thread that runs out of a hole takes 12
MOST_CORRECTIONS = 4000  # of a load step with all its parts: eight times what one of the scene "pulley" takes
DOWN = 2  # of them go downhill before one of Newton's method
REFITS = 4  # equilibria at most, further ones, until the packets of knots that travel fit
LONG_END = 10.0  # √(EI/F) of an end beyond which the tension in it is the dead load on it, to 1e-8
BALANCED = 1e-6  # of the larger of two dead loads: nearer ones are equal
DEEPEST = 4  # halves of halves of a load step
SNAPS = 2  # of them, before tissue creeps to where it snaps
FIRST_PACE, LAST_PACE = 1e-3, 1e-10  # of an organ that creeps, over its stiffest node: softer than its softest mode
EASIER, HARDER = 4.0, 10.0  # the pace falls by the one after a success, and rises by the other after a failure
CREEPS = 60
LIES = 4  # times at most that it is tied to where it has come to
LYING = 1e-10  # of the stiffest span: what turns or slides freely, as pieces that are cut do, lies where it is


def static_problem(
    system: System[Body],
    state: State[Body],
    share: float,
    duration: float,
    answer: Answer[Body],
    first: State[Body],
    began: State[Body],
    lapse: float = 0.0,
) -> Problem[Body]:
    """Return the problem of equilibrium at the part `share` of the loads. Friction in holes opposes the way from
    `first`, and what is drawn through is counted from there; hands draw and ties hold as in a load step that `began` at
    a state, with all of the force that they have at its end, and the thread rubs on the organ on its way from there. It
    relaxes for `lapse` [s] from `first` on."""
    time = share * duration
    system = system.over(first, lapse)
    system = system if state.spline is None else system.on(state.spline)
    load = end_load(system, duration, share) - (share * system.weight if system.thread.travels else 0.0)
    loose = loose_points(system, state)
    load[loose] = 0.0
    by_hand = system.drawn_lengths(first.time, time), system.pulling_forces(time)
    stretch = stretches_at(system, state.s, state.N, state.present)
    return Problem(
        system=system,
        time=time,
        dt=time - state.time,
        mass_factor=lying_tie(system, state),
        q_ref=state.q,
        load=load,
        answer=answer,
        rows=system.rows & state.present[:, None],
        law=law_of(system, first.s, state.present, 0.0, first.s, *by_hand, began.time, stretch),
        stiffen=True,
        frame=state.frame,
        gaps=tie_gaps(system, state, time),
        fields=() if state.spline is None else ((state.spline, state.q[:, :3]),),
        weight=np.where(loose, 0.0, share),
        start=began if system.bears else None,
    )


def loose_points(system: System[Body], state: State[Body]) -> Flags:
    """Return the control points of the pieces of a cut thread that nothing holds, shape `(n,)`: no load on them is
    borne by anything. A thread in one piece has none, and what nothing holds of it has no equilibrium."""
    spline = system.thread.spline
    if spline.pieces == 1:
        return np.zeros(spline.n, dtype=bool)
    held = np.zeros(spline.pieces, dtype=bool)
    held[spline.piece_of(state.s[state.present])] = True
    for piece, end in zip((0, -1), system.ends, strict=True):
        held[piece] |= end.position(0.0) is not None
    return np.repeat(~held, spline.piece_points)


def settle(
    system: System[Body],
    state: State[Body],
    share: float,
    duration: float,
    given: Answer[Body] | None = None,
    began: State[Body] | None = None,
) -> Step[Body]:
    """Solve for equilibrium at the part `share` of the final loads; `given` is the organ's answer, None: that at rest;
    `began`, the state at the start of the load step if the state is one on its way, which hands have not let go of yet.
    Raises `EquilibriumError`."""
    began = state if began is None else began
    return stand_firm(go_downhill(system, state, share, duration, given, began))


def stand_firm(step: Step[Body]) -> Step[Body]:
    """Return a step to an equilibrium in which the thread stays: the same or, where it would buckle, the one that it
    goes aside to; the same where none is found."""
    problem, z = step.solution.problem, step.solution.iterate
    if not is_squeezed(step.solution) or would_stay(step.solution, step.new):
        return step
    try:
        solution = let_lie(settle_stretch(solve(problem, aside(problem, z), BOWING), find))
    except StepError as error:
        log.debug("the thread would not stay, and goes nowhere else: %s", error)
        return step
    new = equilibrium_state(replace(step.old, frame=problem.frame), solution)
    found = Step(step.old, new, problem.dt, solution, end_configuration(new, solution), snapped=True)
    return found if would_stay(solution, new) else step


def go_downhill(
    system: System[Body],
    state: State[Body],
    share: float,
    duration: float,
    given: Answer[Body] | None,
    began: State[Body],
) -> Step[Body]:
    """Reach equilibrium by rounds of corrections that go downhill, every third of Newton's method from where they led,
    which is the faster one along a valley; it comes first after a load step with a linear organ that nothing touches.
    Friction opposes the way from `state`. Arguments as for `settle`."""
    lapse = 0.0 if given is not None else max(share * duration - state.time, 0.0) if duration else np.inf
    answer = ask_organ(system, Equilibrium(lapse), [state], duration, share) if given is None else given
    problem = static_problem(system, state, share, duration, answer, state, began, lapse)
    near = state.time > 0.0 and answer.linear and problem.contact is None and problem.strands is None
    now, down, refits = state, 0 if near else DOWN, REFITS
    failed = EquilibriumError(state.time, share * duration - state.time, "", "", share, remedy_for(system, state))
    for _ in range(ROUNDS):
        try:
            solution = find_rest(problem, guess(problem, now, sense_of(problem, now)), down == 0)
            new = equilibrium_state(now, solution)
            fit = fitted(system, new)[1]
            if fit is new or not refits:
                return Step(state, new, problem.dt, solution, end_configuration(new, solution))
            now, answer, down, refits = fit, solution.problem.answer, 0, refits - 1
        except StepError as error:
            failed = replace(failed, cause=error.cause, piercing=error.piercing)
            if down:
                now, answer = further(system, state, now, error)
            down = down - 1 if down else DOWN
        problem = static_problem(system, now, share, duration, answer, state, began, lapse)
    raise failed


def further(
    system: System[Body], first: State[Body], old: State[Body], error: StepError
) -> tuple[State[Body], Answer[Body]]:
    """Return the state that the corrections from an `old` one reached until the `error`, on knots that fit it, and the
    organ's answer there; the load step began at `first`. Raises the error if the corrections were not spent,
    `LeavingError` if the thread has run out of a hole, `TogetherError` if holes have met."""
    if not isinstance(error, UnfinishedError):
        raise error
    new = put_where(old, error.reached)
    refuse_leaving(system, first, new)
    refuse_together(system, new)
    return fitted(system, new, solved=False)[1], error.reached.problem.answer


def find_rest(problem: Problem[Body], first: Iterate, near: bool) -> Solution[Body]:
    """Find an equilibrium, with the thread's own stretch at its holes, by Newton's method where one may be `near`.
    Raises `StepError`."""
    found = solve(problem, first, downhill=0 if near else 1)
    return let_lie(settle_stretch(corrected(found), find))


def settle_stretch(
    solution: Solution[Body], solve_again: Callable[[Problem[Body], Iterate], Solution[Body]]
) -> Solution[Body]:
    """Solve again while the stretch 1 + T/EA by which friction goes is another at the end than the equilibrium was
    solved with. Raises `StepError`."""
    for _ in range(TENSIONS):
        problem, z = solution.problem, solution.iterate
        system = problem.system.on(solution.residual.configuration.thread.spline)
        stretch = stretches_at(system, z.s, z.N, problem.rows[:, 0])
        change = np.max(np.abs(stretch / problem.law.stretch - 1.0), initial=0.0)
        if problem.law.ideal or change <= AT_REST:
            break
        again = solve_again(replace(problem, law=replace(problem.law, stretch=stretch)), z)
        solution = replace(again, iterations=solution.iterations + again.iterations)
    return solution


def corrected(solution: Solution[Body]) -> Solution[Body]:
    """Return a solution with one correction made where it took none: forces may be just below the tolerance, far above
    those that Newton's method leaves, and works and branches begin there. A correction along motions that cost nothing
    is not made: round-off decides how far it goes. Raises `StepError`."""
    if solution.iterations:
        return solution
    z = solution.iterate
    ask_before_correction()
    try:
        _, z = correct(replace(solution.problem, closed=z.pressed, rubbing=z.rubbing), z, solution.residual)
    except SingularError:  # the loads have come to a limit point, and it holds as it is
        return solution
    if costs_nothing(solution.problem, force_tolerance(solution.problem, solution.residual), z.q - solution.iterate.q):
        return solution
    again = solve(solution.problem, z)
    return replace(again, iterations=1 + again.iterations)


def sense_of(problem: Problem[Body], now: State[Body]) -> Array:
    """Return the sense of sliding of a thread that is `now` somewhere, shape `(m,)`; where it sticks but has come from
    elsewhere, that of its way."""
    return np.where(now.sigma == 0.0, np.sign(now.s - problem.law.s_old), now.sigma)


def refuse_leaving(system: System[Body], old: State[Body], new: State[Body]) -> None:
    """Raise `LeavingError` where a thread on its way has run out of a hole, over an end that nothing holds. One that is
    held at that end may come back."""
    gone = emptied_holds(system, old, new)
    try:
        refuse_held_end(system, old, new, gone)
    except StepError:
        return
    if gone.any():
        raise LeavingError(old.time, new.time - old.time, "the thread runs out of a hole", gone=gone)


def let_lie(solution: Solution[Body]) -> Solution[Body]:
    """Solve again with a thread that may move at no cost tied to where it is now, by a tenth of the tie, until that
    bears nothing: each time the part of the tie in the stiffness of the thread is left (the proximal point algorithm:
    Rockafellar, SIAM J. Control Optim. 14, 1976). Raises `StepError`."""
    if not solution.problem.mass_factor:
        return solution
    for _ in range(LIES):
        problem, z, spline = solution.problem, solution.iterate, solution.residual.configuration.thread.spline
        fields = ((spline, z.q[:, :3]),) if problem.fields else ()
        problem = replace(problem, q_ref=z.q, fields=fields, mass_factor=0.1 * problem.mass_factor)
        again = solve(problem, z)
        solution = replace(again, iterations=solution.iterations + again.iterations)
        way = np.abs(problem.system.thread.momentum(again.iterate.q - z.q)[:, :3]).sum()
        if problem.mass_factor * way <= rounded_force(problem):
            break
    last = corrected(replace(solution, iterations=0))  # what is left does work: a piece may have gone far
    return replace(last, iterations=solution.iterations + last.iterations)


def lying_tie(system: System[Body], state: State[Body]) -> float:
    """Return the tie [1/s²] to where it lies of a thread that may move at no cost: one that is cut, or slides freely in
    all its holes; zero of others. It makes their matrix regular, so it is a part of its largest entry, the stiffness of
    the shortest span: what it bears is below what a solve leaves open."""
    if not (system.thread.spline.cuts.size or slides_freely(system, state.present)):
        return 0.0
    thread = system.at(state).thread
    stiffness = np.abs(thread.tangent(thread.points(state.q, state.frame), state.N)).max()
    return float(LYING * stiffness / np.abs(thread.mass_band).max())


def guess(problem: Problem[Body], state: State[Body], sigma: Array) -> Iterate:
    """Return the last equilibrium with the prescribed ends moved on, where Newton starts."""
    return replace(where_it_is(problem, state), sigma=sigma)


def put_where(old: State[Body], solution: Solution[Body]) -> State[Body]:
    """Return the state with the thread where an iterate has it, solved or not."""
    z, thread = solution.iterate, solution.problem.system.thread
    return replace(
        old,
        q=z.q,
        N=z.N,
        s=z.s,
        lam=np.where(solution.problem.rows, z.lam, 0.0),
        y=z.y,
        sigma=z.sigma,
        frame=thread.transport_frame(old.frame, z.q),
        solved=None,
        **riding(solution.residual),
    )


def equilibrium_state(old: State[Body], solution: Solution[Body]) -> State[Body]:
    """Return the state of an equilibrium: at rest. Raises `InversionError`."""
    problem, residual = solution.problem, solution.residual
    new = replace(
        put_where(old, solution),
        time=problem.time,
        v=np.zeros_like(solution.iterate.q),
        organ=accept_organ(solution),
        s_dot=np.zeros_like(solution.iterate.s),
        reaction=reactions(problem, residual.thread),
        stretch=problem.law.stretch,
    )
    return with_sense(problem.system, old, new, residual.passage)


def refuse_unbalanced(system: System[Body], state: State[Body], duration: float) -> None:
    """Raise `UnbalancedError` where two different dead loads, or one and a free end, draw on a thread that may slide
    in all its holes, and these bear no such difference: without friction the tension is the same all along.

    An end that is short compared with √(EI/F) may stand across its load and balance another one (the elastica arm
    scale: Bosi, Misseroni, Dal Corso & Bigoni, Proc. R. Soc. A 470, 2014), and is let pass.
    """
    thread, here = system.thread, state.present
    if not may_slide_as_a_whole(system, here) or system.weight.any():
        return
    if system.contact is not None and system.contact.friction:  # of strands, which may balance them
        return
    load = np.array([np.linalg.norm(end.force(duration)) for end in system.ends])
    ends = np.array([state.s[here].min() - thread.spline.start, thread.spline.end - state.s[here].max()])
    short = (load > 0.0) & (load * ends**2 < LONG_END**2 * thread.EI)
    borne = largest_load(system, state, load)
    if short.any() or (1.0 - BALANCED) * load.max() <= borne:
        return
    slides = "slides freely in all its holes"
    if borne > load.min():
        slides = f"may slide in all its holes, whose friction bears {borne:.4g} N at most against the smaller one"
    cause = (
        f"the dead loads are unbalanced, {load[0]:.4g} N at the start and {load[1]:.4g} N at the end of a thread that "
        f"{slides}"
    )
    raise UnbalancedError(state.time, duration - state.time, cause)


def largest_load(system: System[Body], state: State[Body], load: Array) -> float:
    """Return the largest dead load [N] that the smaller of the two at the ends, `load` (2,) [N], may balance through
    the holes of a thread that slides in them, however they turn it; infinite where that is not known.

    A hole bears T₂ − T₁ ≤ F₀ + μ N, and is pressed on by both strands at most, N ≤ T₁ + T₂, in a channel ℓ by their
    couples too, 2 √(EI T) each at most (a long elastica), which adds 2 (M₁ + M₂)/ℓ. A strand between two holes that is
    short compared with √(EI/T) may press more.
    """
    EI, tension = system.thread.EI, float(load.min())
    order = np.argsort(state.s)[:: 1 if load[0] <= load[1] else -1]
    order = order[(system.rough & state.present)[order]]
    if not state.present.all() or any(system.own_friction[k] for k in order):
        return np.inf
    strands = np.diff(np.sort(state.s))
    if order.size and (tension * strands**2 < LONG_END**2 * EI).any():
        return np.inf
    static, _, grip, barb, per_channel = system.friction
    grip = grip + np.abs(barb)
    for mu, F, by_couple in zip(static[order], grip[order], 4.0 * np.sqrt(EI) * per_channel[order], strict=True):
        if mu >= 1.0:
            return np.inf
        b, c = mu * by_couple, F + (1.0 + mu) * tension + mu * by_couple * np.sqrt(tension)
        tension = float(((b + np.sqrt(b**2 + 4.0 * (1.0 - mu) * c)) / (2.0 * (1.0 - mu))) ** 2)
    return tension


def slides_freely(system: System[Body], present: Flags) -> bool:
    """Tell whether a thread in one piece slides freely in all its holes, those that it is `present` in `(m,)`, and no
    end of it is held: under equal loads at both ends it costs nothing to slide as a whole."""
    return may_slide_as_a_whole(system, present) and not (system.rows.any(axis=1) & present & system.rough).any()


def remedy_for(system: System[Body], state: State[Body]) -> str:
    """Return what may help where no equilibrium is found."""
    return HOLD_IT if may_slide_as_a_whole(system, state.present) else OTHER_WAYS


def may_slide_as_a_whole(system: System[Body], present: Flags) -> bool:
    """Tell whether nothing but friction holds a thread in one piece along itself, in the holes that it is `present` in
    `(m,)`: no end, anchor, tie or hand."""
    holds = (system.rows.any(axis=1) & present & (~system.may_slide | system.by_hand)).any()
    held = any(end.position(0.0) is not None for end in system.ends)
    return not (holds or held or system.ties or not present.any() or system.thread.spline.cuts.size)


def settle_or_snap(system: System[Body], state: State[Body], share: float, duration: float, snap: bool) -> Step[Body]:
    """Solve for equilibrium as `settle` does; where there is none near, and the tissue may `snap`, or none that holds,
    for that which a nonlinear organ creeps to. Raises `EquilibriumError`."""
    organ = system.organ
    try:
        step = settle(system, state, share, duration)
    except EquilibriumError:
        if not (snap and isinstance(organ, Creeping)):
            raise
        log.info("no equilibrium is near at %.4g of the loads: the tissue creeps to the next one", share)
        return creep(system, organ, state, share, duration)
    if not isinstance(organ, Creeping) or organ.holds(step.solution.problem.answer):
        return step
    log.info("the equilibrium at %.4g of the loads does not hold: the tissue creeps to the next one", share)
    try:
        return creep(system, organ, state, share, duration)
    except EquilibriumError:  # the thread holds the tissue where it would not stay alone
        return step


def creep(system: System[Body], organ: Creeping, state: State[Body], share: float, duration: float) -> Step[Body]:
    """Let the organ creep to the equilibrium that is downhill, at a pace that quickens. Raises `EquilibriumError`."""
    now, pace, failed = state, FIRST_PACE, EquilibriumError(state.time, share * duration - state.time, "", "", share)
    for _ in range(CREEPS):
        try:
            given = organ.creep(touching_organ(system, now, now), duration, share, pace) if pace > LAST_PACE else None
            step = settle(system, now, share, duration, given, state)
        except OrganError as error:
            failed, pace = replace(failed, cause=str(error)), HARDER * pace
            continue
        except EquilibriumError as error:
            failed, pace = error, HARDER * pace
            continue
        if given is None:
            return replace(step, old=state, dt=share * duration - state.time, snapped=True)
        now, pace = step.new, pace / EASIER
    raise failed


def load_steps(
    system: System[Body],
    state: State[Body],
    share: float,
    duration: float,
) -> Iterator[Step[Body]]:
    """Go on to the part `share` of the loads, in parts where that fails, and yield the steps as they are made.
    Without a `duration` all loads are those at t = 0, and begin with none. Raises as `go_on` does, and
    `SpentError` after MOST_CORRECTIONS."""
    left = iter(range(MOST_CORRECTIONS))

    def count() -> None:
        if next(left, None) is None:
            doing = what_it_does(system, state)
            raise SpentError(state.time, share, MOST_CORRECTIONS, *doing, remedy=remedy_for(system, state))

    with asked_before_corrections(count):
        yield from go_on(system, state, share, duration, state.time / duration if duration else 0.0)


def go_on(
    system: System[Body],
    state: State[Body],
    share: float,
    duration: float,
    begun: float,
    depth: int = 0,
) -> Iterator[Step[Body]]:
    """Go on from the part `begun` of the loads to the part `share`, in halves of the increment where it fails, where
    the thread flips through a hole or folds within a span, and where tissue at finite strain goes on as only another
    branch does; yield the steps. Raises `StepError`, `InversionError`, `ConstraintError` where a hand has drawn the
    thread out."""
    try:
        step = settle_or_snap(system, state, share, duration, depth >= SNAPS)
        step, gone = accepted(system, step, depth)
    except LeavingError as error:
        gone = error.gone
    except (StepError, InversionError) as error:
        if depth == DEEPEST or share <= begun:  # after a cut the loads stay what they are
            raise without_equilibrium(error, share) from error
        for part in (0.5 * (begun + share), share):
            for step in go_on(system, state, part, duration, begun, depth=depth + 1):
                yield step
            state, begun = step.new, part
        return
    if gone.any():
        left = release(state, gone)
        refuse_loose(system, left, share, duration)
        yield from go_on(system, left, share, duration, begun, depth=depth)
        return
    yield from [step, *pair_lips(system, step, share, duration)]


def accepted(system: System[Body], step: Step[Body], depth: int) -> tuple[Step[Body], Flags]:
    """Return a load step that has been halved `depth` times, told whether its tissue snapped, and the holes that the
    thread ran out of in it, shape `(holds,)`. Raises `StepError` where the loads are to be halved, `ConstraintError`
    where a hand has drawn the thread out."""
    gone = refuse_impossible(system, step)
    if depth < DEEPEST:
        refuse_folding(step)
    step = told_to_snap(system, step, depth)
    return step, gone


def told_to_snap(system: System[Body], step: Step[Body], depth: int) -> Step[Body]:
    """Return the step; where tissue at finite strain turned a hole at once as only another branch does, or came past a
    barrier of energy, one that has snapped if the loads cannot be halved any more. Raises `StepError` where they
    can."""
    if step.snapped or not isinstance(system.organ, Creeping):
        return step
    if depth < DEEPEST:
        refuse_turning(system, step.old, step.new)
        if has_jumped(system.organ, step):
            cause = "the tissue jumped past a barrier of energy: that is another branch"
            raise StepError(step.old.time, step.dt, cause)
        return step
    turned = turn_of_holes(system, step.old, step.new).max(initial=0.0) > FARTHEST_TURN
    return replace(step, snapped=bool(turned) or has_jumped(system.organ, step))


def refuse_folding(step: Step[Body]) -> None:
    """Raise `StepError` where a load step has folded the thread within a span: its end was pushed past the next points,
    and Newton's method has left it there."""
    spline, old, new = step.solution.problem.system.thread.spline, step.old, step.new
    was = step.solution.problem.system.at(old).thread.spline.folds(old.q[:, :3], old.s[old.present])
    if spline.folds(new.q[:, :3], new.s[new.present]).any() and not was.any():
        raise StepError(step.old.time, step.dt, "the thread turned back on itself within a span")


def has_jumped(organ: Creeping, step: Step[Body]) -> bool:
    """Tell whether tissue at finite strain came past a barrier of energy in a step."""
    return organ.has_jumped(step.solution.problem.answer, step.old.organ, step.new.organ)


def without_equilibrium(error: StepError | InversionError, share: float) -> CouplingError:
    """Return the error of a load step, which has no length in time to be told, but a `share` of the loads."""
    if isinstance(error, InversionError | EquilibriumError):
        return error
    return EquilibriumError(error.time, error.dt, error.cause, error.piercing, share)


def refuse_loose(system: System[Body], state: State[Body], share: float, duration: float) -> None:
    """Raise `OutError` where a thread in one piece has left its last hole and no end of it is held."""
    held = any(end.position(0.0) is not None for end in system.ends)
    if not (held or state.present.any() or system.thread.spline.pieces > 1):
        cause = "the thread runs out of its last hole"
        raise OutError(state.time, share * duration - state.time, cause, share=share)


def pair_lips(system: System[Body], step: Step[Body], share: float, duration: float) -> list[Step[Body]]:
    """Find the equilibrium again while the lips, which a step pairs as they were at its start, slide on its way, or
    their gaps change where an organ at finite strain turns them, and while a body that nothing but thread and contact
    holds is dragged; with friction they rub along the way from the start of the load step. Raises `StepError`."""
    out = [step]
    while (len(out) <= PAIRINGS and has_slid(system, out[-1], step.old)) or (
        len(out) <= DRIFTS and is_dragged(system, out[-1])
    ):
        since = Equilibrium(share * duration - step.old.time)
        given = ask_organ(system, since, [out[-1].new, step.old], duration, share)
        out.append(settle(system, out[-1].new, share, duration, given, step.old))
    if is_dragged(system, out[-1]):
        cause = "a body of the organ that no clamp holds drifts on, since neither thread nor contact stops it"
        remedy = "clamp it, stitch it, or let a contact stop it"
        raise EquilibriumError(step.old.time, share * duration - step.old.time, cause, "", share, remedy)
    return out[1:]


def has_slid(system: System[Body], step: Step[Body], origin: State[Body]) -> bool:
    """Tell whether lips that press on one another, or the thread and the organ, face something else after a step than
    in it."""
    if misplaced(system, step.new, origin) > MISPLACED * system.thread.section.diameter:
        return True
    seen = slice(2, 3) if step.solution.problem.answer.linear else slice(0, 3, 2)
    before, after = (system.organ.lips(state.organ) for state in (step.old, step.new))
    way = max(np.abs(b - a).max(initial=0.0) for a, b in zip(before[seen], after[seen], strict=True))
    return bool(way > PAIRED * system.thread.section.diameter and after[1].any())


def is_dragged(system: System[Body], step: Step[Body]) -> bool:
    """Tell whether a body of the organ that nothing but thread and contact holds has not come to rest in a step."""
    organ = system.organ
    return isinstance(organ, Floats) and organ.dragged(step.new.organ) > DRAGGED
