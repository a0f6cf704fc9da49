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
from tissue.organs.meshed import KEPT_OPERATORS, OrganEnergies, OrganState, SiteAnswer, TimeScheme
from tissue.recent import Recent

# The data with which a kernel makes steps of an organ in modes of stiffness one. Masses and loads (n,); displacement by
# the site forces in a step, W (n, 9p); Y (9p, n), y0 (9p,); residual of the equations of motion per acceleration of the
# modes (k, n); Rayleigh's α [1/s] and β [s]; tolerances of the residual, relative to the largest forces and by
# round-off [√J].
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
    """Modes of an organ.

    `mu` (n,) = 1/ω² [s²] are their masses for a stiffness of one. `Y` has shape (9p, n). `load`
    (n,) is gravity, `surface_load` (n, l) the loads, and `rayleigh` = (α [1/s], β [s]).
    """

    mu: Array
    Y: Array
    load: Array
    surface_load: Array
    rayleigh: tuple[float, float]
    _operators: Recent[ModalOperator] = field(default_factory=lambda: Recent(KEPT_OPERATORS), init=False, repr=False)

    @property
    def size(self) -> int:
        """Number of modes."""
        return self.mu.size

    def operator(self, a: float, d: float) -> ModalOperator:
        """Return the operator of a time scheme; the last few operators are cached."""
        return self._operators.of((), lambda: self._operator(a, d), (a, d))

    def _operator(self, a: float, d: float) -> ModalOperator:
        alpha, beta = self.rayleigh
        diagonal = (a + alpha * d) * self.mu + (1.0 + beta * d)
        W = self.Y.T / diagonal[:, None]
        C = self.Y @ W
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
        """Return y = y0 + Y η, shape `(9p,)`."""
        return np.asarray(y0 + self.Y @ U)

    def rates(self, state: OrganState) -> Array:
        """Return η̈ + α η̇, `(n,)`; its product with μ is the force of inertia and mass damping."""
        return np.asarray(state.A + self.rayleigh[0] * state.V)

    def energies(self, old: OrganState, new: OrganState) -> OrganEnergies:
        """Return the energies at `new` and the works of the step, as in `tissue.organs.dynamic`."""
        (alpha, beta), mu = self.rayleigh, self.mu
        U, V, A, dU, dV = new.U, new.V, new.A, new.U - old.U, new.V - old.V
        return OrganEnergies(
            kinetic=float(0.5 * V @ (mu * V)),
            elastic=float(0.5 * U @ U),
            load_work=float(self.load_under(new.shares) @ dU),
            viscous=float(alpha * (mu * V) @ dU + beta * V @ dU),
            numerical=float(0.5 * dU @ dU + 0.5 * dV @ (mu * dV) + (mu * A) @ dU - (mu * V) @ dV),
        )
