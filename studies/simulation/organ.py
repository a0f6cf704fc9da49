"""The organ of a scenario: its discrete elasticity, its energy, loads and gaps, and its solution.

Cells at the holes are refined to the requested accuracy of the compliance. The strain-energy density
differs from cell to cell if regions differ.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache, partial

import numpy as np
import psutil
import skfem

import tissue
from meshes.budget import BYTES_PER_UNKNOWN
from meshes.wound import lips
from studies.arrays import Array
from studies.scenario import PulledEnd, Scenario, Solve, Tissue, WoundMesh
from studies.scenario.organ import LIPS, Load
from studies.scenario.values import Turn
from studies.simulation.given import Given
from studies.simulation.meshing import check_loaded, is_sized, material_of, motions_left, owned, wound_of
from studies.simulation.sharing import Shared, body_key
from tissue.elasticity import formulation
from tissue.materials.density import Sum
from tissue.materials.fibres import Fibres
from tissue.materials.isotropic import Exponential
from tissue.organs.finite import KEEP, keep_at_rest
from tissue.solvers.direct import LIBRARIES

Dynamic = tissue.DynamicOrgan | tissue.KrylovOrgan
AnyOrgan = tissue.FixedSites | tissue.QuasiStaticOrgan | Dynamic | tissue.FiniteOrgan

SMALLEST = 5_000  # unknowns of an organ for a Krylov space: for a smaller organ all unknowns cost hardly more per step
LARGEST = 100_000  # unknowns: above this the Krylov space takes as long as the rest of the preparation
MOST_PULLS = 60  # variables of sites and loads, with eight vectors each: six holes


def organ_of(
    scenario: Scenario,
    sites: Sequence[tissue.Site],
    body: tissue.Elasticity | None,
    fit: tissue.Fitted | None,
    given: Given,
) -> AnyOrgan:
    """Return the organ with its holes at the `sites`, for the coupling.

    The organ is linear or at finite strain, with or without inertia. A linear organ can be in its
    Krylov space. Without `[tissue]` the holes are points fixed in space. The `fit` of a refined
    body has located the holes already.
    """
    if body is None or scenario.tissue is None:
        return tissue.fixed_sites(sites)
    placed = tissue.build_sites(body, sites) if fit is None else fit.sites
    check_loaded(body.mesh, scenario.tissue)
    gaps, loads, bears = gaps_of(scenario, body), loads_of(scenario), scenario.thread.surface
    skin = None if bears is None else tissue.skin_of(body, bears.friction)
    known = body, placed, scenario.solve.gravity, scenario.tissue.solver, gaps, loads, skin
    inertia = scenario.tissue.inertia and scenario.solve.kind == "dynamic"
    relaxation = relaxation_of(scenario.tissue, body)
    if scenario.tissue.material != "linear":
        hyper = hyperelasticity_of(scenario.tissue, body, given)
        keep = keep_at_rest(body.free.size) if scenario.solve.kind == "static" else KEEP
        damping = scenario.tissue.rayleigh[0]
        return tissue.FiniteOrgan(*known, law=hyper, inertia=inertia, damping=damping, keep=keep, relaxation=relaxation)
    if relaxation is not None:
        damped = scenario.tissue.rayleigh
        return tissue.RelaxingOrgan(*known, rayleigh=damped, relaxation=relaxation, inertia=inertia)
    if not inertia:
        held = scenario.tissue.clamp, scenario.tissue.roller
        floating = scenario.floats and any(motions.size for motions in motions_left(body.mesh, *held)[1])
        return tissue.FloatingOrgan(*known) if floating else tissue.QuasiStaticOrgan(*known)
    full = tissue.DynamicOrgan(*known, rayleigh=scenario.tissue.rayleigh)
    return tissue.KrylovOrgan(full) if takes_krylov(scenario, full) else full


def takes_krylov(scenario: Scenario, full: tissue.DynamicOrgan) -> bool:
    """Return whether steps of an organ use its Krylov space.

    They use it if requested, or by default if it is faster. The duration of the run is not
    considered, so that a longer run continues with the same method.
    """
    if not scenario.has_krylov or scenario.solve.organ == "krylov":
        return scenario.has_krylov
    pulls = full.Y.shape[0] + full.surface_load.shape[1]
    pays = SMALLEST <= full.size <= LARGEST and pulls <= MOST_PULLS and full.choice.name in LIBRARIES
    return pays and tissue.has_space(full)


def loads_of(scenario: Scenario) -> tuple[tissue.SurfaceLoad, ...]:
    """Return the loads on the organ's boundaries."""
    return tuple(
        tissue.SurfaceLoad(table.boundary, table.traction, table.pressure, course_of(scenario.solve, table))
        for table in (() if scenario.tissue is None else scenario.tissue.load)
    )


def course_of(solve: Solve, table: Load | PulledEnd) -> tuple[Turn, ...] | None:
    """Return the course of a load; None if the whole load acts at all times."""
    return table.rows(solve.duration, table.ramp or 0.0)


def gaps_of(scenario: Scenario, body: tissue.Elasticity) -> tissue.Gaps | None:
    """Return the gaps between surfaces in contact, None without contact.

    The gaps of a wound's lips are between matching nodes.
    """
    shape = None if scenario.tissue is None else scenario.tissue.mesh
    parts: list[tissue.Part] = []
    friction = {pair.between: pair.friction for pair in scenario.contact}
    for between in scenario.touching:
        if isinstance(shape, WoundMesh) and set(between) == set(LIPS):
            own = lip_gaps(shape, body)
        else:
            own = tissue.surface_gaps(body, [between])
        parts += [replace(part, friction=friction.get(between, 0.0)) for part in own.parts]
    return tissue.Gaps(body, tuple(parts)) if parts else None


def lip_gaps(shape: WoundMesh, body: tissue.Elasticity) -> tissue.Gaps:
    """Return the gaps between the matching nodes of a wound's lips."""
    wound = wound_of(shape)
    pairs = lips(body.mesh, wound)
    return tissue.build_gaps(body, pairs.nodes, pairs.facets[:, 0], np.eye(3)[wound.normal_axis])


def recovery_of(scenario: Scenario, body: tissue.Elasticity | None, store: Shared) -> tissue.StressRecovery:
    """Return the recovery of stress from displacement, from the store if possible."""
    assert body is not None
    return store.take("recovery", body_key(scenario), lambda: tissue.stress_recovery(body))


def depths_of(scenario: Scenario, body: tissue.Elasticity | None, store: Shared, points: Array) -> Array:
    """Return the depth of points `(k, 3)` below the organ's surface, shape `(k,)` [m].

    It is negative outside. The function comes from the store if possible.
    """
    assert body is not None
    mesh = body.mesh

    def remembered() -> Callable[[bytes], Array]:
        depths = tissue.depths(mesh)
        return cache(lambda places: depths(np.frombuffer(places).reshape(-1, 3)))

    known: Callable[[bytes], Array] = store.take("depths", body_key(scenario), remembered)
    return known(np.ascontiguousarray(points, dtype=np.float64).tobytes())


def body_of(table: Tissue, given: Given, mesh: skfem.MeshTet) -> tissue.Elasticity:
    """Return the discrete elasticity of an organ on a mesh."""
    material = material_of(table, mesh)
    kind = formulation(table.dilatation, table.element, material.poisson_ratio, table.material != "linear")
    body = tissue.elasticity(mesh, material, table.element, table.clamp, kind, table.roller)
    return given.stiffened(body)


def fitted(
    scenario: Scenario, given: Given, mesh: skfem.MeshTet | None, sites: Sequence[tissue.Site]
) -> tuple[tissue.Elasticity | None, tissue.Fitted | None]:
    """Return the discrete elasticity of the organ, and the refinement of its cells at the `sites`.

    Both are None without an organ. The refinement is None unless the scenario requests an accuracy.
    Lips match node by node: both lips of a slit are refined alike, and the mesh of an open wound
    stays symmetric about the wound.
    """
    table = scenario.tissue
    if mesh is None or table is None:
        return None, None
    body_on, shape = partial(body_of, table, given), table.mesh
    if shape.accuracy == "given":
        return body_on(mesh), None
    mirror = wound_of(shape).normal_axis if isinstance(shape, WoundMesh) and shape.width else None
    most = psutil.virtual_memory().available / BYTES_PER_UNKNOWN[table.element]
    fit = tissue.fitted(mesh, table.element, body_on, sites, shape.accuracy, most, mirror, is_sized(scenario))
    return fit.body, fit


def hyperelasticity_of(table: Tissue, body: tissue.Elasticity, given: Given) -> tissue.Hyperelasticity:
    """Return the energy of an organ at finite strain, of the scenario or from Python."""
    own = given.distortion(float(np.max(body.material.lame_mu)))
    shear = Exponential(body.material.lame_mu, stiffening_of(table, body))
    return tissue.Hyperelasticity(body, own or Sum([shear, *fibres_of(table, body)]), prestretch_of(table, body))


def relaxation_of(table: Tissue, body: tissue.Elasticity) -> tissue.Prony | None:
    """Return the relaxation of an organ's stress, None without relaxation.

    Each series acts in its own cells.
    """
    if not table.relaxes:
        return None
    owner, every = owned(table, body.mesh, "relaxation")
    rows = [(share * (owner == k), time) for k, series in enumerate(every) for share, time in series]
    return tissue.Prony(*zip(*rows, strict=True))


def stiffening_of(table: Tissue, body: tissue.Elasticity) -> Array:
    """Return b per cell, shape `(c,)` [-]: zero for a neo-Hookean material.

    A region without material and stiffening has the organ's b.
    """
    out = np.full(body.mesh.nelements, table.stiffening or 0.0)
    for region in table.region:
        if region.material is not None or region.stiffening is not None:
            own = region.stiffening or (table.stiffening or 0.0)
            out[body.mesh.subdomains[region.name]] = 0.0 if region.material == "neo-hookean" else own
    return out


def fibres_of(table: Tissue, body: tissue.Elasticity) -> list[Fibres]:
    """Return the families of fibres, each in the cells of its organ or region."""
    owner, every = owned(table, body.mesh, "fibres")
    return [
        Fibres(family.direction, family.k1 * (owner == k), family.k2)
        for k, families in enumerate(every)
        for family in families or ()
    ]


def prestretch_of(table: Tissue, body: tissue.Elasticity) -> Array:
    """Return the principal stretches of the reference shape, shape `(3,)` [-].

    The shape is `(3, c)` if a region differs.
    """
    owner, every = owned(table, body.mesh, "prestretch")
    stretches = np.array([stretch or (1.0, 1.0, 1.0) for stretch in every])
    return stretches[0] if len(every) == 1 else np.ascontiguousarray(stretches[owner].T)
