"""A thread that is cut: over one knot sequence, and nothing of it goes from one piece to the next."""

from copy import deepcopy
from typing import Any

import numpy as np
import pytest

from studies.output.series import thread_file
from studies.scenario import Scenario, ScenarioError
from studies.simulation import prepare
from studies.simulation.assembly import assemble
from tests.bounds import IDENTITY, TWO_SOLVERS
from tests.thread.threads import bent
from thread.catalogue import suture
from thread.cutting import insert_knots
from thread.errors import ThreadError
from thread.knots import apportion, clamped_knots, piecewise_knots, uniform_knots
from thread.spline import Spline
from thread.thread import Thread

ONE, OTHER = np.array([0.0, 0.004, 0.007, 0.012, 0.02]), np.array([0.02, 0.023, 0.03])
CUT = Spline(piecewise_knots([ONE, OTHER]))
APART = Spline(clamped_knots(ONE)), Spline(clamped_knots(OTHER))
SUTURE = suture("2-0 polypropylene")


def test_functions_are_those_of_the_pieces() -> None:
    """Independent check: on either side of the cut stand the functions of the piece alone, at the cut those of either
    as it is asked for."""
    assert CUT.pieces == 2 and CUT.n == sum(piece.n for piece in APART)
    for shift, piece, breaks in zip((0, APART[0].n), APART, (ONE, OTHER), strict=True):
        s = np.linspace(breaks[0], breaks[-1], 50)
        first, b = CUT.basis(s, home=np.full(50, breaks[0]))
        alone, b_alone = piece.basis(s)
        assert np.array_equal(first, alone + shift)
        assert np.abs(b - b_alone).max() <= IDENTITY * np.abs(b_alone).max()


def test_energies_and_mass_are_those_of_the_pieces() -> None:
    """Independent check: force and mass of a curve of any shape."""
    whole, parts = Thread(CUT, SUTURE), [Thread(piece, SUTURE) for piece in APART]
    q = np.random.default_rng(5).normal(size=(CUT.n, 3)) * 2e-3 + np.linspace(0.0, 0.03, CUT.n)[:, None] * [1, 0, 0]
    split = np.split(q, [APART[0].n])
    alone = np.concatenate([part.gradient(part.points(x)) for part, x in zip(parts, split, strict=True)])
    together = whole.gradient(whole.points(q))
    assert np.abs(together - alone).max() <= IDENTITY * np.abs(alone).max()
    momentum = np.concatenate([part.momentum(x) for part, x in zip(parts, split, strict=True)])
    assert np.abs(whole.momentum(q) - momentum).max() <= IDENTITY * np.abs(momentum).max()


def test_control_points_are_shared_out() -> None:
    """Independent check: whole numbers that add up, at least one each; knots have the points asked for."""
    for spans in (3, 7, 50):
        out = apportion(spans, np.array([0.2, 5.0, 1.0]))
        assert out.sum() == spans and out.min() >= 1 and out[1] == out.max()
    spline = Spline(uniform_knots(0.1, 40, [0.04, 0.06]))
    assert spline.n == 40 and np.array_equal(spline.cuts, [0.04, 0.06])
    spans = np.diff(spline.breaks)
    assert spans.max() < 1.2 * spans.min()
    with pytest.raises(ThreadError, match="at least 4"):
        uniform_knots(0.1, 11, [0.04, 0.06])
    with pytest.raises(ThreadError, match="must increase"):
        uniform_knots(0.1, 40, [0.06, 0.04])


def test_insertion_changes_nothing() -> None:
    """Independent check (Boehm 1980): the curve and its derivatives are the same functions."""
    spline, s = Spline(uniform_knots(0.1, 13)), np.linspace(0.0, 0.1, 777)
    q, v = bent(spline), bent(spline, 1)
    fine, (q_fine, v_fine) = insert_knots(spline, np.array([0.011, 0.0523, 0.0524, 0.0999]), [q, v])
    assert fine.n == spline.n + 4
    for old, new in ((q, q_fine), (v, v_fine)):
        before, after = spline.curve(old, s), fine.curve(new, s)
        scale = np.abs(before).max(axis=(0, 2))
        assert np.all(np.abs(before - after).max(axis=(0, 2))[:3] <= 1e3 * IDENTITY * scale[:3])


LEFT: dict[str, Any] = {
    "path": [[-0.04, 0, 0], [0, 0, 0]],
    "start": {"kind": "fixed"},
    "hole": {
        "name": "left",
        "at": [-0.02, 0, 0],
        "direction": [1, 0, 0],
        "friction": {"static": 0.2, "kinetic": 0.1, "grip": 1e-5},
    },
}
RIGHT: dict[str, Any] = {
    "path": [[0, 0, 0], [0.04, 0, 0]],
    "end": {"kind": "pulled", "force": [0.01, 0, 0.02], "ramp": 0.02},
    "hole": {"name": "right", "at": [0.015, 0, 0], "kind": "anchored", "direction": [1, 0, 0]},
}


def scenario(*pieces: dict[str, Any], thread: dict[str, Any] | None = None, **solve: Any) -> Scenario:
    """The pieces as threads laid one after the other along x, cut where they meet; `thread` says more of them."""
    first, last = pieces[0], pieces[-1]
    table = {
        "thread": {
            "suture": "2-0 polypropylene",
            "control_points": 16 * len(pieces),
            "knots": "fixed",
            "path": [first["path"][0], last["path"][1]],
            "start": first.get("start", {"kind": "free"}),
            "end": last.get("end", {"kind": "free"}),
            "cuts": [0.04] if len(pieces) > 1 else [],
            "damping": 5.0,
        }
        | (thread or {}),
        "piercing": [piece["hole"] for piece in pieces],
        "solve": {"dt": 1e-3, "duration": 0.02, "gravity": [0, 1.0, -9.81], **solve},
    }
    return Scenario.model_validate(table)


TURNED = LEFT | {"start": {"kind": "fixed", "turn": [[0.0, 0.0], [0.02, 3.0]]}}  # a holder that spins it
TWISTED = {"twist": True, "coil_radius": 0.02, "coil_towards": [0, 0, 1]}


@pytest.mark.parametrize(
    ("solve", "left", "thread"),
    [
        ({"integrator": "bdf2"}, LEFT, {}),
        ({"friction": "two-pass"}, LEFT, {}),
        ({"coupling": "staggered"}, LEFT, {}),
        ({"kind": "static", "load_steps": 3}, LEFT, {}),
        ({}, TURNED, TWISTED),
        ({}, LEFT, {"twist": True, "energy": "springs"}),
        ({"kind": "static", "load_steps": 3}, LEFT, {"energy": "springs"}),
    ],
)
def test_a_cut_thread_is_two_threads(solve: dict[str, Any], left: dict[str, Any], thread: dict[str, Any]) -> None:
    """Independent check: a cut thread that hangs, is pulled and slides with friction moves as two threads apart, in
    time by every way to step and at rest, with twist and memory of a coil, and with springs; its balance of energy is
    theirs together."""
    runs = [prepare(scenario(*pieces, thread=thread, **solve)) for pieces in ((left, RIGHT), (left,), (RIGHT,))]
    steps = [list(run.advance()) for run in runs]
    ends = [each[-1] for each in steps]
    (whole, *parts), frames = [record for record, _ in ends], [frame().thread for _, frame in ends]
    scale = np.abs(frames[0].points).max()
    apart = np.concatenate([frames[1].points, frames[2].points])
    assert np.abs(frames[0].s - np.append(frames[1].s, 0.04 + frames[2].s)).max() <= IDENTITY  # the same spans
    assert np.abs(frames[0].points - apart).max() <= TWO_SOLVERS * scale
    tension = np.concatenate([frames[1].tension, frames[2].tension])
    assert np.abs(frames[0].tension - tension).max() <= TWO_SOLVERS * np.abs(tension).max()
    for hole, (part,) in zip(whole.piercings, [part.piercings for part in parts], strict=True):
        assert np.abs(hole.force - part.force).max() <= TWO_SOLVERS * np.abs(part.force).max()
        assert abs(hole.tension_after) == pytest.approx(abs(part.tension_after), rel=TWO_SOLVERS, abs=1e-10)
    for name in ("external_work", "elastic_thread"):
        total = sum(getattr(part.energy, name) for part in parts)
        assert getattr(whole.energy, name) == pytest.approx(total, rel=1e-6)
    assert frames[0].pieces == (len(frames[1].points), len(frames[2].points))
    assert b'NumberOfLines="2"' in thread_file(frames[0]) and b'NumberOfLines="1"' in thread_file(frames[1])


def test_a_hole_is_left_at_a_cut() -> None:
    """Independent check: a piece that is drawn out of its hole leaves it by its cut end, as a thread leaves it by its
    end, and does not go on into the next piece."""
    left = deepcopy(LEFT)
    left["hole"] = {"name": "left", "at": [-0.001, 0, 0]}
    left["start"] = {"kind": "driven", "waypoints": [[0, -0.04, 0, 0], [0.02, -0.044, 0, 0]]}
    events = [
        [event for record, _ in prepare(scenario(*pieces)).advance() for event in record.events]
        for pieces in ((left, RIGHT), (left,))
    ]
    (cut,), (end,) = ([e for e in found if e.kind == "leaves"] for found in events)
    assert cut.s == end.s == pytest.approx(0.04, rel=IDENTITY)
    assert cut.time == pytest.approx(end.time, abs=1e-6)  # a thousandth of a step, within which it is interpolated


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"cuts": [0.05, 0.04]}, "they must rise"),
        ({"cuts": [0.09]}, "must lie between 0 and the thread's length"),
        ({"cuts": [0.039, 0.041]}, "the piece from 0.039 to 0.041 m is shorter than two"),
        ({"energy": "springs", "springs": 29}, "control points need at least 30"),
        ({"cuts": [0.0375, 0.0425], "control_points": 12}, "thread.cuts = .* raise thread.control_points"),
        ({"cuts": [0.035, 0.045]}, "is in no hole"),
        ({"cuts": [0.0005]}, "thread.cuts = .* the piece from 0 to 0.0005 m is shorter than two spans"),
        ({"cuts": [0.02]}, "a piercing is there"),
        ({"cuts": [0.02 + 1e-15, 0.05]}, "a piercing is there"),
        ({"cuts": [0.02 - 1e-15]}, "a piercing is there"),
    ],
)
def test_refusals(change: dict[str, Any], words: str) -> None:
    """Independent check: what does not go with cuts is refused by its key."""
    table = scenario(LEFT, RIGHT, kind="static").model_dump(by_alias=True)
    del table["thread"]["tolerance"]  # of knots that travel alone
    table["thread"] |= change
    with pytest.raises(Exception, match=words) as caught:
        assemble(Scenario.model_validate(table))
    assert isinstance(caught.value, ScenarioError | ValueError)


def test_the_linear_step_refuses_cuts() -> None:
    """Independent check: the paper's linear step is not asked for what it was not made for."""
    with pytest.raises(ValueError, match=r"cannot use thread\.cuts"):
        scenario(LEFT, RIGHT, scheme="linear", friction="two-pass")
