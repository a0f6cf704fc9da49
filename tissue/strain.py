"""Strain and rotation of the organ, cell by cell.

Small-strain elasticity assumes that both are small.

Linear elasticity takes strain and rotation from one gradient, ε = sym ∇U and ω = ½ curl U. It
neglects terms of second order in both. The displacement does not show the size of these terms: a
body can move far without strain.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.sparse import csr_matrix
from skfem import ElementTetP1
from skfem.quadrature import get_quadrature

from tissue.arrays import Array
from tissue.elasticity import Elasticity, cellwise_lambda
from tissue.materials.density import determinant
from tissue.shapes import shapes

PAIRS = ((0, 1), (1, 2), (0, 2))  # of axes, in VTK's order of a symmetric tensor


class Strains(NamedTuple):
    """Strain measures of a field.

    - `strain` `(c,)` [-]: the largest principal strain of each cell in magnitude.
    - `rotation` `(c,)` [rad]: its largest rotation |½ curl U|.
    - `energy_density` `(c,)` [J/m³]: its mean strain energy per volume, λ/2 (div U)² + μ ε : ε. Averaged
      terms add half of pressure times dilatation.
    - `nodal_volume_ratio` `(nodes,)` [-]: the result of the function of this name.
    """

    strain: Array
    rotation: Array
    energy_density: Array
    nodal_volume_ratio: Array


def strains(elasticity: Elasticity, U: Array) -> Strains:
    """Return all strain measures of a field over all unknowns `(N,)` [m].

    The gradient of the field is computed once.
    """
    corners, mean = elasticity.corner_slopes, elasticity.mean_slopes[0]
    at_corners = gradient(elasticity, corners, U)
    slope = at_corners if mean is corners else gradient(elasticity, mean, U)
    return Strains(
        *_strain_of(elasticity, at_corners), _energy_of(elasticity, U, slope), _nodal_ratio_of(elasticity, slope)
    )


def _strain_of(elasticity: Elasticity, slope: Array) -> tuple[Array, Array]:
    shear = [0.5 * (slope[i, j] + slope[j, i]) for i, j in PAIRS]
    low, high = extreme_values([slope[0, 0], slope[1, 1], slope[2, 2], *shear])
    strain = np.maximum(high, -low)
    turn = sum(np.square(slope[i, j] - slope[j, i]) for i, j in PAIRS)
    places = strain.size // len(elasticity.cells), -1
    return strain.reshape(places).max(axis=0), 0.5 * np.sqrt(turn).reshape(places).max(axis=0)


def extreme_values(parts: Sequence[Array]) -> tuple[Array, Array]:
    """Return the smallest and the largest principal value of symmetric tensors, `(m,)` each.

    `parts` are xx, yy, zz, xy, yz, xz, `(m,)` each. The values follow from the invariants: p + 2
    √(J₂/3) cos θ with the Lode angle θ, cos 3θ = (3√3/2) J₃/J₂^(3/2).

    This method takes a tenth of the time of an eigenvalue solver. If two of the three principal
    values are equal, seven digits are correct.
    """
    p = (parts[0] + parts[1] + parts[2]) / 3.0
    x, y, z = (part - p for part in parts[:3])
    xy, yz, xz = parts[3:]
    J2 = 0.5 * (x**2 + y**2 + z**2) + xy**2 + yz**2 + xz**2
    J3 = x * y * z + 2.0 * xy * yz * xz - x * yz**2 - y * xz**2 - z * xy**2
    radius = np.sqrt(J2 / 3.0)
    cosine = 0.5 * J3 / np.maximum(radius**3, np.finfo(float).tiny)
    angle = np.arccos(np.clip(cosine, -1.0, 1.0)) / 3.0
    return p + 2.0 * radius * np.cos(angle + 2.0 * np.pi / 3.0), p + 2.0 * radius * np.cos(angle)


def symmetric(parts: Sequence[Array] | Array) -> Array:
    """Return symmetric tensors, shape `(m, 3, 3)`, from their parts xx, yy, zz, xy, yz, xz `(6,
    m)`.
    """
    xx, yy, zz, xy, yz, xz = parts
    return np.stack([xx, xy, xz, xy, yy, yz, xz, yz, zz], axis=1).reshape(-1, 3, 3)


def gradient(elasticity: Elasticity, slopes: csr_matrix, U: Array) -> Array:
    """Return ∂U_i/∂x_j, shape `(3, 3, a c)`, at the places of `slopes`
    (`tissue.elasticity.slope_matrix`).
    """
    return np.array([(slopes @ part).reshape(3, -1) for part in elasticity.nodal(U).T])


def volume_ratio(elasticity: Elasticity, U: Array) -> Array:
    """Return J of each cell, `(c,)` [-]: its volume divided by its volume in the reference shape.

    `U` [m] is a field over all unknowns `(N,)`. The edges of a P2 cell can bend, so its volume is
    not the volume between its corners.
    """
    places, weights = get_quadrature(elasticity.cell, max(1, 3 * elasticity.cell.maxdeg - 3))
    return np.asarray(weights @ volume_ratios(elasticity, U, places.T) / weights.sum())


def volume_ratios(elasticity: Elasticity, U: Array, places: Array) -> Array:
    """Return J at `places` `(a, 3)` of the reference cell, shape `(a, c)` [-].

    `U` [m] is a field over all unknowns `(N,)`. With elements of degree k, J is a polynomial of
    degree 3 (k − 1) in a cell.
    """
    _, slopes = shapes(elasticity.cell, places)
    x = (elasticity.points + elasticity.nodal(U))[elasticity.cells]
    edges = (np.tensordot(slope, x, (0, 1)).swapaxes(1, 2) for slope in np.moveaxis(slopes, 2, 0))
    return np.array([determinant(edge) for edge in edges]) / elasticity.signed_six_volumes


def nodal_volume_ratio(elasticity: Elasticity, U: Array) -> Array:
    """Return J averaged at the nodes, shape `(nodes,)` [-].

    `U` [m] is a field over all unknowns `(N,)`.

    At the vertices the average is ∫ ψ J dX / ∫ ψ dX with the hat functions ψ. At the middle of an
    edge it is the mean of both ends.

    The law of nearly incompressible tissue acts on this average (Bonet and Burton, Commun. Numer.
    Meth. Engng. 14, 1998). The average is smooth, whereas J of single cells oscillates.
    """
    return _nodal_ratio_of(elasticity, gradient(elasticity, elasticity.mean_slopes[0], U))  # points of the law


def _nodal_ratio_of(elasticity: Elasticity, slope: Array) -> Array:
    corners, mesh = ElementTetP1(), elasticity.mesh
    _, places, weights = elasticity.mean_slopes
    J = determinant(slope + np.eye(3)[:, :, None]).reshape(len(weights), -1)
    hats = weights * shapes(corners, places)[0]
    volume = elasticity.six_volumes
    shares = volume * (hats @ J), volume * hats.sum(axis=1)[:, None]
    now, before = (np.bincount(mesh.t.ravel(), each.ravel(), mesh.nvertices) for each in shares)
    if elasticity.element == "P1":
        return np.asarray(now / before)
    between, _ = shapes(corners, np.asarray(elasticity.cell.doflocs))
    out = np.ones(len(elasticity.points))
    out[elasticity.cells] = (now / before)[mesh.t.T] @ between
    return out


def _energy_of(elasticity: Elasticity, U: Array, slope: Array) -> Array:
    material, (_, places, weights) = elasticity.material, elasticity.mean_slopes
    slope = slope.reshape(3, 3, len(weights), -1)
    dilatation = slope[0, 0] + slope[1, 1] + slope[2, 2]
    squares = sum(np.square(slope[i, i]) for i in range(3))
    squares = squares + 0.5 * sum(np.square(slope[i, j] + slope[j, i]) for i, j in PAIRS)
    spread = cellwise_lambda(material, elasticity.dilatation)
    density = 0.5 * spread * dilatation**2 + material.lame_mu * squares
    if elasticity.pressure is not None:
        numbers, element = elasticity.averages
        pressure = shapes(element, places)[0].T @ (elasticity.pressure @ U)[numbers]
        density += 0.5 * pressure * dilatation * (material.lame_lambda > spread)
    return np.asarray(weights @ density)


def energy_measure(elasticity: Elasticity, strain: Array) -> Array:
    """Return 6 ∫ E ε² dx of each cell, `(c,)` [J], with the `strain` (c,) of each.

    It measures the strain energy, so that the shares of cells can be compared.
    """
    return np.asarray(elasticity.material.youngs_modulus * elasticity.six_volumes * strain**2)
