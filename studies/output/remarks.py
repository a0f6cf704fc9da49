"""Remarks: what a run says of its own numbers, in `summary.json`, on the console and from Python.

The catalogue has each code once, with its severity, the bound that it is said beyond, and why there. A remark of the
severity "unsupported" says that a number of the run is not what its model means; a "note" says what a reader should
know. Who judges a run is `studies.simulation.remarks`.
"""

from collections.abc import Iterable
from dataclasses import asdict, dataclass
from typing import Literal

from studies.output.records import SEEN, SWITCHES

Severity = Literal["note", "unsupported"]

SMALL_STRAIN = 0.2  # linear elasticity leaves out ½ε² beside ε: a tenth of it here
SMALL_ROTATION = 0.2  # rad: a rotation alone strains a linear body by 1 − cos θ, which is 0.02 here
RULES = 1.1  # of the force across the thread: beyond, what presses at a hole is its couple, over the channel
UNSURE = 0.05  # of the tension: how far friction over half and over twice the channel may be apart
SHARE = 0.05  # of the organ's strain energy: what less of it does decides no force
THREAD_STRAIN = 0.1  # a line through the origin fits the stress of monofilaments about as far (assumption)
KINKED = 1.0  # diameters: in a bend of a smaller radius the fibres inside would be at half their length, and less
OFF_PATH = 10.0  # diameters: as far as the thread is drawn into a hole that begins
CREATED = 1e-4  # of a run's energy: round-off is 1e-9 of it, and the shipped scenes create none at their steps
DISSIPATED = 0.05  # of a run's energy
OUTDONE = 1.0  # of what friction took: beyond, the steps had more to do with where a thread that slid came to stay
FALLEN = 1e-6  # of the loads: round-off is less
CROSSED = 0.01  # of the lips' extent: nearer, they are as good as closed
SWUNG = 0.01  # of the largest force
SLID = 1.0  # diameters that a thread may still slide in as long as the run took, and be at rest
STEEP = 1.0  # friction along a surface over the force across it
BARE = 4.0  # radii of a tract: as much of its path is near the surface where it goes in and out at 30° or more
STIFF = 1.0  # EI times the turn from a ball to the next, over T r²: 2 % of what a bite of two or four radii closes
SLIGHT = 0.05  # rad from a ball to the next: a slack thread that bends less lies straight in its tract
IN_TISSUE = 1.0  # diameters of the thread: deeper, it lies in tissue and not on it
MOVED = 2.0  # footprints: as far as a hole may be moved and still touch where it would have been
NEAR = 2.0  # of the footprints of two holes together: there a hole moves its neighbour by a quarter of its own way
RESOLVED_SHARE = 0.03  # of a hole's compliance that springs may make up: no more than its own error
REDUCED = 0.03  # of the largest way of a hole that a small basis may leave open: as much as springs may
COARSE = {"P1": 0.25, "P2": 0.5}  # footprints to a cell: the compliance of the hole is then within 8 %


@dataclass(frozen=True)
class Kind:
    """A kind of remark: `bound`, beyond which it is said, and `reason`, both for the manual."""

    code: str
    severity: Severity
    bound: str
    reason: str


@dataclass(frozen=True)
class Remark:
    """What is said of a run: `where` names a piercing, a key, or a part of the run."""

    code: str
    severity: Severity
    message: str
    where: str

    @property
    def unsupported(self) -> bool:
        """Whether a number is not supported."""
        return self.severity == "unsupported"

    @property
    def line(self) -> str:
        """The remark to be read by a person."""
        return f"{self.severity}: {self.message} [{self.code}]"

    def record(self) -> dict[str, str]:
        """Return the remark as `summary.json` has it."""
        return asdict(self)


KINDS = (
    Kind(
        "demand",
        "unsupported",
        f"at the start, a pull that would draw a hole of a linear organ by {SMALL_STRAIN:g} footprints and more",
        "0.6 F/(E a²) is how far a half-space gives way; the tissue at the hole is then strained by about as much",
    ),
    Kind(
        "stiff-thread",
        "unsupported",
        "before the first step, a couple 2 sin(θ/2) √(EI T) of a taut thread, or 1.6 EI θ/ℓ of one bent within the way "
        f"ℓ to the next hole or hand, above {SMALL_ROTATION:g} E a³ at a hole of a linear organ that imposes a "
        "direction; θ is the angle from the path there to the next hole or load",
        "E a³ is about the couple that turns a footprint on a half-space by a radian",
    ),
    Kind(
        "pull-strength",
        "unsupported",
        "before the first step, a pull above the least knot-pull strength of `suture catalogue`, where that is known, "
        f"or above what stretches the thread by {THREAD_STRAIN:g}",
        "a suture of that size may break there, and none does in a run; its law is linear, and sutures are so at small "
        "strains alone",
    ),
    Kind(
        "hole-strain",
        "unsupported",
        f"mean strain at a hole above {SMALL_STRAIN:g}",
        "the second-order part of the strain, which linear elasticity leaves out, is then a tenth of it",
    ),
    Kind(
        "hole-rotation",
        "unsupported",
        f"turn of a hole above {SMALL_ROTATION:g} rad",
        "a rotation alone strains a linear body by 1 − cos θ, which is 0.02 there",
    ),
    Kind(
        "subgrid-strain",
        "unsupported",
        f"sub-grid springs at a hole at finite strain drawn out by {SMALL_STRAIN:g} footprints, or so far that tissue "
        f"which stiffens makes them {RESOLVED_SHARE:.0%} of the hole's compliance too soft",
        "springs that make up for coarse cells are linear: where the tissue they stand for is not, they are a model",
    ),
    Kind(
        "tissue-strain",
        "unsupported",
        f"strain above {SMALL_STRAIN:g} in cells with more than {SHARE:.0%} of the organ's strain energy",
        "as at a hole; so much of the energy decides forces",
    ),
    Kind(
        "tissue-rotation",
        "unsupported",
        f"rotation above {SMALL_ROTATION:g} rad in cells with more than {SHARE:.0%} of the organ's strain energy",
        "as at a hole",
    ),
    Kind(
        "local-strain",
        "note",
        f"strain above {SMALL_STRAIN:g} in cells with less of it",
        "at an edge, a clamp or a wound's tip strain has no limit under refinement: stress there means nothing",
    ),
    Kind(
        "tears",
        "unsupported",
        "bearing pressure at a hole above tissue.strength, where that is given",
        "the tissue may tear there; none tears in a run",
    ),
    Kind(
        "pressure-turn",
        "unsupported",
        f"surface of a linear organ under a pressure turned by more than {SMALL_ROTATION:g} rad",
        "there the pressure acts along the normals of the reference shape, and does not follow the surface",
    ),
    Kind(
        "lips-cross",
        "unsupported",
        f"lips of a wound more than {CROSSED:g} of their extent through one another",
        "without `tissue.contact` they do not press on one another: what closes them meets no resistance any more",
    ),
    Kind(
        "thread-strength",
        "unsupported",
        "tension above the least knot-pull strength of `suture catalogue`, where that is known",
        "a suture of that size may break there; no thread breaks in a run",
    ),
    Kind(
        "thread-strain",
        "unsupported",
        f"axial strain of the thread above {THREAD_STRAIN:g}",
        "its law is linear, and sutures are so at small strains alone",
    ),
    Kind(
        "channel",
        "note",
        f"a rough hole that imposes a direction and names no `channel`, where what presses is above {RULES:g} of the "
        f"force across the thread, and friction over half and over twice the channel differs by {UNSURE:.0%} of the "
        "tension, at the end of the run",
        "the couple presses on the ends of the channel with itself over its length; the path tells how deep the bite "
        "is, and not over how much of it the tissue guides the thread",
    ),
    Kind(
        "spans",
        "unsupported",
        "`thread.span_ratio` above 0.5 at the end",
        "forces along the thread are then off by several per cent, and at a single moment the friction of a hole that "
        "gives the thread its direction by a tenth to two fifths, by a fifth to one and a half times where the thread "
        "bends there and back",
    ),
    Kind(
        "spans-between",
        "unsupported",
        "`thread.spans_between` below 2 at the end",
        "on so few spans the thread does not bend between them as it would",
    ),
    Kind(
        "energy-created",
        "unsupported",
        f"numerical dissipation below −{CREATED:g} of the run's energy at any time",
        "a scheme that creates energy drives the motion itself",
    ),
    Kind(
        "numerical-dissipation",
        "note",
        f"above {DISSIPATED:.0%} of the run's energy at the end, where friction acts or forces still swing "
        "(`forces-swing`); or above what friction took, where a thread slid through a hole by more than its diameter",
        "what moves has been damped by the steps in time, and friction keeps what the way there did, and how far a "
        "thread slid; what has come to rest without it does not know how",
    ),
    Kind(
        "slides-freely",
        "unsupported",
        "a run at rest of a thread that slides without friction in all its holes, with no end of it held",
        "under the same pull at both ends it slides as a whole at no cost: the slip of each hole depends on the load "
        "steps; forces, places and what is drawn between two holes do not",
    ),
    Kind(
        "not-held",
        "note",
        "a run in time of an organ without a clamp, a roller or a surface that touches another",
        "thread and loads move it as a whole, by what its mass allows",
    ),
    Kind(
        "would-not-stay",
        "unsupported",
        "at the end of a run at rest, or of one in time that came to rest, a motion of the thread in its holes that "
        "lowers its potential",
        "Newton's method follows equilibria beyond the point where a thread buckles, snaps or rolls over; it would "
        "leave this one at the least disturbance, and none that holds was found downhill",
    ),
    Kind(
        "branch",
        "note",
        "load steps failed, and the equilibrium was followed along its branch by arc length",
        "each equilibrium on the way is one, but whether it holds is not asked on the way",
    ),
    Kind(
        "limit-point",
        "unsupported",
        f"on a branch that was followed by arc length the loads fell by more than {FALLEN:g} of the full loads",
        "beyond a limit point the branch goes on under less load: under loads that only rise, thread or tissue jump "
        "there, and may come to rest on another branch",
    ),
    Kind(
        "not-at-rest",
        "note",
        "at the end of a dynamic run, kinetic energy above 1e-4 of the elastic, or thread that would slide by more "
        "than its diameter in as long again",
        "the last numbers are of a moment, not of an equilibrium",
    ),
    Kind(
        "forces-swing",
        "note",
        f"at the end of a dynamic run, the force of a hole over the last {SEEN} steps more than {SWUNG:.0%} of the "
        "largest off a straight course",
        "what swings within so few steps is late and damped by them, and shorter ones have it elsewhere at that time",
    ),
    Kind(
        "chatter",
        "note",
        f"in a dynamic run, a hole that changes between stick and slip {SWITCHES} times within {SEEN} steps",
        "when it slips and when it sticks is then a matter of the steps, and so are the times of these events; shorter "
        "steps tell of more of them, or of fewer",
    ),
    Kind(
        "subgrid",
        "unsupported",
        "no patch of the cells around a hole makes up for their coarseness",
        "nothing is added there: the hole is as stiff as its cells",
    ),
    Kind(
        "cells",
        "unsupported",
        f"without `piercing.subgrid`, cells above {COARSE['P1']:g} (P1) or {COARSE['P2']:g} (P2) of the footprint",
        "the mesh is then too stiff at the hole by more than some 8 %",
    ),
    Kind(
        "accuracy",
        "unsupported",
        "a hole whose compliance is estimated to be less accurate than `tissue.mesh.accuracy`",
        "the refinement ended after its last round, or before one for which there is no memory",
    ),
    Kind(
        "bare-point",
        "unsupported",
        "a footprint of zero in an organ",
        "the displacement of a point has no limit under refinement",
    ),
    Kind(
        "holes-near",
        "note",
        f"two holes within {NEAR:g} times their footprints together, centre to centre",
        "each then moves the other by a quarter of its own way, and more",
    ),
    Kind(
        "off-path",
        "note",
        f"a piercing more than {OFF_PATH:g} diameters from `thread.path`",
        "the thread is bent to it at the start, and the energy of that goes where the damping takes it",
    ),
    Kind(
        "kinked",
        "note",
        f"a thread laid in a bend whose radius is less than {KINKED:g} of its diameters",
        "no suture bends so and stays elastic; at the start it swings back from there",
    ),
    Kind(
        "after-end",
        "note",
        "a cut, a tie or a piercing that begins, after `solve.duration`",
        "it does not happen in this run; it may in one that goes on from it",
    ),
    Kind(
        "rest-unloaded",
        "note",
        'with `solve.start = "rest"`, a dead load on an end of the thread that grows within a `ramp` of its own',
        "there is none of it at t = 0: the rest that the run starts from is without it, and slack that it takes up is "
        "taken up in time",
    ),
    Kind(
        "moved",
        "note",
        f"a piercing with `near` farther from it than {MOVED:g} times its footprint",
        "a path, a box or a neighbour that was placed by `near` may no longer fit the hole",
    ),
    Kind(
        "no-tract",
        "note",
        "thread more than its diameter deep in the organ between two holes without a `[[tract]]`, at the start",
        "it bears on the tissue at the two holes alone, so that the depth of a bite changes nothing",
    ),
    Kind(
        "no-hole",
        "unsupported",
        "thread more than its diameter deep in the organ, at the start, on a strand that crosses the surface without a "
        "hole: between two holes, or from an end to the first or the last; not the free tail of an anchored hole",
        "thread and organ touch at the holes alone, and it passes through all other tissue",
    ),
    Kind(
        "tract-bare",
        "note",
        f"more than {BARE:g} radii of a tract's path outside the organ or nearer to a surface than its radius, besides "
        "what leads across a wound or from one surface in contact to the other",
        "no ball of tissue has room there, and the thread bears on none",
    ),
    Kind(
        "tract-stiff",
        "note",
        f"EI times the turn of the thread from one ball of a tract to the next above {STIFF:g} T r², at the end of the "
        f"run, and that turn above {SLIGHT:g} rad; T is its tension, r the balls' radius",
        "where the thread's stiffness presses on the tissue as its pull does, half the spacing changes what a bite "
        "closes by more than 2 %, and the force on a ball at a sharp bend has no limit",
    ),
    Kind(
        "contact-rough",
        "note",
        f"a `[[contact]]` with a coefficient of friction above {STEEP:g}",
        "with much friction surfaces may stick or slip under the very same loads, or have no answer at all (Klarbring, "
        "Ingenieur-Archiv 60, 1990): what is found is one answer, and depends on the steps",
    ),
    Kind(
        "handed-over",
        "note",
        "a stiffness, a law of friction or a strain energy that was handed over from Python",
        "the scenario in the folder does not say it, and run anew it is another run",
    ),
    Kind(
        "stress-of-e-nu",
        "unsupported",
        "a stiffness that was handed over from Python",
        "stress, its principal values and the energy of cells are recovered with E and ν, which it need not have",
    ),
    Kind(
        "units",
        "unsupported",
        "a length, modulus or density that no organ or suture has",
        "numbers in mm, kPa or g/cm³ look like that",
    ),
    Kind(
        "reduction",
        "unsupported",
        f"hole of an organ in a small basis further than {REDUCED:.0%} of the largest way of a hole from its place in "
        "a basis with one block more",
        "that difference is nearly the error of the basis: the motion is too fast for it",
    ),
    Kind(
        "reduction-bound",
        "note",
        f"the bound of the distance to the whole organ above {REDUCED:.0%} of that way",
        "the bound adds up over the run what might be missed; the error is most often far below it, and nearer to the "
        "difference",
    ),
    Kind(
        "frames-missing",
        "note",
        "at a resume, frames that `results.pvd` names and that are not there",
        "they are left out of it",
    ),
    Kind(
        "remedy",
        "note",
        "a run that failed: what helped on a copy of it, or that nothing did",
        "shorter steps, a finer thread and the like are tried before they are named; `--no-remedies` leaves that out",
    ),
    Kind("no-picture", "note", "a picture that could not be drawn", "the message has the cause"),
)
CATALOGUE = {kind.code: kind for kind in KINDS}


def remark(code: str, where: str, message: str) -> Remark:
    """Make a remark of a kind of the catalogue."""
    return Remark(code, CATALOGUE[code].severity, message, where)


def any_unsupported(remarks: Iterable[Remark]) -> bool:
    """Tell whether a remark says that a number is not supported."""
    return any(each.unsupported for each in remarks)


def markdown() -> str:
    """Make the table of the manual."""
    lines = ["| code | severity | said of | because |", "|---|---|---|---|"]
    lines += [f"| `{kind.code}` | {kind.severity} | {kind.bound} | {kind.reason} |" for kind in KINDS]
    return "\n".join(lines) + "\n"
