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
from coupling.kernels.constraints import Functions, Passage, knot_functions, passage_by
from coupling.ties import ON_TIME, Tie
from thread.banded import diagonal_of
from thread.ends import Clamped, End
from thread.frames import Frame
from thread.kernels.travel import Ridden
from thread.relaxation import Memory
from thread.spline import Spline
from thread.thread import Thread
from tissue.recent import Recent
from tissue.sites.site import frame

PRESSED = (1e-3, 1e-2, 1e-1, 1.0, 10.0)  # N, at which a user's law is checked; the range contains that of sutures
STEP = 1e-5  # of N: step of the difference quotient for the check of its slope, with an error of about 1e-10
AGREE = 1e-3  # relative tolerance of the slope: a difference quotient passes, the slope of another function does not


@dataclass(frozen=True)
class Friction:
    """The friction of a hole: Coulomb's coefficients `static`, `kinetic` [-], and `grip` F₀ [N],
    independent of the tension.

    - `grip`: for a barb a pair, for an abscissa at the hole that rises, and for one that falls.
    - `channel` [m]: length over which a hole imposes a direction. The couple of this constraint
      presses on both ends of the channel (`coupling.step.sliding`); None if it does not press.
    - `own`: a user's law that is added; None if there is none.
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
    """Refuse a law of friction without valid forces, or with the slope of another function:
    Newton's method needs both.
    """
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
    """One hole of the thread.

    - `name`; `slides`: whether the thread slides in it; `directed`: whether the direction of its
      site is imposed.
    - `friction`: None means a hole without friction.
    - `begins`, `ends` [s]: the thread is in the hole between these times.
    - `draw`, shape `(k, 2)`: a hand draws the thread; t [s] and length [m] towards the end of the
      thread, linear in between.
    - `pull`, shape `(k, 2)`: a hand pulls the thread; t [s] and force [N] towards the end of the
      thread, with which it slides.
    - `bearing` [m]: length over which the thread bears on the tissue; None if it is unknown.
    - `strength` [Pa]: pressure that the tissue bears there.
    - `tract`: a ball of tissue on the thread's way between two holes is a hole too, and this is the
      name of that way; empty for other holes.

    In a hole in which the thread slides, a hand holds the thread only between the first and the
    last of its times. It may draw and pull one after the other. A row with nan as length or force
    lets go, and the next row takes the thread again. In other holes the hand always holds the
    thread. Raises `CouplingError` if the hand would draw and pull at once, for rows that contradict
    these rules, and for friction at an anchored thread in a hand.
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
            raise CouplingError(f"piercing {self.name!r}: a hand always holds an anchored thread; leave out friction")
        every = [*self.drawing, *self.pulling]
        if any(np.isnan(rows).any() for rows in every):
            raise CouplingError(
                f"piercing {self.name!r}: a hand lets go of a thread that it does not hold; leave out this row"
            )
        if self.slides and any(len(rows) < 2 for rows in every):
            raise CouplingError(
                f"piercing {self.name!r}: if the thread slides in a hole, a hand draws from the first row to the last; "
                "give two rows"
            )
        if not self.slides and any(np.isnan(rows).any() for rows in (self.draw, self.pull) if rows is not None):
            raise CouplingError(f"piercing {self.name!r}: a hand always holds an anchored thread; leave out nan")
        crossing = any(is_overlapping(one, other) for one in self.drawing for other in self.pulling)
        if self.drawing and self.pulling and (not self.slides or crossing):
            raise CouplingError(f"piercing {self.name!r}: a hand draws by a length or with a force; leave one out")

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

    def is_held(self, schedules: Sequence[Array], time: float) -> bool:
        """Return whether a hand holds the thread in a step from `time` [s] on, by `drawing` or `pulling`."""
        return any(not self.slides or is_within(rows, time) for rows in schedules)

    def drawn_length(self, time: float) -> float:
        """Return the length drawn through until `time` [s], summed over the grips, each from its
        first row on [m].
        """
        return float(sum(np.interp(time, rows[:, 0], rows[:, 1] - rows[0, 1]) for rows in self.drawing))

    def pulling_force(self, time: float) -> float:
        """Return the force of the hand on the thread, towards its end, at `time` [s], in N.

        The force is that of the last grip that began before then, or of the first grip.
        """
        begun = [rows for rows in self.pulling if rows[0, 0] < time] or list(self.pulling[:1])
        return float(np.interp(time, *begun[-1].T)) if begun else 0.0


def grips(rows: Array) -> tuple[Array, ...]:
    """Return the rows (k, 2) of a hand in one array for each time that it takes the thread.

    A row with nan, at which the hand lets go, gets the last value of that grip.
    """
    parts = [part for part in np.split(rows, np.flatnonzero(np.isnan(rows[:, 1])) + 1) if len(part)]
    values = [np.where(np.isnan(part[:, 1]), np.roll(part[:, 1], 1), part[:, 1]) for part in parts]
    return tuple(np.column_stack([part[:, 0], value]) for part, value in zip(parts, values, strict=True))


def is_within(rows: Array, time: float) -> bool:
    """Return whether a step from `time` [s] on is within the times of the `rows` (k, 2) of a hand."""
    (first, _), (last, _) = rows[0], rows[-1]
    slack = ON_TIME * (last - first)
    return bool(first - slack <= time < last - slack)


def turns(rows: Array) -> list[float]:
    """Return the times [s] of the first and last of a hand's `rows` (k, 2), and of those at which it turns."""
    way = np.sign(np.diff(rows[:, 1]))
    at_turn = np.r_[True, way[1:] != way[:-1], True] if len(rows) > 1 else [True]
    return [float(time) for time in rows[at_turn, 0]]


def is_overlapping(one: Array, other: Array) -> bool:
    """Return whether two schedules of a hand, rows (k, 2), overlap in more than an end."""
    return bool(max(one[0, 0], other[0, 0]) < min(one[-1, 0], other[-1, 0]))


@dataclass(frozen=True)
class ThreadContact:
    """The contact of the thread with the surface of the organ.

    Strands `inside` are in tissue, between two holds by number, with END for an end of the thread.
    If `bears`, the other strands bear on the surface, with a coefficient of `friction` [-].
    """

    inside: tuple[tuple[int, int], ...] = ()
    bears: bool = True
    friction: float = 0.0


@dataclass(frozen=True)
class System(Generic[Body]):
    """The data that do not change from step to step.

    - `thread`, `ends`, `organ`.
    - `piercings`: in the order of the organ's sites.
    - `gravity` (3,) [m/s²]: acts on the thread; the organ has its own.
    - `epsilon`: ε of eq. 7, zero for eq. 6.
    - `ties`: loops of the thread.
    - `compiled`: whether covered steps are solved by the compiled loops (`coupling.step.solver`).
    - `contact`: contact of the thread with the organ's surface; None if it is unknown.
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
            raise CouplingError(f"epsilon = {self.epsilon} kg with ties, whose strands have no inertia; give 0")
        if self.organ.y0.size != 9 * len(self.piercings):
            raise CouplingError(
                f"{len(self.piercings)} piercings, but the organ has {self.organ.y0.size // 9} sites; give as many"
            )
        self._refuse_missing_directions()
        if self.thread.EI == 0.0 and self.rough.any():
            name = self.piercings[int(np.argmax(self.rough))].name
            raise CouplingError(
                f"friction at piercing {name!r} with EI = 0: friction acts along the tangent of the bend at a hole, "
                "and a spline without bending has no such bend; give the thread bending, for a limp one a small "
                "bending_factor, or leave the friction out"
            )

    def _refuse_missing_directions(self) -> None:
        told = self.organ.directed if isinstance(self.organ, KnowsDirections) else ()
        for piercing, directed in zip(self.piercings, told, strict=False):
            if piercing.directed and not directed:
                raise CouplingError(
                    f"piercing {piercing.name!r}: directed = True, but its site has no direction; give the site one "
                    '(a vector, or "normal" on an organ), or use directed=False'
                )

    def at(self, state: "State[Body]") -> "System[Body]":
        """Return the system with the thread on the spline of a state; itself if that is its own spline."""
        thread = self.thread if state.spline is None else self.thread.on(state.spline)
        return self.with_thread(thread.with_memory(state.memory))

    def over(self, state: "State[Body]", dt: float) -> "System[Body]":
        """Return the system with the thread for a step of `dt` [s] from a state.

        The thread is on the spline of the state. If it relaxes, it has the remembered strain.
        """
        system = self.at(state)
        if system.thread.relaxation is None:
            return system
        curve = Solved(system.thread.spline, state.q, state.v) if state.spline is None else solved_curve(state)
        memory = system.thread.on(curve.spline).after_step(curve.q, dt)
        return system.with_thread(system.thread.with_memory(memory))

    def on(self, spline: Spline) -> "System[Body]":
        """Return the system with the thread on another spline; itself if that is its own spline."""
        return self.with_thread(self.thread.on(spline))

    def with_thread(self, thread: Thread) -> "System[Body]":
        """Return the system with another thread; itself if that is its own thread."""
        return self if thread is self.thread else replace(self, thread=thread)

    def led(self, side: int, end: End) -> "System[Body]":
        """Return the system with another end of the thread at a `side`.

        Both the old and the new end only prescribe a place. All cached properties of the system
        remain valid and are kept.
        """
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

    def held_pieces(self, s: Array, present: Flags) -> Flags:
        """Return which pieces of the thread a hole or an end holds, shape `(pieces,)`.

        The holds at `s` (m,) [m] that are `present` (m,) hold their pieces.
        """
        spline = self.thread.spline
        held = np.zeros(spline.pieces, dtype=bool)
        held[spline.piece_of(s[present])] = True
        for piece, end in zip((0, -1), self.ends, strict=True):
            held[piece] |= end.position(0.0) is not None
        return held

    @cached_property
    def held_flags(self) -> Flags:
        """Flags of the thread's unknowns that its ends prescribe, shape `(n, c)`."""
        held = np.zeros(self.thread.coordinates * self.thread.n, dtype=bool)
        held[self.held] = True
        return held.reshape(self.thread.n, -1)

    @cached_property
    def held_entries(self) -> Indices:
        """Places in a flattened band of the rows and columns of the prescribed unknowns, including
        the diagonal.
        """
        h, size = self.thread.half_band, self.thread.coordinates * self.thread.n
        row, column = np.indices((3 * h + 1, size))
        row = row - 2 * h + column
        return np.flatnonzero(np.isin(row, self.held) | np.isin(column, self.held))

    @cached_property
    def own_friction(self) -> tuple[FrictionLaw | None, ...]:
        """User's law of friction of each hold, None for one without; empty if no hold has one."""
        own = [p.friction.own if p.friction else None for p in self.piercings]
        return (*own, *([None] * self.holds_off_organ)) if any(law is not None for law in own) else ()

    @cached_property
    def weight(self) -> Array:
        """Gravity on the thread and its point masses, shape `(n, c)` [N]; it has no twisting moment."""
        weight = np.zeros((self.thread.n, self.thread.coordinates))
        weight[:, :3] = np.outer(self.thread.mass_matrix @ np.ones(self.thread.n), self.gravity)
        return weight

    @cached_property
    def clamps(self) -> tuple[int, ...]:
        """Ends (0, 1) with a held tangent: direction constraints at a fixed abscissa, after the piercings."""
        return tuple(k for k, end in enumerate(self.ends) if isinstance(end, Clamped))

    @cached_property
    def holds(self) -> int:
        """Number of places that hold the thread: piercings, then clamped ends, then both strands of every tie."""
        return len(self.piercings) + self.holds_off_organ

    @property
    def holds_off_organ(self) -> int:
        """Number of holds that are not piercings of the organ."""
        return len(self.clamps) + 2 * len(self.ties)

    @cached_property
    def strands(self) -> Indices:
        """Holds of the two strands of every tie, lower abscissa first, shape `(t, 2)`."""
        first = len(self.piercings) + len(self.clamps)
        return first + np.arange(2 * len(self.ties)).reshape(-1, 2)

    @cached_property
    def of_ties(self) -> Flags:
        """Flags of the holds that are strands of ties, shape `(holds,)`."""
        return np.arange(self.holds) >= len(self.piercings) + len(self.clamps)

    @cached_property
    def clamp_frames(self) -> Array:
        """y of each clamped end: an arbitrary point, and two vectors across its tangent, shape `(c, 9)`."""
        tangents = [end.direction for end in self.ends if isinstance(end, Clamped)]
        rows = [np.concatenate([np.zeros(3), *frame(tangent)]) for tangent in tangents]
        return np.array(rows).reshape(-1, 9)

    @cached_property
    def rows(self) -> Flags:
        """Flags of the constraints (g, c₁, c₂) that each hold imposes, shape `(holds, 5)`."""
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
        """Evaluate the thread with control values `q` (n, c) at the abscissae `s` (holds,) of its holds.

        `home` is as for `coupling.kernels.constraints.passage`. If knots travel, `drive` (holds,)
        [N] is −∂Π/∂s, or `ridden` contains it. The results for the last arrays are cached: the end
        of a step is the start of the next one.
        """

        def make() -> Passage:
            unknown = np.zeros(len(s)) if self.thread.travels and drive is None else drive
            return passage_by(self._functions.of((s, home), functions), q, unknown, ridden)

        def functions() -> Functions:
            if self.thread.travels:
                return knot_functions(self.thread.placed(s).spline, s)
            return self.thread.spline.basis(s, home)

        return make() if ridden is not None else self._passages.of((q, s, home, drive), make)

    @cached_property
    def _passages(self) -> Recent[Passage]:
        """Cache of `passage`; `ridden` is that of one iterate and is used only once."""
        return Recent()

    @cached_property
    def _functions(self) -> Recent[Functions]:
        """Cache of the functions at the holes; a line search moves the thread at the same abscissae."""
        return Recent()

    @cached_property
    def recent_pulls(self) -> Recent[Array]:
        """Cache of `coupling.step.tension.pull_at`, by s, N and the present holds."""
        return Recent()

    def passage_of(self, state: "State[Body]") -> Passage:
        """Evaluate the thread of a state at its holds."""
        return self.at(state).passage(state.q, state.s, drive=state.drive)

    @property
    def width(self) -> float:
        """Distance from an end of the thread, or of a piece of it, at which a hole leaves it [m].

        If knots travel, a hole with its packet cannot pass the end, and leaves within a diameter of
        the end. Otherwise it is zero.
        """
        return self.thread.section.diameter if self.thread.travels else 0.0

    @cached_property
    def may_slide(self) -> Flags:
        """Flags of the abscissae that are unknown unless a hand draws them by a length, shape `(holds,)`."""
        slides = [p.slides or p.pull is not None for p in self.piercings]
        return np.array(slides + [False] * self.holds_off_organ, dtype=bool) | self.of_ties

    @cached_property
    def from_start(self) -> Flags:
        """Flags of the holds that are active when the thread is laid, shape `(holds,)`; ties are not."""
        begun = [p.begins <= 0.0 for p in self.piercings]
        return np.array(begun + [True] * self.holds_off_organ, dtype=bool) & ~self.of_ties

    @cached_property
    def friction(self) -> tuple[Array, Array, Array, Array, Array]:
        """Coefficients of all holds: static, kinetic [-], grip and barb [N], and 1/channel [1/m],
        each `(holds,)`.

        A rising abscissa is gripped by the sum of grip and barb, and a falling one by their
        difference.
        """
        each = [p.friction or Friction() for p in self.piercings] + [Friction()] * len(self.clamps)
        each += [Friction(grip=tie.hold if np.isfinite(tie.hold) else 0.0) for tie in self.ties for _ in range(2)]
        table = [(f.static, f.kinetic, *f.grips, 1.0 / f.channel if f.channel else 0.0) for f in each]
        static, kinetic, rising, falling, per_channel = np.array(table).reshape(-1, 5).T.copy()
        return static, kinetic, 0.5 * (rising + falling), 0.5 * (rising - falling), per_channel

    @cached_property
    def by_hand(self) -> Flags:
        """Flags of the holds through which a hand ever draws the thread, shape `(holds,)`."""
        return np.array([p.by_hand for p in self.piercings] + [False] * self.holds_off_organ, dtype=bool)

    def in_hand(self, time: float) -> tuple[Flags, Flags]:
        """Return the holds at which a hand draws the thread in a step from `time` [s] on: by a
        length, and with a force.

        Both have shape `(holds,)`.
        """
        none = [False] * self.holds_off_organ
        if not self.by_hand.any():
            return self.by_hand, self.by_hand
        drawn = [p.is_held(p.drawing, time) for p in self.piercings]
        pulled = [p.is_held(p.pulling, time) for p in self.piercings]
        return np.array(drawn + none, dtype=bool), np.array(pulled + none, dtype=bool)

    def drawn_ties(self, time: float) -> Flags:
        """Return flags of the holds that are strands of a tie which hands draw in a step from
        `time` [s] on, shape `(holds,)`.
        """
        return self.over_ties([tie.is_drawn(time) for tie in self.ties]) > 0.0

    def over_ties(self, values: Sequence[float], first: float = 1.0) -> Array:
        """Return numbers of ties over the holds, shape `(holds,)`.

        They are multiplied by `first` for the first strands, and zero for holds that are not
        strands.
        """
        out = np.zeros(self.holds)
        out[self.strands] = np.outer(values, [first, 1.0])
        return out

    @cached_property
    def yielding(self) -> Array:
        """Decrease of the force of a tie's hands per speed of the thread, shape `(holds,)` [N s/m]."""
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
        """Area on which the thread bears at each piercing, its diameter times the bearing length,
        shape `(p,)` [m²].

        The area is infinite if the length is unknown.
        """
        lengths = [np.inf if p.bearing is None else p.bearing for p in self.piercings]
        return self.thread.section.diameter * np.array(lengths, dtype=float)

    def hold_still(self, band: Array) -> Array:
        """Replace the rows and columns of the prescribed unknowns in a banded matrix by those of
        the identity, in place.
        """
        band.ravel()[self.held_entries] = 0.0
        band[diagonal_of(band), self.held] = 1.0
        return band

    @cached_property
    def rough(self) -> Flags:
        """Flags of the holds with friction, shape `(holds,)`."""
        static, _, grip, _, _ = self.friction
        rough = (static > 0.0) | (grip > 0.0)
        for k, law in enumerate(self.own_friction):
            rough[k] |= law is not None
        return rough


@dataclass(frozen=True)
class State(Generic[Body]):
    """The system at one time.

    - `q`, `v` (n, c) [m, m/s, with twist rad, rad/s]; `N`: axial forces [N]; `organ`: the organ's
      own state.
    - `s`, `s_dot` (holds,) [m, m/s]; `lam` (holds, 5) [N, N m]; `y` (holds, 9).
    - `sigma` (holds,): sign of ds/dt, −1 or +1; 0 if the thread sticks.
    - `present` (holds,): False before a piercing begins, and after the thread has left the hole.
    - `sense` (holds,): sign of T·(u × v). In a directed hole it changes only if the frame flips,
      not if T does.
    - `reaction` (2, c) [N]: force of the holders on the thread's ends, with twist also their torque
      about the tangent [N m].
    - `y_dot` (holds, 9) [m/s, 1/s]: rate of y; None at rest.
    - `frame`: reference of the twist; None without twist.
    - `stretch` (holds,) [-]: 1 + T/EA of the strands at the holes if knots travel, otherwise 1;
      None if the state is not the end of a step.
    - `by_hand` (holds,): holds at which hands drew in the step that ended here; None if there was
      no step.
    - `spline`, `drive` (holds,) [N], `solved`: if knots travel (`thread.packets`), the spline of q
      and v, −∂Π/∂s that the holes bear, and the solved curve if q and v have been put on other
      knots since.
    - `memory`: if the thread relaxes, the memory of the step that ended here; None before the first
      one.
    - `before`, `dt_before` [s]: for a two-step integrator the earlier state, which has no earlier
      state itself, and the time since then. None if the next step has no memory: at the start, with
      a one-step integrator, or after a jump (`forgetful`).
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
    by_hand: Flags | None = None
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
    """Return the solved curve of a state, on its own knots."""
    assert state.spline is not None  # because knots travel
    return state.solved or Solved(state.spline, state.q, state.v)


def forgetful(state: State[Body]) -> State[Body]:
    """Return the state without the earlier state, for use after a jump of velocity or of the constraints.

    No integrator of second order may use states on both sides of such a jump.
    """
    return state if state.before is None and state.dt_before is None else replace(state, before=None, dt_before=None)
