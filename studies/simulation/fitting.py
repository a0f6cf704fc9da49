"""Cells where the holes of a scenario are: its organ refined until their compliance is as accurate as it asks for."""

from collections.abc import Sequence
from functools import partial

import psutil
import skfem

import tissue
from meshes.budget import BYTES_PER_UNKNOWN
from studies import scenario as model
from studies.scenario import Scenario
from studies.simulation.given import Given
from studies.simulation.meshing import material_of, wound_of


def body_of(table: model.Tissue, given: Given, mesh: skfem.MeshTet) -> tissue.Elasticity:
    """Return the discrete elasticity of an organ on a mesh."""
    material = material_of(table, mesh)
    body = tissue.elasticity(mesh, material, table.element, table.clamp, table.dilatation, table.roller)
    return given.stiffened(body)


def fitted(
    scenario: Scenario, given: Given, mesh: skfem.MeshTet, sites: Sequence[tissue.Site]
) -> tissue.Elasticity | tissue.Fitted:
    """Return the organ on its mesh as it is, or with the cells at the `sites` refined where the scenario asks for it.

    Lips match node by node: those of a slit are cut alike, the mesh of an open wound stays its own image across it.
    """
    table = scenario.tissue
    assert table is not None
    body_on, shape = partial(body_of, table, given), table.mesh
    if shape.accuracy == "given":
        return body_on(mesh)
    mirror = wound_of(shape).normal_axis if isinstance(shape, model.WoundMesh) and shape.width else None
    most = psutil.virtual_memory().available / BYTES_PER_UNKNOWN[table.element]
    return tissue.fitted(mesh, table.element, body_on, sites, shape.accuracy, most, mirror)
