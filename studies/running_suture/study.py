"""A running suture: the reach of a pull along the stitches, compared with a published experiment.

Horeman et al. (PLoS ONE 2013;8:e84466) sewed pig fascia with seven continuous stitches and measured
the thread of the second stitch. It bears 3 N (SD 1.2) while it is pulled, and 1 N (SD 0.3) from the
fourth stitch on. The fifth, sixth and seventh stitch have no influence. Here a thread runs through
two rough holes per stitch, its first hole is a knot, and its loose end is pulled.

*One pull.* Seven stitches carry no load except a small laying tension. The end is pulled, and let
back. One number, the coefficient of friction μ, is fitted: two stitches back the tension is the
published third of the pull.

*Placing.* With this μ the stitches are placed one after the other. The end is held, passed through
two new holes, pulled, and let back to the hold. Friction keeps the tension of earlier stitches. The
hold is not published, so it is varied.

A hole is a ring around which the thread bends: T₁ − T₂ = μN with T₁(1 − cos α) = T₂(1 − cos β), see
`studies.theory.bent_ratio`. Around a cylinder the ratio would be exp(μθ). Segments follow
`tensions_by_law`, independent of their elasticity, if only the pull moves thread through a hole.
Neglected are contact of the lips, tearing of holes, creep of tissue, and the sensor on the
published thread.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from coupling.run import begin
from coupling.run.impact import begin_piercing
from coupling.run.run import Run
from coupling.step.stepping import try_step
from coupling.system import State, System
from studies.arrays import Array
from studies.figure import curve, described, deviations, draw, series, unnamed
from studies.scenario import Scenario
from studies.simulation.assembly import assemble
from studies.study import Job, Table, each, grouped, measure, measured, require, scene, unit_field
from studies.theory import bent_ratio, tensions_by_law
from studies.verdicts import bearing_strain, beyond_bearing, beyond_linear, not_settled, unrest
from thread.ends import Free

# Small bites (Deerenberg et al., Lancet 2015;386:1254): 5 mm from the edge of the wound, every 5
# mm, USP 2-0.
BITE, PITCH = 5e-3, 5e-3  # [m]
# Förstemann et al., J Biomech 2011;44:600: 3.4 N/mm at 6 % across the linea alba, 57 N/mm, here on
# 1.5 mm.
THICKNESS, YOUNGS_MODULUS = 1.5e-3, 4e7  # [m], [Pa]
WIDTH, BEYOND = 0.04, 0.03  # of the sheet, and its length beyond the stitches [m]
FOOTPRINT = 0.7e-3  # radius of a hole [m]

PULL, PULL_SD = 3.0, 1.2  # published [N]
LEFT, LEFT_SD = 1.0, 0.3  # published two stitches back [N]
BACK = 2  # stitches from the pull to the stitch for the calibration
PUBLISHED = "Horeman et al. 2013, mean and SD"
ONE, CALIBRATED, PLACING = "one pull", "one pull, calibrated", "placing, stitch 2"

SLACK = 0.1  # tension in which a thread is laid without friction; a pull is let back to twice this [N]
FREE, TAIL, LOOP = 6e-3, 0.03, 1e-3  # of thread before its knot, beyond the last hole, above and below each hole [m]
NEVER = 1e9  # a beginning that is never reached [s]: the stitch begins when the hand has moved the thread there
STEP, LAYING, PULLING, LETTING, SWING, REST = 2e-3, 0.04, 0.15, 0.08, 0.06, 0.02  # [s]
SLIPPED = 1.2  # times its tension before the pull: a stitch above this was reached by slip
OVER = np.array([-2 * BITE, PITCH, 0.0]) / np.hypot(2 * BITE, PITCH)  # over the wound to the next stitch
UNDER = np.array([1.0, 0.0, 0.0])  # under the wound
UP = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True, kw_only=True)
class Row:
    """One stitch at one moment of one run; `tension` is the tension of the thread behind it."""

    kind: str  # ONE, CALIBRATED or PLACING
    fixed: bool = measured("", lambda line: line.case.fixed)
    mu: float = measured("-", lambda line: line.case.mu)
    hold: float = unit_field("N")  # between two pulls
    stitches: int = measured("-", lambda line: line.holes // 2)  # placed so far
    moment: str  # "pulled" or "let back"
    hand: float = unit_field("N")
    stitch: int = unit_field("-")  # 1 begins with the knot
    tension: float = unit_field("N")
    law: float = unit_field("N")  # by the measured turns and the law of a ring
    moved: float = measured("m", lambda line: np.linalg.norm(line.moved, axis=1).max())  # largest of a hole
    bearing: float = measured("-", lambda line: line.bearing)  # largest bearing strain at a hole
    settled: float = measured("-", lambda line: unrest(line.run.energies.kinetic, line.run.energies.elastic))

    @property
    def stitches_back(self) -> int:
        """Number of stitches back from the pull."""
        return self.stitches - self.stitch


@dataclass(frozen=True)
class Case:
    """A suture to be placed."""

    mu: float
    stitches: int
    fixed: bool = False  # holes fixed in space instead of a sheet


@dataclass(frozen=True)
class Hand(Free):
    """A hand with a dead load that changes between two `times` [s].

    The load changes from `begin` to `end` (3,) [N].
    """

    times: tuple[float, float]
    begin: Array
    end: Array

    def force(self, time: float | Array, share: float = 1.0) -> Array:
        """Return the load at `time` [N]."""
        way = np.interp(time, self.times, (0.0, 1.0))
        return np.asarray(np.multiply.outer(1.0 - way, self.begin) + np.multiply.outer(way, self.end))


@dataclass(frozen=True)
class Line:
    """A suture in its holes.

    `law` (segments,) [N] are the tensions behind each hole by the law of friction.
    """

    case: Case
    run: Run[Any]
    law: Array

    @property
    def holes(self) -> int:
        """Number of holes that contain the thread."""
        return int(self.run.state.present.sum())

    @cached_property
    def forces(self) -> Array:
        """Tensions before and after each hole, and its force, shape `(holes, 3)` [N].

        Only holes with the thread are included.
        """
        observed = self.run.piercings[: self.holes]
        return np.array([(abs(o.tension_before), abs(o.tension_after), np.linalg.norm(o.force)) for o in observed])

    @property
    def moved(self) -> Array:
        """Displacements of these holes, shape `(holes, 3)` [m]."""
        return (self.run.state.y - self.run.system.organ.y0.reshape(-1, 9))[: self.holes, :3]

    @property
    def bearing(self) -> float:
        """Largest bearing strain at a hole [-]."""
        E = np.inf if self.case.fixed else YOUNGS_MODULUS
        return bearing_strain(self.forces[:, 2].max(), self.run.system.thread.section.diameter, THICKNESS, E)

    @property
    def turns(self) -> Array:
        """Turn of the thread in each hole except the knot (holes − 1,) [rad].

        It follows from the balance of forces.
        """
        before, after, force = self.forces[1:].T
        cosine = (before**2 + after**2 - force**2) / (2.0 * before * after)
        return np.arccos(np.clip(cosine, -1.0, 1.0))


def main(
    mus: Sequence[float] = (0.0, 0.05, 0.1, 0.15, 0.2, 0.3, 0.4),
    stitches: int = 7,
    holds: Sequence[float] = (0.2, 0.4, 0.8),
    fixed: bool = False,
) -> Iterator[Row]:
    """Yield one pull for every coefficient, one for the calibrated coefficient, and the placings.

    There is a placing for every hold [N]. The placing with the middle hold is also run in holes
    `fixed` in space; with `fixed`, all runs are. Raises `StudyError` for arguments that prevent a
    calibration.
    """
    allowed = stitches > BACK and min(mus) >= 0.0 and max(mus) < 1.0 and min(holds) > 0.0
    reason = f"give more than {BACK} stitches, coefficients from 0 to below 1 and holds above 0"
    require(allowed, f"stitches = {stitches}, mus = {mus}, holds = {holds}", reason)
    rows: list[Row] = []
    for row in each([partial(one_pull, Case(mu, stitches, fixed), ONE) for mu in sorted(mus)]):
        rows.append(row)
        yield row
    case = Case(calibrate(rows), stitches, fixed)
    jobs: list[Job] = [partial(one_pull, case, CALIBRATED), *(partial(placing, case, hold) for hold in holds)]
    jobs += [] if fixed else [partial(placing, replace(case, fixed=True), holds[len(holds) // 2])]
    yield from each(jobs)


# --- the suture -------------------------------------------------------------------------------------------


def scenario(case: Case, laid: int) -> Scenario:
    """Return the scene with a thread laid up and down through the holes of the first stitches.

    Its tail lies over the closed wound. The holes are in a sheet, or fixed in space.
    """
    along, fixed = PITCH * (np.arange(case.stitches) - (case.stitches - 1) / 2), case.fixed
    holes = [np.array([side * BITE, y, -THICKNESS / 2]) for y in along for side in (-1.0, 1.0)]
    path = [holes[0] - FREE * UNDER + LOOP * UP]
    for number, hole in enumerate(holes[: 2 * laid]):
        path += [hole + way * LOOP * UP for way in ((1, -1) if number % 2 == 0 else (-1, 1))]
    tail = TAIL + (case.stitches - laid) * (2 * BITE + np.hypot(2 * BITE, PITCH))
    rough = {"friction": {"static": case.mu, "kinetic": case.mu}} if case.mu else {}
    size = [WIDTH, (case.stitches - 1) * PITCH + 2 * BEYOND, THICKNESS]
    values = {
        "thread.path": [*path, holes[2 * laid - 1] + tail * OVER + LOOP * UP],
        "piercing": [
            {
                "name": f"{('entry', 'exit')[k % 2]} {k // 2 + 1}", "at": hole, "direction": "free",
                "footprint": 0.0 if fixed else FOOTPRINT, "from": 0.0 if k < 2 * laid else NEVER,
                **({"kind": "anchored"} if k == 0 else rough),
            }
            for k, hole in enumerate(holes)
        ],
    }  # fmt: skip
    return scene("running_suture", values | ({"tissue": None} if fixed else {"tissue.mesh.size": size}))


def lay_taut(case: Case, stitches: int, tension: float) -> Line:
    """Return a thread laid in the first stitches and drawn taut without friction."""
    assembly = assemble(scenario(case, stitches))
    rough, hand = assembly.system, Hand((0.0, 1.0), tension * OVER, tension * OVER)
    smooth = tuple(replace(hole, friction=None) for hole in rough.piercings)
    run = begun(replace(rough, piercings=smooth, ends=(rough.ends[0], hand)), assembly.start())
    line = lead(Line(case, run, np.full(2 * stitches, tension)), tension * OVER, LAYING)
    return replace(line, run=begun(replace(line.run.system, piercings=rough.piercings), line.run.state))


def begun(system: System, state: State) -> Run[Any]:
    """Return a new run in which smooth holes slide and rough holes stick."""
    slip = np.where(system.may_slide & ~system.rough & state.present, 1.0, 0.0)
    return begin(system, replace(state, sigma=slip), try_step)


def lead(line: Line, force: Array, seconds: float) -> Line:
    """Return the line after the hand's force has changed to `force` (3,) [N] in this time."""
    system, state = line.run.system, line.run.state
    hand = Hand((state.time, state.time + seconds), system.ends[1].force(state.time), force)
    run = replace(begin(replace(system, ends=(system.ends[0], hand)), state, try_step), fresh=False)
    return replace(line, run=run.steps(STEP, int(np.ceil(seconds / STEP - 1e-9))))


def pull(line: Line, hand: float, seconds: float) -> Line:
    """Return the line after a move of the hand and a rest.

    The prediction of the law of friction is updated.
    """
    line = lead(lead(line, hand * OVER, seconds), hand * OVER, REST)
    ratios = np.array([bent_ratio(line.case.mu, turn) for turn in line.turns])
    return replace(line, law=tensions_by_law(line.law, hand, ratios))


def add_stitch(line: Line, number: int, hold: float) -> Line:
    """Return the line with one more stitch, `number` from 0.

    The tail passes over its entry, then under the wound to its exit, and back.
    """
    for hole, came, goes, way in ((2 * number, OVER, UNDER, -UP), (2 * number + 1, UNDER, OVER, UP)):
        line = lead(line, hold * came, REST)
        state, _ = begin_piercing(line.run.system, line.run.state, hole, STEP, np.nan)
        line = replace(line, run=replace(line.run, state=state))
        line = lead(lead(line, hold * way, SWING / 2), hold * goes, SWING / 2)
    return replace(line, law=np.append(line.law, [hold, hold]))


# --- runs -------------------------------------------------------------------------------------------------


def one_pull(case: Case, kind: str) -> Iterator[Row]:
    """Yield the rows of a suture that is laid, pulled, and let back."""
    line = lay_taut(case, case.stitches, SLACK)
    for hand, seconds, name in ((PULL, PULLING, "pulled"), (2.0 * SLACK, LETTING, "let back")):
        line = pull(line, hand, seconds)
        yield from moment(line, kind=kind, hold=SLACK, moment=name, hand=hand)


def placing(case: Case, hold: float) -> Iterator[Row]:
    """Yield the rows of stitches placed from the second on: hold, pull, let back."""
    line = lay_taut(case, 2, hold)
    for number in range(2, case.stitches + 1):
        line = add_stitch(line, number - 1, hold) if number > 2 else line
        line = pull(pull(line, hold, REST), PULL, PULLING)
        yield from moment(line, kind=PLACING, hold=hold, moment="pulled", hand=PULL)
        line = pull(lead(line, np.sqrt(PULL * hold) * OVER, LETTING / 2), hold, LETTING / 2)


def moment(line: Line, **known: Any) -> Iterator[Row]:
    """Yield the row of every stitch at the present moment."""
    tensions = zip(line.forces[1::2, 1].tolist(), line.law[1::2].tolist(), strict=True)
    for number, (tension, law) in enumerate(tensions, 1):
        yield measure(Row, line, stitch=number, tension=tension, law=law, **known)


# --- what they say ----------------------------------------------------------------------------------------


def runs(rows: Sequence[Row], *kinds: str) -> list[list[Row]]:
    """Return the rows of each run of some kinds, under the full pull, by the coefficient."""
    pulled = sorted((row for row in rows if row.kind in kinds and row.moment == "pulled"), key=lambda row: row.mu)
    return list(grouped(pulled, lambda row: (row.kind, row.fixed, row.mu, row.hold)).values())


def rows_at(run: Sequence[Row]) -> dict[int, Row]:
    """Return the rows of a run by stitches back from the pull.

    For one pull these are the stitches along the line. For placed stitches it is the second stitch
    under each pull.
    """
    return {row.stitches_back: row for row in run if row.stitch == 2 or row.kind != PLACING}


def calibrate(rows: Sequence[Row], left: float = LEFT) -> float:
    """Return the μ for a tension [N] two stitches back.

    The logarithm of the ratio is nearly linear in artanh μ.

    Raises `StudyError`.
    """
    over = runs(rows, ONE)
    ratios = [np.log(rows_at(run)[0].hand / rows_at(run)[BACK].tension) for run in over]
    wanted = float(np.log(over[0][0].hand / left))
    reason = f"they must leave both more and less than {left:g} N two stitches back; add smaller or larger ones"
    require(min(ratios) <= wanted <= max(ratios), f"mus = {[run[0].mu for run in over]}", reason)
    return float(np.tanh(np.interp(wanted, ratios, [np.arctanh(run[0].mu) for run in over])))


def law_error(run: Sequence[Row]) -> float:
    """Return the largest relative error of the tensions after slip.

    The reference is the law of a ring.
    """
    slid = [row for row in run if row.stitches_back and row.law > SLIPPED * row.hold]
    return max((abs(row.tension / row.law - 1.0) for row in slid), default=0.0)


def table(rows: Sequence[Row]) -> Table:
    """Return the table with a line for each run.

    A line follows the suture, or the second stitch under each pull.
    """
    most = max(row.stitches for row in rows)

    def cell(back: int) -> Callable[[list[Row]], str]:
        return lambda run: f"{rows_at(run)[back].tension:.3f}" if back in rows_at(run) else ""

    columns = (
        ("run", lambda run: run[0].kind),
        ("organ", lambda run: organ(run[0])),
        ("μ [-]", lambda run: f"{run[0].mu:.4g}"),
        ("hold [N]", lambda run: f"{run[0].hold:g}"),
        *((f"T, {back} back [N]", cell(back)) for back in range(most)),
        ("off the law [%]", lambda run: f"{100 * law_error(run):.2g}"),
    )
    found = Table.of(columns, runs(rows, ONE) + runs(rows, CALIBRATED) + runs(rows, PLACING))
    published = [f"{PULL:g} (SD {PULL_SD:g})", "", f"{LEFT:g} (SD {LEFT_SD:g})", *["the same"] * 3, *[""] * most][:most]
    return Table(found.head, [["Horeman et al., stitch 2", "pig fascia", "", "", *published, ""], *found.lines])


def organ(row: Row) -> str:
    """Return the material of a row's holes."""
    return "fixed points" if row.fixed else "closed fascia"


def second_stitches(rows: Sequence[Row]) -> dict[str, dict[int, Row]]:
    """Return the second stitch under each pull, by the name of its run.

    The runs are separate rows that end at the pull, and stitches placed one by one.
    """
    anew = {back: row for back, row in rows_at(runs(rows, CALIBRATED)[0]).items() if row.stitch > 1}
    placed = {f"{organ(run[0])}, hold {run[0].hold:g} N": rows_at(run) for run in runs(rows, PLACING)}
    return {"each row drawn anew": anew} | placed


def remarks(rows: Sequence[Row]) -> Iterator[str]:
    """Yield remarks on the calibration, the predictions, and the limits of all runs.

    Predictions are compared with published values.
    """
    first = runs(rows, CALIBRATED)[0][0]
    yield f"calibrated: μ = {first.mu:.3f}, for {LEFT:g} N two stitches back from a pull of {first.hand:g} N"
    for name, found in second_stitches(rows).items():
        if BACK in found:
            yield f"{name}: stitch 2 {sequence(found)}"
    yield "the hold is not published: with this second free number the published course is possible, but not predicted"
    yield from not_settled("all runs", max(row.settled for row in rows))
    yield from beyond_linear("all runs", max(row.moved for row in rows), FOOTPRINT)
    yield from beyond_bearing("all runs", max(row.bearing for row in rows))


def sequence(tensions: dict[int, Row]) -> str:
    """Return the tensions of the second stitch in words."""
    shown, left = ", ".join(f"{tensions[back].tension:.2f}" for back in sorted(tensions)), tensions[BACK].tension
    change = max((abs(row.tension - left) for back, row in tensions.items() if back > BACK), default=0.0)
    fourth, unchanged = ("agrees" if far <= LEFT_SD else "DISAGREES" for far in (abs(left - LEFT), change))
    return (
        f"{shown} N; at the fourth an error of {abs(left - LEFT):.2f} N ({fourth}), then a change of up to "
        f"{change:.2f} N (published: no change, SD {LEFT_SD:g} N: {unchanged})"
    )


# --- figure -----------------------------------------------------------------------------------------------


def figure(rows: Sequence[Row]) -> Figure:
    """Return the figure of the tension along the line, and of the second stitch.

    The second stitch is followed while stitches are placed.
    """
    most = max(row.stitches for row in rows)
    pulls = {f"μ = {run[0].mu:.3g}": list(rows_at(run).values()) for run in runs(rows, ONE) if run[0].mu}
    pulls |= {f"μ = {run[0].mu:.3g} calibrated": run for run in runs(rows, CALIBRATED)}
    followed = {name: list(found.values()) for name, found in second_stitches(rows).items()}
    later = range(2 + BACK, most + 1)
    return draw(described(
        "running_suture",
        [
            series(pulls, "stitches_back", "tension", "", markersize=4), {"ticks": {"x": range(most)}},
            series(unnamed(pulls), "stitches_back", "law", ":", [""]),
            curve([], [], "ring law, by the turns measured", ":"),
            deviations([0, BACK], [PULL, LEFT], [PULL_SD, LEFT_SD], PUBLISHED),
        ],
        [
            series(followed, lambda row: row.stitches_back + 2, "tension", markersize=4),
            deviations([2, *later], [PULL, *[LEFT] * len(later)], [PULL_SD, *[LEFT_SD] * len(later)], PUBLISHED),
            {"ticks": {"x": range(2, most + 1)}},
        ],
    ))  # fmt: skip
