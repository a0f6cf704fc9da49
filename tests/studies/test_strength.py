"""What the thread bears on the tissue with: the pressure at a hole, the tissue's strength, and the event `tears`."""

from copy import deepcopy
from typing import Any

import numpy as np
import pytest

from studies.scenario import parse
from studies.simulation import prepare
from studies.simulation.assembly import assemble
from tests.bounds import IDENTITY
from thread.catalogue import suture

PULL, FOOTPRINT = 0.05, 1.5e-3
SCENE: dict[str, Any] = {
    "tissue": {
        "youngs_modulus": 6e5,
        "poisson_ratio": 0.45,
        "density": 1070.0,
        "clamp": ["bottom"],
        "mesh": {"kind": "block", "size": [0.02, 0.016, 0.008], "h": 4e-3},
        "region": [{"name": "skin", "depth": [0.0, 0.002], "strength": 2.5e4}],
        "strength": 1.0,
    },
    "thread": {
        "suture": "2-0 polypropylene",
        "control_points": 20,
        "path": [[0, 0, 0], [0, 0, 0.02]],
        "end": {"kind": "pulled", "force": [0, 0, PULL]},
    },
    "piercing": [{"name": "hole", "at": [0, 0, 0], "kind": "anchored", "footprint": FOOTPRINT, "s": 0.0}],
    "solve": {"kind": "static", "load_steps": 5},
}


def test_the_bearing_pressure_is_force_over_diameter_and_length() -> None:
    """Independent check: an anchor that bears the pull P bears P/(d 2a) of a footprint a, and the tissue of its own
    region tears at the load step that passes its strength, once."""
    simulation = prepare(parse(SCENE))
    records = [record for record, _ in simulation.advance()]
    expected = PULL / (suture("2-0 polypropylene").diameter * 2.0 * FOOTPRINT)
    found = [record.piercings[0].bearing_pressure for record in records]
    assert found[1:] == pytest.approx([expected * k / 5 for k in range(1, 6)], rel=1e-8)
    torn = [(record.step, event.piercing) for record in records for event in record.events if event.kind == "tears"]
    assert torn == [(int(np.ceil(5 * 2.5e4 / expected)), "hole")]


@pytest.mark.parametrize(
    ("hole", "length"),
    [
        ({}, 2.0 * FOOTPRINT),
        ({"kind": "sliding", "s": 0.01, "direction": [0, 0, 1], "channel": 7e-3,
          "friction": {"static": 0.1, "kinetic": 0.1}}, 7e-3),
        ({"footprint": 0.0}, 10.0 * suture("2-0 polypropylene").diameter),
    ],
)  # fmt: skip
def test_the_length_is_the_channels_or_of_the_footprint(hole: dict[str, Any], length: float) -> None:
    """Independent check: a channel's own length, two footprints, or ten diameters of a bare point; strength is that of
    the last region around the hole, or the organ's."""
    table = deepcopy(SCENE)
    table["piercing"][0] |= hole
    (made,) = assemble(parse(table)).system.piercings
    assert made.bearing == pytest.approx(length, rel=IDENTITY) and made.strength == 2.5e4
    del table["tissue"]["region"]
    assert assemble(parse(table)).system.piercings[0].strength == 1.0
    del table["tissue"]["strength"]
    assert assemble(parse(table)).system.piercings[0].strength == np.inf
