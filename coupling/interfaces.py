"""What the coupling asks of an organ: nine numbers per piercing, their compliance, and one back-substitution.

Of an organ whose lips may touch (`Organ.pairs` > 0) it asks their gaps `g`, shape `(k,)`, and gives it the contact
forces `p` (k,) [N] that push them apart. Of an organ of no pairs it asks nothing of that.

`y`, shape `(9p,)`, holds per piercing the point x [m] and the frame vectors u, v [-]. `f_y`, shape `(9p,)`, is the
generalized force on the organ conjugate to y, Φ_yᵀλ. A time scheme is two numbers and two reference fields:
acceleration = a (U − U_a), velocity = d (U − U_d); backward Euler has a = 1/Δt², U_a = U + Δt V, d = 1/Δt, U_d = U.
"""

from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix

Array = NDArray[np.float64]
Indices = NDArray[np.intp]


class Prediction(Protocol):
    """The organ's answer to a step without the thread."""

    @property
    def y_free(self) -> Array:
        """Site variables without site forces, shape `(9p,)`."""


class OrganOperator(Protocol):
    """The factored organ at one pair (a, d)."""

    @property
    def A(self) -> csr_matrix:
        """a M + d C + K over the free unknowns, shape `(N, N)`; K for a quasi-static organ."""

    @property
    def C(self) -> Array:
        """Site compliance Y A⁻¹ Yᵀ, shape `(9p, 9p)`."""

    def right_hand_side(self, state: Any, history: Any) -> Array:
        """b of A U⁺ = b + Yᵀ f_y, shape `(N,)`."""

    def predict(self, state: Any, history: Any) -> Prediction:
        """The step without site forces."""

    def complete(self, prediction: Any, f_y: Array, p: Array) -> Any:
        """The organ's state after the step under the site forces `f_y` and the contact forces `p`, `(0,)` without
        pairs."""


class ContactOperator(OrganOperator, Protocol):
    """That of an organ with pairs, whose predictions have `g_free` (k,) [m] beside `y_free`."""

    @property
    def C_cc(self) -> Array:
        """Gaps by contact forces, symmetric and positive definite, shape `(k, k)` [m/N]."""

    @property
    def C_cy(self) -> Array:
        """Gaps by site forces, shape `(k, 9p)`."""


class OrganEnergies(Protocol):
    """Energies at the end of a step and works during it [J]."""

    @property
    def kinetic(self) -> float:
        """½VᵀMV"""

    @property
    def elastic(self) -> float:
        """½UᵀKU"""

    @property
    def gravity_work(self) -> float:
        """Of the weight."""

    @property
    def viscous(self) -> float:
        """Taken by the Rayleigh damping."""

    @property
    def numerical(self) -> float:
        """Taken by the integrator, and by contact: −p⁺·Δg."""


class Organ(Protocol):
    """An elastic organ, or none, as the coupling sees it."""

    @property
    def y0(self) -> Array:
        """Reference site variables, shape `(9p,)`."""

    @property
    def Y(self) -> csr_matrix:
        """y = y0 + Y U over the free unknowns, shape `(9p, N)`."""

    @property
    def size(self) -> int:
        """Number N of free unknowns."""

    def displacement(self, state: Any) -> Array:
        """Displacement of all unknowns, made on demand [m]."""

    def start(self) -> Any:
        """State at the start of a run."""

    def operator(self, a: float, d: float) -> OrganOperator:
        """Factored operator of a time scheme; kept for the pairs used last."""

    def history(self, coefficients: Any, states: Any) -> Any:
        """Reference fields of the time scheme: U_a = Σ (α U + β V), U_d = Σ γ U over `coefficients` (α, β, γ)."""

    def energies(self, old: Any, new: Any) -> OrganEnergies:
        """Energies at `new` and works of the step."""

    def site_variables(self, state: Any) -> Array:
        """y, shape `(9p,)`."""

    @property
    def pairs(self) -> int:
        """Number k of pairs of points on lips that may touch; 0: nothing below is asked for."""

    def gap(self, state: Any) -> Array:
        """g, shape `(k,)` [m]."""

    def contact_forces(self, state: Any) -> Array:
        """p, shape `(k,)` [N]."""


@runtime_checkable
class JumpingOrgan(Organ, Protocol):
    """What a piercing that begins asks of an organ beside: to be drawn to the thread, and to take an impulse."""

    def site_velocities(self, state: Any) -> Array:
        """dy/dt, shape `(9p,)`."""

    def site_mobility(self) -> Array | None:
        """Y M⁻¹ Yᵀ, jump of dy/dt by an impulse conjugate to y, shape `(9p, 9p)`; None without mass to take one."""

    def kicked(self, state: Any, impulse: Array) -> Any:
        """The state after an impulse `(9p,)` on its sites: V + M⁻¹ Yᵀ impulse."""

    def moved(self, state: Any, operator: Any, f_y: Array, p: Array) -> Any:
        """The state with other site and contact forces and the displacement that an operator gives their change; V is
        kept."""
