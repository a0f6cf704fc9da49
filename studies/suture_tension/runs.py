"""The runs: what a case measures.

Stress is no nodal maximum, which would grow with the mesh, but that averaged over the half ball below a hole, and the
mean round a ring about it. It is that of a P2 mesh of its own under the forces of the run: a uniform organ's stress
does not depend on E.
"""

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
from scipy.sparse import csr_matrix

import tissue
from coupling.reports.observation import site_compliance, site_forces
from meshes.block import graded_block_structured
from meshes.grading import Grading
from studies.arrays import Array
from studies.scenario import Scenario, parse
from studies.simulation import Simulation, prepare
from studies.simulation.memory import OrganRun
from studies.simulation.recording import step_record
from studies.suture_tension.case import (
    COARSEST,
    DAMPING,
    DIP,
    GROWTH,
    LEG,
    POISSON,
    REFERENCE,
    RELAXED,
    RELAXED_STEP,
    ROUND,
    SIZE,
    STRESSES,
    THEORY,
    Case,
    Row,
    theory_tensions,
)
from studies.theory import half_ball
from studies.until_failure import steps_until_failure
from thread.catalogue import suture

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
    """Yield every load step; where one fails, the last equilibrium once more with the name of what failed."""
    simulation = prepare(scenario(case))
    before = simulation.beginning()
    for now, failed in steps_until_failure(simulation):
        if failed:
            yield measure(case, simulation, now, failed)
        elif not now.state.present.all():
            yield measure(case, simulation, before, "left its hole: a hole came up to the hand that holds the start")
            return
        elif case.way == "static" or now.number == simulation.steps:
            yield measure(case, simulation, now, "")
        before = now


def mesh_table(case: Case) -> dict[str, object]:
    """Return the cells of a run: as large as a footprint at the holes, in the sweep of materials those of the mesh for
    stress."""
    if case.sweep == "material":
        k = case.refinement
        sizes = {"h": SIZE[0], "h_site": COARSEST * case.footprint / k, "growth": GROWTH ** (1.0 / k)}
    else:
        sizes = {"h": 0.01, "h_site": case.footprint, "growth": 1.8}
    return {"kind": "block", "generator": "structured", "size": list(SIZE), **sizes}


def material_table(case: Case) -> dict[str, object]:
    """Return the material of a run, in the sweep of materials on P2 cells."""
    stiffening = {"stiffening": case.stiffening} if case.stiffening else {}
    element = {"element": "P2"} if case.sweep == "material" else {}
    return {"material": case.material, **stiffening, **element}


def scenario(case: Case) -> Scenario:
    """Return a thread down into a block and up again, its start held, its end drawn up."""
    x, bottom = 0.5 * case.bite, -case.depth - DIP
    hole: dict[str, object] = {"direction": case.holes, "footprint": case.footprint}
    if case.mu:
        hole["friction"] = {"static": case.mu, "kinetic": case.mu}
    ramp = RELAXED if case.way == "dynamic" else 0.0
    still: dict[str, object] = {"kind": "static", "load_steps": case.load_steps}
    return parse(
        {
            "title": f"suture tension: {case.sweep} {case.name}",
            "tissue": {
                "youngs_modulus": case.youngs_modulus,
                "poisson_ratio": POISSON,
                "density": 1070.0,
                "inertia": False,
                "clamp": ["bottom"],
                "mesh": mesh_table(case),
                **material_table(case),
            },
            "thread": {
                "suture": case.suture,
                "control_points": 60,
                "resolution": case.knots,
                "damping": DAMPING if ramp else 0.0,
                "path": [[-x, 0.0, LEG], [-x, 0.0, bottom], [x, 0.0, bottom], [x, 0.0, LEG]],
                "start": {"kind": "driven", "waypoints": [[0.0, -x, 0.0, LEG], [1.0, -x, 0.0, LEG - case.given]]},
                "end": {"kind": "pulled", "force": [0.0, 0.0, case.tension], "ramp": ramp},
            },
            "piercing": [
                {"name": name, "at": [float(c) for c in at], **hole}
                for name, at in zip(("entry", "exit"), case.places, strict=True)
            ],
            "solve": {"duration": RELAXED, "dt": RELAXED_STEP, "integrator": "euler"} if ramp else still,
        }
    )


def measure(case: Case, simulation: Simulation, now: OrganRun, failed: str) -> Row:
    """Return what there is to know of an equilibrium, compared with theory."""
    seen, f = step_record(now), site_forces(now.system, now.state)
    load = case.tension * now.state.time / simulation.scenario.solve.duration
    entry, leave = seen.piercings
    C, moved = hole_response(case, now)
    tensions = theory_tensions(case, load)
    theory = case.theory.displacements(*tensions)
    return Row(
        **asdict(case),
        load=load,
        entry_along=float(moved[0]),
        entry_normal=float(moved[2]),
        exit_along=-float(moved[9]),
        exit_normal=float(moved[11]),
        theory_along=-float(theory[1, 0]),
        theory_normal=float(theory[1, 1]),
        approach=float(moved[0] - moved[9]),
        theory_approach=float(theory[0, 0] - theory[1, 0]),
        drawn=LEG + case.depth + case.bite - leave.s,
        theory_drawn=theory_drawn_length(case, theory, tensions),
        held=entry.tension_before,
        entered=entry.tension_after,
        leaving=leave.tension_before,
        pulled=leave.tension_after,
        theory_held=tensions[0],
        force_along=-float(f[1, 0]),
        force_normal=float(f[1, 2]),
        couple=float(np.linalg.norm(leave.couple)),
        turn=float(np.abs(moved.reshape(2, 3, 3)[:, 1:]).max()),
        compliance_along=float(C[9, 9]),
        compliance_normal=float(C[11, 11]),
        **(no_stresses() if case.sweep == "material" else stresses(case, now.state.organ)),
        cells=float((np.prod(SIZE) / fine_organ(geometry(case)).elasticity.mesh.nelements) ** (1.0 / 3.0)),
        residual=residual_of(case, C @ f.ravel(), moved),
        span_ratio=seen.span_ratio,
        springs=max((float(gap["share"]) for gap in simulation.subgrid.values()), default=0.0),
        kinetic=now.energies.kinetic,
        elastic=now.energies.elastic,
        clear=all(gap["holds"] for gap in simulation.subgrid.values()),
        failed=failed,
    )


def residual_of(case: Case, theirs: Array, moved: Array) -> float:
    """Return |C f − u| over |u|, NaN where C is a tangent."""
    if case.material != "linear":
        return float("nan")
    return float(np.linalg.norm(theirs - moved) / max(np.linalg.norm(moved), np.finfo(float).tiny))


def hole_response(case: Case, now: OrganRun) -> tuple[Array, Array]:
    """Return the compliance `(18, 18)` of the holes and how far they moved `(18,)`; in the sweep of cells, what the
    mesh for stress makes of the forces of the run."""
    organ = now.system.organ
    if case.sweep == "cells":
        C = fine_organ(geometry(case)).operator(0.0, 0.0).C / case.youngs_modulus
        return C, C @ site_forces(now.system, now.state).ravel()
    return site_compliance(now.system, now.state), now.state.y.ravel() - organ.y0


def theory_drawn_length(case: Case, moved: Array, tensions: tuple[float, float, float]) -> float:
    """Return what comes through the exit [m]: what holes that moved `(2, 2)` [m] and the hand give, and stretch, less
    what the bends take: 2√(EI/T)(1 − cos θ/2) of an elastica that turns by θ on one side of a hole."""
    held, between, _ = tensions
    if between == 0.0:
        return 0.0
    section, stretched = suture(case.suture), held * (LEG + case.depth) + between * case.bite
    inside, outside = (45.0, 45.0) if case.holes == "free" else (90.0, 0.0)
    bends = 2.0 * bend(section.EI, between, inside) + bend(section.EI, held, outside)
    given = case.given * tensions[2] / case.tension
    return float(moved[0, 0] - moved[1, 0] + moved[0, 1] + given + stretched / section.EA - bends)


def bend(EI: float, tension: float, turn: float) -> float:
    """Return the length that an elastica of stiffness EI [N m²] takes to turn by `turn` [degree] from its line [m]."""
    return float(2.0 * np.sqrt(EI / tension) * (1.0 - np.cos(np.radians(turn) / 2.0)))


# --- stress -----------------------------------------------------------------------------------------------


def geometry(case: Case) -> Case:
    """Return the case without what stress under given forces does not depend on, nor on the ring."""
    kept = {name: getattr(case, name) for name in ("bite", "depth", "footprint", "holes", "refinement")}
    return replace(REFERENCE, **kept)


@lru_cache(maxsize=3)
def fine_organ(case: Case) -> tissue.QuasiStaticOrgan:
    """Return the organ of a `geometry` on P2 cells that resolve its holes, E = 1 Pa."""
    k, a = case.refinement, case.footprint
    mesh = graded_block_structured(SIZE, Grading(SIZE[0], COARSEST * a / k, GROWTH ** (1.0 / k), a), case.places)
    body = tissue.elasticity(mesh, tissue.Material(1.0, POISSON, 1.0), "P2", ["bottom"])
    direction = "normal" if case.holes == "normal" else None
    sites = [tissue.Site(at, a, direction=direction) for at in case.places]
    return tissue.QuasiStaticOrgan(body, tissue.build_sites(body, sites))


@dataclass(frozen=True)
class Probe:
    """Where stress is taken: the recovery at the nodes, and the `points` of ball and ring from them, the ball's with
    `weights`."""

    recovery: tissue.StressRecovery
    points: csr_matrix
    weights: Array

    def tensors(self, U: Array) -> tuple[Array, Array]:
        """Return the mean stress below the exit `(1, 6)` and stress round the ring `(k, 6)` [Pa]."""
        values, count = np.asarray(self.points @ self.recovery.stress(U)), len(self.weights)
        return self.weights[None] @ values[:count], values[count:]


@lru_cache(maxsize=8)
def probe(case: Case, ring: float) -> Probe:
    """Return the exit's probe of a `geometry`."""
    body, (points, weights) = fine_organ(case).elasticity, ball_points(case)
    at = tissue.interpolation(body, np.vstack([points, ring_points(case, ring)]))
    return Probe(tissue.stress_recovery(body), at, weights)


def ball_points(case: Case) -> tuple[Array, Array]:
    """Return the points of the half ball below the exit `(k, 3)` [m], and their weights."""
    points, weights = half_ball()
    return case.places[1] + case.footprint * points, weights


def ring_points(case: Case, ring: float) -> Array:
    """Return the points of a ring about the exit, half a footprint below it, shape `(k, 3)` [m]."""
    angle = 2.0 * np.pi * (np.arange(ROUND) + 0.5) / ROUND
    circle = np.column_stack([ring * np.cos(angle), ring * np.sin(angle), np.full(ROUND, -0.5)])
    return np.asarray(case.places[1] + case.footprint * circle)


def stresses(case: Case, state: tissue.OrganState) -> dict[str, Any]:
    """Return the von Mises and principal stresses under the forces of a state, measured and in the half-space [Pa]."""
    shape = geometry(case)
    mean, ring = probe(shape, case.ring).tensors(fine_organ(shape).displacement(state))
    out = mean_stresses("mean", mean) | mean_stresses("ring", ring)
    theory = dict.fromkeys(THEORY, float("nan"))
    if case.depth == 0.0 and case.holes == "free":
        forces = state.f_y.reshape(2, 9)[:, :3]
        exact = case.theory.mean_stress(1, forces)[None], case.theory.stress(ring_points(case, case.ring), forces)
        known = mean_stresses("mean", flatten(exact[0])) | mean_stresses("ring", flatten(exact[1]))
        theory = {name: known[name.removeprefix("theory_")] for name in THEORY}
    return out | theory


def no_stresses() -> dict[str, Any]:
    """Return no stresses: the mesh for stress is linear."""
    return dict.fromkeys((*STRESSES, *THEORY), float("nan"))


def mean_stresses(where: str, stress: Array) -> dict[str, float]:
    """Return the means over points of the von Mises, the largest and the smallest principal stress of `(k, 6)` [Pa]."""
    xx, yy, zz, xy, yz, xz = stress.T
    matrix = np.moveaxis(np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]), 2, 0)
    principal = np.linalg.eigvalsh(matrix).mean(axis=0)
    return {
        f"{where}_von_mises": float(tissue.von_mises(stress).mean()),
        f"{where}_largest": float(principal[2]),
        f"{where}_smallest": float(principal[0]),
    }


def flatten(stress: Array) -> Array:
    """Return the tensors `(k, 3, 3)` as xx, yy, zz, xy, yz, xz, shape `(k, 6)`."""
    return np.column_stack([stress[:, i, j] for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (1, 2), (0, 2))])
