"""The full Newton method on the condensed monolithic system of one implicit step, with the
constraints at its end.

    inertia (q − q_ref) + ∂E/∂q − F − Φ_qᵀλ = 0        thread
    law of sliding                                     one per hold
    Φ(q, s, y) = 0                                     five per hold
    y − y_free − C Φ_yᵀλ = 0                           organ, exactly condensed

If lips of a wound touch, y_free and C are those of the organ with these pairs closed
(`coupling.joins.contact`). All second-order terms are included. The axial force at each quadrature
point is a separate iterate (mixed integration points, Magisano, Leonetti & Garcea 2017): the plain
Newton method diverges at the stretch-to-inertia ratio of a real suture.
"""

from collections import Counter
from collections.abc import Callable, Container
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import Any, Generic

import numpy as np

from coupling.answer import all_holds, pad_compliance
from coupling.arrays import Array, Flags, Indices
from coupling.calls import ask_before_correction
from coupling.errors import FarError, StepError
from coupling.interfaces import Answer, Body
from coupling.joins.contact import (
    NO_FORCES,
    Contact,
    closing_forces,
    condense,
    contact_of,
    find_pressed,
    find_sets,
    first_of,
    is_lawful,
    misfits,
)
from coupling.joins.rubbing import NO_PAIRS, Rubbing
from coupling.joins.strands import Strands, Touch, under
from coupling.kernels.border import NINE, Border, site_residuals, stiffen_holds
from coupling.kernels.bordered import PHI, S, SingularError, Y, linearise, newton_directions
from coupling.kernels.constraints import LOCAL, Passage, phi, pressing_force, site_force, spread, thread_force
from coupling.kernels.friction import Law, Ruled
from coupling.kernels.iteration import (
    ALONG,
    FORCE_TOLERANCE,
    MARGIN,
    RETURNS,
    force_rounded,
    holds_solved,
    share,
    share_between,
)
from coupling.step.configuration import GAP_TOLERANCE, Configuration, evaluate_thread
from coupling.step.sliding import admissible_sigma, driven, ruled, with_own_laws
from coupling.step.tension import stretches_at
from coupling.system import State, System
from thread.errors import ThreadError
from thread.frames import Frame
from thread.kernels.travel import Field, Ride
from thread.placed import Placed
from thread.riding import field_of, ride, ride_of, with_riding_force, with_tie
from thread.spline import Spline
from thread.thread import Points
from tissue.errors import OrganError

MAX_ITERATIONS = 25  # for one active set of friction and contact
MAX_SETS = 20  # plus one for every pair of lips that may touch
WAYS = 6  # digits for the comparison of the directions of slip
LONGEST_MOVE = 0.01  # of the thread's length; a longer Newton correction is shortened
RAN_AWAY = "a force is not finite: the iteration ran away, or a load is not a number"
STICK_OR_SLIP = "stick and slip of the friction alternate without end"
TOUCH_OR_OPEN = "friction's or the lips' active sets alternate without end"
NO_GAPS = np.zeros((0, 3))


@dataclass(frozen=True)
class Problem(Generic[Body]):
    """The problem of one step.

    - `time` [s]: at its end; `dt` [s].
    - `mass_factor` [1/s²], `q_ref` (n, c): the inertia and viscous force is mass_factor·M (q −
      q_ref).
    - `load` (n, c) [N, with twist N m]; `answer`: the organ's.
    - `rows` (m, 5): active constraints; `law`: the law of sliding.
    - `stiffen`: whether the constraints' own stiffness is added to the thread's band; needed
      without inertia (an exact row operation).
    - `frame`: that at the start of the step; None without twist.
    - `closed` (k,), `rubbing`: pairs of lips that are held closed under any force, and their
      friction.
    - `gaps` (t, 3) [m]: gaps between the strands of every tie.
    - `fields`: if knots travel, earlier curves on their own splines with control values (n, 3) [m],
      whose sum replaces `q_ref`; empty if `q_ref` is on the thread's own spline.
    - `weight`: if knots travel, the active part of the weight, for all or for each control point
      (n,), which is not part of `load`.
    - `stands`: whether the organ's answer is kept under any forces.
    - `near`: whether the step fails if a correction of the organ is shortened to less than a quarter, or prolonged.
    - `start`: the state at the start of the step if the thread bears on the organ, otherwise None.
    - `along`: makes a correction if the loads are unknown too, and returns it with the problem
      under other loads; None if the loads are given (`coupling.rest.branch`).
    """

    system: System[Body]
    time: float
    dt: float
    mass_factor: float
    q_ref: Array
    load: Array
    answer: Answer[Body]
    rows: Flags
    law: Law
    stiffen: bool = False
    frame: Frame | None = None
    closed: Flags = field(default_factory=lambda: NO_PAIRS)
    rubbing: Rubbing = field(default_factory=Rubbing)
    gaps: Array = field(default_factory=lambda: NO_GAPS)
    fields: tuple[tuple[Spline, Array], ...] = ()
    weight: float | Array = 1.0
    stands: bool = False
    near: bool = False
    start: State[Body] | None = None
    along: "Corrector[Body] | None" = None

    @cached_property
    def earlier(self) -> tuple[tuple[Spline, Array], tuple[Spline, Array]]:
        """The two earlier curves of a thread whose knots travel; a missing one is zero."""
        fields = self.fields or ((self.system.thread.spline, self.q_ref[:, :3]),)
        return fields[0], (fields[1] if len(fields) > 1 else (fields[0][0], np.zeros_like(fields[0][1])))

    @cached_property
    def ride(self) -> Ride:
        """Travel of the knots, under the active part of the weight."""
        return ride_of(self.system.thread, self.gravity)

    @property
    def weights(self) -> Array:
        """Active part of the thread's weight on each control point, shape `(n, 1)`."""
        return np.broadcast_to(self.weight, self.system.thread.n)[:, None]

    @property
    def gravity(self) -> Array:
        """Gravity times the active part of the weight on each span, shape `(spans, 3)` [m/s²]."""
        return self.weights[self.system.thread.spline.first] * self.system.gravity

    @cached_property
    def fields_read(self) -> tuple[Field, Field]:
        """Earlier curves as arrays for the kernels."""
        one, other = self.earlier
        return field_of(*one), field_of(*other)

    @cached_property
    def inertia(self) -> Array:
        """mass_factor·M, banded."""
        return self.mass_factor * self.system.thread.mass_band

    @cached_property
    def floating(self) -> tuple[Indices, Flags]:
        """First control point of each piece of the thread and of what follows it, `(p, 2)`, and
        whether no hole and no end holds the piece, `(p,)`.

        The mean place of such a piece does not affect any force, and a dead load moves it by many
        lengths in a step.
        """
        spline = self.system.thread.spline
        ends = np.column_stack([spline.piece_starts, spline.piece_starts + spline.piece_points])
        return ends, ~self.system.held_pieces(self.law.s_old, np.asarray(self.rows.any(axis=1)))

    @cached_property
    def contact(self) -> Contact[Body] | None:
        """Contact of the lips; None if nothing may touch."""
        return contact_of(self.system, self.answer)

    @cached_property
    def strands(self) -> Strands[Body] | None:
        """Points of the thread that may bear on the organ; None if there are none."""
        if self.start is None or not len(self.answer.points):
            return None
        return Strands(self.system, self.start, self.answer, self.contact, self.closed, self.rubbing)

    @cached_property
    def organ_at_holds(self) -> tuple[Array, Array]:
        """y_free, shape `(m, 9)`, and C, shape `(9m, 9m)`, of all holds, with the closed pairs."""
        y_free, C = all_holds(self.system, self.answer.y_free), pad_compliance(self.system, self.answer.C)
        if self.contact is None or not self.closed.any():
            return y_free, C
        return condense(self.contact, self.closed, self.rubbing, y_free, C)

    @property
    def y_free(self) -> Array:
        """Site variables of all holds without forces, shape `(m, 9)`."""
        return self.organ_at_holds[0]

    @property
    def C(self) -> Array:
        """Compliance of all holds, shape `(9m, 9m)`."""
        return self.organ_at_holds[1]


@dataclass(frozen=True)
class Iterate:
    """Unknowns of a step: `q` (n, c), `N` (spans, g), `s` (m,), `lam` (m, 5), `y` (m, 9), and active sets.

    The sets are `sigma` (m,) of the friction in holes, and `pressed` (k,) of the contact with its
    friction, `rubbing`. The contact forces follow from the other unknowns.
    """

    q: Array
    N: Array
    s: Array
    lam: Array
    y: Array
    sigma: Array
    pressed: Flags = field(default_factory=lambda: NO_PAIRS, kw_only=True)
    rubbing: Rubbing = field(default_factory=Rubbing, kw_only=True)


@dataclass(frozen=True)
class Residual:
    """Residuals at an iterate, and data for the tangent.

    - `configuration`: the evaluated thread.
    - `f_y` (m, 9): site forces Φ_yᵀλ.
    - `push` (n, 3) [N]: forces on the control points of the holes, Φ_qᵀλ, and of the organ's
      surface, `touch`.
    - `thread` (n, c) [N, with twist N m]: residual of the thread; at held unknowns the reaction.
    - `holds` (m, 6): law of sliding, Φ; `site` (m, 9).
    - `force_scale` [N], `torque_scale` [N m].
    """

    configuration: Configuration
    f_y: Array
    push: Array
    thread: Array
    holds: Array
    site: Array
    force_scale: float
    torque_scale: float = 0.0
    touch: Touch | None = None

    @property
    def points(self) -> Points:
        """The curve."""
        return self.configuration.points

    @property
    def passage(self) -> Passage:
        """The thread at the holes."""
        return self.configuration.at


@dataclass(frozen=True)
class Solution(Generic[Body]):
    """A converged step: its problem, the iterate, the residual, and the number of Newton directions.

    The constraint forces are those of `residual.passage` and `iterate.y` at the end of the step.
    For the linear step they are those at its start, and `linearisation` [J] is the work of its
    elastic force minus that of the true one. `p` (k,) [N] are the contact forces.
    """

    problem: Problem[Body]
    iterate: Iterate
    residual: Residual
    iterations: int
    linearisation: float = 0.0
    p: Array = field(default_factory=lambda: NO_FORCES)


@dataclass
class UnfinishedError(StepError):
    """A step that used all its corrections; `reached` is the unsolved state of the iteration."""

    reached: "Solution[Any]" = field(kw_only=True)


def evaluate(problem: Problem[Body], z: Iterate) -> Residual:
    """Evaluate all residuals of a step. Raises `StepError` as `touched` does."""
    thread, inertia, ridden = problem.system.thread, np.zeros_like(z.q), None
    if thread.travels:
        inertia, ridden = ride(thread.placed(z.s), problem.ride, problem.fields_read, problem.mass_factor, z.q, z.N)
    elif problem.mass_factor:
        inertia = problem.mass_factor * thread.momentum(z.q - problem.q_ref)
    now = evaluate_thread(problem.system, z.q, z.s, problem.frame, problem.law.s_old, ridden=ridden)
    f_y = site_force(now.at, z.lam, z.y)
    now, touch, pressing = touched(problem, z, now, f_y)
    at, elastic = now.at, now.elastic
    balance, push = elastic - problem.load, spread(thread_force(at, z.lam, z.y), at, thread.n) + pressing
    balance[:, :3] -= push
    balance += inertia
    holds = np.empty((len(z.s), 6))
    holds[:, S] = ruled_at(problem, z, at).residual[:, 0]
    holds[:, PHI] = np.where(problem.rows, phi(at, z.lam, z.y), z.lam)
    scale = max(np.abs(elastic[:, :3]).max(), np.abs(problem.load[:, :3]).max(), np.abs(z.lam[:, :3]).max(initial=0.0))
    return Residual(
        now,
        f_y,
        push,
        balance,
        holds,
        site_residual(problem, z, f_y, touch),
        max(float(scale), float(np.abs(pressing).max(initial=0.0)), thread.force_unit),
        float(np.abs(elastic[:, 3:]).max()) if thread.twist else 0.0,
        touch,
    )


def ruled_at(problem: Problem[Body], z: Iterate | State[Body], at: Passage, margin: float = 0.0) -> Ruled:
    """Evaluate the law of sliding at an iterate or a state, as `coupling.step.sliding.ruled`."""
    return ruled(problem.law, z.sigma, at, z.s, z.lam, z.y, margin, problem.system.own_friction)


def touched(
    problem: Problem[Body], z: Iterate, now: Configuration, f_y: Array
) -> tuple[Configuration, Touch | None, Array]:
    """Return the configuration of the thread where it bears on the organ, and the forces of its points.

    The configuration contains the driving forces of the friction at the holds. `f_y` (m, 9) are the
    forces on the sites. The forces of the points are None if no point may bear. The third result
    has their forces on the control points, shape `(n, 3)` [N]. Raises `StepError` if no forces of
    the points obey Coulomb's law.
    """
    strands = problem.strands
    if strands is None:
        return now, None, np.zeros((problem.system.thread.n, 3))
    try:
        touch = strands.touch(z.q, z.s, f_y.ravel())
    except OrganError as error:
        raise StepError(problem.time - problem.dt, problem.dt, str(error)) from error
    if strands.friction and touch.P.any() and now.at.ridden is not None:
        by_s = now.at.ridden.by_s - strands.drive(touch.P, z.s)
        now = replace(now, at=replace(now.at, drive=-by_s, ridden=now.at.ridden._replace(by_s=by_s)))
    return now, touch, strands.push(touch, z.q)


def site_residual(problem: Problem[Body], z: Iterate, f_y: Array, touch: Touch | None) -> Array:
    """Return the residuals of the sites under their forces `f_y` (m, 9) and those of the thread's
    points, shape `(m, 9)`.
    """
    joints = problem.law.joints
    if len(problem.gaps) < len(joints.strands):
        raise ValueError(f"{len(joints.strands)} active ties, but {len(problem.gaps)} gaps; give one for each")
    out = np.empty_like(f_y)
    y_free, C = (np.ascontiguousarray(x) for x in problem.organ_at_holds)
    if problem.strands is not None and touch is not None:
        y_free = y_free + problem.strands.sites(touch)
    site_residuals(joints, C, y_free, problem.gaps, np.ascontiguousarray(z.y), f_y, out)
    return out


def follow(problem: Problem[Body], z: Iterate, r: Residual) -> tuple[Problem[Body], Residual, bool]:
    """Ask the organ again under the forces of an iterate.

    Returns the problem and the residual with its answer, and whether the last answer was valid.
    At rest, the stretch in the law of sliding follows the iterate.
    Raises `StepError` if the organ has no answer, and `FarError` if the problem must be `near`.
    """
    if problem.stands:
        return problem, r, True
    sites = len(problem.system.piercings)
    try:
        answer = problem.answer.again(r.f_y[:sites].ravel(), forces_that_close(problem, z, r))
        if answer is problem.answer:
            return problem, r, True
        if problem.near and answer.far:
            raise FarError("a correction of the tissue was shortened to less than a quarter, or prolonged")
        problem = replace(problem, answer=answer)
        problem = stretched(problem, z, r) if problem.stiffen else problem
        return problem, evaluate(problem, z), False
    except OrganError as error:
        raise failure(problem, r.holds, str(error)) from error


def stretched(problem: Problem[Body], z: Iterate, r: Residual) -> Problem[Body]:
    """Return the problem with the stretch 1 + T/EA of an iterate in its law of sliding."""
    system = problem.system.on(r.configuration.thread.spline)
    stretch = stretches_at(system, z.s, z.N, problem.rows[:, 0])
    return replace(problem, law=problem.law._replace(stretch=stretch))


def force_tolerance(problem: Problem[Body], r: Residual) -> float:
    """Return the tolerance of a force in a solved step [N]: a part of the largest force, plus the
    round-off of forces that cancel.
    """
    return FORCE_TOLERANCE * r.force_scale + rounded_force(problem)


def rounded_force(problem: Problem[Body]) -> float:
    """Return the round-off of forces that cancel [N]."""
    thread, place = problem.system.thread, np.abs(problem.q_ref[:, :3]).max()
    by_place = thread.largest_bending + problem.mass_factor * thread.largest_mass
    span = (thread.spline.end - thread.spline.start) / (len(thread.spline.breaks) - 1)
    return float(force_rounded(thread.EA, by_place, span, place))


def is_converged(problem: Problem[Body], z: Iterate, r: Residual) -> bool:
    """Return whether every equation holds to its tolerance, each relative to a named scale."""
    thread = problem.system.thread
    force = force_tolerance(problem, r)
    gap = GAP_TOLERANCE * thread.section.diameter
    free = np.abs(r.thread)
    free.ravel()[problem.system.held] = 0.0
    torque = max(force * thread.section.diameter, FORCE_TOLERANCE * r.torque_scale)
    along = force + (ALONG - 1.0) * rounded_force(problem) if thread.travels else force
    limits, rounded = (force, gap, along), rounded_places(problem)
    return bool(
        free[:, :3].max() <= force
        and (free.shape[1] == 3 or free[:, 3].max() <= torque)
        and holds_solved(problem.law, z.sigma, problem.rows, limits, r.holds, r.site, rounded)
    )


def rounded_places(problem: Problem[Body]) -> Array:
    """Return the motion of the sites of a nonlinear organ by the round-off of forces, shape `(m, 9)` [m, -].

    It is large close to a limit point of the organ alone, at which its compliance is infinite. It
    is zero for a linear organ, which has no limit point.
    """
    m = problem.system.holds
    if problem.answer.linear:
        return np.zeros((m, NINE))
    by_force = np.abs(problem.C.reshape(m, NINE, m, NINE)[..., :3])
    return np.asarray(rounded_force(problem) * by_force.max(axis=(2, 3), initial=0.0))


def border_of(problem: Problem[Body], z: Iterate, at: Passage) -> Border:
    """Linearise the holds, with the rows of inactive constraints replaced by λ = 0."""
    law, own, sigma = problem.law, problem.system.own_friction, np.ascontiguousarray(z.sigma, dtype=float)
    if own:
        law = with_own_laws(law, own, pressing_force(at, z.lam, z.y, law.per_channel))
    return linearise(law, sigma, problem.rows, at, z.lam, z.y)


def add_constraint_stiffness(
    problem: Problem[Body], A: Array, border: Border, r: Residual
) -> tuple[Array, Border, Array]:
    """Add Φ_qᵀ Γ (Φ_q dq + … + Φ) to the thread's equations.

    The solution does not change. The matrix becomes regular even if the thread could move or turn
    freely without the constraints (statics). Γ has the size of the band's diagonal.
    """
    thread, at, m = problem.system.thread, r.passage, len(r.holds)
    border = border._replace(E=border.E.copy())
    K, push = np.zeros((m, NINE, NINE)), np.zeros((m, NINE))
    stiffen_holds(float(np.abs(A).max()), problem.rows, at.b, border, r.holds, K, push)
    blocks = np.einsum("mki,mkalb,mlj->mijab", at.b[:, :3], K.reshape(-1, 3, 3, 3, 3), at.b[:, :3])
    r_q = r.thread.copy()
    r_q[:, :3] += spread(push.reshape(-1, 3, 3)[:, :2], at, thread.n)
    return A + thread.band_at(at.first, blocks), border, r_q


def allowed_share(problem: Problem[Body], dq: Array) -> float:
    """Return the part of a correction that is applied.

    No control point moves further than LONGEST_MOVE; the mean move of a piece that floats does not
    count.
    """
    thread = problem.system.thread
    longest = LONGEST_MOVE * (thread.spline.end - thread.spline.start)
    return float(share(longest, *problem.floating, thread.lever, np.ascontiguousarray(dq)))


def applied_share(problem: Problem[Body], r: Residual, dq: Array, dz: Array) -> float:
    """Return the part of a correction with the holes' part `dz` (m, 15) that is applied.

    In addition to `allowed_share`, it leaves a part of the length of each strand between two holes.
    """
    part, spline = allowed_share(problem, dq), r.configuration.thread.spline
    if not isinstance(spline, Placed):
        return part
    return float(min(part, share_between(problem.ride, np.ascontiguousarray(spline.places), np.ascontiguousarray(dz))))


def thread_matrix(problem: Problem[Body], z: Iterate, r: Residual) -> Array:
    """Return the thread's own matrix, banded: inertia and stiffness."""
    thread = r.configuration.thread
    A = thread.tangent(r.points, z.N)
    A += problem.mass_factor * thread.mass_band if thread.travels else problem.inertia
    strands = problem.strands
    if strands is not None and strands.held.size:
        A += thread.band_at(strands.first[strands.held], strands.springs)
    return A


def direction(problem: Problem[Body], z: Iterate, r: Residual, tie: float = 0.0) -> tuple[Array, Array]:
    """Return Newton's whole direction dq (n, c), dz (m, 15) at an iterate.

    The material points of the thread are tied to their places by a mass times `tie` [1/s²]. Raises
    `SingularError`.
    """
    thread, at = r.configuration.thread, r.passage
    A, r_q = thread_matrix(problem, z, r), r.thread
    if tie:
        A += tie * thread.mass_band
        at = at if at.ridden is None else replace(at, ridden=with_tie(thread, problem.ride, z.q, tie, at.ridden))
    border = border_of(problem, z, at)
    if problem.stiffen:
        A, border, r_q = add_constraint_stiffness(problem, A, border, r)
    A, joined = problem.system.hold_still(A), (problem.law.joints, z.sigma)
    solve = partial(newton_directions, A, problem.system.held, border, problem.C, at, joined=joined)
    if problem.strands is None or r.touch is None:
        return solve([(r_q, r.holds, r.site)])[0]
    forces, at_holds = partial(change_of_site_forces, border, at), partial(driven, problem.law, z.sigma)
    return problem.strands.directed(r.touch, (r_q, r.holds, r.site), at_holds, z.s, solve, forces)


def change_of_site_forces(border: Border, at: Passage, dq: Array, dz: Array) -> Array:
    """Return the change of the site forces Φ_yᵀλ in a direction dq (n, c), dz (m, 15), shape `(9m,)`."""
    by_thread = at.b[:, :3] @ dq[at.first[:, None] + LOCAL, :3]
    return (np.matvec(border.F, dz) + np.matvec(border.R, by_thread.reshape(-1, 9))).ravel()


def moved(problem: Problem[Body], z: Iterate, r: Residual, dq: Array, dz: Array) -> Iterate:
    """Return an iterate moved by dq (n, c) and dz (m, 15)."""
    return replace(
        z,
        q=z.q + dq,
        N=next_axial_force(problem, r, dq, dz),
        s=z.s + dz[:, S],
        lam=z.lam + dz[:, PHI],
        y=z.y + dz[:, Y],
    )


def next_axial_force(problem: Problem[Body], r: Residual, dq: Array, dz: Array) -> Array:
    """Return the axial forces (spans, a) [N] of an iterate moved by dq (n, c), and by the first
    column of dz (m, …).
    """
    thread = r.configuration.thread
    N = thread.next_axial_force(r.points, dq)
    return with_riding_force(thread, problem.ride, r.points, dz, N) if thread.travels else N


def correct(problem: Problem[Body], z: Iterate, r: Residual) -> tuple[Problem[Body], Iterate]:
    """Make one Newton correction. Raises `SingularError`."""
    dq, dz = direction(problem, z, r)
    part = applied_share(problem, r, dq, dz)
    return problem, moved(problem, z, r, part * dq, part * dz)


Corrector = Callable[[Problem[Body], Iterate, Residual], tuple[Problem[Body], Iterate]]


def solve(
    problem: Problem[Body], start: Iterate, correct: Corrector[Body] = correct, patience: int = 1
) -> Solution[Body]:
    """Iterate from `start` until every equation holds, and stick and slip, contact and opening fit
    the solution.

    `correct` makes one Newton correction; the default condenses the organ. `patience` is the
    allowed number of corrections, in those of a plain solve. Each active set of friction and
    contact is solved before it is judged here; a way downhill also changes it on the way. If a set
    returns, only the first differing hole or pair changes (Murty's least-index rule). The solve
    fails if sets cycle, or change after MAX_SETS sets. Raises `StepError`.
    """
    try:
        return solve_sets(problem, start, correct, patience)
    except (OrganError, ThreadError) as error:
        raise StepError(problem.time - problem.dt, problem.dt, str(error)) from error


def solve_sets(problem: Problem[Body], start: Iterate, correct: Corrector[Body], patience: int) -> Solution[Body]:
    """Solve one active set after another, as described in `solve`.

    Raises `StepError`, and `OrganError` if the lips of a nonlinear organ have no answer.
    """
    z, iterations = replace(start, sigma=admissible_sigma(problem.law, start.sigma)), 0
    rubs = problem.contact is not None and problem.contact.rubs  # directions of slip may change in one set
    seen: Counter[bytes] = Counter()
    for _ in range(MAX_SETS + len(z.pressed)):
        solution = solve_set(replace(problem, closed=z.pressed, rubbing=z.rubbing), z, correct, patience)
        iterations += solution.iterations
        z, r = solution.iterate, solution.residual
        problem = solution.problem
        seen[sets_of(z)] += 1
        fitting = with_next_sets(problem, z, r, seen)
        if fitting is z:
            return replace(solution, problem=problem, iterations=iterations, p=contact_forces(problem, z, r))
        if seen[sets_of(z)] > RETURNS and not rubs:
            break
        z = fitting
    raise failure(problem, r.holds, STICK_OR_SLIP if problem.contact is None else TOUCH_OR_OPEN)


def sets_of(z: Iterate) -> bytes:
    """Return the active sets of an iterate as bytes, for comparison; sets with different directions
    of slip are different.
    """
    ways = np.round(z.rubbing.along, WAYS) + 0.0  # no negative zeros
    return z.sigma.tobytes() + z.pressed.tobytes() + z.rubbing.slips.tobytes() + ways.tobytes()


def with_next_sets(problem: Problem[Body], z: Iterate, r: Residual, seen: Container[bytes]) -> Iterate:
    """Return a solved iterate with the active sets that fit its forces; the same object if it has them.

    Pairs are judged to round-off at first, and within the tolerance of the solve only if that leads
    back to an earlier set.
    """
    margin = MARGIN * force_tolerance(problem, r)
    sigma = ruled_at(problem, z, r.passage, margin).fits
    contact = None if problem.contact is None else under(problem.contact, problem.strands, r.touch)
    if contact is not None and contact.rubs:
        return with_rubbing_sets(problem, contact, z, r, sigma, seen)
    pressed = z.pressed if contact is None else find_pressed(contact, r.f_y.ravel(), z.pressed)
    fitting = replace(z, sigma=sigma, pressed=pressed)
    if np.array_equal(sigma, z.sigma) and np.array_equal(pressed, z.pressed):
        return z
    if sets_of(fitting) not in seen:
        return fitting
    other = sigma != z.sigma
    if other.any():
        return replace(z, sigma=admissible_sigma(problem.law, np.where(first_of(other), sigma, z.sigma)))
    wrong = NO_PAIRS if contact is None else misfits(contact, r.f_y.ravel(), z.pressed, margin)
    return replace(z, pressed=z.pressed ^ first_of(wrong)) if wrong.any() else z


def with_rubbing_sets(
    problem: Problem[Body], contact: Contact[Body], z: Iterate, r: Residual, sigma: Array, seen: Container[bytes]
) -> Iterate:
    """Return a solved iterate with the active sets that fit its forces, of the thread's friction
    `sigma` and of the surfaces.

    It is the same object if the forces of the surfaces obey Coulomb's law, whatever the set.
    """
    f = r.f_y.ravel()
    other = sigma != z.sigma
    if not other.any() and is_lawful(contact, z.pressed, z.rubbing, f):
        return z
    pressed, rubbing, _ = find_sets(contact, f, z.pressed, z.rubbing)
    fitting = replace(z, sigma=sigma, pressed=pressed, rubbing=rubbing)
    if other.any() and sets_of(fitting) in seen:
        return replace(fitting, sigma=admissible_sigma(problem.law, np.where(first_of(other), sigma, z.sigma)))
    return fitting


def forces_that_close(problem: Problem[Body], z: Iterate, r: Residual) -> Array:
    """Return the forces of the pairs by the active set of an iterate, then those of the thread's
    points, shape `(k,)` [N].
    """
    P = NO_FORCES if r.touch is None else r.touch.P
    if problem.contact is None:
        return P
    contact = under(problem.contact, problem.strands, r.touch)
    return np.append(closing_forces(contact, z.pressed, z.rubbing, r.f_y.ravel()), P)


def contact_forces(problem: Problem[Body], z: Iterate, r: Residual) -> Array:
    """Return p of a solved iterate, shape `(k,)` [N]; tension between lips by round-off is set to zero."""
    p = forces_that_close(problem, z, r)
    if problem.contact is not None and not problem.contact.rubs:
        lips = len(problem.contact.g_free)
        p[:lips] = np.maximum(p[:lips], 0.0)
    return p


@np.errstate(over="ignore", divide="ignore", invalid="ignore")  # a diverging try gets its own error
def solve_set(problem: Problem[Body], z: Iterate, correct: Corrector[Body], patience: int) -> Solution[Body]:
    """Iterate by Newton's method from `z` with its active set. Raises `StepError`."""
    r = evaluate(problem, z)
    for iteration in range(patience * MAX_ITERATIONS):
        if not np.isfinite(r.force_scale) or not np.all(np.isfinite(r.thread)):
            raise failure(problem, r.holds, RAN_AWAY)
        problem, r, stands = follow(problem, z, r)
        if stands and is_converged(problem, z, r):
            if problem.system.thread.turns_too_far(problem.frame, z.q):
                raise failure(problem, r.holds, "a tangent turned by more than 120°, too far for the twist's frame")
            return Solution(problem, z, r, iteration)
        ask_before_correction()
        try:
            problem, z = (problem.along or correct)(problem, z, r)
        except SingularError as error:
            raise failure(problem, r.holds, str(error)) from error
        r = evaluate(problem, z)
    failed = failure(problem, r.holds, too_many(patience * MAX_ITERATIONS))
    raise unfinished(failed, Solution(problem, z, r, iteration + 1))


def unfinished(failed: StepError, reached: Solution[Body]) -> UnfinishedError:
    """Return the error of a step with the state that its corrections `reached`."""
    return UnfinishedError(failed.time, failed.dt, failed.cause, failed.piercing, reached=reached)


def too_many(corrections: int) -> str:
    """Return the message that `corrections` corrections of one active set did not converge."""
    return f"no convergence in {corrections} Newton iterations"


def failure(problem: Problem[Body], holds: Array, cause: str) -> StepError:
    """Return the error of a step, with the piercing whose constraints are violated most; `holds`
    (m, 6) as in `Residual`.
    """
    piercings = problem.system.piercings
    gap = np.nan_to_num(np.abs(holds[: len(piercings), PHI]), nan=np.inf).max(axis=1, initial=0.0)
    name = piercings[int(np.argmax(gap))].name if piercings else ""
    return StepError(problem.time - problem.dt, problem.dt, cause, name)
