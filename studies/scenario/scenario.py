"""The scenario: one TOML file, validated completely before the computation.

The models of this package define the file; `keys.toml` has the meaning of each key with its unit in brackets. All
units are SI units, except in a mesh file. ``schema`` gives the JSON schema.
"""

from collections.abc import Mapping, Sequence
from itertools import combinations, pairwise
from math import ceil, dist, inf
from typing import Annotated, Any

from pydantic import Field, ValidationError, model_validator

from studies.scenario.contact import Contact
from studies.scenario.course import STEPS, Timed
from studies.scenario.meanings import because
from studies.scenario.names import name_faults
from studies.scenario.organ import LIPS, GivenMesh, Tissue, WoundMesh, boundaries_of, unknown_clamp
from studies.scenario.piercing import Piercing, grips, place_refusal
from studies.scenario.refusal import as_toml, dotted_key, refusal, sentences
from studies.scenario.solve import WHOLE, Output, Solve
from studies.scenario.stitch import Stitch, long_form
from studies.scenario.table import ScenarioError, ScenarioTable, plain_values, repetition
from studies.scenario.thread import ClampedEnd, Cut, End, PulledEnd, Thread
from studies.scenario.tie import Tie, tie_fault
from studies.scenario.tract import Tract, check_tracts

RAMP = 0.05  # s: the period of 20 Hz, a slow vibration of the organs here
ONE_SYSTEM = {"solve.scheme": "newton", "solve.coupling": "monolithic", "solve.friction": "implicit"}
RELAXING = ONE_SYSTEM | {"thread.energy": "continuous"}  # required by a relaxing thread
TIED = RELAXING | {"solve.epsilon": 0.0, "thread.twist": False}  # required by a tied thread
TRAVELLING = TIED | {"thread.bending": True}  # required by knots that travel with the holes
MOST_FRAMES = 20_000  # of three files each; results.pvd lists all of them and is rewritten with each frame

# --- solution and output ----------------------------------------------------------------------------------


class Scenario(ScenarioTable):
    """A scenario: a suture thread, the organ that it pierces, their loads and the solution method."""

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
        given = {key: table.get(key, {}) for key in ("thread", "solve")}
        if "thread" not in table or not isinstance(given["solve"], dict):
            return table
        knots = "travelling" if travels_as_given(given) else "fixed"
        return table | {"thread": {"knots": knots} | given["thread"]}

    def _check_piercings(self) -> None:
        if problem := repetition("piercing", [piercing.name for piercing in self.piercing]):
            raise ValueError(problem)
        check_order(
            [(piercing, piercing.s) for piercing in self.piercing if piercing.s is not None], self.thread.length
        )
        if self.thread.knots == "fixed":
            check_control_points(self.thread.control_points, len(self.piercing) + 2 * len(self.tie))
        remedies = {"at": ("surface", "give [x, y, z]"), "direction": ("normal", 'use "free" or [x, y, z]')}
        for key, (word, remedy) in remedies.items() if self.tissue is None else ():
            lost = next((hole.name for hole in self.piercing if getattr(hole, key) == word), None)
            shown = dotted_key(["piercing", lost, key]), word
            self._refuse(lost is not None, "piercing.surface", shown, remedy=remedy)

    def _check_frames(self) -> None:
        frames, least = self.solve.steps // self.output.every, ceil(self.solve.steps / MOST_FRAMES)
        self._refuse(frames > MOST_FRAMES, "output.every.frames", frames=frames, most=MOST_FRAMES, least=least)

    def _check_apart(self) -> None:
        if self.tissue is not None:
            check_apart([hole for hole in self.piercing if hole.at != "surface"])

    def _check_tracts(self) -> None:
        check_tracts(self.tract, self.piercing, self.tissue is not None, self.solve.scheme)

    def _check_friction(self) -> None:
        bending, rubbing = self.thread.bending, [k for k, tract in enumerate(self.tract) if tract.friction]
        if rubbing:
            shown = f"tract.{rubbing[0]}.friction", self.tract[rubbing[0]].friction
            self._refuse(not bending, "tract.friction.bending", shown)
        rough = next((piercing.name for piercing in self.piercing if piercing.friction is not None), None)
        if rough is not None:
            key, linear = dotted_key(["piercing", rough, "friction"]), self.solve.scheme == "linear"
            self._refuse(linear and self.solve.friction == "implicit", "solve.friction.linear", key=key)
            self._refuse(not bending, "thread.bending.friction", key=key)

    @property
    def touching(self) -> tuple[tuple[str, str], ...]:
        """Names of the surfaces that press on each other, by pairs."""
        lips = (LIPS,) if self.tissue is not None and self.tissue.contact else ()
        return (*lips, *(pair.between for pair in self.contact))

    @property
    def wounds(self) -> tuple[tuple[str, str], ...]:
        """Names of the surfaces of wounds, by pairs: surfaces in contact, and lips without contact."""
        cut = self.tissue is not None and isinstance(self.tissue.mesh, WoundMesh)
        lips = (LIPS,) if cut and not any(set(pair) == set(LIPS) for pair in self.touching) else ()
        return (*lips, *self.touching)

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
        self._refuse(self.tissue and self.tissue.reduction, "thread.contact.reduction", shown)
        if later := next((hole for hole in self.piercing if hole.from_ > 0.0), None):
            key = dotted_key(["piercing", later.name, "from"])
            self._refuse(True, "thread.contact.later", shown, key=key, begins=later.from_)
        why = "in such a run the thread bears on the organ at its holes alone; set it to "
        self._require(ONE_SYSTEM, why, ", or leave out thread.contact")

    def _check_contact(self) -> None:
        linear = self.solve.scheme == "linear" and self.solve.coupling == "monolithic"
        first = ("contact.0.between", self.touching[0]) if self.contact else ("tissue.contact", True)
        self._refuse(self.touching and linear, "contact.linear", first)
        check_touching(self.touching, len(self.touching) - len(self.contact))
        self._refuse(self.contact and self.tissue is None, "contact.organ", first)
        if self.tissue is not None and (there := boundaries_of(self.tissue.mesh)):
            known = [*there, *(boundary.name for boundary in self.tissue.boundary)]
            for k, pair in enumerate(self.contact):
                if problem := unknown_clamp(pair.between, known, f"contact.{k}.between"):
                    raise ValueError(problem)

    @property
    def has_krylov(self) -> bool:
        """Whether steps of the organ can use its Krylov space.

        False if `solve.organ` is "whole". With "auto" also false if a hole begins later, because the hole then
        strikes the tissue.
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
        if organ.relaxes:
            return "tissue.relaxation is given, but the space cannot relax; leave out one of them"
        return "tissue.reduction is another basis; leave out one of them" if organ.reduction is not None else ""

    def _check_krylov(self) -> None:
        why = self.without_krylov
        self._refuse(self.solve.organ == "krylov" and why, "solve.organ.krylov", why=why)

    def _check_reduction(self) -> None:
        if self.tissue is not None and self.tissue.reduction is not None:
            shown = "tissue.reduction", self.tissue.reduction.model_dump()
            self._refuse(self.solve.kind == "static", "tissue.reduction.static", shown)
            self._refuse(self.contact, "tissue.reduction.contact", shown)

    def _check_material(self) -> None:
        if self.tissue is None or self.tissue.material == "linear":
            return
        why = f"tissue.material is {self.tissue.material}, and the paper's variants need a linear organ; use "
        self._require(ONE_SYSTEM, why, ', or material = "linear"')

    def _require(self, needed: Mapping[str, Any], why: str, otherwise: str) -> None:
        """Refuse the first key that has not the value that is `needed`, which the reason names in the middle."""
        for key, value in needed.items():
            table, name = key.split(".")
            if (found := getattr(getattr(self, table), name)) != value:
                raise ValueError(refusal(key, found, f"{why}{as_toml(value)}{otherwise}"))

    def _check_knots(self) -> None:
        if self.thread.knots == "fixed":
            given = self.thread.tolerance != type(self.thread).model_fields["tolerance"].default
            self._refuse(given, "thread.tolerance.fixed")
            return
        why = "thread.knots is travelling, which needs another value; set it to "
        self._require(TRAVELLING, why, ', or knots = "fixed"')

    def _check_relaxation(self) -> None:
        if self.thread.relaxation:
            self._require(RELAXING, "a thread cannot relax with it; set it to ", ", or leave out thread.relaxation")

    def _check_linear(self) -> None:
        hands = ((hole, key) for hole in self.piercing for key in ("draw", "pull"))
        drawn = next((("piercing", hole.name, key) for hole, key in hands if getattr(hole, key) is not None), None)
        key = "thread.cuts" if self.thread.cuts else dotted_key(drawn or ())
        self._refuse(self.solve.scheme == "linear" and key, "solve.scheme.step", key=key)

    def _check_cutting(self) -> None:
        self._refuse(self.cut and self.solve.scheme != "newton", "solve.scheme.cut")
        places = [cut.s for cut in self.cut]
        twice = next((s for k, s in enumerate(places) if s in (*places[:k], *self.thread.cuts)), None)
        self._refuse(twice is not None, "cut.s.twice", ("cut.s", twice))

    def _check_ties(self) -> None:
        if problem := tie_fault(self.tie, self.piercing):
            raise ValueError(problem)
        if self.tie:
            self._require(TIED, "a thread cannot be tied with it; set it to ", ", or leave out [[tie]]")
        hasty = next((t for t in self.tie if self.solve.step_by(t.from_) == self.solve.step_by(t.until)), None)
        if hasty is not None:
            self._refuse(True, "tie.until.hasty", (dotted_key(["tie", hasty.name, "until"]), hasty.until))

    def _check_hands(self) -> None:
        solve = self.solve
        sliding = [hole for hole in self.piercing if hole.kind == "sliding" and solve.kind == "static"]
        taken = [(hole, rows) for hole in sliding for rows in grips(hole.draw or ())]
        for hole, rows in taken:
            (first, length), number = rows[0], solve.step_by(rows[0][0])
            begins = number * solve.duration / solve.load_steps
            late = begins - first > WHOLE * solve.duration
            lost = any(time < begins and later != length for (time, _), (_, later) in pairwise(rows))
            shown = dotted_key(["piercing", hole.name, "draw"]), hole.draw
            self._refuse(late and lost, "piercing.draw.late", shown, first=first, begins=begins)

    def _check_turning(self) -> None:
        ends = (self.thread.start, self.thread.end)
        held = any(isinstance(end, ClampedEnd) or getattr(end, "turn", None) for end in ends)
        self._refuse(self.thread.twist and self.solve.kind == "static" and not held, "thread.twist.free")

    def _check_courses(self) -> None:
        ends = [(f"thread.{key}", getattr(self.thread, key)) for key in ("start", "end")]
        loads = [] if self.tissue is None else [(f"tissue.load.{k}", load) for k, load in enumerate(self.tissue.load)]
        for key, table in [*ends, *loads]:
            if isinstance(table, Timed) and (wave := table.hasty(self.solve.step)):
                shorter = "more load steps" if self.solve.kind == "static" else "a smaller solve.dt"
                self._refuse(True, "course.short", (f"{key}.{wave[0]}", wave[1]), steps=STEPS, shorter=shorter)

    def _check_held(self) -> None:
        tissue = self.tissue
        if tissue is None or tissue.clamp or tissue.roller or (tissue.inertia and self.solve.kind == "dynamic"):
            return
        why = "solve.kind is static" if self.solve.kind == "static" else "tissue.inertia is false"
        self._refuse(True, "tissue.clamp.unheld", ("tissue.clamp", []), why=why)


# --- checks that the simulation repeats once it knows more ------------------------------------------------


def check_touching(pairs: Sequence[tuple[str, str]], first: int) -> None:
    """Refuse two surfaces in contact that are named twice; the first of [[contact]] is number `first`."""
    for k, pair in enumerate(pairs):
        if any(set(pair) == set(other) for other in pairs[:k]):
            raise ScenarioError(refusal(f"contact.{k - first}.between", pair, because("contact-twice")))


def check_apart(holes: Sequence[Piercing]) -> None:
    """Refuse holes of an organ whose footprints overlap at the same time."""
    for one, other in combinations(holes, 2):
        apart, reach = dist(one.place, other.place), one.footprint + other.footprint
        together = max(one.from_, other.from_) < min(hole.until or inf for hole in (one, other))
        if together and apart < reach:
            key = dotted_key(["piercing", one.name])
            raise ScenarioError(place_refusal(other, because("holes-near", key=key, apart=apart, reach=reach)))


def check_given(scenario: object) -> None:
    """Refuse an argument from Python that is not a scenario, for example a file name."""
    if not isinstance(scenario, Scenario):
        raise ScenarioError(f"{scenario!r} is refused: it is no scenario; load a file or a scene, or parse tables")


def check_order(placed: Sequence[tuple[Piercing, float]], length: float | None = None) -> None:
    """Refuse piercings whose abscissas [m] do not increase along the list or are outside the thread.

    Also refuse piercings at an end of the thread without anchor.
    """
    for hole, s in placed:
        check_within(hole, s, length)
    for (before, low), (after, high) in pairwise(placed):
        if high <= low:
            reason = because("holes-order", key=dotted_key(["piercing", before.name, "s"]), low=low)
            raise ScenarioError(refusal(dotted_key(["piercing", after.name, "s"]), high, reason))


def check_within(hole: Piercing, s: float, length: float | None) -> None:
    """Refuse a piercing whose abscissa [m] is outside the thread, or at an end of the thread without anchor."""
    last = inf if length is None else length
    if (hole.kind == "anchored" and 0.0 <= s <= last) or 0.0 < s < last:
        return
    limit = "the thread's length" if length is None else f"the thread's length of {length:.6g} m"
    within = f"must lie between 0 and {limit}; move the piercing, or extend the path beyond it"
    at_end = (s in (0.0, last) and ', or hold the end of the thread there: kind = "anchored"') or ""
    if hole.s is None and hole.at is not None:
        reason = f"the nearest point of the path is at s = {s:.6g} m, which {within}{at_end}"
        raise ScenarioError(refusal(dotted_key(["piercing", hole.name, "at"]), hole.at, reason))
    raise ScenarioError(refusal(dotted_key(["piercing", hole.name, "s"]), s, f"it {within}{at_end}"))


def check_cuts(cuts: Sequence[float], length: float, key: str = "thread.cuts") -> None:
    """Refuse cuts of this `key` that lie outside the thread of this length [m]."""
    lost = next((s for s in cuts if s >= length), None)
    if lost is not None:
        reason = f"it must lie between 0 and the thread's length of {length:.6g} m; move it"
        raise ScenarioError(refusal(key, lost, reason))


def check_spans(
    cuts: Sequence[float], ends: Sequence[float], breaks: Sequence[float], key: str = "thread.cuts"
) -> None:
    """Refuse cuts of this `key` that leave a piece of a single span.

    `ends` are the ends of the pieces and `breaks` the ends of the spans [m].
    """
    for before, after in pairwise(ends) if cuts else ():
        if sum(before <= s <= after for s in breaks) < 3:
            raise ScenarioError(refusal(key, cuts, because("piece-short", begins=before, ends=after)))


def travels_as_given(tables: Mapping[str, Mapping[str, Any]]) -> bool:
    """Return whether knots can travel in a scenario with these tables `thread` and `solve`, as given by the user."""
    keys = [(*key.partition(".")[::2], value) for key, value in TRAVELLING.items()]
    return all(tables[table].get(key, value) == value for table, key, value in keys)


def check_control_points(control_points: int, piercings: int) -> None:
    """Refuse a spline too coarse for its holes.

    A hole, or a strand of a tie, has up to 5 constraints. Its unknowns are 3 per control point and its own
    abscissa. The thread bends at the hole, so the spline needs a span at the hole and one on each side: 3
    control points for each hole, in addition to the 4 of a single cubic.
    """
    least = 4 + 3 * piercings
    if control_points < least:
        reason = because("points-few", piercings=piercings, least=least)
        raise ScenarioError(refusal("thread.control_points", control_points, reason))


# --- reading and writing ----------------------------------------------------------------------------------


def parse(data: Mapping[str, Any]) -> Scenario:
    """Validate a scenario given as tables, which can contain numpy's numbers. Raises `ScenarioError`."""
    if not isinstance(data, Mapping):
        raise ScenarioError(
            f"{data!r} is refused: it is no scenario; give its tables, a dict, or load a file or a scene"
        )
    data = plain_values(data)
    try:
        return Scenario.model_validate(data)
    except ValidationError as error:
        raise ScenarioError(dict.fromkeys([*sentences(error, Scenario, data), *name_faults(data)])) from None


def schema() -> dict[str, Any]:
    """Return the JSON schema (draft 2020-12) of the scenario file."""
    declared = {"$schema": "https://json-schema.org/draft/2020-12/schema"}
    return declared | Scenario.model_json_schema(by_alias=True)


def ramped(end: End, solve: Solve) -> End:
    """Return an end with the ramp of its dead load, if there is a dead load.

    A sudden dead load accelerates a thread of a few milligrams through its holes to several metres per second.
    At a start at rest the load has already acted.
    """
    if not isinstance(end, PulledEnd) or end.ramp is not None:
        return end
    grows = solve.kind == "dynamic" and solve.start == "path" and end.course is None
    return end.model_copy(update={"ramp": min(RAMP, solve.duration) if grows else 0.0})


def with_given_mesh(scenario: Scenario, sha256: str) -> Scenario:
    """Return the scenario with an organ on a given mesh with this digest. Raises `ScenarioError`."""
    if scenario.tissue is None:
        raise ScenarioError("mesh is refused: the scenario has no organ; add [tissue]")
    table = scenario.tissue.mesh
    if isinstance(table, GivenMesh) and table.sha256 not in (None, sha256):
        reason = f"the given mesh has {sha256}; give the same mesh, or leave sha256 out"
        raise ScenarioError(refusal("tissue.mesh.sha256", table.sha256, reason))
    mesh = GivenMesh(kind="given", sha256=sha256, accuracy=table.accuracy, bound=table.bound)
    return scenario.model_copy(update={"tissue": scenario.tissue.model_copy(update={"mesh": mesh})})


def resolved(scenario: Scenario, length: float | None = None, s: Sequence[float] = ()) -> Scenario:
    """Return the scenario with the defaults that depend on several tables.

    These are the ramps of dead loads [s] and, unless the resting organ moves the thread, rest length and
    abscissas [m]. A piercing that begins later gets its abscissa, if not given, from the thread's position at
    this time.
    """
    ends = {key: ramped(getattr(scenario.thread, key), scenario.solve) for key in ("start", "end")}
    thread = scenario.thread.model_copy(update=ends)
    if length is None:
        return scenario.model_copy(update={"thread": thread})
    thread = thread.model_copy(update={"length": length})
    pairs = zip(scenario.piercing, s, strict=True)
    piercing = tuple(
        hole.model_copy(update={"s": float(value)}) if hole.s is None and hole.from_ == 0.0 else hole
        for hole, value in pairs
    )
    return scenario.model_copy(update={"thread": thread, "piercing": piercing})
