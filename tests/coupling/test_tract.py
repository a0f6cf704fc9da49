"""A thread that bears on the tissue between two holes: against a beam, in depth, with friction, refused in words."""

import tomllib
from copy import deepcopy
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

import tissue
from coupling.integrators import Equilibrium
from coupling.reports.observation import site_compliance
from coupling.run.events import changes
from coupling.run.location import times_at_end
from coupling.step.stepping import ask_organ
from studies.output.columns import TRACT, values
from studies.scenario import ScenarioError, parse
from studies.simulation import Simulation, prepare
from studies.simulation.memory import OrganRun
from studies.simulation.recording import step_record
from studies.simulation.remarks import stiff_in_tracts, without_tract
from studies.simulation.tracts import Ball, gaps_of

BORDER = 1e-6  # of the way across: where a path is deep enough is found by twenty halvings
FOUNDATION = 2e-3  # of the deflection of the tip: the spline's 160 points, and the beam's own theory at these loads
SPACING = 0.02  # of a gap, or of what a stitch closes of it, when the balls are twice as close
# Of the energy at stake: balls half a radius apart press on one another with up to 40 times the pull, on cells that are
# larger than they are, and with more on those that tell them apart.
CLOSE = 2e-7
NONE = np.zeros(0)
TIP, PULL = 0.014, 1e-5  # where the thread ends [m], and the force across it there [N]
GRIPPED = 1e-3  # of a pull: friction moves the balls, and what the thread turns by there presses
GRIP, TAUT = 0.02, 0.05  # of a whole tract, and the pull on the thread through it [N]

BLOCK = """
[tissue]
youngs_modulus = 1.0e5
poisson_ratio = 0.4
density = 1000.0
clamp = ["bottom"]
[tissue.mesh]
accuracy = "given"
kind = "block"
generator = "structured"
size = [0.02, 0.012, 0.012]
h = 2.0e-3
[solve]
kind = "static"
load_steps = 1
"""
STRAIGHT = """
[[piercing]]
name = "in"
at = [-0.01, 0, -0.006]
footprint = 1.5e-3
kind = "{kind}"
[[piercing]]
name = "out"
at = [0.01, 0, -0.006]
footprint = 1.5e-3
[[tract]]
between = ["in", "out"]
"""
THREAD = """
[thread]
suture = "2-0 polypropylene"
control_points = 160
"""
ACROSS = f"""
{BLOCK}{STRAIGHT.format(kind="anchored")}{THREAD}
path = [[-0.011, 0, -0.006], [{TIP}, 0, -0.006]]
end = {{ kind = "pulled", force = [0, 0, {PULL}] }}
"""
STITCH = """
[tissue]
youngs_modulus = 2.0e5
poisson_ratio = 0.4
density = 1000.0
clamp = ["bottom"]
[tissue.mesh]
accuracy = 0.1
kind = "wound"
shape = "slit"
generator = "structured"
size = [0.03, 0.012, 0.014]
length = 0.008
depth = 0.008
h = 2.0e-3
[[tissue.load]]
boundary = "right"
traction = [2e3, 0, 0]
[[tissue.load]]
boundary = "left"
traction = [-2e3, 0, 0]
{thread}
path = [[-0.006, 0, 0.012], [-0.006, 0, -{depth}], [0.006, 0, -{depth}], [0.006, 0, 0.012]]
[[piercing]]
name = "left"
at = [-0.006, 0, 0]
kind = "anchored"
footprint = 1.5e-3
[[piercing]]
name = "right"
at = [0.006, 0, 0]
kind = "anchored"
footprint = 1.5e-3
[[tract]]
between = ["left", "right"]
spacing = {spacing}
[solve]
kind = "static"
load_steps = 2
"""


def at_rest(text: str) -> tuple[Simulation, OrganRun]:
    """A scenario and its equilibrium."""
    simulation = prepare(parse(tomllib.loads(text)))
    now = simulation.beginning()
    while now.number < simulation.steps:
        now = simulation.next(now)
    return simulation, now


def test_a_straight_thread_drawn_sideways_is_a_beam_on_the_tract() -> None:
    """Independent check (Euler and Bernoulli): a beam that the holes and balls hold by their compliance, and that a
    force at its tip bends, has the same deflection there and presses on each ball with the same force."""
    simulation, now = at_rest(ACROSS)
    holes, EI = now.piercings, now.system.thread.EI
    C = site_compliance(now.system, now.state).reshape(len(holes), 9, -1, 9)[:, 2, :, 2]
    x = np.array([hole.x[0] - hole.displacement[0] for hole in holes])
    cubes, at_tip, ones = np.abs(x[:, None] - x) ** 3 / 12.0 / EI, np.abs(x - TIP) ** 3 / 12.0 / EI, np.ones_like(x)
    rows = [np.column_stack([cubes + C, ones, x]), np.append(ones, [0.0, 0.0]), np.append(x, [0.0, 0.0])]
    found = np.linalg.solve(np.vstack(rows), -PULL * np.append(at_tip, [1.0, TIP]))
    forces, tip = found[:-2], at_tip @ found[:-2] + found[-2] + found[-1] * TIP
    assert abs(now.state.q[-1, 2] + 0.006 - tip) <= FOUNDATION * abs(tip)
    assert np.abs([hole.force[2] for hole in holes] - forces).max() <= FOUNDATION * np.abs(forces).max()
    stiff = np.abs(x - TIP) <= 0.5 * np.ptp(x)
    assert np.abs(forces[~stiff]).max() < 0.05 * np.abs(forces).max(), "the foundation is not long enough to be one"
    (tract,) = step_record(now).tracts
    force = values(TRACT, tract)["force"] + sum(hole.force for hole in holes if not hole.tract)  # type: ignore[operator]
    assert np.allclose(force, [0, 0, -PULL], atol=1e-3 * PULL)
    assert [remark.code for remark in simulation.remarks() if remark.code.endswith("tract")] == []


LIPS = ("lip_left", "lip_right")
LAYERS = (0.0, -6e-3)  # of the skin and of the fascia, where gaps are looked at [m]


def gaps(simulation: Simulation, U: np.ndarray) -> np.ndarray:
    """How far a slit that is pulled apart opens at the skin and at the fascia [m]."""
    body = simulation.assembly.body
    assert body is not None
    moved, points = body.nodal(U)[:, 0], body.points
    sides = [np.unique(body.mesh.facets[:, body.mesh.boundaries[name]]) for name in LIPS]
    nearest = [[side[np.linalg.norm(points[side] - [0, 0, z], axis=1).argmin()] for side in sides] for z in LAYERS]
    return np.array([moved[right] - moved[left] for left, right in nearest])


@cache
def closing(depth: float, share: float, drawn: float = 0.0) -> tuple[np.ndarray, np.ndarray, list[str]]:
    """The gaps that a stitch `depth` [m] deep leaves, balls a `share` of the default apart, with so much thread `drawn`
    through [m]; what it closes of them; and the remarks on its tract."""
    text = STITCH.format(thread=THREAD, depth=depth, spacing=share * 1.5e-3)
    if share == 1.0:
        text = text.replace("spacing = 0.0015\n", "")
    hand = f'name = "right"\ndraw = [[0.0, 0.0], [1.0, {drawn}]]'
    simulation, now = at_rest(text.replace('name = "right"\nat', f"{hand}\nat"))
    organ = simulation.assembly.organ
    assert isinstance(organ, tissue.QuasiStaticOrgan)
    error = abs(now.energies.balance_error) / now.energies.at_stake
    assert error <= CLOSE
    alone = ask_organ(now.system, Equilibrium(), [now.state], 1.0, 1.0).accept(np.zeros(9 * len(now.piercings)), NONE)
    left, whole = (gaps(simulation, organ.displacement(state)) for state in (now.state.organ, alone))
    said = stiff_in_tracts(simulation.scenario, step_record(now).tracts)
    return left, whole - left, [remark.code for remark in said]


@pytest.mark.parametrize("radii", [2, 4, 6, 8])
def test_half_the_spacing_closes_a_wound_alike(radii: int) -> None:
    """Independent check: what a stitch of half a newton closes of the gap at the skin and at the fascia, and with balls
    half as far apart as they are by default."""
    (_, closed, _), (_, finer, _) = (closing(radii * 1.5e-3, share, 2e-3) for share in (1.0, 0.5))
    assert closed[1] > 0.0 and np.abs(finer - closed).max() <= SPACING * np.abs(finer).max()


def test_the_depth_of_a_bite_matters_and_the_spacing_does_not() -> None:
    """Independent check: a stitch of 3 mm holds the skin better together than one of 6 mm, and the gap at the skin does
    not depend on how close the balls are."""
    (deep, _, _), (finer, _, _), (flat, _, _) = closing(6e-3, 1.0), closing(6e-3, 0.5), closing(3e-3, 1.0)
    assert abs(finer[0] - deep[0]) <= SPACING * deep[0]
    assert 0.0 < flat[0] < 0.6 * deep[0]


@pytest.mark.parametrize(("depth", "drawn"), [(3e-3, 4e-4), (6e-3, 7e-4), (3e-3, 0.0)])
def test_a_stiff_thread_that_pulls_little_is_told(depth: float, drawn: float) -> None:
    """Independent check: round a bend of 3 mm a 2-0 thread under 0.1 N and less presses by its stiffness; half the
    spacing changes what it closes by more than 2 %, and the remark says so. Drawn by 0.4 N it is not said."""
    (_, closed, said), (_, finer, _) = closing(depth, 1.0, drawn), closing(depth, 0.5, drawn)
    assert np.abs(finer - closed).max() > SPACING * np.abs(finer).max() and said == ["tract-stiff"]
    assert closing(depth, 1.0, 2e-3)[2] == []


def test_the_grip_of_a_tract_is_taken_from_the_pull() -> None:
    """Independent check: nothing presses along a straight tract, so that a thread which is drawn through needs its grip
    more behind it than before; the friction is counted. That it slips is one event, however many balls there are, and
    where some stick it sticks."""
    text = f"""
{BLOCK}{STRAIGHT.format(kind="sliding")}
friction = {{ static = 0.0, kinetic = 0.0, grip = {GRIP} }}
{THREAD}
path = [[-0.012, 0, -0.006], [{TIP}, 0, -0.006]]
start = {{ kind = "pulled", force = [-{TAUT}, 0, 0] }}
end = {{ kind = "driven", waypoints = [[0, {TIP}, 0, -0.006], [1, {TIP + 1e-3}, 0, -0.006]] }}
"""
    _, now = at_rest(text)
    (tract,) = step_record(now).tracts
    events = [(event.kind, event.piercing) for event in now.events if event.kind != "halved"]
    assert events == [("slips", "in-out")]
    assert values(TRACT, tract)["slipping"] == len(tract.balls)
    some = replace(now.state, sigma=np.where(np.arange(now.system.holds) == 3, 0.0, now.state.sigma))
    stuck = now.system, now.state, some, times_at_end(now.state, some)
    assert [(each.kind, each.piercing) for each in changes(*stuck)] == [("sticks", "in-out")]
    none = replace(now.state, sigma=np.zeros_like(some.sigma))
    assert changes(now.system, some, none, times_at_end(some, none)) == []
    assert abs(tract.balls[0].tension_before - TAUT) <= GRIPPED * TAUT
    assert abs(tract.balls[-1].tension_after - TAUT - GRIP) <= GRIPPED * TAUT
    assert abs(values(TRACT, tract)["friction"] + GRIP) <= GRIPPED * GRIP
    assert now.energies.friction_dissipation > 0.0


def changed(**keys: Any) -> dict[str, Any]:
    tables = tomllib.loads(ACROSS)
    tables["tract"][0] |= keys
    return tables


def test_a_tract_that_cannot_be_is_refused_in_words() -> None:
    """Independent check: each refusal names the key and what is wrong."""
    shallow, fixed = changed(), changed(spacing=4e-4)
    fixed["thread"] |= {"knots": "fixed", "control_points": 20}
    shallow["thread"]["path"] = [[-0.011, 0, -0.001], [TIP, 0, -0.001]]
    for hole in shallow["piercing"]:
        hole["at"][2], hole["footprint"], shallow["tract"][0]["radius"] = -0.001, 5e-4, 1.5e-3
    free = changed()
    del free["tissue"]
    free["piercing"][0]["footprint"] = free["piercing"][1]["footprint"] = 0.0
    bare = changed()
    bare["piercing"][1]["footprint"] = 0.0
    cut = changed()
    cut["thread"]["cuts"] = [0.01]
    for tables, said in (
        (changed(between=["out", "in"]), "does not pass 'in' right after 'out'"),
        (changed(between=["in", "exit"]), "there is no piercing 'exit'"),
        (free, "without \\[tissue\\]"),
        (bare, "a tract's balls need a radius"),
        (changed(spacing=1e-5), "tract.0.spacing = 1e-05 .* diameter of the thread.* at least 0.000"),
        (cut, "cuts the thread between them, at 0.01 m"),
        (fixed, "need at least .* raise it, or use a larger tract.spacing"),
        (shallow, "nowhere deeper in the organ than the radius of 0.0015 m"),
    ):
        with pytest.raises(ScenarioError, match=said):
            prepare(parse(tables))


def test_the_way_across_a_wound_is_no_fault_of_a_tract() -> None:
    """Independent check: a bite through both lips of a slit is bare for two radii there, where it passes from lip to
    lip, and that is not held against it; of as much beneath a surface that is no wound is, and of a bite that leaves
    the block through its bottom the remark has the whole height."""
    deep = tomllib.loads(STITCH.format(thread=THREAD, depth=6e-3, spacing=1.5e-3))
    near = deepcopy(deep)
    near["thread"]["path"][1:3] = [[-0.006, 0, -6e-3], [-0.0014, 0, -1e-3], [0.0014, 0, -1e-3], [0.006, 0, -6e-3]]
    through = deepcopy(deep)
    through["thread"]["path"][1:3] = [[-0.006, 0, -0.016], [0.006, 0, -0.016]]
    for tables, codes in ((deep, []), (near, ["tract-bare"]), (through, ["tract-out"])):
        simulation = prepare(parse(tables))
        assembly = simulation.assembly
        balls = [(hole, float(s)) for hole, s in zip(assembly.holes, assembly.s, strict=True) if isinstance(hole, Ball)]
        assert {ball.part for ball, _ in balls} == {0, 1} and assembly.body is not None
        gaps = gaps_of(assembly.scenario, assembly.body.mesh, balls)
        across = [high - low for low, high, is_across in gaps if is_across]
        assert sum(across) == pytest.approx(0.0 if codes else 3e-3, rel=BORDER)
        said = [each for each in simulation.foreseen if each.code in ("tract-bare", "tract-out")]
        assert [each.code for each in said] == codes
    assert "up to 2 mm outside" in said[0].message


def test_a_thread_is_cut_in_its_tract() -> None:
    """Independent check: cut within the tissue while it is drawn, the piece behind the cut stays in its balls and bears
    on the hole no more."""
    tables = changed()
    for hole in tables["piercing"]:
        hole["kind"] = "sliding"
    tables["piercing"][0]["kind"] = "anchored"
    tables["thread"] |= {"end": {"kind": "driven", "waypoints": [[0, TIP, 0, -0.006], [0.4, TIP + 1e-4, 0, -0.006]]}}
    tables |= {"cut": [{"s": 0.0117, "time": 0.9}], "solve": {"kind": "static", "load_steps": 2}}
    simulation = prepare(parse(tables))
    before = simulation.next(simulation.beginning())
    now = simulation.next(before)
    assert before.piercings[0].tension_after > 0.01
    assert abs(now.piercings[0].tension_after) <= GRIPPED * before.piercings[0].tension_after
    assert now.state.present.all() and "cut" in {event.kind for event in now.events}


def test_thread_in_tissue_without_a_tract_is_told() -> None:
    """Independent check: the straight thread lies 6 mm deep, and without its tract the remark says so."""
    tables = changed()
    del tables["tract"]
    said = [remark for remark in prepare(parse(tables)).remarks() if remark.code == "no-tract"]
    assert len(said) == 1 and "6 mm deep" in said[0].message


def test_holes_without_a_tract_are_told_together() -> None:
    """Independent check: two pairs of holes with thread deep between them are one remark, with the deepest."""
    (said,) = without_tract({("a", "b"): 1e-3, ("b", "c"): 0.0, ("c", "d"): 4e-3}, 3e-4)
    assert said.where == "a" and "1 other pair of holes" in said.message and "4 mm deep" in said.message
