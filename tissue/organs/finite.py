"""An organ at finite strain: energy Π(U), internal force ∂Π/∂U and tangent K(U), in the same coupled system.

    a M (U⁺ − U_a) + α d M (U⁺ − U_d) + ∂Π/∂U − load = Zᵀ (∂y/∂z)ᵀ f_y,    z = Z U

At an iterate U_k the site variables are seen through z alone (`tissue.sites.finite`), y ≈ y_k + J dz, so that with the
residual r_k without site forces, A_k = a M + α d M + K, C_z = Z A_k⁻¹ Zᵀ and S = f_y·∂²y/∂z² the answer is

    dz = (1 − C_z S)⁻¹ (C_z Jᵀ f_y − Z A_k⁻¹ r_k),   y = y_k + J dz,   dU = A_k⁻¹ (Zᵀ (Jᵀ f_y + S dz) − r_k).

Forces p on the gaps g = g0 + G U of lips that touch add Gᵀ p to the forces, with C_cc = G Ã⁻¹ Gᵀ, C_cy = G Ã⁻¹ Zᵀ Jᵀ
and Ã = A − Zᵀ S Z. What faces what, and which way, is found where a step begins, in the deformed shape.

The coupled Newton asks `again` after each correction: the organ goes to U_k + dU, cut short where a cell would turn
inside out or its potential under these forces would rise, and the answer stands once its own residual there is within
RESIDUAL of the forces of the cells. A factor is kept while it makes the residual fall; the converged answer does not
depend on it.
"""

from collections import OrderedDict, deque
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from scipy.sparse import csr_matrix, identity

from tissue.arrays import Array, Indices
from tissue.errors import FactorError, OrganError, TissueError
from tissue.hyperelasticity import Hyperelasticity
from tissue.materials.density import Density
from tissue.organs.meshed import (
    EMPTY,
    NO_LIPS,
    NO_POINTS,
    Columns,
    Equation,
    LinearAnswer,
    LipCompliance,
    Lips,
    MeshedOrgan,
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
from tissue.relaxation import Prony
from tissue.sites.finite import SiteMap
from tissue.solvers.choice import Solver, mass_solver, solver
from tissue.solvers.direct import Pattern
from tissue.solvers.factor import factorize_indefinite

RESIDUAL = 1e-10  # of the largest force of a cell on a node: the organ's own equations
ROUND_OFF = 2e-14  # of the force of a cell at a strain of one, which round-off of F = I + ∇U leaves
BENT = 1e-12  # of the numbers of a frame: y(z) against its linearisation
KEEP = 0.25  # a factor is kept while it makes the residual fall below this part of itself: a new one takes as long as
# two dozen corrections by the old one
SHORTEST = 2.0**-12  # part of a correction below which the organ gives up
RISE = 1e-10  # of the potential: it may rise by round-off
KEPT_TANGENTS = 2
FARTHEST = 4.0  # times the way that the tangent at its end says: a flap that is drawn upright under four times the load
# goes 2.7 times that far, an exponential that grows by e⁴ goes 4 times
PARTS = (0.25, 0.5, 0.75)  # of a way, at which is seen whether a barrier lies on it
DROP = 0.1  # of the largest force along a way: one that drops by less before it rises again is no barrier
MOST_CORRECTIONS = 50  # of the equilibrium without site forces


@dataclass(frozen=True)
class Motion:
    """What inertia does in a step: factors `a` [1/s²], `d` [1/s] and the fields U_a, U_d, `(N,)` [m]; the dead `load`
    of the step, `(N,)` [N], and the parts of the loads that act, as a state keeps them. Where the organ `creeps`, a is
    no inertia but drags it back to U_a; where it is `led` along a branch, its potential need not fall. Tissue that
    relaxes does so along a `course`."""

    a: float
    d: float
    inertia: Array
    damping: Array
    load: Array
    shares: Array | None
    creeps: bool = False
    led: bool = False
    course: "Course | None" = None

    @property
    def density(self) -> Density | None:
        """The density of tissue that relaxes in the step; None: its own."""
        return None if self.course is None else self.course.density


@dataclass(frozen=True)
class Course:
    """How the stress relaxes in a step of `dt` [s]: the stresses `relaxing` `(b, 3, 3, q, c)` and S_iso `(3, 3, q, c)`
    at its start [Pa], and the `density` that the step goes by (`tissue.relaxation`)."""

    dt: float
    relaxing: Array
    S: Array
    density: Density


@dataclass(frozen=True)
class Tangent:
    """A factorised where the organ was at `U`, with the rows `Z` `(k, N)` of its sites; whether A is `definite`."""

    U: Array
    A: csr_matrix
    factor: Solver
    Z: csr_matrix
    definite: bool = True
    _recalled: deque[tuple[csr_matrix, Columns]] = field(default_factory=lambda: deque(maxlen=1), repr=False)
    _let_go: deque[tuple[Array, Array]] = field(default_factory=lambda: deque(maxlen=1), repr=False)

    @cached_property
    def _columns(self) -> tuple[Array, Array]:
        """Made when first asked for: an organ that sags alone asks for none."""
        try:
            return compliance(self.factor, self.Z)
        except FactorError as error:
            raise unsolved(error) from error

    @property
    def W(self) -> Array:
        """A⁻¹ Zᵀ, shape `(N, k)`. Raises `OrganError`."""
        return self._columns[0]

    @property
    def C_z(self) -> Array:
        """Z A⁻¹ Zᵀ, shape `(k, k)`. Raises `OrganError`."""
        return self._columns[1]

    def way_without_forces(self, r: Array) -> Array:
        """Return −A⁻¹ r, shape `(N,)` [m]; that of the last residual `(N,)` [N] is remembered. Raises `OrganError`."""
        for known, way in self._let_go:
            if known is r:
                return way
        self._let_go.append((r, -solved(self.factor, r)))
        return self._let_go[-1][1]

    def gaps_by_forces(self, pairing: Pairing, some: Indices) -> Array:
        """Return the columns of `some` pairs `(j,)` of G A⁻¹ Gᵀ, shape `(k, j)` [m/N]; those of the last G are
        remembered. Raises `OrganError`."""
        if not any(known is pairing.G for known, _ in self._recalled):
            self._recalled.append((pairing.G, gap_compliance(self.factor, pairing.G)))
        try:
            return self._recalled[-1][1].of(some)
        except FactorError as error:
            raise unsolved(error) from error


@dataclass(frozen=True)
class Displaced(LipCompliance):
    """A tangent in the form of a linear answer: W = A⁻¹ Zᵀ Jᵀ `(N, 9p)` and C `(9p, 9p)`."""

    organ: MeshedOrgan
    A: csr_matrix
    factor: Solver
    W: Array
    C: Array


def unsolved(error: FactorError) -> OrganError:
    """Return the error of a tangent that cannot be solved, by which the step is taken in halves."""
    return OrganError(f"the tissue's tangent cannot be solved ({error})")


def solved(factor: Solver, b: Array) -> Array:
    """Return A⁻¹ b of a tangent. Raises `OrganError`."""
    try:
        return np.asarray(factor.solve(b))
    except FactorError as error:
        raise unsolved(error) from error


@dataclass(frozen=True)
class Point:
    """The organ at `U` `(N,)` under no site forces: `F` at the cells, residual `r` `(N,)` [N], and `scale` [N], the
    largest force of a cell on a node; the numbers `z` of its sites."""

    U: Array
    F: Array
    r: Array
    scale: float
    z: Array


@dataclass(frozen=True)
class Forces:
    """Forces on the organ: site forces `f_y` (9p,), and the `push` Gᵀ p of the lips over its unknowns `(N,)` [N]."""

    f_y: Array
    push: Array


@dataclass(frozen=True)
class FiniteAnswer:
    """The answer linearised at a `point` under forces `f_y` (9p,), by a `tangent` made there or before;
    `pairing` is what faces what on the lips; `ahead` (N,) [m] is how much further than by that tangent it goes, None:
    no further."""

    organ: "FiniteOrgan"
    motion: Motion
    point: Point
    tangent: Tangent
    f_y: Array
    pairing: Pairing
    ahead: Array | None = None

    @property
    def linear(self) -> bool:
        """No: `again` asks for another tangent."""
        return False

    @cached_property
    def g_free(self) -> Array:
        """Gaps without site and contact forces, shape `(k,)` [m]."""
        if not self.organ.touches:
            return EMPTY
        free = self.point.U + self._U_r + self.tangent.W @ (self._S @ (self._bent @ (self.organ.map.Z @ self._U_r)))
        return np.asarray(self.pairing.g0 + self.pairing.G @ free)

    @cached_property
    def _GW(self) -> Array:
        """G A⁻¹ Zᵀ, shape `(k, number of z)`."""
        return np.asarray(self.pairing.sums @ touching(self.organ.lip_rows, self.tangent.W))

    @cached_property
    def _GW_turning(self) -> Array:
        """G A⁻¹ Zᵀ S (1 − C_z S)⁻¹, by which frames that the needle cut turn, shape `(k, number of z)`."""
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
        """What points outside face, shape `(j, 9 + l)`."""
        return NO_POINTS if self.pairing.points is None else self.pairing.points

    @cached_property
    def _U_r(self) -> Array:
        """−A⁻¹ r, and what it goes ahead, shape `(N,)` [m]."""
        U_r = self.tangent.way_without_forces(self.point.r)
        return U_r if self.ahead is None else U_r + self.ahead

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
            return np.asarray(np.linalg.inv(np.eye(self._S.shape[0]) - self.tangent.C_z @ self._S))
        except np.linalg.LinAlgError as error:
            raise OrganError("the frames that the needle cut turn with the tissue without end") from error

    @cached_property
    def C(self) -> Array:
        """Site compliance, shape `(9p, 9p)`."""
        C = self.J @ self._bent @ self.tangent.C_z @ self.J.T
        return np.asarray(0.5 * (C + C.T))

    @cached_property
    def y_free(self) -> Array:
        """Site variables without site forces, as linearised, shape `(9p,)`."""
        return np.asarray(self.organ.map.y(self.point.z) + self.J @ (self._bent @ (self.organ.map.Z @ self._U_r)))

    def moved(self, forces: Forces) -> Array:
        """Return U_k + dU under forces, shape `(N,)` [m]."""
        g, U_p = self.J.T @ forces.f_y, self._U_r
        if forces.push.any():
            U_p = U_p + solved(self.tangent.factor, forces.push)
        if self._S.nnz:
            g = g + self._S @ (self._bent @ (self.tangent.C_z @ g + self.organ.map.Z @ U_p))
        return np.asarray(self.point.U + (self.tangent.W @ g if g.any() else 0.0) + U_p)

    def _forces(self, f_y: Array, p: Array) -> Forces:
        return Forces(f_y, self.pairing.G.T @ p if p.size else np.zeros(self.organ.size))

    def accept(self, f_y: Array, p: Array = EMPTY) -> OrganState:
        """Return the state at the end of the step."""
        U = self.moved(self._forces(f_y, p))
        return self.organ.state_at(self.motion, U, f_y, p, self.pairing, self.tangent)

    def again(self, f_y: Array, p: Array) -> "FiniteAnswer":
        """Return itself where the organ's own equations hold under these forces, else the answer linearised where
        they take it. Raises `OrganError`."""
        organ, forces = self.organ, self._forces(f_y, p)
        before = organ.off_balance(self.point, forces)
        point, share = organ.go(self.motion, self.point, self.moved(forces), forces, before)
        after = organ.off_balance(point, forces)
        if share == 1.0 and after <= organ.tolerance(self.motion, point) and self._fits(point, f_y, p):
            return self
        if after > organ.keep * before:
            tangent = organ.tangent(self.motion, point.U, point.F)
            return FiniteAnswer(organ, self.motion, point, tangent, f_y, self.pairing)
        kept = FiniteAnswer(organ, self.motion, point, self.tangent, f_y, self.pairing)
        return kept.after(self, forces) if share == 1.0 and self.motion.a and not forces.push.any() else kept

    def after(self, last: "FiniteAnswer", forces: Forces) -> "FiniteAnswer":
        """Return the answer that goes as far ahead as the last two corrections by one tangent say, without a solve
        more: an old tangent leaves much the same part of each, in much the same direction (Anderson, J. ACM 12, 1965,
        with one correction remembered: of more the last few steps need hardly fewer)."""
        way = self.point.U - last.point.U
        left = self.moved(forces) - self.point.U
        change = left - (way if last.ahead is None else way - last.ahead)
        part = float(left @ change) / max(float(change @ change), np.finfo(float).tiny)
        return replace(self, ahead=-part * (way + change))

    def _fits(self, point: Point, f_y: Array, p: Array) -> bool:
        """Whether the sites are where their linearisation says."""
        if not any(self.organ.map.cut):
            return True
        y = self.y_free + self.C @ f_y + p @ self.C_cy
        off = np.abs(self.organ.map.y(point.z) - y).reshape(-1, 3, 3)
        return bool(off[:, 1:].max() <= BENT)

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
    """An organ at finite strain, with `inertia` and mass-proportional `damping` α [1/s], or always in equilibrium.

    `hyper` is its energy, None the neo-Hookean solid of the same E and ν; `relaxation` is how it relaxes, None: not at
    all. `keep` is the part of itself that the residual must fall below for a factor to be kept; 0 makes every tangent
    anew.
    """

    hyper: Hyperelasticity | None = None
    inertia: bool = True
    damping: float = 0.0
    keep: float = KEEP
    relaxation: Prony | None = None
    M: csr_matrix = field(init=False, repr=False)
    _tangents: OrderedDict[tuple[float, float, float | None, int, bytes], Tangent] = field(init=False, repr=False)
    _pattern: Pattern = field(init=False, repr=False)
    _recalled: deque[tuple[Array, float, Array]] = field(init=False, repr=False)
    _met: deque[tuple[Array, Array, Array, Density | None]] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        super().__post_init__()
        body = self.elasticity
        if self.hyper is not None and self.hyper.body is not body:
            raise TissueError("hyper: it is of another body than the organ's; build both on one")
        if not 0.0 <= self.damping < np.inf:
            raise TissueError(f"damping = {self.damping} 1/s: allowed is 0 or more; damping takes energy")
        if not self.inertia:
            refuse_loose(body)
        if self.hyper is None:
            object.__setattr__(self, "hyper", Hyperelasticity(body))
        free = body.free
        dead = np.array([load.pressure is None for load in self.loads], dtype=float)
        object.__setattr__(self, "surface_load", self.surface_load * dead)
        object.__setattr__(self, "M", csr_matrix(body.M[free][:, free]))
        object.__setattr__(self, "_tangents", OrderedDict())
        object.__setattr__(self, "_pattern", Pattern())
        object.__setattr__(self, "_recalled", deque(maxlen=3))
        object.__setattr__(self, "_met", deque(maxlen=2))

    # --- the organ's own numbers ------------------------------------------------------------------------------

    @property
    def law(self) -> Hyperelasticity:
        """Its energy."""
        assert self.hyper is not None
        return self.hyper

    @cached_property
    def map(self) -> SiteMap:
        """The site variables of z = Z U."""
        return SiteMap(self.sites)

    @cached_property
    def _round_off(self) -> float:
        """Force that round-off of F leaves [N]."""
        stiffness = float(self.elasticity.K.diagonal().max())
        return ROUND_OFF * stiffness * float(np.cbrt(6.0 * self.law.weights.sum(axis=0).max()))

    @cached_property
    def _largest_mass(self) -> float:
        """Of a node [kg]."""
        return float(self.M.diagonal().max(initial=0.0))

    def tolerance(self, motion: Motion, point: Point) -> float:
        """Return the accepted residual of a solved step [N]."""
        inertia = motion.a * self._largest_mass * float(np.abs(point.U).max(initial=0.0))
        return RESIDUAL * point.scale + self._round_off + ROUND_OFF * inertia

    def point(self, motion: Motion, U: Array, F: Array | None = None) -> Point:
        """Return the organ at U, with its deformation gradients `F` where they are known."""
        F = self.law.gradient(self.whole(U)) if F is None else F
        forces, scale = self.law.forces(F, motion.density)
        self._met.append((U, F, forces[self.elasticity.free], motion.density))
        r = forces[self.elasticity.free] - motion.load - self.pressing(motion.shares, U)
        if motion.a:
            r = r + self.M @ (motion.a * (U - motion.inertia) + self.damping * motion.d * (U - motion.damping))
        return Point(U, F, r, scale, np.asarray(self.map.Z @ U))

    def _nodal(self, U: Array) -> Array:
        """Return the displacement of all nodes, shape `(m, 3)` [m]."""
        return self.elasticity.nodal(self.whole(U))

    def _places(self, U: Array) -> Array:
        """Return where the nodes are, shape `(m, 3)` [m]."""
        return self.elasticity.points + self._nodal(U)

    def pressing(self, shares: Array | None, U: Array) -> Array:
        """Return the forces of the pressures, which follow their surfaces, over the free unknowns `(N,)` [N]."""
        if not self.surface.follows:
            return np.zeros(self.size)
        return self.surface.pressing(shares, self._places(U))[self.elasticity.free]

    def load_resultants(self, state: OrganState) -> Array:
        """Return the sum of the forces of each whole load, pressures on their surfaces as they lie, `(l, 3)` [N]."""
        return self.surface.resultants_at(self._places(state.U))

    def off_balance(self, point: Point, forces: Forces) -> float:
        """Return the largest residual under forces [N]."""
        pull = self.map.Z_T @ (self.map.slope(point.z).T @ forces.f_y) + forces.push
        return float(np.abs(pull - point.r).max(initial=0.0))

    def potential(self, motion: Motion, start: Array, U: Array, F: Array, forces: Forces) -> float:
        """Return the potential that the organ minimises in a step under constant forces [J]; inf if a cell is inverted.
        The work of pressures is along the straight path from `start` (N,) to U."""
        out = self.law.energy(F, motion.density) - float((motion.load + forces.push) @ U)
        out -= float(forces.f_y @ self.map.y(np.asarray(self.map.Z @ U)))
        if self.surface.follows:
            way = self.elasticity.nodal(self.whole(U - start))
            out -= self.surface.pressing_work(motion.shares, self._places(start), way)
        if motion.a:
            for factor, back in ((motion.a, motion.inertia), (self.damping * motion.d, motion.damping)):
                out += 0.5 * factor * float((U - back) @ (self.M @ (U - back)))
        return out

    def go(self, motion: Motion, start: Point, U: Array, forces: Forces, before: float) -> tuple[Point, float]:
        """Go from `start` to U, or a part of the way: where no cell is inverted and, but where the organ is led, the
        residual, `before` at the start, or the potential falls. Returns where, and the part. Raises `OrganError`."""
        share, way, first, inverted = 1.0, U - start.U, None, np.inf
        while share >= SHORTEST:
            there = start.U + share * way if share < 1.0 else U
            F = self.law.gradient(self.whole(there))
            if self.law.is_possible(F):
                with np.errstate(over="ignore", invalid="ignore"):  # no forces are finite there: a part of the way is
                    point = self.point(motion, there, F)
                if motion.led or self.off_balance(point, forces) <= max(before, self.tolerance(motion, point)):
                    return point, share
                first = self.potential(motion, start.U, start.U, start.F, forces) if first is None else first
                if self.potential(motion, start.U, there, F, forces) <= first + RISE * abs(first):
                    return point, share
            else:
                inverted = share
            share *= 0.5
        raise OrganError(
            "the tissue finds no way to give way: a cell would turn inside out"
            if inverted < 2.0 * SHORTEST
            else "the tissue finds no way to give way: both its imbalance and its energy rise, as where it snaps"
        )

    def tangent(self, motion: Motion, U: Array, F: Array | None = None) -> Tangent:
        """Return the tangent at U, factorised; the last few are kept. Raises `OrganError`."""
        shares = motion.shares if self.surface.follows else None
        met = None if motion.course is None else motion.course.dt
        key = motion.a, motion.d, met, id(U), b"" if shares is None else shares.tobytes()
        known = self._tangents.get(key)
        if known is not None and known.U is U:
            return known
        while self._tangents and len(self._tangents) >= min(KEPT_TANGENTS, self.choice.room):
            self._tangents.popitem(last=False)
        A = self.law.tangent(self.law.gradient(self.whole(U)) if F is None else F, motion.density)
        if shares is not None:
            free = self.elasticity.free
            A = csr_matrix(A - self.surface.pressing_tangent(shares, self._places(U))[free][:, free])
        if motion.a:
            A = csr_matrix(A + (motion.a + self.damping * motion.d) * self.M)
        factor, definite = self._factor(A, motion.creeps)
        self._tangents[key] = Tangent(U, A, factor, self.map.Z, definite)
        return self._tangents[key]

    def _factor(self, A: csr_matrix, must: bool) -> tuple[Solver, bool]:
        """Return A factorised, by LU where it is not definite, which it `must` be or not: beyond a bifurcation; and
        whether it is. Raises `OrganError`."""
        try:
            return solver(A, self.places, self.choice.name, bool(self._tangents), self._pattern), True
        except FactorError as indefinite:
            if must:
                raise unsolved(indefinite) from indefinite
            try:
                return factorize_indefinite(A), False
            except FactorError as error:
                raise unsolved(error) from error

    # --- what the coupling asks -------------------------------------------------------------------------------

    def motion(self, scheme: TimeScheme, past: Sequence[OrganState], shares: Array | None) -> Motion:
        """Return the inertia and loads of a step of `scheme` from the states `past`, the newest first."""
        load, course = self.load_under(shares), self.course(slips_since(past, scheme), scheme.dt) if past else None
        if not (self.inertia and scheme.a):
            return Motion(0.0, 0.0, EMPTY, EMPTY, load, shares, course=course)
        terms = list(zip(scheme.coefficients, past, strict=True))
        inertia = sum((alpha * s.U + beta * s.V for (alpha, beta, _), s in terms), np.zeros(self.size))
        damping = sum((gamma * s.U for (_, _, gamma), s in terms), np.zeros(self.size))
        return Motion(scheme.a, scheme.d, inertia, damping, load, shares, course=course)

    def course(self, state: OrganState, dt: float) -> Course | None:
        """Return how the stress relaxes in a step of `dt` [s] from a state, None where it does not."""
        if self.relaxation is None:
            return None
        S = self.law.distortional_stress(self.law.gradient(self.whole(state.U)))
        relaxing = np.zeros((len(self.relaxation.times), *S.shape)) if state.relaxing is None else state.relaxing
        H = self.relaxation.held(relaxing, S, dt)
        return Course(dt, relaxing, S, self.law.relaxing(self.relaxation.met(dt), H))

    def stressed(self, state: OrganState) -> Density | None:
        """Return the density by whose stress the tissue is stressed in a state; None: its own."""
        if self.relaxation is None or state.relaxing is None:
            return self.lasting
        return self.law.relaxing(1.0 - self.relaxation.total, state.relaxing.sum(axis=0))

    @cached_property
    def lasting(self) -> Density | None:
        """The density of tissue in which all has relaxed; None: its own."""
        return None if self.relaxation is None else self.law.relaxing(1.0 - self.relaxation.total, None)

    def start(self) -> OrganState:
        """Return the state at the start: at rest and undeformed, or without inertia in equilibrium with gravity and
        prestretch, unless contact surfaces would cross there. Raises `TissueError` if no such state exists."""
        return self._started

    @cached_property
    def _started(self) -> OrganState:
        """The state at the start, found once."""
        rest, none = np.zeros(self.size), np.zeros(self.y0.size)
        undeformed = OrganState(rest, rest, rest, none, self.no_contact, shares=self.no_shares)
        if self.inertia:
            return undeformed
        try:
            U = self._sagged(rest)
        except OrganError as error:
            if self.pairs:
                return undeformed
            raise TissueError(
                f"the organ has no equilibrium under gravity and prestretch ({error}); take less of them, or firmer "
                "tissue"
            ) from error
        crosses = self.gaps is not None and (self.g0 + self.G[: self.pairs] @ U).min() < 0.0
        return undeformed if crosses else replace(undeformed, U=U)

    def _sagged(self, U: Array) -> Array:
        """Return the equilibrium without site forces that is reached from U, shape `(N,)` [m]. Raises `OrganError`."""
        none, no_push = np.zeros(self.y0.size), np.zeros(self.contacts)
        course = self.course(OrganState(U, U, U, none), np.inf)
        still = Motion(0.0, 0.0, EMPTY, EMPTY, self.load, None, course=course)
        point, no_forces = self.point(still, U), Forces(none, np.zeros(self.size))
        if self.off_balance(point, no_forces) <= self._round_off:
            return U
        answer = FiniteAnswer(self, still, point, self.tangent(still, U, point.F), none, self.pairing(None))
        for _ in range(MOST_CORRECTIONS):
            after = answer.again(none, no_push)
            if after is answer:
                return answer.moved(no_forces)
            answer = after
        raise OrganError(f"no convergence in {MOST_CORRECTIONS} Newton iterations")

    def answer(
        self, scheme: TimeScheme, past: Sequence[OrganState], time: float = np.inf, share: float = 1.0
    ) -> FiniteAnswer:
        """Return the answer of a step of `scheme` from the states `past`, the newest first, under `share` of the loads
        at `time` [s]: linearised at the newest with the tangent that it came with."""
        motion, state = self.motion(scheme, past, self.shares_at(time, share)), past[0]
        point = self.point(motion, state.U)
        known = state.linearised if self.keep and state.linearised is not None else state.U
        tangent = self.tangent(motion, known, point.F if known is state.U else None)
        pairing = self.slipping_from(slips_since(past, scheme).U, self.paired_anew(state.U, state.ahead))
        return FiniteAnswer(self, motion, point, tangent, state.f_y, pairing)

    def creep(self, state: OrganState, time: float, share: float, pace: float) -> FiniteAnswer:
        """Return the answer of an organ that creeps from a state towards its equilibrium under `share` of the loads at
        `time` [s]: dragged back by its mass, at a `pace` of 1 as hard as the stiffest node resists, 0 not at all. It
        goes downhill, to an equilibrium that holds, also where none is near."""
        shares = self.shares_at(time, share)
        a = pace * float(self.elasticity.K.diagonal().max()) / self._largest_mass
        course = self.course(state, 0.0)
        motion = Motion(a, 0.0, state.U, state.U, self.load_under(shares), shares, creeps=True, course=course)
        point = self.point(motion, state.U)
        return FiniteAnswer(
            self,
            motion,
            point,
            self.tangent(motion, state.U, point.F),
            state.f_y,
            self.paired_anew(state.U, state.ahead),
        )

    def under(self, answer: FiniteAnswer, time: float, share: float) -> FiniteAnswer:
        """Return an answer at rest under another `share` of the loads at `time` [s], where it is. From there it is led:
        an equilibrium that does not hold is no valley of its potential."""
        shares = self.shares_at(time, share)
        motion = replace(answer.motion, load=self.load_under(shares), shares=shares, led=True)
        return replace(answer, motion=motion, point=self.point(motion, answer.point.U, answer.point.F))

    def holds(self, answer: FiniteAnswer) -> bool:
        """Whether the organ would stay where its answer stands, under dead forces: its tangent is definite."""
        return answer.tangent.definite

    def has_jumped(self, answer: FiniteAnswer, old: OrganState, new: OrganState) -> bool:
        """Return whether a state, where an `answer` of the organ's own stands, is no continuation of an old one: the
        tangent there takes a much shorter way for what the elastic forces changed by, and on the straight way they drop
        and rise again. Tissue that stiffens, or a flap that turns, does the one or the other; where a hand leads tissue
        past a limit point they drop by next to nothing before they rise, the less the shorter the way."""
        way, density = new.U - old.U, answer.motion.density
        last, first = (self._forces_at(state.U, density)[1] for state in (new, old))
        straight = solved(answer.tangent.factor, last - first)
        if np.linalg.norm(way) <= FARTHEST * np.linalg.norm(straight):
            return False
        forces = [first, *(self._force_or_none(old.U + part * way, density) for part in PARTS), last]
        works = np.array([np.inf if force is None else force @ way for force in forces])
        crests, rises = np.maximum.accumulate(works), np.maximum.accumulate(works[::-1])[::-1]
        drop = np.minimum(crests, rises)[np.isfinite(works)] - works[np.isfinite(works)]
        return bool(drop.max() > DROP * max(abs(works[0]), abs(works[-1])))

    def _force_or_none(self, U: Array, density: Density | None) -> Array | None:
        """Return the force of a density's energy (N,) [N], None if it is not finite."""
        F = self.law.gradient(self.whole(U))
        with np.errstate(over="ignore", invalid="ignore"):
            force = self.law.forces(F, density)[0][self.elasticity.free]
        return force if self.law.is_possible(F) and np.isfinite(force).all() else None

    def paired_anew(self, U: Array, points: Array | None = None) -> Pairing:
        """Return the pairing under a displacement of the free unknowns `(N,)`, along the current normals."""
        facing = None
        if self.gaps is not None:
            facing = self.gaps.facing(self.elasticity.points, self._nodal(U), turns=True)
        return self.slipping_from(U, self.pairing(facing, points))

    def state_at(
        self, motion: Motion, U: Array, f_y: Array, p: Array, pairing: Pairing, tangent: Tangent
    ) -> OrganState:
        """Return the state at the end of a step."""
        if motion.a and not motion.creeps:
            V, A = motion.d * (U - motion.damping), motion.a * (U - motion.inertia)
        else:
            V = A = np.zeros(self.size)
        rest = self.contact_or_none(p), pairing.facing, motion.shares, tangent.U
        return OrganState(U, V, A, f_y, *rest, relaxing=self.relaxed(motion.course, U), points=pairing.points)

    def relaxed(self, course: Course | None, U: Array) -> Array | None:
        """Return the stresses that relax at the end of a step at U `(N,)`, shape `(b, 3, 3, q, c)` [Pa]."""
        if course is None or self.relaxation is None:
            return None
        change = self.law.distortional_stress(self.law.gradient(self.whole(U))) - course.S
        return self.relaxation.after(course.relaxing, change, course.dt)

    def site_variables(self, state: OrganState) -> Array:
        """Return y = y(Z U), shape `(9p,)`."""
        return np.asarray(self.map.y(np.asarray(self.map.Z @ state.U)))

    def lips(self, state: OrganState) -> Lips:
        """Return the gaps, forces, ways and friction of the pairs."""
        if self.gaps is None:
            return NO_LIPS
        p = self.contact_forces(state)[: self.pairs]
        return Lips(self.gaps_of(state)[: self.pairs], p, self.slides(state.U), *self.rubbing(state))

    def impulse(self, state: OrganState) -> SiteAnswer | None:
        """Return the answer to an impulse on the sites: dy/dt = J Z V, by J Z M⁻¹ Zᵀ Jᵀ. None without inertia."""
        if not self.inertia:
            return None
        J, (W, C) = self.map.slope(np.asarray(self.map.Z @ state.U)), self._mobility

        def struck(j: Array, p: Array) -> OrganState:
            return replace(state, V=state.V + W @ (J.T @ j))

        return SiteAnswer(J @ (self.map.Z @ state.V), lambda: J @ C @ J.T, struck)

    @cached_property
    def _mobility(self) -> tuple[Array, Array]:
        """M⁻¹ Zᵀ `(N, k)` and Z M⁻¹ Zᵀ `(k, k)`."""
        return compliance(mass_solver(self.M, self.places, self.choice.name), self.map.Z)

    def displace(self, scheme: TimeScheme, state: OrganState, y: Array, f_y: Array) -> LinearAnswer:
        """Return the answer of a step in which nothing moves from `y` (9p,) as long as the site forces are `f_y` (9p,)
        and the contact forces those of `state`: linear in their change, of which the next step takes what is left."""
        motion = self.motion(scheme, [state] * len(scheme.coefficients), state.shares)
        tangent, p, pairing = self.tangent(motion, state.U), self.contact_forces(state), self.pairing_of(state)
        J = self.map.slope(np.asarray(self.map.Z @ state.U))
        C = J @ tangent.C_z @ J.T
        operator = Displaced(self, tangent.A, tangent.factor, tangent.W @ J.T, C)
        y_free, g_free = operator.free_values(y, self.gaps_of(state), f_y, p, pairing)

        def displaced(f_new: Array, p_new: Array) -> OrganState:
            df, dp = f_new - f_y, p_new - p
            U = state.U + operator.W @ df
            U = U + solved(tangent.factor, pairing.G.T @ dp) if dp.any() else U
            return replace(state, U=U, f_y=state.f_y + df, p=self.contact_or_none(p_new))

        def right_hand_side() -> Array:
            return np.asarray(tangent.A @ state.U - self.map.Z_T @ (J.T @ f_y) - pairing.G.T @ p)

        return LinearAnswer(operator, y_free, g_free, displaced, right_hand_side, pairing)

    def displacement(self, state: OrganState) -> Array:
        """Return the displacement of all unknowns, shape `(N_all,)` [m]."""
        return self.whole(state.U)

    def velocity(self, state: OrganState) -> Array:
        """Return the velocity of all unknowns, shape `(N_all,)` [m/s]."""
        return self.whole(state.V)

    def _stored(self, U: Array) -> tuple[float, Array]:
        """Return the energy stored for good [J] and its force (N,) [N]; those of the last fields are remembered."""
        for known, energy, force in self._recalled:
            if known is U:
                return energy, force
        F, force = self._forces_at(U, self.lasting)
        self._recalled.append((U, self.law.energy(F, self.lasting), force))
        return self._recalled[-1][1:]

    def _forces_at(self, U: Array, density: Density | None) -> tuple[Array, Array]:
        """Return F at the cells and the force of a density's energy (N,) [N], those of the last points if they are."""
        for known, F, force, by in self._met:
            if by is density and np.array_equal(known, U):
                return F, force
        F = self.law.gradient(self.whole(U))
        return F, self.law.forces(F, density)[0][self.elasticity.free]

    def energies(self, old: OrganState, new: OrganState) -> OrganEnergies:
        """Return the energies at `new`, and the work done from `old` to it [J]. Stress that relaxes is viscous: its
        work is that of its value at the end, of which it gives some back where the tissue goes back.

        The integrator takes what the forces at the end do along the step beyond the change of energy: of the cells,
        of the mass and the contact as in the linear organ, and f_y·(Δy − J Δz) of frames that are cut.
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
        if new.p is not None and new.p.any():
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
