"""The strain-energy density of a scenario's organ, cell by cell if its regions differ."""

from itertools import permutations

import numpy as np

import tissue
from studies import scenario as model
from studies.arrays import Array
from studies.simulation.given import Given
from tissue.materials.density import Density, Sum
from tissue.materials.fibres import Fibres
from tissue.materials.isotropic import Exponential

# Directions m and normals n of simple shears F = I + γ m ⊗ n, along and halfway between the axes, in both senses.
AXES = [(np.eye(3)[i], np.eye(3)[j]) for i, j in permutations(range(3), 2)]
PLANES = [(s * m, n) for a, b in AXES for m, n in ((a, b), ((a + b) / 2**0.5, (a - b) / 2**0.5)) for s in (1.0, -1.0)]


def hyperelasticity_of(table: model.Tissue, body: tissue.Elasticity, given: Given) -> tissue.Hyperelasticity:
    """Return the energy of an organ at finite strain: the given energy, or the energy of the scenario."""
    own = given.distortion(float(np.max(body.material.lame_mu)))
    return tissue.Hyperelasticity(body, own or distortion_of(table, body), prestretch_of(table, body))


def distortion_of(table: model.Tissue, body: tissue.Elasticity) -> Density:
    """Return the scenario's density of distortion."""
    parts: list[Density] = [Exponential(body.material.lame_mu, stiffening_of(table, body)), *fibres_of(table, body)]
    return Sum(parts)


def relaxation_of(table: model.Tissue, body: tissue.Elasticity) -> tissue.Prony | None:
    """Return the relaxation of an organ's stress, None without relaxation; each series acts in its own cells."""
    if not table.relaxes:
        return None
    owner, every = np.zeros(body.mesh.nelements, dtype=np.intp), [table.relaxation]
    for region in table.region:
        if region.relaxation is not None:
            owner[body.mesh.subdomains[region.name]] = len(every)
            every.append(region.relaxation)
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
    owner, families = np.zeros(body.mesh.nelements, dtype=np.intp), [table.fibres or ()]
    for region in table.region:
        if region.fibres is not None:
            owner[body.mesh.subdomains[region.name]] = len(families)
            families.append(region.fibres)
    return [
        Fibres(family.direction, family.k1 * (owner == k), family.k2)
        for k, those in enumerate(families)
        for family in those
    ]


def prestretch_of(table: model.Tissue, body: tissue.Elasticity) -> Array:
    """Return the principal stretches of the reference shape, shape `(3,)`, or `(3, c)` if a region differs."""
    whole = np.array(table.prestretch or (1.0, 1.0, 1.0))
    if all(region.prestretch is None for region in table.region):
        return whole
    out = np.repeat(whole[:, None], body.mesh.nelements, axis=1)
    for region in table.region:
        if region.prestretch is not None:
            out[:, body.mesh.subdomains[region.name]] = np.array(region.prestretch)[:, None]
    return out
