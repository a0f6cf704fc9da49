"""No organ: piercings at points fixed in space."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import csr_matrix

from tissue.arrays import Array
from tissue.organs.meshed import EMPTY, NO_LIPS, Equation, Lips, OrganEnergies, OrganState, SiteAnswer, TimeScheme
from tissue.sites.site import Site, space_frames


@dataclass(frozen=True)
class FixedAnswer(SiteAnswer[OrganState]):
    """The answer of sites fixed in space.

    The sites have no rows in the assembled matrix.
    """

    @property
    def equation(self) -> Equation:
        """The equation, which has no unknowns."""
        sites = csr_matrix((self.y_free.size, 0))
        return Equation(csr_matrix((0, 0)), EMPTY, self.y_free, sites, EMPTY, csr_matrix((0, 0)))


@dataclass(frozen=True)
class FixedSites:
    """Sites fixed in space instead of an organ, `y0` `(9p,)`; made by `fixed_sites`.

    `directed` tells for each site whether a direction was given; it is empty if this is unknown.
    """

    y0: Array
    directed: tuple[bool, ...] = ()

    @property
    def size(self) -> int:
        """Number of unknowns, zero."""
        return 0

    def lips(self, state: OrganState) -> Lips:
        """Return no pairs: there are no lips."""
        return NO_LIPS

    def start(self) -> OrganState:
        """Return the state without forces."""
        return OrganState(EMPTY, EMPTY, EMPTY, np.zeros(self.y0.size))

    def answer(
        self, scheme: TimeScheme, past: Sequence[OrganState], time: float = np.inf, share: float = 1.0
    ) -> FixedAnswer:
        """Return the answer of sites that no force moves."""
        return FixedAnswer(self.y0, self._stiff, lambda f_y, p: OrganState(EMPTY, EMPTY, EMPTY, f_y))

    def site_variables(self, state: OrganState) -> Array:
        """Return y0, shape `(9p,)`."""
        return self.y0

    def impulse(self, state: OrganState) -> SiteAnswer:
        """Return the answer of sites at rest: they do not move under any impulse."""
        return SiteAnswer(np.zeros(self.y0.size), self._stiff, lambda j, p: state)

    def displace(self, scheme: TimeScheme, state: OrganState, y: Array, f_y: Array) -> SiteAnswer:
        """Return the answer of sites that no force moves."""
        return SiteAnswer(self.y0, self._stiff, lambda f_new, p: replace(state, f_y=state.f_y + (f_new - f_y)))

    def _stiff(self) -> Array:
        """Return the compliance of the sites, zero, shape `(9p, 9p)`."""
        return np.zeros((self.y0.size, self.y0.size))

    def steady_loads(self, state: OrganState, times: Sequence[float]) -> tuple[float, Array, Array]:
        """Return zero energy, zero displacement of the sites and the forces on them: there are no
        loads.
        """
        return 0.0, np.zeros(self.y0.size), state.f_y

    def energies(self, old: OrganState, new: OrganState) -> OrganEnergies:
        """Return zero energies and works."""
        return OrganEnergies(0.0, 0.0, 0.0, 0.0, 0.0)


def fixed_sites(sites: Sequence[Site]) -> FixedSites:
    """Return sites fixed in space; their directions must be vectors or None."""
    return FixedSites(space_frames(sites), tuple(site.direction is not None for site in sites))
