"""Lips that rub on one another where a thread draws them together: the law, two solves, the audit, at rest, a run."""

import csv
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from skfem import MeshTet

from coupling.integrators import BackwardEuler
from coupling.joins.contact import observe_contact
from coupling.joins.rubbing import stuck
from coupling.paper.assembled import Monolith, monolithic_solve
from coupling.reports.audit import audit_step, initial_energies
from coupling.run.run import schedule_piercings
from coupling.step.newton import solve
from coupling.step.solver import find
from coupling.step.stepping import Step, bdf2_step, dynamic_problem, organ_answer, predict
from coupling.system import Piercing, State, System
from studies.scenario import ScenarioError, load, parse
from studies.simulation import prepare
from tests.bounds import IDENTITY, RESIDUAL, TWO_SOLVERS
from tests.coupling import test_contact, test_finite_contact
from tests.coupling.test_contact import DT, SCENARIO, STEPS, assert_lips, resumed, scale_of, start, written_bodies
from tests.thread.threads import last_by_newton, load_step, run, taken

MU = 0.3
ONE_PAIR = 3e-3  # by which the friction of one pair on coarse cells is read larger than μ p; its cause is not known
AT_FINITE_STRAIN = "slit quasi-static P1 fibre"
SCENES = ("slit quasi-static P1", "open dynamic P1, rough, drawn", AT_FINITE_STRAIN)


@cache
def scene(name: str, mu: float = MU) -> tuple[System, State]:
    """A scene of the tests of contact, with friction between the lips."""
    system, state = (test_finite_contact if name == AT_FINITE_STRAIN else test_contact).scene(name)
    gaps = system.organ.gaps
    organ = replace(system.organ, gaps=replace(gaps, parts=tuple(replace(part, friction=mu) for part in gaps.parts)))
    return replace(system, organ=organ), replace(state, organ=organ.start())


@cache
def steps(name: str) -> list[Step]:
    return taken(*scene(name), DT, test_finite_contact.STEPS if name == AT_FINITE_STRAIN else STEPS)


def assert_rubs(system: System, step: Step, first: State | None = None) -> tuple[int, int]:
    """Coulomb's law of every pair, by what the nodes did in the step, or since the `first` state of a load step; the
    number of pairs that stick, and that slip."""
    organ: Any = system.organ
    lips, ways = observe_contact(system, step.new), organ.pairing(step.new.organ.facing)
    before = (step.old if first is None else first).organ
    k, dU = organ.pairs, organ.field(step.new.organ) - organ.field(before)
    w = (ways.G @ dU)[k:].reshape(-1, 2)
    tau, bound = step.new.organ.p[k:].reshape(-1, 2), organ.friction(step.new.organ.facing)
    bound, size, way = bound * lips.force, np.linalg.norm(tau, axis=1), np.linalg.norm(w, axis=1)
    scale = lips.force.max(initial=0.0)
    assert (size <= bound + TWO_SOLVERS * scale).all()
    assert np.abs(np.linalg.norm(lips.friction, axis=1) - size).max() <= IDENTITY * scale
    slips = (lips.force > 0.0) & (way > TWO_SOLVERS * np.abs(organ.field(step.new.organ)).max())
    against = -bound[slips, None] * w[slips] / way[slips, None]
    assert np.abs(tau[slips] - against).max(initial=0.0) <= 1e-6 * scale
    return int((lips.force > 0.0).sum() - slips.sum()), int(slips.sum())


@pytest.mark.parametrize("name", SCENES)
def test_coulombs_law_at_every_step(name: str) -> None:
    """Independent check: no friction above μ p, nothing that sticks moves, and what slips has μ p against its way; gaps
    and forces obey the law of contact as without friction."""
    system, _ = scene(name)
    seen = []
    for step in steps(name):
        assert_lips(system, step.new) if name != AT_FINITE_STRAIN else None
        seen.append(assert_rubs(system, step))
    stick, slip = np.max(seen, axis=0)
    assert stick > 0 and slip > 0


@pytest.mark.parametrize("name", SCENES[:2])  # at finite strain plain Newton does not follow on knots that stay
def test_condensed_and_assembled_agree(name: str) -> None:
    """Consistency check: the step in which pairs slip first and the last one, every unknown on its own scale, friction
    too; begun with pairs that all stick and are pressed, it is the same."""
    system, _ = scene(name)
    organ: Any = system.organ
    slipping = [step for step in steps(name) if observe_contact(system, step.new).slips.any()]
    for step in (last_by_newton(slipping[::-1], DT)[0], last_by_newton(steps(name), DT)[0]):
        scheme, state = BackwardEuler(DT), step.old
        problem = dynamic_problem(system, state, DT, organ_answer(system, scheme, state), scheme)
        first = predict(problem, state)
        a, z = solve(problem, first), monolithic_solve(problem, first, organ.field(state.organ)).iterate
        assert isinstance(z, Monolith)
        pairs = [(a.p, z.p), (a.iterate.q - state.q, z.q - state.q), (a.iterate.s, z.s), (a.iterate.y, z.y)]
        pairs += [(a.iterate.lam[:, :3], z.lam[:, :3]), (organ.field(step.new.organ), z.U)]
        for got, exact in pairs:
            assert np.abs(got - exact).max() <= TWO_SOLVERS * np.abs(exact).max()
        pressed, m = np.ones(organ.pairs, dtype=bool), organ.gaps.rough.size
        cold = find(problem, replace(first, pressed=pressed, rubbing=stuck(m)))
        assert np.abs(cold.p - a.p).max() <= 10.0 * TWO_SOLVERS * np.abs(a.p).max()


@pytest.mark.parametrize("name", SCENES)
def test_what_friction_takes_is_in_the_audit(name: str) -> None:
    """Independent check: external work = Δ kinetic + Δ elastic + friction + viscous + numerical in every step, with
    what lips take that rub, by their own forces and ways; it never gives."""
    system, state = scene(name)
    organ: Any = system.organ
    energies, taken_by_lips = initial_energies(system, state), 0.0
    for step in steps(name):
        before, energies = energies, audit_step(system, energies, step)
        at_stake = energies.at_stake + abs(energies.numerical_dissipation)
        assert abs(energies.balance_error - before.balance_error) <= RESIDUAL * at_stake
        k, dU = organ.pairs, organ.field(step.new.organ) - organ.field(step.old.organ)
        ways = organ.pairing(step.new.organ.facing).G @ dU
        taken_by_lips -= float(step.new.organ.p[k:] @ ways[k:])
        assert organ.energies(step.old.organ, step.new.organ)[5] >= -IDENTITY * at_stake
    assert taken_by_lips > 0.0
    if name != "open dynamic P1, rough, drawn":  # where the holes rub too
        assert energies.friction_dissipation == pytest.approx(taken_by_lips, rel=1e-6)


def test_lips_at_rest_rub_from_load_step_to_load_step() -> None:
    """Independent check: statics obeys Coulomb's law between its load steps, and its audit closes."""
    system, state = scene("slit quasi-static P1")
    energies, seen = initial_energies(system, state), []
    for k in range(1, 4):
        first = state
        for step in load_step(system, first, k / 3, STEPS * DT):
            energies, state = audit_step(system, energies, step), step.new
            assert_lips(system, state)
            seen.append(assert_rubs(system, step, first))
    assert np.max(seen, axis=0).min() > 0 and energies.friction_dissipation > 0.0
    assert abs(energies.balance_error) <= RESIDUAL * abs(energies.external_work)


def test_lips_rub_under_bdf2_and_when_a_hole_ends() -> None:
    """Independent check: the same law under BDF2; a hole that the thread leaves moves no lips of itself, and they
    neither cross nor pull then."""
    name = "slit quasi-static P1"
    system, state = scene(name)
    for _ in range(STEPS):
        step = bdf2_step(system, state, DT)
        assert_lips(system, step.new)
        state = step.new
    assert observe_contact(system, state).friction.any()
    last = steps(name)[-1].new
    ending = replace(system, piercings=(Piercing("entry"), Piercing("exit", ends=last.time)))
    gone, events = schedule_piercings(ending, last.time - DT, last, DT, np.array([np.nan, np.nan]))
    assert [event.kind for event in events] == ["ends"]
    for step in run(ending, gone, DT / 8, 3):
        assert_lips(ending, step.new)


def test_little_friction_changes_little() -> None:
    """Independent check: forces of the last step come to those of smooth lips as the coefficient goes to zero."""
    name = "slit quasi-static P1"
    smooth = test_contact.steps(name)[-1].new
    system, _ = scene(name)
    apart = []
    for mu in (1e-4, 1e-5):
        rubs, first = scene(name, mu)
        last = taken(rubs, first, DT, STEPS)[-1].new
        apart.append(np.abs(last.y - smooth.y)[:2, :3].max() / scale_of(system, smooth))
    assert 0.0 < apart[1] <= 0.2 * apart[0] and apart[0] < 1e-4


RUBS = SCENARIO.replace("contact = true\n", "") + '[[contact]]\nbetween = ["lip_left", "lip_right"]\nfriction = 0.3\n'


@pytest.fixture(scope="module")
def rubbed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A scenario file beside the folder of its run."""
    file = tmp_path_factory.mktemp("rubbing") / "slit.toml"
    file.write_text(RUBS, encoding="utf-8")
    assert start(file, file.parent / "whole", "--quiet") == 0
    return file


def test_what_a_run_says_of_friction(rubbed: Path) -> None:
    """Independent check: no row of the table has more friction than the coefficient allows, pairs slip in some, and
    what is taken stands in the energies, which close."""
    out = rubbed.parent / "whole"
    with (out / "contact.csv").open() as file:
        rows = [{key.partition(" [")[0]: value for key, value in row.items()} for row in csv.DictReader(file)]
    friction, force, slipping, pressed = (
        np.array([float(row[key]) for row in rows]) for key in ("friction", "force", "slipping", "pressed")
    )
    assert (friction <= MU * force * (1.0 + ONE_PAIR)).all() and friction.max() > 0.0
    assert (slipping <= pressed).all() and slipping.max() > 0
    with (out / "energy.csv").open() as file:
        energies = list(csv.DictReader(file))
    assert float(energies[-1]["friction_dissipation [J]"]) > 0.0
    assert abs(float(energies[-1]["balance_error [J]"])) <= 1e-8 * float(energies[-1]["external_work [J]"])


def test_a_resumed_run_rubs_on(rubbed: Path) -> None:
    """Consistency check: a run that was interrupted between lips that rub goes on to the same bytes."""
    assert resumed(rubbed, 25).contact[0].friction > 0.0


def test_a_block_falls_on_a_slope(tmp_path: Path) -> None:
    """Independent check: a body that lands on another slips, then sticks for good where the slope is below μ, and goes
    on slipping where it is above; the events tell, and friction is what the slope asks for, or μ N."""
    file = written_bodies(tmp_path)
    for slope in (0.2, 0.4):
        gravity = 9.81 * np.array([np.sin(np.arctan(slope)), 0.0, -np.cos(np.arctan(slope))])
        rubs = 'contact=[{between=["upper","lower"],friction=0.3}]'
        steps = [f"solve.gravity={gravity.tolist()}", "solve.dt=5e-3", "solve.duration=0.06"]
        records = [step for step, _ in prepare(load(file, [rubs, *steps])).advance()]
        events = [event for step in records for event in step.events if event.kind != "halved"]  # as it lands
        last = records[-1].contact[0]
        assert {event.piercing for event in events} == {"upper - lower"} and events[0].kind == "slips"
        assert last.friction / last.force == pytest.approx(min(slope, MU), rel=2e-3)
        assert [events[-1].kind, last.slipping] == (["sticks", 0] if slope < MU else ["slips", last.pressed])


def test_a_coefficient_is_zero_or_more(rubbed: Path) -> None:
    """A coefficient that is negative is refused, zero is none, and more than one is remarked on before the run."""
    override = 'contact=[{between=["lip_left","lip_right"],friction=%s}]'
    assert load(rubbed, [override % "0.0"]).contact[0].friction == 0.0
    assert "contact-rough" in [remark.code for remark in prepare(load(rubbed, [override % "1.5"])).remarks()]
    with pytest.raises(ScenarioError, match=r"contact\.0\.friction"):
        load(rubbed, [override % "-0.1"])


def test_on_other_knots_lips_rub_from_the_start_of_the_load_step() -> None:
    """Independent check: where statics finds an equilibrium again on finer knots, through holes without friction, every
    pair that has moved since the load step began bears all the friction that there can be, and is said to slip."""
    table = {
        "tissue": {
            "youngs_modulus": 1e5,
            "poisson_ratio": 0.45,
            "density": 1070.0,
            "inertia": False,
            "clamp": ["bottom"],
            "mesh": {
                "kind": "wound",
                "size": [0.03, 0.02, 0.01],
                "h": 5e-3,
                "length": 0.012,
                "depth": 0.005,
                "accuracy": "given",
            },
        },
        "contact": [{"between": ["lip_left", "lip_right"], "friction": 0.02}],
        "thread": {
            "suture": "2-0 polypropylene",
            "control_points": 12,
            "path": [[-0.012, 0.001, 0.003], [-0.006, 0, 0], [0.006, 0.001, 0], [0.012, 0, 0.003]],
        },
        "piercing": [
            {"name": "left", "at": [-0.006, 0, 0], "kind": "anchored"},
            {"name": "right", "at": [0.006, 0.001, 0], "kind": "anchored", "draw": [[0.0, 0.0], [1.0, 2e-3]]},
        ],
        "solve": {"kind": "static", "load_steps": 2},
    }
    first = prepare(parse(table)).beginning()
    now = first.load(0.5, 1.0)
    organ: Any = now.system.organ
    k, dU = organ.pairs, organ.field(now.state.organ) - organ.field(first.state.organ)
    w = (organ.pairing(now.state.organ.facing).G @ dU)[k:].reshape(-1, 2)
    lips = observe_contact(now.system, now.state)
    assert (np.linalg.norm(w, axis=1) > 1e-6).all() and lips.slips.all()
    assert np.linalg.norm(lips.friction, axis=1) == pytest.approx(0.02 * lips.force, rel=ONE_PAIR)


def test_a_joint_that_begins_to_slide_as_a_whole_bears_its_loads() -> None:
    """Independent check: normal forces and friction of a joint have the resultant of the loads. Nearly all pairs slip,
    so that forces that obey Coulomb's law to round-off are found to seven digits only."""
    loads = [
        {"boundary": "right", "pressure": 4e3, "course": [[0, 0], [0.2, 1]]},
        {"boundary": "right", "traction": [0, 0.9e3, 0], "course": [[0, 0], [0.2, 0], [1, 1]]},
    ]
    mesh = {"kind": "wound", "size": [0.03, 0.02, 0.01], "length": 0.02, "depth": 0.01, "h": 3e-3, "accuracy": "given"}
    block = {"youngs_modulus": 2e5, "poisson_ratio": 0.3, "density": 1e3, "inertia": False, "mesh": mesh, "load": loads}
    ends = {"path": [[0, 0, 0.02], [0.01, 0, 0.02]], "start": {"kind": "fixed"}, "end": {"kind": "fixed"}}
    scene = {
        "title": "sheared",
        "tissue": block | {"clamp": ["left"], "roller": ["bottom"]},
        "contact": [{"between": ["lip_left", "lip_right"], "friction": MU}],
        "thread": {"suture": "5-0 nylon"} | ends,
        "solve": {"kind": "static", "load_steps": 10},
    }
    *_, (record, _) = prepare(parse(scene)).advance()
    (joint,) = record.contact
    assert joint.slipping >= 0.8 * joint.pressed
    assert np.hypot(joint.force, joint.friction) == pytest.approx(np.hypot(0.8, 0.18), rel=1e-3)


@pytest.mark.parametrize(("element", "cells", "mu"), [("P1", 8, 0.5), ("P2", 4, MU)])
def test_a_body_pressed_on_its_mirror_image_does_not_rub(element: str, cells: int, mu: float) -> None:
    """Independent check: two equal bodies under equal loads have no tendency to slip. With friction they press as
    without it, also where planes of symmetry cross the contact; friction is of second order in the slope there."""
    a, curvature = 0.01, 3.0
    block = MeshTet.init_tensor(*(np.linspace(0.0, a, n + 1) for n in (cells, 2, 2)))
    bent = block.p + np.outer([0, 0, curvature], block.p[0] ** 2 * (1.0 - block.p[2] / a))
    flip = np.array([[1.0], [1.0], [-1.0]])
    mesh = MeshTet(np.hstack([bent, flip * bent]), np.hstack([block.t, block.t + block.nvertices]))
    outer, flat = mesh.boundary_facets(), np.hstack([block.p, flip * block.p])
    x, y, z = flat[:, mesh.facets[:, outer]].mean(axis=1)
    is_upper = mesh.facets[0, outer] < block.nvertices
    sides = {"x": x < 1e-9, "front": y < 1e-9, "back": y > a - 1e-9, "top": z > a - 1e-9, "base": z < 1e-9 - a}
    sides |= {"upper": is_upper & (np.abs(z) < 1e-9), "lower": ~is_upper & (np.abs(z) < 1e-9)}
    named = {name: outer[there] for name, there in sides.items()}
    named["pin"] = named["base"][:1]  # bears nothing, because the loads are in equilibrium
    tissue = {"youngs_modulus": 1e6, "poisson_ratio": 0.3, "density": 1e3, "inertia": False, "element": element}
    held = {"roller": ["x", "front", "back", "pin"], "mesh": {"kind": "given", "accuracy": "given"}}
    ends = {"path": [[0, 0, 0.03], [0.01, 0, 0.03]], "start": {"kind": "fixed"}, "end": {"kind": "fixed"}}
    seen = []
    for coefficient in (0.0, mu):
        scene = {
            "tissue": tissue | held | {"load": [{"boundary": side, "pressure": 5e3} for side in ("top", "base")]},
            "contact": [{"between": ["upper", "lower"], "friction": coefficient}],
            "thread": {"suture": "8-0 nylon"} | ends,
            "solve": {"kind": "static", "load_steps": 7},
        }
        *_, (record, _) = prepare(parse(scene), mesh=mesh.with_boundaries(named)).advance()
        seen += record.contact
    smooth, rough = seen
    assert rough.largest_pressure == pytest.approx(smooth.largest_pressure, rel=1e-3)
    assert [smooth.force, rough.force] == pytest.approx([5e3 * a**2] * 2, rel=1e-3)
    assert rough.friction < 0.02 * rough.force
