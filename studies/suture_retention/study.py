"""Suture retention (ISO 7198): a loop 2 mm from the edge of a strip is drawn 10 mm, and the force on it is measured.

A strip is clamped at one end. A suture goes through its thickness near the other end, in the middle of its width; both
ends of the loop are drawn along the strip. Nothing tears in the model: force, bearing pressure F/(d t), the largest
stretch and energy density at the hole go on rising, and the question is where they are when a real strip gives way.

*Tissues.* Exponential, with E and b of a uniaxial test alone. E is the slope at the start, and b makes the curve of a
strip of the organ's own Poisson's ratio pass through the point where the strips broke. Where a loop pulls as hard as
the published one that gave way, or stretches the tissue as far as the strips that broke, is a prediction.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy.optimize import brentq

import tissue
from studies.arrays import Array
from studies.figure import COLOURS, MARKERS, panels
from studies.scenario import Scenario, parse
from studies.simulation import Simulation, prepare
from studies.simulation.memory import OrganRun
from studies.simulation.recording import step_record
from studies.simulation.remarks import coarse_spans
from studies.study import Job, Study, StudyError, Table, each, unit_field
from studies.until_failure import steps_until_failure
from thread.catalogue import suture
from tissue.materials.density import Sum
from tissue.materials.isotropic import Exponential, Volumetric

LENGTH, WIDTH = 0.02, 0.01  # of the strip [m], as in Gong et al.
EDGE, DRAWN = 2e-3, 0.01  # of the hole from the edge, and of the hands [m] (ISO 7198)
POISSON = 0.499  # κ is that of the slope at the start: what stiffens swells, at 0.49 instead of being stretched
SUTURE = "3-0 polypropylene"
LEG, APART, DIP = 0.02, 4e-3, 1e-3  # of the loop: beyond the strip, of either hand from its middle, at the hole [m]
FAR, GROWTH = 4e-3, 2.0  # cells far from the hole [m], and how they grow
NEAR = 2.0  # footprints around the hole, in which the largest stretch is looked for
MIDDLE = 0.15  # of the strip's length: its middle part, which is drawn as in a uniaxial test
MILLI, KILO, MEGA = 1e-3, 1e3, 1e6
LINEAR, COARSER = "linear organ", "coarser cells"


@dataclass(frozen=True)
class Tissue:
    """A published tissue: slope at the start of a uniaxial test [Pa], nominal stress [Pa] and strain where it broke,
    thickness [m], force at which a suture tore out [N] and its spread, and where all this is from."""

    slope: float
    stress: float
    strain: float
    thickness: float
    force: float
    spread: float | None
    source: str

    @cached_property
    def stiffening(self) -> float:
        """b that makes the curve pass through the point where it broke [-]."""
        end = 1.0 + self.strain
        return float(brentq(lambda b: np.log(uniaxial(self.slope, b, end)[0] / self.stress), 1e-3, 20.0, xtol=1e-12))

    def nominal(self, stretch: float) -> float:
        """Return the nominal stress [Pa] of a strip, free at its sides, at a stretch."""
        return uniaxial(self.slope, self.stiffening, stretch)[0]

    def stretch(self, nominal: float) -> float:
        """Return the stretch of such a strip under a nominal stress [Pa]."""
        return float(brentq(lambda x: self.nominal(x) - nominal, 1.0, 1.0 + self.strain))

    @property
    def steepest(self) -> float:
        """Slope of the curve where it broke [Pa], by a difference over 1e-5."""
        end = 1.0 + self.strain
        return (self.nominal(end) - self.nominal(end - 1e-5)) / 1e-5

    @property
    def swelling(self) -> float:
        """J of the strips where they broke [-]."""
        return uniaxial(self.slope, self.stiffening, 1.0 + self.strain)[1]


def uniaxial(slope: float, stiffening: float, stretch: float) -> tuple[float, float]:
    """Return the nominal stress [Pa] and J of a strip of Poisson's ratio POISSON at a stretch, free at its sides."""
    material = tissue.Material(slope, POISSON, 1.0)
    density = Sum([Exponential(material.lame_mu, stiffening), Volumetric(material.bulk_modulus)])

    def stress(side: float) -> Array:
        return density.stress(np.diag([stretch, side, side])[:, :, None])[:, :, 0]

    side = float(brentq(lambda x: float(stress(x)[1, 1]), 0.7 / np.sqrt(stretch), 1.5))
    return float(stress(side)[0, 0]), stretch * side**2


TISSUES = {
    "small bowel": Tissue(
        250e3, 0.9e6, 1.4, 2e-3, 4.62, 1.40,
        "breaks at 0.9 MPa, 140 % across (Egorov et al., J. Biomech. 35 (2002) 1417); slope 180 to 307 kPa at the "
        "start (biaxial, Terry et al. 2014); a suture in 10 × 20 mm of human bowel tears out at 4.62 ± 1.40 N (Gong et "
        "al., J. Biomech. Eng. 2023, 10.1115/1.4063951); its thickness and distance from the edge are assumed",
    ),
    "skin": Tissue(
        1.18e6, 21.6e6, 0.54, 2e-3, 67.0, None,
        "slope 1.18 MPa at the start, breaks at 21.6 MPa, 54 % (back, Ní Annaidh et al., J. Mech. Behav. Biomed. "
        "Mater. 5 (2012) 139, with 83.3 MPa as the slope near the end); sutures in full-thickness skin give way, or "
        "it does, at a median of 67 N (Front. Surg. 6 (2019) 69); thickness and distance from the edge are assumed",
    ),
}  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class Case:
    """What is run."""

    name: str
    variant: str = ""
    footprint: float = unit_field("m")
    size: float = unit_field("m")  # of the cells at the hole
    load_steps: int = unit_field("-")

    @property
    def tissue(self) -> Tissue:
        """The tissue."""
        return TISSUES[self.name]


@dataclass(frozen=True, kw_only=True)
class Row(Case):
    """One equilibrium on the way."""

    drawn: float = unit_field("m")  # of the hands
    force: float = unit_field("N")  # on the hole, along the strip
    clamp: float = unit_field("N")  # that the clamp bears
    moved: float = unit_field("m")  # of the hole
    bearing: float = unit_field("Pa")  # F/(d t)
    stretch: float = unit_field("-")  # largest at the hole
    swelling: float = unit_field("-")  # largest J there
    energy: float = unit_field("Pa")  # largest density of energy there, per volume of the reference shape
    middle: float = unit_field("-")  # mean stretch along the middle of the strip
    uniaxial: float = unit_field("-")  # what a strip is stretched by F over its section
    span_ratio: float = unit_field("-")
    failed: str


def main(
    tissues: Sequence[str] = tuple(TISSUES),
    footprints: Sequence[float] = (0.6e-3, 0.9e-3),
    load_steps: int = 20,
    size: float = 0.75e-3,
    variants: Sequence[str] = (LINEAR, COARSER),
) -> Iterator[Row]:
    """Yield every load step of each tissue and footprint, and of the last footprint with a linear organ of the same E
    and on coarser cells. Raises `StudyError`."""
    if unknown := [name for name in tissues if name not in TISSUES]:
        raise StudyError(f"tissues: {unknown[0]!r} is refused; those known are {', '.join(TISSUES)}")
    if unknown := [name for name in variants if name not in (LINEAR, COARSER)]:
        raise StudyError(f"variants: {unknown[0]!r} is refused; allowed are {LINEAR!r} and {COARSER!r}")
    if min(footprints) <= 0.0 or max(footprints) >= 0.5 * min(TISSUES[name].thickness for name in tissues):
        raise StudyError(f"footprints = {list(footprints)} is refused: give numbers above 0 to below 1e-3 [m]")
    if load_steps < 1 or size <= 0.0:
        raise StudyError(f"load_steps = {load_steps}, size = {size} is refused: give numbers above 0")
    cases = [Case(name=name, footprint=a, size=size, load_steps=load_steps) for name in tissues for a in footprints]
    for case in [case for case in cases if case.footprint == footprints[-1]]:
        changed = {LINEAR: replace(case, variant=LINEAR), COARSER: replace(case, variant=COARSER, size=1.5 * size)}
        cases += [changed[variant] for variant in variants]
    jobs: list[Job] = [partial(run, case) for case in cases]
    yield from each(jobs)


def run(case: Case) -> Iterator[Row]:
    """Yield every load step; where one fails, the last equilibrium once more with the name of what failed."""
    simulation = prepare(scenario(case))
    for now, failed in steps_until_failure(simulation):
        yield measure(case, simulation, now, failed)


def scenario(case: Case) -> Scenario:
    """Return the strip, clamped at its left end, and the loop through it, whose ends are drawn to the right."""
    thickness = case.tissue.thickness
    at, middle = 0.5 * LENGTH - EDGE, -0.5 * thickness
    hand = 0.5 * LENGTH + LEG
    stiffening = {"material": "exponential", "stiffening": case.tissue.stiffening}

    def drawn(side: float) -> dict[str, object]:
        z = middle + side * APART
        return {"kind": "driven", "waypoints": [[0.0, hand, 0.0, z], [1.0, hand + DRAWN, 0.0, z]]}

    loop = [(hand, APART), (at, DIP), (at, -DIP), (hand, -APART)]
    return parse(
        {
            "title": f"suture retention: {case.name}",
            "tissue": {
                "youngs_modulus": case.tissue.slope,
                "poisson_ratio": POISSON,
                "density": 1070.0,
                "inertia": False,
                "clamp": ["left"],
                "element": "P2",
                "mesh": {
                    "kind": "block",
                    "generator": "structured",
                    "size": [LENGTH, WIDTH, thickness],
                    "h": FAR,
                    "h_site": case.size,
                    "growth": GROWTH,
                },
                **({} if case.variant == LINEAR else stiffening),
            },
            "thread": {
                "suture": SUTURE,
                "control_points": 40,
                "resolution": "adaptive",
                "path": [[x, 0.0, middle + z] for x, z in loop],
                "start": drawn(1.0),
                "end": drawn(-1.0),
            },
            "piercing": [{"name": "hole", "at": [at, 0.0, middle], "footprint": case.footprint}],
            "solve": {"kind": "static", "load_steps": case.load_steps},
        }
    )


def measure(case: Case, simulation: Simulation, now: OrganRun, failed: str) -> Row:
    """Return what there is to know of an equilibrium."""
    seen = step_record(now)
    (hole,), thickness = seen.piercings, case.tissue.thickness
    force = -float(hole.force[0])
    return Row(
        **{name: getattr(case, name) for name in Case.__dataclass_fields__},
        drawn=DRAWN * now.state.time / simulation.scenario.solve.duration,
        force=force,
        moved=float(hole.displacement[0]),
        bearing=force / (suture(SUTURE).diameter * thickness),
        **in_tissue(case, simulation, now),
        uniaxial=uniaxial_stretch(case, force / (WIDTH * thickness)),
        span_ratio=seen.span_ratio,
        failed=failed,
    )


def uniaxial_stretch(case: Case, nominal: float) -> float:
    """Return what a strip is stretched by under a nominal stress [Pa]; 1 before it is drawn."""
    if nominal <= 0.0:
        return 1.0
    return 1.0 + nominal / case.tissue.slope if case.variant == LINEAR else case.tissue.stretch(nominal)


def in_tissue(case: Case, simulation: Simulation, now: OrganRun) -> dict[str, Any]:
    """Return the largest stretch and energy density near the hole, the stretch of the strip's middle, and what the
    clamp bears."""
    organ, body = simulation.assembly.organ, simulation.assembly.body
    assert body is not None and isinstance(organ, tissue.FiniteOrgan | tissue.QuasiStaticOrgan)
    U = organ.displacement(now.state.organ)
    centres = body.mesh.p[:, body.mesh.t].mean(axis=1).T
    hole = np.array(simulation.scenario.piercing[0].place)
    near = np.linalg.norm(centres - hole, axis=1) <= NEAR * case.footprint
    hyper = organ.law if isinstance(organ, tissue.FiniteOrgan) else tissue.Hyperelasticity(body)
    stretches, _ = tissue.cell_stretch(hyper, U)
    finite = isinstance(organ, tissue.FiniteOrgan)
    energy = tissue.cell_energy(hyper, U) if finite else tissue.energy_density(body, U)
    forces = hyper.forces(hyper.gradient(U))[0] if finite else body.K @ U
    held = np.abs(body.points[:, 0] + 0.5 * LENGTH) < 1e-9 * LENGTH
    x, along = body.points[:, 0], body.nodal(U)[:, 0]
    middle = np.abs(x) <= MIDDLE * LENGTH
    return {
        "stretch": float(stretches[near, 0].max()),
        "swelling": float(stretches[near].prod(axis=1).max()),
        "energy": float(energy[near].max()),
        "middle": 1.0 + float(np.polyfit(x[middle], along[middle], 1)[0]),
        "clamp": -float(body.nodal(forces)[held, 0].sum()),
    }


# --- what was found ---------------------------------------------------------------------------------------


def runs_of(rows: Sequence[Row]) -> dict[tuple[str, float, str], list[Row]]:
    """Return the equilibria by tissue, footprint and variant, by draw; those that failed left out."""
    keys = dict.fromkeys((row.name, row.footprint, row.variant) for row in rows)
    good = [row for row in rows if not row.failed]
    return {key: [row for row in good if (row.name, row.footprint, row.variant) == key] for key in keys}


def where(runs: Sequence[Row], known: str, value: float, asked: str) -> float:
    """Return a quantity where another has a value, linear between load steps from rest; NaN beyond the last."""
    rest = {"stretch": 1.0}
    x, y = ([rest.get(name, 0.0), *(getattr(row, name) for row in runs)] for name in (known, asked))
    return float(np.interp(value, x, y, right=np.nan))


def table(rows: Sequence[Row]) -> Table:
    """Make a line a run: at the end, at the published force, and at the stretch at which strips broke."""
    head = (
        "tissue", "footprint [mm]", "changed", "b [-]", "F at 10 mm [N]", "F/(d t) [MPa]", "largest stretch [-]",
        "energy density [MPa]", "strip's middle, uniaxial [-]", "published F [N]", "drawn there [mm]",
        "stretch there [-]", "strips break at [-]", "F there [N]", "drawn there [mm]",
    )  # fmt: skip
    return Table(head, [line(runs) for runs in runs_of(rows).values() if runs])


def line(runs: Sequence[Row]) -> tuple[str, ...]:
    """Return the cells of a run."""
    last, of = runs[-1], runs[-1].tissue
    broken = 1.0 + of.strain
    spread = "" if of.spread is None else f" ± {of.spread:g}"
    return (
        last.name,
        f"{last.footprint / MILLI:g}",
        last.variant,
        "" if last.variant == LINEAR else f"{of.stiffening:.2f}",
        f"{last.force:.3g}",
        f"{last.bearing / MEGA:.3g}",
        f"{last.stretch:.3g}",
        f"{last.energy / MEGA:.3g}",
        f"{last.middle:.4g}, {last.uniaxial:.4g}",
        f"{of.force:g}{spread}",
        number(where(runs, "force", of.force, "drawn") / MILLI),
        number(where(runs, "force", of.force, "stretch")),
        f"{broken:g}",
        number(where(runs, "stretch", broken, "force")),
        number(where(runs, "stretch", broken, "drawn") / MILLI),
    )


def number(value: float) -> str:
    """Write a number, or that it was not reached."""
    return "not reached" if np.isnan(value) else f"{value:.3g}"


def remarks(rows: Sequence[Row]) -> list[str]:
    """Say what the fits are worth, what was predicted, on what it depends, and what failed."""
    names = list(dict.fromkeys(row.name for row in rows))
    out = [fit_words(name) for name in names]
    found = runs_of(rows)
    for (name, footprint, variant), runs in found.items():
        if runs and not variant:
            out.append(prediction(name, footprint, runs))
        reference = found.get((name, footprint, ""), [])
        if runs and variant == COARSER and reference:
            off = [getattr(reference[-1], key) / getattr(runs[-1], key) - 1.0 for key in ("force", "stretch", "energy")]
            text = ", ".join(f"{word} {x:+.1%}" for word, x in zip(("force", "stretch", "energy"), off, strict=True))
            out.append(f"{name}: against cells 1.5 times coarser, at the end: {text}")
    swelling = max((row.swelling for row in rows if not row.variant), default=1.0)
    out.append(f"tissue at the hole swells to up to {swelling:.3g} of its volume, which real tissue hardly does")
    balance = max((abs(row.clamp - row.force) / row.force for row in rows if row.force > 0.0), default=0.0)
    out.append(f"what the clamp bears is the force on the hole within {balance:.1g}")
    out += [f"{row.name}, {row.drawn / MILLI:.3g} mm: FAILED beyond, {row.failed}" for row in rows if row.failed]
    coarse = max((row.span_ratio for row in rows), default=0.0)
    return [*out, *(f"TOO COARSE, {said.message}" for said in coarse_spans(coarse))]


def fit_words(name: str) -> str:
    """Say what a tissue was fitted to."""
    of = TISSUES[name]
    return (
        f"{name}: E = {of.slope / KILO:.4g} kPa and b = {of.stiffening:.2f} by two points of a uniaxial test, for a "
        f"strip of ν = {POISSON:g}; where it broke its slope is then {of.steepest / MEGA:.3g} MPa, and its volume "
        f"{of.swelling:.3f} of what it was; {of.source}"
    )


def prediction(name: str, footprint: float, runs: Sequence[Row]) -> str:
    """Say where the tissue is stretched as far as the strips that broke, and what was published."""
    of = TISSUES[name]
    at = where(runs, "stretch", 1.0 + of.strain, "force")
    spread = "" if of.spread is None else f" ± {of.spread:g}"
    words = f"within 10 mm, at {at:.3g} N," if np.isfinite(at) else "not within 10 mm,"
    return (
        f"{name}, footprint {footprint / MILLI:g} mm: stretched as far as strips that broke {words} published is a "
        f"loop that gives way at {of.force:g}{spread} N; nothing TEARS in the model, and the stretch at a hole depends "
        "on its footprint"
    )


def figure(rows: Sequence[Row]) -> Figure:
    """Draw force, largest stretch and bearing pressure over the draw, and the uniaxial curves."""
    drawing, grid = panels(2, 2)
    over_draw(grid[0, 0], rows, "force", 1.0, "force [N]")
    over_draw(grid[0, 1], rows, "stretch", 1.0, "largest stretch at the hole [-]")
    over_draw(grid[1, 0], rows, "bearing", MEGA, "bearing pressure F/(d t) [MPa]")
    grid[1, 0].set_ylim(bottom=grid[1, 0].get_ylim()[0] / 20.0)  # room for the runs' names
    grid[1, 0].legend(fontsize=6, loc="lower right", ncols=2)
    curves(grid[1, 1], rows)
    return drawing


def over_draw(axes: Axes, rows: Sequence[Row], key: str, unit: float, label: str) -> None:
    """Draw a quantity over the way of the hands; dash-dotted what is published."""
    names = list(dict.fromkeys(row.name for row in rows))
    styles = {"": "-", LINEAR: ":", COARSER: "--"}
    for (name, footprint, variant), runs in runs_of(rows).items():
        colour, wide = COLOURS[names.index(name)], footprint == max(row.footprint for row in rows)
        label_of = f"{name}, {footprint / MILLI:g} mm{', ' + variant if variant else ''}"
        x = [row.drawn / MILLI for row in runs]
        y = [getattr(row, key) / unit for row in runs]
        axes.plot(x, y, styles[variant], color=colour, marker="o" if wide else "s", markersize=3, label=label_of)
    for name, colour in zip(names, COLOURS, strict=False):
        known = {"force": (TISSUES[name].force, "a suture gave way"), "stretch": (1.0 + TISSUES[name].strain, "broke")}
        if key in known:
            value, what = known[key]
            axes.axhline(value, color=colour, linestyle="-.")
            axes.annotate(f"{name}: {what}", (1.0, value), va="bottom", fontsize=6, color=colour)
    axes.set(xlabel="drawn [mm]", ylabel=label)
    if key != "stretch":
        axes.set_yscale("log")


def curves(axes: Axes, rows: Sequence[Row]) -> None:
    """Draw the fitted uniaxial curves, the points they were fitted to, and the middle of the strips."""
    for name, colour, marker in zip(dict.fromkeys(row.name for row in rows), COLOURS, MARKERS, strict=False):
        of = TISSUES[name]
        x = np.linspace(1.0, 1.0 + of.strain, 60)[1:]
        axes.plot(x, [of.nominal(at) / MEGA for at in x], color=colour, label=f"{name}: fitted, ν = {POISSON:g}")
        axes.plot(1.0 + of.strain, of.stress / MEGA, "*", color=colour, markersize=10, label="where strips broke")
        runs = [row for row in rows if row.name == name and not row.variant and not row.failed]
        nominal = [row.force / (WIDTH * of.thickness) / MEGA for row in runs]
        axes.plot(
            [row.middle for row in runs], nominal, marker, color=colour, markersize=3, label="middle of the strip"
        )
    axes.set(xlabel="stretch [-]", ylabel="nominal stress [MPa]", yscale="log")
    axes.legend(fontsize=6)


STUDY = Study(
    main=main,
    question="At which force and draw does a suture 2 mm from the edge of a strip stretch the tissue as far as strips "
    "that break, and is that where sutures tear out?",
    independent="the middle of the strip against the closed form of a uniaxial test, the force that published sutures "
    "gave way at; the clamp bears the force on the hole",
    consistency="a linear organ of the same E; coarser cells; two footprints",
    table=table,
    figure=figure,
    remarks=remarks,
    quick={"tissues": ("skin",), "footprints": (0.9e-3,), "size": 2e-3, "variants": (LINEAR,)},
)
