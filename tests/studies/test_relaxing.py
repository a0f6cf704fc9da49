"""Scenarios whose tissue relaxes: a stitch that loosens, layers of their own, what is refused."""

from itertools import islice
from typing import Any

import numpy as np
import pytest
import scipy.linalg

import tissue
from studies.scenario import ScenarioError, parse
from studies.simulation import prepare

G, TAU, STRETCH, RAMP = 0.5, 1.0, 2e-4, 0.05
LENGTH = 0.05


def held(**tables: dict[str, Any]) -> dict[str, Any]:
    """A thread that is anchored in a block and drawn by STRETCH within RAMP, at rest at every load step."""
    organ = {
        "youngs_modulus": 2e4,
        "poisson_ratio": 0.45,
        "density": 1000.0,
        "clamp": ["bottom"],
        "relaxation": [[G, TAU]],
        "mesh": {"kind": "block", "size": [0.03, 0.03, 0.015], "h": 5e-3, "accuracy": "given"},
    }
    waypoints = [[0.0, 0.0, 0.0, LENGTH], [RAMP, 0.0, 0.0, LENGTH + STRETCH], [9.0, 0.0, 0.0, LENGTH + STRETCH]]
    thread = {
        "suture": "4-0 nylon",
        "path": [[0.0, 0.0, 0.0], [0.0, 0.0, LENGTH]],
        "start": {"kind": "free"},
        "end": {"kind": "driven", "waypoints": waypoints},
    }
    hole = {"name": "hole", "at": [0.0, 0.0, 0.0], "kind": "anchored", "direction": "free", "footprint": 3e-3}
    solve = {"kind": "static", "duration": 4.0, "load_steps": 80}
    return {
        "tissue": organ | tables.get("tissue", {}),
        "thread": thread | tables.get("thread", {}),
        "piercing": [hole],
        "solve": solve | tables.get("solve", {}),
    }


@pytest.mark.parametrize("material", ["linear", "neo-hookean"])
def test_a_stitch_loosens(material: str) -> None:
    """Independent check: thread and tissue are springs of which those of the tissue's distortion relax. With K_d v =
    m K v, K with the thread in it, the way of each mode is that of two springs and a dashpot of which m G relaxes."""
    simulation = prepare(parse(held(tissue={"material": material})))
    seen = [(step.time, abs(step.piercings[0].force[2])) for step, _ in simulation.advance()]
    t, force = np.array(seen[1:]).T
    body, system = simulation.assembly.body, simulation.assembly.system
    assert body is not None
    sites = tissue.build_sites(body, [tissue.Site((0.0, 0.0, 0.0), 3e-3, direction=None)])
    organ = tissue.RelaxingOrgan(body, sites, relaxation=tissue.Prony([G], [TAU]))
    y, k = organ.Y[2].toarray()[0], system.thread.EA / LENGTH
    m, v = scipy.linalg.eigh(organ.branches[0].toarray() / G, organ.K.toarray() + k * np.outer(y, y))
    slow = (1.0 - G * m) / TAU
    mean = np.exp(-np.outer(t, slow)) * np.expm1(RAMP * slow) / (RAMP * slow)
    way = ((1.0 - G * m * mean) / (1.0 - G * m)) @ (v.T @ y) ** 2 * k * STRETCH
    assert np.abs(force / (k * (STRETCH - way)) - 1.0).max() < 1e-2
    assert force[-1] < 0.7 * force[0]


def test_a_region_relaxes_by_itself() -> None:
    """Independent check: only the region's cells relax, so much and so fast as it says, and none if it says nothing."""
    layer = {"name": "layer", "depth": [0.0, 5e-3]}
    organ = [
        prepare(parse(held(tissue={"region": [layer | own]}))).assembly.organ
        for own in ({}, {"relaxation": []}, {"relaxation": [[0.2, 3.0]]})
    ]
    for each, times in zip(organ, ([TAU], [TAU], [TAU, 3.0]), strict=True):
        assert isinstance(each, tissue.RelaxingOrgan) and list(each.relaxation.times) == times
        within = each.elasticity.mesh.subdomains["layer"]
        shares = [np.broadcast_to(share, each.elasticity.mesh.nelements) for share in each.relaxation.shares]
        assert np.all(shares[0][within] == (G if each is organ[0] else 0.0))
        assert np.all(np.delete(shares[0], within) == G)
        assert len(shares) == 1 or (np.all(shares[1][within] == 0.2) and np.all(np.delete(shares[1], within) == 0.0))


@pytest.mark.parametrize(
    ("tables", "words"),
    [
        ({"tissue": {"relaxation": [[0.6, 1.0], [0.4, 2.0]]}}, ["tissue.relaxation", "below 1"]),
        ({"tissue": {"relaxation": [0.6, 1.0]}}, ["tissue.relaxation", "rows"]),
        ({"solve": {"kind": "dynamic", "organ": "krylov"}}, ["solve.organ", "tissue.relaxation"]),
        ({"thread": {"relaxation": [[0.6, 1.0], [0.4, 2.0]]}}, ["thread.relaxation", "below 1"]),
        ({"thread": {"relaxation": [[0.2, 1.0]], "energy": "springs"}}, ["thread.energy", "thread.relaxation"]),
    ],
)
def test_what_cannot_be_is_refused(tables: dict[str, dict[str, Any]], words: list[str]) -> None:
    """Independent check: key, reason and remedy."""
    with pytest.raises(ScenarioError) as refused:
        parse(held(**tables))
    assert all(word in str(refused.value) for word in words)


LOSING, SLOW = 0.4, 2.0  # share and time [s] of the thread


@pytest.mark.parametrize("knots", ["travelling", "fixed"])
def test_a_thread_that_relaxes_loosens_its_stitch(knots: str) -> None:
    """Independent check: the spring of the tissue in series with a spring and a Maxwell element, drawn within RAMP; a
    ratio r of stiffnesses slows it by (1 + r)/(1 + (1 − g) r)."""
    thread = {"relaxation": [[LOSING, SLOW]], "knots": knots}
    simulation = prepare(parse(held(tissue={"relaxation": [], "youngs_modulus": 2e5}, thread=thread)))
    steps = [step for step, _ in simulation.advance()]
    t, force = np.array([(step.time, abs(step.piercings[0].force[2])) for step in steps[1:]]).T
    body, system = simulation.assembly.body, simulation.assembly.system
    assert body is not None
    organ = tissue.RelaxingOrgan(
        body,
        tissue.build_sites(body, [tissue.Site((0.0, 0.0, 0.0), 3e-3, direction=None)]),
        relaxation=tissue.Prony([G], [TAU]),
    )
    y, k = organ.Y[2].toarray()[0], system.thread.section.EA / LENGTH
    r = k * float(y @ np.linalg.solve(organ.K.toarray(), y))
    sudden, last = k * STRETCH / (1.0 + r), k * STRETCH * (1.0 - LOSING) / (1.0 + (1.0 - LOSING) * r)
    x = np.array([RAMP, *(t - RAMP)]) * (1.0 + (1.0 - LOSING) * r) / (SLOW * (1.0 + r))
    left = np.exp(-x[1:]) * -np.expm1(-x[0]) / x[0]
    assert np.abs(force / (last + (sudden - last) * left) - 1.0).max() < 1e-2
    assert force[-1] < 0.8 * force[0]


def drawn(kind: str, **more: Any) -> dict[str, Any]:
    """A thread that is stretched round a rough hole in no organ, held while it relaxes, and drawn on."""
    ways = [[0.0, 0.0, 0.0, 0.03], [0.3, 0.0, 0.0, 0.0305], [2.0, 0.0, 0.0, 0.0305], [2.5, 0.0, 0.0, 0.0315]]
    thread = {
        "suture": "4-0 polypropylene",
        "path": [[-0.03, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.03]],
        "length": 0.06,
        "start": {"kind": "fixed"},
        "end": {"kind": "driven", "waypoints": ways},
        "relaxation": [[0.3, 0.5], [0.2, 5.0]],
    }
    hole = {"name": "hole", "at": [0.0, 0.0, 0.0], "direction": "free", "friction": {"static": 0.2, "kinetic": 0.2}}
    solve = {"kind": "static", "load_steps": 60} if kind == "static" else {"kind": "dynamic", "dt": 0.01}
    return {"thread": thread | more, "piercing": [hole], "solve": solve | {"duration": 3.0}}


@pytest.mark.parametrize("kind", ["static", "dynamic"])
def test_the_law_of_friction_holds_in_strands_that_have_relaxed(kind: str) -> None:
    """Independent check: T₂ − T₁ = μN of the tensions that the strands transmit, while the hole slides over material
    that has relaxed under another tension. The energy closes, and what relaxes while nothing moves is what the thread
    stores less."""
    steps = [step for step, _ in prepare(parse(drawn(kind))).advance()]
    slid = 0
    for step in steps[1:]:
        hole, energy = step.piercings[0], step.energy
        assert abs(energy.balance_error) < 1e-9 * energy.external_work
        rise, pressed = hole.tension_after - hole.tension_before, np.linalg.norm(hole.force)
        if hole.state == "slip" and step.time > 2.0 and pressed > 0.1:
            slid += 1
            assert rise == pytest.approx(0.2 * np.sqrt(pressed**2 - rise**2), rel=5e-3)
    assert slid > 5
    drawn_on = [step.energy for step in steps if step.time > 0.3]  # the bends that are laid have sprung open by then
    work, lost = (
        getattr(drawn_on[-1], name) - getattr(drawn_on[0], name) for name in ("external_work", "numerical_dissipation")
    )
    assert work > 1e-3 and abs(lost) < 2e-3 * work
    held_by = [step.energy for step in steps if 0.5 < step.time < 1.95]
    lost = held_by[-1].viscous_dissipation - held_by[0].viscous_dissipation
    assert lost == pytest.approx(held_by[0].elastic_thread - held_by[-1].elastic_thread, rel=1e-3)


@pytest.mark.parametrize("more", [{}, {"knots": "fixed"}])
def test_a_run_goes_on_from_what_the_thread_remembers(more: dict[str, Any]) -> None:
    """Identity: a run that is continued from the record of a step computes the same numbers."""
    simulation = prepare(parse(drawn("dynamic", **more)))
    steps = [step for step, _ in islice(simulation.advance(), 71)]
    kept = steps[60].kept
    assert kept is not None
    *_, (again, _) = islice(simulation.advance(kept()), 11)
    assert again.step == 70 and np.array_equal(steps[70].end_reaction, again.end_reaction)


@pytest.mark.parametrize("hold", [{}, {"hold": 0.04}])
def test_a_tie_that_is_drawn_within_a_load_step_holds_the_same(hold: dict[str, float]) -> None:
    """Two ways: load steps longer than the draw, and load steps that divide it. A knot slips when it is locked, before
    the tissue relaxes."""
    stitch = {"name": "a", "at": [0.0, 0.0, 0.0], "bite": 5e-3, "depth": 3e-3, "force": 0.05, "until": 10.0, **hold}
    tables = held(tissue={"relaxation": [[0.3, 10.0], [0.2, 100.0]]}) | {"stitch": [stitch]}
    del tables["piercing"], tables["thread"]["path"], tables["thread"]["start"], tables["thread"]["end"]
    force = []
    for load_steps in (4, 160):
        solve = {"kind": "static", "duration": 400.0, "load_steps": load_steps}
        *_, (last, _) = prepare(parse(tables | {"solve": solve})).advance()
        force.append(last.ties[0].force)
    assert force[0] == pytest.approx(force[1], rel=3e-3)
    assert force[1] < hold.get("hold", 0.05)
