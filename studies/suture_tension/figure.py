"""The figure: displacement and stress over load, distance, cells, depth, footprint and friction."""

from collections.abc import Sequence
from dataclasses import asdict, fields, replace

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from studies.arrays import Array
from studies.figure import COLOURS, MARKERS, panels, ticks
from studies.suture_tension.case import (
    CLEAR,
    CLINICAL,
    CURVE,
    DEPARTURE,
    KILO,
    MILLI,
    QUANTITIES,
    Case,
    Row,
    theory_tensions,
)
from studies.suture_tension.findings import departures, rows_of_sweep, runs_by_material, runs_by_tissue
from studies.verdicts import LINEAR


def figure(rows: Sequence[Row]) -> Figure:
    """Draw the displacement over tension, the same without dimension, stress over distance and cells, and each sweep
    compared with theory; last the linear organ beside those at finite strain."""
    drawing, grid = panels(5, 2)
    over_load(grid[0, 0], rows)
    plot_scaled(grid[0, 1], rows)
    over_distance(grid[1, 0], rows)
    over_cells(grid[1, 1], rows)
    approaches(grid[2, 0], rows)
    over_depth(grid[2, 1], rows)
    over_footprint(grid[3, 0], rows)
    over_friction(grid[3, 1], rows)
    over_materials(grid[4, 0], rows)
    over_departure(grid[4, 1], rows)
    return drawing


def over_load(axes: Axes, rows: Sequence[Row]) -> None:
    """Draw how far the exit moved over the tension; crosses where no equilibrium was found, arrows at clinical
    tensions."""
    for (name, runs), colour, marker in zip(runs_by_tissue(rows).items(), COLOURS, MARKERS, strict=False):
        loads, label = [row.load for row in runs], f"{name}, {runs[0].youngs_modulus / KILO:g} kPa"
        axes.plot(loads, [row.moved / MILLI for row in runs], color=colour, marker=marker, markersize=3, label=label)
        if runs[-1].failed:
            axes.plot(runs[-1].load, runs[-1].moved / MILLI, "x", color=colour, markersize=10)
        axes.axvline(CLINICAL[name][0], color=colour, linestyle=":")
    axes.axhline(LINEAR * rows[0].footprint / MILLI, color="black", linestyle="--", label=f"{LINEAR} footprints")
    axes.plot([], [], "x", color="black", markersize=10, label="fails beyond")
    axes.plot([], [], color="black", linestyle=":", label="clinical tension")
    axes.set(xscale="log", yscale="log", xlabel="tension T [N]", ylabel="displacement of a hole [mm]")
    axes.set_ylim(top=50.0 * axes.get_ylim()[1])
    axes.legend(fontsize=6, loc="upper left", ncols=2)


def plot_scaled(axes: Axes, rows: Sequence[Row]) -> None:
    """Draw u/a over T/(E a²): one curve for all stiffnesses as long as theory is linear and the thread taut."""
    for (name, runs), colour, marker in zip(runs_by_tissue(rows).items(), COLOURS, MARKERS, strict=False):
        x = [row.scaled_load for row in runs]
        axes.plot(x, [row.exit_along / row.footprint for row in runs], marker, color=colour, markersize=4, label=name)
    runs = rows_of_sweep(rows, "stiffness")
    x = [row.scaled_load for row in runs]
    axes.plot(x, [row.exit_along / row.footprint for row in runs], "*", color="black", label="E alone changed")
    every = [row for row in rows_of_sweep(rows, "tension") if row.load > 0.0]
    ends = np.array([min(row.scaled_load for row in every), max(row.scaled_load for row in every)])
    slope = every[0].theory_along / every[0].footprint / every[0].scaled_load
    axes.plot(ends, slope * ends, color="black", label="half-space")
    axes.axhline(LINEAR, color="black", linestyle="--")
    axes.axhline(0.5 * rows[0].bite / rows[0].footprint, color="grey", linestyle=":", label="the holes meet")
    axes.set(xscale="log", yscale="log", xlabel="T/(E a²) [-]", ylabel="displacement along over a [-]")
    axes.legend(fontsize=6)


def over_distance(axes: Axes, rows: Sequence[Row]) -> None:
    """Draw the stress round a ring over its radius; lines are Cerruti's and Boussinesq's solutions."""
    runs = rows_of_sweep(rows, "distance")
    x = [row.ring for row in runs]
    for name, colour, marker in (("von_mises", COLOURS[0], "o"), ("largest", COLOURS[1], "s")):
        label = {"von_mises": "von Mises", "largest": "largest principal"}[name]
        axes.plot(x, [getattr(row, f"ring_{name}") / KILO for row in runs], marker, color=colour, label=label)
        axes.plot(x, [getattr(row, f"theory_ring_{name}") / KILO for row in runs], color=colour)
    axes.plot(x, [-row.ring_smallest / KILO for row in runs], "^", color=COLOURS[2], label="− smallest principal")
    axes.plot([], [], color="black", label="half-space")
    axes.set(xscale="log", yscale="log", xlabel="distance from the hole [footprints]", ylabel="stress [kPa]")
    ticks(axes, "x", x)
    axes.legend()


def over_cells(axes: Axes, rows: Sequence[Row]) -> None:
    """Draw the displacement and stress of the mesh for stress over its cells, each over theory."""
    runs = sorted(rows_of_sweep(rows, "cells"), key=lambda row: row.cells)
    quantities = ("exit_along", "exit_normal", "mean_von_mises", "mean_largest", "ring_von_mises", "ring_largest")
    for quantity, colour, marker in zip(quantities, COLOURS, MARKERS, strict=True):
        theory = [getattr(row, f"theory_{quantity.removeprefix('exit_')}") for row in runs]
        ratio = [getattr(row, quantity) / value for row, value in zip(runs, theory, strict=True)]
        axes.plot([row.cells / MILLI for row in runs], ratio, color=colour, marker=marker, label=QUANTITIES[quantity])
    axes.axhline(1.0, color="black", label="half-space")
    axes.set(xlabel="cells (V/N)^⅓ [mm]", ylabel="measured over half-space [-]")
    axes.legend(fontsize=6)


def approaches(axes: Axes, rows: Sequence[Row]) -> None:
    """Draw the approach of the holes over the bite."""
    runs = rows_of_sweep(rows, "bite width")
    axes.plot([row.bite / MILLI for row in runs], [row.approach / MILLI for row in runs], "o", label="measured")
    bites = np.linspace(min(row.bite for row in runs), max(row.bite for row in runs), CURVE)
    cases = [replace(case_of(runs[0]), bite=float(bite)) for bite in bites]
    theory = [np.ptp(theory_displacements(case)[:, 0]) / MILLI for case in cases]
    axes.plot(bites / MILLI, theory, color="black", label="half-space")
    axes.set(xlabel="bite [mm]", ylabel="approach of the holes [mm]")
    axes.legend()


def over_depth(axes: Axes, rows: Sequence[Row]) -> None:
    """Draw the displacement of the exit over its depth: discs on the surface, balls below it."""
    runs = rows_of_sweep(rows, "bite depth")
    deepest = max(row.depth for row in runs)
    below_surface = np.linspace(CLEAR * runs[0].footprint, max(deepest, 2.0 * CLEAR * runs[0].footprint), CURVE)
    plot_exit(axes, runs, "depth", below_surface, "depth of the holes [mm]")
    for k, colour in ((0, COLOURS[0]), (1, COLOURS[1])):
        disc = abs(theory_displacements(replace(case_of(runs[0]), depth=0.0))[1, k])
        axes.plot(0.0, disc / MILLI, "_", color=colour, markersize=20)


def over_footprint(axes: Axes, rows: Sequence[Row]) -> None:
    """Draw the displacement of the exit over the footprint."""
    runs = rows_of_sweep(rows, "footprint")
    radii = np.geomspace(min(row.footprint for row in runs), max(row.footprint for row in runs), CURVE)
    plot_exit(axes, runs, "footprint", radii, "footprint [mm]")
    axes.set(xscale="log", yscale="log")
    ticks(axes, "x", [row.footprint / MILLI for row in runs])
    ticks(axes, "y", (0.05, 0.1, 0.2, 0.3))


def plot_exit(axes: Axes, runs: Sequence[Row], name: str, values: Array, label: str) -> None:
    """Draw the displacement of the exit, along and normal, and lines of theory at `values` of what was changed."""
    x = [getattr(row, name) / MILLI for row in runs]
    cases = [Case(**(asdict(case_of(runs[0])) | {name: float(value)})) for value in values]
    theory = np.array([np.abs(theory_displacements(case)[1]) for case in cases])
    for k, (way, colour, marker) in enumerate(zip(("along", "normal"), COLOURS, MARKERS, strict=False)):
        axes.plot(x, [getattr(row, f"exit_{way}") / MILLI for row in runs], marker, color=colour, label=way)
        axes.plot(values / MILLI, theory[:, k] / MILLI, color=colour)
    axes.plot([], [], color="black", label="half-space")
    axes.set(xlabel=label, ylabel="displacement of the exit [mm]")
    axes.legend()


def case_of(row: Row) -> Case:
    """Return what was run."""
    return Case(**{f.name: getattr(row, f.name) for f in fields(Case)})


def theory_displacements(case: Case) -> Array:
    """Return (x, z) of entry and exit in a half-space under the whole tension, shape `(2, 2)` [m]."""
    return case.theory.displacements(*theory_tensions(case, case.tension))


def over_friction(axes: Axes, rows: Sequence[Row]) -> None:
    """Draw the tensions behind each hole over the pull."""
    runs = rows_of_sweep(rows, "friction")
    x = [row.mu for row in runs]
    for name, words, colour, marker in (
        ("leaving", "between the holes", COLOURS[0], "o"),
        ("held", "held", COLOURS[1], "s"),
    ):
        axes.plot(x, [getattr(row, name) / row.load for row in runs], marker, color=colour, label=words)
    mus = np.linspace(min(x), max(x), CURVE)
    theory = np.array([theory_tensions(replace(case_of(runs[0]), mu=float(mu)), 1.0) for mu in mus])
    for k, colour in ((1, COLOURS[0]), (0, COLOURS[1])):
        axes.plot(mus, theory[:, k], color=colour)
    axes.plot([], [], color="black", label="a thread that bends by 90° at each hole")
    axes.set(xlabel="friction μ [-]", ylabel="tension over the pull [-]", ylim=(0.0, 1.1))
    axes.legend()


def over_materials(axes: Axes, rows: Sequence[Row]) -> None:
    """Draw u/a over τ of the linear organ and of those at finite strain, on the same cells."""
    for (name, runs), colour, marker in zip(runs_by_material(rows).items(), COLOURS, MARKERS, strict=False):
        x, y = [row.scaled_load for row in runs], [row.exit_along / row.footprint for row in runs]
        axes.plot(x, y, color=colour, marker=marker, markersize=4, label=name)
    axes.axhline(LINEAR, color="black", linestyle="--", label=f"{LINEAR} footprints")
    axes.axhline(0.5 * rows[0].bite / rows[0].footprint, color="grey", linestyle=":", label="the holes meet")
    axes.set(xscale="log", yscale="log", xlabel="τ = T/(E a²) [-]", ylabel="u/a along [-]")
    axes.legend(fontsize=6)


def over_departure(axes: Axes, rows: Sequence[Row]) -> None:
    """Draw how far the linear organ is off each of the others over u/a: where its range ends, measured."""
    materials = runs_by_material(rows)
    linear = materials.pop("linear", [])
    for (name, runs), colour, marker in zip(materials.items(), COLOURS[1:], MARKERS[1:], strict=False):
        x = [row.exit_along / row.footprint for row in runs]
        axes.plot(x, 100.0 * departures(linear, runs), color=colour, marker=marker, markersize=4, label=name)
    for level in (-DEPARTURE, DEPARTURE):
        axes.axhline(100.0 * level, color="black", linestyle=":")
    axes.axvline(LINEAR, color="black", linestyle="--", label=f"{LINEAR} footprints, assumed")
    axes.set(xscale="log", xlabel="u/a of the material at finite strain [-]", ylabel="linear organ off by [%]")
    axes.set_yscale("symlog", linthresh=10.0)
    axes.legend(fontsize=6)
