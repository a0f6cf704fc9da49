"""A body at finite strain: its derivatives, solutions in the discrete space, orders, locking, Rivlin's closed forms."""

from functools import cache

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.optimize import root
from skfem import Basis, ElementTetP1, ElementTetP2, ElementVector, LinearForm, MeshTet

import tissue
from tests.bounds import IDENTITY, ORDER, RESIDUAL, SLOPE
from tests.tissue.finite import box, equilibrium
from tissue.arrays import Array
from tissue.materials.density import Sum
from tissue.materials.fibres import Fibres
from tissue.materials.isotropic import Exponential, Volumetric
from tissue.materials.prestretch import Prestretched

E, B = 1.0e5, 2.0
STRETCHES = (1.05, 1.0, 0.952)
LONG = 0.6  # of the cylinder, over its radius
RIVLIN = 0.01  # of torque, force and pressure of an incompressible body; ν = 0.4999 leaves 1e-3


def body_of(
    mesh: MeshTet,
    element: str,
    nu: float,
    clamp: tuple[str, ...] = ("all",),
    roller: tuple[str, ...] = (),
    dilatation: str = "auto",
) -> tissue.Elasticity:
    return tissue.elasticity(mesh, tissue.Material(E, nu, 1000.0), element, clamp, dilatation, roller)


@pytest.mark.parametrize(
    ("element", "nu", "dilatation"),
    [("P1", 0.3, "auto"), ("P1", 0.49, "auto"), ("P2", 0.49, "auto"), ("P2", 0.49, "mean")],
)
def test_force_and_tangent_are_the_derivatives_of_the_energy(element: str, nu: float, dilatation: str) -> None:
    """Independent check, by slope: with J averaged at the vertices or over cells, prestretch, fibres, and a part of
    the body that is compressible."""
    mesh = box((2, 2, 2), (1.0, 1.0, 1.0), 0.2)
    soft = mesh.p[0, mesh.t].mean(axis=0) < 0.5
    material = tissue.Material(E, np.where(soft, 0.3, nu), 1000.0)
    body = tissue.elasticity(mesh, material, element, ["low2"], dilatation)
    law = Sum([Exponential(material.lame_mu, B), Fibres([1.0, 0.0, 0.0], 1e4, 2.0)])
    hyper = tissue.Hyperelasticity(body, law, np.outer([1.1, 1.0, 0.95], np.ones(mesh.nelements)))
    U, dU = (body.extended(x) for x in np.random.default_rng(2).standard_normal((2, body.free.size)))
    U, dU = 0.004 * U, 0.005 * dU
    F = hyper.gradient(U)
    force, K = hyper.forces(F)[0][body.free], hyper.tangent(F)
    assert hyper.energy_at_points(F).sum() == pytest.approx(hyper.energy(F), rel=IDENTITY)
    errors = []
    for h in (1e-2, 1e-3):
        sides = [hyper.gradient(U + s * h * dU) for s in (1.0, -1.0)]
        slope = (hyper.energy(sides[0]) - hyper.energy(sides[1])) / (2 * h)
        pull = (hyper.forces(sides[0])[0] - hyper.forces(sides[1])[0])[body.free] / (2 * h)
        errors.append([abs(slope - force @ dU[body.free]), np.abs(pull - K @ dU[body.free]).max()])
    assert np.all(np.abs(np.log10(np.divide(*errors)) - 2.0) < SLOPE)
    assert abs(K - K.T).max() <= IDENTITY * abs(K).max()


@pytest.mark.parametrize(
    ("element", "nu", "dilatation"),
    [(of, nu, "auto") for of in ("P1", "P2") for nu in (0.3, 0.49)] + [("P2", 0.49, "mean")],
)
def test_at_rest_it_is_the_linear_organ(element: str, nu: float, dilatation: str) -> None:
    """Consistency check: the tangent at U = 0 is the linear organ's matrix, whatever the stiffening."""
    body = body_of(box((2, 3, 2), (1.0, 1.2, 0.8), 0.2), element, nu, ("low0",), dilatation=dilatation)
    hyper = tissue.Hyperelasticity(body, Exponential(body.material.lame_mu, B))
    K, linear = hyper.tangent(hyper.gradient(np.zeros(body.N))), body.K[body.free][:, body.free]
    assert abs(K - linear).max() <= IDENTITY * abs(linear).max()


@pytest.mark.parametrize("element", ["P1", "P2"])
def test_a_rotation_by_a_right_angle_stores_nothing(element: str) -> None:
    """Independent check: no energy and no force, relative to E and the size of the body."""
    body = body_of(box((2, 2, 2), (1.0, 1.0, 1.0), 0.2), element, 0.49)
    hyper = tissue.Hyperelasticity(body, Exponential(body.material.lame_mu, B))
    R = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    F = hyper.gradient(body.flat(body.points @ (R - np.eye(3)).T))
    assert abs(hyper.energy(F)) <= IDENTITY * E
    assert np.abs(hyper.forces(F)[0]).max() <= IDENTITY * E
    inverted = hyper.gradient(body.flat(-2.0 * body.points * [1.0, 0.0, 0.0]))
    assert hyper.energy(inverted) == np.inf


@pytest.mark.parametrize(("element", "nu"), [("P1", 0.3), ("P1", 0.49), ("P2", 0.49)])
def test_a_bar_under_tension_with_fibres_and_prestretch(element: str, nu: float) -> None:
    """Independent check: a bar on rollers under dead traction takes the stretches at which its P in closed form is
    (t, 0, 0)."""
    size, traction = (1.0, 0.6, 0.5), 0.6 * E
    body = body_of(box((2, 2, 2), size, 0.2), element, nu, (), roller=("low0", "low1", "low2"))
    mu, lam = body.material.lame_mu, body.material.lame_lambda
    law = Sum([Exponential(mu, B), Fibres([1.0, 0.0, 0.0], 0.3 * E, 1.0)])
    hyper = tissue.Hyperelasticity(body, law, STRETCHES)
    surface = Basis(body.mesh, body.basis.elem).boundary("high0")
    load = LinearForm(lambda v, w: traction * v[0]).assemble(surface)
    U = equilibrium(hyper, np.zeros(body.N), load, steps=4)
    exact = Prestretched(Sum([law, Volumetric(lam + 2.0 * mu / 3.0)]), np.array(STRETCHES))

    def missing(x: Array) -> Array:
        P = np.diag(exact.stress(np.diag(x)[:, :, None])[:, :, 0])
        return (P - [traction, 0.0, 0.0]) / E

    found = root(missing, np.array([1.3, 0.9, 0.9]), tol=1e-13)
    assert found.success
    assert np.abs(U - body.flat(body.points * (found.x - 1.0))).max() <= RESIDUAL
    assert found.x[0] > 1.1


@pytest.mark.parametrize(
    ("element", "nu", "dilatation"),
    [("P1", 0.3, "auto"), ("P1", 0.4999, "auto"), ("P2", 0.4999, "auto"), ("P2", 0.499, "mean")],
)
def test_shear_and_equibiaxial_stretch_are_exact_on_an_irregular_mesh(element: str, nu: float, dilatation: str) -> None:
    """Independent check: an affine motion prescribed all round is the motion inside, and its energy is V·W."""
    body = body_of(box((3, 3, 3), (1.0, 1.0, 1.0), 0.25), element, nu, dilatation=dilatation)
    hyper = tissue.Hyperelasticity(body, Exponential(body.material.lame_mu, B))
    shear = np.array([[0.0, 0.5, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
    for gradient, I1 in ((shear, 3.25), (np.diag([0.25, 0.25, 1.25**-2 - 1.0]), 2 * 1.25**2 + 1.25**-4)):
        exact = body.flat(body.points @ gradient.T)
        astray = body.extended(2e-4 * np.random.default_rng(1).standard_normal(body.free.size))
        U = equilibrium(hyper, exact + astray)
        assert np.abs(U - exact).max() <= RESIDUAL
        W = body.material.lame_mu / (2 * B) * np.expm1(B * (I1 - 3.0))
        assert abs(hyper.energy(hyper.gradient(U)) - W) <= RESIDUAL * W


def sheared(X: Array) -> Array:
    """x = X + (0.2 sin πY + 0.1 Z², 0.15 sin 2Z, 0): ∇u of a motion that keeps volume, shape `(3, 3, …)`."""
    out = np.zeros((3, *X.shape))
    out[0, 1], out[0, 2] = 0.2 * np.pi * np.cos(np.pi * X[1]), 0.2 * X[2]
    out[1, 2] = 0.3 * np.cos(2.0 * X[2])
    return out


def motion(X: Array) -> Array:
    return np.stack([0.2 * np.sin(np.pi * X[1]) + 0.1 * X[2] ** 2, 0.15 * np.sin(2.0 * X[2]), 0.0 * X[0]])


@cache
def manufactured(element: str, cells: int, nu: float) -> Array:
    """Errors in L2 and H1 of that motion, prescribed all round, with the load that it needs."""
    body = body_of(box((cells,) * 3, (1.0, 1.0, 1.0)), element, nu)
    hyper = tissue.Hyperelasticity(body, Exponential(body.material.lame_mu, 0.5))
    fine = Basis(body.mesh, ElementVector({"P1": ElementTetP1, "P2": ElementTetP2}[element]()), intorder=6)
    eye = np.eye(3)[:, :, None, None]
    law = Exponential(body.material.lame_mu, 0.5)
    load = LinearForm(lambda v, w: np.sum(law.stress(eye + sheared(w.x)) * v.grad, axis=(0, 1))).assemble(fine)
    U = equilibrium(hyper, body.flat(motion(body.points.T).T), load)
    field, x = fine.interpolate(U), np.asarray(fine.global_coordinates())
    value = np.einsum("ick,ck->", (np.asarray(field) - motion(x)) ** 2, fine.dx)
    slope = np.einsum("ijck,ck->", (field.grad - sheared(x)) ** 2, fine.dx)
    return np.sqrt([value, slope])


@pytest.mark.parametrize(("element", "cells", "orders"), [("P1", (4, 8), (2, 1)), ("P2", (2, 4), (3, 2))])
def test_manufactured_solution_converges_at_the_theoretical_orders(
    element: str, cells: tuple[int, int], orders: tuple[int, int]
) -> None:
    """Independent check: orders k + 1 and k at strains of half."""
    coarse, fine = (manufactured(element, n, 0.3) for n in cells)
    assert np.abs(np.log2(coarse / fine) - orders).max() < ORDER


@pytest.mark.parametrize(("element", "cells"), [("P1", 8), ("P2", 4)])
def test_nearly_incompressible_tissue_does_not_lock(element: str, cells: int) -> None:
    """Independent check: errors at ν = 0.4999 are at most twice those at 0.3."""
    assert np.all(manufactured(element, cells, 0.4999) <= 2.0 * manufactured(element, cells, 0.3))


def test_torsion_of_a_cylinder() -> None:
    """Independent check (Rivlin 1949): torque μψI and the axial force −½μψ²I of the Poynting effect, I the polar moment
    of the meshed cross-section, at a
    twist of 0.6 per radius."""
    line = np.linspace(-1.0, 1.0, 6)
    square = MeshTet.init_tensor(line, line, np.linspace(0.0, LONG, 4))
    x, y, z = square.p
    disc = MeshTet(np.stack([x * np.sqrt(1 - y**2 / 2), y * np.sqrt(1 - x**2 / 2), z]), square.t)
    ends = {"low": lambda x: x[2] < 1e-9, "high": lambda x: x[2] > LONG - 1e-9}
    body = body_of(disc.with_boundaries(ends), "P2", 0.4999, ("low", "high"))
    psi, X = 0.6, body.points
    angle = psi * X[:, 2]
    turned = np.column_stack(
        [X[:, 0] * np.cos(angle) - X[:, 1] * np.sin(angle), X[:, 0] * np.sin(angle) + X[:, 1] * np.cos(angle), X[:, 2]]
    )
    hyper = tissue.Hyperelasticity(body)
    U = equilibrium(hyper, body.flat(turned - X))
    forces, top = body.nodal(hyper.forces(hyper.gradient(U))[0]), X[:, 2] > LONG - 1e-9
    places = np.asarray(Basis(body.mesh, body.basis.elem, intorder=2).global_coordinates())
    polar = float(np.sum(hyper.weights * np.sum(places[:2] ** 2, axis=0).T)) / LONG
    torque = np.sum(turned[top, 0] * forces[top, 1] - turned[top, 1] * forces[top, 0])
    mu = body.material.lame_mu
    assert torque == pytest.approx(mu * psi * polar, rel=RIVLIN)
    assert forces[top, 2].sum() == pytest.approx(-0.5 * mu * psi**2 * polar, rel=RIVLIN)


@pytest.mark.parametrize("b", [0.0, 1.0])
def test_inflation_of_a_thick_tube(b: float) -> None:
    """Independent check: p = ∫ μ exp(b (λ − 1/λ)²) (λ² − λ⁻²) dr/r in plane strain, its inner radius half as large
    again."""
    square = MeshTet.init_tensor(np.linspace(0.0, 1.0, 5), np.linspace(0.0, 1.0, 9), np.linspace(0.0, 0.25, 2))
    R, theta = 1.0 + square.p[0], 0.5 * np.pi * square.p[1]
    mesh = MeshTet(np.stack([R * np.cos(theta), R * np.sin(theta), square.p[2]]), square.t)
    sides = {
        "x0": lambda x: x[0] < 1e-9,
        "y0": lambda x: x[1] < 1e-9,
        "z0": lambda x: x[2] < 1e-9,
        "z1": lambda x: x[2] > 0.25 - 1e-9,
        "inner": lambda x: np.hypot(x[0], x[1]) < 1.05,
    }
    body = body_of(mesh.with_boundaries(sides), "P2", 0.4999, ("inner",), roller=("x0", "y0", "z0", "z1"))
    hyper = tissue.Hyperelasticity(body, Exponential(body.material.lame_mu, b))
    X = body.points
    R = np.hypot(X[:, 0], X[:, 1])
    inside, grown = R < 1.0 + 1e-9, np.sqrt(1.0 + 1.25 / R**2) - 1.0
    U = equilibrium(hyper, body.flat(X * grown[:, None] * [1.0, 1.0, 0.0]))
    forces = body.nodal(hyper.forces(hyper.gradient(U))[0])[inside]
    outward = np.sum(forces[:, :2] * X[inside, :2]) / np.hypot(*X[inside, :2].T).mean()

    def bearing(r: float) -> float:
        x = r / np.sqrt(r**2 - 1.25)
        return body.material.lame_mu * np.exp(b * (x - 1.0 / x) ** 2) * (x**2 - x**-2) / r

    pressure = quad(bearing, 1.5, np.sqrt(4.0 + 1.25))[0]
    assert outward / (1.5 * 0.5 * np.pi * 0.25) == pytest.approx(pressure, rel=RIVLIN)
