"""Sutures drawn as tight as they are tied, through tissue that stiffens, at rest and at default settings."""

import numpy as np
import pytest

from suturefem import load, prepare
from tests.bounds import ELASTICA_COARSE, RESIDUAL
from thread.catalogue import suture as suture_of
from thread.vectors import dot


@pytest.mark.parametrize("suture", ["2-0 polypropylene", "4-0 polypropylene"])
@pytest.mark.parametrize(("E", "F"), [(5e5, 3.0), (7.5e4, 1.0), (5e3, 0.5)], ids=["skin", "bowel", "liver"])
def test_what_is_tied_completes(E: float, F: float, suture: str) -> None:
    """Independent check: the scene of skin on coarser cells, with skin, bowel and liver of E [Pa] and b = 5 and dead
    loads F [N] that a linear organ ended under with holes that met or threads that flipped. The strands bear the dead
    loads, the holes the resultant of these, no cell is turned inside out, the thread goes through its directed holes as
    it was laid, and the holes have not met. It slides out of both alike, which could run through them at no cost."""
    pull = f"[{{}}{0.8 * F}, 0, {0.6 * F}]"
    scene = [
        f"tissue.youngs_modulus={E}",
        f"thread.suture='{suture}'",
        f"thread.start.force={pull.format('-')}",
        f"thread.end.force={pull.format('')}",
        "tissue.element=P1",
        "tissue.mesh.accuracy=given",
        "tissue.mesh.h_site=2.5e-3",
        *(f"piercing.{hole}.friction={{static=0,kinetic=0}}" for hole in ("entry", "exit")),
    ]
    for step, frame in prepare(load("skin", scene)).advance():
        last, picture = step, frame
    entry, exit = last.piercings
    assert (
        abs(entry.tension_before / F - 1.0) <= ELASTICA_COARSE and abs(exit.tension_after / F - 1.0) <= ELASTICA_COARSE
    )
    assert np.abs(entry.force + exit.force + [0.0, 0.0, 1.2 * F]).max() <= RESIDUAL * F
    for hole, down in ((entry, -1.0), (exit, 1.0)):
        assert down * dot(hole.tangent, np.cross(hole.u, hole.v)) > 0.0
    assert exit.x[0] > entry.x[0]
    assert abs(entry.slip + exit.slip) <= 0.1 * suture_of(suture).diameter
    organ = picture().organ
    assert organ is not None and organ.volume_ratio.min() > 0.0
