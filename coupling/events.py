"""What happens to piercings: they begin and end at their times, the thread leaves them, slips or sticks in them.

A piercing begins and ends between two steps: at the first end of a step that reaches its time. All other events bear
the time of the end of the step in which they were found, at most one step late.

A piercing begins in two strokes, both between two steps.

1. *The thread is drawn in.* Where it passes nearest to the hole it may be off by a gap and an angle. Both are closed as
   a step of backward Euler would close them, with every velocity held: inertia / Δt² and stiffness of thread and organ
   share the way. What had been in balance with the inertia stays so, hence without a gap nothing moves. The work
   is that of whoever draws the thread in, and counts as external work.
2. *An inelastic impulse.* The velocities jump by M⁻¹Φ_qᵀj on the thread and M_o⁻¹YᵀΦ_yᵀj on the organ, such that the
   hole and the thread in it move together from then on: equal and opposite, so that momentum is kept. The kinetic
   energy lost is ½Δvᵀ M Δv ≥ 0, and counts as numerical dissipation. There is no friction in the impulse, nor
   contact: lips that it drives together are stopped by the next step.

An end of a piercing changes neither positions nor velocities. What the compliance that the spline lacks there stored
is let go, and counts as numerical dissipation.
"""

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Literal

import numpy as np

from coupling.audit import Energies, initial_energies
from coupling.border import NINE, PHI, Border, S, direction, linearise, without
from coupling.constraints import (
    Array,
    Passage,
    bare_passage,
    dot,
    held_energy,
    phi,
    site_force,
    spread,
    thread_force,
)
from coupling.contact import contact_at, first_pressed
from coupling.diagnosis import refuse_faults
from coupling.errors import CouplingError, FormingError, StepError
from coupling.interfaces import JumpingOrgan, OrganOperator
from coupling.newton import Iterate, Problem
from coupling.scheme import BackwardEuler
from coupling.sliding import law_of, linearise_law
from coupling.stepping import Step, all_holds, found, padded, release, sense
from coupling.system import Flags, State, System, forgetful

Kind = Literal["begins", "ends", "leaves", "slips", "sticks", "halved", "knots"]

NEAR = 10.0  # diameters: a thread that passes a hole no nearer than this is not drawn in
STEEPEST = 0.5  # cosine of the angle between thread and directed hole (60°) beyond which it is not turned in
ON_TIME = 1e-9  # of a step: a time this near the end of a step is that of its end
SAMPLES = 8  # places on each span at which the search for the nearest one begins
CORRECTIONS = 50  # of that search, at most


@dataclass(frozen=True)
class Event:
    """One event.

    `time` [s]; `piercing` by name, empty for a halved step and for other knots; `s` [m]. Of a piercing that begins:
    `gap` [m] and `angle` [rad] that were closed, `work` [J] done in closing them, `loss` [J] of kinetic energy and
    `impulse` (3,) [N s] of the hole on the thread. Of other knots: `control_points` after it, `loss` and `impulse`,
    what the change cost of the thread's energy and momentum. `work` − `loss` is what the event changed of kinetic plus
    elastic energy.
    """

    time: float
    kind: Kind
    piercing: str = ""
    s: float = float("nan")
    gap: float = 0.0
    angle: float = 0.0
    work: float = 0.0
    loss: float = 0.0
    impulse: tuple[float, float, float] = (0.0, 0.0, 0.0)
    control_points: int = 0

    @property
    def energy(self) -> float:
        """Change of kinetic and elastic energy [J]."""
        return self.work - self.loss


# -- found in a step -------------------------------------------------------------------------------------------------


def noticed(system: System, old: State, taken: list[Step]) -> list[Event]:
    """Events in the steps taken from `old`, in the order of their times."""
    states = [old, *(step.new for step in taken)]
    out = [event for before, after in pairwise(states) for event in changes(system, before, after)]
    if len(taken) > 1:
        out.append(Event(taken[-1].new.time, "halved"))
    return out


def changes(system: System, old: State, new: State) -> list[Event]:
    """Holes left, and stitches that began to slip or to stick, between two states."""
    out = []
    for k, piercing in enumerate(system.piercings):
        if old.present[k] and not new.present[k]:
            out.append(Event(new.time, "leaves", piercing.name, nearer_end(system, float(new.s[k]))))
        elif new.present[k] and system.rough[k] and (old.slip[k] == 0.0) != (new.slip[k] == 0.0):
            kind: Kind = "sticks" if new.slip[k] == 0.0 else "slips"
            out.append(Event(new.time, kind, piercing.name, float(new.s[k])))
    return out


def nearer_end(system: System, s: float) -> float:
    """The end of its piece of thread by which a hole at `s` was left [m]."""
    spline = system.thread.spline
    start, end = spline.piece_ends[spline.piece_of(s) + np.arange(2)]
    return float(start if s - start < end - s else end)


# -- at a time -------------------------------------------------------------------------------------------------------


def scheduled(system: System, earlier: float, state: State, dt: float, given: Array) -> tuple[State, list[Event]]:
    """The state after every piercing that ends or begins later than `earlier` [s] and not after the state's time.

    `dt` [s] is the step; `given` (p,) [m] the abscissae of piercings that begin, NaN where the thread's nearest place
    is taken. Raises `FormingError`, `ConstraintError`.
    """
    out = []
    for k, piercing in enumerate(system.piercings):
        if state.present[k] and is_due(piercing.ends, earlier, state.time, dt):
            let_go = float(held_energy(system.passage(state.q, state.s), state.lam, state.y)[k])
            out.append(Event(state.time, "ends", piercing.name, float(state.s[k]), loss=let_go))
            state = release(state, np.arange(system.holds) == k)
    for k, piercing in enumerate(system.piercings):
        if not state.present[k] and is_due(piercing.begins, earlier, state.time, dt):
            state, event = begun(system, state, k, dt, float(given[k]))
            out.append(event)
    return state, out


def is_due(time: float, earlier: float, now: float, dt: float) -> bool:
    """Whether a time lies after `earlier` and not after `now` [s]."""
    return earlier < time - ON_TIME * dt <= now


def booked(system: System, energies: Energies, state: State, events: list[Event]) -> Energies:
    """The audit after events: what was done to draw the thread in is external work, the impulse's loss numerical."""
    if not events:
        return energies
    now = initial_energies(system, state)
    return replace(
        energies,
        kinetic=now.kinetic,
        elastic_thread=now.elastic_thread,
        elastic_tissue=now.elastic_tissue,
        external_work=energies.external_work + sum(event.work for event in events),
        numerical_dissipation=energies.numerical_dissipation + sum(event.loss for event in events),
    )


# -- a piercing begins -----------------------------------------------------------------------------------------------


def begun(system: System, state: State, k: int, dt: float, given: float) -> tuple[State, Event]:
    """The state with the thread in hole `k`, and what it took. Raises `FormingError`, `ConstraintError`."""
    name, y = system.piercings[k].name, state.y[k]
    s = abscissa(system, state, k, given)
    placed = replace(state, s=np.where(np.arange(system.holds) == k, s, state.s))
    at = system.passage(placed.q, placed.s)
    gap = float(np.linalg.norm(at.P[k] - y[:3]))
    angle = misdirection(system, at, y, k)
    refuse_far(system, state.time, name, gap, angle)
    within = with_hole(system, placed, at, k)
    refuse_faults(system, within)
    closed = drawn_in(system, within, k, dt)
    after, impulse = struck(system, closed, k)
    energies = [initial_energies(system, x) for x in (state, closed, after)]
    work = sum(e.elastic * sign for e, sign in zip(energies[:2], (-1.0, 1.0), strict=True))
    loss = energies[1].kinetic - energies[2].kinetic
    return after, Event(state.time, "begins", name, float(after.s[k]), gap, angle, work, loss, impulse)


def jumping(system: System) -> JumpingOrgan:
    """The organ, if it can take a jump. Raises `CouplingError`."""
    if not isinstance(system.organ, JumpingOrgan):
        raise CouplingError(
            f"no piercing can begin in an organ of type {type(system.organ).__name__}: it takes no jump"
        )
    return system.organ


def abscissa(system: System, state: State, k: int, given: float) -> float:
    """Where the thread enters hole `k` [m]: as given, else nearest to the hole; between the piercings beside it."""
    low, high = between(system, state, k)
    if np.isnan(given):
        return nearest(system, state, state.y[k, :3], low, high)
    spline = system.thread.spline
    held_end = not system.piercings[k].slides and given in (spline.start, spline.end)
    if not (low < given < high or held_end):
        cause = f"s = {given} m does not lie between its neighbours on the thread, at {low:.6g} and {high:.6g} m"
        raise FormingError(state.time, system.piercings[k].name, f"{cause}; correct s or the order of the piercings")
    return given


def between(system: System, state: State, k: int) -> tuple[float, float]:
    """Abscissae of the piercings present before and after the k-th, or the thread's ends [m]."""
    spline, p = system.thread.spline, len(system.piercings)
    here = state.present[:p]
    low, high = state.s[:k][here[:k]], state.s[k + 1 : p][here[k + 1 :]]
    return float(low.max(initial=spline.start)), float(high.min(initial=spline.end))


def nearest(system: System, state: State, x: Array, low: float, high: float) -> float:
    """Abscissa of the thread's nearest place to the point `x` (3,), between `low` and `high` [m].

    The nearest of many samples, then Newton on ½|P − x|², kept between the samples beside it.
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


def misdirection(system: System, at: Passage, y: Array, k: int) -> float:
    """Angle between the thread and the axis of hole `k`, whichever way it passes [rad]; 0 where none is imposed."""
    if not system.piercings[k].directed:
        return 0.0
    normal, T = np.cross(y[3:6], y[6:]), at.T[k]
    return float(np.arctan2(np.linalg.norm(np.cross(T, normal)), abs(T @ normal)))


def refuse_far(system: System, time: float, name: str, gap: float, angle: float) -> None:
    """Raise `FormingError` where the thread is too far from the hole or too steep to it."""
    allowed = NEAR * system.thread.section.diameter
    if not gap <= allowed:
        cause = f"the thread passes {gap:.3g} m away from the hole, allowed are {allowed:.3g} m ({NEAR:g} diameters)"
        raise FormingError(time, name, f"{cause}; lead the thread to the hole, or let it begin later")
    if np.cos(angle) < STEEPEST:
        cause = f"the thread makes an angle of {np.degrees(angle):.0f}° with the hole's direction, allowed are 60°"
        raise FormingError(time, name, f"{cause}; lead it in more directly, or set direction to free")


def with_hole(system: System, state: State, at: Passage, k: int) -> State:
    """The state with hole `k` in force, not yet met."""
    this = np.arange(system.holds) == k
    return replace(
        forgetful(state),
        present=state.present | this,
        sense=np.where(this, sense(at, state.y), state.sense),
        slip=np.where(this, np.where(system.may_slide & ~system.rough, 1.0, 0.0), state.slip),
        s_dot=np.where(this, 0.0, state.s_dot),
    )


def drawn_in(system: System, state: State, k: int, dt: float) -> State:
    """The state with Φ = 0 in hole `k`, entered at its abscissa; velocities are kept. Raises `FormingError`."""
    scheme = BackwardEuler(dt)
    operator = system.organ.operator(scheme.a, scheme.d)
    problem = closing(system, state, k, scheme, operator)
    slip, pressed = np.where(problem.law.may_slide, state.slip, 0.0), first_pressed(problem.contact, system, state)
    guess = Iterate(state.q, state.N, state.s, state.lam, state.y, slip, pressed=pressed)
    try:
        solution = found(problem, guess)
    except StepError as error:
        raise FormingError(state.time, system.piercings[k].name, f"the thread cannot be drawn in ({error})") from error
    z = solution.iterate
    # By the change alone: the organ's own forces are still those of holes that ended at this very moment.
    forces = site_force(system.passage(state.q, state.s), state.lam, state.y)
    change = (site_force(solution.residual.passage, z.lam, z.y) - forces)[: len(system.piercings)].ravel()
    organ = jumping(system).moved(state.organ, operator, state.organ.f_y + change, solution.p)
    lam = np.where(problem.rows, z.lam, 0.0)
    frame = system.thread.carried(state.frame, z.q)
    return replace(state, q=z.q, N=z.N, s=z.s, lam=lam, y=z.y, organ=organ, frame=frame)


def closing(system: System, state: State, k: int, scheme: BackwardEuler, operator: OrganOperator) -> Problem:
    """The step that moves nothing but what hole `k` asks: all forces of the state are loads on it.

    The hole's own abscissa is held, the others follow their laws; lips do not cross.
    """
    thread = system.thread
    at = system.passage(state.q, state.s)
    balanced = thread.gradient(thread.points(state.q, state.frame))
    balanced[:, :3] -= spread(thread_force(at, state.lam, state.y), at, thread.n)
    factor = scheme.a + scheme.d * thread.damping
    f_y = site_force(at, state.lam, state.y).ravel()
    C, contact = padded(system, operator.C), contact_at(system, state, operator, f_y)
    y_free = state.y - (C @ f_y).reshape(-1, NINE)
    if contact is not None:
        y_free -= (system.organ.contact_forces(state.organ) @ contact.C_cy).reshape(-1, NINE)
    others = state.present & (np.arange(system.holds) != k)
    return Problem(
        system=system,
        time=state.time,
        dt=scheme.dt,
        inertia=factor * thread.mass_band,
        mass_factor=factor,
        q_ref=state.q,
        load=balanced,
        y_free=y_free,
        C=C,
        rows=system.rows & state.present[:, None],
        law=law_of(system, state.s, others, system.epsilon * scheme.a, state.s),
        frame=state.frame,
        contact=contact,
    )


def struck(system: System, state: State, k: int) -> tuple[State, tuple[float, float, float]]:
    """The state after the impulse that makes thread and organ move together in hole `k`, and the impulse [N s].

    Minimises ½Δvᵀ M Δv of thread and organ under dΦ/dt = 0 in the hole, unchanged in the others. An organ without mass
    takes no impulse: its holes go with the thread.
    """
    mobility = jumping(system).site_mobility()
    if mobility is None:
        return state, (0.0, 0.0, 0.0)
    this = np.arange(system.holds) == k
    at, p = bare_passage(system.thread.spline, state.q, state.s), len(system.piercings)
    rates = np.zeros((system.holds, 6))
    rates[k, PHI] = np.where(system.rows[k], constraint_rate(system, state, at)[k], 0.0)
    slides = np.where(this, system.may_slide, state.slip != 0.0)
    border = impact(system, state, at, slides)
    M, none = system.hold_still(system.thread.mass_band.copy()), np.zeros_like(state.q)
    dv, dz = direction(M, system.held, border, padded(system, mobility), at, none, rates, np.zeros_like(state.y))
    j, s_dot = dz[:, PHI], state.s_dot + np.where(slides, dz[:, S], 0.0)
    organ = jumping(system).kicked(state.organ, site_force(at, j, state.y)[:p].ravel())
    slip = np.where(this & system.rough, np.sign(s_dot), state.slip)
    x, y, z = (float(value) for value in j[k, :3])
    return replace(state, v=state.v + dv, s_dot=s_dot, slip=slip, organ=organ), (x, y, z)


def constraint_rate(system: System, state: State, at: Passage) -> Array:
    """dΦ/dt of a thread that does not slide, shape `(m, 5)` [m/s, 1/s]."""
    moving = bare_passage(system.thread.spline, state.v, state.s)
    dy = all_holds(system, jumping(system).site_velocities(state.organ))
    dy[len(system.piercings) :] = 0.0
    out = phi(moving, np.zeros_like(state.lam), state.y)
    out[:, :3] = moving.P - dy[:, :3]
    out[:, 3] += dot(at.T, dy[:, 3:6])
    out[:, 4] += dot(at.T, dy[:, 6:])
    return out


def impact(system: System, state: State, at: Passage, slides: Flags) -> Border:
    """The holds as an impulse meets them: the thread slides freely where `slides`, else not at all."""
    none = np.zeros((system.holds, 5))
    law = replace(
        law_of(system, state.s, state.present, system.epsilon, state.s), rough=np.zeros(system.holds, dtype=bool)
    )
    border = linearise(at, none, state.y)
    linearise_law(border, law, slides.astype(np.float64), at, none, state.y)
    return without(border, ~(system.rows & state.present[:, None]))
