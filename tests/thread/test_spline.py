"""The cubic B-spline: what any such basis must do, and a second way to evaluate it."""

import numpy as np
import pytest

from tests.bounds import IDENTITY
from tests.thread.threads import assert_slope
from thread.errors import ThreadError
from thread.knots import clamped_knots, uniform_knots
from thread.spline import Spline

# Clamped, no two spans alike, with a double and a triple knot inside.
BREAKS = np.array([0.0, 0.1, 0.35, 0.35, 0.5, 0.55, 0.8, 0.8, 0.8, 1.1, 1.3])
SPLINE = Spline(clamped_knots(BREAKS))
S = np.linspace(0.0, 1.3, 79)  # the ends are among them, the knots inside are not


def cox_de_boor(knots: np.ndarray, i: int, degree: int, s: float) -> float:
    """The recursion that defines B-splines (de Boor 1972); 0/0 is 0, and the last span holds its right end."""
    if degree == 0:
        last = knots[i] < knots[i + 1] == knots[-1] == s
        return float(knots[i] <= s < knots[i + 1] or last)
    out = 0.0
    if knots[i + degree] > knots[i]:
        out += (s - knots[i]) / (knots[i + degree] - knots[i]) * cox_de_boor(knots, i, degree - 1, s)
    if knots[i + degree + 1] > knots[i + 1]:
        fall = (knots[i + degree + 1] - s) / (knots[i + degree + 1] - knots[i + 1])
        out += fall * cox_de_boor(knots, i + 1, degree - 1, s)
    return out


def matrix(s: np.ndarray, order: int) -> np.ndarray:
    """All functions' derivatives of an order at `s`, shape `(m, n)`."""
    first, b = SPLINE.basis(s)
    full = np.zeros((len(s), SPLINE.n))
    np.put_along_axis(full, first[:, None] + np.arange(4), b[:, order], axis=1)
    return full


def test_values_are_those_of_the_recursion() -> None:
    """Independent check: the definition of B-splines, for every function, between the knots and on them."""
    s = np.sort(np.concatenate([S, BREAKS]))
    exact = np.array([[cox_de_boor(SPLINE.knots, i, 3, x) for i in range(SPLINE.n)] for x in s])
    assert np.abs(matrix(s, 0) - exact).max() <= IDENTITY


def test_partition_of_unity() -> None:
    """Independent check: the functions sum to one, each derivative of the sum is zero; none is negative."""
    for order in range(4):
        functions = matrix(S, order)
        assert np.abs(functions.sum(axis=1) - (order == 0)).max() <= IDENTITY * np.abs(functions).max()
    assert matrix(S, 0).min() >= -IDENTITY


@pytest.mark.parametrize("order", [0, 1, 2])
def test_derivatives_against_differences(order: int) -> None:
    """Independent check: each derivative is the slope of the one before; of b, cubic, with the square
    of the step; of b' and b'' the central difference is exact."""
    s = np.array([0.05, 0.2, 0.42, 0.52, 0.7, 0.95, 1.2])
    assert_slope(lambda h: matrix(s + h, order), matrix(s, order + 1), h=0.01)


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_polynomials_up_to_cubic_are_reproduced(degree: int) -> None:
    """Independent check: control points from the blossom (Marsden's identity) give the polynomial and its slopes."""
    t1, t2, t3 = SPLINE.knots[1:-3], SPLINE.knots[2:-2], SPLINE.knots[3:-1]
    blossoms = [np.ones_like(t1), (t1 + t2 + t3) / 3, (t1 * t2 + t2 * t3 + t3 * t1) / 3, t1 * t2 * t3]
    q = np.tile(blossoms[degree][:, None], (1, 3))
    D = SPLINE.curve(q, S)[:, :, 0]
    power = np.polynomial.Polynomial([0.0] * degree + [1.0])
    for order in range(4):
        exact = power.deriv(order)(S) if order else power(S)
        assert np.abs(D[:, order] - exact).max() <= IDENTITY * np.abs(matrix(S, order)).max()


def test_the_ends_are_the_end_points() -> None:
    """Independent check: a clamped cubic passes through q_0 and q_n−1, along q_1 − q_0 with 3/(first span)."""
    q = np.random.default_rng(1).standard_normal((SPLINE.n, 3))
    D = SPLINE.curve(q, [SPLINE.start, SPLINE.end])
    assert np.abs(D[:, 0] - q[[0, -1]]).max() <= IDENTITY
    slopes = 3.0 * np.array([(q[1] - q[0]) / 0.1, (q[-1] - q[-2]) / 0.2])
    assert np.abs(D[:, 1] - slopes).max() <= IDENTITY * np.abs(slopes).max()


def test_a_curve_goes_through_points_whatever_its_length() -> None:
    """Independent check: of threads of seeded lengths, of which the last Greville abscissa is beyond the end of some by
    round-off, each goes through its points."""
    beyond = 0
    for length in np.random.default_rng(5).uniform(0.01, 0.2, 100):
        spline = Spline(uniform_knots(length, 24))
        points = np.stack([np.sin(30.0 * spline.greville), spline.greville], axis=1)
        curve = spline.curve(spline.through(points), np.minimum(spline.greville, spline.end))[:, 0]
        assert np.abs(curve - points).max() <= IDENTITY
        beyond += int(spline.greville[-1] > spline.end)
    assert beyond > 0


@pytest.mark.parametrize(("knot", "smooth"), [(0.1, 2), (0.35, 1), (0.8, 0)])
def test_a_knot_takes_one_order_of_smoothness_each_time(knot: float, smooth: int) -> None:
    """Independent check: C² at a single knot, C¹ at a double, C⁰ at a triple, and the next derivative jumps."""
    q = np.random.default_rng(2).standard_normal((SPLINE.n, 3))
    first, b = SPLINE.basis(np.array([np.nextafter(knot, 0.0), knot]))
    assert first[0] < first[1]
    left, right = (np.einsum("ki,ia->ka", b[k], q[first[k] : first[k] + 4]) for k in (0, 1))
    scale = np.abs(left).max(axis=1)
    jump = np.abs(left - right).max(axis=1) / scale
    assert np.all(jump[: smooth + 1] <= IDENTITY)
    assert jump[smooth + 1] > 1e-2


@pytest.mark.parametrize(
    ("knots", "word"),
    [
        (np.zeros((2, 8)), "shape"),
        (np.arange(7.0), "at least 8"),
        (np.array([0, 0, 0, 0, np.nan, 1, 1, 1, 1]), "finite"),
        (np.array([0, 0, 0, 0, 0.6, 0.4, 1, 1, 1, 1]), "order"),
        (np.zeros(8), "order"),
        (np.array([0, 0, 0, 0.1, 0.5, 1, 1, 1, 1.0]), "clamped"),
        (np.array([0, 0, 0, 0, 0.5, 0.9, 1, 1, 1.0]), "clamped"),
        (np.array([0, 0, 0, 0, 0.5, 0.5, 0.5, 0.5, 0.5, 1, 1, 1, 1]), "four times"),
        (np.array([0, 0, 0, 0, 0, 1, 1, 1, 1.0]), "four times"),
    ],
)
def test_bad_knots_are_refused(knots: np.ndarray, word: str) -> None:
    """Independent check: what is no clamped sequence is refused by name."""
    with pytest.raises(ThreadError, match=word):
        Spline(knots)
