"""Static equilibrium under the final loads, reached in load steps.

Where Newton from the last load step fails, the thread is let go gradually: it is tied to where it is by a mass-like
stiffness that is weakened until it can be dropped (pseudo-transient continuation). The accepted answer has none of it.
Where the thread would not stay at what Newton's method finds then, the tie is weakened further instead.

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
from coupling.kernels.bordered import SingularError
from coupling.step.descent import BOWING, stretching_tie
from coupling.step.diagnosis import has_turned, refuse_crossing, refuse_held_end, refuse_turning
from coupling.step.motion import what_it_does
from coupling.step.newton import Iterate, Problem, Solution, correct, force_tolerance
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
    left_by,
    reactions,
    release,
    riding,
    tie_gaps,
    where_it_is,
    with_sense,
)
from coupling.step.tension import pull_at, stretches_at
from coupling.system import State, System
from tissue.errors import OrganError

log = logging.getLogger(__name__)

WEAKER = 10.0  # the tie is weakened by this factor after a success, tightened by its square root after a failure
GENTLEST = 1.5  # by which it is weakened at least: by less than WEAKER after failures
AS_CANTILEVER = 3.516**2  # the first natural frequency of a clamped thread in bending, ω² = 3.516² EI/(ρA L⁴)
AS_STRING = (0.5 * np.pi) ** 2  # and that of one that a force F draws taut, ω² = (π/2)² F/(ρA L²)
AT_REST = 1e-10  # part by which 1 + T/EA at rest differs from that which the equilibrium was solved with
TENSIONS = 20  # equilibria with another 1 + T/EA at most
PAIRINGS = 8  # equilibria of a load step at most, further ones, until lips that slide face what they faced before
PAIRED = 1e-4  # of the thread's diameter: lips that slide no further face what they faced before
DRIFTS = 30  # equilibria of a load step at most, further ones, until a body that floats has come to rest
DRAGGED = 1e-10  # of the forces on it: what may still drag it
ATTEMPTS = 60
FAILURES = 6  # among them with a nonlinear organ: no tie of the thread brings tissue past a point where it snaps
MOST_FAILURES = 15  # with a linear one: the load step is halved sooner
MOST_CORRECTIONS = 4000  # of a load step with all its parts: eight times what one of the scene "pulley" takes
DROPPED = 0.3  # of the softest mode: the tie that is dropped first; where that leads astray, a weaker one is
REFITS = 4  # equilibria at most, further ones, until the packets of knots that travel fit
REFUSALS = 3  # drops at most that lead astray: a thread that would not stay under its last tie either is told
SOFT_TISSUE = 1e-6  # of the first tie: the last one where tissue at finite strain, a flap, gives way before the thread
LONG_END = 10.0  # √(EI/F) of an end beyond which the tension in it is the dead load on it, to 1e-8
BALANCED = 1e-6  # of the larger of two dead loads: nearer ones are equal
DEEPEST = 4  # halves of halves of a load step
SNAPS = 2  # of them, before tissue creeps to where it snaps
FIRST_PACE, LAST_PACE = 1e-3, 1e-10  # of an organ that creeps, over its stiffest node: softer than its softest mode
EASIER, HARDER = 4.0, 10.0  # the pace falls by the one after a success, and rises by the other after a failure
CREEPS = 60
LYING = 1e-10  # of the stiffest span: a piece that is cut turns freely in its holes, or in none, and lies where it is


def static_problem(
    system: System[Body],
    state: State[Body],
    share: float,
    duration: float,
    tie: float,
    answer: Answer[Body],
    first: State[Body],
    began: float,
) -> Problem[Body]:
    """Return the problem of equilibrium at the part `share` of the loads. `tie` [1/s²] ties each point to where it is
    in `state`, as do the pieces of a thread that is cut. Friction opposes the way from `first`, and what is drawn
    through is counted from there; hands draw and ties hold as in a load step that `began` then [s], with all of the
    force that they have at its end."""
    time, system = share * duration, system.at(state)
    load = end_load(system, duration, share) - (share * system.weight if system.thread.travels else 0.0)
    loose = loose_points(system, state)
    load[loose] = 0.0
    by_hand = system.drawn_lengths(first.time, time), system.pulling_forces(time)
    stretch = stretches_at(system, state.s, state.N, state.present)
    return Problem(
        system=system,
        time=time,
        dt=time - state.time,
        mass_factor=tie + (lying_tie(system, state) if system.thread.spline.cuts.size else 0.0),
        q_ref=state.q,
        load=load,
        answer=answer,
        rows=system.rows & state.present[:, None],
        law=law_of(system, first.s, state.present, 0.0, first.s, *by_hand, began, stretch),
        stiffen=True,
        frame=state.frame,
        gaps=tie_gaps(system, state, time),
        fields=() if state.spline is None else ((state.spline, state.q[:, :3]),),
        weight=np.where(loose, 0.0, share),
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
    began: float | None = None,
) -> Step[Body]:
    """Solve for equilibrium at the part `share` of the final loads; `given` is the organ's answer, None: that at rest;
    `began` [s], the start of the load step where the state is one on its way, which hands have not let go of yet.
    Raises `EquilibriumError`."""
    began = state.time if began is None else began
    return stand_firm(relax_ties(system, state, share, duration, given, began))


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


def relax_ties(
    system: System[Body],
    state: State[Body],
    share: float,
    duration: float,
    given: Answer[Body] | None,
    began: float,
) -> Step[Body]:
    """Reach equilibrium by ties that are weakened and dropped, the first load step from the first tie on, others
    without one unless that fails. On the way friction opposes the way of each tie, without a tie that from `state`.
    Arguments as for `settle`."""
    answer = ask_organ(system, Equilibrium(), [state], duration, share) if given is None else given
    firm, weaker, now = first_tie(system), WEAKER, state
    tie = firm if state.time == 0.0 else 0.0
    dropped, refusals, refits = 0.0, REFUSALS, REFITS
    failed: StepError | InversionError | None = None
    failures = MOST_FAILURES if answer.linear else FAILURES
    for _ in range(ATTEMPTS):
        problem = static_problem(system, now, share, duration, tie, answer, state, began)
        try:
            if tie:
                solution = find(rubbing_from(problem, now.s), guess(problem, now, now.sigma))
            else:
                solution = drop_tie(problem, now, lately=refits == REFITS)
            new = equilibrium_state(now, solution)
        except (StepError, InversionError) as error:
            failed, failures = error, failures - 1
            if failures == 0:
                break
            tie, weaker = (firm if tie == 0.0 else tie * np.sqrt(WEAKER)), max(GENTLEST, np.sqrt(weaker))
            continue
        fit = fitted(system, new)[1]
        if tie == 0.0:
            if refits and fit is not new:
                now, answer, refits = fit, solution.problem.answer, refits - 1
                continue
            if refusals and dropped and leads_astray(solution, new):
                log.debug("a tie was dropped to where the thread would not stay: a weaker one leads further")
                tie, refusals = dropped / WEAKER, refusals - 1
                continue
            return Step(state, new, problem.dt, solution, end_configuration(new, solution))
        refuse_leaving(system, state, new)
        now, answer, dropped = fit, solution.problem.answer, tie
        tie, weaker = (0.0 if tie < last_tie(problem, state) else tie / weaker), min(WEAKER, weaker**1.5)
    if isinstance(failed, InversionError):
        raise failed
    cause, piercing = (failed.cause, failed.piercing) if failed else ("the ties could not be dropped", "")
    raise EquilibriumError(state.time, share * duration - state.time, cause, piercing, share)


def leads_astray(solution: Solution[Body], new: State[Body]) -> bool:
    """Tell whether Newton's method has gone where no weaker tie would lead to, as a tie was dropped: to a `new` state
    in which the thread would not stay. One without bending stiffness, and one that is cut, have motions that cost
    nothing, and are not asked."""
    thread = solution.problem.system.thread
    return bool(thread.EI) and not thread.spline.cuts.size and not would_stay(solution, new)


def find_rest(problem: Problem[Body], first: Iterate) -> Solution[Body]:
    """Find the equilibrium of a thread that nothing ties, with its own stretch at its holes. Raises `StepError`."""
    return let_lie(settle_stretch(corrected(find(problem, first)), find))


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
    """Return a solution with one correction made where it took none: a tie that is dropped may leave forces just below
    the tolerance, far above those that Newton leaves, and works and branches begin there. One along motions that cost
    nothing is not made: how far it goes it takes from round-off. Raises `StepError`."""
    if solution.iterations:
        return solution
    z = solution.iterate
    ask_before_correction()
    try:
        z = correct(replace(solution.problem, closed=z.pressed, rubbing=z.rubbing), z, solution.residual)
    except SingularError:  # the loads have come to a limit point, and it holds as it is
        return solution
    if costs_nothing(solution.problem, force_tolerance(solution.problem, solution.residual), z.q - solution.iterate.q):
        return solution
    again = solve(solution.problem, z)
    return replace(again, iterations=1 + again.iterations)


def drop_tie(problem: Problem[Body], now: State[Body], lately: bool) -> Solution[Body]:
    """Solve for the equilibrium of a thread that slid while it was tied, to where it is `now`. Raises `StepError`.

    Friction opposes the whole way; where the thread turned back on it, and no equilibrium is near with that, `lately`
    only the last of it, and what friction takes of the whole way is then an estimate by the forces at the end.
    """
    try:
        return find_rest(problem, guess(problem, now, sense_of(problem, now)))
    except StepError:
        if not lately:
            raise
        solution = find_rest(rubbing_from(problem, now.s), guess(problem, now, now.sigma))
    law = replace(problem.law, stretch=solution.problem.law.stretch)
    return replace(solution, problem=replace(solution.problem, law=law))


def sense_of(problem: Problem[Body], now: State[Body]) -> Array:
    """Return the sense of sliding of a thread that is `now` somewhere, shape `(m,)`; where it sticks but has come from
    elsewhere, that of its way."""
    return np.where(now.sigma == 0.0, np.sign(now.s - problem.law.s_old), now.sigma)


def rubbing_from(problem: Problem[Body], s: Array) -> Problem[Body]:
    """Return the problem with friction that opposes the way from the abscissae `s` (m,) [m]."""
    law = problem.law
    return replace(problem, law=replace(law, s_old=s, s_held=np.where(law.may_slide, s, law.s_held)))


def refuse_leaving(system: System[Body], old: State[Body], new: State[Body]) -> None:
    """Raise `LeavingError` where a thread that is tied has run out of a hole, over an end that nothing holds: without
    the ties it goes further. One that is held at that end may come back."""
    gone = emptied_holds(system, old, new)
    try:
        refuse_held_end(system, old, new, gone)
    except StepError:
        return
    if gone.any():
        raise LeavingError(old.time, new.time - old.time, "the thread runs out of a hole", gone=gone)


def let_lie(solution: Solution[Body]) -> Solution[Body]:
    """Solve again with the pieces of a cut thread tied to where they are now, so that a piece whose place is told by
    what holds it bears nothing of that tie. Raises `StepError`."""
    problem, z = solution.problem, solution.iterate
    if not problem.mass_factor:
        return solution
    spline = solution.residual.configuration.thread.spline
    fields = ((spline, z.q[:, :3]),) if problem.fields else ()
    again = solve(replace(problem, q_ref=z.q, fields=fields), z)
    return replace(again, iterations=solution.iterations + again.iterations)


def drawing_force(problem: Problem[Body], state: State[Body]) -> float:
    """Return the largest force that draws on the thread [N]: of dead loads, of hands at holes and ties, and the tension
    that it is under in a state, which held and driven ends make. Ties draw a thread tighter for a while than it is in
    the end, so that it is asked where they are not yet."""
    dead = np.linalg.norm(problem.load[:, :3], axis=1).max()
    pull = pull_at(problem.system.at(state), state.s, state.N, problem.rows[:, 0])
    return float(max(dead, np.abs(problem.law.injected).max(initial=0.0), pull.max(initial=0.0)))


def first_tie(system: System[Body]) -> float:
    """Return the tie [1/s²] that holds a whole thread as firmly as its own stretching does: the same on all knots. One
    as stiff as the spans themselves holds a thread on fine ones across its holes, where it has to bend."""
    return stretching_tie(system.thread)


def lying_tie(system: System[Body], state: State[Body]) -> float:
    """Return the tie [1/s²] of the pieces of a cut thread to where they lie. It makes their matrix regular, so it is a
    part of its largest entry, the stiffness of the shortest span: what it bears is below what a solve leaves open."""
    thread = system.at(state).thread
    stiffness = np.abs(thread.tangent(thread.points(state.q, state.frame), state.N)).max()
    return float(LYING * stiffness / np.abs(thread.mass_band).max())


def last_tie(problem: Problem[Body], state: State[Body]) -> float:
    """Return the tie [1/s²] that holds a whole thread less than the softest of its modes, in bending or, where the
    forces that draw on it in a `state` make it stiffer, as a string: a weaker one is dropped, and so is one that is
    weaker than what keeps the pieces of a cut thread where they lie. Tissue at finite strain may bend far more easily
    than any thread."""
    if not problem.answer.linear:
        return SOFT_TISSUE * first_tie(problem.system)
    thread = problem.system.thread
    length = thread.spline.end - thread.spline.start
    soft = max(AS_CANTILEVER * thread.EI, AS_STRING * drawing_force(problem, state) * length**2)
    lying = lying_tie(problem.system, state) if thread.spline.cuts.size else 0.0
    return float(max(DROPPED * soft / (thread.section.rhoA * length**4), lying))


def guess(problem: Problem[Body], state: State[Body], sigma: Array) -> Iterate:
    """Return the last equilibrium with the prescribed ends moved on, where Newton starts."""
    return replace(where_it_is(problem, state), sigma=sigma)


def equilibrium_state(old: State[Body], solution: Solution[Body]) -> State[Body]:
    """Return the state of an equilibrium: at rest. Raises `InversionError`."""
    problem, z, residual = solution.problem, solution.iterate, solution.residual
    system = problem.system
    new = replace(
        old,
        time=problem.time,
        q=z.q,
        v=np.zeros_like(z.q),
        N=z.N,
        organ=accept_organ(solution),
        s=z.s,
        s_dot=np.zeros_like(z.s),
        lam=np.where(problem.rows, z.lam, 0.0),
        y=z.y,
        sigma=z.sigma,
        reaction=reactions(system, residual.thread, problem.load),
        frame=system.thread.transport_frame(old.frame, z.q),
        stretch=problem.law.stretch,
        solved=None,
        **riding(residual),
    )
    return with_sense(system, old, new, residual.passage)


def refuse_unbalanced(system: System[Body], state: State[Body], duration: float) -> None:
    """Raise `UnbalancedError` where two different dead loads, or one and a free end, draw on a thread that may slide
    in all its holes, and these bear no such difference: without friction the tension is the same all along.

    An end that is short compared with √(EI/F) may stand across its load and balance another one (the elastica arm
    scale: Bosi, Misseroni, Dal Corso & Bigoni, Proc. R. Soc. A 470, 2014), and is let pass.
    """
    thread, here = system.thread, state.present
    if not may_slide_as_a_whole(system, here) or system.weight.any():
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
    static, _, grip, per_channel = system.friction
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
            given = organ.creep(now.organ, duration, share, pace) if pace > LAST_PACE else None
            step = settle(system, now, share, duration, given, state.time)
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
            raise SpentError(state.time, share, MOST_CORRECTIONS, *what_it_does(system, state))

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
    gone = left_by(system, step.old, step.new)
    refuse_crossing(system, step.old, step.new)
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
        refuse_jump(system.organ, step)
        return step
    turned = has_turned(system, step.old, step.new).any()
    return replace(step, snapped=bool(turned) or has_jumped(system.organ, step))


def refuse_folding(step: Step[Body]) -> None:
    """Raise `StepError` where a load step has folded the thread within a span: its end was pushed past the next points,
    and Newton's method has left it there."""
    spline, old, new = step.solution.problem.system.thread.spline, step.old, step.new
    was = step.solution.problem.system.at(old).thread.spline.folds(old.q[:, :3], old.s[old.present])
    if spline.folds(new.q[:, :3], new.s[new.present]).any() and not was.any():
        raise StepError(step.old.time, step.dt, "the thread turned back on itself within a span")


def refuse_jump(organ: Creeping, step: Step[Body]) -> None:
    """Raise `StepError` where tissue at finite strain came past a barrier of energy in a step."""
    if has_jumped(organ, step):
        raise StepError(step.old.time, step.dt, "the tissue jumped past a barrier of energy: that is another branch")


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
    while (len(out) <= PAIRINGS and has_slid(system, out[-1])) or (len(out) <= DRIFTS and is_dragged(system, out[-1])):
        given = ask_organ(system, Equilibrium(), [out[-1].new, step.old], duration, share)
        out.append(settle(system, out[-1].new, share, duration, given, step.old.time))
    if is_dragged(system, out[-1]):
        cause = "a body of the organ that no clamp holds drifts on, since neither thread nor contact stops it"
        remedy = "clamp it, stitch it, or let a contact stop it"
        raise EquilibriumError(step.old.time, share * duration - step.old.time, cause, "", share, remedy)
    return out[1:]


def has_slid(system: System[Body], step: Step[Body]) -> bool:
    """Tell whether lips that press on one another face something else after a step than in it."""
    seen = slice(2, 3) if step.solution.problem.answer.linear else slice(0, 3, 2)
    before, after = (system.organ.lips(state.organ) for state in (step.old, step.new))
    way = max(np.abs(b - a).max(initial=0.0) for a, b in zip(before[seen], after[seen], strict=True))
    return bool(way > PAIRED * system.thread.section.diameter and after[1].any())


def is_dragged(system: System[Body], step: Step[Body]) -> bool:
    """Tell whether a body of the organ that nothing but thread and contact holds has not come to rest in a step."""
    organ = system.organ
    return isinstance(organ, Floats) and organ.dragged(step.new.organ) > DRAGGED
