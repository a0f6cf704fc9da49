"""Records of a run: plain arrays, the only data that the simulation passes to the output."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields, make_dataclass, replace
from typing import Any

import numpy as np
from numpy.linalg import norm
from numpy.typing import NDArray

from coupling.reports.audit import Energies
from coupling.reports.observation import PiercingObservation
from coupling.run.events import Event
from coupling.run.tying import TieObservation
from studies.arrays import Array
from studies.lists import list_of
from studies.output.fields import ThreadRecord

SEEN = 10  # number of last steps in which a swing of forces is sought
SWITCHES = 6  # between stick and slip within SEEN steps: three periods, which these steps do not resolve
STILL = 1e-9  # of the largest tension: smaller forces are round-off
APART = 1e-6  # m: a smaller gap counts as closed, because body fluid hardly passes it and tissue is rougher
LIST = list_of(__file__, "columns.toml")
Record = Any  # an object of a class that `record_of` returns


def record_of(name: str, *groups: str, needed: Sequence[str] = (), **more: Any) -> Any:
    """Return the class of records `name`: a field for each column of groups of the list.

    It has the `needed` fields too, and `more` fields, or the same ones, with defaults.
    """
    columns = [column for group in groups for column in LIST[group] if column not in more]
    defaults = [(field, Any, value) for field, value in more.items()]
    every = [*columns, *needed, *defaults]
    return make_dataclass(name, every, frozen=True, kw_only=True, namespace={"__module__": __name__})


# The closing forces of one stitch at one time.
StitchRecord = record_of("StitchRecord", "stitch")
# Two surfaces that can touch, with the stitches of this pair.
ContactRecord = record_of("ContactRecord", "contact", stitches=())
# Strands outside the organ, with the abscissa of the largest depth [m].
StrandsRecord = record_of("StrandsRecord", "strands", s=np.nan)
# A place on the rim of the first of two surfaces that can touch.
GapRecord = record_of("GapRecord", "gap_profile")
# A load on a boundary of the organ at one time.
LoadRecord = record_of("LoadRecord", "load")
# The organ at one time: arrays of its nodes `(nodes, …)` and of its cells `(cells, …)`. The lips are None without
# contact, the stretches for a linear organ. `deformed` is the strain energy of all cells, `strained` and
# `rotated` that of cells whose strain or rotation is not small, in linear tissue by `tissue.energy_measure` [J].
OrganRecord = record_of(
    "OrganRecord",
    "organ_arrays",
    "organ_cells",
    needed=("deformed", "strained", "rotated"),
    **dict.fromkeys(("contact_pressure", "lip_gap", "principal_stretch", "first_stretch", "third_stretch")),
    pressed_turn=0.0,  # largest angle between a pressed normal and its reference direction [rad]
    crossed=0.0,  # overlap of lips without contact, over their extent [-]
    hole_strain=None,  # (p,) largest `strain` of the cells on which each hole bears [-]
    hole_energy=None,  # (p,) largest `energy_density` of these cells [Pa]
)
# Size and residual of an organ's Krylov space at one time.
KrylovRecord = record_of("KrylovRecord", "krylov")


@dataclass(frozen=True)
class TractRecord:
    """The tissue along the thread between two holes at one time.

    It consists of balls in the order of the thread.
    """

    tract: str  # its name
    balls: tuple[PiercingObservation, ...]

    @property
    def spacing(self) -> float:
        """Largest length of path per ball, the distance to the next ball [m]."""
        return max(ball.bearing or 0.0 for ball in self.balls)

    @property
    def turn(self) -> float:
        """Largest turn of the thread between neighbouring balls [rad].

        Across a wound it is the turn per ball spacing.
        """
        tangents, s = (np.array([getattr(ball, name) for ball in self.balls]) for name in ("tangent", "s"))
        angles = np.arccos(np.clip(np.vecdot(tangents[1:], tangents[:-1]), -1.0, 1.0))
        return float(np.max(angles * self.spacing / np.maximum(np.diff(s), self.spacing), initial=0.0))

    @property
    def tension(self) -> float:
        """Largest tension of the thread at a ball [N], 0 if the thread is slack."""
        return max(0.0, *(max(ball.tension_before, ball.tension_after) for ball in self.balls))


@dataclass(frozen=True)
class StepRecord:
    """The record of a step; step 0 is the start.

    Its text omits the functions, which hold the whole system.
    """

    time: float  # [s]
    step: int
    piercings: tuple[PiercingObservation, ...]
    energy: Energies
    newton_iterations: int  # of this step
    constraint_max: float  # largest |P(s) - x| of the thread at its holes [m]
    start_reaction: Array  # (3,) force of the holder on the thread [N]
    end_reaction: Array  # (3,) [N]
    max_strain: float  # largest axial strain of the thread [-]
    slide_speed: float  # largest speed of the thread in a hole [m/s]
    spans: Callable[[], float] = field(repr=False)  # computes `span_ratio`, used only for the last step
    apart: Callable[[], float] = field(repr=False)  # computes `spans_between`, used only for the last step
    stays: Callable[[], bool] = field(repr=False)  # computes `would_stay`, used only for the last step
    outside: Callable[[], Record | None] = field(repr=False)  # computes `strands`, used only for the last step
    seconds: float  # wall-clock time of this step without compilation [s]
    unstable: bool = False  # whether tissue that is unstable by itself found no other equilibrium at rest
    fallen: float | None = None  # decrease of the loads along a branch [s of their clock], None without one
    events: tuple[Event, ...] = ()
    contact: tuple[Record, ...] = ()  # of all surfaces that can touch
    loads: tuple[Record, ...] = ()
    tracts: tuple[TractRecord, ...] = ()
    krylov: Record | None = None  # None unless the organ is in its Krylov space
    ties: tuple[TieObservation, ...] = ()
    profile: Callable[[], tuple[Record, ...]] = field(default=tuple, repr=False)  # computes the gaps along all rims
    torques: tuple[float, float] | None = None  # of the holders at start and end about the tangent [N m]; or None
    kept: Callable[[], Mapping[str, NDArray[Any]]] | None = field(default=None, repr=False)  # computes `memory`

    @property
    def span_ratio(self) -> float:
        """Longest span at a hole over the bending length of the thread there [-]."""
        return self.spans()

    @property
    def spans_between(self) -> float | None:
        """Fewest spans between neighbouring holes along the thread [-].

        None with fewer than two holes.
        """
        number = self.apart()
        return number if np.isfinite(number) else None

    @property
    def strands(self) -> Record | None:
        """The strands outside the organ, None without such strands."""
        return self.outside()

    @property
    def would_stay(self) -> bool:
        """Whether the equilibrium is stable: the thread resists every motion."""
        return self.stays()

    @property
    def memory(self) -> Mapping[str, NDArray[Any]] | None:
        """All data that the later steps depend on, None if no checkpoint is kept."""
        return None if self.kept is None else self.kept()


def law_violations(step: StepRecord) -> list[float]:
    """Return the violation of Coulomb's law at each hole while hands draw a tie [N], else zero."""
    drawn = any(tie.state == "drawn" for tie in step.ties)
    return [drawn * hole.cone_residual for hole in step.piercings]


def largest_tension(step: StepRecord) -> float:
    """Return the largest tension at holes and ends [N]."""
    pulls = [pull for hole in step.piercings for pull in (hole.tension_before, hole.tension_after)]
    ends = float(norm(step.start_reaction)), float(norm(step.end_reaction))
    return max(*(pull for pull in pulls if np.isfinite(pull)), *ends)


def turned_over(step: StepRecord) -> float:
    """Return the kinetic plus elastic energy, or the external work if it is larger [J]."""
    return max(step.energy.kinetic + step.energy.of_deformation, abs(step.energy.external_work))


def settling_loss(step: StepRecord) -> float | None:
    """Return the stored energy that the first step dissipated numerically [J], None at other steps.

    Bends of the laid thread store energy, and one step brings them to rest. The work of loads in
    this step is not stored energy.
    """
    return max(step.energy.numerical_dissipation - max(step.energy.external_work, 0.0), 0.0) if step.step == 1 else None


@dataclass(frozen=True)
class Extremes:
    """The largest values of a run until now, and the forces of its last steps.

    A field has the function that returns its value, or None, for a "step" or for the organ of a
    "frame".
    """

    # (p,) mean strain of the tissue at each hole [-]
    mean_strain: Array = field(metadata={"step": lambda step: [hole.mean_strain for hole in step.piercings]})
    # (p,) turn of each hole [rad]
    turn: Array = field(metadata={"step": lambda step: [hole.turn for hole in step.piercings]})
    # (p,) pressure of the thread on the tissue at each hole [Pa]
    bearing_pressure: Array = field(metadata={"step": lambda step: [hole.bearing_pressure for hole in step.piercings]})
    # (p,) violation of Coulomb's law at each hole while hands draw a tie [N]
    off_law: Array = field(metadata={"step": law_violations})
    # (p,) strain of the cells on which each hole bears [-]
    cell_strain: Array = field(metadata={"frame": lambda organ: organ.hole_strain})
    # (p,) strain energy per volume of these cells [Pa]
    cell_energy: Array = field(metadata={"frame": lambda organ: organ.hole_energy})
    forces: Array  # (SEEN + 1, p, 3) force of each hole on the thread at the last steps, NaN before the start [N]
    switches: Array  # (SWITCHES, p) step numbers of the last switches of each hole, NaN if there were fewer
    chattered: Array  # (p,) time of the first SWITCHES switches of a hole within SEEN steps [s], NaN if there was none
    locked: Array  # (t,) force at the locking of each tie [N], NaN before
    # largest tension at holes and ends [N]
    tension: float = field(default=0.0, metadata={"step": largest_tension})
    # largest axial strain [-]
    thread_strain: float = field(default=0.0, metadata={"step": lambda step: step.max_strain})
    # largest of kinetic plus elastic energy, and of external work [J]
    energy: float = field(default=0.0, metadata={"step": turned_over})
    # largest elastic energy of deformation [J]
    elastic: float = field(default=0.0, metadata={"step": lambda step: step.energy.of_deformation})
    # largest energy created by the integrator [J]
    created: float = field(default=0.0, metadata={"step": lambda step: -step.energy.numerical_dissipation})
    # stored energy that the first step dissipated numerically [J]
    settling: float = field(default=0.0, metadata={"step": settling_loss})
    # largest strain of the organ's cells [-]
    strain: float = field(default=0.0, metadata={"frame": lambda organ: organ.strain.max()})
    # largest rotation of the organ's cells [rad]
    rotation: float = field(default=0.0, metadata={"frame": lambda organ: organ.rotation.max()})
    # measure of the strain energy of all cells, of those whose strain, and of those whose rotation is not small [J]
    deformed: float = field(default=0.0, metadata={"frame": lambda organ: organ.deformed})
    strained: float = field(default=0.0, metadata={"frame": lambda organ: organ.strained})
    rotated: float = field(default=0.0, metadata={"frame": lambda organ: organ.rotated})
    # turn of a pressed surface [rad]
    pressed_turn: float = field(default=0.0, metadata={"frame": lambda organ: organ.pressed_turn})
    # overlap of lips without contact, over their extent [-]
    crossed: float = field(default=0.0, metadata={"frame": lambda organ: organ.crossed})
    branches: float = 0.0  # number of load steps that followed a branch by arc length
    # decrease of the loads along a branch [s of their clock]
    fallen: float = field(default=0.0, metadata={"step": lambda step: step.fallen})
    # residual of an organ in its Krylov space [-]
    residual: float = field(default=0.0, metadata={"step": lambda step: step.krylov and step.krylov.residual})

    def after(self, at: str, source: Any) -> "Extremes":
        """Return the extremes including the values of a step, or of the organ of a frame."""
        return replace(self, **{name: larger(getattr(self, name), of(source)) for name, of in LARGEST[at]})

    def after_step(self, step: StepRecord) -> "Extremes":
        """Return the extremes including one more step."""
        now = np.array([tie.force if tie.state in ("tied", "slips") else np.nan for tie in step.ties])
        forces = np.reshape([hole.force for hole in step.piercings], (1, -1, 3))
        return replace(
            self.after("step", step),
            forces=np.concatenate([self.forces[1:], forces]),
            locked=np.where(np.isnan(self.locked), now, self.locked),
            branches=self.branches + (step.fallen is not None),
        ).after_switches(step)

    def after_switches(self, step: StepRecord) -> "Extremes":
        """Return the extremes including the changes between stick and slip of one more step."""
        place = {hole.name: k for k, hole in enumerate(step.piercings)}
        switched = [each for each in step.events if each.kind in ("slips", "sticks") and each.piercing in place]
        switches, chattered = self.switches.copy(), self.chattered.copy()
        for event in switched:
            k = place[event.piercing]
            switches[:, k] = [*switches[1:, k], step.step]
            if np.isnan(chattered[k]) and step.step - switches[0, k] < SEEN:
                chattered[k] = event.time
        return replace(self, switches=switches, chattered=chattered) if switched else self

    @property
    def swing(self) -> float:
        """Largest deviation of a hole's force from a straight line over the last steps [-].

        It is relative to the largest force. Zero with fewer steps, or if all forces are round-off.
        """
        largest = float(norm(self.forces, axis=2).max(initial=0.0))
        if not largest > STILL * self.tension:
            return 0.0
        course = np.linspace(self.forces[0], self.forces[-1], len(self.forces))
        return float(norm(self.forces - course, axis=2).max()) / largest

    def share(self, energy: float) -> float:
        """Return a strain energy as a share of the largest of all cells [-], zero without strain."""
        return energy / self.deformed if self.deformed else 0.0

    def after_frame(self, organ: Record | None) -> "Extremes":
        """Return the extremes including one more frame of the organ, None without an organ."""
        return self if organ is None else self.after("frame", organ)


TRACKED = [(each.name, each.metadata) for each in fields(Extremes)]
LARGEST = {at: [(name, of[at]) for name, of in TRACKED if at in of] for at in ("step", "frame")}


def larger(met: Any, now: Any) -> Any:
    """Return the larger of the earlier and the new values, numbers or `(p,)`.

    None means no new values.
    """
    if now is None:
        return met
    return np.maximum(met, now) if isinstance(met, np.ndarray) else max(met, float(now))


def nothing_met(piercings: int, ties: int) -> Extremes:
    """Return the extremes before the start of a run, for these numbers of piercings and ties."""
    unknown = (SEEN + 1, piercings, 3), (SWITCHES, piercings), (piercings,), (ties,)
    return Extremes(*np.zeros((6, piercings)), *(np.full(shape, np.nan) for shape in unknown))


Ending = tuple[StepRecord, Extremes]  # the last step of a run, and the largest values until then


@dataclass(frozen=True)
class Snapshot:
    """The fields of one frame."""

    time: float  # [s]
    thread: ThreadRecord
    piercings: tuple[PiercingObservation, ...]
    organ: Record | None = None
    ties: tuple[TieObservation, ...] = ()
