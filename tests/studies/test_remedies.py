"""What helps a run that failed, tried on copies of it."""

import json
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import pytest

import suturefem
from coupling.errors import CouplingError, CreatedEnergyError, TogetherError, TurnedHoleError
from studies.command import command
from studies.output.records import Snapshot, StepRecord
from studies.scenario import Scenario, ScenarioError
from studies.scenario.scenario import parse
from studies.scenario.toml import changed, dump, parsed, tables
from studies.simulation.remedies import MOST, PAST, remedies, try_remedies
from suturefem import load, prepare
from tests.studies.samples import Stub, framing, step

FAILURE = CouplingError("no convergence")
TURNED = TurnedHoleError(0.0, 1e-3, "no convergence")
LINEAR = ["solve.scheme='linear'", "solve.duration=0.05", "output.every=50"]


def scenario_of(**solve: Any) -> Scenario:
    """Return a thread through a ring in 100 steps, unless `solve` says otherwise."""
    thread = {"suture": "4-0 nylon", "control_points": 20, "path": [[0, 0, 0], [0.05, 0, 0]]}
    ring = {"name": "ring", "at": [0.02, 0.0, 0.0], "direction": "free"}
    return parse({"thread": thread, "piercing": [ring], "solve": {"dt": 1e-3, "duration": 0.1} | solve})


@dataclass(frozen=True)
class Copy(Stub):
    """Steps of a millisecond without physics, each of so many `corrections`; fails after `ends` of them."""

    ends: int = 100
    corrections: int = 3

    def advance(self, memory: object = None) -> Iterator[tuple[StepRecord, Callable[[], Snapshot]]]:
        for number in range(self.steps + 1):
            if number > self.ends:
                raise FAILURE
            time = number * self.scenario.solve.duration / self.steps
            yield replace(step(number), time=time, newton_iterations=self.corrections), framing(time)


def said_of(ways: dict[str, dict[str, int]], failed: int = 30) -> tuple[str, list[Scenario]]:
    """Return what is said of a run of 100 steps that failed after some, and the copies that were made; `ways` says by
    a setting what such a copy does, any other fails where the run did."""
    made: list[Scenario] = []

    def make(copy: Scenario) -> Copy:
        made.append(copy)
        keys = {"dt": copy.solve.dt < 1e-3, "points": copy.thread.control_points > 20}
        way = next((ways[key] for key, there in keys.items() if there and key in ways), {})
        ends, corrections = way.get("ends", failed), way.get("corrections", 3)
        return Copy(copy, steps=copy.solve.steps, ends=ends, corrections=corrections)

    last = replace(step(failed), time=failed * 1e-3)
    return try_remedies(scenario_of(), FAILURE, last, make).message, made


def test_the_first_remedy_that_helps_is_named_with_those_that_do_not() -> None:
    """Independent check: copies of which that with the finer thread alone gets past the step that failed."""
    said, made = said_of({"points": {"ends": 1000}})
    assert "with thread.control_points = 40 the run gets past t = 0.03 s" in said
    assert "no help: solve.dt = 0.00025" in said and len(made) == 2
    said, made = said_of({"dt": {"ends": 1000}})
    assert "with solve.dt = 0.00025 the run gets past" in said and "no help" not in said and len(made) == 1


@pytest.mark.parametrize(
    "solve", [{"scheme": "linear"}, {"scheme": "linear", "friction": "two-pass"}, {"friction": "two-pass"}]
)
def test_the_papers_options_are_replaced_together_by_what_is_exact(solve: dict[str, str]) -> None:
    """Independent check: the scenario with the first remedy is not refused, as one of them without the others is."""
    paper = scenario_of(**solve)
    exact = parsed(changed(tables(paper), next(remedies(paper, FAILURE)))).solve
    assert (exact.scheme, exact.friction, exact.integrator) == ("newton", "implicit", "bdf2")


def test_where_nothing_helps_it_says_so() -> None:
    """Independent check: copies that fail, and one that fails before it is well past, or would take too long."""
    told = "no remedy helped on a copy of the run; no help: solve.dt = 0.00025; "
    assert told in said_of({})[0]
    assert told in said_of({"dt": {"ends": 4 * (30 + PAST) - 1}})[0]
    slow = MOST // 100
    late = f"stopped after {MOST} corrections: solve.dt = 0.00025"
    assert said_of({"dt": {"ends": 1000, "corrections": slow}})[0].endswith(late)
    assert "no remedy helped" not in said_of({"dt": {"ends": 1000, "corrections": slow // 2}})[0]


def test_what_the_scenario_refuses_is_not_said_to_have_been_tried() -> None:
    """Independent check: copies with other knots are refused; none but that with shorter steps was tried."""

    def make(copy: Scenario) -> Copy:
        if copy.solve.dt == scenario_of().solve.dt:
            raise ScenarioError("refused")
        return Copy(copy, steps=copy.solve.steps, ends=0)

    said = try_remedies(scenario_of(), FAILURE, None, make).message
    assert said == "no remedy helped on a copy of the run; no help: solve.dt = 0.00025"


def test_a_copy_that_comes_to_its_end() -> None:
    """Independent check: a run that failed near its end."""
    assert "with solve.dt = 0.00025 the run reaches its end" in said_of({"dt": {"ends": 1000}}, failed=98)[0]


def test_what_is_tried_goes_by_scenario_and_failure() -> None:
    """Independent check: the paper's schemes are tried without, loads in smaller steps, tissue that turned a hole at
    finite strain."""
    tried = [key for each in remedies(scenario_of(), FAILURE) for key in each]
    assert tried == ["solve.dt", "thread.control_points"]
    assert next(remedies(scenario_of(kind="static"), FAILURE)) == {"solve.load_steps": 40}
    assert next(remedies(load("paper_figure_1", LINEAR), FAILURE))["solve.scheme"] == "newton"
    scene = load("two_piercings")
    for collapsed in (TURNED, TogetherError(0.0, "drawn to nothing")):
        assert next(remedies(scene, collapsed)) == {"tissue.material": "neo-hookean"}
    assert "tissue.material" not in next(remedies(scene, FAILURE))


def test_a_run_that_fails_leaves_what_helps(tmp_path: Path) -> None:
    """Independent check: the paper's linear scheme creates energy at 1 ms, Newton's at the same step does not. From
    Python and by the command the summary says the same; who asks for none gets none."""
    with pytest.raises(CreatedEnergyError):
        suturefem.run(load("paper_figure_1", LINEAR), tmp_path / "python")
    words = ["run", "paper_figure_1", *(word for pair in LINEAR for word in ("--set", pair)), "--quiet", "--no-picture"]
    assert command.main([*words, "--out", str(tmp_path / "command")]) == 1
    said = [remedy_in(tmp_path / way) for way in ("python", "command")]
    assert said[0] == said[1] != []
    assert 'with solve.scheme = "newton", solve.integrator = "bdf2" the run' in said[0][0]
    assert command.main([*words, "--no-remedies", "--out", str(tmp_path / "none")]) == 1
    assert remedy_in(tmp_path / "none") == []


def test_unbalanced_dead_loads_are_refused_before_anything_is_run(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Independent check: 1 N and 2 N at the ends of a thread through a ring without friction have no equilibrium,
    whatever the steps and the knots are; in time they have a motion. Nothing is written, and `check` says the same."""
    thread = scenario_of().thread.model_dump(exclude_unset=True)
    loads = {"start": {"kind": "pulled", "force": [-1, 0, 0]}, "end": {"kind": "pulled", "force": [2, 0, 0]}}
    unequal = parse(tables(scenario_of(kind="static")) | {"thread": thread | loads})
    reason = r"1 N at the start and 2 N at the end .* let the loads differ by less"
    with pytest.raises(ScenarioError, match=f"^thread.start.force and thread.end.force are refused: .* {reason}$"):
        suturefem.run(unequal, tmp_path / "python")
    assert not list((tmp_path / "python").glob("*.csv"))
    (tmp_path / "unequal.toml").write_text(dump(unequal), encoding="utf-8")
    for words in (["run", "--out", str(tmp_path / "command")], ["check"]):
        assert command.main([*words, str(tmp_path / "unequal.toml")]) == 2
        assert re.search(reason, capsys.readouterr().err)
    assert prepare(parse(tables(scenario_of()) | {"thread": thread | loads})).steps == scenario_of().solve.steps


def remedy_in(folder: Path) -> list[str]:
    """Return what the summary of a folder says of remedies."""
    remarks = json.loads((folder / "summary.json").read_text(encoding="utf-8"))["remarks"]
    return [each["message"] for each in remarks if each["code"] == "remedy"]
