"""Mesh refinement: which numbers of a pulled suture converge, with a bare point, a footprint and a sub-grid footprint.

A suture through two ideal holes of a quasi-static block, one end held, the other pulled by a dead load. Cells, element
order, control points, time step and footprint are refined each alone; cells, control points and time step together.
Measured are the compliance of a hole along the surface and along its normal, how far the entry moves, the force on it
and the length drawn through the exit. Every quantity of every ladder gets a verdict (`studies.verdicts`) from its
three finest runs.

A bare point has no limit: on meshes that are copies of one another its compliance is c/(E h) and a constant. So has
none a footprint that shrinks; its compliance is c/(E a).

The order of theory. A compliance is an energy, wᵀA⁻¹w, and errs by the square of the energy norm's error, ∫ h²|u″|² for
P1 and ∫ h⁴|u‴|² for P2. The weight w of a footprint has a kink at its rim, at a distance r of which u″ ~ log r and
u‴ ~ 1/r. That is h² for P1; for P2 the rim adds as much from every octave of r between a and h: h⁴ ln(a/h), the order
of which is 4 − 1/ln(a/h) and not 4. Displacements, forces and lengths are smooth functions of the compliances and
inherit their order; what the sub-grid footprint leaves to the mesh is smooth, h² with P1. A thread's moment kinks at a
hole, inside a span where the spline's is linear: h³ for its energy, with a small factor, for most of it is made up for
(`thread.compliance`). Backward Euler is of order one, so the coupled ladder takes spans like h and steps like h²: cells
and steps are then both of order two.

Two things are kept out because they would hide this. Where the clamped bottom meets a free side the stress is infinite
(strains like r^(λ−1) with sin²(λπ/2) = (4(1−ν)² − λ²)/(3−4ν), Williams 1952; λ = 0.71 at ν = 0.3, an error of h^1.42,
small but lasting); at ν = 0 it is not (λ = 1, uniaxial stress), so ν = 0. And the holes leave the thread its direction:
the couple of an imposed one has a load that jumps at the rim, so it is of order two on either element, with a factor
that depends on how the rim cuts the cells.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import product

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from coupling.reports.observation import site_compliance
from studies.figure import COLOURS, MARKERS, panels, ticks
from studies.scenario import Scenario, parse
from studies.simulation import prepare
from studies.study import Job, Study, StudyError, Table, each, unit_field
from studies.verdicts import Verdict, beyond_linear, observed_order, too_coarse, verdict

LENGTH, WIDTH, HEIGHT = 0.012, 6e-3, 3e-3  # of the block [m]
POISSON = 0.0  # at which no edge is singular
HALF = 3e-3  # of the distance of the holes [m]
PULL = 0.02  # [N]
DAMPING = 400.0  # of the thread [1/s]: what it stores in its bends is gone within the ramp
RAMP = 0.05  # of the pull in a dynamic run, at whose end it is looked at [s]
STATIC = 0.0  # time step of an equilibrium
FOOTPRINT, CONTROL_POINTS, CELLS = 2e-3, 40, 16  # what is not refined [m], [-], [per LENGTH]

MILLI = 1e-3
DECADE = (1.0, 2.0, 5.0, 10.0, 20.0, 50.0)  # ticks [mm/N]
SPANS_PER_CELL, STEPS_PER_CELL = 2.5, 1 / 32  # of the coupled ladder: spans over cells, steps over their square
# Orders of theory; the coupled ladder has that of its lowest parts, P1 in h and backward Euler in Δt ~ h².
FORMAL = {"P1": 2.0, "control points": 3.0, "time step": 1.0, "footprint": 2.0, "coupled": 2.0}
QUANTITIES = {
    "compliance_along": ("compliance along the surface", "mm/N"),
    "compliance_normal": ("compliance along the normal", "mm/N"),
    "displacement": ("displacement of the entry", "mm"),
    "force": ("force on the entry", "mN"),
    "drawn": ("length drawn through", "mm"),
}
VARIANTS = ("bare point, P1", "footprint, P1", "footprint, P2", "sub-grid footprint, P1")
BARE, FOOTPRINT_P1, FOOTPRINT_P2, SUBGRID = VARIANTS


@dataclass(frozen=True, kw_only=True)
class Row:
    """One run of one ladder."""

    ladder: str
    variant: str
    cells: int = unit_field("per length of the block")
    footprint: float = unit_field("m")
    control_points: int = unit_field("-")
    dt: float = unit_field("s")  # 0: an equilibrium
    compliance_along: float = unit_field("m/N")
    compliance_normal: float = unit_field("m/N")
    displacement: float = unit_field("m")
    force: float = unit_field("N")
    drawn: float = unit_field("m")
    clear: bool  # of what the sub-grid compliance does not reckon with

    @property
    def size(self) -> float:
        """What the ladder refines: cell or footprint [m], time step [s], or one over the spans [-]."""
        return {
            "cells": LENGTH / self.cells,
            "coupled": LENGTH / self.cells,
            "control points": 1.0 / (self.control_points - 3),
            "time step": self.dt,
            "footprint": self.footprint,
        }[self.ladder]

    @property
    def size_text(self) -> str:
        """The same in words."""
        return {
            "cells": f"h = {LENGTH / self.cells / MILLI:.3g} mm",
            "coupled": f"h = {LENGTH / self.cells / MILLI:.3g} mm, Δt = {self.dt / MILLI:.3g} ms",
            "control points": f"{self.control_points} points",
            "time step": f"Δt = {self.dt / MILLI:g} ms",
            "footprint": f"a = {self.footprint / MILLI:g} mm",
        }[self.ladder]


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
    """Yield every run. Cells are per length of the block and multiples of eight, so that all meshes are copies of one
    another about the holes. Raises `StudyError` for ladders that no verdict can be given on."""
    ladder_of: dict[str, Sequence[float]] = {"p1_cells": p1_cells, "footprint_cells": footprint_cells}
    ladder_of |= {"p2_cells": p2_cells, "coupled_cells": coupled_cells}
    check_ladders(ladder_of | {"control_points": control_points, "steps": steps, "footprints": footprints})
    run = partial(measure, youngs_modulus=youngs_modulus)
    jobs: list[Job] = []
    for variant, cells in zip(VARIANTS, (p1_cells, footprint_cells, p2_cells, p1_cells), strict=True):
        jobs += [partial(run, "cells", variant, cells=n) for n in cells]
    for n in coupled_cells:
        points, dt = round(SPANS_PER_CELL * n) + 3, RAMP / round(STEPS_PER_CELL * n**2)
        jobs.append(partial(run, "coupled", SUBGRID, cells=n, control_points=points, dt=dt))
    jobs += [partial(run, "control points", SUBGRID, control_points=n) for n in control_points]
    jobs += [partial(run, "time step", SUBGRID, dt=dt) for dt in steps]
    jobs += [partial(run, "footprint", SUBGRID, footprint=a) for a in footprints]
    yield from each(jobs)


def check_ladders(ladder_of: Mapping[str, Sequence[float]]) -> None:
    """Refuse ladders of fewer than three rungs, and meshes that are no copies of one another."""
    for name, rungs in ladder_of.items():
        shown = ", ".join(f"{rung:g}" for rung in rungs)
        if len(set(rungs)) < 3 or min(rungs) <= 0:
            raise StudyError(f"{name} = [{shown}] is refused: a verdict needs three different numbers above zero")
        if name.endswith("cells") and any(rung % 8 for rung in rungs):
            raise StudyError(
                f"{name} = [{shown}] is refused: only meshes of 8, 16, 24 … cells are copies of one another"
            )


def measure(
    ladder: str,
    variant: str,
    *,
    youngs_modulus: float,
    cells: int = CELLS,
    footprint: float = FOOTPRINT,
    control_points: int = CONTROL_POINTS,
    dt: float = STATIC,
) -> Row:
    """Measure one run at its last moment."""
    radius = 0.0 if variant.startswith("bare") else footprint
    simulation = prepare(scenario(variant, youngs_modulus, cells, radius, control_points, dt))
    C = site_compliance(simulation.assembly.system, simulation.start)
    *_, (record, _) = simulation.advance()
    entry, leave = record.piercings
    return Row(
        ladder=ladder,
        variant=variant,
        cells=cells,
        footprint=radius,
        control_points=control_points,
        dt=dt,
        compliance_along=float(C[9, 9]),
        compliance_normal=float(C[11, 11]),
        displacement=float(np.linalg.norm(entry.displacement)),
        force=float(np.linalg.norm(entry.force)),
        drawn=leave.slip,
        clear=all(gap["holds"] for gap in simulation.subgrid.values()),
    )


def scenario(
    variant: str,
    youngs_modulus: float,
    cells: int,
    footprint: float,
    control_points: int,
    dt: float,
) -> Scenario:
    """Make the scenario: a suture down into a block and up again, its start held, its end pulled along the block and
    up."""
    hole = {"direction": "free", "footprint": footprint, "subgrid": variant.startswith("sub-grid")}
    path = [[-0.02, 0.015], [-HALF, 5e-3], [-HALF, -2e-3], [HALF, -2e-3], [HALF, 5e-3], [0.02, 0.015]]
    still: dict[str, object] = {"kind": "static", "load_steps": 4}
    return parse(
        {
            "title": f"mesh refinement: {variant}",
            "tissue": {
                "youngs_modulus": youngs_modulus,
                "poisson_ratio": POISSON,
                "density": 1070.0,
                "inertia": False,
                "element": variant[-2:],
                "clamp": ["bottom"],
                "mesh": {"kind": "block", "size": [LENGTH, WIDTH, HEIGHT], "h": LENGTH / cells},
            },
            "thread": {
                "suture": "2-0 polypropylene",
                "control_points": control_points,
                "resolution": "fixed",
                "damping": DAMPING,
                "path": [[x, 0.0, z] for x, z in path],
                "start": {"kind": "fixed"},
                "end": {"kind": "pulled", "force": [0.8 * PULL, 0.0, 0.6 * PULL], "ramp": RAMP if dt else 0.0},
            },
            "piercing": [
                {"name": "entry", "at": [-HALF, 0.0, 0.0], **hole},
                {"name": "exit", "at": [HALF, 0.0, 0.0], **hole},
            ],
            "solve": {"duration": RAMP, "dt": dt, "integrator": "euler"} if dt else still,
        }
    )


# --- verdicts ---------------------------------------------------------------------------------------------


def ladders(rows: Sequence[Row]) -> Iterator[tuple[str, str, list[Row]]]:
    """Yield the name, variant and runs of each ladder, finest first."""
    for ladder, variant in dict.fromkeys((row.ladder, row.variant) for row in rows):
        runs = [row for row in rows if (row.ladder, row.variant) == (ladder, variant)]
        yield ladder, variant, sorted(runs, key=lambda row: row.size)


def verdict_on(runs: Sequence[Row], quantity: str) -> Verdict:
    """Return the verdict on a quantity of one ladder."""
    return verdict([run.size for run in runs], [getattr(run, quantity) for run in runs], formal_order(runs))


def formal_order(runs: Sequence[Row]) -> float:
    """Return the order of theory of a ladder; for P2 the one that h⁴ ln(a/h) shows on its three finest meshes."""
    if runs[0].ladder != "cells":
        return FORMAL[runs[0].ladder]
    if runs[0].variant != FOOTPRINT_P2:
        return FORMAL["P1"]
    h = np.array([run.size for run in runs[:3]])
    return observed_order(list(h), list(h**4 * np.log(FOOTPRINT / h)))


def expected_order(runs: Sequence[Row], quantity: str) -> str:
    """Write the order of theory in words: −1 of what has no limit."""
    if runs[0].ladder == "footprint" or not runs[0].footprint:
        return "-1" if quantity.startswith("compliance") else "none"
    return f"{formal_order(runs):.3g}"


def verdict_text(runs: Sequence[Row], quantity: str) -> str:
    """Write the verdict in words; nothing is called converged that hangs on a hole that diverges."""
    found = verdict_on(runs, quantity)
    compliances = [name for name in QUANTITIES if name.startswith("compliance") and can_change(runs[0].ladder, name)]
    if found.kind in ("converged", "unresolved") and any(
        verdict_on(runs, name).kind == "diverging" for name in compliances
    ):
        return "NOT CONVERGED, for its holes diverge"
    return found.text


def can_change(ladder: str, quantity: str) -> bool:
    """Tell whether a ladder can change a quantity: the organ's compliance knows no thread."""
    return ladder in ("cells", "footprint") or not quantity.startswith("compliance")


def table(rows: Sequence[Row]) -> Table:
    """Make one line for every quantity of every ladder."""
    head = (
        "refined",
        "holes",
        "finest",
        "quantity [its unit]",
        "finest value [same]",
        "order [-]",
        "of theory [-]",
        "limit [same]",
        "index [%]",
        "verdict",
    )
    lines = []
    for (ladder, variant, runs), quantity in product(ladders(rows), QUANTITIES):
        if not can_change(ladder, quantity):
            continue
        name, of = QUANTITIES[quantity]
        found, finest = verdict_on(runs, quantity), getattr(runs[0], quantity) / MILLI
        limit = "none" if np.isnan(found.limit) else f"{found.limit / MILLI:.4g}"
        index = f"{100.0 * found.index:.2g}" if np.isfinite(found.index) else "none"
        order = "swings" if np.isnan(found.order) else f"{found.order:.2f}"
        lines.append(
            (
                ladder,
                variant,
                runs[0].size_text,
                f"{name} [{of}]",
                f"{finest:.4g}",
                order,
                expected_order(runs, quantity),
                limit,
                index,
                verdict_text(runs, quantity),
            )
        )
    return Table(head, lines)


def remarks(rows: Sequence[Row]) -> list[str]:
    """List the worst of each ladder: cells too coarse, holes that moved too far, and where nothing makes up for it."""
    out = []
    for ladder, variant, runs in ladders(rows):
        name = f"{ladder}, {variant}"
        if runs[0].footprint == 0.0:
            out.append(f"{name}: strains beside the hole grow without bound, NO LINEAR RANGE")
            continue
        if "sub-grid" not in variant:
            coarse = max(runs, key=lambda run: LENGTH / run.cells / run.footprint)
            out += too_coarse(f"{name}, {coarse.size_text}", LENGTH / coarse.cells, coarse.footprint)
        far = max(runs, key=lambda run: run.displacement / run.footprint)
        out += beyond_linear(f"{name}, {far.size_text}", far.displacement, far.footprint)
        near = [run.size_text for run in runs if not run.clear]
        if near:
            out.append(f"{name}, {', '.join(near)}: NO SUB-GRID compliance could be added at a hole")
    return out


# --- figure -----------------------------------------------------------------------------------------------


def figure(rows: Sequence[Row]) -> Figure:
    """Draw every quantity over the cells and over the footprint, errors and the orders of theory, and what thread and
    time change."""
    drawing, grid = panels(5, 2)
    places = grid.ravel()
    for axes, quantity in zip(places[:5], QUANTITIES, strict=True):
        over_cells(axes, rows, quantity)
    places[0].legend()
    over_footprint(places[5], rows)
    errors(places[6], rows)
    errors_of_coupled_ladder(places[7], rows)
    changes(places[8], rows, "control points")
    changes(places[9], rows, "time step")
    return drawing


def over_cells(axes: Axes, rows: Sequence[Row], quantity: str) -> None:
    """Draw a quantity over the cells, one curve for each kind of hole."""
    for variant, colour, marker in zip(VARIANTS, COLOURS, MARKERS, strict=False):
        runs = runs_of_ladder(rows, "cells", variant)
        values = [getattr(run, quantity) / MILLI for run in runs]
        axes.plot([run.size / MILLI for run in runs], values, color=colour, marker=marker, label=variant)
    name, unit_of = QUANTITIES[quantity]
    axes.set(xscale="log", xlabel="cells h [mm]", ylabel=f"{name} [{unit_of}]")
    ticks(axes, "x", sorted({run.size / MILLI for run in rows if run.ladder == "cells"}))
    if quantity.startswith("compliance"):
        axes.set_yscale("log")
        ticks(axes, "y", DECADE)


def over_footprint(axes: Axes, rows: Sequence[Row]) -> None:
    """Draw the compliances over the footprint, and 1/a."""
    runs = runs_of_ladder(rows, "footprint", SUBGRID)
    a = np.array([run.size for run in runs]) / MILLI
    for quantity, colour, marker in zip(("compliance_along", "compliance_normal"), COLOURS, MARKERS, strict=False):
        values = np.array([getattr(run, quantity) for run in runs]) / MILLI
        axes.plot(a, values, color=colour, marker=marker, label=QUANTITIES[quantity][0])
        axes.plot(a, values[0] * a[0] / a, color="black", linestyle=":", label="1/a" if marker == "o" else None)
    axes.set(xscale="log", yscale="log", xlabel="footprint a [mm]", ylabel="compliance [mm/N]")
    ticks(axes, "x", sorted(a))
    ticks(axes, "y", DECADE)
    axes.legend()


def errors(axes: Axes, rows: Sequence[Row]) -> None:
    """Draw how far the compliance along the surface is from the limit of P2, and the orders of theory."""
    quantity = "compliance_along"
    limit = verdict_on(runs_of_ladder(rows, "cells", FOOTPRINT_P2), quantity).limit
    for k, variant in enumerate(VARIANTS[1:], 1):
        runs = runs_of_ladder(rows, "cells", variant)
        h = np.array([run.size for run in runs])
        error = abs(np.array([getattr(run, quantity) for run in runs]) / limit - 1.0)
        axes.plot(h / MILLI, error, color=COLOURS[k], marker=MARKERS[k], linestyle="none", label=variant)
        if variant != SUBGRID:
            law, name = (h**4 * np.log(FOOTPRINT / h), "h⁴ ln(a/h)") if variant == FOOTPRINT_P2 else (h**2, "h²")
            axes.plot(h / MILLI, error[0] * law / law[0], color=COLOURS[k], linestyle=":", label=name)
    axes.set(xscale="log", yscale="log", xlabel="cells h [mm]", ylabel="error of the compliance along the surface [-]")
    ticks(axes, "x", sorted({run.size / MILLI for run in rows if run.ladder == "cells"}))
    axes.legend(loc=(0.02, 0.18))


def errors_of_coupled_ladder(axes: Axes, rows: Sequence[Row]) -> None:
    """Draw how far the coupled ladder is from its limits."""
    runs = runs_of_ladder(rows, "coupled", SUBGRID)
    h = np.array([run.size for run in runs])
    quantities = [quantity for quantity in QUANTITIES if can_change("coupled", quantity)]
    for quantity, colour, marker in zip(quantities, COLOURS, MARKERS, strict=False):
        error = abs(np.array([getattr(run, quantity) for run in runs]) / verdict_on(runs, quantity).limit - 1.0)
        axes.plot(h / MILLI, error, color=colour, marker=marker, linestyle="none", label=QUANTITIES[quantity][0])
        law = error[0] * (h / h[0]) ** FORMAL["coupled"]
        axes.plot(h / MILLI, law, color="black", linestyle=":", label="order 2" if marker == "o" else None)
    axes.set(xscale="log", yscale="log", xlabel="cells h, with spans and steps [mm]", ylabel="error [-]")
    ticks(axes, "x", sorted(h / MILLI))
    axes.legend()


def changes(axes: Axes, rows: Sequence[Row], ladder: str) -> None:
    """Draw how far the quantities are from those of the finest run, over what is refined."""
    finest, *runs = runs_of_ladder(rows, ladder, SUBGRID)
    x = [run.control_points if ladder == "control points" else run.dt / MILLI for run in runs]
    quantities = [quantity for quantity in QUANTITIES if can_change(ladder, quantity)]
    for quantity, colour, marker in zip(quantities, COLOURS, MARKERS, strict=False):
        values = [abs(getattr(run, quantity) / getattr(finest, quantity) - 1.0) for run in runs]
        axes.plot(x, values, color=colour, marker=marker, label=QUANTITIES[quantity][0])
    label = "control points [-]" if ladder == "control points" else "time step [ms]"
    axes.set(xscale="log", yscale="log", xlabel=label, ylabel=f"change to {finest.size_text} [-]")
    ticks(axes, "x", sorted(x))
    axes.margins(y=0.4)
    axes.legend()


def runs_of_ladder(rows: Sequence[Row], ladder: str, variant: str) -> list[Row]:
    """Return the runs of a ladder, finest first."""
    return next(runs for *names, runs in ladders(rows) if names == [ladder, variant])


STUDY = Study(
    main=main,
    question="Which numbers of a pulled suture converge when cells, element, control points, step or footprint change?",
    independent="a bare point's compliance grows like 1/h, a footprint's like 1/a; a footprint's error falls like h² "
    "(P1) and h⁴ ln(a/h) (P2); backward Euler is of order one; with steps like h², all together is of order two",
    consistency="footprint on P2 against sub-grid footprint on P1, and each number against its own refinement",
    table=table,
    figure=figure,
    remarks=remarks,
    quick={
        "p1_cells": (16, 24, 32),
        "footprint_cells": (16, 24, 32, 48),
        "p2_cells": (16, 24, 32),
        "coupled_cells": (24, 32, 40),
        "steps": (2e-3, 1e-3, 5e-4),
    },
)
