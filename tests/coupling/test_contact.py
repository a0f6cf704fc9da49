"""Lips that a thread draws together: the law of contact at every step, two ways of solving, the audit, every scheme."""

import csv
import json
from dataclasses import replace
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import meshio
import numpy as np
import pytest

from coupling.errors import CouplingError, EquilibriumError
from coupling.integrators import BackwardEuler
from coupling.joins.contact import observe_contact
from coupling.kernels.constraints import phi
from coupling.paper.assembled import Monolith, equation_of, monolithic_solve
from coupling.paper.linear_step import linear_step
from coupling.paper.staggered import staggered_step
from coupling.paper.two_pass import two_pass
from coupling.reports.audit import Energies, audit_step, initial_energies
from coupling.rest import equilibrium
from coupling.rest.equilibrium import settle, slides_back
from coupling.run import begin
from coupling.run.run import schedule_piercings
from coupling.step import stepping
from coupling.step.newton import solve
from coupling.step.solver import find
from coupling.step.stepping import Step, dynamic_problem, organ_answer, predict, try_step
from coupling.system import Friction, Piercing, State, System
from meshes.block import block
from studies.command import command
from studies.output.folder import Recorder
from studies.output.records import APART, StepRecord
from studies.scenario import ScenarioError, load
from studies.simulation import prepare
from studies.simulation.recording import contact_record, contact_records, observed_wounds
from tests.bounds import GAP, IDENTITY, RESIDUAL, TWO_SOLVERS
from tests.coupling.multipliers import multiplier_imbalance
from tests.thread.threads import (
    ABSCISSAE,
    LENGTH,
    RADIUS,
    Z,
    hairpin,
    hairpin_system,
    laid,
    last_by_newton,
    load_step,
    run,
    taken,
)
from tests.tissue.wounds import wounded_organ
from thread.ends import Clamped, Fixed, Pulled
from thread.placed import through_holes

DT, STEPS, WIDTH = 2e-3, 9, 1e-3
FITTED = 1e-2  # what the packets of knots are made for, which are others after another way
START, END = hairpin(RADIUS, LENGTH)(np.array([0.0, LENGTH]))
# The end is drawn across the wound and up, harder on one side of it, so that a part of the lips meets.
DRAWN = (Fixed(START), Pulled(np.array([-0.1, 0.02, 0.3]), np.array([[0.0, 0.0], [STEPS * DT, 1.0]])))
HANDS = (  # the thread is drawn by hand through the one hole, and slides with friction through the other
    Piercing("entry", slides=False, draw=np.array([[0.0, 0.0], [STEPS * DT, -1e-3]])),
    Piercing("exit", friction=Friction(0.15, 0.12, 1e-4)),
)
CLAMPED = (Clamped(START, -Z), DRAWN[1])
SCENES = {
    "slit dynamic P1": (True, "P1", 0.0),
    "slit dynamic P1, clamped": (True, "P1", 0.0),
    "slit quasi-static P1": (False, "P1", 0.0),
    "slit quasi-static P1, rough, drawn": (False, "P1", 0.0),
    "open dynamic P1": (True, "P1", WIDTH),
    "open dynamic P1, rough, drawn": (True, "P1", WIDTH),
    "open quasi-static P1": (False, "P1", WIDTH),
    "slit dynamic P2": (True, "P2", 0.0),
    "open quasi-static P2": (False, "P2", WIDTH),
}


@cache
def scene(name: str, contact: bool = True, points: int = 40) -> tuple[System, State]:
    inertia, element, width = SCENES[name]
    options: dict[str, Any] = {"gravity": (0.0, 0.0, -9.81)} | ({"rayleigh": (3.0, 1e-4)} if inertia else {})
    h = 1e-2 if element == "P2" else 3e-3
    special = "clamped" in name
    organ = wounded_organ(inertia, element, width, h, contact=contact, **options)
    system = hairpin_system(organ, CLAMPED if special else DRAWN, points, gravity=-9.81 * Z)
    system = replace(system, piercings=HANDS) if "drawn" in name else system
    return system, laid(system, ABSCISSAE, hairpin(RADIUS, LENGTH))


@cache
def steps(name: str) -> list[Step]:
    return taken(*scene(name), DT, STEPS)


def scale_of(system: System, state: State) -> float:
    """What gaps are small against [m]: the width, or the way that the holes moved."""
    moved = state.y[: len(system.piercings)] - system.organ.y0.reshape(-1, 9)
    return float(max(system.organ.g0.max(), np.abs(moved[:, :3]).max()))


def assert_lips(system: System, state: State) -> int:
    """g ≥ 0, p ≥ 0 and p g = 0 to round-off; the number of pairs that are pressed."""
    lips, scale = observe_contact(system, state), scale_of(system, state)
    assert lips.gap.min() >= -IDENTITY * scale
    assert lips.force.min() >= 0.0
    assert lips.complementarity <= IDENTITY * scale * lips.force.max(initial=0.0)
    return lips.pressed


@pytest.mark.parametrize("name", SCENES)
def test_the_law_of_contact_at_every_step(name: str) -> None:
    """Independent check: lips do not cross, press and never pull, and press only where they touch; the holes'
    constraints hold and cancel as without contact."""
    system, start = scene(name)
    pressed = [assert_lips(system, start)]
    for step in steps(name):
        new = step.new
        pressed.append(assert_lips(system, new))
        at = system.passage_of(new)
        assert np.abs(phi(at, new.lam, new.y)[:2, :3]).max() <= GAP * system.thread.section.diameter
        assert np.abs(system.organ.site_variables(new.organ) - new.y[:2].ravel()).max() <= TWO_SOLVERS * RADIUS
        assert multiplier_imbalance(system, new)[0] <= IDENTITY * np.abs(new.lam[:, :3]).max()
    assert pressed[0] == 0 and len(set(pressed)) > 2
    assert pressed[-1] > 0 and len(system.organ.lips(start.organ)[0]) >= 4


def test_a_node_that_slides_off_while_it_is_pressed_lets_go() -> None:
    """Independent check: in one load step of six times the force a lip slides so far past the other that a node which
    was pressed faces nothing any more; the load step ends with lips that obey the law of contact."""
    system, state = scene("slit quasi-static P1")
    harder = replace(system, ends=(system.ends[0], Pulled(6.0 * DRAWN[1].load, DRAWN[1].course)))
    steps = [settle(harder, state, 1.0, STEPS * DT), *load_step(harder, state, 1.0, STEPS * DT)]
    lips = [harder.organ.lips(step.new.organ) for step in steps]
    off = [now.gap >= harder.organ.gaps.extent for now in lips]
    assert any((before.force[gone] > 0.0).any() for before, gone in zip(lips, off[1:], strict=False))
    assert not any(now.force[gone].any() for now, gone in zip(lips, off, strict=True))
    assert_lips(harder, steps[-1].new)


def test_without_contact_the_same_lips_cross() -> None:
    """Independent check: what the tests above find is the contact's doing."""
    name = "slit quasi-static P1"
    organ, (free, state) = scene(name)[0].organ, scene(name, contact=False)
    for _ in range(STEPS):
        state = try_step(free, state, DT).new
    U = free.organ.field(state.organ)
    assert (organ.g0 + organ.pairing(None).G @ U).min() < -0.1 * scale_of(scene(name)[0], state)


@pytest.mark.parametrize("name", [name for name in SCENES if name != "slit dynamic P2"])
def test_condensed_and_assembled_agree(name: str) -> None:
    """Consistency check: the step in which the first pairs touch and the last one, both from the same state, in every
    unknown on its own scale, the contact forces too. Of P2, whose assembled matrix is dear, the first alone."""
    system, _ = scene(name)
    organ: Any = system.organ
    touching = [step for step in steps(name) if step.new.organ.p.any()]
    both = last_by_newton(touching[::-1], DT)[0], last_by_newton(touching, DT)[0]
    for step in both[: 1 if "P2" in name else 2]:
        scheme, state = BackwardEuler(DT), step.old
        problem = dynamic_problem(system, state, DT, organ_answer(system, scheme, state), scheme)
        whole = equation_of(problem)
        first = predict(problem, state)
        a = solve(problem, first)
        z = monolithic_solve(problem, first, organ.field(state.organ)).iterate
        assert isinstance(z, Monolith)
        pairs = [(a.p, z.p), (a.iterate.q - state.q, z.q - state.q), (a.iterate.s, z.s), (a.iterate.y, z.y)]
        pairs += [(a.iterate.lam[:, :3], z.lam[:, :3]), (a.iterate.lam[:, 3:], z.lam[:, 3:])]
        pairs += [(organ.field(step.new.organ), z.U), (step.new.organ.p, z.p)]
        for got, exact in pairs:
            assert np.abs(got - exact).max() <= TWO_SOLVERS * np.abs(exact).max()
        assert np.array_equal(a.iterate.pressed, z.pressed) and np.array_equal(a.iterate.sigma, z.sigma)
        residual = whole.A @ z.U - whole.b - organ.Y.T @ step.new.organ.f_y - whole.G.T @ a.p
        terms = np.abs(abs(whole.A) @ np.abs(z.U)).max()
        assert np.abs(residual).max() <= RESIDUAL * terms + TWO_SOLVERS * np.abs(step.new.organ.f_y).max()


@pytest.mark.parametrize("name", SCENES)
def test_it_does_not_matter_which_pairs_are_thought_pressed(name: str) -> None:
    """Consistency check: the last step begun with all pairs pressed, with none, with the wrong ones and at random."""
    system, _ = scene(name)
    state = last_by_newton(steps(name), DT)[0].old
    k = len(system.organ.lips(state.organ)[0])
    scheme = BackwardEuler(DT)
    problem = dynamic_problem(system, state, DT, organ_answer(system, scheme, state), scheme)
    warm = solve(problem, predict(problem, state))
    right = warm.p > 0.0
    for pressed in (np.ones(k, bool), np.zeros(k, bool), ~right, np.random.default_rng(2).random(k) < 0.5):
        cold = find(problem, replace(predict(problem, state), pressed=pressed))
        assert np.array_equal(cold.p > 0.0, right)
        assert np.abs(cold.p - warm.p).max() <= TWO_SOLVERS * warm.p.max()
        assert np.abs(cold.iterate.q - warm.iterate.q).max() <= TWO_SOLVERS * np.abs(warm.iterate.q - state.q).max()


@pytest.mark.parametrize("name", SCENES)
def test_audit_closes_at_every_step(name: str) -> None:
    """Independent check: external work = Δ kinetic + Δ elastic + friction + viscous + numerical in every step, with the
    contact's own −p⁺·Δg in the last; each by a formula of its own."""
    system, state = scene(name)
    energies: list[Energies] = [initial_energies(system, state)]
    worked = 0.0
    for step in steps(name):
        energies.append(audit_step(system, energies[-1], step))
        terms = np.array([getattr(energies[-1], key) for key in ("kinetic", "elastic_thread", "elastic_tissue")])
        moved = [abs(energies[-1].external_work), abs(energies[-1].numerical_dissipation), *terms]
        assert abs(energies[-1].balance_error - energies[-2].balance_error) <= RESIDUAL * max(moved)
        old, new = step.old.organ, step.new.organ
        worked += float(new.p @ (system.organ.gap(old) - system.organ.gap(new)))
    assert worked > 1e-6 * energies[-1].external_work  # the audit would not close without it


def run_by(take: Any, system: System, state: State, count: int = STEPS) -> list[State]:
    out = [state]
    for _ in range(count):
        out.append(take(system, out[-1], DT).new)
    return out


@pytest.mark.parametrize("take", [stepping.bdf2_step, two_pass, staggered_step], ids=["bdf2", "two-pass", "staggered"])
@pytest.mark.parametrize("name", ["slit dynamic P1", "open quasi-static P1"])
def test_the_law_of_contact_by_every_scheme(name: str, take: Any) -> None:
    """Independent check: the same law under BDF2, friction in two passes, and with the organ after the thread, of a
    thread that is fine enough to be drawn on through its holes."""
    system, start = scene(name, points=80)
    if take is two_pass:
        holes = tuple(replace(hole, friction=Friction(0.1, 0.1)) for hole in system.piercings)
        system = replace(system, piercings=holes)
    states = run_by(take, system, start)
    assert [assert_lips(system, state) for state in states][-1] > 0
    if take is stepping.bdf2_step:
        energies = initial_energies(system, start)
        for old in states[:-1]:
            energies = audit_step(system, energies, take(system, old, DT))
        assert abs(energies.balance_error) <= RESIDUAL * abs(energies.external_work)


@pytest.mark.parametrize("name", ["slit quasi-static P1", "open quasi-static P1"])
def test_equilibrium_is_where_the_motion_comes_to_rest(name: str) -> None:
    """Consistency check: load steps of statics and a long quasi-static run end with the same lips, of a thread whose
    knots travel, to which a hole is no lattice with equilibria of its own."""
    system, _ = scene(name)
    spline = through_holes(LENGTH, np.array(ABSCISSAE), bool(system.rows[0, 3]), LENGTH / 37)
    system = replace(system, thread=replace(system.thread, spline=spline))
    start = laid(system, ABSCISSAE, hairpin(RADIUS, LENGTH))
    state, energies = start, initial_energies(system, start)
    for k in range(1, 6):
        for step in load_step(system, state, k / 5, STEPS * DT):
            energies, state = audit_step(system, energies, step), step.new
            assert assert_lips(system, state) >= 0
    assert abs(energies.balance_error) <= RESIDUAL * abs(energies.external_work)
    moved = replace(system, thread=replace(system.thread, damping=100.0))
    run = begin(moved, start, try_step)
    for _ in range(STEPS + 60):
        run = run.step(DT)
    lips, still = observe_contact(system.at(state), state), observe_contact(run.system, run.state)
    assert lips.pressed == still.pressed > 0
    assert np.abs(lips.force - still.force).max() <= FITTED * lips.force.max()


@pytest.mark.parametrize("inertia", [True, False])
def test_a_piercing_that_begins_and_one_that_ends_between_pressed_lips(inertia: bool) -> None:
    """Independent check: lips that are pressed when the thread is let go of one hole and drawn into another neither
    cross nor pull then, nor in the steps after."""
    name = "slit dynamic P1" if inertia else "slit quasi-static P1"
    system, _ = scene(name)
    state = steps(name)[-1].new
    begun = replace(state, present=np.array([True, False]), lam=state.lam * [[1.0], [0.0]])
    late = replace(system, piercings=(Piercing("entry"), Piercing("exit", begins=state.time)))
    after, events = schedule_piercings(late, state.time - DT, begun, DT, np.array([np.nan, np.nan]))
    assert [event.kind for event in events] == ["begins"]
    assert assert_lips(late, after) > 0
    assert np.abs(system.organ.site_variables(after.organ) - after.y.ravel()).max() <= TWO_SOLVERS * RADIUS
    ending = replace(system, piercings=(Piercing("entry"), Piercing("exit", ends=state.time)))
    gone, events = schedule_piercings(ending, state.time - DT, state, DT, np.array([np.nan, np.nan]))
    assert [event.kind for event in events] == ["ends"]
    for within, first in ((late, after), (ending, gone)):
        for step in run(within, first, DT / 8, 4):
            assert_lips(within, step.new)


def test_weight_presses_a_slit_from_the_start() -> None:
    """Independent check: a quasi-static organ whose weight presses its lips together starts in contact, at rest."""
    organ = wounded_organ(False, gravity=(0.0, 0.0, -9.81), h=3e-3)
    upside = wounded_organ(False, gravity=(0.0, 0.0, 9.81), h=3e-3)
    pressed = []
    for each in (organ, upside):
        system = hairpin_system(each, DRAWN, 40)
        pressed.append(assert_lips(system, laid(system, ABSCISSAE, hairpin(RADIUS, LENGTH))))
    assert max(pressed) > 0


def test_the_linear_step_refuses_lips() -> None:
    system, state = scene("slit quasi-static P1")
    with pytest.raises(CouplingError, match="no contact of lips"):
        linear_step(system, state, DT)


SCENARIO = """
[thread]
suture = "2-0 polypropylene"
control_points = 30
path = [[-0.015, 0, 0.015], [-0.005, 0, 0.006], [-0.005, 0, -0.005], [0.005, 0, -0.005], [0.005, 0, 0.006],
        [0.015, 0, 0.015]]
start = { kind = "fixed" }
end = { kind = "driven", waypoints = [[0, 0.015, 0, 0.015], [0.03, -0.005, 0.004, 0.035]] }
damping = 20.0
[tissue]
youngs_modulus = 2.0e4
poisson_ratio = 0.45
density = 1070.0
rayleigh = [5.0, 5.0e-4]
clamp = ["bottom"]
contact = true
mesh = { kind = "wound", size = [0.03, 0.02, 0.01], length = 0.012, depth = 0.005, h = 4.0e-3, accuracy = "given" }
[[piercing]]
name = "entry"
at = [-0.005, 0, 0]
direction = "normal"
footprint = 2.0e-3
[[piercing]]
name = "exit"
at = [0.005, 0, 0]
direction = "normal"
footprint = 2.0e-3
[solve]
dt = 1.0e-3
duration = 0.03
[output]
every = 8
"""


def start(file: Path, out: Path, *more: str) -> int:
    return command.main(["run", str(file), "--out", str(out), "--no-picture", *more])


@pytest.fixture(scope="module")
def closed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A scenario file beside the folder of its run."""
    file = tmp_path_factory.mktemp("contact") / "slit.toml"
    file.write_text(SCENARIO, encoding="utf-8")
    assert start(file, file.parent / "whole", "--quiet") == 0
    return file


def test_what_a_run_says_of_its_lips(closed: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Independent check: the table obeys the law of contact row by row, the summary and the printed line repeat its
    last row, and the pressure in the last frame has the force that it says."""
    out = closed.parent / "whole"
    with (out / "contact.csv").open() as file:
        table = list(csv.DictReader(file))
    assert len(table) == 31 and list(table[0])[:3] == ["time [s]", "step [-]", "pair"]
    assert {row.pop("pair") for row in table} == {"lip_left - lip_right"}
    rows = [{key.partition(" [")[0]: float(value) for key, value in row.items()} for row in table]
    assert rows[0]["pressed"] == 0 and 0 < rows[-1]["pressed"] <= rows[-1]["pairs"]
    for row in rows:
        assert row["smallest_gap"] >= -IDENTITY * RADIUS and row["force"] >= 0.0
        assert row["complementarity"] <= IDENTITY * RADIUS * max(row["force"], 1e-300)
        assert (row["force"] > 0.0) == (row["pressed"] > 0)
    summary = json.loads((out / "summary.json").read_text())
    last = {key: value for key, value in rows[-1].items() if key not in ("time", "step")}
    assert summary["contact"].keys() == {"lip_left - lip_right"} and last["area"] > 0.0
    told = dict(summary["contact"]["lip_left - lip_right"])
    assert told.pop("stitches").keys() == {hole.name for hole in load(closed).piercing} and told == last
    with (out / "gap_profile.csv").open() as file:
        rim = list(csv.DictReader(file))
    assert max(float(row["largest_gap [m]"] or 0.0) for row in rim) == last["largest_gap"]
    simulation = prepare(load(closed))
    for step, frame in simulation.advance():
        organ = frame().organ if step.step == 12 else None
        if organ is not None:
            break
    gaps = simulation.assembly.system.organ.gaps
    left = gaps.nodes[:, 0]
    assert organ.contact_pressure[left] @ gaps.parts[0].areas == pytest.approx(rows[12]["force"], rel=TWO_SOLVERS)
    assert organ.contact_pressure.max() == pytest.approx(rows[12]["largest_pressure"], rel=TWO_SOLVERS)
    assert np.nanmin(organ.lip_gap) == rows[12]["smallest_gap"]
    assert np.isfinite(organ.lip_gap).sum() == 2 * len(left) == np.isin(np.arange(len(organ.lip_gap)), gaps.nodes).sum()
    frame = (out / "frames" / "organ_000030.vtu").read_bytes()
    assert b'Name="contact_pressure"' in frame and b'Name="lip_gap"' in frame
    assert start(closed, closed.parent / "again", "--set", "solve.duration=2e-3") == 0
    printed = capsys.readouterr().out
    assert "contact    lip_left - lip_right: 0 of" in printed and "contact.csv, stitches.csv, gap_pro" in printed


def resumed(file: Path, last: int) -> StepRecord:
    """Interrupt a run after a step and go on with it, to the bytes of the one in `whole`; the record of that step."""
    out, whole = file.parent / "interrupted", file.parent / "whole"
    simulation, seen = prepare(load(file)), []
    recorder = Recorder(out, simulation.tally(), simulation.topology)
    with pytest.raises(KeyboardInterrupt), recorder:
        for step, frame in simulation.advance():
            recorder.record(step, frame)
            seen.append(step)
            if step.step == last:
                raise KeyboardInterrupt
    assert start(file, out, "--resume", "--quiet") == 0
    for name in ("contact.csv", "energy.csv", "piercings.csv", "frames/organ_000030.vtu"):
        assert (out / name).read_bytes() == (whole / name).read_bytes(), name
    return seen[-1]


def test_a_resumed_run_has_the_same_lips(closed: Path) -> None:
    """Consistency check: a run that was interrupted goes on to the same bits."""
    resumed(closed, 19)


@pytest.mark.parametrize(
    ("override", "words"),
    [
        ("tissue.mesh={kind='block',size=[0.03,0.02,0.01],h=4e-3}", ["tissue.contact = true", "no lips", '"wound"']),
        ("solve.scheme=linear", ["tissue.contact = true", "no inequalities", 'solve.scheme = "newton"']),
        ("tissue.contact=1", ["tissue.contact = 1", "boolean"]),
    ],
)
def test_what_contact_refuses(closed: Path, override: str, words: list[str]) -> None:
    with pytest.raises(ScenarioError) as refusal:
        load(closed, [override])
    assert all(word in str(refusal.value) for word in words)


BODIES = """
[tissue]
youngs_modulus = 1.0e5
poisson_ratio = 0.3
density = 1000.0
rayleigh = [50.0, 1.0e-3]
clamp = ["floor"]
[tissue.mesh]
accuracy = "given"
kind = "file"
path = "two.vtu"
[[tissue.boundary]]
name = "floor"
box = [[-1, -1, -0.011], [1, 1, -0.009]]
[[tissue.boundary]]
name = "lower"
box = [[-1, -1, -0.001], [1, 1, 5e-5]]
[[tissue.boundary]]
name = "upper"
box = [[-1, -1, 5e-5], [1, 1, 0.001]]
[thread]
suture = "2-0 polypropylene"
control_points = 8
path = [[0.03, 0, 0], [0.05, 0, 0]]
start = { kind = "fixed" }
end = { kind = "fixed" }
[[contact]]
between = ["upper", "lower"]
[solve]
dt = 2.0e-3
duration = 0.12
gravity = [0, 0, -9.81]
[output]
every = 60
"""


@pytest.fixture(scope="module")
def bodies(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A scenario of a block that hangs 0.1 mm above another one, which is held, in one file."""
    return written_bodies(tmp_path_factory.mktemp("bodies"))


def written_bodies(folder: Path) -> Path:
    """The scenario file of two blocks in a folder, beside their mesh."""
    lower, upper = block((0.01, 0.01, 0.01), 5e-3), block((0.006, 0.006, 0.006), 3e-3)
    points = np.vstack([lower.p.T, upper.p.T + np.array([0.0, 0.0, 0.0061])])
    cells = np.vstack([lower.t.T, upper.t.T + lower.nvertices])
    meshio.Mesh(points, {"tetra": cells}).write(folder / "two.vtu")
    (folder / "bodies.toml").write_text(BODIES, encoding="utf-8")
    return folder / "bodies.toml"


def test_a_body_that_falls_on_another_comes_to_rest_on_it(bodies: Path) -> None:
    """Independent check: the contact carries its weight then, over a part of the lower body's upper side no larger than
    its own lower side and a cell around, and neither is in the other."""
    out = bodies.parent / "out"
    assert start(bodies, out, "--quiet") == 0
    summary = json.loads((out / "summary.json").read_text())
    found = summary["contact"]["upper - lower"]
    assert found["force"] == pytest.approx(0.006**3 * 1000.0 * 9.81, rel=0.01)
    assert 0.0 < found["area"] <= 0.006**2 * (1.0 + IDENTITY) and found["smallest_gap"] >= -IDENTITY * 0.01
    assert found["smallest_gap"] <= found["largest_gap"] < 1e-5 and found["slide"] < 1e-4


@pytest.mark.parametrize("element", ["P1", "P2"])
def test_what_is_open_between_two_surfaces(bodies: Path, element: str) -> None:
    """Independent check: the whole side of the upper body, 0.1 mm above the lower one, is open, and between them is
    that times the side; where some of it is nearer than the tolerance this is not open, whatever it is by. What is
    pressed and what is open share no area: together they are the side."""
    simulation = prepare(load(bodies, [f'tissue.element="{element}"']))
    side, above = 0.006**2, 1e-4
    now = simulation.beginning()
    (found,) = contact_records(now)
    assert found.open_area == pytest.approx(side, rel=RESIDUAL)
    assert found.gap_volume == pytest.approx(side * above, rel=RESIDUAL)
    ((wound, lips, points),) = observed_wounds(now, None)
    (part,) = wound.gaps.parts
    near = wound.gaps.body.points[part.left, 0] < -1e-9
    touching = replace(lips, gap=np.where(near, 0.5 * APART, lips.gap), force=np.where(near, 1e-3, 0.0))
    share = float(part.pair_areas[~near].sum())
    assert 0.4 * side < share < side
    found = contact_record(wound, touching, points)
    assert found.open_area == pytest.approx(share, rel=RESIDUAL)
    assert found.area + found.open_area == pytest.approx(side, rel=RESIDUAL)
    assert found.gap_volume == pytest.approx(share * above + (side - share) * 0.5 * APART, rel=RESIDUAL)
    assert found.approximation == pytest.approx(1.0 - share / side, rel=RESIDUAL)
    through = contact_record(wound, replace(lips, gap=np.full_like(lips.gap, -above)), points)
    assert (through.approximation, through.open_area) == (0.0, 0.0)  # what is through one another does not touch


def test_a_body_that_can_move_is_refused_at_rest(bodies: Path) -> None:
    """Independent check: where nothing may come to hold it, and of tissue at finite strain, a run at rest says which
    body, and how it can move."""
    with pytest.raises(ScenarioError, match=r"has 2 parts, .* can still move along x, y, z and turn about .* x, y, z"):
        prepare(load(bodies, ["solve.kind=static", "tissue.material=neo-hookean", "tissue.rayleigh=[50.0, 0.0]"]))
    with pytest.raises(ScenarioError, match=r"has 2 parts"):
        prepare(load(bodies, ["solve.kind=static", "contact=[]"]))
    with pytest.raises(ScenarioError, match=r"has 2 parts"):
        prepare(load(bodies, ["contact=[]"]))


WEIGHT = 0.006**3 * 1000.0 * 9.81  # of the upper body [N]
AT_REST = ["solve.kind=static", "solve.load_steps=2", "output.every=1"]
SLOPE = "solve.gravity=[1.962, 0, -9.81]"  # of 0.2


@pytest.mark.parametrize("rough", [False, True])
def test_a_body_that_nothing_holds_at_rest_lies_on_another(bodies: Path, rough: bool) -> None:
    """Independent check: 0.1 mm above a plate, which is level, or rises by 0.2 with a coefficient of friction of 0.3,
    it lies on it at rest; what the plate bears is its weight, and friction what draws it downhill. The balance of
    energy closes, and the work of the weight is what the drag took. Consistency check: resumed, the same bits."""
    friction = ['contact=[{between=["upper","lower"],friction=0.3}]', SLOPE] if rough else []
    simulation = prepare(load(bodies, AT_REST + friction))
    records = [record for record, _ in simulation.advance()]
    (lies,), energy = records[-1].contact, records[-1].energy
    assert lies.force == pytest.approx(WEIGHT, rel=TWO_SOLVERS)
    assert lies.friction == pytest.approx(0.2 * WEIGHT if rough else 0.0, abs=TWO_SOLVERS * WEIGHT)
    assert abs(lies.smallest_gap) <= IDENTITY * 0.006
    assert abs(energy.balance_error) <= RESIDUAL * energy.external_work
    assert energy.numerical_dissipation == pytest.approx(WEIGHT * 1e-4, rel=0.2)
    again = [record for record, _ in simulation.advance(records[1].memory)]
    assert again[-1].contact == records[-1].contact


@pytest.mark.parametrize(
    "drawn", [["solve.gravity=[0, 0, 9.81]"], ['contact=[{between=["upper","lower"],friction=0.19}]', SLOPE]]
)
def test_a_body_that_nothing_comes_to_hold_is_said_to_drift(bodies: Path, drawn: list[str]) -> None:
    """Independent check: drawn away from the plate, and on a slope that is steeper than its friction, it has no
    equilibrium, and the run ends with that sentence."""
    simulation = prepare(load(bodies, AT_REST + drawn))
    with pytest.raises(EquilibriumError, match=r"that no clamp holds drifts on.*; clamp it"):
        simulation.next(simulation.beginning())


def test_lips_whose_pairs_alternate_are_no_equilibrium(monkeypatch: pytest.MonkeyPatch) -> None:
    """Consistency check: lips that still slide by a diameter after the last pairing are said to, and are no result."""
    monkeypatch.setattr(equilibrium, "slid", lambda system, step: 1.5 * system.thread.section.diameter)
    system, state = scene("slit quasi-static P1")
    with pytest.raises(EquilibriumError, match=r"slide to and fro on one another by .* mm.*friction"):
        begin(system, state).load(1.0, 1.0)


def test_surfaces_that_slide_to_and_fro_do_not_drift() -> None:
    """Independent check: slides that return are those of pairs that alternate; a drift continues."""
    system: Any = SimpleNamespace(organ=SimpleNamespace(lips=lambda slide: (0.0, 0.0, np.array([slide]))))

    def back(*slides: float) -> bool:
        steps: Any = [SimpleNamespace(new=SimpleNamespace(organ=slide)) for slide in slides]
        return slides_back(system, steps)

    assert back(7.0, 1.0, 3.0, 1.0) and not back(3.0, 1.0, 2.0, 3.0) and not back(0.0, 0.0, 0.0)
