"""An organ with inertia: its operators of time schemes, and its steps."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.blas import daxpy
from scipy.sparse import csr_matrix

from tissue.arrays import Array
from tissue.errors import TissueError
from tissue.organs.meshed import (
    KEPT_OPERATORS,
    LinearAnswer,
    MeshedOrgan,
    Operator,
    OrganEnergies,
    OrganState,
    Pairing,
    SiteAnswer,
    TimeScheme,
    compliance,
)
from tissue.recent import Recent
from tissue.solvers.choice import MULTIGRID, mass_solver

DRIFT = 1e-13  # of ‖K‖‖U‖: largest error of K U from the residuals of many steps; with a larger error K U is recomputed


class Products(NamedTuple):
    """M U [kg m], M V [N s] and K U [N] of a state, `(N,)` each."""

    MU: Array
    MV: Array
    KU: Array


class History(NamedTuple):
    """Reference fields of the time scheme over the free unknowns `(N,)`.

    They are U_a and U_d [m], and the products M U_a, M U_d [kg m] and K U_d [N].
    """

    inertia: Array
    damping: Array
    M_inertia: Array
    M_damping: Array
    K_damping: Array


def combination(weights: Sequence[float], fields: Sequence[Array]) -> Array:
    """Return Σ w x of one or more fields, shape `(N,)`.

    Each field with a weight other than zero is passed over once.

    A step makes thirty such passes. They read more memory than its matrix products.
    """
    total = weights[0] * fields[0]
    for weight, values in zip(weights[1:], fields[1:], strict=True):
        if weight:
            total = daxpy(values, total, a=weight)
    return total


@dataclass(frozen=True)
class DynamicOperator(Operator):
    """The factorised A = a M + d C + K."""

    organ: "DynamicOrgan"
    a: float
    d: float

    def predict(self, state: OrganState, history: History, load: Array) -> Array:
        """Return U⁺ under a load (N,) without site forces, by one solve.

        The solve is for the increment, so that round-off is relative to the increment.
        """

        def guess() -> Array:
            """Return the field for constant acceleration and site forces."""
            if not self.a:
                return np.asarray(-self.W @ state.f_y)
            return history.inertia + state.A / self.a - state.U - self.W @ state.f_y

        return state.U + self.factor.solve(self.residual(history, self.organ.products(state), load), guess)

    def residual(self, history: History, now: Products, load: Array) -> Array:
        """Return b − A U under a load (N,).

        It follows from known products of U and of the history, without a new matrix product.
        """
        alpha, beta = self.organ.rayleigh
        a, c, k = self.a, alpha * self.d, beta * self.d
        inertia = (a, c, -a - c), (history.M_inertia, history.M_damping, now.MU)
        stiffness = (k, -1.0 - k), (history.K_damping, now.KU)
        return combination((1.0, *inertia[0], *stiffness[0]), (load, *inertia[1], *stiffness[1]))

    def state(
        self, history: History, U: Array, f_y: Array, p: Array, pairing: Pairing, shares: Array | None
    ) -> OrganState:
        """Return the state of U⁺ with its rates and products.

        The forces `f_y` and `p` and the `shares` of the loads act on it.

        Only M U⁺ needs a new matrix product.

        K U⁺ follows from the balance of forces of the step. The residuals of the solver therefore
        accumulate in K U⁺; with a direct solver they are round-off. If they are larger, K U⁺ is
        left out of the state and computed later by a product.
        """
        alpha, beta = self.organ.rayleigh
        MU = self.organ.mass_times(U)
        a, d, share = self.a, self.d, 1.0 / (1.0 + beta * self.d)
        MV = combination((d, -d), (MU, history.M_damping))
        forces = self.organ.load_under(shares), self.organ.site_rows @ f_y, MU, history.M_inertia, MV, history.K_damping
        KU = combination((share, share, -share * a, share * a, -share * alpha, share * beta * d), forces)
        if p.any():
            KU += share * (pairing.G.T @ p)
        rates = combination((d, -d), (U, history.damping)), combination((a, -a), (U, history.inertia))
        rest = pairing.facing, shares
        stands = self.organ.is_elastic_force(U, KU)
        return OrganState(U, *rates, f_y, p, *rest, MU=MU, MV=MV, KU=KU if stands else None, points=pairing.points)


@dataclass(frozen=True, eq=False)
class DynamicOrgan(MeshedOrgan):
    """An organ with inertia and Rayleigh damping C = αM + βK, `rayleigh` = (α [1/s], β [s]).

    The organ need not be held by supports.
    """

    rayleigh: tuple[float, float] = (0.0, 0.0)
    node_mass: csr_matrix = field(init=False, repr=False)
    slots: NDArray[np.intp] | None = field(init=False, repr=False)  # of free unknowns; None if no node is partly held
    _forces: Recent[Array] = field(default_factory=Recent, init=False, repr=False)

    def __post_init__(self) -> None:
        super().__post_init__()
        alpha, beta = self.rayleigh
        if not (0.0 <= alpha < np.inf and 0.0 <= beta < np.inf):
            raise TissueError(
                f"rayleigh = {self.rayleigh}: allowed are α ≥ 0 [1/s] and β ≥ 0 [s]; damping takes energy"
            )
        free = self.elasticity.free
        whole = np.unique(free // 3)[:, None] * 3 + np.arange(3)  # all unknowns of nodes with a free unknown
        rolls = whole.size > free.size
        nodal = csr_matrix(self.elasticity.M[whole.ravel()][:, whole.ravel()]) if rolls else self.M
        object.__setattr__(self, "slots", np.searchsorted(whole.ravel(), free) if rolls else None)
        object.__setattr__(self, "node_mass", csr_matrix(nodal[::3, ::3]))

    def start(self) -> OrganState:
        """Return the undeformed state at rest; gravity and loads act from the first step."""
        rest = np.zeros(self.size)
        return OrganState(rest, rest, rest, np.zeros(self.y0.size), np.zeros(self.contacts), shares=self.no_shares)

    def operator(self, a: float, d: float) -> DynamicOperator:
        """Return the factorised operator of a time scheme; the last few operators are cached.

        For a = d = 0, without motion, the operator is K. Raises `TissueError` for numbers that no
        scheme has.
        """
        if not ((0.0 < a < np.inf and 0.0 <= d < np.inf) or a == d == 0.0):
            raise TissueError(
                f"a = {a} 1/s², d = {d} 1/s: allowed are a > 0 and d ≥ 0, or zeros at rest; give a positive time step"
            )
        return self._operators.of((), lambda: self._factorized(a, d), (a, d))

    @cached_property
    def _operators(self) -> Recent[DynamicOperator]:
        """The last operators, as many as fit into memory."""
        return Recent(min(KEPT_OPERATORS, self.choice.room))

    def operator_of(self, scheme: TimeScheme) -> DynamicOperator:
        """Return the factorised operator of a step of a scheme."""
        return self.operator(scheme.a, scheme.d)

    def mass_times(self, field: Array) -> Array:
        """Return M times a field over the free unknowns `(N,)`.

        The three components of a node have the same row of M.
        """
        if self.slots is None:
            return np.asarray(self.node_mass @ field.reshape(-1, 3)).ravel()
        whole = np.zeros(3 * self.node_mass.shape[0])  # held components are zero
        whole[self.slots] = field
        return np.asarray(self.node_mass @ whole.reshape(-1, 3)).ravel()[self.slots]

    def elastic_force(self, U: Array) -> Array:
        """Return K U.

        The forces of the last fields are cached, because the step to a state and the step from it
        need the same force.
        """
        return self._forces.of((U,), lambda: np.asarray(self.K @ U))

    def _factorized(self, a: float, d: float, soft: csr_matrix | None = None) -> DynamicOperator:
        """Return the operator of a scheme.

        `soft` is subtracted from the stiffness; None means no change.
        """
        alpha, beta = self.rayleigh
        A = csr_matrix((a + alpha * d) * self.M + (1.0 + beta * d) * self.K)
        if soft is not None:
            A = csr_matrix(A - soft)
        factor = self.solver_of(A)
        W, C = compliance(factor, self.Y)
        return DynamicOperator(self, A, factor, W, C, a, d)

    def answer(
        self, scheme: TimeScheme, past: Sequence[OrganState], time: float = np.inf, share: float = 1.0
    ) -> LinearAnswer:
        """Return the answer of a step of `scheme` from the states `past`, newest first.

        The answer takes one solve. The part `share` of the loads acts at `time` [s].
        """
        return self.answer_paired(scheme, past, self.paired_after(past, scheme), time, share)

    def answer_paired(
        self, scheme: TimeScheme, past: Sequence[OrganState], pairing: Pairing, time: float, share: float
    ) -> LinearAnswer:
        """Return the answer of a step with a given pairing."""
        operator, history = self.operator_of(scheme), self.history(scheme, past)
        shares = self.shares_at(time, share)
        load = self.load_under(shares)
        return self._answered(operator, operator.predict(past[0], history, load), history, load, pairing, shares)

    def _answered(
        self,
        operator: DynamicOperator,
        U_free: Array,
        history: History,
        load: Array,
        pairing: Pairing,
        shares: Array | None,
    ) -> LinearAnswer:
        """Return the answer of a step under a `load` (N,) that ends at `U_free` (N,) without site
        forces.
        """

        def complete(f_y: Array, p: Array) -> OrganState:
            """Return the state of U⁺ = U_free + W f_y + A⁻¹Gᵀ p."""
            U = operator.add_forces(U_free, f_y, p, pairing)
            return operator.state(history, U, f_y, p, pairing, shares)

        return LinearAnswer(
            operator,
            self.y0 + self.Y @ U_free,
            pairing.g0 + pairing.G @ U_free,
            complete,
            lambda: operator.residual(history, Products(*np.zeros((3, self.size))), load),
            pairing,
        )

    def history(self, scheme: TimeScheme, past: Sequence[OrganState]) -> History:
        """Return the reference fields U_a = Σ_k (α_k U_k + β_k V_k), U_d = Σ_k γ_k U_k of a scheme,
        and their products.

        They are zero for an equilibrium, which uses no earlier state.
        """
        if not scheme.coefficients:
            return History(*np.zeros((5, self.size)))
        alpha, beta, gamma = zip(*scheme.coefficients, strict=True)
        MU, MV, KU = zip(*map(self.products, past), strict=True)
        U, V = zip(*((state.U, state.V) for state in past), strict=True)
        return History(
            combination(alpha + beta, U + V),
            combination(gamma, U),
            combination(alpha + beta, MU + MV),
            combination(gamma, MU),
            combination(gamma, KU) if self.rayleigh[1] else np.zeros(self.size),
        )

    def products(self, state: OrganState) -> Products:
        """Return M U, M V and K U of a state.

        Products that the state already has are not computed again.
        """
        MU = self.mass_times(state.U) if state.MU is None else state.MU
        MV = self.mass_times(state.V) if state.MV is None else state.MV
        return Products(MU, MV, self.elastic_force(state.U) if state.KU is None else state.KU)

    def is_elastic_force(self, U: Array, force: Array) -> bool:
        """Return whether a force is K U up to round-off, measured along two random directions."""
        if self.choice.name == MULTIGRID:
            return False
        Z, KZ = self._probes
        return bool(np.all(np.abs(Z @ force - KZ @ U) <= DRIFT * self._stiffness * np.linalg.norm(U)))

    @cached_property
    def site_rows(self) -> csr_matrix:
        """Yᵀ by rows, shape `(N, 9p)`."""
        return csr_matrix(self.Y.T)

    @cached_property
    def _probes(self) -> tuple[Array, Array]:
        """Random directions z, as rows, and K z, shape `(2, N)` each."""
        Z = np.random.default_rng(0).standard_normal((2, self.size))
        return Z, np.ascontiguousarray((self.K @ Z.T).T)

    @cached_property
    def _stiffness(self) -> float:
        """‖K‖, the largest row sum [N/m]."""
        return float(np.max(abs(self.K) @ np.ones(self.size)))

    def site_variables(self, state: OrganState) -> Array:
        """Return y = y0 + Y U, shape `(9p,)`."""
        return np.asarray(self.y0 + self.Y @ state.U)

    def impulse(self, state: OrganState) -> SiteAnswer:
        """Return the answer of the sites' velocity to an impulse on the sites.

        The velocity dy/dt is Y V without the impulse, and changes by Y M⁻¹ Yᵀ times the impulse. V
        of the state changes by M⁻¹ Yᵀ times the impulse.
        """
        return SiteAnswer(
            self.Y @ state.V,
            lambda: self._mobility[1],
            lambda j, p: replace(state, V=state.V + self._mobility[0] @ j, MU=None, MV=None),
        )

    def displace(self, scheme: TimeScheme, state: OrganState, y: Array, f_y: Array) -> LinearAnswer:
        """Return the answer of a step in which the sites stay at `y` (9p,) while the forces are
        constant.
        """
        return self.displaced(self.operator_of(scheme), state, y, f_y, self.Y)

    @cached_property
    def _mobility(self) -> tuple[Array, Array]:
        """M⁻¹ Yᵀ `(N, 9p)` and Y M⁻¹ Yᵀ."""
        return compliance(mass_solver(self.M, self.places, self.choice.name), self.Y)

    def energies(self, old: OrganState, new: OrganState) -> OrganEnergies:
        """Return the energies at `new` and the works of the step.

        f_y·Δy + load = Δ(kinetic + elastic) + viscous + numerical is exact for any time scheme. The
        dissipation of the scheme is ½ΔUᵀKΔU + ½ΔVᵀMΔV + (A⁺ᵀMΔU − V⁺ᵀMΔV); the bracket is zero for
        backward Euler. The viscous work is V⁺ᵀ C ΔU. With p⁺·g⁺ = 0 the contact dissipates −p⁺·Δg =
        p⁺·g ≥ 0. This dissipation is part of `numerical`. It is of first order in the step, except
        if lips strike one another.
        """
        alpha, beta = self.rayleigh
        was, now = self.products(old), self.products(new)
        dU, dV, elastic = new.U - old.U, new.V - old.V, now.KU - was.KU
        pushes, friction = self.contact_works(new.p, self.pairing_of(new).G @ dU)
        return OrganEnergies(
            kinetic=float(0.5 * new.V @ now.MV),
            elastic=float(0.5 * new.U @ now.KU),
            load_work=float(self.load_under(new.shares) @ dU),
            viscous=float(alpha * (now.MV @ dU) + beta * (new.V @ elastic)),
            numerical=float(
                0.5 * dU @ elastic + 0.5 * dV @ (now.MV - was.MV) + new.A @ (now.MU - was.MU) - now.MV @ dV + pushes
            ),
            friction=friction,
        )
