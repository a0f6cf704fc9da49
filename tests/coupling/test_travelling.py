"""A thread whose knots travel with its holes, drawn through rough holes: against the elastica of its own pulls, solved
in three ways, at rest and in time."""

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

from coupling.integrators import BackwardEuler
from coupling.kernels.constraints import phi
from coupling.paper.assembled import Monolith, monolithic_solve
from coupling.reports.audit import audit_step, initial_energies
from coupling.run import begin
from coupling.step import newton, solver
from coupling.step.packets import bent_over, due, put_on_knots
from coupling.step.stepping import dynamic_problem, organ_answer, predict, try_step
from coupling.system import Friction, Piercing, State, System
from studies.output.records import StepRecord
from studies.scenario import Scenario
from studies.simulation import prepare
from studies.simulation.sharing import thread_key
from tests.bounds import GAP, RESIDUAL, TWO_SOLVERS
from tests.coupling.multipliers import multiplier_imbalance
from tests.thread.threads import ABSCISSAE, LENGTH, RADIUS, Z, block_organ, hairpin, laid
from thread.catalogue import suture
from thread.ends import Fixed, Pulled
from thread.packets import Hold, travelling
from thread.placed import Placed
from thread.thread import Thread

PULL, FRICTION, COUPLE = 3e-3, 1e-2, 1e-2  # of the pull, of μN, and of the couples of both strands
SUTURES = ("2-0 polypropylene", "4-0 nylon", "6-0 polypropylene", "8-0 nylon")
MU, SPEED = 0.2, 0.05  # -, m/s


def along(angle: float) -> np.ndarray:
    """The direction at an angle [rad] below the x axis."""
    return np.array([np.cos(angle), 0.0, -np.sin(angle)])


def drawn(name: str, pull: float, turn: float, before: float | None, kind: str, duration: float = 0.12) -> Scenario:
    """A thread under a dead pull at its start, drawn by its end through a rough hole at the origin, where it turns by
    `turn` [rad], `before` of it on the near side; None: the hole imposes no direction."""
    section = suture(name)
    arm = max(0.025, 15.0 * np.sqrt(section.EI / pull))
    start, tip, from_ = -(arm + 0.01) * along(0.0), arm * along(turn), 0.05
    way = [[0.0, *tip], [from_, *tip], [duration, *(tip + max(SPEED * (duration - from_), 2e-3) * along(turn))]]
    hole: dict[str, Any] = {"name": "hole", "at": [0, 0, 0], "friction": {"static": MU, "kinetic": MU}}
    hole |= {"direction": "free"} if before is None else {"direction": along(before).tolist(), "channel": 1.0}
    table = {
        "thread": {
            "suture": name,
            "knots": "travelling",
            "control_points": 20,
            "damping": 30.0,
            "path": [start.tolist(), [0, 0, 0], tip.tolist()],
            "start": {"kind": "pulled", "force": (-pull * along(0.0)).tolist()}
            | ({} if kind == "static" else {"ramp": 0.02}),
            "end": {"kind": "driven", "waypoints": way},
        },
        "piercing": [hole],
        "solve": {"kind": "static", "duration": duration, "load_steps": 10}
        if kind == "static"
        else {"dt": 1e-3, "duration": duration},
    }
    return Scenario.model_validate(table)


def seeded(count: int) -> list[tuple[str, float, float, float | None]]:
    """Cases over the range that a user stands in: sutures, T/EA from 1e-5 to 2e-2, turns to 150°."""
    rng, out = np.random.default_rng(32), []
    while len(out) < count:
        name = SUTURES[rng.integers(len(SUTURES))]
        pull = suture(name).EA * 10 ** rng.uniform(-5.0, np.log10(2e-2))
        turn, share = np.radians(rng.uniform(30.0, 150.0)), rng.uniform(-0.2, 0.6)
        sharp = turn * (1.0 - share) > np.radians(150.0)
        if np.sqrt(suture(name).EI / pull) < 3e-3 and abs(share - 0.5) > 0.05 and not sharp:
            out.append((name, float(pull), float(turn), None if rng.uniform() < 0.3 else float(share * turn)))
    return out


def errors(record: StepRecord, name: str, pull: float, before: float | None) -> tuple[float, float, float]:
    """What pull, friction and couple are off by, over the pull, μN and the couples of both strands: of the elastica of
    the pulls on both sides, stretch and all."""
    section, hole = suture(name), record.piercings[0]
    after = pull * along(0.0) - np.asarray(hole.force)
    if abs(np.linalg.norm(after) - hole.tension_after) > abs(
        np.linalg.norm(other := pull * along(0.0) + np.asarray(hole.force)) - hole.tension_after
    ):
        after = other
    tension, angle = float(np.linalg.norm(after)), float(np.arctan2(-after[2], after[0]))
    rubbed = MU * hole.normal_force
    friction = (tension - pull - rubbed) / rubbed
    if before is None:
        return (tension - pull - rubbed) / tension, friction, 0.0

    def couple(T: float, turn: float) -> float:
        stored = T * (1.0 - np.cos(turn)) + T**2 / (2.0 * section.EA) * np.sin(turn) ** 2
        return float(np.sign(turn) * np.sqrt(2.0 * section.EI * stored))

    near, far = couple(pull, before), couple(tension, angle - before)
    off = (np.linalg.norm(hole.couple) - abs(near - far)) / (abs(near) + abs(far))
    return (tension - pull - rubbed) / tension, friction, float(off)


@pytest.mark.parametrize("case", seeded(10), ids=lambda case: f"{case[0]} {case[1]:.3g} N")
def test_a_drawn_thread_at_rest_is_the_elastica(case: tuple[str, float, float, float | None]) -> None:
    """Independent check: closed forms of the elastica and Coulomb's law, at default settings with 20 control points
    besides the packets."""
    name, pull, turn, before = case
    *_, (last, _) = prepare(drawn(name, pull, turn, before, "static")).advance()
    assert last.piercings[0].state == "slip"
    off = np.abs(errors(last, name, pull, before))
    assert (off < [PULL, FRICTION, COUPLE]).all(), off


@pytest.mark.parametrize("case", seeded(10)[:3], ids=lambda case: f"{case[0]} {case[1]:.3g} N")
def test_a_drawn_thread_in_motion_is_the_elastica_at_every_moment(case: tuple[str, float, float, float | None]) -> None:
    """Independent check: the same at the worst moment of a draw, and the drawn curve goes through its hole."""
    name, pull, turn, before = case
    records = [record for record, _ in prepare(drawn(name, pull, turn, before, "dynamic")).advance()]
    late = [record for record in records if record.time > 0.09]
    off = np.abs([errors(record, name, pull, before) for record in late]).max(axis=0)
    assert all(record.piercings[0].state == "slip" for record in late)
    assert (off < [PULL, FRICTION, COUPLE]).all(), off
    assert max(record.constraint_max for record in records) <= GAP * suture(name).diameter
    moved = records[-1].energy.external_work
    assert max(abs(record.energy.balance_error) for record in records) < RESIDUAL * abs(moved)


@cache
def drawn_hairpin() -> tuple[System, State]:
    """A hairpin through two rough holes of a block, its end drawn up, on knots that travel."""
    path = hairpin(RADIUS, LENGTH)
    start, _ = path(np.array([0.0, LENGTH]))
    ends = Fixed(start), Pulled(np.array([0.05, 0.02, 0.2]), np.array([[0.0, 0.0], [8e-3, 1.0]]))
    holes = tuple(Piercing(name, friction=Friction(0.2, 0.1, channel=2e-3)) for name in ("entry", "exit"))
    travel = travelling(LENGTH, [Hold(k, s, True, 5e-4) for k, s in enumerate(ABSCISSAE)], 2, 2e-3, (None, None))
    spline = Placed(travel.knots, travel.places(np.array(ABSCISSAE)), travel)
    thread = Thread(spline, suture("2-0 polypropylene"), damping=20.0)
    system = System(thread, ends, block_organ("P1", True), holes, gravity=-9.81 * Z)
    return system, laid(system, ABSCISSAE, path)


def test_compiled_called_and_assembled_agree() -> None:
    """Consistency check: one step by the compiled loops, by the same kernels called from Python, and by Newton on the
    assembled matrix; every unknown on its own scale."""
    system, state = drawn_hairpin()
    for _ in range(4):
        state = try_step(system, state, 2e-3).new
    problem = dynamic_problem(system, state, 2e-3, organ_answer(system, BackwardEuler(2e-3), state))
    first = predict(problem, state)
    one = solver.solve_compiled(problem, first).iterate
    organ: Any = system.organ
    for other in (
        newton.solve(problem, first).iterate,
        monolithic_solve(problem, first, organ.field(state.organ)).iterate,
    ):
        for name in ("q", "s", "y"):
            a, b = getattr(one, name), getattr(other, name)
            assert np.abs(a - b).max() < TWO_SOLVERS * np.abs(a).max()
        assert np.abs(one.lam - other.lam).max() < TWO_SOLVERS * np.abs(one.lam).max()
        assert np.array_equal(one.sigma, other.sigma)
    assert isinstance(other, Monolith)


def test_the_matrix_is_the_derivative_of_the_residual() -> None:
    """Independent check: central differences of all residuals along a seeded direction, a sliding hole and one that
    sticks."""
    system, state = drawn_hairpin()
    state = try_step(system, state, 2e-3).new
    problem = dynamic_problem(system, state, 2e-3, organ_answer(system, BackwardEuler(2e-3), state))
    z = replace(predict(problem, state), sigma=np.array([1.0, 0.0]))
    thread = system.thread.placed(z.s)
    z = replace(z, N=thread.EA * thread.points(z.q).strain)
    r = newton.evaluate(problem, z)
    dq, dz = newton.direction(problem, z, r)
    h = 1e-6

    def at(x: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        moved = replace(z, q=z.q + x * dq, s=z.s + x * dz[:, 0], lam=z.lam + x * dz[:, 1:6], y=z.y + x * dz[:, 6:])
        placed = system.thread.placed(moved.s)
        there = newton.evaluate(problem, replace(moved, N=placed.EA * placed.points(moved.q).strain))
        free = there.thread.copy().reshape(z.q.shape)
        free[system.held_flags] = 0.0
        return free, there.holds, there.site

    for plus, minus, now in zip(at(h), at(-h), at(0.0), strict=True):
        slope = (plus - minus) / (2.0 * h)
        assert np.abs(slope + now).max() < 1e-4 * np.abs(now).max()


def test_energy_and_action_are_balanced_at_every_step() -> None:
    """Identity: the audit of each step closes, and the multipliers act on thread and organ alike."""
    system, state = drawn_hairpin()
    energies = initial_energies(system, state)
    for _ in range(6):
        step = try_step(system, state, 2e-3)
        energies, state = audit_step(system, energies, step), step.new
        force, moment = multiplier_imbalance(system.at(state), state)
        assert (
            force < RESIDUAL * np.abs(state.lam[:, :3]).max() and moment < RESIDUAL * LENGTH * np.abs(state.lam).max()
        )
        assert abs(energies.balance_error) < RESIDUAL * energies.at_stake


def test_new_knots_leave_the_thread_in_its_holes() -> None:
    """Identity: a curve that is put on other knots passes its holes, in their directions, before it is solved for. A
    hole that it has left does not draw it."""
    system, state = drawn_hairpin()
    diameter = system.thread.section.diameter
    other, moved = put_on_knots(system, state, due(system, state, 0.5 * bent_over(system, state)))
    assert len(moved.q) != len(state.q)
    off = phi(other.passage_of(moved), moved.lam, moved.y) * other.rows
    assert np.abs(off).max() <= GAP * diameter

    aside = state.y.copy()
    aside[1, 0] += 10.0 * diameter
    left = replace(state, present=np.array([True, False]), y=aside)
    other, moved = put_on_knots(system, left, due(system, left, bent_over(system, left)))
    at = np.linspace(0.0, LENGTH, 200)
    before, after = (x.curve(z.q, at)[:, 0] for x, z in ((system.thread.spline, state), (other.thread.spline, moved)))
    assert np.abs(after - before).max() < diameter


def running(kind: str, name: str) -> Scenario:
    """A running stitch of six rough holes fixed in space, its start held, its end pulled with 1 N."""
    bite, up, lead = 6e-3, 3.5e-3, 1e-2
    path, holes = [[-bite / 2 - lead, -bite, lead]], []
    for k in range(3):
        y = (k - 1) * bite
        holes += [[-bite / 2, y, 0.0], [bite / 2, y, 0.0]]
        path += [[-bite / 2, y, 0.35 * up], [-bite / 2, y, -0.8 * up], [-bite / 4, y, -up], [bite / 4, y, -up]]
        path += [[bite / 2, y, -0.8 * up], [bite / 2, y, 0.35 * up]]
        path += [[bite / 4, y + bite / 4, up], [-bite / 4, y + 3 * bite / 4, up]] if k < 2 else []
    rough = {"direction": "free", "friction": {"static": 0.1, "kinetic": 0.1}}
    pull = {"kind": "pulled", "force": [0.5**0.5, 0, 0.5**0.5]}
    table = {
        "thread": {
            "suture": name,
            "knots": "travelling",
            "damping": 200.0,
            "path": [*path, [bite / 2 + lead, bite, lead]],
            "start": {"kind": "fixed"},
            "end": pull if kind == "static" else pull | {"ramp": 0.2},
        },
        "piercing": [{"name": f"h{k}", "at": hole} | rough for k, hole in enumerate(holes)],
        "solve": {"kind": "static", "load_steps": 10} if kind == "static" else {"dt": 2e-3, "duration": 0.4},
    }
    return Scenario.model_validate(table)


@pytest.mark.parametrize("name", ["4-0 nylon", "6-0 nylon"])
def test_a_running_stitch_has_one_answer_at_rest_and_in_motion(name: str) -> None:
    """Consistency check within 1 %, and Coulomb's law at each hole by the tensions that its strands transmit."""
    tensions = []
    for kind in ("static", "dynamic"):
        *_, (last, _) = prepare(running(kind, name)).advance()
        holes = last.piercings
        tensions.append([holes[0].tension_before, *(hole.tension_after for hole in holes)])
        loss = np.array([hole.tension_after - hole.tension_before for hole in holes])
        assert loss == pytest.approx(0.1 * np.array([hole.normal_force for hole in holes]), rel=0.02)
    assert tensions[0] == pytest.approx(tensions[1], rel=0.01)


def stitched(**solve: Any) -> dict[str, Any]:
    """A thread pulled through two holes in time, of which the second begins later and the first ends."""
    return {
        "thread": {
            "suture": "4-0 nylon",
            "knots": "travelling",
            "damping": 50.0,
            "path": [[-0.02, 0, 0], [0, 0, 0.001], [0.02, 0, 0]],
            "start": {"kind": "pulled", "force": [-0.1, 0, 0], "ramp": 0.01},
            "end": {"kind": "driven", "waypoints": [[0, 0.02, 0, 0], [0.02, 0.02, 0, 0], [0.1, 0.02, 0, -0.004]]},
        },
        "piercing": [
            {"name": "first", "at": [-0.005, 0, 0.0005], "direction": "free", "until": 0.06},
            {"name": "second", "at": [0.008, 0, 0.0004], "direction": "free", "from": 0.03},
        ],
        "solve": {"dt": 1e-3, "duration": 0.08} | solve,
    }


def test_piercings_begin_and_end_on_knots_that_travel() -> None:
    """Identity: the thread goes through each hole at its knot as long as it is in it, the audit closes across both
    events, and without friction the tension is the same on both sides."""
    records = [record for record, _ in prepare(Scenario.model_validate(stitched())).advance()]
    kinds = [event.kind for record in records for event in record.events]
    assert kinds.count("begins") == 1 and kinds.count("ends") == 1 and "knots" not in kinds
    assert max(record.constraint_max for record in records) <= GAP * suture("4-0 nylon").diameter
    scale = max(abs(record.energy.external_work) for record in records)
    assert max(abs(record.energy.balance_error) for record in records) < RESIDUAL * scale
    hole = records[-1].piercings[1]
    assert hole.state == "slip" and hole.tension_after == pytest.approx(hole.tension_before, rel=5e-3)


def test_a_run_that_is_resumed_goes_on_to_the_same_bits() -> None:
    """Identity: from any record, also just after packets were made anew."""
    simulation = prepare(Scenario.model_validate(stitched()))
    whole = list(simulation.advance())
    for at in (3, 31, 50):
        memory = whole[at][0].memory
        again = list(prepare(Scenario.model_validate(stitched())).advance(memory))
        assert len(again) == len(whole) - at
        for (one, _), (other, _) in zip(whole[at:], again, strict=True):
            assert one.energy == other.energy
            assert [hole.s for hole in one.piercings] == [hole.s for hole in other.piercings]


@pytest.mark.parametrize(("key", "value"), [("twist", True), ("energy", "springs"), ("bending", False)])
def test_what_cannot_travel_is_refused_in_words(key: str, value: Any) -> None:
    table = stitched()
    table["thread"][key] = value
    with pytest.raises(ValueError, match="knots is travelling"):
        Scenario.model_validate(table)


def test_a_thread_drawn_out_of_its_last_hole_leaves_it() -> None:
    """The packet of a hole cannot pass an end: the hole is left over it, in the step in which it would."""
    table = stitched()
    table["piercing"] = [{"name": "only", "at": [-0.005, 0, 0.0005], "direction": "free"}]
    table["thread"] |= {"start": {"kind": "free"}, "damping": 5.0}
    table["thread"]["end"]["waypoints"] = [[0, 0.02, 0, 0], [0.04, 0.05, 0, 0]]
    table["solve"]["duration"] = 0.04
    records = [record for record, _ in prepare(Scenario.model_validate(table)).advance()]
    events = [event for record in records for event in record.events if event.kind == "leaves"]
    assert len(events) == 1 and records[-1].piercings[0].state == "left"


def test_loops_and_python_make_the_same_steps() -> None:
    """Consistency check: steps made in the compiled loops and one by one, with packets made anew between them, under
    gravity and with a point mass at an end that is pulled: places, forces at the ends, and the audit."""
    system, state = drawn_hairpin()
    system = replace(system, compiled=True, thread=replace(system.thread, point_masses=(0.0, 1e-4)))
    one = other = begin(system, state, try_step)
    one = one.steps(1e-3, 12)
    for _ in range(12):
        step = replace(other, system=replace(other.system, compiled=False)).step(1e-3)
        other = replace(step, system=replace(step.system, compiled=True))
    a, b = one.state, other.state
    for name in ("q", "v", "s", "y", "lam", "reaction", "drive"):
        x, y = getattr(a, name), getattr(b, name)
        assert np.abs(x - y).max() < 10.0 * TWO_SOLVERS * np.abs(x).max(), name
    assert one.energies.external_work == pytest.approx(other.energies.external_work, rel=1e-6)
    assert one.energies.kinetic == pytest.approx(other.energies.kinetic, rel=1e-6)
    assert abs(one.energies.balance_error) < RESIDUAL * one.energies.at_stake


def test_steps_are_controlled_by_the_error_of_material_points() -> None:
    """A tighter tolerance takes more and smaller steps, also across packets that are made anew."""
    name, pull, turn, before = seeded(10)[0]
    counts = []
    for tolerance in (1e-4, 1e-6):
        scenario = drawn(name, pull, turn, before, "dynamic", 0.06)
        solve = scenario.solve.model_copy(update={"tolerance": tolerance})
        records = [record for record, _ in prepare(scenario.model_copy(update={"solve": solve})).advance()]
        counts.append(sum(record.newton_iterations for record in records))
        assert np.isfinite(records[-1].piercings[0].tension_after)
    assert counts[1] > counts[0]


def test_threads_are_shared_only_by_cases_with_the_same_holes() -> None:
    """Identity: a hole that imposes a direction has a double knot, so its thread is another one."""
    free, directed = stitched(), stitched()
    directed["piercing"][0]["direction"] = [1, 0, 0]
    keys = {thread_key(Scenario.model_validate(table), 0.04, (0.01, 0.02)) for table in (free, directed, stitched())}
    assert len(keys) == 2
