"""The runs: a thread draws up two holes of a block, and is measured.

A thread comes down into one hole of a block, runs below its surface to the other and up again. Its start is held, its
end is drawn up by a dead load T, so that in linear theory both holes are drawn up by T and towards each other by T.
Each thing is changed alone about a reference case: a 3-0 braid under 0.1 N, 0.5 MPa, holes 10 mm apart on the surface,
a footprint of 1 mm, no friction. The bite's depth is that of the holes' centres: where the tissue bears the thread is
all that this model knows of a channel, so a deeper bite is one that bears deeper (a ball instead of a disc).

Stress is no nodal maximum, which would grow with the mesh, but that averaged over the half ball below a hole, and the
mean round a ring about it. It is that of a P2 mesh of its own under the forces of the run: a uniform organ's stress
does not depend on E.
"""

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from functools import lru_cache
from types import SimpleNamespace
from typing import Any

import numpy as np
from scipy.sparse import csr_matrix

import tissue
from coupling.reports.observation import site_compliance, site_forces
from meshes.block import graded_block_structured
from meshes.grading import Grading
from studies.arrays import Array
from studies.scenario import Scenario
from studies.simulation import Simulation, prepare
from studies.simulation.memory import OrganRun
from studies.simulation.recording import step_record
from studies.study import measure, measured, scene, unit_field
from studies.theory import TwoHoles, bend_length, bent_ratio, half_ball
from studies.until_failure import steps_until_failure
from studies.verdicts import LINEAR, bearing_strain
from thread.catalogue import suture

SIZE = (0.07, 0.06, 0.03)  # of the block, held at its bottom [m]
POISSON = 0.45
LEG = 0.03  # of the thread above each hole [m]
DIP = 1e-3  # of the laid thread below the holes [m]
DAMPING, RELAXED, RELAXED_STEP = 400.0, 1.0, 1e-2  # of a dynamic run [1/s, s, s], its load rising all the while
ROUND = 48  # points of a ring
TAUT = 0.2  # of the bite: a thread that bends over less is as good as a string
COARSEST = 1.3  # cells at the holes over the footprint, on the coarsest mesh for stress; finer by its `refinement`
GROWTH = 3.0  # of its cells
KINDS = ("von_mises", "largest", "smallest")
STRESSES = tuple(f"{place}_{kind}" for place in ("mean", "ring") for kind in KINDS)
THEORY = tuple(f"theory_{place}_{kind}" for place in ("mean", "ring") for kind in KINDS[:2])


@dataclass(frozen=True, kw_only=True)
class Case:
    """One run: `name` is a tissue, or the difference from the others of its `sweep` in words."""

    sweep: str
    name: str = ""
    suture: str = "3-0 polyglactin 910"
    knots: str = "travelling"  # or "fixed"
    holes: str = "free"  # or "normal": the thread's direction in them
    way: str = "static"  # or "dynamic"
    load_steps: int = unit_field("-")
    tension: float = unit_field("N")  # asked for
    youngs_modulus: float = unit_field("Pa")
    bite: float = unit_field("m")
    depth: float = unit_field("m")  # of the holes' centres
    footprint: float = unit_field("m")
    mu: float = unit_field("-")
    given: float = unit_field("m")  # by which the hand at the start gives way
    ring: float = unit_field("footprints")  # radius of the ring on which stress is taken
    refinement: float = unit_field("-")  # of the mesh for stress
    material: str = "linear"
    stiffening: float = unit_field("-", default=0.0)

    @property
    def theory(self) -> TwoHoles:
        """The same holes in a half-space."""
        return TwoHoles(self.bite, self.depth, self.footprint, self.youngs_modulus, POISSON)

    def tensions(self, load: float) -> tuple[float, float, float]:
        """Return the tension before, between and after holes that each turn a bending thread by 90° [N]."""
        ratio = bent_ratio(self.mu, 0.5 * np.pi)
        return load / ratio**2, load / ratio, load

    def displacements(self, load: float) -> Array:
        """Return (x, z) of entry and exit in a half-space, shape `(2, 2)` [m]."""
        return self.theory.displacements(*self.tensions(load))


@dataclass(frozen=True, kw_only=True)
class Row(Case):
    """One equilibrium. "along" is towards the other hole and "normal" out of the tissue; forces are those on it."""

    load: float = measured("N", lambda at: at.load)  # that was reached
    entry_along: float = measured("m", lambda at: at.moved[0])
    entry_normal: float = measured("m", lambda at: at.moved[2])
    exit_along: float = measured("m", lambda at: -at.moved[9])
    exit_normal: float = measured("m", lambda at: at.moved[11])
    theory_along: float = measured("m", lambda at: -at.theory[1, 0])  # of the exit, in a half-space
    theory_normal: float = measured("m", lambda at: at.theory[1, 1])
    approach: float = measured("m", lambda at: at.moved[0] - at.moved[9])
    theory_approach: float = measured("m", lambda at: at.theory[0, 0] - at.theory[1, 0])
    drawn: float = measured("m", lambda at: at.drawn)  # through the exit, since a taut thread in the undeformed organ
    theory_drawn: float = measured("m", lambda at: at.theory_drawn)
    held: float = measured("N", lambda at: at.entry.tension_before)
    leaving: float = measured("N", lambda at: at.exit.tension_before)
    pulled: float = measured("N", lambda at: at.exit.tension_after)
    theory_held: float = measured("N", lambda at: at.theory_held)
    force_along: float = measured("N", lambda at: -at.forces[1, 0])  # on the exit
    force_normal: float = measured("N", lambda at: at.forces[1, 2])
    couple: float = measured("N m", lambda at: np.linalg.norm(at.exit.couple))
    turn: float = measured("-", lambda at: np.abs(at.moved.reshape(2, 3, 3)[:, 1:]).max())  # of a frame: ⟨∇U⟩
    compliance_along: float = measured("m/N", lambda at: at.C[9, 9])
    compliance_normal: float = measured("m/N", lambda at: at.C[11, 11])
    mean_von_mises: float = unit_field("Pa")
    mean_largest: float = unit_field("Pa")
    mean_smallest: float = unit_field("Pa")
    ring_von_mises: float = unit_field("Pa")
    ring_largest: float = unit_field("Pa")
    ring_smallest: float = unit_field("Pa")
    theory_mean_von_mises: float = unit_field("Pa")
    theory_mean_largest: float = unit_field("Pa")
    theory_ring_von_mises: float = unit_field("Pa")
    theory_ring_largest: float = unit_field("Pa")
    cells: float = measured("m", lambda at: (np.prod(SIZE) / at.cells) ** (1.0 / 3.0))  # (V/N)^⅓ of the mesh for stress
    residual: float = measured("-", lambda at: at.residual)  # |C f − u| over |u|
    span_ratio: float = measured("-", lambda at: at.span_ratio)
    kinetic: float = measured("J", lambda at: at.energies.kinetic)
    elastic: float = measured("J", lambda at: at.energies.elastic)
    failed: str

    @property
    def moved(self) -> float:
        """Displacement of the hole that moved farther [m]."""
        return float(max(np.hypot(self.entry_along, self.entry_normal), np.hypot(self.exit_along, self.exit_normal)))

    @property
    def scaled_load(self) -> float:
        """τ = T/(E a²)."""
        return self.load / (self.youngs_modulus * self.footprint**2)

    @property
    def scaled_way(self) -> float:
        """Displacement of the exit along, in footprints."""
        return self.exit_along / self.footprint

    @property
    def gap(self) -> float:
        """Distance of the holes along [m]."""
        return self.bite - self.approach

    @property
    def bearing(self) -> float:
        """T/(d ℓ E)."""
        return bearing_strain(self.load, suture(self.suture).diameter, self.bite, self.youngs_modulus)

    @property
    def is_linear(self) -> bool:
        """Whether the linear organ is entitled to it."""
        return self.moved <= LINEAR * self.footprint and self.bearing <= LINEAR and self.turn <= LINEAR

    @property
    def is_taut(self) -> bool:
        """Whether the thread bends over little of the bite."""
        return self.load > 0.0 and np.sqrt(suture(self.suture).EI / self.load) <= TAUT * self.bite


REFERENCE = Case(
    sweep="reference", load_steps=4, tension=0.1, youngs_modulus=500e3, bite=0.01, depth=0.0, footprint=1e-3, mu=0.0,
    given=0.0, ring=2.0, refinement=1.5,
)  # fmt: skip


# --- runs -------------------------------------------------------------------------------------------------


def run_tensions(case: Case, tensions: Sequence[float]) -> Iterator[Row]:
    """Yield the runs to one tension after the other, and no further than the first that fails."""
    for tension in sorted(tensions):
        for row in run(replace(case, tension=tension)):
            yield row
        if row.failed:
            return


def last_step(case: Case) -> Row:
    """Run a case; return its last step."""
    *_, row = run(case)
    return row


def run(case: Case) -> Iterator[Row]:
    """Yield every load step; if one fails, the last equilibrium again with the name of the failure."""
    simulation = prepare(scenario(case))
    before = simulation.beginning()
    for now, failed in steps_until_failure(simulation):
        if failed:
            yield row_of(case, simulation, now, failed)
        elif not now.state.present.all():
            yield row_of(case, simulation, before, "left its hole: a hole came up to the hand that holds the start")
            return
        elif case.way == "static" or now.number == simulation.steps:
            yield row_of(case, simulation, now, "")
        before = now


def scenario(case: Case) -> Scenario:
    """Return the scene with the values of a case: cells refined at the holes, in the sweep of materials the P2 cells of
    the mesh for stress."""
    x, bottom, fine = 0.5 * case.bite, -case.depth - DIP, case.refinement
    values: dict[str, Any] = {
        "tissue.youngs_modulus": case.youngs_modulus,
        "tissue.material": case.material,
        "thread.suture": case.suture,
        "thread.knots": case.knots,
        "thread.path": [[-x, 0.0, LEG], [-x, 0.0, bottom], [x, 0.0, bottom], [x, 0.0, LEG]],
        "thread.start.waypoints": [[0.0, -x, 0.0, LEG], [1.0, -x, 0.0, LEG - case.given]],
        "thread.end.force": [0.0, 0.0, case.tension],
        "solve.load_steps": case.load_steps,
    }
    for name, at in zip(("entry", "exit"), case.theory.places, strict=True):
        hole = {"name": name, "at": at, "direction": case.holes, "footprint": case.footprint}
        values[f"piercing.{name}"] = hole | ({"friction": {"static": case.mu, "kinetic": case.mu}} if case.mu else {})
    if case.stiffening:
        values["tissue.stiffening"] = case.stiffening
    if case.sweep == "material":
        values |= {"tissue.element": "P2", "tissue.mesh.h": SIZE[0], "tissue.mesh.accuracy": "given"}
        values |= {"tissue.mesh.h_site": COARSEST * case.footprint / fine, "tissue.mesh.growth": GROWTH ** (1.0 / fine)}
    if case.way == "dynamic":
        values |= {"thread.damping": DAMPING, "thread.end.ramp": RELAXED}
        values["solve"] = {"duration": RELAXED, "dt": RELAXED_STEP, "integrator": "euler"}
        del values["solve.load_steps"]
    return scene("suture_tension", values)


def row_of(case: Case, simulation: Simulation, now: OrganRun, failed: str) -> Row:
    """Return the row of an equilibrium, compared with theory."""
    seen, f = step_record(now), site_forces(now.system, now.state)
    load = case.tension * now.state.time / simulation.scenario.solve.duration
    C, moved = hole_response(case, now)
    off = np.linalg.norm(C @ f.ravel() - moved) / max(np.linalg.norm(moved), np.finfo(float).tiny)
    end = SimpleNamespace(
        load=load, C=C, moved=moved, forces=f, entry=seen.piercings[0], exit=seen.piercings[1],
        drawn=LEG + case.depth + case.bite - seen.piercings[1].s, span_ratio=seen.span_ratio,
        residual=off if case.material == "linear" else np.nan,  # C of another material is a tangent
        theory=case.displacements(load), theory_drawn=theory_drawn_length(case, load),
        theory_held=case.tensions(load)[0], cells=fine_organ(geometry(case)).elasticity.mesh.nelements,
        energies=now.energies,
    )  # fmt: skip
    return measure(Row, end, **asdict(case), **stresses(case, now.state.organ), failed=failed)


def hole_response(case: Case, now: OrganRun) -> tuple[Array, Array]:
    """Return the compliance `(18, 18)` of the holes and their displacements `(18,)`; in the sweep of cells, those of
    the stress mesh under the forces of the run."""
    organ = now.system.organ
    if case.sweep == "cells":
        C = fine_organ(geometry(case)).operator(0.0, 0.0).C / case.youngs_modulus
        return C, C @ site_forces(now.system, now.state).ravel()
    return site_compliance(now.system, now.state), now.state.y.ravel() - organ.y0


def theory_drawn_length(case: Case, load: float) -> float:
    """Return the theoretical length drawn through the exit [m]: displacements of holes and hand, and stretch, minus the
    length of the bends, 2√(EI/T)(1 − cos θ/2) of an elastica that turns by θ on one side of a hole."""
    held, between, pulled = case.tensions(load)
    if between == 0.0:
        return 0.0
    moved, section = case.displacements(load), suture(case.suture)
    stretched = held * (LEG + case.depth) + between * case.bite
    inside, outside = (45.0, 45.0) if case.holes == "free" else (90.0, 0.0)
    bends = 2.0 * bend_length(section.EI, between, inside) + bend_length(section.EI, held, outside)
    given = case.given * pulled / case.tension
    return float(moved[0, 0] - moved[1, 0] + moved[0, 1] + given + stretched / section.EA - bends)


# --- stress -----------------------------------------------------------------------------------------------


def geometry(case: Case) -> Case:
    """Return the case without the keys that do not affect the stress under given forces, nor the ring."""
    kept = {name: getattr(case, name) for name in ("bite", "depth", "footprint", "holes", "refinement")}
    return replace(REFERENCE, **kept)


@lru_cache(maxsize=3)
def fine_organ(case: Case) -> tissue.QuasiStaticOrgan:
    """Return the organ of a `geometry` on P2 cells that resolve its holes, E = 1 Pa."""
    k, a, places = case.refinement, case.footprint, case.theory.places
    mesh = graded_block_structured(SIZE, Grading(SIZE[0], COARSEST * a / k, GROWTH ** (1.0 / k), a), places)
    body = tissue.elasticity(mesh, tissue.Material(1.0, POISSON, 1.0), "P2", ["bottom"])
    direction = "normal" if case.holes == "normal" else None
    sites = [tissue.Site(at, a, direction=direction) for at in places]
    return tissue.QuasiStaticOrgan(body, tissue.build_sites(body, sites))


@lru_cache(maxsize=8)
def probe(case: Case, ring: float) -> tuple[tissue.StressRecovery, csr_matrix]:
    """Return the recovery at the nodes of a `geometry`, and the exit's half ball and ring from there."""
    body, ball = fine_organ(case).elasticity, case.theory.places[1] + case.footprint * half_ball()[0]
    at = tissue.interpolation(body, np.vstack([ball, ring_points(case, ring)]))
    return tissue.stress_recovery(body), at


def ring_points(case: Case, ring: float) -> Array:
    """Return the points of a ring about the exit, half a footprint below it, shape `(k, 3)` [m]."""
    angle = 2.0 * np.pi * (np.arange(ROUND) + 0.5) / ROUND
    circle = np.column_stack([ring * np.cos(angle), ring * np.sin(angle), np.full(ROUND, -0.5)])
    return np.asarray(case.theory.places[1] + case.footprint * circle)


def stresses(case: Case, state: tissue.OrganState) -> dict[str, Any]:
    """Return the von Mises and principal stresses under the forces of a state, measured and in the half-space [Pa]; NaN
    in the sweep of materials, for the mesh for stress is linear."""
    out = dict.fromkeys((*STRESSES, *THEORY), float("nan"))
    if case.sweep == "material":
        return out
    shape, weights = geometry(case), half_ball()[1]
    recovery, points = probe(shape, case.ring)
    values = np.asarray(points @ recovery.stress(fine_organ(shape).displacement(state)))
    out |= mean_stresses(weights[None] @ values[: len(weights)], values[len(weights) :])
    if case.depth == 0.0 and case.holes == "free":
        forces = state.f_y.reshape(2, 9)[:, :3]
        below = case.theory.mean_stress(1, forces)[None]
        known = mean_stresses(flat(below), flat(case.theory.stress(ring_points(case, case.ring), forces)))
        out |= {name: known[name.removeprefix("theory_")] for name in THEORY}
    return out


def mean_stresses(*stress: Array) -> dict[str, float]:
    """Return the means over points of the von Mises, the largest and the smallest principal stress of `(k, 6)` [Pa],
    below the hole and on the ring."""
    out: list[float] = []
    for points in stress:
        largest, _, smallest = tissue.principal(points)[0].mean(axis=0).tolist()
        out += [float(tissue.von_mises(points).mean()), largest, smallest]
    return dict(zip(STRESSES, out, strict=True))


def flat(stress: Array) -> Array:
    """Return the tensors `(k, 3, 3)` as xx, yy, zz, xy, yz, xz, shape `(k, 6)`."""
    return np.column_stack([stress[:, i, j] for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (1, 2), (0, 2))])
