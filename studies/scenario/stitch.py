"""The table of a stitch, `[[stitch]]`.

It writes path, piercings, tracts, ties and cuts of a thread. A stitch is a row of bites. A bite
goes down into the tissue through one hole and up through the next hole, along half an ellipse, like
a curved needle. Strands on the surface join the bites. Without depth, as in the middle of a thin
sheet, the whole stitch is straight from hole to hole. Each kind is a list of bites (`bites_of`)
with coordinates along the wound and across it from left to right.
"""

import re
from collections.abc import Iterator, Mapping, Sequence
from functools import cached_property
from itertools import pairwise
from math import ceil, cos, pi, sin
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
from pydantic import Field

from studies.arrays import Array
from studies.scenario.piercing import Friction
from studies.scenario.refusal import CAUSES, as_toml, because, dotted_key, refusal
from studies.scenario.solve import Solve
from studies.scenario.table import ScenarioTable, check_ending, check_rising, repetition
from studies.scenario.values import From, NotNegative, Positive, Text, Turn, Vector, one_sentence
from thread.path import rounded_path

NEAR = 0.3  # of bite and depth of a vertical mattress stitch: its inner bite near the edges
BENDS = 8  # per bite: each turns the thread by 22.5°
LIFT = 0.2  # of the bite: height of a strand above the surface, for about the length of its natural arch
KNOT = 0.4  # of the bite: height at which the strands of a knot cross
# Height of the upright tails over a knot [m]. A stiff loop that is laid straightens its bends and draws in its tails:
# of 2-0 polypropylene, bites of 1 to 8 mm and forces from 0.05 N up at most 4.3 mm on each side.
UPRIGHT = 0.01
TAIL = 2.0  # of the bite: length of the tails of a stitch without depth
UNTIL = 0.75  # of the run: time at which a stitch is tied
FLAT = ("block", "wound")  # meshes with a plane top at z = 0
ROWS = ("running", "purse-string")  # kinds with a number of bites
Kind = Literal["single", "running", "vertical-mattress", "horizontal-mattress", "figure-of-eight", "purse-string"]


class Bite(NamedTuple):
    """A passage through the tissue.

    It has the `names` of its two holes, their places along and across the wound [m], and its depth
    [m].
    """

    names: tuple[str, str]
    first: tuple[float, float]
    last: tuple[float, float]
    depth: float


class Stitch(ScenarioTable):
    """Stitch that is laid, drawn by hands, and locked if it is drawn with a force."""

    name: Text
    kind: Kind = "single"
    at: Vector
    along: Vector | None = None
    normal: Vector = (0.0, 0.0, 1.0)
    bite: Annotated[Positive | tuple[Positive, Positive], one_sentence("allowed-bite")]
    depth: NotNegative
    pitch: Positive | None = None
    count: Annotated[int, Field(strict=True, ge=2, le=200)] = 6
    force: Positive | None = None
    draw: Annotated[tuple[Turn, ...], Field(min_length=1)] | None = None
    from_: From = 0.0
    until: Positive | None = None
    hold: Positive | None = None
    footprint: Positive = 1.0e-3
    tract: Annotated[Positive | Literal[False], one_sentence("allowed-tract")] | None = None
    friction: Friction | None = None

    def _check(self) -> None:
        check_ending(self.from_, self.until)
        self._refuse(self.kind not in ROWS and "count" in self.model_fields_set, "count.fixed")
        self._refuse((self.force is None) == (self.draw is None), "force.draw")
        straight = self.kind == "running" or (self.kind == "single" and self.draw is not None)
        self._refuse(not self.depth and not straight, "depth.tied")
        self._refuse(not self.depth and bool(self.tract), "tract.straight")
        self._refuse(self.draw is not None and self.until is not None, "until.draw")
        self._refuse(self.draw is not None and self.from_ > 0.0, "from.draw", ("from", self.from_))
        slips = self.kind != "single" or self.draw is None or (self.depth and self.tract is not False)
        self._refuse(self.friction is not None and not slips, "friction.held")
        self._refuse(not self.is_tied and self.hold is not None, "hold.untied")
        if self.draw is not None:
            check_rising("draw", self.draw)
        self._refuse(not np.any(self.normal), "normal.zero")
        if self.along is not None:
            self._refuse(not np.any(self.along), "along.zero")
            parallel = np.linalg.norm(np.cross(unit(self.along), unit(self.normal))) < 1e-6
            self._refuse(parallel, "along.parallel")
        crowded = self.kind == "purse-string" and self.count * 2.0 * self.mean >= 2.0 * pi * self.step
        self._refuse(crowded, "bite.long")

    @property
    def is_tied(self) -> bool:
        """Whether the stitch is a loop that hands draw with a force and tie."""
        return self.kind != "running" and self.draw is None

    @property
    def sides(self) -> tuple[float, float]:
        """Distances of the holes from the line, left and right [m]."""
        return self.bite if isinstance(self.bite, tuple) else (self.bite, self.bite)

    @property
    def mean(self) -> float:
        """Mean of both distances [m]."""
        return sum(self.sides) / 2.0

    @property
    def step(self) -> float:
        """Distance of the bites along the wound, or the radius of the circle [m]."""
        return self.pitch or self.mean

    def locks(self, solve: Solve) -> float:
        """Return the time at which the stitch is locked [s], by default at the end of a step."""
        return self.until or min(ceil(UNTIL * solve.steps) * solve.step, solve.duration)

    @cached_property
    def frame(self) -> Array:
        """Unit vectors along the wound, across it, and out of the tissue, shape `(3, 3)`.

        The second vector points from left to right.
        """
        out, along = unit(self.normal), np.array(self.along, dtype=float)
        along = unit(along - (along @ out) * out)
        return np.array([along, np.cross(along, out), out])

    def place(self, where: tuple[float, float], height: float = 0.0) -> Array:
        """Return the point at a place along and across the wound, shape `(3,)` [m].

        It lies at a `height` above the surface [m].
        """
        return np.array(self.at) + np.array([*where, height]) @ self.frame

    @cached_property
    def bites(self) -> list[Bite]:
        """The bites in the order of the thread."""
        return bites_of(self)

    @property
    def ends(self) -> list[str]:
        """Full names of the first and the last hole."""
        return [f"{self.name}.{name}" for name in (self.bites[0].names[0], self.bites[-1].names[1])]

    @property
    def points(self) -> list[Array]:
        """The points of the stitch's part of the path [m], from tail to tail."""
        lift, first, last = LIFT * self.mean, self.bites[0].first, self.bites[-1].last
        inside: list[Array] = []
        for bite in self.bites:
            down, up = ([self.place(end, lift)] if self.depth else [] for end in (bite.first, bite.last))
            inside += [*down, self.place(bite.first), *self.deep(bite), self.place(bite.last), *up]
        return [*self.tail(first, last), *inside, *self.tail(last, first)[::-1]]

    def deep(self, bite: Bite) -> list[Array]:
        """Return the points of a bite below the surface [m].

        They are the corners of tangents to half an ellipse, which is vertical at both holes.
        """
        (x, y), (u, v), half = bite.first, bite.last, 0.5 * pi / BENDS
        turns = [(2 * k + 1) * half for k in range(BENDS)] if bite.depth else []
        ways = [0.5 - 0.5 * cos(turn) / cos(half) for turn in turns]
        depths = [bite.depth * sin(turn) / cos(half) for turn in turns]
        return [self.place((x + w * (u - x), y + w * (v - y)), -d) for w, d in zip(ways, depths, strict=True)]

    def tail(self, own: tuple[float, float], other: tuple[float, float]) -> list[Array]:
        """Return the points of the tail at a hole [m].

        The two tails of a tied stitch cross halfway between their holes and rise from there. Those of
        another stitch are vertical, or straight on without depth.
        """
        height = KNOT * self.mean
        (x, y), (u, v) = own, other
        size = float(np.hypot(x - u, y - v))
        ahead = (u - x) / size, (v - y) / size
        if not self.depth:
            return [self.place((x - TAIL * self.mean * ahead[0], y - TAIL * self.mean * ahead[1]))]
        if not self.is_tied:
            return [self.place(own, 2.0 * height)]
        knot = 0.5 * (x + u), 0.5 * (y + v)
        end = knot[0] + height * (ahead[0] - ahead[1]), knot[1] + height * (ahead[1] + ahead[0])
        return [self.place(end, height + UPRIGHT), self.place(knot, height)]

    def piercings(self, at_surface: bool, in_organ: bool, solve: Solve) -> Iterator[dict[str, Any]]:
        """Yield the tables of the stitch's piercings.

        `at_surface`: their places are found on the surface. `in_organ`: their direction is normal
        to the surface, else along the thread. Without depth they are at their places, and free.
        """
        out = self.frame[2]
        for bite in self.bites:
            for name, where, down in zip(bite.names, (bite.first, bite.last), (-1.0, 1.0), strict=True):
                full, at = f"{self.name}.{name}", rounded(self.place(where))
                found = at_surface and self.depth
                place = {"at": "surface", "near": at, "along": rounded(out)} if found else {"at": at}
                way = {"direction": "normal" if in_organ else rounded(down * out)} if self.depth else {}
                table = {"name": full, **place, **way, "footprint": self.footprint}
                hand = {} if self.is_tied else self.hand(full, solve)
                yield table | hand | ({} if hand.get("kind") == "anchored" else self.friction_key())

    def friction_key(self, *without: str) -> dict[str, Any]:
        """Return the key of the friction without some of its keys; empty without friction."""
        if self.friction is None:
            return {}
        return {"friction": self.friction.model_dump(exclude_unset=True, exclude=set(without))}

    def hand(self, hole: str, solve: Solve) -> dict[str, Any]:
        """Return the keys of the hand that holds a stitch without a tie at a hole.

        Hands that draw a length hold both ends. Otherwise the first hole is anchored, and at the last
        hole a hand draws the thread with its force and then holds it.
        """
        if hole not in self.ends:
            return {}
        if self.draw is not None:
            sense = -1.0 if hole == self.ends[0] else 1.0
            return {"kind": "anchored", "draw": [[time, sense * length] for time, length in self.draw]}
        if hole == self.ends[0]:
            return {"kind": "anchored"}
        locks = self.locks(solve)
        held = {"draw": [[locks, 0.0], [solve.duration, 0.0]]} if locks < solve.duration else {}
        return {"pull": [[self.from_, 0.0], [locks, self.force]]} | held

    def tracts(self) -> list[dict[str, Any]]:
        """Return the tables of the stitch's tracts."""
        if self.tract is False or not self.depth:
            return []
        return [
            {"between": [f"{self.name}.{name}" for name in bite.names], "radius": self.tract or self.bearing(bite)}
            | self.friction_key("grip")
            for bite in self.bites
        ]

    def bearing(self, bite: Bite) -> float:
        """Return the default radius of the tissue along a bite on which the thread bears [m].

        A quarter of an ellipse between surface and lip is deeper in the tissue than 0.7 of its
        smaller half axis; the balls of half of that axis fit.
        """
        width = float(np.hypot(*np.subtract(bite.last, bite.first)))
        return min(self.footprint, 0.5 * bite.depth, 0.25 * width)

    def ties(self, solve: Solve) -> list[dict[str, Any]]:
        """Return the table of the stitch's tie in a list, empty without a tie."""
        if not self.is_tied:
            return []
        hold = {} if self.hold is None else {"hold": self.hold}
        times = {"from": self.from_, "until": self.locks(solve)}
        held = {"held": True} if self.from_ else {}
        return [{"name": self.name, "between": self.ends, "force": self.force} | times | hold | held]


def bites_of(stitch: Stitch) -> list[Bite]:
    """Return the bites of a stitch in the order of the thread."""
    (left, right), depth, step, half = stitch.sides, stitch.depth, stitch.step, 0.5 * stitch.step

    def across(label: str, along: float, back: bool = False, share: float = 1.0) -> Bite:
        holes = (f"{label}left", (along, -share * left)), (f"{label}right", (along, share * right))
        (one, first), (other, last) = holes[::-1] if back else holes
        return Bite((one, other), first, last, share * depth)

    match stitch.kind:
        case "single":
            return [across("", 0.0)]
        case "running":
            return [across(f"{k + 1}.", k * step) for k in range(stitch.count)]
        case "vertical-mattress":
            return [across("far.", 0.0), across("near.", 0.0, back=True, share=NEAR)]
        case "horizontal-mattress":
            return [across("1.", -half), across("2.", half, back=True)]
        case "figure-of-eight":
            return [across("1.", -half), across("2.", half)]
        case "purse-string":
            reach = stitch.mean / step
            turns = [2.0 * pi * (k + 0.5) / stitch.count for k in range(stitch.count)]
            ends = [[(step * sin(turn + side), step * cos(turn + side)) for side in (-reach, reach)] for turn in turns]
            numbered = enumerate(ends, start=1)
            return [Bite((f"{k}.left", f"{k}.right"), first, last, depth) for k, (first, last) in numbered]


def long_form(data: Mapping[str, Any]) -> dict[str, Any]:
    """Return the tables of a scenario in the long form of its stitches.

    Path, piercings, tracts, ties and cuts replace the stitches. One thread runs through all
    stitches and is cut between two stitches. Raises `ValidationError` if a stitch or `[solve]` is
    refused, and `ValueError` if the scenario also has tables that its stitches write.
    """
    stitches = [Stitch.model_validate(table) for table in data.get("stitch", ())]
    if not stitches:
        return dict(data)
    if fault := repetition("stitch", [stitch.name for stitch in stitches]):
        raise ValueError(fault)
    solve, thread, organ = Solve.model_validate(data.get("solve", {})), data.get("thread", {}), data.get("tissue")
    owned = [f"thread.{key}" for key in ("path", "cuts", "length") if key in thread]
    owned += [key for key in ("piercing", "tract") if data.get(key)]
    if owned:
        raise ValueError(f"{owned[0]} is refused: {because('stitch-writes')}")
    mesh = organ.get("mesh") if isinstance(organ, Mapping) else None
    mesh = mesh if isinstance(mesh, Mapping) else {}
    default = (-1.0, 0.0, 0.0) if mesh.get("kind") == "wound" and mesh.get("along") == "x" else (0.0, 1.0, 0.0)
    for stitch in stitches:
        if stitch.draw is None and stitch.from_ >= (until := stitch.locks(solve)):
            key = dotted_key(["stitch", stitch.name, "from"])
            raise ValueError(refusal(key, stitch.from_, because("stitch-late", until=until)))
    stitches = [stitch.model_copy(update={"along": stitch.along or default}) for stitch in stitches]
    parts = [stitch.points for stitch in stitches]
    path = [rounded(point) for part in parts for point in part]
    whole = rounded_path(path)
    cuts = [whole.nearest(0.5 * (before[-1] + after[0]))[0] for before, after in pairwise(parts)]
    in_organ, at_surface = organ is not None, organ is not None and mesh.get("kind") not in FLAT
    return {key: value for key, value in data.items() if key != "stitch"} | {
        "thread": {**thread, "path": path, **({"cuts": cuts} if cuts else {})},
        "piercing": [hole for each in stitches for hole in each.piercings(at_surface, in_organ, solve)],
        "tract": [tract for each in stitches for tract in each.tracts()] if in_organ else [],
        "tie": [*data.get("tie", ()), *(tie for each in stitches for tie in each.ties(solve))],
    }


def unit(vector: Sequence[float] | Array) -> Array:
    """Return the vector scaled to length one."""
    return np.asarray(vector, dtype=float) / np.linalg.norm(vector)


def rounded(point: Array) -> list[float]:
    """Return the coordinates of a point rounded to a picometre.

    This removes the round-off of the frame.
    """
    return [round(value, 12) + 0.0 for value in point.tolist()]


# --- hints in refusals of tables that a stitch wrote: the keys of the stitch to change ---------------------
# A scenario has the long form of its stitches, whose keys the user of a stitch has not written.


def stitch_names(data: Mapping[str, Any]) -> tuple[str, ...]:
    """Return the names of the stitches in tables that are not yet validated."""
    tables = data.get("stitch")
    names = [table.get("name") for table in tables if isinstance(table, Mapping)] if isinstance(tables, list) else []
    return tuple(name for name in names if isinstance(name, str))


def with_origin(problem: str, stitches: Sequence[str]) -> str:
    """Return a refusal, with a hint if one of the `stitches`, given by name, wrote the refused key.

    All piercings and tracts of a scenario with stitches are theirs, but ties can be the user's own.
    """
    if stitches and re.match(r"thread\.(path|cuts)\b", problem) and because("stitch-writes") not in problem:
        return f"{problem}; {because('stitch-path')}"
    names = "|".join(re.escape(as_toml(name)[1:-1]) for name in sorted(stitches, key=len, reverse=True))
    found = re.match(rf"""(tie)\.(?:"({names})"|({names}))\.|(piercing|tract)\b.*?["']({names})\.""", problem)
    if not stitches or found is None:
        return problem
    table, name = filter(None, found.groups())
    key = problem.partition(" = ")[0].rpartition(".")[2]
    return f"{problem}; {because('stitch-part', name=name, keys=CAUSES.get(key, CAUSES[table]))}"
