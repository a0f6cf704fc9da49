"""Loops of thread that hands draw tight and lock: their tension and length against closed forms, the work that it
takes, condensed and assembled, and what a tie cannot be."""

from collections.abc import Sequence
from copy import deepcopy
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np
import pytest

from coupling.errors import CouplingError, FormingError, StepError, TogetherError
from coupling.integrators import BackwardEuler, Scheme
from coupling.paper.assembled import Monolith, equation_of, monolithic_solve
from coupling.rest.equilibrium import settle
from coupling.rest.laying import start
from coupling.run import run
from coupling.run.cutting import Cut, cut_thread
from coupling.run.tying import begin_tie, observe_ties, with_strands
from coupling.step.diagnosis import diagnose, refuse_held_end
from coupling.step.newton import solve
from coupling.step.sliding import ruled
from coupling.step.stepping import dynamic_problem, organ_answer, predict
from coupling.system import Piercing, State, System
from coupling.ties import Tie, gap_left
from studies.output.records import StepRecord, nothing_met
from studies.output.remarks import bounds
from studies.scenario import ScenarioError, parse
from studies.simulation import Simulation, prepare
from tests.bounds import GAP, IDENTITY, RESIDUAL, TWO_SOLVERS
from tests.coupling.multipliers import multiplier_imbalance
from tests.thread.threads import Array
from thread.catalogue import suture
from thread.ends import Fixed, Free
from thread.knots import uniform_knots
from thread.path import rounded_path
from thread.quadrature import gauss_rule
from thread.spline import Spline
from thread.thread import MASS_POINTS, Thread
from tissue.organs.meshed import NO_LIPS, Lips, OrganEnergies

SUTURE = suture("2-0 polypropylene")
CLOSED_FORM = 5e-3  # of a tension or a length: what bends that do not die out between two holes leave of the sum
BORNE = 0.02  # of the force: the bend of a cut loop is worth EI/R² = 0.015 N
FORCE, RADIUS = 1.0, 0.01  # N, m
NOTHING = np.zeros(0)


@dataclass(frozen=True)
class Springs:
    """Sites on springs that give way by `give` [m/N]; the organ's state is y (9p,)."""

    y0: Array
    give: float

    @property
    def C(self) -> Array:
        return np.diag(np.tile(np.repeat([self.give, 0.0], [3, 6]), len(self.y0) // 9))

    def start(self) -> Array:
        return self.y0

    def answer(self, scheme: Scheme, past: Sequence[Array], time: float, share: float = 1.0) -> "Springs":
        return self

    linear, g_free = True, NOTHING

    def gaps_by_forces(self, some: np.ndarray) -> Array:
        return np.zeros((0, 0))

    @property
    def C_cy(self) -> Array:
        return np.zeros((0, len(self.y0)))

    @property
    def y_free(self) -> Array:
        return self.y0

    def accept(self, f_y: Array, p: Array) -> Array:
        return np.asarray(self.y0 + self.C @ f_y)

    def again(self, f_y: Array, p: Array) -> "Springs":
        return self

    def site_variables(self, state: Array) -> Array:
        return state

    def lips(self, state: Array) -> Lips:
        return NO_LIPS

    def energies(self, old: Array, new: Array) -> OrganEnergies:
        stored = [0.5 * float(np.sum((y - self.y0) ** 2)) / self.give for y in (old, new)]
        taken = float((new - self.y0) @ (new - old)) / self.give - (stored[1] - stored[0])
        return OrganEnergies(0.0, stored[1], 0.0, 0.0, taken)


def loop(places: Array, give: float, points: int = 160, **tie: Any) -> tuple[System[Array], State[Array]]:
    """A limp thread around `places` (k, 3), of which the last but one corner before each end is no hole but where it
    crosses itself; its tails go on from there."""
    crossing, *corners, _ = places
    along = (corners[0] - corners[-1]) / np.linalg.norm(corners[0] - corners[-1])
    tail = 0.3 * np.linalg.norm(corners[0] - corners[-1]) * along
    path = rounded_path([crossing - tail, *corners, crossing + tail])
    holes = [corner for corner in corners if abs(np.linalg.norm(corner) - RADIUS) < 1e-9]
    passes = [path.passes(hole) for hole in holes]
    s = np.array([places[np.argmin(distances)] for places, distances in passes])
    thread = Thread(Spline(uniform_knots(path.length, points)), SUTURE, damping=20.0)
    organ: Any = Springs(np.concatenate([[*hole, 0, 0, 1.0, 1.0, 0, 0] for hole in holes]), give)
    given = {"force": FORCE, "begins": 0.0, "locks": 0.06, "ramp": 0.03, "speed": 0.05} | tie
    piercings = tuple(Piercing(f"hole {k}", directed=len(holes) == 2) for k in range(len(holes)))
    system = System(thread, (Free(), Free()), organ, piercings, ties=(Tie("knot", (0, len(holes) - 1), **given),))
    return system, start(system, s, path.position(gauss_rule(thread.spline, MASS_POINTS).s), 1.0)


def ring(corners: int, give: float, **tie: Any) -> tuple[System[Array], State[Array]]:
    """A loop around the corners of a regular polygon, closed in the middle of a side."""
    angle = 2.0 * np.pi * (np.arange(corners) + 0.5) / corners - 0.5 * np.pi
    places = RADIUS * np.stack([np.cos(angle), np.sin(angle), 0.0 * angle], axis=1)
    crossing = 0.5 * (places[0] + places[-1])
    return loop(np.stack([crossing, *places, crossing]), give, **tie)


def test_a_knot_that_has_come_to_a_hole_is_named() -> None:
    """Consistency check: a step that fails with less than a diameter of thread between knot and hole is explained by
    both names, on any knots of the state."""
    now = run.begin(*ring(6, 5e-4))
    strand, hole = int(now.system.strands[0, 0]), int(now.system.ties[0].between[0])
    s = now.state.s.copy()
    s[hole] = s[strand] + 0.5 * now.system.thread.section.diameter
    told = diagnose(now.system, replace(now.state, s=s), StepError(0.0, 1e-3, "no convergence"))
    assert isinstance(told, TogetherError) and "tie 'knot'" in str(told) and "piercing 'hole 0'" in str(told)
    assert "draw less" in str(told)


def test_a_loop_that_is_cut_has_no_length() -> None:
    """Independent check: a loop that was cut is none any more, and one cut in a tail beyond its tie is what it was."""
    now = run.begin(*ring(6, 5e-4)).load(1.0, 0.12)
    (whole,), spline = now.ties, now.system.thread.spline
    for s, length in ((whole.s_first + 0.5 * whole.length, np.nan), (0.5 * whole.s_first, whole.length)):
        system, state, _ = cut_thread(now.system, now.state, s)
        (tie,) = observe_ties(system, state, now.tie_works)
        assert system.thread.spline.pieces == spline.pieces + 1 and tie.state == whole.state
        assert tie.length == pytest.approx(length, rel=IDENTITY, nan_ok=True)


@pytest.mark.parametrize("share", [0.25, 1.0])
def test_a_loop_that_is_cut_at_rest_bears_nothing(share: float) -> None:
    """Independent check: hands that draw a loop let go where it is cut, for it would come out without end, and tell
    where it was; a knot that is locked stays, and bears nothing either."""
    now = run.begin(*ring(6, 5e-4))
    (closed,) = now.load(share, 0.12).ties
    s = closed.s_first + 0.45 * closed.length
    after = replace(now, cuts=(Cut(s, share * 0.12),)).load(share, 0.12)
    (tie,) = after.ties
    assert [event.kind for event in after.events if event.kind in ("cut", "unties")] == ["cut", "unties"][
        : 1 + (share < 0.5)
    ]
    assert tie.state == ("open" if share < 0.5 else "tied") and tie.s_first < s < tie.s_second
    assert closed.force > 0.4 * FORCE and tie.force < BORNE * FORCE
    assert max(abs(hole.tension_after) for hole in after.piercings) < BORNE * FORCE


def test_a_loop_in_anchored_holes_is_cut_while_hands_draw() -> None:
    """Independent check: two holes of a loop slide and two are anchored. When the strand between the anchors is cut,
    the hands let go, and what is left in the holes are bends across the width of the wound, worth EI/R². The thread
    slides far on the way there, so that Newton's method alone does not find the last equilibrium."""
    width, kinds = 4e-3, {"r1": "sliding", "l1": "anchored", "r2": "anchored", "l2": "sliding"}
    corners = zip(kinds, [(1, 1), (-1, 1), (-1, -1), (1, -1)], strict=True)
    holes = {name: [width * x, width * y, 0.0] for name, (x, y) in corners}
    under, over = ([[x, y, z] for x, y, _ in holes.values()] for z in (-3e-3, 2e-3))
    into, out, beyond, back = [4e-3, 4e-3, 1e-3], [4e-3, -4e-3, 1e-3], [-6e-3, 4e-3, 5e-3], [-6e-3, -4e-3, 5e-3]
    path = [[-5e-3, -2e-3, 5e-3], [0.0, 0.0, 4e-3], into, *under[:2], over[1], beyond, back, over[2], *under[2:], out]
    data = {
        "piercing": [
            {"name": name, "at": at, "kind": kinds[name], "direction": [0, 0, 1]} for name, at in holes.items()
        ],
        "tie": [{"name": "k", "between": ["r1", "l2"], "force": 0.2, "until": 0.8, "speed": 0.05}],
        "thread": {"suture": "4-0 nylon", "control_points": 24, "path": [*path, [0.0, 0.0, 4e-3], [-5e-3, 2e-3, 5e-3]]},
        "cut": [{"s": 0.03, "time": 0.299}],
        "solve": {"kind": "static", "duration": 0.3, "load_steps": 1},
    }
    *_, (last, _) = prepare(parse(data)).advance()
    assert [event.kind for event in last.events if event.kind in ("cut", "unties")] == ["cut", "unties"]
    bend = suture("4-0 nylon").EI / width**2
    assert bend < 0.05 * 0.2
    assert max(abs(tension) for hole in last.piercings for tension in (hole.tension_before, hole.tension_after)) < bend


def length_around(corners: int, side: float, tension: float) -> float:
    """The unstrained length of a thread under a tension around the corners of a polygon of such sides [m].

    At a corner it turns by 2θ, from θ on either side to nothing: an elastica whose way is longer than its chord by
    ∫(1 − cos ϑ) ds = 2√(EI/T)(1 − cos θ/2) (Love, Mathematical Theory of Elasticity, 262).
    """
    stretch = float(max(np.roots([0.5, 0.0, -0.5, -tension / SUTURE.EA]).real))
    bend = 2.0 * np.sqrt(SUTURE.EI / tension) * (1.0 - np.cos(0.5 * np.pi / corners))
    return corners * (side + 2.0 * bend) / stretch


@pytest.mark.parametrize(("corners", "give"), [(6, 1e-9), (6, 5e-4), (8, 5e-4)])
def test_a_ring_around_springs(corners: int, give: float) -> None:
    """Independent check: around rigid and yielding points, a polygon for a cylinder, a loop drawn to 1 N bears 1 N in
    every strand and presses each point by what a turn of it asks for; its unstrained length is that of the polygon
    with its bends, and locked it keeps both."""
    now = run.begin(*ring(corners, give))
    for share in (0.125, 0.25, 0.5, 1.0):
        now = now.load(share, 0.12)
    (tie,), turn = now.ties, 2.0 * np.sin(np.pi / corners)
    assert tie.state == "tied" and [event.kind for event in now.events] == []
    assert tie.force == pytest.approx(FORCE, rel=CLOSED_FORM)
    side = turn * (RADIUS - turn * FORCE * give)
    assert tie.length == pytest.approx(length_around(corners, side, FORCE), rel=CLOSED_FORM)
    for hole in now.piercings:
        assert hole.tension_before == pytest.approx(FORCE, rel=CLOSED_FORM)
        assert hole.tension_after == pytest.approx(FORCE, rel=CLOSED_FORM)
        assert np.linalg.norm(hole.force) == pytest.approx(turn * FORCE, rel=CLOSED_FORM)


def test_a_ring_between_two_springs() -> None:
    """Independent check: a stitch through two holes pulls either with twice the tension of its strands, and its length
    is that of the way between them as they have come nearer, there and back, with its bends."""
    over, side, under = np.array([0, 4e-3, 0]), np.array([RADIUS, 0, 0]), np.array([0, -4e-3, 0])
    give = 5e-4
    now = run.begin(*loop(np.stack([over, side, side + under, under - side, -side, over]), give, points=200))
    for share in (0.06, 0.125, 0.25, 0.5, 1.0):
        now = now.load(share, 0.06)
    (tie,), (first, last) = now.ties, now.piercings
    assert tie.state == "tied" and tie.force == pytest.approx(FORCE, rel=CLOSED_FORM)
    assert first.force[0] == pytest.approx(2.0 * FORCE, rel=CLOSED_FORM)
    assert last.force[0] == pytest.approx(-2.0 * FORCE, rel=CLOSED_FORM)
    way = 2.0 * (RADIUS - 2.0 * FORCE * give)
    assert tie.length == pytest.approx(length_around(2, way, FORCE), rel=CLOSED_FORM)


def test_a_tie_slips_above_what_it_holds() -> None:
    """Independent check: a loop drawn to 1 N and locked by a tie that holds 0.4 N loosens until it bears that, and
    what the knot takes is 0.4 N along all that slipped; from there it holds."""
    firm, now = run.begin(*ring(6, 5e-4)), run.begin(*ring(6, 5e-4, hold=0.4))
    for share in (0.125, 0.25, 0.5):
        firm, now = firm.load(share, 0.12), now.load(share, 0.12)
    drawn, before = firm.ties[0], firm.energies
    assert [event.kind for event in now.events] == ["tied", "slips"] and drawn.state == "tied"
    (tie,) = now.ties
    assert tie.state == "slips" and tie.force == pytest.approx(0.4, rel=CLOSED_FORM) and tie.length > drawn.length
    taken = now.energies.friction_dissipation - before.friction_dissipation
    assert taken == pytest.approx(0.4 * (tie.length - drawn.length), rel=CLOSED_FORM)
    assert tie.work == drawn.work and abs(now.energies.balance_error) <= RESIDUAL * now.energies.elastic_thread
    assert now.load(1.0, 0.12).ties[0].length == pytest.approx(tie.length, rel=TWO_SOLVERS)


# -- in an elastic organ ----------------------------------------------------------------------------------------------

TWO: dict[str, Any] = {
    "tissue": {
        "youngs_modulus": 4e5,
        "poisson_ratio": 0.45,
        "density": 1070.0,
        "rayleigh": [5.7, 5.8e-4],
        "clamp": ["bottom"],
        "mesh": {"kind": "block", "size": [0.03, 0.03, 0.012], "h": 5e-3, "accuracy": "given"},
    },
    "thread": {
        "suture": "2-0 polypropylene",
        "control_points": 130,
        "cuts": [0.041],
        "damping": 20.0,
        "path": [
            [-2e-3, -6e-3, 5.2e-3], [0, -6e-3, 5e-3], [5e-3, -6e-3, 0], [5e-3, -6e-3, -4e-3], [-5e-3, -6e-3, -4e-3],
            [-5e-3, -6e-3, 0], [0, -6e-3, 5e-3], [2e-3, -6e-3, 5.2e-3],
            [-2e-3, 6e-3, 5.2e-3], [0, 6e-3, 5e-3], [5e-3, 6e-3, 0], [5e-3, 6e-3, -4e-3], [-5e-3, 6e-3, -4e-3],
            [-5e-3, 6e-3, 0], [0, 6e-3, 5e-3], [2e-3, 6e-3, 5.2e-3],
        ],
    },
    "piercing": [
        {"name": f"{side}{k}", "at": [x, y, 0], "direction": "normal", "footprint": 1.5e-3}
        for k, y in enumerate((-6e-3, 6e-3), start=1)
        for side, x in (("right", 5e-3), ("left", -5e-3))
    ],
    "solve": {"kind": "static", "duration": 1.0, "load_steps": 8},
    "tie": [
        {"name": f"knot{k}", "between": [f"left{k}", f"right{k}"], "force": FORCE, "from": 0.0, "until": 0.5}
        for k in (1, 2)
    ],
}  # fmt: skip


def stitch(**solve: Any) -> dict[str, Any]:
    """The first of the two stitches alone, with friction in its holes."""
    table = deepcopy(TWO)
    table["thread"] |= {"control_points": 70, "cuts": [], "path": table["thread"]["path"][:8]}
    table["piercing"], table["tie"] = table["piercing"][:2], table["tie"][:1]
    table["solve"] |= solve
    return table


def records_of(table: dict[str, Any]) -> tuple[Simulation, list[StepRecord]]:
    """Every step."""
    simulation = prepare(parse(table))
    return simulation, [record for record, _ in simulation.advance()]


def test_a_tied_stitch_pulls_its_holes_with_twice_its_tension() -> None:
    """Independent check: in an elastic block the hole bears both strands, over the wound and below, however far it
    gives way; what comes out of the loop is what the hands drew."""
    _, records = records_of(stitch())
    (tie,), (right, left) = records[-1].ties, records[-1].piercings
    assert tie.state == "tied" and tie.force == pytest.approx(
        FORCE, rel=1e-4
    )  # along strands that are not quite parallel
    assert right.force[0] == pytest.approx(2.0 * FORCE, rel=0.01)
    assert left.force[0] == pytest.approx(-2.0 * FORCE, rel=0.01)
    assert right.displacement[0] < -1e-4 and left.displacement[0] > 1e-4
    assert records[0].energy.numerical_dissipation == 0.0  # the closed tie is part of the start
    energy = records[-1].energy
    assert energy.external_work > 0.0 and abs(energy.balance_error) <= RESIDUAL * energy.external_work
    assert tie.work == pytest.approx(energy.external_work, rel=1e-6)  # nothing else is done from outside


IN_SPITE_OF_ORDER = 1e-2  # of a hole's force, its displacement and the length of a loop: what knots are made for
BY_ORDER = 2e-2  # of the same: what the order in which two neighbours are drawn changes with μ = 0.1


@cache
def two_drawn(first: int, mu: float) -> tuple[StepRecord, ...]:
    """Two stitches at rest, that number `first` drawn by itself and the other while its hands go on; the record before
    the first is drawn, half-way, and the last one."""
    table = deepcopy(TWO)
    table["thread"]["control_points"] = 130
    table["solve"]["load_steps"] = 2
    for k, tie in enumerate(table["tie"]):
        tie |= {"from": 0.0 if k == first else 0.5, "until": 1.0, "ramp": 0.5}
    for hole in table["piercing"]:
        hole["friction"] = {"static": mu, "kinetic": mu} if mu else None
    return tuple(records_of(table)[1])


def differences(one: StepRecord, other: StepRecord) -> Array:
    """What two records differ by: in the forces on holes, in their displacements, in the lengths of loops, each of the
    largest."""
    pairs = [
        [np.array([getattr(hole, name) for hole in record.piercings]) for record in (one, other)]
        for name in ("force", "displacement")
    ]
    pairs.append([np.array([tie.length for tie in record.ties]) for record in (one, other)])
    return np.array([np.abs(a - b).max() / np.abs(a).max() for a, b in pairs])


def test_ties_are_drawn_in_any_order() -> None:
    """Independent check: without friction the state at rest of two loops, which hands draw with given forces, does not
    know which of them was drawn first; each hole bears both of its strands. With friction it hardly does."""
    ways = [two_drawn(first, 0.0) for first in (0, 1)]
    assert [tie.state for tie in ways[0][1].ties] == ["drawn", "drawn"]  # the second is about to be
    assert max(abs(hole.force[0]) for hole in ways[0][1].piercings[2:]) < 0.1 * 2.0 * FORCE  # its bends alone
    assert differences(ways[0][-1], ways[1][-1]).max() <= IN_SPITE_OF_ORDER
    for record in (way[-1] for way in ways):
        assert [tie.state for tie in record.ties] == ["tied", "tied"]
        assert [abs(hole.force[0]) for hole in record.piercings] == pytest.approx([2.0 * FORCE] * 4, rel=0.02)
        assert abs(record.energy.balance_error) <= RESIDUAL * record.energy.external_work
    rough = differences(*(two_drawn(first, 0.1)[-1] for first in (0, 1)))
    assert (rough <= BY_ORDER).all()


def test_a_loop_does_not_run_round_in_its_holes() -> None:
    """Independent check: while hands draw it, and in holes without friction when it is tied too, what one hole gives
    the other takes, so that the knot stays between them; in time and at rest."""
    table = stitch(kind="dynamic", dt=2e-3, duration=0.08)
    table["tie"][0] |= {"until": 0.04, "speed": 0.2}
    table["thread"]["path"][:2] = [[-4e-3, -6e-3, 5.2e-3], [1.5e-3, -6e-3, 5e-3]]  # nearer to one hole
    _, moved = records_of(table)
    for records in (moved, two_drawn(0, 0.0)):
        sums = np.array([[hole.s for hole in record.piercings[:2]] for record in records]).sum(axis=1)
        assert np.ptp(sums) <= IDENTITY * sums[0]
        tie, (right, left) = records[-1].ties[0], records[-1].piercings[:2]
        assert tie.state == "tied" and tie.s_first < right.s < left.s < tie.s_second
    assert moved[-1].ties[0].force > 0.25 * FORCE


def test_a_loop_that_slides_is_at_the_edge_of_sticking() -> None:
    """Independent check: where friction in its first and its last hole, which differ, lets a loop slide, a thousand
    millionth more would hold it, and less would not; stick and slip are judged by one law."""
    table = stitch()
    table["thread"]["path"][:2] = [[-4e-3, -6e-3, 5.2e-3], [1.5e-3, -6e-3, 5e-3]]  # nearer to one hole
    for hole in table["piercing"]:
        hole["friction"] = {"static": 0.1, "kinetic": 0.1}
    simulation = prepare(parse(table))
    solution = settle(simulation.assembly.system, simulation.beginning().state, 0.25, 1.0).solution
    law, z = solution.problem.law, solution.iterate
    pair = law.joints.pairs[law.rough[law.joints.pairs].all(axis=1)][0]
    f = np.abs(ruled(law, z.sigma, solution.residual.passage, z.s, z.lam, z.y).f[pair])
    assert z.sigma[pair].all() and abs(f[1] - f[0]) > 1e-3 * f[0]
    stuck = np.where(np.isin(np.arange(len(z.s)), pair), 0.0, z.sigma)
    for factor, slides in ((1.0 + 1e-9, False), (1.0 - 1e-9, True)):
        known = law._replace(static=factor * law.static, kinetic=factor * law.kinetic), stuck, solution.residual.passage
        assert ruled(*known, z.s, z.lam, z.y).fits[pair].all() == slides


@pytest.mark.parametrize(("mu", "kept"), [(0.3, False), (0.1, True)])
def test_a_knot_that_hands_keep_between_unequal_holes_is_remarked(mu: float, kept: bool) -> None:
    """Independent check: with μ = 0.3 in one hole the hands give half of the difference to each hole, and none if
    both are alike; once the tie is locked, each hole obeys Coulomb's law by itself."""
    table = stitch(load_steps=4)
    table["tie"][0]["until"] = 0.75
    for hole, own in zip(table["piercing"], (0.3, mu), strict=True):
        hole["friction"] = {"static": own, "kinetic": own}
    simulation, records = records_of(table)
    extremes = nothing_met(2, 1)
    for record in records:
        extremes = extremes.after_step(record)
    remarks = simulation.remarks((records[-1], extremes))
    drawn = records[2].piercings
    assert [each.where for each in remarks if each.code == "knot-kept"] == [records[2].ties[0].name] * kept
    force = 0.5 * abs(0.3 * drawn[0].normal_force - mu * drawn[1].normal_force)
    assert [hole.cone_residual for hole in drawn] == pytest.approx([force] * 2, abs=0.1 * bounds.OFF_LAW * FORCE)
    assert records[-1].ties[0].state == "tied"
    assert max(hole.cone_residual for hole in records[-1].piercings) <= RESIDUAL * FORCE


@cache
def moving() -> tuple[Simulation, run.Run]:
    """A stitch that has been drawn for 30 ms in time, with friction in its holes."""
    table = stitch(kind="dynamic", dt=1e-3, duration=0.06)
    for hole in table["piercing"]:
        hole["friction"] = {"static": 0.3, "kinetic": 0.3}
    table["tie"][0] |= {"until": 0.04, "speed": 0.2}
    simulation = prepare(parse(table))
    now = simulation.beginning()
    for _ in range(30):
        now = simulation.next(now)
    return simulation, now


def test_condensed_and_assembled_agree() -> None:
    """Consistency check: both solves of a step in which hands draw a loop, and of one in which it is locked and slips,
    in an organ with inertia."""
    simulation, drawn = moving()
    locked = drawn
    while locked.number < simulation.steps:
        locked = simulation.next(locked)
    slipping = replace(locked.system.ties[0], hold=0.9 * locked.ties[0].force)
    for now, system in ((drawn, drawn.system), (locked, replace(locked.system, ties=(slipping,)))):
        state, scheme = replace(now.state, before=None, dt_before=None), BackwardEuler(1e-3)
        problem = dynamic_problem(system, state, 1e-3, organ_answer(system, scheme, state))
        first = predict(problem, state)
        organ: Any = system.organ
        a, b = solve(problem, first), monolithic_solve(problem, first, organ.field(state.organ))
        z, strands = b.iterate, system.strands[0]
        assert isinstance(z, Monolith) and len(z.U) == equation_of(problem).A.shape[0] + 3
        assert a.iterations > 0 and b.iterations > 0 and bool(problem.law.rough[strands[0]]) == (now is locked)
        assert np.abs(z.s - state.s)[strands].min() > 1e-9
        for name in ("q", "s", "lam", "y"):
            one, other = (getattr(x, name)[..., :3] if name == "y" else getattr(x, name) for x in (a.iterate, z))
            assert np.abs(one - other).max() <= TWO_SOLVERS * np.abs(other).max()


def test_every_step_of_a_loop_drawn_in_time() -> None:
    """Independent check, step by step: the strands meet, each hand draws the same length, their force and moment on
    the thread are none in all, the balance of energy closes, and the loop comes under tension; locked, it keeps its
    length."""
    simulation, now = moving()
    (one, other), lengths = now.system.strands[0], []
    total = now.state.s[[one, other]].sum()
    while now.number < simulation.steps:
        now = simulation.next(now)
        state = now.state
        at = now.configuration.at
        assert np.linalg.norm(at.P[one] - at.P[other]) <= 1e-3 * now.system.thread.section.diameter
        assert now.ties[0].gap <= GAP * now.system.thread.section.diameter
        assert state.s[[one, other]].sum() == pytest.approx(total, rel=IDENTITY)
        force, moment = multiplier_imbalance(now.system, state)
        scale = np.abs(state.lam[:, :3]).max()
        assert np.abs(state.lam[one, :3] + state.lam[other, :3]).max() <= RESIDUAL * scale
        assert force <= RESIDUAL * scale and moment <= RESIDUAL * scale * 0.02
        assert abs(now.energies.balance_error) <= RESIDUAL * now.energies.at_stake
        lengths.append(now.ties[0].length)
    drawn = np.diff(lengths)
    assert (drawn[:8] < 0.0).all() and np.abs(drawn[-18:]).max() == 0.0
    assert now.ties[0].state == "tied" and now.ties[0].force > 0.4 * FORCE
    assert now.energies.friction_dissipation > 0.0
    assert now.ties[0].work == pytest.approx(now.energies.external_work, rel=1e-9)  # nothing else is done from outside


def test_round_off_does_not_keep_a_tie_from_being_locked() -> None:
    """Independent check: four of six load steps to 0.3 s end a little before 0.2 s, where the tie is locked; no hand
    draws it from there on."""
    system, _ = ring(6, 1e-9, locks=0.2)
    end = 4 / 6 * 0.3
    assert end < 0.2 and not system.drawn_ties(end).any() and system.drawn_ties(3 / 6 * 0.3)[system.strands].all()


def test_a_tie_that_runs_over_a_held_end_is_refused_in_words() -> None:
    """Independent check: the knot is named, which is no piercing."""
    system, state = ring(6, 1e-9)
    system = replace(system, ends=(Fixed(state.q[0]), Free()))
    out, tied = with_strands(state.s, system.strands[0], (-1e-4, state.s[-1])), system.of_ties
    new = replace(state, s=out, present=state.present | tied)
    with pytest.raises(StepError, match="runs out at tie 'knot': its start is held"):
        refuse_held_end(system, state, new, tied)


def test_a_cut_piece_may_run_out_past_the_place_of_a_held_end() -> None:
    """Independent check: the thread is cut before its holes. Their piece can leave them in one step that is longer
    than the rest of the thread, whose start is held, and the rest cannot."""
    system, state = ring(6, 1e-9)
    system = replace(system, ends=(Fixed(state.q[0]), Free()))
    holes = np.arange(system.holds) < len(system.piercings)
    other, cut, _ = cut_thread(system, state, 0.5 * state.s[0])
    refuse_held_end(other, cut, replace(cut, s=np.where(holes, -1e-4, cut.s)), holes)
    other, cut, _ = cut_thread(system, state, 0.5 * (state.s[2] + state.s[3]))
    with pytest.raises(StepError, match="its start is held"):
        refuse_held_end(other, cut, replace(cut, s=np.where(holes, -1e-4, cut.s)), holes)


def test_strands_that_parted_are_refused_in_words() -> None:
    """Independent check: it is a tie that cannot begin, and by then a path that crosses itself does not help."""
    system, state = ring(6, 1e-9)
    apart = state.q.copy()
    apart[len(apart) // 2 :, 2] += 0.1
    with pytest.raises(FormingError, match=r"tie 'knot' cannot begin: its strands are .* let the tie begin before"):
        begin_tie(system, replace(state, q=apart), 0)


def test_a_run_with_ties_goes_on_where_it_was() -> None:
    """Consistency check: from the memory of a step in which hands draw, the same numbers, bit by bit."""
    simulation = prepare(parse(stitch(load_steps=4)))
    whole = [record for record, _ in simulation.advance()]
    memory = whole[1].memory
    assert memory is not None
    further = [record for record, _ in simulation.advance(memory)]
    for name in ("work", "force", "length", "state"):
        assert [getattr(record.ties[0], name) for record in further] == [getattr(r.ties[0], name) for r in whole[1:]]


@pytest.mark.parametrize(
    ("tie", "solve", "words"),
    [
        ({"between": ["left1", "rihgt1"]}, {}, r'tie\.knot1\.between.*no piercing "rihgt1", did you mean "right1"'),
        ({"between": ["left1", "left1"]}, {}, r"tie\.knot1\.between.*has two holes"),
        ({"from": 0.6}, {}, r"tie\.knot1\.until = 0\.5 is refused: it must be later than from"),
        ({"ramp": 0.6}, {}, r"tie\.knot1\.ramp = 0\.6 is refused: the loop is locked 0\.5 s after"),
        ({"force": 0.0}, {}, r"tie\.knot1\.force"),
        ({"held": 1}, {}, r"tie\.knot1\.held"),
        (
            {"from": 0.3, "until": 0.37},
            {"kind": "dynamic", "dt": 0.25},
            r"tie\.knot1\.until = 0\.37.*closed and locked in the same step",
        ),
        ({}, {"kind": "dynamic", "scheme": "linear"}, r"solve\.scheme.*a thread cannot be tied with it"),
        ({}, {"kind": "dynamic", "coupling": "staggered"}, r"solve\.coupling.*a thread cannot be tied with it"),
        ({}, {"kind": "dynamic", "epsilon": 1e-4}, r"solve\.epsilon.*a thread cannot be tied with it"),
    ],
)
def test_refusals(tie: dict[str, Any], solve: dict[str, Any], words: str) -> None:
    """Independent check: what cannot be tied is refused by its key before anything is solved."""
    table = stitch(**solve)
    table["tie"][0] |= tie
    with pytest.raises(ScenarioError, match=words):
        parse(table)


def test_held_strands_need_their_holes_from_the_start() -> None:
    """Independent check: a tie may begin with its hole, but hands cannot hold its strands before."""
    table = stitch()
    table["piercing"][0]["from"], table["tie"][0]["from"] = 0.1, 0.2
    parse(table)
    table["tie"][0]["held"] = True
    with pytest.raises(ScenarioError, match=r"tie\.knot1\.from = 0\.2 is refused"):
        parse(table)


def test_strands_that_are_tied_already() -> None:
    """Independent check: two ties do not join the same strands, nor bear the same name."""
    table = deepcopy(TWO)
    table["tie"][1]["between"] = ["right1", "left1"]
    with pytest.raises(ScenarioError, match='tie "knot1" already joins these strands'):
        parse(table)
    table["tie"][1]["name"] = "knot1"
    with pytest.raises(ScenarioError, match=r"tie\.name.*names must be unique"):
        parse(table)


def test_a_tie_of_numbers_that_make_none() -> None:
    """Independent check: refused where it is built."""
    given = {"force": 1.0, "begins": 0.0, "locks": 1.0, "ramp": 0.5, "speed": 0.1}
    for change in ({"locks": 0.0}, {"ramp": 2.0}, {"force": 0.0}, {"speed": 0.0}, {"hold": -1.0}):
        with pytest.raises(CouplingError, match="tie 'knot'"):
            Tie("knot", (0, 1), **(given | change))
    with pytest.raises(CouplingError, match="epsilon"):
        replace(ring(6, 1e-9)[0], epsilon=1e-4)


def test_strands_are_brought_together_as_the_force_grows() -> None:
    """Independent check: what is left of a gap falls linearly, in whatever steps, and to nothing."""
    tie, gap = Tie("knot", (0, 1), 2.0, 1.0, 3.0, 1.0, 0.1), np.array([[3.0, 0.0, 4.0]])
    assert tie.drawing_force(1.5) == 1.0 and tie.drawing_force(5.0) == 2.0 and tie.drawing_force(0.0) == 0.0
    half = gap_left((tie,), gap, 1.0, 1.5)
    assert half == pytest.approx(0.5 * gap) and gap_left((tie,), half, 1.5, 1.75) == pytest.approx(0.25 * gap)
    assert not gap_left((tie,), half, 1.5, 2.0).any() and not gap_left((tie,), 0.0 * gap, 2.0, 2.5).any()
