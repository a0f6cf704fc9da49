"""Two footprints drawn together on a block of stiffening tissue, by a solver of its own on a quarter of the block.

P2 cells on lines of its own, held in two planes of symmetry; the force of half a disc over the reference surface,
summed over small triangles; total Lagrangian, nothing averaged, its own stress, tangent, assembly and Newton's method.
Of the library there is the factorisation alone. `python -m tests.tissue.quarter` prints the ways on finer meshes than
the test takes, and where they tend to.
"""

from collections.abc import Sequence
from functools import cached_property, partial

import numpy as np
import skfem
from scipy.optimize import brentq
from scipy.sparse import csr_matrix, diags
from skfem.quadrature import get_quadrature

from tissue.arrays import Array, Indices
from tissue.errors import FactorError
from tissue.solvers.direct import LIBRARIES, Pattern, is_installed
from tissue.solvers.factor import factorize

E, NU, B = 1e5, 0.45, 5.0  # Pa, -, -
MU, KAPPA = E / (2.0 * (1.0 + NU)), E / (3.0 * (1.0 - 2.0 * NU))
RADIUS, PLACE = 2e-3, 5e-3  # of a disc, and its way from the middle [m]
X = np.array([0.0, 2.5e-3, 5e-3, 7.5e-3, 12e-3])  # of the coarsest cells [m]; the disc is around the third
Y, Z = np.array([0.0, 2.5e-3, 6e-3]), np.array([-8e-3, -5.5e-3, -2.5e-3, 0.0])
SCALED = (0.3, 1.0, 2.0)  # τ = T/(E a²)
PARTS = (2, 3, 4)  # that the edges of the coarsest cells are cut into
STEP = 0.75  # of τ
SOLVED = 1e-9  # of the largest nodal load
CORRECTIONS = 60
FIRMER = 0.0, 0.02, 0.1, 0.5, 2.0  # of its diagonal: what is added to a tangent until it is definite
NODES = 10  # of a cell
TRIANGLES = 4  # halvings of a facet's edges for the force of the disc, which ends within facets


def stress_and_tangent(F: Array) -> tuple[Array, Array]:
    """Return P `(3, 3, …)` and ∂P/∂F `(3, 3, 3, 3, …)` by formulas of its own, in F⁻ᵀ: nothing is shared with the
    densities."""
    J, G = np.linalg.det(F.transpose(2, 3, 0, 1)), np.linalg.inv(F.transpose(2, 3, 1, 0)).transpose(2, 3, 0, 1)
    square, grown = np.sum(F**2, axis=(0, 1)), J ** (-2.0 / 3.0)
    g = 2.0 * grown * (F - square / 3.0 * G)
    slope = 0.5 * MU * np.exp(B * (grown * square - 3.0))
    P = slope * g + KAPPA * (J - 1.0) * J * G
    one = np.einsum("ik,jl->ijkl", np.eye(3), np.eye(3))[..., None, None]
    turned = np.einsum("il...,kj...->ijkl...", G, G)  # −∂G_ij/∂F_kl
    outer = partial(np.einsum, "ij...,kl...->ijkl...")
    bent = -2.0 / 3.0 * outer(g, G) + 2.0 * grown * (one - 2.0 / 3.0 * outer(G, F) + square / 3.0 * turned)
    swollen = KAPPA * ((2.0 * J - 1.0) * J * outer(G, G) - (J - 1.0) * J * turned)
    return P, B * slope * outer(g, g) + slope * bent + swollen


def cut(lines: Array, parts: int) -> Array:
    """Return lines with each interval between them cut into equal parts."""
    at = np.linspace(0.0, len(lines) - 1.0, parts * (len(lines) - 1) + 1)
    return np.asarray(np.interp(at, np.arange(len(lines)), lines))


def small_triangles() -> tuple[Array, Array]:
    """Return points `(2, q)` and weights `(q,)` on the reference triangle, of degree 4 on each of its small ones."""
    places, weights = get_quadrature(skfem.refdom.RefTri, 4)
    corners = np.array([[[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]])
    for _ in range(TRIANGLES):
        a, b, c = corners.transpose(1, 0, 2)
        ab, bc, ca = 0.5 * (a + b), 0.5 * (b + c), 0.5 * (c + a)
        corners = np.concatenate([np.stack(each, 1) for each in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))])
    shares = np.array([1.0 - places.sum(axis=0), *places])
    points = np.einsum("kq,tkd->dtq", shares, corners).reshape(2, -1)
    return points, np.tile(weights, len(corners)) / len(corners)


class Quarter:
    """A quarter of the block, on cells of an edge that is the coarsest ones' over `parts`."""

    def __init__(self, parts: int) -> None:
        self.parts = parts

    @cached_property
    def mesh(self) -> skfem.MeshTet:
        """The cells; the top is at z = 0."""
        return skfem.MeshTet.init_tensor(*(cut(lines, self.parts) for lines in (X, Y, Z)))

    @cached_property
    def basis(self) -> skfem.Basis:
        """One of a component."""
        return skfem.Basis(self.mesh, skfem.ElementTetP2(), intorder=2)

    @cached_property
    def slopes(self) -> Array:
        """Gradients of the shape functions, `(cells, points, NODES, 3)` [1/m]."""
        return np.ascontiguousarray(np.array([shape[0].grad for shape in self.basis.basis]).transpose(2, 3, 0, 1))

    @cached_property
    def unknowns(self) -> Indices:
        """Of each cell, node by node, `(cells, 3 NODES)`."""
        return np.asarray((3 * self.basis.element_dofs.T[:, :, None] + np.arange(3)).reshape(-1, 3 * NODES))

    @cached_property
    def free(self) -> Indices:
        """Unknowns that neither the bottom nor a plane of symmetry holds."""
        x, held = self.basis.doflocs, np.zeros((self.basis.N, 3), dtype=bool)
        held[np.isclose(x[2], Z[0])] = True
        held[np.isclose(x[0], 0.0), 0] = held[np.isclose(x[1], 0.0), 1] = True
        return np.flatnonzero(~held)

    @cached_property
    def mean(self) -> Array:
        """Row by which the disc's mean displacement is taken of that of the nodes, `(nodes,)`: weights 1 − r²/a²."""
        top = self.mesh.facets_satisfying(lambda x: np.isclose(x[2], 0.0), boundaries_only=True)
        facets = skfem.FacetBasis(self.mesh, skfem.ElementTetP2(), facets=top, quadrature=small_triangles())
        x, row = np.asarray(facets.global_coordinates()), np.zeros(self.basis.N)
        weights = np.maximum(0.0, 1.0 - ((x[0] - PLACE) ** 2 + x[1] ** 2) / RADIUS**2) * facets.dx
        for dofs, shape in zip(facets.element_dofs, facets.basis, strict=True):
            np.add.at(row, dofs, (np.asarray(shape[0]) * weights).sum(axis=1))
        return row / weights.sum()

    def gradient(self, U: Array) -> Array:
        """Return F at the points of the cells, `(3, 3, cells, points)`."""
        local = U[self.unknowns].reshape(-1, NODES, 3)
        return np.einsum("eai,eqaj->ijeq", local, self.slopes, optimize=True) + np.eye(3)[:, :, None, None]

    def potential(self, U: Array, load: Array) -> float:
        """Return the stored energy less what dead loads `(N,)` [N] have done [J]; inf where a cell is inverted."""
        F = self.gradient(U)
        J = np.linalg.det(F.transpose(2, 3, 0, 1))
        if not J.min() > 0.0:
            return np.inf
        strained = np.minimum(B * (J ** (-2.0 / 3.0) * np.sum(F**2, axis=(0, 1)) - 3.0), 500.0)
        stored = 0.5 * MU / B * np.expm1(strained) + 0.5 * KAPPA * (J - 1.0) ** 2
        return float(np.sum(stored * self.basis.dx) - load @ U)

    @cached_property
    def entries(self) -> tuple[Array, Indices, Indices]:
        """Which entries of the cells' tangents are of free unknowns, and their rows and columns."""
        number = np.full(3 * self.basis.N, -1)
        number[self.free] = np.arange(self.free.size)
        local = number[self.unknowns]
        shape = *local.shape, local.shape[1]
        rows, columns = (np.broadcast_to(each, shape).ravel() for each in (local[:, :, None], local[:, None]))
        kept = (rows >= 0) & (columns >= 0)
        return kept, rows[kept], columns[kept]

    def stiffness(self, A: Array) -> csr_matrix:
        """Return ∂²energy/∂U² over the free unknowns [N/m] from ∂P/∂F."""
        half = (A * self.basis.dx).transpose(4, 5, 0, 2, 1, 3) @ self.slopes.transpose(0, 1, 3, 2)[:, :, None, None]
        blocks = (self.slopes[:, :, None, None] @ half).sum(axis=1).transpose(0, 3, 1, 4, 2)
        kept, rows, columns = self.entries
        K = csr_matrix((blocks.ravel()[kept], (rows, columns)), shape=(self.free.size,) * 2)
        return csr_matrix(0.5 * (K + K.T))

    @cached_property
    def places(self) -> Array:
        """Of the free unknowns, `(n, 3)` [m]."""
        return np.repeat(self.basis.doflocs.T, 3, axis=0)[self.free]

    def correction(self, A: Array, r: Array, pattern: Pattern) -> Array:
        """Return Newton's correction of the free unknowns [m] for a residual [N], shorter where the tangent is not
        definite."""
        K = self.stiffness(A)
        solve = partial(factorize, places=self.places, method=next(filter(is_installed, LIBRARIES)), pattern=pattern)
        solve = partial(solve, one_of_many=True)
        for firmer in FIRMER:
            try:
                return -solve(csr_matrix(K + diags(firmer * K.diagonal()))).solve(r)
            except FactorError:
                continue
        raise AssertionError("the tangent is far from definite")

    def settled(self, U: Array, load: Array, pattern: Pattern) -> Array:
        """Return the equilibrium under dead loads `(N,)` [N] that is near U."""
        for _ in range(CORRECTIONS):
            P, A = stress_and_tangent(self.gradient(U))
            local = np.einsum("eqaj,ijeq,eq->eai", self.slopes, P, self.basis.dx, optimize=True)
            r = np.bincount(self.unknowns.ravel(), local.ravel(), U.size) - load
            if np.abs(r[self.free]).max() <= SOLVED * np.abs(load).max():
                return U
            way, first, share = np.zeros_like(U), self.potential(U, load), 1.0
            way[self.free] = self.correction(A, r[self.free], pattern)
            while self.potential(U + share * way, load) > first + 1e-10 * abs(first):
                share *= 0.5
            U = U + share * way
        raise AssertionError(f"no equilibrium in {CORRECTIONS} corrections")

    def ways(self, scaled: Sequence[float]) -> Array:
        """Return how far the disc has moved to the other one under every tension, over its radius."""
        U, last, out, pattern = np.zeros(3 * self.basis.N), 0.0, [], Pattern()
        for tension in scaled:
            for part in np.linspace(last, tension, int(np.ceil((tension - last) / STEP - 1e-9)) + 1)[1:]:
                pull = -0.5 * part * E * RADIUS**2 * self.mean  # half a disc
                U = self.settled(U, np.stack([pull, 0.0 * pull, 0.0 * pull], axis=1).ravel(), pattern)
            out.append(-float(self.mean @ U[::3]) / RADIUS)
            last = tension
        return np.array(out)


def limit(parts: Sequence[int], found: Array) -> tuple[float, float]:
    """Return where numbers on three meshes, the coarsest first, tend to, and with which order."""
    a, b, c = (1.0 / number for number in parts)

    def off(order: float) -> float:
        return float((found[0] - found[1]) * (b**order - c**order) - (found[1] - found[2]) * (a**order - b**order))

    order = brentq(off, 0.5, 8.0)
    return float(found[2] - (found[1] - found[2]) * c**order / (b**order - c**order)), order


def main() -> None:
    """Print the ways on every mesh, and where they tend to."""
    found = np.array([Quarter(parts).ways(SCALED) for parts in PARTS])
    for tension, ways in zip(SCALED, found.T, strict=True):
        end, order = limit(PARTS, ways)
        print(f"τ = {tension:g}: {', '.join(f'{way:.5f}' for way in ways)} tend to {end:.5f}, with order {order:.2f}")


if __name__ == "__main__":
    main()
