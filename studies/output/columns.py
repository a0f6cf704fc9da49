"""The quantities of a results folder, each defined once: name, unit, meaning and source.

A `Column` makes the heading of a CSV table, the name of an array in a frame, a key of ``summary.json`` and a
line of the manual (``python -m studies.output.columns`` updates these lines). To add a quantity, add its field
to a record of ``studies.output.records`` and one line here.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Generic, Literal, TypeVar

import numpy as np
from numpy.typing import NDArray

from coupling.run.events import Event
from studies.manual import with_blocks
from studies.output import remarks
from studies.output.fields import OrganRecord, ThreadRecord
from studies.output.records import (
    APART,
    ContactRecord,
    EnergyRecord,
    Extremes,
    GapRecord,
    KrylovRecord,
    LoadRecord,
    PiercingRecord,
    ReductionRecord,
    RunRecord,
    StepRecord,
    StitchRecord,
    TieRecord,
    TractRecord,
)
from studies.scenario import Piercing, PulledEnd, Thread

Row = TypeVar("Row")
Item = TypeVar("Item")
Value = float | int | str | Sequence[float] | NDArray[np.float64] | None
StepItem = tuple[StepRecord, Item]  # a row of a table: a step, and the item of the step that this row describes

AXES = ("x", "y", "z")
STATE_CODES = {"stick": 0, "slip": 1, "anchored": 2, "left": 3}  # of `state` in the frames, which cannot hold text
TIE_CODES = {"open": 0, "drawn": 1, "tied": 2, "slips": 3, "held": 4}  # codes of the `state` of a tie in the frames
MANUAL = Path(__file__).with_name("README.md")


@dataclass(frozen=True)
class Column(Generic[Row]):
    """A quantity of a results folder.

    `name` is in lower_snake_case. `unit` is "-" for a number without unit and empty for text. `meaning` is for
    the manual. `source` is a function of a row's record that returns the value or None; without `source` the
    value is the field `name`. `kind` is the kind of a value. `parts` are the names of a vector's components in
    a table; empty for a scalar.
    """

    name: str
    unit: str
    meaning: str
    source: Callable[[Row], Value] | None = None
    kind: Literal["number", "whole", "text"] = "number"
    parts: tuple[str, ...] = ()

    def of(self, record: Row) -> Value:
        """Return the value of a row's record."""
        value: Value = getattr(record, self.name) if self.source is None else self.source(record)
        return value

    @property
    def headings(self) -> list[str]:
        """Headings in a CSV table, with the unit: `force_x [N]`."""
        unit = f" [{self.unit}]" if self.unit else ""
        return [name + unit for name in self.parts or (self.name,)]


def vector(name: str, unit: str, meaning: str, source: Callable[[Row], Value] | None = None) -> Column[Row]:
    """Make the column of a vector with three components along x, y and z."""
    return Column(name, unit, meaning, source, parts=tuple(f"{name}_{axis}" for axis in AXES))


def count(name: str, meaning: str, source: Callable[[Row], Value] | None = None) -> Column[Row]:
    """Make the column of a whole number."""
    return Column(name, "-", meaning, source, kind="whole")


def text(name: str, meaning: str, source: Callable[[Row], Value] | None = None) -> Column[Row]:
    """Make the column of a word."""
    return Column(name, "", meaning, source, kind="text")


def headings(columns: Iterable[Column[Any]]) -> list[str]:
    """List the headings of a CSV table."""
    return [heading for column in columns for heading in column.headings]


def values(columns: Iterable[Column[Row]], record: Row) -> dict[str, Value]:
    """Return the quantities of a record by name."""
    return {column.name: column.of(record) for column in columns}


# -- the quantities --------------------------------------------------------------------------------------------------


TIME: Column[StepRecord] = Column("time", "s", "time reached")
STEP: Column[StepRecord] = count("step", "number of the step; 0 is the start")

NAME: Column[PiercingRecord] = text("piercing", "name of the piercing", lambda hole: hole.name)
PLACE: Column[PiercingRecord] = Column("x", "m", "place of the hole", parts=AXES)
STATE: Column[PiercingRecord] = text("state", "`stick`, `slip`, `anchored`, or `left` (the thread is not in the hole)")
HOLE: tuple[Column[PiercingRecord], ...] = (
    Column("s", "m", "abscissa of the thread in the hole"),
    Column("slip", "m", "length drawn through towards the end since the piercing began"),
    PLACE,
    vector("displacement", "m", "displacement of the hole from the reference shape"),
    vector("force", "N", "force of the hole on the thread"),
    Column(
        "normal_force",
        "N",
        "force across the thread; in a channel summed over its two ends, with the couple",
    ),
    Column("tangential_force", "N", "part of `force` along `tangent`: friction and the configurational force"),
    vector("couple", "N m", "couple of the hole on the thread"),
    Column("tension_before", "N", "axial force of the strand at lower `s`; positive in tension"),
    Column("tension_after", "N", "axial force of the strand at higher `s`"),
    STATE,
    vector("tangent", "-", "unit tangent of the thread in the hole, towards rising `s`"),
    Column("cone_residual", "N", "violation of Coulomb's law"),
    Column(
        "mean_strain",
        "-",
        "largest principal strain across the hole in magnitude, averaged over the footprint",
    ),
    Column("turn", "rad", "rotation of the tissue at the hole"),
    Column(
        "bearing_pressure",
        "Pa",
        "`force` over thread diameter and bearing length: channel, else two footprints, else ten diameters",
    ),
)
CHANNEL: Column[PiercingRecord] = Column("channel", "m", "length of the channel; null without friction or direction")
HOLE_SUMMARY = (*HOLE, CHANNEL)
MOVED: Column[Piercing] = Column("moved", "m", "distance from `piercing.near` to the place found")
ACCURACY: tuple[Column[Mapping[str, Any]], ...] = (
    Column(
        "compliance_error",
        "-",
        "estimated relative error of the compliance",
        lambda known: known.get("errors"),
    ),
    Column(
        "bounds",
        "-",
        "bounds of the exact over the run's compliance, to forces along x, y and z; with `tissue.mesh.bound`",
        lambda known: known.get("bounds"),
        parts=("bounds_lower", "bounds_upper"),
    ),
)
HOLE_ARRAYS: tuple[Column[PiercingRecord], ...] = (
    count(
        "state", ", ".join(f"{code} {word}" for word, code in STATE_CODES.items()), lambda hole: STATE_CODES[hole.state]
    ),
    vector("u", "-", "first vector across the hole, moving with the tissue"),
    vector("v", "-", "second vector across the hole"),
)
PIERCING_ARRAYS = (*(column for column in HOLE if column not in (PLACE, STATE)), *HOLE_ARRAYS)

EVENT: tuple[Column[Event], ...] = (
    text(
        "event",
        "piercing: `begins`, `ends`, `leaves`, `slips`, `sticks`, `tears`; strand: `taut`, "
        "`slack`; tie: `closes`, `tied`, `slips`, `sticks`, `unties`; contact, tract: `slips`, "
        "`sticks`; thread: `cut`; step: `halved`; `snaps`: jump to a distant equilibrium; "
        "`branch`: equilibrium by arc length",
        lambda event: event.kind,
    ),
    text(
        "piercing",
        "name of the piercing, tie, tract, pair of surfaces, or strand (`start-entry`); else empty",
    ),
    Column("s", "m", "abscissa of the hole, the cut, or the middle of the strand"),
    Column("energy", "J", "change of kinetic and elastic energy: `work` minus `loss`"),
    Column("work", "J", "work to draw the thread into a beginning hole"),
    Column("loss", "J", "energy lost by the impulse of a beginning hole, or by a cut"),
    Column("gap", "m", "distance of the thread from a beginning hole, or of the strands of a tie"),
    Column("angle", "rad", "angle between the thread and the direction of a beginning hole"),
    vector("impulse", "N s", "impulse of a beginning hole on the thread, or of a cut"),
    count("control_points", "number after a cut, else empty", lambda event: event.control_points or None),
)

ENERGY: tuple[Column[EnergyRecord], ...] = (
    Column("kinetic", "J", "kinetic energy of thread and organ"),
    Column("elastic_thread", "J", "elastic energy of the thread; in row 0 of its bent path"),
    Column("elastic_tissue", "J", "elastic energy of the organ"),
    Column("prestretch", "J", "part of `elastic_tissue` that `tissue.prestretch` stored"),
    Column("external_work", "J", "work of loads, gravity, holders and hands"),
    Column("friction_dissipation", "J", "dissipated by friction in holes and contacts"),
    Column("viscous_dissipation", "J", "dissipated by damping, and work of stress that relaxes"),
    Column(
        "numerical_dissipation",
        "J",
        "dissipated by the integrator and contact; negative: created",
    ),
    Column("balance_error", "J", "external work minus dissipation and change of energy: round-off"),
)

MAX_STRAIN: Column[StepRecord] = Column("max_strain", "-", "largest axial strain of the thread")
SPAN_RATIO: Column[StepRecord] = Column(
    "span_ratio", "-", "longest span at a hole over √(EI/T); ⅓ is fine, above ½ is too coarse"
)
SPANS_BETWEEN: Column[StepRecord] = Column(
    "spans_between",
    "-",
    "fewest spans between neighbouring holes, null with fewer than two; 3 is fine, below 2 is too coarse",
)
ENDS: dict[str, tuple[Column[StepRecord], Column[StepRecord]]] = {
    "start": (
        vector("start_reaction", "N", "force of the holder on the start of the thread"),
        Column(
            "start_torque",
            "N m",
            "torque of the holder about the tangent; with `thread.twist`",
            lambda step: step.torques and step.torques[0],
        ),
    ),
    "end": (
        vector("end_reaction", "N", "force of the holder on the end of the thread"),
        Column(
            "end_torque",
            "N m",
            "torque of the holder about the tangent; with `thread.twist`",
            lambda step: step.torques and step.torques[1],
        ),
    ),
}
GROWS: Column[PulledEnd] = Column(
    "grows_within", "s", "ramp of the dead load on a pulled end, 0: at once", lambda end: end.ramp
)
SOLVED: tuple[Column[StepRecord], ...] = (
    count("newton_iterations", "Newton iterations of this step"),
    Column("constraint_max", "m", "largest distance between a hole and its thread"),
    MAX_STRAIN,
    Column("slide_speed", "m/s", "largest speed of the thread in a hole"),
    *(reaction for reaction, _ in ENDS.values()),
    *(torque for _, torque in ENDS.values()),
    Column("seconds", "s", "wall-clock time without compilation; the mean of steps made in one call"),
)

PAIR: Column[ContactRecord] = text("pair", "names of the two surfaces")
CONTACT: tuple[Column[ContactRecord], ...] = (
    count("pairs", "number of node pairs"),
    count("pressed", "pairs under a force"),
    Column("smallest_gap", "m", "smallest gap along the normal; for wound lips along the wound plane's normal"),
    Column("largest_gap", "m", "largest gap of pairs that face each other, else zero"),
    Column("open_area", "m²", f"area of facing pairs more than {APART:g} m apart"),
    Column("gap_volume", "m³", "volume between the surfaces"),
    Column("slide", "m", "largest sliding distance of a pair"),
    Column("largest_pressure", "Pa", "largest pressure of a pair"),
    Column("area", "m²", "area under pressure"),
    Column("force", "N", "sum of the contact forces' magnitudes"),
    Column("complementarity", "J", "largest force times gap in magnitude"),
    count("slipping", "pressed pairs that slip"),
    Column("friction", "N", "magnitude of the friction resultant"),
    Column("approximation", "-", f"share of the area with a gap below {APART:g} m in magnitude"),
    Column("closure_force", "N", "force of the thread that closes the wound: mean of both sides"),
    Column(
        "eversion",
        "rad",
        "mean angle by which the edges at the stitches turn outwards, both sides together; empty without edges",
    ),
)

STITCH_NAME: Column[StitchRecord] = text("stitch", "name of the tie, the tract or the single hole")
STITCH_PAIR: Column[StitchRecord] = text("pair", "names of the two surfaces")
STITCH: tuple[Column[StitchRecord], ...] = (
    Column("left_force", "N", "closing force on one side, across the undeformed surfaces"),
    Column("right_force", "N", "the same on the other side"),
    Column("load_share", "-", "share of the force of all stitches; empty if that is zero"),
)

GAP_PROFILE: tuple[Column[GapRecord], ...] = (
    text("pair", "names of the two surfaces"),
    Column("way", "m", "length along the rim in the reference shape"),
    Column("x", "m", "place on the rim", parts=AXES),
    Column("edge_gap", "m", "gap at the rim; empty if the rim faces nothing"),
    Column("largest_gap", "m", "largest gap below this place; empty if nothing faces it"),
    Column("largest_pressure", "Pa", "largest pressure there"),
)

TRACT_NAME: Column[TractRecord] = text("tract", "names of its two holes")
TRACT: tuple[Column[TractRecord], ...] = (
    count("balls", "number of tissue balls", lambda tract: len(tract.balls)),
    Column("length", "m", "length of path on which the thread bears"),
    Column("spacing", "m", "largest distance between balls"),
    vector("force", "N", "total force of the tissue on the thread"),
    Column("normal_force", "N", "sum of the forces across the thread"),
    Column("friction", "N", "sum of the forces along the thread, towards rising `s`"),
    Column("bearing", "N/m", "largest force across the thread per length"),
    Column("bearing_pressure", "Pa", "largest force on a ball over diameter and ball length"),
    Column("displacement", "m", "largest displacement of a ball"),
    Column("tension_before", "N", "tension before the first ball", lambda tract: tract.balls[0].tension_before),
    Column("tension_after", "N", "tension after the last ball", lambda tract: tract.balls[-1].tension_after),
    count("slipping", "balls at which the thread slips"),
)

LOAD: tuple[Column[LoadRecord], ...] = (
    text("boundary", "name of the loaded boundary"),
    Column("share", "-", "share of the load that acts"),
    Column("area", "m²", "area of the boundary in the reference shape"),
    vector("force", "N", "total force on the organ"),
)

TIE_NAME: Column[TieRecord] = text("tie", "name of the tie", lambda tie: tie.name)
TIE_PLACE: Column[TieRecord] = Column("x", "m", "place of the tie", parts=AXES)
TIE_STATE: Column[TieRecord] = text(
    "state",
    "`open`: not closed, or undone; `held` in statics before `drawn`; `tied`; `slips`: above `hold`",
)
TIE_NUMBERS: tuple[Column[TieRecord], ...] = (
    Column("force", "N", "tension of the strands at the tie"),
    Column("length", "m", "unstrained length of the loop; empty if it is cut"),
    Column("gap", "m", "distance of the strands"),
    Column("work", "J", "work of the hands"),
    Column("s_first", "m", "abscissa of the strand at lower `s`"),
    Column("s_second", "m", "abscissa of the other strand"),
)
TIE: tuple[Column[TieRecord], ...] = (TIE_STATE, *TIE_NUMBERS, TIE_PLACE)
TIE_ARRAYS: tuple[Column[TieRecord], ...] = (
    count("state", ", ".join(f"{code} {word}" for word, code in TIE_CODES.items()), lambda tie: TIE_CODES[tie.state]),
    *TIE_NUMBERS,
)

ORGAN_ARRAYS: tuple[Column[OrganRecord], ...] = (
    vector("displacement", "m", "displacement from the reference shape"),
    Column(
        "stress",
        "Pa",
        "stress at the nodes: xx, yy, zz, xy, yz, xz",
        parts=tuple(f"stress_{pair}" for pair in ("xx", "yy", "zz", "xy", "yz", "xz")),
    ),
    Column("von_mises", "Pa", "von Mises stress"),
    Column(
        "principal_stress",
        "Pa",
        "principal stresses in falling order; compression is negative",
        parts=("stress_first", "stress_second", "stress_third"),
    ),
    vector("first_direction", "-", "direction of the first principal stress, of either sign"),
    vector("third_direction", "-", "direction of the third principal stress, of either sign"),
    Column("nodal_volume_ratio", "-", "J averaged at the vertices"),
    Column("contact_pressure", "Pa", "pressure on contact surfaces, else zero"),
    Column("lip_gap", "m", "gap of contact surfaces, else not a number"),
)
ORGAN_CELLS: tuple[Column[OrganRecord], ...] = (
    Column("strain", "-", "largest principal strain of the cell, in magnitude"),
    Column("rotation", "rad", "largest rotation: half the length of curl U; at finite strain the angle of R"),
    Column("energy_density", "Pa", "mean strain energy per volume"),
    Column("volume_ratio", "-", "J: volume over that in the reference shape"),
    Column(
        "principal_stretch",
        "-",
        "mean principal stretches in falling order; at finite strain",
        parts=("stretch_first", "stretch_second", "stretch_third"),
    ),
    vector("first_stretch", "-", "direction of the first stretch in the deformed shape"),
    vector("third_stretch", "-", "direction of the third stretch in the deformed shape"),
)
THREAD_ARRAYS: tuple[Column[ThreadRecord], ...] = (
    Column("s", "m", "abscissa: rest arc length from the start of the path"),
    Column("tension", "N", "axial force; compression is negative"),
    Column("curvature", "1/m", "curvature of the axis"),
    Column(
        "radius",
        "m",
        "radius of the thread, for the Tube filter",
        lambda thread: np.full(len(thread.points), thread.radius),
    ),
    Column("torque", "N m", "torque about the tangent, right-handed"),
    vector("bearing", "N/m", "force of tracts on the thread per length, else zero"),
)
ARRAYS: tuple[Column[Any], ...] = (*ORGAN_ARRAYS, *ORGAN_CELLS, *THREAD_ARRAYS, *PIERCING_ARRAYS, *TIE_ARRAYS)
UNITS = {column.name: column.unit for column in ARRAYS}  # of the arrays of a frame

RANGE: tuple[Column[Extremes], ...] = (
    Column("largest_strain", "-", "largest `strain` of a cell of the organ, over all frames", lambda met: met.strain),
    Column("largest_rotation", "rad", "largest `rotation` of a cell, over all frames", lambda met: met.rotation),
    Column(
        "strained_share",
        "-",
        f"largest share of strain energy in cells strained above {remarks.SMALL_STRAIN:g}",
        lambda met: met.strained,
    ),
    Column(
        "rotated_share",
        "-",
        f"the same for cells rotated above {remarks.SMALL_ROTATION:g} rad",
        lambda met: met.rotated,
    ),
    Column("pressed_turn", "rad", "largest turn of a pressed surface"),
)
HOLE_RANGE: tuple[Column[Sequence[float]], ...] = (
    Column("mean_strain", "-", "largest `mean_strain`, over all steps", lambda met: met[0]),
    Column("turn", "rad", "largest `turn`, over all steps", lambda met: met[1]),
    Column("bearing_pressure", "Pa", "largest `bearing_pressure`, over all steps", lambda met: met[2]),
    Column(
        "cell_strain",
        "-",
        "largest `strain` of the cells at the hole, over all frames",
        lambda met: met[3],
    ),
    Column("cell_energy", "Pa", "largest `energy_density` of these cells, over all frames", lambda met: met[4]),
)

REDUCTION: Column[ReductionRecord] = count("vectors", "vectors of the basis")
HOLE_REDUCTION: tuple[Column[tuple[float, float, float]], ...] = (
    Column(
        "difference",
        "m",
        "largest distance of the hole from its place with one block more",
        lambda small: small[0],
    ),
    Column("bound", "m", "largest bound of the distance from its place in the whole organ", lambda small: small[1]),
    Column(
        "force_difference",
        "N",
        "`difference` times the hole's largest static stiffness",
        lambda small: small[0] * small[2],
    ),
    Column("force_bound", "N", "`bound` times that stiffness", lambda small: small[1] * small[2]),
)

KRYLOV: tuple[Column[tuple[int, float]], ...] = (
    count("vectors", "vectors of the Krylov space; 0 once all unknowns are solved", lambda known: known[0]),
    Column(
        "residual",
        "-",
        "largest residual over the largest tissue force",
        lambda known: known[1],
    ),
)

RUN: tuple[Column[RunRecord], ...] = (
    text("status", "`completed`, `failed` or `interrupted`"),
    text("error", "reason if not completed, else empty"),
    Column("time", "s", "time reached", lambda run: run.last.time if run.last else 0.0),
    count("steps", "steps taken", lambda run: run.last.step if run.last else 0),
    count("newton_iterations", "Newton iterations of all steps"),
    Column("constraint_max", "m", "largest distance between a hole and its thread, over all steps"),
    Column(
        "seconds_per_step",
        "s",
        "mean wall-clock time without compilation; null before the first step",
        lambda run: run.seconds / run.last.step if run.last and run.last.step else None,
    ),
    count("tissue_dofs", "free unknowns of the organ"),
)


# -- the tables ------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Layout(Generic[Row]):
    """The layout of a table: its columns and `rows`, a function that returns the rows of a step.

    The second column is the step. `every_step`: whether each step has exactly one row.
    """

    name: str
    columns: tuple[Column[Row], ...]
    rows: Callable[[StepRecord], Iterable[Row]]
    every_step: bool = True


def step_columns(*columns: Column[StepRecord]) -> tuple[Column[StepItem[Any]], ...]:
    """Make columns of a row from columns of its step."""
    return tuple(_part_column(0, column) for column in columns)


def item_columns(*columns: Column[Item]) -> tuple[Column[StepItem[Item]], ...]:
    """Make columns of a row from columns of its item."""
    return tuple(_part_column(1, column) for column in columns)


def _part_column(place: int, column: Column[Any]) -> Column[Any]:
    """Return the column of a pair whose value comes from one of the two."""
    return replace(column, source=lambda pair: column.of(pair[place]))


def listed(
    name: str, columns: Iterable[Column[Item]], items: Callable[[StepRecord], Iterable[Item]]
) -> Layout[StepItem[Item]]:
    """Return the layout of a table with a row for each item of a step."""
    return Layout(
        name,
        (*step_columns(TIME, STEP), *item_columns(*columns)),
        lambda step: [(step, item) for item in items(step)],
        every_step=False,
    )


EVENT_TIME: Column[Event] = Column("time", "s", "time of the event, or the end of its step")

PIERCINGS = listed("piercings", (NAME, *HOLE), lambda step: step.piercings)
EVENTS: Layout[StepItem[Event]] = replace(
    listed("events", EVENT, lambda step: step.events),
    columns=(*item_columns(EVENT_TIME), *step_columns(STEP), *item_columns(*EVENT)),
)
ENERGIES = replace(listed("energy", ENERGY, lambda step: [step.energy]), every_step=True)
STEPS: Layout[StepRecord] = Layout("steps", (TIME, STEP, *SOLVED), lambda step: [step])
CONTACTS = listed("contact", (PAIR, *CONTACT), lambda step: step.contact)
LOADS = listed("loads", LOAD, lambda step: step.loads)
TRACTS = listed("tracts", (TRACT_NAME, *TRACT), lambda step: step.tracts)
TIES = listed("ties", (TIE_NAME, *TIE), lambda step: step.ties)
STITCHES = listed(
    "stitches",
    (STITCH_NAME, STITCH_PAIR, *STITCH),
    lambda step: [stitch for pair in step.contact for stitch in pair.stitches],
)
# The order of writing: if a table with one row per step has a step, the tables before it have this step too.
TABLES: tuple[Layout[Any], ...] = (PIERCINGS, EVENTS, LOADS, TRACTS, ENERGIES, STEPS, CONTACTS, STITCHES, TIES)


# -- the summary -----------------------------------------------------------------------------------------------------


def state_summary(step: StepRecord, holes: Iterable[Piercing] = (), thread: Thread | None = None) -> dict[str, Any]:
    """Return energy, thread, piercings, contact and ties of a step for ``summary.json``.

    The scenario's `holes` give the distances moved to the surface, and its `thread` the ramps.
    """
    found = {hole.name: values((MOVED,), hole) for hole in holes if hole.moved is not None}
    contact = {"contact": {pair.pair: _contact_summary(pair) for pair in step.contact}} if step.contact else {}
    ties = {"ties": {tie.name: values(TIE, tie) for tie in step.ties}} if step.ties else {}
    loads = {"loads": [values(LOAD, load) for load in step.loads]} if step.loads else {}
    tracts = {"tracts": {tract.tract: values(TRACT, tract) for tract in step.tracts}} if step.tracts else {}
    ends = {end: _end_summary(end, step) | _growth_summary(getattr(thread, end, None)) for end in ENDS}
    return (
        {
            "energy": values(ENERGY, step.energy),
            "thread": ends | values((MAX_STRAIN, SPAN_RATIO, SPANS_BETWEEN), step),
            "piercings": {hole.name: values(HOLE_SUMMARY, hole) | found.get(hole.name, {}) for hole in step.piercings},
        }
        | contact
        | ties
        | loads
        | tracts
    )


def _contact_summary(pair: ContactRecord) -> dict[str, Any]:
    """Return the quantities of two surfaces from their record, and by name the shares of their stitches."""
    return {**values(CONTACT, pair), "stitches": {one.stitch: values(STITCH, one) for one in pair.stitches}}


def range_summary(names: Iterable[str], extremes: Extremes) -> dict[str, Any]:
    """Return the largest strains and rotations of the tissue for ``summary.json``."""
    steps = extremes.mean_strain, extremes.turn, extremes.bearing_pressure
    frames = extremes.cell_strain, extremes.cell_energy
    each = zip(names, zip(*(of_holes.tolist() for of_holes in (*steps, *frames)), strict=True), strict=True)
    holes = {name: values(HOLE_RANGE, largest) for name, largest in each}
    return {**values(RANGE, extremes), "piercings": holes}


def reduction_summary(names: Iterable[str], extremes: Extremes, small: ReductionRecord) -> dict[str, Any]:
    """Return the error estimates of a small basis for ``summary.json``."""
    numbers = zip(*(each.tolist() for each in (extremes.difference, extremes.bound, small.stiffness)), strict=True)
    holes = {name: values(HOLE_REDUCTION, three) for name, three in zip(names, numbers, strict=True)}
    return {**values([REDUCTION], small), "piercings": holes}


def krylov_summary(extremes: Extremes, now: KrylovRecord) -> dict[str, Value]:
    """Return the size and residual of the organ's Krylov space for ``summary.json``."""
    return values(KRYLOV, (now.vectors, extremes.residual))


def end_columns(end: str) -> tuple[Column[Any], ...]:
    """Return the columns of an end of the thread with the names of the summary."""
    start = f"{end}_"
    return *(
        replace(
            column, name=column.name.removeprefix(start), parts=tuple(part.removeprefix(start) for part in column.parts)
        )
        for column in ENDS[end]
    ), GROWS


ANY = "*"  # for the name of a piercing, a pair, a tie …
SUMMARY: dict[tuple[str, ...], tuple[Column[Any], ...]] = {  # by the place in ``summary.json``
    (): RUN,
    ("energy",): ENERGY,
    **{("thread", end): end_columns(end) for end in ENDS},
    ("thread",): (MAX_STRAIN, SPAN_RATIO, SPANS_BETWEEN),
    ("piercings", ANY): (*HOLE_SUMMARY, MOVED, *ACCURACY),
    ("contact", ANY): CONTACT,
    ("contact", ANY, "stitches", ANY): STITCH,
    ("ties", ANY): TIE,
    ("loads", ANY): LOAD,
    ("range",): RANGE,
    ("range", "piercings", ANY): HOLE_RANGE,
    ("reduction",): (REDUCTION,),
    ("reduction", "piercings", ANY): HOLE_REDUCTION,
    ("krylov",): KRYLOV,
}


def _end_summary(end: str, step: StepRecord) -> dict[str, Value]:
    """Return the reaction at an end of the thread from a step, and the torque if there is one."""
    found = values(ENDS[end], step)
    return {name.removeprefix(f"{end}_"): value for name, value in found.items() if value is not None}


def _growth_summary(end: object) -> dict[str, Value]:
    """Return the ramp of a pulled end from its table in the scenario; empty for another end."""
    return values((GROWS,), end) if isinstance(end, PulledEnd) else {}


# -- the manual ------------------------------------------------------------------------------------------------------


def markdown(columns: Iterable[Column[Any]], what: str) -> str:
    """Return a list in Markdown; `what` is "column" (components by name), "array" or "key" (whole vectors)."""
    lines = []
    for column in columns:
        names = _in_short(column.parts) if what == "column" and column.parts else column.name
        unit = f" [{column.unit}]" if column.unit else ""
        lines.append(f"- `{names}`{unit}: {column.meaning}")
    return "\n".join(["", *lines, "", ""])


def _in_short(parts: tuple[str, ...]) -> str:
    """Return the names of components in short, as ``force_x/y/z``."""
    return "/".join((parts[0], *(part.rpartition("_")[2] for part in parts[1:])))


def manual_tables() -> dict[str, str]:
    """Return the tables of the manual by the name of their file."""
    tables = {*HOLE, *ENERGY, *CONTACT, *STITCH, *TIE, *LOAD}  # these have their own table
    keys = [
        replace(column, name=".".join(["NAME" if part == ANY else part for part in place] + [column.name]))
        for place, columns in SUMMARY.items()
        for column in columns
        if column not in tables
    ]
    return {
        "summary.json": markdown(keys, "key"),
        "remarks": remarks.markdown(),
        **{f"{layout.name}.csv": markdown(layout.columns[2:], "column") for layout in TABLES},
        "gap_profile.csv": markdown(GAP_PROFILE, "column"),
        "organ": markdown(ORGAN_ARRAYS, "array"),
        "organ_cells": markdown(ORGAN_CELLS, "array"),
        "thread": markdown(THREAD_ARRAYS, "array"),
        "piercings": markdown(HOLE_ARRAYS, "array"),
        "ties": markdown(TIE_ARRAYS[:1], "array"),
    }


def with_tables(manual: str, tables: Mapping[str, str]) -> str:
    """Return the manual with each table between its marks updated."""
    return with_blocks(manual, "columns of", tables)


if __name__ == "__main__":
    MANUAL.write_text(with_tables(MANUAL.read_text(encoding="utf-8"), manual_tables()), encoding="utf-8")
