"""The beginning of a piercing, in two stages, both between two steps.

1. *The thread is drawn in.* At its closest point to the hole the thread can be off by a gap and an
angle. Both are closed as in a step of backward Euler with every velocity held: the inertia / Δt²
and the stiffness of thread and organ determine the way. Forces in balance with the inertia stay in
balance, so that nothing moves without a gap. The work is that of the hand that draws the thread in,
and counts as external work. 2. *An inelastic impulse.* The velocities jump by M⁻¹Φ_qᵀj on the
thread and M_o⁻¹YᵀΦ_yᵀj on the organ, so that the hole and the thread in it have the same velocity
after it. The impulses are equal and opposite, so that momentum is conserved. The lost kinetic
energy is ½Δvᵀ M Δv ≥ 0 and counts as numerical dissipation. The impulse has no friction and no
contact: lips that it drives together are stopped by the next step.
"""

from dataclasses import replace

import numpy as np

from coupling.answer import all_holds, pad_compliance
from coupling.arrays import Array, Flags
from coupling.errors import FormingError, StepError
from coupling.integrators import BackwardEuler
from coupling.interfaces import Body
from coupling.joins.contact import NO_FORCES, first_sets
from coupling.kernels.border import Border
from coupling.kernels.bordered import PHI, S, linearise, newton_directions
from coupling.kernels.constraints import Passage, passage, phi, site_force, spread, thread_force
from coupling.kernels.friction import Joints
from coupling.reports.audit import initial_energies
from coupling.run.events import Event
from coupling.step.diagnosis import refuse_faults
from coupling.step.newton import Iterate, Problem
from coupling.step.packets import with_holes
from coupling.step.sliding import law_of
from coupling.step.solver import find
from coupling.step.stepping import accept_organ, riding, sense, tie_gaps
from coupling.system import State, System, forgetful
from thread.vectors import dot

NEAR = 10.0  # diameters: a thread further away from a hole is not drawn in
STEEPEST = 0.5  # cosine of the largest angle (60°) between a thread that is drawn in and a directed hole
SAMPLES = 8  # points on each span for the start of the search for the closest point
QUICKER = 4  # times that the time in which a thread is drawn into a hole is divided by four, at most
CORRECTIONS = 50  # of that search, at most


def begin_piercing(
    system: System[Body], state: State[Body], k: int, dt: float, given: float
) -> tuple[State[Body], Event]:
    """Put the thread into hole `k`; return the state with it, and the event with its gap, work and loss.

    Raises `FormingError`, `ConstraintError`.
    """
    name, y = system.piercings[k].name, state.y[k]
    s = abscissa(system, state, k, given)
    placed = replace(state, s=np.where(np.arange(system.holds) == k, s, state.s))
    system, placed = with_holes(system, placed, placed.present | (np.arange(system.holds) == k))
    at = system.passage_of(placed)
    gap = float(np.linalg.norm(at.P[k] - y[:3]))
    angle = misdirection(system, at, y, k)
    refuse_far(system, state.time, name, gap, angle)
    within = with_hole(system, placed, at, k)
    refuse_faults(system, within)
    closed = draw_in(system, within, k, dt)
    system = system.at(closed)
    after, impulse = strike(system, closed, k)
    energies = [initial_energies(system.at(x), x) for x in (state, closed, after)]
    work = sum(e.elastic * sign for e, sign in zip(energies[:2], (-1.0, 1.0), strict=True))
    loss = energies[1].kinetic - energies[2].kinetic
    return after, Event(state.time, "begins", name, float(after.s[k]), gap, angle, work, loss, impulse)


def abscissa(system: System[Body], state: State[Body], k: int, given: float) -> float:
    """Return the abscissa at which the thread enters hole `k` [m]: the given one, or that closest to the hole.

    It lies between the neighbours of the hole on the thread.
    """
    low, high = neighbours(system, state, k)
    if np.isnan(given):
        return nearest_abscissa(system, state, state.y[k, :3], low, high)
    spline = system.thread.spline
    held_end = not system.piercings[k].slides and given in (spline.start, spline.end)
    if not (low < given < high or held_end):
        cause = f"s = {given} m is not between its neighbours on the thread, at {low:.6g} and {high:.6g} m"
        raise FormingError(state.time, system.piercings[k].name, f"{cause}; correct s or the order of the piercings")
    return given


def neighbours(system: System[Body], state: State[Body], k: int) -> tuple[float, float]:
    """Return the abscissae of the present piercings before and after the k-th, or of the thread's ends [m]."""
    spline, p = system.thread.spline, len(system.piercings)
    here = state.present[:p]
    low, high = state.s[:k][here[:k]], state.s[k + 1 : p][here[k + 1 :]]
    return float(low.max(initial=spline.start)), float(high.min(initial=spline.end))


def nearest_abscissa(system: System[Body], state: State[Body], x: Array, low: float, high: float) -> float:
    """Return the abscissa of the thread's closest point to the point `x` (3,), between `low` and `high` [m].

    Newton's method on ½|P − x|² starts from the closest of many samples. It stays between the
    samples before and after it.
    """
    spline = system.thread.spline
    count = SAMPLES * (len(spline.breaks) - 1)
    samples = np.linspace(low, high, count + 1)
    distance = np.linalg.norm(spline.curve(state.q[:, :3], samples)[:, 0] - x, axis=1)
    best = int(np.argmin(distance))
    left, right, s = samples[max(best - 1, 0)], samples[min(best + 1, count)], samples[best]
    for _ in range(CORRECTIONS):
        P, T, K, _ = spline.curve(state.q[:, :3], [s])[0]
        slope, curvature = (P - x) @ T, max(T @ T + (P - x) @ K, 0.1 * (T @ T))
        before, s = s, float(np.clip(s - slope / curvature, left, right))
        if s == before:
            break
    return float(s)


def misdirection(system: System[Body], at: Passage, y: Array, k: int) -> float:
    """Return the angle between the thread and the axis of hole `k`, in either sense [rad]; 0 for a
    hole without direction.
    """
    if not system.piercings[k].directed:
        return 0.0
    normal, T = np.cross(y[3:6], y[6:]), at.T[k]
    return float(np.arctan2(np.linalg.norm(np.cross(T, normal)), abs(T @ normal)))


def refuse_far(system: System[Body], time: float, name: str, gap: float, angle: float) -> None:
    """Raise `FormingError` if the thread is too far from the hole, or too oblique to it."""
    allowed = NEAR * system.thread.section.diameter
    if not gap <= allowed:
        cause = f"the thread passes {gap:.3g} m away from the hole, allowed are {allowed:.3g} m ({NEAR:g} diameters)"
        raise FormingError(time, name, f"{cause}; lead the thread to the hole, or let the piercing begin later")
    if np.cos(angle) < STEEPEST:
        cause = f"the thread makes an angle of {np.degrees(angle):.0f}° with the hole's direction, allowed are 60°"
        raise FormingError(time, name, f"{cause}; lead the thread in more directly, or set direction to free")


def with_hole(system: System[Body], state: State[Body], at: Passage, k: int) -> State[Body]:
    """Return the state with hole `k` active but not yet closed."""
    this = np.arange(system.holds) == k
    return replace(
        forgetful(state),
        present=state.present | this,
        sense=np.where(this, sense(at, state.y), state.sense),
        sigma=np.where(this, np.where(system.may_slide & ~system.rough, 1.0, 0.0), state.sigma),
        s_dot=np.where(this, 0.0, state.s_dot),
    )


def draw_in(system: System[Body], state: State[Body], k: int, dt: float) -> State[Body]:
    """Draw the thread into hole `k`; return the state with Φ = 0 there, at the abscissa of the hole.

    Velocities do not change. If the thread would buckle on its way, it is drawn in within a shorter
    time, by its inertia. Raises `FormingError`.
    """
    for shorter in range(QUICKER + 1):
        problem = closing_problem(system, state, k, BackwardEuler(dt / 4**shorter))
        sigma = np.where(problem.law.may_slide, state.sigma, 0.0)
        pressed, rubbing = first_sets(problem.contact, system, state)
        guess = Iterate(state.q, state.N, state.s, state.lam, state.y, sigma, pressed=pressed, rubbing=rubbing)
        try:
            solution = find(problem, guess)
            break
        except StepError as error:
            cause = f"the thread cannot be drawn in ({error})"
    else:
        raise FormingError(state.time, system.piercings[k].name, cause)
    z, organ = solution.iterate, accept_organ(solution)
    lam = np.where(problem.rows, z.lam, 0.0)
    frame = system.thread.transport_frame(state.frame, z.q)
    here = {**riding(solution.residual), "drive": state.drive}  # the drive of the motion, not of this problem
    return replace(state, q=z.q, N=z.N, s=z.s, lam=lam, y=z.y, organ=organ, frame=frame, solved=None, **here)


def closing_problem(system: System[Body], state: State[Body], k: int, scheme: BackwardEuler) -> Problem[Body]:
    """Return the problem of a step that only closes hole `k`: all forces of the state are loads on it.

    The abscissa of the hole is held. The other abscissae follow their laws, or are held if knots
    travel. Lips do not cross.
    """
    thread = system.thread
    at = system.passage_of(state)
    balanced = thread.gradient(thread.points(state.q, state.frame))
    balanced[:, :3] -= spread(thread_force(at, state.lam, state.y), at, thread.n)
    factor = scheme.a + scheme.d * thread.damping
    sites = slice(len(system.piercings))
    y, f_y = state.y[sites].ravel(), site_force(at, state.lam, state.y)[sites].ravel()
    others = state.present & (np.arange(system.holds) != k)
    others &= not thread.travels  # with travelling knots their balance contains the inertia: they are held
    return Problem(
        system=system,
        time=state.time,
        dt=scheme.dt,
        mass_factor=factor,
        q_ref=state.q,
        load=balanced,
        answer=system.organ.displace(scheme, state.organ, y, f_y),
        rows=system.rows & state.present[:, None],
        law=law_of(system, state.s, others, system.epsilon * scheme.a, state.s, stretch=state.stretch),
        frame=state.frame,
        gaps=tie_gaps(system, state, state.time),
        weight=0.0,
    )


def strike(system: System[Body], state: State[Body], k: int) -> tuple[State[Body], tuple[float, float, float]]:
    """Apply the impulse after which thread and organ move together in hole `k`; return the state
    after it and the impulse [N s].

    The impulse minimises ½Δvᵀ M Δv of thread and organ under dΦ/dt = 0 in the hole, with dΦ/dt
    unchanged in the others. An organ without mass takes no impulse: its holes move with the thread.
    """
    answer = system.organ.impulse(state.organ)
    if answer is None:
        return state, (0.0, 0.0, 0.0)
    this = np.arange(system.holds) == k
    at, p = passage(system.thread.spline, state.q, state.s), len(system.piercings)
    rates = np.zeros((system.holds, 6))
    rates[k, PHI] = np.where(system.rows[k], constraint_rate(system, state, at, answer.y_free)[k], 0.0)
    slides = np.where(this, system.may_slide, (state.sigma != 0.0) & ~system.of_ties)
    border, in_force = impact_border(system, state, at, slides), state.present[system.strands].all(axis=1)
    joints = Joints(system.strands[in_force], np.zeros((0, 2), dtype=np.intp), 1.0)
    M, none = system.hold_still(system.thread.mass_band.copy()), np.zeros_like(state.q)
    residuals, joined = (none, rates, np.zeros_like(state.y)), (joints, np.zeros(system.holds))
    dv, dz = newton_directions(M, system.held, border, pad_compliance(system, answer.C), at, [residuals], joined)[0]
    j, s_dot = dz[:, PHI], state.s_dot + np.where(slides, dz[:, S], 0.0)
    organ = answer.accept(site_force(at, j, state.y)[:p].ravel(), NO_FORCES)
    sigma = np.where(this & system.rough, np.sign(s_dot), state.sigma)
    x, y, z = (float(value) for value in j[k, :3])
    return replace(state, v=state.v + dv, s_dot=s_dot, sigma=sigma, organ=organ), (x, y, z)


def constraint_rate(system: System[Body], state: State[Body], at: Passage, y_dot: Array) -> Array:
    """Return dΦ/dt of a thread that does not slide, with the velocities `y_dot` (9p,) of the sites,
    shape `(m, 5)` [m/s, 1/s].
    """
    moving = passage(system.thread.spline, state.v, state.s)
    dy = all_holds(system, y_dot)
    dy[len(system.piercings) :] = 0.0
    out = phi(moving, np.zeros_like(state.lam), state.y)
    out[:, :3] = moving.P - dy[:, :3]
    out[:, 3] += dot(at.T, dy[:, 3:6])
    out[:, 4] += dot(at.T, dy[:, 6:])
    return out


def impact_border(system: System[Body], state: State[Body], at: Passage, slides: Flags) -> Border:
    """Linearise the holds for an impulse: the thread slides freely where `slides` is True, and
    sticks elsewhere.
    """
    none = np.zeros((system.holds, 5))
    law = law_of(system, state.s, state.present, system.epsilon, state.s)
    law = law._replace(rough=np.zeros(system.holds, dtype=bool))
    rows = system.rows & state.present[:, None]
    return linearise(law, slides.astype(np.float64), rows, at, none, state.y)
