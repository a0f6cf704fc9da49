"""The strain-energy density of a scenario's organ, cell by cell if its regions differ."""

import numpy as np

import tissue
from studies import scenario as model
from studies.arrays import Array
from studies.simulation.given import Given
from studies.simulation.meshing import owned
from tissue.materials.density import Sum
from tissue.materials.fibres import Fibres
from tissue.materials.isotropic import Exponential


def hyperelasticity_of(table: model.Tissue, body: tissue.Elasticity, given: Given) -> tissue.Hyperelasticity:
    """Return the energy of an organ at finite strain, of the scenario or from Python."""
    own = given.distortion(float(np.max(body.material.lame_mu)))
    shear = Exponential(body.material.lame_mu, stiffening_of(table, body))
    return tissue.Hyperelasticity(body, own or Sum([shear, *fibres_of(table, body)]), prestretch_of(table, body))


def relaxation_of(table: model.Tissue, body: tissue.Elasticity) -> tissue.Prony | None:
    """Return the relaxation of an organ's stress, None without relaxation.

    Each series acts in its own cells.
    """
    if not table.relaxes:
        return None
    owner, every = owned(table, body.mesh, "relaxation")
    rows = [(share * (owner == k), time) for k, series in enumerate(every) for share, time in series]
    return tissue.Prony(*zip(*rows, strict=True))


def stiffening_of(table: model.Tissue, body: tissue.Elasticity) -> Array:
    """Return b per cell, shape `(c,)` [-]: zero for a neo-Hookean material.

    A region without material and stiffening has the organ's b.
    """
    out = np.full(body.mesh.nelements, table.stiffening or 0.0)
    for region in table.region:
        if region.material is not None or region.stiffening is not None:
            own = region.stiffening or (table.stiffening or 0.0)
            out[body.mesh.subdomains[region.name]] = 0.0 if region.material == "neo-hookean" else own
    return out


def fibres_of(table: model.Tissue, body: tissue.Elasticity) -> list[Fibres]:
    """Return the families of fibres, each in the cells of its organ or region."""
    owner, every = owned(table, body.mesh, "fibres")
    return [
        Fibres(family.direction, family.k1 * (owner == k), family.k2)
        for k, families in enumerate(every)
        for family in families or ()
    ]


def prestretch_of(table: model.Tissue, body: tissue.Elasticity) -> Array:
    """Return the principal stretches of the reference shape, shape `(3,)` [-].

    The shape is `(3, c)` if a region differs.
    """
    owner, every = owned(table, body.mesh, "prestretch")
    stretches = np.array([stretch or (1.0, 1.0, 1.0) for stretch in every])
    return stretches[0] if len(every) == 1 else np.ascontiguousarray(stretches[owner].T)
