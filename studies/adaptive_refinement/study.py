"""Adaptive refinement: the error of a hole's compliance over unknowns and over seconds.

The accuracy of the estimated error is also shown. There is one hole in a clamped block. The cases
are several footprints, a hole near an edge, a skin, and a wall. The skin is half a footprint thick,
and the wall one footprint. The skin is 20 times or a tenth as stiff as the tissue below. The
compliance to forces is computed on three kinds of meshes, by linear and by quadratic cells:

- uniform: structured, of one size;
- graded: structured, with a size at the hole that is a share of the footprint, growing away from
  it;
- adaptive: a coarse mesh, refined until the estimated error is within `tissue.mesh.accuracy`.

The error is taken in the direction in which it is largest. The reference is an adaptive mesh of
quadratic cells, finer than all others, plus its own estimated error.

*Theoretical order.* By Galerkin the error of a compliance is the energy of the error of its column.
Under a parabolic footprint this is h⁴ ln(a/h) for P2 and h² for P1 (`studies.mesh_refinement`). On
meshes that are fine only where necessary, N unknowns give N^(−4/3) and N^(−2/3), independent of
edges and borders.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from time import perf_counter
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

import tissue
from studies.arrays import MILLI
from studies.figure import Item, draw, level, panel, series, unnamed
from studies.lists import study_list
from studies.simulation.assembly import assemble, site_of
from studies.study import Table, columns_of, each, grouped, require, require_known, scene, unit_field
from tissue.refinement.estimate import estimate

A = 1e-3  # footprint of the cases with one footprint [m]
LENGTH = 0.04  # of the block [m]
ASKED = 0.03  # error at which meshes are compared: the default of tissue.mesh.accuracy
EFFECTIVITY = 0.7, 1.5  # allowed range of the estimate over the error
FAR = 8e-3  # size of graded and adaptive cells far from the hole [m]
GROWTH = 2.0  # of graded cells: a smaller growth gives more cells where they are long and thin
UNIFORM, GRADED, ADAPTIVE = "uniform", "graded", "adaptive"
ERROR = "error of the compliance [-]"
SHARES = (0.01, 0.02, 0.05, 0.1, 0.2, 0.5)  # ticks
TICKS = {"x": (2.0, 5.0, 10.0, 20.0, 50.0)}
Settings = dict[str, Any]
CASES: dict[str, Settings] = study_list("adaptive_refinement")["cases"]  # keys of the scene


@dataclass(frozen=True, kw_only=True)
class Row:
    """One mesh; `size` is the size of the cells, or of the cells at the hole, or an accuracy."""

    case: str
    footprint: float = unit_field("m")
    element: str
    mesh: str
    size: float = unit_field("m, or - of adaptive ones")
    unknowns: int = unit_field("-")
    seconds: float = unit_field("s")
    normal: float = unit_field("m/N")
    error: float = unit_field("-")
    estimate: float = unit_field("-")

    @property
    def kind(self) -> str:
        """Mesh and element."""
        return f"{self.mesh}, {self.element}"

    @property
    def effectivity(self) -> float:
        """The estimate over the error [-]."""
        return self.estimate / self.error


def main(
    footprints: Sequence[float] = (2e-3, 1e-3, 5e-4, 2.5e-4),
    cases: Sequence[str] = tuple(CASES),
    elements: Sequence[str] = ("P1", "P2"),
    uniform: Sequence[float] = (4e-3, 2.5e-3, 2e-3),
    graded: Sequence[float] = (1.0, 0.5, 0.25),
    accuracies: Sequence[float] = (0.2, 0.1, 0.05, 0.02),
    reference: float = 0.004,
) -> Iterator[Row]:
    """Yield every mesh of every case.

    `footprints` [m] are in the middle of the block, `cases` are names. Sizes of uniform cells are
    in [m], sizes of graded cells are at the hole over the footprint. Raises `StudyError`.
    """
    require_known("cases", cases, CASES)
    require_known("elements", elements, ("P1", "P2"))
    inside = all(0.0 < a <= 0.1 * LENGTH for a in footprints)
    require(inside, "footprints", "give 0 to 4e-3")
    require(1e-3 <= reference < 0.5 * min(accuracies), f"reference = {reference:g}", "give less than half an accuracy")
    every: dict[str, tuple[float, Settings]] = {f"footprint {a / MILLI:g} mm": (a, {}) for a in footprints}
    every |= {name: (A, CASES[name]) for name in cases}
    sizes = {UNIFORM: uniform, GRADED: graded, ADAPTIVE: accuracies}
    yield from each([partial(run_case, name, *case, elements, sizes, reference) for name, case in every.items()])


def run_case(
    name: str, a: float, keys: Settings, elements: Sequence[str], sizes: Mapping[str, Sequence[float]], reference: float
) -> Iterator[Row]:
    """Yield the meshes of a case, with errors relative to its reference."""
    keys = {"piercing.hole.footprint": a, **keys}
    found, _, _ = measured_on(keys | cells(ADAPTIVE, reference, a) | {"tissue.element": "P2"})
    exact = found.compliance[0] + found.missed[0]
    for element in elements:
        for mesh, size in ((mesh, size) for mesh, own in sizes.items() for size in own):
            found, unknowns, seconds = measured_on(keys | cells(mesh, size, a) | {"tissue.element": element})
            yield Row(
                case=name, footprint=a, element=element, mesh=mesh, size=size * (a if mesh == GRADED else 1.0),
                unknowns=unknowns, seconds=seconds, normal=float(found.compliance[0, 2]),
                error=float(np.max(1.0 - found.compliance[0] / exact)), estimate=float(found.errors[0]),
            )  # fmt: skip


def cells(mesh: str, size: float, a: float) -> Settings:
    """Return the keys of a mesh of a kind, at a footprint `a` [m]."""
    if mesh == ADAPTIVE:
        return {"tissue.mesh.h": FAR, "tissue.mesh.accuracy": size}
    at = {"h": size} if mesh == UNIFORM else {"h": FAR, "h_site": size * a, "growth": GROWTH}
    return {f"tissue.mesh.{key}": value for key, value in at.items()} | {"tissue.mesh.accuracy": "given"}


def measured_on(keys: Settings) -> tuple[tissue.Estimate, int, float]:
    """Return the compliance of the hole with its estimated error, the unknowns, and the seconds.

    The seconds are those before the first step.
    """
    given = scene("adaptive_refinement", keys)
    begun = perf_counter()
    assembly = assemble(given)
    seconds, body = perf_counter() - begun, assembly.body
    assert body is not None
    sites = [site_of(hole) for hole in assembly.holes]
    return estimate(body, sites, tissue.build_sites(body, sites)), int(body.free.size), seconds


def needed(rows: Sequence[Row], field: str) -> float:
    """Return the unknowns or seconds for the error ASKED.

    They are interpolated between two meshes on logarithmic axes. Not a number if no mesh is so
    accurate; the value of the coarsest mesh if all are.
    """
    ordered = sorted(rows, key=lambda row: -row.error)
    errors, values = ([getattr(row, name) for row in ordered] for name in ("error", field))
    if errors[-1] > ASKED:
        return float("nan")
    return float(np.exp(-np.interp(-np.log(ASKED), -np.log(errors), -np.log(values))))


def table(rows: Sequence[Row]) -> Table:
    """Return the table with a line for each kind of mesh on a case."""
    columns = columns_of(
        "adaptive_refinement",
        unknowns=lambda meshes: shown(needed(meshes, "unknowns")),
        seconds=lambda meshes: shown(needed(meshes, "seconds")),
        most=lambda meshes: f"{max(row.unknowns for row in meshes)}",
        least_error=lambda meshes: f"{100.0 * min(row.error for row in meshes):.2g}",
        effectivities=lambda meshes: range_text([row.effectivity for row in meshes]),
    )
    return Table.of(columns, grouped(rows, lambda row: (row.case, row.kind)).values())


def range_text(values: Sequence[float]) -> str:
    """Return the smallest and the largest value as text."""
    return f"{min(values):.2f} to {max(values):.2f}"


def shown(number: float) -> str:
    """Return a number with two digits, or "not reached" for NaN."""
    return "not reached" if np.isnan(number) else f"{float(f'{number:.2g}'):g}"


def remarks(rows: Sequence[Row]) -> Iterator[str]:
    """Yield remarks on the sizes of meshes, and on estimates far from the error.

    The other meshes are compared with the adaptive ones.
    """
    for case, own in grouped(rows, lambda row: row.case).items():
        for element, same in grouped(own, lambda row: row.element).items():
            need = {mesh: needed(meshes, "unknowns") for mesh, meshes in grouped(same, lambda row: row.mesh).items()}
            for mesh in (UNIFORM, GRADED):
                if not np.isnan(ratio := need.get(mesh, np.nan) / need.get(ADAPTIVE, np.nan)):
                    more = f"{ratio:.2g} times the unknowns of adaptive ones"
                    yield f"{case}, {element}: {mesh} meshes take {more} for 3 %"
    for row in (row for row in rows if row.mesh == ADAPTIVE):
        if not EFFECTIVITY[0] <= row.effectivity <= EFFECTIVITY[1]:
            yield f"{row.case}, {row.kind}, {row.unknowns} unknowns: ESTIMATE {row.effectivity:.2g} times the error"


def figure(rows: Sequence[Row]) -> Figure:
    """Return the figure of the error over unknowns and seconds, and of estimate over error."""
    places: list[Item] = []
    for case, own in grouped(rows, lambda row: row.case).items():
        lines = grouped(own, lambda row: row.kind)
        named = unnamed(lines) if places else lines
        curves = series(named, lambda row: row.unknowns / 1000.0, "error")
        words = "unknowns [thousands]", ERROR
        places.append(panel(*words, curves, level(ASKED), log="xy", ticks=TICKS | {"y": SHARES}, title=case))
    first = grouped([row for row in rows if row.case == rows[0].case], lambda row: row.kind)
    seconds = series(unnamed(first), "seconds", "error")
    ticks = {"x": (0.2, 0.5, 1.0, 2.0, 5.0, 10.0), "y": SHARES}
    places.append(panel("time [s]", ERROR, seconds, log="xy", ticks=ticks, title=rows[0].case))
    adaptive = grouped([row for row in rows if row.mesh == ADAPTIVE], lambda row: row.element)
    bounds = [level(value, style=":") for value in EFFECTIVITY]
    points = series(adaptive, "error", "effectivity", "")
    places.append(panel(ERROR, "estimate over error", points, *bounds, log="x", ticks={"x": SHARES}, title="adaptive"))
    places += [Axes.set_axis_off] * (len(places) % 2)
    return draw(places)
