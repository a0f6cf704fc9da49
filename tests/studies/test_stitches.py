"""Stitches that surgeons tie, as shipped scenes: what the strands bear, and with what they close a wound."""

import numpy as np
import pytest

from studies import load, prepare

COARSE = ["tissue.mesh.h=6e-3", "tissue.mesh.h_site=2e-3", "thread.control_points=80", "solve.load_steps=4"]
ACROSS = 0.02  # of a closing force: strands bend at their holes, and are not quite the chords between these


def test_a_pulley_closes_with_the_strands_that_cross() -> None:
    """Independent check: the pull on the holes of one side is the sum of the tensions of the strands that cross the
    wound, along the way between their holes; friction leaves less in each strand further from the knot, alike on both
    ways from it, and no more than a capstan turned by π from strand to strand leaves."""
    scenario = load("pulley", COARSE)
    record = [record for record, _ in prepare(scenario).advance()][-1]
    (knot,), holes = record.ties, record.piercings
    assert knot.state == "tied" and knot.force == pytest.approx(scenario.tie[0].force, rel=0.01)
    strands = np.array([holes[-1].tension_after, *(hole.tension_after for hole in holes)])  # the first is the knot's
    ways = [b.x - a.x for a, b in zip([holes[-1], *holes[:-1]], holes, strict=True)]
    crossing = sum(T * abs(way[0]) / np.linalg.norm(way) for T, way in zip(strands[:-1], ways, strict=True))
    closing = sum(hole.force[0] for hole in holes if hole.x[0] > 0.0)
    assert closing == pytest.approx(crossing, rel=ACROSS)
    assert closing == pytest.approx(-sum(hole.force[0] for hole in holes if hole.x[0] < 0.0), rel=1e-3)
    assert strands[0] > strands[1] > strands[2] and strands[1] == pytest.approx(strands[3], rel=1e-3)
    assert (strands[1:3] / strands[:2] >= np.exp(-0.1 * np.pi)).all()
