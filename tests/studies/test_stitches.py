"""Stitches that surgeons tie, as shipped scenes: what the strands bear, and with what they close a wound."""

import tomllib
from functools import cache
from typing import Any

import numpy as np
import pytest

from studies.scenario import parse
from studies.scenario.stitch import long_form
from studies.scenario.toml import SCENES, parsed
from studies.simulation.recording import contact_records, gap_profile, observed_wounds, step_record
from studies.simulation.wound import wounds_of
from suturefem import load, prepare
from tests.bounds import IDENTITY, RESIDUAL, TWO_SOLVERS
from tests.meshes.samples import NEEDS_GMSH
from tests.thread.threads import Array

COARSE = [
    "tissue.mesh.h=6e-3",
    "tissue.mesh.accuracy=given",
    "tissue.mesh.h_site=2e-3",
    "thread.control_points=80",
    "solve.load_steps=4",
]
ACROSS = 0.02  # of a closing force: strands bend at their holes, and are not quite the chords between these


def pull_across(holes: Any) -> float:
    """What the strands of a loop that crosses the plane x = 0 pull across it along the ways between its holes [N]."""
    pull = 0.0
    for before, after in zip([holes[-1], *holes[:-1]], holes, strict=True):  # the first strand is the knot's
        way = after.x - before.x
        if before.x[0] * after.x[0] < 0.0:
            pull += before.tension_after * abs(way[0]) / float(np.linalg.norm(way))
    return pull


def test_a_pulley_closes_with_the_strands_that_cross() -> None:
    """Independent check: the pull on the holes of one side is the sum of the tensions of the strands that cross the
    wound, along the way between their holes; friction leaves less in each strand further from the knot, alike on both
    ways from it, and no more than a capstan turned by π from strand to strand leaves."""
    scenario = load("pulley", [*COARSE, "tract=[]"])
    record = [record for record, _ in prepare(scenario).advance()][-1]
    (knot,), holes = record.ties, record.piercings
    assert knot.state == "tied" and knot.force == pytest.approx(scenario.tie[0].force, rel=0.01)
    strands = np.array([holes[-1].tension_after, *(hole.tension_after for hole in holes)])  # the first is the knot's
    closing = sum(hole.force[0] for hole in holes if hole.x[0] > 0.0)
    assert closing == pytest.approx(pull_across(holes), rel=ACROSS)
    assert closing == pytest.approx(-sum(hole.force[0] for hole in holes if hole.x[0] < 0.0), rel=1e-3)
    (lips,) = record.contact  # of a wound whose lips do not press on one another
    assert lips.closure_force == pytest.approx(closing, rel=1e-3) and (lips.pressed, lips.force) == (0, 0.0)
    assert [(stitch.stitch, stitch.load_share) for stitch in lips.stitches] == [("knot", pytest.approx(1.0))]
    assert max(gap.largest_gap or 0.0 for gap in record.profile()) == lips.largest_gap
    assert strands[0] > strands[1] > strands[2] and strands[1] == pytest.approx(strands[3], rel=1e-3)
    assert (strands[1:3] / strands[:2] >= np.exp(-0.1 * np.pi)).all()


def test_a_stitch_that_begins_later_is_held_until_then_in_time() -> None:
    """Consistency check: the same stitch at rest; its strands spring apart if nobody holds them."""
    stitch = {"name": "s", "at": [0, 0, 0], "bite": 4e-3, "depth": 3e-3, "force": 0.15, "from": 0.02, "until": 0.12}
    mesh = {"kind": "wound", "size": [0.04, 0.036, 0.012], "length": 0.02, "depth": 0.006, "h": 5e-3, "accuracy": 0.5}
    organ = {"youngs_modulus": 1e6, "poisson_ratio": 0.45, "density": 1070.0, "clamp": ["bottom"], "element": "P1"}
    table = {"tissue": organ | {"inertia": False, "contact": True, "mesh": mesh}, "stitch": [stitch]}
    table |= {"thread": {"suture": "4-0 polypropylene", "damping": 50.0}}
    force = []
    for solve in ({"kind": "static", "load_steps": 4, "duration": 0.13}, {"dt": 2e-3, "duration": 0.13}):
        *_, (last, _) = prepare(parse(table | {"solve": solve})).advance()
        assert last.ties[0].state == "tied"
        force.append(last.ties[0].force)
    assert force[0] == pytest.approx(0.15, rel=0.01) and force[1] == pytest.approx(force[0], rel=0.05)


@pytest.mark.parametrize("suture", ["2-0 polypropylene", "4-0 nylon"])
def test_a_tied_loop_does_not_depend_on_the_load_steps(suture: str) -> None:
    """Independent check: hands with a growing force let no thread out, so that a stiff loop keeps its laid length until
    they draw it, and in the end they bear the force. Consistency check: 1, 4 and 40 load steps tie the same loop."""
    friction = {"static": 0.1, "kinetic": 0.1}
    stitch = {"name": "a", "at": [0, 0, 0], "bite": 5e-3, "depth": 4e-3, "force": 0.5, "until": 0.75} | {
        "friction": friction
    }
    found = []
    for steps in (1, 4, 40):
        table = {"thread": {"suture": suture}, "stitch": [stitch], "solve": {"kind": "static", "load_steps": steps}}
        records = [record for record, _ in prepare(parse(table)).advance()]
        lengths = [record.ties[0].length for record in records]
        assert max(np.diff(lengths)) <= 1e-9 * lengths[0] and records[-1].ties[0].state == "tied"
        assert records[-1].ties[0].force == pytest.approx(stitch["force"], rel=0.01)
        found.append([lengths[-1], *(hole.tension_before for hole in records[-1].piercings)])
    assert found[:2] == [pytest.approx(found[2], rel=1e-3)] * 2


ALIKE = 0.02  # of a stitch's force: the mesh is not the same at all six
SPACED = 0.02  # of the closing, by half the spacing of a tract's balls
SHALLOW, DEEP = 4e-3, 15.5e-3  # m: within the fat, and behind it in the fascia


def stitched_wall(depth: float, spacing: float) -> tuple[float, float, float]:
    """By how much one stitch of 1 N that goes `depth` [m] into the abdominal wall draws its skin and the bottom of its
    fascia together in the middle [m], and what it turns out the edges by [rad]; balls of its tract `spacing` [m]
    apart."""
    x, end, grips = 0.01, 2e-3, {"direction": "normal", "footprint": 1.5e-3}
    path = [[-end, -end, 4.6e-3], [0, 0, 4e-3], [x, 0, 1e-3], [x, 0, -depth]]
    tables = tomllib.loads((SCENES / "abdominal_wall.toml").read_text(encoding="utf-8"))
    del tables["thread"]["cuts"]
    tables["thread"] |= {"control_points": 140, "path": [*path, *([-a, -b, c] for a, b, c in reversed(path))]}
    tables["tissue"]["mesh"] |= {"size": [0.06, 0.04, 0.02], "length": 0.024}
    tables["piercing"] = [{"name": n, "at": [at, 0, 0], **grips} for n, at in (("right", x), ("left", -x))]
    tables["tract"] = [{"between": ["right", "left"], "spacing": spacing}]
    tables["tie"] = [{"name": "knot", "between": ["right", "left"], "force": 1.0, "from": 0.0, "until": 1.0}]
    simulation = prepare(parse(tables | {"solve": {"kind": "static", "load_steps": 2}}))
    runs = [simulation.beginning()]
    while runs[-1].number < simulation.steps:
        runs.append(simulation.next(runs[-1]))
    (((wound, before, _),), ((_, after, points),)) = (
        tuple(observed_wounds(n, simulation.open_lips)) for n in runs[::2]
    )
    at = wound.gaps.body.points[wound.gaps.left]
    closed, middle = before.gap - after.gap, np.abs(at[:, 1]) < 2.5e-3
    skin, fascia = (closed[middle & (np.abs(at[:, 2] - z) < 1e-3)].mean() for z in (0.0, -0.02))
    return float(skin), float(fascia), wound.eversion(points)


@NEEDS_GMSH
def test_a_deeper_bite_closes_the_fascia_and_turns_the_edges_out() -> None:
    """Independent check: a stitch within the fat closes the skin alone, turns its edges in and opens the wall's other
    side, as a couple on a plate does; one that takes the fascia closes this, the skin by less, and turns the edges out.
    With half the spacing of the balls that bear the thread each is closed by the same, to 2 % of what the skin is."""
    shallow, deep, finer = (stitched_wall(*case) for case in ((SHALLOW, 1.5e-3), (DEEP, 1.5e-3), (DEEP, 0.75e-3)))
    assert shallow[1] < 0.0 < deep[1] and shallow[2] < 0.0 < deep[2] and deep[0] < 0.8 * shallow[0]
    assert finer[:2] == pytest.approx(deep[:2], abs=SPACED * deep[0])


RADIAL = 0.02  # of areas, forces and the widening of a tube: cells of a third of the radius and less
SIX = ("first", "second", "third", "fourth", "fifth", "sixth")
FEW = [
    *(
        *(f"stitch.{name}.tract=false" for name in SIX),
        "tissue.mesh.h=3e-3",
        "tissue.mesh.h_site=2e-3",
        "tissue.mesh.accuracy=given",
        "solve.load_steps=4",
    ),
]


@cache
def sewn(*given: str) -> Any:
    """The anastomosis, coarsely and without tracts, after its last step."""
    simulation = prepare(load("anastomosis", [*FEW, *given]))
    now = simulation.beginning()
    while now.number < simulation.steps:
        now = simulation.next(now)
    assert [tie.state for tie in now.ties] == ["tied"] * 6
    return now


def joined(*given: str) -> tuple[Any, Any]:
    """The organ of the anastomosis, and its last state."""
    return sewn(*given).system.organ, sewn(*given).state.organ


def forces_on_stumps(organ: Any, state: Any) -> dict[str, Array]:
    """What the threads in its holes, the other stump, the pressure, and its holder do to the left and to the right
    stump, by name, shape `(2, 3)` each [N]."""
    body = organ.elasticity
    sides = [np.sign(points[:, 0])[:, None] == [-1.0, 1.0] for points in (body.points, organ.y0.reshape(-1, 9))]
    contact = body.nodal(organ.whole(organ.pairing(state.facing).G.T @ state.p))
    pressure = body.nodal(organ.surface.columns @ state.shares)
    inner = body.nodal(body.K @ organ.displacement(state))
    held = np.isin(body.nodes, body.clamped) * (inner - pressure)
    nodal = {"contact": contact, "pressure": pressure, "holder": held}
    return {"threads": sides[1].T @ state.f_y.reshape(-1, 9)[:, :3]} | {
        name: sides[0].T @ force for name, force in nodal.items()
    }


@NEEDS_GMSH
def test_the_forces_on_a_stump_balance() -> None:
    """Independent check: threads, the other stump, pressure and holder have no resultant on either stump, which the
    stitches draw to the other one, against what this and the holder bear."""
    forces = forces_on_stumps(*joined())
    scale = np.abs(forces["threads"]).max()
    assert np.abs(sum(forces.values())).max() <= TWO_SOLVERS * scale
    threads, contact, holder = (forces[name][0, 0] for name in ("threads", "contact", "holder"))
    assert threads > 1.0 and contact < 0.0 and holder < 0.0


@NEEDS_GMSH
def test_what_closes_an_anastomosis() -> None:
    """Independent check: what closes the line is what the threads do to a stump along it; six stitches alike all round
    bear a sixth each, and draw both sides with the same force. What is closed and what is open is all of the line, and
    the way round it is 2πb less what a polygon cuts off."""
    (found,), rim = contact_records(sewn()), gap_profile(sewn())
    mesh: Any = load("anastomosis").tissue.mesh  # type: ignore[union-attr]
    along = forces_on_stumps(*joined())["threads"][:, 0]
    assert found.closure_force == pytest.approx(0.5 * (along[0] - along[1]), rel=RESIDUAL)
    assert [stitch.stitch for stitch in found.stitches] == list(SIX)
    assert sum(stitch.load_share for stitch in found.stitches) == pytest.approx(1.0, rel=IDENTITY)
    for stitch in found.stitches:
        assert stitch.load_share == pytest.approx(1.0 / 6.0, rel=ALIKE)
        assert stitch.left_force == pytest.approx(stitch.right_force, rel=ALIKE)
    area = found.open_area / (1.0 - found.approximation)
    assert area == pytest.approx(np.pi * (mesh.radius**2 - (mesh.radius - mesh.wall) ** 2), rel=RADIAL)
    ways, gaps = np.array([gap.way for gap in rim]), [gap.largest_gap for gap in rim]
    assert (np.diff(ways) > 0.0).all() and max(gaps) == found.largest_gap
    assert ways[-1] + ways[1] == pytest.approx(2.0 * np.pi * mesh.radius, rel=0.01)
    assert all(abs(np.hypot(*gap.x[1:]) - mesh.radius) < 0.1 * mesh.wall for gap in rim)


@NEEDS_GMSH
def test_a_wound_through_a_wall_is_judged_where_its_stitches_begin() -> None:
    """Independent check: stitches that go in above and below have as many openings on either side of the wall; both
    sides of the wound are judged along the same rim, that of the first hole, at z = 0."""
    simulation = prepare(load("abdominal_wall", [*COARSE, "tract=[]"]))
    now, lips = simulation.beginning(), simulation.open_lips
    assert lips is not None
    ((wound,),), openings = wounds_of(now.system, [lips], now.piercings), [hole.x[2] for hole in now.piercings]
    assert sum(z > -1e-3 for z in openings) == sum(z < -1e-3 for z in openings) and openings[0] > -1e-3
    for rim in wound.rims:
        assert np.allclose(rim.middles[:, 2], 0.0, atol=IDENTITY) and np.allclose(rim.normal, [0, 0, 1])


def radius_of(mesh: Any, surface: str, length: float) -> float:
    """The radius of a cylinder of a length [m] with the volume within a surface of the mesh around x [m]."""
    corners = mesh.p[:, mesh.facets[:, mesh.boundaries[surface]]]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0], axis=0) / 2.0
    volume = np.abs(np.sum(corners.mean(axis=1)[1:] * normals[1:], axis=0)).sum() / 2.0
    return float(np.sqrt(volume / (np.pi * length)))


@NEEDS_GMSH
def test_a_stump_widens_as_a_thick_tube() -> None:
    """Independent check: the middle of a stump widens as Lamé's tube does under the pressure p, 2pa²b/(E(b² − a²)) at
    the outer radius, less ν σ b/E by the axial stress σ with which the stitches draw it. Quadratic cells; the radii are
    those of the facets; cut and clamp are 15 mm away, three decay lengths of a shell."""
    long = "tissue.element=P2", "tissue.mesh.h=2e-3", "tissue.mesh.length=0.1", "solve.load_steps=2"
    organ, state = joined(*long)
    tissue = load("anastomosis", [*FEW, *long]).tissue
    shape: Any = tissue.mesh
    body, E = organ.elasticity, tissue.youngs_modulus
    a, b = (radius_of(body.mesh, surface, shape.length - shape.gap) for surface in ("inner", "outer"))
    stress = -forces_on_stumps(organ, state)["holder"][0, 0] / (np.pi * (b**2 - a**2))
    expected = 2.0 * tissue.load[0].pressure * a**2 * b / (E * (b**2 - a**2)) - tissue.poisson_ratio * stress * b / E
    points, U = body.points, body.nodal(organ.displacement(state))
    away, across = np.abs(points[:, 0]) / shape.length, np.hypot(points[:, 1], points[:, 2])
    middle = (across > shape.radius - 1e-6) & (away > 0.15) & (away < 0.35)
    widened = float(np.mean(np.sum(U[middle, 1:] * points[middle, 1:], axis=1) / shape.radius))
    assert widened == pytest.approx(expected, rel=RADIAL)


@NEEDS_GMSH
def test_stitches_bear_the_thrust_of_a_closed_end() -> None:
    """Independent check: a stump that nothing else holds, and whose end is closed, hangs on the stitches as on bolts
    that are tightened before: where the stumps press on one another the threads bear the thrust pπa² and what presses,
    which is what they were tied with; beyond, the line is open all round and they bear the thrust alone, with the two
    strands of each between them."""
    mesh: Any = load("anastomosis").tissue.mesh
    b, a, p = mesh.radius, mesh.radius - mesh.wall, 4e4
    closed = f'{{boundary="inner",pressure={p}}},{{boundary="right",traction=[{p * a**2 / (b**2 - a**2)},0,0]}}'
    smooth = [f"stitch.{name}.friction={{static=0,kinetic=0}}" for name in SIX]
    given = [*FEW, *smooth, "solve.load_steps=2", 'tissue.clamp=["left"]', f"tissue.load=[{closed}]"]
    simulation = prepare(load("anastomosis", given))
    organ, runs = simulation.assembly.system.organ, [simulation.beginning()]
    while runs[-1].number < simulation.steps:
        runs.append(simulation.next(runs[-1]))
    each = [forces_on_stumps(organ, run.state.organ) for run in runs[1:]]
    for forces, share in zip(each, (0.5, 1.0), strict=True):
        scale = np.abs(forces["threads"]).max()
        assert np.abs(sum(forces.values())).max() <= TWO_SOLVERS * scale and not forces["holder"][1].any()
        assert forces["pressure"][1, 0] == pytest.approx(share * p * np.pi * a**2, rel=RADIAL)
    tied, parted = (step_record(run) for run in runs[1:])
    assert tied.contact[0].pressed and each[0]["contact"][1, 0] > 0.1 * each[0]["pressure"][1, 0]
    assert parted.contact[0].pressed == 0 and not each[1]["contact"].any()
    assert parted.contact[0].open_area == pytest.approx(np.pi * (b**2 - a**2), rel=2.0 * RADIAL)
    strands = 0.5 * sum(hole.tension_before + hole.tension_after for hole in parted.piercings)
    assert strands == pytest.approx(each[1]["pressure"][1, 0], rel=ACROSS)


def around_a_tube(radius: float, wall: float, holes: int) -> dict[str, Any]:
    """The tables of a scenario in which a loop of thread through holes all around a tube is drawn and tied."""

    def at(x: float, r: float, angle: float) -> list[float]:
        return [x, -r * float(np.sin(angle)), r * float(np.cos(angle))]

    ring = [at(0.0, radius, (k + 0.5) * 2.0 * np.pi / holes) for k in range(holes)]
    tails = [at(-2e-3, radius + 5e-3, -0.45), at(0.0, radius + 3e-3, 0.0)], [at(0.0, radius + 3e-3, 0.0)]
    path = [*tails[0], *ring, *tails[1], at(2e-3, radius + 5e-3, 0.45)]
    free = {"at": "surface", "direction": "free", "footprint": 0.8e-3}
    mesh = {"kind": "tube", "radius": radius, "wall": wall, "length": 0.024, "h": 1.4e-3, "accuracy": "given"}
    return {
        "tissue": {
            **{"youngs_modulus": 1.5e6, "poisson_ratio": 0.3, "density": 1070.0, "element": "P2"},
            **{"clamp": ["left", "right"], "mesh": mesh},
        },
        "thread": {"suture": "4-0 polypropylene", "control_points": 200, "path": path},
        "solve": {"kind": "static", "load_steps": 1},
        "piercing": [{"name": f"hole{k}", "near": place, **free} for k, place in enumerate(ring)],
        "tie": [{"name": "knot", "between": ["hole0", f"hole{holes - 1}"], "force": 0.05, "until": 0.9, "ramp": 0.9}],
    }


@NEEDS_GMSH
def test_a_suture_around_a_tube_narrows_it_as_a_ring_load_does_a_shell() -> None:
    """Independent check: a loop of tension T through n holes presses inwards by 2 n T sin(π/n), and what the tube
    narrows by in the mean around it is that of a long thin shell under a ring load P per length (Timoshenko and
    Woinowsky-Krieger, Theory of Plates and Shells, 1959, §115), P a² β/(2 E t) e^(−βx) (cos βx + sin βx) with
    β⁴ = 3 (1 − ν²)/(a t)², but for what a wall t over a radius a leaves out, half of that ratio."""
    b, t, n = 0.0105, 1e-3, 12
    simulation = prepare(parsed(around_a_tube(b, t, n)))
    run = simulation.next(simulation.beginning())
    organ, tissue = simulation.assembly.system.organ, simulation.scenario.tissue
    assert tissue is not None
    T = np.mean([hole.tension_after for hole in step_record(run).piercings])
    sites = organ.y0.reshape(-1, 9)[:, 1:3]
    inwards = -np.sum(run.state.organ.f_y.reshape(-1, 9)[:, 1:3] * sites) / b
    assert inwards == pytest.approx(2.0 * n * T * np.sin(np.pi / n), rel=ACROSS)
    a, E, nu = b - 0.5 * t, tissue.youngs_modulus, tissue.poisson_ratio
    beta = (3.0 * (1.0 - nu**2)) ** 0.25 / np.sqrt(a * t)
    under = inwards / (2.0 * np.pi * a) * a**2 * beta / (2.0 * E * t)
    points, U = organ.elasticity.points, organ.elasticity.nodal(organ.displacement(run.state.organ))
    narrowed = -np.sum(U[:, 1:] * points[:, 1:], axis=1) / np.hypot(points[:, 1], points[:, 2])
    for x in np.arange(1.0, 8.0) * 1e-3:
        near = np.abs(np.abs(points[:, 0]) - x) < 0.4e-3
        shell = under * np.exp(-beta * x) * (np.cos(beta * x) + np.sin(beta * x))
        assert narrowed[near].mean() == pytest.approx(shell, abs=0.5 * t / a * under)


def through_the_wall(bites: int) -> list[str]:
    """The holes of a running suture of so many bites, in its order."""
    return [
        f"{side}{(k + (side == 'left')) % bites + 1}_{end}"
        for k in range(bites)
        for side, ends in (("right", ("out", "in")), ("left", ("in", "out")))
        for end in ends
    ]


@NEEDS_GMSH
def test_a_running_suture_draws_two_stumps_together_through_their_walls() -> None:
    """Independent check: one thread that goes round through both walls without friction has one tension, with which
    its strands, over the line and in the lumen, draw either stump to the other; threads, the other stump, pressure and
    holder have no resultant on either; its holes open outwards and into the lumen by turns."""
    holes = through_the_wall(6)
    few = [
        "thread.suture='5-0 polypropylene'",
        "tissue.mesh.h=3e-3",
        "tissue.mesh.h_site=2e-3",
        "tissue.mesh.accuracy=given",
    ]
    few += ["solve.load_steps=3"]
    simulation = prepare(load("running_anastomosis", few))
    organ, run = simulation.assembly.system.organ, simulation.beginning()
    while run.number < simulation.steps:
        run = simulation.next(run)
    record = step_record(run)
    assert [hole.name for hole in record.piercings] == holes and [tie.state for tie in run.ties] == ["tied"]
    radial = organ.sites.points * [0.0, 1.0, 1.0]
    outward = np.sum(organ.sites.normals * radial, axis=1) / np.linalg.norm(radial, axis=1)
    assert outward == pytest.approx([1.0 if hole.endswith("out") else -1.0 for hole in holes], rel=ACROSS)
    forces = forces_on_stumps(organ, run.state.organ)
    threads = forces["threads"]
    assert np.abs(sum(forces.values())).max() <= TWO_SOLVERS * np.abs(threads).max()
    tensions = [T for hole in record.piercings for T in (hole.tension_before, hole.tension_after)]
    assert max(tensions) == pytest.approx(min(tensions), rel=ACROSS)
    assert threads[0, 0] == pytest.approx(pull_across(record.piercings), rel=ACROSS)
    (wound,) = record.contact
    assert [stitch.stitch for stitch in wound.stitches] == holes  # a running suture is told hole by hole
    assert wound.closure_force == pytest.approx(threads[0, 0], rel=RESIDUAL)
    assert sum(stitch.load_share for stitch in wound.stitches) == pytest.approx(1.0, rel=IDENTITY)


@NEEDS_GMSH
def test_stitches_close_a_laceration_from_a_surface_file() -> None:
    """Independent check: the faces of the wound come together and press on one another, none goes through the other,
    and each stitch draws its two sides towards one another with the same force."""
    few = ["tissue.mesh.h=8e-3", "tissue.mesh.accuracy=given", "tissue.mesh.h_site=2.5e-3"]
    few += [
        f"stitch.{name}.{key}"
        for name in ("first", "second", "third")
        for key in ("tract=false", "friction={static=0,kinetic=0}")
    ]
    records = [record for record, _ in prepare(load("laceration", few)).advance()]
    open_, closed = (record.contact[0] for record in (records[0], records[-1]))
    width = open_.largest_gap
    assert open_.pressed == 0 and open_.smallest_gap > 0.05 * width
    assert closed.pressed > 0 and closed.largest_gap < 0.7 * width and closed.smallest_gap >= -IDENTITY * width
    assert [tie.state for tie in records[-1].ties] == ["tied"] * 3
    holes = records[-1].piercings
    for left, right in zip(holes[::2], holes[1::2], strict=True):
        assert right.force[0] > 0.2 and right.force[0] == pytest.approx(-left.force[0], rel=0.1)


@pytest.mark.parametrize(
    ("suture", "sides", "depth", "force"), [("4-0 polypropylene", 5e-3, 3.5e-3, 0.15), ("2-0 nylon", 8e-3, 6e-3, 0.5)]
)
def test_the_tract_of_a_stitch_rubs_like_a_capstan(suture: str, sides: float, depth: float, force: float) -> None:
    """Independent check: the tract turns the thread by half a turn, so that the tensions at its ends are as e^(μπ)."""
    mu = 0.1
    tissue = {"youngs_modulus": 1e6, "poisson_ratio": 0.45, "density": 1070.0, "inertia": False, "clamp": ["bottom"]}
    mesh = {"kind": "block", "size": [0.02, 0.03, 0.012], "h": 3e-3, "accuracy": 0.2}
    stitch = {"name": "one", "at": [0, 0, 0], "bite": sides, "depth": depth, "force": force, "tract": 1e-3}
    stitch |= {"friction": {"static": mu, "kinetic": mu}}
    scenario = long_form({"tissue": tissue | {"mesh": mesh}, "thread": {"suture": suture}, "stitch": [stitch]})
    inside = [point for point in scenario["thread"]["path"] if abs(point[1]) <= sides * (1 + 1e-9) and point[2] <= 0.0]
    down, up = [[*inside[k][:2], 0.012] for k in (0, -1)]
    drawn = {"kind": "driven", "waypoints": [[0, *up], [0.06, *up], [0.16, *up[:2], 0.014]]}
    scenario["thread"] |= {
        "path": [down, *inside, up],
        "damping": 100.0,
        "start": {"kind": "pulled", "force": [0, 0, force], "ramp": 0.05},
        "end": drawn,
    }
    scenario["tract"][0]["friction"] = {"static": mu, "kinetic": mu}
    holes = [{"name": hole["name"], "at": hole["at"], "direction": "free"} for hole in scenario["piercing"]]
    scenario |= {"piercing": holes, "tie": [], "solve": {"dt": 1e-3, "duration": 0.16}}
    *_, (last, _) = prepare(parse(scenario)).advance()
    first, second = (hole for hole in last.piercings if not hole.tract)
    assert second.tension_before / first.tension_after == pytest.approx(np.exp(mu * np.pi), rel=0.06)


SLIT = """
[thread]
suture = "2-0 silk"
[tissue]
youngs_modulus = 12e3
poisson_ratio = 0.45
density = 1060.0
clamp = ["bottom"]
inertia = false
contact = true
mesh = {kind = "wound", shape = "slit", size = [0.04, 0.03, 0.012], depth = 0.008, length = 0.016, h = 3e-3}
[[stitch]]
name = "one"
at = [0, 0, 0]
bite = 4.3e-3
depth = 5e-3
force = 0.25
until = 0.75
tract = false
footprint = 1.5e-3
"""


def test_pressed_lips_that_slide_come_to_rest() -> None:
    """Independent check: the lips of a slit in soft tissue turn as the stitch presses and slides them. Pairs at the
    place of the last equilibrium alternate there by millimetres; the equilibrium does not depend on the load steps,
    and its images on both sides agree."""
    found = []
    for steps in (4, 16):
        table = tomllib.loads(SLIT) | {"solve": {"kind": "static", "load_steps": steps}}
        table["tissue"]["mesh"]["accuracy"] = "given"
        *_, (last, _) = prepare(parse(table)).advance()
        left, right = last.piercings
        assert left.force[0] == pytest.approx(-right.force[0], rel=1e-3)
        found.append([left.force[0], left.x[0], last.ties[0].length, last.contact[0].force])
    assert found[0] == pytest.approx(found[1], rel=5e-3)
