"""Closed forms of footprints on a half-space and of balls in full space."""

import numpy as np
import pytest

from studies import unbounded
from tests.bounds import IDENTITY, RESIDUAL
from tissue.sites import footprint

NU = 0.45


@pytest.mark.parametrize("nu", [0.0, 0.3, 0.49])
def test_kernels_of_the_unbounded_body(nu: float) -> None:
    """Independent check: Kelvin averaged over the parabolic ball; the forces and the couple of DATA's disc.

    A turn of the frame about the normal changes nothing."""
    G = 1.0 / (2.0 * (1.0 + nu))
    ball = (10.0 - 12.0 * nu) / 3.0 * (10.0 / 7.0) / (16.0 * np.pi * G * (1.0 - nu))
    assert unbounded.ball_compliance(nu) == pytest.approx(ball, rel=IDENTITY)
    disc = unbounded.disc_compliance(nu)
    S = 2048.0 / (315.0 * np.pi)
    assert disc[2, 2] == pytest.approx((1.0 - nu**2) * S / np.pi, rel=IDENTITY)
    assert disc[0, 0] == pytest.approx((1.0 + nu) * (2.0 - nu) * S / (2.0 * np.pi), rel=IDENTITY)
    assert disc[9, 9] == pytest.approx(128.0 * (1.0 - nu**2) / (15.0 * np.pi**2), rel=IDENTITY)
    half = unbounded.half_ball_compliance(nu)
    c, s = np.cos(0.4), np.sin(0.4)
    Q = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    turn = np.zeros((12, 12))
    turn[:3, :3], turn[3:, 3:] = Q, np.kron(Q, Q)
    for C in (disc, half):
        assert np.abs(C - C.T).max() <= RESIDUAL * np.abs(C).max()
        assert np.abs(turn @ C @ turn.T - C).max() <= RESIDUAL * np.abs(C).max()
        assert np.linalg.eigvalsh(C).min() > -RESIDUAL


def test_half_ball_kernel_against_boussinesq_and_cerruti() -> None:
    """Independent check of the answers of the slopes to forces: the point-force fields summed over the disc, their
    slopes over the half ball. The sums of points near one another leave 2 %."""
    half = unbounded.half_ball_compliance(NU)
    disc, ball = footprint.disc("parabolic"), footprint.ball("parabolic")
    below = np.flatnonzero(ball.points[:, 2] < 0.0)
    step, slopes = 1e-5, np.zeros((3, 3, 3))
    for j in range(3):
        for sign in (1.0, -1.0):
            offset = ball.points[below][:, None] + sign * step * np.eye(3)[j] - disc.points
            field = np.einsum("kqab,q->kab", unbounded.surface_force(offset, NU), disc.weights)
            slopes[:, j] += sign / (2.0 * step) * np.einsum("k,kab->ab", 2.0 * ball.weights[below], field)
    assert np.abs(slopes.reshape(9, 3) - half[3:, :3]).max() <= 0.02 * np.abs(half[3:, :3]).max()
