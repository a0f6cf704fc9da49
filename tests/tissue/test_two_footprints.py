"""Two footprints drawn together far beyond small strain, against a finite-strain solver of its own."""

from functools import cache, partial

import numpy as np
import pytest
import skfem
from scipy.sparse import csc_matrix
from scipy.sparse.linalg import splu

import tissue
from coupling.integrators import Equilibrium
from tests.bounds import TWO_SOLVERS
from tissue.arrays import Array
from tissue.materials.isotropic import Exponential
from tissue.organs.finite import FiniteAnswer

E, RADIUS, B = 1e5, 2e-3, 5.0
SCALED = (0.3, 1.0, 5.0)  # τ = T/(E a²)
PLACES = ((-0.005, 0.0, 0.0), (0.005, 0.0, 0.0))
NONE = np.zeros(0)


@cache
def block(nu: float) -> tissue.Elasticity:
    """A block of P2 cells with its top at z = 0, held below."""
    lines = np.linspace(-0.012, 0.012, 9), np.linspace(-0.006, 0.006, 5), np.linspace(-0.008, 0.0, 4)
    mesh = skfem.MeshTet.init_tensor(*lines).with_boundaries({"bottom": lambda x: x[2] < -0.008 + 1e-9})
    return tissue.elasticity(mesh, tissue.Material(E, nu, 1070.0), "P2", ["bottom"])


def pulls() -> Array:
    """Forces on the sites under unit tension, towards one another, shape `(18,)`."""
    f = np.zeros(18)
    f[0], f[9] = 1.0, -1.0
    return f


@cache
def ways(nu: float) -> tuple[float, ...]:
    """How far the first footprint moves towards the other under every tension, by the organ [m]."""
    body, out = block(nu), []
    hyper = tissue.Hyperelasticity(body, Exponential(body.material.lame_mu, B))
    sites = tissue.build_sites(body, [tissue.Site(place, RADIUS) for place in PLACES])
    organ = tissue.FiniteOrgan(body, sites, hyper=hyper, inertia=False)
    state = organ.start()
    for tension in SCALED:
        f = tension * E * RADIUS**2 * pulls()
        answer: FiniteAnswer = organ.answer(Equilibrium(), [state])
        while (after := answer.again(f, NONE)) is not answer:
            answer = after
        state = answer.accept(f)
        out.append(float(organ.site_variables(state)[0] - organ.y0[0]))
    return tuple(out)


def stress_and_tangent(mu: float, kappa: float, F: Array) -> tuple[Array, Array]:
    """Return P `(3, 3, …)` and ∂P/∂F `(3, 3, 3, 3, …)` by formulas of its own, in F⁻ᵀ: nothing is shared with the
    densities."""
    J, G = np.linalg.det(F.transpose(2, 3, 0, 1)), np.linalg.inv(F.transpose(2, 3, 1, 0)).transpose(2, 3, 0, 1)
    square, grown = np.sum(F**2, axis=(0, 1)), J ** (-2.0 / 3.0)
    g = 2.0 * grown * (F - square / 3.0 * G)
    slope = 0.5 * mu * np.exp(B * (grown * square - 3.0))
    P = slope * g + kappa * (J - 1.0) * J * G
    one = np.einsum("ik,jl->ijkl", np.eye(3), np.eye(3))[..., None, None]
    turned = np.einsum("il...,kj...->ijkl...", G, G)  # −∂G_ij/∂F_kl
    outer = partial(np.einsum, "ij...,kl...->ijkl...")
    bent = -2.0 / 3.0 * outer(g, G) + 2.0 * grown * (one - 2.0 / 3.0 * outer(G, F) + square / 3.0 * turned)
    swollen = kappa * ((2.0 * J - 1.0) * J * outer(G, G) - (J - 1.0) * J * turned)
    return P, B * slope * outer(g, g) + slope * bent + swollen


def solved_alone(nu: float) -> list[float]:
    """The same by a solver of its own: total Lagrangian, nothing averaged, a tangent at every correction [m]."""
    body, out = block(nu), []
    mu, kappa = body.material.lame_mu, E / (3.0 * (1.0 - 2.0 * nu))
    basis = skfem.Basis(body.mesh, skfem.ElementVector(skfem.ElementTetP2()), intorder=2)
    slopes, dofs = np.array([each[0].grad for each in basis.basis]), basis.element_dofs
    sites = tissue.build_sites(body, [tissue.Site(place, RADIUS) for place in PLACES])
    U, old = np.zeros(body.N), 0.0
    for tension in SCALED:
        for scaled in np.linspace(old, tension, 5)[1:]:
            load = sites.Y.T @ (scaled * E * RADIUS**2 * pulls())
            for _ in range(30):
                F = np.einsum("aijeq,ae->ijeq", slopes, U[dofs]) + np.eye(3)[:, :, None, None]
                P, A = stress_and_tangent(mu, kappa, F)
                local = np.einsum("aijeq,ijeq,eq->ae", slopes, P, basis.dx)
                r = np.bincount(dofs.ravel(), local.ravel(), body.N)[body.free] - load
                if np.abs(r).max() <= 1e-11 * np.abs(load).max():
                    break
                half = np.einsum("ijkleq,bkleq,eq->bijeq", A, slopes, basis.dx, optimize=True)
                blocks = np.einsum("aijeq,bijeq->abe", slopes, half, optimize=True)
                at = np.broadcast_to(dofs[:, None], blocks.shape), np.broadcast_to(dofs[None], blocks.shape)
                K = csc_matrix((blocks.ravel(), (at[0].ravel(), at[1].ravel())), shape=(body.N, body.N))
                U[body.free] -= splu(K[body.free][:, body.free].tocsc()).solve(r)
        out.append(float((sites.Y @ U[body.free])[0]))
        old = tension
    return out


def test_two_footprints_drawn_together() -> None:
    """Independent check: τ = 0.3, 1 and 5 in stiffening tissue, against a solver of its own on the same P2 cells, to
    two solvers' accuracy, far beyond what is linear."""
    found = ways(0.45)
    assert found == pytest.approx(solved_alone(0.45), rel=TWO_SOLVERS)
    assert 2.0 * found[0] < found[2] < 0.5 * SCALED[2] / SCALED[0] * found[0]
