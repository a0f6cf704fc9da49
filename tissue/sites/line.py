"""What a mesh misses of a line of balls inside the tissue, along which a thread bears on it across itself.

Balls a radius or two apart move one another, so what a coarse mesh misses between them counts as much as at each. The
exact compliance between balls in an unbounded body is known at any distance, overlapping ones included. As for a single
hole (`tissue.sites.closed_form`), the exact field of each is prescribed on the rim of a patch of the mesh, here one
around them all, and the mesh answers inside:

    ΔC_ij = (C_unbounded,ij − Y_i u_mesh,j) / √(E_i E_j)

for a body of E = 1 and the mean ν of the tissue along the line, so that layers count by the modulus at each ball. What
the mesh misses within a cell of a border between layers, or of a surface, is made up for as if the tissue went on.
"""

from collections.abc import Sequence

import numpy as np
from scipy.sparse import csr_matrix, vstack
from scipy.special import spherical_jn

from tissue.arrays import Array
from tissue.elasticity import Elasticity, elasticity
from tissue.material import Material
from tissue.sites.closed_form import Footprint, field, foreign
from tissue.sites.surface import Surface
from tissue.sites.unbounded import kelvin, panels
from tissue.solvers.choice import solver_once

LARGEST = 60.0  # wave number times the smaller radius at which the integral ends: a uniform ball leaves 4e-6 out
PANELS = 60  # of twelve Gauss points each up to there
MOMENTS = {"uniform": 3.0 / 5.0, "parabolic": 3.0 / 7.0}  # ⟨r²⟩ over the square of the radius
TINY = 1e-9  # of a radius: two balls nearer are one
FORCES = 3  # of the nine numbers of a site: those of its point


def ball_pairs(centres: Array, radii: Array, weight: str, nu: float) -> Array:
    """Return the mean displacement of each ball by a unit force spread over each, in full space of E = 1, shape
    `(3p, 3p)`; `centres` `(p, 3)` [m] and `radii` `(p,)` [m]."""
    p = len(centres)
    offset, C = centres[:, None] - centres, np.empty((p, p, 3, 3))
    overlap = np.linalg.norm(offset, axis=2) < radii[:, None] + radii
    one, other = np.nonzero(overlap)
    C[overlap] = overlapping(offset[overlap], radii[one], radii[other], weight, nu)
    one, other = np.nonzero(~overlap)
    C[~overlap] = apart(offset[~overlap], MOMENTS[weight] * (radii[one] ** 2 + radii[other] ** 2), nu)
    return np.asarray(C.swapaxes(1, 2).reshape(3 * p, 3 * p))


def apart(offset: Array, moments: Array, nu: float) -> Array:
    """Return the same of pairs of balls that do not overlap, shape `(k, 3, 3)`, from the `moments` ⟨r²⟩ of both `(k,)`
    [m²]: the point force and a sixth of its Laplacian, since ∇⁴ of it is zero."""
    r = np.linalg.norm(offset, axis=1)[:, None, None]
    unit = offset / r[:, 0]
    quadrupole = np.eye(3) - 3.0 * unit[:, :, None] * unit[:, None, :]
    laplacian = (1.0 + nu) / (4.0 * np.pi * (1.0 - nu)) * quadrupole / r**3
    return np.asarray(kelvin(offset, nu) + moments[:, None, None] / 6.0 * laplacian)


def overlapping(offset: Array, one: Array, other: Array, weight: str, nu: float) -> Array:
    """Return the same of pairs of balls that overlap, of radii `one` and `other` `(k,)` [m].

    Kelvin's solution at wave vector k, (I − kkᵀ/2(1−ν)k²)/μk², times the weights' transforms; over the directions of k
    exp(ik·d) averages to j₀(kd), and k̂k̂ exp(ik·d) to I j₁(kd)/kd − d̂d̂ j₂(kd).
    """
    mu, away = 1.0 / (2.0 * (1.0 + nu)), np.linalg.norm(offset, axis=1)
    unit = offset / np.where(away > 0.0, away, 1.0)[:, None]
    x, dx = panels(LARGEST, PANELS, 12)  # wave number times the smaller radius
    a = np.minimum(one, other)
    share = dx / a[:, None] * transform(weight, x * (one / a)[:, None]) * transform(weight, x * (other / a)[:, None])
    kd = x * (np.maximum(away, TINY * a) / a)[:, None]
    whole, second = (np.sum(share * spherical_jn(n, kd), axis=1)[:, None, None] for n in (0, 2))
    part = 0.5 / (1.0 - nu)
    C = (whole - part * (whole + second) / 3.0) * np.eye(3) + part * second * unit[:, :, None] * unit[:, None, :]
    return np.asarray(C / (2.0 * np.pi**2 * mu))


def transform(weight: str, x: Array) -> Array:
    """Return the Fourier transform of a ball's weight at wave number times radius."""
    return np.asarray(15.0 * spherical_jn(2, x) / x**2 if weight == "parabolic" else 3.0 * spherical_jn(1, x) / x)


def line_gap(
    body: Elasticity, surface: Surface, balls: Sequence[Footprint], rows: csr_matrix, reach: Array, E: Array, nu: float
) -> tuple[Array, Array]:
    """Return ΔC of the points of `balls`, shape `(3p, 3p)` [m/N], and their compliance in the unbounded body.

    `rows` `(3p, N)` are those of the points over all unknowns, `reach` `(p,)` [m] is how far from each the patch goes,
    `E` `(p,)` [Pa] the modulus at each.
    """
    centres, radii = np.array([ball.centre for ball in balls]), np.array([ball.radius for ball in balls])
    exact = ball_pairs(centres, radii, balls[0].weight, nu)
    inside = np.zeros(len(body.points), dtype=bool)
    for centre, far in zip(centres, reach, strict=True):
        inside |= np.linalg.norm(body.points - centre, axis=1) <= far
    inside[foreign(body, surface, balls[0])] = False
    scale = 1.0 / np.sqrt(np.repeat(E, FORCES))
    gap = exact - answers(body, balls, rows, inside, nu)
    return scale[:, None] * 0.5 * (gap + gap.T) * scale, scale[:, None] * exact * scale


def answers(body: Elasticity, balls: Sequence[Footprint], rows: csr_matrix, inside: Array, nu: float) -> Array:
    """Return what the mesh makes of the unbounded body's fields around the balls, at their points, shape `(3p, 3p)`."""
    inner, whole = np.sort(body.nodes[inside].ravel()), uniform(body, nu)
    K = whole[inner]
    rim = np.setdiff1d(np.union1d(K.indices, rows.indices), inner)
    nodes, U = np.flatnonzero(np.isin(body.nodes, rim).any(axis=1)), np.zeros((body.N, rows.shape[0]))
    for j, ball in enumerate(balls):
        U[body.nodes[nodes], FORCES * j : FORCES * (j + 1)] = field(ball, body.points[nodes], nu)[:, :, :FORCES]
    factor = solver_once(csr_matrix(K[:, inner]), body.basis.doflocs[:, inner].T)
    U[inner] = factor.solve(rows[:, inner].T.toarray() - K[:, rim] @ U[rim])
    return np.asarray(rows @ U)


def uniform(body: Elasticity, nu: float) -> csr_matrix:
    """Return the stiffness of the body were it all of E = 1 and one ν, over all unknowns [m]."""
    E = np.unique(body.material.youngs_modulus)
    if E.size == 1 and np.all(np.asarray(body.material.poisson_ratio) == nu):
        return csr_matrix(body.K / E[0])
    dilatation = "cell" if body.pressure is None else "nodal"
    return elasticity(body.mesh, Material(1.0, nu, 1.0), body.element, dilatation=dilatation).K


def rows_of(points: Sequence[csr_matrix]) -> csr_matrix:
    """Return the rows of the balls' points, three each, one below the other."""
    return csr_matrix(vstack([csr_matrix(rows[:FORCES]) for rows in points]))
