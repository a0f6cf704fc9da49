"""The organ's discretisation: first solutions it must hold exactly, then orders of convergence, then a bar
that rings.
"""

import numpy as np
import pytest
from numpy.typing import NDArray
from skfem import Basis, BilinearForm, ElementTetP1, ElementTetP2, ElementVector, LinearForm, MeshTet
from skfem.helpers import dot

import tissue
from tissue.organs.dynamic import History

Array = NDArray[np.float64]
TISSUE = tissue.Material(1.0e5, 0.45, 1070.0)


def box(counts: tuple[int, int, int], size: tuple[float, float, float], jitter: float = 0.0) -> MeshTet:
    """A box from the origin; `jitter` moves the inner nodes by that share of a cell, so no two cells are
    alike.
    """
    lines = [np.linspace(0.0, s, n + 1) for n, s in zip(counts, size, strict=True)]
    mesh = MeshTet.init_tensor(*lines)
    top = np.array(size)[:, None]
    inner = np.all((mesh.p > 1e-9 * top) & (mesh.p < (1.0 - 1e-9) * top), axis=0)
    moves = np.random.default_rng(3).uniform(-1.0, 1.0, mesh.p.shape) * jitter * top / np.array(counts)[:, None]
    moved = MeshTet(mesh.p + moves * inner, mesh.t)
    return moved.with_boundaries({"left": lambda x: x[0] < 1e-9 * size[0], "all": lambda x: np.full(x.shape[1], True)})


def solve_with_data(body: tissue.Elasticity, data: Array, load: Array) -> Array:
    """Displacement `(N,)` under `load`, with the clamped unknowns moved as `data` `(N,)` says."""
    free, clamped = body.free, body.clamped
    U = np.where(np.isin(np.arange(body.N), clamped), data, 0.0)
    factor = tissue.factorize(body.K[free][:, free], body.basis.doflocs[:, free].T)
    U[free] = factor.solve(load[free] - (body.K @ U)[free])
    return U


def pure_bending(points: Array, curvature: float, nu: float) -> Array:
    """u_x = κxz, u_y = −νκyz, u_z = −κ/2 (x² + ν(z² − y²)) (Timoshenko & Goodier, art. 102)."""
    x, y, z = points.T
    return curvature * np.column_stack([x * z, -nu * y * z, -0.5 * (x**2 + nu * (z**2 - y**2))])


def hung_bar(points: Array, slope: float, nu: float, length: float) -> Array:
    """A bar under its weight, hung at z = L; `slope` = ρg/E (Timoshenko & Goodier, art. 96)."""
    x, y, z = points.T
    return slope * np.column_stack([-nu * x * z, -nu * y * z, 0.5 * (z**2 + nu * (x**2 + y**2) - length**2)])


@pytest.mark.parametrize("element", ["P1", "P2"])
def test_linear_field_is_exact_on_an_irregular_mesh(element: str) -> None:
    body = tissue.elasticity(box((3, 4, 3), (0.06, 0.04, 0.02), 0.3), TISSUE, element, ["all"])
    gradient = np.random.default_rng(0).standard_normal((3, 3))
    exact = body.flat(body.points @ gradient.T)
    U = solve_with_data(body, exact, np.zeros(body.N))
    assert body.free.size > 0
    assert np.abs(U - exact).max() <= 1e-12 * np.abs(exact).max()


def test_pure_bending_is_exact_in_p2() -> None:
    body = tissue.elasticity(box((3, 2, 3), (0.06, 0.04, 0.02), 0.3), TISSUE, "P2", ["all"])
    exact = body.flat(pure_bending(body.points, 2.0, 0.45))
    U = solve_with_data(body, exact, np.zeros(body.N))
    assert np.abs(U - exact).max() <= 1e-11 * np.abs(exact).max()


def test_hung_bar_under_its_weight_is_exact_in_p2() -> None:
    """Independent check of the body force: σ_zz = ρgz and nothing else."""
    body = tissue.elasticity(box((2, 2, 4), (0.02, 0.02, 0.06), 0.3), TISSUE, "P2", ["all"])
    exact = body.flat(hung_bar(body.points, 1070.0 * 9.81 / 1.0e5, 0.45, 0.06))
    U = solve_with_data(body, exact, body.body_force(np.array([0.0, 0.0, -9.81])))
    assert np.abs(U - exact).max() <= 1e-11 * np.abs(exact).max()


def sine(x: Array) -> Array:
    return np.sin(np.pi * x[0]) * np.sin(np.pi * x[1]) * np.sin(np.pi * x[2])


def sine_gradient(x: Array) -> Array:
    s, c = np.sin(np.pi * x), np.cos(np.pi * x)
    return np.pi * np.stack([c[0] * s[1] * s[2], s[0] * c[1] * s[2], s[0] * s[1] * c[2]])


def sine_load(x: Array, lam: float, mu: float) -> Array:
    """b_i = −[(λ+μ) ∂_i Σ_j ∂_j φ − 3π²μ φ] for u_i = φ = sin πx sin πy sin πz."""
    s, c = np.sin(np.pi * x), np.cos(np.pi * x)
    phi = sine(x)
    cross = {(i, j): c[i] * c[j] * s[3 - i - j] for i in range(3) for j in range(3) if i != j}
    div = [np.pi**2 * (-phi + sum(cross[i, j] for j in range(3) if j != i)) for i in range(3)]
    return np.stack([-((lam + mu) * div[i] - 3.0 * np.pi**2 * mu * phi) for i in range(3)])


def manufactured_errors(element: str, cells: int) -> Array:
    """Errors in L2, H1 and energy for the sine field on the unit cube, E = 1, ν = 0.3."""
    material = tissue.Material(1.0, 0.3, 1.0)
    body = tissue.elasticity(box((cells,) * 3, (1.0, 1.0, 1.0)), material, element, ["all"])
    scalar = {"P1": ElementTetP1, "P2": ElementTetP2}[element]()
    fine = Basis(body.mesh, ElementVector(scalar), intorder=6)
    lam, mu = float(material.lame_lambda), float(material.lame_mu)
    load = LinearForm(lambda v, w: dot(sine_load(w.x, lam, mu), v)).assemble(fine)
    U = solve_with_data(body, np.zeros(body.N), load)
    field, x = fine.interpolate(U), fine.global_coordinates()
    value = np.einsum("ick,ck->", (np.asarray(field) - sine(np.asarray(x))) ** 2, fine.dx)
    slope = np.einsum("ijck,ck->", (field.grad - sine_gradient(np.asarray(x))) ** 2, fine.dx)
    return np.array([np.sqrt(value), np.sqrt(slope), abs(0.5 * U @ (body.K @ U) - SINE_ENERGY)])


SINE_ENERGY = (3.0 * np.pi**2 / 16.0) * (0.3 / (1.3 * 0.4)) + 0.75 * np.pi**2 / 2.6  # λ and μ at E = 1, ν = 0.3


@pytest.mark.parametrize(("element", "cells", "orders"), [("P1", (8, 16), (2, 1, 2)), ("P2", (5, 9), (3, 2, 4))])
def test_manufactured_solution_converges_at_the_theoretical_orders(
    element: str, cells: tuple[int, int], orders: tuple[int, int, int]
) -> None:
    """Independent check: strain energy 3.914626746 in closed form, orders k + 1, k and 2k."""
    assert pytest.approx(3.914626746, rel=1e-9) == SINE_ENERGY
    coarse, fine = (manufactured_errors(element, n) for n in cells)
    observed = np.log(coarse / fine) / np.log(cells[1] / cells[0])
    assert np.abs(observed - orders).max() <= 0.15


def test_mass_is_the_vector_form_and_weighs_the_body() -> None:
    """Consistency check: the mass is built from one scalar block; the vector weak form must say the same."""
    for element, scalar in (("P1", ElementTetP1()), ("P2", ElementTetP2())):
        body = tissue.elasticity(box((2, 2, 2), (0.06, 0.04, 0.02), 0.2), TISSUE, element)
        whole = Basis(body.mesh, ElementVector(scalar), intorder=4)
        direct = 1070.0 * BilinearForm(lambda u, v, w: dot(u, v)).assemble(whole)
        assert abs(direct - body.M).max() <= 1e-12 * abs(direct).max()
        weight = body.nodal(body.body_force(np.array([0.0, 0.0, -9.81]))).sum(axis=0)
        assert weight == pytest.approx([0.0, 0.0, -9.81 * 1070.0 * 0.06 * 0.04 * 0.02], rel=1e-12, abs=1e-12)


def test_free_body_has_six_rigid_motions_without_energy() -> None:
    body = tissue.elasticity(box((2, 2, 2), (0.06, 0.04, 0.02), 0.2), TISSUE, "P2")
    values = np.linalg.eigvalsh(body.K.toarray())
    assert np.abs(values[:6]).max() <= 1e-12 * values[-1]
    assert values[6] > 1e-6 * values[-1]


def test_soft_half_takes_more_strain() -> None:
    """A material may differ from cell to cell: two blocks in a row, ν = 0, share the stress and not the
    strain.
    """
    mesh = box((4, 1, 1), (0.04, 0.01, 0.01))
    x = mesh.p[0, mesh.t].mean(axis=0)
    modulus = np.where(x < 0.02, 1.0e5, 4.0e5)
    body = tissue.elasticity(mesh.with_boundaries({"ends": lambda x: (x[0] < 1e-9) | (x[0] > 0.04 - 1e-9)}),
                             tissue.Material(modulus, 0.0, 1000.0), "P1", ["ends"])  # fmt: skip
    pulled = body.flat(
        np.column_stack([np.where(body.points[:, 0] > 0.03, 1e-3, 0.0), np.zeros((len(body.points), 2))])
    )
    U = body.nodal(solve_with_data(body, pulled, np.zeros(body.N)))
    middle = np.isclose(body.points[:, 0], 0.02)
    assert U[middle, 0] == pytest.approx(np.full(middle.sum(), 0.8e-3), rel=1e-10)


def bar_tip(times: Array) -> Array:
    """Tip of a fixed-free bar under acceleration switched on at t = 0, in units of its static value; c = L =
    1.
    """
    n = (2.0 * np.arange(2000) + 1.0) * np.pi / 2.0
    share = 4.0 * np.sin(n) / n**3  # Σ share = 1
    return (share * (1.0 - np.cos(np.outer(times, n)))).sum(axis=1)


@pytest.mark.parametrize("element", ["P1", "P2"])
def test_bar_rings_with_the_period_of_its_length(element: str) -> None:
    """Independent check: E = 100 kPa, ρ = 1000, ν = 0, L = 0.1 m: c = 10 m/s, period 4L/c = 40 ms, tip to
    twice static.

    With ν = 0 a laterally free bar is the wave equation. The trapezoidal rule, which loses no energy, is a
    member of the family acceleration = a (U − U_a), velocity = d (U − U_d).
    """
    body = tissue.elasticity(box((20, 1, 1), (0.1, 0.01, 0.01)), tissue.Material(1.0e5, 0.0, 1000.0), element, ["left"])
    organ = tissue.DynamicOrgan(body, tissue.build_sites(body, []), gravity=(1.0, 0.0, 0.0))
    dt, steps = 2.5e-4, 160
    operator = organ.operator(4.0 / dt**2, 2.0 / dt)
    state = organ.start()
    state = tissue.OrganState(state.U, state.V, tissue.factorize(organ.M).solve(organ.load), state.f_y)
    tip, energy = [], []
    for _ in range(steps):
        inertia = state.U + dt * state.V + 0.25 * dt**2 * state.A
        damping = state.U + 0.5 * dt * state.V
        masses = organ.mass_times(inertia), organ.mass_times(damping)
        history = History(inertia, damping, *masses, K_damping=organ.elastic_force(damping))
        U = operator.predict(state, history, organ.load)
        rates = operator.d * (U - history.damping), operator.a * (U - history.inertia)
        state = tissue.OrganState(U, *rates, state.f_y)
        tip.append(body.nodal(organ.displacement(state))[np.isclose(body.points[:, 0], 0.1), 0].mean())
        audit = organ.energies(organ.start(), state)
        energy.append(audit.kinetic + audit.elastic - audit.load_work)
    static = 1000.0 * 0.1**2 / (2.0 * 1.0e5)
    exact = static * bar_tip(np.arange(1, steps + 1) * dt * 100.0)
    assert exact.max() == pytest.approx(2.0 * static, rel=1e-6)
    assert np.abs(np.array(tip) - exact).max() <= 0.01 * 2.0 * static
    assert np.abs(energy).max() <= 1e-10 * static * 1000.0 * 1e-5


@pytest.mark.parametrize("element", ["P1", "P2"])
def test_every_node_is_placed_where_vtk_expects_it(element: str) -> None:
    body = tissue.elasticity(box((2, 2, 2), (0.06, 0.04, 0.02), 0.2), TISSUE, element)
    points, cells, nodes = body.points, body.cells, body.nodes
    corners = points[cells[:, :4]]
    assert np.array_equal(corners, body.mesh.p.T[body.mesh.t.T])
    assert np.array_equal(np.sort(nodes.ravel()), np.arange(body.N))
    for k, (i, j) in enumerate([(0, 1), (1, 2), (0, 2), (0, 3), (1, 3), (2, 3)][: cells.shape[1] - 4]):
        assert np.abs(points[cells[:, 4 + k]] - 0.5 * (corners[:, i] + corners[:, j])).max() <= 1e-12 * 0.06
    field = np.random.default_rng(0).standard_normal(body.N)
    assert np.array_equal(body.flat(body.nodal(field)), field)


@pytest.mark.parametrize(
    ("material", "words"),
    [
        ((0.0, 0.3, 1.0), "youngs_modulus = 0 Pa"),
        ((np.nan, 0.3, 1.0), "youngs_modulus = nan"),
        ((1.0, 0.5, 1.0), "poisson_ratio = 0.5"),
        ((1.0, -1.0, 1.0), "poisson_ratio = -1"),
        ((1.0, 0.3, -2.0), "density = -2 kg/m³"),
        ((np.array([1.0, -1.0]), 0.3, 1.0), "youngs_modulus = -1"),
    ],
)
def test_impossible_material_is_refused(material: tuple[float, float, float], words: str) -> None:
    with pytest.raises(tissue.TissueError, match=words):
        tissue.Material(*material)


def test_unknown_boundary_element_and_shape_are_refused() -> None:
    mesh = box((1, 1, 1), (1.0, 1.0, 1.0))
    with pytest.raises(tissue.TissueError, match=r"'botom'.*all, left"):
        tissue.elasticity(mesh, TISSUE, "P1", ["botom"])
    with pytest.raises(tissue.TissueError, match="element = 'Q1'"):
        tissue.elasticity(mesh, TISSUE, "Q1")
    with pytest.raises(tissue.TissueError, match="one per cell"):
        tissue.elasticity(mesh, tissue.Material(np.ones(3), 0.3, 1.0))
