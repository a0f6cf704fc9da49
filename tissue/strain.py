"""Strain and rotation of the organ, cell by cell: what small-strain elasticity takes to be small.

Linear elasticity reads strain and rotation off one gradient, ε = sym ∇U and ω = ½ curl U. It leaves out what is of
second order in either, and no displacement tells how much that is: a body may go far without straining.
"""

import numpy as np
from numpy.typing import NDArray
from skfem import ElementTetP1
from skfem.quadrature import get_quadrature

from tissue.arrays import Array
from tissue.elasticity import ELEMENTS, Elasticity, cellwise_lambda

Flags = NDArray[np.bool_]

VERTICES = 4  # of a tetrahedron: a gradient that is linear in a cell is largest at one of them


def cell_strain(elasticity: Elasticity, U: Array) -> tuple[Array, Array]:
    """Return the largest principal strain [-], in magnitude, and the largest rotation |½ curl U| [rad] of each cell,
    shape `(c,)` each. `U` [m] is a field over all unknowns `(N,)`.
    """
    element = ELEMENTS[elasticity.element]()
    places = np.asarray(element.doflocs)[: VERTICES if element.maxdeg > 1 else 1]
    values = elasticity.nodal(U)[elasticity.cells]
    slope = np.einsum("cni,canj->caij", values, shape_gradients(elasticity, places), optimize=True)
    turned = np.swapaxes(slope, 2, 3)
    strain = np.abs(np.linalg.eigvalsh(0.5 * (slope + turned))).max(axis=(1, 2))
    rotation = np.sqrt(0.125) * np.linalg.norm(slope - turned, axis=(2, 3)).max(axis=1)
    return np.asarray(strain), np.asarray(rotation)


def volume_ratio(elasticity: Elasticity, U: Array) -> Array:
    """Return the volume between the corners of each cell over that of the reference shape, J, shape `(c,)` [-]; `U` [m]
    is a field over all unknowns `(N,)`."""
    corners = elasticity.mesh.t.T
    before, now = (x[corners] for x in (elasticity.points, elasticity.points + elasticity.nodal(U)))
    sides = (x[:, 1:] - x[:, :1] for x in (now, before))
    now_volume, volume = (np.linalg.det(each) for each in sides)
    return np.asarray(now_volume / volume)


def nodal_volume_ratio(elasticity: Elasticity, U: Array) -> Array:
    """Return J averaged at the vertices by their hat functions ψ, ∫ ψ J dX / ∫ ψ dX, and midway along edges the mean of
    both ends, shape `(nodes,)` [-]; `U` [m] is a field over all unknowns `(N,)`.

    It is what the law of nearly incompressible tissue acts on (Bonet and Burton, Commun. Numer. Meth. Engng. 14, 1998):
    the J of single cells alternates where this one is smooth.
    """
    element, corners, mesh = ELEMENTS[elasticity.element](), ElementTetP1(), elasticity.mesh
    places, weights = get_quadrature(element, max(1, 2 * (element.maxdeg - 1)))  # the law's
    slope = np.einsum(
        "cni,canj->caij", elasticity.nodal(U)[elasticity.cells], shape_gradients(elasticity, places.T), optimize=True
    )
    J = np.linalg.det(np.eye(3) + slope)
    hats = weights * np.array([corners.lbasis(places, n)[0] for n in range(VERTICES)])
    volume = np.abs(elasticity.six_volumes)
    shares = volume * (hats @ J.T), volume * hats.sum(axis=1)[:, None]
    now, before = (np.bincount(mesh.t.ravel(), each.ravel(), mesh.nvertices) for each in shares)
    between = np.array([corners.lbasis(np.asarray(element.doflocs).T, n)[0] for n in range(VERTICES)])
    out = np.ones(len(elasticity.points))
    out[elasticity.cells] = (now / before)[mesh.t.T] @ between
    return out


def energy_density(elasticity: Elasticity, U: Array) -> Array:
    """Return the strain energy per volume of each cell, on its mean, shape `(c,)` [J/m³]: λ/2 (div U)² + μ ε : ε, and
    half of pressure times dilatation for what is averaged at the vertices. `U` [m] is a field over all unknowns `(N,)`.
    """
    element, material = ELEMENTS[elasticity.element](), elasticity.material
    places, weights = get_quadrature(element, max(1, 2 * element.maxdeg - 2))
    values = elasticity.nodal(U)[elasticity.cells]
    slope = np.einsum("cni,canj->caij", values, shape_gradients(elasticity, places.T), optimize=True)
    dilatation, strain = np.einsum("caii->ca", slope), 0.5 * (slope + slope.swapaxes(2, 3))
    spread = material.lame_lambda if elasticity.pressure is None else cellwise_lambda(material)
    lam, mu = (np.broadcast_to(modulus, len(slope))[:, None] for modulus in (spread, material.lame_mu))
    density = 0.5 * lam * dilatation**2 + mu * np.sum(strain**2, axis=(2, 3))
    if elasticity.pressure is not None:
        corners = ElementTetP1()
        shapes = np.array([corners.lbasis(places, n)[0] for n in range(VERTICES)])
        pressure = (elasticity.pressure @ U)[elasticity.mesh.t.T] @ shapes
        density += 0.5 * pressure * dilatation * np.reshape(material.lame_lambda > spread, (-1, 1))
    return np.asarray(density @ weights / weights.sum())


def energy_share(elasticity: Elasticity, strain: Array, cells: Flags) -> float:
    """Return the share of the organ's strain energy, measured by ∫ E ε² dx with the `strain` (c,) of each cell, that is
    in some `cells` (c,); 0 of an organ without strain.
    """
    energy = elasticity.material.youngs_modulus * elasticity.six_volumes * strain**2
    return float(energy[cells].sum() / max(energy.sum(), np.finfo(float).tiny))


def shape_gradients(elasticity: Elasticity, places: Array) -> Array:
    """Return ∂φ_n/∂x_j at places of the reference cell `(a, 3)`, in each cell, shape `(c, a, n, 3)` [1/m]."""
    slopes = reference_slopes(elasticity.element, places)
    return np.einsum("nka,ckj->canj", slopes, elasticity.inverse_edges, optimize=True)


def reference_slopes(name: str, places: Array) -> Array:
    """Return ∂φ_n/∂ξ_k of the shape functions of an element at places of the reference cell `(a, 3)`, shape
    `(n, 3, a)`."""
    element, count = ELEMENTS[name](), len(places)
    each = [np.reshape(element.lbasis(places.T, n)[1], (3, -1)) for n in range(len(element.doflocs))]
    return np.array([np.broadcast_to(slope, (3, count)) for slope in each])
