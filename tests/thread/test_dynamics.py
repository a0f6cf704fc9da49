"""Motion of a thread without piercings. Backward Euler's own solution is known in closed form in every case here, so
the comparison is exact in time and the physics is not hidden behind its damping."""

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from coupling.reports.audit import audit_step, initial_energies
from coupling.step.stepping import Step
from coupling.system import State, System
from tests.bounds import IDENTITY, ORDER, TWO_SOLVERS
from tests.thread.threads import ORIGIN, PP, Strand, X, Y, Z, bent, laid, line, run, straight, uniform, without_organ
from thread.ends import Clamped, Driven, Fixed, Free, Pulled
from thread.errors import ThreadError

SOFT = Strand(rhoA=0.01, EA=3.0, EI=0.02)  # over a metre: waves in stretch and bending within a second


def free_thread(
    n: int = 12, gravity: float = 0.0, damping: float = 0.0, section: Strand = SOFT
) -> tuple[System, State]:
    """A metre of soft thread in space, straight and at rest."""
    system = without_organ(uniform(1.0, n, section, damping=damping), gravity=-gravity * Z)
    state = laid(system, [], line(ORIGIN, X))
    return system, replace(state, q=straight(system.thread.spline))


def thrown() -> tuple[System, list[Step]]:
    """A bent thread let go while it moves and turns."""
    system, state = free_thread()
    q = bent(system.thread.spline)
    v = np.array([0.5, -0.2, 0.3]) + np.cross([0.0, 1.0, 2.0], q) + 0.1 * q[::-1]
    points = system.thread.points(q)
    return system, run(system, replace(state, q=q, v=v, N=SOFT.EA * points.strain), 5e-3, 40)


def oscillation(x: np.ndarray, dt: float) -> np.ndarray:
    """ω² from three positions of a linear oscillator under backward Euler: its equation, solved for ω²."""
    return -(x[2:] - 2.0 * x[1:-1] + x[:-2]) / (dt**2 * x[2:])


def test_linear_momentum_is_conserved() -> None:
    """Independent check: a free thread; per step, relative to ∫|v| dm."""
    system, steps = thrown()
    M = system.thread.mass_matrix
    momenta = np.array([(M @ step.new.v).sum(axis=0) for step in steps])
    momenta = np.concatenate([[(M @ steps[0].old.v).sum(axis=0)], momenta])
    assert np.linalg.norm(steps[0].new.v - steps[0].old.v) > 1e-2 * np.linalg.norm(steps[0].old.v)
    assert np.abs(np.diff(momenta, axis=0)).max() <= 10 * IDENTITY * np.abs(momenta).max()


def test_angular_momentum_falls_as_backward_euler_says() -> None:
    """Independent check: ΔL = Δt ∫ v⁺ × v dm in every step, since the elastic forces have no moment."""
    system, steps = thrown()
    M = system.thread.mass_matrix
    for step in steps:
        old, new = step.old, step.new
        before, after = (np.cross(x.q, M @ x.v).sum(axis=0) for x in (old, new))
        exact = step.dt * np.cross(new.v, M @ old.v).sum(axis=0)
        assert np.abs(after - before - exact).max() <= 100 * IDENTITY * np.abs(before).max()
    assert np.abs(exact).max() > 1e-6 * np.abs(before).max()


def test_audit_of_a_thrown_thread_closes() -> None:
    """Independent check: no work from outside, and each step the energy lost is the integrator's ½Δvᵀ M Δv plus what
    the elastic energy lies above its tangent; an exact bookkeeping must close and must not gain."""
    system, steps = thrown()
    energies = [initial_energies(system, steps[0].old)]
    for step in steps:
        energies.append(audit_step(system, energies[-1], step))
    scale = energies[0].kinetic + energies[0].elastic_thread
    errors = np.diff([e.balance_error for e in energies])
    assert np.abs(errors).max() <= IDENTITY * scale
    last = energies[-1]
    assert last.external_work == last.viscous_dissipation == last.friction_dissipation == 0.0
    lost = scale - last.kinetic - last.elastic_thread
    assert abs(last.numerical_dissipation / lost - 1.0) <= 100 * IDENTITY * scale / lost
    assert lost > 0.01 * scale


def test_free_fall() -> None:
    """Independent check: x = x₀ + v₀t − ½g t(t + Δt) Z, backward Euler's exact fall; the thread keeps its shape, and
    gravity's work is m g h."""
    system, state = free_thread(gravity=9.81)
    v = np.array([0.1, 0.2, 0.3])
    dt = 0.01
    state = replace(state, v=np.broadcast_to(v, state.q.shape))
    steps = run(system, state, dt, 25)
    energies = initial_energies(system, state)
    for k, step in enumerate(steps, 1):
        fallen = k * dt * v - 0.5 * 9.81 * dt**2 * k * (k + 1) * Z
        assert np.abs(step.new.q - state.q - fallen).max() <= 10 * IDENTITY
        energies = audit_step(system, energies, step)
    weight = SOFT.rhoA * 9.81
    assert abs(energies.external_work / (-weight * fallen[2]) - 1.0) <= 100 * IDENTITY
    assert abs(energies.balance_error) <= 100 * IDENTITY * energies.external_work


def test_damping_decays_exponentially() -> None:
    """Independent check: v = v₀/(1 + cΔt)ᵏ, backward Euler's exp(−ct), and the audit finds the loss viscous."""
    c, dt, steps = 3.0, 0.02, 20
    system, state = free_thread(damping=c)
    state = replace(state, v=np.broadcast_to(X + 2 * Y, state.q.shape))
    taken = run(system, state, dt, steps)
    for k, step in enumerate(taken, 1):
        assert np.abs(step.new.v - state.v / (1.0 + c * dt) ** k).max() <= 10 * IDENTITY
    energies = initial_energies(system, state)
    before = energies.kinetic
    for k, step in enumerate(taken, 1):
        energies = audit_step(system, energies, step)
        viscous = sum(SOFT.rhoA * 5.0 * c * dt / (1.0 + c * dt) ** (2 * j) for j in range(1, k + 1))
        assert abs(energies.viscous_dissipation / viscous - 1.0) <= 100 * IDENTITY
        assert abs(energies.balance_error) <= 10 * IDENTITY * before


def test_frequency_of_a_cantilever() -> None:
    """Independent check: ω₁ = 1.8751041² √(EI/ρA)/L² at small amplitude. Backward Euler has killed the higher modes
    when the frequency is read from its own recursion, so the step does not enter."""
    L, n = 0.1, 20
    section = Strand(EA=10.0)
    omega = 1.8751041**2 * np.sqrt(section.EI / section.rhoA) / L**2
    system = without_organ(uniform(L, n, section), (Clamped(ORIGIN, X), Free()))
    state = laid(system, [], line(ORIGIN, X))
    q = straight(system.thread.spline)
    x = q[:, :1] / L
    state = replace(state, q=q + 1e-5 * L * (x**2 * (6 - 4 * x + x**2) / 3) * Z, N=0.0 * state.N)
    dt = 2 * np.pi / omega / 50
    tip = np.array([state.q[-1, 2]] + [step.new.q[-1, 2] for step in run(system, state, dt, 90)])
    assert abs(tip[-1]) > 1e-7 * L
    squares = oscillation(tip, dt)[-25:][np.abs(tip[-25:]) > 0.2 * np.abs(tip[-25:]).max()]
    assert np.abs(np.sqrt(squares) / omega - 1.0).max() < 1e-5


def test_point_mass_pendulum() -> None:
    """Independent check: ω² = g (M + m/2)/(l (M + m/3)) of a mass M on a string of mass m, bending left out, at an
    amplitude of a thousandth; l is the length that the weight stretches it to, 4e-4 longer than at rest."""
    L, M, g = 0.1, 1e-2, 9.81
    m = PP.rhoA * L
    thread = uniform(L, 6, PP, bending=False, point_masses=(0.0, M))
    system = without_organ(thread, (Fixed(ORIGIN), Free()), gravity=-g * Z)
    state = laid(system, [], line(ORIGIN, np.array([1e-3, 0.0, -np.sqrt(1 - 1e-6)])))
    omega = np.sqrt(g * (M + m / 2) / (L * (1.0 + M * g / PP.EA) * (M + m / 3)))
    dt = 2 * np.pi / omega / 60
    x = np.array([step.new.q[-1, 0] for step in run(system, state, dt, 60)])
    squares = oscillation(x, dt)[-30:][np.abs(x[-30:]) > 0.2 * np.abs(x[-30:]).max()]
    assert np.abs(np.sqrt(squares) / omega - 1.0).max() < 1e-5


def test_first_order_in_time() -> None:
    """Independent check: three halvings of the step on a plucked string, stretched by a third and so soft that its
    waves are resolved; the differences halve, ± ORDER."""
    softer = Strand(rhoA=0.01, EA=0.03, EI=3e-5)
    thread = uniform(1.0, 8, softer)
    system = without_organ(thread, (Fixed(ORIGIN), Fixed(4 / 3 * X)))
    laid_out = replace(laid(system, [], line(ORIGIN, 4 / 3 * X)), q=straight(thread.spline, ORIGIN, 4 / 3 * X))
    x = np.pi * laid_out.q[:, :1] / laid_out.q[-1, 0]
    plucked = replace(laid_out, v=np.sin(x) * Z + 0.5 * np.sin(2 * x) * Y + 0.2 * np.sin(x) * X)
    q = [run(system, plucked, 0.4 / steps, steps)[-1].new.q for steps in (40, 80, 160, 320)]
    differences = [np.abs(a - b).max() for a, b in pairwise(q)]
    orders = np.log2(np.array(differences[:-1]) / differences[1:])
    assert abs(orders[-1] - 1.0) < ORDER
    assert differences[-1] > TWO_SOLVERS


def test_a_turned_scene_moves_alike() -> None:
    """Consistency check: axes exchanged in the scene, axes exchanged in the answer."""
    turn = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    system, state = free_thread(gravity=2.0)
    q = bent(system.thread.spline)
    state = replace(state, q=q, N=SOFT.EA * system.thread.points(q).strain)
    one = run(system, state, 0.01, 10)[-1].new.q
    other = run(replace(system, gravity=turn @ system.gravity), replace(state, q=q @ turn.T), 0.01, 10)[-1].new.q
    assert np.abs(other - one @ turn.T).max() <= TWO_SOLVERS


def test_what_the_ends_do_in_time() -> None:
    """Independent check: a ramped pull and a driven hand at every step of a run, as reactions and as places."""
    load, way = (
        np.array([0.0, 0.01, 0.02]),
        np.array([[0.0, 0.0, 0.0, 0.0], [0.02, 0.0, 1e-3, 0.0], [0.03, 0.0, 1e-3, 2e-3]]),
    )
    system = without_organ(uniform(0.1, 12), (Driven(way), Pulled(load, np.array([[0.0, 0.0], [0.02, 1.0]]))))
    state = laid(system, [], line(ORIGIN, X))
    steps = run(system, state, 5e-3, 8)
    assert abs(steps[-1].new.time - 0.04) <= IDENTITY
    for step in steps:
        t = step.new.time
        assert np.abs(step.new.reaction[1] - load * min(1.0, t / 0.02)).max() <= IDENTITY
        place = [0.0, 1e-3 * min(1.0, t / 0.02), 2e-3 * np.clip((t - 0.02) / 0.01, 0.0, 1.0)]
        assert np.abs(step.new.q[0] - place).max() <= IDENTITY


@pytest.mark.parametrize(
    "make",
    [
        lambda: Clamped(ORIGIN, np.array([1.0, 1.0, 0.0])),
        lambda: Driven(np.zeros((2, 3))),
        lambda: Driven(np.zeros((0, 4))),
        lambda: Driven(np.array([[0.0, 0.0, 0.0, np.nan]])),
        lambda: Driven(np.zeros((2, 4))),
    ],
)
def test_bad_ends_are_refused(make: Callable[[], object]) -> None:
    """Independent check: no unit vector; waypoints of a wrong shape, none, NaN, times that rest."""
    with pytest.raises(ThreadError):
        make()
