"""The scenario: one TOML file, validated completely before the computation.

The models of this package define the file; `keys.toml` has the meaning of each key with its unit in
brackets. All units are SI units, except in a mesh file. ``schema`` gives the JSON schema.
"""

import reprlib
from collections.abc import Mapping, Sequence
from functools import cached_property
from itertools import combinations, pairwise
from math import ceil, dist, inf
from typing import Annotated, Any

from pydantic import Field, ValidationError, model_validator

from studies.scenario.course import STEPS
from studies.scenario.organ import LIPS, Contact, GivenMesh, Load, Tissue, WoundMesh, name_faults, unknown_clamp
from studies.scenario.piercing import Piercing, Tie, Tract, check_ties, check_tracts, place_refused
from studies.scenario.refusal import as_toml, because, dotted_key, refusal, sentences
from studies.scenario.solve import Output, Solve
from studies.scenario.stitch import Stitch, long_form, stitch_names, with_origin
from studies.scenario.table import ScenarioError, ScenarioTable, plain_values, refuse, refused, repetition
from studies.scenario.thread import ClampedEnd, Cut, End, PulledEnd, Thread

RAMP = 0.05  # s: the period of 20 Hz, a slow vibration of the organs here
ONE_SYSTEM = {"solve.scheme": "newton", "solve.coupling": "monolithic", "solve.friction": "implicit"}
RELAXING = ONE_SYSTEM | {"thread.energy": "continuous"}  # required by a relaxing thread
TIED = RELAXING | {"solve.epsilon": 0.0, "thread.twist": False}  # required by a tied thread
TRAVELLING = TIED | {"thread.bending": True}  # required by knots that travel with the holes
MOST_FRAMES = 20_000  # of three files each; results.pvd lists all of them and is rewritten with each frame

# --- solution and output ----------------------------------------------------------------------------------


class Scenario(ScenarioTable):
    """A scenario: suture thread, pierced organ, their loads and the solution method."""

    WITHIN = ""

    title: Annotated[str, Field(strict=True)] = ""
    tissue: Tissue | None = None
    thread: Thread
    piercing: tuple[Piercing, ...] = ()
    tract: tuple[Tract, ...] = ()
    cut: tuple[Cut, ...] = ()
    tie: tuple[Tie, ...] = ()
    stitch: tuple[Stitch, ...] = ()
    contact: tuple[Contact, ...] = ()
    solve: Solve = Solve()
    output: Output = Output()

    @model_validator(mode="before")
    @classmethod
    def _write_out(cls, table: Any) -> Any:
        if not isinstance(table, dict) or not isinstance(thread := table.get("thread", {}), dict):
            return table
        try:
            table = long_form(table)
        except (ValidationError, TypeError):  # the fields report the fault, and a missing path is no fault
            table = table | {"thread": {"path": ((0, 0, 0), (0, 0, 1))} | thread} if table.get("stitch") else table
        tables = {key: table.get(key, {}) for key in ("thread", "solve")}
        if "thread" not in table or not isinstance(tables["solve"], dict):
            return table
        needed = [(key.split("."), value) for key, value in TRAVELLING.items()]
        travels = all(tables[part].get(key, value) == value for (part, key), value in needed)
        return table | {"thread": {"knots": "travelling" if travels else "fixed"} | table["thread"]}

    def _check_piercings(self) -> None:
        self._report(repetition("piercing", [hole.name for hole in self.piercing]))
        check_order([(hole, hole.s) for hole in self.piercing if hole.s is not None], self.thread.length)
        if self.thread.knots == "fixed":
            check_control_points(self.thread.control_points, len(self.piercing) + 2 * len(self.tie))
        remedies = {"at": ("surface", "give [x, y, z]"), "direction": ("normal", 'use "free" or [x, y, z]')}
        for key, (word, remedy) in remedies.items() if self.tissue is None else ():
            for hole in self.piercing:
                on_surface = getattr(hole, key) == word
                self._refuse(on_surface, "piercing.surface", (hole.key(key), word), remedy=remedy)

    def _check_frames(self) -> None:
        frames, least = self.solve.steps // self.output.every, ceil(self.solve.steps / MOST_FRAMES)
        self._refuse(frames > MOST_FRAMES, "output.every.frames", frames=frames, most=MOST_FRAMES, least=least)

    def _check_apart(self) -> None:
        if self.tissue is not None:
            check_apart([hole for hole in self.piercing if hole.at != "surface"])

    def _check_tracts(self) -> None:
        check_tracts(self.tract, self.piercing, self.tissue is not None, self.solve.scheme)
        for k, tract in enumerate(self.tract):
            given, least = (f"tract.{k}.spacing", tract.spacing), self.thread.thickness
            self._refuse((tract.spacing or least) < least, "tract.spacing.dense", given, least=least)

    def _check_friction(self) -> None:
        for k, tract in enumerate(self.tract):
            shown = f"tract.{k}.friction", tract.friction
            self._refuse(tract.friction and not self.thread.bending, "tract.friction.bending", shown)
        linear = self.solve.scheme == "linear" and self.solve.friction == "implicit"
        for hole in self.piercing:
            key = hole.key("friction")
            self._refuse(hole.friction and linear, "solve.friction.linear", key=key)
            self._refuse(hole.friction and not self.thread.bending, "thread.bending.friction", key=key)

    @cached_property
    def stitches(self) -> tuple[str, ...]:
        """Names of the stitches whose long form the scenario has.

        `parse` sets them. They are no field, so that the long form in a file is an equal scenario.
        """
        return ()

    @property
    def touching(self) -> tuple[tuple[str, str], ...]:
        """Names of the surfaces that press on each other, by pairs."""
        lips = (LIPS,) if self.tissue is not None and self.tissue.contact else ()
        return (*lips, *(pair.between for pair in self.contact))

    @property
    def wounds(self) -> tuple[tuple[str, str], ...]:
        """Names of the surfaces of wounds, by pairs, with or without contact."""
        cut = self.tissue is not None and isinstance(self.tissue.mesh, WoundMesh)
        lips = (LIPS,) if cut and not any(set(pair) == set(LIPS) for pair in self.touching) else ()
        return (*lips, *self.touching)

    @property
    def loads(self) -> dict[str, Load | PulledEnd]:
        """Loads on the ends of the thread and on the organ, by their keys."""
        ends = {f"thread.{key}": getattr(self.thread, key) for key in ("start", "end")}
        organ = {f"tissue.load.{k}": load for k, load in enumerate(self.tissue.load if self.tissue else ())}
        return {key: end for key, end in ends.items() if isinstance(end, PulledEnd)} | organ

    @property
    def growth(self) -> dict[str, float]:
        """Times [s] in which the loads without a course grow from zero, by their keys; 0 s is at once.

        In statics a load that acts whole at all times grows with the load steps.
        """
        end, static = self.solve.duration, self.solve.kind == "static"
        ramps = {key: (load, load.ramp or 0.0) for key, load in self.loads.items()}
        return {key: end if static and load.rows(end, ramp) is None else ramp for key, (load, ramp) in ramps.items()}

    @property
    def floats(self) -> bool:
        """Whether a body of the organ can be held only by contact and stitches."""
        if self.tissue is None or not self.touching:
            return False
        at_rest = self.solve.kind == "static" and self.tissue.material == "linear"
        return at_rest or (self.solve.kind == "dynamic" and self.tissue.inertia)

    def _check_thread_contact(self) -> None:
        if self.thread.surface is None:
            return
        shown = "thread.contact", self.thread.model_dump(mode="json")["contact"]
        self._refuse(self.tissue is None, "thread.contact.organ", shown)
        for hole in self.piercing:
            begins = hole.from_
            self._refuse(begins > 0.0, "thread.contact.later", shown, key=hole.key("from"), begins=begins)
        why = "in such a run the thread bears on the organ at its holes alone; set it to "
        self._require(ONE_SYSTEM, why, ", or leave out thread.contact")

    def _check_contact(self) -> None:
        linear = self.solve.scheme == "linear" and self.solve.coupling == "monolithic"
        first = ("contact.0.between", self.touching[0]) if self.contact else ("tissue.contact", True)
        self._refuse(self.touching and linear, "contact.linear", first)
        lips = len(self.touching) - len(self.contact)
        for k, pair in enumerate(self.touching):
            if any(set(pair) == set(other) for other in self.touching[:k]):
                raise refused(f"contact.{k - lips}.between", pair, "contact-twice")
        self._refuse(self.contact and self.tissue is None, "contact.organ", first)
        if self.tissue is not None and (known := self.tissue.boundaries):
            for k, table in enumerate(self.contact):
                self._report(unknown_clamp(table.between, known, f"contact.{k}.between"))

    @property
    def has_krylov(self) -> bool:
        """Whether steps of the organ can use its Krylov space.

        It is false if `solve.organ` is "whole". With "auto" it is also false if a hole begins
        later, because the hole then strikes the tissue.
        """
        later = any(hole.from_ for hole in self.piercing)
        return self.solve.organ != "whole" and not self.without_krylov and (self.solve.organ == "krylov" or not later)

    @property
    def without_krylov(self) -> str:
        """Why no step of the organ can use its Krylov space, empty if steps can."""
        organ = self.tissue
        if organ is None:
            return "there is no organ; add [tissue]"
        if not (organ.inertia and self.solve.is_one_system):
            return "it needs inertia, and time steps by Newton of thread and organ in one system; leave it out"
        if organ.material != "linear" or self.touching or self.thread.surface is not None:
            return "it needs a linear organ without contact; leave it out"
        return "tissue.relaxation is given, but the space cannot relax; leave out one of them" if organ.relaxes else ""

    def _check_krylov(self) -> None:
        why = self.without_krylov
        self._refuse(self.solve.organ == "krylov" and why, "solve.organ.krylov", why=why)

    def _check_material(self) -> None:
        if self.tissue is None or self.tissue.material == "linear":
            return
        why = f"tissue.material is {self.tissue.material}, and the paper's variants need a linear organ; use "
        self._require(ONE_SYSTEM, why, ', or material = "linear"')

    def _require(self, needed: Mapping[str, Any], why: str, otherwise: str) -> None:
        """Refuse the first key whose value is not the `needed` value.

        The sentence has the needed value between `why` and `otherwise`.
        """
        for key, value in needed.items():
            table, name = key.split(".")
            if (found := getattr(getattr(self, table), name)) != value:
                raise ValueError(refusal(key, found, f"{why}{as_toml(value)}{otherwise}"))

    def _check_knots(self) -> None:
        default = type(self.thread).model_fields["tolerance"].default
        if self.thread.knots == "travelling":
            why = "thread.knots is travelling, which needs another value; set it to "
            self._require(TRAVELLING, why, ', or knots = "fixed"')
        elif self.thread.tolerance != default:
            self._refuse(True, "thread.tolerance.fixed")

    def _check_relaxation(self) -> None:
        if self.thread.relaxation:
            self._require(RELAXING, "a thread cannot relax with it; set it to ", ", or leave out thread.relaxation")

    def _check_linear(self) -> None:
        linear = self.solve.scheme == "linear"
        self._refuse(linear and self.thread.cuts, "solve.scheme.step", key="thread.cuts")
        for hole in self.piercing:
            for key, rows in hole.hands.items():
                self._refuse(linear and rows, "solve.scheme.step", key=hole.key(key))

    def _check_cutting(self) -> None:
        self._refuse(self.cut and self.solve.scheme != "newton", "solve.scheme.cut")
        places = [cut.s for cut in self.cut]
        for k, s in enumerate(places):
            self._refuse(s in (*places[:k], *self.thread.cuts), "cut.s.twice", ("cut.s", s))

    def _check_ties(self) -> None:
        check_ties(self.tie, self.piercing)
        if self.tie:
            self._require(TIED, "a thread cannot be tied with it; set it to ", ", or leave out [[tie]]")
        for tie in self.tie:
            at_once = self.solve.kind == "dynamic" and self.solve.step_by(tie.from_) == self.solve.step_by(tie.until)
            self._refuse(at_once, "tie.until.hasty", (dotted_key(["tie", tie.name, "until"]), tie.until))

    def _check_turning(self) -> None:
        held = any(isinstance(end, ClampedEnd) or getattr(end, "turn", None) for end in self.thread.ends)
        self._refuse(self.thread.twist and self.solve.kind == "static" and not held, "thread.twist.free")

    def _check_courses(self) -> None:
        shorter = "more load steps" if self.solve.kind == "static" else "a smaller solve.dt"
        for key, table in self.loads.items():
            if wave := table.short_wave(STEPS * self.solve.step):
                self._refuse(True, "course.short", (f"{key}.{wave[0]}", wave[1]), steps=STEPS, shorter=shorter)
            if missed := table.missed_turn(self.solve.step, self.solve.duration):
                time, share = missed
                given = (f"{key}.course", table.course) if table.course else (f"{key}.until", table.until)
                self._refuse(True, "course.missed", given, time=time, share=share, shorter=shorter)

    def _check_held(self) -> None:
        tissue, static = self.tissue, self.solve.kind == "static"
        unheld = tissue and not (tissue.clamp or tissue.roller or (tissue.inertia and not static))
        why = "solve.kind is static" if static else "tissue.inertia is false"
        self._refuse(unheld, "tissue.clamp.unheld", ("tissue.clamp", []), why=why)


# --- checks that the simulation repeats once it knows more ------------------------------------------------


def check_apart(holes: Sequence[Piercing]) -> None:
    """Refuse holes of an organ whose footprints overlap at the same time."""
    for one, other in combinations(holes, 2):
        distance, reach = dist(one.place, other.place), one.footprint + other.footprint
        together = max(one.from_, other.from_) < min(hole.until or inf for hole in (one, other))
        if together and distance < reach:
            raise place_refused(other, "holes-near", key=one.key(), distance=distance, reach=reach)


def check_given(scenario: object) -> None:
    """Refuse an argument from Python that is not a scenario, for example a file name."""
    if not isinstance(scenario, Scenario):
        shown = reprlib.repr(scenario)
        raise ScenarioError(f"{shown} is refused: it is no scenario; load a file or a scene, or parse tables")


def check_order(placed: Sequence[tuple[Piercing, float]], length: float | None = None) -> None:
    """Refuse piercings whose abscissas [m] do not increase along the list.

    Also refuse a piercing outside the thread, and a piercing at an end of the thread without
    anchor.
    """
    for hole, s in placed:
        check_within(hole, s, length)
    for (before, low), (after, high) in pairwise(placed):
        refuse(high <= low, after.key("s"), high, "holes-order", key=before.key("s"), low=low)


def check_within(hole: Piercing, s: float, length: float | None) -> None:
    """Refuse a piercing outside the thread, or at an end of the thread without anchor.

    `s` is its abscissa [m], and `length` the thread's length [m], None if unknown.
    """
    last = inf if length is None else length
    if (hole.kind == "anchored" and 0.0 <= s <= last) or 0.0 < s < last:
        return
    limit = "the thread's length" if length is None else f"the thread's length of {length:.6g} m"
    at_end = ', or hold the end of the thread there: kind = "anchored"' if s in (0.0, last) else ""
    if hole.s is None:
        raise refused(hole.key("at"), hole.at, "at-outside", s=s, limit=limit, at_end=at_end)
    raise refused(hole.key("s"), s, "s-outside", limit=limit, at_end=at_end)


def check_cuts(cuts: Sequence[float], length: float, key: str = "thread.cuts") -> None:
    """Refuse cuts of this `key` that lie outside the thread of this length [m]."""
    for s in cuts:
        refuse(s >= length, key, s, "cut-outside", length=length)


def check_spans(
    cuts: Sequence[float], ends: Sequence[float], breaks: Sequence[float], key: str = "thread.cuts"
) -> None:
    """Refuse cuts of this `key` that leave a piece of a single span.

    `ends` are the ends of the pieces and `breaks` the ends of the spans [m].
    """
    for before, after in pairwise(ends) if cuts else ():
        refuse(sum(before <= s <= after for s in breaks) < 3, key, cuts, "piece-short", begins=before, ends=after)


def check_control_points(control_points: int, piercings: int) -> None:
    """Refuse a spline too coarse for its holes.

    A hole, or a strand of a tie, has up to 5 constraints. Its unknowns are 3 per control point and
    its own abscissa. The thread bends at the hole, so the spline needs a span at the hole and one
    on each side: 3 control points for each hole, in addition to the 4 of a single cubic.
    """
    words = {"piercings": piercings, "least": 4 + 3 * piercings}
    refuse(control_points < words["least"], "thread.control_points", control_points, "points-few", **words)


# --- reading and writing ----------------------------------------------------------------------------------


def parse(data: Mapping[str, Any]) -> Scenario:
    """Validate a scenario given as tables, which can contain numpy's numbers.

    Raises `ScenarioError`.
    """
    if not isinstance(data, Mapping):
        raise ScenarioError(f"{data!r} is refused: {because('tables')}")
    data = plain_values(data)
    stitches = stitch_names(data)
    try:
        scenario = Scenario.model_validate(data)
    except ValidationError as error:
        problems = [*sentences(error, Scenario, written_out(data)), *name_faults(data)]
        raise ScenarioError(dict.fromkeys(with_origin(problem, stitches) for problem in problems)) from None
    vars(scenario)["stitches"] = stitches
    return scenario


def written_out(data: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return tables in the long form of their stitches, or as they are if a stitch is refused."""
    try:
        return long_form(data)
    except (ValueError, TypeError):
        return data


def schema() -> dict[str, Any]:
    """Return the JSON schema (draft 2020-12) of the scenario file."""
    declared = {"$schema": "https://json-schema.org/draft/2020-12/schema"}
    return declared | Scenario.model_json_schema(by_alias=True)


def ramped(end: End, solve: Solve) -> End:
    """Return an end with the ramp of its dead load, if there is a dead load.

    A sudden dead load accelerates a thread of a few milligrams through its holes to several metres
    per second. At a start at rest the load has already acted.
    """
    if not isinstance(end, PulledEnd) or end.ramp is not None:
        return end
    grows = solve.kind == "dynamic" and solve.start == "path" and end.course is None
    return end.model_copy(update={"ramp": min(RAMP, solve.duration) if grows else 0.0})


def with_given_mesh(scenario: Scenario, sha256: str) -> Scenario:
    """Return the scenario with an organ on a given mesh with this digest.

    Raises `ScenarioError`.
    """
    if scenario.tissue is None:
        raise ScenarioError("mesh is refused: the scenario has no organ; add [tissue]")
    table = scenario.tissue.mesh
    if isinstance(table, GivenMesh) and table.sha256 not in (None, sha256):
        raise refused("tissue.mesh.sha256", table.sha256, "mesh-other", sha256=sha256)
    mesh = GivenMesh(kind="given", sha256=sha256, accuracy=table.accuracy, bound=table.bound)
    return scenario.model_copy(update={"tissue": scenario.tissue.model_copy(update={"mesh": mesh})})


def resolved(scenario: Scenario, length: float | None = None, s: Sequence[float] = ()) -> Scenario:
    """Return the scenario with the defaults that depend on several tables.

    These are the ramps of dead loads [s] and, unless holes move the thread from its path, rest
    length and abscissas [m]. A piercing that begins later gets its abscissa, if not given, from the
    thread's position at this time.
    """
    solve, thread = scenario.solve, scenario.thread
    keys: dict[str, object] = {"start": ramped(thread.start, solve), "end": ramped(thread.end, solve)}
    holes = scenario.piercing
    if length is not None:
        keys["length"] = length
        holes = tuple(
            hole.model_copy(update={"s": float(at)}) if hole.s is None and hole.from_ == 0.0 else hole
            for hole, at in zip(holes, s, strict=True)
        )
    return scenario.model_copy(update={"thread": thread.model_copy(update=keys), "piercing": holes})
