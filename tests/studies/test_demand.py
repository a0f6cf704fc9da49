"""What loads ask of holes and suture, before the first step: by closed forms, and by the campaign's runs."""

import csv
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from meshes.quality import size_at
from studies.arrays import Array
from studies.campaign.generator import asked, cases
from studies.output.remarks import bounds
from studies.scenario import Scenario, load, parse
from studies.simulation import demand, prepare
from studies.simulation.assembly import abscissae, section_of
from studies.simulation.meshing import mesh_of
from tests.bounds import IDENTITY
from thread.catalogue import knot_pull, suture
from thread.path import rounded_path

RUNS = Path(demand.__file__).parents[1] / "campaign" / "results" / "runs.csv"
LEFT = {"hole-strain", "hole-rotation", "tissue-strain", "tissue-rotation", "thread-strength", "thread-strain"}
LATER = "1101110111111011101010110110111111111000111111010111100000100111101111"  # which of the cases of seed 2 did
ASKED = {  # of which seed, which of the cases did; "-" of those that took longer than 40 s or stopped at once
    21: "1111000-0111111010-011000111001101-0-0101-01001-11-000-10011-00100000-1100101000",
    22: "1-0-10000101-1111101-1-01111110011001-0011110001---010001-000001-1101001101-1001",
}
ORGAN = {
    "youngs_modulus": 1e4,
    "poisson_ratio": 0.45,
    "density": 1e3,
    "clamp": ["bottom"],
    "mesh": {"kind": "block", "generator": "structured", "size": [0.06, 0.04, 0.02], "h": 0.01, "accuracy": "given"},
}


YIELD, TILT = 0.659 * 1.45 * 0.775, 0.75 * (1.0 - 0.45**2)  # of a half-space with ν = 0.45: 0.74 and 0.60
STRAIN, TURN = bounds.EARLY_STRAIN, bounds.EARLY_ROTATION


def said(scenario: Scenario, radii: Array | None = None) -> dict[str, str]:
    """Return what is foreseen of a scenario with one E everywhere, by its code; None: on cells that are fine."""
    path = rounded_path(scenario.thread.path)
    at, length = np.array(abscissae(scenario, path, path.length)), scenario.thread.length or path.length
    strength = knot_pull(scenario.thread.suture) if scenario.thread.suture else None
    E = np.full(len(scenario.piercing), scenario.tissue.youngs_modulus if scenario.tissue else np.inf)
    radii = np.array([hole.footprint or np.inf for hole in scenario.piercing]) if radii is None else radii
    found = demand.demanding(scenario, section_of(scenario.thread), path.tangent(at), at, length, E, radii, strength)
    return {each.code: each.message for each in found}


def pulled(force: float, **hole: Any) -> Scenario:
    """Return an organ of 10 kPa, a suture anchored in its top, and a pull along it [N]."""
    anchor = {"name": "anchor", "at": [0, 0, 0], "kind": "anchored", "footprint": 1e-3} | hole
    thread = {"suture": "4-0 nylon", "path": [[0, 0, 0.002], [0, 0, -0.002]]}
    thread |= {"end": {"kind": "pulled", "force": [force, 0, 0]}}
    return parse({"tissue": ORGAN, "thread": thread, "piercing": [anchor], "solve": {"kind": "static"}})


def test_a_pull_is_told_in_words_by_the_way_of_a_half_space() -> None:
    """Independent check: 0.74 F/(E a), 15 mm of 0.2 N in 10 kPa under a millimetre; at the bound and beyond."""
    assert "move the hole 'anchor' by about 15 mm" in said(pulled(0.2))["demand"]
    bound = STRAIN * 1e4 * 1e-6 / YIELD
    assert "demand" not in said(pulled((1.0 - IDENTITY) * bound))
    assert "demand" in said(pulled((1.0 + 1e-6) * bound))
    assert not said(load("two_piercings"))


def test_coarse_cells_hold_a_hole_as_a_wider_disc() -> None:
    """Independent check: a footprint a on cells of a size h is a disc of √(a² + h²); what is said of it is in words of
    a strain."""
    body = prepare(pulled(0.2)).assembly.body
    assert body is not None
    wide = 1e-6 + size_at(body.mesh, np.zeros(3)) ** 2
    for share, told in ((0.99, False), (1.01, True)):
        foreseen = prepare(pulled(share * STRAIN * 1e4 * wide / YIELD)).foreseen
        assert [each.message for each in foreseen if "a strain of about 0.16, but" in each.message] == [
            each.message for each in foreseen if each.code == "demand"
        ]
        assert ("demand" in [each.code for each in foreseen]) == told


def test_a_tract_turns_the_thread_in_the_place_of_its_holes() -> None:
    """Independent check: a thread that comes from above and leaves upward pulls at each hole by a right angle, √2 T, or
    by nothing where it goes on straight into a tract."""
    T, down, across = np.full(3, 2.0), [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]
    ways, through = np.array([down, across, [0.0, 0.0, 1.0]]), np.array([down, [0.0, 0.0, 1.0]])
    for borne, force in ((False, 2.0 * 2**0.5), (True, 0.0)):
        at = demand.ways_at_holes(ways, through, np.array([borne]))
        assert demand.hole_forces(T, at) == pytest.approx([force, force])


def test_the_force_on_a_hole_is_the_turn_of_a_taut_thread() -> None:
    """Independent check: a right angle is √2 T, a straight way nothing, and no load goes on beyond an anchored hole."""
    assert demand.hole_forces(np.array([2.0, 2.0]), np.eye(3)[:2, None]) == pytest.approx([2.0 * 2**0.5])
    assert demand.hole_forces(np.array([2.0, 2.0]), np.eye(3)[[0, 0], None]) == pytest.approx([0.0])
    assert demand.strand_tensions(pulled(0.2), np.array([0.002]), 0.03, 1.0, np.ones(1)).tolist() == [0.0, 0.2]


def test_a_loop_draws_its_holes_together_by_twice_the_force_of_the_hands() -> None:
    """Independent check: a flat loop pulls at both ends of its two holes by F; by 2 · 0.74 F/(E a²) = 0.16 of a
    footprint a, whether the thread is cut or not, and beyond the strength of the suture by F alone."""
    path = [[-0.01, 0, 0.005], [0.01, 0, 0], [0.01, 0, -0.005], [-0.01, 0, -0.005], [-0.01, 0, 0], [0.01, 0, 0.005]]
    tops = [
        {"name": name, "at": [x, 0, 0], "direction": "free", "footprint": 1e-3}
        for name, x in (("a", 0.01), ("b", -0.01))
    ]
    strength = knot_pull("4-0 nylon")
    assert strength is not None

    def loop(force: float, E: float, until: float = 1.0, **thread: Any) -> dict[str, str]:
        tie = {"name": "knot", "between": ["b", "a"], "force": force, "until": until}
        tables = {"thread": {"suture": "4-0 nylon", "path": path} | thread, "piercing": tops, "tie": [tie]}
        return said(parse({"tissue": ORGAN | {"youngs_modulus": E}} | tables))

    least = 2.0 * YIELD * 0.5 / (STRAIN * 1e-6)
    for thread in ({}, {"cuts": [0.06]}):
        assert "demand" not in loop(0.5, 1.01 * least, **thread)
        assert "the load of 1 N would move the hole" in loop(0.5, 0.99 * least, **thread)["demand"]
        assert "(minimum average)" not in loop(0.99 * strength, 1e9, **thread).get("pull-strength", "")
        assert "(minimum average)" in loop(1.01 * strength, 1e9, **thread)["pull-strength"]
    assert "demand" not in loop(0.5, 0.99 * least, until=0.1)  # two hands of 0.05 m/s need longer for 1 cm of slack


def test_a_hand_that_draws_further_than_the_thread_reaches_pulls_holes() -> None:
    """Independent check: springs in a row, the thread and two turns of a right angle: 4 mm short, and 5 mm by a tract
    that is 1 mm longer."""
    ring = {"footprint": 1e-3, "direction": "free"}
    path = [[-0.01, 0, 0.0], [-0.01, 0, 0.001], [0.01, 0, 0.001], [0.01, 0, 0]]
    hand = {"kind": "driven", "waypoints": [[0.0, *path[-1]], [1.0, 0.01, 0, -0.004]]}
    thread = {"suture": "4-0 nylon", "path": path, "length": 0.022, "start": {"kind": "fixed"}, "end": hand}
    holes = [ring | {"name": name, "at": at} for name, at in zip("ab", path[1:3], strict=True)]
    tables = {"tissue": ORGAN, "thread": thread, "piercing": holes, "solve": {"duration": 1.0}}
    springs = np.full(2, 1e4 * 1e-3 / YIELD)
    EA = suture("4-0 nylon").EA
    laid = np.array([0.001, 0.022])  # between the holes 1 mm longer than straight, which a tract keeps
    for tract, short in (([], 0.004), ([{"between": ["a", "b"]}], 0.005)):
        scenario = parse(tables | {"tract": tract})
        tension = demand.strand_tensions(scenario, laid, 0.022, EA, springs)
        assert tension == pytest.approx(np.full(3, short / (0.022 / EA + 2 * 2 / (1e4 * 1e-3 / YIELD))))


def test_a_pull_beyond_the_strength_of_the_suture_is_foreseen() -> None:
    """Independent check: by the catalogue; and a thread that is stiff for its tissue by 0.6 √(2 EI T)/(E a³) of a
    right angle, in directed holes alone."""
    strength = knot_pull("4-0 nylon")
    assert strength is not None
    for share, told in ((0.999, False), (1.001, True)):
        assert ("(minimum average)" in said(pulled(share * strength)).get("pull-strength", "")) == told
    wide = (TILT * np.sqrt(2.0 * suture("4-0 nylon").EI * 0.02) / (TURN * 1e4)) ** (1 / 3)
    for footprint, told in ((0.99 * wide, True), (1.01 * wide, False)):
        assert ("stiff-thread" in said(pulled(0.02, direction="normal", footprint=footprint))) == told
        assert "stiff-thread" not in said(pulled(0.02, direction="free", footprint=footprint))


@pytest.mark.parametrize("seed", [1, 2])
def test_what_is_foreseen_is_what_runs_say(seed: int) -> None:
    """Independent check: of the campaign's 300 runs, and of 70 of another seed that were made later, 95 % of those that
    left the linear range or passed the strength of their suture were foreseen to, and 80 % of those foreseen to did.
    Springs made the holes of these runs as compliant as in fine cells."""
    with RUNS.open(encoding="utf-8") as file:
        first = [bool(LEFT & set(row["said"].split())) for row in csv.DictReader(file)]
    left = np.array(first if seed == 1 else [bit == "1" for bit in LATER])
    foreseen = np.array([bool(said(parse(case.tables))) for case in cases(seed, left.size)])
    assert np.mean(foreseen[left]) >= 0.95
    assert np.mean(left[foreseen]) >= 0.80


def test_what_is_foreseen_on_cells_as_they_are_is_what_runs_say() -> None:
    """Independent check: likewise of runs with ties, tracts, cuts and wounds, on the cells of their meshes where these
    stay as they are. Runs without a mark did not end in 40 s, or at once."""
    left, foreseen = [], []
    for seed, bits in ASKED.items():
        for case, bit in zip(asked(seed, len(bits)), bits, strict=True):
            if bit != "-":
                scenario = parse(case.tables)
                assert scenario.tissue is not None
                table, radii = scenario.tissue, None
                if table.mesh.accuracy == "given":
                    mesh = mesh_of(table, scenario.piercing)
                    sizes = [size_at(mesh, np.array(hole.place)) for hole in scenario.piercing]
                    radii = demand.radii_at(scenario.piercing, sizes, table.element)
                left.append(bit == "1")
                foreseen.append(bool(said(scenario, radii)))
    both = np.sum(np.logical_and(left, foreseen))
    assert both >= 0.95 * np.sum(left)
    assert both >= 0.80 * np.sum(foreseen)


def test_one_hole_is_turned_by_the_strand_to_a_hand() -> None:
    """Independent check: an arc of the length ℓ to a hand, 2 EI θ/ℓ of a right angle θ, and none to a free end."""
    EI, way, path = suture("2-0 nylon").EI, 0.03, [[0, 0, 0.01], [0, 0, 0], [0, 0, -0.001], [0.03, 0, 0]]
    wide = (TILT * 2.0 * EI * 0.5 * np.pi / way / (TURN * 1e4)) ** (1 / 3)
    for footprint, end, told in ((0.99, "fixed", True), (1.01, "fixed", False), (0.5, "free", False)):
        thread = {"suture": "2-0 nylon", "path": path, "end": {"kind": end}}
        hole = {"name": "only", "at": [0, 0, 0], "direction": [0, 0, -1], "footprint": footprint * wide, "s": 0.01}
        assert ("stiff-thread" in said(parse({"tissue": ORGAN, "thread": thread, "piercing": [hole]}))) == told


@pytest.mark.parametrize("aside", [0.0, 1e-6, 1e-3])
def test_a_thread_that_is_drawn_straight_back_turns_its_hole(aside: float) -> None:
    """Independent check: a taut strand that turns straight back has the largest couple, 2 √(EI T), and one that is
    led a little aside has nearly that."""
    force, strand = 0.02, suture("4-0 nylon")
    wide = (TILT * 2.0 * np.sqrt(strand.EI * force) / (TURN * 1e4)) ** (1 / 3)
    end = {"kind": "pulled", "force": [aside * force, 0, force]}
    for footprint, told in ((0.99, True), (1.01, False)):
        thread = {"suture": "4-0 nylon", "path": [[0, 0, 0.01], [0, 0, 0], [0, 0, -0.01]], "end": end}
        hole = {"name": "only", "at": [0, 0, 0], "direction": [0, 0, -1], "footprint": footprint * wide, "s": 0.01}
        table = {"tissue": ORGAN, "thread": thread | {"start": {"kind": "free"}}, "piercing": [hole]}
        assert ("stiff-thread" in said(parse(table))) == told


def test_a_pull_that_stretches_the_thread_too_far_is_foreseen() -> None:
    """Independent check: a tenth of EA, of a suture whose strength is not known."""
    bound = 0.1 * suture("8-0 nylon").EA
    assert knot_pull("8-0 nylon") is None or knot_pull("8-0 nylon") > bound
    for share, told in ((0.999, False), (1.001, True)):
        scenario = pulled(share * bound)
        thread = scenario.thread.model_copy(update={"suture": "8-0 nylon"})
        found = said(scenario.model_copy(update={"thread": thread}))
        assert ("(strain 10%)" in found.get("pull-strength", "")) == told


def test_strands_through_tissue_without_a_hole_are_foreseen() -> None:
    """Independent check: first, last and middle strands that come out of the side or the top without a hole; not those
    that go round, nor the tail behind an anchored hole."""
    tops = [{"name": name, "at": [x, 0, 0], "direction": "free"} for name, x in (("a", -0.01), ("b", 0.01))]
    above, below = [-0.02, 0, 0.01], [-0.02, 0, -0.01]
    beyond = [0.0, 0, 0.01]

    def found(path: Any, holes: Any) -> list[tuple[str, str]]:
        table = {"tissue": ORGAN, "thread": {"suture": "4-0 nylon", "path": path}, "piercing": holes}
        return [(each.code, each.where) for each in prepare(parse(table)).foreseen if each.code == "no-hole"]

    a, b, end = [-0.01, 0, 0], [0.01, 0, 0], [0.02, 0, 0.01]
    assert found([above, a, b, end], tops) == []
    assert found([below, a, b, end], tops) == [("no-hole", "a")]
    assert found([above, a, b, [0.02, 0, -0.01]], tops) == [("no-hole", "b")]
    assert found([above, a, [-0.005, 0, -0.006], beyond, [0.005, 0, 0.006], b, end], tops) == [("no-hole", "a")]
    anchored = [tops[0] | {"kind": "anchored"}, tops[1]]
    assert found([below, a, b, end], anchored) == []
