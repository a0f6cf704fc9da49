"""The table of a piercing, `[[piercing]]`, and of its friction."""

from collections.abc import Sequence
from itertools import product
from math import dist, hypot
from typing import Annotated, Literal

from pydantic import Field

from studies.scenario.meanings import because
from studies.scenario.refusal import as_toml, dotted_key, refusal
from studies.scenario.table import ScenarioError, ScenarioTable, check_ending, check_rising, refused
from studies.scenario.values import From, NotNegative, Number, Positive, Text, Turn, Vector, one_sentence

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
