"""A scene in other units of length and force is the same scene."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest

from studies.arrays import Array
from studies.scenario import load, parse
from studies.scenario.reference import unit_of
from studies.scenario.toml import tables
from studies.simulation import prepare
from tests.bounds import TWO_SOLVERS
from tests.meshes.samples import NEEDS_GMSH
from thread.catalogue import suture

ROWS = {"waypoints": "m", "pull": "N", "draw": "m"}  # of a time [s] first
FRICTION = "piercing.friction={static = 0.15, kinetic = 0.12, grip = 1e-3}"
TURNED = (
    "thread.end.waypoints=[[0, 0.02, 0, 0.02], [0.1, 0.026, 0, 0.023], [0.2, 0.02, 0, 0.02], [0.3, 0.028, 0, 0.024]]"
)
SCENES = {
    "two_piercings": (FRICTION, TURNED, "solve.duration=0.25", "tissue.mesh.accuracy=0.1"),
    "stitch_by_stitch": (),  # at rest, by gmsh, with slack strands
}


def size_of(unit: str, metre: float, newton: float) -> float:
    """Return a unit of the manual where a metre and a newton are such numbers; seconds stay."""
    kilogram = newton / metre
    sizes = {"m": metre, "m/s": metre, "m/s²": metre, "N": newton, "kg": kilogram}
    return (sizes | {"Pa": newton / metre**2, "kg/m³": kilogram / metre**3}).get(unit, 1.0)


def in_units(data: Mapping[str, Any], metre: float, newton: float, above: str = "") -> dict[str, Any]:
    """Return the tables of a scenario in other units, by the units of the manual."""

    def changed(key: str, value: Any, size: float) -> Any:
        if isinstance(value, Mapping):
            return in_units(value, metre, newton, f"{key}.")
        if isinstance(value, list | tuple):
            return [changed(key, each, size) for each in value]
        return value * size if isinstance(value, float) and size != 1.0 else value

    out = {}
    for name, value in data.items():
        if name in ROWS:
            out[name] = [[row[0], *(x * size_of(ROWS[name], metre, newton) for x in row[1:])] for row in value]
        else:
            out[name] = changed(above + name, value, size_of(unit_of(above + name), metre, newton))
    return out


def without_catalogue(data: dict[str, Any]) -> dict[str, Any]:
    """Return the tables of a scenario with the numbers of its suture."""
    thread = {key: value for key, value in data["thread"].items() if key != "suture"}
    section = suture(data["thread"]["suture"])
    names = ("diameter", "youngs_modulus", "density", "poisson_ratio", "bending_factor")
    assert section.solid_fraction == 1.0
    return data | {"thread": thread | {name: getattr(section, name) for name in names}}


def seen(data: dict[str, Any], metre: float, newton: float) -> tuple[Array, Array, list[tuple[str, str]]]:
    """Return forces and abscissae of the holes at every step, over those units, and the events by kind and hole."""
    records = [record for record, _ in prepare(parse(in_units(data, metre, newton))).advance()]
    forces = [[[*hole.force, hole.tension_after] for hole in record.piercings] for record in records]
    places = [[[hole.s, hole.slip] for hole in record.piercings] for record in records]
    events = [(event.kind, event.piercing) for record in records for event in record.events]
    return np.array(forces) / newton, np.array(places) / metre, events


@pytest.mark.parametrize("seed", [1, 2])
@pytest.mark.parametrize("name", ["two_piercings", pytest.param("stitch_by_stitch", marks=NEEDS_GMSH)])
def test_a_scene_in_other_units_is_the_same_scene(name: str, seed: int) -> None:
    """Independent check: a scene whose thread slips and sticks, in centimetres or millimetres and with a unit of force
    drawn by the seed: forces and abscissae over the largest, and the same events."""
    data = without_catalogue(dict(tables(load(name, SCENES[name]))))
    metre, newton = 10.0 ** (1 + seed), 10.0 ** np.random.default_rng(seed).uniform(-3.0, 3.0)
    forces, places, events = seen(data, 1.0, 1.0)
    same = seen(data, metre, newton)
    assert {"slips", "sticks"} <= {kind for kind, _ in events}
    assert same[0] == pytest.approx(forces, rel=0.0, abs=TWO_SOLVERS * np.abs(forces).max())
    assert same[1] == pytest.approx(places, rel=0.0, abs=TWO_SOLVERS * np.abs(places).max())
    assert same[2] == events
