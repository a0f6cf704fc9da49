"""Static equilibrium under the final loads, reached in load steps.

The thread goes downhill from its place (`coupling.step.descent`). After each round of corrections
its knots are made anew if they no longer fit, and Newton's method is tried. A thread that slides
freely in all its holes, or a piece that is cut off, can move without a change of energy. Such a
thread stays as close to its place as the equilibrium allows.

A nonlinear organ may have no close equilibrium: it snaps beyond a limit point, downhill to the next
equilibrium that is stable. A load step in which it snaps is halved a few times.

A body of the organ that only thread and contact hold has a drag towards its last state
(`tissue.organs.floating`). The equilibrium is solved again from the last one until the drag is
zero.

The lips are paired at a place between the last one and the new equilibrium
(`tissue.organs.meshed.MeshedOrgan.paired_nearer`): at the equilibrium itself, pressed lips that
slide would alternate.

An equilibrium that is solved again is the end of the same load step, so that its works are by the
forces at both ends of the load step. Those of the equilibria between, with the pairs of other
places, are not part of them.

A thread that runs out of a hole on the way has left the hole: the load step is repeated without it.
"""

import logging
from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np

from coupling.arrays import Array, Flags
from coupling.calls import ask_before_correction, asked_before_corrections
from coupling.errors import (
    HOLD_IT,
    OF_LOOSE_BODY,
    OF_TISSUE,
    OTHER_WAYS,
    BranchError,
    CouplingError,
    EquilibriumError,
    FarError,
    InversionError,
    LeavingError,
    OutError,
    SpentError,
    StepError,
    TogetherError,
    UnbalancedError,
)
from coupling.integrators import Equilibrium
from coupling.interfaces import Answer, Body, Floats, Paired, Snapping
from coupling.joins.strands import misplaced
from coupling.kernels.bordered import SingularError
from coupling.step.descent import BOWING
from coupling.step.diagnosis import (
    FARTHEST_TURN,
    hold_names,
    refuse_held_end,
    refuse_together,
    refuse_turning,
    turn_of_holes,
)
from coupling.step.motion import is_tissue_alone, what_it_does
from coupling.step.newton import (
    Iterate,
    Problem,
    Solution,
    UnfinishedError,
    correct,
    force_tolerance,
    rounded_force,
    stretched,
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
from tissue.errors import FactorError, OrganError

log = logging.getLogger(__name__)

AT_REST = 1e-10  # relative tolerance between 1 + T/EA of an equilibrium and that in its law of friction
TENSIONS = 20  # equilibria with a changed 1 + T/EA, at most
PAIRINGS = 8  # additional equilibria of a load step, at most, until the pairs of sliding lips no longer change
PAIRED = 1e-4  # of the thread's diameter: slip below which the pairs of lips do not change
MISPLACED = 1e-3  # of the thread's diameter: a strand closer to the surface lies on it
DRIFTS = 30  # additional equilibria of a load step, at most, until a floating body is at rest
DRAGGED = 1e-10  # of the forces on a floating body: allowed remaining drag
ROUNDS = 40  # of corrections, each starting with knots that fit; a thread that runs out of a hole takes 12
MOST_CORRECTIONS = 4000  # of a load step with all its parts: eight times the number for the scene "pulley"
REPORTED = 100  # corrections between two messages: a usual load step takes fewer
AWAY = 8  # rounds of Newton's method from an unstable equilibrium of tissue, at most: a column that buckles takes 2
DOWN = 2  # rounds downhill before a round of Newton's method
REFITS = 4  # additional equilibria, at most, until the packets of travelling knots fit
LONG_END = 10.0  # √(EI/F): in a longer end the tension is the dead load on it, to 1e-8
BALANCED = 1e-6  # of the larger of two dead loads, or of the largest force: loads with a smaller difference are equal
LIGHT = 0.01  # of the loads: 1 to 80 load steps then agree to 1e-3 (2-0, turns of 150°, arms of 15 to 120 mm)
DEEPEST = 4  # repeated halvings of a load step; with 6 snaps take twice the time
FAR = 1e3  # times the extent of a scene: nothing that could hold a thread is so far away
LIES = 4  # times that a thread is tied to the place that it has reached, at most
LYING = 1e-10  # of the stiffest span: tie of a thread that turns or slides freely, such as a piece that is cut off


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
    """Return the problem of equilibrium at the part `share` of the loads.

    Friction in holes opposes the way from `first`, and drawn lengths count from there. The thread
    relaxes for `lapse` [s] from `first` on. The load step began at `began`. Which hands draw and
    which ties hold is decided at its time; their forces are those at the end of the load step. The
    thread slides in ties, and rubs on the organ, on the way from `began`.
    """
    time = share * duration
    system = system.over(first, lapse)
    system = system if state.spline is None else system.on(state.spline)
    load = end_load(system, duration, share) - (share * system.weight if system.thread.travels else 0.0)
    loose = loose_points(system, state)
    load[loose] = 0.0
    by_hand = system.drawn_lengths(first.time, time), system.pulling_forces(time)
    stretch = stretches_at(system, state.s, state.N, state.present)
    s_old = np.where(system.of_ties, began.s, first.s)
    return Problem(
        system=system,
        time=time,
        dt=time - state.time,
        mass_factor=lying_tie(system, state),
        q_ref=state.q,
        load=load,
        answer=answer,
        rows=system.rows & state.present[:, None],
        law=law_of(system, s_old, state.present, 0.0, s_old, *by_hand, began.time, stretch),
        stiffen=True,
        frame=state.frame,
        gaps=tie_gaps(system, state, time),
        fields=() if state.spline is None else ((state.spline, state.q[:, :3]),),
        weight=np.where(loose, 0.0, share),
        start=began if system.bears else None,
    )


def loose_points(system: System[Body], state: State[Body]) -> Flags:
    """Return the control points of pieces of a cut thread without any holder, shape `(n,)`.

    No load on such a piece has a reaction. A thread in one piece has no such points; it has no
    equilibrium without a holder.
    """
    spline = system.thread.spline
    if spline.pieces == 1:
        return np.zeros(spline.n, dtype=bool)
    return np.repeat(~system.held_pieces(state.s, state.present), spline.piece_points)


def settle(
    system: System[Body],
    state: State[Body],
    share: float,
    duration: float,
    given: Answer[Body] | None = None,
    began: State[Body] | None = None,
    near: bool = False,
    firm: bool = False,
) -> Step[Body]:
    """Solve for equilibrium at the part `share` of the final loads.

    `given` is the organ's answer; None means that at rest, where the stability of the tissue is
    judged too. `began` is the state at the start of the load step if `state` is on its way; None
    means `state`. Hands act as at the time of `began`. If `near`, corrections of the tissue may not
    be shortened to less than a quarter, or prolonged. Raises `EquilibriumError`, `FarError` if a
    correction is shortened or prolonged, and `StepError` if an unstable thread has to be `firm`.
    """
    step = stand_firm(go_downhill(system, state, share, duration, given, began or state, near), firm)
    return snapped(step, share, duration, began or state) if given is None else step


def stand_firm(step: Step[Body], firm: bool) -> Step[Body]:
    """Return a step to a stable equilibrium of the thread.

    The step is unchanged if the thread is stable. A thread that would buckle moves to a
    neighbouring equilibrium. If none is found, the step is unchanged too. If it has to be `firm`, a
    `StepError` is raised instead, because a folded thread is often the end of too long a way.
    """
    problem, z = step.solution.problem, step.solution.iterate
    if not is_squeezed(step.solution) or would_stay(step.solution, step.new):
        return step
    try:
        solution = let_lie(settle_stretch(solve(problem, aside(problem, z), BOWING), find))
        new = equilibrium_state(replace(step.old, frame=problem.frame), solution)
        if would_stay(solution, new):
            return Step(step.old, new, problem.dt, solution, end_configuration(new, solution), snapped=True)
    except StepError as error:
        log.debug("no other equilibrium of the thread is found: %s", error)
    if firm:
        raise StepError(step.old.time, step.dt, "the thread would buckle, and no stable equilibrium is found")
    return step


def snapped(step: Step[Body], share: float, duration: float, began: State[Body]) -> Step[Body]:
    """Return a step to a stable equilibrium of the tissue.

    The step is unchanged if the tissue is stable by itself. Otherwise the tissue is moved off its
    equilibrium, to one side and then to the other, and goes downhill from there
    (`Snapping.off_saddle`). If it does not go further away, thread or contact stabilise it, and the
    step is unchanged. Otherwise the step is marked as unstable. Raises `SpentError`, and
    `BranchError` on a branch, if all corrections are used up, and `StepError` without a tangent.
    """
    system, answer = step.solution.problem.system, step.solution.problem.answer
    organ = system.organ
    if not isinstance(organ, Snapping):
        return step
    try:
        if organ.holds(answer):
            return step
        sides = organ.off_saddle(answer, step.new.organ)
    except (FactorError, OrganError) as error:
        raise StepError(step.old.time, step.dt, str(error)) from error
    log.info("the tissue alone is unstable at %.4g of the loads: it goes downhill", share)
    for body in sides:
        try:
            there = go_away(system, replace(step.new, organ=body), share, duration, began)
            found = go_downhill(system, there, share, duration, ask_again(system, there, share, duration, began), began)
            stable = organ.holds(found.solution.problem.answer)
        except (SpentError, BranchError):
            raise
        except (CouplingError, FactorError, OrganError) as error:
            log.info("no other equilibrium is found (%s)", error)
            continue
        if stable:
            return replace(found, old=step.old, dt=step.dt, snapped=True, along=step.along)
        if organ.distance(found.new.organ, step.new.organ) < organ.distance(body, step.new.organ):
            return step
    return replace(step, unstable=True)


def go_away(system: System[Body], state: State[Body], share: float, duration: float, began: State[Body]) -> State[Body]:
    """Return the equilibrium that Newton's method reaches from a state that is not one, in the time of
    its load step. Raises `StepError`.
    """
    answer = ask_again(system, state, share, duration, began)
    problem = static_problem(system, state, share, duration, answer, state, began)
    z = where_it_is(problem, state)
    for _ in range(AWAY):
        try:
            return equilibrium_state(state, solve(problem, z))
        except UnfinishedError as error:
            problem, z, failed = error.reached.problem, error.reached.iterate, error
    raise failed


def ask_again(
    system: System[Body], state: State[Body], share: float, duration: float, began: State[Body]
) -> Answer[Body]:
    """Return the answer of the organ at a state in a load step that `began` before."""
    lapse = share * duration - began.time if duration else np.inf
    return ask_organ(system, Equilibrium(lapse), [state, began], duration, share)


def go_downhill(
    system: System[Body],
    state: State[Body],
    share: float,
    duration: float,
    given: Answer[Body] | None,
    began: State[Body],
    near: bool = False,
) -> Step[Body]:
    """Reach equilibrium by rounds of corrections downhill, with every third round by Newton's method.

    Newton's method is faster along a valley. It is the first round beyond the part LIGHT of the loads
    if the organ is linear and nothing touches it. Friction opposes the way from `began`. Arguments as for
    `settle`.
    """
    lapse = max(share * duration - began.time, 0.0) if duration else np.inf
    answer = ask_organ(system, Equilibrium(lapse), [state], duration, share) if given is None else given
    problem = static_problem(system, state, share, duration, answer, began, began, lapse)
    simple = state.time > LIGHT * duration and answer.linear and problem.contact is None and problem.strands is None
    now, down, refits = state, 0 if simple else DOWN, REFITS
    failed = EquilibriumError(state.time, share * duration - state.time, "", "", share, remedy_for(system, state))
    for _ in range(ROUNDS):
        try:
            way = np.sign(now.s - problem.law.s_old)  # the sense of a hold that sticks and has moved
            begin = replace(where_it_is(problem, now), sigma=np.where(now.sigma == 0.0, way, now.sigma))
            solution = solve(replace(problem, near=near), begin, downhill=int(down > 0))
            solution = replace(solution, problem=replace(solution.problem, near=False))
            solution = let_lie(settle_stretch(corrected(solution), find))
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
        problem = static_problem(system, now, share, duration, answer, began, began, lapse)
    raise failed


def further(
    system: System[Body], first: State[Body], old: State[Body], error: StepError
) -> tuple[State[Body], Answer[Body]]:
    """Return the state that the corrections reached before the `error`, on knots that fit it, and
    the organ's answer there.

    The load step began at `first`, and the corrections at `old`. Raises the error itself if the
    corrections were not used up, `LeavingError` if the thread has run out of a hole, a `StepError`
    if it has flown away, and `TogetherError` if holes have met.
    """
    if not isinstance(error, UnfinishedError):
        raise error
    new = put_where(old, error.reached)
    refuse_leaving(system, first, new)
    refuse_flown(system, first, new)
    refuse_together(system, new)
    return fitted(system, new, solved=False)[1], error.reached.problem.answer


def settle_stretch(
    solution: Solution[Body], solve_again: Callable[[Problem[Body], Iterate], Solution[Body]]
) -> Solution[Body]:
    """Solve again until the stretch 1 + T/EA in the law of friction is that of the equilibrium.
    Raises `StepError`.
    """
    for _ in range(TENSIONS):
        problem, z = solution.problem, solution.iterate
        changed = stretched(problem, z, solution.residual)
        change = np.max(np.abs(changed.law.stretch / problem.law.stretch - 1.0), initial=0.0)
        ideal = not (problem.law.rough.any() or problem.law.injected.any())
        if ideal or change <= AT_REST:
            break
        again = solve_again(changed, z)
        solution = replace(again, iterations=solution.iterations + again.iterations)
    return solution


def corrected(solution: Solution[Body]) -> Solution[Body]:
    """Return a solution with at least one correction.

    Without a correction the forces can be just below the tolerance, far above those that Newton's
    method leaves. Works and branches start from these forces. A correction along motions without a
    change of energy is not made, because round-off determines its size. Raises `StepError`.
    """
    if solution.iterations:
        return solution
    z = solution.iterate
    ask_before_correction()
    try:
        _, z = correct(replace(solution.problem, closed=z.pressed, rubbing=z.rubbing), z, solution.residual)
    except SingularError:  # the loads are at a limit point, and the solution is valid as it is
        return solution
    if costs_nothing(solution.problem, force_tolerance(solution.problem, solution.residual), z.q - solution.iterate.q):
        return solution
    again = solve(solution.problem, z)
    return replace(again, iterations=1 + again.iterations)


def refuse_leaving(system: System[Body], old: State[Body], new: State[Body]) -> None:
    """Raise `LeavingError` if the thread has run out of a hole over an end without a holder.

    If the end is held, the thread may return.
    """
    gone = emptied_holds(system, old, new)
    try:
        refuse_held_end(system, old, new, gone)
    except StepError:
        return
    if gone.any():
        places = dict.fromkeys(np.array(hold_names(system))[gone].tolist())
        raise LeavingError(old.time, new.time - old.time, f"the thread runs out at {', '.join(places)}", gone=gone)


def refuse_flown(system: System[Body], old: State[Body], new: State[Body]) -> None:
    """Raise `StepError` if the thread has flown away, where round-off hides the loads on it."""
    scene = np.ptp(old.q[:, :3], axis=0).max() + np.abs(old.q[:, :3]).max()
    if np.abs(new.q[:, :3]).max() > FAR * scene:
        floats = isinstance(system.organ, Floats)
        which, hold = ("its loads, or those of a body without a clamp", "a body") if floats else ("its loads", "an end")
        cause = f"the thread flies away: nothing balances {which}; hold {hold}, or use a smaller load"
        raise StepError(old.time, new.time - old.time, cause)


def let_lie(solution: Solution[Body]) -> Solution[Body]:
    """Solve again with a free thread tied to its new place.

    A free thread can move without a change of energy (`lying_tie`). The tie is a tenth of the last one, and the
    solution is repeated until the tie bears no force. A force that stays is that of loads without
    balance. Each time the error is multiplied by the
    ratio of the tie to the thread's stiffness (the proximal point algorithm: Rockafellar, SIAM J.
    Control Optim. 14, 1976). Raises `StepError`.
    """
    if not solution.problem.mass_factor:
        return solution
    for _ in range(LIES):
        problem, z, spline = solution.problem, solution.iterate, solution.residual.configuration.thread.spline
        fields = ((spline, z.q[:, :3]),) if problem.fields else ()
        problem = replace(problem, q_ref=z.q, fields=fields, mass_factor=0.1 * problem.mass_factor)
        again = find(problem, z)
        solution = replace(again, iterations=solution.iterations + again.iterations)
        way = np.abs(problem.system.thread.momentum(again.iterate.q - z.q)[:, :3]).sum()
        if problem.mass_factor * way <= rounded_force(problem):
            break
    if (force := float(problem.mass_factor * way)) > BALANCED * solution.residual.force_scale:
        cause = f"nothing balances {force:.2g} N of the loads on the thread or on a piece of it"
        raise StepError(problem.time - problem.dt, problem.dt, f"{cause}, which moves away; hold an end, or tie it")
    last = corrected(replace(solution, iterations=0))  # the remaining force does work: a piece may have moved far
    return replace(last, iterations=solution.iterations + last.iterations)


def lying_tie(system: System[Body], state: State[Body]) -> float:
    """Return the tie [1/s²] that holds a free thread at its place; zero for other threads.

    A free thread can move without a change of energy: it is cut, or slides freely in
    all its holes. The tie makes the matrix regular. It is a part of the largest entry of the
    matrix, the stiffness of the shortest span, so that its force is below the tolerance of a solve.
    """
    if not (system.thread.spline.cuts.size or slides_freely(system, state.present)):
        return 0.0
    thread = system.at(state).thread
    stiffness = np.abs(thread.tangent(thread.points(state.q, state.frame), state.N)).max()
    return float(LYING * stiffness / np.abs(thread.mass_band).max())


def put_where(old: State[Body], solution: Solution[Body]) -> State[Body]:
    """Return the state with the thread of an iterate, whether solved or not."""
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
    """Return the state of an equilibrium, at rest. Raises `InversionError`."""
    problem, residual = solution.problem, solution.residual
    new = replace(
        put_where(old, solution),
        time=problem.time,
        v=np.zeros_like(solution.iterate.q),
        organ=accept_organ(solution),
        s_dot=np.zeros_like(solution.iterate.s),
        reaction=reactions(problem, residual.thread),
        stretch=problem.law.stretch,
        by_hand=problem.law.by_hand,
    )
    return with_sense(problem.system, old, new, residual.passage)


def refuse_unbalanced(system: System[Body], state: State[Body], duration: float) -> None:
    """Raise `UnbalancedError` for different dead loads on a thread that can slide in all its holes.

    The thread is refused if its holes cannot bear the difference of the loads. A free end is a load
    of zero. Without friction the tension is constant along the thread. An end that is short
    compared with √(EI/F) can stand across its load and balance another one (the elastica arm scale:
    Bosi, Misseroni, Dal Corso & Bigoni, Proc. R. Soc. A 470, 2014); it is not refused.
    """
    thread, here = system.thread, state.present
    if not may_slide_as_a_whole(system, here) or system.weight.any():
        return
    if system.contact is not None and system.contact.friction:  # friction of strands may balance the loads
        return
    load = np.array([np.linalg.norm(end.force(duration)) for end in system.ends])
    ends = np.array([state.s[here].min() - thread.spline.start, thread.spline.end - state.s[here].max()])
    short = (load > 0.0) & (load * ends**2 < LONG_END**2 * thread.EI)
    borne = largest_load(system, state, load)
    if short.any() or (1.0 - BALANCED) * load.max() <= borne:
        return
    slides = "slides freely in all its holes"
    if borne > load.min():
        slides = f"can slide in all its holes, whose friction bears at most {borne:.4g} N against the smaller load"
    cause = (
        f"the dead loads are unbalanced, {load[0]:.4g} N at the start and {load[1]:.4g} N at the end of a thread that "
        f"{slides}"
    )
    raise UnbalancedError(state.time, duration - state.time, cause)


def largest_load(system: System[Body], state: State[Body], load: Array) -> float:
    """Return the largest dead load [N] that the smaller one can balance through the holes; infinite
    if it is unknown.

    `load` (2,) [N] are the loads at the ends of a thread that slides in the holes, at any angle.

    A hole bears T₂ − T₁ ≤ F₀ + μ N. The strands press on it with N ≤ T₁ + T₂. In a channel ℓ their
    couples, 2 √(EI T) each at most (a long elastica), add 2 (M₁ + M₂)/ℓ. A strand between two holes
    that is short compared with √(EI/T) can press more.
    """
    EI, tension = system.thread.EI, float(load.min())
    order = np.argsort(state.s)[:: 1 if load[0] <= load[1] else -1]
    order = order[(system.rough & state.present)[order]]
    if not state.present.all() or system.own_friction:
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
    """Return whether a thread in one piece slides freely in all its holes and no end of it is held.

    `present` (m,) are its holes. Under equal loads at both ends such a thread slides as a whole
    without a change of energy.
    """
    return may_slide_as_a_whole(system, present) and not (system.rows.any(axis=1) & present & system.rough).any()


def remedy_for(system: System[Body], state: State[Body]) -> str:
    """Return the remedy in the message if no equilibrium is found."""
    if is_tissue_alone(system):
        return OF_TISSUE
    if isinstance(system.organ, Floats):
        return OF_LOOSE_BODY
    return HOLD_IT if may_slide_as_a_whole(system, state.present) else OTHER_WAYS


def may_slide_as_a_whole(system: System[Body], present: Flags) -> bool:
    """Return whether only friction holds a thread in one piece along itself: no end, anchor, tie or hand.

    `present` (m,) are its holes.
    """
    holds = (system.rows.any(axis=1) & present & (~system.may_slide | system.by_hand)).any()
    held = any(end.position(0.0) is not None for end in system.ends)
    return not (holds or held or system.ties or not present.any() or system.thread.spline.cuts.size)


def lightly_loaded(system: System[Body], state: State[Body], share: float, duration: float) -> list[Step[Body]]:
    """Return the steps from the laid thread to its equilibrium under the part LIGHT of the loads.

    A laid thread is not in equilibrium. Its bends draw back through a rough hole as soon as the loads
    allow it, and friction would hold them under larger loads. Loads with a course are those at the
    part LIGHT of the time, light only if they grow from zero. The list is empty if the first load
    step, to the part `share`, is as small, and for a body that only the thread holds, which light
    loads do not bring to rest. It is empty too if the thread has no such equilibrium in all its
    holes and ties, without a snap; it then begins with that load step.
    """
    if share <= LIGHT or state.time > 0.0 or isinstance(system.organ, Floats):
        return []
    try:
        step, gone = accepted(system, settle(system, state, LIGHT, duration), 0)
    except (CouplingError, FactorError) as error:
        log.info(
            "no equilibrium under light loads; if there is friction, it may keep bends of the laid thread: %s", error
        )
        return []
    return [] if gone.any() or step.snapped else [step]


def load_steps(
    system: System[Body],
    state: State[Body],
    share: float,
    duration: float,
) -> Iterator[Step[Body]]:
    """Go on to the part `share` of the loads, in smaller steps if necessary, and yield the steps.

    If `duration` is zero, all loads are those at t = 0 and begin with zero. Raises the errors of
    `go_on`, and `SpentError` after MOST_CORRECTIONS.
    """
    left = iter(range(MOST_CORRECTIONS))

    def count() -> None:
        number = next(left, None)
        if number and number % REPORTED == 0:
            log.info(
                "%d of at most %d corrections so far to %.4g %% of the loads", number, MOST_CORRECTIONS, 100.0 * share
            )
        if number is None:
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
    """Go on from the part `begun` of the loads to the part `share`, and yield the steps.

    The increment is halved if it fails, if a correction of the tissue is shortened to less than a
    quarter or prolonged (both halves then mostly take less time), if the thread flips through a
    hole, or if tissue at finite strain has jumped to another branch. Raises `StepError`,
    `InversionError`, `TogetherError` if holes have met, and `ConstraintError` if a hand has drawn
    the thread out.
    """
    halves = depth < DEEPEST and share > begun  # after a cut the loads do not change
    try:
        # Halves are accepted with an unstable thread, because slack threads remain unstable in smaller parts.
        step = settle(system, state, share, duration, near=halves, firm=halves and depth == 0)
        step, gone = accepted(system, step, depth)
    except LeavingError as error:
        gone = error.gone
    except (StepError, InversionError, TogetherError, FarError) as error:
        if not halves:
            raise without_equilibrium(error, share, remedy_for(system, state)) from error
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
    yield pair_lips(system, step, share, duration)


def accepted(system: System[Body], step: Step[Body], depth: int) -> tuple[Step[Body], Flags]:
    """Return an accepted load step, and the holes that the thread left in it, shape `(holds,)`.

    The step, which has been halved `depth` times, gets the mark whether its tissue snapped. Raises
    `StepError` if the loads must be halved, and `ConstraintError` if a hand has drawn the thread
    out.
    """
    gone = refuse_impossible(system, step)
    return told_to_snap(system, step, depth), gone


def told_to_snap(system: System[Body], step: Step[Body], depth: int) -> Step[Body]:
    """Return the step, marked as snapped if the tissue jumped and the loads cannot be halved any more.

    Tissue at finite strain jumps if it turns a hole too far in one step, as only another branch
    does, or passes an energy barrier. Raises `StepError` if the loads can be halved.
    """
    if step.snapped or not isinstance(system.organ, Snapping):
        return step
    if depth < DEEPEST:
        refuse_turning(system, step.old, step.new)
        if has_jumped(system.organ, step):
            cause = "the tissue jumped over an energy barrier to another branch"
            raise StepError(step.old.time, step.dt, cause)
        return step
    turned = turn_of_holes(system, step.old, step.new).max(initial=0.0) > FARTHEST_TURN
    return replace(step, snapped=bool(turned) or has_jumped(system.organ, step))


def has_jumped(organ: Snapping, step: Step[Body]) -> bool:
    """Return whether tissue at finite strain passed an energy barrier in a step."""
    return organ.has_jumped(step.solution.problem.answer, step.old.organ, step.new.organ)


def without_equilibrium(error: CouplingError, share: float, remedy: str) -> CouplingError:
    """Return the error of a load step, with the `share` of the loads instead of a length in time."""
    if isinstance(error, EquilibriumError) or not isinstance(error, StepError):
        return error
    return EquilibriumError(error.time, error.dt, error.cause, error.piercing, share, remedy)


def refuse_loose(system: System[Body], state: State[Body], share: float, duration: float) -> None:
    """Raise `OutError` if a thread in one piece has left its last hole and no end of it is held."""
    held = any(end.position(0.0) is not None for end in system.ends)
    if not (held or state.present.any() or system.thread.spline.pieces > 1):
        cause = "the thread runs out of its last hole"
        raise OutError(state.time, share * duration - state.time, cause, share=share)


def pair_lips(system: System[Body], step: Step[Body], share: float, duration: float) -> Step[Body]:
    """Return a load step to the equilibrium at which its pairs and its floating bodies are at rest.

    A step pairs the lips as at its start. The equilibrium is solved again if the lips slide on the
    way from the place of their pairs, if their gaps change because an organ at finite strain turns
    them, or if a body that only thread and contact hold is dragged. The equilibria between are no
    part of the way: all works and all friction are those of the way from the start of the load step
    to the last one. Raises `StepError`, also if a strand is then farther than its diameter from the
    place of its forces on the surface, or if the lips slid further than that since the last
    equilibrium.
    """
    out, lapse = [step], share * duration - step.old.time
    while (len(out) <= PAIRINGS and has_slid(system, out[-1], step.old)) or (
        len(out) <= DRIFTS and is_dragged(system, out[-1])
    ):
        now = out[-1].new
        if isinstance(system.organ, Paired):
            now = replace(now, organ=system.organ.paired_nearer(out[-1].old.organ, now.organ))
        given = ask_again(system, now, share, duration, step.old)
        out.append(replace(settle(system, now, share, duration, given, step.old), unstable=step.unstable))
    off = misplaced(system, out[-1].new, step.old) if len(out) > PAIRINGS else 0.0  # else it is less than MISPLACED
    if off > system.thread.section.diameter:
        cause = f"a strand finds no place on the surface: it is {1e3 * off:.2g} mm from where its forces act"
        raise OutError(step.old.time, lapse, cause, "", share, "pull less, or take firmer tissue")
    if len(out) > PAIRINGS and (way := slid(system, out[-1])) > system.thread.section.diameter:
        cause = f"pressed surfaces slide to and fro on one another by {1e3 * way:.2g} mm"
        remedy = "pull less, give the contact friction, or take firmer tissue"
        raise EquilibriumError(step.old.time, lapse, cause, "", share, remedy)
    if is_dragged(system, out[-1]):
        cause = "a body of the organ that no clamp holds drifts on: neither thread nor contact stops it"
        remedy = "clamp it, stitch it, or let a contact stop it"
        if slides_back(system, out):
            cause = "surfaces of a body that no clamp holds slide to and fro on one another"
            remedy = "give the contact friction, clamp the body, or take finer cells"
        raise EquilibriumError(step.old.time, lapse, cause, "", share, remedy)
    made = replace(out[-1].solution, iterations=sum(each.solution.iterations for each in out))
    return replace(
        out[-1], old=step.old, dt=step.dt, solution=made, snapped=any(each.snapped for each in out), along=step.along
    )


def slides_back(system: System[Body], steps: list[Step[Body]]) -> bool:
    """Return whether surfaces are closer to their places two equilibria before than to the last ones, as
    with pairs that alternate.
    """
    earlier, before, last = (system.organ.lips(step.new.organ)[2] for step in steps[-3:])
    return bool(np.abs(last - earlier).max(initial=0.0) < np.abs(last - before).max(initial=0.0))


def has_slid(system: System[Body], step: Step[Body], origin: State[Body]) -> bool:
    """Return whether the facing pairs after a step differ from those in it, of pressed lips, or of
    thread and organ.
    """
    diameter = system.thread.section.diameter
    return misplaced(system, step.new, origin) > MISPLACED * diameter or slid(system, step) > PAIRED * diameter


def slid(system: System[Body], step: Step[Body]) -> float:
    """Return how far pressed lips slid in a step, or how far tissue at finite strain opened them [m]."""
    seen = slice(2, 3) if step.solution.problem.answer.linear else slice(0, 3, 2)
    before, after = (system.organ.lips(state.organ) for state in (step.old, step.new))
    if not after[1].any():
        return 0.0
    return max(float(np.abs(b - a).max(initial=0.0)) for a, b in zip(before[seen], after[seen], strict=True))


def is_dragged(system: System[Body], step: Step[Body]) -> bool:
    """Return whether a body that only thread and contact hold has not come to rest in a step."""
    organ = system.organ
    return isinstance(organ, Floats) and organ.dragged(step.new.organ) > DRAGGED
