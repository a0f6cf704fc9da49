"""No organ: piercings at points fixed in space."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import csr_matrix

from tissue.organ import (
    NOTHING,
    Array,
    History,
    OrganEnergies,
    OrganState,
    Prediction,
)
from tissue.sites import Site, space_frames


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
