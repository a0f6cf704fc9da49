"""Loads on boundaries of the organ, as nodal forces: tractions that keep their direction, and pressures.

    f_a = ∫ φ_a t dA                    a traction t [Pa], per area of the reference shape
    f_a = −∫ φ_a p (x_ξ × x_η) dξ dη    a pressure p [Pa] on a surface whose nodes are at x, x_ξ × x_η outward

The pressure's forces are those on the surface as it lies: at the reference places they are what a linear organ bears,
at the displaced ones those of a pressure that follows. Either is exact: tractions of a P2 facet are of degree 2,
pressures on a curved one of degree 4.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from skfem import ElementTriP1, ElementTriP2
from skfem.quadrature import get_quadrature

from tissue.arrays import Array, Indices
from tissue.elasticity import Elasticity
from tissue.errors import TissueError
from tissue.supports import facets_of

TRIANGLES = {"P1": ElementTriP1, "P2": ElementTriP2}
DEGREE = {"P1": 1, "P2": 4}  # of φ_a (x_ξ × x_η) on a facet


@dataclass(frozen=True)
class SurfaceLoad:
    """A force per area on the boundary of that name: a `traction` (3,) [Pa] per reference area, or a `pressure` [Pa],
    positive where it pushes on the organ. It grows linearly from zero within `ramp` [s].

    Raises `TissueError` unless one of the two is given, finite, and ramp ≥ 0.
    """

    boundary: str
    traction: tuple[float, float, float] | None = None
    pressure: float | None = None
    ramp: float = 0.0

    def __post_init__(self) -> None:
        if (self.traction is None) == (self.pressure is None):
            raise TissueError(f"load on {self.boundary!r}: allowed are a traction or a pressure; give one of them")
        given = np.asarray(self.pressure if self.traction is None else self.traction, dtype=float)
        if given.shape not in {(), (3,)} or not np.all(np.isfinite(given)) or not 0.0 <= self.ramp < np.inf:
            raise TissueError(
                f"load on {self.boundary!r}: {given} Pa, ramp {self.ramp} s; allowed are three finite numbers of a "
                "traction or one of a pressure, and ramp ≥ 0"
            )

    def share(self, time: float) -> float:
        """Return the part of the load that acts at a time [s], from 0 to 1."""
        return 1.0 if time >= self.ramp else time / self.ramp


@dataclass(frozen=True)
class Facets:
    """Facets of a body: their `nodes` `(f, 3)`, or `(f, 6)` with P2, so ordered that x_ξ × x_η points outward."""

    element: str
    nodes: Indices

    @cached_property
    def rule(self) -> tuple[Array, Array, Array]:
        """Shape functions `(n, g)`, their slopes by ξ and η `(2, n, g)`, and weights `(g,)` at Gauss points."""
        triangle = TRIANGLES[self.element]()
        at, weights = get_quadrature(triangle, DEGREE[self.element])
        each = [triangle.lbasis(at, n) for n in range(self.nodes.shape[1])]
        shapes = np.array([np.broadcast_to(value, weights.shape) for value, _ in each])
        slopes = np.array([np.broadcast_to(np.reshape(slope, (2, -1)), (2, weights.size)) for _, slope in each])
        return shapes, slopes.swapaxes(0, 1), np.asarray(weights)

    def area_vectors(self, x: Array) -> Array:
        """Return x_ξ × x_η at the Gauss points of a surface whose body has its nodes at `x` (m, 3), `(f, g, 3)`
        [m²]."""
        along = np.einsum("kng,fni->kfgi", self.rule[1], x[self.nodes])
        return np.cross(along[0], along[1])

    def nodal_forces(self, density: Array, count: int) -> Array:
        """Return ∫ φ_a t dξ dη for `density` t `(f, g, 3)` [N] at the `count` nodes of the body, `(count, 3)` [N]."""
        shapes, _, weights = self.rule
        each = np.einsum("ng,g,fgi->fni", shapes, weights, density).reshape(-1, 3)
        spread = [np.bincount(self.nodes.ravel(), component, minlength=count) for component in each.T]
        return np.column_stack(spread)


def build_facets(body: Elasticity, name: str) -> Facets:
    """Return the facets of the boundary of that name. Raises `TissueError` where the mesh names none such, and
    for one inside the body."""
    mesh, facets = body.mesh, facets_of(body.mesh, "load", name)
    if np.any(mesh.f2t[1, facets] >= 0):
        raise TissueError(f"load: the boundary {name!r} lies inside the organ in part; name one on its surface")
    corners = mesh.facets[:, facets].T.astype(np.intp)
    opposite = mesh.t[:, mesh.f2t[0, facets]].sum(axis=0) - corners.sum(axis=1)
    a, b, c, d = (mesh.p.T[node] for node in (*corners.T, opposite))
    inward = np.sum(np.cross(b - a, c - a) * (d - a), axis=1) > 0.0
    corners[inward] = corners[inward][:, [0, 2, 1]]
    return Facets(body.element, body.facet_nodes(corners))


@dataclass(frozen=True)
class Loads:
    """The loads `each` on a body."""

    body: Elasticity
    each: tuple[SurfaceLoad, ...] = ()

    @cached_property
    def facets(self) -> tuple[Facets, ...]:
        """Facets of the boundary of each load."""
        return tuple(build_facets(self.body, load.boundary) for load in self.each)

    def shares(self, time: float, share: float = 1.0) -> Array:
        """Return the part of each load that acts at `time` [s], times `share`, `(k,)`."""
        return share * np.array([load.share(time) for load in self.each])

    def forces(self, number: int, x: Array) -> Array:
        """Return the nodal forces of the whole load of that number on a body whose nodes are at `x` (m, 3), `(m, 3)`
        [N]; those of a traction are the same at any."""
        load, facets = self.each[number], self.facets[number]
        if load.pressure is not None:
            return facets.nodal_forces(-load.pressure * facets.area_vectors(x), len(x))
        area = np.linalg.norm(facets.area_vectors(self.body.points), axis=2)
        return facets.nodal_forces(area[..., None] * np.asarray(load.traction, dtype=float), len(x))

    @cached_property
    def columns(self) -> Array:
        """Forces of each whole load in the reference shape over all unknowns of the body, `(N, k)` [N]."""
        each = [self.body.flat(self.forces(number, self.body.points)) for number in range(len(self.each))]
        return np.array(each).reshape(-1, self.body.N).T

    @cached_property
    def resultants(self) -> Array:
        """Sum of the forces of each whole load, `(k, 3)` [N]."""
        each = [self.forces(number, self.body.points).sum(axis=0) for number in range(len(self.each))]
        return np.array(each).reshape(-1, 3)

    @cached_property
    def areas(self) -> Array:
        """Area of the boundary of each load in the reference shape, `(k,)` [m²]."""
        sizes = [np.linalg.norm(facets.area_vectors(self.body.points), axis=2) for facets in self.facets]
        return np.array([float((size @ facets.rule[2]).sum()) for size, facets in zip(sizes, self.facets, strict=True)])

    def turns(self, displacement: Array) -> Array:
        """Return the largest angle by which a displacement (m, 3) [m] turns the outward normal of the boundary of each
        pressure, `(k,)` [rad]; 0 for a traction."""
        x = self.body.points
        pairs = [(facets.area_vectors(x), facets.area_vectors(x + displacement)) for facets in self.facets]
        turns = [float(angles(*pair).max(initial=0.0)) for pair in pairs]
        return np.array([0.0 if load.pressure is None else turn for load, turn in zip(self.each, turns, strict=True)])


def angles(a: Array, b: Array) -> Array:
    """Return the angles between vectors along the last axis [rad]."""
    return np.arctan2(np.linalg.norm(np.cross(a, b), axis=-1), np.sum(a * b, axis=-1))
