"""Masses that friction slows: two over two holes, and one that slides to rest."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import brentq

from coupling.errors import CouplingError
from coupling.kernels.constraints import driving_force
from coupling.reports.audit import audit_step, initial_energies
from coupling.reports.observation import observe
from coupling.system import Friction, Piercing, State, System
from tests.bounds import IDENTITY, RESIDUAL
from tests.thread.threads import FREE, ORIGIN, Array, Strand, X, Z, laid, line, run, uniform, without_organ

G = 9.81


# -- two masses over two holes -----------------------------------------------------------------------------------------


ELL, RADIUS, GAP = 1.5e-3, 1.5e-3, 0.02  # √(EI/mg), of the path's corners, between the holes [m]


def two_masses(mu: float, heavy: float = 0.015, light: float = 0.005, hang: float = 0.025) -> tuple[System, State]:
    """A thread over two rings 20 mm apart; the heavy mass at its end, the light one at its start."""
    arc = 0.5 * np.pi * RADIUS
    lengths = np.cumsum([hang, arc, GAP - 2 * RADIUS, arc, hang])

    def path(s: Array) -> Array:
        s = np.asarray(s, float)
        a = np.clip((s - lengths[0]) / RADIUS, 0.0, np.pi / 2)
        b = np.clip((s - lengths[2]) / RADIUS, 0.0, np.pi / 2)
        flat = np.clip(s - lengths[1], 0.0, GAP - 2 * RADIUS)
        x = RADIUS * (1 - np.cos(a)) + flat + RADIUS * np.sin(b)
        z = np.minimum(s - lengths[0], 0.0) + RADIUS * (np.sin(a) - 1 + np.cos(b)) - np.maximum(s - lengths[3], 0.0)
        return np.stack([x, 0.0 * s, z], axis=-1)

    at = np.array([lengths[0] + 0.5 * arc, lengths[2] + 0.5 * arc])
    friction = Friction(mu, mu) if mu else None
    rings = tuple(Piercing(name, directed=False, friction=friction) for name in ("light side", "heavy side"))
    section = Strand(EA=1e3, EI=0.01 * G * ELL**2, rhoA=1e-6)
    thread = uniform(float(lengths[-1]), 150, section, point_masses=(light, heavy))
    system = without_organ(thread, FREE, rings, [(point, None) for point in path(at)], gravity=-G * Z)
    return system, laid(system, at, path)


def ring_ratio(mu: float) -> float:
    """T₁/T₂ of a thread that bends, a quarter turn round a ring: T₁ − T₂ = μN, and M²/2EI = T (1 − cos) on both sides
    (see the test of the capstan)."""

    def ratio(alpha: float) -> float:
        return float((1 + mu * np.cos(alpha)) / (1 - mu * np.sin(alpha)))

    alpha = brentq(lambda a: ratio(a) * (1 - np.cos(a)) - (1 - np.sin(a)), 0.1, np.pi / 4 + 1e-12)
    return ratio(alpha)


def test_friction_on_a_thread_without_bending_is_refused() -> None:
    """Independent check: the law of a thread does not depend on EI as EI → 0, and a spline without bending does not
    keep it: with the hole and the remedy, for both ways to leave bending out. An ideal hole holds such a thread."""
    system, _ = two_masses(0.1)
    limp = replace(system.thread, section=replace(system.thread.section, EI=0.0))
    for thread in (replace(system.thread, bending=False), limp):
        with pytest.raises(CouplingError, match=r"'light side' with EI = 0.*bending_factor"):
            replace(system, thread=thread)
        replace(two_masses(0.0)[0], thread=thread)


@pytest.mark.parametrize("mu", [0.0, 0.2])
def test_two_masses_over_two_holes(mu: float) -> None:
    """Independent check: a = g (m₁ − k² m₂)/(m₁ + k² m₂), k the ratio of the tensions at one ring, to 1 %. The bends at
    the rings give, and the masses bounce on them: a is that of what the tension does not move, m₁ z₁ − k² m₂ z₂."""
    system, state = two_masses(mu)
    light, heavy = system.thread.point_masses
    share = ring_ratio(mu) ** 2 * light
    exact = G * (heavy - share) / (heavy + share)
    steps = run(system, state, 5e-4, 180)
    weight = np.array([share, -heavy]) / (share + heavy)
    gains = [(step.new.v - step.old.v)[[0, -1], 2] @ weight / step.dt for step in steps]
    sliding = np.array([mu == 0.0 or np.array_equal(step.new.sigma, [-1.0, -1.0]) for step in steps])
    sliding[:40] = False  # the first bounce
    assert sliding.sum() > 100
    assert abs(np.mean(np.array(gains)[sliding]) / exact - 1.0) < 1e-2


# -- a mass that slides to rest ----------------------------------------------------------------------------------------


MASS, SPEED, FORCE, DT = 0.01, 0.1, 0.01, 1e-3  # F5: 10 g at 0.1 m/s against 0.01 N


def sliding_mass(friction: Friction, gravity: float) -> tuple[System, State]:
    """A stiff thread with half the mass on either end, gliding along x through a sleeve."""
    length = 0.04
    thread = uniform(length, 8, Strand(EA=1e5, EI=1.0, rhoA=1e-6), point_masses=(0.5 * MASS, 0.5 * MASS))
    sleeve = (Piercing("sleeve", friction=friction),)
    system = without_organ(thread, FREE, sleeve, ((ORIGIN, X),), gravity=-gravity * Z)
    state = laid(system, [0.5 * length], line(-0.5 * length * X, X))
    v = np.outer(np.ones(thread.n), SPEED * X)
    return system, replace(state, v=v, s_dot=-SPEED * np.ones(1), sigma=-np.ones(1))


@pytest.mark.parametrize("cause", ["weight", "grip"])
def test_a_sliding_mass_stops(cause: str) -> None:
    """Independent check (F5): at rest after m v₀/(μN) within a step, 5 mm on within a step's way, and then at rest to
    the last bit: no creep. What friction took is what the motion lost, less what the integrator took, to 1e-6; and
    Σ (F₀ + μN)|T||Δs|, summed here."""
    mass = MASS + 0.04e-6
    friction = Friction(FORCE / (mass * G), FORCE / (mass * G)) if cause == "weight" else Friction(grip=FORCE)
    system, state = sliding_mass(friction, G if cause == "weight" else 0.0)
    energies = before = initial_energies(system, state)
    lost, stopped, first = 0.0, 0.0, state
    for step in run(system, state, DT, 150):
        energies, new = audit_step(system, energies, step), step.new
        at = system.passage_of(new)
        lost += abs(driving_force(at, new.lam, new.y)[0] * (new.s - step.old.s)[0])
        if new.sigma[0] == 0.0:
            stopped = stopped or new.time
            assert new.s[0] == step.old.s[0]
            assert new.s_dot[0] == 0.0
            if new.time > stopped + 0.01:
                assert np.abs(new.v).max() < 1e-12 * SPEED / DT  # [m/s], a round-off of position over a step
    exact = mass * SPEED / FORCE
    assert abs(stopped - exact) <= DT * (1 + IDENTITY)
    assert abs(first.s[0] - new.s[0] - 0.5 * SPEED * exact) < SPEED * DT
    motion = before.kinetic - energies.kinetic
    assert abs(energies.friction_dissipation / lost - 1.0) < 1e-9
    gravity = energies.external_work - (energies.elastic_thread - before.elastic_thread)
    assert abs(energies.friction_dissipation + energies.numerical_dissipation - motion - gravity) < 1e-6 * motion
    assert abs(motion / (0.5 * mass * SPEED**2) - 1.0) < 1e-6
    assert abs(energies.friction_dissipation / motion - 1.0) < 2 * DT / exact
    assert abs(energies.balance_error) < RESIDUAL * motion
    assert observe(system, first, new)[0].state == "stick"
