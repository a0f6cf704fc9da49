"""The campaign's cases follow from their seed, and every end of a case has its cause."""

import pickle
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from coupling.errors import StepError
from studies.campaign import study
from studies.campaign.generator import ASKS, GENTLE, KINDS, SUTURES, Case, asked, cases
from studies.campaign.study import AGREED, ALIKE, TELLING, Row, apart, figure, remarks, run, table
from studies.scenario import parse
from studies.simulation import Simulation
from studies.study import AT_WORK
from studies.sweeps.case import Result, run_case


def test_a_case_follows_from_the_seed_and_its_number_alone() -> None:
    """Independent check: a case drawn alone is the one drawn among others; another seed gives another."""
    many = list(cases(3, 12))
    (alone,), (other,) = cases(3, 1, 7), cases(4, 1, 7)
    assert alone.tables == many[7].tables != other.tables
    assert {case.kind for case in cases(3, 60)} == set(KINDS)
    assert all(case.tables["thread"]["suture"] in SUTURES for case in many)


def test_every_case_is_a_scenario_and_the_gentle_ones_load_slowly() -> None:
    """Independent check: what is drawn is read without a refusal; sudden loads say so, and none of them is gentle."""
    for case in cases(5, 30):
        parse(case.tables)
        ends = case.tables["thread"]["start"], case.tables["thread"]["end"]
        assert any(end.get("ramp") == 0.0 for end in ends) == (case.kind == "sudden")
        assert case.gentle == (case.kind != "sudden" and case.demand < GENTLE)


def test_everything_that_a_scenario_may_ask_for_is_asked() -> None:
    """Independent check: each question is drawn, and each scenario is read without a refusal."""
    many = list(asked(5, 60))
    assert {case.ask for case in many} == set(ASKS)
    for case in many:
        parse(case.tables)


def short(number: int) -> Case:
    """A case of seed 1, three steps long."""
    (case,) = cases(1, 1, number)
    return replace(case, tables={**case.tables, "solve": {"dt": 1e-3, "duration": 3e-3}})


def test_an_error_and_a_refusal_are_the_cause(monkeypatch: pytest.MonkeyPatch) -> None:
    """Independent check: what is raised at a step, what is refused before it, and what completes."""
    going = Simulation.next

    def failing(self: Simulation, now: Any) -> Any:
        if now.number == 1:
            raise StepError(0.0, 1e-3, "no")
        return going(self, now)

    assert run(short(22)).cause == "completed"
    monkeypatch.setattr(Simulation, "onward", lambda self, now: [failing(self, now)])
    stopped = run(short(22))
    assert (stopped.cause, stopped.time) == ("StepError", 1e-3)
    wrong = replace(short(22), tables=short(22).tables | {"cut": [{"s": -1.0, "time": 0.1}]})
    assert (run(wrong).cause, run(wrong).time) == ("refused", 0.0)


def test_the_workers_of_a_study_do_the_cases() -> None:
    """Independent check: each case is an item of its own, which goes to another process and comes back the same."""
    items: list[Any] = []

    def others(work: Any, given: Sequence[Any]) -> Iterator[Any]:
        items.extend(pickle.loads(pickle.dumps(given)))
        return iter(())

    token = AT_WORK.set(others)
    try:
        assert list(study.main(seed=3, first=2, count=4)) == []
    finally:
        AT_WORK.reset(token)
    assert [item.args[0] for item in items] == list(asked(3, 4, 2))


def test_a_thread_that_slides_as_its_swinging_is_damped_is_told() -> None:
    """Independent check: a hand draws gently on a thread that swings as it was laid. Of what friction took the steps
    took several times as much, and the run says so."""
    (case,) = cases(1, 1, 65)
    for hole in case.tables["piercing"]:  # as long as the footprints are wide
        hole.update({"channel": 2.0 * hole["footprint"]} if hole["direction"] != "free" else {})
    said = {remark["code"] for remark in run_case(case.tables).summary["remarks"]}
    assert "numerical-dissipation" in TELLING & said


def test_what_did_not_arrive_is_counted_and_listed() -> None:
    """Independent check: a case that an error stopped is no completed one, and table, remarks and figure say so."""
    done = run(short(22))
    stopped = replace(done, cause="StepError", time=0.5 * done.time)
    rows: list[Row] = [stopped, done, replace(done, said="spans energy-created")]
    lines = {line[0]: line[1:] for line in table(rows).lines}
    assert lines["all"] == lines[done.kind] == ["2 of 3", "1"] and table(rows).head[2] == "StepError"
    said = "\n".join(remarks(rows))
    assert "TOO FEW" in said and f"case {done.number} ({done.kind}, motion" in said
    assert "cases whose steps created energy: 1 of 3 22" in said
    assert figure(rows).axes


def test_a_case_agrees_with_itself_in_shorter_steps(monkeypatch: pytest.MonkeyPatch) -> None:
    """Consistency check: a case compared with itself is no way apart; one whose holes pull a tenth more, and one that
    does not complete in shorter steps, are told by name, and without a remark that would tell so."""
    case, steps = short(22), []
    result = run_case(case.tables)
    found, holes = run(case), result.summary["piercings"]
    assert apart(result, result, found.suture) == 0.0
    more = {name: hole | {"force": 1.1 * np.array(hole["force"])} for name, hole in holes.items()}
    assert apart(replace(result, summary={"piercings": more}), result, found.suture) == pytest.approx(0.1)
    longest = max(abs(hole["slip"]) for hole in holes.values()) + 1e-3
    less = {name: hole | {"slip": hole["slip"] + longest} for name, hole in holes.items()}
    assert apart(replace(result, summary={"piercings": less}), result, found.suture) > 1.0

    def again(tables: Any) -> Result:
        steps.append(tables["solve"]["dt"])
        return result if len(steps) == 1 else replace(result, failure="StepError")

    monkeypatch.setattr(study, "run_case", again)
    rows = [replace(run(case, quarter=True), said=""), replace(found, apart=0.0), found]
    assert steps == [1e-3, 0.25e-3]
    said = "\n".join(remarks(rows))
    assert "1 of 2, 1 of the others WITHOUT A REMARK on the steps" in said and "difference inf; remarks: none" in said
    near = [
        replace(found, apart=share * ALIKE, said=words)
        for share, words in ((0.5, "spans forces-swing"), (0.5, "no-tract"), (2.0, "forces-swing"))
    ]
    assert "cases with a remark, but within 0.2%: 1 of 2" in "\n".join(remarks(near))
    far = [replace(found, apart=2.0 * AGREED, said=words) for words in ("not-at-rest", "")]
    told = replace(far[0], said="not-at-rest numerical-dissipation")
    assert "0 of 3, 2 of the others WITHOUT A REMARK on the steps" in "\n".join(remarks([*far, told]))
