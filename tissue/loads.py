"""Loads on boundaries of the organ, as nodal forces: tractions that keep their direction, and
pressures.

    f_a = ∫ φ_a t dA                    a traction t [Pa], per area of the reference shape
    f_a = −∫ φ_a p (x_ξ × x_η) dξ dη    a pressure p [Pa] on a surface whose nodes are at x, x_ξ × x_η outward

The forces of a pressure act on the surface through the nodes at x. A linear organ uses the
reference positions. A follower pressure uses the displaced positions. Both are integrated exactly:
tractions of a P2 facet have degree 2, pressures on a curved facet degree 4.

A follower pressure has a potential, the volume behind its surface, if the surface is closed or its
rim is held. Only then is its tangent symmetric (Bufler, Comput. Methods Appl. Mech. Eng. 45, 1984).
In other cases the code uses the symmetric part of the tangent.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.sparse import coo_matrix, csr_matrix
from skfem import ElementTriP1, ElementTriP2
from skfem.quadrature import get_quadrature

from tissue.arrays import Array, Indices
from tissue.elasticity import Elasticity
from tissue.errors import TissueError
from tissue.shapes import shapes
from tissue.supports import outer_facets_of

TRIANGLES = {"P1": ElementTriP1, "P2": ElementTriP2}
DEGREE = {"P1": 1, "P2": 4}  # degree of φ_a (x_ξ × x_η) on a facet
PERMUTATION = np.array([np.cross(np.eye(3)[i], np.eye(3)) for i in range(3)])  # a × b has the components a_i P_ijk b_j


@dataclass(frozen=True)
class SurfaceLoad:
    """A force per area on a named boundary: a `traction` (3,) [Pa] per reference area, or a
    `pressure` [Pa].

    A positive pressure pushes on the organ. The `course` of the load has rows of time [s] and
    factor [-], and is linear in between. None means that the whole load acts at all times; in
    statics it then grows with the load steps. Raises `TissueError` unless exactly one of traction
    and pressure is given, both are finite, and the times of the course increase.
    """

    boundary: str
    traction: tuple[float, float, float] | None = None
    pressure: float | None = None
    course: tuple[tuple[float, float], ...] | None = None

    def __post_init__(self) -> None:
        if (self.traction is None) == (self.pressure is None):
            raise TissueError(
                f"load on {self.boundary!r}: allowed is either a traction or a pressure; give one of them"
            )
        given = np.asarray(self.pressure if self.traction is None else self.traction, dtype=float)
        if given.shape not in {(), (3,)} or not np.all(np.isfinite(given)):
            raise TissueError(f"load on {self.boundary!r}: {given} Pa; allowed are finite numbers, three or one")
        if self.course is not None and not (np.all(np.isfinite(self._rows)) and np.all(np.diff(self._rows[0]) > 0.0)):
            raise TissueError(f"load on {self.boundary!r}: the times of its course do not rise; sort them")

    @cached_property
    def _rows(self) -> Array:
        """Times and factors of the course, shape `(2, k)`."""
        return np.array(self.course, dtype=float).T

    def factor(self, time: float, share: float = 1.0) -> float:
        """Return the part of the load that acts at `time` [s], or at a `share` of the load steps in
        statics.

        In statics the load steps end at `time`.
        """
        if self.course is None:
            return share
        # In an equilibrium at the start, `time` is 0 and only `share` grows.
        return (1.0 if time > 0.0 else share) * float(np.interp(share * time, *self._rows))


@dataclass(frozen=True)
class Facets:
    """Facets of a body with their `nodes` `(f, 3)`, or `(f, 6)` with P2.

    The order of the nodes is such that x_ξ × x_η points outward.
    """

    element: str
    nodes: Indices

    @cached_property
    def rule(self) -> tuple[Array, Array, Array]:
        """Shape functions `(n, g)`, their derivatives with respect to ξ and η `(2, n, g)`, and
        weights `(g,)` at Gauss points.
        """
        triangle = TRIANGLES[self.element]()
        at, weights = get_quadrature(triangle, DEGREE[self.element])
        phi, slopes = shapes(triangle, at.T)
        return phi, slopes.swapaxes(0, 1), np.asarray(weights)

    def area_vectors(self, x: Array) -> Array:
        """Return x_ξ × x_η at the Gauss points of the facets, `(f, g, 3)` [m²].

        The body's nodes are at `x` (m, 3).
        """
        along = self._along(x)
        return np.cross(along[0], along[1])

    def _along(self, x: Array) -> Array:
        """Return x_ξ and x_η at the Gauss points, shape `(2, f, g, 3)` [m]."""
        return np.asarray(np.einsum("kng,fni->kfgi", self.rule[1], x[self.nodes]))

    def turning(self, x: Array) -> Array:
        """Return the derivative of ∫ φ_a (x_ξ × x_η) dξ dη with respect to the node positions,
        shape `(f, n, 3, n, 3)` [m].

        The integrand changes by φ_b,ξ e_j × x_η − φ_b,η e_j × x_ξ.
        """
        (phi, slopes, weights), (x_xi, x_eta) = self.rule, self._along(x)
        sides = np.einsum("bg,jki,fgk->fgbij", slopes[0], PERMUTATION, x_eta)
        sides -= np.einsum("bg,jki,fgk->fgbij", slopes[1], PERMUTATION, x_xi)
        return np.asarray(np.einsum("g,ag,fgbij->faibj", weights, phi, sides))

    def nodal_forces(self, density: Array, count: int) -> Array:
        """Return ∫ φ_a t dξ dη for `density` t `(f, g, 3)` [N] at the `count` nodes of the body,
        `(count, 3)` [N].
        """
        phi, _, weights = self.rule
        each = np.einsum("ng,g,fgi->fni", phi, weights, density).reshape(-1, 3)
        spread = [np.bincount(self.nodes.ravel(), component, minlength=count) for component in each.T]
        return np.column_stack(spread)


def build_facets(body: Elasticity, name: str) -> Facets:
    """Return the facets of the boundary `name`.

    Raises `TissueError` if the mesh has no boundary of this name, or if the boundary lies inside
    the body.
    """
    return Facets(body.element, body.surface_nodes(outer_facets_of(body.mesh, "load", name), inwards=False))


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
        """Return the part of each load that acts at `time` [s], or at a `share` of the load steps
        in statics, `(k,)`.

        In statics the load steps end at `time`.
        """
        return np.array([load.factor(time, share) for load in self.each])

    def are_steady(self, shares: Array | None, times: Sequence[float]) -> bool:
        """Return whether the same parts `shares` (k,) of the loads act at all `times` [s].

        `shares` None means that there are no loads.
        """
        return shares is None or all((self.shares(time) == shares).all() for time in times)

    def forces(self, number: int, x: Array) -> Array:
        """Return the nodal forces of one whole load, `(m, 3)` [N].

        The body's nodes are at `x` (m, 3). The forces of a traction do not depend on `x`.
        """
        load, facets = self.each[number], self.facets[number]
        if load.pressure is not None:
            return facets.nodal_forces(-load.pressure * facets.area_vectors(x), len(x))
        area = np.linalg.norm(facets.area_vectors(self.body.points), axis=2)
        return facets.nodal_forces(area[..., None] * np.asarray(load.traction, dtype=float), len(x))

    @cached_property
    def columns(self) -> Array:
        """Forces of each whole load in the reference shape over all unknowns of the body, `(N, k)`
        [N].
        """
        each = [self.body.flat(self.forces(number, self.body.points)) for number in range(len(self.each))]
        return np.array(each).reshape(-1, self.body.N).T

    @cached_property
    def resultants(self) -> Array:
        """Sum of the forces of each whole load on the reference shape, `(k, 3)` [N]."""
        return self.resultants_at(self.body.points)

    def resultants_at(self, x: Array) -> Array:
        """Return the sum of the forces of each whole load, `(k, 3)` [N].

        The body's nodes are at `x` (m, 3).
        """
        each = [self.forces(number, x).sum(axis=0) for number in range(len(self.each))]
        return np.array(each).reshape(-1, 3)

    @cached_property
    def follows(self) -> bool:
        """Whether a load is a pressure, which follows its surface."""
        return any(load.pressure is not None for load in self.each)

    def _pressures(self, shares: Array | None) -> list[tuple[float, Facets]]:
        """Return each acting pressure [Pa] and its facets; an empty list if `shares` is None."""
        parts = zip(self.each, np.zeros(len(self.each)) if shares is None else shares, self.facets, strict=True)
        return [(share * load.pressure, on) for load, share, on in parts if load.pressure is not None and share]

    def pressing(self, shares: Array | None, x: Array) -> Array:
        """Return the forces of the parts `shares` `(k,)` of the pressures over all unknowns, `(N,)`
        [N].

        The body's nodes are at `x` (m, 3). `shares` None means no pressure.
        """
        each = [on.nodal_forces(-p * on.area_vectors(x), len(x)) for p, on in self._pressures(shares)]
        return self.body.flat(sum(each, np.zeros_like(x)))

    def pressing_tangent(self, shares: Array | None, x: Array) -> csr_matrix:
        """Return the symmetric part of the derivative of the forces of `pressing` with respect to
        the displacement, shape `(N, N)` [N/m].
        """
        out = csr_matrix((self.body.N, self.body.N))
        for p, on in self._pressures(shares):
            unknowns, n = self.body.nodes[on.nodes].reshape(len(on.nodes), -1), 3 * on.nodes.shape[1]
            blocks = -p * on.turning(x).reshape(-1, n, n)
            rows, columns = np.repeat(unknowns, n, axis=1), np.tile(unknowns, (1, n))
            half = coo_matrix((0.5 * blocks.ravel(), (rows.ravel(), columns.ravel())), shape=out.shape)
            out = csr_matrix(out + half + half.T)
        return out

    @cached_property
    def areas(self) -> Array:
        """Area of the boundary of each load in the reference shape, `(k,)` [m²]."""
        sizes = [np.linalg.norm(facets.area_vectors(self.body.points), axis=2) for facets in self.facets]
        return np.array([float((size @ facets.rule[2]).sum()) for size, facets in zip(sizes, self.facets, strict=True)])

    def turns(self, displacement: Array) -> Array:
        """Return the largest angle by which a displacement (m, 3) [m] turns the outward normal of
        the boundary of each pressure, `(k,)` [rad].

        The angle is 0 for a traction.
        """
        x = self.body.points
        pairs = [(facets.area_vectors(x), facets.area_vectors(x + displacement)) for facets in self.facets]
        turns = [float(angles(*pair).max(initial=0.0)) for pair in pairs]
        return np.array([0.0 if load.pressure is None else turn for load, turn in zip(self.each, turns, strict=True)])


def angles(a: Array, b: Array) -> Array:
    """Return the angles between vectors along the last axis [rad]."""
    return np.arctan2(np.linalg.norm(np.cross(a, b), axis=-1), np.sum(a * b, axis=-1))
