"""Lower and upper bounds of each hole's compliance, which enclose the compliance of the exact body.

Lower bound: C_h of quadratic displacements on the mesh. By Galerkin orthogonality C_h is below C by
the energy ‖e‖² of the error e of the column. Upper bound: ‖e‖ is at most ‖θ − σ_h‖ for every stress
θ in equilibrium with the load (Prager and Synge, Quart. Appl. Math. 5, 1947). θ is constructed star
by star (`tissue.refinement.star`). θ balances the quadratic part of the traction under a footprint.
The rest of the traction moves the body by an energy of at most r² (`tissue.refinement.rim`):

    C_h ≤ C ≤ C_h + (‖θ − σ_h‖ + r)².

The dilatation is evaluated cell by cell, because there are no such bounds with an averaged
dilatation. The mesh is bisected at the rims of footprints until r is small, so that both bounds are
nearer to C than the compliance of the original mesh.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_matrix
from skfem import MeshTet

from tissue.arrays import Array, Indices
from tissue.elasticity import Elasticity, elasticity
from tissue.errors import TissueError
from tissue.material import Material
from tissue.refinement.estimate import is_held
from tissue.refinement.rim import cut_at_rims, pull_of
from tissue.refinement.star import AXES, OF_CELL, Stars
from tissue.sites.site import Site, build_sites, load_of
from tissue.sites.surface import outer_surface
from tissue.solvers.choice import GIGA, SHARE, Solver, solver_of_columns
from tissue.solvers.memory import free_memory
from tissue.supports import held_facets

BYTES_OF_CELL = 8 * OF_CELL**2 + 2e4  # for the stiffness of a cell, and for all other data
ROOM = 5e8  # bytes for the multipliers of goals that are solved together


@dataclass(frozen=True)
class Bounds:
    """Bounds of the compliance of sites to forces along x, y and z.

    The `lower` and `upper` bounds have shape `(g, 3)` each [m/N]. The `goals` `(g,)` are the sites
    with a footprint that do not belong to a line.
    """

    goals: Indices
    lower: Array
    upper: Array


def bounds(
    mesh: MeshTet,
    material: Material,
    sites: Sequence[Site],
    clamp: Sequence[str],
    roller: Sequence[str],
    accuracy: float,
) -> Bounds:
    """Return bounds of the compliance of sites to forces, for a linear body held at boundaries.

    A smaller `accuracy` of the compliance [-] gives finer cells at the rims of footprints. Bare
    points, which have no finite compliance, and the sites of a line are left out.

    Raises `TissueError` if the body is free to move, if a footprint is inside the body, if the
    facets do not cover a footprint exactly once, and if memory is too small.
    """
    goals = np.array([k for k, site in enumerate(sites) if site.radius > 0.0 and not site.line], np.intp)
    chosen = [sites[goal] for goal in goals]
    mesh, material = cut_at_rims(mesh, material, chosen, accuracy)
    check_memory(mesh.nelements)
    body = elasticity(mesh, material, "P2", clamp, "cell", roller)
    if not is_held(body):
        raise TissueError("bounds of the compliance: a part of the organ is free to move; clamp a boundary")
    surface, stars = outer_surface(mesh), Stars(mesh, material, held_facets(mesh, clamp, roller))
    pulls = [pull_of(stars, load_of(surface, site)) for site in chosen]
    rows, factor = goal_rows(body, chosen), factor_of(body)
    lower, excess = np.empty((2, goals.size, AXES))
    most = max(1, int(ROOM / (8 * AXES * OF_CELL * mesh.nelements)))
    for first in range(0, goals.size, most):
        some, own = slice(first, first + most), rows[AXES * first : AXES * (first + most)]
        W = np.zeros((body.N, own.shape[0]))
        W[body.free] = factor.solve(own.T.toarray())
        lower[some] = compliance(own, W[body.free])
        excess[some] = stars.excess(stars.field(body, W, pulls[some])).reshape(-1, AXES)
    rests = np.array([pull.missed.sum() for pull in pulls])
    return Bounds(goals, lower, lower + (np.sqrt(excess) + np.sqrt(rests)[:, None]) ** 2)


def relative_bounds(
    body: Elasticity,
    sites: Sequence[Site],
    clamp: Sequence[str],
    roller: Sequence[str],
    accuracy: float,
) -> Array:
    """Return bounds of each site's exact compliance, divided by its compliance in a linear `body`.

    The bounds have shape `(p, 2)` [-] and hold for forces along x, y and z. They are NaN for sites
    that are no goals. Raises `TissueError` as `bounds` does.
    """
    known = bounds(body.mesh, body.material, sites, clamp, roller, accuracy)
    rows = goal_rows(body, [sites[goal] for goal in known.goals])
    own = compliance(rows, factor_of(body).solve(rows.T.toarray()))
    out = np.full((len(sites), 2), np.nan)
    out[known.goals, 0] = np.min(known.lower / own, axis=1)
    out[known.goals, 1] = np.max(known.upper / own, axis=1)
    return out


def goal_rows(body: Elasticity, sites: Sequence[Site]) -> csr_matrix:
    """Return the rows of site displacements along x, y, z over the free unknowns, `(3p, N)`."""
    return csr_matrix(build_sites(body, sites).Y[(9 * np.arange(len(sites))[:, None] + np.arange(AXES)).ravel()])


def factor_of(body: Elasticity) -> Solver:
    """Return the solver for the columns of a body."""
    return solver_of_columns(body.free_stiffness, body.places)


def compliance(rows: csr_matrix, columns: Array) -> Array:
    """Return the compliance along x, y and z, `(p, 3)` [m/N].

    `rows` `(3p, N)` are the rows of the sites, and `columns` their columns.
    """
    return np.asarray(rows.multiply(columns.T).sum(axis=1)).reshape(-1, AXES)


def check_memory(cells: int) -> None:
    """Raise `TissueError` if the matrices of so many `cells` do not fit into memory."""
    need = BYTES_OF_CELL * cells
    if need > SHARE * free_memory():
        raise TissueError(
            f"bounds of the compliance: {cells} cells need {need / GIGA:.1f} GB, more than is free; take a larger "
            "tissue.mesh.accuracy, or leave tissue.mesh.bound out"
        )
