"""An organ at finite strain in the coupled system.

It has an energy Π(U), an internal force ∂Π/∂U and a tangent K(U):

    a M (U⁺ − U_a) + α d M (U⁺ − U_d) + ∂Π/∂U − load = Zᵀ (∂y/∂z)ᵀ f_y,    z = Z U

The site variables depend on U only through z (`tissue.sites.finite`). At an iterate U_k they are
y ≈ y_k + J dz. Let r_k be the residual without site forces, A_k = a M + α d M + K, C_z = Z A_k⁻¹ Zᵀ
and S = f_y·∂²y/∂z². The answer is

    dz = (1 − C_z S)⁻¹ (C_z Jᵀ f_y − Z A_k⁻¹ r_k),   y = y_k + J dz,   dU = A_k⁻¹ (Zᵀ (Jᵀ f_y + S dz) − r_k).

The forces of the iterate are subtracted from r_k and from f_y and p. C_z and C_cy then act only on
their changes, and the converged answer does not depend on them.

Forces p on the gaps g = g0 + G U of touching lips add Gᵀ p to the forces. Their compliances are
C_cc = G Ã⁻¹ Gᵀ and C_cy = G Ã⁻¹ Zᵀ Jᵀ with Ã = A − Zᵀ S Z. The pairing and its directions are
determined at the start of a step, in the deformed shape.

The coupled Newton iteration calls `again` after each correction. The organ then moves to U_k + dU.
The move is shortened if a cell would be inverted, or if the residual would increase and the move
would lead too far uphill in the organ's potential under these forces. The answer has converged when
its own residual there is within RESIDUAL of the forces of the cells. A factor is reused while few
corrections are left with it; the converged answer does not depend on the factor. In the statics of
an organ, so are C_z and C_cy of an earlier factor: their columns are more expensive than a factor.
"""

import logging
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import ClassVar

import numpy as np
from scipy.sparse import csr_matrix, identity

from tissue.arrays import Array, Indices
from tissue.errors import FactorError, OrganError, TissueError
from tissue.hyperelasticity import Hyperelasticity
from tissue.materials.density import Density, determinant
from tissue.organs.meshed import (
    EMPTY,
    NO_POINTS,
    Columns,
    Equation,
    LinearAnswer,
    MeshedOrgan,
    Operator,
    OrganEnergies,
    OrganState,
    Pairing,
    SiteAnswer,
    TimeScheme,
    compliance,
    gap_compliance,
    refuse_loose,
    slips_since,
    touching,
)
from tissue.recent import Recent
from tissue.relaxation import Prony
from tissue.sites.finite import SiteMap
from tissue.solvers.choice import Solver, mass_solver, solver
from tissue.solvers.direct import Pattern
from tissue.solvers.factor import factorize_indefinite
from tissue.strain import volume_ratios

log = logging.getLogger(__name__)

RESIDUAL = 1e-10  # of the largest force of a cell on a node: bound of the organ's residual
ROUND_OFF = 2e-14  # of the force of a cell at a strain of one: round-off of F = I + ∇U
BENT = 1e-12  # of a frame's numbers and of the organ's span: accepted difference between y(z) and its linearisation
KEEP = 8  # corrections, a third of those allowed in a step in time
CHEAP = 10_000  # unknowns; a new factor with its columns is as expensive as about KEEP corrections
TOGETHER = 4  # columns of the sites in the time of a correction: CHOLMOD solves for as many at once
SHORTEST = 2.0**-12  # smallest part of a correction that is tried
LONGEST = 2.0**6  # corrections of an indefinite tangent: longest way along one of them
ENOUGH = 0.8  # of the slope at the start of a correction: largest slope against the motion at its end
SHORTER = 0.25  # of a correction that led too far: its shortest next part
KEPT_TANGENTS = 2
SHIFTS = (1e-4, 1e-2, 0.1, 1.0, 10.0, 100.0)  # of the stiffness at small strain, added to an indefinite tangent
# Times the displacement predicted by the tangent at the end. A flap that is pulled upright by four
# times the load moves 2.7 times as far, and an exponential law with a growth of e⁴ 4 times as far.
FARTHEST = 4.0
POWERS = 20  # iterations for an unstable motion: an estimate is enough
OFF = 1e-3  # strain by which unstable tissue is moved off its equilibrium
PARTS = (0.25, 0.5, 0.75)  # of a path: points at which the path is checked for a barrier
DROP = 0.1  # of the larger force at the ends of a path: a smaller drop along it is no barrier
MOST_CORRECTIONS = 50  # for the equilibrium without site forces


@dataclass(frozen=True)
class Motion:
    """The inertia and loads of a step.

    - `a` [1/s²], `d` [1/s]: the factors of the time scheme.
    - `inertia`, `damping` `(N,)` [m]: the fields U_a and U_d.
    - `load` `(N,)` [N]: the dead load.
    - `shares` `(l,)`: the parts of the loads that act; None without loads.
    - `led`: if True, the organ is led along a branch of equilibria, and its potential may increase.
    - `course`: the relaxation of the tissue; None without relaxation.
    """

    a: float
    d: float
    inertia: Array
    damping: Array
    load: Array
    shares: Array | None
    led: bool = False
    course: "Course | None" = None

    @property
    def density(self) -> Density | None:
        """The density of relaxing tissue in the step; None for the density of the body."""
        return None if self.course is None else self.course.density


@dataclass(frozen=True)
class Course:
    """The relaxation of stress in a step of `dt` [s].

    `relaxing` `(b, 3, 3, q, c)` [Pa] are the relaxing stresses at the start of the step, and `S`
    `(3, 3, q, c)` [Pa] is S_iso there. `H` `(3, 3, q, c)` [Pa] is the constant stress in the step,
    and `density` the energy density with it (`tissue.relaxation`).
    """

    dt: float
    relaxing: Array
    S: Array
    H: Array
    density: Density


@dataclass(frozen=True)
class Tangent:
    """The factorised tangent A at the displacement `U`.

    `Z` `(k, N)` are the rows of the sites. `definite` is False if the tangent is not positive
    definite; A is then shifted, unless the organ is led (`FiniteOrgan.tangent`). `H` is the constant
    stress of its course; None without relaxation.
    """

    U: Array
    factor: "TangentSolver"
    Z: csr_matrix
    definite: bool = True
    H: Array | None = None
    _gaps: Recent[Columns] = field(default_factory=lambda: Recent(1), repr=False)
    _corrections: Recent[Array] = field(default_factory=lambda: Recent(1), repr=False)

    @property
    def A(self) -> csr_matrix:
        """The factorised matrix, shape `(N, N)` [N/m]."""
        return self.factor.A

    @cached_property
    def columns(self) -> "SiteColumns":
        """Its own columns, computed when first needed; without site forces they are not needed.

        Raises `OrganError`.
        """
        return SiteColumns(self.U, *compliance(self.factor, self.Z))

    def correction(self, answer: "FiniteAnswer") -> Array:
        """Return A⁻¹ times the residual of an answer under its forces, shape `(N,)` [m].

        It is cached for the last point and forces. Raises `OrganError`.
        """
        return self._corrections.of((answer.point, answer.f_y, answer.p), lambda: self.factor.solve(answer.residual))

    def gaps_by_forces(self, pairing: Pairing, some: Indices) -> Array:
        """Return the columns of `some` pairs `(j,)` of G A⁻¹ Gᵀ, shape `(k, j)` [m/N].

        They are cached for the last G. Raises `OrganError` if the tangent cannot be solved.
        """
        return self._gaps.of((pairing.G,), lambda: gap_compliance(self.factor, pairing.G)).of(some)


@dataclass(frozen=True)
class SiteColumns:
    """The motion by forces on the sites, of the tangent A at the displacement `U`.

    `W` `(N, k)` is A⁻¹ Zᵀ, and `C_z` `(k, k)` is Z A⁻¹ Zᵀ.
    """

    U: Array
    W: Array
    C_z: Array
    _gaps: Recent[Array] = field(default_factory=lambda: Recent(1), repr=False)

    def gaps(self, sums: csr_matrix, lip_rows: csr_matrix) -> Array:
        """Return G W, shape `(k, number of z)`, for a pairing with G = `sums` `lip_rows`.

        It is cached for the last `sums`.
        """
        return self._gaps.of((sums,), lambda: np.asarray(sums @ touching(lip_rows, self.W)))

    @property
    def worth(self) -> float:
        """The number of corrections that take as long as these columns."""
        return len(self.C_z) / TOGETHER


def unsolved(error: FactorError) -> OrganError:
    """Return the error for a tangent that cannot be solved.

    The step is then repeated as two half steps.
    """
    return OrganError(f"the tissue's tangent cannot be solved ({error})")


@dataclass(frozen=True)
class TangentSolver:
    """A solver of a tangent. Raises `OrganError` if the tangent cannot be solved."""

    own: Solver

    @property
    def A(self) -> csr_matrix:
        """The tangent, shape `(N, N)`."""
        return self.own.A

    def solve(self, b: Array, guess: Callable[[], Array] | None = None, rough: bool = False) -> Array:
        """Return A⁻¹ b; arguments as of `Solver.solve`."""
        try:
            return self.own.solve(b, guess, rough)
        except FactorError as error:
            raise unsolved(error) from error


def keep_at_rest(unknowns: int) -> int:
    """Return `keep` for the equilibria of an organ, which allow more corrections than a step in time.

    A factorisation takes O(n²) operations and a back-substitution O(n^(4/3)) (George, SIAM J.
    Numer. Anal. 10, 1973). A factor is therefore worth O(n^(2/3)) corrections.
    """
    return round(KEEP * max(1.0, unknowns / CHEAP) ** (2.0 / 3.0))


def corrections_left(before: float, after: float, tolerance: float) -> float:
    """Return the number of corrections until a residual is within its `tolerance`.

    Each is assumed to reduce the residual as the last one did, from `before` to `after`. The number
    is infinite if that did not reduce it.
    """
    if after <= tolerance:
        return 0.0
    return float(np.log(after / tolerance) / np.log(before / after)) if after < before else np.inf


@dataclass(frozen=True)
class Point:
    """The organ at `U` `(N,)` without site forces.

    `F` are the deformation gradients at the cells, and `r` `(N,)` [N] is the residual. `scale` [N]
    is the largest force of a cell on a node, and `z` are the numbers of the sites.
    """

    U: Array
    F: Array
    r: Array
    scale: float
    z: Array


@dataclass(frozen=True)
class Forces:
    """Forces on the organ.

    `f_y` (9p,) are the site forces, and `push` = Gᵀ p `(N,)` [N] the contact forces over the free
    unknowns.
    """

    f_y: Array
    push: Array


@dataclass(frozen=True)
class FiniteAnswer:
    """The answer linearised at a `point` under forces `f_y` (9p,) and `p` (k,).

    The `tangent` was computed at this point or at an earlier one. `columns` are those of an earlier
    tangent; None for its own. `pairing` is the pairing of the lips. `ahead` (N,) [m] is an
    extrapolation beyond the correction with this tangent; None without extrapolation. `far` is True
    if a correction was shortened below SHORTER, or prolonged, since the start of the step.
    """

    organ: "FiniteOrgan"
    motion: Motion
    point: Point
    tangent: Tangent
    columns: SiteColumns | None
    f_y: Array
    p: Array
    pairing: Pairing
    ahead: Array | None = None
    far: bool = False
    linear: ClassVar = False  # `again` can return an answer with another tangent

    @property
    def by_sites(self) -> SiteColumns:
        """The columns of the sites."""
        return self.columns or self.tangent.columns

    @cached_property
    def g_free(self) -> Array:
        """Gaps without site and contact forces, shape `(k,)` [m]."""
        if not self.organ.touches:
            return EMPTY
        g = self.pairing.g0 + self.pairing.G @ (self.point.U + self._correction) - self.C_cy @ self.f_y
        acts = np.flatnonzero(self.p)
        g = g - self.gaps_by_forces(acts) @ self.p[acts]
        return np.asarray(g + self._GW_turning @ (self.organ.map.Z @ self._correction))

    @property
    def _GW(self) -> Array:
        """G A⁻¹ Zᵀ, shape `(k, number of z)`."""
        return self.by_sites.gaps(self.pairing.sums, self.organ.lip_rows)

    @cached_property
    def _GW_turning(self) -> Array:
        """The effect of turning fibre frames, G A⁻¹ Zᵀ S (1 − C_z S)⁻¹, `(k, number of z)`."""
        return np.asarray(self._GW @ self._S @ self._bent)

    @cached_property
    def C_cy(self) -> Array:
        """Gaps by site forces, shape `(k, 9p)`."""
        return np.asarray(self._GW @ self._bent.T @ self.J.T)

    def gaps_by_forces(self, some: Indices) -> Array:
        """Return the gaps by the contact forces of `some` pairs `(j,)`, shape `(k, j)` [m/N]."""
        C = self.tangent.gaps_by_forces(self.pairing, some)
        return C + self._GW_turning @ self._GW[some].T if self._S.nnz else C

    @property
    def friction(self) -> Array:
        """Coefficient of friction of each pair, shape `(pairs,)` [-]."""
        return self.organ.friction(self.pairing.facing)

    @property
    def points(self) -> Array:
        """The facing data of outside points, shape `(j, 9 + l)`."""
        return NO_POINTS if self.pairing.points is None else self.pairing.points

    @cached_property
    def _correction(self) -> Array:
        """A⁻¹ times the residual under `f_y` and `p`, plus the extrapolation `ahead`, shape `(N,)` [m]."""
        way = self.tangent.correction(self)
        return way if self.ahead is None else way + self.ahead

    @property
    def residual(self) -> Array:
        """The residual under `f_y` and `p`, shape `(N,)` [N]."""
        return self.organ.residual(self.point, self._forces(self.f_y, self.p))

    @cached_property
    def J(self) -> csr_matrix:
        """∂y/∂z, shape `(9p, k)`."""
        return self.organ.map.slope(self.point.z)

    @cached_property
    def _S(self) -> csr_matrix:
        return self.organ.map.bend(self.point.z, self.f_y)

    @cached_property
    def _bent(self) -> Array | csr_matrix:
        """(1 − C_z S)⁻¹, shape `(k, k)`."""
        if not self._S.nnz:
            return identity(self._S.shape[0], format="csr")
        try:
            return np.asarray(np.linalg.inv(np.eye(self._S.shape[0]) - self.by_sites.C_z @ self._S))
        except np.linalg.LinAlgError as error:
            raise OrganError("the fibre frames turn with the tissue without limit") from error

    @cached_property
    def C(self) -> Array:
        """Site compliance, shape `(9p, 9p)`."""
        C = self.J @ self._bent @ self.by_sites.C_z @ self.J.T
        return np.asarray(0.5 * (C + C.T))

    @cached_property
    def y_free(self) -> Array:
        """Linearised site variables without site and contact forces, shape `(9p,)`."""
        y = self.organ.map.y(self.point.z) + self.J @ (self._bent @ (self.organ.map.Z @ self._correction))
        return np.asarray(y - self.C @ self.f_y - self.p @ self.C_cy)

    def moved(self, f_y: Array, p: Array) -> Array:
        """Return U_k + dU under the forces `f_y` and `p`, shape `(N,)` [m]."""
        g, U_p, push = self.J.T @ (f_y - self.f_y), self._correction, p - self.p
        if push.any():
            U_p = U_p + self.tangent.factor.solve(self.pairing.G.T @ push)
        if self._S.nnz:
            g = g + self._S @ (self._bent @ (self.by_sites.C_z @ g + self.organ.map.Z @ U_p))
        if not g.any():
            return self.point.U + U_p
        by_sites = (
            self.tangent.columns.W @ g if self.columns is None else self.tangent.factor.solve(self.organ.map.Z_T @ g)
        )
        return np.asarray(self.point.U + U_p + by_sites)

    def _forces(self, f_y: Array, p: Array) -> Forces:
        return Forces(f_y, self.pairing.G.T @ p if p.size else np.zeros(self.organ.size))

    def accept(self, f_y: Array, p: Array = EMPTY) -> OrganState:
        """Return the state at the end of the step. Raises `OrganError` if a cell is inverted there."""
        U = self.moved(f_y, p)
        self.organ.refuse_inverted(U)
        return self.organ.state_at(self, U, f_y, p)

    def again(self, f_y: Array, p: Array) -> "FiniteAnswer":
        """Return the answer linearised at a new point under these forces.

        It is itself if the organ's equations have converged under these forces. Raises `OrganError`
        if there is no new point or no tangent.
        """
        organ, forces, tangent, columns = self.organ, self._forces(f_y, p), self.tangent, self.columns
        before = organ.off_balance(self.point, forces)
        point, share = organ.go(self.motion, self.point, self.moved(f_y, p), forces)
        if share == 1.0 and not (tangent.definite or self.motion.led):
            point, share = organ.go_further(self.motion, self.point, point, self._forces(self.f_y, self.p), forces)
        if share < 1.0:  # far from a solution: one correction without the columns of the sites
            tangent, before = organ.tangent(self.motion, point.U, point.F), organ.off_balance(point, forces)
            way = tangent.factor.solve(organ.residual(point, forces))
            point = organ.go(self.motion, point, point.U + way, forces)[0]
        after, tolerance = organ.off_balance(point, forces), organ.tolerance(self.motion, point)
        missed, change = self._missed(point, f_y, p)
        if share == 1.0 and after <= tolerance and missed <= BENT:
            return self
        if corrections_left(before, after, tolerance) >= organ.keep:
            tangent = organ.tangent(self.motion, point.U, point.F)
        if tangent is not self.tangent:
            columns = organ.lent(self.motion, self.by_sites) if f_y.any() else None
        if columns is not None and share == 1.0 and corrections_left(change, missed, BENT) >= columns.worth:
            columns = None
        far = self.far or not SHORTER <= share <= 1.0
        answer = FiniteAnswer(organ, self.motion, point, tangent, columns, f_y, p, self.pairing, far=far)
        extrapolated = tangent is self.tangent and share == 1.0 and not forces.push.any()
        return answer.after(self) if extrapolated else answer

    def after(self, last: "FiniteAnswer") -> "FiniteAnswer":
        """Return the answer with an extrapolation from the last two corrections.

        Both corrections have the same tangent, and no additional solve is needed. With an old
        tangent, the remaining error of each correction has nearly the same ratio and direction
        (Anderson, J. ACM 12, 1965, with one stored correction; more stored corrections hardly save
        iterations).
        """
        way = self.point.U - last.point.U
        left = self.moved(self.f_y, self.p) - self.point.U
        change = left - (way if last.ahead is None else way - last.ahead)
        part = float(left @ change) / max(float(change @ change), np.finfo(float).tiny)
        return replace(self, ahead=-part * (way + change))

    def _missed(self, point: Point, f_y: Array, p: Array) -> tuple[float, float]:
        """Return the error of the linearised site variables at a point, and their change.

        Both are the largest in the numbers of a frame, and in displacements over the organ's span.
        """
        if self.columns is None and not any(self.organ.map.cut):
            return 0.0, 0.0
        y, then = self.organ.map.y(point.z), self.organ.map.y(self.point.z)
        errors = y - (self.y_free + self.C @ f_y + p @ self.C_cy), y - then
        scale = np.repeat([self.organ.span, 1.0], [3, 6])
        missed, change = (float(np.max(np.abs(error.reshape(-1, 9)) / scale, initial=0.0)) for error in errors)
        return missed, change

    @property
    def equation(self) -> Equation:
        """The organ's rows of the assembled matrix."""
        organ, Z = self.organ, self.organ.map.Z
        A = csr_matrix(self.tangent.A - Z.T @ self._S @ Z)
        Y = csr_matrix(self.J @ Z)
        b = A @ self.point.U - self.point.r
        b = b if self.ahead is None else b + self.tangent.A @ self.ahead
        y0 = organ.map.y(self.point.z) - Y @ self.point.U
        return Equation(A, b, y0, Y, self.pairing.g0, self.pairing.G)


@dataclass(frozen=True, eq=False)
class FiniteOrgan(MeshedOrgan):
    """An organ at finite strain.

    - `law`: its energy.
    - `inertia`: if False, the organ is always in equilibrium.
    - `damping` [1/s]: the factor α of the mass-proportional damping.
    - `keep`: a factor is reused if fewer corrections than these are left with it; with 0 there is
      a new tangent for every correction.
    - `relaxation`: the relaxation of its stress; None without relaxation.
    """

    law: Hyperelasticity = field(kw_only=True)
    inertia: bool = True
    damping: float = 0.0
    keep: int = KEEP
    relaxation: Prony | None = None
    turns: ClassVar = True
    _pattern: Pattern = field(default_factory=Pattern, init=False, repr=False)
    _energies: Recent[tuple[float, Array]] = field(default_factory=Recent, init=False, repr=False)
    _met: deque[tuple[Array, Array, Array, Density | None]] = field(
        default_factory=lambda: deque(maxlen=2), init=False, repr=False
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        body = self.elasticity
        if self.law.body is not body:
            raise TissueError("law: it has another body than the organ; build both on the same body")
        if not 0.0 <= self.damping < np.inf:
            raise TissueError(f"damping = {self.damping} 1/s: allowed is 0 or more; damping takes energy")
        if not self.inertia:
            refuse_loose(body)
        dead = np.array([load.pressure is None for load in self.loads], dtype=float)
        object.__setattr__(self, "surface_load", self.surface_load * dead)

    # --- the organ's numbers ----------------------------------------------------------------------

    @cached_property
    def map(self) -> SiteMap:
        """The map from z = Z U to the site variables."""
        return SiteMap(self.sites)

    @cached_property
    def _round_off(self) -> float:
        """Force due to round-off of F [N]."""
        stiffness = float(self.elasticity.K.diagonal().max())
        return ROUND_OFF * stiffness * float(np.cbrt(6.0 * self.law.weights.sum(axis=0).max()))

    @cached_property
    def rounded_energy(self) -> float:
        """Round-off of the elastic energy [J]: that of tissue at a strain of one."""
        material = self.elasticity.material
        stiffness = np.asarray(material.lame_lambda) + 2.0 * np.asarray(material.lame_mu)
        return ROUND_OFF * float(np.sum(self.law.weights * stiffness))

    @cached_property
    def _largest_mass(self) -> float:
        """Largest mass of a node [kg]."""
        return float(self.M.diagonal().max(initial=0.0))

    def tolerance(self, motion: Motion, point: Point) -> float:
        """Return the accepted residual of a solved step [N]."""
        inertia = motion.a * self._largest_mass * float(np.abs(point.U).max(initial=0.0))
        return RESIDUAL * point.scale + self._round_off + ROUND_OFF * inertia

    def point(self, motion: Motion, U: Array, F: Array | None = None) -> Point:
        """Return the organ at U.

        `F` are its deformation gradients; None if they are not known yet.
        """
        F = self.law.gradient(self.whole(U)) if F is None else F
        forces, scale = self.law.forces(F, motion.density)
        self._met.append((U, F, forces[self.elasticity.free], motion.density))
        r = forces[self.elasticity.free] - motion.load - self.pressing(motion.shares, U)
        if motion.a:
            r = r + self.M @ (motion.a * (U - motion.inertia) + self.damping * motion.d * (U - motion.damping))
        return Point(U, F, r, scale, np.asarray(self.map.Z @ U))

    def _places(self, U: Array) -> Array:
        """Return the positions of the nodes, shape `(m, 3)` [m]."""
        return self.elasticity.points + self.nodal(U)

    def pressing(self, shares: Array | None, U: Array) -> Array:
        """Return the forces of the pressures over the free unknowns, `(N,)` [N].

        Pressures follow their surfaces.
        """
        if not self.surface.follows:
            return np.zeros(self.size)
        return self.surface.pressing(shares, self._places(U))[self.elasticity.free]

    def load_resultants(self, state: OrganState) -> Array:
        """Return the sum of the forces of each whole load, `(l, 3)` [N].

        Pressures act on the deformed surfaces.
        """
        return self.surface.resultants_at(self._places(state.U))

    def off_balance(self, point: Point, forces: Forces) -> float:
        """Return the largest residual under forces [N]."""
        return float(np.abs(self.residual(point, forces)).max(initial=0.0))

    def residual(self, point: Point, forces: Forces) -> Array:
        """Return the forces minus the organ's own forces at a point, shape `(N,)` [N]."""
        J_T = self.map.slope(point.z).T
        return np.asarray(self.map.Z_T @ (J_T @ forces.f_y) + forces.push - point.r)

    def go(self, motion: Motion, start: Point, U: Array, forces: Forces) -> tuple[Point, float]:
        """Return the point at U, or at a part of the way from `start` to U, and this part.

        No cell is inverted at the point. Unless the organ is led, one of two conditions holds. The
        residual is at most that at the start, or the slope of the potential under constant forces
        rises to at most ENOUGH of its size at the start (Matthies & Strang, Int. J. Numer. Meth.
        Eng. 14, 1979). A way that leads uphill at its start, as an extrapolation can, is kept if it
        reduces the residual; otherwise its opposite is taken. Raises `OrganError` if there is no
        such point.
        """
        way, share, inverted = U - start.U, 1.0, np.inf
        before, down = self.off_balance(start, forces), float(self.residual(start, forces) @ way)
        while share >= SHORTEST:
            there = start.U + share * way if share < 1.0 else U
            F, part = self.law.gradient(self.whole(there)), SHORTER
            if determinant(F).min() > 0.0:
                # Infinite forces at this point shorten the way.
                with np.errstate(over="ignore", invalid="ignore"):
                    point = self.point(motion, there, F)
                    left = self.residual(point, forces)
                    up = -float(left @ way)
                if motion.led or np.abs(left).max(initial=0.0) <= max(before, self.tolerance(motion, point)):
                    return point, share
                if down < 0.0:
                    way, down, U = -way, -down, start.U - way
                    continue
                if up <= ENOUGH * down:
                    return point, share
                part = max(down / (down + up), SHORTER) if np.isfinite(up) else SHORTER
            else:
                inverted = share
            share *= part
        raise OrganError(
            "the tissue finds no equilibrium: a cell would be inverted"
            if inverted < SHORTEST / SHORTER
            else "the tissue finds no equilibrium: both its residual and its energy increase, as at a snap-through"
        )

    def go_further(self, motion: Motion, start: Point, end: Point, first: Forces, last: Forces) -> tuple[Point, float]:
        """Return a point on the way from `start` to `end` and beyond, and the length of its way in this one.

        The potential under constant forces falls at first; its slope at the point is at most ENOUGH
        of that at the start, in size. A correction of a shifted tangent is as long as the shift
        allows, and not as long as the potential falls (Moré & Sorensen, Math. Program. 16, 1979). The
        way ends at `end` if the forces, `first` at the start and `last` at the end, change much along
        it: thread or contact then hold the organ.
        """
        way, length = end.U - start.U, 1.0
        down = float(self.residual(start, last) @ way)
        if abs(down - self.residual(start, first) @ way) > (1.0 - ENOUGH) * down:
            return end, length
        while length < LONGEST and self.residual(end, last) @ way > ENOUGH * down:
            there = start.U + 2.0 * length * way
            F = self.law.gradient(self.whole(there))
            if determinant(F).min() <= 0.0:
                break
            with np.errstate(over="ignore", invalid="ignore"):
                point = self.point(motion, there, F)
                if not self.residual(point, last) @ way >= -ENOUGH * down:
                    break
            end, length = point, 2.0 * length
        return end, length

    def refuse_inverted(self, U: Array) -> None:
        """Raise `OrganError` if a cell is inverted at one of its nodes at U.

        A P2 cell can be inverted there although it is not at its quadrature points.
        """
        body = self.elasticity
        J = volume_ratios(body, self.whole(U), np.asarray(body.cell.doflocs)).min(axis=0)
        if J.min() <= 0.0:
            x, y, z = 1e3 * self._places(U)[body.cells[J.argmin()]].mean(axis=0)
            where = (
                f"the worst of {np.count_nonzero(J <= 0.0)} at ({x:.3g}, {y:.3g}, {z:.3g}) mm, where J = {J.min():.2g}"
            )
            raise OrganError(f"the tissue finds no equilibrium: a cell would be inverted ({where})")

    def tangent(self, motion: Motion, U: Array, F: Array | None = None) -> Tangent:
        """Return the factorised tangent at U.

        The last few tangents are cached. Raises `OrganError`.
        """
        shares = motion.shares if self.surface.follows else None
        met, H = (None, None) if motion.course is None else (motion.course.dt, motion.course.H)

        def made() -> Tangent:
            A = self.law.tangent(self.law.gradient(self.whole(U)) if F is None else F, motion.density)
            if shares is not None:
                free = self.elasticity.free
                A = csr_matrix(A - self.surface.pressing_tangent(shares, self._places(U))[free][:, free])
            if motion.a:
                A = csr_matrix(A + (motion.a + self.damping * motion.d) * self.M)
            factor, definite = self._factor(A, motion.led)
            return Tangent(U, TangentSolver(factor), self.map.Z, definite, H)

        values = motion.a, motion.d, met, motion.led, b"" if shares is None else shares.tobytes()
        return self._tangents.of((U, H), made, values)

    def lent(self, motion: Motion, columns: SiteColumns) -> SiteColumns | None:
        """Return columns of an earlier tangent for a new one; None if it needs its own."""
        return self._lent.of((columns.U,), lambda: columns) if self._lends(motion) else None

    def _lends(self, motion: Motion) -> bool:
        """Return whether tangents can use columns of an earlier one.

        The tangents of a step in time, of relaxation and of following pressures depend on more than
        the displacement, and close to a limit point of a branch they change without limit.
        """
        own = motion.a or motion.led or motion.course is not None or self.surface.follows
        return bool(self.keep and not own)

    @cached_property
    def span(self) -> float:
        """Diagonal of the organ's bounding box [m]."""
        return float(np.linalg.norm(np.ptp(self.elasticity.points, axis=0)))

    @cached_property
    def _lent(self) -> Recent[SiteColumns]:
        """The columns that other tangents use, by displacement."""
        return Recent()

    @cached_property
    def _tangents(self) -> Recent[Tangent]:
        """The last tangents, as many as fit into memory."""
        return Recent(min(KEPT_TANGENTS, self.choice.room))

    def _factor(self, A: csr_matrix, led: bool) -> tuple[Solver, bool]:
        """Return the factorised A, and whether A is positive definite.

        Unless the organ is `led`, the smallest of SHIFTS times the stiffness at small strain is
        added to an indefinite A with which it is definite, so that corrections lead downhill.
        Without such a shift A is factorised by LU. Raises `OrganError` if A is singular.
        """
        more = len(self._tangents) > 0
        for shift in (0.0,) if led else (0.0, *SHIFTS):
            try:
                shifted = csr_matrix(A + shift * self.K) if shift else A
                return solver(shifted, self.places, self.choice.name, more, self._pattern), not shift
            except FactorError as error:
                log.debug("with a shift of %g: %s", shift, error)
        try:
            return factorize_indefinite(A, self.places, self._pattern), False
        except FactorError as error:
            raise unsolved(error) from error

    # --- the interface of the coupling ------------------------------------------------------------

    def motion(self, scheme: TimeScheme, past: Sequence[OrganState], shares: Array | None) -> Motion:
        """Return the inertia and loads of a step of `scheme` from states `past`, newest first."""
        load, course = self.load_under(shares), self.course(slips_since(past, scheme), scheme.dt) if past else None
        if not (self.inertia and scheme.a):
            return Motion(0.0, 0.0, EMPTY, EMPTY, load, shares, course=course)
        terms = list(zip(scheme.coefficients, past, strict=True))
        inertia = sum((alpha * s.U + beta * s.V for (alpha, beta, _), s in terms), np.zeros(self.size))
        damping = sum((gamma * s.U for (_, _, gamma), s in terms), np.zeros(self.size))
        return Motion(scheme.a, scheme.d, inertia, damping, load, shares, course=course)

    def course(self, state: OrganState, dt: float) -> Course | None:
        """Return the relaxation of stress in a step of `dt` [s]; None without relaxation."""
        if self.relaxation is None:
            return None
        S = self.law.distortional_stress(self.law.gradient(self.whole(state.U)))
        relaxing = np.zeros((len(self.relaxation.times), *S.shape)) if state.relaxing is None else state.relaxing
        H = self.relaxation.held(relaxing, S, dt)
        return Course(dt, relaxing, S, H, self.law.relaxing(self.relaxation.met(dt), H))

    def stressed(self, state: OrganState) -> Density | None:
        """Return the density with the stress of a state; None for the density of the body."""
        if self.relaxation is None or state.relaxing is None:
            return self.lasting
        return self.law.relaxing(1.0 - self.relaxation.total, state.relaxing.sum(axis=0))

    @cached_property
    def lasting(self) -> Density | None:
        """The density of tissue after complete relaxation; None for the density of the body."""
        return None if self.relaxation is None else self.law.relaxing(1.0 - self.relaxation.total, None)

    def start(self) -> OrganState:
        """Return the state at the start.

        It is at rest and undeformed. Without inertia, it is in equilibrium with gravity and
        prestretch. It is undeformed too if contact surfaces would cross in this equilibrium, or if
        an organ with pairs has no equilibrium. Raises `TissueError` if an organ without pairs has
        no equilibrium.
        """
        return self._started

    @cached_property
    def _started(self) -> OrganState:
        """The state at the start, computed once."""
        rest, none = np.zeros(self.size), np.zeros(self.y0.size)
        undeformed = OrganState(rest, rest, rest, none, np.zeros(self.contacts), shares=self.no_shares)
        if self.inertia:
            return undeformed
        try:
            sagged = self._sagged(undeformed)
        except OrganError as error:
            if self.pairs:
                return undeformed
            raise TissueError(
                f"the organ has no equilibrium under gravity and prestretch ({error}); take less of them, or firmer "
                "tissue"
            ) from error
        crosses = self.gaps is not None and self.gap(sagged).min() < 0.0
        return undeformed if crosses else sagged

    def _sagged(self, state: OrganState) -> OrganState:
        """Return the equilibrium without site forces; the iteration starts from a `state` at rest.

        Raises `OrganError`.
        """
        none, no_push, U = state.f_y, np.zeros(self.contacts), state.U
        still = Motion(0.0, 0.0, EMPTY, EMPTY, self.load, None, course=self.course(state, np.inf))
        point, no_forces = self.point(still, U), Forces(none, np.zeros(self.size))
        if self.off_balance(point, no_forces) <= self._round_off:
            return state
        tangent = self.tangent(still, U, point.F)
        answer = FiniteAnswer(self, still, point, tangent, None, none, no_push, self.pairing(None))
        for _ in range(MOST_CORRECTIONS):
            after = answer.again(none, no_push)
            if after is answer:
                last = answer.tangent
                return replace(state, U=answer.moved(none, no_push), linearised=last.U, linearised_H=last.H)
            answer = after
        raise OrganError(f"no convergence in {MOST_CORRECTIONS} Newton iterations")

    def answer(
        self, scheme: TimeScheme, past: Sequence[OrganState], time: float = np.inf, share: float = 1.0
    ) -> FiniteAnswer:
        """Return the answer of a step of `scheme` from the states `past`, newest first.

        `share` of the loads acts at `time` [s]. The answer is linearised at the newest state, with
        the tangent that was last used for this state.
        """
        motion, state = self.motion(scheme, past, self.shares_at(time, share)), past[0]
        point, columns = self.point(motion, state.U), None
        if self.keep and state.linearised is not None:
            if (at := state.columns) is not None and self._lends(motion):
                columns = self._lent.of((at,), lambda: self.tangent(motion, at).columns)
            tangent = self.tangent(self._with_stress(motion, state.linearised_H), state.linearised)
        else:
            tangent = self.tangent(motion, state.U, point.F)
        return self._answer(motion, point, tangent, columns, state, self.paired_after(past, scheme))

    def _answer(
        self,
        motion: Motion,
        point: Point,
        tangent: Tangent,
        columns: SiteColumns | None,
        state: OrganState,
        pairing: Pairing,
    ) -> FiniteAnswer:
        """Return the answer linearised under the forces of a state, without the forces of other pairs."""
        p = state.p if state.p.size == len(pairing.g0) else np.zeros(len(pairing.g0))
        return FiniteAnswer(self, motion, point, tangent, columns, state.f_y, p, pairing)

    def _with_stress(self, motion: Motion, H: Array | None) -> Motion:
        """Return the motion with the constant stress `H` of an earlier step; None without relaxation."""
        if motion.course is None or H is None or self.relaxation is None:
            return motion
        density = self.law.relaxing(self.relaxation.met(motion.course.dt), H)
        return replace(motion, course=replace(motion.course, H=H, density=density))

    def under(self, answer: FiniteAnswer, time: float, share: float) -> FiniteAnswer:
        """Return an answer at rest at the same displacement under another `share` of the loads.

        The loads are those at `time` [s]. The new answer is `led`, because the potential has no
        minimum at an unstable equilibrium.
        """
        shares = self.shares_at(time, share)
        motion = replace(answer.motion, load=self.load_under(shares), shares=shares, led=True)
        point, tangent = self.point(motion, answer.point.U, answer.point.F), answer.tangent
        if not (tangent.definite or answer.motion.led):
            tangent = self.tangent(motion, tangent.U)
        return replace(answer, motion=motion, point=point, tangent=tangent, columns=None)

    def holds(self, answer: FiniteAnswer) -> bool:
        """Return whether the equilibrium of an answer is stable under dead forces.

        It is stable if the tangent there is positive definite. That of the answer can belong to an
        earlier displacement.
        """
        return self.tangent(answer.motion, answer.point.U, answer.point.F).definite

    def off_saddle(self, answer: FiniteAnswer, state: OrganState) -> tuple[OrganState, OrganState]:
        """Return an unstable `state` moved to both sides along a motion with negative stiffness.

        The motion is found by the power method with the factor of the shifted tangent, whose softest
        motions are the unstable ones.
        """
        factor = self.tangent(replace(answer.motion, led=False), answer.point.U, answer.point.F).factor
        way = factor.solve(np.random.default_rng(0).standard_normal(self.size))
        for _ in range(POWERS):
            way = factor.solve(way / np.linalg.norm(way))
        strain = np.abs(self.law.gradient(self.whole(way)) - np.eye(3)[:, :, None, None]).max()
        off = OFF / strain * way
        return replace(state, U=state.U + off), replace(state, U=state.U - off)

    def distance(self, one: OrganState, other: OrganState) -> float:
        """Return the largest difference of the displacements of two states [m]."""
        return float(np.abs(one.U - other.U).max())

    def has_jumped(self, answer: FiniteAnswer, old: OrganState, new: OrganState) -> bool:
        """Return whether a `new` state has jumped to another branch than the `old` one.

        `answer` is the converged answer of the new state. Two conditions must hold. The
        displacement is much longer than the tangent at its end predicts for the change of the
        elastic forces. The elastic forces along the straight path drop and rise again. Stiffening
        tissue or a turning flap meets only one condition. If a hand leads tissue past a limit
        point, the forces hardly drop before they rise, and less on a shorter path.
        """
        way, density = new.U - old.U, answer.motion.density
        last, first = (self._forces_at(state.U, density)[1] for state in (new, old))
        tangent = answer.tangent
        if not tangent.definite:
            tangent = self.tangent(replace(answer.motion, led=True), answer.point.U, answer.point.F)
        straight = tangent.factor.solve(last - first)
        if np.linalg.norm(way) <= FARTHEST * np.linalg.norm(straight):
            return False
        forces = [first, *(self._force_or_none(old.U + part * way, density) for part in PARTS), last]
        works = np.array([np.inf if force is None else force @ way for force in forces])
        crests, rises = np.maximum.accumulate(works), np.maximum.accumulate(works[::-1])[::-1]
        drop = np.minimum(crests, rises)[np.isfinite(works)] - works[np.isfinite(works)]
        return bool(drop.max() > DROP * max(abs(works[0]), abs(works[-1])))

    def _force_or_none(self, U: Array, density: Density | None) -> Array | None:
        """Return the force of a density's energy (N,) [N].

        None if the force is not finite or a cell is inverted.
        """
        F = self.law.gradient(self.whole(U))
        with np.errstate(over="ignore", invalid="ignore"):
            force = self.law.forces(F, density)[0][self.elasticity.free]
        return force if determinant(F).min() > 0.0 and np.isfinite(force).all() else None

    def state_at(self, answer: FiniteAnswer, U: Array, f_y: Array, p: Array) -> OrganState:
        """Return the state at the end of a step, from its last answer."""
        motion, pairing, tangent = answer.motion, answer.pairing, answer.tangent
        if motion.a:
            V, A = motion.d * (U - motion.damping), motion.a * (U - motion.inertia)
        else:
            V = A = np.zeros(self.size)
        rest = p, pairing.facing, motion.shares, tangent.U
        stress = self.relaxed(motion.course, U)
        state = OrganState(U, V, A, f_y, *rest, relaxing=stress, points=pairing.points, linearised_H=tangent.H)
        return state if answer.columns is None else replace(state, columns=answer.columns.U)

    def relaxed(self, course: Course | None, U: Array) -> Array | None:
        """Return the relaxing stresses at the end of a step, shape `(b, 3, 3, q, c)` [Pa].

        `U` `(N,)` [m] is the displacement there. None without relaxation.
        """
        if course is None or self.relaxation is None:
            return None
        change = self.law.distortional_stress(self.law.gradient(self.whole(U))) - course.S
        return self.relaxation.after(course.relaxing, change, course.dt)

    def site_variables(self, state: OrganState) -> Array:
        """Return the site variables y(Z U), shape `(9p,)`."""
        return np.asarray(self.map.y(np.asarray(self.map.Z @ state.U)))

    def impulse(self, state: OrganState) -> SiteAnswer | None:
        """Return the answer to an impulse on the sites; None without inertia.

        Its `y_free` is dy/dt = J Z V, and its compliance J Z M⁻¹ Zᵀ Jᵀ.
        """
        if not self.inertia:
            return None
        J, (W, C) = self.map.slope(np.asarray(self.map.Z @ state.U)), self._mobility

        def struck(j: Array, p: Array) -> OrganState:
            return replace(state, V=state.V + W @ (J.T @ j))

        return SiteAnswer(J @ (self.map.Z @ state.V), lambda: J @ C @ J.T, struck)

    @cached_property
    def _mobility(self) -> tuple[Array, Array]:
        """The matrices M⁻¹ Zᵀ `(N, k)` and Z M⁻¹ Zᵀ `(k, k)`."""
        return compliance(mass_solver(self.M, self.places, self.choice.name), self.map.Z)

    def displace(self, scheme: TimeScheme, state: OrganState, y: Array, f_y: Array) -> LinearAnswer:
        """Return the answer of a step without motion from `y` (9p,) while the forces are constant.

        The next step removes the remaining error of the linear answer.
        """
        motion = self.motion(scheme, [state] * len(scheme.coefficients), state.shares)
        tangent, J = self.tangent(motion, state.U), self.map.slope(np.asarray(self.map.Z @ state.U))
        operator = Operator(self, tangent.A, tangent.factor, tangent.columns.W @ J.T, J @ tangent.columns.C_z @ J.T)
        return self.displaced(operator, state, y, f_y, csr_matrix(J @ self.map.Z))

    def _stored(self, U: Array) -> tuple[float, Array]:
        """Return the energy without relaxing stress [J] and its force (N,) [N].

        They are cached for the last fields.
        """

        def stored() -> tuple[float, Array]:
            F, force = self._forces_at(U, self.lasting)
            return self.law.energy(F, self.lasting), force

        return self._energies.of((U,), stored)

    def _forces_at(self, U: Array, density: Density | None) -> tuple[Array, Array]:
        """Return F at the cells and the force of a density's energy (N,) [N].

        They are cached for the last points.
        """
        for known, F, force, by in self._met:
            if by is density and np.array_equal(known, U):
                return F, force
        F = self.law.gradient(self.whole(U))
        return F, self.law.forces(F, density)[0][self.elasticity.free]

    def energies(self, old: OrganState, new: OrganState) -> OrganEnergies:
        """Return the energies at `new` and the works from `old` to `new` [J].

        The work of the relaxing stress counts as viscous and uses its value at the end of the step.
        Some of this work is returned if the tissue moves back.

        The dissipation of the integrator is the work along the step of the forces at its end, minus
        the change of energy. It has parts of the cells, the mass and the contact, as in the linear
        organ, and the part f_y·(Δy − J Δz) of fibre frames.
        """
        dU, dV = new.U - old.U, new.V - old.V
        (stored, force), (before, _) = self._stored(new.U), self._stored(old.U)
        z, z_old = self.map.Z @ new.U, self.map.Z @ old.U
        bent = (
            new.f_y @ (self.map.y(z) - self.map.y(z_old) - self.map.slope(z) @ (z - z_old))
            if any(self.map.cut)
            else 0.0
        )
        numerical = force @ dU - (stored - before) + bent
        friction = relaxation = 0.0
        if self.relaxation is not None:
            relaxation = float((self._forces_at(new.U, self.stressed(new))[1] - force) @ dU)
        if new.p.any():
            pushes, friction = self.contact_works(new.p, self.pairing_of(new).G @ dU)
            numerical += pushes
        kinetic = viscous = 0.0
        if self.inertia:
            momentum = self.M @ new.V
            kinetic, viscous = float(0.5 * new.V @ momentum), float(self.damping * momentum @ dU)
            numerical += 0.5 * dV @ (self.M @ dV) + new.A @ (self.M @ dU) - momentum @ dV
        load_work = float((self.load_under(new.shares) + self.pressing(new.shares, new.U)) @ dU)
        works = load_work, viscous + relaxation, float(numerical), friction
        return OrganEnergies(kinetic, float(stored), *works, self._of_prestretch)

    @cached_property
    def _of_prestretch(self) -> float:
        """Energy that a prestretch stores in the reference shape [J]."""
        return self.law.energy_of_prestretch(self.lasting)
