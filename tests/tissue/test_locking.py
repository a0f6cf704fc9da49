"""Nearly incompressible tissue: a bonded layer and the Lamé modes of a cube, as right at ν → ½ as at ν = 0.3."""

from functools import cache

import numpy as np
import pytest
from scipy.sparse.linalg import eigsh
from skfem import MeshTet

import tissue
from tests.tissue.layers import footprint_compliance, layer_compliance, quarter_layer

E = 1.0e5
A, H = 0.5, 1.0  # radius of the footprint and thickness of the layer


@pytest.mark.parametrize(
    ("a", "nu", "cells", "growth", "wide"),
    [(0.5, 0.3, 4, 2.0, 3.0), (0.2, 0.3, 4, 2.0, 3.0), (0.5, 0.45, 4, 1.5, 3.0), (0.5, 0.49, 3, 2.0, 4.0)],
)
def test_bonded_layer_gives_way_as_its_hankel_transform_says(
    a: float, nu: float, cells: int, growth: float, wide: float
) -> None:
    """Independent check, P2: normal and tangential compliance of a parabolic footprint within 0.5 %.

    The layer is cut off three or four thicknesses away, where its answer has decayed to 0.2 %.
    """
    body = tissue.elasticity(quarter_layer(a, H, cells, growth, wide), tissue.Material(E, nu, 1000.0), "P2", ["base"])
    for axis, exact in zip((2, 0), layer_compliance("parabolic", a, H, E, nu), strict=True):
        assert footprint_compliance(body, a, "parabolic", axis) == pytest.approx(exact, rel=5e-3)


def test_a_deep_layer_is_a_half_space() -> None:
    """The kernel against closed forms, and a thin one against the squeezed column σ = (λ + 2μ)ε: C = h⟨w⟩/(λ + 2μ)."""
    C_zz, C_xx = layer_compliance("uniform", 1.0, 200.0, E, 0.3)
    assert C_zz == pytest.approx(0.491745 / E, rel=0.01)
    assert C_xx == pytest.approx(0.597120 / E, rel=0.01)
    C_zz, C_xx = layer_compliance("parabolic", 1.0, 0.02, E, 0.3)
    mean = 4.0 / (3.0 * np.pi)  # ∫w² over the disc
    assert C_zz == pytest.approx(0.02 * mean * 1.3 * 0.4 / (0.7 * E), rel=0.02)
    assert C_xx == pytest.approx(0.02 * mean * 2.6 / E, rel=0.02)


def test_a_point_doubles_and_a_footprint_converges() -> None:
    """Independent check (theory), uniform P1 mesh, h halved twice: a bare point's compliance is c/(Eh) and a remainder
    that stays, so that its growth doubles; the footprint's error against the layer's Hankel transform falls with the
    second order of a traction without jumps, and from below."""
    points, errors = [], []
    exact = layer_compliance("parabolic", A, H, E, 0.3)[0]
    for cells in (2, 4, 8):
        mesh = quarter_layer(A, H, cells, 1.0 + 1.6 / cells, 3.0)
        body = tissue.elasticity(mesh, tissue.Material(E, 0.3, 1000.0), "P1", ["base"])
        errors.append(1.0 - footprint_compliance(body, A, "parabolic", 2) / exact)
        line = np.linspace(-1.0, 1.0, 2 * cells + 1)
        block = MeshTet.init_tensor(line, line, line[: cells + 1])
        body = tissue.elasticity(
            block.with_boundaries({"base": lambda x: x[2] < -1.0 + 1e-9}),
            tissue.Material(E, 0.3, 1000.0),
            "P1",
            ["base"],
        )
        point = tissue.build_sites(body, [tissue.Site([0.0, 0.0, 0.0], 0.0, "uniform", None)])
        points.append(tissue.QuasiStaticOrgan(body, point).operator(0.0, 0.0).C[2, 2])
    assert abs((points[2] - points[1]) / (points[1] - points[0]) - 2.0) < 0.1
    assert min(errors) > 0.0
    assert abs(np.log2(errors[1] / errors[2]) - 2.0) < 0.4  # the gradation of the mesh is not halved with it


@cache
def layer_errors(element: str, nu: float, dilatation: str = "auto") -> tuple[float, float]:
    """Relative errors of the normal and tangential compliance on a coarse mesh."""
    cells, growth = {"P1": (4, 1.6), "P2": (2, 2.0)}[element]
    mesh = quarter_layer(A, H, cells, growth, 3.0)
    body = tissue.elasticity(mesh, tissue.Material(E, nu, 1000.0), element, ["base"], dilatation)
    exact = layer_compliance("parabolic", A, H, E, nu)
    got = [footprint_compliance(body, A, "parabolic", axis) for axis in (2, 0)]
    return abs(got[0] / exact[0] - 1.0), abs(got[1] / exact[1] - 1.0)


@pytest.mark.parametrize("element", ["P1", "P2"])
def test_a_bonded_layer_does_not_lock(element: str) -> None:
    """Errors at ν = 0.499 and 0.4999 at most twice those at 0.3 on the same mesh; with the dilatation cell by cell the
    normal one is more than three times as large."""
    reference = np.array(layer_errors(element, 0.3))
    for nu in (0.499, 0.4999):
        assert (np.array(layer_errors(element, nu)) <= 2.0 * reference).all()
    assert layer_errors(element, 0.4999, "cell")[0] > 3.0 * reference[0]


def test_means_over_cells_do_not_lock() -> None:
    """Errors at ν = 0.4999 at most 1.5 times those at 0.45 on the same mesh, where both formulations are one; with the
    dilatation cell by cell more than 2.5 times."""
    moderate = np.array(layer_errors("P2", 0.45))
    assert np.array(layer_errors("P2", 0.45, "mean")) == pytest.approx(moderate, rel=1e-9)
    assert (np.array(layer_errors("P2", 0.4999, "mean")) <= 1.5 * moderate).all()
    assert layer_errors("P2", 0.4999, "cell")[0] > 2.5 * moderate[0]
    moderate_frequency = lame_error("P2", 0.45, "cell")
    assert lame_error("P2", 0.4999, "mean") <= 1.5 * moderate_frequency
    assert lame_error("P2", 0.4999, "cell") > 2.5 * moderate_frequency


@cache
def lame_error(element: str, nu: float, dilatation: str = "auto") -> float:
    """Relative error of the cube's Lamé frequency ω = √2 π √(G/ρ)/L."""
    L, rho = 0.1, 1000.0
    lines = [np.linspace(0.0, L, {"P1": 9, "P2": 6}[element])] * 3
    body = tissue.elasticity(MeshTet.init_tensor(*lines), tissue.Material(E, nu, rho), element, dilatation=dilatation)
    exact = np.sqrt(2.0) * np.pi * np.sqrt(E / (2.0 * (1.0 + nu)) / rho) / L
    squares, modes = eigsh(body.K, k=18, M=body.M, sigma=exact**2, v0=np.ones(body.N))
    x, y, z = np.pi * body.points.T / L
    shape = body.flat(np.column_stack([np.cos(x) * np.sin(y), -np.sin(x) * np.cos(y), 0.0 * z]))
    share = (modes.T @ (body.M @ shape)) ** 2 / (shape @ (body.M @ shape))
    same = np.abs(squares / squares[np.argmax(share)] - 1.0) < 1e-6  # its two likenesses along x and y
    assert share[same].sum() > 0.8
    return float(np.sqrt(squares[same].mean()) / exact - 1.0)


@pytest.mark.parametrize("nu", [0.2, 0.3, 0.499, 0.4999])
def test_lame_modes_of_a_free_cube_are_exact_in_p2(nu: float) -> None:
    """Independent check: the equivoluminal modes u = (cos πx/L sin πy/L, −sin πx/L cos πy/L, 0), whatever ν."""
    assert 0.0 <= lame_error("P2", nu) <= 1e-3


@pytest.mark.parametrize("element", ["P1", "P2"])
def test_lame_modes_do_not_lock(element: str) -> None:
    """Frequency errors at ν = 0.499 and 0.4999 at most twice that at 0.3; with the dilatation cell by cell above three
    times."""
    for nu in (0.499, 0.4999):
        assert lame_error(element, nu) <= 2.0 * lame_error(element, 0.3)
    assert lame_error(element, 0.4999, "cell") > 3.0 * lame_error(element, 0.3)


def test_both_formulations_are_one_at_and_below_three_tenths() -> None:
    mesh = MeshTet.init_tensor(*[np.linspace(0.0, 1.0, 3)] * 3)
    for nu in (-0.2, 0.3):
        K = [
            tissue.elasticity(mesh, tissue.Material(1.0, nu, 1.0), "P2", dilatation=kind).K
            for kind in ("cell", "nodal")
        ]
        assert abs(K[0] - K[1]).max() <= 1e-14 * abs(K[0]).max()


@pytest.mark.parametrize(("element", "dilatation"), [("P1", "nodal"), ("P2", "nodal"), ("P2", "mean")])
def test_uniform_strain_has_hookes_stress_where_the_dilatation_is_averaged(element: str, dilatation: str) -> None:
    """Energy ½σ:ε V and the stress at every node."""
    mesh = MeshTet.init_tensor(*[np.linspace(0.0, 1.0, 4)] * 3)
    body = tissue.elasticity(mesh, tissue.Material(1.0, 0.499, 1.0), element, dilatation=dilatation)
    gradient = np.random.default_rng(1).standard_normal((3, 3))
    strain, mu = 0.5 * (gradient + gradient.T), 1.0 / 2.998
    tensor = 2.0 * mu * (strain + 0.499 / 0.002 * np.trace(strain) * np.eye(3))
    U = body.flat(body.points @ gradient.T)
    energy = 0.5 * U @ (body.K @ U)
    assert energy == pytest.approx(0.5 * np.sum(tensor * strain), rel=1e-12)
    stress = tissue.stress_recovery(body).stress(U)
    expected = [tensor[i, j] for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (1, 2), (0, 2))]
    assert np.abs(stress - expected).max() <= 1e-11 * np.abs(tensor).max()


def test_a_soft_half_takes_no_part_in_the_average() -> None:
    """Where only one half is nearly incompressible, a dilatation of the other half alone has its own energy."""
    mesh = MeshTet.init_tensor(*[np.linspace(0.0, 1.0, 5)] * 3)
    soft = mesh.p[0, mesh.t].mean(axis=0) > 0.5
    body = tissue.elasticity(mesh, tissue.Material(1.0, np.where(soft, 0.0, 0.499), 1.0), "P1")
    stretch = np.maximum(body.points[:, 0] - 0.5, 0.0)
    U = body.flat(np.column_stack([stretch, np.zeros((len(stretch), 2))]))
    energy = 0.5 * U @ (body.K @ U)
    assert energy == pytest.approx(0.25, rel=1e-12)


def test_tissue_at_the_limit_of_the_rest_takes_no_part_in_the_average() -> None:
    """Independent check: a half with ν = 0.3, whose λ is the rest up to round-off, is that with ν a little smaller."""
    mesh = MeshTet.init_tensor(*[np.linspace(0.0, 1.0, 3)] * 3)
    soft = mesh.p[0, mesh.t].mean(axis=0) > 0.5
    one, other = (
        tissue.elasticity(mesh, tissue.Material(1e5, np.where(soft, nu, 0.499), 1.0), "P1").K
        for nu in (0.3, 0.3 - 1e-9)
    )
    assert abs(one - other).max() <= 1e-7 * abs(one).max()


def test_unknown_dilatation_is_refused() -> None:
    with pytest.raises(tissue.TissueError, match="P1 cell"):
        tissue.elasticity(MeshTet(), tissue.Material(1.0, 0.3, 1.0), dilatation="mean")
    with pytest.raises(tissue.TissueError, match="dilatation = 'edge'"):
        tissue.elasticity(MeshTet(), tissue.Material(1.0, 0.3, 1.0), dilatation="edge")
