"""A scene in other units of length and force is the same scene."""

from typing import Any

import numpy as np
import pytest

from studies.arrays import Array
from studies.scenario import parse
from studies.simulation import prepare

ROUNDED = 1e-12  # of the largest: round-off, where all numbers of the scene are times powers of two
SAME = 1e-8  # of the largest, where they are rounded too


def scene(metre: float, newton: float) -> dict[str, Any]:
    """Return a thread that is drawn through two rough holes and let back, in units by which a metre and a newton are
    such numbers; seconds stay."""
    mass, stress = newton / metre, newton / metre**2

    def place(*values: float) -> list[float]:
        return [value * metre for value in values]

    rough = {"static": 0.15, "kinetic": 0.12, "grip": 1e-3 * newton}
    hole = {"footprint": 1e-3 * metre, "friction": rough}
    hand = [[0.0, *place(0.04, 0, 0.012)], [0.03, *place(0.044, 0, 0.013)], [0.06, *place(0.041, 0, 0.012)]]
    return {
        "thread": {
            "diameter": 0.2e-3 * metre,
            "youngs_modulus": 1.5e9 * stress,
            "density": 1100 * mass / metre**3,
            "poisson_ratio": 0.4,
            "control_points": 40,
            "damping": 5.0,
            "path": [place(-0.04, 0, 0.012), place(-0.01, 0, 0), place(0.01, 0, 0), place(0.04, 0, 0.012)],
            "start": {"kind": "pulled", "force": [-0.05 * newton, 0, 0.02 * newton], "ramp": 0.02},
            "end": {"kind": "driven", "waypoints": hand},
        },
        "piercing": [
            hole | {"name": "a", "at": place(-0.01, 0, 0)},
            hole | {"name": "b", "at": place(0.01, 0, 0), "direction": [1, 0, 0.3], "channel": 2e-3 * metre},
        ],
        "solve": {"dt": 1e-3, "duration": 0.05, "newton": "numpy"},
    }


def seen(metre: float, newton: float) -> tuple[Array, list[tuple[str, str]]]:
    """Return forces and abscissae of the holes at every step, over those units, and the events by kind and hole."""
    records = [record for record, _ in prepare(parse(scene(metre, newton))).advance()]
    numbers = [[[*(hole.force / newton), hole.s / metre] for hole in record.piercings] for record in records]
    return np.array(numbers), [(event.kind, event.piercing) for record in records for event in record.events]


@pytest.fixture(scope="module")
def in_metres() -> tuple[Array, list[tuple[str, str]]]:
    return seen(1.0, 1.0)


@pytest.mark.parametrize(
    ("metre", "newton", "bound"), [(2.0, 1.0, ROUNDED), (1024.0, 4.0, ROUNDED), (100.0, 1.0, SAME), (1e3, 1e3, SAME)]
)
def test_a_scene_in_other_units_is_the_same(
    metre: float, newton: float, bound: float, in_metres: tuple[Array, list[tuple[str, str]]]
) -> None:
    """Independent check: what is drawn through rough holes and turns back there has the same forces, abscissae and
    events in centimetres, in millimetres, and in units that are powers of two of metres, to round-off."""
    numbers, events = in_metres
    other, other_events = seen(metre, newton)
    assert any(kind == "slips" for kind, _ in events) and any(kind == "sticks" for kind, _ in events)
    assert other_events == events
    assert np.abs(other - numbers).max() <= bound * np.abs(numbers).max()
