"""Loads of a scenario: what they do to an organ with a thread in it, their work, resume, and what is refused."""

import csv
import json
from collections.abc import Callable
from copy import deepcopy
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from studies.command import command
from studies.output.columns import state_summary
from studies.output.remarks import bounds
from studies.scenario import ScenarioError, dump, parse
from studies.scenario.course import Timed
from studies.simulation import prepare
from studies.simulation.assembly import assemble
from tests.bounds import RESIDUAL

E, NU, SIZE = 2e5, 0.3, (0.02, 0.016, 0.008)
AUDIT = 1e-9  # of the work: what a step's equations may be off by, times its motion
SCENE: dict[str, Any] = {
    "tissue": {
        "youngs_modulus": E,
        "poisson_ratio": NU,
        "density": 1070.0,
        "roller": ["left", "front", "bottom"],
        "mesh": {"kind": "block", "size": SIZE, "h": 4e-3, "accuracy": "given"},
        "load": [{"boundary": "right", "traction": [2e2, 0, 0]}, {"boundary": "top", "pressure": 50.0, "ramp": 4e-3}],
    },
    "thread": {
        "suture": "2-0 polypropylene",
        "control_points": 20,
        "damping": 20.0,
        "path": [[-0.002, 0, -0.006], [-0.002, 0, 0.01]],
    },
    "piercing": [{"name": "hole", "at": [-0.002, 0, 0], "kind": "anchored", "footprint": 2e-3}],
    "solve": {"dt": 1e-3, "duration": 8e-3},
    "output": {"every": 4},
}


def changed(**tissue: Any) -> dict[str, Any]:
    """The scene with other keys of the organ."""
    table = deepcopy(SCENE)
    table["tissue"] |= tissue
    return table


def test_a_load_strains_the_organ_under_a_thread_in_statics() -> None:
    """Independent check: a free thread bears nothing, and the hole moves with uniform strain, σ_x = 200 Pa and
    σ_z = −50 Pa; the loads' resultants and shares are in the records."""
    table = changed()
    table["tissue"]["load"][1]["ramp"] = 0.0
    table["solve"] = {"kind": "static", "load_steps": 4}
    table["thread"]["end"] = {"kind": "pulled", "force": [0, 0, 1e-9]}
    records = [record for record, _ in prepare(parse(table)).advance()]
    (hole,) = records[-1].piercings
    from_corner = np.array(hole.x) - hole.displacement + [0.5 * SIZE[0], 0.5 * SIZE[1], SIZE[2]]
    strain = np.array([2e2 + NU * 50.0, -NU * 2e2 + NU * 50.0, -50.0 - NU * 2e2]) / E
    assert np.abs(hole.displacement - strain * from_corner).max() <= 1e-5 * np.abs(strain * from_corner).max()
    assert [load.share for load in records[2].loads] == [0.5, 0.5]
    force = records[-1].loads[1].force
    assert force == pytest.approx([0, 0, -50.0 * SIZE[0] * SIZE[1]], rel=RESIDUAL, abs=1e-15)
    energy = records[-1].energy
    stored = energy.elastic_thread + energy.elastic_tissue - records[0].energy.elastic_thread
    assert energy.external_work == pytest.approx(stored, rel=1e-6)  # the trapezoidal rule is exact in a linear organ
    assert abs(energy.balance_error) <= AUDIT * energy.external_work


@pytest.mark.parametrize(
    ("inertia", "solve"),
    [(True, {}), (False, {"integrator": "euler"}), (True, {"integrator": "euler", "coupling": "staggered"})],
)
def test_the_energy_balance_closes_in_time(inertia: bool, solve: dict[str, Any]) -> None:
    """Independent check: by every way to step the work of the loads is booked outside, and the balance closes."""
    table = changed(inertia=inertia, rayleigh=[2.0, 1e-4])
    table["solve"] |= {"duration": 4e-3} | solve
    records = [record for record, _ in prepare(parse(table)).advance()]
    energy = records[-1].energy
    assert energy.external_work > energy.kinetic + energy.elastic_tissue > 0.0
    assert abs(energy.balance_error) <= AUDIT * energy.external_work
    assert [load.share for load in records[2].loads] == [1.0, 0.5]


def test_a_ramp_without_inertia_does_the_work_that_is_stored() -> None:
    """Independent check: by BDF2 works are of the mean force, so that a ramped load on a quasi-static organ does what
    is stored but for the first step, of backward Euler, which does its ΔE twice: (1/8)² of it."""
    table = changed(inertia=False, load=[{"boundary": "top", "pressure": 50.0, "ramp": 8e-3}])
    energy = [record for record, _ in prepare(parse(table)).advance()][-1].energy
    assert energy.external_work == pytest.approx(energy.elastic_tissue * (1.0 + 1.0 / 64), rel=1e-3)


COURSE = [[0.0, 0.0], [0.25, 1.0], [1.0, 0.2]]


@pytest.mark.parametrize("material", ["linear", "neo-hookean"])
def test_loads_at_rest_follow_their_courses(material: str) -> None:
    """Independent check: a linear organ under two loads of one course moves by the factor of its course at each load
    step; a neo-Hookean one of small strain nearly so. The thread, under the whole load, bears the same at its hole."""
    load = [{"boundary": "right", "traction": [20.0, 0, 0], "course": COURSE}]
    load += [{"boundary": "top", "pressure": 5.0, "course": COURSE}]
    table = changed(load=load, material=material)
    table["solve"] = {"kind": "static", "load_steps": 8}
    table["thread"]["end"] = {"kind": "pulled", "force": [0, 0, 1e-9], "course": COURSE}
    records = [record for record, _ in prepare(parse(table)).advance()]
    factors = np.interp([record.time for record in records], *np.transpose(COURSE))
    assert [load.share for record in records for load in record.loads] == pytest.approx(
        np.repeat(factors, 2), abs=1e-12
    )
    moved = np.array([record.piercings[0].displacement for record in records])
    allowed = 1e-5 if material == "linear" else 2.0 * 20.0 / E + 1e-5
    assert np.abs(moved - factors[:, None] * moved[2]).max() <= allowed * np.abs(moved).max()
    held = np.array([record.piercings[0].force for record in records])
    assert -held[:, 2] == pytest.approx(1e-9 * factors, rel=1e-3, abs=1e-14)


@pytest.mark.parametrize(
    ("keys", "rows", "grows"),
    [
        ({}, [[0, 0], [1, 1]], 1.0),
        ({"ramp": 0.0}, [[0, 0], [1, 1]], 1.0),
        ({"course": [[0, 1]]}, [[0, 0], [1, 1]], 1.0),
        ({"course": [[0, 1], [1, 1]]}, [[0, 0], [1, 1]], 1.0),
        ({"course": [[0, 1], [2, 1], [3, 0]], "until": 1.5}, [[0, 0], [1, 1]], 1.0),
        ({"until": 2.0}, [[0, 0], [1, 1]], 1.0),
        ({"ramp": 0.5}, [[0, 0], [0.5, 1]], 0.5),
        ({"ramp": 2.0}, [[0, 0], [2, 1]], 2.0),
        ({"from": 0.25, "ramp": 0.5}, [[0.25, 0], [0.75, 1]], 0.5),
        ({"from": 0.2}, [[0.2, 0], [0.2 + 1e-6, 1]], 0.0),
        ({"course": [[0, 1], [1, 0.5]]}, [[0, 1], [1, 0.5]], 0.0),
    ],
)
def test_a_load_at_rest_is_one_function_of_time_however_written(
    keys: dict[str, Any], rows: list[list[float]], grows: float
) -> None:
    """Independent check: what is whole throughout grows with the load steps, a ramp and every other course are
    followed, on the organ and on the thread; the summary says how the thread's load grows."""
    table = changed(load=[{"boundary": "right", "traction": [20.0, 0, 0], **keys}])
    table["solve"] = {"kind": "static", "load_steps": 4}
    table["thread"]["end"] = {"kind": "pulled", "force": [0, 0, 1e-9], **keys}
    simulation = prepare(parse(table))
    steps = [record for record, _ in simulation.advance() if record.time > 0.0]
    factors = np.interp([step.time for step in steps], *np.transpose(rows))
    assert [step.loads[0].share for step in steps] == pytest.approx(factors, abs=1e-8)  # of `from`, 1e-9 earlier
    pulls = [-step.piercings[0].force[2] for step in steps]
    assert pulls == pytest.approx(1e-9 * factors, rel=1e-3, abs=1e-14)
    assert state_summary(steps[-1], simulation.scenario)["thread"]["end"]["grows_within"] == grows


@pytest.mark.parametrize("dt", [1e-3, 2e-3])
def test_the_impulse_of_a_sudden_load_is_its_force_times_its_time(dt: float) -> None:
    """Independent check: momentum of a heavy end, a hundred times the thread, under a force from 10 to 20 ms; a step
    that ends at `from` has no load, and one that ends at `until` has it: as many are loaded as fit into the time."""
    end: dict[str, Any] = {"kind": "pulled", "force": [1e-3, 0, 0], "from": 0.01, "until": 0.02, "ramp": 0}
    end["mass"] = 1e-3
    thread = {"suture": "2-0 polypropylene", "control_points": 8, "path": [[0, 0, 0], [0.1, 0, 0]], "end": end}
    *_, (last, _) = prepare(parse({"thread": thread, "solve": {"duration": 0.05, "dt": dt}})).advance()
    assert np.sqrt(2.0 * last.energy.kinetic * end["mass"]) == pytest.approx(1e-5, rel=30.0 * dt)


@pytest.mark.parametrize(
    ("course", "factor"),
    [
        ({"kind": "ramp", "over": 4e-3}, lambda t: min(t / 4e-3, 1.0)),
        (
            {"kind": "hold", "rise": 2e-3, "hold": 2e-3, "fall": 4e-3},
            lambda t: np.interp(t, [0, 2e-3, 4e-3, 8e-3], [0, 1, 1, 0]),
        ),
        ({"kind": "cycle", "period": 4e-3, "low": 0.2}, lambda t: 0.6 - 0.4 * np.cos(np.pi * t / 2e-3)),
        ({"kind": "cough", "at": 2e-3, "duration": 4e-3}, lambda t: np.sin(np.pi * np.clip(250 * t - 0.5, 0, 1)) ** 2),
    ],
    ids=["ramp", "hold", "cycle", "cough"],
)
def test_loads_in_time_follow_their_courses(course: dict[str, Any], factor: Callable[[float], float]) -> None:
    """Independent check: each named course is its formula at the ends of steps, which fall on its rows; counted from
    `from`, and zero before and after `until`."""
    load = [{"boundary": "top", "pressure": 50.0, "course": course}]
    load += [load[0] | {"from": 3e-3, "until": 6e-3}]
    records = [record for record, _ in prepare(parse(changed(load=load))).advance()]
    for record in records[1:]:
        whole, part = (entry.share for entry in record.loads)
        assert whole == pytest.approx(factor(record.time), abs=1e-9)
        late = factor(record.time - 3e-3) if 3e-3 + 1e-9 < record.time < 6e-3 + 1e-9 else 0.0
        assert part == pytest.approx(late, abs=1e-6)


FINITE: dict[str, Any] = {"material": "exponential", "stiffening": 5.0, "prestretch": [1.01, 1.0, 0.99]}


@pytest.mark.parametrize("material", [{}, FINITE], ids=["linear", "exponential"])
def test_a_run_under_loads_resumes_to_the_same_numbers(tmp_path: Path, material: dict[str, Any]) -> None:
    """Consistency check: 4 steps and 4 more are 8, bit by bit; tables and summary tell of the loads."""
    whole, parts, file = tmp_path / "whole", tmp_path / "parts", tmp_path / "scene.toml"
    file.write_text(dump(parse(changed(**material))))
    say = ["--quiet", "--no-picture"]
    assert command.main(["run", str(file), "--out", str(whole), *say]) == 0
    assert command.main(["run", str(file), "--out", str(parts), "--set", "solve.duration=4e-3", *say]) == 0
    assert command.main(["run", str(file), "--out", str(parts), "--resume", *say]) == 0
    for name in ("piercings.csv", "energy.csv", "loads.csv"):
        assert (whole / name).read_bytes() == (parts / name).read_bytes()
    rows = list(csv.DictReader((whole / "loads.csv").read_text().splitlines()))
    assert [row["boundary"] for row in rows[:2]] == ["right", "top"] and float(rows[3]["share [-]"]) == 0.25
    assert [load["share"] for load in json.loads((whole / "summary.json").read_text())["loads"]] == [1.0, 1.0]


def test_a_surface_under_pressure_that_turns_has_a_remark() -> None:
    """Independent check: a plate held at one end and pressed from above turns by more than linear elasticity bears."""
    table = changed(clamp=["left"], roller=[], load=[{"boundary": "top", "pressure": 2e3}], youngs_modulus=1e4)
    table["solve"] = {"kind": "static", "load_steps": 1}
    table["thread"]["end"] = {"kind": "pulled", "force": [0, 0, 1e-2]}
    simulation = prepare(parse(table))
    (_, *_, (_, frame)) = simulation.advance()
    organ = frame().organ
    assert organ is not None and organ.pressed_turn > bounds.SMALL_ROTATION


@pytest.mark.parametrize(
    ("load", "words"),
    [
        ({"boundary": "topp", "pressure": 1.0}, r'load\.0\.boundary = "topp".*nearest is "top"'),
        ({"boundary": "top", "pressure": 1.0, "traction": [1, 0, 0]}, r"load\.0\.pressure = 1\.0.*leave out one"),
        ({"boundary": "top"}, r"load\.0\.traction is missing"),
        ({"boundary": "right", "pressure": 1.0}, r'load\.0\.boundary = "right".*is clamped'),
        ({"boundary": "left", "pressure": 1.0}, r'load\.0\.boundary = "left".*a roller holds its normal direction'),
        ({"boundary": "corner", "traction": [1, 0, 0]}, r'load\.0\.boundary = "corner".*the whole boundary is held'),
        ({"boundary": "top", "pressure": 1.0, "ramp": -1.0}, r"load\.0\.ramp = -1\.0"),
        ({"boundary": "top", "pressure": 1.0, "course": [[0, 0], [1.05e-4, 1], [1.1e-4, 0]]}, r"turns at 0\.000105 s"),
        ({"boundary": "top", "pressur": 1.0}, r"nearest is tissue\.load\.0\.pressure"),
    ],
)
def test_refusals(load: dict[str, Any], words: str) -> None:
    """Independent check: a load that cannot be or does nothing is refused by its key before anything is solved."""
    box = [[0.0099, -1, -1], [1, 1, 1]]
    corner = [{"name": "corner", "box": box}]
    with pytest.raises(ScenarioError, match=words):
        assemble(parse(changed(load=[load], clamp=["right"], roller=["left"], boundary=corner)))


@pytest.mark.parametrize(
    ("load", "time"),
    [
        ({"course": [[0, 0], [0.16, 1], [0.2, 0]]}, 0.16),
        ({"course": [[0, 0], [0.1, 1], [0.2, 0]]}, None),
        ({"course": [[0, 0], [1, 1]], "until": 0.55}, None),
        ({"course": [[0, 0], [0.52, 1], [0.54, 0.99], [0.56, 1], [1, 1]]}, None),
        ({"course": [[0, 0], [1, 0], [1.045, 1], [3, 0]]}, None),
        ({"course": {"kind": "hold", "rise": 0.01, "hold": 0.01, "fall": 0.01}}, 0.01),
        ({"from": 0.12, "until": 0.14}, 0.12),
        ({"from": 0.12, "until": 0.24}, None),
    ],
)
def test_a_turn_is_missed_if_no_step_is_near_its_height(load: dict[str, Any], time: float | None) -> None:
    """Independent check: by hand, for steps of 0.1 s and a last one of 0.05 s."""
    missed = Timed.model_validate(load).missed_turn(0.1, 1.05)
    assert (None if missed is None else missed[0]) == (None if time is None else pytest.approx(time))


@pytest.mark.parametrize("knots", ["travelling", "fixed"])
def test_the_weight_of_a_thread_does_the_work_of_its_mean(knots: str) -> None:
    """Independent check: in one load step or in eight, the weight of a slack thread that grows does what is stored, and
    no end force is reported where nothing holds the end."""
    works = []
    for steps in (1, 8):
        thread = {
            "diameter": 3e-4,
            "youngs_modulus": 1e9,
            "density": 1e5,
            "knots": knots,
            "path": [[0.0, 0.0, 0.0], [0.02, 0.0, 0.0]],
            "start": {"kind": "clamped"},
        }
        solve = {"kind": "static", "load_steps": steps, "gravity": [0.0, 0.0, -9.81]}
        table = {"thread": thread, "solve": solve}
        first, *_, last = (record for record, _ in prepare(parse(table)).advance())
        works.append(last.energy.external_work / (last.energy.elastic_thread - first.energy.elastic_thread))
        assert not last.end_reaction.any()
    assert works == pytest.approx([1.0, 1.0], rel=0.05)
    assert abs(works[1] - 1.0) < 0.1 * abs(works[0] - 1.0) + 1e-4
