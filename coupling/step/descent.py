"""A step with a distant solution: Newton's method led downhill, from the start of the step.

After the elimination of the constraints of the holes, an implicit step without friction is the
minimum of a potential. It is that of the thread, its inertia and its loads, plus ½ fᵀC f of an
organ whose sites are y = y_free + C f under forces f. Corrections stay on the constraints, which
are linear in the control points next to a hole: these points are moved the shortest way. The work
of all residuals along a correction,

    W = r_q·dq + (f − Φ_yᵀλ)·dy − r_s ds,

is the slope of that potential. Friction is part of W as a given force. The way leads downhill by
three rules:

- W < 0 at the start of a correction. There dᵀH d = −W, so that W shows whether the curvature along
  the correction is positive (Chiang & Zavala, SIAM J. Optim. 26, 2016). If it is not, the material
  points of the thread are tied to their places by a stiffness like a mass. The tie grows until the
  curvature is positive (Levenberg, Q. Appl. Math. 2, 1944), at least by what is lacking along d.
- At the end of a correction W is at most ENOUGH of its size at the start; the correction is
  shortened until this holds (Matthies & Strang, Int. J. Numer. Meth. Eng. 14, 1979).
- A correction that would go further than the tie allows contains a motion almost without a change
  of energy, such as that of a thread that slides freely. It is also made with a firmer tie, which
  hardly changes the other motions.

Stick and slip, contact and opening change on the way, because the forces there are known:

- A hole with friction that a correction takes back past its start is stopped there, and the
  correction is made again: otherwise friction of the old sense would drive the hole.
- A sticking hole slides when a whole Newton correction leaves more force on it than friction bears.
  Holes that were stopped are released a few at a time, those with the largest excess first: when
  they slide, others may stay.
- Surfaces of the organ touch according to the forces at the holes.
"""

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Generic

import numpy as np

from coupling.arrays import Array, Flags
from coupling.errors import CouplingError, StepError
from coupling.interfaces import Body
from coupling.joins.contact import find_sets
from coupling.joins.strands import under
from coupling.kernels.border import Border
from coupling.kernels.bordered import SINGULAR_HOLDS, S, SingularError, Y
from coupling.kernels.constraints import LOCAL
from coupling.kernels.friction import Ruled
from coupling.step import newton
from coupling.step.configuration import GAP_TOLERANCE, PUT, LocalRows, onto_constraints
from coupling.step.newton import (
    Iterate,
    Problem,
    Residual,
    Solution,
    applied_share,
    border_of,
    change_of_site_forces,
    evaluate,
    moved,
    ruled_at,
)
from coupling.step.sliding import admissible_sigma, sliding_strands
from tissue.errors import OrganError

PATIENCE, BOWING = 4, 8  # times the corrections of a plain solve; a column that buckles takes 150
ENOUGH = 0.8  # of the slope at the start of a correction: largest slope against the motion at its end
SHORTEST, LONGEST = 0.1, 0.8  # of a correction that led too far: range of its shortening
ANSWERS = 3  # answers of a nonlinear organ with a way downhill each, at most
LENGTHS = 9  # lengths of a correction, at most
MUCH = 0.5  # of the largest excess: such holes are released together; one by one, 84 holes took 200 corrections
LEAST = 0.1  # of a correction: if a smaller part is allowed, it is made with a firmer tie
FIRMER = 4.0  # growth of the tie from try to try; with tenfold ties a buckling column grew by 5 % per correction
SOFTEST, FIRMEST = 1e-6, 1e8  # of EA/(ρA L²), the stiffness of the whole thread: the first and the last tie


def descend(problem: Problem[Body], start: Iterate, patience: int = PATIENCE) -> Solution[Body]:
    """Solve a step downhill from `start`.

    With a nonlinear organ, the step is solved downhill with the organ's last answer, and then by
    Newton's method. If Newton's method does not converge, this is repeated with the organ's answer that it reached.
    `patience` is the allowed number of corrections, in those of a plain solve. Raises `StepError`.
    """
    if problem.answer.linear:
        return newton.solve(problem, start, Descent[Body](), patience)
    made, z = 0, start
    for _ in range(ANSWERS):
        held = newton.solve(replace(problem, stands=True), z, Descent[Body](), patience)
        made, z = made + held.iterations, held.iterate
        try:
            solution = newton.solve(problem, z)
            return replace(solution, iterations=made + solution.iterations)
        except newton.UnfinishedError as error:  # of its corrections, only those of the organ went downhill
            failed: StepError = error
            problem = error.reached.problem
        except StepError as error:
            failed, problem = error, newton.follow(problem, z, held.residual)[0]
    raise newton.unfinished(failed, replace(held, problem=problem, iterations=made))


@dataclass
class Descent(Generic[Body]):
    """Corrections that go downhill.

    `there` is the result of the last correction, None before the first one. `tie` [1/s²] is its
    tie. `whole` is True if the last correction was the whole one of Newton. `stopped` (m,) are the
    holes stopped so far.
    """

    there: "Place[Body] | None" = None
    tie: float = 0.0
    whole: bool = False
    stopped: Flags = field(default_factory=lambda: np.zeros(0, dtype=bool))

    def __call__(self, problem: Problem[Body], z: Iterate, r: Residual) -> tuple[Problem[Body], Iterate]:
        """Make one correction, as `coupling.step.newton.correct` does. Raises `SingularError`."""
        start, stopped = self.start(problem, z, r), np.zeros(len(z.s), dtype=bool)
        there = self.led_from(start)
        while (back := slides_back(there) & ~stopped).any():
            stopped |= back
            there = self.led_from(start.stopping(stopped))
        there = there.with_senses(np.where(stopped & ~there.arrived, start.z.sigma, there.z.sigma))
        self.stopped |= stopped
        if self.whole:
            there = there.with_senses(self.released(there, there.ruled.fits))
        self.there = there.touching()
        return self.there.problem, self.there.z

    def led_from(self, start: "Place[Body]") -> "Place[Body]":
        """Return the result of a correction downhill. Raises `SingularError`."""
        way = self.downhill(start)
        share, down = way.allowed, abs(way.slope)
        for _ in range(LENGTHS):
            there, slope = way.after(share)
            if slope <= ENOUGH * down:
                break
            share = shortened(share, slope, down)
        self.whole = share == 1.0 and self.tie == 0.0
        if share == 1.0:
            return there
        # After a part of a correction the axial forces are those of the strains.
        own = there.r.configuration.thread.EA * there.r.points.strain
        return replace(there, z=replace(there.z, N=own))

    def start(self, problem: Problem[Body], z: Iterate, r: Residual) -> "Place[Body]":
        """Return the place of an iterate: the result of the last correction, unless something changed since."""
        if self.there is None:
            self.stopped = np.zeros(len(z.s), dtype=bool)
            return consistent(problem, z, holding_forces(problem, z))
        if self.there.z is z and self.there.problem.answer is problem.answer:
            return replace(self.there, problem=problem, r=r)
        return consistent(problem, replace(z, sigma=self.released(self.there, z.sigma)), self.there.f)

    def released(self, at: "Place[Body]", sigma: Array) -> Array:
        """Return the senses `sigma` (m,) of the holes after those at a place.

        Of the stopped holes that slide again in `sigma`, only those slide whose excess over the
        bound is at least half of the largest one.
        """
        again = (sigma != 0.0) & (at.z.sigma == 0.0) & self.stopped
        f, bound, barb = at.ruled.judged.T
        excess = np.where(again, sigma * (f - barb) - bound, -np.inf)
        wait = again & (excess < MUCH * excess.max(initial=-np.inf))
        return admissible_sigma(at.problem.law, np.where(wait, 0.0, sigma))

    def downhill(self, start: "Place[Body]") -> "Way[Body]":
        """Return a correction that leads downhill at its start.

        It is Newton's own if no tie gives such a correction, as at the level of round-off. Raises
        `SingularError`.
        """
        thread, plain, firm = start.problem.system.thread, correction(start, 0.0), None
        whole = float(thread.EA / (thread.section.rhoA * (thread.spline.end - thread.spline.start) ** 2))
        tie, way, least, firmest = 0.0, plain, max(self.tie / FIRMER, SOFTEST * whole), FIRMEST * whole
        while way is None or way.slope > 0.0 or way.allowed < LEAST:
            if tie and firm is None and (way is None or way.slope > 0.0):
                firm = correction(start, firmest)  # if it leads uphill too, the search ends
            if tie == firmest or (firm is not None and firm.slope > 0.0):
                if plain is None:
                    raise SingularError(SINGULAR_HOLDS)
                return plain
            tie = min(max(FIRMER * tie, least, tie + (0.0 if way is None else way.lacking)), firmest)
            way = correction(start, tie)
        self.tie = tie
        return way


def slides_back(there: "Place[Body]") -> Flags:
    """Return the holes with friction that slid on the way to a place, and back past their start, shape `(m,)`."""
    law, z = there.problem.law, there.z
    return np.asarray(law.rough & law.may_slide & (z.sigma * (z.s - law.s_old) < 0.0))


def correction(start: "Place[Body]", tie: float) -> "Way[Body] | None":
    """Return the correction of a thread tied to its place; None if its matrix is singular."""
    try:
        return Way(start, *newton.direction(start.problem, start.z, start.r, tie))
    except SingularError:
        return None


def shortened(share: float, slope: float, down: float) -> float:
    """Return a shorter share of a correction with the slope `down` at its start and `slope` after a
    `share` of it.

    The slope there is zero if it rises like the third power, as with the strain due to a rotation
    of the thread.
    """
    ratio = np.cbrt(down / slope) if np.isfinite(slope) else 0.0
    return share * float(np.clip(ratio, SHORTEST, LONGEST))


@dataclass(frozen=True)
class Place(Generic[Body]):
    """An iterate `z` of a `problem` on its constraints, its residual `r`, the forces `f` (m, 9)
    that hold the sites, and Φ_q, `local`.
    """

    problem: Problem[Body]
    z: Iterate
    r: Residual
    f: Array
    local: LocalRows

    @cached_property
    def border(self) -> Border:
        """The linearised holds."""
        return border_of(self.problem, self.z, self.r.passage)

    @cached_property
    def ruled(self) -> Ruled:
        """The evaluated law of sliding."""
        return ruled_at(self.problem, self.z, self.r.passage)

    @cached_property
    def arrived(self) -> Flags:
        """Whether a sticking hole is at the abscissa at which it sticks, shape `(m,)`."""
        return np.abs(self.z.s - self.problem.law.s_held) <= GAP_TOLERANCE * self.problem.system.thread.section.diameter

    def stopping(self, holes: Flags) -> "Place[Body]":
        """Return the place, from which a whole correction takes `holes` (m,) back to their start."""
        law, z, r = self.problem.law, self.z, self.r
        sigma = admissible_sigma(law, np.where(holes, 0.0, z.sigma))
        residuals = r.holds.copy()
        residuals[:, S] = np.where(sigma == z.sigma, r.holds[:, S], z.s - law.s_held)
        return replace(self, z=replace(z, sigma=sigma), r=replace(r, holds=residuals))

    def with_senses(self, sigma: Array) -> "Place[Body]":
        """Return the place with the senses of sliding `sigma` (m,)."""
        if np.array_equal(sigma, self.z.sigma):
            return self
        z = replace(self.z, sigma=admissible_sigma(self.problem.law, sigma))
        return replace(self, z=z, r=evaluate(self.problem, z))

    def touching(self) -> "Place[Body]":
        """Return the place with the pairs pressed that its forces press; itself if no set of pairs fits."""
        contact, z = self.problem.contact, self.z
        if contact is None:
            return self
        contact = under(contact, self.problem.strands, self.r.touch)
        try:
            pressed, rubbing, _ = find_sets(contact, self.f.ravel(), z.pressed, z.rubbing)
        except (CouplingError, OrganError):
            return self
        if np.array_equal(pressed, z.pressed):
            return self
        problem = replace(self.problem, closed=pressed, rubbing=rubbing)
        return consistent(problem, replace(z, pressed=pressed, rubbing=rubbing), self.f)


@dataclass(frozen=True)
class Way(Generic[Body]):
    """A correction `dq` (n, c), `dz` (m, 15) from the place `starts`."""

    starts: Place[Body]
    dq: Array
    dz: Array

    @cached_property
    def slope(self) -> float:
        """Work of the residuals along the correction at its start [J]."""
        return self.work(self.starts)

    @cached_property
    def allowed(self) -> float:
        """Allowed part of the correction."""
        return applied_share(self.starts.problem, self.starts.r, self.dq, self.dz)

    @property
    def lacking(self) -> float:
        """Estimate of the tie [1/s²] that this correction still lacks to lead downhill and not too far.

        The curvature along it is −W/(dᵀM d) in units of a tie. A mode that is too soft moves in
        inverse proportion to its stiffness. The motion of the holes is left out of M, which made the
        estimate up to 4 times too large in measured cases.
        """
        moved = np.vdot(self.starts.r.configuration.thread.momentum(self.dq), self.dq)
        return float(abs(self.slope) / moved * (1.0 if self.slope > 0.0 else np.divide(LEAST, self.allowed) - 1.0))

    @cached_property
    def df(self) -> Array:
        """Change of the forces that hold the sites, shape `(m, 9)`."""
        at = self.starts
        change = change_of_site_forces(at.border, at.r.passage, self.dq, self.dz)
        return at.r.f_y + change.reshape(at.f.shape) - at.f

    def after(self, share: float) -> tuple[Place[Body], float]:
        """Return the place after a `share` of the correction, on the constraints, and the work
        along the correction there [J].
        """
        at = self.starts
        z = moved(at.problem, at.z, at.r, share * self.dq, share * self.dz)
        there = put_on_constraints(at.problem, z, at.f + share * self.df)
        return there, self.work(there)

    def work(self, at: Place[Body]) -> float:
        """Return the work of the residuals at a place along this correction, projected on the
        constraints there [J].

        It is infinite if a residual is inf or nan.
        """
        problem, z, r, border = at.problem, at.z, at.r, at.border
        off = np.matvec(at.local.rows, self.dq[r.passage.first[:, None] + LOCAL, :3].reshape(-1, 12))
        off += np.matvec(border.Phi_y, self.dz[:, Y]) + border.Phi_s * self.dz[:, :1]
        along = self.dq - at.local.put_back(r.passage, off * problem.rows, self.dq)
        residual = r.thread.copy()
        residual.ravel()[problem.system.held] = 0.0
        law, drive = problem.law, np.where(z.sigma == 0.0, 0.0, r.holds[:, S])
        drive[sliding_strands(law, z.sigma)[0]] = 0.0  # their equation is that their sum is constant
        of_sites = at.f - r.f_y
        of_sites[law.joints.strands] = -r.f_y[law.joints.strands]
        W = float(np.vdot(residual, along) - drive @ self.dz[:, S] + np.vdot(of_sites, self.dz[:, Y]))
        return W if np.isfinite(W) else np.inf


def put_on_constraints(problem: Problem[Body], z: Iterate, f: Array) -> Place[Body]:
    """Return the place of an iterate with its control points moved onto the constraints.

    If the thread bears on the organ, its points also move the sites.
    """
    rounds, times = (1, PUT) if problem.strands is None else (PUT, 1)
    for _ in range(rounds):
        if problem.strands is not None:
            z = replace(z, y=sites_under(problem, z, f))
        q, local = onto_constraints(problem.system, problem.rows, z.q, z.s, z.y, problem.law.s_old, times)
        if q is z.q:
            break
        z = replace(z, q=q)
    return Place(problem, z, evaluate(problem, z), f, local)


def sites_under(problem: Problem[Body], z: Iterate, f: Array) -> Array:
    """Return the sites of an iterate under forces `f` (m, 9) that hold them, shape `(m, 9)`; those
    of ties do not change.
    """
    y = problem.y_free + (problem.C @ f.ravel()).reshape(f.shape)
    if problem.strands is not None:
        y = y + problem.strands.sites(problem.strands.touch(z.q, z.s, f.ravel()))
    return np.where(problem.system.of_ties[:, None], z.y, y)


def holding_forces(problem: Problem[Body], z: Iterate) -> Array:
    """Return the forces (m, 9) that hold the sites of the organ at their places in an iterate.

    They are a least-squares solution, because a clamped end and a closed lip have no compliance.
    """
    way = (z.y - problem.y_free).ravel()
    if problem.strands is not None:
        way = way - problem.strands.sites(problem.strands.touch(z.q, z.s, np.zeros_like(way))).ravel()
    return np.asarray(np.linalg.lstsq(problem.C, way, rcond=1e-12)[0].reshape(z.y.shape))


def consistent(problem: Problem[Body], z: Iterate, f: Array) -> Place[Body]:
    """Return the place of an iterate on the constraints, with consistent sites and abscissae.

    The sites are at their places under the forces `f` (m, 9), and held abscissae at their held
    values.
    """
    law, y = problem.law, sites_under(problem, z, f)
    s, strands = np.where(z.sigma == 0.0, law.s_held, z.s), law.joints.strands
    middle = 0.5 * z.y[strands].sum(axis=1, keepdims=True)
    half = np.pad(0.5 * problem.gaps[: len(strands)], ((0, 0), (0, 6)))[:, None]
    y[strands] = middle + half * [[[1.0], [-1.0]]]
    one, other = sliding_strands(law, z.sigma)
    over = 0.5 * (s[one] - law.s_old[one] + s[other] - law.s_old[other])
    s[one], s[other] = s[one] - over, s[other] - over
    return put_on_constraints(problem, replace(z, y=y, s=s), f)
