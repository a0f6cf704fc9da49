"""Remarks on the numbers of a run, in `summary.json`, on the console and from Python.

The catalogue has each code once, with its severity, its bound and the reason for the bound. A remark of the
severity "unsupported" means that a number of the run is outside its model. A "note" is information for the
reader. `studies.simulation.remarks` judges a run.
"""

from collections.abc import Iterable
from dataclasses import asdict, dataclass
from typing import Literal, get_args

from studies.output.records import SEEN, SWITCHES

Severity = Literal["unsupported", "note"]

SMALL_STRAIN = 0.2  # linear elasticity neglects ½ε² compared with ε: a tenth of ε here
SMALL_ROTATION = 0.2  # rad: a pure rotation strains a linear body by 1 − cos θ, which is 0.02 here
EARLY = 0.8  # factor on both for a prediction, which can be too low: a check should miss few runs beyond the bounds
RULES = 1.1  # times the force across the thread: above this, the couple over the channel presses more than the force
UNSURE = 0.05  # of the tension: allowed difference of friction between half and twice the channel
SHARE = 0.05  # of the organ's strain energy: a smaller share hardly affects the forces
THREAD_STRAIN = 0.1  # stress of monofilaments is proportional to strain up to about this strain (assumption)
KINKED = 1.0  # diameters: in a bend of a smaller radius the inner fibres are compressed to half their length or less
OFF_PATH = 10.0  # diameters: a beginning hole draws the thread by at most this distance
CREATED = 1e-4  # of a run's energy: round-off is 1e-9 of it, and the time steps of the shipped scenes create no energy
DISSIPATED = 0.05  # of a run's energy
OUTDONE = 1.0  # of the friction loss: above this, time steps rather than friction determine where the thread stops
FALLEN = 1e-6  # of the loads: round-off is smaller
CROSSED = 0.01  # of the lips' extent: a smaller overlap counts as closed
SWUNG = 0.01  # of the largest force
SLID = 1.0  # diameters: a thread at rest slides less than this in another run of the same duration
LOCKED = 0.9  # of the hands' force on a tie: below this, the hands still drew at more than a tenth of their speed
STEEP = 1.0  # coefficient of friction
BARE = 4.0  # radii: at an angle of 30° or more this length of a tract's path is near the surface, at both ends together
STIFF = 1.0  # EI times the turn per ball, over T r²: 2 % of the closing effect of a bite of two or four radii
SLIGHT = 0.05  # rad per ball: a slack thread with a smaller turn lies straight in its tract
IN_TISSUE = 1.0  # diameters: a deeper thread lies in tissue and not on tissue
MOVED = 2.0  # footprints: a hole moved by this distance still touches its former place
NEAR = 2.0  # times the sum of two footprints: nearer, a hole moves its neighbour by a quarter of its displacement
REDUCED = 0.03  # of the largest displacement of a hole: allowed error of a small basis, equal to the error of the cells
COARSE = {"P1": 0.25, "P2": 0.5}  # cell size over footprint: the hole's compliance then has an error of at most 8 %


@dataclass(frozen=True)
class Kind:
    """A kind of remark, with the condition `bound` and its `reason` for the manual."""

    code: str
    bound: str
    reason: str
    severity: Severity = "unsupported"


@dataclass(frozen=True)
class Remark:
    """A remark on a run; `where` names a piercing, a key, or a part of the run."""

    code: str
    severity: Severity
    message: str
    where: str

    @property
    def unsupported(self) -> bool:
        """Whether the remark means an unsupported number."""
        return self.severity == "unsupported"

    @property
    def line(self) -> str:
        """The remark as a line for the console."""
        return f"{self.severity}: {self.message} [{self.code}]"

    def record(self) -> dict[str, str]:
        """Return the remark as in `summary.json`."""
        return asdict(self)


KINDS = (
    Kind(
        "demand",
        f"predicted displacement of a hole in a linear organ above {EARLY * SMALL_STRAIN:g} r; r² = a² + h² with "
        "footprint a and cell size h (P1) or h/2 (P2)",
        "a half-space yields by 0.74 F/(E r), and the strain is about the displacement over r",
    ),
    Kind(
        "stiff-thread",
        f"predicted turn of a directed hole in a linear organ above {EARLY * SMALL_ROTATION:g} rad: "
        "0.75 (1 − ν²)/(E r³) times the couple of both strands, each 2 sin(θ/2) √(EI T) if taut, 2 EI θ/ℓ if slack; "
        "θ is the angle between hole and strand, ℓ the strand's length",
        "this is the turn of a rigid disc on a half-space",
    ),
    Kind(
        "pull-strength",
        "load on the thread above the smallest knot-pull strength of `suture catalogue`, or a strain of "
        f"{THREAD_STRAIN:g}",
        "a real suture may break there",
    ),
    Kind(
        "hole-strain",
        f"mean strain at a hole above {SMALL_STRAIN:g}",
        "linear elasticity neglects a tenth of this strain",
    ),
    Kind(
        "hole-rotation",
        f"turn of a hole above {SMALL_ROTATION:g} rad",
        "a rotation θ alone strains a linear body by 1 − cos θ = 0.02",
    ),
    Kind(
        "tissue-strain",
        f"strain above {SMALL_STRAIN:g} in cells with more than {SHARE:.0%} of the strain energy",
        "cells with this energy affect the forces",
    ),
    Kind("tissue-rotation", f"the same for a rotation above {SMALL_ROTATION:g} rad", "these cells affect the forces"),
    Kind(
        "local-strain",
        f"strain above {SMALL_STRAIN:g} in cells with less energy",
        "strain has no limit under refinement at an edge, a clamp or a wound's tip",
        "note",
    ),
    Kind(
        "tears", "bearing pressure at a hole above `tissue.strength`", "real tissue can tear there; the model does not"
    ),
    Kind(
        "pressure-turn",
        f"turn of a pressed surface of a linear organ above {SMALL_ROTATION:g} rad",
        "the pressure keeps the direction of the reference shape",
    ),
    Kind(
        "lips-cross",
        f"overlap of wound lips above {CROSSED:g} of their extent",
        "without `tissue.contact` the lips do not resist",
    ),
    Kind(
        "thread-strength",
        "tension above the smallest knot-pull strength of `suture catalogue`",
        "a real suture may break there",
    ),
    Kind(
        "thread-strain",
        f"axial strain of the thread above {THREAD_STRAIN:g}",
        "sutures are linear at small strain only",
    ),
    Kind(
        "channel",
        f"rough, directed hole without `channel`: at the end a normal force above {RULES:g} times the force across, "
        f"and friction that differs by {UNSURE:.0%} of the tension between half and twice the channel",
        "the couple presses with m/ℓ, and the path does not give the length ℓ",
        "note",
    ),
    Kind(
        "spans",
        "`thread.span_ratio` above 0.5 at the end",
        "errors of several per cent in forces along the thread, of 10 to 40 % in momentary friction of a directed "
        "hole, or 20 to 150 % if the thread bends back",
    ),
    Kind(
        "spans-between",
        "`thread.spans_between` below 2 at the end",
        "this coarse spline cannot bend like the thread",
    ),
    Kind(
        "energy-created",
        f"numerical dissipation below −{CREATED:g} of the run's energy at any time",
        "created energy drives the motion",
    ),
    Kind(
        "numerical-dissipation",
        f"numerical dissipation at the end above {DISSIPATED:.0%} of the run's energy, with friction or "
        "`forces-swing`; or above the friction loss, if the thread slid by more than its diameter",
        "time steps damped the motion; with friction the final state depends on the motion",
        "note",
    ),
    Kind(
        "slides-freely",
        "static run without friction in the holes and without a held end",
        "the thread can slide as a whole: `slip` depends on the load steps, forces and places do not",
    ),
    Kind(
        "not-held",
        "dynamic run of an organ without clamp, roller or contact",
        "thread and loads accelerate the whole organ",
        "note",
    ),
    Kind(
        "would-not-stay",
        "unstable equilibrium at the end: a motion of the thread lowers its potential",
        "Newton's method can follow equilibria beyond buckling; no stable equilibrium was found here",
    ),
    Kind(
        "branch",
        "load steps failed, and the branch was followed by arc length",
        "the stability of the branch is not checked",
        "note",
    ),
    Kind(
        "limit-point",
        f"loads fell along the branch by more than {FALLEN:g} of the full loads",
        "thread or tissue would jump at the limit point, perhaps to another branch",
    ),
    Kind(
        "not-at-rest",
        "at the end of a dynamic run, kinetic energy above 1e-4 of the elastic, or a slide speed above one "
        "thread diameter per duration of the run",
        "the final numbers are momentary",
        "note",
    ),
    Kind(
        "hole-left",
        "at the end the thread is not in a hole that should hold it",
        "the hole bears nothing; lengthen the thread, hold its end, or end the hole by `until`",
    ),
    Kind(
        "tie-undone",
        "at the end a tie that has begun is open, and its loop is not cut",
        "the stitch holds nothing (event `unties`); shorten `ramp`, raise `force`, or leave longer ends",
    ),
    Kind(
        "tie-slack",
        f"in a dynamic run, a tie locked below {LOCKED:g} of its `force`",
        "the hands still drew; raise `speed`, or end later by `until`",
    ),
    Kind(
        "forces-swing",
        f"at the end of a dynamic run, a hole's force deviates from a straight line over {SEEN} steps by more than "
        f"{SWUNG:.0%} of the largest",
        "long time steps delay and damp the oscillation; use a smaller `solve.dt`",
        "note",
    ),
    Kind(
        "chatter",
        f"in a dynamic run, {SWITCHES} changes between stick and slip at a hole within {SEEN} steps",
        "number and times of these events depend on the time step",
        "note",
    ),
    Kind(
        "cells",
        f'with `tissue.mesh.accuracy = "given"`, cells above {COARSE["P1"]:g} (P1) or {COARSE["P2"]:g} (P2) footprints',
        "the mesh is more than about 8 % too stiff at the hole",
    ),
    Kind(
        "accuracy",
        "estimated error of a hole's compliance above `tissue.mesh.accuracy`",
        "refinement ended after its last round, or because memory ran out",
    ),
    Kind("bare-point", "footprint of zero in an organ", "the displacement of a point has no limit under refinement"),
    Kind(
        "holes-near",
        f"distance of two holes below {NEAR:g} times the sum of their footprints",
        "each hole moves the other by a quarter of its displacement or more",
        "note",
    ),
    Kind(
        "off-path",
        f"piercing more than {OFF_PATH:g} diameters from `thread.path`",
        "the thread is bent to the hole at the start, and this energy sets the thread in motion",
        "note",
    ),
    Kind(
        "kinked",
        f"bend radius of the path below {KINKED:g} thread diameter",
        "no suture stays elastic there; the thread springs back at the start",
        "note",
    ),
    Kind(
        "after-end",
        "cut, tie or beginning piercing after `solve.duration`",
        "the event does not happen in this run",
        "note",
    ),
    Kind(
        "rest-unloaded",
        '`solve.start = "rest"` and a dead load with its own `ramp`',
        "the load is zero at t = 0, so its slack disappears during the run",
        "note",
    ),
    Kind(
        "moved",
        f"piercing farther from `near` than {MOVED:g} footprints",
        "a path or box placed by `near` can lose its fit",
        "note",
    ),
    Kind(
        "no-tract",
        "thread in tissue, deeper than its diameter, between two holes without a `[[tract]]`",
        "the depth of the bite has no effect",
        "note",
    ),
    Kind(
        "no-hole",
        "thread in tissue, deeper than its diameter, on a strand that crosses the surface without a hole; "
        "except the free tail of an anchored hole",
        "the thread passes through tissue without a force",
    ),
    Kind(
        "tract-bare",
        f"more than {BARE:g} radii of a tract's path outside the organ or within a radius of its surface, "
        "except across wounds and contacts",
        "the thread does not bear there",
        "note",
    ),
    Kind(
        "tract-stiff",
        f"EI times the turn of the thread per ball above {STIFF:g} T r² at the end (tension T, radius r), and that "
        f"turn above {SLIGHT:g} rad",
        "half the spacing changes the closing effect by more than 2 %",
        "note",
    ),
    Kind(
        "contact-rough",
        f"coefficient of friction of a `[[contact]]` above {STEEP:g}",
        "several solutions or none can exist (Klarbring 1990); the result depends on the steps",
        "note",
    ),
    Kind(
        "handed-over",
        "stiffness, law of friction or strain energy from Python",
        "the scenario in the folder does not reproduce the run",
        "note",
    ),
    Kind("stress-of-e-nu", "stiffness from Python", "stress and energy of cells are computed with E and ν"),
    Kind("units", "implausible length, modulus or density", "the number may be in mm, kPa or g/cm³"),
    Kind(
        "reduction",
        f"`difference` of a hole above {REDUCED:.0%} of the largest displacement of a hole",
        "the motion is too fast for the basis",
    ),
    Kind(
        "reduction-bound",
        f"small basis: `bound` above {REDUCED:.0%} of that displacement",
        "the error is usually far smaller, near the difference",
        "note",
    ),
    Kind(
        "frames-missing",
        "at a resume, missing frames of `results.pvd`",
        "these frames are removed from the list",
        "note",
    ),
    Kind(
        "remedy",
        "failed run: the remedy that helped on a copy, or none",
        "`--no-remedies` omits the search",
        "note",
    ),
    Kind("no-picture", "picture that could not be drawn", "the message has the cause", "note"),
)
CATALOGUE = {kind.code: kind for kind in KINDS}


def remark(code: str, where: str, message: str) -> Remark:
    """Return a remark of a kind of the catalogue."""
    return Remark(code, CATALOGUE[code].severity, message, where)


def judged(deserved: bool, code: str, where: str, message: str) -> list[Remark]:
    """Return a remark of a kind of the catalogue if `deserved`, else none."""
    return [remark(code, where, message)] if deserved else []


def any_unsupported(remarks: Iterable[Remark]) -> bool:
    """Return whether a remark means an unsupported number."""
    return any(each.unsupported for each in remarks)


def _sentence(words: str) -> str:
    """Return a sentence with a capital first letter."""
    return words[0].upper() + words[1:]


def markdown() -> str:
    """Return the lists of the manual, one for each severity."""
    lines = []
    for severity in get_args(Severity):
        lines += ["", f"Severity `{severity}`:", ""]
        lines += [
            f"- `{kind.code}`: {kind.bound}. {_sentence(kind.reason)}." for kind in KINDS if kind.severity == severity
        ]
    return "\n".join([*lines, "", ""])
