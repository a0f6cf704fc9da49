"""A shallow arch that a load presses through: no equilibrium is near, and the tissue goes downhill to the next one."""

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
import skfem
from scipy.optimize import brentq, minimize
from scipy.special import ellipe, ellipk

import tissue
from coupling.errors import CouplingError
from coupling.integrators import Equilibrium
from coupling.rest import equilibrium
from coupling.rest.branch import Branch, follow, walk
from coupling.rest.equilibrium import snapped
from coupling.rest.laying import start
from coupling.run.run import Run, begin
from coupling.system import Piercing, State, System
from meshes.block import block
from studies.scenario import parse
from studies.simulation import prepare
from tests.bounds import RESIDUAL, TWO_SOLVERS
from tests.thread.threads import Array, X, Y, Z
from thread.catalogue import suture
from thread.ends import Fixed, Free, Pulled
from thread.knots import uniform_knots
from thread.quadrature import gauss_rule
from thread.spline import Spline
from thread.thread import MASS_POINTS, Thread
from tissue.materials.isotropic import Exponential
from tissue.organs.finite import Forces

SPAN, WIDTH, THICK, RISE = 0.04, 4e-3, 0.5e-3, 4e-3  # m
LONG = 0.03  # of a flap [m]
LOAD = 16.0  # Pa, beyond what it bears
HALF = 0.02  # of the thread [m]
COLUMN = 0.02  # of the elastica's displacements: measured 0.5 and 0.8 % with 12 and 16 cells along it


def crown(x: Array) -> Array:
    """Height of the arch's underside [m]."""
    return np.asarray(RISE * (1.0 - (2.0 * x / SPAN) ** 2))


def arch() -> tissue.FiniteOrgan:
    """A strip of P2 cells, held at both ends, with a dead load on its top and a hole in the middle."""
    lines = np.linspace(-SPAN / 2, SPAN / 2, 13), np.linspace(-WIDTH / 2, WIDTH / 2, 2), np.linspace(0.0, THICK, 2)
    flat = skfem.MeshTet.init_tensor(*lines).with_boundaries(
        {"top": lambda x: np.isclose(x[2], THICK), "ends": lambda x: np.isclose(np.abs(x[0]), SPAN / 2)}
    )
    p = flat.p.copy()
    p[2] += crown(p[0])
    body = tissue.elasticity(
        skfem.MeshTet(p, flat.t, _boundaries=flat.boundaries), tissue.Material(1e6, 0.3, 1000.0), "P2", ("ends",)
    )
    sites = tissue.build_sites(body, [tissue.Site((0.0, 0.0, RISE + THICK), 2e-3, "parabolic", None)])
    load = tissue.SurfaceLoad("top", traction=(0.0, 0.0, -LOAD))
    return tissue.FiniteOrgan(body, sites, loads=[load], inertia=False, law=tissue.Hyperelasticity(body))


@cache
def pressed() -> tuple[tissue.FiniteOrgan, list[Run]]:
    """The arch with a thread through its hole that is hardly drawn, in two load steps."""
    organ, at = arch(), np.array([0.0, 0.0, RISE + THICK])
    thread = Thread(Spline(uniform_knots(2.0 * HALF, 16)), suture("4-0 polypropylene"))
    ends = Fixed(at - HALF * Y), Pulled(1e-3 * Y)
    system: Any = System(thread, ends, organ, (Piercing("hole", directed=False),))
    path = at + (gauss_rule(thread.spline, MASS_POINTS).s[..., None] - HALF) * Y
    runs = [begin(system, start(system, np.array([HALF]), path, 1.0))]
    for share in (0.25, 1.0):
        runs.append(runs[-1].load(share, 1.0))
    return organ, runs


def lowest(organ: tissue.FiniteOrgan, run: Run) -> float:
    """How far the arch has gone down at most [m]."""
    return -float(organ.elasticity.nodal(organ.displacement(run.state.organ))[:, 2].min())


def test_an_arch_snaps_through_and_says_so() -> None:
    """Independent check: under a quarter of the load it stands, under all of it, it hangs through, in an equilibrium
    that holds: its tangent is definite. The event says so, once, and every joule is accounted for."""
    organ, (_, stands, through) = pressed()
    assert 0.0 < lowest(organ, stands) < 0.1 * RISE and lowest(organ, through) > RISE
    assert [event.kind for event in stands.events] == []
    assert [event.kind for event in through.events].count("snaps") == 1
    U = through.state.organ.U
    stiffness = np.linalg.eigvalsh(organ.law.tangent(organ.law.gradient(organ.whole(U))).toarray())
    assert stiffness.min() > 0.0
    audit = through.energies
    assert abs(audit.balance_error) <= 1e-7 * audit.external_work
    assert audit.numerical_dissipation > 0.1 * audit.external_work  # what the snap would have set in motion


def test_tissue_that_fails_without_the_thread_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    """Independent check: a suction that corrections cannot bear in one step, on a block that no thread touches, is not
    put down to the thread and its path."""
    monkeypatch.setattr(equilibrium, "MOST_CORRECTIONS", 20)
    block = {"kind": "block", "size": [0.02, 0.02, 0.02], "h": 0.01}
    tissue_of = {
        "material": "neo-hookean",
        "youngs_modulus": 1e5,
        "poisson_ratio": 0.45,
        "density": 1e3,
        "inertia": False,
    }
    held = {"mesh": block, "clamp": ["bottom"], "load": [{"boundary": "top", "pressure": -1e6}]}
    thread = {"suture": "6-0 nylon", "path": [[0.0, 0.0, 0.05], [0.01, 0.0, 0.05]], "start": {"kind": "fixed"}}
    data = {"tissue": tissue_of | held, "thread": thread, "solve": {"kind": "static", "load_steps": 1}}
    with pytest.raises(CouplingError, match=r"the tissue deforms without the thread.* finer mesh or smaller") as error:
        list(prepare(parse(data)).advance())
    assert "path" not in str(error.value)


def test_the_arch_hangs_where_newton_finds_it_from_below() -> None:
    """Independent check: the equilibrium of the same load that Newton finds from the arch turned over."""
    organ, (_, _, through) = pressed()
    state, body = through.state.organ, organ.elasticity
    over = np.zeros((len(body.points), 3))
    over[:, 2] = -2.0 * crown(body.points[:, 0])
    U = body.flat(over)[body.free]
    answer = organ.answer(Equilibrium(), [tissue.OrganState(U, 0.0 * U, 0.0 * U, state.f_y)], 1.0)
    for _ in range(100):
        after = answer.again(state.f_y, np.zeros(0))
        if after is answer:
            break
        answer = after
    point = answer.point
    assert np.abs(point.U - state.U).max() <= TWO_SOLVERS * np.abs(state.U).max()
    assert np.abs(point.r - organ.map.Z.T @ state.f_y[: organ.map.Z.shape[0]]).max() <= 100.0 * RESIDUAL * point.scale


def test_newton_does_not_jump_without_a_word() -> None:
    """Independent check: under five times the load Newton's method itself goes from the arch to where it hangs
    through, an equilibrium that holds. That is no continuation, and the event says so, once; on from there is."""
    organ, (laid, _, _) = pressed()
    loads = [replace(load, traction=(0.0, 0.0, -5.0 * LOAD)) for load in organ.loads]
    system: Any = replace(laid.system, organ=replace(organ, loads=loads))
    through = begin(system, replace(laid.state, organ=system.organ.start())).load(0.8, 1.0)
    assert lowest(organ, through) > RISE
    assert [event.kind for event in through.events].count("snaps") == 1
    assert "snaps" not in [event.kind for event in through.load(1.0, 1.0).events]


def test_newton_finds_an_unstable_equilibrium_from_near() -> None:
    """Independent check: half-way between both equilibria the flat arch would buckle. From near there along the mode of
    negative stiffness, a correction under the forces that hold it leads uphill and to it, with an error of second
    order: a thread can stabilise such an equilibrium."""
    organ, (_, stands, through) = pressed()
    motion = organ.answer(Equilibrium(), [stands.state.organ], 1.0).motion
    U = 0.5 * (stands.state.organ.U + through.state.organ.U)
    forces = Forces(np.zeros(organ.y0.size), organ.point(motion, U).r)
    stiffness, modes = np.linalg.eigh(organ.law.tangent(organ.law.gradient(organ.whole(U))).toarray())
    assert stiffness[0] < 0.0
    errors = []
    for part in (1e-3, 1e-4):
        start = organ.point(motion, U + part * RISE * modes[:, 0] / np.abs(modes[:, 0]).max())
        way = np.linalg.solve(organ.law.tangent(start.F).toarray(), organ.residual(start, forces))
        assert organ.residual(start, forces) @ way < 0.0
        point, share = organ.go(motion, start, start.U + way, forces)
        assert share == 1.0
        errors.append(np.abs(point.U - U).max())
    assert errors[0] < 0.1 * 1e-3 * RISE and errors[1] < 0.02 * errors[0]


def flap() -> tissue.FiniteOrgan:
    """A thin strip of stiffening tissue that is held at one end, with a hole near the other."""
    lines = np.linspace(0.0, LONG, 16), np.linspace(-WIDTH / 2, WIDTH / 2, 2), np.linspace(-THICK, 0.0, 2)
    mesh = skfem.MeshTet.init_tensor(*lines).with_boundaries({"end": lambda x: np.isclose(x[0], 0.0)})
    body = tissue.elasticity(mesh, tissue.Material(1e6, 0.3, 1000.0), "P2", ("end",))
    sites = tissue.build_sites(body, [tissue.Site((LONG - 2e-3, 0.0, 0.0), 2e-3, "parabolic", None)])
    law = tissue.Hyperelasticity(body, Exponential(body.material.lame_mu, 5.0))
    return tissue.FiniteOrgan(body, sites, law=law, inertia=False)


def test_a_flap_that_bends_far_and_is_drawn_taut_does_not_snap() -> None:
    """Independent check: a dead load that lifts a thin flap turns it upright, by 80°, and then stretches it, stiffer
    and stiffer; that is one branch, though on the straight way between two of its equilibria a flap that turns is
    pressed together and drawn out again, far harder than it is bent. A load step in which corrections of the tissue
    must be shortened again and again is halved; that takes a third of the time."""
    organ, at = flap(), np.array([LONG - 2e-3, 0.0, 0.0])
    thread = Thread(Spline(uniform_knots(HALF, 16)), suture("4-0 polypropylene"))
    hole = Piercing("hole", slides=False, directed=False)
    system: Any = System(thread, (Free(), Pulled(0.1 * Z)), organ, (hole,))
    path = at + gauss_rule(thread.spline, MASS_POINTS).s[..., None] * Z
    runs = [begin(system, start(system, np.array([0.0]), path, 1.0))]
    for share in (0.002, 0.006, 0.02, 1.0):
        runs.append(runs[-1].load(share, 1.0))
        assert "snaps" not in [event.kind for event in runs[-1].events]
    assert runs[-1].state.y[0, 2] > 0.95 * LONG and runs[-1].state.y[0, 0] < 0.1 * LONG
    assert len(runs[1].taken) > 1


def post(**loads: Any) -> tuple[tissue.FiniteOrgan, float]:
    """A straight post, 40 × 4 × 2 mm, and Euler's load of it [N]. Its mesh is the same on both sides of its middle,
    across which it buckles."""
    lines = np.linspace(0.0, 0.001, 2), np.linspace(-0.002, 0.002, 2), np.linspace(-0.04, 0.0, 13)
    half = skfem.MeshTet.init_tensor(*lines)
    faces = {"bottom": lambda x: np.isclose(x[2], -0.04), "top": lambda x: np.isclose(x[2], 0.0)}
    mesh = (half + half.mirrored((1.0, 0.0, 0.0))).with_boundaries(faces)
    body = tissue.elasticity(mesh, tissue.Material(1e5, 0.0, 1000.0), "P2", ("bottom",))
    sites = tissue.build_sites(body, [tissue.Site((0.0, 0.0, 0.0), 1e-3, "parabolic", None)])
    organ = tissue.FiniteOrgan(body, sites, inertia=False, law=tissue.Hyperelasticity(body), **loads)
    return organ, np.pi**2 * 1e5 * (0.004 * 0.002**3 / 12.0) / (4.0 * 0.04**2)


def column(load: float) -> tuple[Any, Run]:
    """A post under a half of a `load` in Euler's loads, and its system."""
    organ, euler = post()
    thread = Thread(Spline(uniform_knots(HALF, 16)), suture("4-0 polypropylene"))
    hole = Piercing("hole", slides=False, directed=False)
    system: Any = System(thread, (Free(), Pulled(-load * euler * Z)), organ, (hole,))
    path = -gauss_rule(thread.spline, MASS_POINTS).s[..., None] * Z
    return system, begin(system, start(system, np.array([0.0]), path, 1.0)).load(0.5, 1.0)


def softest(organ: tissue.FiniteOrgan, run: State[Any]) -> float:
    """Smallest eigenvalue of the tangent [N/m]."""
    F = organ.law.gradient(organ.whole(run.organ.U))
    return float(np.linalg.eigvalsh(organ.law.tangent(F).toarray()).min())


def test_a_column_buckles_under_a_dead_load() -> None:
    """Independent check: under 1.5 times Euler's load a straight column is an equilibrium that does not hold. It bends
    across its thin side as far as the elastica of that load, with K(k) = √1.5 π/2: the tip deflects by 2k/K and
    sinks by 2 − 2E/K of the length."""
    load = 1.5
    system, run = column(load)
    run = run.load(1.0, 1.0)
    assert softest(system.organ, run.state) > 0.0
    K, tip = np.sqrt(load) * np.pi / 2.0, run.state.y[0, :3]
    m = brentq(lambda m: ellipk(m) - K, 0.0, 0.99)
    assert abs(tip[0]) == pytest.approx(2.0 * np.sqrt(m) / K * 0.04, rel=COLUMN)
    assert tip[2] == pytest.approx(-(2.0 - 2.0 * ellipe(m) / K) * 0.04, rel=COLUMN)
    assert abs(tip[1]) < 0.01 * abs(tip[0])


def test_a_column_buckles_in_small_load_steps_too() -> None:
    """Independent check: in small steps a straight column converges with an old tangent, from below its buckling load.
    It is straight under 0.975 of Euler's load, and bent under 1.027 of it."""
    _, run = column(1.3)
    for share in (0.6, 0.7, 0.75, 0.79):
        run = run.load(share, 1.0)
        assert (abs(run.state.y[0, 0]) > 0.01 * 0.04) == (1.3 * share > 1.0)
    assert "snaps" in [event.kind for event in run.events]


@pytest.mark.parametrize("share", [1.0 - 1e-6, 1.0 + 1e-6])
def test_a_cube_under_equal_dead_loads_leaves_its_symmetric_state(share: float) -> None:
    """Independent check: Rivlin's cube. Under equal dead tractions of 2.1 shear moduli the symmetric state is a saddle,
    and the minimum is a plate. If the load on one pair of faces differs by 1e-6, the tissue snaps to it too."""
    mu, kappa, T = 1e5 / 2.9, 1e5 / 0.3, 2.1 * 1e5 / 2.9
    mesh = block((0.01, 0.01, 0.01), 0.005)
    material, rollers = tissue.Material(1e5, 0.45, 1000.0), ("left", "front", "bottom")
    body = tissue.elasticity(mesh, material, "P1", (), "cell", rollers)
    pulls = {"right": T * X, "back": T * Y, "top": share * T * Z}
    loads = [tissue.SurfaceLoad(name, traction=tuple(pull)) for name, pull in pulls.items()]
    organ = tissue.FiniteOrgan(
        body, tissue.build_sites(body, []), loads=loads, inertia=False, law=tissue.Hyperelasticity(body)
    )
    thread = Thread(Spline(uniform_knots(HALF, 8)), suture("4-0 polypropylene"))
    system: Any = System(thread, (Fixed(Z), Fixed(Z + HALF * X)), organ, ())
    path = Z + gauss_rule(thread.spline, MASS_POINTS).s[..., None] * X
    run = begin(system, start(system, np.zeros(0), path, 1.0))
    for part in np.linspace(0.1, 1.0, 10):
        run = run.load(part, 1.0)
    moved = organ.elasticity.nodal(organ.displacement(run.state.organ))[np.argmax(mesh.p.sum(axis=0))]

    def potential(logs: Array) -> float:
        J, stretches = np.exp(logs.sum()), np.exp(logs)
        distortion = 0.5 * mu * J ** (-2.0 / 3.0) * stretches @ stretches
        return float(distortion + 0.5 * kappa * (J - 1.0) ** 2 - T * stretches.sum()) / mu

    least = np.exp(minimize(potential, np.log([1.8, 1.8, 0.4]), tol=1e-9).x)
    assert "snaps" in [event.kind for event in run.events]
    assert sorted(1.0 + moved / 0.01) == pytest.approx(sorted(least), rel=1e-4)


def test_a_column_that_is_led_beyond_its_bifurcation_is_left_to_buckle() -> None:
    """Consistency check: the branch of the straight column leads through equilibria that do not hold. Left alone there,
    it goes to where load steps lead it, on either side."""
    system, run = column(1.5)
    branch = Branch(system, run.state, 1.0, run.state)
    straight, found = [*walk(branch, 1.0)][-1], follow(branch, 1.0)[-1]
    assert softest(system.organ, straight.new) < 0.0 and abs(straight.new.y[0, 0]) < 1e-3 * 0.04
    buckled = run.load(1.0, 1.0).state
    assert found.snapped and softest(system.organ, found.new) > 0.0
    assert abs(found.new.y[0, 0]) == pytest.approx(abs(buckled.y[0, 0]), rel=TWO_SOLVERS)


def test_a_column_that_a_thread_guys_is_stable() -> None:
    """Independent check: fixed at its foot, a column bears Euler's load; with its tip held aside 8.2 times as much
    (Timoshenko and Gere, Theory of Elastic Stability, 1961, §2.3). A thread across it, fixed at both ends, holds its
    tip: under 1.5 times the load it stands, though its tissue alone would not, and comes back when it is moved."""
    euler = post()[1]
    load = tissue.SurfaceLoad("top", traction=(0.0, 0.0, -1.5 * euler / (0.002 * 0.004)))
    organ, _ = post(loads=[load])
    thread = Thread(Spline(uniform_knots(2.0 * HALF, 16)), suture("4-0 polypropylene"))
    hole = Piercing("hole", slides=False, directed=False)
    system: Any = System(thread, (Fixed(-HALF * X), Fixed(HALF * X)), organ, (hole,))
    path = (gauss_rule(thread.spline, MASS_POINTS).s[..., None] - HALF) * X
    run = begin(system, start(system, np.array([HALF]), path, 1.0)).load(0.5, 1.0).load(1.0, 1.0)
    assert softest(organ, run.state) < 0.0 and not run.taken[-1].unstable and not run.events
    assert np.abs(run.state.y[0, :2]).max() < 1e-3 * 0.04


def test_a_column_without_a_way_off_is_unstable(monkeypatch: pytest.MonkeyPatch) -> None:
    """Consistency check: if the tissue finds no other equilibrium, the step is marked."""
    system, run = column(1.5)
    straight = [*walk(Branch(system, run.state, 1.0, run.state), 1.0)][-1]

    def fails(*_: object) -> State[Any]:
        raise CouplingError("no equilibrium")

    monkeypatch.setattr(equilibrium, "go_away", fails)
    assert snapped(straight, 1.0, 1.0, run.state).unstable
