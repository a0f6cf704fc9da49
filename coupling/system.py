"""The coupled system: a thread, its ends, an organ, and the piercings that join them."""

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Generic

import numpy as np

from coupling.arrays import Array, Flags, Indices
from coupling.errors import CouplingError
from coupling.interfaces import Body, FrictionLaw, KnowsDirections, Organ
from coupling.kernels.constraints import Passage, knot_passage, passage
from coupling.recent import Recent
from coupling.ties import ON_TIME, Tie
from thread.banded import diagonal_of
from thread.ends import Clamped, End
from thread.frames import Frame
from thread.kernels.travel import Ridden
from thread.relaxation import Memory
from thread.spline import Spline
from thread.thread import Thread
from thread.vectors import cross, unit_vector

PRESSED = (1e-3, 1e-2, 1e-1, 1.0, 10.0)  # N, at which a law of one's own is looked at: what sutures bear is among them
STEP = 1e-5  # of N, of the difference that its slope is compared with: the error of this is some 1e-10
AGREE = 1e-3  # between the two: a slope by differences passes, one of another function does not


@dataclass(frozen=True)
class Friction:
    """Coulomb's coefficients `static`, `kinetic` [-], and `grip` F₀ [N], independent of the tension; of a barb a pair,
    for an abscissa at the hole that rises, and for one that falls.

    `channel` [m] is the length over which a hole imposes a direction: the couple that this takes presses on both its
    ends (`coupling.step.sliding`). None: it does not press. `own` is a law of one's own that is added, None: there is
    none.
    """

    static: float = 0.0
    kinetic: float = 0.0
    grip: float | tuple[float, float] = 0.0
    channel: float | None = None
    own: FrictionLaw | None = None

    def __post_init__(self) -> None:
        if not 0.0 <= self.kinetic <= self.static or not min(self.grips) >= 0.0:
            raise CouplingError(
                f"friction: static {self.static}, kinetic {self.kinetic}, grip {self.grip} N; allowed are "
                "0 ≤ kinetic ≤ static and grip ≥ 0"
            )
        if self.own is not None:
            check_law(self.own)

    @property
    def grips(self) -> tuple[float, float]:
        """F₀ [N] for an abscissa that rises, and for one that falls."""
        return self.grip if isinstance(self.grip, tuple) else (self.grip, self.grip)


def check_law(law: FrictionLaw) -> None:
    """Refuse a law of friction that Newton could not follow: forces that are none, and a slope of another function."""
    for N in PRESSED:
        static, kinetic, slope = law.static(N), law.kinetic(N), law.slope(N)
        if not 0.0 <= kinetic <= static < np.inf:
            raise CouplingError(
                f"friction: at N = {N:g} N the law {law!r} gives static {static:g} N and kinetic {kinetic:g} N; "
                "allowed are 0 ≤ kinetic ≤ static"
            )
        difference = (law.kinetic(N * (1 + STEP)) - law.kinetic(N * (1 - STEP))) / (2 * STEP * N)
        if not abs(slope - difference) <= AGREE * max(abs(difference), kinetic / N):
            raise CouplingError(
                f"friction: at N = {N:g} N the law {law!r} gives the slope {slope:g}, and its kinetic force rises by "
                f"{difference:g}; return the derivative of the kinetic force by N"
            )


@dataclass(frozen=True)
class Piercing:
    """One hole: its name, whether the thread slides in it, and whether the direction of its site is imposed.

    `friction` None means an ideal hole. The thread is in it from `begins` to `ends` [s]. A hand may draw the thread
    through a hole: `draw`, shape `(k, 2)`: t [s], length [m] towards the end of the thread, linear in between; or
    `pull`, shape `(k, 2)`: t [s], force [N] towards the end of the thread, with which it slides. Where the thread
    slides by itself the hand has it from the first to the last of these times alone, and may do both, one after the
    other; a row with NaN in place of a length or force lets go, and the next one takes it again. Else it has it always.
    Raises `CouplingError` where it were to do both at once, and for friction in its way.
    The thread bears on the tissue over the length `bearing` [m], None where that is not known, and the tissue there
    bears `strength` [Pa]. A ball of tissue along the thread's way between two holes is a hole too: `tract` names that
    way, empty for any other hole.
    """

    name: str
    slides: bool = True
    directed: bool = True
    friction: Friction | None = None
    begins: float = 0.0
    ends: float = np.inf
    draw: Array | None = None
    pull: Array | None = None
    bearing: float | None = None
    strength: float = np.inf
    tract: str = ""

    def __post_init__(self) -> None:
        if self.by_hand and not self.slides and self.friction is not None:
            raise CouplingError(f"piercing {self.name!r}: a hand always has the thread that is anchored; no friction")
        every = [*self.drawing, *self.pulling]
        if any(np.isnan(rows).any() for rows in every):
            raise CouplingError(
                f"piercing {self.name!r}: a hand lets go of a thread that it does not have; leave it out"
            )
        if self.slides and any(len(rows) < 2 for rows in every):
            raise CouplingError(
                f"piercing {self.name!r}: through a hole in which the thread slides a hand draws from the first row to "
                "the last; give two rows"
            )
        if not self.slides and any(np.isnan(rows).any() for rows in (self.draw, self.pull) if rows is not None):
            raise CouplingError(f"piercing {self.name!r}: a hand always has the thread that is anchored; no letting go")
        crossing = any(is_overlapping(one, other) for one in self.drawing for other in self.pulling)
        if self.drawing and self.pulling and (not self.slides or crossing):
            raise CouplingError(f"piercing {self.name!r}: a hand draws with a force or by a length; leave one out")

    @property
    def by_hand(self) -> bool:
        """Whether a hand ever draws the thread through the hole, by a length or with a force."""
        return self.draw is not None or self.pull is not None

    @cached_property
    def drawing(self) -> tuple[Array, ...]:
        """Rows (k, 2) of `draw` for each time that a hand takes the thread."""
        return () if self.draw is None else grips(self.draw)

    @cached_property
    def pulling(self) -> tuple[Array, ...]:
        """Rows (k, 2) of `pull` for each time that a hand takes the thread."""
        return () if self.pull is None else grips(self.pull)

    def is_drawn(self, time: float) -> bool:
        """Whether a hand draws the thread by a length, or holds it, in a step from `time` [s] on."""
        return any(not self.slides or is_within(rows, time) for rows in self.drawing)

    def is_pulled(self, time: float) -> bool:
        """Whether a hand draws the thread with a force in a step from `time` [s] on."""
        return any(not self.slides or is_within(rows, time) for rows in self.pulling)

    def was_in_hand(self, time: float) -> bool:
        """Whether a hand drew the thread in a step to `time` [s]."""
        return any(not self.slides or is_within(rows, time, ended=True) for rows in (*self.drawing, *self.pulling))

    def drawn_length(self, time: float) -> float:
        """Return the length drawn through until `time` [s], by every grip from its own first row on [m]."""
        return float(sum(np.interp(time, rows[:, 0], rows[:, 1] - rows[0, 1]) for rows in self.drawing))

    def pulling_force(self, time: float) -> float:
        """Return the force of the hand on the thread, towards its end, at `time` [s], in N: of the grip that began
        before then, or of the first."""
        begun = [rows for rows in self.pulling if rows[0, 0] < time] or list(self.pulling[:1])
        return float(np.interp(time, *begun[-1].T)) if begun else 0.0


def grips(rows: Array) -> tuple[Array, ...]:
    """Return the rows (k, 2) of a hand in one array for each time that it takes the thread. One that lets go, with NaN,
    is the end of what its hand did last."""
    parts = [part for part in np.split(rows, np.flatnonzero(np.isnan(rows[:, 1])) + 1) if len(part)]
    values = [np.where(np.isnan(part[:, 1]), np.roll(part[:, 1], 1), part[:, 1]) for part in parts]
    return tuple(np.column_stack([part[:, 0], value]) for part, value in zip(parts, values, strict=True))


def is_within(rows: Array, time: float, ended: bool = False) -> bool:
    """Whether a step from `time` [s] on, or one that has `ended` then, lies within the times of the `rows` (k, 2) of a
    hand."""
    (first, _), (last, _) = rows[0], rows[-1]
    slack = ON_TIME * (last - first) * (-1.0 if ended else 1.0)
    after = first - slack
    return bool((after < time <= last - slack) if ended else (after <= time < last - slack))


def is_overlapping(one: Array, other: Array) -> bool:
    """Whether two schedules of a hand, rows (k, 2), have times in common beyond an end."""
    return bool(max(one[0, 0], other[0, 0]) < min(one[-1, 0], other[-1, 0]))


@dataclass(frozen=True)
class ThreadContact:
    """How the thread meets the surface of the organ: strands `inside` are in tissue, between two holds by number, END
    for an end of the thread. The others bear on the surface if the thread `bears` on it, with a coefficient of
    `friction` [-]."""

    inside: tuple[tuple[int, int], ...] = ()
    bears: bool = True
    friction: float = 0.0


@dataclass(frozen=True)
class System(Generic[Body]):
    """Everything that does not change from step to step.

    `piercings` are in the order of the organ's sites. `gravity` (3,) [m/s²] acts on the thread here (the organ
    carries its own). `epsilon` is ε of eq. 7, zero for eq. 6. `ties` close loops of the thread. `compiled`: steps that
    the compiled loops cover are solved by them (`coupling.step.solver`). `contact`: how the thread meets the organ's
    surface, None if that is not known.
    """

    thread: Thread
    ends: tuple[End, End]
    organ: Organ[Body]
    piercings: tuple[Piercing, ...]
    gravity: Array = field(default_factory=lambda: np.zeros(3))
    epsilon: float = 0.0
    ties: tuple[Tie, ...] = ()
    compiled: bool = False
    contact: ThreadContact | None = None

    def __post_init__(self) -> None:
        if self.ties and self.epsilon > 0.0:
            raise CouplingError(f"epsilon = {self.epsilon} kg with ties, whose strands have no inertia; take 0")
        if self.organ.y0.size != 9 * len(self.piercings):
            raise CouplingError(
                f"{len(self.piercings)} piercings, but the organ has {self.organ.y0.size // 9} sites; give one for one"
            )
        self._refuse_missing_directions()
        if self.thread.EI == 0.0 and self.rough.any():
            name = self.piercings[int(np.argmax(self.rough))].name
            raise CouplingError(
                f"friction at piercing {name!r} with EI = 0: it acts along the tangent that the bend at a hole gives "
                "the thread, however thin, and a spline without bending has none; give the thread bending, "
                "for a limp one a small bending_factor, or leave the friction out"
            )

    def _refuse_missing_directions(self) -> None:
        told = self.organ.directed if isinstance(self.organ, KnowsDirections) else ()
        for piercing, directed in zip(self.piercings, told, strict=False):
            if piercing.directed and not directed:
                raise CouplingError(
                    f"piercing {piercing.name!r}: directed = True, but its site was given no direction; give the site "
                    'one (a vector, or "normal" on an organ), or take directed=False'
                )

    def at(self, state: "State[Body]") -> "System[Body]":
        """Return the system with the thread on the spline of a state, the same one if that is its own."""
        thread = self.thread if state.spline is None else self.thread.on(state.spline)
        return self.with_thread(thread.with_memory(state.memory))

    def over(self, state: "State[Body]", dt: float) -> "System[Body]":
        """Return the system with the thread as a step of `dt` [s] from a state meets it: on its spline, with the
        strain that it remembers where it relaxes."""
        system = self.at(state)
        if system.thread.relaxation is None:
            return system
        curve = Solved(system.thread.spline, state.q, state.v) if state.spline is None else solved_curve(state)
        memory = system.thread.on(curve.spline).after_step(curve.q, dt)
        return system.with_thread(system.thread.with_memory(memory))

    def on(self, spline: Spline) -> "System[Body]":
        """Return the system with the thread on another spline, the same one if that is its own."""
        return self.with_thread(self.thread.on(spline))

    def with_thread(self, thread: Thread) -> "System[Body]":
        """Return the system with another thread, the same one if that is its own."""
        return self if thread is self.thread else replace(self, thread=thread)

    def led(self, side: int, end: End) -> "System[Body]":
        """Return the system with another end of the thread at a `side`, where one is held by its place alone as this
        one is: all that was derived from the system stays valid, and is not derived again."""
        led, ends = copy(self), list(self.ends)
        ends[side] = end
        object.__setattr__(led, "ends", tuple(ends))
        return led

    @property
    def bears(self) -> bool:
        """Whether strands of the thread bear on the organ's surface."""
        return self.contact is not None and self.contact.bears

    @cached_property
    def held(self) -> Indices:
        """Numbers of the thread's unknowns that its ends prescribe."""
        c, held = self.thread.coordinates, [np.arange(0)]
        for first, end in zip((0, c * (self.thread.n - 1)), self.ends, strict=True):
            if end.position(0.0) is not None:
                held.append(first + np.arange(3))
            if self.thread.twist and end.angle(0.0) is not None:
                held.append(first + np.array([3]))
        return np.concatenate(held)

    @cached_property
    def held_flags(self) -> Flags:
        """Which of the thread's unknowns its ends prescribe, shape `(n, c)`."""
        held = np.zeros(self.thread.coordinates * self.thread.n, dtype=bool)
        held[self.held] = True
        return held.reshape(self.thread.n, -1)

    @cached_property
    def held_entries(self) -> Indices:
        """Places in a flattened band of the rows and columns of the prescribed unknowns, the diagonal included."""
        h, size = self.thread.half_band, self.thread.coordinates * self.thread.n
        row, column = np.indices((3 * h + 1, size))
        row = row - 2 * h + column
        return np.flatnonzero(np.isin(row, self.held) | np.isin(column, self.held))

    @cached_property
    def own_friction(self) -> tuple[FrictionLaw | None, ...]:
        """Law of one's own of each hold, None where there is none, `holds` of them."""
        own = [p.friction.own if p.friction else None for p in self.piercings]
        return (*own, *([None] * self.holds_off_organ))

    @cached_property
    def weight(self) -> Array:
        """Gravity on the thread and its point masses, shape `(n, c)` [N]; it does not twist."""
        weight = np.zeros((self.thread.n, self.thread.coordinates))
        weight[:, :3] = np.outer(self.thread.mass_matrix @ np.ones(self.thread.n), self.gravity)
        return weight

    @cached_property
    def clamps(self) -> tuple[int, ...]:
        """Ends (0, 1) whose tangent is held: direction constraints at a fixed abscissa, after the piercings."""
        return tuple(k for k, end in enumerate(self.ends) if isinstance(end, Clamped))

    @cached_property
    def holds(self) -> int:
        """Number of places that hold the thread: piercings, then clamped ends, then both strands of every tie."""
        return len(self.piercings) + self.holds_off_organ

    @property
    def holds_off_organ(self) -> int:
        """Number of holds that are no piercings of the organ."""
        return len(self.clamps) + 2 * len(self.ties)

    @cached_property
    def strands(self) -> Indices:
        """Holds of the two strands of every tie, that at lower abscissa first, shape `(t, 2)`."""
        first = len(self.piercings) + len(self.clamps)
        return first + np.arange(2 * len(self.ties)).reshape(-1, 2)

    @cached_property
    def of_ties(self) -> Flags:
        """Which holds are strands of ties, shape `(holds,)`."""
        return np.arange(self.holds) >= len(self.piercings) + len(self.clamps)

    @cached_property
    def clamp_abscissae(self) -> Array:
        """Abscissa of each clamped end [m]."""
        spline = self.thread.spline
        return np.array([(spline.start, spline.end)[k] for k in self.clamps])

    @cached_property
    def clamp_frames(self) -> Array:
        """y of each clamped end: any point, and two vectors across its tangent, shape `(c, 9)`."""
        tangents = [end.direction for end in self.ends if isinstance(end, Clamped)]
        rows = [np.concatenate([np.zeros(3), *orthonormal_pair(tangent)]) for tangent in tangents]
        return np.array(rows).reshape(-1, 9)

    @cached_property
    def rows(self) -> Flags:
        """Which of (g, c₁, c₂) each hold imposes, shape `(holds, 5)`."""
        piercings = [[True] * 3 + [p.directed] * 2 for p in self.piercings]
        clamps = [[False] * 3 + [True] * 2] * len(self.clamps)
        strands = [[True] * 3 + [False] * 2] * (2 * len(self.ties))
        return np.array(piercings + clamps + strands, dtype=bool).reshape(-1, 5)

    def passage(
        self,
        q: Array,
        s: Array,
        home: Array | None = None,
        drive: Array | None = None,
        ridden: Ridden | None = None,
    ) -> Passage:
        """Evaluate the thread with control values `q` (n, c) at the abscissae `s` (holds,) of its holds; `home` as for
        `coupling.kernels.constraints.passage`; `drive` (holds,) [N], −∂Π/∂s where knots travel, or `ridden` with it.
        That of the arrays asked last is remembered: the end of a step is the start of the next."""

        def make() -> Passage:
            if self.thread.travels:
                return knot_passage(self.thread.placed(s).spline, q, s, drive, ridden)
            return passage(self.thread.spline, q, s, home)

        # the pieces that `home` says are no part of what is remembered, nor is what an iterate alone rides on
        if self.thread.spline.cuts.size or ridden is not None:
            return make()
        return self._passages.of((q, s, drive), make)

    @cached_property
    def _passages(self) -> Recent[Passage]:
        """What `passage` made last."""
        return Recent()

    @cached_property
    def recent_pulls(self) -> Recent[Array]:
        """What `coupling.step.tension.pull_at` made last, of s, N and the holds that are there."""
        return Recent()

    def passage_of(self, state: "State[Body]") -> Passage:
        """Evaluate the thread of a state at its holds."""
        return self.at(state).passage(state.q, state.s, drive=state.drive)

    @property
    def width(self) -> float:
        """How near to an end of the thread, or of a piece of it, a hole leaves it [m]: where knots travel, a hole with
        its packet cannot pass the end, and leaves within a diameter of it."""
        return self.thread.section.diameter if self.thread.travels else 0.0

    @cached_property
    def may_slide(self) -> Flags:
        """Which abscissae are unknown, unless a hand draws them by a length, shape `(holds,)`."""
        slides = [p.slides or p.pull is not None for p in self.piercings]
        return np.array(slides + [False] * self.holds_off_organ, dtype=bool) | self.of_ties

    @cached_property
    def from_start(self) -> Flags:
        """Which holds are there when the thread is laid, shape `(holds,)`: no ties."""
        begun = [p.begins <= 0.0 for p in self.piercings]
        return np.array(begun + [True] * self.holds_off_organ, dtype=bool) & ~self.of_ties

    @cached_property
    def friction(self) -> tuple[Array, Array, Array, Array, Array]:
        """Coefficients of all holds: static, kinetic [-], grip and barb [N], by whose sum and difference an abscissa
        that rises and one that falls is gripped, 1/channel [1/m], each `(holds,)`."""
        each = [p.friction or Friction() for p in self.piercings] + [Friction()] * len(self.clamps)
        each += [Friction(grip=tie.hold if np.isfinite(tie.hold) else 0.0) for tie in self.ties for _ in range(2)]
        table = [(f.static, f.kinetic, *f.grips, 1.0 / f.channel if f.channel else 0.0) for f in each]
        static, kinetic, rising, falling, per_channel = np.array(table).reshape(-1, 5).T
        return static, kinetic, 0.5 * (rising + falling), 0.5 * (rising - falling), per_channel

    @cached_property
    def by_hand(self) -> Flags:
        """Holds through which a hand ever draws the thread, shape `(holds,)`."""
        return np.array([p.by_hand for p in self.piercings] + [False] * self.holds_off_organ, dtype=bool)

    def in_hand(self, time: float) -> tuple[Flags, Flags]:
        """Return the holds through which a hand draws the thread in a step from `time` [s] on: by a length, and with a
        force, shape `(holds,)` each."""
        none = [False] * self.holds_off_organ
        if not self.by_hand.any():
            return self.by_hand, self.by_hand
        drawn, pulled = ([getattr(p, way)(time) for p in self.piercings] for way in ("is_drawn", "is_pulled"))
        return np.array(drawn + none, dtype=bool), np.array(pulled + none, dtype=bool)

    def drawn_ties(self, time: float) -> Flags:
        """Holds that are strands of a tie which hands draw in a step from `time` [s] on, shape `(holds,)`."""
        return self.over_ties([tie.is_drawn(time) for tie in self.ties]) > 0.0

    def over_ties(self, values: Sequence[float], first: float = 1.0) -> Array:
        """Return numbers of ties over the holds, shape `(holds,)`: for their first strands times `first`, zero but for
        strands."""
        out = np.zeros(self.holds)
        out[self.strands] = np.outer(values, [first, 1.0])
        return out

    @cached_property
    def yielding(self) -> Array:
        """By how much less the hands of a tie draw per speed of the thread, shape `(holds,)` [N s/m]."""
        return self.over_ties([tie.force / tie.speed for tie in self.ties])

    def drawn_lengths(self, earlier: float, later: float) -> Array:
        """Return the length drawn through each hold between two times [s], shape `(holds,)` [m]."""
        lengths = [p.drawn_length(later) - p.drawn_length(earlier) for p in self.piercings]
        return np.array(lengths + [0.0] * self.holds_off_organ)

    def pulling_forces(self, time: float) -> Array:
        """Return the forces of the hands on the thread at each hold at `time` [s], shape `(holds,)` [N]."""
        pulls = np.array([p.pulling_force(time) for p in self.piercings] + [0.0] * self.holds_off_organ)
        return pulls + self.over_ties([tie.drawing_force(time) for tie in self.ties], -1.0)

    @cached_property
    def bearing_areas(self) -> Array:
        """Area on which the thread bears at each piercing, its diameter times the length of the bearing, shape `(p,)`
        [m²]; infinite where that is not known."""
        lengths = [np.inf if p.bearing is None else p.bearing for p in self.piercings]
        return self.thread.section.diameter * np.array(lengths, dtype=float)

    def hold_still(self, band: Array) -> Array:
        """Replace the rows and columns of the prescribed unknowns in a banded matrix by those of the identity, in
        place."""
        band.ravel()[self.held_entries] = 0.0
        band[diagonal_of(band), self.held] = 1.0
        return band

    @cached_property
    def rough(self) -> Flags:
        """Which holds have friction at all, shape `(holds,)`."""
        static, _, grip, _, _ = self.friction
        own = np.array([law is not None for law in self.own_friction], dtype=bool)
        return np.asarray((static > 0.0) | (grip > 0.0) | own)


def orthonormal_pair(tangent: Array) -> tuple[Array, Array]:
    """Return the unit vectors u, v with u × v = `tangent`: the axes x, y turned by the smallest rotation from z to it.

    Continuous everywhere but at −z, where no rule is. It is the rule of the organ's own sites too. Neither imports the
    other: an organ knows no thread's end, and the coupling knows of an organ only its nine numbers per site.
    """
    x, y, z = tangent
    across = np.hypot(x, y)
    if across == 0.0:
        return np.array([1.0, 0.0, 0.0]), np.array([0.0, np.sign(z), 0.0])
    c, s = x / across, y / across
    u = np.array([1.0 - c * c * (1.0 - z), -c * s * (1.0 - z), -x])
    u = unit_vector(u - (u @ tangent) * tangent)
    return u, cross(tangent, u)


@dataclass(frozen=True)
class State(Generic[Body]):
    """The system at one time.

    `q`, `v` (n, c) [m, m/s, with twist rad, rad/s]; `N`, axial forces [N]; `organ`, the organ's own state; `s`,
    `s_dot` (holds,) [m, m/s]; `lam` (holds, 5) [N, N m]; `y` (holds, 9); `sigma` (holds,): −1, 0, +1 sign of ds/dt, 0
    where the thread sticks; `present` (holds,): False before a piercing begins, and once the thread has left the hole;
    `sense` (holds,): sign of T·(u × v), which changes in a directed hole only where the frame does, not T; `reaction`
    (2, c) [N], force of the holders on the thread's ends, with twist their torque about the tangent too [N m]; `y_dot`
    (holds, 9) [m/s, 1/s], rate of y, None at rest; `frame`, what the twist is measured from, None without twist;
    `stretch` (holds,) [-], 1 + T/EA of the strands at the holes where knots travel, else 1, None of a state that no
    step ended with.

    Where knots travel (`thread.packets`): the `spline` that q and v are on, `drive` (holds,) [N], −∂Π/∂s that the holes
    bear, and the `solved` curve, its spline, q and v, if q and v have been put on other knots since.
    Where the thread relaxes, the `memory` of the step that ended here, None before the first one.

    A two-step integrator keeps the state `before`, `dt_before` [s] earlier, which itself remembers nothing. None: the
    next step has no memory (the start, a one-step integrator, or a jump: see `forgetful`).
    """

    time: float
    q: Array
    v: Array
    N: Array
    organ: Body
    s: Array
    s_dot: Array
    lam: Array
    y: Array
    sigma: Array
    present: Flags
    sense: Array
    reaction: Array
    y_dot: Array | None = None
    frame: Frame | None = None
    stretch: Array | None = None
    spline: Spline | None = None
    drive: Array | None = None
    solved: "Solved | None" = None
    memory: Memory | None = None
    before: "State[Body] | None" = None
    dt_before: float | None = None


@dataclass(frozen=True)
class Solved:
    """A curve as it was solved: its `spline`, `q` and `v` (n, c)."""

    spline: Spline
    q: Array
    v: Array


def solved_curve(state: State[Body]) -> Solved:
    """Return the curve of a state as it was solved, on its own knots."""
    assert state.spline is not None  # of a thread whose knots travel
    return state.solved or Solved(state.spline, state.q, state.v)


def forgetful(state: State[Body]) -> State[Body]:
    """Return the state without the step before it: after a jump of velocity or of the constraints, which no
    integrator of second order may look across."""
    return state if state.before is None and state.dt_before is None else replace(state, before=None, dt_before=None)
