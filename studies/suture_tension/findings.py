"""The findings: table, verdicts, ranges, and what the rows do not support."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from studies.arrays import Array
from studies.simulation.remarks import coarse_spans
from studies.study import Table
from studies.suture_tension.case import CLINICAL, DEPARTURE, FORMAL, KILO, MILLI, QUANTITIES, Row, theory_tensions
from studies.verdicts import LINEAR, Verdict, not_settled, verdict

VARIED = {  # by sweep: what is written of its case
    "stiffness": lambda row: f"E = {row.youngs_modulus / KILO:g} kPa",
    "friction": lambda row: f"μ = {row.mu:g}",
    "distance": lambda row: f"ring of {row.ring:g} footprints",
    "bite width": lambda row: f"w = {row.bite / MILLI:g} mm",
    "bite depth": lambda row: f"c = {row.depth / MILLI:g} mm",
    "footprint": lambda row: f"a = {row.footprint / MILLI:g} mm",
    "cells": lambda row: f"h = {row.cells / MILLI:.3g} mm",
}


def case_text(row: Row) -> str:
    """Write what a row's case is, in words."""
    return row.name or VARIED[row.sweep](row)


def rows_of_sweep(rows: Sequence[Row], sweep: str) -> list[Row]:
    """Return the rows of a sweep."""
    return [row for row in rows if row.sweep == sweep]


def runs_by_tissue(rows: Sequence[Row]) -> dict[str, list[Row]]:
    """Return the load steps of the tensions by tissue, by load; the last may be one that failed."""
    runs = rows_of_sweep(rows, "tension")
    by_name = {name: reached([row for row in runs if row.name == name]) for name in dict.fromkeys(x.name for x in runs)}
    return {name: steps for name, steps in by_name.items() if steps}


def reached(runs: Sequence[Row]) -> list[Row]:
    """Return load steps by load. What failed before its first one, the larger steps of a larger tension, has no numbers
    of its own: it is said of the last that was reached."""
    loaded = sorted((row for row in runs if row.load > 0.0), key=lambda row: (row.load, bool(row.failed)))
    failed = [row.failed for row in runs if row.load == 0.0]
    if loaded and failed and not loaded[-1].failed:
        loaded.append(replace(loaded[-1], failed=failed[0]))
    return loaded


def table(rows: Sequence[Row]) -> Table:
    """Make a line a run, of tensions and materials the last load step of each."""
    head = (
        "changed", "case", "T [N]", "u along [mm]", "u normal [mm]", "half-space [mm]", "u/a [-]", "approach [mm]",
        "half-space [mm]", "drawn through [mm]", "theory [mm]", "T held, between, pulled [N]", "theory [N]",
        "force along, normal [N]", "couple [N mm]", "below: von Mises, σ₁, σ₃ [kPa]", "half-space [kPa]",
        "ring: von Mises, σ₁, σ₃ [kPa]", "half-space [kPa]", "T/(d ℓ E) [-]", "verdict",
    )  # fmt: skip
    return Table(head, [line(row) for row in rows if shown(row)])


def shown(row: Row) -> bool:
    """Tell whether a row has a line: of several load steps the last."""
    return row.sweep not in ("tension", "material") or bool(row.failed) or row.load == row.tension


def line(row: Row) -> tuple[str, ...]:
    """Return the cells of a row."""
    mm, kPa, side = 1.0 / MILLI, 1.0 / KILO, theory_tensions(row, row.load)
    return (
        row.sweep,
        case_text(row),
        f"{row.load:.3g}",
        f"{row.exit_along * mm:.4g}",
        f"{row.exit_normal * mm:.4g}",
        f"{row.theory_along * mm:.4g}, {row.theory_normal * mm:.4g}",
        f"{row.moved / row.footprint:.3g}",
        f"{row.approach * mm:.4g}",
        f"{row.theory_approach * mm:.4g}",
        f"{row.drawn * mm:.4g}",
        f"{row.theory_drawn * mm:.4g}",
        f"{row.held:.4g}, {row.leaving:.4g}, {row.pulled:.4g}",
        f"{side[0]:.4g}, {side[1]:.4g}, {side[2]:.4g}",
        f"{row.force_along:.4g}, {row.force_normal:.4g}",
        f"{row.couple * mm:.3g}",
        f"{row.mean_von_mises * kPa:.4g}, {row.mean_largest * kPa:.4g}, {row.mean_smallest * kPa:.4g}",
        kilo_text(row.theory_mean_von_mises, row.theory_mean_largest),
        f"{row.ring_von_mises * kPa:.4g}, {row.ring_largest * kPa:.4g}, {row.ring_smallest * kPa:.4g}",
        kilo_text(row.theory_ring_von_mises, row.theory_ring_largest),
        f"{row.bearing:.2g}",
        row_verdict(row),
    )


def kilo_text(*values: float) -> str:
    """Write the numbers [k…], or that there are none."""
    return "none" if np.isnan(values[0]) else ", ".join(f"{value / KILO:.4g}" for value in values)


def row_verdict(row: Row) -> str:
    """Return what a row is worth."""
    if row.failed:
        return f"FAILED: {row.failed.split(':')[0]}"
    if row.material != "linear":
        return "finite strain"
    return "linear" if row.is_linear else "BEYOND linear"


def has_ladder(rows: Sequence[Row]) -> bool:
    """Tell whether there are cells enough for a verdict."""
    return len({row.cells for row in rows_of_sweep(rows, "cells")}) >= 3


def verdict_on(rows: Sequence[Row], quantity: str) -> Verdict:
    """Return the verdict on a quantity of the cells."""
    runs = rows_of_sweep(rows, "cells")
    return verdict([row.cells for row in runs], [getattr(row, quantity) for row in runs], FORMAL[quantity])


def runs_by_material(rows: Sequence[Row]) -> dict[str, list[Row]]:
    """Return the equilibria of each material by load."""
    runs = sorted((row for row in rows_of_sweep(rows, "material") if not row.failed), key=lambda row: row.load)
    return {name: [row for row in runs if row.name == name] for name in dict.fromkeys(row.name for row in runs)}


def departures(linear: Sequence[Row], runs: Sequence[Row]) -> Array:
    """Return by load how far the linear organ is off what a hole moves along in another material [-]; NaN beyond the
    linear organ's last load."""
    loads, moved = [row.load for row in linear], [row.exit_along for row in linear]
    same = np.interp([row.load for row in runs], [0.0, *loads], [0.0, *moved], right=np.nan)
    return np.asarray(same / [row.exit_along for row in runs] - 1.0)


def measured_range(linear: Sequence[Row], runs: Sequence[Row]) -> tuple[float, float]:
    """Return τ and u/a at which the linear organ is off by DEPARTURE, infinite where it is not that far."""
    off = np.abs(departures(linear, runs))
    if not np.any(off > DEPARTURE):
        return float("inf"), float("inf")
    end = int(np.argmax(off > DEPARTURE)) + 1
    steps = [0.0, *off[:end]]
    tau, moved = ([0.0, *(getattr(row, name) for row in runs[:end])] for name in ("scaled_load", "exit_along"))
    return float(np.interp(DEPARTURE, steps, tau)), float(np.interp(DEPARTURE, steps, moved)) / runs[0].footprint


def measured_ranges(rows: Sequence[Row]) -> list[str]:
    """Say of each material where the linear organ of the same E, ν, cells and springs is off, and by how much."""
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
            f"{known[last]:.3g} it is {off[last]:+.0%} off; springs of coarse cells are {runs[0].springs:.1%} of the "
            "compliance, in both"
        )
    return out


def limits(runs: Sequence[Row]) -> tuple[float, float]:
    """List the tension at which the holes have moved by LINEAR footprints, infinite where they have not, and that at
    which the bearing strain T/(d ℓ E) is LINEAR [N]; below the first load step both are proportional."""
    loads, moved = [0.0, *(row.load for row in runs)], [0.0, *(row.moved / row.footprint for row in runs)]
    moving = float(np.interp(LINEAR, moved, loads)) if moved[-1] > LINEAR else float("inf")
    return moving, LINEAR * runs[0].load / runs[0].bearing


def ranges(rows: Sequence[Row]) -> list[str]:
    """Say by tissue: up to which tension theory is linear, and whether a clinical one is."""
    out = []
    for name, runs in runs_by_tissue(rows).items():
        moving, bearing = limits(runs)
        clinical, source = CLINICAL[name]
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
    for way in ("along", "normal"):
        ratio = [getattr(row, f"exit_{way}") / getattr(row, f"theory_{way}") - 1.0 for row in small]
        if ratio:
            spread = f"{100 * min(ratio):+.2g} to {100 * max(ratio):+.2g} %"
            out.append(f"linear range, taut thread: the exit moves {way} by {spread} of what it does in a half-space")
    for way, k in (("along", 0), ("normal", 1)):
        block = getattr(rows[0], f"compliance_{way}") / rows[0].theory.compliance[k, k] - 1.0
        out.append(f"block and cells of the runs have {100 * block:+.2g} % of the half-space's compliance {way}")
    out.append(f"compliance times reported force is the reported displacement within {max_residual(rows):.1g}")
    return out


def max_residual(rows: Sequence[Row]) -> float:
    """Return the largest residual of C f = u of the linear organ."""
    return max(row.residual for row in rows if row.material == "linear")


def remarks(rows: Sequence[Row]) -> list[str]:
    """List the ranges by tissue, slopes, verdicts on the cells, and what is beyond, failed or not made up for."""
    out = [*ranges(rows), *measured_ranges(rows), *slopes(rows)]
    for quantity, name in QUANTITIES.items():
        if has_ladder(rows):
            found, off = verdict_on(rows, quantity), theory_error(rows, quantity)
            word = found.text if found.kind == "converged" else f"NOT CONVERGED ({found.text})"
            out.append(f"cells, {name}: {word}" + ("" if np.isnan(off) else f", {off:+.1%} off the half-space"))
    out += sweep_errors(rows)
    if not has_ladder(rows):
        out.append("cells: no ladder was run, so that no stress is SHOWN TO CONVERGE; the preset full has one")
    return list(dict.fromkeys([*out, *(line for row in rows for line in shortcomings(row))]))


def shortcomings(row: Row) -> list[str]:
    """Return what failed, is beyond, did not settle, is too coarse or not made up for in a row."""
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
    if not row.clear:
        out.append(f"{name}: NO SUB-GRID compliance could be added at a hole")
    coarse = [] if row.failed else coarse_spans(row.span_ratio)
    return [*out, *(f"{name}: TOO COARSE, {said.message}" for said in coarse)]


def sweep_errors(rows: Sequence[Row]) -> list[str]:
    """Tell how far the stress of the sweeps is from that of the half-space under the same forces."""
    runs = [row for row in rows if row.sweep not in ("cells", "distance") and np.isfinite(row.theory_ring_von_mises)]
    out = []
    for where, words in (("mean", "below the hole"), ("ring", "on the ring")):
        name = f"{where}_von_mises"
        known = [row for row in runs if getattr(row, f"theory_{name}") > 0.0]
        off = [getattr(row, name) / getattr(row, f"theory_{name}") - 1.0 for row in known]
        if off:
            spread = f"{min(off):+.1%} to {max(off):+.1%}"
            out.append(
                f"sweeps, cells of {runs[0].cells / MILLI:.2g} mm: von Mises {words} {spread} off the half-space"
            )
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


def theory_error(rows: Sequence[Row], quantity: str) -> float:
    """Return the finest cells' number over the half-space's, less 1; NaN where none is known."""
    finest = min(rows_of_sweep(rows, "cells"), key=lambda row: row.cells)
    theory = getattr(finest, f"theory_{quantity.removeprefix('exit_')}", float("nan"))
    return float(getattr(finest, quantity) / theory - 1.0)
