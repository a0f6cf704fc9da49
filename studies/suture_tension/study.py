"""Tension of a suture: how far it moves two holes of an organ, the stress around them, and where linear theory ends."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from studies.arrays import Array
from studies.figure import COLOURS, Item, curve, draw, laws, level, panel, series, several
from studies.simulation.remarks import coarse_spans
from studies.study import Job, Table, described, each, grouped, require, require_known
from studies.suture_tension.runs import KINDS, REFERENCE, SIZE, STRESSES, Row, last_step, run_tensions
from studies.verdicts import LINEAR, Verdict, not_settled, verdict

GIVEN = 0.4e-3  # by which the hand at the start gives way where there is friction, so that the thread slides [m]
CURVE = 41  # points of a curve
CLEAR = 2.0  # footprints from a hole inside to the surface, at least
MATERIAL_STEPS = 8  # load steps to a tension of a material
DEPARTURE = 0.05  # of the displacement by which the linear organ is off where its range ends
MILLI, KILO = 1e-3, 1e3

TISSUES = {  # E [Pa], its order of magnitude at small strain; a clinical tension [N] and where it is from
    # shear modulus 1.8 kPa (Phys. Med. Biol. 64 (2019) 225001)
    "liver": (6e3, 1.2, "0.27 MPa that tear liver on 10 mm × 0.45 mm; none was measured"),
    # biaxial, 180 to 307 kPa at low strain (Terry et al. 2014)
    "small bowel": (250e3, 4.62, "pull-out, Gong et al., J. Biomech. Eng. 2023"),
    # in vivo 0.1 to 1 MPa in plane (Geerligs 2011; Agache 1980)
    "skin": (
        500e3,
        1.1,
        "largest on closing a wound of 36 × 5 mm, Capek et al., Med. Biol. Eng. Comput. 50 (2012) 193",
    ),
    # assumed; 28 to 57 MPa from the line loads of Förstemann et al. (J. Biomech. 44 (2011) 600)
    "fascia": (10e6, 3.0, "running stitch, Horeman et al., PLoS ONE 8 (2013) e84466"),
}
MATERIALS: dict[str, dict[str, Any]] = {  # of one E and ν, which all of them have at small strain
    "linear": {},
    "neo-hookean": {"material": "neo-hookean"},
    "exponential, b = 1": {"material": "exponential", "stiffening": 1.0},
    "exponential, b = 5": {"material": "exponential", "stiffening": 5.0},
}
SOFT: dict[str, dict[str, Any]] = {  # ways to pull at an organ that is too soft for it
    "10 load steps": {"load_steps": 10},
    "40 load steps": {"load_steps": 40},
    "damped motion": {"way": "dynamic", "load_steps": 100},
}
QUANTITIES = {
    "exit_along": "displacement along",
    "exit_normal": "displacement normal",
    "mean_von_mises": "von Mises stress below the hole",
    "mean_largest": "largest principal stress below the hole",
    "ring_von_mises": "von Mises stress on the ring",
    "ring_largest": "largest principal stress on the ring",
    "ring_smallest": "smallest principal stress on the ring",
}
FORMAL = {"exit_along": 4.0, "exit_normal": 4.0} | dict.fromkeys(STRESSES, 2.0)  # orders of P2
EXIT: dict[str, Callable[[Array], float]] = {  # of what the holes of a half-space are displaced by
    "exit_along": lambda u: abs(u[1, 0]),
    "exit_normal": lambda u: abs(u[1, 1]),
}
VARIED: dict[str, Callable[[Row], str]] = {  # by sweep: what is written of its case
    "stiffness": lambda row: f"E = {row.youngs_modulus / KILO:g} kPa",
    "friction": lambda row: f"μ = {row.mu:g}",
    "distance": lambda row: f"ring of {row.ring:g} footprints",
    "bite width": lambda row: f"w = {row.bite / MILLI:g} mm",
    "bite depth": lambda row: f"c = {row.depth / MILLI:g} mm",
    "footprint": lambda row: f"a = {row.footprint / MILLI:g} mm",
    "cells": lambda row: f"h = {row.cells / MILLI:.3g} mm",
}


def main(
    tissues: Sequence[str] = tuple(TISSUES),
    tensions: Sequence[float] = (0.02, 0.2, 2.0, 5.0),
    moduli: Sequence[float] = (1e5, 2e5, 5e5, 2e6, 1e7),
    bites: Sequence[float] = (0.005, 0.0075, 0.01, 0.015, 0.02),
    depths: Sequence[float] = (0.0, 2e-3, 4e-3, 8e-3),
    footprints: Sequence[float] = (0.5e-3, 1e-3, 2e-3),
    mus: Sequence[float] = (0.0, 0.1, 0.2, 0.3, 0.4),
    distances: Sequence[float] = (1.5, 2.0, 3.0, 4.0),
    refinements: Sequence[float] = (1.5, 2.0, 2.5, 3.0),
    soft_ways: Sequence[str] = ("10 load steps", "40 load steps", "damped motion"),
    materials: Sequence[str] = tuple(MATERIALS),
    scaled_tensions: Sequence[float] = (0.4, 2.0),
    refinement: float = 1.5,
) -> Iterator[Row]:
    """Yield every load step of the tensions, by tissue or material and up to the first that fails; the last one of
    everything else. `scaled_tensions` are T/(E a²) of the materials.

    Raises `StudyError`.
    """
    known = ("tissues", tissues, TISSUES), ("soft_ways", soft_ways, SOFT), ("materials", materials, MATERIALS)
    for argument in known:
        require_known(*argument)
    above_zero = {"tensions": tensions, "moduli": moduli, "distances": distances, "scaled_tensions": scaled_tensions}
    for name, values in above_zero.items():
        require(min(values) > 0.0, f"{name} = {list(values)}", "give numbers above 0")
    fit = 4.0 * REFERENCE.footprint <= min(bites) and max(bites) <= 0.5 * SIZE[0]
    require(fit, f"bites = {list(bites)}", "give 4 footprints (4e-3) to half the block (0.04) [m]")
    fit = not any(0.0 < c < CLEAR * REFERENCE.footprint for c in depths) and max(depths) <= 0.5 * SIZE[2]
    require(fit, f"depths = {list(depths)}", "give 0 or 2 footprints (2e-3) to half the block [m]")
    fit = min(footprints) > 0.0 and max(footprints) <= 0.25 * REFERENCE.bite
    require(fit, f"footprints = {list(footprints)}", "give numbers above 0 to 2.5e-3 [m]")
    fit = len(set(refinements)) != 2 and min(refinements) >= 1.0
    require(fit, f"refinements = {list(refinements)}", "give one, or three for a verdict, none below 1")
    require(min(mus) >= 0.0 and max(mus) < 1.0, f"mus = {list(mus)}", "give coefficients from 0 to below 1")
    finest = max((refinement, *refinements))
    soft = {"suture": "2-0 polypropylene", "knots": "fixed", "holes": "normal", "tension": 0.5}
    soft |= {"youngs_modulus": TISSUES["liver"][0]}
    alone: dict[str, list[dict[str, Any]]] = {
        "stiffness": [{"youngs_modulus": E} for E in moduli],
        "friction": [{"mu": mu, "given": GIVEN} for mu in mus],
        "distance": [{"ring": r, "refinement": finest} for r in distances],
        "cells": [{"refinement": k} for k in sorted(refinements, reverse=True)],
        "bite width": [{"bite": w} for w in bites],
        "bite depth": [{"depth": c} for c in depths],
        "footprint": [{"footprint": a} for a in footprints],
        "direction": [{"name": holes, "holes": holes} for holes in ("free", "normal")],
        "soft organ": [{**soft, "name": name, **SOFT[name]} for name in soft_ways],
    }
    case = replace(REFERENCE, refinement=refinement)
    one = case.youngs_modulus * case.footprint**2
    pulled = [replace(case, sweep="tension", name=name, youngs_modulus=TISSUES[name][0]) for name in tissues]
    other = replace(case, sweep="material", load_steps=MATERIAL_STEPS)
    jobs: list[Job] = [partial(run_tensions, tissue, tensions) for tissue in pulled]
    jobs += [partial(last_step, replace(case, sweep=sweep, **new)) for sweep, cases in alone.items() for new in cases]
    for name in materials:
        material = replace(other, name=name, **MATERIALS[name])
        jobs.append(partial(run_tensions, material, [one * scaled for scaled in scaled_tensions]))
    yield from each(jobs)


# --- what was found ---------------------------------------------------------------------------------------


def case_text(row: Row) -> str:
    """Return a row's case, in words."""
    return row.name or VARIED[row.sweep](row)


def rows_of_sweep(rows: Sequence[Row], sweep: str) -> list[Row]:
    """Return the rows of a sweep."""
    return [row for row in rows if row.sweep == sweep]


def runs_by_tissue(rows: Sequence[Row]) -> dict[str, list[Row]]:
    """Return the load steps of the tensions by tissue, by load; the last may be one that failed."""
    by_name = grouped(rows_of_sweep(rows, "tension"), lambda row: row.name)
    return {name: steps for name, runs in by_name.items() if (steps := reached(runs))}


def reached(runs: Sequence[Row]) -> list[Row]:
    """Return load steps by load. A failed first step, the larger steps of a larger tension, has no numbers; it is
    reported with the last step that was reached."""
    loaded = sorted((row for row in runs if row.load > 0.0), key=lambda row: (row.load, bool(row.failed)))
    failed = [row.failed for row in runs if row.load == 0.0]
    if loaded and failed and not loaded[-1].failed:
        loaded.append(replace(loaded[-1], failed=failed[0]))
    return loaded


def runs_by_material(rows: Sequence[Row]) -> dict[str, list[Row]]:
    """Return the equilibria of each material by load."""
    runs = [row for row in rows_of_sweep(rows, "material") if not row.failed]
    return grouped(sorted(runs, key=lambda row: row.load), lambda row: row.name)


def triple(*values: float, unit: float = 1.0) -> str:
    """Write numbers in a unit."""
    return ", ".join(f"{value / unit:.4g}" for value in values)


def stress_cell(prefix: str) -> Callable[[Row], str]:
    """Return the writer of the measured or theoretical stresses of a place [kPa]."""
    kinds = KINDS[:2] if prefix.startswith("theory") else KINDS

    def cell(row: Row) -> str:
        values = [getattr(row, f"{prefix}_{kind}") for kind in kinds]
        return "none" if len(kinds) == 2 and np.isnan(values[0]) else triple(*values, unit=KILO)

    return cell


def row_verdict(row: Row) -> str:
    """Return the verdict on a row."""
    if row.failed:
        return f"FAILED: {row.failed.split(':')[0]}"
    if row.material != "linear":
        return "finite strain"
    return "linear" if row.is_linear else "BEYOND linear"


COLUMNS = (
    ("changed", lambda row: row.sweep),
    ("case", case_text),
    ("T [N]", lambda row: f"{row.load:.3g}"),
    ("u along [mm]", lambda row: triple(row.exit_along, unit=MILLI)),
    ("u normal [mm]", lambda row: triple(row.exit_normal, unit=MILLI)),
    ("half-space [mm]", lambda row: triple(row.theory_along, row.theory_normal, unit=MILLI)),
    ("u/a [-]", lambda row: f"{row.moved / row.footprint:.3g}"),
    ("approach [mm]", lambda row: triple(row.approach, unit=MILLI)),
    ("half-space [mm]", lambda row: triple(row.theory_approach, unit=MILLI)),
    ("drawn through [mm]", lambda row: triple(row.drawn, unit=MILLI)),
    ("theory [mm]", lambda row: triple(row.theory_drawn, unit=MILLI)),
    ("T held, between, pulled [N]", lambda row: triple(row.held, row.leaving, row.pulled)),
    ("theory [N]", lambda row: triple(*row.tensions(row.load))),
    ("force along, normal [N]", lambda row: triple(row.force_along, row.force_normal)),
    ("couple [N mm]", lambda row: f"{row.couple / MILLI:.3g}"),
    ("below: von Mises, σ₁, σ₃ [kPa]", stress_cell("mean")),
    ("half-space [kPa]", stress_cell("theory_mean")),
    ("ring: von Mises, σ₁, σ₃ [kPa]", stress_cell("ring")),
    ("half-space [kPa]", stress_cell("theory_ring")),
    ("T/(d ℓ E) [-]", lambda row: f"{row.bearing:.2g}"),
    ("verdict", row_verdict),
)


def table(rows: Sequence[Row]) -> Table:
    """Make a line a run, of tensions and materials the last load step of each."""
    last = [r for r in rows if r.sweep not in ("tension", "material") or r.failed or r.load == r.tension]
    return Table.of(COLUMNS, last)


def verdict_on(rows: Sequence[Row], quantity: str) -> Verdict:
    """Return the verdict on a quantity of the cells."""
    runs = rows_of_sweep(rows, "cells")
    return verdict([row.cells for row in runs], [getattr(row, quantity) for row in runs], FORMAL[quantity])


def departures(linear: Sequence[Row], runs: Sequence[Row]) -> Array:
    """Return by load the relative error of the linear organ's displacement against another material [-]; NaN beyond the
    linear organ's last load."""
    loads, moved = [row.load for row in linear], [row.exit_along for row in linear]
    same = np.interp([row.load for row in runs], [0.0, *loads], [0.0, *moved], right=np.nan)
    return np.asarray(same / [row.exit_along for row in runs] - 1.0)


def measured_range(linear: Sequence[Row], runs: Sequence[Row]) -> tuple[float, float]:
    """Return τ and u/a at which the error of the linear organ is DEPARTURE, infinite if it stays smaller."""
    off = np.abs(departures(linear, runs))
    if not np.any(off > DEPARTURE):
        return float("inf"), float("inf")
    end = int(np.argmax(off > DEPARTURE)) + 1
    steps = [0.0, *off[:end]]
    tau, moved = ([0.0, *(getattr(row, name) for row in runs[:end])] for name in ("scaled_load", "scaled_way"))
    return float(np.interp(DEPARTURE, steps, tau)), float(np.interp(DEPARTURE, steps, moved))


def measured_ranges(rows: Sequence[Row]) -> list[str]:
    """Say of each material where the linear organ of the same E, ν and cells is off, and by how much."""
    materials = runs_by_material(rows)
    linear = materials.pop("linear", [])
    out = []
    for name, runs in materials.items() if linear else ():
        tau, moved = measured_range(linear, runs)
        off, known = departures(linear, runs), [row.scaled_load for row in runs]
        last = int(np.flatnonzero(np.isfinite(off))[-1])
        where = f"at τ = T/(E a²) = {tau:.2g}, u/a = {moved:.2g}" if np.isfinite(tau) else "nowhere here"
        out.append(
            f"{name}: the linear organ is {DEPARTURE:.0%} off the hole's way {where} (assumed: u/a = {LINEAR}); at τ = "
            f"{known[last]:.3g} it is {off[last]:+.0%} off"
        )
    return out


def limits(runs: Sequence[Row]) -> tuple[float, float]:
    """List the tension at which the holes have moved by LINEAR footprints, infinite if they have not, and that at
    which the bearing strain T/(d ℓ E) is LINEAR [N]; below the first load step both are proportional."""
    loads, moved = [0.0, *(row.load for row in runs)], [0.0, *(row.moved / row.footprint for row in runs)]
    moving = float(np.interp(LINEAR, moved, loads)) if moved[-1] > LINEAR else float("inf")
    return moving, LINEAR * runs[0].load / runs[0].bearing


def ranges(rows: Sequence[Row]) -> list[str]:
    """Say by tissue: up to which tension theory is linear, and whether a clinical one is."""
    out = []
    for name, runs in runs_by_tissue(rows).items():
        moving, bearing = limits(runs)
        _, clinical, source = TISSUES[name]
        first = min(moving, bearing)
        how = f"BEYOND, {clinical / first:.2g} times" if clinical > first else "within"
        far = f"{moving:.2g} N" if np.isfinite(moving) else f"more than {runs[-1].load:g} N"
        out.append(
            f"{name}, E = {runs[0].youngs_modulus / KILO:g} kPa: a hole has moved by {LINEAR} footprints at {far}, "
            f"T/(d ℓ E) is {LINEAR} at {bearing:.2g} N; a clinical tension of {clinical:g} N ({source}) is {how}"
        )
    return out


def slopes(rows: Sequence[Row]) -> list[str]:
    """Return the small-tension slopes over those of the half-space, and the residual of C f = u."""
    small = [row for row in rows_of_sweep(rows, "tension") if row.is_linear and row.is_taut and not row.failed]
    out = []
    for way in ("along", "normal") if small else ():
        ratio = [100 * (getattr(row, f"exit_{way}") / getattr(row, f"theory_{way}") - 1.0) for row in small]
        spread = f"{min(ratio):+.2g} to {max(ratio):+.2g} %"
        out.append(f"linear range, taut thread: the exit moves {way} by {spread} of what it does in a half-space")
    for k, way in enumerate(("along", "normal")):
        block = getattr(rows[0], f"compliance_{way}") / rows[0].theory.compliance[k, k] - 1.0
        out.append(f"block and cells of the runs have {100 * block:+.2g} % of the half-space's compliance {way}")
    worst = max(row.residual for row in rows if row.material == "linear")
    return [*out, f"compliance times reported force is the reported displacement within {worst:.1g}"]


def over_theory(quantity: str, row: Row) -> float:
    """Return a quantity over its theoretical value, NaN if that is unknown."""
    return float(getattr(row, quantity) / getattr(row, f"theory_{quantity.removeprefix('exit_')}", float("nan")))


def convergence(rows: Sequence[Row]) -> list[str]:
    """Say of each quantity whether it converges on the cells, and how far the finest is off the half-space."""
    runs, out = rows_of_sweep(rows, "cells"), []
    if len({row.cells for row in runs}) < 3:
        return []
    finest = min(runs, key=lambda row: row.cells)
    for quantity, name in QUANTITIES.items():
        found = verdict_on(rows, quantity)
        off = over_theory(quantity, finest) - 1.0
        word = found.text if found.kind == "converged" else f"NOT CONVERGED ({found.text})"
        out.append(f"cells, {name}: {word}" + ("" if np.isnan(off) else f", {off:+.1%} off the half-space"))
    return out


def remarks(rows: Sequence[Row]) -> list[str]:
    """Return the ranges by tissue, slopes, verdicts on the cells, and the shortcomings of rows."""
    cells = convergence(rows)
    out = [*ranges(rows), *measured_ranges(rows), *slopes(rows), *cells, *sweep_errors(rows)]
    if not cells:
        out.append("cells: no ladder was run, so that no stress is SHOWN TO CONVERGE; the preset full has one")
    return list(dict.fromkeys([*out, *(line for row in rows for line in shortcomings(row))]))


def shortcomings(row: Row) -> list[str]:
    """Return the shortcomings of a row: failure, range, unrest, coarse cells."""
    name, out = f"{row.sweep}, {case_text(row)}, {row.load:.3g} N", []
    if row.failed:
        out.append(f"{name}: FAILED beyond, {row.failed}")
    elif row.sweep not in ("tension", "cells", "distance", "material") and not row.is_linear:
        out.append(f"{name}: {exceeded_limits(row)}")
    if row.gap < row.footprint and (row.failed or row.load == row.tension):
        where = f"the holes are {row.gap / row.footprint:.2g} footprints apart, of {row.bite / row.footprint:g}"
        out.append(f"{name}: {where}, and nothing keeps them apart: the MODEL ENDS there")
    if row.way == "dynamic":
        out += not_settled(name, row.kinetic, row.elastic)
    coarse = [] if row.failed else coarse_spans(row.span_ratio)
    return [*out, *(f"{name}: TOO COARSE, {said.message}" for said in coarse)]


def sweep_errors(rows: Sequence[Row]) -> list[str]:
    """Tell how far the stress of the sweeps is from that of the half-space under the same forces."""
    out = []
    runs = [row for row in rows if row.sweep not in ("cells", "distance") and np.isfinite(row.theory_ring_von_mises)]
    for where, words in (("mean", "below the hole"), ("ring", "on the ring")):
        pairs = [(getattr(row, f"{where}_von_mises"), getattr(row, f"theory_{where}_von_mises")) for row in runs]
        if off := [found / theory - 1.0 for found, theory in pairs if theory > 0.0]:
            cells = f"sweeps, cells of {runs[0].cells / MILLI:.2g} mm"
            out.append(f"{cells}: von Mises {words} {min(off):+.1%} to {max(off):+.1%} off the half-space")
    return out


def exceeded_limits(row: Row) -> str:
    """Say by which measures a row is beyond the linear range."""
    measures = {
        "a hole moved by {:.2g} footprints": row.moved / row.footprint,
        "the bearing strain is {:.2g}": row.bearing,
        "a hole's frame turned by {:.2g}": row.turn,
    }
    words = [text.format(value) for text, value in measures.items() if value > LINEAR]
    return f"{', '.join(words)}, BEYOND the linear range (about {LINEAR})"


# --- figure -----------------------------------------------------------------------------------------------


def figure(rows: Sequence[Row]) -> Figure:
    """Draw the displacement over tension, the same without dimension, stress over distance and cells, and each sweep
    compared with theory; last the linear organ and those at finite strain."""
    by_sweep, tissues, materials = grouped(rows, lambda row: row.sweep), runs_by_tissue(rows), runs_by_material(rows)
    named = {f"{name}, {runs[0].youngs_modulus / KILO:g} kPa": runs for name, runs in tissues.items()}
    last = {"fails beyond": [runs[-1] for runs in tissues.values() if runs[-1].failed]}
    clinical = [level("x", TISSUES[name][1], None, ":", of) for name, of in zip(tissues, COLOURS, strict=False)]
    loaded = [row for row in by_sweep["tension"] if row.load > 0.0]
    ends = np.array([min(row.scaled_load for row in loaded), max(row.scaled_load for row in loaded)])
    slope = loaded[0].theory_along / loaded[0].footprint / loaded[0].scaled_load
    known, footprint, small, tau = "half-space", rows[0].footprint, {"fontsize": 6}, "τ = T/(E a²) [-]"
    linear = level("y", LINEAR, f"{LINEAR} footprints")
    meet = level("y", 0.5 * rows[0].bite / footprint, "the holes meet", ":", "grey")
    cells = sorted(by_sweep["cells"], key=lambda row: row.cells)
    black = {"markers": ["*"], "colours": ["black"]}
    return draw(
        [
            panel(
                "tension T [N]", "displacement of a hole [mm]", series(named, "load", "moved [mm]", markersize=3),
                series(last, "load", "moved [mm]", "", markers=["x"], colours=["black"]), *clinical,
                level("y", LINEAR * footprint / MILLI, f"{LINEAR} footprints"), curve([], [], "clinical tension", ":"),
                log="xy", above=50.0, legend={"fontsize": 6, "loc": "upper left", "ncols": 2},
            ),
            panel(
                tau, "displacement along over a [-]", series(tissues, "scaled_load", "scaled_way", "", markersize=4),
                series({"E alone changed": by_sweep["stiffness"]}, "scaled_load", "scaled_way", "", **black),
                curve(ends, slope * ends, known), linear, meet, log="xy", legend=small,
            ),
        ],
        [
            panel(
                "distance from the hole [footprints]", "stress [kPa]", curve([], [], known),
                several(by_sweep["distance"], "ring", {
                    "von Mises": "ring_von_mises [kPa]", "largest principal": "ring_largest [kPa]",
                    "− smallest principal": lambda row: -row.ring_smallest / KILO,
                }, ""),
                several(by_sweep["distance"], "ring", {
                    "_von Mises": "theory_ring_von_mises [kPa]", "_largest": "theory_ring_largest [kPa]",
                }, markers=[""]), log="xy", ticks={"x": [row.ring for row in by_sweep["distance"]]},
            ),
            panel(
                "cells (V/N)^⅓ [mm]", "measured over half-space [-]", level("y", 1.0, known, "-"),
                several(cells, "cells [mm]", {
                    name: partial(over_theory, key) for key, name in QUANTITIES.items() if key != "ring_smallest"
                }), legend=small,
            ),
        ],
        [
            against_theory(by_sweep["bite width"], "bite", {"approach": lambda u: u[0, 0] - u[1, 0]}),
            against_theory(by_sweep["bite depth"], "depth", EXIT),
        ],
        [against_theory(by_sweep["footprint"], "footprint", EXIT, "xy"), over_friction(by_sweep["friction"])],
        [
            panel(
                tau, "u/a along [-]", series(materials, "scaled_load", "scaled_way", markersize=4), linear, meet,
                log="xy", legend=small,
            ),
            over_departure(materials, small),
        ],
    )  # fmt: skip


def against_theory(
    runs: Sequence[Row], name: str, quantities: Mapping[str, Callable[[Array], float]], log: str = ""
) -> Item:
    """Draw displacements over the varied quantity; lines are a half-space, from the depth at which holes are clear of
    the surface."""
    values, case = [getattr(row, name) / MILLI for row in runs], runs[0]
    least = CLEAR * case.footprint / MILLI if name == "depth" else min(values)
    over = np.linspace(least, max(*values, 2.0 * least * (name == "depth")), CURVE)

    def theory(of: Callable[[Array], float], at: Array) -> list[float]:
        changes: list[dict[str, Any]] = [{name: float(x) * MILLI} for x in at]
        return [of(replace(case, **new).displacements(case.tension)) / MILLI for new in changes]

    known = [partial(theory, of) for of in quantities.values()]
    return panel(
        f"{name} [mm]", "displacement [mm]",
        several(runs, f"{name} [mm]", {QUANTITIES.get(key, key): f"{key} [mm]" for key in quantities}, ""),
        laws(known, over), *([laws(known, np.zeros(1), "_")] if name == "depth" else []),
        curve([], [], "half-space"), log=log,
    )  # fmt: skip


def over_friction(runs: Sequence[Row]) -> Item:
    """Draw the tensions behind each hole over the pull."""
    mus, case = np.linspace(min(row.mu for row in runs), max(row.mu for row in runs), CURVE), runs[0]
    theory = np.array([replace(case, mu=float(mu)).tensions(1.0) for mu in mus])
    return panel(
        "friction μ [-]", "tension over the pull [-]",
        several(runs, "mu", {
            "between the holes": lambda row: row.leaving / row.load, "held": lambda row: row.held / row.load,
        }, ""),
        *(curve(mus, theory[:, k], None, "-", colour) for k, colour in zip((1, 0), COLOURS, strict=False)),
        curve([], [], "a thread that bends by 90° at each hole"), ylim=(0.0, 1.1),
    )  # fmt: skip


def over_departure(materials: Mapping[str, Sequence[Row]], small: Mapping[str, Any]) -> Item:
    """Draw how far the linear organ is off each of the others over u/a: where its range ends, measured."""
    linear, off = materials.get("linear", []), {}
    for name, runs in materials.items():
        if name != "linear":
            off[name] = list(zip([row.scaled_way for row in runs], 100.0 * departures(linear, runs), strict=True))
    return panel(
        "u/a of the material at finite strain [-]", "linear organ off by [%]", series(off, 0, 1, colours=COLOURS[1:]),
        *(level("y", 100.0 * end, None, ":") for end in (-DEPARTURE, DEPARTURE)),
        level("x", LINEAR, f"{LINEAR} footprints, assumed"),
        lambda axes: axes.set_yscale("symlog", linthresh=10.0), log="x", legend=small,
    )  # fmt: skip


STUDY = described("suture_tension", main, table, figure, remarks)
