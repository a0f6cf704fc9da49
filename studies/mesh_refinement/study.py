"""Mesh refinement: the numbers of a pulled suture that converge.

They are compared for a bare point and for footprints. A suture passes two ideal holes of a
quasi-static block, one end is held, and a dead load pulls the other. Cells, element order, control
points, time step and footprint are refined one by one; cells, control points and time step also
together. Measured are the compliance of a hole along the surface and along its normal, and the
displacement of the entry. The force on the entry and the length drawn through the exit are also
measured. Each quantity of each ladder gets a verdict (`studies.verdicts`) from its three finest
runs.

A bare point has no limit: on meshes that are scaled copies its compliance is c/(E h) plus a
constant. A shrinking footprint has no limit either: its compliance is c/(E a).

*Theoretical order.* A compliance is an energy, wᵀA⁻¹w. Its error is the square of the error in the
energy norm: ∫ h²|u″|² for P1 and ∫ h⁴|u‴|² for P2. The weight w of a footprint has a kink at its
rim. At a distance r from it, u″ ~ log r and u‴ ~ 1/r. This gives h² for P1. For P2 every octave of
r between a and h adds the same amount. The error is then h⁴ ln(a/h), with the order 4 − 1/ln(a/h)
instead of 4. Displacements, forces and lengths are smooth functions of the compliances and have the
same order. A thread's moment has a kink at a hole, inside a span where the spline's moment is
linear: the energy error is h³ with a small factor. Backward Euler has order one, so the coupled
ladder refines spans like h and steps like h²: cells and steps are then both of order two.

Two effects are excluded, because they would hide these orders. Where the clamped bottom meets a
free side, the stress is infinite: strains like r^(λ−1) with sin²(λπ/2) = (4(1−ν)² − λ²)/(3−4ν)
(Williams 1952). At ν = 0.3, λ = 0.71 gives a small but persistent error of h^1.42. At ν = 0 the
stress is finite (λ = 1, uniaxial stress), so ν = 0. The second effect is an imposed direction of
the thread. The load of its couple jumps at the rim, so the order is two on both elements. The
factor depends on the cut of the rim by the cells. So the holes leave the direction free.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import product
from types import SimpleNamespace

import numpy as np
from matplotlib.figure import Figure

from coupling.reports.observation import site_compliance
from studies.arrays import MILLI
from studies.figure import COLOURS, MARKERS, Item, both, curve, described, draw, laws, panel, series, several, value
from studies.lists import study_list
from studies.simulation import prepare
from studies.study import Columns, Job, Table, each, grouped, measure, measured, require, scene, unit_field
from studies.verdicts import Verdict, beyond_linear, observed_order, too_coarse, verdict

LENGTH = 0.012  # of the block [m]
RAMP = 0.05  # of the pull in a dynamic run, which is evaluated at its end [s]
STATIC = 0.0  # time step in the table for an equilibrium
FOOTPRINT, CONTROL_POINTS, CELLS = 2e-3, 40, 16  # values that are not refined [m], [-], [per LENGTH]

DECADE = (1.0, 2.0, 5.0, 10.0, 20.0, 50.0)  # ticks [mm/N]
SPANS_PER_CELL, STEPS_PER_CELL = 2.5, 1 / 32  # of the coupled ladder: spans per cell, and steps per square of cells
# Theoretical orders; the coupled ladder has the lowest of its parts, P1 in h and backward Euler in
# Δt ~ h².
FORMAL = {"P1": 2.0, "control points": 3.0, "time step": 1.0, "footprint": 2.0, "coupled": 2.0}
QUANTITIES = study_list("mesh_refinement")["quantities"]  # words and unit
VARIANTS = ("bare point, P1", "footprint, P1", "footprint, P2")
FOOTPRINT_P1, FOOTPRINT_P2 = VARIANTS[1:]
FITTED = "cells refined to the footprint, P2"
ACCURACY = 0.02  # accuracy of these cells: nearly independent of the footprint


@dataclass(frozen=True, kw_only=True)
class Row:
    """One run of one ladder."""

    ladder: str
    variant: str
    cells: int = unit_field("per length of the block")
    footprint: float = unit_field("m")
    control_points: int = unit_field("-")
    dt: float = unit_field("s")  # 0: an equilibrium
    compliance_along: float = measured("m/N", lambda at: at.C[9, 9])
    compliance_normal: float = measured("m/N", lambda at: at.C[11, 11])
    displacement: float = measured("m", lambda at: np.linalg.norm(at.entry.displacement))
    force: float = measured("N", lambda at: np.linalg.norm(at.entry.force))
    drawn: float = measured("m", lambda at: at.exit.slip)

    @property
    def h(self) -> float:
        """Size of the cells [m]."""
        return LENGTH / self.cells

    @property
    def sizes(self) -> tuple[float, str]:
        """The refined size and its name.

        The size is a cell or a footprint [m], a time step [s], or one over the spans [-].
        """
        h = f"h = {self.h / MILLI:.3g} mm"
        return {
            "cells": (self.h, h),
            "coupled": (self.h, f"{h}, Δt = {self.dt / MILLI:.3g} ms"),
            "control points": (1.0 / (self.control_points - 3), f"{self.control_points} points"),
            "time step": (self.dt, f"Δt = {self.dt / MILLI:g} ms"),
            "footprint": (self.footprint, f"a = {self.footprint / MILLI:g} mm"),
        }[self.ladder]

    @property
    def size(self) -> float:
        """The refined size, in its unit."""
        return self.sizes[0]

    @property
    def size_text(self) -> str:
        """The refined size in words."""
        return self.sizes[1]


def main(
    p1_cells: Sequence[int] = (16, 24, 32, 48),
    footprint_cells: Sequence[int] = (32, 48, 64, 80),
    p2_cells: Sequence[int] = (16, 24, 32),
    coupled_cells: Sequence[int] = (24, 32, 48),
    control_points: Sequence[int] = (40, 80, 160),
    steps: Sequence[float] = (4e-3, 2e-3, 1e-3, 5e-4),
    footprints: Sequence[float] = (1e-3, 5e-4, 2.5e-4),
    youngs_modulus: float = 2e5,
) -> Iterator[Row]:
    """Yield every run.

    Cells are per length of the block and multiples of eight, so that all meshes are scaled copies
    around the holes. Raises `StudyError` for ladders without a possible verdict.
    """
    ladder_of: dict[str, Sequence[float]] = {"p1_cells": p1_cells, "footprint_cells": footprint_cells}
    ladder_of |= {"p2_cells": p2_cells, "coupled_cells": coupled_cells}
    check_ladders(ladder_of | {"control_points": control_points, "steps": steps, "footprints": footprints})
    run = partial(run_rung, youngs_modulus=youngs_modulus)
    jobs: list[Job] = []
    for variant, cells in zip(VARIANTS, (p1_cells, footprint_cells, p2_cells), strict=True):
        jobs += [partial(run, "cells", variant, cells=n) for n in cells]
    for n in coupled_cells:
        points, dt = round(SPANS_PER_CELL * n) + 3, RAMP / round(STEPS_PER_CELL * n**2)
        jobs.append(partial(run, "coupled", FOOTPRINT_P1, cells=n, control_points=points, dt=dt))
    jobs += [partial(run, "control points", FOOTPRINT_P2, control_points=n) for n in control_points]
    jobs += [partial(run, "time step", FOOTPRINT_P2, dt=dt) for dt in steps]
    jobs += [partial(run, "footprint", FITTED, footprint=a) for a in footprints]
    yield from each(jobs)


def check_ladders(ladder_of: Mapping[str, Sequence[float]]) -> None:
    """Refuse ladders with fewer than three levels, and meshes that are not scaled copies."""
    for name, rungs in ladder_of.items():
        shown = f"{name} = [{', '.join(f'{rung:g}' for rung in rungs)}]"
        require(len(set(rungs)) >= 3 and min(rungs) > 0, shown, "a verdict needs three different numbers above zero")
        copies = not name.endswith("cells") or not any(rung % 8 for rung in rungs)
        require(copies, shown, "only meshes of 8, 16, 24 … cells are scaled copies")


def run_rung(
    ladder: str,
    variant: str,
    *,
    youngs_modulus: float,
    cells: int = CELLS,
    footprint: float = FOOTPRINT,
    control_points: int = CONTROL_POINTS,
    dt: float = STATIC,
) -> Row:
    """Return one run, measured at its end."""
    radius = 0.0 if variant.startswith("bare") else footprint
    values: dict[str, object] = {"tissue.youngs_modulus": youngs_modulus, "thread.control_points": control_points}
    values |= {"tissue.element": variant[-2:], "tissue.mesh.h": LENGTH / cells}
    values |= {f"piercing.{hole}.footprint": radius for hole in ("entry", "exit")}
    if variant == FITTED:
        values["tissue.mesh.accuracy"] = ACCURACY
    if dt:
        values |= {"thread.end.ramp": RAMP, "solve": {"duration": RAMP, "dt": dt, "integrator": "euler"}}
    simulation = prepare(scene("mesh_refinement", values))
    C = site_compliance(simulation.assembly.system, simulation.start)
    *_, (record, _) = simulation.advance()
    entry, leave = record.piercings
    end = SimpleNamespace(C=C, entry=entry, exit=leave)
    known = {"ladder": ladder, "variant": variant, "cells": cells, "footprint": radius}
    return measure(Row, end, **known, control_points=control_points, dt=dt)


# --- verdicts ---------------------------------------------------------------------------------------------


def ladders(rows: Sequence[Row]) -> Iterator[tuple[str, str, list[Row]]]:
    """Yield the name, variant and runs of each ladder, finest first."""
    for (ladder, variant), runs in grouped(rows, lambda row: (row.ladder, row.variant)).items():
        yield ladder, variant, sorted(runs, key=lambda row: row.size)


def verdict_on(runs: Sequence[Row], quantity: str) -> Verdict:
    """Return the verdict on a quantity of one ladder."""
    return verdict([run.size for run in runs], [getattr(run, quantity) for run in runs], formal_order(runs))


def formal_order(runs: Sequence[Row]) -> float:
    """Return the theoretical order of a ladder.

    For P2 it is the order of h⁴ ln(a/h) on its three finest meshes.
    """
    if runs[0].ladder != "cells":
        return FORMAL[runs[0].ladder]
    if runs[0].variant != FOOTPRINT_P2:
        return FORMAL["P1"]
    h = np.array([run.size for run in runs[:3]])
    return observed_order(list(h), list(h**4 * np.log(FOOTPRINT / h)))


def expected_order(runs: Sequence[Row], quantity: str) -> str:
    """Return the theoretical order in words; −1 for numbers without a limit."""
    if runs[0].ladder == "footprint" or not runs[0].footprint:
        return "-1" if quantity.startswith("compliance") else "none"
    return f"{formal_order(runs):.3g}"


def verdict_text(runs: Sequence[Row], quantity: str) -> str:
    """Return the verdict in words.

    A number is not called converged if a compliance of its holes diverges.
    """
    found = verdict_on(runs, quantity)
    compliances = [name for name in QUANTITIES if name.startswith("compliance") and can_change(runs[0].ladder, name)]
    diverge = any(verdict_on(runs, name).kind == "diverging" for name in compliances)
    if diverge and found.kind in ("converged", "unresolved"):
        return "NOT CONVERGED, because its holes diverge"
    return found.text


def can_change(ladder: str, quantity: str) -> bool:
    """Return whether a ladder can change a quantity.

    The organ's compliance does not depend on the thread.
    """
    return ladder in ("cells", "footprint") or not quantity.startswith("compliance")


COLUMNS: Columns = (  # for a ladder's runs, a quantity and its verdict
    ("refined", lambda of: of[0][0].ladder),
    ("holes", lambda of: of[0][0].variant),
    ("finest", lambda of: of[0][0].size_text),
    ("quantity [its unit]", lambda of: "{} [{}]".format(*QUANTITIES[of[1]])),
    ("finest value [same]", lambda of: f"{getattr(of[0][0], of[1]) / MILLI:.4g}"),
    ("order [-]", lambda of: "swings" if np.isnan(of[2].order) else f"{of[2].order:.2f}"),
    ("of theory [-]", lambda of: expected_order(*of[:2])),
    ("limit [same]", lambda of: "none" if np.isnan(of[2].limit) else f"{of[2].limit / MILLI:.4g}"),
    ("index [%]", lambda of: f"{100.0 * of[2].index:.2g}" if np.isfinite(of[2].index) else "none"),
    ("verdict", lambda of: verdict_text(*of[:2])),
)


def table(rows: Sequence[Row]) -> Table:
    """Return the table with a line for every quantity of every ladder."""
    pairs = [(runs, quantity) for (_, _, runs), quantity in product(ladders(rows), QUANTITIES)]
    changing = [(runs, quantity) for runs, quantity in pairs if can_change(runs[0].ladder, quantity)]
    return Table.of(COLUMNS, [(runs, quantity, verdict_on(runs, quantity)) for runs, quantity in changing])


def remarks(rows: Sequence[Row]) -> Iterator[str]:
    """Yield the worst remarks of each ladder: cells too coarse, holes that moved too far."""
    for ladder, variant, runs in ladders(rows):
        name = f"{ladder}, {variant}"
        if runs[0].footprint == 0.0:
            yield f"{name}: strains next to the hole grow without bound, NO LINEAR RANGE"
            continue
        if variant != FITTED:
            coarse = max(runs, key=lambda run: LENGTH / run.cells / run.footprint)
            yield from too_coarse(f"{name}, {coarse.size_text}", LENGTH / coarse.cells, coarse.footprint)
        far = max(runs, key=lambda run: run.displacement / run.footprint)
        yield from beyond_linear(f"{name}, {far.size_text}", far.displacement, far.footprint)


# --- figure -----------------------------------------------------------------------------------------------


def figure(rows: Sequence[Row]) -> Figure:
    """Return the figure of all quantities over the cells, errors with orders, and other ladders."""
    cells = {variant: runs_of_ladder(rows, "cells", variant) for variant in VARIANTS}
    sizes = {"x": sorted({run.h / MILLI for run in rows if run.ladder == "cells"})}
    places = [
        panel(
            "cells h [mm]", f"{name} [{unit}]", series(cells, "h [mm]", f"{quantity} [{unit}]"),
            log="xy" if quantity.startswith("compliance") else "x",
            ticks=sizes | ({"y": DECADE} if quantity.startswith("compliance") else {}),
        )
        for quantity, (name, unit) in QUANTITIES.items()
    ]  # fmt: skip
    radii = runs_of_ladder(rows, "footprint", FITTED)
    a, (along, normal) = np.array([run.footprint for run in radii]) / MILLI, list(QUANTITIES)[:2]
    inverse = [lambda x, key=key: getattr(radii[0], key) / MILLI * a[0] / x for key in (along, normal)]
    limit, coupled = verdict_on(cells[FOOTPRINT_P2], along).limit, runs_of_ladder(rows, "coupled", FOOTPRINT_P1)
    together = [
        error_of(coupled, k, key, verdict_on(coupled, key).limit, name)
        for k, (key, (name, _)) in enumerate(QUANTITIES.items())
        if can_change("coupled", key)
    ]
    panels = described(
        "mesh_refinement",
        [
            several(radii, "footprint [mm]", {QUANTITIES[key][0]: f"{key} [mm/N]" for key in (along, normal)}),
            laws(inverse, a, ":"), curve([], [], "1/a", ":"), {"ticks": {"x": sorted(a), "y": DECADE}},
        ],
        [*(error_of(cells[name], k, along, limit, name) for k, name in enumerate(VARIANTS) if k), {"ticks": sizes}],
        [*together, {"ticks": {"x": sorted(run.h / MILLI for run in coupled)}}],
    )  # fmt: skip
    others = changes(rows, "control points", "control_points", "-"), changes(rows, "time step", "dt [ms]", "ms")
    return draw([*places, *panels, *others])


def error_of(runs: Sequence[Row], k: int, quantity: str, limit: float, name: str) -> Item:
    """Return the relative error of a quantity.

    A dotted line shows its theoretical order through the finest run.
    """
    h, error = np.array([run.h for run in runs]), abs(np.array([getattr(run, quantity) for run in runs]) / limit - 1.0)
    law = h**4 * np.log(FOOTPRINT / h) if runs[0].variant == FOOTPRINT_P2 else h**2
    measured = curve(h / MILLI, error, name, MARKERS[k], COLOURS[k])
    return both(measured, curve(h / MILLI, error[0] * law / law[0], None, ":", COLOURS[k]))


def changes(rows: Sequence[Row], ladder: str, x: str, unit: str) -> Item:
    """Return the panel of the changes of the quantities, relative to the finest run.

    They are shown over the refined size.
    """
    finest, *runs = runs_of_ladder(rows, ladder, FOOTPRINT_P2)
    off = {
        name: lambda run, key=key: abs(getattr(run, key) / getattr(finest, key) - 1.0)
        for key, (name, _) in QUANTITIES.items()
        if can_change(ladder, key)
    }
    at = sorted(value(x)(run) for run in runs)
    label = f"{ladder} [{unit}]"
    return panel(label, f"change to {finest.size_text} [-]", several(runs, x, off), log="xy", ticks={"x": at})


def runs_of_ladder(rows: Sequence[Row], ladder: str, variant: str) -> list[Row]:
    """Return the runs of a ladder, finest first."""
    return next(runs for *names, runs in ladders(rows) if names == [ladder, variant])
