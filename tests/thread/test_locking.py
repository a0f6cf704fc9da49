"""Membrane locking: a thin rod bent through nearly a right angle, against the extensible elastica by quadrature."""

import numpy as np
import pytest
from scipy.integrate import solve_bvp
from scipy.optimize import brentq

from tests.bounds import ELASTICA_COARSE
from tests.thread.test_statics import elastica
from tests.thread.threads import PP, Array, Strand

LENGTH, LOAD = 0.1, 10  # PL²/EI = 10 turns the tip by 82°
RATIOS = (1e4, 1e6, 1e8, 1e10)  # EA/EI [1/m²]; a round rod of diameter d has 16/d²


def stretched(along: float, EA: float) -> float:
    """|T| from the axial equilibrium of ½EAε² + ½EIθ'²: |T| EA ε = F·t."""
    return float(brentq(lambda T: 0.5 * EA * T * (T * T - 1.0) - along, 0.5, 2.0, xtol=1e-15))


def exact_tip(EA: float) -> Array:
    """Tip (x, z) [m] of the clamped rod under the dead load P across: x' = |T| cos θ, z' = |T| sin θ, θ' = M/EI,
    M' = −|T| P cos θ; the moment vanishes at the tip."""
    P = LOAD * PP.EI / LENGTH**2

    def slope(s: Array, y: Array) -> Array:
        T = np.array([stretched(P * np.sin(theta), EA) for theta in y[2]])
        c, sine = np.cos(y[2]), np.sin(y[2])
        return np.array([T * c, T * sine, y[3] / PP.EI, -T * P * c])

    s = np.linspace(0.0, LENGTH, 41)
    guess = np.array([0.6 * s, 0.6 * s, 1.4 * s / LENGTH, P * LENGTH * 0.5 * (1.0 - s / LENGTH)])
    at_ends = lambda a, b: np.array([a[0], a[1], a[2], b[3] / (P * LENGTH)])  # noqa: E731
    answer = solve_bvp(slope, at_ends, s, guess, tol=1e-10, max_nodes=20000)
    assert answer.success
    return np.asarray(answer.y[:2, -1])


@pytest.mark.parametrize("n", [10, 20])
def test_no_locking(n: int) -> None:
    """Independent check: with ten and with twenty control points the error of the tip does not grow with EA/EI: at 10⁶
    times the stiffness it is at most twice what it is where stretch is easy."""
    errors = []
    for ratio in RATIOS:
        _, state = elastica(n, LOAD, LENGTH, Strand(EA=ratio * PP.EI))
        errors.append(np.abs(state.q[-1, [0, 2]] - exact_tip(ratio * PP.EI)).max() / LENGTH)
    assert max(errors) <= 2.0 * errors[0]
    assert n < 20 or max(errors) < ELASTICA_COARSE
