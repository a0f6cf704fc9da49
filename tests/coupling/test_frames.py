"""The two vectors across a tangent, of clamped ends and of the organ's sites."""

import numpy as np
import pytest

from tests.bounds import IDENTITY
from tissue.arrays import Array
from tissue.sites.site import frame

TURN = 1e-6  # of the tangent between two looks [rad]


def tangents(count: int) -> Array:
    """Unit vectors all around, and the axes, shape `(count + 6, 3)`."""
    every = np.random.default_rng(7).normal(size=(count, 3))
    return np.concatenate([every / np.linalg.norm(every, axis=1, keepdims=True), np.eye(3), -np.eye(3)])


def test_the_frame_is_orthonormal_and_right_handed() -> None:
    """Independent check: u, v, t is a rotation, straight down too."""
    for t in tangents(200):
        R = np.array([*frame(t), t])
        assert np.abs(R @ R.T - np.eye(3)).max() <= IDENTITY
        assert np.linalg.det(R) == pytest.approx(1.0, rel=IDENTITY)


@pytest.mark.parametrize("height", [0.9, 0.0, -0.9])
def test_the_frame_is_continuous_across_the_horizon(height: float) -> None:
    """Independent check: u, v turn with the tangent and about it by (1 − cos) of the azimuth's change, nothing else: by
    less than 3 TURN, on both sides of the horizon and across it."""
    for azimuth in np.linspace(0.0, 2.0 * np.pi, 24, endpoint=False):
        for way in ([0.0, TURN], [TURN, 0.0]):
            polar, around = np.arccos(height) + np.array([-0.5, 0.5]) * way[0], azimuth + np.array([-0.5, 0.5]) * way[1]
            level = np.sin(polar)
            t = np.stack([level * np.cos(around), level * np.sin(around), np.cos(polar)], axis=1)
            (u_0, v_0), (u_1, v_1) = frame(t[0]), frame(t[1])
            assert max(np.abs(u_1 - u_0).max(), np.abs(v_1 - v_0).max()) <= 3.0 * TURN
