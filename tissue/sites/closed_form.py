"""A footprint in a body that looks unbounded: its compliance, the field around it, and what a mesh makes of that field.

The exact field of `tissue.sites.unbounded` is prescribed on the rim of a patch of the organ's own mesh and matrix, and
the mesh answers inside. Had the mesh resolved the footprint, this would be the exact field; what the rim, edges and
other sites do to the site comes with the mesh's own compliance.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix

from tissue.arrays import Array, Indices
from tissue.elasticity import Elasticity
from tissue.sites import footprint
from tissue.sites.surface import Surface
from tissue.sites.unbounded import (
    DISC,
    TWELVE,
    ball_compliance,
    disc_compliance,
    half_ball_compliance,
    kelvin,
    scaled,
    surface_force,
)
from tissue.solvers.choice import solver_once

FACING = 0.9  # cosine of the turn of the normal up to which a facet belongs to the site's own surface
BLOCK = 50_000  # pairs of footprint points and rim nodes at a time, which fit near the processor


@dataclass(frozen=True)
class Footprint:
    """A site as the kernels see it: `centre` (3,) [m]; `axes` (3, 3), rows of a frame with the outward normal last;
    `radius` [m]; `weight`; `kind` "disc" (normal frame), "half ball" (fibre frame) or "ball" (inside); and `frame`
    `(9, 12)`, the site's variables from the twelve averages."""

    centre: Array
    axes: Array
    radius: float
    weight: str
    kind: str
    frame: Array

    @property
    def turn(self) -> Array:
        """The twelve averages in space from those in the axes, `(12, 12)`."""
        turned = np.zeros((TWELVE, TWELVE))
        turned[:3, :3], turned[3:, 3:] = self.axes.T, np.kron(self.axes.T, self.axes.T)
        return turned

    def distance(self, points: Array) -> Array:
        """Distance of points `(k, 3)` from the disc or the ball, shape `(k,)` [m]."""
        x, y, z = self.axes @ (points - self.centre).T
        if self.kind == "ball":
            return np.maximum(np.sqrt(x**2 + y**2 + z**2) - self.radius, 0.0)
        return np.hypot(np.maximum(np.hypot(x, y) - self.radius, 0.0), z)


def unbounded(site: Footprint, E: float, nu: float) -> Array:
    """The site's compliance in the unbounded body, shape `(9, 9)`; infinite where a couple has no limit."""
    of = {"disc": disc_compliance, "half ball": half_ball_compliance, "ball": ball_compliance}
    twelve = of[site.kind](site.weight, nu)
    finite = scaled(np.where(np.isinf(twelve), 0.0, twelve), site.radius, E)
    C = site.frame @ site.turn @ finite @ site.turn.T @ site.frame.T
    if is_endless(site):
        C[3:] = C[:, 3:] = np.inf
    return np.asarray(C)


def is_endless(site: Footprint) -> bool:
    """Whether the site's couples have no limit: those of a disc whose weight does not fall to zero at its rim."""
    return site.kind == "disc" and bool(np.isinf(DISC[site.weight]).any())


def moduli(body: Elasticity, touched: NDArray[np.bool_]) -> tuple[float, float]:
    """E [Pa] and ν at the site: their means over the cells that the footprint touches."""
    cells, material = np.all(touched[body.cells], axis=1), body.material
    E, nu = (np.broadcast_to(m, cells.shape) for m in (material.youngs_modulus, material.poisson_ratio))
    return mean(E[cells]), mean(nu[cells])


def mean(values: Array) -> float:
    """The mean, which is the value itself where all are equal: what is known of one ν is not worked out twice."""
    return float(values[0] + (values - values[0]).mean())


def answer(body: Elasticity, site: Footprint, rows: csr_matrix, inner: Indices, modulus: tuple[float, float]) -> Array:
    """What the mesh makes of the unbounded body's field around the site: Y u_mesh under unit forces, shape `(9, 9)`.

    The field is prescribed wherever the equations of the `inner` unknowns reach beyond them.
    """
    (E, nu), K = modulus, body.K[inner]
    rim = np.setdiff1d(np.union1d(K.indices, rows.indices), inner)
    nodes, U = np.flatnonzero(np.isin(body.nodes, rim).any(axis=1)), np.zeros((body.N, 9))
    U[body.nodes[nodes]] = field(site, body.points[nodes], nu) / E
    factor = solver_once(csr_matrix(K[:, inner]), body.basis.doflocs[:, inner].T)
    # What rough columns leave, 1e-8 of each, is far below what the closed form itself knows of a hole.
    U[inner] = factor.solve(rows[:, inner].T.toarray() - K[:, rim] @ U[rim], rough=True)
    return np.asarray(rows @ U)


def foreign(body: Elasticity, surface: Surface, site: Footprint) -> Indices:
    """Nodes on surfaces that the unbounded body does not have."""
    facets = body.mesh.boundary_facets()
    if site.kind != "ball":
        normal = site.axes[2]
        offset = surface.triangles.mean(axis=1) - site.centre
        level = np.abs(offset @ normal) <= np.sqrt(1.0 - FACING**2) * np.linalg.norm(offset, axis=1) + site.radius
        facets = facets[~((surface.normals @ normal > FACING) & level)]
    return np.unique(body.facet_nodes(body.mesh.facets[:, facets].T))


def field(site: Footprint, points: Array, nu: float) -> Array:
    """Displacement around the site in the unbounded body of E = 1 by unit forces on its variables, `(k, 3, 9)`."""
    offset = (points - site.centre) @ site.axes.T
    twelve = (ball_field if site.kind == "ball" else surface_field)(site, offset, nu)
    return np.asarray(np.einsum("ai,kab,cb->kic", site.axes, twelve, site.frame @ site.turn))


def surface_field(site: Footprint, offset: Array, nu: float) -> Array:
    """Of the twelve averages over a disc, `(k, 3, 12)`, slopes along z by the lack of traction on the surface.

    As a function of the place of the force, the field is a solution without traction itself: ∂_z u_x = −∂_x u_z and
    ∂_z u_z = −ν/(1−ν) (∂_x u_x + ∂_y u_y).
    """
    value, slope = footprint.disc(site.weight), footprint.disc_slope("parabolic")
    out = np.empty((len(offset), 3, 3, 4))
    out[..., 0] = summed(surface_force, offset, site.radius * value.points, value.weights[:, None], nu)[..., 0]
    vectors = slope.vectors[:, :2] / site.radius
    out[..., 1:3] = summed(surface_force, offset, site.radius * slope.points, vectors, nu)
    out[:, :, 0, 3], out[:, :, 1, 3] = -out[:, :, 2, 1], -out[:, :, 2, 2]
    out[:, :, 2, 3] = -nu / (1.0 - nu) * (out[:, :, 0, 1] + out[:, :, 1, 2])
    return np.concatenate([out[..., 0], out[..., 1:].reshape(-1, 3, 9)], axis=2)


def ball_field(site: Footprint, offset: Array, nu: float) -> Array:
    """Of the twelve averages over a ball, `(k, 3, 12)`.

    Outside, a weight that depends on the radius alone acts like a point and its second moment, ∇⁴u being zero; six
    points on the axes with the same moment do so but for (a/r)⁴.
    """
    axes = site.radius * np.sqrt({"uniform": 3.0 / 5.0, "parabolic": 3.0 / 7.0}[site.weight]) * np.eye(3)
    places, slopes = np.vstack([axes, -axes]), np.vstack([axes, -axes]) / (2.0 * axes[0, 0] ** 2)
    out = summed(kelvin, offset, places, np.column_stack([np.full(6, 1.0 / 6.0), slopes]), nu)
    return np.concatenate([out[..., 0], out[..., 1:].reshape(-1, 3, 9)], axis=2)


def summed(kernel, offset: Array, places: Array, weights: Array, nu: float) -> Array:  # type: ignore[no-untyped-def]
    """Σ_q kernel(offset − places_q) weights_q, shape `(k, 3, 3, w)`."""
    step = max(1, BLOCK // len(places))
    parts = [
        np.moveaxis(np.moveaxis(kernel(offset[i : i + step, None] - places, nu), (-2, -1), (0, 1)) @ weights, 2, 0)
        for i in range(0, len(offset), step)
    ]
    return np.concatenate(parts) if parts else np.zeros((0, 3, 3, weights.shape[1]))
