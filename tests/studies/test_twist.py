"""Scenarios with twist, a coil or springs: what is refused, what is written, and that a run goes on where it was."""

import json
import tomllib
from pathlib import Path

import numpy as np
import pytest
import pyvista as pv

from studies.command import command
from studies.scenario import ScenarioError, dump, load, parse
from studies.simulation import prepare
from tests.bounds import LINEAR

SCENARIO = """
[thread]
suture = "2-0 polypropylene"
control_points = 24
path = [[0, 0, 0], [0.06, 0, 0]]
twist = true
coil_radius = 0.03
coil_towards = [0, 0, 1]
start = { kind = "clamped" }
end = { kind = "driven", waypoints = [[0, 0.06, 0, 0], [0.05, 0.058, 0, 0]], turn = [[0, 0], [0.05, 3.0]] }
[[piercing]]
name = "ring"
at = [0.03, 0, 0]
[solve]
dt = 2.5e-3
duration = 0.05
[output]
every = 5
"""
REFUSED = [
    ("thread.twist=false", ["thread.end.turn", "thread.twist = true"]),
    ("thread.bending=false", ["thread.twist = true", "bending = true"]),
    ("thread.coil_radius=0", ["thread.coil_radius = 0", "greater than 0", "[m]"]),
    ("thread.coil_towards=[1, 0, 0]", ["thread.coil_towards", "parallel to the start of the path", "across"]),
    ("thread.springs=40", ["thread.springs = 40", "springs"]),
    ("thread.bending_factor=0", ["thread.bending_factor = 0", "greater than 0"]),
    ("thread.energy=spring", ['thread.energy = "spring"', '"continuous" or "springs"']),
    ("thread.end.turn=[[0, 1.0]]", ["thread.end.turn", "t = 0", "[0, 0]"]),
    ("thread.end.turn=[[0, 0], [0, 1]]", ["thread.end.turn.1 = [0.0, 1.0]", "later than 0.0 s", "sort"]),
    ("thread.start={kind='free', turn=[[0, 0]]}", ["thread.start.turn", "no such key"]),
]


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "turned.toml"
    path.write_text(SCENARIO, encoding="utf-8")
    return path


@pytest.mark.parametrize(("override", "words"), REFUSED)
def test_refused(file: Path, override: str, words: list[str]) -> None:
    """Independent check: one sentence with the key, what is allowed and the remedy."""
    with pytest.raises(ScenarioError) as error:
        load(file, [override])
    assert len(error.value.problems) == 1
    for word in words:
        assert word in str(error.value)


def test_a_coil_needs_twist_and_statics_a_held_section(file: Path) -> None:
    """Independent check: the sentences of the two refusals that want more than one key changed."""
    free = "thread.end={kind='driven', waypoints=[[0, 0.06, 0, 0]]}"
    with pytest.raises(ScenarioError, match=r"coil_radius .*thread\.twist = true"):
        load(file, ["thread.twist=false", free])
    with pytest.raises(ScenarioError, match=r"thread\.twist .*rotate freely"):
        load(file, ["thread.start={kind='fixed'}", free, "solve.kind=static"])
    assert load(file, [free, "solve.kind=static"]).thread.twist


def test_a_run_with_twist(file: Path) -> None:
    """Independent check: summary and table hold the torque of the hand that turns, the frames that along the thread;
    and the scenario reads back as it was written."""
    out = file.parent / "out"
    assert command.main(["run", str(file), "--out", str(out), "--quiet", "--no-picture"]) == 0
    thread = json.loads((out / "summary.json").read_text())["thread"]
    assert thread["end"]["torque"] > 0.0
    assert len(thread["end"]["reaction"]) == 3
    head, *_, last = (line.split(",") for line in (out / "steps.csv").read_text().splitlines())
    assert float(last[head.index("end_torque [N m]")]) == thread["end"]["torque"]
    drawn = pv.read(sorted((out / "frames").glob("thread_*.vtp"))[-1])
    assert "torque" in drawn.array_names
    scenario = load(file)
    assert load(out / "scenario.toml").thread.coil_radius == 0.03
    assert parse_again(dump(scenario)) == dump(scenario)


def parse_again(text: str) -> str:
    """A scenario's text read and written once more."""
    return dump(parse(tomllib.loads(text)))


def test_a_run_with_twist_goes_on_where_it_was(file: Path) -> None:
    """Consistency check: from the memory of the tenth step, the twist's frame included, the same numbers bit by bit."""
    simulation = prepare(load(file, ["solve.integrator=bdf2"]))
    whole = [step for step, _ in simulation.advance()]
    again = [step for step, _ in simulation.advance(whole[10].memory)]
    last, other = whole[-1].memory, again[-1].memory
    assert last is not None and other is not None
    assert "state.frame.tau" in last
    assert last.keys() == other.keys()
    assert all(np.array_equal(last[key], other[key]) for key in last)


def test_static_twist(file: Path) -> None:
    """Independent check: a straight thread without a coil, turned in load steps: GJ φ/L at both ends."""
    path = "thread.end={kind='driven', waypoints=[[0, 0.06, 0, 0]], turn=[[0, 0], [0.05, 2.0]]}"
    text = SCENARIO.replace("coil_radius = 0.03\ncoil_towards = [0, 0, 1]\n", "")
    file.write_text(text, encoding="utf-8")
    simulation = prepare(load(file, [path, "solve.kind=static", "solve.load_steps=4"]))
    *_, (last, frame) = simulation.advance()
    torque = simulation.assembly.system.thread.section.GJ * 2.0 / 0.06
    assert last.torques is not None
    assert np.abs(np.array(last.torques) / torque - [-1.0, 1.0]).max() < LINEAR
    assert frame().thread.torque is not None
    assert np.abs(frame().thread.torque / torque - 1.0).max() < LINEAR


@pytest.mark.parametrize("springs", ["", "thread.springs=30"])
def test_springs_of_a_scenario(file: Path, springs: str) -> None:
    """Independent check: n − 1 springs unless a number is given, and the run is completed."""
    simulation = prepare(load(file, ["thread.energy=springs", *([springs] if springs else [])]))
    layout = simulation.assembly.system.thread.spring_layout
    assert layout is not None and layout.length.size == (30 if springs else 23)
    *_, (last, _) = simulation.advance()
    assert last.step == 20


def test_a_bending_factor_of_ones_own(file: Path) -> None:
    """Independent check: it scales the bending and torsional stiffness of the solid rod and nothing else."""
    whole, half = (
        prepare(load(file, [f"thread.bending_factor={x}"])).assembly.system.thread.section for x in (1.0, 0.5)
    )
    assert (half.EI / whole.EI, half.GJ / whole.GJ, half.EA / whole.EA) == (0.5, 0.5, 1.0)
