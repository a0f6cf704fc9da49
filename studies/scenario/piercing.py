"""The table of a piercing, `[[piercing]]`, and of its friction."""

from collections.abc import Sequence
from itertools import product
from math import dist, hypot
from typing import Annotated, Literal

from pydantic import Field

from studies.scenario.refusal import as_toml, dotted_key, refusal
from studies.scenario.table import SUBGRID, ScenarioTable, check_ending, check_rising
from studies.scenario.values import From, NotNegative, Number, Positive, Text, Turn, Vector, one_sentence

LetGo = tuple[Number]
HandRow = Annotated[
    Turn | LetGo, one_sentence("rows [t, length] or [t, force], and [t] alone to let go, for example [0.2]")
]
Hand = Annotated[tuple[HandRow, ...], Field(min_length=1)]
Grip = tuple[Turn, ...]  # from the time at which a hand takes the thread to the time at which it lets go

SMALLEST = 1e-6  # m, of a footprint: a tenth of the finest suture's diameter
SHORTEST, LONGEST = 1e-100, 1e100  # of a direction: the squares of its components neither overflow nor vanish
OF_NO_LENGTH = "it must not be zero, or too short or long to compute its length; give numbers near one"


class Friction(ScenarioTable):
    """Coulomb friction and grip at a piercing."""

    static: NotNegative
    kinetic: NotNegative
    grip: Annotated[
        NotNegative | tuple[NotNegative, NotNegative],
        one_sentence("a force of zero or more, or two of them, [rising, falling], for example grip = [0.1, 2.0]"),
    ] = 0.0

    def shared(self, parts: int) -> float | tuple[float, float]:
        """Return the grip of each of `parts` equal parts [N]."""
        if isinstance(self.grip, tuple):
            return self.grip[0] / parts, self.grip[1] / parts
        return self.grip / parts

    def _check_order(self) -> None:
        self._refuse(self.kinetic > self.static, "kinetic.large")


class Piercing(ScenarioTable):
    """Hole through which the thread passes."""

    FORMER = SUBGRID

    name: Text
    at: Annotated[
        Literal["surface"] | Vector,
        one_sentence('three numbers [x, y, z] [m] or "surface", for example at = [-0.01, 0.0, 0.0]'),
    ]
    near: Vector | None = None
    along: Vector | None = None
    kind: Literal["sliding", "anchored"] = "sliding"
    direction: Annotated[
        Literal["free", "normal"] | Vector,
        one_sentence('"free", "normal" or three numbers [x, y, z], for example direction = "normal"'),
    ] = "free"
    footprint: NotNegative = 1.0e-3
    weight: Literal["uniform", "parabolic"] = "parabolic"
    s: NotNegative | None = None
    friction: Friction | None = None
    draw: Hand | None = None
    pull: Hand | None = None
    channel: Positive | None = None
    from_: From = 0.0
    until: Positive | None = None

    def _check_effect(self) -> None:
        for key, vector in (("direction", self.direction), ("along", self.along)):
            if vector is not None and not isinstance(vector, str) and not SHORTEST < hypot(*vector) < LONGEST:
                numbers = ", ".join(f"{x:g}" for x in vector)
                raise ValueError(f".{key} = [{numbers}] is refused: {OF_NO_LENGTH}")
        self._refuse(0.0 < self.footprint < SMALLEST, "footprint.small")
        self._require_place()
        check_ending(self.from_, self.until)
        self._require_hand()
        check_rising("draw", self.draw or ())
        check_rising("pull", self.pull or ())
        self._refuse(self.kind == "anchored" and self.friction is not None, "friction.anchored")
        idle = self.friction is None or self.direction == "free"
        self._refuse(self.channel is not None and idle, "channel.idle")

    @property
    def place(self) -> Vector:
        """Place of the hole [m], or the point from which the surface is searched."""
        if self.at != "surface":
            return self.at
        assert self.near is not None
        return self.near

    @property
    def line(self) -> Vector | None:
        """Direction of the line that finds a place on the surface, None for the nearest surface point."""
        return self.along or (None if isinstance(self.direction, str) else self.direction)

    @property
    def moved(self) -> float | None:
        """Distance from `near` to the place found on the surface [m], None without `near`."""
        return None if self.near is None else dist(self.near, self.place)

    def _require_place(self) -> None:
        """Refuse a place on the surface without `near`, and `along` without `near`."""
        self._refuse(self.at == "surface" and self.near is None, "near.missing")
        self._refuse(self.along is not None and self.near is None, "along.near")

    def _require_hand(self) -> None:
        """Refuse a hand that prescribes length and force at once, that draws for no time, or that lets go twice."""
        draw, pull, slides = self.draw, self.pull, self.kind == "sliding"
        hands = {"draw": draw or (), "pull": pull or ()}
        for key, rows in hands.items():
            self._require_letting_go(key, rows)
        if draw is not None and pull is not None:
            self._refuse(not slides, "pull.anchored")
            for one, other in product(grips(draw), grips(pull)):
                at_once = max(one[0][0], other[0][0]) < min(one[-1][0], other[-1][0])
                self._refuse(at_once, "pull.draw", begins=one[0][0], ends=one[-1][0])
        for key, rows in hands.items():
            single = next((grip[0] for grip in grips(rows) if len(grip) < 2), None) if slides else None
            if single is not None:
                self._refuse(True, "rows.single", (f"{key}.{rows.index(single)}", single))

    def _require_letting_go(self, key: str, rows: Sequence[Turn | LetGo]) -> None:
        """Refuse rows of time alone at an anchored hole, and at times at which no hand holds the thread."""
        alone = [number for number, row in enumerate(rows) if len(row) == 1]
        if alone:
            shown = f"{key}.{alone[0]}", rows[alone[0]]
            self._refuse(self.kind != "sliding", "rows.anchored", shown)
        idle = next((number for number in alone if number == 0 or number - 1 in alone), None)
        if idle is not None:
            self._refuse(True, "rows.idle", (f"{key}.{idle}", rows[idle]))


def grips(rows: Sequence[Turn | LetGo]) -> list[Grip]:
    """Return the rows of a hand in parts, one part for each time that the hand takes the thread."""
    parts: list[Grip] = []
    taken = False
    for row in rows:
        whole = row if len(row) == 2 else (row[0], parts[-1][-1][1])
        parts = [*parts[:-1], (*parts[-1], whole)] if taken else [*parts, (whole,)]
        taken = len(row) == 2
    return parts


def place_refusal(hole: Piercing, reason: str) -> str:
    """Return the refusal of a hole's place, with the origin of this place."""
    key = dotted_key(["piercing", hole.name, "at"])
    if hole.near is None:
        return refusal(key, hole.at, reason)
    return refusal(key, "surface", f"near gives {as_toml(hole.place)} m on the surface, and {reason}")
