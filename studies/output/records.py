"""Records of a run: plain arrays, the only data that the simulation passes to the output."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.linalg import norm
from numpy.typing import NDArray

from coupling.reports.audit import Energies
from coupling.reports.observation import PiercingObservation
from coupling.run.events import Event
from coupling.run.tying import TieObservation
from studies.arrays import Array
from studies.output.fields import OrganRecord, ThreadRecord

SEEN = 10  # steps before the last over which forces are seen to swing
SWITCHES = 6  # between stick and slip within SEEN steps, three times to and fro: as short a period these do not resolve
STILL = 1e-9  # of the largest tension: forces below are of round-off
APART = 1e-6  # m: surfaces nearer are closed; a fluid of the body hardly passes, and tissue is rougher

PiercingRecord = PiercingObservation
EnergyRecord = Energies
TieRecord = TieObservation


@dataclass(frozen=True)
class StitchRecord:
    """The closing forces of one stitch at one time."""

    stitch: str  # name of its tie, its tract or its only hole
    pair: str  # of surfaces that it draws together
    left_force: float  # that draws the first of them to the other one [N]
    right_force: float  # that draws the other one [N]
    load_share: float | None  # of what all stitches draw them by [-], None if that is nothing


@dataclass(frozen=True)
class ContactRecord:
    """Two surfaces that may touch at one time, those of a wound's lips or others."""

    pair: str  # their names
    pairs: int  # of nodes that face one another
    pressed: int  # of them, under a force
    smallest_gap: float  # [m]
    largest_pressure: float  # [Pa]
    area: float  # under pressure [m²]
    slide: float  # largest, of a pair past one another along the surfaces [m]
    force: float  # that pushes them apart, in all [N]
    complementarity: float  # largest |force times gap| of a pair [J]
    largest_gap: float = 0.0  # of pairs that face one another [m]
    open_area: float = 0.0  # of them, where they are apart [m²]
    gap_volume: float = 0.0  # between them [m³]
    slipping: int = 0  # of the pressed pairs, with all the friction that there can be
    friction: float = 0.0  # along the surfaces, the magnitude of the resultant [N]
    approximation: float = 0.0  # share of their area where they touch: neither apart nor crossed by more than APART [-]
    closure_force: float = 0.0  # that the thread draws them together with [N]
    eversion: float | None = None  # by how much the outer surface rises towards both their edges [rad]; None without
    stitches: tuple[StitchRecord, ...] = ()  # that draw them together


@dataclass(frozen=True)
class GapRecord:
    """A place on the rim of the first of two surfaces that may touch, at one time."""

    pair: str
    way: float  # along the rim in the reference shape [m]
    x: Array  # (3,) place [m]
    edge_gap: float | None  # of the rim there [m], None if it faces nothing
    largest_gap: float | None  # of the surface behind it [m], likewise
    largest_pressure: float  # there [Pa]


@dataclass(frozen=True)
class TractRecord:
    """The tissue along the thread between two holes at one time, ball by ball in the order of the thread."""

    tract: str  # its name
    balls: tuple[PiercingRecord, ...]

    @property
    def force(self) -> Array:
        """Total force of the tissue on the thread, shape `(3,)` [N]."""
        return np.sum([ball.force for ball in self.balls], axis=0)

    @property
    def length(self) -> float:
        """Length of the path on which the thread bears [m]."""
        return sum(ball.bearing or 0.0 for ball in self.balls)

    @property
    def spacing(self) -> float:
        """Largest length of path that a ball stands for, from each to the next [m]."""
        return max(ball.bearing or 0.0 for ball in self.balls)

    @property
    def turn(self) -> float:
        """Largest turn of the thread from a ball to the next, or on as much of its way across a wound [rad]."""
        tangents, s = (np.array([getattr(ball, name) for ball in self.balls]) for name in ("tangent", "s"))
        angles = np.arccos(np.clip(np.vecdot(tangents[1:], tangents[:-1]), -1.0, 1.0))
        return float(np.max(angles * self.spacing / np.maximum(np.diff(s), self.spacing), initial=0.0))

    @property
    def tension(self) -> float:
        """Largest tension of the thread at a ball [N], 0 where it is slack."""
        return max(0.0, *(max(ball.tension_before, ball.tension_after) for ball in self.balls))

    @property
    def bearing(self) -> float:
        """Largest force across the thread per length [N/m]."""
        return max(ball.normal_force / (ball.bearing or np.inf) for ball in self.balls)

    @property
    def normal_force(self) -> float:
        """Sum of the forces across the thread [N]."""
        return sum(ball.normal_force for ball in self.balls)

    @property
    def friction(self) -> float:
        """Sum of the forces along the thread, towards rising s [N]."""
        return sum(ball.tangential_force for ball in self.balls)

    @property
    def displacement(self) -> float:
        """Largest displacement of a ball [m]."""
        return max(float(norm(ball.displacement)) for ball in self.balls)

    @property
    def bearing_pressure(self) -> float:
        """Largest pressure of the thread on a ball [Pa]."""
        return max(ball.bearing_pressure for ball in self.balls)

    @property
    def slipping(self) -> int:
        """Number of balls along which the thread slips."""
        return sum(ball.state == "slip" for ball in self.balls)


@dataclass(frozen=True)
class LoadRecord:
    """A load on a boundary of the organ at one time."""

    boundary: str
    share: float  # of the load that acts [-]
    area: float  # of the boundary in the reference shape [m²]
    force: Array  # (3,) that acts on the organ, in all [N]


@dataclass(frozen=True)
class ReductionRecord:
    """Error estimates of an organ's small basis at its holes at one time."""

    vectors: int  # of the basis
    difference: Array  # (p,) between the place of a hole and that in a basis with one block more [m]
    bound: Array  # (p,) of the distance to the place in the whole organ [m]
    stiffness: Array  # (p,) largest of the hole against a slow pull [N/m]


@dataclass(frozen=True)
class KrylovRecord:
    """Size and residual of an organ's Krylov space at one time."""

    vectors: int  # of the space; 0 once the organ is solved whole
    residual: float  # of the equations of motion of all unknowns, over the largest forces so far [-]


@dataclass(frozen=True)
class StepRecord:
    """The record of a step; step 0 is the start."""

    time: float  # [s]
    step: int
    piercings: tuple[PiercingRecord, ...]
    energy: EnergyRecord
    newton_iterations: int  # of this step
    constraint_max: float  # largest |P(s) - x| of the thread at its holes [m]
    start_reaction: Array  # (3,) force of the holder on the thread [N]
    end_reaction: Array  # (3,) [N]
    max_strain: float  # largest axial strain of the thread [-]
    slide_speed: float  # largest speed of the thread in a hole [m/s]
    spans: Callable[[], float]  # makes `span_ratio`, which only the last step's is asked for
    apart: Callable[[], float]  # makes `spans_between`, likewise
    stays: Callable[[], bool]  # makes `would_stay`, likewise
    seconds: float  # wall-clock time of this step, compiling its loops left out [s]
    fallen: float | None = None  # of the loads along a branch that was followed [s of their clock], None without one
    events: tuple[Event, ...] = ()
    contact: tuple[ContactRecord, ...] = ()  # of all surfaces that may touch
    loads: tuple[LoadRecord, ...] = ()
    tracts: tuple[TractRecord, ...] = ()
    reduction: ReductionRecord | None = None  # of an organ in a small basis
    krylov: KrylovRecord | None = None  # of an organ in its Krylov space
    ties: tuple[TieRecord, ...] = ()
    profile: Callable[[], tuple[GapRecord, ...]] = tuple  # makes the gaps along all rims, of the last step alone
    torques: tuple[float, float] | None = None  # of the holders of start and end about the tangent [N m], with twist
    kept: Callable[[], Mapping[str, NDArray[Any]]] | None = None  # makes `memory`, asked for at a checkpoint

    @property
    def span_ratio(self) -> float:
        """Longest span at a hole over the length that the thread bends over there [-]."""
        return self.spans()

    @property
    def spans_between(self) -> float | None:
        """Spans between the two holes that are nearest to one another along the thread [-], None if there are no
        two."""
        number = self.apart()
        return number if np.isfinite(number) else None

    @property
    def would_stay(self) -> bool:
        """Whether the thread resists every motion of its own from an equilibrium."""
        return self.stays()

    @property
    def memory(self) -> Mapping[str, NDArray[Any]] | None:
        """All that the steps after this one depend on, None if nothing is kept."""
        return None if self.kept is None else self.kept()


@dataclass(frozen=True)
class RunRecord:
    """A run as far as it came."""

    status: str
    error: str  # empty unless it failed or was interrupted
    last: StepRecord | None  # None if it did not get as far as its start
    newton_iterations: int  # of all steps
    constraint_max: float  # over all steps [m]
    seconds: float  # wall-clock time of all steps, compiling their loops left out [s]
    tissue_dofs: int


@dataclass(frozen=True)
class Extremes:
    """The largest values of a run so far, over its steps and, for the organ's cells, over its frames; and the forces of
    its last steps."""

    mean_strain: Array  # (p,) of the tissue at each hole [-]
    turn: Array  # (p,) [rad]
    bearing_pressure: Array  # (p,) of the thread on the tissue at each hole [Pa]
    way: Array  # (p,) of each hole from its place in the reference shape [m]
    difference: Array  # (p,) between a small basis and one with a block more [m]
    bound: Array  # (p,) of the distance to the whole organ [m]
    cell_strain: Array  # (p,) of the cells on which each hole bears [-]
    cell_energy: Array  # (p,) strain energy per volume of them [Pa]
    forces: Array  # (SEEN + 1, p, 3) of each hole on the thread at the last steps, NaN before there were so many [N]
    switches: Array  # (SWITCHES, p) numbers of the steps in which each hole last switched, NaN before it did so often
    chattered: Array  # (p,) when each hole first switched so often within SEEN steps [s], NaN if it did not
    locked: Array  # (t,) force under which each tie was locked [N], NaN before
    tension: float = 0.0  # of the thread at its holes and ends [N]
    thread_strain: float = 0.0  # [-]
    energy: float = 0.0  # kinetic and elastic, or work of whatever is outside [J]
    created: float = 0.0  # by the steps in time [J]
    strain: float = 0.0  # of the organ's cells [-]
    rotation: float = 0.0  # [rad]
    strained: float = 0.0  # share of the strain energy in cells strained beyond what is small [-]
    rotated: float = 0.0  # the same in cells rotated beyond [-]
    pressed_turn: float = 0.0  # of a surface under a pressure [rad]
    crossed: float = 0.0  # of lips that do not touch, through one another, over their extent [-]
    branches: float = 0.0  # load steps that followed one by arc length
    fallen: float = 0.0  # of the loads along one [s of their clock]
    residual: float = 0.0  # of an organ in its Krylov space [-]

    def after_step(self, step: StepRecord) -> "Extremes":
        """Return the extremes with a step more."""
        holes, energy, small = step.piercings, step.energy, step.reduction
        now = np.array([tie.force if tie.state in ("tied", "slips") else np.nan for tie in step.ties])
        pulls = [pull for hole in holes for pull in (hole.tension_before, hole.tension_after) if np.isfinite(pull)]
        return replace(
            self,
            mean_strain=np.maximum(self.mean_strain, [hole.mean_strain for hole in holes]),
            turn=np.maximum(self.turn, [hole.turn for hole in holes]),
            bearing_pressure=np.maximum(self.bearing_pressure, [hole.bearing_pressure for hole in holes]),
            way=np.maximum(self.way, [float(norm(hole.displacement)) for hole in holes]),
            forces=np.concatenate([self.forces[1:], np.reshape([hole.force for hole in holes], (1, -1, 3))]),
            difference=self.difference if small is None else np.maximum(self.difference, small.difference),
            bound=self.bound if small is None else np.maximum(self.bound, small.bound),
            locked=np.where(np.isnan(self.locked), now, self.locked),
            tension=max(self.tension, *pulls, float(norm(step.start_reaction)), float(norm(step.end_reaction))),
            thread_strain=max(self.thread_strain, step.max_strain),
            energy=max(self.energy, energy.kinetic + energy.of_deformation, abs(energy.external_work)),
            created=max(self.created, -energy.numerical_dissipation),
            branches=self.branches + (step.fallen is not None),
            fallen=max(self.fallen, step.fallen or 0.0),
            residual=self.residual if step.krylov is None else max(self.residual, step.krylov.residual),
        ).after_switches(step)

    def after_switches(self, step: StepRecord) -> "Extremes":
        """Return the extremes with the changes between stick and slip in a step more."""
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
        """Largest deviation of a hole's force from a straight line over the last steps, over the largest force [-]; 0
        with fewer steps, or forces of round-off only."""
        largest = float(norm(self.forces, axis=2).max(initial=0.0))
        if not largest > STILL * self.tension:
            return 0.0
        course = np.linspace(self.forces[0], self.forces[-1], len(self.forces))
        return float(norm(self.forces - course, axis=2).max()) / largest

    def after_frame(self, organ: OrganRecord | None) -> "Extremes":
        """Return the extremes with a frame of the organ more, None without one."""
        if organ is None:
            return self
        return replace(
            self,
            cell_strain=at_least(self.cell_strain, organ.hole_strain),
            cell_energy=at_least(self.cell_energy, organ.hole_energy),
            strain=max(self.strain, float(organ.strain.max())),
            rotation=max(self.rotation, float(organ.rotation.max())),
            strained=max(self.strained, organ.strained),
            rotated=max(self.rotated, organ.rotated),
            pressed_turn=max(self.pressed_turn, organ.pressed_turn),
            crossed=max(self.crossed, organ.crossed),
        )


def at_least(met: Array, now: Array | None) -> Array:
    """Return the larger of the earlier and the new values, shape `(p,)`; None if there are no new values."""
    return met if now is None else np.asarray(np.maximum(met, now))


def nothing_met(piercings: int, ties: int) -> Extremes:
    """Return the extremes of a run with so many piercings and ties before its start."""
    unknown = (SEEN + 1, piercings, 3), (SWITCHES, piercings), (piercings,), (ties,)
    return Extremes(*np.zeros((8, piercings)), *(np.full(shape, np.nan) for shape in unknown))


@dataclass(frozen=True)
class Ending:
    """The end of a run, with its largest values until then."""

    step: StepRecord
    extremes: Extremes


@dataclass(frozen=True)
class Snapshot:
    """The fields of one frame."""

    time: float  # [s]
    thread: ThreadRecord
    piercings: tuple[PiercingRecord, ...]
    organ: OrganRecord | None = None
    ties: tuple[TieRecord, ...] = ()
