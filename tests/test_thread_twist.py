"""Twist of the thread: the reference frame and its derivatives, torsion waves, and the instabilities of twisted rods."""

from dataclasses import replace

import numpy as np
import pytest
from bounds import IDENTITY
from scipy.spatial.transform import Rotation
from threads import Strand, assert_slope, bent, dense, thread_on

from thread.spline import clamped
from thread.thread import Thread
from thread.twist import Frame, reference_twist, reference_twist_derivatives, turned, unit

KNOTS = clamped(np.array([0.0, 0.1, 0.18, 0.3, 0.3, 0.45, 0.5, 0.7, 0.9, 1.0]))
TWISTING = Strand(EA=3.0, EI=0.02, GJ=0.03)


def twisted(seed: int = 0) -> tuple[Thread, np.ndarray, Frame]:
    """A thread in no special shape, with angles of no special kind, its frame that of another shape."""
    thread = thread_on(KNOTS, TWISTING, twist=True)
    rng = np.random.default_rng(seed)
    old, new = (np.column_stack([bent(thread.spline, s), rng.standard_normal(thread.n)]) for s in (seed, seed + 9))
    frame = thread.untwisted(old)
    assert frame is not None
    return thread, new, replace(frame, tau=rng.standard_normal(frame.tau.shape))


@pytest.mark.parametrize("seed", range(3))
def test_twist_of_the_carried_frame(seed: int) -> None:
    """Independent check: the frame is turned by the smallest rotation at every s; the twist a₁'·a₂ of the turned frame,
    by central differences along s, is what the formula says."""
    rng = np.random.default_rng(seed)
    w = rng.uniform(-1.0, 1.0, (2, 3, 3))

    def tangent(k: int, s: float) -> np.ndarray:
        return unit(np.array([1.0, 0.0, 0.0]) + w[k, 0] * np.sin(s) + w[k, 1] * s + 0.2 * w[k, 2] * s**2)

    def frame_at(s: float) -> np.ndarray:
        """A frame along the old tangents, twisted at the rate that its own derivative tells."""
        t = tangent(0, s)
        a = unit(np.cross(t, np.array([0.3, 0.2, 0.9])))
        a = np.cos(2.0 * s) * a + np.sin(2.0 * s) * np.cross(t, a)
        return np.array([a, np.cross(t, a)])

    def carried_at(s: float) -> np.ndarray:
        t_o, t = tangent(0, s), tangent(1, s)
        return np.array([turned(a, t_o, t) for a in frame_at(s)])

    h, s = 1e-4, 0.3
    rate = lambda f: (f(s + h) - f(s - h)) / (2 * h)  # noqa: E731
    frame = Frame(tangent(0, s), rate(lambda x: tangent(0, x)), rate(frame_at)[0] @ frame_at(s)[1], frame_at(s)[0])
    stretch = 1.3
    T, K = stretch * tangent(1, s), stretch * rate(lambda x: tangent(1, x)) + 0.7 * tangent(1, s)
    exact = rate(carried_at)[0] @ carried_at(s)[1]
    assert abs(exact - frame.tau) > 1e-2
    assert abs(reference_twist(T, K, frame) - exact) < 1e-6
    assert np.abs(np.linalg.det([*carried_at(s), tangent(1, s)]) - 1.0) <= 10 * IDENTITY


@pytest.mark.parametrize("seed", range(3))
def test_derivatives_of_the_reference_twist(seed: int) -> None:
    """Independent check: by central differences, at tangents far from unit length."""
    rng = np.random.default_rng(seed)
    T, K, dT, dK, t_o, x = rng.standard_normal((6, 5, 3))
    T = 1.5 * unit(t_o + 0.7 * unit(T))
    frame = Frame(unit(t_o), x, rng.standard_normal(5), x)
    by_T, by_K, TT, TK = reference_twist_derivatives(T, K, frame)
    assert_slope(lambda h: reference_twist(T + h * dT, K + h * dK, frame), (by_T * dT + by_K * dK).sum(axis=1), h=0.03)
    exact = np.einsum("mij,mj->mi", TT, dT) + np.einsum("mij,mj->mi", TK, dK)
    assert_slope(lambda h: reference_twist_derivatives(T + h * dT, K + h * dK, frame)[0], exact, h=0.03)
    exact = np.einsum("mji,mj->mi", TK, dT)
    assert_slope(lambda h: reference_twist_derivatives(T + h * dT, K + h * dK, frame)[1], exact, h=0.03)


@pytest.mark.parametrize("seed", range(3))
def test_derivatives_of_the_energy_with_twist(seed: int) -> None:
    """Independent check: force and torque are the slope of the energy, the tangent that of both; it is symmetric."""
    thread, q, frame = twisted(seed)
    d = 0.02 * np.random.default_rng(seed).standard_normal(q.shape)
    gradient = lambda x: thread.gradient(thread.points(x, frame))  # noqa: E731
    assert_slope(lambda h: np.array(thread.energy(thread.points(q + h * d, frame))), np.array(np.sum(gradient(q) * d)))
    points = thread.points(q, frame)
    H = dense(thread.tangent(points, thread.EA * points.strain))
    assert_slope(lambda h: gradient(q + h * d).ravel(), H @ d.ravel())
    assert np.abs(H - H.T).max() <= IDENTITY * np.abs(H).max()


def test_carrying_the_frame_changes_no_energy() -> None:
    """Independent check: the twist is the same from the frame of the start of a step and from that of its end; and the
    energy does not see a rigid motion, carried in many small turns, but for the angle that frame and section share."""
    thread, q, frame = twisted()
    energy = thread.energy(thread.points(q, frame))
    after = thread.carried(frame, q)
    assert abs(thread.energy(thread.points(q, after)) / energy - 1.0) <= 10 * IDENTITY
    force = thread.gradient(thread.points(q, after))
    for _ in range(7):
        turn = Rotation.from_rotvec([0.4, -0.3, 0.8]).as_matrix()
        q = np.column_stack([q[:, :3] @ turn.T, q[:, 3]])
        moved = thread.points(q, after)
        after = thread.carried(after, q)
        force[:, :3] = force[:, :3] @ turn.T
    del moved, energy
