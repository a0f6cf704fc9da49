"""What a thread that relaxes remembers: Maxwell elements against their differential equation, spans by their means."""

import numpy as np
import pytest
from scipy.integrate import quad

from tests.bounds import IDENTITY
from thread.relaxation import Memory
from tissue.relaxation import Prony

SERIES = Prony([0.3, 0.2], [0.5, 40.0])
S = np.linspace(0.0, 0.1, 11)


def memory(dt: float) -> Memory:
    """Strains and held strains of no special kind."""
    rng = np.random.default_rng(8)
    return Memory(S, 0.02 * rng.standard_normal(S.size), 0.01 * rng.standard_normal((2, S.size)), dt)


def lost(t: float, h: float, steady: float, tau: float) -> float:
    """h²/τ at a time [s], of a Maxwell element whose strain is h."""
    return float((h * np.exp(-t / tau) - steady * np.expm1(-t / tau)) ** 2 / tau)


@pytest.mark.parametrize("dt", [1e-9, 1e-3, 0.3, 50.0, 1e6])
def test_a_step_solves_the_differential_equation(dt: float) -> None:
    """Independent check: h(t) of dh/dt + h/τ = r under an even rate r of strain, and the quadrature of h²/τ."""
    before, strain = memory(dt), np.linspace(-0.01, 0.03, S.size)
    rate, after = (strain - before.strain) / dt, before.held_after(SERIES, strain)
    taken = np.zeros(S.size)
    for g, tau, Q, end in zip(SERIES.shares, SERIES.times, before.held, after, strict=True):
        x, h = dt / tau, Q / g
        steady = rate * tau
        assert np.abs(end / g - (h * np.exp(-x) - steady * np.expm1(-x))).max() < IDENTITY
        for k in range(S.size):
            early = quad(lost, 0.0, min(dt, 40.0 * tau), (h[k], steady[k], tau), epsrel=1e-10)[0]
            taken[k] += g * (early + steady[k] ** 2 * max(dt - 40.0 * tau, 0.0) / tau)
    error = np.abs(before.dissipated(SERIES, strain) - taken)
    assert error.max() < 1e-8 * taken.max() + IDENTITY * np.max(strain**2)


def test_the_force_is_that_of_the_natural_strain() -> None:
    """Identity: (1 − Σ g) ε + Σ Q at the end of a step is γ (ε − ε̄), whatever the strain."""
    before, strain, shares = memory(0.7), np.linspace(-0.01, 0.03, S.size), np.array(SERIES.shares)
    force = (1.0 - shares.sum()) * strain + before.held_after(SERIES, strain).sum(axis=0)
    assert np.abs(SERIES.met(before.dt) * (strain - before.natural(SERIES)) - force).max() < IDENTITY


def test_a_span_remembers_the_mean_of_its_points() -> None:
    """Independent check: quadrature of what is linear between the points."""
    known, ends = memory(0.1), np.array([0.0, 0.003, 0.031, 0.032, 0.1])
    of_spans = known.over(ends)
    for row, means in zip((known.strain, *known.held), (of_spans.strain, *of_spans.held), strict=True):
        for low, high, mean in zip(ends[:-1], ends[1:], means[:, 0], strict=True):
            x = np.linspace(low, high, 20001)
            assert mean == pytest.approx(np.trapezoid(np.interp(x, S, row), x) / (high - low), rel=1e-6, abs=1e-9)
