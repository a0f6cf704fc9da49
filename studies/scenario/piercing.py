"""The tables of a piercing and its friction, `[[piercing]]`, and of what joins two piercings.

A tract, `[[tract]]`, is tissue on which the thread bears laterally between two holes. A tie,
`[[tie]]`, is a loop of thread that hands draw tight over the tissue and lock.
"""

from collections.abc import Sequence
from itertools import product
from math import dist, hypot, inf
from typing import Annotated, Literal

from pydantic import Field

from studies.scenario.refusal import as_toml, because, dotted_key, nearest, refusal
from studies.scenario.table import ScenarioError, ScenarioTable, check_ending, check_rising, refuse, refused, repetition
from studies.scenario.values import Flag, From, NotNegative, Number, Positive, Text, Turn, Vector, one_sentence

LetGo = tuple[Number]
HandRow = Annotated[Turn | LetGo, one_sentence("allowed-hand")]
Hand = Annotated[tuple[HandRow, ...], Field(min_length=1)]
Grip = tuple[Turn, ...]  # from the time at which a hand takes the thread to the time at which it lets go

SMALLEST = 1e-6  # m, of a footprint: a tenth of the finest suture's diameter
SHORTEST, LONGEST = 1e-100, 1e100  # of a direction: the squares of its components neither overflow nor vanish


class Friction(ScenarioTable):
    """Coulomb friction and grip at a piercing."""

    static: NotNegative
    kinetic: NotNegative
    grip: Annotated[NotNegative | tuple[NotNegative, NotNegative], one_sentence("allowed-grip")] = 0.0

    def shared(self, parts: int) -> "Friction":
        """Return the friction of each of `parts` equal parts, which share the grip."""
        grip = tuple(force / parts for force in self.grip) if isinstance(self.grip, tuple) else self.grip / parts
        return self.model_copy(update={"grip": grip})

    def _check_order(self) -> None:
        self._refuse(self.kinetic > self.static, "kinetic.large")


class Piercing(ScenarioTable):
    """Hole through which the thread passes."""

    name: Text
    at: Annotated[Literal["surface"] | Vector, one_sentence("allowed-place")]
    near: Vector | None = None
    along: Vector | None = None
    kind: Literal["sliding", "anchored"] = "sliding"
    direction: Annotated[Literal["free", "normal"] | Vector, one_sentence("allowed-direction")] = "free"
    footprint: NotNegative = 1.0e-3
    weight: Literal["uniform", "parabolic"] = "parabolic"
    s: NotNegative | None = None
    friction: Friction | None = None
    draw: Hand | None = None
    pull: Hand | None = None
    channel: Positive | None = None
    from_: From = 0.0
    until: Positive | None = None

    def _check_directions(self) -> None:
        """Refuse a direction whose length vanishes or overflows."""
        for key, vector in (("direction", self.direction), ("along", self.along)):
            if vector is not None and not isinstance(vector, str) and not SHORTEST < hypot(*vector) < LONGEST:
                numbers = ", ".join(f"{x:g}" for x in vector)
                raise ValueError(f".{key} = [{numbers}] is refused: {because('no-length')}")

    def _check_place(self) -> None:
        """Refuse a place on the surface without `near`, and `along` without `near`."""
        self._refuse(0.0 < self.footprint < SMALLEST, "footprint.small")
        self._refuse(self.at == "surface" and self.near is None, "near.missing")
        self._refuse(self.along is not None and self.near is None, "along.near")
        check_ending(self.from_, self.until)

    def _check_release(self) -> None:
        """Refuse impossible rows of time alone.

        A hand never releases an anchored thread. At a sliding hole a hand must hold the thread
        before.
        """
        for key, rows in self.hands.items():
            alone = [number for number, row in enumerate(rows) if len(row) == 1]
            for number in alone:
                shown = f"{key}.{number}", rows[number]
                self._refuse(self.kind == "anchored", "rows.anchored", shown)
                self._refuse(number == 0 or number - 1 in alone, "rows.idle", shown)

    def _check_hands(self) -> None:
        """Refuse a hand that prescribes length and force at once, or that draws for no time.

        Also refuse rows whose times do not rise.
        """
        self._refuse(self.kind == "anchored" and None not in (self.draw, self.pull), "pull.anchored")
        for draw, pull in product(*map(grips, self.hands.values())):
            at_once = max(draw[0][0], pull[0][0]) < min(draw[-1][0], pull[-1][0])
            self._refuse(at_once, "pull.draw", begins=draw[0][0], ends=draw[-1][0])
        for key, rows in self.hands.items():
            for grip in grips(rows) if self.kind == "sliding" else ():
                self._refuse(len(grip) < 2, "rows.single", (f"{key}.{rows.index(grip[0])}", grip[0]))
        for key, rows in self.hands.items():
            check_rising(key, rows)

    def _check_friction(self) -> None:
        self._refuse(self.kind == "anchored" and self.friction is not None, "friction.anchored")
        idle = self.friction is None or self.direction == "free"
        self._refuse(self.channel is not None and idle, "channel.idle")

    @property
    def hands(self) -> dict[str, tuple[Turn | LetGo, ...]]:
        """Rows of the hands that draw by a length or pull by a force, by their keys.

        They are empty without a hand.
        """
        return {"draw": self.draw or (), "pull": self.pull or ()}

    def key(self, *parts: str) -> str:
        """Return the full name of the table, or of one of its keys."""
        return dotted_key(["piercing", self.name, *parts])

    @property
    def place(self) -> Vector:
        """Place of the hole [m], or the point from which the surface is searched."""
        if self.at != "surface":
            return self.at
        assert self.near is not None
        return self.near

    @property
    def line(self) -> Vector | None:
        """Direction of the line on which the place is searched.

        It is None if the nearest point of the surface is searched.
        """
        return self.along or (None if isinstance(self.direction, str) else self.direction)

    @property
    def moved(self) -> float | None:
        """Distance from `near` to the place found on the surface [m], None without `near`."""
        return None if self.near is None else dist(self.near, self.place)


def grips(rows: Sequence[Turn | LetGo]) -> list[Grip]:
    """Return the rows of a hand in parts, one part for each time that the hand takes the thread."""
    parts: list[Grip] = []
    held = False
    for row in rows:
        whole = row if len(row) == 2 else (row[0], parts[-1][-1][1])
        parts = [*parts[:-1], (*parts[-1], whole)] if held else [*parts, (whole,)]
        held = len(row) == 2
    return parts


def place_refused(hole: Piercing, reason: str, /, **values: object) -> ScenarioError:
    """Return the error for a hole's place, with its origin and the reason of this name."""
    if hole.near is None:
        return refused(hole.key("at"), hole.at, reason, **values)
    origin = f"near gives {as_toml(hole.place)} m on the surface, and {because(reason, **values)}"
    return ScenarioError(refusal(hole.key("at"), "surface", origin))


class Tract(ScenarioTable):
    """Tissue along the thread's path between two neighbouring holes.

    The thread slides along the path, and not across it.
    """

    between: tuple[Text, Text]
    radius: Positive | None = None
    spacing: Positive | None = None
    friction: Friction | None = None

    @property
    def name(self) -> str:
        """Name of the tract, made of the names of its holes."""
        return "-".join(self.between)


def check_tracts(tracts: Sequence[Tract], holes: Sequence[Piercing], in_organ: bool, scheme: str) -> None:
    """Refuse a tract that is impossible.

    Its holes must be neighbours along the thread, without a second tract, permanent, and with a
    radius. It needs an organ and must not use the paper's linear step.
    """
    names = [hole.name for hole in holes]
    for k, tract in enumerate(tracts):
        key, value = f"tract.{k}.between", tract.between
        refuse(not in_organ, key, value, "tract-organ")
        refuse(scheme == "linear", key, value, "tract-linear")
        for name in value:
            known = ", ".join(map(repr, names)) or "none"
            refuse(name not in names, key, value, "tract-unknown", name=name, known=known)
        refuse(any(value == other.between for other in tracts[:k]), key, value, "tract-twice")
        (one, other), (first, last) = value, map(names.index, value)
        if last != first + 1:
            following = f"; after {one!r} it passes {names[first + 1]!r}" if first + 1 < len(names) else ""
            raise refused(key, value, "tract-apart", one=one, other=other, following=following)
        ends = holes[first : last + 1]
        for hole in ends:
            refuse(hole.from_ > 0.0 or hole.until is not None, key, value, "tract-passing", hole=hole.key())
        refuse(tract.radius is None and not min(hole.footprint for hole in ends), key, value, "tract-radius", number=k)


class Tie(ScenarioTable):
    """Tie of the outer strands at two holes."""

    name: Text
    between: tuple[Text, Text]
    force: Positive
    from_: From = 0.0
    until: Positive
    ramp: NotNegative | None = None
    speed: Positive = 0.05
    hold: Positive | None = None
    held: Flag = False

    @property
    def growth(self) -> float:
        """Time in which the force grows [s]."""
        return 0.5 * (self.until - self.from_) if self.ramp is None else self.ramp

    def _check(self) -> None:
        self._refuse(self.between[0] == self.between[1], "between.one")
        check_ending(self.from_, self.until)
        drawn = self.until - self.from_
        self._refuse(self.ramp is not None and self.ramp > drawn, "ramp.long", drawn=drawn)


def check_ties(ties: Sequence[Tie], holes: Sequence[Piercing]) -> None:
    """Refuse ties with a repeated name, and a tie of impossible holes.

    Whether the thread has slid out of a hole is not considered.
    """
    if fault := repetition("tie", [tie.name for tie in ties]):
        raise ScenarioError(fault)
    known, pairs = {hole.name: hole for hole in holes}, [set(tie.between) for tie in ties]
    for k, tie in enumerate(ties):
        key = "tie", tie.name, "between"
        for name in tie.between:
            if name not in known:
                match = nearest(name, known)
                hint = f", did you mean {as_toml(match)}" if match else ""
                raise refused(key, tie.between, "tie-unknown", name=as_toml(name), hint=hint)
        other = ties[pairs.index(pairs[k])].name
        refuse(pairs[k] in pairs[:k], key, tie.between, "tie-twice", other=as_toml(other))
        for hole in map(known.__getitem__, tie.between):
            if not hole.from_ <= (0.0 if tie.held else tie.from_) <= tie.from_ < (hole.until or inf):
                raise refused(("tie", tie.name, "from"), tie.from_, "tie-early", name=as_toml(hole.name))
