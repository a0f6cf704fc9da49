"""A thin thread on few points, which bends at a hole."""

import tomllib

import numpy as np
import pytest
from scipy.optimize import brentq

from studies.scenario import parse
from studies.simulation import Simulation, prepare
from studies.simulation.memory import OrganRun
from thread import catalogue

LAYER = 0.03  # of forces, couples and friction's part of the pull
MU, CHANNEL = 0.1, 10.0  # friction, and its channel over the diameter where there is no footprint
PULL, TURN = 0.3, 60.0


def at_rest(text: str) -> tuple[Simulation, OrganRun]:
    """A scenario and its equilibrium."""
    simulation = prepare(parse(tomllib.loads(text)))
    now = simulation.beginning()
    while now.number < simulation.steps:
        now = simulation.next(now)
    return simulation, now


def turned() -> tuple[Simulation, OrganRun]:
    """A thin thread on 40 points, turned by a right angle in one ideal hole and pulled."""
    return at_rest(f"""
[thread]
suture = "7-0 nylon"
path = [[-0.03, 0, 0], [0, 0, 0], [0, 0, 0.03]]
start = {{ kind = "fixed" }}
end = {{ kind = "pulled", force = [0, 0, {PULL}] }}
[[piercing]]
name = "ring"
at = [0, 0, 0]
direction = [1, 0, 1]
[solve]
kind = "static"
load_steps = 4
""")


def test_a_thin_thread_turned_by_a_right_angle() -> None:
    """Independent check: an ideal hole leaves the tension alone, so the held end bears what pulls at the other."""
    assert abs(np.linalg.norm(turned()[1].state.reaction[0]) / PULL - 1.0) <= LAYER


def first_integral(T: float, turn: float, EI: float, EA: float) -> float:
    """Couple [N m] of a long extensible elastica under T that turns by `turn` from its clamp."""
    return float(
        np.sign(turn) * np.sqrt(2.0 * EI * T * (1.0 - np.cos(turn)) * (1.0 + T * (1.0 + np.cos(turn)) / 2 / EA))
    )


@pytest.mark.parametrize(
    ("suture", "T", "spans"),
    [
        ("2-0 polypropylene", 5.0, 3.0),
        ("4-0 nylon", 1.0, 0.3),
        ("8-0 nylon", 0.01, 1.0),
        ("6-0 polypropylene", 0.1, 20.0),
    ],
)
def test_force_couple_and_friction_at_one_hole(suture: str, T: float, spans: float) -> None:
    """Independent check (Euler's elastica on each side of the hole, its couple and force pressing at both ends of the
    channel): the pull at slip, the hole's force and couple, on spans of so many √(EI/T) but at it."""
    section = catalogue.suture(suture)
    layer = float(np.sqrt(section.EI / T))
    _, now = at_rest(scene(suture, T, max(12.0, 6.0 * spans) * layer, layer, spans))
    hole, hand = now.piercings[0], now.state.reaction[1]
    assert hole.state == "slip"
    after = float(np.arctan2(hand[2], hand[0]))
    pulled = np.linalg.norm(hand)

    def force(T2: float) -> np.ndarray:
        return np.array([T2 * np.cos(after) - T, T2 * np.sin(after)])

    def couple(T2: float) -> float:
        return first_integral(T2, after, section.EI, section.EA)

    def lacking(T2: float) -> float:
        half, pressing = 0.5 * force(T2)[1], couple(T2) / (CHANNEL * section.diameter)
        return T2 - T - MU * (abs(half + pressing) + abs(half - pressing))

    told = brentq(lacking, T, 3.0 * T)
    assert abs((pulled - T) / (told - T) - 1.0) <= LAYER
    assert abs(np.linalg.norm(hole.force) / np.linalg.norm(force(told)) - 1.0) <= LAYER
    assert abs(np.linalg.norm(hole.couple) / couple(told) - 1.0) <= LAYER


def scene(suture: str, T: float, reach: float, layer: float, spans: float = 1.0, knots: str = "travelling") -> str:
    """A thread under T through one rough hole along x, whose hand goes round by TURN and outwards."""
    way = np.linspace(0.0, np.radians(TURN), 5)
    away = reach * (1.0 + 0.02 * np.arange(5))
    rows = np.column_stack([np.linspace(0.0, 1.0, 5), away * np.cos(way), 0.0 * way, away * np.sin(way)]).tolist()
    return f"""
[thread]
suture = "{suture}"
control_points = {round(2.0 * reach / (spans * layer)) + 3}
knots = "{knots}"
path = [[{-reach}, 0, 0], [{reach}, 0, 0]]
start = {{ kind = "pulled", force = [{-T}, 0, 0] }}
end = {{ kind = "driven", waypoints = {rows} }}
[[piercing]]
name = "hole"
at = [{0.3 * spans * layer}, 0, 0]
direction = [1, 0, 0]
friction = {{ static = {MU}, kinetic = {MU} }}
[solve]
kind = "static"
load_steps = 6
"""
