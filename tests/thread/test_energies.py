"""Energies, forces and masses of the thread: derivatives by slope, closed forms, and invariance."""

import numpy as np
import pytest
from scipy.interpolate import BSpline
from scipy.spatial.transform import Rotation

from tests.bounds import IDENTITY, ORDER
from tests.thread.threads import PP, Strand, assert_slope, bent, dense, greville, straight, thread_on, uniform
from thread.errors import ThreadError
from thread.kernels.curve import Curve, Stretched, energy_of, gradient_of, tangent_of
from thread.knots import clamped_knots
from thread.thread import Thread

# Stretch alone, bending alone, and both of a size, over a metre: EA L² ~ EI (nL)² for the waves of `bent`.
SECTIONS = {
    "axial": Strand(EA=3.0, EI=0.0),
    "bending": Strand(EA=0.0, EI=0.02),
    "both": Strand(EA=3.0, EI=0.02),
}
KNOTS = clamped_knots(np.array([0.0, 0.1, 0.18, 0.3, 0.3, 0.45, 0.5, 0.7, 0.9, 1.0]))
RNG = np.random.default_rng(5)

# Five points whose first two control values are T and T' themselves, with EI = 2: the energy is the sum of κ².
FIRST, SECOND, NOTHING = (np.tile(row, (5, 1, 1)) for row in np.vstack([np.eye(4)[:2], np.zeros(4)]))
EDGES = np.zeros((5, 2, 4)), np.zeros((5, 2)), np.zeros(5), np.zeros((5, 2))
POINTS = Curve(np.zeros(5, np.int64), FIRST, SECOND, np.ones((5, 1)), NOTHING, np.zeros((5, 1)), *EDGES, 0.0, 2.0)


def at_points(T: np.ndarray, K: np.ndarray) -> Stretched:
    """The five points with given derivatives (5, 3) each."""
    return Stretched(T[:, None].copy(), K[:, None].copy(), np.zeros((5, 1, 3)), np.zeros((5, 1)), np.zeros((5, 2, 3)))


def curvature_squared_gradient(T: np.ndarray, K: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Derivatives of κ² by T and T', (5, 3) each."""
    F = np.zeros((5, 4, 3))
    gradient_of(POINTS, at_points(T, K), F)
    return F[:, 0], F[:, 1]


def curvature_squared(T: np.ndarray, K: np.ndarray) -> np.ndarray:
    """κ² of each of the five points, shape `(5,)`."""
    each = (np.ascontiguousarray(row)[:, None] for row in np.eye(5))
    return np.array([energy_of(POINTS._replace(w=w), at_points(T, K)) for w in each])


@pytest.fixture(params=SECTIONS)
def thread(request: pytest.FixtureRequest) -> Thread:
    return thread_on(KNOTS, SECTIONS[request.param])


def hessian(thread: Thread, q: np.ndarray) -> np.ndarray:
    """The tangent at N = EA ε."""
    points = thread.points(q)
    return dense(thread.tangent(points, thread.EA * points.strain))


def energy(thread: Thread, q: np.ndarray) -> float:
    return thread.energy(thread.points(q))


def gradient(thread: Thread, q: np.ndarray) -> np.ndarray:
    return thread.gradient(thread.points(q))


@pytest.mark.parametrize("seed", range(3))
def test_gradient_is_the_slope_of_the_energy(thread: Thread, seed: int) -> None:
    """Independent check: central differences of the energy, in directions of no special kind."""
    q = bent(thread.spline, seed)
    d = 0.02 * np.random.default_rng(seed).standard_normal(q.shape)
    assert_slope(lambda h: np.array(energy(thread, q + h * d)), np.array(np.sum(gradient(thread, q) * d)))


@pytest.mark.parametrize("seed", range(3))
def test_tangent_at_the_elastic_force_is_the_exact_hessian(thread: Thread, seed: int) -> None:
    """Independent check: central differences of the gradient; and the matrix is symmetric."""
    q = bent(thread.spline, seed)
    d = 0.02 * np.random.default_rng(seed).standard_normal(q.shape)
    H = hessian(thread, q)
    assert_slope(lambda h: gradient(thread, q + h * d).ravel(), H @ d.ravel())
    assert np.abs(H - H.T).max() <= IDENTITY * np.abs(H).max()


def test_tangent_is_affine_in_the_iterated_force() -> None:
    """Independent check: a force δN more at a Gauss point adds w δN b'b' I, the geometric stiffness, no more."""
    thread = thread_on(KNOTS, SECTIONS["both"])
    q = bent(thread.spline)
    points = thread.points(q)
    dN = RNG.standard_normal(points.strain.shape)
    more = dense(thread.tangent(points, thread.EA * points.strain + dN)) - hessian(thread, q)
    rule = thread.axial_rule
    slopes = BSpline(thread.spline.knots, np.eye(thread.n), 3)(rule.s, nu=1)
    exact = np.einsum("eg,egi,egj->ij", rule.w * dN, slopes, slopes)
    assert np.abs(more - np.kron(exact, np.eye(3))).max() <= IDENTITY * np.abs(hessian(thread, q)).max()


def test_next_axial_force_is_the_linearised_law() -> None:
    """Independent check: N = EA(ε + dε), dε the slope of the strain; the next ε differs from it by ½|δT|² alone."""
    thread = thread_on(KNOTS, SECTIONS["both"])
    q = bent(thread.spline)
    d = 0.1 * RNG.standard_normal(q.shape)
    N = thread.next_axial_force(thread.points(q), d)
    slope = N - thread.EA * thread.points(q).strain
    assert np.abs(slope).max() > 0.1 * np.abs(N).max()
    differences = thread.EA * (thread.points(q + d).strain - thread.points(q - d).strain) / 2.0
    assert np.abs(differences - slope).max() <= IDENTITY * np.abs(slope).max() * 10


@pytest.mark.parametrize("seed", range(3))
def test_curvature_derivatives(seed: int) -> None:
    """Independent check: κ² by (T, T') at tangents far from unit length and not across T'."""
    rng = np.random.default_rng(seed)
    T, K, dT, dK = rng.standard_normal((4, 5, 3))
    T *= 2.0 / np.linalg.norm(T, axis=1)[:, None]
    g_T, g_K = curvature_squared_gradient(T, K)
    H = np.zeros((5, 4, 3, 12))
    tangent_of(POINTS, at_points(T, K), np.zeros((5, 1)), H)
    H_TT, H_TK, H_KK = H[:, 0, :, :3], H[:, 0, :, 3:6], H[:, 1, :, :3]
    assert_slope(lambda h: curvature_squared(T + h * dT, K + h * dK), (g_T * dT + g_K * dK).sum(axis=1), h=0.03)
    exact_T = np.einsum("mij,mj->mi", H_TT, dT) + np.einsum("mij,mj->mi", H_TK, dK)
    exact_K = np.einsum("mji,mj->mi", H_TK, dT) + np.einsum("mij,mj->mi", H_KK, dK)
    assert_slope(lambda h: curvature_squared_gradient(T + h * dT, K + h * dK)[0], exact_T, h=0.03)
    assert_slope(lambda h: curvature_squared_gradient(T + h * dT, K + h * dK)[1], exact_K, h=0.03)
    cross = np.linalg.norm(np.cross(T, K), axis=1) ** 2 / np.linalg.norm(T, axis=1) ** 4
    assert abs(energy_of(POINTS, at_points(T, K)) - cross.sum()) <= 1e2 * IDENTITY * cross.max()
    assert np.abs(curvature_squared(T, K) - cross).max() <= 1e2 * IDENTITY * cross.max()


def test_stretch_of_a_straight_thread() -> None:
    """Independent check: uniform stretch λ stores ½EA L (½(λ² − 1))² and pulls with EA ε λ at the ends only."""
    thread = thread_on(KNOTS, SECTIONS["both"])
    stretch, L = 1.07, 1.0
    q = stretch * straight(thread.spline)
    strain = 0.5 * (stretch**2 - 1.0)
    assert abs(energy(thread, q) / (0.5 * thread.EA * strain**2 * L) - 1.0) <= IDENTITY
    pull = np.zeros((thread.n, 3))
    pull[[0, -1], 0] = thread.EA * strain * stretch * np.array([-1.0, 1.0])
    assert np.abs(gradient(thread, q) - pull).max() <= IDENTITY * thread.EA


def test_bending_energy_of_an_arc() -> None:
    """Independent check: EI φ²/2L for an arc of angle φ. The points interpolate it: κ is off by O(h²) in the end
    spans and by less on the mean of the others, so the energy is off by O(h³)."""
    angle = 2.0

    def error(n: int) -> float:
        thread = uniform(1.0, n, Strand(EA=0.0, EI=0.7))
        s = greville(thread.spline)
        basis = BSpline(thread.spline.knots, np.eye(n), 3)(s)
        arc = np.column_stack([np.sin(angle * s), 1.0 - np.cos(angle * s), 0.0 * s]) / angle
        return energy(thread, np.linalg.solve(basis, arc)) / (0.5 * 0.7 * angle**2) - 1.0

    coarse, fine = abs(error(35)), abs(error(67))
    assert fine < 1e-5
    assert abs(np.log2(coarse / fine) - 3.0) < ORDER


@pytest.mark.parametrize("seed", range(3))
def test_energy_does_not_see_a_rigid_motion(thread: Thread, seed: int) -> None:
    """Independent check: energy unchanged, forces turned along, their sum and moment zero."""
    q = bent(thread.spline, seed)
    turn = Rotation.from_quat(np.random.default_rng(seed).standard_normal(4)).as_matrix()
    moved = q @ turn.T + np.array([0.3, -2.0, 1.0])
    force = gradient(thread, q)
    scale = np.abs(force).max()
    assert abs(energy(thread, moved) / energy(thread, q) - 1.0) <= 10 * IDENTITY
    assert np.abs(gradient(thread, moved) - force @ turn.T).max() <= 10 * IDENTITY * scale
    assert np.abs(force.sum(axis=0)).max() <= 10 * IDENTITY * scale
    assert np.abs(np.cross(q, force).sum(axis=0)).max() <= 10 * IDENTITY * scale


def test_no_energy_mode_but_the_rigid_ones() -> None:
    """Independent check: the reduced rule leaves a stretched straight thread with six motions without stiffness, no
    more (no hourglass); three translations, three turns, of which one is about its own axis and moves nothing."""
    thread = uniform(1.0, 14, SECTIONS["both"])
    H = hessian(thread, straight(thread.spline))
    stiffness = np.sort(np.linalg.eigvalsh(H)) / np.abs(H).max()
    assert np.all(np.abs(stiffness[:5]) < 1e-10)
    assert stiffness[5] > 1e-6


def test_mass_matrix_is_the_integral() -> None:
    """Independent check: ∫ρA b_i b_j by eight Gauss points a span and another B-spline code; its sum is the mass."""
    thread = thread_on(KNOTS, PP, point_masses=(2e-6, 5e-6))
    x, w = np.polynomial.legendre.leggauss(8)
    breaks = np.unique(KNOTS)
    s = (0.5 * (breaks[:-1] + breaks[1:])[:, None] + 0.5 * np.diff(breaks)[:, None] * x).ravel()
    b = BSpline(KNOTS, np.eye(thread.n), 3)(s)
    exact = PP.rhoA * (b.T * (0.5 * np.diff(breaks)[:, None] * w).ravel()) @ b
    exact[0, 0] += 2e-6
    exact[-1, -1] += 5e-6
    M = thread.mass_matrix.toarray()
    assert np.abs(M - exact).max() <= IDENTITY * exact.max()
    assert abs(M.sum() / (PP.rhoA * 1.0 + 7e-6) - 1.0) <= IDENTITY
    assert np.abs(dense(thread.mass_band) - np.kron(M, np.eye(3))).max() <= IDENTITY * exact.max()


def test_kinetic_energy_of_a_rigid_motion() -> None:
    """Independent check: a straight thread turning about its middle while it moves: ½mV² + ½(mL²/12)ω², exact."""
    thread = thread_on(KNOTS, PP)
    q = straight(thread.spline) - np.array([0.5, 0.0, 0.0])
    V, omega = np.array([0.3, -0.2, 0.5]), np.array([0.0, 2.0, -1.5])
    v = V + np.cross(omega, q)
    exact = 0.5 * PP.rhoA * (V @ V + omega @ omega / 12.0)
    assert abs(0.5 * np.sum(v * (thread.mass_matrix @ v)) / exact - 1.0) <= IDENTITY


def test_without_bending_there_is_none() -> None:
    """Consistency check: `bending` False is EI = 0."""
    off, zero = thread_on(KNOTS, SECTIONS["both"], bending=False), thread_on(KNOTS, SECTIONS["axial"])
    q = bent(off.spline)
    assert energy(off, q) == energy(zero, q) > 0.0
    assert np.array_equal(hessian(off, q), hessian(zero, q))


@pytest.mark.parametrize("options", [{"damping": -1.0}, {"damping": np.nan}, {"point_masses": (0.0, -1e-3)}])
def test_bad_threads_are_refused(options: dict) -> None:
    """Independent check: damping and masses that cannot be."""
    with pytest.raises(ThreadError):
        thread_on(KNOTS, PP, **options)


@pytest.mark.parametrize("repeats", [1, 2, 3])
def test_uniform_tension_on_uneven_and_repeated_knots(repeats: int) -> None:
    """Independent check: a straight thread under uniform strain is pulled at its ends only, whatever its knots."""
    knots = np.concatenate([np.zeros(4), [0.1, 0.25], np.full(repeats, 0.4), [0.5, 0.75, 0.9], np.ones(4)])
    thread = thread_on(knots, SECTIONS["both"])
    inner = gradient(thread, 1.05 * straight(thread.spline))[1:-1]
    assert np.abs(inner).max() <= IDENTITY * thread.EA
