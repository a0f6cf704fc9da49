"""A running suture: how far along the stitches a pull is felt, compared with a published experiment.

Horeman et al. (PLoS ONE 2013;8:e84466) sewed pig fascia with seven continuous stitches and measured the thread of the
second: 3 N (SD 1.2) while it is pulled, 1 N (SD 0.3) from the fourth stitch on, and no influence of the fifth, sixth
and seventh. Here a thread runs through two rough holes a stitch, its first hole a knot, and its loose end is pulled.

*One pull.* Seven stitches under no load but the slack's; the end is pulled, and let back. One number, the coefficient
of friction μ, is set so that two stitches back the tension is the published third of the pull.

*Placing.* With that μ the stitches are placed one after the other: the end is held, led through two new holes, pulled,
let back to the hold. What friction has locked in earlier stitches stays. The hold is not published: it is varied.

A hole is a ring that the thread bends round: T₁ − T₂ = μN with T₁(1 − cos α) = T₂(1 − cos β), see
`studies.theory.bent_ratio`; round a cylinder it would be exp(μθ). Segments obey `tensions_by_law`, whatever their
elasticity, as long as nothing but the pull moves thread through a hole. Left out are lips that press on one another,
holes that tear, tissue that creeps, and the sensor that the published thread ran through.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from types import SimpleNamespace
from typing import Any, Literal

import numpy as np
from matplotlib.figure import Figure

from coupling.reports.audit import initial_energies
from coupling.reports.observation import observe
from coupling.run import begin
from coupling.run.impact import begin_piercing
from coupling.step.stepping import try_step
from coupling.system import State, System
from studies.arrays import Array
from studies.figure import COLOURS, Item, band, curve, draw, level, panel, series, unnamed
from studies.scenario import Scenario
from studies.simulation.assembly import assemble
from studies.study import StudyError, Table, described, each, grouped, measure, measured, require, scene, unit_field
from studies.theory import bent_ratio, second_stitch_by_law, tensions_by_law
from studies.verdicts import beyond_bearing, beyond_linear, not_settled, unrest
from thread.ends import Free

Organ = Literal["closed fascia", "gaping fascia", "fixed points"]

# Small bites (Deerenberg et al., Lancet 2015;386:1254): 5 mm from the edge of the wound, every 5 mm, USP 2-0.
BITE, PITCH = 5e-3, 5e-3  # [m]
# Förstemann et al., J Biomech 2011;44:600: 3.4 N/mm at 6 % across the linea alba, 57 N/mm, here on 1.5 mm.
THICKNESS, YOUNGS_MODULUS = 1.5e-3, 4e7  # [m], [Pa]
WIDTH, BEYOND = 0.04, 0.015  # of the sheet, and how far it and the wound go on beyond the stitches [m]
FOOTPRINT, CELL = 0.7e-3, 1.5e-3  # [m]
SUTURE, OTHER = "2-0 polyglactin 910", "2-0 polydioxanone"  # that of the experiment is not known to us

PUBLISHED_PULL, PULL_SD = 3.0, 1.2  # [N]
PUBLISHED_LEFT, LEFT_SD = 1.0, 0.3  # two stitches back [N]
PUBLISHED_REACH = 3  # stitches back at most
CALIBRATED = "calibrated"
BACK = 2  # stitches from the pull to where μ is calibrated
FELT = LEFT_SD  # change of tension that counts as felt [N]
COEFFICIENTS = 0.05, 0.3  # of sutures on wet tissue [-]: assumed, after Zhang et al. (Tribol Lett 2017), no value read

SLACK = 0.1  # tension in which a thread is laid without friction [N]
FREE = 6e-3  # of the thread before its knot [m]
TAIL = 0.03  # beyond the last hole [m]
LED = 1e9  # of a stitch that begins where the hand has led the thread, not at a time of its own [s]
LOOP = 1e-3  # by which it is laid beyond each hole, up and down [m]
LAYING, PULLING, LETTING, SWING, REST = 0.04, 0.15, 0.08, 0.06, 0.02  # [s]
STAGES = (1.5, 0.8, 0.4, 0.2)  # of the hand on its way back [N]
RISE = (0.5, 1.0, 2.0)  # and on its way out [N]
TOLERANCE = 0.03  # of the knots that travel with the holes
SLIPPED = 1.2  # times its tension before the pull: a stitch this far above it was reached by slip
OVER = np.array([-2 * BITE, PITCH, 0.0]) / np.hypot(2 * BITE, PITCH)  # over the wound to the next stitch
UNDER = np.array([1.0, 0.0, 0.0])  # under it
UP = np.array([0.0, 0.0, 1.0])
TENSIONS = (0.1, 0.2, 0.5, 1.0, 2.0, 5.0)  # ticks [N]


@dataclass(frozen=True, kw_only=True)
class Row:
    """One stitch at one moment of one run. Its tension is that of the thread where it leaves the stitch."""

    kind: str = measured("", lambda at: at.kind)  # "one pull" or "placing"
    organ: str = measured("", lambda at: at.case.organ)
    check: str = measured("", lambda at: at.case.check)  # what is other than in the reference, or nothing
    mu: float = measured("-", lambda at: at.case.mu)
    hold: float = measured("N", lambda at: at.hold)  # between two pulls
    stitches: int = measured("-", lambda at: at.line.holes // 2)  # placed so far
    moment: str = measured("", lambda at: at.name)  # "before", "rising", "pulled" or "let back"
    hand: float = measured("N", lambda at: at.line.hand)
    stitch: int = unit_field("-")  # 1 begins with the knot
    tension: float = unit_field("N")
    law: float = unit_field("N")  # by the turns measured in the run and the law of a ring
    turn: float = measured("degree", lambda at: np.degrees(at.line.turns.mean()))  # mean of the holes
    moved: float = measured("m", lambda at: at.moved.max())  # farthest a hole has moved
    press: float = measured("N", lambda at: at.line.forces[:, 2].max())  # largest force on a hole
    diameter: float = measured("m", lambda at: at.line.system.thread.section.diameter)  # of the thread
    youngs_modulus: float = measured("Pa", lambda at: at.case.stiffness)  # of the sheet, infinite for fixed points
    settled: float = measured("-", lambda at: unrest(at.energies.kinetic, at.energies.elastic))  # kinetic over elastic
    steps: int = measured("-", lambda at: at.line.steps)

    @property
    def stitches_back(self) -> int:
        """Stitches back from the pull."""
        return self.stitches - self.stitch


@dataclass(frozen=True)
class Case:
    """One run to be made. `tolerance` and `step` [s] are those of thread and time."""

    mu: float
    organ: Organ = "closed fascia"
    check: str = ""
    stitches: int = 7
    pull: float = PUBLISHED_PULL
    suture: str = SUTURE
    youngs_modulus: float = YOUNGS_MODULUS
    step: float = 2e-3
    tolerance: float = TOLERANCE
    cell: float = CELL

    @property
    def stiffness(self) -> float:
        """E of the sheet, infinite without one [Pa]."""
        return np.inf if self.organ == "fixed points" else self.youngs_modulus


@dataclass(frozen=True)
class Hand(Free):
    """Pulls with a dead load that goes from `begin` to `end` (3,) [N] between two `times` [s]."""

    times: tuple[float, float]
    begin: Array
    end: Array

    def force(self, time: float | Array, share: float = 1.0) -> Array:
        """Return the load at `time` [N]."""
        way = np.interp(time, self.times, (0.0, 1.0))
        return np.asarray(np.multiply.outer(1.0 - way, self.begin) + np.multiply.outer(way, self.end))


@dataclass(frozen=True)
class Line:
    """A suture in its holes. `law` (segments,) [N]: the tensions behind each hole by the law of friction."""

    system: System
    state: State
    step: float
    law: Array
    steps: int = 0

    @property
    def holes(self) -> int:
        """Holes that the thread is in."""
        return int(self.state.present.sum())

    @cached_property
    def forces(self) -> Array:
        """Tensions before and after each hole that the thread is in and its force, shape `(holes, 3)` [N]."""
        seen = observe(self.system, self.state, self.state)[: self.holes]
        each = [(abs(o.tension_before), abs(o.tension_after), np.linalg.norm(o.force)) for o in seen]
        return np.array(each, dtype=np.float64)

    @property
    def turns(self) -> Array:
        """Angle by which the thread turns in each hole but the knot (holes − 1,) [rad], from the balance of forces."""
        before, after, force = self.forces[1:].T
        cosine = (before**2 + after**2 - force**2) / (2.0 * before * after)
        return np.arccos(np.clip(cosine, -1.0, 1.0))

    @property
    def hand(self) -> float:
        """Pull on the loose end [N]."""
        return float(np.linalg.norm(self.system.ends[1].force(self.state.time)))


def main(
    mus: Sequence[float] = (0.0, 0.05, 0.1, 0.15, 0.2, 0.3, 0.4),
    stitches: int = 7,
    holds: Sequence[float] = (0.2, 0.4, 0.8),
    unchecked: bool = False,
    organ: Organ = "closed fascia",
    youngs_modulus: float = YOUNGS_MODULUS,
    thread: str = SUTURE,
) -> Iterator[Row]:
    """Run one pull for every coefficient and for the calibrated one, its checks, and the placing with every hold [N].

    Raises `StudyError` for what cannot be calibrated.
    """
    allowed = stitches > BACK and min(mus) >= 0.0 and max(mus) < 1.0 and min(holds) > 0.0
    reason = f"give more than {BACK} stitches, coefficients from 0 to below 1 and holds above 0"
    require(allowed, f"stitches = {stitches}, mus = {mus}, holds = {holds}", reason)
    base = Case(0.0, organ, stitches=stitches, suture=thread, youngs_modulus=youngs_modulus)
    rows: list[Row] = []
    for row in each([partial(one_pull, replace(base, mu=mu)) for mu in sorted(mus)]):
        rows.append(row)
        yield row
    case, middle = replace(base, mu=calibrate(rows)[0]), sorted(holds)[len(holds) // 2]
    others = [] if unchecked else variations(case)
    pulls = [partial(one_pull, other) for other in (replace(case, check=CALIBRATED), *others)]
    placed = [(case, hold) for hold in holds]
    placed += [] if unchecked else [(replace(case, organ=organ), middle) for organ in ("gaping fascia", "fixed points")]
    jobs = [*pulls, *(partial(placing, *one) for one in placed)]
    yield from each(jobs)


def variations(case: Case) -> list[Case]:
    """List the same case with one thing changed at a time."""
    return [
        replace(case, organ="fixed points", check="fixed points"),
        replace(case, step=case.step / 2, check="half the time step"),
        replace(case, tolerance=TOLERANCE / 3, check="finer thread"),
        replace(case, cell=CELL / 2, check="finer mesh"),
        replace(case, suture=OTHER, check=OTHER),
        replace(case, stitches=BACK + 2, check=f"{BACK + 2} stitches"),
    ]


# --- the suture -------------------------------------------------------------------------------------------


def scenario(case: Case, laid: int) -> Scenario:
    """Return the scene with a thread laid up and down through the holes of the first stitches, its tail over the wound;
    the wound is closed for good, or open and gaping, or there is no sheet."""
    along, fixed = PITCH * (np.arange(case.stitches) - (case.stitches - 1) / 2), case.organ == "fixed points"
    holes = [np.array([side * BITE, y, -THICKNESS / 2]) for y in along for side in (-1.0, 1.0)]
    path = [holes[0] - FREE * UNDER + LOOP * UP]
    for number, hole in enumerate(holes[: 2 * laid]):
        path += [hole + way * LOOP * UP for way in ((1, -1) if number % 2 == 0 else (-1, 1))]
    tail = TAIL + (case.stitches - laid) * (2 * BITE + np.hypot(2 * BITE, PITCH))
    rough = {"friction": {"static": case.mu, "kinetic": case.mu}} if case.mu else {}
    length = (case.stitches - 1) * PITCH + 2 * BEYOND
    organ: dict[str, Any] = {"tissue": None}
    if not fixed:
        size = [WIDTH, length + 2 * BEYOND, THICKNESS]
        mesh: dict[str, Any] = {"kind": "block", "size": size, "h": case.cell, "accuracy": "given"}
        organ = {"tissue.youngs_modulus": case.youngs_modulus, "tissue.mesh": mesh}
    if case.organ == "gaping fascia":
        mesh |= {"kind": "wound", "shape": "slit", "length": length, "depth": THICKNESS}
    values = {
        "thread.suture": case.suture,
        "thread.tolerance": case.tolerance,
        "thread.path": [*path, holes[2 * laid - 1] + tail * OVER + LOOP * UP],
        "thread.end.force": SLACK * OVER,
        "piercing": [
            {
                "name": f"{('entry', 'exit')[number % 2]} {number // 2 + 1}",
                "at": hole,
                "direction": "free",
                "footprint": 0.0 if fixed else FOOTPRINT,
                "from": 0.0 if number < 2 * laid else LED,
                **({"kind": "anchored"} if number == 0 else rough),
            }
            for number, hole in enumerate(holes)
        ],
    }
    return scene("running_suture", values | organ)


def lay_taut(case: Case, stitches: int, tension: float) -> Line:
    """Lay a thread in the first stitches and draw it taut without friction."""
    assembly = assemble(scenario(case, stitches))
    rough, state = assembly.system, assembly.start()
    smooth = tuple(replace(hole, friction=None) for hole in rough.piercings)
    hand = Hand((0.0, 1.0), tension * OVER, tension * OVER)
    system = replace(rough, piercings=smooth, ends=(rough.ends[0], hand))
    state = replace(state, sigma=smooth_slip(system, state))
    line = Line(system, state, case.step, np.full(2 * stitches, tension))
    line = lead(line, tension * OVER, LAYING)
    system = replace(line.system, piercings=rough.piercings)
    return replace(line, system=system, state=replace(line.state, sigma=smooth_slip(system, line.state)))


def smooth_slip(system: System, state: State) -> Array:
    """Return which holes slide: those without friction; those with friction stick."""
    return np.where(system.may_slide & ~system.rough & state.present, 1.0, 0.0)


def lead(line: Line, force: Array, seconds: float) -> Line:
    """Lead the hand's force to `force` (3,) [N] in so many seconds."""
    system, now = line.system, line.state.time
    hand = Hand((now, now + seconds), system.ends[1].force(now), force)
    system = replace(system, ends=(system.ends[0], hand))
    run = replace(begin(system, line.state, try_step), fresh=False)
    count = int(np.ceil(seconds / line.step - 1e-9))
    for _ in range(count):
        run = run.step(line.step)
    return replace(line, system=run.system, state=run.state, steps=line.steps + count)


def pull(line: Line, mu: float, force: Array, seconds: float) -> Line:
    """Move the hand, let the suture come to rest, and record the prediction of the law of friction."""
    line = lead(lead(line, force, seconds), force, REST)
    ratios = np.array([bent_ratio(mu, turn) for turn in line.turns])
    return replace(line, law=tensions_by_law(line.law, line.hand, ratios))


def add_stitch(line: Line, number: int, hold: float) -> Line:
    """Sew one stitch more, `number` from 0: the tail passes over its entry, is led under the wound to its exit,
    back."""
    for hole, came, goes, way in ((2 * number, OVER, UNDER, -UP), (2 * number + 1, UNDER, OVER, UP)):
        line = lead(line, hold * came, REST)
        state, _ = begin_piercing(line.system, line.state, hole, line.step, np.nan)
        line = replace(line, state=state)
        line = lead(lead(line, hold * way, SWING / 2), hold * goes, SWING / 2)
    return replace(line, law=np.append(line.law, [hold, hold]))


# --- runs -------------------------------------------------------------------------------------------------


def one_pull(case: Case) -> Iterator[Row]:
    """Lay the suture, pull it, and let it back in stages."""
    line, rise = lay_taut(case, case.stitches, SLACK), PULLING / (len(RISE) + 1)
    hands = [(SLACK, REST, "before"), *((x, rise, "rising") for x in RISE if x < case.pull)]
    hands += [(case.pull, rise, "pulled"), *((x, LETTING / len(STAGES), "let back") for x in STAGES)]
    for hand, seconds, name in hands:
        line = pull(line, case.mu, hand * OVER, seconds)
        yield from moment(line, case, "one pull", SLACK, name)


def placing(case: Case, hold: float) -> Iterator[Row]:
    """Place stitch after stitch from the second on: hold, pull, let back."""
    line = lay_taut(case, 2, hold)
    for number in range(2, case.stitches + 1):
        line = add_stitch(line, number - 1, hold) if number > 2 else line
        line = pull(line, case.mu, hold * OVER, REST)
        yield from moment(line, case, "placing", hold, "before")
        line = pull(line, case.mu, case.pull * OVER, PULLING)
        yield from moment(line, case, "placing", hold, "pulled")
        line = lead(line, np.sqrt(case.pull * hold) * OVER, LETTING / 2)
        line = pull(line, case.mu, hold * OVER, LETTING / 2)
        yield from moment(line, case, "placing", hold, "let back")


def moment(line: Line, case: Case, kind: str, hold: float, name: str) -> Iterator[Row]:
    """Make the row of every stitch as it is."""
    energies = initial_energies(line.system, line.state)
    away = (line.state.y - line.system.organ.y0.reshape(-1, 9))[: line.holes, :3]
    end = SimpleNamespace(line=line, case=case, kind=kind, hold=hold, name=name, energies=energies)
    end.moved = np.linalg.norm(away, axis=1)
    for stitch in range(1, line.holes // 2 + 1):
        tension, law = float(line.forces[2 * stitch - 1, 1]), float(line.law[2 * stitch - 1])
        yield measure(Row, end, stitch=stitch, tension=tension, law=law)


# --- what they say ----------------------------------------------------------------------------------------


def runs(rows: Sequence[Row]) -> list[list[Row]]:
    """Return the rows of each run."""

    def key(row: Row) -> tuple[object, ...]:
        return row.kind, row.organ, row.check, row.mu, row.hold, row.stitches if row.kind == "one pull" else 0

    return list(grouped(rows, key).values())


def sweep(rows: Sequence[Row]) -> list[list[Row]]:
    """Return the runs of one pull in which nothing but the coefficient is varied, by the coefficient."""
    found = [run for run in runs(rows) if (run[0].kind, run[0].check) == ("one pull", "")]
    return sorted(found, key=lambda run: run[0].mu)


def placings(rows: Sequence[Row]) -> list[list[Row]]:
    """Return the runs in which stitches are placed."""
    return [run for run in runs(rows) if run[0].kind == "placing"]


def rows_at(run: Sequence[Row]) -> dict[int, Row]:
    """Return the rows under the full pull by stitches back from it: one pull along the line, or, of stitches placed one
    after the other, the second under one pull after the other."""
    followed = run[0].kind == "placing"
    return {row.stitches_back: row for row in run if row.moment == "pulled" and (row.stitch == 2 or not followed)}


def reference(rows: Sequence[Row]) -> list[Row]:
    """Return the run of one pull with the calibrated coefficient."""
    return next(run for run in runs(rows) if run[0].check == CALIBRATED)


def coefficient(rows: Sequence[Row], left: float) -> float:
    """Return the μ that leaves a tension [N] two stitches back, by ln of the ratio, nearly linear in artanh μ. Raises
    `StudyError`."""
    over = sweep(rows)
    ratios = [np.log(rows_at(run)[0].hand / rows_at(run)[BACK].tension) for run in over]
    wanted = float(np.log(rows_at(over[0])[0].hand / left))
    if not min(ratios) <= wanted <= max(ratios):
        shown = ", ".join(f"{run[0].mu:g}" for run in over)
        reason = f"none of them leaves more, or none less, than {left:g} N two stitches back"
        raise StudyError(f"mus = [{shown}] is refused: {reason}; give smaller or larger ones")
    return float(np.tanh(np.interp(wanted, ratios, [np.arctanh(run[0].mu) for run in over])))


def calibrate(rows: Sequence[Row]) -> tuple[float, float, float]:
    """Return the μ of the published tension, and those of one SD more and one less. Raises `StudyError`."""
    mu, low, high = (coefficient(rows, PUBLISHED_LEFT + sign * LEFT_SD) for sign in (0, 1, -1))
    return mu, low, high


def reach(run: Sequence[Row]) -> int:
    """Count the stitches back to the farthest in which a pull changes the tension by FELT; of several pulls the
    farthest."""
    before = {(row.stitches, row.stitch): row.tension for row in run if row.moment == "before"}
    pulled = [row for row in run if row.moment == "pulled"]
    felt = [row for row in pulled if abs(row.tension - before[row.stitches, row.stitch]) >= FELT]
    return max((row.stitches_back for row in felt), default=0)


def reaches_knot(run: Sequence[Row]) -> bool:
    """Return whether a pull is felt up to the last stitch of the run, so that its reach is unknown."""
    return reach(run) == max(row.stitches for row in run) - 1


def law_error(run: Sequence[Row]) -> float:
    """Return the largest error of the tensions that slip has brought about on the way out, over those of the law of a
    ring."""
    outward = [row for row in run if row.moment in ("rising", "pulled") and row.stitches_back]
    slid = [row for row in outward if row.law > SLIPPED * row.hold]
    return max((abs(row.tension / row.law - 1.0) for row in slid), default=0.0)


def table(rows: Sequence[Row]) -> Table:
    """Make one line a run: along the line, or the second stitch under one pull after the other."""
    most = max(row.stitches for row in rows)
    columns = [f"T, {back} back [N]" for back in range(most)]
    head = ("run", "organ", "μ [-]", "hold [N]", *columns, "felt [stitches back]", "off the law [%]")
    seen = [f"{PUBLISHED_PULL:g} (SD {PULL_SD:g})", "", f"{PUBLISHED_LEFT:g} (SD {LEFT_SD:g})"]
    seen += ["the same"] * max(min(most, 6) - 3, 0)
    seen += [""] * (most - len(seen))
    lines = [["Horeman et al., stitch 2", "pig fascia", "", "", *seen, f"≤ {PUBLISHED_REACH}", ""]]
    for run in runs(rows):
        first, tensions = run[0], rows_at(run)
        name = "placing, stitch 2" if first.kind == "placing" else ", ".join(x for x in ("one pull", first.check) if x)
        cells = [f"{tensions[back].tension:.3f}" if back in tensions else "" for back in range(most)]
        felt = f"{'≥ ' if reaches_knot(run) else ''}{reach(run)}"
        case = [name, first.organ, f"{first.mu:.4g}", f"{first.hold:g}"]
        lines.append([*case, *cells, felt, f"{100 * law_error(run):.2g}"])
    return Table(head, lines)


def remarks(rows: Sequence[Row]) -> list[str]:
    """Return remarks on the calibration, the predictions against the published values, the checks, and the limits of
    every run."""
    return [*calibration(rows), *predictions(rows), *consistency(rows), *limits(rows)]


def calibration(rows: Sequence[Row]) -> list[str]:
    """State μ with its interval, and whether it is a coefficient one would expect."""
    run, (mu, more, less) = reference(rows), calibrate(rows)
    low, high = COEFFICIENTS
    inside, pulled = "within" if low <= mu <= high else "OUTSIDE", rows_at(run)[0]
    capstan = np.log(PUBLISHED_PULL / PUBLISHED_LEFT) / (2 * BACK * np.radians(pulled.turn))
    return [
        f"calibrated: μ = {mu:.3f}, by {PUBLISHED_LEFT:g} N two stitches back from {pulled.hand:g} N; {more:.3f} to "
        f"{less:.3f} for ± 1 SD of that alone. Round cylinders (exp μθ) of the holes' mean turn, "
        f"{pulled.turn:.0f}°, it would be {capstan:.3f}",
        f"that is {inside} the {low:g} to {high:g} assumed for sutures on wet tissue",
    ]


def predictions(rows: Sequence[Row]) -> list[str]:
    """Return the predictions that were not calibrated: the reach and the later pulls at the second stitch for one pull,
    and those of stitches placed for each hold."""
    run = reference(rows)
    felt = f"felt {reach(run)} stitches back, published at most {PUBLISHED_REACH}"
    out = [f"predicted, one pull: {felt}: {reach_verdict(run)}"]
    followed = {"predicted, every row drawn anew, friction forgets": tensions_drawn_anew(run)}
    for placed in placings(rows):
        followed[f"placing, {placed[0].organ}, hold {placed[0].hold:g} N"] = rows_at(placed)
    out += [f"{name}: stitch 2 {sequence(found)}" for name, found in followed.items() if BACK in found]
    holds = agreeing_holds(run)
    found = f"for holds from {holds[0]:.2f} to {holds[-1]:.2f} N" if len(holds) else "for no hold"
    free = "the hold is not published: a second free number, with which the published course is possible, not predicted"
    return [*out, f"{free}; by the law alone, with the same μ, stitch 2 is within the published SD {found}"]


def agreeing_holds(run: Sequence[Row]) -> Array:
    """Return the holds [N] in steps of 10 mN with which the law alone leaves the second stitch as published."""
    pull, last = rows_at(run)[0].hand, max(row.stitches for row in run)
    ratio = (pull / rows_at(run)[BACK].tension) ** (1 / (2 * BACK))
    holds = np.arange(0.01, pull, 0.01)
    second = np.array([second_stitch_by_law(ratio, pull, hold, max(last, 3 + BACK)) for hold in holds])[:, BACK:]
    fourth = np.abs(second[:, 0] - PUBLISHED_LEFT) <= LEFT_SD
    return holds[fourth & (np.abs(second - second[:, :1]).max(axis=1) < FELT)]


def tensions_drawn_anew(run: Sequence[Row]) -> dict[int, Row]:
    """Return the second stitch of rows that end where they are pulled, each drawn anew: friction knows no past."""
    return {back: row for back, row in rows_at(run).items() if row.stitch > 1}


def reach_verdict(run: Sequence[Row]) -> str:
    """Return whether the reach is the published one."""
    if reaches_knot(run):
        return "the row is too short to tell"
    return "agrees" if reach(run) <= PUBLISHED_REACH else "DISAGREES"


def sequence(tensions: dict[int, Row]) -> str:
    """Write the tensions of the second stitch in words."""
    shown = ", ".join(f"{tensions[back].tension:.2f}" for back in sorted(tensions))
    left = tensions[BACK].tension
    later = [abs(row.tension - left) for back, row in tensions.items() if back > BACK]
    change, off = max(later, default=0.0), abs(left - PUBLISHED_LEFT)
    fourth = "agrees" if off <= LEFT_SD else "DISAGREES"
    unchanged = "agrees" if change < FELT else "DISAGREES"
    return (
        f"{shown} N; under the fourth, where one pull calibrates, {off:.2f} N off ({fourth}), then changed by up to "
        f"{change:.2f} N (published: by none, SD {LEFT_SD:g} N: {unchanged})"
    )


def consistency(rows: Sequence[Row]) -> list[str]:
    """Compare two stitches back under changes that should have no effect."""
    usual = rows_at(reference(rows))[BACK].tension
    checks = {run[0].check: rows_at(run)[BACK].tension for run in runs(rows) if run[0].check not in ("", CALIBRATED)}
    return [f"{name}: {100 * (found / usual - 1.0):+.2g} % two stitches back" for name, found in checks.items()]


def limits(rows: Sequence[Row]) -> list[str]:
    """List the worst of each kind of run."""
    out = []
    for name, of in grouped(rows, lambda row: f"{row.kind}, {row.organ}").items():
        out += not_settled(name, max(row.settled for row in of), 1.0)
        hardest = max(of, key=lambda row: row.press / (row.diameter * row.youngs_modulus))
        out += beyond_linear(name, max(row.moved for row in of), FOOTPRINT)
        out += beyond_bearing(name, hardest.press, hardest.diameter, THICKNESS, hardest.youngs_modulus)
    return out


# --- figure -----------------------------------------------------------------------------------------------


def figure(rows: Sequence[Row]) -> Figure:
    """Draw the tension along the line, reach over μ, the second stitch while stitches are placed, and a pull let
    back."""
    run, most = reference(rows), max(row.stitches for row in rows)
    shown = [run for run in sweep(rows) if run[0].mu]
    pulls = {f"μ = {each[0].mu:.3g} {each[0].check}": list(rows_at(each).values()) for each in (*shown, run)}
    colours = [*(str(grey) for grey in np.linspace(0.7, 0.2, len(shown))), COLOURS[0]]
    tried = grouped((*sweep(rows), run), reaches_knot)
    over = {"one pull": tried.get(False, []), "to the knot": tried.get(True, [])}
    mu, low, high = calibrate(rows)
    followed = {"each row drawn anew": list(tensions_drawn_anew(run).values())}
    for placed in placings(rows):
        followed[f"{placed[0].organ}, hold {placed[0].hold:g} N"] = list(rows_at(placed).values())
    left = [[mean] * max(most - BACK - 1, 0) for mean in (PUBLISHED_LEFT, LEFT_SD)]
    later, law = range(2 + BACK, most + 1), curve([], [], "ring law, by the turns measured", ":")
    back = {f"{k} back": [row for row in run if row.stitches_back == k] for k in range(1, min(5, most))}
    return draw(
        [
            panel(
                "stitches back from the pull [-]", "tension [N]",
                series(pulls, "stitches_back", "tension", "", colours=colours, markersize=4),
                series(unnamed(pulls), "stitches_back", "law", ":", [""], colours), law,
                published([0, BACK], [PUBLISHED_PULL, PUBLISHED_LEFT], [PULL_SD, LEFT_SD]),
                log="y", ticks={"x": range(most), "y": TENSIONS}, title="one pull", ylim=(0.08, 30.0),
                legend={"fontsize": 6.5, "loc": "upper right", "ncols": 2},
            ),
            panel(
                "coefficient of friction μ [-]", "felt, stitches back [-]",
                series(over, lambda each: each[0].mu, reach, "", ("o", "^"), [COLOURS[0]] * 2),
                band("x", low, high, "μ within ± 1 SD"), level("x", mu, f"calibrated, μ = {mu:.3f}"),
                band("y", 0, PUBLISHED_REACH, f"published: ≤ {PUBLISHED_REACH}", COLOURS[1]),
                ticks={"y": range(most)}, title=f"felt: a change by {FELT:g} N or more", ylim=(0, most - 0.5),
            ),
        ],
        [
            panel(
                "stitch that is pulled [-]", "tension of stitch 2 [N]",
                series(
                    followed, lambda row: row.stitches_back + 2, "tension",
                    colours=["black", COLOURS[0], *COLOURS[2:]], markersize=4,
                ),
                published([2, *later], [PUBLISHED_PULL, *left[0]], [PULL_SD, *left[1]]),
                ticks={"x": range(2, most + 1)}, title="stitches placed one by one", legend={"fontsize": 6.5},
            ),
            panel(
                "pull on the loose end [N]", "tension [N]", series(back, "hand", "tension", colours=COLOURS[1:]),
                series(unnamed(back), "hand", "law", ":", [""], ["black"]), law, above=1.25,
                title=f"pulled and let back, μ = {run[0].mu:.3f}", legend={"loc": "upper left", "ncols": 2},
            ),
        ],
    )  # fmt: skip


def published(x: Sequence[float], mean: Sequence[float], deviation: Sequence[float]) -> Item:
    """Draw the published means with their SD."""
    looks: dict[str, Any] = {"fmt": "s", "markerfacecolor": "white", "capsize": 4, "zorder": 5, "color": COLOURS[1]}
    return lambda axes: axes.errorbar(x, mean, deviation, label="Horeman et al. 2013, mean and SD", **looks)


STUDY = described("running_suture", main, table, figure, remarks)
