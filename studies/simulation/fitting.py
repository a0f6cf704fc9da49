"""Cells at the holes of a scenario, refined to the requested accuracy of the compliance."""

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
) -> tuple[tissue.Elasticity, tissue.Fitted | None]:
    """Return the discrete elasticity of the organ, and the refinement of its cells at the `sites`.

    The refinement is None unless the scenario requests an accuracy. Lips match node by node: both
    lips of a slit are refined alike, and the mesh of an open wound stays symmetric about the wound.
    """
    table = scenario.tissue
    assert table is not None
    body_on, shape = partial(body_of, table, given), table.mesh
    if shape.accuracy == "given":
        return body_on(mesh), None
    mirror = wound_of(shape).normal_axis if isinstance(shape, model.WoundMesh) and shape.width else None
    most = psutil.virtual_memory().available / BYTES_PER_UNKNOWN[table.element]
    fit = tissue.fitted(mesh, table.element, body_on, sites, shape.accuracy, most, mirror)
    return fit.body, fit
