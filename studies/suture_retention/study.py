"""Suture retention (ISO 7198): the force on a loop near the edge of a strip.

The loop is 2 mm from the edge and is drawn 10 mm. A strip is clamped at one end. A suture passes
through its thickness near the other end, in the middle of its width, and both ends of the loop are
drawn along the strip. Nothing tears in the model: force, bearing pressure F/(d t), the largest
stretch and the energy density at the hole continue to rise. The question is their values when a
real strip fails.

*Tissues.* They are exponential, with E and b from a uniaxial test only. E is the initial slope.
With b, the curve of a strip of the organ's Poisson's ratio passes through the point where the
strips broke. Two quantities are predictions: the state at the published failure force of a loop,
and the state at the stretch of the broken strips.
"""

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cached_property, partial
from types import SimpleNamespace

import numpy as np
from matplotlib.figure import Figure
from scipy.optimize import brentq

import tissue
from coupling.errors import CouplingError
from studies.arrays import KILO, MEGA, MILLI
from studies.figure import COLOURS, MARKERS, Item, curve, described, draw, level, series
from studies.lists import sentences, study_list
from studies.scenario import Scenario
from studies.simulation import Simulation, prepare
from studies.simulation.memory import OrganRun
from studies.simulation.recording import step_record
from studies.study import Table, columns_of, each, grouped, measure, measured, require, require_known, scene, unit_field
from studies.theory import Fibrous
from thread.catalogue import suture

LENGTH, WIDTH = 0.02, 0.01  # of the strip [m], as in Gong et al.
EDGE, DRAWN = 2e-3, 0.01  # of the hole from the edge, and length drawn by the hands [m] (ISO 7198)
POISSON = 0.499  # κ follows from the initial slope: at 0.49 a stiffening tissue would swell instead of stretch
SUTURE = "3-0 polypropylene"
LEG, OFFSET, DIP = 0.02, 4e-3, 1e-3  # of the loop: beyond the strip, of either hand from its middle, at the hole [m]
NEAR = 2.0  # footprints around the hole in which the largest stretch is sought
MIDDLE = 0.15  # of the strip's length: its middle part, stretched as in a uniaxial test
LINEAR, COARSER = "linear organ", "coarser cells"
say = sentences(study_list("suture_retention")["words"])


@dataclass(frozen=True)
class Tissue:
    """A published tissue.

    It has the initial slope of a uniaxial test [Pa], nominal stress [Pa] and strain at failure, and
    the thickness [m]. `force` [N] is the force at which a suture tore out, with its spread or None.
    """

    slope: float
    stress: float
    strain: float
    thickness: float
    force: float
    source: str
    spread: float | None = None

    @cached_property
    def law(self) -> Fibrous:
        """The law of the tissue.

        Its b is the one for which the curve passes through the point of failure.
        """

        def off(stiffening: float) -> float:
            return float(np.log(Fibrous(self.slope, POISSON, stiffening).strip(self.broken)[0] / self.stress))

        return Fibrous(self.slope, POISSON, float(brentq(off, 1e-3, 20.0, xtol=1e-12)))

    def nominal(self, stretch: float) -> float:
        """Return the nominal stress [Pa] of a strip, free at its sides, at a stretch."""
        return self.law.strip(stretch)[0]

    def stretch(self, nominal: float) -> float:
        """Return the stretch of a strip under a nominal stress [Pa]."""
        return float(brentq(lambda x: self.nominal(x) - nominal, 1.0, self.broken))

    @property
    def broken(self) -> float:
        """Stretch at which strips broke [-]."""
        return 1.0 + self.strain

    @property
    def published(self) -> str:
        """Force at which a suture tore out, with its spread [N]."""
        return f"{self.force:g}" + ("" if self.spread is None else f" ± {self.spread:g}")


TISSUES = {name: Tissue(**published) for name, published in study_list("suture_retention")["published"].items()}


@dataclass(frozen=True, kw_only=True)
class Case:
    """One run."""

    name: str
    variant: str = ""
    footprint: float = unit_field("m")
    size: float = unit_field("m")  # of the cells at the hole
    load_steps: int = unit_field("-")

    @property
    def tissue(self) -> Tissue:
        """The tissue of the run."""
        return TISSUES[self.name]


@dataclass(frozen=True, kw_only=True)
class Row(Case):
    """One equilibrium of a run."""

    drawn: float = measured("m", lambda at: at.drawn)  # by the hands
    force: float = measured("N", lambda at: at.force)  # on the hole, along the strip
    clamp: float = measured("N", lambda at: -at.body.nodal(at.forces)[at.held, 0].sum())  # force on the clamp
    bearing: float = measured("Pa", lambda at: at.force / (suture(SUTURE).diameter * at.thickness))  # F/(d t)
    stretch: float = measured("-", lambda at: at.stretches[:, 0].max())  # largest at the hole
    swelling: float = measured("-", lambda at: at.stretches.prod(axis=1).max())  # largest J at the hole
    energy: float = measured("Pa", lambda at: at.energy.max())  # largest density at the hole, per reference volume
    middle: float = measured("-", lambda at: 1.0 + np.polyfit(at.x, at.along, 1)[0])  # mean stretch of the middle
    uniaxial: float = measured("-", lambda at: at.uniaxial)  # stretch of a strip under F over its section
    failed: str


def main(
    tissues: Sequence[str] = tuple(TISSUES),
    footprints: Sequence[float] = (0.6e-3, 0.9e-3),
    load_steps: int = 20,
    size: float = 0.75e-3,
    variants: Sequence[str] = (LINEAR, COARSER),
) -> Iterator[Row]:
    """Yield every load step of each tissue and footprint.

    The last footprint is also run with a linear organ of the same E, and on coarser cells. Raises
    `StudyError`.
    """
    require_known("tissues", tissues, TISSUES)
    require_known("variants", variants, (LINEAR, COARSER))
    fit = min(footprints) > 0.0 and max(footprints) < 0.5 * min(TISSUES[name].thickness for name in tissues)
    require(fit, f"footprints = {list(footprints)}", "give numbers above 0 to below 1e-3 [m]")
    require(load_steps >= 1 and size > 0.0, f"load_steps = {load_steps}, size = {size}", "give numbers above 0")
    cases = [Case(name=name, footprint=a, size=size, load_steps=load_steps) for name in tissues for a in footprints]
    for case in [case for case in cases if case.footprint == footprints[-1]]:
        changed = {LINEAR: replace(case, variant=LINEAR), COARSER: replace(case, variant=COARSER, size=1.5 * size)}
        cases += [changed[variant] for variant in variants]
    yield from each([partial(run, case) for case in cases])


def run(case: Case) -> Iterator[Row]:
    """Yield every load step.

    If one fails, the last equilibrium is yielded again with the name of the failure.
    """
    simulation = prepare(scenario(case))
    now = simulation.beginning()
    while now.number < simulation.steps:
        try:
            now = simulation.next(now)
        except CouplingError as error:
            yield row_of(case, simulation, now, f"{type(error).__name__}: {error}")
            return
        yield row_of(case, simulation, now, "")


def scenario(case: Case) -> Scenario:
    """Return the strip, clamped at its left end, and the loop through it.

    The ends of the loop are drawn to the right.
    """
    thickness = case.tissue.thickness
    at, middle, hand = 0.5 * LENGTH - EDGE, -0.5 * thickness, 0.5 * LENGTH + LEG
    stiffening = {"tissue.material": "exponential", "tissue.stiffening": case.tissue.law.stiffening}
    values = {
        "tissue.youngs_modulus": case.tissue.slope,
        "tissue.mesh.size": [LENGTH, WIDTH, thickness],
        "tissue.mesh.h_site": case.size,
        "thread.path": [[x, 0.0, middle + z] for x, z in ((hand, OFFSET), (at, DIP), (at, -DIP), (hand, -OFFSET))],
        "piercing.hole.at": [at, 0.0, middle],
        "piercing.hole.footprint": case.footprint,
        "solve.load_steps": case.load_steps,
        **({} if case.variant == LINEAR else stiffening),
    }
    for end, z in (("start", middle + OFFSET), ("end", middle - OFFSET)):
        values[f"thread.{end}.waypoints"] = [[0.0, hand, 0.0, z], [1.0, hand + DRAWN, 0.0, z]]
    return scene("suture_retention", values)


def row_of(case: Case, simulation: Simulation, now: OrganRun, failed: str) -> Row:
    """Return the row of an equilibrium."""
    organ, thickness, (hole,) = simulation.assembly.organ, case.tissue.thickness, step_record(now).piercings
    assert isinstance(organ, tissue.FiniteOrgan | tissue.QuasiStaticOrgan)
    U, force, body = organ.displacement(now.state.organ), -float(hole.force[0]), organ.elasticity
    hyper = organ.law if isinstance(organ, tissue.FiniteOrgan) else tissue.Hyperelasticity(body)
    linear = case.variant == LINEAR
    centres = body.mesh.p[:, body.mesh.t].mean(axis=1).T
    near = np.linalg.norm(centres - np.array(simulation.scenario.piercing[0].place), axis=1) <= NEAR * case.footprint
    x, along = body.points[:, 0], body.nodal(U)[:, 0]
    middle = np.abs(x) <= MIDDLE * LENGTH
    end = SimpleNamespace(
        drawn=DRAWN * now.state.time / simulation.scenario.solve.duration, force=force, thickness=thickness,
        uniaxial=uniaxial_stretch(case, force / (WIDTH * thickness)), body=body,
        stretches=tissue.principal_stretch(hyper, U)[0][near], x=x[middle], along=along[middle],
        energy=(tissue.strains(body, U).energy_density if linear else tissue.cell_energy(hyper, U))[near],
        forces=body.K @ U if linear else hyper.forces(hyper.gradient(U))[0],
        held=np.abs(x + 0.5 * LENGTH) < 1e-9 * LENGTH,
    )  # fmt: skip
    return measure(Row, end, **asdict(case), failed=failed)


def uniaxial_stretch(case: Case, nominal: float) -> float:
    """Return the stretch of a strip under a nominal stress [Pa]; 1 without stress."""
    if nominal <= 0.0:
        return 1.0
    return 1.0 + nominal / case.tissue.slope if case.variant == LINEAR else case.tissue.stretch(nominal)


# --- what was found ---------------------------------------------------------------------------------------


def runs_of(rows: Sequence[Row]) -> dict[tuple[str, float, str], list[Row]]:
    """Return the equilibria by tissue, footprint and variant, without failed ones.

    They are in the order of the draw.
    """
    return grouped((row for row in rows if not row.failed), lambda row: (row.name, row.footprint, row.variant))


def where(runs: Sequence[Row], known: str, value: float, asked: str) -> float:
    """Return a quantity at the point where another has a value.

    It is linear between load steps, and NaN beyond the last.
    """
    rest = {"stretch": 1.0}
    x, y = ([rest.get(name, 0.0), *(getattr(row, name) for row in runs)] for name in (known, asked))
    return float(np.interp(value, x, y, right=np.nan))


def table(rows: Sequence[Row]) -> Table:
    """Return the table with a line for each run.

    It shows the end, the published force, and the stretch of broken strips.
    """
    columns = columns_of(
        "suture_retention",
        stiffening=lambda runs: "" if runs[-1].variant == LINEAR else f"{runs[-1].tissue.law.stiffening:.2f}",
        stretches=lambda runs: f"{runs[-1].middle:.4g}, {runs[-1].uniaxial:.4g}",
        drawn_at_force=lambda runs: number(where(runs, "force", runs[-1].tissue.force, "drawn") / MILLI),
        stretch_at_force=lambda runs: number(where(runs, "force", runs[-1].tissue.force, "stretch")),
        force_at_break=lambda runs: number(where(runs, "stretch", runs[-1].tissue.broken, "force")),
        drawn_at_break=lambda runs: number(where(runs, "stretch", runs[-1].tissue.broken, "drawn") / MILLI),
    )
    return Table.of(columns, runs_of(rows).values())


def number(value: float) -> str:
    """Return a number as text, or that it was not reached."""
    return "not reached" if np.isnan(value) else f"{value:.3g}"


def remarks(rows: Sequence[Row]) -> Iterator[str]:
    """Yield remarks on the fits, the predictions, their dependences, and failures."""
    found = runs_of(rows)
    yield from map(fit_words, dict.fromkeys(row.name for row in rows))
    for (name, footprint, variant), runs in found.items():
        if not variant:
            yield prediction(name, footprint, runs)
        if variant == COARSER and (reference := found.get((name, footprint, ""))):
            off = {key: getattr(reference[-1], key) / getattr(runs[-1], key) for key in ("force", "stretch", "energy")}
            text = ", ".join(f"{key} {over - 1.0:+.1%}" for key, over in off.items())
            yield f"{name}: against cells 1.5 times coarser, at the end: {text}"
    swelling = max((row.swelling for row in rows if not row.variant), default=1.0)
    yield f"tissue at the hole swells to {swelling:.3g} times its volume, which is hardly realistic"
    balance = max((abs(row.clamp - row.force) / row.force for row in rows if row.force > 0.0), default=0.0)
    yield f"the force on the clamp equals the force on the hole within {balance:.1g}"
    for row in (row for row in rows if row.failed):
        yield f"{row.name}, {row.drawn / MILLI:.3g} mm: FAILED beyond, {row.failed}"


def fit_words(name: str) -> str:
    """Return the fit of a tissue, in words; its slope at failure is a difference over 1e-5."""
    of, end = TISSUES[name], TISSUES[name].broken
    steepest = (of.nominal(end) - of.nominal(end - 1e-5)) / 1e-5
    known = {"E": of.slope / KILO, "nu": POISSON, "slope": steepest / MEGA, "volume": of.law.strip(end)[1]}
    return say("fit", name=name, of=of, **known)


def prediction(name: str, footprint: float, runs: Sequence[Row]) -> str:
    """Return in words whether the tissue reaches the stretch of broken strips.

    The published force is added.
    """
    of = TISSUES[name]
    at = where(runs, "stretch", of.broken, "force")
    words = f"reached within 10 mm, at {at:.3g} N;" if np.isfinite(at) else "not reached within 10 mm;"
    return say("prediction", name=name, of=of, footprint=footprint / MILLI, words=words)


def figure(rows: Sequence[Row]) -> Figure:
    """Return the figure of force, stretch and bearing pressure, and of the uniaxial curves."""
    named = {f"{name}, {a / MILLI:g} mm, {v}".rstrip(", "): runs for (name, a, v), runs in runs_of(rows).items()}
    colour = dict(zip(dict.fromkeys(row.name for row in rows), COLOURS, strict=False))
    colours = [colour[runs[0].name] for runs in named.values()]
    quantities = (("force", "force"), ("stretch", "broken"), ("bearing [MPa]", ""))
    drawn = [
        [
            series(named, "drawn [mm]", y, "-", MARKERS, colours),
            *(level(getattr(TISSUES[name], of), None, "-.", colour[name]) for name in colour if of),
        ]
        for y, of in quantities
    ]
    return draw(described("suture_retention", *drawn, [item for name in colour for item in uniaxial(name, rows)]))


def uniaxial(name: str, rows: Sequence[Row]) -> list[Item]:
    """Return the curves of a uniaxial fit, its fitted point, and the middle of the strips."""
    of, colour = TISSUES[name], COLOURS[list(TISSUES).index(name)]
    x = np.linspace(1.0, of.broken, 60)[1:]
    runs = {f"{name}: middle of the strip": [r for r in rows if r.name == name and not r.variant and not r.failed]}
    return [
        curve(x, [of.nominal(at) / MEGA for at in x], f"{name}: fitted, ν = {POISSON:g}", "-", colour),
        curve(of.broken, of.stress / MEGA, f"{name}: where strips broke", "*", colour, markersize=10),
        series(runs, "middle", lambda row: row.force / (WIDTH * of.thickness) / MEGA, "", colours=[colour]),
    ]
