"""The quantities of a results folder, each said once: name, unit, meaning, and what it is taken from.

A `Column` makes the heading of a CSV table, the name of an array in a frame, a key of ``summary.json`` and a line of
the manual (``python -m studies.output.columns`` writes those lines into it anew). To add a quantity, add its field to a
record of ``studies.output.records`` and one line here.
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
StepItem = tuple[StepRecord, Item]  # a row of a table: a step, and what of it the row is about

AXES = ("x", "y", "z")
STATE_CODES = {"stick": 0, "slip": 1, "anchored": 2, "left": 3}  # of `state` in the frames, where text has no place
TIE_CODES = {"open": 0, "drawn": 1, "tied": 2, "slips": 3, "held": 4}  # of `state` of a tie in the frames
MANUAL = Path(__file__).with_name("README.md")


@dataclass(frozen=True)
class Column(Generic[Row]):
    """A quantity: `name` (lower_snake_case), `unit` ("-" where it has none, empty for text), `meaning` for the manual,
    and `of`, which takes its value from a row's record; None where there is none.

    `kind` is that of a number in it. `parts` are the names of a vector's components in a table; none for a scalar.
    """

    name: str
    unit: str
    meaning: str
    of: Callable[[Row], Value]
    kind: Literal["number", "whole", "text"] = "number"
    parts: tuple[str, ...] = ()

    @property
    def headings(self) -> list[str]:
        """Headings in a CSV table, with the unit: `force_x [N]`."""
        unit = f" [{self.unit}]" if self.unit else ""
        return [name + unit for name in self.parts or (self.name,)]


def vector(name: str, unit: str, meaning: str, of: Callable[[Row], Value]) -> Column[Row]:
    """Make the column of a vector with three components along x, y and z."""
    return Column(name, unit, meaning, of, parts=tuple(f"{name}_{axis}" for axis in AXES))


def count(name: str, meaning: str, of: Callable[[Row], Value]) -> Column[Row]:
    """Make the column of a whole number."""
    return Column(name, "-", meaning, of, kind="whole")


def text(name: str, meaning: str, of: Callable[[Row], Value]) -> Column[Row]:
    """Make the column of a word."""
    return Column(name, "", meaning, of, kind="text")


def headings(columns: Iterable[Column[Any]]) -> list[str]:
    """List the headings of a CSV table."""
    return [heading for column in columns for heading in column.headings]


def values(columns: Iterable[Column[Row]], record: Row) -> dict[str, Value]:
    """Take the quantities of a record by name."""
    return {column.name: column.of(record) for column in columns}


# -- the quantities --------------------------------------------------------------------------------------------------


TIME: Column[StepRecord] = Column("time", "s", "time reached", lambda step: step.time)
STEP: Column[StepRecord] = count("step", "number of the step; 0 is the start", lambda step: step.step)

NAME: Column[PiercingRecord] = text("piercing", "name of the piercing", lambda hole: hole.name)
PLACE: Column[PiercingRecord] = Column("x", "m", "place of the hole", lambda hole: hole.x, parts=AXES)
STATE: Column[PiercingRecord] = text(
    "state",
    "`stick`, `slip`, `anchored`, or `left`: the thread is not in the hole, no longer or not yet",
    lambda hole: hole.state,
)
HOLE: tuple[Column[PiercingRecord], ...] = (
    Column(
        "s", "m", "abscissa of the thread in the hole: rest arc length from the start of the path", lambda hole: hole.s
    ),
    Column(
        "slip",
        "m",
        "length of thread drawn through towards the thread's end since the start, or since the piercing began",
        lambda hole: hole.slip,
    ),
    PLACE,
    vector("displacement", "m", "of the hole from its place in the reference shape", lambda hole: hole.displacement),
    vector("force", "N", "of the hole on the thread", lambda hole: hole.force),
    Column(
        "normal_force",
        "N",
        "force that presses the thread on the hole, across the thread: of `force` alone, or the sum over the two ends "
        "of a channel, which take the couple too",
        lambda hole: hole.normal_force,
    ),
    Column(
        "tangential_force",
        "N",
        "part of `force` along `tangent`: friction, and the configurational force where a direction is imposed",
        lambda hole: hole.tangential_force,
    ),
    vector(
        "couple", "N m", "of the hole on the thread: the reaction to the imposed direction", lambda hole: hole.couple
    ),
    Column(
        "tension_before",
        "N",
        "axial force of the thread at lower `s`, beyond its bend at the hole; positive in tension",
        lambda hole: hole.tension_before,
    ),
    Column("tension_after", "N", "the same at higher `s`", lambda hole: hole.tension_after),
    STATE,
    vector("tangent", "-", "unit vector along the thread in the hole, towards rising `s`", lambda hole: hole.tangent),
    Column(
        "cone_residual",
        "N",
        "by how much the force along the thread breaks Coulomb's law",
        lambda hole: hole.cone_residual,
    ),
    Column(
        "mean_strain",
        "-",
        "largest principal strain of the tissue across the hole's direction, in magnitude, averaged over the footprint",
        lambda hole: hole.mean_strain,
    ),
    Column("turn", "rad", "by which the tissue's frame at the hole is rotated", lambda hole: hole.turn),
    Column(
        "bearing_pressure",
        "Pa",
        "length of `force` over the thread's diameter and the length on which it bears: the channel's, else two "
        "footprints, over which the model spreads the force, else ten diameters",
        lambda hole: hole.bearing_pressure,
    ),
)
CHANNEL: Column[PiercingRecord] = Column(
    "channel",
    "m",
    "length of the channel on whose two ends the couple presses; null without friction or direction",
    lambda hole: hole.channel,
)
HOLE_SUMMARY = (*HOLE, CHANNEL)
MOVED: Column[Piercing] = Column(
    "moved", "m", "distance from `piercing.near` to the place on the surface; with `near`", lambda hole: hole.moved
)
HOLE_ARRAYS: tuple[Column[PiercingRecord], ...] = (
    count(
        "state", ", ".join(f"{code} {word}" for word, code in STATE_CODES.items()), lambda hole: STATE_CODES[hole.state]
    ),
    vector("u", "-", "first vector across the hole's direction, as it moves with the tissue", lambda hole: hole.u),
    vector("v", "-", "second vector across the hole's direction", lambda hole: hole.v),
)
PIERCING_ARRAYS = (*(column for column in HOLE if column not in (PLACE, STATE)), *HOLE_ARRAYS)

EVENT: tuple[Column[Event], ...] = (
    text(
        "event",
        "`begins`, `ends`, `leaves`, `slips`, `sticks` of a piercing, `tears` where the tissue's strength is exceeded; "
        "`taut`, `slack` of a strand; "
        "`closes`, `tied`, `slips`, `sticks`, `unties` of a tie; `slips`, `sticks` of surfaces in contact, and "
        "along a tract, as a whole or no more; `cut`: the thread was; `halved`: the step was; "
        "`snaps`: the tissue, or a thread that buckles, went to an equilibrium that was not near; "
        "`branch`: load steps failed, and the equilibrium was followed along its branch by arc length",
        lambda event: event.kind,
    ),
    text(
        "piercing",
        "name of the piercing, tie, tract or pair of surfaces, of a strand those of what it lies between, as in "
        "`entry-exit`, `start-entry`, `exit-end`; empty for `cut`, `halved`, `snaps`, `branch`",
        lambda event: event.piercing,
    ),
    Column(
        "s",
        "m",
        "abscissa of the thread in the hole, of the cut, or in the middle of the strand",
        lambda event: event.s,
    ),
    Column("energy", "J", "change of kinetic and elastic energy: `work` less `loss`", lambda event: event.energy),
    Column("work", "J", "done in drawing the thread into a hole that begins", lambda event: event.work),
    Column(
        "loss",
        "J",
        "of energy, by the impulse when a hole begins or by a cut",
        lambda event: event.loss,
    ),
    Column(
        "gap",
        "m",
        "between thread and hole, closed when it begins, or left between the strands of a tie that closes",
        lambda event: event.gap,
    ),
    Column("angle", "rad", "between thread and the hole's direction, closed when it begins", lambda event: event.angle),
    vector(
        "impulse",
        "N s",
        "of the hole on the thread when it begins; for `cut` the change of the thread's momentum",
        lambda event: event.impulse,
    ),
    count("control_points", "after a cut, else empty", lambda event: event.control_points or None),
)

ENERGY: tuple[Column[EnergyRecord], ...] = (
    Column("kinetic", "J", "kinetic energy of thread and organ", lambda energy: energy.kinetic),
    Column(
        "elastic_thread",
        "J",
        "elastic energy of the thread; in row 0 that of the bends in which it was laid",
        lambda energy: energy.elastic_thread,
    ),
    Column("elastic_tissue", "J", "elastic energy of the organ", lambda energy: energy.elastic_tissue),
    Column(
        "prestretch",
        "J",
        "the part of `elastic_tissue` that `tissue.prestretch` had stored at the start, what was cut open having gaped",
        lambda energy: energy.prestretch,
    ),
    Column(
        "external_work",
        "J",
        "of loads, gravity, holders and hands since the start, with the forces at the end of each step",
        lambda energy: energy.external_work,
    ),
    Column(
        "friction_dissipation",
        "J",
        "by friction in the holes, and of surfaces that press on one another, since the start",
        lambda energy: energy.friction_dissipation,
    ),
    Column("viscous_dissipation", "J", "by damping since the start", lambda energy: energy.viscous_dissipation),
    Column(
        "numerical_dissipation",
        "J",
        "by the integrator, contact included, since the start; negative: the scheme has created energy",
        lambda energy: energy.numerical_dissipation,
    ),
    Column(
        "balance_error",
        "J",
        "external work less the three dissipations and the change of kinetic and elastic energy: round-off",
        lambda energy: energy.balance_error,
    ),
)

MAX_STRAIN: Column[StepRecord] = Column(
    "max_strain", "-", "largest axial strain of the thread", lambda step: step.max_strain
)
SPAN_RATIO: Column[StepRecord] = Column(
    "span_ratio",
    "-",
    "longest span at a hole over the length that the thread bends over there; ⅓ is fine, above ½ too coarse",
    lambda step: step.span_ratio,
)
SPANS_BETWEEN: Column[StepRecord] = Column(
    "spans_between",
    "-",
    "spans between the two holes nearest to one another along the thread, null with fewer than two; 3 is fine, below 2 "
    "too coarse",
    lambda step: step.spans_between,
)
ENDS: dict[str, tuple[Column[StepRecord], Column[StepRecord]]] = {
    "start": (
        vector(
            "start_reaction", "N", "force of the holder of the start on the thread", lambda step: step.start_reaction
        ),
        Column(
            "start_torque",
            "N m",
            "of the holder of the start about the tangent; with `thread.twist`",
            lambda step: step.torques and step.torques[0],
        ),
    ),
    "end": (
        vector("end_reaction", "N", "force of the holder of the end on the thread", lambda step: step.end_reaction),
        Column(
            "end_torque",
            "N m",
            "of the holder of the end about the tangent; with `thread.twist`",
            lambda step: step.torques and step.torques[1],
        ),
    ),
}
GROWS: Column[PulledEnd] = Column(
    "grows_within",
    "s",
    "time in which the dead load on it grows from zero, 0: at once; where it is pulled",
    lambda end: end.ramp,
)
SOLVED: tuple[Column[StepRecord], ...] = (
    count("newton_iterations", "of this step", lambda step: step.newton_iterations),
    Column(
        "constraint_max",
        "m",
        "largest distance between a hole and the thread in it, which the solve leaves open",
        lambda step: step.constraint_max,
    ),
    MAX_STRAIN,
    Column("slide_speed", "m/s", "largest speed of the thread in a hole", lambda step: step.slide_speed),
    *(reaction for reaction, _ in ENDS.values()),
    *(torque for _, torque in ENDS.values()),
    Column(
        "seconds",
        "s",
        "wall-clock time of this step, compiling its loops left out; of steps made at once their mean",
        lambda step: step.seconds,
    ),
)

PAIR: Column[ContactRecord] = text("pair", "names of the two surfaces", lambda lips: lips.pair)
CONTACT: tuple[Column[ContactRecord], ...] = (
    count("pairs", "nodes of one that may meet the other", lambda lips: lips.pairs),
    count("pressed", "of them, under a force", lambda lips: lips.pressed),
    Column(
        "smallest_gap",
        "m",
        "of all pairs, along the normal of the surface; of a wound's lips along that of its plane",
        lambda lips: lips.smallest_gap,
    ),
    Column(
        "largest_gap",
        "m",
        "of the pairs that face one another: where most leaks; zero where none does",
        lambda lips: lips.largest_gap,
    ),
    Column(
        "open_area",
        "m²",
        f"of the pairs that face one another, where they are more than {APART:g} m apart: shares of the nodes",
        lambda lips: lips.open_area,
    ),
    Column(
        "gap_volume",
        "m³",
        "between them: the integral of the gap; over the length of a leak's way it is the mean area of its passage",
        lambda lips: lips.gap_volume,
    ),
    Column("slide", "m", "largest, of a pair past one another along the surfaces", lambda lips: lips.slide),
    Column("largest_pressure", "Pa", "of all pairs", lambda lips: lips.largest_pressure),
    Column("area", "m²", "under pressure: shares of the nodes", lambda lips: lips.area),
    Column("force", "N", "that pushes the two apart, in all: the sum of its magnitudes", lambda lips: lips.force),
    Column("complementarity", "J", "largest magnitude of force times gap of a pair", lambda lips: lips.complementarity),
    count(
        "slipping",
        "pressed nodes that slip with friction; the others stick where there is any",
        lambda lips: lips.slipping,
    ),
    Column(
        "friction",
        "N",
        "of the two on one another along the surfaces: the magnitude of its resultant",
        lambda lips: lips.friction,
    ),
    Column(
        "approximation",
        "-",
        f"share of the area where the two touch: are no more than {APART:g} m apart, nor as far through one another",
        lambda lips: lips.approximation,
    ),
    Column(
        "closure_force",
        "N",
        "that the thread draws the two together with across them: the mean of what it draws either by",
        lambda lips: lips.closure_force,
    ),
    Column(
        "eversion",
        "rad",
        "by how much the outer surface on both sides rises towards the edges where the stitches are, together and in "
        "the mean along them; negative: it is turned in; empty where they have no edge there",
        lambda lips: lips.eversion,
    ),
)

STITCH_NAME: Column[StitchRecord] = text("stitch", "its tie, its tract or its only hole", lambda stitch: stitch.stitch)
STITCH_PAIR: Column[StitchRecord] = text("pair", "names of the two surfaces that it draws together", lambda s: s.pair)
STITCH: tuple[Column[StitchRecord], ...] = (
    Column(
        "left_force",
        "N",
        "of the thread on the tissue on one side of them, towards the other side, across the surfaces as they were at "
        "first",
        lambda stitch: stitch.left_force,
    ),
    Column("right_force", "N", "likewise on the other side", lambda stitch: stitch.right_force),
    Column(
        "load_share",
        "-",
        "of what all stitches draw the two surfaces by; empty where that is nothing",
        lambda stitch: stitch.load_share,
    ),
)

GAP_PROFILE: tuple[Column[GapRecord], ...] = (
    text("pair", "names of the two surfaces", lambda gap: gap.pair),
    Column("way", "m", "along the rim in the shape at rest", lambda gap: gap.way),
    Column("x", "m", "place", lambda gap: gap.x, parts=AXES),
    Column("edge_gap", "m", "of the rim; empty where it faces nothing", lambda gap: gap.edge_gap),
    Column(
        "largest_gap",
        "m",
        "of the part of the surface that is nearest to this place of its rim; empty where it faces nothing",
        lambda gap: gap.largest_gap,
    ),
    Column("largest_pressure", "Pa", "of that part", lambda gap: gap.largest_pressure),
)

TRACT_NAME: Column[TractRecord] = text("tract", "names of the two holes it is between", lambda tract: tract.tract)
TRACT: tuple[Column[TractRecord], ...] = (
    count("balls", "of tissue in a row along the thread's path", lambda tract: len(tract.balls)),
    Column("length", "m", "of the path on which the thread bears: deep enough in the tissue", lambda t: t.length),
    Column("spacing", "m", "of the balls along it, at most", lambda tract: tract.spacing),
    vector("force", "N", "of the tissue on the thread along the tract, in all", lambda tract: tract.force),
    Column("normal_force", "N", "sum over the balls of the forces across the thread", lambda tract: tract.normal_force),
    Column("friction", "N", "sum of the forces along the thread, towards rising `s`", lambda tract: tract.friction),
    Column("bearing", "N/m", "largest force across the thread per length of it", lambda tract: tract.bearing),
    Column(
        "bearing_pressure",
        "Pa",
        "largest force on a ball over the thread's diameter and the length that the ball stands for",
        lambda tract: tract.bearing_pressure,
    ),
    Column("displacement", "m", "largest, of a ball from its place in the reference shape", lambda t: t.displacement),
    Column("tension_before", "N", "of the thread before the first ball", lambda tract: tract.balls[0].tension_before),
    Column("tension_after", "N", "of the thread after the last ball", lambda tract: tract.balls[-1].tension_after),
    count("slipping", "balls along which the thread slips", lambda tract: tract.slipping),
)

LOAD: tuple[Column[LoadRecord], ...] = (
    text("boundary", "name of the boundary that it acts on", lambda load: load.boundary),
    Column("share", "-", "of the load, that acts now", lambda load: load.share),
    Column("area", "m²", "of the boundary in the reference shape", lambda load: load.area),
    vector("force", "N", "on the organ, in all", lambda load: load.force),
)

TIE_NAME: Column[TieRecord] = text("tie", "name of the tie", lambda tie: tie.name)
TIE_PLACE: Column[TieRecord] = Column("x", "m", "place of the tie", lambda tie: tie.x, parts=AXES)
TIE_STATE: Column[TieRecord] = text(
    "state",
    "`open`: not closed yet, or undone; `held` together at rest until it is `drawn` by hands; `tied`; `slips`: above "
    "what it holds",
    lambda tie: tie.state,
)
TIE_NUMBERS: tuple[Column[TieRecord], ...] = (
    Column("force", "N", "tension of the strands where the tie holds them", lambda tie: tie.force),
    Column("length", "m", "of the thread in the loop, unstrained; none of a loop that is cut", lambda tie: tie.length),
    Column("gap", "m", "left between the strands, which hands bring together", lambda tie: tie.gap),
    Column("work", "J", "of the hands on the tie", lambda tie: tie.work),
    Column("s_first", "m", "abscissa of the strand at lower `s`", lambda tie: tie.s_first),
    Column("s_second", "m", "abscissa of the other strand", lambda tie: tie.s_second),
)
TIE: tuple[Column[TieRecord], ...] = (TIE_STATE, *TIE_NUMBERS, TIE_PLACE)
TIE_ARRAYS: tuple[Column[TieRecord], ...] = (
    count("state", ", ".join(f"{code} {word}" for word, code in TIE_CODES.items()), lambda tie: TIE_CODES[tie.state]),
    *TIE_NUMBERS,
)

ORGAN_ARRAYS: tuple[Column[OrganRecord], ...] = (
    vector("displacement", "m", "from the reference shape, in which the points are", lambda organ: organ.displacement),
    Column(
        "stress",
        "Pa",
        "recovered at the nodes: xx, yy, zz, xy, yz, xz",
        lambda organ: organ.stress,
        parts=tuple(f"stress_{pair}" for pair in ("xx", "yy", "zz", "xy", "yz", "xz")),
    ),
    Column("von_mises", "Pa", "equivalent of that stress", lambda organ: organ.von_mises),
    Column(
        "principal_stress",
        "Pa",
        "principal values of that stress, falling; a push is negative",
        lambda organ: organ.principal_stress,
        parts=("stress_first", "stress_second", "stress_third"),
    ),
    vector("first_direction", "-", "unit vector of the first of them, of either sense", lambda o: o.first_direction),
    vector("third_direction", "-", "unit vector of the third, of either sense", lambda o: o.third_direction),
    Column(
        "nodal_volume_ratio",
        "-",
        "J averaged at the vertices by their hat functions, as nearly incompressible tissue is held to it; midway "
        "along edges the mean of both ends",
        lambda organ: organ.nodal_volume_ratio,
    ),
    Column(
        "contact_pressure",
        "Pa",
        "on surfaces that may touch, zero off them; with contact",
        lambda organ: organ.contact_pressure,
    ),
    Column("lip_gap", "m", "between them, not a number off them; with contact", lambda organ: organ.lip_gap),
)
ORGAN_CELLS: tuple[Column[OrganRecord], ...] = (
    Column(
        "strain",
        "-",
        "largest principal strain in the cell, in magnitude, of the mesh alone",
        lambda organ: organ.strain,
    ),
    Column("rotation", "rad", "largest rotation in the cell, half the length of curl U", lambda organ: organ.rotation),
    Column(
        "energy_density",
        "Pa",
        "strain energy per volume, on the mean of the cell; times the volumes it adds up to that of the mesh",
        lambda organ: organ.energy_density,
    ),
    Column(
        "volume_ratio",
        "-",
        "J: volume between the corners of the cell over that before, 1 where tissue keeps its volume",
        lambda organ: organ.volume_ratio,
    ),
    Column(
        "principal_stretch",
        "-",
        "principal stretches of the mean of the cell, falling; at finite strain",
        lambda organ: organ.principal_stretch,
        parts=("stretch_first", "stretch_second", "stretch_third"),
    ),
    vector(
        "first_stretch",
        "-",
        "unit vector of the first of them as tissue lies; at finite strain",
        lambda o: o.first_stretch,
    ),
    vector("third_stretch", "-", "unit vector of the third, likewise", lambda o: o.third_stretch),
)
THREAD_ARRAYS: tuple[Column[ThreadRecord], ...] = (
    Column("s", "m", "abscissa: rest arc length from the start of the path", lambda thread: thread.s),
    Column("tension", "N", "axial force; a push is negative", lambda thread: thread.tension),
    Column("curvature", "1/m", "of the thread's axis", lambda thread: thread.curvature),
    Column(
        "radius", "m", "of the thread, for the Tube filter", lambda thread: np.full(len(thread.points), thread.radius)
    ),
    Column("torque", "N m", "about the tangent, right-handed; with `thread.twist`", lambda thread: thread.torque),
    vector(
        "bearing",
        "N/m",
        "force of the tissue along tracts on the thread, per length; zero elsewhere; with `tract`",
        lambda thread: thread.bearing,
    ),
)
ARRAYS: tuple[Column[Any], ...] = (*ORGAN_ARRAYS, *ORGAN_CELLS, *THREAD_ARRAYS, *PIERCING_ARRAYS, *TIE_ARRAYS)
UNITS = {column.name: column.unit for column in ARRAYS}  # of the arrays of a frame

RANGE: tuple[Column[Extremes], ...] = (
    Column("largest_strain", "-", "largest `strain` of a cell of the organ, over all frames", lambda met: met.strain),
    Column("largest_rotation", "rad", "largest `rotation` of a cell, over all frames", lambda met: met.rotation),
    Column(
        "strained_share",
        "-",
        f"largest share of the organ's strain energy in cells strained by more than {remarks.SMALL_STRAIN:g}",
        lambda met: met.strained,
    ),
    Column(
        "rotated_share",
        "-",
        f"the same in cells rotated by more than {remarks.SMALL_ROTATION:g} rad",
        lambda met: met.rotated,
    ),
    Column(
        "pressed_turn",
        "rad",
        "largest angle by which a surface under a pressure turned, over all frames",
        lambda met: met.pressed_turn,
    ),
)
HOLE_RANGE: tuple[Column[Sequence[float]], ...] = (
    Column("mean_strain", "-", "largest `mean_strain` of the piercing, over all steps", lambda met: met[0]),
    Column("turn", "rad", "largest `turn` of the piercing, over all steps", lambda met: met[1]),
    Column("bearing_pressure", "Pa", "largest `bearing_pressure`, over all steps", lambda met: met[2]),
    Column(
        "cell_strain",
        "-",
        "largest `strain` of the cells on which the hole bears, over all frames; at finite strain the stretch that is "
        "farthest from one, less one",
        lambda met: met[3],
    ),
    Column("cell_energy", "Pa", "largest `energy_density` of them, over all frames", lambda met: met[4]),
)

REDUCTION: Column[ReductionRecord] = count("vectors", "of the basis", lambda small: small.vectors)
HOLE_REDUCTION: tuple[Column[tuple[float, float, float]], ...] = (
    Column(
        "difference",
        "m",
        "largest distance between the hole and its place in a basis with one block more: the error but for what that "
        "basis, too, leaves open",
        lambda small: small[0],
    ),
    Column(
        "bound",
        "m",
        "largest bound of the distance to the hole's place in the whole organ under the same forces",
        lambda small: small[1],
    ),
    Column(
        "force_difference",
        "N",
        "`difference` times the hole's largest static stiffness: the force that makes up for it",
        lambda small: small[0] * small[2],
    ),
    Column("force_bound", "N", "`bound` times that stiffness", lambda small: small[1] * small[2]),
)

KRYLOV: tuple[Column[tuple[int, float]], ...] = (
    count(
        "vectors",
        "of the space in which the organ is solved; 0 where it no longer follows the motion, and the organ is solved "
        "whole",
        lambda known: known[0],
    ),
    Column(
        "residual",
        "-",
        "largest residual of the equations of motion of all unknowns, over the largest forces of the tissue so far",
        lambda known: known[1],
    ),
)

RUN: tuple[Column[RunRecord], ...] = (
    text("status", "`completed`, `failed` or `interrupted`", lambda run: run.status),
    text("error", "what ended a run that was not completed; else empty", lambda run: run.error),
    Column("time", "s", "time reached", lambda run: run.last.time if run.last else 0.0),
    count("steps", "steps taken", lambda run: run.last.step if run.last else 0),
    count("newton_iterations", "of all steps", lambda run: run.newton_iterations),
    Column(
        "constraint_max",
        "m",
        "largest distance between a hole and the thread in it, which the solve leaves open, over all steps",
        lambda run: run.constraint_max,
    ),
    Column(
        "seconds_per_step",
        "s",
        "wall-clock time of a step on average, compiling its loops left out; null before the first",
        lambda run: run.seconds / run.last.step if run.last and run.last.step else None,
    ),
    count(
        "tissue_dofs",
        "unknowns of the organ that are not held, with those of the springs at its holes",
        lambda run: run.tissue_dofs,
    ),
)


# -- the tables ------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Layout(Generic[Row]):
    """What a table holds: its columns, of which the step is the second, and `rows`, which takes its rows from a step.

    `every_step`: whether each step has exactly one row.
    """

    name: str
    columns: tuple[Column[Row], ...]
    rows: Callable[[StepRecord], Iterable[Row]]
    every_step: bool = True


def step_columns(*columns: Column[StepRecord]) -> tuple[Column[StepItem[Any]], ...]:
    """Make columns of a row from columns of its step."""
    return tuple(_part_column(0, column) for column in columns)


def item_columns(*columns: Column[Item]) -> tuple[Column[StepItem[Item]], ...]:
    """Make columns of a row from columns of what of the step the row is about."""
    return tuple(_part_column(1, column) for column in columns)


def _part_column(place: int, column: Column[Any]) -> Column[Any]:
    """Return the column of a pair that takes its value from one of the two."""
    of = column.of
    return replace(column, of=lambda pair: of(pair[place]))


EVENT_TIME: Column[Event] = Column(
    "time",
    "s",
    "when it happened; of what only the ends of a step tell, the end of that step or of a part of it",
    lambda event: event.time,
)

PIERCINGS: Layout[StepItem[PiercingRecord]] = Layout(
    "piercings",
    (*step_columns(TIME, STEP), *item_columns(NAME, *HOLE)),
    lambda step: [(step, hole) for hole in step.piercings],
    every_step=False,
)
EVENTS: Layout[StepItem[Event]] = Layout(
    "events",
    (*item_columns(EVENT_TIME), *step_columns(STEP), *item_columns(*EVENT)),
    lambda step: [(step, event) for event in step.events],
    every_step=False,
)
ENERGIES: Layout[StepItem[EnergyRecord]] = Layout(
    "energy", (*step_columns(TIME, STEP), *item_columns(*ENERGY)), lambda step: [(step, step.energy)]
)
STEPS: Layout[StepRecord] = Layout("steps", (TIME, STEP, *SOLVED), lambda step: [step])
CONTACTS: Layout[StepItem[ContactRecord]] = Layout(
    "contact",
    (*step_columns(TIME, STEP), *item_columns(PAIR, *CONTACT)),
    lambda step: [(step, pair) for pair in step.contact],
    every_step=False,
)
LOADS: Layout[StepItem[LoadRecord]] = Layout(
    "loads",
    (*step_columns(TIME, STEP), *item_columns(*LOAD)),
    lambda step: [(step, load) for load in step.loads],
    every_step=False,
)
TRACTS: Layout[StepItem[TractRecord]] = Layout(
    "tracts",
    (*step_columns(TIME, STEP), *item_columns(TRACT_NAME, *TRACT)),
    lambda step: [(step, tract) for tract in step.tracts],
    every_step=False,
)
TIES: Layout[StepItem[TieRecord]] = Layout(
    "ties",
    (*step_columns(TIME, STEP), *item_columns(TIE_NAME, *TIE)),
    lambda step: [(step, tie) for tie in step.ties],
    every_step=False,
)
STITCHES: Layout[StepItem[StitchRecord]] = Layout(
    "stitches",
    (*step_columns(TIME, STEP), *item_columns(STITCH_NAME, STITCH_PAIR, *STITCH)),
    lambda step: [(step, stitch) for pair in step.contact for stitch in pair.stitches],
    every_step=False,
)
# In the order in which they are written: where a table with a row for every step has a step, those before it have too.
TABLES: tuple[Layout[Any], ...] = (PIERCINGS, EVENTS, LOADS, TRACTS, ENERGIES, STEPS, CONTACTS, STITCHES, TIES)


# -- the summary -----------------------------------------------------------------------------------------------------


def state_summary(step: StepRecord, holes: Iterable[Piercing] = (), thread: Thread | None = None) -> dict[str, Any]:
    """Take from a step what ``summary.json`` says of energy, thread, piercings, lips and ties, and from the scenario's
    `holes` by how much they were moved, from its `thread` how its dead loads grow."""
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
    """Take what two surfaces do from their record, and by name what each stitch bears of them."""
    return {**values(CONTACT, pair), "stitches": {one.stitch: values(STITCH, one) for one in pair.stitches}}


def range_summary(names: Iterable[str], extremes: Extremes) -> dict[str, Any]:
    """Make what ``summary.json`` says of how far the tissue of a run was strained and turned."""
    steps = extremes.mean_strain, extremes.turn, extremes.bearing_pressure
    frames = extremes.cell_strain, extremes.cell_energy
    each = zip(names, zip(*(of_holes.tolist() for of_holes in (*steps, *frames)), strict=True), strict=True)
    holes = {name: values(HOLE_RANGE, largest) for name, largest in each}
    return {**values(RANGE, extremes), "piercings": holes}


def reduction_summary(names: Iterable[str], extremes: Extremes, small: ReductionRecord) -> dict[str, Any]:
    """Make what ``summary.json`` says of how far a small basis of the organ was off."""
    numbers = zip(*(each.tolist() for each in (extremes.difference, extremes.bound, small.stiffness)), strict=True)
    holes = {name: values(HOLE_REDUCTION, three) for name, three in zip(names, numbers, strict=True)}
    return {**values([REDUCTION], small), "piercings": holes}


def krylov_summary(extremes: Extremes, now: KrylovRecord) -> dict[str, Value]:
    """Make what ``summary.json`` says of the Krylov space of the organ."""
    return values(KRYLOV, (now.vectors, extremes.residual))


def _end_summary(end: str, step: StepRecord) -> dict[str, Value]:
    """Take the reaction at an end of the thread from a step, and the torque where there is one."""
    found = values(ENDS[end], step)
    return {name.removeprefix(f"{end}_"): value for name, value in found.items() if value is not None}


def _growth_summary(end: object) -> dict[str, Value]:
    """Take how the dead load on an end of the thread grows from its table in the scenario; nothing of one without."""
    return values((GROWS,), end) if isinstance(end, PulledEnd) else {}


# -- the manual ------------------------------------------------------------------------------------------------------


def markdown(columns: Iterable[Column[Any]], what: str) -> str:
    """Make a table in Markdown; `what` is "column" (components by name), "array" or "key" (vectors whole)."""
    lines = [f"| {what} | unit | meaning |", "|---|---|---|"]
    for column in columns:
        names = column.parts if what == "column" and column.parts else (column.name,)
        lines.append(f"| {', '.join(f'`{name}`' for name in names)} | {column.unit} | {column.meaning} |")
    return "\n".join(lines) + "\n"


def manual_tables() -> dict[str, str]:
    """Make the tables of the manual, by the name of their file."""
    ends: list[Column[Any]] = [
        replace(column, name=f"thread.{end}.{column.name.removeprefix(f'{end}_')}")
        for end, pair in ENDS.items()
        for column in pair
    ]
    ends += [replace(GROWS, name=f"thread.{end}.{GROWS.name}") for end in ENDS]
    sums = [replace(column, name=f"thread.{column.name}") for column in (MAX_STRAIN, SPAN_RATIO, SPANS_BETWEEN)]
    ranges: list[Column[Any]] = [replace(column, name=f"range.{column.name}") for column in RANGE]
    ranges += [replace(column, name=f"range.piercings.NAME.{column.name}") for column in HOLE_RANGE]
    told: tuple[Column[Any], ...] = (CHANNEL, MOVED)
    holes = [replace(column, name=f"piercings.NAME.{column.name}") for column in told]
    small: list[Column[Any]] = [replace(REDUCTION, name=f"reduction.{REDUCTION.name}")]
    small += [replace(column, name=f"reduction.piercings.NAME.{column.name}") for column in HOLE_REDUCTION]
    spaces: list[Column[Any]] = [replace(column, name=f"krylov.{column.name}") for column in KRYLOV]
    return {
        "summary.json": markdown([*RUN, *ends, *sums, *holes, *ranges, *small, *spaces], "key"),
        "remarks": remarks.markdown(),
        **{f"{layout.name}.csv": markdown(layout.columns, "column") for layout in TABLES},
        "gap_profile.csv": markdown(GAP_PROFILE, "column"),
        "organ": markdown(ORGAN_ARRAYS, "array"),
        "organ_cells": markdown(ORGAN_CELLS, "array"),
        "thread": markdown(THREAD_ARRAYS, "array"),
        "piercings": markdown(HOLE_ARRAYS, "array"),
        "ties": markdown(TIE_ARRAYS, "array"),
    }


def with_tables(manual: str, tables: Mapping[str, str]) -> str:
    """Return the manual with each table between its marks made anew."""
    return with_blocks(manual, "columns of", tables)


if __name__ == "__main__":
    MANUAL.write_text(with_tables(MANUAL.read_text(encoding="utf-8"), manual_tables()), encoding="utf-8")
