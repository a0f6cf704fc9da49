"""Tension of a suture: the displacement of two holes, and the end of linear theory.

The stress below the holes is also measured. A thread comes down into one hole of a block, runs
below its surface to the other and up again. Its start is held, and a dead load T draws its end up.
In linear theory both holes are drawn up by T and towards each other by T. All results depend on
τ = T/(E a²), with the radius a of a footprint: one tissue with four materials gives the range of
any other.

Each parameter is changed alone from a reference case. It is a 3-0 braid under 0.1 N, in tissue of
0.5 MPa, without friction. The holes are 10 mm apart on the surface, with a footprint of 1 mm. The
bite's depth is the depth of the holes' centres. The model knows only where the tissue bears the
thread, so a deeper bite bears deeper (a ball instead of a disc). Stress is averaged over the half
ball below a hole, because a nodal maximum would grow with the mesh.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from types import SimpleNamespace

import numpy as np
from matplotlib.figure import Figure

import tissue
from coupling.reports.observation import site_compliance, site_forces
from studies.arrays import KILO, MILLI, Array
from studies.figure import described, draw, level, series
from studies.lists import sentences, study_list
from studies.scenario import Scenario
from studies.simulation import Simulation, prepare
from studies.simulation.memory import OrganRun
from studies.simulation.recording import step_record
from studies.simulation.remarks import coarse_spans
from studies.study import Job, Table, columns_of, each, grouped, measure, measured, require, scene, unit_field
from studies.theory import TwoHoles, half_ball
from studies.verdicts import LINEAR, bearing_strain, beyond_bearing, beyond_linear, verdict
from thread.catalogue import suture

SIZE = (0.07, 0.06, 0.03)  # of the block, held at its bottom [m]
POISSON = 0.45
THREAD = suture("3-0 polyglactin 910")
FOOTPRINT = 1e-3  # radius of a hole's averaging disc [m]
LEG, DIP = 0.03, 1e-3  # of the laid thread above the holes and below them [m]
COARSEST, GROWTH = 1.3, 3.0  # P2 cells at the holes over the footprint, and their growth; finer by a `refinement`
SIX = [0, 1, 2, 0, 1, 0], [0, 1, 2, 1, 2, 2]  # xx, yy, zz, xy, yz, xz of a tensor
DEPARTURE = 0.05  # relative error of the linear organ's displacement at the end of its range

TISSUES = study_list("suture_tension")["published"]
say = sentences(study_list("suture_tension")["words"])
MATERIALS = study_list("suture_tension")["materials"]  # with the same E and ν at small strain
VARIED = {"cells": "cells", "bite width": "bite", "bite depth": "depth"}  # field by sweep


@dataclass(frozen=True, kw_only=True)
class Case:
    """One run of a material."""

    sweep: str
    material: str = "linear"
    tension: float = unit_field("N", default=0.1)  # prescribed
    youngs_modulus: float = unit_field("Pa", default=500e3)
    bite: float = unit_field("m", default=0.01)
    depth: float = unit_field("m", default=0.0)  # of the holes' centres
    refinement: float = unit_field("-", default=0.0)  # of P2 cells; 0: cells refined to an accuracy

    @property
    def theory(self) -> TwoHoles:
        """The same holes in a half-space."""
        return TwoHoles(self.bite, self.depth, FOOTPRINT, self.youngs_modulus, POISSON)


@dataclass(frozen=True, kw_only=True)
class Row(Case):
    """One equilibrium. "along" is towards the other hole and "normal" out of the tissue."""

    load: float = measured("N", lambda at: at.load)  # load reached
    moved: float = measured("m", lambda at: np.linalg.norm(at.moved[:, :3], axis=1).max())  # largest displacement
    exit_along: float = measured("m", lambda at: -at.moved[1, 0])
    exit_normal: float = measured("m", lambda at: at.moved[1, 2])
    theory_along: float = measured("m", lambda at: -at.theory[1, 0])  # of the exit, in a half-space
    theory_normal: float = measured("m", lambda at: at.theory[1, 1])
    approach: float = measured("m", lambda at: at.moved[0, 0] - at.moved[1, 0])
    theory_approach: float = measured("m", lambda at: at.theory[0, 0] - at.theory[1, 0])
    stress: float = measured("Pa", lambda at: at.stress[0])  # von Mises, below the exit
    theory_stress: float = measured("Pa", lambda at: at.stress[1])
    cells: float = measured("m", lambda at: at.cells)  # (V/N)^⅓
    residual: float = measured("-", lambda at: at.residual)  # |C f − u| over |u|
    span_ratio: float = measured("-", lambda at: at.span_ratio)

    @property
    def scaled_load(self) -> float:
        """τ = T/(E a²)."""
        return self.load / (self.youngs_modulus * FOOTPRINT**2)

    @property
    def scaled_way(self) -> float:
        """Displacement of the exit along, in footprints."""
        return self.exit_along / FOOTPRINT

    @property
    def bearing(self) -> float:
        """T/(d ℓ E)."""
        return bearing_strain(self.load, THREAD.diameter, self.bite, self.youngs_modulus)

    @property
    def shortcomings(self) -> list[str]:
        """Limits that the row exceeds: loads beyond the linear range, coarse spans."""
        name = f"{self.sweep}, {case_text(self)}, {self.load:.3g} N"
        out = [f"{name}: TOO COARSE, {remark.message}" for remark in coarse_spans(self.span_ratio)]
        if self.material == "linear":
            out += [*beyond_linear(name, self.moved, FOOTPRINT), *beyond_bearing(name, self.bearing)]
        return out


QUANTITIES: dict[str, tuple[float, Callable[[Row], float], Callable[[Row], float]]] = {  # order of P2, here, theory
    "displacement along": (4.0, lambda row: row.exit_along, lambda row: row.theory_along),
    "displacement normal": (4.0, lambda row: row.exit_normal, lambda row: row.theory_normal),
    "von Mises stress below the hole": (2.0, lambda row: row.stress, lambda row: row.theory_stress),
}


def main(
    materials: Sequence[str] = tuple(MATERIALS),
    scaled_tensions: Sequence[float] = (0.4, 2.0),
    bites: Sequence[float] = (0.005, 0.0075, 0.01, 0.015, 0.02),
    depths: Sequence[float] = (0.0, 2e-3, 4e-3, 8e-3),
    refinements: Sequence[float] = (1.5, 2.0, 2.5, 3.0),
) -> Iterator[Row]:
    """Yield every load step of the materials, and the last steps of all other runs.

    Each material is loaded to each of the `scaled_tensions` T/(E a²). The materials use P2 cells of
    the first refinement. Raises `StudyError`.
    """
    case, few = Case(sweep="material", refinement=refinements[0]), len(set(refinements))
    known = "linear" in materials and set(materials) <= MATERIALS.keys()
    inside = all(c == 0.0 or 2e-3 <= c <= 0.015 for c in depths)
    for name, values, fit, remedy in (
        ("materials", materials, known, f"linear, and some of {'; '.join(MATERIALS)}"),
        ("scaled_tensions", scaled_tensions, min(scaled_tensions) > 0.0, "numbers above 0"),
        ("bites", bites, min(bites) >= 4e-3 and max(bites) <= 0.035, "4 footprints (4e-3) to 0.035 [m]"),
        ("depths", depths, inside, "0 or 2 footprints (2e-3) to 0.015 [m]"),
        ("refinements", refinements, few != 2 and min(refinements) >= 1.0, "one of 1 or more, or three for a verdict"),
    ):
        require(fit, f"{name} = {list(values)}", f"give {remedy}")
    scaled = [case.youngs_modulus * FOOTPRINT**2 * tau for tau in sorted(scaled_tensions)]
    jobs: list[Job] = [partial(run, Case(sweep="reference"))]
    jobs += [partial(run, replace(case, material=name, tension=T)) for name in materials for T in scaled]
    jobs += [partial(run, Case(sweep="cells", refinement=k)) for k in sorted(refinements, reverse=True)]
    jobs += [partial(run, Case(sweep="bite width", bite=w)) for w in bites]
    jobs += [partial(run, Case(sweep="bite depth", depth=c)) for c in depths]
    yield from each(jobs)


# --- runs -------------------------------------------------------------------------------------------------


def run(case: Case) -> Iterator[Row]:
    """Yield every load step of a material, or only the last step of another run."""
    simulation = prepare(scenario(case))
    now = simulation.beginning()
    while now.number < simulation.steps:
        now = simulation.next(now)
        if case.sweep == "material" or now.number == simulation.steps:
            yield row_of(case, simulation, now)


def scenario(case: Case) -> Scenario:
    """Return the scene with the values of a case."""
    x, bottom, k = 0.5 * case.bite, -case.depth - DIP, case.refinement
    values = {
        "tissue.youngs_modulus": case.youngs_modulus,
        "thread.path": [[-x, 0.0, LEG], [-x, 0.0, bottom], [x, 0.0, bottom], [x, 0.0, LEG]],
        "thread.start.waypoints": [[0.0, -x, 0.0, LEG]],
        "thread.end.force": [0.0, 0.0, case.tension],
        **dict(zip(("piercing.entry.at", "piercing.exit.at"), case.theory.places, strict=True)),
        **{f"tissue.{key}": value for key, value in MATERIALS[case.material].items()},
    }
    if k:
        values |= {"tissue.element": "P2", "tissue.mesh.h": SIZE[0], "tissue.mesh.accuracy": "given"}
        values |= {"tissue.mesh.h_site": COARSEST * FOOTPRINT / k, "tissue.mesh.growth": GROWTH ** (1.0 / k)}
    return scene("suture_tension", values | {"solve.load_steps": 8 if case.sweep == "material" else 4})


def row_of(case: Case, simulation: Simulation, now: OrganRun) -> Row:
    """Return the row of an equilibrium; its stress is for a linear organ on P2 cells, else NaN."""
    f, body = site_forces(now.system, now.state), simulation.assembly.body
    load, organ = case.tension * now.state.time / simulation.scenario.solve.duration, now.system.organ
    theory, stress = case.theory.displacements(load, load, load), np.full(2, np.nan)
    moved = now.state.y.ravel() - organ.y0
    off = site_compliance(now.system, now.state) @ f.ravel() - moved
    assert body is not None
    if case.refinement and isinstance(organ, tissue.QuasiStaticOrgan):
        ball, weights = half_ball()
        at = tissue.interpolation(body, case.theory.places[1] + FOOTPRINT * ball)
        nodal = tissue.stress_recovery(body).stress(organ.displacement(now.state.organ))
        stress = tissue.von_mises(np.array([weights @ (at @ nodal), case.theory.mean_stress(1, f[:, :3])[SIX]]))
    end = SimpleNamespace(
        load=load, moved=moved.reshape(2, 9), theory=theory, stress=stress, span_ratio=step_record(now).span_ratio,
        cells=(np.prod(SIZE) / body.mesh.nelements) ** (1.0 / 3.0),
        residual=np.linalg.norm(off) / np.linalg.norm(moved),
    )  # fmt: skip
    return measure(Row, end, **asdict(case))


# --- what was found ---------------------------------------------------------------------------------------


def varied(row: Row) -> float:
    """Return the changed parameter of a row [mm]."""
    return float(getattr(row, VARIED[row.sweep]) / MILLI)


def case_text(row: Row) -> str:
    """Return the change of a row in words."""
    return f"{VARIED[row.sweep]} = {varied(row):.3g} mm" if row.sweep in VARIED else row.material


def runs_by_material(rows: Sequence[Row]) -> dict[str, list[Row]]:
    """Return the equilibria of each material by load."""
    runs = sorted((row for row in rows if row.sweep == "material"), key=lambda row: row.load)
    return grouped(runs, lambda row: row.material)


def written(*values: float) -> str:
    """Return lengths [mm] as text."""
    return ", ".join(f"{value / MILLI:.4g}" for value in values)


def table(rows: Sequence[Row]) -> Table:
    """Return the table with a line for each run; a material has its last load step."""
    columns = columns_of(
        "suture_tension",
        case=case_text,
        here=lambda row: written(row.exit_along, row.exit_normal, row.approach),
        half_space=lambda row: written(row.theory_along, row.theory_normal, row.theory_approach),
        moved_over_footprint=lambda row: f"{row.moved / FOOTPRINT:.3g}",
    )
    return Table.of(columns, [row for row in rows if row.sweep != "material" or np.isclose(row.load, row.tension)])


def departures(linear: Sequence[Row], runs: Sequence[Row]) -> Array:
    """Return the relative error of the linear organ's displacement at each load of `runs` [-].

    NaN beyond the linear organ's last load.
    """
    loads, moved = [row.load for row in linear], [row.exit_along for row in linear]
    same = np.interp([row.load for row in runs], [0.0, *loads], [0.0, *moved], right=np.nan)
    return np.asarray(same / [row.exit_along for row in runs] - 1.0)


def measured_range(linear: Sequence[Row], runs: Sequence[Row]) -> tuple[float, float]:
    """Return τ and u/a at which the error of the linear organ is DEPARTURE.

    Infinite if the error stays smaller.
    """
    off = np.abs(departures(linear, runs))
    if not np.any(off > DEPARTURE):
        return float("inf"), float("inf")
    end = int(np.argmax(off > DEPARTURE)) + 1
    tau, moved = ([0.0, *(getattr(row, name) for row in runs[:end])] for name in ("scaled_load", "scaled_way"))
    return float(np.interp(DEPARTURE, [0.0, *off[:end]], tau)), float(np.interp(DEPARTURE, [0.0, *off[:end]], moved))


def measured_ranges(rows: Sequence[Row]) -> Iterator[str]:
    """Yield in words for each material the load at which the linear organ is wrong.

    Its error is added.
    """
    materials = runs_by_material(rows)
    linear = materials.pop("linear")
    for name, runs in materials.items():
        (tau, moved), off = measured_range(linear, runs), departures(linear, runs)
        last = int(np.flatnonzero(np.isfinite(off))[-1])
        where = f"at τ = T/(E a²) = {tau:.2g}, u/a = {moved:.2g}" if np.isfinite(tau) else "at no load here"
        known = {"departure": DEPARTURE, "linear": LINEAR, "tau": runs[last].scaled_load, "off": off[last]}
        yield say("range", name=name, where=where, **known)


def limits(row: Row, youngs_modulus: float) -> tuple[float, float]:
    """Return two limiting tensions [N] of a linear organ of modulus E [Pa].

    At the first, proportional, the holes have moved by LINEAR footprints. At the second the bearing
    strain T/(d ℓ E) is LINEAR.
    """
    moving = row.load * LINEAR * FOOTPRINT / row.moved * youngs_modulus / row.youngs_modulus
    return moving, LINEAR * THREAD.diameter * row.bite * youngs_modulus


def ranges(row: Row) -> Iterator[str]:
    """Yield in words for each tissue the range of linear theory.

    A clinical tension is compared with this range.
    """
    for name, of in TISSUES.items():
        moving, bearing = limits(row, of["youngs_modulus"])
        times = of["tension"] / min(moving, bearing)
        how = f"BEYOND, {times:.2g} times" if times > 1.0 else "within"
        known = {"E": of["youngs_modulus"] / KILO, "linear": LINEAR, "moving": moving, "bearing": bearing}
        yield say("clinical", name=name, of=of, how=how, **known)


def convergence(rows: Sequence[Row]) -> Iterator[str]:
    """Yield in words whether each quantity converges on the cells.

    Its deviation from the half-space is added.
    """
    runs = sorted((row for row in rows if row.sweep == "cells"), key=lambda row: row.cells)
    if len({row.cells for row in runs}) < 3:
        yield "cells: they were not refined, so no stress is SHOWN TO CONVERGE; use the preset full"
        return
    for name, (order, of, theory) in QUANTITIES.items():
        found = verdict([row.cells for row in runs], [of(row) for row in runs], order)
        word = found.text if found.kind == "converged" else f"NOT CONVERGED ({found.text})"
        yield f"cells, {name}: {word}, {of(runs[0]) / theory(runs[0]) - 1.0:+.1%} off the half-space"


def remarks(rows: Sequence[Row]) -> Iterator[str]:
    """Yield remarks on the ranges, the convergence on the cells, and exceeded limits."""
    worst = max(row.residual for row in rows if row.material == "linear")
    yield from (*ranges(rows[0]), *measured_ranges(rows), *convergence(rows))
    yield f"compliance times reported force equals the reported displacement within {worst:.1g}"
    yield from (line for row in rows if row.sweep != "material" for line in row.shortcomings)


# --- figure -----------------------------------------------------------------------------------------------


def figure(rows: Sequence[Row]) -> Figure:
    """Return the figure of displacement over tension, linear error, and single changes.

    The single changes are compared with theory.
    """
    materials = runs_by_material(rows)
    linear, changed = materials["linear"], grouped((row for row in rows if row.sweep in VARIED), lambda row: row.sweep)
    off = {name: [*zip(departures(linear, runs), runs, strict=True)] for name, runs in materials.items()}
    panels = described(
        "suture_tension",
        [
            series(materials, "scaled_load", "scaled_way"),
            series({"half-space": linear}, "scaled_load", lambda row: row.theory_along / FOOTPRINT, "--"),
            level(LINEAR, f"{LINEAR} footprints, assumed"),
        ],
        [
            series(off, lambda pair: pair[1].scaled_load, lambda pair: 100.0 * pair[0]),
            *(level(100.0 * end, None, ":") for end in (-DEPARTURE, DEPARTURE)),
        ],
        [level(1.0, None, "-"), series(changed, varied, lambda row: row.exit_along / row.theory_along)],
    )
    return draw(panels, 3)
