"""The surface of a lacerated organ: closed, of the volume of what it is made of, and that of the shipped scene."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from meshes.errors import MeshError
from meshes.laceration import Laceration, as_obj, ellipsoid, lacerated
from meshes.skin import Skin, read_surface
from studies.scenario import SCENES


def test_a_wedge_is_torn_out_of_an_ellipsoid(tmp_path: Path) -> None:
    """Independent check: the surface is closed and crosses itself nowhere, which reading it refuses; without a wedge it
    holds 4π/3 abc, less what chords of α around and β along cut off, α²/6 + β²/4, and with it less by
    ∫ ½ w d (1 − (2y/l)²) dy = w d l/3, of which chords of l/20 cut off a little too."""
    shape = replace(Laceration(), uneven=0.0)
    (tmp_path / "torn.obj").write_text(as_obj(lacerated(shape)))
    torn, whole = read_surface(tmp_path / "torn.obj", 1e-3), Skin(*ellipsoid(shape))
    cut = (2.0 * np.pi / shape.around) ** 2 / 6.0 + (np.pi / shape.rings) ** 2 / 4.0
    assert 1.0 - whole.volume / (4.0 / 3.0 * np.pi * np.prod(shape.axes)) == pytest.approx(cut, rel=0.01)
    assert whole.volume - torn.volume == pytest.approx(shape.width * shape.depth * shape.length / 3.0, rel=0.05)


def test_the_shipped_surface_is_that_of_the_generator() -> None:
    """Consistency check: seed and shape make the file again, letter by letter."""
    assert (SCENES / "laceration.obj").read_text(encoding="utf-8") == as_obj(lacerated(Laceration()))


def test_another_seed_is_another_organ() -> None:
    """Independent check: unevenness leaves the wedge where it is, across x = 0."""
    one, other = (lacerated(replace(Laceration(), seed=seed)) for seed in (1, 2))
    assert np.abs(one.points - other.points).max() > 1e-3 * Laceration().axes[0]
    assert one.volume != pytest.approx(other.volume, rel=1e-4)
    for skin in (one, other):
        assert (
            skin.points[:, 0].max() > 0.02 and np.isclose(skin.points[:, 0], 0.5 * Laceration().width, rtol=0.01).any()
        )


def test_impossible_wedges_are_refused_in_words() -> None:
    with pytest.raises(MeshError, match=r"length = 0\.08 and depth = 0\.01 of the wedge must be below"):
        Laceration(length=0.08)
    with pytest.raises(MeshError, match="width = 0"):
        Laceration(width=0.0)
