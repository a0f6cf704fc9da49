"""Twist of the thread: the reference frame and its derivatives, torsion waves, and how twisted rods buckle."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import eigh
from scipy.optimize import brentq

from coupling.reports.audit import audit_step, initial_energies
from coupling.rest.equilibrium import settle
from tests.bounds import IDENTITY, LINEAR, RESIDUAL, TWISTED
from tests.thread.threads import (
    ORIGIN,
    PP,
    Path,
    Strand,
    X,
    assert_derivatives,
    assert_slope,
    bent,
    dense,
    greville,
    laid,
    line,
    load_step,
    run,
    stiffness,
    straight,
    thread_on,
    uniform,
    without_organ,
)
from thread.ends import Clamped, Driven, Fixed, Free, Pulled
from thread.energies.torsion import Torsion
from thread.errors import ThreadError
from thread.frames import Frame, reference_twist, reference_twist_derivatives, turned
from thread.knots import clamped_knots
from thread.thread import Thread
from thread.vectors import unit_vector

L, N = 0.1, 40
SOFT = Strand(rhoA=0.01, EA=3.0, EI=0.02)
KNOTS = clamped_knots(np.array([0.0, 0.1, 0.18, 0.3, 0.3, 0.45, 0.5, 0.7, 0.9, 1.0]))
TWISTING = Strand(EA=3.0, EI=0.02, GJ=0.03)


def twisted(seed: int = 0) -> tuple[Thread, np.ndarray, Frame]:
    """A thread in no special shape, with angles of no special kind, its frame that of another shape."""
    thread = thread_on(KNOTS, TWISTING, twist=True)
    rng = np.random.default_rng(seed)
    old, new = (np.column_stack([bent(thread.spline, s), rng.standard_normal(thread.n)]) for s in (seed, seed + 9))
    frame = thread.untwisted_frame(old)
    assert frame is not None
    return thread, new, replace(frame, tau=rng.standard_normal(frame.tau.shape))


@pytest.mark.parametrize("seed", range(3))
def test_twist_of_the_carried_frame(seed: int) -> None:
    """Independent check: the frame is turned by the smallest rotation at every s; the twist a₁'·a₂ of the turned frame,
    by central differences along s, is what the formula says."""
    rng = np.random.default_rng(seed)
    w = rng.uniform(-1.0, 1.0, (2, 3, 3))

    def tangent(k: int, s: float) -> np.ndarray:
        return unit_vector(np.array([1.0, 0.0, 0.0]) + w[k, 0] * np.sin(s) + w[k, 1] * s + 0.2 * w[k, 2] * s**2)

    def frame_at(s: float) -> np.ndarray:
        """A frame along the old tangents, twisted at the rate that its own derivative tells."""
        t = tangent(0, s)
        a = unit_vector(np.cross(t, np.array([0.3, 0.2, 0.9])))
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
    T = 1.5 * unit_vector(t_o + 0.7 * unit_vector(T))
    frame = Frame(unit_vector(t_o), x, rng.standard_normal(5), x)
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
    assert_derivatives(thread, frame, q, d)


def test_carrying_the_frame_changes_no_energy() -> None:
    """Independent check: energy and torque are the same from the frame of the start of a step and from that of its end.
    (The forces are those at a fixed θ, which is another turn of the section from each.)"""
    thread, q, frame = twisted()
    before, after = (thread.points(q, x) for x in (frame, thread.transport_frame(frame, q)))
    assert abs(thread.energy(after) / thread.energy(before) - 1.0) <= 10 * IDENTITY
    torque = thread.gradient(before)[:, 3]
    assert np.abs(thread.gradient(after)[:, 3] - torque).max() <= 100 * IDENTITY * np.abs(torque).max()


def test_a_thread_with_twist_asks_for_its_frame() -> None:
    """Independent check: without it there is no energy; and a string cannot be twisted."""
    thread, q, _ = twisted()
    with pytest.raises(ThreadError, match="frame"):
        thread.points(q)
    with pytest.raises(ThreadError, match="bending"):
        thread_on(KNOTS, TWISTING, twist=True, bending=False)


def test_audit_of_a_twisted_thread_closes() -> None:
    """Independent check: a bent, twisted thread is let go, moves and spins; each step's energy is accounted for, and a
    force-free thread keeps its momentum."""
    thread = uniform(1.0, 12, replace(SOFT, GJ=0.015, diameter=0.3), twist=True)
    system = without_organ(thread)
    state = laid(system, [], line(ORIGIN, X))
    q = np.column_stack([bent(thread.spline), 6.0 * np.sin(3.0 * greville(thread.spline))])
    frame = thread.untwisted_frame(q)
    v = np.column_stack([np.cross([0.0, 1.0, 2.0], q[:, :3]), 5.0 * q[:, 0]])
    state = replace(state, q=q, v=v, frame=frame, N=thread.EA * thread.points(q, frame).strain)
    steps = run(system, state, 2e-3, 40)
    energies = [initial_energies(system, state)]
    for step in steps:
        energies.append(audit_step(system, energies[-1], step))
    scale = energies[0].kinetic + energies[0].elastic_thread
    assert np.abs(np.diff([e.balance_error for e in energies])).max() <= IDENTITY * scale
    momenta = np.array([thread.momentum(step.new.v)[:, :3].sum(axis=0) for step in steps])
    assert np.abs(np.diff(momenta, axis=0)).max() <= 10 * IDENTITY * np.abs(thread.momentum(v)[:, :3]).sum()
    assert Torsion(thread.stations, 0.015).energy(steps[0].solution.residual.points.at[1]) > 1e-2 * scale
    before, after = (x.frame for x in (steps[0].old, steps[-1].new))
    assert before is not None and after is not None
    assert np.vecdot(before.t, after.t).min() < 0.9, "the tangents turned, so the frame had to follow"


# -- small vibration and buckling: the thread's own matrices -----------------------------------------------------------


def test_torsional_vibration() -> None:
    """Independent check: a straight rod held at one end, f = c/4L, 3c/4L, 5c/4L with c = √(GJ/ρJ)."""
    thread = uniform(L, N, twist=True)
    system = without_organ(thread, (Clamped(ORIGIN, X), Free()))
    state = laid(system, [], line(ORIGIN, X))
    spin = np.setdiff1d(np.arange(3, 4 * N, 4), system.held)
    points = thread.points(state.q, state.frame)
    K, M = (dense(x)[np.ix_(spin, spin)] for x in (thread.tangent(points, thread.EA * points.strain), thread.mass_band))
    f = np.sqrt(eigh(K, M, eigvals_only=True)[:3]) / (2.0 * np.pi)
    exact = np.sqrt(PP.GJ / PP.rhoJ) / (4.0 * L) * np.array([1, 3, 5])
    assert np.abs(f / exact - 1.0).max() < 1e-5


def greenhill(T: float) -> float:
    """Critical torque M L/EI of a rod clamped at both ends under the tension T L²/EI.

    The deflection w = y + i z obeys EI w⁽⁴⁾ − i M w⁽³⁾ − T w⁽²⁾ = 0, so w = 1, x, exp(i k x) with EI k² − M k + T = 0.
    """

    def mismatch(M: float) -> float:
        d = np.sqrt(complex(M * M - 4.0 * T))
        a, b = 0.5 * (M + d), 0.5 * (M - d)
        A, B = np.exp(1j * a), np.exp(1j * b)
        rows = [[1, 0, 1, 1], [0, 1, 1j * a, 1j * b], [1, 1, A, B], [0, 1, 1j * a * A, 1j * b * B]]
        return float((np.linalg.det(np.array(rows)) * np.exp(-0.5j * (a + b))).imag)  # turned so, it is imaginary

    M = np.linspace(2.0 * np.sqrt(T) + 0.05, 2.0 * np.sqrt(T) + 12.0, 2401)
    first = int(np.flatnonzero(np.diff(np.sign([mismatch(x) for x in M])))[0])
    return float(brentq(mismatch, M[first], M[first + 1]))


@pytest.mark.parametrize("T", [0.0, 40.0, 400.0])
def test_greenhill(T: float) -> None:
    """Independent check: the torque that buckles a straight rod clamped at both ends, under no tension
    (tan(ML/2EI) = ML/2EI, M = 8.98682 EI/L), and under tension, where it tends to 2√(EI T)."""
    exact = greenhill(T) if T else 8.98682
    assert abs(greenhill(1e-3) - 8.98682) < 1e-3
    thread = uniform(L, N, twist=True)
    system = without_organ(thread, (Clamped(ORIGIN, X), Clamped(L * X, X)))
    state = laid(system, [], line(ORIGIN, X))
    stretch = 1.0 + T * PP.EI / (L**2 * PP.EA)

    def at(angle: float) -> np.ndarray:
        s = greville(thread.spline)
        q = np.column_stack([stretch * straight(thread.spline), angle * s / L])
        return stiffness(system, replace(state, q=q, frame=thread.untwisted_frame(q)))

    K = at(0.0)
    angle = 1.0 / eigh(K - at(1.0), K, eigvals_only=True)[-1]  # the stiffness is linear in the twist
    assert abs(angle * PP.GJ / PP.EI / exact - 1.0) < TWISTED


def circle(length: float) -> Path:
    """A ring that leaves the origin along x."""
    R = length / (2.0 * np.pi)
    return lambda s: R * np.stack([np.sin(s / R), 0.0 * s, 1.0 - np.cos(s / R)], axis=-1)


@pytest.mark.parametrize("ratio", [0.5, 0.714])
def test_michell(ratio: float) -> None:
    """Independent check: a ring closed with the twist 2π√3 EI/GJ loses its stability. A thread clamped at both ends in
    one place is a closed ring: a rigid motion brings any ring's one section there. One motion costs nothing, the turn
    of the ring about the clamp's tangent while the sections turn back."""
    section = replace(PP, GJ=ratio * PP.EI)
    critical = 2.0 * np.pi * np.sqrt(3.0) / ratio
    turn = np.array([[0.0, 0.0], [1.0, (1.0 + TWISTED) * critical]])
    system = without_organ(uniform(L, N, section, twist=True), (Clamped(ORIGIN, X), Clamped(ORIGIN, X, turn=turn)))
    state = laid(system, [], circle(L))
    lowest = []
    for angle in (0.3, 0.6, 1.0 - TWISTED, 1.0 + TWISTED):
        # beyond the limit a load step would be halved, and leave the flat ring
        state = settle(system, state, angle / (1.0 + TWISTED), 1.0).new
        assert abs(state.reaction[1, 3] / (section.GJ * angle * critical / L) - 1.0) < LINEAR
        lowest.append(eigh(stiffness(system, state), eigvals_only=True)[:2])
    scale = lowest[0][1]
    assert scale > 0.0
    assert abs(lowest[2][0]) < 1e-6 * scale < lowest[2][1]
    assert lowest[3][0] < -1e-6 * scale


def test_localised_helix() -> None:
    """Independent check: a long twisted rod under tension forms one helix whose envelope is a sech (Coyne 1990; van der
    Heijden & Thompson 2000). With m = M/√(EI T), a² = 1 − m²/4 and λ = √(EI/T): sin(β/2) = a sech(a s/λ), β the angle
    to the axis, ends drawn together by 4aλ and turned by ML/GJ + 4 arccos(m/2). Both are imposed; M, T, β come out."""
    m, decay = 1.6, 0.06 * L
    a, T = np.sqrt(1.0 - m * m / 4.0), PP.EI / decay**2
    M, shortening = m * np.sqrt(PP.EI * T), 4.0 * a * decay
    turn = np.array([[0.0, 0.0], [1.0, M * L / PP.GJ + 4.0 * np.arccos(m / 2.0)]])
    thread = uniform(L, N, twist=True)
    system = without_organ(thread, (Clamped(ORIGIN, X), Clamped((L - shortening) * X, X, turn=turn)))
    state = laid(system, [], wave(L, L - shortening))
    for share in np.arange(1, 21) / 20:
        state = load_step(system, state, share, 1.0)[-1].new
    assert abs(state.reaction[1, 0] / T - 1.0) < TWISTED
    assert abs(state.reaction[1, 3] / M - 1.0) < TWISTED
    s = np.linspace(0.0, L, 201)
    t = unit_vector(thread.spline.curve(state.q[:, :3], s)[:, 1])
    envelope = np.sqrt(0.5 * (1.0 - t[:, 0]))
    assert np.abs(envelope - a / np.cosh(a * (s - 0.5 * L) / decay)).max() < TWISTED
    assert np.abs(state.q[:, 1]).max() > 0.02 * L


def wave(length: float, distance: float) -> Path:
    """One wave of a cosine over a distance, as long as the thread, by arc length."""
    x = np.linspace(0.0, 1.0, 4001)

    def drawn(height: float) -> tuple[np.ndarray, np.ndarray]:
        places = np.stack([distance * x, 0.0 * x, height * (1.0 - np.cos(2.0 * np.pi * x))], axis=-1)
        return places, np.append(0.0, np.cumsum(np.linalg.norm(np.diff(places, axis=0), axis=1)))

    places, s = drawn(float(brentq(lambda height: drawn(height)[1][-1] - length, 0.0, length)))
    return lambda at: np.stack([np.interp(at, s, places[:, k]) for k in range(3)], axis=-1)


def test_a_needle_turns_the_thread() -> None:
    """Independent check: a driven end turned slowly, the other held: the torque GJ φ/L arrives at both, and the work of
    the fingers is ½GJ φ²/L but for what the integrator took."""
    turn = np.array([[0.0, 0.0], [0.2, 3.0]])
    hand = Driven(np.array([[0.0, *(L * X)]]), turn=turn)
    system = without_organ(uniform(L, 12, twist=True), (Clamped(ORIGIN, X), hand))
    state = laid(system, [], line(ORIGIN, X))
    energies = initial_energies(system, state)
    for step in run(system, state, 5e-3, 80):
        energies = audit_step(system, energies, step)
    torque, stored = PP.GJ * 3.0 / L, 0.5 * PP.GJ * 9.0 / L
    state = step.new
    assert np.abs(state.reaction[:, 3] / torque - [-1.0, 1.0]).max() < LINEAR
    assert abs(energies.elastic_thread / stored - 1.0) < LINEAR
    assert abs(energies.external_work - energies.numerical_dissipation - stored) < LINEAR * stored
    assert state.frame is not None
    assert np.abs(system.thread.torque(state.q, state.frame) / torque - 1.0).max() < LINEAR


def test_a_clamp_holds_place_direction_and_section() -> None:
    """Independent check: at every step of a thread thrown about by its free end, while the clamp turns it."""
    turn = np.array([[0.0, 0.0], [0.02, 1.5]])
    ends = (Clamped(ORIGIN, X, turn=turn), Pulled(np.array([0.0, 2e-3, 3e-3]), np.array([[0.0, 0.0], [0.01, 1.0]])))
    system = without_organ(uniform(L, 20, twist=True), ends)
    state = laid(system, [], line(ORIGIN, X))
    for step in run(system, state, 2e-3, 15):
        new = step.new
        T = system.thread.spline.curve(new.q[:, :3], [0.0])[0, 1]
        assert np.array_equal(new.q[0, :3], ORIGIN)
        assert np.abs(T[1:]).max() <= RESIDUAL
        assert abs(new.q[0, 3] - min(1.5, 75.0 * new.time)) <= IDENTITY
        assert new.reaction[1, 3] == 0.0
    assert np.abs(new.q[-1, 1:3]).max() > 0.1 * L


@pytest.mark.parametrize("turn", [np.zeros((2, 2)), np.zeros((2, 3)), np.array([[0.0, 1.0]])])
def test_bad_turns_are_refused(turn: np.ndarray) -> None:
    """Independent check: times that rest, a wrong shape, an angle at the start."""
    with pytest.raises(ThreadError):
        Fixed(ORIGIN, turn=turn)
