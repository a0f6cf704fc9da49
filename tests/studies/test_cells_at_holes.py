"""Cells where the holes of a scenario are: `tissue.mesh.accuracy` on every kind of mesh, and what a run says of it."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import studies
from meshes.block import block
from studies.command.summary import refinement_line
from studies.output.quantities import quantities
from studies.scenario import ScenarioError, parse
from studies.scenario.toml import changed
from studies.simulation import Simulation, prepare
from tests.studies.test_sweep import ORGAN

ASKED = 0.05
HOLE = {"at": [0.004, 0.003, 0.0], "direction": "free", "footprint": 1e-3}
QUADRATIC = {"tissue.element": "P2", "tissue.mesh.accuracy": ASKED}
FITTED = changed(ORGAN, QUADRATIC)


def fitted(data: dict[str, Any], keys: dict[str, Any], **handed: Any) -> Simulation:
    """A scenario with other keys, prepared."""
    return prepare(parse(changed(data, keys)), **handed)


def test_a_run_reports_its_cells_and_their_error(tmp_path: Path) -> None:
    """Independent check: what was asked for is reached, the summary and the line of the command say so, and nothing is
    added to a hole's compliance."""
    simulation = fitted(FITTED, {})
    assert simulation.subgrid == {}
    out = studies.run(simulation.scenario, tmp_path / "out")
    summary = json.loads((tmp_path / "out" / "summary.json").read_text(encoding="utf-8"))
    rounds, error = summary["mesh"]["rounds"], summary["piercings"]["ring"]["compliance_error"]
    assert out is not None
    assert 0.0 < error <= ASKED
    assert rounds[-1]["estimate"] == error
    assert rounds[-1]["unknowns"] == summary["tissue_dofs"] == simulation.tissue_dofs
    assert not {remark["code"] for remark in summary["remarks"]} & {"accuracy", "cells", "subgrid"}
    assert quantities(summary)["piercings.ring.compliance_error"].value == error
    assert f"{len(rounds)} round" in refinement_line(simulation.refinement)
    assert "'ring'" in refinement_line(simulation.refinement)


def test_the_mesh_as_given_is_the_default() -> None:
    """Independent check: no cell is refined, and no error reported."""
    plain, said = (fitted(ORGAN, keys) for keys in ({}, {"tissue.mesh.accuracy": "given"}))
    assert plain.refinement == said.refinement == {}
    assert plain.tissue_dofs == said.tissue_dofs
    assert refinement_line({}) == ""


@pytest.mark.parametrize("value", [0.0, 1.0, "fine"])
def test_an_accuracy_that_cannot_be_is_refused(value: object) -> None:
    """Independent check: the sentence has the key, the value, what is allowed and an example."""
    with pytest.raises(ScenarioError, match=r'tissue\.mesh.*accuracy = .* is refused: allowed are "given" or a number'):
        parse(changed(FITTED, {"tissue.mesh.accuracy": value}))


def test_a_mesh_from_python_is_refined() -> None:
    """Consistency check: the block that the scenario makes, handed over."""
    given = fitted(FITTED, {}, mesh=block((0.02, 0.02, 0.01), 5e-3))
    assert 0.0 < given.refinement["errors"]["ring"] <= ASKED
    assert given.topology is not None
    assert np.ptp(given.topology.points, axis=0) == pytest.approx([0.02, 0.02, 0.01])


def test_lips_in_contact_match_on_refined_cells() -> None:
    """Independent check: the hole is beside one lip, and the pairs of nodes are found on both."""
    wound = {"kind": "wound", "size": [0.03, 0.02, 0.01], "h": 5e-3, "length": 0.01, "depth": 5e-3, "accuracy": ASKED}
    simulation = fitted(FITTED, {"tissue.mesh": wound, "tissue.contact": True, "piercing.0": {"name": "ring", **HOLE}})
    gaps = simulation.assembly.organ.gaps
    assert gaps is not None
    left, right = np.moveaxis(gaps.body.points[gaps.nodes], 1, 0)
    assert np.abs(left - right).max() == 0.0
    assert simulation.refinement["errors"]["ring"] <= ASKED


def test_finite_strain_begins_on_refined_cells() -> None:
    """Consistency check: the cells are those of the linear organ, whose tangent the material has at rest."""
    keys = {"tissue.material": "neo-hookean", "tissue.rayleigh": [0.0, 0.0]}
    assert fitted(FITTED, keys).refinement["errors"] == fitted(FITTED, {}).refinement["errors"]
