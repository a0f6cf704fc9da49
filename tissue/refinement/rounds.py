"""A body with fine cells at its holes, refined by estimates of its error.

The error is estimated and the mesh is refined until the accuracy is reached.
"""

import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from time import perf_counter

import numpy as np
from skfem import MeshTet

from tissue.arrays import Array
from tissue.elasticity import Elasticity
from tissue.refinement.estimate import estimate
from tissue.refinement.mark import marked, share_to_mark, wanted
from tissue.refinement.refine import refine, refine_to
from tissue.sites.site import Site, Sites, build_sites

log = logging.getLogger(__name__)

MOST_ROUNDS = 8  # three to six are usual
GROWTH = 2.0  # of the unknowns in a round: about the largest factor


@dataclass(frozen=True)
class Round:
    """A round of refinement.

    `unknowns` is the number of free unknowns. `error` is the largest estimated relative error of a
    hole's compliance [-], and `seconds` is the time of the round.
    """

    unknowns: int
    error: float
    seconds: float

    def record(self) -> dict[str, float | int]:
        """Return the numbers for the record of a run."""
        return {"unknowns": self.unknowns, "estimate": self.error, "seconds": self.seconds}


@dataclass(frozen=True)
class Fitted:
    """A `body` whose mesh was refined in `rounds`, with its `sites` and their estimated errors.

    `errors` `(p,)` [-] are the relative errors of the compliance of its sites, NaN for bare points.
    `indicators` `(c,)` [-] are the shares of its cells in these errors.
    """

    body: Elasticity
    sites: Sites
    rounds: tuple[Round, ...]
    errors: Array
    indicators: Array


def fitted(
    mesh: MeshTet,
    element: str,
    body_on: Callable[[MeshTet], Elasticity],
    sites: Sequence[Site],
    accuracy: float,
    most: float = np.inf,
    mirror: int | None = None,
    sized: bool = False,
) -> Fitted:
    """Return a body on a mesh that is refined until every site's compliance is accurate enough.

    `body_on` makes the body on a mesh. The refinement ends when the estimated relative errors are
    within the `accuracy`, or if the next round could have more than `most` unknowns.

    A mesh that is symmetric about the plane normal to the axis `mirror` stays symmetric, because
    matching lips need this symmetry. The cells of a mesh that is `sized` are small at the sites
    already (`tissue.refinement.mark.zones`).
    """
    begun = perf_counter()
    if not sized:
        size = wanted(mesh, element, accuracy, sites)
        mesh = refine_to(mesh, size if mirror is None else mirrored(size, mirror)).mesh
    body = body_on(mesh)
    rounds: list[Round] = []
    while True:
        placed = build_sites(body, sites)
        found = estimate(body, sites, placed)
        error = float(found.errors.max(initial=0.0))
        rounds.append(Round(body.free.size, error, perf_counter() - begun))
        told = len(rounds), body.free.size, 100.0 * error
        log.info("cells at the holes, round %d: %d unknowns, an error of %.2g %% in a hole's compliance", *told)
        if error <= accuracy or len(rounds) == MOST_ROUNDS or GROWTH * body.free.size > most:
            break
        begun = perf_counter()
        share = share_to_mark(element, error / accuracy)
        body = body_on(refine(body.mesh, marked(body.mesh, found.indicators, share, mirror)).mesh)
    errors = np.full(len(sites), np.nan)
    errors[found.goals] = found.errors
    return Fitted(body, placed, tuple(rounds), errors, found.indicators)


def mirrored(size: Callable[[Array], Array], axis: int) -> Callable[[Array], Array]:
    """Return a size function that is symmetric about the plane normal to an axis.

    It returns the smaller of the sizes wanted at corners `(c, 4, 3)` and at their mirror images.
    """
    signs = np.ones(3)
    signs[axis] = -1.0
    return lambda corners: np.minimum(size(corners), size(corners * signs))
