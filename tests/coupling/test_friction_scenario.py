"""Friction by the keys of a scenario: each one changes what is measured, in the sense it must."""

from copy import deepcopy
from typing import Any

import numpy as np
import pytest

from studies.output.records import StepRecord
from studies.scenario import Scenario
from studies.simulation import prepare
from studies.simulation.remarks import assumed_channels
from tests.bounds import ADAPTED, MOVED, TWO_SOLVERS
from tests.thread.threads import PP

DRAWN: dict[str, Any] = {
    "thread": {
        "suture": "2-0 polypropylene",
        "control_points": 40,
        "path": [[-0.005, 0, 0.02], [-0.005, 0, -0.0055], [0.005, 0, -0.0055], [0.005, 0, 0.02]],
        "damping": 20.0,
        "start": {"kind": "pulled", "force": [0.0, 0.0, 0.05], "ramp": 0.01},
        "end": {"kind": "driven", "waypoints": [[0.0, 0.005, 0, 0.02], [0.05, 0.005, 0, 0.0225]]},
    },
    "piercing": [
        {"name": "entry", "at": [-0.005, 0, 0], "direction": [0, 0, -1]},
        {"name": "exit", "at": [0.005, 0, 0], "direction": [0, 0, 1]},
    ],
    "solve": {"dt": 2.5e-3, "duration": 0.05},
}

LONG = 1.0  # [m]: at the ends of such a channel the couple is nothing


def last(friction: dict[str, float] | None, channel: float = LONG, solver: str = "implicit") -> StepRecord:
    """The end of the run with the friction at both holes."""
    table = deepcopy(DRAWN)
    for hole in table["piercing"]:
        hole.update({"friction": friction, "channel": channel} if friction else {})
    table["solve"]["friction"] = solver
    if solver != "implicit":  # on knots that stand still, which are fine enough to slide by
        table["thread"]["control_points"] = 160
    return [record for record, _ in prepare(Scenario.model_validate(table)).advance()][-1]


def pull(record: StepRecord) -> float:
    """Force of the hand [N]."""
    return float(np.linalg.norm(record.end_reaction))


def test_every_key_of_friction_acts() -> None:
    """Independent check: friction, grip and a channel each make the hand pull harder; what it takes is counted."""
    smooth = last(None)
    rough = last({"static": 0.2, "kinetic": 0.2})
    gripped = last({"static": 0.2, "kinetic": 0.2, "grip": 0.02})
    channel = last({"static": 0.2, "kinetic": 0.2}, channel=5e-3)
    slower = last({"static": 0.2, "kinetic": 0.1})
    assert abs(smooth.energy.friction_dissipation) <= TWO_SOLVERS * smooth.energy.external_work
    assert pull(smooth) < pull(slower) < pull(rough) < min(pull(gripped), pull(channel))
    assert pull(gripped) - pull(rough) > 0.03  # two holes of 0.02 N
    for record in (rough, gripped, channel, slower):
        assert record.energy.friction_dissipation > 0.0
        assert all(hole.cone_residual <= TWO_SOLVERS * pull(record) for hole in record.piercings)


def drawn_through(channel: float | None) -> tuple[float, list[str]]:
    """Return what friction takes at the first of two rough holes at the end of a run [N], and what is said of it."""
    table = deepcopy(DRAWN)
    for hole in table["piercing"]:
        hole.update({"friction": {"static": 0.05, "kinetic": 0.05}} | ({} if channel is None else {"channel": channel}))
    simulation = prepare(Scenario.model_validate(table))
    records = [record for record, _ in simulation.advance()]
    said = [each.message for each in assumed_channels(simulation.scenario.piercing, records[-1].piercings)]
    return 0.05 * records[-1].piercings[0].normal_force, said


def test_friction_that_goes_with_an_assumed_channel_is_told() -> None:
    """Independent check: where no channel is given and the couple presses, the remark names the channel that is assumed
    and friction over half and over twice of it, which runs with these channels have too; none where one is given."""
    assumed = 10 * PP.diameter
    (_, [said]), others = drawn_through(None), [drawn_through(share * assumed) for share in (0.5, 1.0, 2.0)]
    half, now, twice = (friction for friction, _ in others)
    assert f"an assumed channel of {1e3 * assumed:.2g} mm: it is up to {now:.2g} N" in said
    assert all(not none for _, none in others)
    assert (half, twice) == (pytest.approx(2.0 * now, rel=0.2), pytest.approx(0.5 * now, rel=0.2))


BITE = [-0.005, 0, 0], [0.005, 0, 0]  # its holes
WALL = [0, 0, 0], [0, 0, -0.01]


def channels(
    holes: tuple[list[float], ...], organ: bool = True, tract: bool = False, **keys: Any
) -> list[float | None]:
    """The channels at the start of rough directed holes with the `keys`, of a bite 5.5 mm deep or of a thread straight
    down, in a block of 10 mm or without an organ."""
    table = deepcopy(DRAWN)
    table["thread"] |= {"start": {"kind": "free"}, "end": {"kind": "free"}}
    if holes[0] == WALL[0]:
        table["thread"]["path"] = [[0, 0, 0.02], [0, 0, -0.03]]
    rough = {"direction": [0, 0, -1], "friction": {"static": 0.2, "kinetic": 0.2}} | keys
    table["piercing"] = [{"name": f"hole{k}", "at": place} | rough for k, place in enumerate(holes)]
    if organ:
        mesh = {"kind": "block", "generator": "structured", "size": [0.03, 0.02, 0.01], "h": 5e-3, "accuracy": "given"}
        made_of = {"youngs_modulus": 1e5, "poisson_ratio": 0.4, "density": 1e3}
        table["tissue"] = made_of | {"clamp": ["left"], "mesh": mesh}
    if tract:
        table["tract"] = [{"between": ["hole0", "hole1"], "spacing": 4e-3}]
    record, _ = next(iter(prepare(Scenario.model_validate(table)).advance()))
    return [hole.channel for hole in record.piercings if not hole.tract]


@pytest.mark.parametrize("footprint", [0.0, 5e-4, 2e-3])
def test_a_channel_is_as_deep_as_the_bite(footprint: float) -> None:
    """Independent check: whatever the footprint and with a tract or without, 5.5 mm; half of a wall of 10 mm that is
    pierced on both sides and all of one that is pierced on one; none where there is no direction."""
    keys = {"footprint": footprint}
    assert channels(BITE, **keys) == [pytest.approx(5.5e-3, rel=1e-3)] * 2
    assert channels(WALL, **keys) == [pytest.approx(5e-3, rel=1e-3)] * 2
    assert channels(WALL[:1], **keys) == [pytest.approx(0.01, rel=1e-3)]
    assert channels(BITE, **keys, direction="free") == [None, None]
    if footprint:
        assert channels(BITE, tract=True, **keys) == [pytest.approx(5.5e-3, rel=1e-3)] * 2


def test_a_channel_without_a_bite_is_of_the_thread() -> None:
    """Independent check: ten diameters without an organ; as given."""
    assert channels(BITE, organ=False) == [pytest.approx(10 * PP.diameter)] * 2
    assert channels(BITE, channel=4e-3) == [4e-3, 4e-3]


def test_the_default_channel_presses() -> None:
    """Independent check: a thread drawn straight through a hole that turns it by 45° is held back by the couple of its
    bends over √(EI/T) at the channel's ends: by more than twice what the force across the hole holds it back by."""
    table = deepcopy(DRAWN)
    out = [[0.0, -0.03, 0.0, 0.0], [0.05, -0.0325, 0.0, 0.0]]
    table["thread"] |= {"path": [[0.03, 0.0, 0.0], [-0.03, 0.0, 0.0]], "end": {"kind": "driven", "waypoints": out}}
    table["thread"]["start"] = {"kind": "pulled", "force": [0.05, 0.0, 0.0], "ramp": 0.01}
    table["piercing"] = [{"name": "only", "at": [0, 0, 0], "direction": [-1, 0, 1]}]
    table["piercing"][0]["friction"] = {"static": 0.2, "kinetic": 0.2}
    drag = {}
    for key, channel in {"default": {}, "long": {"channel": LONG}}.items():
        table["piercing"][0] |= channel
        record = [record for record, _ in prepare(Scenario.model_validate(table)).advance()][-1]
        assert record.piercings[0].state == "slip"
        drag[key] = pull(record) - 0.05
    assert drag["default"] > 2.0 * drag["long"] > 0.0


def test_what_never_slips() -> None:
    """Independent check: with a grip no pull here overcomes, no thread goes through, to the last bit."""
    record = last({"static": 0.0, "kinetic": 0.0, "grip": 1e4})
    assert all(hole.slip == 0.0 and hole.state == "stick" for hole in record.piercings)


@pytest.mark.parametrize("static", [0.2, 0.24])
def test_two_pass_by_its_key(static: float) -> None:
    """Independent check: solve.friction = "two-pass" is another friction, near the exact one at small μ, and misses its
    cone. What it takes is counted too; where a hole turns back it lags and may give."""
    table = {"static": static, "kinetic": 0.2}
    exact, lagged = last(table), last(table, solver="two-pass")
    assert 1e-4 < abs(pull(lagged) / pull(exact) - 1.0) < 0.2
    assert max(hole.cone_residual for hole in lagged.piercings) > 1e-4 * pull(exact)
    assert abs(lagged.energy.friction_dissipation) > 1e-3 * lagged.energy.external_work


def test_forces_while_the_knots_travel() -> None:
    """Independent check: at every step the thread before the first hole carries what holds it back but for its inertia
    and damping, and beyond the last μ Σ|λ_n| more within the 1 % that knots which travel are made for."""
    table = deepcopy(DRAWN)
    table["thread"] |= {"suture": "3-0 silk"}
    for hole in table["piercing"]:
        hole["friction"] = {"static": 0.1, "kinetic": 0.1}
    records = [record for record, _ in prepare(Scenario.model_validate(table)).advance()][8:]
    for entry, exit in (record.piercings for record in records):
        assert entry.state == exit.state == "slip"
        assert abs(entry.tension_before - 0.05) < MOVED * 0.05
        drag = 0.1 * (entry.normal_force + exit.normal_force)
        assert abs(exit.tension_after - entry.tension_before - drag) < ADAPTED * 0.05


def test_statics_of_four_rough_holes_in_a_row() -> None:
    """Independent check: a far-near-near-far stitch of a thread laid in bends, pulled at both ends, settles in statics,
    and at every load step each hole keeps Coulomb's law. On its way the thread slides one way and back in some."""
    corners = [[-0.008, 0, 0], [0.003, 0, 0], [-0.003, 0.002, 0], [0.008, 0.002, 0]]
    rough = {"static": 0.1, "kinetic": 0.1}
    down = [
        [x, y, z] for (x, y, _), ways in zip(corners, ((4, -6), (-6, 4)) * 2, strict=True) for z in np.array(ways) / 1e3
    ]
    table = {
        "thread": {
            "suture": "3-0 polypropylene",
            "control_points": 100,
            "path": [[-0.009, 0, 0.02], *down, [0.009, 0.002, 0.02]],
            "start": {"kind": "pulled", "force": [-0.05, 0.0, 0.2]},
            "end": {"kind": "pulled", "force": [0.05, 0.0, 0.3]},
        },
        "piercing": [{"name": f"{k}", "at": at, "friction": rough} for k, at in enumerate(corners)],
        "solve": {"kind": "static", "load_steps": 2, "duration": 1.0},
    }
    records = [record for record, _ in prepare(Scenario.model_validate(table)).advance()]
    assert [record.time for record in records] == [0.0, 0.5, 1.0]
    for record in records[1:]:
        assert all(hole.cone_residual <= TWO_SOLVERS * pull(record) for hole in record.piercings)
        assert record.piercings[-1].state == "slip"
