"""A body with cells where its holes are: its mesh is estimated, marked and refined until the accuracy is reached."""

import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from time import perf_counter

import numpy as np
from skfem import MeshTet

from tissue.arrays import Array
from tissue.elasticity import Elasticity
from tissue.refinement.estimate import estimate
from tissue.refinement.mark import marked, wanted
from tissue.refinement.refine import refine, refine_to
from tissue.sites.site import Site, build_sites

log = logging.getLogger(__name__)

MOST_ROUNDS = 8  # three to six are usual
GROWTH = 2.0  # of the unknowns in a round, at most about


@dataclass(frozen=True)
class Round:
    """A round of refinement: the free `unknowns`, the largest relative `error` of a hole's compliance that was
    estimated [-], and the `seconds` it took."""

    unknowns: int
    error: float
    seconds: float

    def record(self) -> dict[str, float | int]:
        """The numbers to be written down."""
        return {"unknowns": self.unknowns, "estimate": self.error, "seconds": self.seconds}


@dataclass(frozen=True)
class Fitted:
    """A `body` whose mesh was refined in `rounds`, the relative `errors` of the compliance of its sites that were
    estimated `(p,)` [-], not a number of bare points, and the `indicators` of its cells `(c,)` [-], shares of these."""

    body: Elasticity
    rounds: tuple[Round, ...]
    errors: Array
    indicators: Array

    @property
    def error(self) -> float:
        """The largest of the errors, 0 without a footprint [-]."""
        return self.rounds[-1].error


def fitted(
    mesh: MeshTet,
    element: str,
    body_on: Callable[[MeshTet], Elasticity],
    sites: Sequence[Site],
    accuracy: float,
    most: float = np.inf,
    mirror: int | None = None,
) -> Fitted:
    """Return the body of an `element` that `body_on` makes on a mesh, refined until the relative error of the
    compliance of every site is within the `accuracy`, or the next round might have more than `most` unknowns.

    A mesh that is its own image about the plane across the axis `mirror`, as lips that match need it, stays so.
    """
    begun, size = perf_counter(), wanted(mesh, element, accuracy, sites)
    body = body_on(refine_to(mesh, size if mirror is None else mirrored(size, mirror)).mesh)
    rounds: list[Round] = []
    while True:
        found = estimate(body, sites, build_sites(body, sites))
        error = float(found.errors.max(initial=0.0))
        rounds.append(Round(body.free.size, error, perf_counter() - begun))
        told = len(rounds), body.free.size, 100.0 * error
        log.info("cells at the holes, round %d: %d unknowns, an error of %.2g %% in a hole's compliance", *told)
        if error <= accuracy or len(rounds) == MOST_ROUNDS or GROWTH * body.free.size > most:
            break
        begun = perf_counter()
        body = body_on(refine(body.mesh, marked(body.mesh, found.indicators, mirror)).mesh)
    errors = np.full(len(sites), np.nan)
    errors[found.goals] = found.errors
    return Fitted(body, tuple(rounds), errors, found.indicators)


def mirrored(size: Callable[[Array], Array], axis: int) -> Callable[[Array], Array]:
    """Return the smaller size of those wanted at corners `(c, 4, 3)` and at their images about the plane across an
    axis."""
    signs = np.ones(3)
    signs[axis] = -1.0
    return lambda corners: np.minimum(size(corners), size(corners * signs))
