"""Strands of the thread on the surface of the organ: Hertz, a capstan of tissue, the law of contact, the audit."""

import tomllib
from dataclasses import replace
from functools import cache
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
import skfem

import tissue
from coupling.errors import OutError, StepError
from coupling.joins.strands import AWAY, FIRM, abscissae, forces_of, places_of
from coupling.rest.equilibrium import load_steps
from coupling.rest.laying import start
from coupling.step.newton import direction, evaluate
from coupling.system import System, ThreadContact
from studies.scenario import ScenarioError, load, parse
from studies.simulation import prepare
from studies.simulation.laid import LaidPath
from studies.simulation.recording import step_record
from tests.bounds import GAP, IDENTITY, RESIDUAL
from thread.catalogue import Section
from thread.ends import Driven
from thread.knots import uniform_knots
from thread.quadrature import gauss_rule
from thread.spline import Spline
from thread.thread import MASS_POINTS, Thread

HERTZ = 0.03  # of the half width of a line contact: nodes of P2 cells are a tenth of it apart
CAPSTAN = 0.01  # of a tension: the thread turns by up to 0.35 rad between two points, and by the facets' 0.15
WORKS = "external_work", "friction_dissipation"
NO_MOVES = np.zeros(1), np.zeros((1, 3))
SUNK = 0.1  # diameters: between the points a strand lies on facets that turn by 0.1 rad
R, E, NU, DEEP, NARROW = 1e-3, 1e5, 0.3, 5e-5, 1.5e-4  # m, Pa, -, m, about the half width [m]


def slab(size: float, width: float) -> tissue.QuasiStaticOrgan:
    """A plane slab of P2 cells of a `size` [m] under the line x = z = 0, one cell and `width` [m] thick in y, on
    rollers."""
    half, step = [0.0], size
    while half[-1] < 40.0 * NARROW:
        step *= 1.2 if half[-1] > 2.0 * NARROW else 1.0
        half.append(half[-1] + step)
    x, z = np.array([-at for at in half[:0:-1]] + half), -np.array(half)[::-1]
    mesh = skfem.MeshTet.init_tensor(x, np.array([-0.5, 0.5]) * width, z).with_boundaries(
        {
            "bottom": lambda p: p[2] < z[0] + 1e-9,
            "front": lambda p: p[1] < 1e-9 - 0.5 * width,
            "back": lambda p: p[1] > 0.5 * width - 1e-9,
        }
    )
    material = tissue.Material(E, NU, 1000.0)
    body = tissue.elasticity(mesh, material, element="P2", clamp=["bottom"], roller=["front", "back"])
    skin = tissue.skin_of(body)
    top = replace(skin, facets=skin.facets[(body.points[skin.facets, 2] == 0.0).all(axis=1)])
    return tissue.QuasiStaticOrgan(body, tissue.build_sites(body, []), skin=top)


def test_a_strand_pressed_on_a_half_space_is_hertz_line_contact() -> None:
    # Independent: K. L. Johnson, Contact Mechanics, 4.2 (c): a² = 4 F' R/(π E*), p = 2 F'/(π a) √(1 − x²/a²).
    width = 2e-4
    organ = slab(3e-5, width)
    spline = Spline(uniform_knots(width, 6, ()))
    ends = [Driven(np.array([[0.0, 0, y, R], [1.0, 0, y, R - DEEP]])) for y in (-0.5 * width, 0.5 * width)]
    thread = Thread(spline=spline, section=Section(2.0 * R, 1000.0, 1e9))
    system: System[Any] = System(thread, (ends[0], ends[1]), organ, (), contact=ThreadContact())
    s = gauss_rule(spline, MASS_POINTS).s
    path = np.stack([0.0 * s, s - 0.5 * width, 0.0 * s + R], axis=-1)
    steps = list(load_steps(system, start(system, np.zeros(0), path, 1.0), 1.0, 1.0))
    new = steps[-1].new
    points, P = organ.touching_points(new.organ)
    force, across = -(P[:, None] * points[:, 4:7]).sum(axis=0), points[:, 10]
    assert force[2] == pytest.approx(-new.reaction[:, 2].sum(), rel=1e-3)  # the thread's own weight is no load here
    a = np.sqrt(4.0 * force[2] / width * R * (1.0 - NU**2) / (np.pi * E))
    assert 0.1 < a / R < 0.2
    assert 2.0 * np.sqrt((P @ across**2) / P.sum()) == pytest.approx(a, rel=HERTZ)  # ∫p x² = F' a²/4


def capstan(friction: float, radius: float = 8e-3) -> str:
    """A thread over half of a clamped bar of firm tissue, drawn at one end and held at the other."""
    diameter = 2e-4
    rho, turns = radius + 1.5 * diameter, np.linspace(np.pi, 0.0, 13)  # a corner is rounded below it
    over = rho * np.column_stack([0 * turns, np.cos(turns), np.sin(turns)]) / np.cos(np.pi / 24)
    over[[0, -1]] *= np.cos(np.pi / 24)
    held = radius + 0.5 * diameter
    path = [[0.0, -held, -0.02], *over.round(7).tolist(), [0.0, held, -0.02]]
    return f"""
        title = "a thread over a bar of tissue"
        [tissue]
        youngs_modulus = 1.0e6
        poisson_ratio = 0.3
        density = 1000
        clamp = ["left", "right"]
        mesh = {{ kind = "cylinder", radius = {radius}, length = 0.01, h = 1.2e-3, accuracy = "given" }}
        [thread]
        diameter = {diameter}
        youngs_modulus = 1.0e9
        density = 1000
        bending_factor = 0.1
        path = {path}
        contact = {{ friction = {friction} }}
        start = {{ kind = "fixed" }}
        end = {{ kind = "pulled", force = [0, 0, -0.2] }}
        [solve]
        kind = "static"
        load_steps = 4
    """


def parsed(text: str) -> Any:
    """A scenario from its text."""
    return parse(tomllib.loads(text))


@pytest.mark.parametrize("friction", [0.1, 0.3])
def test_a_strand_round_a_bar_of_tissue_is_a_capstan(friction: float) -> None:
    # Independent: T₁ = T₂ e^{−μφ} with φ = π (Euler), and all work of friction on the thread and the tissue.
    simulation = prepare(parsed(capstan(friction)))
    run = simulation.beginning()
    for share in (0.25, 0.5, 0.75, 1.0):
        run = run.load(share, simulation.scenario.solve.duration)
        assert abs(run.energies.balance_error) <= RESIDUAL * run.energies.at_stake
    assert -run.state.reaction[0, 2] == pytest.approx(0.2 * np.exp(-friction * np.pi), rel=CAPSTAN)
    assert run.energies.friction_dissipation > 0.0
    strands = step_record(run).strands
    assert strands is not None and strands.pressed > 5
    assert strands.friction == pytest.approx(friction * strands.force, rel=1e-6)  # it slips everywhere
    assert strands.off_friction < CAPSTAN * 0.2
    assert strands.depth < 0.0


@pytest.mark.parametrize(("youngs_modulus", "off"), [(1e6, CAPSTAN), (3e5, 3.0 * CAPSTAN)])
def test_a_strand_without_friction_keeps_its_tension_and_its_side(youngs_modulus: float, off: float) -> None:
    # Independent: T₁ = T₂, and the scene is symmetric about x = 0. Nodes of quadratic cells lie on chords, and the
    # strand makes a groove in soft tissue.
    text = capstan(0.0, 5e-3).replace("clamp =", 'element = "P2"\nclamp =').replace("1.0e6", str(youngs_modulus))
    simulation = prepare(parsed(text))
    run = simulation.beginning()
    for share in (0.25, 0.5, 0.75, 1.0):
        run = run.load(share, simulation.scenario.solve.duration)
        assert -run.state.reaction[0, 2] == pytest.approx(0.2 * share, rel=off)
    assert np.abs(run.state.q[:, 0]).max() <= 1.2e-3  # a cell


def test_chords_of_a_path_are_laid_on_the_surface() -> None:
    """Independent check: chords over 30° dip into a bar by more than a radius of the thread, and are laid on it.
    Without friction the thread then bears the same on both sides."""
    turns = np.linspace(np.pi, 0.0, 7)
    over = 8.1e-3 * np.column_stack([0 * turns, np.cos(turns), np.sin(turns)])
    tables = tomllib.loads(capstan(0.0))
    tables["thread"]["path"] = [[0.0, -8.1e-3, -0.02], *over.tolist(), [0.0, 8.1e-3, -0.02]]
    simulation = prepare(parse(tables))
    run, laid = simulation.beginning(), simulation.assembly.laid
    places = [path.position(np.linspace(0.0, path.path.length, 500)) for path in (LaidPath(laid.path, *NO_MOVES), laid)]
    deep = [simulation.assembly.depths(each).max() for each in places]
    assert deep[0] > 1.5e-4 and deep[1] < -0.9e-4
    for share in (0.5, 1.0):
        run = run.load(share, simulation.scenario.solve.duration)
    assert -run.state.reaction[0, 2] == pytest.approx(0.2, rel=CAPSTAN)


SPEED, WAY = 0.1, 2.5e-4  # m/s, m of a load step: a turn by 0.05 rad


def drawn(friction: float, waypoints: str, ramp: float, solve: str) -> Any:
    """A thread over half of a clamped bar, drawn at one end against a dead load at the other."""
    text = capstan(friction, 5e-3).replace("length = 0.01", "length = 6e-3").replace("1.0e6", "1.0e8")
    text = text.replace("path =", "control_points = 40\n        damping = 20.0\n        path =")
    text = text.replace('"fixed"', f'"driven", waypoints = {waypoints}')
    text = text.replace("-0.2]", f"-0.2], ramp = {ramp}, mass = 1e-4").replace('kind = "static"', solve)
    return prepare(parsed(text.replace("load_steps = 4", "")))


@pytest.mark.parametrize(("dt", "integrator"), [(1e-3, "bdf2"), (2e-3, "bdf2"), (2e-3, "euler")])
def test_a_strand_that_slides_in_time_keeps_its_tension(dt: float, integrator: str) -> None:
    """Independent check: without friction the pull is the dead load. Forces along the normals at the start of a step,
    in which the thread turns by α, would pull back with πα of the tension: 6 and 13 %. Of second order are πα²."""
    ways = f"[[0, 0, -5.1e-3, -0.02], [1, 0, -5.1e-3, {-0.02 - SPEED}]]"
    simulation = drawn(
        0.0,
        ways,
        0.0,
        f'dt = {dt}\n        duration = 0.04\n        start = "rest"\n        integrator = "{integrator}"',
    )
    runs = [simulation.beginning()]
    for _ in range(simulation.steps):
        runs.append(runs[-1].step(dt))
    half = runs[len(runs) // 2 :]
    assert np.mean([-run.state.reaction[0, 2] for run in half]) == pytest.approx(
        0.2, rel=CAPSTAN + np.pi * (SPEED * dt / 5e-3) ** 2
    )
    made = half[0].energies.numerical_dissipation - half[-1].energies.numerical_dissipation
    assert made <= np.pi * (SPEED * dt / 5e-3) ** 2 * 0.2 * SPEED * 0.02  # of the work of the pull in that time


def test_the_works_of_a_strand_that_slides_at_rest_are_those_of_its_forces() -> None:
    """The forces are the same at both ends of a load step, so that the external work is their product with the ways
    (consistency check), and friction takes T₁ − T₂ times the way of the thread (independent check)."""
    ways = f"[[0, 0, -5.1e-3, -0.02], [1, 0, -5.1e-3, -0.02], [5, 0, -5.1e-3, {-0.02 - 4 * WAY}]]"
    simulation = drawn(0.2, ways, 1.0, 'kind = "static"\n        duration = 5.0\n        load_steps = 5')
    run = simulation.beginning()
    for k in range(5):
        before, run = run, run.load(0.2 * (k + 1), 5.0)
    pulls = [-each.state.reaction[0, 2] for each in (before, run)]
    external, friction = (getattr(run.energies, name) - getattr(before.energies, name) for name in WORKS)
    given = np.mean(pulls) * WAY
    assert external == pytest.approx(given - 0.2 * (run.state.q[-1, 2] - before.state.q[-1, 2]), abs=1e-6 * given)
    assert friction == pytest.approx((np.mean(pulls) - 0.2) * WAY, rel=CAPSTAN)


STRAND = """
    title = "a strand is drawn down over a block"
    [tissue]
    youngs_modulus = 1.0e5
    poisson_ratio = 0.45
    density = 1000
    clamp = ["bottom"]
    mesh = { kind = "block", size = [0.02, 0.02, 0.01], h = 2.5e-3, accuracy = "given" }
    [thread]
    suture = "2-0 polypropylene"
    path = [[-0.015, 0.001, 0.0002], [0.015, -0.001, 0.0002]]
    contact = true
    start = { kind = "driven", waypoints = [[0, -0.015, 0.001, 0.0002], [0.1, -0.015, 0.001, -0.001]] }
    end = { kind = "driven", waypoints = [[0, 0.015, -0.001, 0.0002], [0.1, 0.015, -0.001, -0.001]] }
    [solve]
    dt = 2e-3
    duration = 0.1
"""


@cache
def strand(friction: float) -> tuple[Any, tuple[Any, ...]]:
    """The system of a strand over a block, and its states in time."""
    text = STRAND if not friction else STRAND.replace("contact = true", f"contact = {{ friction = {friction} }}")
    simulation = prepare(parsed(text))
    runs = [simulation.beginning()]
    for _ in range(50):
        runs.append(runs[-1].step(2e-3))
    return simulation, tuple(runs)


@pytest.mark.parametrize("friction", [0.0, 0.2])
def test_the_law_of_contact_holds_at_every_step(friction: float) -> None:
    # Consistency: gaps from the solved curve and the organ's displacement, forces from the state.
    simulation, runs = strand(friction)
    organ, diameter, pressed = simulation.assembly.organ, simulation.assembly.system.thread.section.diameter, 0
    for before, run in pairwise(runs):
        step = run.taken[-1]
        strands, touch, new = step.solution.problem.strands, step.solution.residual.touch, step.new
        gaps = strands.opens(new.q, new.s) + organ.gaps_of(new.organ)[-len(strands.at) :]
        p, k = touch.P[: strands.count], strands.count
        yields = 0.0 if touch.law is None else FIRM * np.diag(touch.law.C).max() * p.max()
        assert p.min() >= 0.0 and gaps[:k].min() >= -1.01 * yields - GAP * diameter
        assert np.abs(p * gaps[:k]).max() <= (1.01 * yields + GAP * diameter) * p.max()
        if friction:
            along = np.linalg.norm(touch.P[k:].reshape(-1, 2), axis=1)
            assert (along <= friction * p * (1.0 + 1e-8) + 1e-15).all()
            assert touch.P[k:] @ gaps[k:] <= 1e-15  # it opposes the slip
        assert abs(run.energies.balance_error) <= RESIDUAL * runs[-1].energies.at_stake
        assert run.energies.friction_dissipation >= before.energies.friction_dissipation - 1e-15
        pressed = max(pressed, np.count_nonzero(p))
    assert pressed >= 4
    assert (runs[-1].energies.friction_dissipation > 0.0) == (friction > 0.0)


def test_a_strand_does_not_sink_between_its_points() -> None:
    # Independent of the points: the nearest place of the deformed surface to many places of the strand.
    simulation, runs = strand(0.0)
    assembly, run = simulation.assembly, runs[-1]
    system, state, body = run.system, run.state, assembly.body
    s = abscissae(system, state, 12)
    places = places_of(system.at(state).thread.spline, state.q, s)
    moved = body.nodal(assembly.organ.displacement(state.organ))
    away = tissue.skin_of(body).faced(moved, places, np.zeros((len(s), 0)))[:, AWAY]
    over = np.abs(places[:, 0]) < 8e-3
    assert away[over].min() >= (0.5 - SUNK) * system.thread.section.diameter
    assert moved[:, 2].min() < -2e-4  # and the block gives way


def test_the_forces_obey_the_law_of_their_compliance() -> None:
    # Independent of the solver: p ≥ 0, g = Cp + c ≥ 0 and p g = 0, which one p alone obeys.
    _, runs = strand(0.0)
    touch = runs[-1].taken[-1].solution.residual.touch
    assert touch.law is not None and np.count_nonzero(touch.P) >= 4
    for p in (forces_of(touch.law, touch.c_open)[2], touch.P[touch.near]):
        g, scale = touch.law.C @ p + touch.c_open, np.abs(touch.c_open).max()
        assert p.min() >= 0.0 and g.min() >= -1e-8 * scale
        assert np.abs(p * g).max() <= 1e-8 * p.max() * scale


HOLES = """
    title = "a strand between two holes in the top of a block"
    [tissue]
    youngs_modulus = 1.0e5
    poisson_ratio = 0.45
    density = 1000
    clamp = ["bottom"]
    mesh = { kind = "block", size = [0.03, 0.02, 0.01], h = 2.5e-3, accuracy = "given" }
    [thread]
    suture = "4-0 polyglactin 910"
    path = [[-0.02, 0, 0.006], [-0.006, 0, 0], [0.006, 0, 0], [0.02, 0, 0.006]]
    contact = { friction = 0.1 }
    start = { kind = "fixed" }
    end = { kind = "pulled", force = [0.1, 0, 0.05], ramp = 0.02 }
    [[piercing]]
    name = "one"
    at = [-0.006, 0, 0]
    footprint = 1e-3
    friction = { static = 0.1, kinetic = 0.1 }
    [[piercing]]
    name = "other"
    at = [0.006, 0, 0]
    footprint = 1e-3
    [solve]
    dt = 1e-3
    duration = 0.03
"""


def test_contact_pries_no_strand_up_that_lies_flush_between_its_holes() -> None:
    # Independent: no step makes energy, and the strand stays where its holes have it, within its radius.
    run = prepare(parsed(HOLES)).beginning()
    start = run.energies
    for _ in range(30):
        run = run.step(1e-3)
        assert abs(run.energies.balance_error) <= RESIDUAL * 1e-4
    assert run.energies.numerical_dissipation >= start.numerical_dissipation - 1e-3 * run.energies.at_stake
    strands = step_record(run).strands
    assert strands is not None and strands.depth <= 0.5 * run.system.thread.section.diameter


@pytest.mark.parametrize("friction", [0.0, 0.2])
def test_a_correction_takes_the_residual_away(friction: float) -> None:
    # Independent of the linearisation: a small share of a correction leaves that much less of every residual.
    _, runs = strand(friction)
    run, (step,) = runs[-1], runs[-1].taken
    problem, z = step.solution.problem, step.solution.iterate
    z = replace(z, q=z.q + 1e-10 * np.random.default_rng(1).standard_normal(z.q.shape) * ~run.system.held_flags)
    r = evaluate(problem, z)
    dq, _ = direction(problem, z, r)
    free = ~problem.system.held_flags
    left = []
    for share in (1e-2, 5e-3):
        there = replace(z, q=z.q + share * dq)
        r_new = evaluate(problem, there)
        change = (r_new.thread - r.thread)[free] / share
        left.append(np.abs(change + r.thread[free]).max() / np.abs(r.thread[free]).max())
    assert left[1] <= 2e-3


def test_a_strand_above_the_surface_is_none_the_wiser() -> None:
    # Consistency: contact that nothing meets changes no number.
    quiet = STRAND.replace("-0.001]]", "0.0002]]").replace("0.0002]", "0.002]")
    ends = []
    for contact in ("true", "false"):
        run = prepare(parsed(quiet.replace("contact = true", f"contact = {contact}"))).beginning()
        for _ in range(5):
            run = run.step(2e-3)
        ends.append(run.state)
    assert np.abs(ends[0].q - ends[1].q).max() <= IDENTITY * 0.03


@pytest.mark.parametrize(
    ("given", "words"),
    [
        (["thread.contact=0.1"], "thread.contact = 0.1 is refused: allowed are true, false, or a table"),
        (["thread.contact={friction=-0.1}"], "thread.contact"),
        (["thread.contact=true", 'solve.scheme="linear"'], "leave out thread.contact"),
    ],
)
def test_impossible_contact_is_refused_in_words(given: list[str], words: str) -> None:
    # Behaviour: key, value, what is allowed.
    with pytest.raises(ScenarioError, match=words):
        load("two_piercings", given)


def test_contact_without_an_organ_is_refused_in_words() -> None:
    # Behaviour: there is no surface.
    with pytest.raises(ScenarioError, match=r"thread.contact = true is refused: there is no organ; add \[tissue\]"):
        load("paper_figure_1", ["thread.contact=true"])


def test_a_strand_that_sinks_out_of_its_place_is_refused_in_words() -> None:
    # Consistency: the tissue is a fifth as stiff as tissue that carries the strand in a groove.
    simulation = prepare(parsed(capstan(0.0, 5e-3).replace("1.0e6", "6.0e4")))
    run = simulation.beginning().load(0.25, simulation.scenario.solve.duration)
    with pytest.raises(OutError, match=r"a strand finds no place on the surface: it is 0.* mm from where its forces"):
        run.load(0.5, simulation.scenario.solve.duration)


EDGE = """
[tissue]
youngs_modulus = 1e5
poisson_ratio = 0.45
density = 1000.0
clamp = ["bottom"]
mesh = { kind = "block", size = [0.02, 0.016, 0.01], h = 2e-3, accuracy = "given" }
[thread]
suture = "3-0 nylon"
path = [[-0.02, 0, -0.002], [-0.0105, 0, 0.0003], [0.0105, 0, 0.0003], [0.02, 0, -0.002]]
contact = true
start = { kind = "pulled", force = [-0.1, 0, -0.05] }
end = { kind = "pulled", force = [0.1, 0, -0.05] }
[solve]
kind = "static"
load_steps = 4
"""


def test_a_strand_that_slips_off_its_edges_flies_away_in_words() -> None:
    # Independent: without friction nothing balances a pull along the edges, and beyond their ends none downwards. The
    # remark is by statics too: T + EI κ²/2 of a strand without friction is the same on both sides of an edge.
    simulation = prepare(parsed(EDGE))
    run = simulation.beginning().load(0.25, simulation.scenario.solve.duration)
    strands = step_record(run).strands
    tension = np.hypot(0.1, 0.05) * 0.25
    assert strands is not None and strands.friction == 0.0
    assert 2.0 * CAPSTAN * tension < strands.off_friction < tension
    drawn = prepare(parsed(EDGE.replace("[-0.1, 0, -0.05]", "[-0.1, 1e-3, -0.05]")))
    with pytest.raises(StepError, match="the thread flies away: nothing balances its loads"):
        drawn.beginning().load(0.25, drawn.scenario.solve.duration)
