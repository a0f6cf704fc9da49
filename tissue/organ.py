"""The organ as the thread sees it: nine numbers per piercing, their compliance and one back-substitution.

    acceleration⁺ = a (U⁺ − U_a),   velocity⁺ = d (U⁺ − U_d),   (a M + d C + K) U⁺ = b + Yᵀ f_y

with two numbers and two reference fields per time scheme. Backward Euler has a = 1/Δt², U_a = U + Δt V and
d = 1/Δt, U_d = U. `f_y` `(9p,)` is the force on the organ conjugate to y; eliminating U is exact, so that
y = y_free + C f_y. Where a mesh is too coarse for a hole, springs without mass stand between site and mesh, as further
unknowns behind those of the mesh, as stiff as these are in the mean: y = y0 + Y U + √κ B ζ (`tissue.subgrid`).

The lips of a wound may be given gaps g = g0 + G U (`tissue.gaps`), and forces p that push them apart:

    A U⁺ = b + Yᵀ f_y + Gᵀ p,   y = y_free + C f_y + C_yc p,   g = g_free + C_cy f_y + C_cc p

The columns A⁻¹Gᵀ are not kept: once C_cc is known, p costs one more back-substitution a step.
"""

from collections import OrderedDict, deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import block_diag, csr_matrix, eye_array, hstack

from tissue.body import Elasticity
from tissue.errors import TissueError
from tissue.gaps import Gaps
from tissue.memory import free_memory
from tissue.sites import Site, Sites, space_frames
from tissue.solver import GIGA, Choice, Solver, chosen, mass_solver, solver

Array = NDArray[np.float64]

KEPT = 4  # operators kept, memory allowing: one per (a, d) of a run, the start, and a halved step
RECALLED = 4  # fields whose elastic force is remembered: a step asks again for those of its start and of its end
COLUMNS = 64  # of A⁻¹Gᵀ that are made together
SHARE = 0.5  # of the free memory that the compliance of the gaps may take
NOTHING = np.zeros(0)


@dataclass(frozen=True)
class OrganState:
    """Displacement U [m], velocity V [m/s], acceleration A [m/s²] over the free unknowns `(N,)`, the site
    forces, and the contact forces `(k,)` [N], None of an organ without gaps.
    """

    U: Array
    V: Array
    A: Array
    f_y: Array
    p: Array | None = None


@dataclass(frozen=True)
class History:
    """Reference fields of the time scheme over the free unknowns `(N,)` [m]: U_a and U_d."""

    inertia: Array
    damping: Array


@dataclass(frozen=True)
class Prediction:
    """A step without site forces and contact: site variables `(9p,)`, field `(N,)`, the history it came from and
    the gaps `(k,)` [m].
    """

    y_free: Array
    U_free: Array
    history: History
    g_free: Array = field(default_factory=lambda: NOTHING)


@dataclass(frozen=True)
class OrganEnergies:
    """Energies at the end of a step and work done during it [J]."""

    kinetic: float
    elastic: float
    gravity_work: float
    viscous: float
    numerical: float


@dataclass(frozen=True, eq=False)
class _Organ:
    """What a dynamic and a quasi-static organ share: the body, its sites and the blocks over the free
    unknowns.
    """

    elasticity: Elasticity
    sites: Sites
    gravity: ArrayLike = (0.0, 0.0, 0.0)
    solver: str = "auto"  # one of `tissue.solver.SOLVERS`
    gaps: Gaps | None = None
    choice: Choice = field(init=False, repr=False)
    K: csr_matrix = field(init=False, repr=False)
    Y: csr_matrix = field(init=False, repr=False)
    load: Array = field(init=False, repr=False)
    places: Array = field(init=False, repr=False)
    G: csr_matrix = field(init=False, repr=False)

    def __post_init__(self) -> None:
        gravity = np.asarray(self.gravity, dtype=float)
        if gravity.shape != (3,) or not np.all(np.isfinite(gravity)):
            raise TissueError(f"gravity = {self.gravity}: allowed are three finite numbers [m/s²]")
        body, free = self.elasticity, self.elasticity.free
        if self.sites.Y.shape[1] != free.size:
            raise TissueError(
                f"sites over {self.sites.Y.shape[1]} unknowns on an organ of {free.size}; build them on it"
            )
        B, places = self.sites.springs, body.basis.doflocs[:, free].T
        K = csr_matrix(body.K[free][:, free])
        K.eliminate_zeros()  # a fifth of the entries on a block
        stiffness = float(body.K.diagonal().mean())
        springs = stiffness * eye_array(B.shape[1])
        object.__setattr__(self, "K", csr_matrix(block_diag([K, springs])) if B.shape[1] else K)
        object.__setattr__(self, "Y", csr_matrix(hstack([self.sites.Y, np.sqrt(stiffness) * B])))
        object.__setattr__(self, "load", np.append(body.body_force(gravity)[free], np.zeros(B.shape[1])))
        object.__setattr__(self, "places", places)
        object.__setattr__(self, "choice", chosen(self.solver, K, places, self._solved_once))
        object.__setattr__(self, "G", self._gap_rows(B.shape[1]))

    def _gap_rows(self, springs: int) -> csr_matrix:
        """G over all unknowns, shape `(k, N)`; refused where its compliance has no room."""
        N = self.elasticity.free.size + springs
        if self.gaps is None:
            return csr_matrix((0, N))
        k, room = self.pairs, SHARE * free_memory()
        need = 8.0 * ((KEPT + 2) * k**2 + COLUMNS * N)
        if self.gaps.G.shape[1] != self.elasticity.free.size:
            raise TissueError(
                f"gaps over {self.gaps.G.shape[1]} unknowns on an organ of {N - springs}; build them on it"
            )
        if need > room:
            raise TissueError(
                f"contact: the {k} pairs of nodes on the lips take about {need / GIGA:.2g} GB and {room / GIGA:.2g} GB "
                "can be had; take a coarser mesh at the lips, or leave out contact"
            )
        return csr_matrix(hstack([self.gaps.G, csr_matrix((k, springs))]))

    @property
    def pairs(self) -> int:
        """Number k of pairs of nodes on the lips that may touch; 0 without gaps."""
        return 0 if self.gaps is None else len(self.gaps.g0)

    @property
    def g0(self) -> Array:
        """Gaps of the reference shape, shape `(k,)` [m]."""
        return NOTHING if self.gaps is None else self.gaps.g0

    def contact_forces(self, state: OrganState) -> Array:
        """p, shape `(k,)` [N]."""
        return NOTHING if state.p is None else state.p

    def held_apart(self, p: Array) -> Array | None:
        """Contact forces `(k,)` as a state keeps them: None without gaps."""
        return p if self.pairs else None

    @property
    def _no_contact(self) -> Array | None:
        return self.held_apart(np.zeros(self.pairs))

    @property
    def mesh_size(self) -> int:
        """Number of free unknowns of the mesh, which come before those of the springs."""
        return int(self.elasticity.free.size)

    @property
    def _solved_once(self) -> bool:
        """Whether all that is ever solved for are the sites' columns and the load."""
        return False

    def solved(self, A: csr_matrix) -> Solver:
        """What solves with a matrix of the organ: the springs are coupled to nothing but the sites."""
        N = self.mesh_size
        mesh = solver(csr_matrix(A[:N, :N]) if A.shape[0] > N else A, self.places, self.choice.name)
        return mesh if A.shape[0] == N else Sprung(A, mesh)

    @property
    def y0(self) -> Array:
        """Reference site variables, shape `(9p,)` [m, -, -]."""
        return self.sites.y0

    @property
    def size(self) -> int:
        """Number of free unknowns N, those of the springs at the sites included."""
        return int(self.K.shape[0])

    def whole(self, field: Array) -> Array:
        """A field over the free unknowns as one over all unknowns of the mesh, shape `(N_all,)`."""
        return self.elasticity.extended(field[: self.elasticity.free.size])


@dataclass(frozen=True)
class Sprung:
    """A matrix of the mesh, with its solver, and behind it a diagonal of springs."""

    A: csr_matrix
    mesh: Solver

    def solve(self, b: Array, guess: Callable[[], Array] | None = None) -> Array:
        """A⁻¹ b for b of shape `(n,)` or `(n, k)`; a guess is asked for where it is of use."""
        N = self.mesh.A.shape[0]
        near = None if guess is None else lambda: guess()[:N]
        springs = self.A.diagonal()[N:].reshape(-1, *[1] * (b.ndim - 1))
        return np.concatenate([self.mesh.solve(b[:N], near), b[N:] / springs])


class _Lips:
    """What an operator says of the gaps, when it is asked: the columns A⁻¹Gᵀ are dear."""

    organ: _Organ
    factor: Solver
    W: Array

    @cached_property
    def C_cc(self) -> Array:
        """G A⁻¹ Gᵀ, gaps by contact forces, shape `(k, k)` [m/N]."""
        return _gap_compliance(self.factor, self.organ.G)

    @cached_property
    def C_cy(self) -> Array:
        """G W, gaps by site forces, shape `(k, 9p)`."""
        return np.asarray(self.organ.G @ self.W)


@dataclass(frozen=True)
class DynamicOperator(_Lips):
    """A = a M + d C + K, factorised, with W = A⁻¹ Yᵀ and the compliance C = Y W of the sites."""

    organ: "DynamicOrgan"
    a: float
    d: float
    A: csr_matrix
    factor: Solver
    W: Array
    C: Array

    def right_hand_side(self, state: OrganState, history: History) -> Array:
        """b of A U⁺ = b + Yᵀ f_y, shape `(N,)` [N]."""
        return self._residual(np.zeros_like(state.U), history)

    def predict(self, state: OrganState, history: History) -> Prediction:
        """The step without site forces: one solve, for the increment, so that round-off is relative to it."""

        def guess() -> Array:
            """As if acceleration and site forces stayed what they are."""
            return history.inertia + state.A / self.a - state.U - self.W @ state.f_y

        U_free = state.U + self.factor.solve(self._residual(state.U, history), guess)
        organ = self.organ
        return Prediction(organ.y0 + organ.Y @ U_free, U_free, history, organ.g0 + organ.G @ U_free)

    def complete(self, prediction: Prediction, f_y: Array, p: Array = NOTHING) -> OrganState:
        """U⁺ = U_free + W f_y + A⁻¹Gᵀ p and its rates."""
        U, history, organ = self.moved(prediction.U_free, f_y, p), prediction.history, self.organ
        rates = self.d * (U - history.damping), self.a * (U - history.inertia)
        return OrganState(U, *rates, f_y, organ.held_apart(p))

    def moved(self, U: Array, f_y: Array, p: Array) -> Array:
        """U + W f_y + A⁻¹Gᵀ p, shape `(N,)` [m]."""
        U = U + self.W @ f_y
        return U + self.factor.solve(self.organ.G.T @ p) if p.any() else U

    def _residual(self, U: Array, history: History) -> Array:
        """b − A U, by products with M and K: C = αM + βK needs none of its own."""
        alpha, beta = self.organ.rayleigh
        damping = self.d * (history.damping - U)
        inertia = self.organ.weighed(self.a * (history.inertia - U) + alpha * damping)
        residual = self.organ.load + inertia - self.organ.elastic_force(U)
        return residual + self.organ.K @ (beta * damping) if beta and damping.any() else residual


@dataclass(frozen=True, eq=False)
class DynamicOrgan(_Organ):
    """An organ with inertia and Rayleigh damping C = αM + βK, `rayleigh` = (α [1/s], β [s]); it need not be
    held.
    """

    rayleigh: tuple[float, float] = (0.0, 0.0)
    M: csr_matrix = field(init=False, repr=False)
    node_mass: csr_matrix = field(init=False, repr=False)
    _recalled: deque[tuple[Array, Array]] = field(init=False, repr=False, compare=False)
    _operators: OrderedDict[tuple[float, float], DynamicOperator] = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        super().__post_init__()
        alpha, beta = self.rayleigh
        if not (0.0 <= alpha < np.inf and 0.0 <= beta < np.inf):
            raise TissueError(
                f"rayleigh = {self.rayleigh}: allowed are α ≥ 0 [1/s] and β ≥ 0 [s]; damping takes energy"
            )
        free = self.elasticity.free
        M = csr_matrix(self.elasticity.M[free][:, free])
        springs = csr_matrix((self.size - free.size,) * 2)
        object.__setattr__(self, "M", csr_matrix(block_diag([M, springs])) if springs.shape[0] else M)
        object.__setattr__(self, "node_mass", csr_matrix(M[::3, ::3]))
        if 3 * self.node_mass.nnz != M.nnz:
            raise TissueError("the mass matrix must be one over the nodes, the same for x, y and z of each")
        object.__setattr__(self, "_recalled", deque(maxlen=RECALLED))
        object.__setattr__(self, "_operators", OrderedDict())

    def start(self) -> OrganState:
        """Undeformed and at rest; gravity acts from the first step."""
        rest = np.zeros(self.size)
        return OrganState(rest, rest, rest, np.zeros(self.y0.size), self._no_contact)

    def operator(self, a: float, d: float) -> DynamicOperator:
        """The factorised operator of a time scheme; the last few are kept."""
        if not (0.0 < a < np.inf and 0.0 <= d < np.inf):
            raise TissueError(f"a = {a} 1/s², d = {d} 1/s: allowed are a > 0 and d ≥ 0; give a positive time step")
        if (a, d) not in self._operators:
            while len(self._operators) >= min(KEPT, self.choice.room):
                self._operators.popitem(last=False)
            self._operators[a, d] = self._factorized(a, d)
        self._operators.move_to_end((a, d))
        return self._operators[a, d]

    def weighed(self, field: Array) -> Array:
        """M times a field over the free unknowns `(N,)`: a node's three components share its row."""
        return self._weighed_together(field)[0]

    def elastic_force(self, U: Array) -> Array:
        """K U; of the fields asked for last it is remembered, since a state's own is asked for by both its steps."""
        for known, force in self._recalled:
            if known is U:
                return force
        force = np.asarray(self.K @ U)
        self._recalled.append((U, force))
        return force

    def _factorized(self, a: float, d: float) -> DynamicOperator:
        alpha, beta = self.rayleigh
        A = csr_matrix((a + alpha * d) * self.M + (1.0 + beta * d) * self.K)
        factor = self.solved(A)
        W, C = _compliance(factor, self.Y)
        return DynamicOperator(self, a, d, A, factor, W, C)

    def history(self, coefficients: Sequence[tuple[float, float, float]], states: Sequence[OrganState]) -> History:
        """U_a = Σ_k (α_k U_k + β_k V_k), U_d = Σ_k γ_k U_k for `coefficients` (α_k, β_k [s], γ_k) of earlier
        states.
        """
        terms = list(zip(coefficients, states, strict=True))
        inertia = sum((alpha * s.U + beta * s.V for (alpha, beta, _), s in terms), np.zeros(self.size))
        return History(inertia, sum((gamma * s.U for (_, _, gamma), s in terms), np.zeros(self.size)))

    def site_variables(self, state: OrganState) -> Array:
        """y = y0 + Y U, shape `(9p,)`."""
        return np.asarray(self.y0 + self.Y @ state.U)

    def gap(self, state: OrganState) -> Array:
        """g = g0 + G U, shape `(k,)` [m]."""
        return np.asarray(self.g0 + self.G @ state.U)

    def displacement(self, state: OrganState) -> Array:
        """Displacement of all unknowns, shape `(N_all,)` [m]."""
        return self.whole(state.U)

    def field(self, state: OrganState) -> Array:
        """Displacement over the free unknowns, shape `(N,)` [m]."""
        return state.U

    def velocity(self, state: OrganState) -> Array:
        """Velocity of all unknowns, shape `(N_all,)` [m/s]."""
        return self.whole(state.V)

    def site_velocities(self, state: OrganState) -> Array:
        """dy/dt = Y V, shape `(9p,)`."""
        return np.asarray(self.Y @ state.V)

    def site_mobility(self) -> Array:
        """Y M⁻¹ Yᵀ: jump of dy/dt by an impulse conjugate to y, shape `(9p, 9p)`."""
        return self._mobility[1]

    def kicked(self, state: OrganState, impulse: Array) -> OrganState:
        """The state after an impulse `(9p,)` on the sites: V + M⁻¹ Yᵀ impulse."""
        return replace(state, V=state.V + self._mobility[0] @ impulse)

    def moved(self, state: OrganState, operator: DynamicOperator, f_y: Array, p: Array = NOTHING) -> OrganState:
        """The state with other site and contact forces, displaced by W Δf_y + A⁻¹Gᵀ Δp; V is kept."""
        U = operator.moved(state.U, f_y - state.f_y, p - self.contact_forces(state))
        return replace(state, U=U, f_y=f_y, p=self.held_apart(p))

    @cached_property
    def _mobility(self) -> tuple[Array, Array]:
        """M⁻¹ Yᵀ `(N, 9p)` and Y M⁻¹ Yᵀ of the mesh: what has no mass takes no impulse."""
        N = self.mesh_size
        W, C = _compliance(mass_solver(csr_matrix(self.M[:N, :N]), self.places, self.choice.name), self.sites.Y)
        return np.vstack([W, np.zeros((self.size - N, W.shape[1]))]), C

    def energies(self, old: OrganState, new: OrganState) -> OrganEnergies:
        """Energies at `new` and the works of the step: f_y·Δy + gravity = Δ(kinetic + elastic) + viscous +
        numerical.

        Exact for any time scheme: its own dissipation is ½ΔUᵀKΔU + ½ΔVᵀMΔV + (A⁺ᵀMΔU − V⁺ᵀMΔV), of which the bracket
        is zero for backward Euler; viscous is V⁺ᵀ C ΔU. With p⁺·g⁺ = 0 the contact takes −p⁺·Δg = p⁺·g ≥ 0, of first
        order in the step but where lips strike one another: it stands with the integrator's share.
        """
        alpha, beta = self.rayleigh
        dU, dV, force = new.U - old.U, new.V - old.V, self.elastic_force(new.U)
        elastic = force - self.elastic_force(old.U)
        inertia, given, spent = self._weighed_together(new.V, dV, new.A)
        return OrganEnergies(
            kinetic=float(0.5 * new.V @ inertia),
            elastic=float(0.5 * new.U @ force),
            gravity_work=float(self.load @ dU),
            viscous=float(alpha * (inertia @ dU) + beta * (new.V @ elastic)),
            numerical=float(0.5 * dU @ elastic + 0.5 * dV @ given + spent @ dU - inertia @ dV)
            - float(self.contact_forces(new) @ (self.G @ dU)),
        )

    def _weighed_together(self, *fields: Array) -> Array:
        """M times several fields in one pass over it, shape `(k, N)`; the springs have no mass."""
        N, k = self.mesh_size, len(fields)
        side_by_side = np.hstack([field[:N].reshape(-1, 3) for field in fields])
        out = np.zeros((k, self.size))
        out[:, :N] = np.asarray(self.node_mass @ side_by_side).reshape(-1, k, 3).swapaxes(0, 1).reshape(k, -1)
        return out


@dataclass(frozen=True)
class QuasiStaticOperator(_Lips):
    """A = K with the answer to the constant load known: no work that grows with the mesh is left in a step."""

    organ: "QuasiStaticOrgan"
    A: csr_matrix
    factor: Solver
    load: Array
    W: Array
    C: Array
    U_load: Array
    y_load: Array
    sag_energy: float

    def right_hand_side(self, state: OrganState, history: History) -> Array:
        """The constant load, shape `(N,)` [N]."""
        return self.load

    def predict(self, state: OrganState, history: History) -> Prediction:
        """The equilibrium without site forces, known in advance."""
        return Prediction(self.y_load, NOTHING, history, self.g_load)

    def complete(self, prediction: Prediction, f_y: Array, p: Array = NOTHING) -> OrganState:
        """A quasi-static organ is where its forces put it."""
        return OrganState(NOTHING, NOTHING, NOTHING, f_y, self.organ.held_apart(p))

    @cached_property
    def g_load(self) -> Array:
        """Gaps under the constant load alone, shape `(k,)` [m]."""
        return np.asarray(self.organ.g0 + self.organ.G @ self.U_load)


@dataclass(frozen=True, eq=False)
class QuasiStaticOrgan(_Organ):
    """An organ without inertia: U = K⁻¹ (load + Yᵀ f_y). Its state is `f_y` alone, its field is made on
    demand.
    """

    @property
    def _solved_once(self) -> bool:
        return True

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.elasticity.clamped.size == 0:
            known = ", ".join(sorted(self.elasticity.mesh.boundaries or {})) or "none at all"
            raise TissueError(
                "clamp = []: a quasi-static organ that is not held is singular; clamp a boundary (the mesh names "
                f"{known}) or give it inertia"
            )

    @cached_property
    def _operator(self) -> QuasiStaticOperator:
        """Factorised when first asked for: a scenario is checked without."""
        factor = self.solved(self.K)
        W, C = _compliance(factor, self.Y)
        U_load = factor.solve(self.load)
        y_load, sag_energy = np.asarray(self.y0 + self.Y @ U_load), float(0.5 * self.load @ U_load)
        return QuasiStaticOperator(self, self.K, factor, self.load, W, C, U_load, y_load, sag_energy)

    def start(self) -> OrganState:
        """Equilibrium under gravity, without site forces; the lips are not held apart yet."""
        return OrganState(NOTHING, NOTHING, NOTHING, np.zeros(self.y0.size), self._no_contact)

    def operator(self, a: float, d: float) -> QuasiStaticOperator:
        """K, whatever the time scheme."""
        return self._operator

    def history(self, coefficients: Sequence[tuple[float, float, float]], states: Sequence[OrganState]) -> History:
        """Nothing: the organ has no memory."""
        return History(NOTHING, NOTHING)

    def site_variables(self, state: OrganState) -> Array:
        """y = y0 + Y U = y_load + C f_y + C_yc p, shape `(9p,)`."""
        p = self.contact_forces(state)
        if not (self.load.any() or state.f_y.any() or p.any()):
            return self.y0
        y = self._operator.y_load + self._operator.C @ state.f_y
        return y + p @ self._operator.C_cy if p.any() else y

    def gap(self, state: OrganState) -> Array:
        """g = g0 + G U = g_load + C_cy f_y + C_cc p, shape `(k,)` [m]."""
        p = self.contact_forces(state)
        if not (self.pairs and (self.load.any() or state.f_y.any() or p.any())):
            return self.g0
        g = self._operator.g_load + self._operator.C_cy @ state.f_y
        return g + self._operator.C_cc @ p if p.any() else g

    def displacement(self, state: OrganState) -> Array:
        """Displacement of all unknowns, shape `(N_all,)` [m]."""
        return self.whole(self.field(state))

    def field(self, state: OrganState) -> Array:
        """Displacement over the free unknowns, shape `(N,)` [m]."""
        U, p = np.asarray(self._operator.U_load + self._operator.W @ state.f_y), self.contact_forces(state)
        return U + self._operator.factor.solve(self.G.T @ p) if p.any() else U

    def velocity(self, state: OrganState) -> Array:
        """Zero, shape `(N_all,)` [m/s]."""
        return np.zeros(self.elasticity.N)

    def site_velocities(self, state: OrganState) -> Array:
        """Zero, shape `(9p,)`."""
        return np.zeros(self.y0.size)

    def site_mobility(self) -> None:
        """None: without mass nothing takes an impulse."""

    def kicked(self, state: OrganState, impulse: Array) -> OrganState:
        """Unchanged."""
        return state

    def moved(self, state: OrganState, operator: object, f_y: Array, p: Array = NOTHING) -> OrganState:
        """The state with other site and contact forces."""
        return replace(state, f_y=f_y, p=self.held_apart(p))

    def energies(self, old: OrganState, new: OrganState) -> OrganEnergies:
        """As for the dynamic organ, with 9p + k numbers: U = U_load + W f_y + K⁻¹Gᵀ p, K U_load = load,
        Yᵀ U_load = y_load − y0 and Gᵀ U_load = g_load − g0.
        """
        C, sag = self._operator.C, self._operator.y_load - self.y0
        df = new.f_y - old.f_y
        elastic = self._operator.sag_energy + sag @ new.f_y + 0.5 * new.f_y @ (C @ new.f_y)
        by_sites = OrganEnergies(0.0, float(elastic), float(sag @ df), 0.0, float(0.5 * df @ (C @ df)))
        return self._with_contact(by_sites, old, new) if self.pairs else by_sites

    def _with_contact(self, by_sites: OrganEnergies, old: OrganState, new: OrganState) -> OrganEnergies:
        """What the contact forces add; their own work −p⁺·Δg stands with the integrator's share."""
        p, df = self.contact_forces(new), new.f_y - old.f_y
        dp = p - self.contact_forces(old)
        if not (p.any() or dp.any()):
            return by_sites
        C_cc, C_cy, closing = self._operator.C_cc, self._operator.C_cy, self._operator.g_load - self.g0
        elastic, dg = p @ (closing + C_cy @ new.f_y + 0.5 * C_cc @ p), C_cy @ df + C_cc @ dp
        return replace(
            by_sites,
            elastic=by_sites.elastic + float(elastic),
            gravity_work=by_sites.gravity_work + float(closing @ dp),
            numerical=by_sites.numerical + float(dp @ (C_cy @ df + 0.5 * C_cc @ dp) - p @ dg),
        )


@dataclass(frozen=True)
class FixedOperator:
    """No unknowns and no compliance."""

    y0: Array

    @property
    def A(self) -> csr_matrix:
        """Shape `(0, 0)`."""
        return csr_matrix((0, 0))

    @property
    def C(self) -> Array:
        """Zero, shape `(9p, 9p)`."""
        return np.zeros((self.y0.size, self.y0.size))

    @property
    def W(self) -> Array:
        """Shape `(0, 9p)`."""
        return np.zeros((0, self.y0.size))

    def right_hand_side(self, state: OrganState, history: History) -> Array:
        """Shape `(0,)`."""
        return NOTHING

    def predict(self, state: OrganState, history: History) -> Prediction:
        """The sites where they are."""
        return Prediction(self.y0, NOTHING, history)

    def complete(self, prediction: Prediction, f_y: Array, p: Array = NOTHING) -> OrganState:
        """The space takes any force."""
        return OrganState(NOTHING, NOTHING, NOTHING, f_y)


@dataclass(frozen=True)
class FixedSites:
    """No organ: sites fixed in space, `y0` `(9p,)`. Made by `fixed_sites`."""

    y0: Array

    @property
    def Y(self) -> csr_matrix:
        """No unknowns, shape `(9p, 0)`."""
        return csr_matrix((self.y0.size, 0))

    @property
    def size(self) -> int:
        """Zero."""
        return 0

    @property
    def pairs(self) -> int:
        """Zero: space has no lips."""
        return 0

    def gap(self, state: OrganState) -> Array:
        """Shape `(0,)`."""
        return NOTHING

    def contact_forces(self, state: OrganState) -> Array:
        """Shape `(0,)`."""
        return NOTHING

    def start(self) -> OrganState:
        """No force."""
        return OrganState(NOTHING, NOTHING, NOTHING, np.zeros(self.y0.size))

    def operator(self, a: float, d: float) -> FixedOperator:
        """Nothing to factorise."""
        return FixedOperator(self.y0)

    def history(self, coefficients: Sequence[tuple[float, float, float]], states: Sequence[OrganState]) -> History:
        """Nothing: space has no memory."""
        return History(NOTHING, NOTHING)

    def site_variables(self, state: OrganState) -> Array:
        """y0, shape `(9p,)`."""
        return self.y0

    def displacement(self, state: OrganState) -> Array:
        """Shape `(0,)`."""
        return NOTHING

    def velocity(self, state: OrganState) -> Array:
        """Shape `(0,)`."""
        return NOTHING

    def site_velocities(self, state: OrganState) -> Array:
        """Zero, shape `(9p,)`."""
        return np.zeros(self.y0.size)

    def site_mobility(self) -> Array:
        """Zero, shape `(9p, 9p)`: space takes any impulse."""
        return np.zeros((self.y0.size, self.y0.size))

    def kicked(self, state: OrganState, impulse: Array) -> OrganState:
        """Unchanged."""
        return state

    def moved(self, state: OrganState, operator: object, f_y: Array, p: Array = NOTHING) -> OrganState:
        """The state with other site forces."""
        return replace(state, f_y=f_y)

    def energies(self, old: OrganState, new: OrganState) -> OrganEnergies:
        """None."""
        return OrganEnergies(0.0, 0.0, 0.0, 0.0, 0.0)


def fixed_sites(sites: Sequence[Site]) -> FixedSites:
    """Piercings as points fixed in space; their directions must be vectors or None."""
    return FixedSites(space_frames(sites))


def _compliance(factor: Solver, Y: csr_matrix) -> tuple[Array, Array]:
    """W = A⁻¹ Yᵀ `(N, 9p)` and C = Y W `(9p, 9p)`, made symmetric to the last bit."""
    W = factor.solve(Y.T.toarray())
    C = Y @ W
    return W, 0.5 * (C + C.T)


def _gap_compliance(factor: Solver, G: csr_matrix) -> Array:
    """G A⁻¹ Gᵀ `(k, k)`, made symmetric to the last bit; its columns are made a few at a time."""
    some = [slice(first, first + COLUMNS) for first in range(0, G.shape[0], COLUMNS)]
    C = np.hstack([G @ factor.solve(G[rows].T.toarray()) for rows in some])
    return 0.5 * (C + C.T)
