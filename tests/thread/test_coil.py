"""Rest curvature: derivatives by slope, and a thread that coils as its packet made it."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_bvp
from scipy.spatial.transform import Rotation

from coupling.system import State, System
from tests.bounds import IDENTITY, LINEAR
from tests.thread.threads import (
    ORIGIN,
    PP,
    Strand,
    X,
    Y,
    Z,
    assert_derivatives,
    assert_slope,
    bent,
    laid,
    line,
    load_step,
    thread_on,
    uniform,
    without_organ,
)
from thread.ends import Clamped, End, Free, Pulled
from thread.energies.coil import curvature_along, curvature_along_derivatives, direction
from thread.errors import ThreadError
from thread.frames import turned
from thread.knots import clamped_knots
from thread.vectors import unit_vector

KNOTS = clamped_knots(np.array([0.0, 0.1, 0.18, 0.3, 0.3, 0.45, 0.5, 0.7, 0.9, 1.0]))
L = 0.1


@pytest.mark.parametrize("seed", range(3))
def test_curvature_along_a_material_direction(seed: int) -> None:
    """Independent check: with both directions of the turned frame, k₁² + k₂² is κ², and k₁ is that of the turned
    vector; derivatives by central differences."""
    rng = np.random.default_rng(seed)
    T, K, dT, dK, x, y = rng.standard_normal((6, 5, 3))
    t_o = unit_vector(T + 0.7 * unit_vector(x))
    p = unit_vector(np.cross(t_o, y))
    k_1, k_2 = (curvature_along(T, K, d, t_o) for d in (p, np.cross(t_o, p)))
    kappa = np.linalg.norm(np.cross(T, K), axis=-1) / np.linalg.norm(T, axis=-1) ** 2
    assert np.abs((k_1**2 + k_2**2) / kappa**2 - 1.0).max() <= 10 * IDENTITY
    exact = np.vecdot(K, turned(p, t_o, unit_vector(T))) / np.linalg.norm(T, axis=-1)
    assert np.abs(k_1 - exact).max() <= 10 * IDENTITY * np.abs(exact).max()
    by_T, by_K, TT, TK = curvature_along_derivatives(T, K, p, t_o)
    slope = (by_T * dT + by_K * dK).sum(axis=1)
    assert_slope(lambda h: curvature_along(T + h * dT, K + h * dK, p, t_o), slope, h=0.03)
    slope = np.einsum("mij,mj->mi", TT, dT) + np.einsum("mij,mj->mi", TK, dK)
    assert_slope(lambda h: curvature_along_derivatives(T + h * dT, K + h * dK, p, t_o)[0], slope, h=0.03)
    slope = np.einsum("mji,mj->mi", TK, dT)
    assert_slope(lambda h: curvature_along_derivatives(T + h * dT, K + h * dK, p, t_o)[1], slope, h=0.03)


@pytest.mark.parametrize("springs", [None, 20])
def test_derivatives_of_the_energy(springs: int | None) -> None:
    """Independent check: force, torque and tangent by central differences, from the frame of another shape."""
    thread = thread_on(KNOTS, Strand(EA=3.0, EI=0.02, GJ=0.03), twist=True, coil=7.0, springs=springs)
    rng = np.random.default_rng(2)
    q = np.column_stack([bent(thread.spline), rng.standard_normal(thread.n)])
    frame = thread.untwisted_frame(q)
    q, d = q + 0.02 * rng.standard_normal(q.shape), 0.01 * rng.standard_normal(q.shape)
    points = assert_derivatives(thread, frame, q, d)
    assert frame is not None
    assert np.abs(np.vecdot(direction(points.at[-1].theta, frame)[0], frame.t)).max() <= IDENTITY


def coiling(kappa: float, end: End, towards: np.ndarray = Z, n: int = 40) -> System:
    """Clamped at the origin along x, wanting to bend `towards`."""
    thread = uniform(L, n, PP, twist=True, coil=kappa, coil_towards=towards)
    return without_organ(thread, (Clamped(ORIGIN, X), end))


def settled(system: System, steps: int = 4) -> State:
    """From straight to equilibrium, under loads that grow in steps."""
    state = laid(system, [], line(ORIGIN, X))
    for k in range(1, steps + 1):
        state = load_step(system, state, k / steps, 1.0)[-1].new
    return state


@pytest.mark.parametrize("towards", [Z, np.array([0.3, 0.6, -0.8])])
def test_a_straightened_thread_coils(towards: np.ndarray) -> None:
    """Independent check: let go, it is an arc of the packet's radius in the plane of the clamp's section, without
    energy; the straight thread had stored ½EI κ̄² L."""
    kappa = 15.0
    system = coiling(kappa, Free(), towards)
    before = laid(system, [], line(ORIGIN, X))
    stored = system.thread.energy(system.thread.points(before.q, before.frame))
    assert abs(stored / (0.5 * PP.EI * kappa**2 * L) - 1.0) < LINEAR
    state = settled(system, 1)
    side = unit_vector(towards - towards[0] * X)
    tip = (np.sin(kappa * L) * X + (1.0 - np.cos(kappa * L)) * side) / kappa
    assert np.linalg.norm(state.q[-1, :3] - tip) < 1e-5 * L
    assert system.thread.energy(system.thread.points(state.q, state.frame)) < 1e-6 * stored


def test_a_pulled_coil() -> None:
    """Independent check: the planar elastica with rest curvature, EI θ'' = F sin θ, θ(0) = 0, θ'(L) = κ̄, solved by
    collocation."""
    kappa, F = 25.0, 4.0 * PP.EI / L**2
    state = settled(coiling(kappa, Pulled(F * X)))

    def slopes(s: np.ndarray, y: np.ndarray) -> np.ndarray:
        return np.array([y[1], 4.0 * np.sin(y[0]), np.cos(y[0]), np.sin(y[0])])

    def ends(a: np.ndarray, b: np.ndarray) -> np.ndarray:
        return np.array([a[0], b[1] - kappa * L, a[2], a[3]])

    s = np.linspace(0.0, 1.0, 50)
    exact = solve_bvp(slopes, ends, s, np.array([0.5 * s**2, s, s, 0.1 * s]), tol=1e-9, max_nodes=10**5)
    assert exact.success
    tip = np.array([exact.y[2, -1], 0.0, exact.y[3, -1]])
    assert np.abs(state.q[-1, :3] / L - tip).max() < 1e-4
    assert abs(tip[2]) > 0.1


def test_turning_the_clamp_turns_the_coil() -> None:
    """Independent check: a quarter of a turn of the clamped section turns the arc by a quarter about the clamp's
    tangent, and leaves no torque."""
    kappa = 15.0
    quarter = np.array([[0.0, 0.0], [1.0, 0.5 * np.pi]])
    still = coiling(kappa, Free())
    turning = replace(still, ends=(Clamped(ORIGIN, X, turn=quarter), Free()))
    one = settled(still, 1).q[:, :3]
    state = laid(still, [], line(ORIGIN, X))
    state = load_step(still, state, 1e-6, 1.0)[-1].new
    for k in range(1, 9):
        state = load_step(turning, state, k / 8, 1.0)[-1].new
    turn = Rotation.from_rotvec(0.5 * np.pi * X).as_matrix()
    assert np.abs(state.q[:, :3] - one @ turn.T).max() < 1e-4 * L
    assert abs(one[-1] @ Y) < 1e-6 * L < 0.5 * abs(state.q[-1, 1])
    assert np.abs(state.reaction[:, 3]).max() < 1e-4 * PP.EI * kappa


def test_coil_without_twist_is_refused() -> None:
    """Independent check: without an angle of the section there is no side to coil to; nor along the thread."""
    with pytest.raises(ThreadError, match="twist"):
        uniform(L, 12, coil=10.0)
    with pytest.raises(ThreadError, match="along the thread"):
        laid(coiling(10.0, Free(), X), [], line(ORIGIN, X))
