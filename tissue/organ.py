"""The organ as the thread sees it: nine numbers per piercing, their compliance and one back-substitution.

    acceleration⁺ = a (U⁺ − U_a),   velocity⁺ = d (U⁺ − U_d),   (a M + d C + K) U⁺ = b + Yᵀ f_y

with two numbers and two reference fields per time scheme. Backward Euler has a = 1/Δt², U_a = U + Δt V and
d = 1/Δt, U_d = U. `f_y` `(9p,)` is the force on the organ conjugate to y; eliminating U is exact, so that
y = y_free + C f_y. Where a mesh is too coarse for a hole, springs without mass stand between site and mesh, as further
unknowns behind those of the mesh, as stiff as these are in the mean: y = y0 + Y U + √κ B ζ (`tissue.subgrid`).
"""

from collections import OrderedDict, deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import block_diag, csr_matrix, eye_array, hstack

from tissue.body import Elasticity, holds_still
from tissue.errors import TissueError
from tissue.sites import Site, Sites, space_frames
from tissue.solver import Choice, Solver, chosen, mass_solver, solver

Array = NDArray[np.float64]

KEPT = 4  # operators kept, memory allowing: one per (a, d) of a run, the start, and a halved step
RECALLED = 4  # fields whose elastic force is remembered: a step asks again for those of its start and of its end
NOTHING = np.zeros(0)


@dataclass(frozen=True)
class OrganState:
    """Displacement U [m], velocity V [m/s], acceleration A [m/s²] over the free unknowns `(N,)`, and the site
    forces.
    """

    U: Array
    V: Array
    A: Array
    f_y: Array


@dataclass(frozen=True)
class History:
    """Reference fields of the time scheme over the free unknowns `(N,)` [m]: U_a and U_d."""

    inertia: Array
    damping: Array


@dataclass(frozen=True)
class Prediction:
    """A step without site forces: site variables `(9p,)`, field `(N,)` and the history it came from."""

    y_free: Array
    U_free: Array
    history: History


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
    choice: Choice = field(init=False, repr=False)
    K: csr_matrix = field(init=False, repr=False)
    Y: csr_matrix = field(init=False, repr=False)
    load: Array = field(init=False, repr=False)
    places: Array = field(init=False, repr=False)

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


@dataclass(frozen=True)
class DynamicOperator:
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
        return Prediction(self.organ.y0 + self.organ.Y @ U_free, U_free, history)

    def complete(self, prediction: Prediction, f_y: Array) -> OrganState:
        """U⁺ = U_free + W f_y and its rates."""
        U = prediction.U_free + self.W @ f_y
        history = prediction.history
        return OrganState(U, self.d * (U - history.damping), self.a * (U - history.inertia), f_y)

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
    slots: NDArray[np.intp] | None = field(init=False, repr=False)  # of the free unknowns where nodes are held in part
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
        whole = np.unique(free // 3)[:, None] * 3 + np.arange(3)  # all unknowns of the nodes that have a free one
        rolls = whole.size > free.size
        nodal = csr_matrix(self.elasticity.M[whole.ravel()][:, whole.ravel()]) if rolls else M
        object.__setattr__(self, "slots", np.searchsorted(whole.ravel(), free) if rolls else None)
        object.__setattr__(self, "node_mass", csr_matrix(nodal[::3, ::3]))
        if 3 * self.node_mass.nnz != nodal.nnz:
            raise TissueError("the mass matrix must be one over the nodes, the same for x, y and z of each")
        object.__setattr__(self, "_recalled", deque(maxlen=RECALLED))
        object.__setattr__(self, "_operators", OrderedDict())

    def start(self) -> OrganState:
        """Undeformed and at rest; gravity acts from the first step."""
        rest = np.zeros(self.size)
        return OrganState(rest, rest, rest, np.zeros(self.y0.size))

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

    def moved(self, state: OrganState, operator: DynamicOperator, f_y: Array) -> OrganState:
        """The state with other site forces, displaced by W Δf_y; V is kept."""
        return replace(state, U=state.U + operator.W @ (f_y - state.f_y), f_y=f_y)

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
        is zero for backward Euler; viscous is V⁺ᵀ C ΔU.
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
            numerical=float(0.5 * dU @ elastic + 0.5 * dV @ given + spent @ dU - inertia @ dV),
        )

    def _weighed_together(self, *fields: Array) -> Array:
        """M times several fields in one pass over it, shape `(k, N)`; the springs have no mass."""
        N, k = self.mesh_size, len(fields)
        side_by_side = np.hstack([self._by_nodes(field[:N]) for field in fields])
        weighed = np.asarray(self.node_mass @ side_by_side).reshape(-1, k, 3).swapaxes(0, 1).reshape(k, -1)
        out = np.zeros((k, self.size))
        out[:, :N] = weighed if self.slots is None else weighed[:, self.slots]
        return out

    def _by_nodes(self, field: Array) -> Array:
        """A field over the mesh's free unknowns as one vector per node, shape `(m, 3)`; zero where a node is held."""
        if self.slots is None:
            return field.reshape(-1, 3)
        whole = np.zeros(3 * self.node_mass.shape[0])
        whole[self.slots] = field
        return whole.reshape(-1, 3)


@dataclass(frozen=True)
class QuasiStaticOperator:
    """A = K with the answer to the constant load known: no work that grows with the mesh is left in a step."""

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
        return Prediction(self.y_load, NOTHING, history)

    def complete(self, prediction: Prediction, f_y: Array) -> OrganState:
        """A quasi-static organ is where its forces put it."""
        return OrganState(NOTHING, NOTHING, NOTHING, f_y)


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
        body = self.elasticity
        known = ", ".join(sorted(body.mesh.boundaries or {})) or "none at all"
        if body.clamped.size == 0:
            raise TissueError(
                "clamp = []: a quasi-static organ that is not held is singular; clamp a boundary (the mesh names "
                f"{known}) or give it inertia"
            )
        if not holds_still(body.points, np.isin(body.nodes, body.clamped)):
            raise TissueError(
                "roller: a quasi-static organ that can still move as a rigid body is singular; clamp a boundary, or "
                f"put rollers on more of them (the mesh names {known})"
            )

    @cached_property
    def _operator(self) -> QuasiStaticOperator:
        """Factorised when first asked for: a scenario is checked without."""
        factor = self.solved(self.K)
        W, C = _compliance(factor, self.Y)
        U_load = factor.solve(self.load)
        y_load, sag_energy = np.asarray(self.y0 + self.Y @ U_load), float(0.5 * self.load @ U_load)
        return QuasiStaticOperator(self.K, factor, self.load, W, C, U_load, y_load, sag_energy)

    def start(self) -> OrganState:
        """Equilibrium under gravity, without site forces."""
        return OrganState(NOTHING, NOTHING, NOTHING, np.zeros(self.y0.size))

    def operator(self, a: float, d: float) -> QuasiStaticOperator:
        """K, whatever the time scheme."""
        return self._operator

    def history(self, coefficients: Sequence[tuple[float, float, float]], states: Sequence[OrganState]) -> History:
        """Nothing: the organ has no memory."""
        return History(NOTHING, NOTHING)

    def site_variables(self, state: OrganState) -> Array:
        """y = y0 + Y U = y_load + C f_y, shape `(9p,)`."""
        if not (self.load.any() or state.f_y.any()):
            return self.y0
        return self._operator.y_load + self._operator.C @ state.f_y

    def displacement(self, state: OrganState) -> Array:
        """Displacement of all unknowns, shape `(N_all,)` [m]."""
        return self.whole(self.field(state))

    def field(self, state: OrganState) -> Array:
        """Displacement over the free unknowns, shape `(N,)` [m]."""
        return np.asarray(self._operator.U_load + self._operator.W @ state.f_y)

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

    def moved(self, state: OrganState, operator: object, f_y: Array) -> OrganState:
        """The state with other site forces."""
        return replace(state, f_y=f_y)

    def energies(self, old: OrganState, new: OrganState) -> OrganEnergies:
        """As for the dynamic organ, with 9p numbers: U = U_load + W f_y, K U_load = load and Yᵀ U_load =
        y_load − y0.
        """
        C, sag = self._operator.C, self._operator.y_load - self.y0
        df = new.f_y - old.f_y
        elastic = self._operator.sag_energy + sag @ new.f_y + 0.5 * new.f_y @ (C @ new.f_y)
        return OrganEnergies(0.0, float(elastic), float(sag @ df), 0.0, float(0.5 * df @ (C @ df)))


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

    def complete(self, prediction: Prediction, f_y: Array) -> OrganState:
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

    def moved(self, state: OrganState, operator: object, f_y: Array) -> OrganState:
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
