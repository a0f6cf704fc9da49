"""What the thread bears on the tissue with: the pressure at a hole, the tissue's strength, and the event `tears`."""

from copy import deepcopy
from typing import Any

import numpy as np
import pytest

from studies.output.columns import range_summary
from studies.output.records import nothing_met
from studies.scenario import load, parse
from studies.simulation import prepare
from studies.simulation.assembly import assemble
from tests.bounds import IDENTITY, LOCATED
from thread.catalogue import suture

PULL, FOOTPRINT = 0.05, 1.5e-3
SCENE: dict[str, Any] = {
    "tissue": {
        "youngs_modulus": 6e5,
        "poisson_ratio": 0.45,
        "density": 1070.0,
        "clamp": ["bottom"],
        "mesh": {"kind": "block", "size": [0.02, 0.016, 0.008], "h": 4e-3, "accuracy": "given"},
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


def test_tissue_tears_within_the_step_as_its_strength_is_reached() -> None:
    """Independent check: under a pull that grows evenly in time, after the share of the ramp that the strength is of
    what the whole pull bears with; the thread's own weight and swing are below the bound."""
    scene, ramp = deepcopy(SCENE), 0.1
    scene["tissue"] |= {"inertia": False}
    scene["thread"]["end"]["ramp"] = ramp
    scene["solve"] = {"dt": 1e-3, "duration": 0.06}
    torn = [event.time for record, _ in prepare(parse(scene)).advance() for event in record.events]
    expected = ramp * 2.5e4 / (PULL / (suture("2-0 polypropylene").diameter * 2.0 * FOOTPRINT))
    assert torn == [pytest.approx(expected, abs=LOCATED * 1e-3)]


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


def test_the_cells_at_a_hole_are_told_with_their_stretch() -> None:
    """Independent check: of tissue at finite strain that a thread pulls on, the cells on which the holes bear are
    stretched most and store most, and no more than that is told of them; the directions of the largest and the
    smallest stretch stand across one another."""
    block = [
        'tissue.element="P1"',
        "tissue.mesh.accuracy=given",
        "tissue.mesh.h_site=1.8e-3",
        "tissue.mesh.size=[0.03, 0.014, 0.01]",
    ]
    simulation = prepare(load("skin", [*block, "thread.control_points=80", "solve.load_steps=1"]))
    *_, (last, drawn) = simulation.advance()
    organ = drawn().organ
    assert organ is not None and organ.hole_strain is not None and organ.principal_stretch is not None
    assert organ.hole_strain.max() == organ.strain.max() == np.abs(organ.principal_stretch - 1.0).max()
    met = nothing_met(2, 0).after_step(last).after_frame(organ)
    told = range_summary(["entry", "exit"], met)["piercings"]
    assert [told[name]["cell_strain"] for name in ("entry", "exit")] == organ.hole_strain.tolist()
    assert max(told[name]["cell_energy"] for name in ("entry", "exit")) == organ.energy_density.max()
    across = np.einsum("ci,ci->c", organ.first_stretch, organ.third_stretch)
    assert np.abs(across).max() <= IDENTITY
