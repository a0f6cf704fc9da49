"""Verdicts on sequences whose limit and order are known."""

import numpy as np
import pytest
from numpy.typing import NDArray

from studies.verdicts import convergence_index, observed_order, richardson, verdict
from tests.bounds import IDENTITY, TWO_SOLVERS

H = np.array([1.0, 1.3, 2.0, 3.0])  # no two ratios are equal


def power(p: float, C: float = 0.01, limit: float = 1.0) -> NDArray[np.float64]:
    return limit + C * H**p


@pytest.mark.parametrize("p", [-3.0, -1.0, 0.5, 1.0, 2.0, 4.0])
@pytest.mark.parametrize("C", [0.01, -0.01])
def test_order_and_limit_of_a_power(p: float, C: float) -> None:
    """Independent check: any ratios, either sign, refinement that helps or does not."""
    f = power(p, C)
    assert observed_order(H[:3], f[:3]) == pytest.approx(p, rel=TWO_SOLVERS)
    assert richardson(H, f, p) == pytest.approx(1.0, rel=TWO_SOLVERS)
    assert convergence_index(H, f, p) == pytest.approx(1.25 * 0.01 / f[0], rel=TWO_SOLVERS)


def test_celik_table_1() -> None:
    """Independent check: the example of Celik et al. (2008), table 1, monotone column: 18 000, 8 000 and 4 500 cells in
    two dimensions; printed are p = 1.53, limit 6.1685, index 2.2 %."""
    h, f = 1.0 / np.sqrt([18000.0, 8000.0, 4500.0]), [6.063, 5.972, 5.863]
    p = observed_order(h, f)
    assert p == pytest.approx(1.53, abs=0.005)
    assert richardson(h, f, p) == pytest.approx(6.1685, abs=5e-4)
    assert convergence_index(h, f, p) == pytest.approx(0.022, abs=5e-4)


def test_a_logarithm_diverges() -> None:
    """Independent check: f = log h has order zero, f = c/h the order −1 that its verdict names."""
    log = verdict(H, np.log(1e3 / H), 2.0)
    assert (log.kind, log.text) == ("diverging", "DIVERGING like a logarithm")
    assert log.order == pytest.approx(0.0, abs=TWO_SOLVERS)
    point = verdict(H, 3.0 / H + 1.0, 2.0)
    assert point.text == "DIVERGING, order -1.00" and np.isnan(point.limit) and np.isinf(point.index)


def test_errors_that_scatter_are_no_divergence() -> None:
    """Independent check: numbers in proportion to errors that are estimated a fifth too large or too small. The limit
    is within the interval, and a number of cells of the same kind would be called diverging."""
    errors, scatter = np.array([0.06, 0.134, 0.2]), np.array([1.2, 1.0, 1.2])
    found = verdict(errors * scatter, 1.0 - errors, 1.0, estimated=True)
    assert found.kind == "pre-asymptotic" and errors[0] < found.index * (1.0 - errors[0])
    assert verdict(errors * scatter, 1.0 - errors, 1.0).kind == "diverging"
    for unlimited in (-np.log(errors), errors**-0.25):  # they change by more than their estimates
        assert verdict(errors, unlimited, 1.0, estimated=True).kind == "diverging"
    still = verdict(errors, 1.0 + np.array([0.0, 1e-4, 1.5e-4]), 1.0, estimated=True)
    assert still.kind == "unresolved"
    near = verdict([0.0300, 0.0301, 0.06], [1.02, 1.0, 0.99], 1.0, estimated=True)
    assert np.isnan(near.limit) and np.isinf(near.index)
    same = verdict(errors, 1.0 - errors, 1.0, estimated=True)
    assert same == verdict(errors, 1.0 - errors, 1.0) and same.limit == pytest.approx(1.0, rel=TWO_SOLVERS)


def test_verdicts() -> None:
    """Converged holds the limit in its interval; the order of the arguments does not matter; luck is not rewarded."""
    good = verdict(H[::-1], power(2.0)[::-1], 2.0)
    assert good.text == "converged to 1.2 %" and good.limit == pytest.approx(1.0, rel=TWO_SOLVERS)
    assert verdict(H, power(1.0, C=1.0), 2.0).kind == "pre-asymptotic"
    assert verdict(H, power(0.2, C=0.1), 2.0).kind == "pre-asymptotic"
    slow = verdict(H, power(0.3, C=0.01), 2.0)
    assert slow.kind == "pre-asymptotic" and slow.index < 0.03
    lucky = verdict(H, power(6.0, C=1e-3), 2.0)
    assert lucky.index > 3.0 * abs(power(6.0, C=1e-3)[0] - 1.0)
    assert verdict(H, np.full(4, 0.7), 2.0).index <= IDENTITY


def test_swings_and_noise() -> None:
    """A number that swings is given thrice its swing; changes too small to show an order are said to be so, and
    not called convergence, for a logarithm may be as small; large ones that grow diverge."""
    swing = verdict(H, [1.0, 1.01, 0.995, 1.0], 2.0)
    assert np.isnan(swing.order) and np.isnan(swing.limit) and swing.text.endswith("order not resolved")
    assert (swing.kind, swing.index) == ("converged", pytest.approx(0.045))
    assert verdict(H, [1.0, 1.2, 0.9, 1.0], 2.0).kind == "pre-asymptotic"
    assert verdict(H, [1.0, 0.999, 0.9985, 0.9983], 2.0).text == "changes by less than 0.3 %, order not resolved"
    assert verdict(H, 1.0 + 1e-3 * np.log(H), 2.0).kind == "unresolved"
    assert verdict(H, [1.0, 0.992, 0.987, 0.986], 2.0).kind == "diverging"
    assert verdict(H, [1.5, 1.0, 0.9, 0.8], 2.0).kind == "diverging"
    assert verdict(H, [1.5, 1.0, 0.9, 1.0], 2.0).kind == "pre-asymptotic"


def test_near_a_turn_of_the_error_two_numbers_are_near() -> None:
    """Independent check: with the error C (h − h²/k) two finest numbers are as near to one another as one likes, the
    limit is not, and the interval holds it all the same."""
    h = np.array([1.0, 2.0, 4.0])
    for C, k in ((0.003, 3.0001), (0.003, 3.01), (0.1, 3.0001), (-0.003, 3.0001)):
        f = 1.0 + C * (h - h**2 / k)
        found = verdict(h, f, 2.0)
        assert abs(f[0] - f[1]) < 1e-2 * abs(f[0] - 1.0)
        assert found.index * abs(f[0]) > abs(f[0] - 1.0)
    assert verdict([1.0, 2.0, 4.0], [1.0, 1.0000001, 1.1], 2.0).kind == "pre-asymptotic"


@pytest.mark.parametrize("growth", [1.5, 3.0])
def test_swings_that_grow_are_not_called_converged(growth: float) -> None:
    """Independent check: (−g)ᵏ after k refinements has no limit, however small."""
    swing = (-growth) ** np.arange(4)[::-1]
    assert verdict(H, 1.0 + 2e-4 * swing, 2.0).kind in ("unresolved", "pre-asymptotic")
    assert verdict(H, 1.0 + 1e-3 * swing, 2.0).kind in ("unresolved", "pre-asymptotic")


@pytest.mark.parametrize("f", [[np.nan, 1.0, 1.1], [1.0, np.nan, 1.1], [np.inf, 1.0, 1.0], [0.0, 1e-3, 4e-3]])
def test_of_numbers_that_are_none_nothing_is_said(f: list[float]) -> None:
    """A finest number of zero has no relative error."""
    assert verdict([1.0, 2.0, 4.0], f, 2.0).kind == "pre-asymptotic"
    assert verdict([1.0, 2.0, 4.0], [0.0, 0.0, 0.0], 2.0).kind == "zero"


def planted(family: str, draw: np.random.Generator) -> tuple[NDArray[np.float64], NDArray[np.float64], float]:
    """Return sizes, numbers and formal order of a series whose limit, where it has one, is 1; the finest first."""
    h, formal = draw.choice([1.3, np.sqrt(2.0), 2.0]) ** np.arange(draw.integers(3, 6)), draw.choice([1.0, 2.0, 3.0])
    C, t, noise = draw.choice([-1, 1]) * 10.0 ** draw.uniform(-3.0, -0.5), h / h[-1], draw.normal(size=len(h))
    errors = {
        "one order": t ** (formal + draw.uniform(-0.4, 0.4)),
        "a slow order": t ** draw.uniform(0.15, 0.5),
        "a steep order": t ** (formal + draw.uniform(0.6, 3.0)),
        "a higher order as well": t**formal + draw.uniform(-3.0, 3.0) * t ** (formal + 1.0),
        "a lower order as well": t**formal + draw.uniform(-3.0, 3.0) * t ** max(formal - 1.0, 0.5),
        "noise": 0.3 * noise,
        "an order and noise": t**formal + 10.0 ** draw.uniform(-3.0, -0.5) * noise,
        "growing changes": t ** -draw.uniform(0.1, 3.0),
        "a logarithm": np.log(t),
        "a growing swing": (-draw.uniform(1.2, 3.0)) ** np.arange(len(h))[::-1],
    }
    return h, 1.0 + C * errors[family], float(formal)


LIMITED = ("one order", "a slow order", "a steep order", "a higher order as well", "a lower order as well", "noise")


@pytest.mark.parametrize("family", [*LIMITED, "an order and noise"])
def test_intervals_hold_the_limit_of_planted_series(family: str) -> None:
    """Independent check: 95 of 100 intervals hold the limit that was planted, as Roache asks of a factor of safety,
    and those of one order are for the most part no wider than one and a half errors."""
    draw, held, widths = np.random.default_rng(36), [], []
    for _ in range(1000):
        h, f, formal = planted(family, draw)
        found, error = verdict(h, f, formal), abs(f[0] - 1.0)
        if np.isfinite(found.index):
            held.append(found.index * abs(f[0]) >= error * (1.0 - TWO_SOLVERS))
            widths.append(found.index * abs(f[0]) / error)
    assert len(held) > 400 and np.mean(held) > 0.95
    assert family != "one order" or float(np.median(widths)) < 1.5


@pytest.mark.parametrize("family", ["growing changes", "a logarithm", "a growing swing"])
def test_changes_that_do_not_fall_have_no_interval(family: str) -> None:
    """Independent check: what has no limit is never called converged, and no interval is given for it."""
    draw = np.random.default_rng(36)
    found = [verdict(*planted(family, draw)) for _ in range(1000)]
    assert all(np.isinf(one.index) and one.kind != "converged" for one in found)
    assert verdict([1.0, 2.0**0.5, 2.0], [0.1494, 0.1485, 0.1483], 2.0).kind == "diverging"


def test_two_refinements_are_no_study() -> None:
    with pytest.raises(ValueError, match="three different refinements"):
        verdict([1.0, 2.0], [1.0, 2.0], 2.0)
