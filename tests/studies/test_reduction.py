"""A scenario whose organ moves in a small basis: its numbers, what is said of them, and what is refused."""

from pathlib import Path

import numpy as np
import pytest

import tissue
from studies.output.records import StepRecord
from studies.output.tally import Tally
from studies.scenario import ScenarioError, load
from studies.scenario.toml import SCENES
from studies.simulation import prepare
from studies.simulation.sharing import Shared
from studies.simulation.simulation import Simulation

COARSE = [
    "thread.control_points=60",
    "tissue.mesh.h_site=2.0e-3",
    "tissue.mesh.h=5.0e-3",
    "tissue.mesh.accuracy=given",
    "solve.duration=0.02",
    "thread.start.ramp=0.01",
    "piercing.exit.friction={ static = 0.12, kinetic = 0.1 }",
]
SMALL = "tissue.reduction={ blocks = 2 }"


def stepped(simulation: Simulation) -> tuple[list[StepRecord], Tally]:
    """All steps of a run, and what they come to, with its first and last frame."""
    tally = simulation.tally()
    steps = []
    for step, frame in simulation.advance():
        steps.append(step)
        tally.count(step)
        tally.last_step, last = step, frame
    tally.see(last().organ)
    return steps, tally


def way(steps: list[StepRecord], hole: int) -> np.ndarray:
    return np.array([step.piercings[hole].displacement for step in steps])


def test_the_main_job_in_a_small_basis_is_within_what_it_says() -> None:
    """Consistency check: two holes of the shipped scene, coarse, with friction, by the whole organ and in a basis of 54
    vectors. At every step holes and forces are within the bounds that the summary tells, the energy audit closes as
    well, and stress is drawn from the whole field."""
    (whole, _), (small, tally) = (stepped(prepare(load("two_piercings", [*COARSE, *more]))) for more in ([], [SMALL]))
    said = tally.summary("completed")["reduction"]
    assert said["vectors"] == 54 and "reduction" not in {remark.code for remark in tally.remarks}
    for hole, name in enumerate(("entry", "exit")):
        found, largest = said["piercings"][name], np.abs(way(whole, hole)).max()
        error = np.linalg.norm(way(whole, hole) - way(small, hole), axis=1)
        force = [
            np.linalg.norm(a.piercings[hole].force - b.piercings[hole].force) for a, b in zip(whole, small, strict=True)
        ]
        assert error.max() <= found["bound"] <= 0.03 * largest
        assert max(force) <= found["force_bound"]
        assert found["difference"] <= 1e-5 * largest and error.max() <= 1e-5 * largest
    assert abs(small[-1].energy.balance_error) <= 1e-10 * small[-1].energy.external_work


def test_a_small_basis_of_an_organ_under_loads_with_a_tract() -> None:
    """Consistency check: the loads are those of the whole organ, what is left open is told of the two piercings and not
    of the balls between them, and the first of these moves as in the whole organ."""
    more = [
        "thread.control_points=100",
        "tract=[{ between=['entry', 'exit'], radius=1.5e-3 }]",
        "tissue.load=[{ boundary='top', pressure=50.0, ramp=0.002 }]",
        "tissue.mesh.h=8.0e-3",
        "tissue.mesh.accuracy=given",
        "tissue.mesh.h_site=4.0e-3",
        "solve.duration=2.0e-3",
    ]
    (whole, _), (small, tally) = (stepped(prepare(load("two_piercings", [*COARSE, *more, *s]))) for s in ([], [SMALL]))
    assert [np.array_equal(a.loads[0].force, b.loads[0].force) for a, b in zip(whole, small, strict=True)] == [True] * 3
    assert small[-1].reduction is not None and small[-1].reduction.bound.shape == (2,)
    assert set(tally.summary("completed")["reduction"]["piercings"]) == {"entry", "exit"}
    ball, other = (steps[-1].tracts[0].balls[0].displacement for steps in (small, whole))
    assert np.linalg.norm(ball - other) <= 1e-3 * np.linalg.norm(other)


def test_a_basis_too_small_for_a_motion_says_so() -> None:
    """Independent check: tissue of 40 kPa without damping, whose slowest period is longer than the pull, by static
    answers alone: a remark says which holes are not supported."""
    quick = ["tissue.youngs_modulus=4e4", "tissue.rayleigh=[0, 0]", "thread.start.force=[-0.015, 0, 0.01]"]
    quick += ["thread.start.ramp=0.002", "solve.duration=0.012"]
    _, tally = stepped(prepare(load("two_piercings", [*COARSE, *quick, "tissue.reduction={ blocks = 0 }"])))
    assert {"entry", "exit"} >= {remark.where for remark in tally.remarks if remark.code == "reduction"} != set()


def test_a_basis_is_shared_by_what_damps_otherwise() -> None:
    """Consistency check: cases that differ in damping alone share mesh, body and basis; with more blocks the basis is
    made anew, and a thread that differs shares the organ."""
    store = Shared()
    less = "tissue.reduction.blocks=1"
    one, damped, blocks, thread = (
        prepare(load("two_piercings", [*COARSE, *more]), store).assembly.organ
        for more in (
            [SMALL],
            [SMALL, "tissue.rayleigh=[1, 0]"],
            [less],
            [less, "thread.damping=1"],
        )
    )
    assert one.reduction is damped.reduction and one is not damped
    assert blocks.reduction.size < one.reduction.size
    assert thread is blocks


def test_a_basis_is_kept_for_what_it_is_made_from(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Consistency check: a later run takes the basis from the folder, makes none, and moves to the same bits; damping
    and the thread change nothing of it, material, holes and blocks do. A torn file is made anew, and one whose numbers
    were changed: values times 1.5 would be 1.5 times the displacement."""
    keep = [
        "tissue.mesh.h_site=4e-3",
        "tissue.mesh.h=8e-3",
        "tissue.mesh.accuracy=given",
        f'tissue.reduction={{ blocks = 1, keep = "{tmp_path}" }}',
    ]
    made: list[int] = []

    def reduce_organ(organ: tissue.DynamicOrgan, *numbers: int) -> tissue.Reduction:
        made.append(1)
        return plain(organ, *numbers)

    plain = tissue.reduce_organ
    monkeypatch.setattr("tissue.reduce_organ", reduce_organ)

    def made_for(*more: str) -> int:
        before = len(made)
        prepare(load("two_piercings", [*COARSE, *keep, *more]))
        return len(made) - before

    few = [*COARSE, *keep, "solve.duration=3.0e-3"]
    first, second = (stepped(prepare(load("two_piercings", few)))[0][-1] for _ in range(2))
    assert len(made) == 1 == len(list(tmp_path.iterdir()))
    for one, other in zip(first.piercings, second.piercings, strict=True):
        assert np.array_equal(one.displacement, other.displacement) and np.array_equal(one.force, other.force)
    assert not made_for("tissue.rayleigh=[1, 0]") and not made_for("thread.damping=1")
    for other in ("tissue.density=1000.0", "piercing.exit.footprint=3e-3", "tissue.reduction.blocks=2"):
        assert made_for(other) == 1
    for file in tmp_path.iterdir():
        file.write_bytes(file.read_bytes()[:-100])
    assert made_for() == 1 and not made_for()
    for file in tmp_path.iterdir():
        file.unlink()
    assert made_for() == 1
    [file] = tmp_path.iterdir()
    with np.load(file) as found:
        larger = {name: 1.5 * values if values.dtype.kind == "f" else values for name, values in found.items()}
    np.savez(file, **larger)
    assert made_for() == 1 and not made_for()


def test_a_folder_of_bases_stands_beside_its_scenario(tmp_path: Path) -> None:
    """Consistency check: as the path of a mesh does; and a folder that cannot be is refused by its key."""
    file = tmp_path / "scene.toml"
    text = (SCENES / "two_piercings.toml").read_text()
    file.write_text(text.replace("[tissue]", "[tissue]\nreduction = { keep = 'bases' }"))
    scenario = load(file, COARSE)
    assert scenario.tissue is not None and scenario.tissue.reduction is not None
    assert scenario.tissue.reduction.keep == str(tmp_path / "bases")
    (tmp_path / "bases").write_text("no folder")
    with pytest.raises(ScenarioError, match=r"tissue\.reduction\.keep = .*bases.*cannot be written"):
        prepare(scenario)


REFUSED = {
    "finite strain": (['tissue.material="neo-hookean"', "tissue.rayleigh=[1, 0]"], "material is neo-hookean"),
    "quasi-static": (["tissue.inertia=false"], "inertia is false"),
    "static": (['solve.kind="static"'], "solve.kind is static"),
    "contact": (['contact=[{ between = ["left", "right"] }]'], "there is \\[\\[contact\\]\\]"),
    "blocks": (["tissue.reduction.blocks=-1"], "tissue.reduction.blocks = -1"),
    "key": (["tissue.reduction.block=1"], "the nearest is tissue.reduction.blocks"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_no_basis_can_do_is_refused(case: str) -> None:
    """Independent check: by its key, before anything is made."""
    keys, text = REFUSED[case]
    with pytest.raises(ScenarioError, match=text):
        load("two_piercings", [SMALL, *keys])


def test_lips_that_touch_are_refused_with_a_basis() -> None:
    """Independent check: a wound whose lips press on one another, by the key."""
    wound = "tissue.mesh={ kind = 'wound', size = [0.05, 0.03, 0.02], h = 4e-3, length = 0.01, depth = 5e-3 }"
    with pytest.raises(ScenarioError, match=r"tissue\.reduction is refused: contact is true"):
        load("two_piercings", [wound, "tissue.contact=true", SMALL])
