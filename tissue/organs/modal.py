"""A linear organ with inertia, described by modes: stiffness is the identity and mass is diagonal.

A step is one small product:

    (a + α d) μ (η − η_a) + …  becomes  η⁺ = η_free + W f_y,   W = Yᵀ / (a μ + d (α μ + β) + 1),   y = y0 + Y η

as in `tissue.organs.meshed`, with numbers instead of matrices. Rayleigh damping is α μ + β in each
mode.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from tissue.arrays import Array
from tissue.elasticity import Elasticity
from tissue.loads import Loads
from tissue.organs.dynamic import DynamicOrgan
from tissue.organs.meshed import (
    KEPT_OPERATORS,
    NO_LIPS,
    Lips,
    OrganEnergies,
    OrganState,
    SiteAnswer,
    TimeScheme,
)
from tissue.recent import Recent
from tissue.sites.site import Sites
from tissue.solvers.choice import SolverChoice

# The data with which a kernel makes steps of an organ in modes of stiffness one. The first r modes move the sites, and
# the others check them. Masses and loads (n,); displacement by the site forces in a step, W (n, 9p); Y (9p, r), y0
# (9p,); residual of the check per acceleration of the other modes (k, n − r); Rayleigh's α [1/s] and β [s]. If all
# modes move the sites, the residual is for all modes (k, n), and its tolerances follow, relative to the largest forces
# and by round-off [√J]; otherwise zeros.
ModalArrays = tuple[Array, Array, Array, Array, Array, Array, float, float, float, float]


@dataclass(frozen=True)
class ModalOperator:
    """The diagonal a μ + d (α μ + β) + 1 of a time scheme, with W and C.

    W `(n, 9p)` is the inverse of the diagonal times Yᵀ, and C has shape `(9p, 9p)`.
    """

    a: float
    d: float
    diagonal: Array
    W: Array
    C: Array


@dataclass(frozen=True, eq=False)
class Modes:
    """Modes of an organ; the first `size` of them move the sites.

    `mu` (n,) = 1/ω² [s²] are their masses for a stiffness of one. `Y` has shape (9p, n). `load`
    (n,) is gravity, `surface_load` (n, l) the loads, and `rayleigh` = (α [1/s], β [s]).
    """

    mu: Array
    Y: Array
    load: Array
    surface_load: Array
    rayleigh: tuple[float, float]
    size: int
    _operators: Recent[ModalOperator] = field(default_factory=lambda: Recent(KEPT_OPERATORS), init=False, repr=False)

    def operator(self, a: float, d: float) -> ModalOperator:
        """Return the operator of a time scheme; the last few operators are cached."""
        return self._operators.of((), lambda: self._operator(a, d), (a, d))

    def _operator(self, a: float, d: float) -> ModalOperator:
        alpha, beta = self.rayleigh
        diagonal = (a + alpha * d) * self.mu + (1.0 + beta * d)
        W = self.Y.T / diagonal[:, None]
        C = self.Y[:, : self.size] @ W[: self.size]
        return ModalOperator(a, d, diagonal, W, 0.5 * (C + C.T))

    def answer(
        self,
        y0: Array,
        scheme: TimeScheme,
        past: Sequence[OrganState],
        shares: Array | None,
        state: Callable[[Array, Array, Array, Array], OrganState],
    ) -> SiteAnswer[OrganState]:
        """Return the answer of a step of `scheme` from the states `past`, newest first.

        The parts `shares` (l,) of the loads act. `y0` (9p,) are the reference site variables.
        `state` returns the state for η, η̇, η̈ (n,) and f_y.
        """
        operator = self.operator(scheme.a, scheme.d)
        terms = list(zip(scheme.coefficients, past, strict=False))  # an equilibrium uses no earlier state
        inertia = sum((alpha * s.U + beta * s.V for (alpha, beta, _), s in terms), np.zeros(1))
        damping = sum((gamma * s.U for (_, _, gamma), s in terms), np.zeros(1))
        free = self._free(operator, past[0], inertia, damping, self.load_under(shares))

        def accept(f_y: Array, p: Array) -> OrganState:
            """Return the state of η = η_free + W f_y."""
            U = free + operator.W @ f_y
            return state(U, operator.d * (U - damping), operator.a * (U - inertia), f_y)

        return SiteAnswer(self.site_variables(y0, free), lambda: operator.C, accept)

    def _free(self, operator: ModalOperator, now: OrganState, inertia: Array, damping: Array, load: Array) -> Array:
        """Return η⁺ under a load without site forces, `(n,)`.

        The increment is solved for, so that round-off is relative to the increment.
        """
        alpha, beta = self.rayleigh
        moved = operator.a * (inertia - now.U) + alpha * operator.d * (damping - now.U)
        left = load + self.mu * moved + beta * operator.d * (damping - now.U) - now.U
        return np.asarray(now.U + left / operator.diagonal)

    def load_under(self, shares: Array | None) -> Array:
        """Return the forces of gravity and of the parts `shares` (l,) of the loads, `(n,)`."""
        return self.load if shares is None else self.load + self.surface_load @ shares

    def site_variables(self, y0: Array, U: Array) -> Array:
        """Return y = y0 + Y η of the first `size` modes, shape `(9p,)`."""
        return np.asarray(y0 + self.Y[:, : self.size] @ U[: self.size])

    def rates(self, state: OrganState) -> Array:
        """Return η̈ + α η̇, `(n,)`; its product with μ is the force of inertia and mass damping."""
        return np.asarray(state.A + self.rayleigh[0] * state.V)

    def energies(self, old: OrganState, new: OrganState) -> OrganEnergies:
        """Return the energies at `new` and the works of the step, as in `tissue.organs.dynamic`.

        They are exact for the first `size` modes.
        """
        (alpha, beta), own = self.rayleigh, slice(self.size)
        mu, U, V, A = self.mu[own], new.U[own], new.V[own], new.A[own]
        dU, dV = U - old.U[own], V - old.V[own]
        return OrganEnergies(
            kinetic=float(0.5 * V @ (mu * V)),
            elastic=float(0.5 * U @ U),
            load_work=float(self.load_under(new.shares)[own] @ dU),
            viscous=float(alpha * (mu * V) @ dU + beta * V @ dU),
            numerical=float(0.5 * dU @ dU + 0.5 * dV @ (mu * dV) + (mu * A) @ dU - (mu * V) @ dV),
        )


@dataclass(frozen=True, eq=False)
class OrganOfModes:
    """Common part of organs that move in modes of the organ `full` and have its mesh, sites and
    loads.
    """

    full: DynamicOrgan

    def spread(self, state: OrganState, x: Array) -> Array:
        """Return the field over the free unknowns (N,) of U, V or A of a state."""
        raise NotImplementedError

    def field(self, state: OrganState) -> Array:
        """Return the displacement over the free unknowns, shape `(N,)` [m]."""
        return self.spread(state, state.U)

    def displacement(self, state: OrganState) -> Array:
        """Return the displacement of all unknowns of the mesh, shape `(N_all,)` [m]."""
        return self.full.whole(self.field(state))

    def moved(self, state: OrganState, motion: tuple[Array, Array, Array, Array, float]) -> OrganState:
        """Return the state of a `motion` under the loads of another state."""
        U, V, A, f_y, tally = motion
        return OrganState(U, V, A, f_y, shares=state.shares, tally=tally)

    @property
    def y0(self) -> Array:
        """Reference site variables, shape `(9p,)` [m, -, -]."""
        return self.full.y0

    @property
    def directed(self) -> tuple[bool, ...]:
        """Whether each site was given a direction."""
        return self.full.directed

    @property
    def size(self) -> int:
        """Number of free unknowns of the full organ."""
        return self.full.size

    @property
    def elasticity(self) -> Elasticity:
        """The organ's discrete elasticity."""
        return self.full.elasticity

    @property
    def sites(self) -> Sites:
        """The organ's sites."""
        return self.full.sites

    @property
    def surface(self) -> Loads:
        """The loads on its boundaries."""
        return self.full.surface

    @property
    def choice(self) -> SolverChoice:
        """The solver used to build its basis."""
        return self.full.choice

    def load_resultants(self, state: OrganState) -> Array:
        """Return the sum of the forces of each whole load, `(l, 3)` [N]."""
        return self.full.load_resultants(state)

    def lips(self, state: OrganState) -> Lips:
        """Return no pairs: this organ has no contact."""
        return NO_LIPS
