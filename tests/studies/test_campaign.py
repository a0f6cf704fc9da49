"""The campaign's cases follow from their seed, and every end of a case has its cause."""

import pickle
from collections.abc import Iterator, Sequence
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from coupling.errors import (
    ConstraintError,
    CouplingError,
    InversionError,
    StepError,
    TogetherError,
    TurnedHoleError,
    UphillError,
)
from studies.campaign import study
from studies.campaign.asks import ASKS, asked
from studies.campaign.generator import GENTLE, KINDS, SUTURES, cases
from studies.campaign.quarter import forces_apart, lengths_apart, with_shorter_steps
from studies.campaign.study import (
    AGREED,
    ALIKE,
    CAUSES,
    CREATED,
    CREATED_BDF2,
    TELLING,
    Row,
    cause_of,
    figure,
    remarks,
    run,
    table,
)
from studies.scenario import parse
from studies.study import AT_WORK

FLIP = InversionError(0.0, "hole")


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


@pytest.mark.parametrize(
    ("error", "ratio", "turned", "cause"),
    [
        (FLIP, 3.0, 1.0, "flip: spans longer than the bending layer"),
        (FLIP, 1.0, 0.5, "flip: hole turned beyond a linear organ"),
        (FLIP, 1.0, 1.0, "flip"),
        (UphillError(0.0, 1e-3, "up"), 1.0, 1.0, "another branch"),
        (StepError(0.0, 1e-3, "no"), 1.0, 1.0, "no step found"),
        (TurnedHoleError(0.0, 1e-3, "no"), 1.0, 1.0, "hole turned beyond a linear organ"),
        (TogetherError(0.0, "drawn to nothing"), 1.0, 1.0, "holes drawn together"),
        (ConstraintError(0.0, "two"), 1.0, 1.0, "constraints"),
    ],
)
def test_every_error_has_its_cause(
    monkeypatch: pytest.MonkeyPatch, error: CouplingError, ratio: float, turned: float, cause: str
) -> None:
    """Independent check: the cause is read from the error, the spans over the layer and the turn of the holes."""
    monkeypatch.setattr(study, "span_ratio", lambda system, state: ratio)
    y = np.array([[0, 0, 0, turned, 0, 0, 0, 1.0, 0]])
    now = SimpleNamespace(system=None, state=SimpleNamespace(y=y, present=np.array([True])))
    assert cause_of(error, now) == cause  # type: ignore[arg-type]
    assert cause in CAUSES


def test_the_workers_of_a_study_do_the_cases() -> None:
    """Independent check: each case is an item of its own, which goes to another process and comes back the same."""
    items: list[Any] = []

    class Others:
        def done(self, work: Any, given: Sequence[Any]) -> Iterator[Any]:
            items.extend(pickle.loads(pickle.dumps(given)))
            return iter(())

    token = AT_WORK.set(Others())
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
    end = study.followed(case.tables, 20_000)
    assert "numerical-dissipation" in TELLING & set(end.said)


def test_what_did_not_arrive_is_counted_and_listed() -> None:
    """Independent check: a case stopped by its bound is no completed one, and table, remarks and figure say so."""
    (case,) = cases(1, 1, 22)
    stopped = run(case, most=2)
    assert stopped.cause == "corrections spent" and 0.0 < stopped.time < stopped.duration
    done = replace(stopped, cause="completed", time=stopped.duration, created=2.0 * CREATED)
    taken = replace(done, created=0.0, created_bdf2=3.0 * CREATED_BDF2)
    rows: list[Row] = [stopped, done, taken]
    lines = {line[0]: line[1] for line in table(rows).lines}
    assert lines["all"] == "2 of 3" and lines[case.kind] == "2 of 3"
    said = "\n".join(remarks(rows))
    assert "TOO FEW" in said and f"case {case.number}" in said
    for scheme, most in (("backward Euler", done.created), ("BDF2", taken.created_bdf2)):
        [line] = [text for text in said.split("\n") if scheme in text]
        assert f"1 of 3, at most {most:.2g}" in line
    assert figure(rows).axes


def test_a_case_agrees_with_itself_in_shorter_steps(monkeypatch: pytest.MonkeyPatch) -> None:
    """Consistency check: a case compared with itself is no way apart; one whose holes pull a tenth more, and one that
    does not complete in shorter steps, are told by name, and without a remark that would tell so."""
    (case,) = cases(1, 1, 22)
    end = study.followed({**case.tables, "solve": {"dt": 1e-3, "duration": 3e-3}}, 1000)
    assert end.cause == "completed" and end.tally is not None
    now = end.tally.now
    assert forces_apart(now, now) == lengths_apart(now, now) == 0.0
    more = replace(now, state=replace(now.state, lam=1.1 * now.state.lam))
    assert forces_apart(more, now) == pytest.approx(0.1)
    assert with_shorter_steps(case.tables)["solve"]["dt"] == 0.25 * case.tables["solve"]["dt"]
    found = study.row(case, replace(end, said=()))
    monkeypatch.setattr(study, "followed", lambda tables, most: replace(end, cause="another branch"))
    rows = [study.compared(case, found, end, 1000), replace(found, forces_apart=0.0, lengths_apart=0.0), found]
    said = "\n".join(remarks(rows))
    assert "1 of 2, 1 of the others WITHOUT A REMARK on the steps, 0 of them not at rest" in said
    assert "forces by inf" in said and "says nothing" in said
    near = [
        replace(found, forces_apart=0.5 * ALIKE, lengths_apart=share * ALIKE, said=words)
        for share, words in ((0.5, "spans forces-swing"), (0.5, "no-tract"), (2.0, "forces-swing"))
    ]
    assert "remarked on that agree within 0.2% all the same: 1 of 2" in "\n".join(remarks(near))
    far = [replace(found, forces_apart=2.0 * AGREED, lengths_apart=0.0, said=words) for words in ("not-at-rest", "")]
    told = replace(far[0], said="not-at-rest numerical-dissipation")
    assert "0 of 3, 2 of the others WITHOUT A REMARK on the steps, 1 of them not" in "\n".join(remarks([*far, told]))
