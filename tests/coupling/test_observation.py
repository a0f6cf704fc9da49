"""What is observed of a hole's frame, against gradients that have a known strain and rotation."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from coupling.reports.observation import strains_and_turns
from tests.bounds import IDENTITY


def site(u: np.ndarray, v: np.ndarray) -> np.ndarray:
    return np.concatenate([np.zeros(3), u, v])


@pytest.mark.parametrize("angle", [0.0, 1e-6, 0.3, 2.0])
def test_a_rotated_frame_turns_by_its_angle(angle: float) -> None:
    """Independent check: about any axis, that of the hole among them, however small the angle."""
    frame = Rotation.random(rng=np.random.default_rng(3))
    u, v, t = frame.as_matrix().T
    for axis in (t, u, (u + 2.0 * v - t) / np.sqrt(6.0)):
        turned = Rotation.from_rotvec(angle * axis)
        _, turn = strains_and_turns(site(u, v), site(turned.apply(u), turned.apply(v))[None])
        assert abs(turn[0] - angle) < IDENTITY * max(angle, 1.0)


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("spin", [0.0, 0.4])
def test_a_strain_across_the_hole_is_seen_and_is_no_turn(sign: float, spin: float) -> None:
    """Independent check: principal strains −0.25 and 0.1 at 30° across the hole, with and without a spin about it, by
    the normal frame's rule and by the fibre frame's, whose vectors change by the transpose with the sign turned."""
    e = np.array([np.cos(np.pi / 6), np.sin(np.pi / 6), 0.0])
    f = np.array([-e[1], e[0], 0.0])
    gradient = -0.25 * np.outer(e, e) + 0.1 * np.outer(f, f) + spin * (np.outer(f, e) - np.outer(e, f))
    change = gradient if sign > 0.0 else -gradient.T
    u, v = np.eye(3)[:2]
    strain, turn = strains_and_turns(site(u, v), site(u + change @ u, v + change @ v)[None])
    assert abs(strain[0] - 0.25) < IDENTITY
    assert (turn[0] < IDENTITY) == (spin == 0.0)


def test_no_holes_have_no_strain() -> None:
    """Independent check: a thread in no hole."""
    strain, turn = strains_and_turns(np.zeros(0), np.zeros((0, 9)))
    assert strain.shape == turn.shape == (0,)
