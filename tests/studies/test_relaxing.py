"""Scenarios whose tissue relaxes: a stitch that loosens, layers of their own, what is refused."""

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
        "thread": thread,
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
        ({"tissue": {"reduction": {}}, "solve": {"kind": "dynamic"}}, ["tissue.reduction", "relax"]),
        ({"solve": {"kind": "dynamic", "organ": "krylov"}}, ["solve.organ", "tissue.relaxation"]),
    ],
)
def test_what_cannot_be_is_refused(tables: dict[str, dict[str, Any]], words: list[str]) -> None:
    """Independent check: key, reason and remedy."""
    with pytest.raises(ScenarioError) as refused:
        parse(held(**tables))
    assert all(word in str(refused.value) for word in words)
