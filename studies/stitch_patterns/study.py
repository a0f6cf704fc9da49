"""Stitch patterns: the pull on the first throw that closes a wound under tension, single stitch to mattress.

Marsidi, Vermeulen, Horeman & Genders (J. Surg. Res. 255 (2020) 135, abstract read) closed a wound model of neoprene
under 5 N with five stitches, and measured how hard the first throw was pulled. A loop that crosses a wound several
times is a tackle: without friction each crossing strand bears the same, and n of them need the n-th part of the wound's
tension. Friction takes from it at every turn.

*Model.* The lips are shut and stay where they are; what the thread pulls one of them across is the wound's tension. A
hole turns the thread by 90° at the skin and by 90° below it, each over a row of rough rings fixed in space. Both hands
pull alike. The throw turns each strand too, over rings that belong to no lip; in a mattress stitch it lies on one side
of the wound. One μ, of thread on skin and of thread on thread alike, is fitted to the single stitch; the other pulls
are predictions.

*Assumed.* How far a throw turns a strand is not published. Two strands that twist round one another by one and a half
turns, the least that makes a half knot, at a pitch angle α each bend by 540° sin α: 180° to 360° for 20° to 42°. How
the modified pulley stitch was laid the abstract does not say either, so it is not run. Sizes do not matter while the
rings are many √(EI/T) apart.

*By hand.* A strand that has turned by φ from its hand bears exp(−μφ) of the pull (capstan); a thread that bends, the
product over the rings of `studies.theory.bent_ratio`.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from scipy.optimize import brentq

from coupling.rest.laying import start
from coupling.run.run import Run, begin
from studies.arrays import Array
from studies.figure import curve, draw, laws, level, panel, series, unnamed
from studies.friction.study import fixed_holes
from studies.study import Columns, Study, Table, each, grouped, require, require_known, unit_field
from studies.theory import bent_ratio, capstan
from thread.catalogue import suture
from thread.ends import Pulled
from thread.path import rounded_path
from thread.placed import through_holes
from thread.quadrature import gauss_rule
from thread.thread import MASS_POINTS, Thread

WOUND = 5.0  # tension of the wound [N]
SUTURE = "3-0 polypropylene"  # assumed
X, Y, Z = np.eye(3)
RING, STRAIGHT, ARM = 4e-3, 6e-3, 8e-3  # between rings of a corner, between corners, from the last ring to a hand [m]
SLACK = 1.005  # rest length over that of the polygon of rings: the thread begins slack, and slides towards both hands
MOST = 1.0  # coefficient of friction [-]: where a fit is looked for
AGREES = 1.0  # standard deviations: a prediction this near is said to agree
MODIFIED = (4.52, 0.67)  # published of the modified pulley stitch [N]
LEFT, RIGHT, THROW = "left lip", "right lip", "throw"

Law = Callable[[float], float]  # ratio of tensions at one ring, by the angle that it turns the thread by [rad]


@dataclass(frozen=True)
class Pattern:
    """A stitch: its published pull and standard deviation [N], where a strand heads that comes from the throw, and the
    corners of the loop up to the throw again, each by its new heading and the lip that it is on."""

    published: float
    spread: float
    first: Array
    corners: tuple[tuple[Array, str], ...]

    @property
    def text(self) -> str:
        """The published pull and its standard deviation [N]."""
        return f"{self.published:g} ± {self.spread:g}"


PATTERNS = {
    "single": Pattern(5.69, 0.88, -X, ((-Z, LEFT), (X, LEFT), (Z, RIGHT), (-X, RIGHT))),
    "pulley": Pattern(3.46, 0.61, -X, ((-Z, LEFT), (X, LEFT), (Z, RIGHT), (-X, RIGHT)) * 2),
    "vertical mattress": Pattern(
        7.25, 1.33, -X,
        ((-Z, LEFT), (X, LEFT), (Z, RIGHT), (-X, RIGHT), (-Z, RIGHT), (-X, RIGHT), (Z, LEFT), (-X, LEFT)),
    ),
    "horizontal mattress": Pattern(
        8.11, 1.00, -Y,
        ((-Z, LEFT), (X, LEFT), (Z, RIGHT), (Y, RIGHT), (-Z, RIGHT), (-X, RIGHT), (Z, LEFT), (-Y, LEFT)),
    ),
}  # fmt: skip
FITTED = "single"  # the stitch that μ is fitted to


@dataclass(frozen=True, kw_only=True)
class Row:
    """A load step of a stitch (`kind` "load"), or at the last of them a strand between two rings ("strand").

    Of a strand `turn` is that from its nearer hand, and `tension` its own; of a load step `tension` is what the thread
    pulls a lip by, across the wound.
    """

    kind: str
    pattern: str
    throw: float = unit_field("degree")
    rings: int = unit_field("-")  # a corner
    fitted: float = unit_field("N")  # pull of the single stitch that μ was fitted to
    mu: float = unit_field("-")
    pull: float = unit_field("N")
    turn: float = unit_field("degree")
    tension: float = unit_field("N")
    slides: bool  # in all rings but for two in the middle, towards the nearer hand

    @property
    def stitch(self) -> Pattern:
        """The stitch."""
        return PATTERNS[self.pattern]


@dataclass(frozen=True)
class Finely:
    """Resolution of a stitch: load steps, and control points per ring."""

    load_steps: int
    control_points: int


def main(
    throws: Sequence[float] = (180.0, 270.0),
    patterns: Sequence[str] = tuple(PATTERNS),
    rings: Sequence[int] = (2,),
    spreads: Sequence[float] = (),
    load_steps: int = 4,
    control_points: int = 24,
) -> Iterator[Row]:
    """Yield the load steps and strands of every stitch for every turn of a throw [degree], at the first number of
    `rings` a corner; for the middle throw at the others too, and with μ fitted to the single stitch's pull as many
    `spreads` of its standard deviation away; `control_points` a ring. Raises `StudyError`."""
    require_known("patterns", patterns, PATTERNS)
    require(
        min(throws) > 0.0 and max(throws) <= 360.0, f"throws = {list(throws)}", "give turns above 0 up to 360 degrees"
    )
    given = f"rings = {list(rings)}, load_steps = {load_steps}, control_points = {control_points}"
    remedy = "give two rings a corner or more, one load step, eight control points"
    require(min(rings) >= 2 and load_steps >= 1 and control_points >= 8, given, remedy)
    require(FITTED in patterns, f"patterns = {list(patterns)}", f"μ is fitted to {FITTED!r}; add it")
    middle, of = sorted(throws)[len(throws) // 2], PATTERNS[FITTED]
    cases = [(throw, rings[0], of.published) for throw in throws]
    cases += [(middle, many, of.published) for many in rings[1:]]
    cases += [(middle, rings[0], of.published + away * of.spread) for away in spreads]
    how = Finely(load_steps, control_points)
    yield from each([partial(stitches, *case, tuple(patterns), how) for case in cases])


def stitches(throw: float, rings: int, fitted: float, patterns: Sequence[str], how: Finely) -> Iterator[Row]:
    """Yield the rows of all stitches, with the μ that the single one needs to be closed by the pull `fitted` [N]."""
    mu = fit(throw, rings, fitted, how)
    for name in patterns:
        way = Way.of(PATTERNS[name], throw, rings)
        pull = WOUND / way.closing(partial(bent_ratio, mu))
        case = Row(
            kind="load", pattern=name, throw=throw, rings=rings, fitted=fitted, mu=mu, pull=pull, turn=0.0,
            tension=np.nan, slides=False,
        )  # fmt: skip
        for step, run in enumerate(pulled(way, mu, pull, how), start=1):
            at, slides = pull * step / how.load_steps, is_sliding(way, run)
            case = replace(case, pull=at, tension=across(way, run), slides=slides)
            yield case
        for turn, hole in zip(np.degrees(way.from_hand), run.piercings[:-1], strict=True):
            yield replace(case, kind="strand", turn=float(turn), tension=hole.tension_after)


def fit(throw: float, rings: int, pull: float, how: Finely) -> float:
    """Fit μ to the pull [N] that closes a single stitch: by a thread that bends, and once more by how far a run was off
    that law."""
    way = Way.of(PATTERNS[FITTED], throw, rings)

    def by_law(closing: float) -> float:
        return float(brentq(lambda mu: way.closing(partial(bent_ratio, mu)) - closing, 1e-6, MOST))

    guess = by_law(WOUND / pull)
    *_, run = pulled(way, guess, pull, how)
    return by_law((WOUND / pull) ** 2 / (across(way, run) / pull))


# --- the way of a thread ----------------------------------------------------------------------------------


@dataclass(frozen=True)
class Way:
    """The polygon of a thread: `headings` (k + 1, 3) of its sides, the `lengths` (k + 1,) of these [m], and where each
    of its k corners, the rings, is: on a lip or in the throw."""

    headings: Array
    lengths: Array
    places: tuple[str, ...]

    @classmethod
    def of(cls, pattern: Pattern, throw: float, rings: int) -> "Way":
        """Return the way of a stitch from hand to hand, so many rings a corner, `throw` [degree] the turn of either
        strand in it."""
        turns = max(1, round(rings * throw / 90.0))
        angles = np.radians(throw) * np.arange(turns + 1) / turns
        headings = list(turned(pattern.first, Z, angles[::-1]))
        places, groups = [THROW] * turns, [0] * turns
        for number, (heading, lip) in enumerate(pattern.corners, start=1):
            headings += list(turned(headings[-1], heading, 0.5 * np.pi * np.arange(1, rings + 1) / rings))
            places, groups = places + [lip] * rings, groups + [number] * rings
        headings += list(turned(headings[-1], Z, angles[1:]))
        places, groups = places + [THROW] * turns, groups + [len(pattern.corners) + 1] * turns
        between = np.where(np.diff(groups) == 0, RING, STRAIGHT)
        return cls(np.array(headings), np.concatenate([[ARM], between, [ARM]]), tuple(places))

    @property
    def corners(self) -> Array:
        """Rings, with a hand before and after them, shape `(k + 2, 3)` [m]."""
        return np.cumsum(np.vstack([np.zeros(3), self.lengths[:, None] * self.headings]), axis=0)

    @property
    def turns(self) -> Array:
        """Angle by which each ring turns the thread, shape `(k,)` [rad]."""
        return np.arccos(np.clip(np.sum(self.headings[:-1] * self.headings[1:], axis=1), -1.0, 1.0))

    @property
    def on_right(self) -> Array:
        """Whether each ring is on the right lip, shape `(k,)`."""
        return np.array([place == RIGHT for place in self.places])

    @property
    def from_hand(self) -> Array:
        """Angle by which the thread has turned from the nearer hand at each inner side, shape `(k − 1,)` [rad]."""
        turned_by = np.cumsum(self.turns)
        return np.minimum(turned_by, turned_by[-1] - turned_by)[:-1]

    def closing(self, law: Law) -> float:
        """Return the force of the thread on the right lip, across the wound, over the pull of each hand, for a
        `law`."""
        loss = np.concatenate([[0.0], np.cumsum(np.log([law(turn) for turn in self.turns]))])
        tensions = np.exp(-np.minimum(loss, loss[-1] - loss))[:, None] * self.headings
        return float((tensions[:-1] - tensions[1:])[self.on_right, 0].sum())


def turned(heading: Array, towards: Array, angles: Array) -> Array:
    """Return a unit vector turned by `angles` (k,) [rad] towards another across it, shape `(k, 3)`."""
    return np.outer(np.cos(angles), heading) + np.outer(np.sin(angles), towards)


# --- the coupled system -----------------------------------------------------------------------------------


def pulled(way: Way, mu: float, pull: float, how: Finely) -> Iterator[Run]:
    """Yield the equilibria of a suture in rough rings along a way, both its ends pulled by as much as `pull` [N]."""
    corners, radius = way.corners, 0.25 * RING
    path = rounded_path(corners, radius)
    saved = radius * (2.0 * np.tan(0.5 * way.turns) - way.turns)  # by a rounded corner
    length = SLACK * way.lengths.sum()
    stretch = path.length / length
    s = (np.cumsum(way.lengths[:-1]) - np.cumsum(saved) + 0.5 * saved) / stretch
    knots = through_holes(length, s, False, length / (how.control_points * s.size))
    thread = Thread(knots, suture(SUTURE))
    ends = Pulled(-pull * way.headings[0]), Pulled(pull * way.headings[-1])
    system = fixed_holes(thread, ends, mu, corners[1:-1])
    laid = path.position(stretch * gauss_rule(thread.spline, MASS_POINTS).s)
    run = begin(system, start(system, s, laid, stretch))
    for step in range(1, how.load_steps + 1):
        run = run.load(step / how.load_steps, 1.0)
        yield run


def across(way: Way, run: Run) -> float:
    """Return the force of the thread on the right lip, across the wound [N]."""
    return float(run.state.lam[way.on_right, 0].sum())


def is_sliding(way: Way, run: Run) -> bool:
    """Return whether the thread slides towards its nearer hand in all rings but the two in the middle at most."""
    half = (len(way.places) - 1) // 2
    sigma = run.state.sigma
    return bool((sigma[:half] > 0.0).all() and (sigma[-half:] < 0.0).all())


# --- table and figure -------------------------------------------------------------------------------------


Case = tuple[float, int, float]


def cases_of(rows: Sequence[Row]) -> list[Case]:
    """Return the turn of the throw [degree], rings a corner and fitted pull [N] of all that was run, in its order."""
    return list(dict.fromkeys((row.throw, row.rings, row.fitted) for row in rows))


def loads_of(rows: Sequence[Row], case: Case, kind: str = "load") -> dict[str, list[Row]]:
    """Return the load steps of a case by stitch, or its strands."""
    of = [row for row in rows if row.kind == kind and (row.throw, row.rings, row.fitted) == case]
    return grouped(of, lambda row: row.pattern)


def closing_pull(loads: Sequence[Row]) -> float:
    """Return the pull that closes the wound [N], in proportion to the last load step."""
    return WOUND * loads[-1].pull / loads[-1].tension


def predicted_by_capstan(name: str, throw: float, fitted: float) -> float:
    """Return the pull [N] that closes the wound by the capstan alone, its own μ fitted to the single stitch."""
    ways = {key: Way.of(PATTERNS[key], throw, 1) for key in (FITTED, name)}
    mu = brentq(lambda mu: ways[FITTED].closing(partial(capstan, mu)) - WOUND / fitted, 1e-6, MOST)
    return WOUND / ways[name].closing(partial(capstan, float(mu)))


def by_capstan(row: Row) -> float:
    """Return the pull that closes the wound by the capstan alone, in a row's case [N]."""
    return predicted_by_capstan(row.pattern, row.throw, row.fitted)


def off_published(loads: Sequence[Row]) -> float:
    """Return by how many standard deviations the pull that closes the wound is above the published one."""
    return (closing_pull(loads) - loads[-1].stitch.published) / loads[-1].stitch.spread


COLUMNS: Columns = (  # of the load steps of a stitch
    ("stitch", lambda loads: loads[-1].pattern),
    ("throw turns by [°]", lambda loads: f"{loads[-1].throw:g}"),
    ("rings a corner", lambda loads: f"{loads[-1].rings}"),
    ("μ [-]", lambda loads: f"{loads[-1].mu:.4f}"),
    ("fitted to [N]", lambda loads: f"{loads[-1].fitted:g}"),
    ("pull [N]", lambda loads: f"{closing_pull(loads):.3g}"),
    ("capstan [N]", lambda loads: f"{by_capstan(loads[-1]):.3g}"),
    ("published [N]", lambda loads: loads[-1].stitch.text),
    ("off by [SD]", lambda loads: "fitted" if loads[-1].pattern == FITTED else f"{off_published(loads):+.2f}"),
    ("slides everywhere", lambda loads: "yes" if loads[-1].slides else "NO"),
)


def table(rows: Sequence[Row]) -> Table:
    """Make a line a case and stitch."""
    return Table.of(COLUMNS, [loads for case in cases_of(rows) for loads in loads_of(rows, case).values()])


def remarks(rows: Sequence[Row]) -> list[str]:
    """Return remarks on the fit, the agreement, the error of the capstan, and open points."""
    middle = middle_case(rows)
    out = [*(case_words(rows, case) for case in cases_of(rows)), spread_words(rows, middle[0], middle[2])]
    out.append(
        "how far a throw turns its strands is ASSUMED, and so is that thread rubs on thread as it does on neoprene: "
        "with either of its own, μ would be one of two free numbers"
    )
    pulleys = [closing_pull(loads["pulley"]) for case in cases_of(rows) if "pulley" in (loads := loads_of(rows, case))]
    if pulleys:
        value, spread = MODIFIED
        here = " to ".join(dict.fromkeys(f"{pull:.3g}" for pull in (min(pulleys), max(pulleys))))
        out.append(
            f"modified pulley: LEFT OPEN, published {value:g} ± {spread:g} N; the abstract does not say how it was "
            "laid. A closed loop crosses the wound two, four or six times, and by the capstan a loop that crosses four "
            "times, its throw over the wound, needs what the pulley does, "
            f"{here} N here, in whatever order it passes its holes"
        )
    out.append(
        "mattress stitches: the throw lies over one lip, as these stitches are tied; what exactly was pulled, and "
        "which way, the abstract does not say"
    )
    stuck = [f"{row.pattern}, throw {row.throw:g}°" for row in rows if row.kind == "strand" and not row.slides]
    return out + [f"{name}: the thread does NOT slide everywhere" for name in dict.fromkeys(stuck)]


def case_words(rows: Sequence[Row], case: Case) -> str:
    """Return the prediction of a case and its error, in words."""
    loads, said = loads_of(rows, case), []
    for name, steps in loads.items():
        if name != FITTED:
            pull, off = closing_pull(steps), off_published(steps)
            word = "agrees" if abs(off) <= AGREES else "DISAGREES"
            far = f"({off:+.2f} SD; {pull / by_capstan(steps[-1]) - 1.0:+.1%} of the capstan)"
            said.append(f"{name} {pull:.3g} N, published {steps[-1].stitch.text}: {word} {far}")
    return (
        f"throw {case[0]:g}°, {case[1]} rings a corner: μ = {loads[FITTED][-1].mu:.4f} by the single stitch at "
        f"{case[2]:.3g} N; " + "; ".join(said)
    )


def spread_words(rows: Sequence[Row], throw: float, fitted: float) -> str:
    """Return the spread of the predictions over that of the fitted pull, by the capstan, in words."""
    away = [fitted + sign * PATTERNS[FITTED].spread for sign in (-1.0, 1.0)]
    others = dict.fromkeys(row.pattern for row in rows if row.pattern != FITTED)
    pulls = {name: [predicted_by_capstan(name, throw, pull) for pull in away] for name in others}
    said = ", ".join(f"{name} {few:.3g} to {many:.3g} N" for name, (few, many) in pulls.items())
    return f"throw {throw:g}°, fitted to {away[0]:.3g} to {away[1]:.3g} N instead, by the capstan: {said}"


def middle_case(rows: Sequence[Row]) -> Case:
    """Return the case that the others vary: the middle throw, first in its order."""
    throws = sorted({row.throw for row in rows})
    return next(case for case in cases_of(rows) if case[0] == throws[len(throws) // 2])


def figure(rows: Sequence[Row]) -> Figure:
    """Draw published and predicted pulls, their dependences, the load steps, and the tension along the thread."""
    case = middle_case(rows)
    loads, strands = loads_of(rows, case), loads_of(rows, case, "strand")
    names, same = list(loads), [other for other in cases_of(rows) if other[1:] == cases_of(rows)[0][1:]]
    predicted = {
        f"throw {throw:g}°, {rings} rings, fitted to {fitted:.3g} N": [
            (k + 0.1, closing_pull(loads_of(rows, (throw, rings, fitted))[name])) for k, name in enumerate(names)
        ]
        for throw, rings, fitted in cases_of(rows)
    }
    over_throw = {name: [(each[0], closing_pull(loads_of(rows, each)[name])) for each in same] for name in names}
    mean, deviation = np.array([(PATTERNS[name].published, PATTERNS[name].spread) for name in names]).T
    by_hand = [np.vectorize(partial(predicted_by_capstan, name, fitted=case[2])) for name in names]
    law = partial(bent_ratio, loads[FITTED][0].mu)
    closing = [Way.of(PATTERNS[name], case[0], case[1]).closing(law) for name in names]
    sticks = {name: [row for row in steps if not row.slides] for name, steps in loads.items()}
    marks = ("o", "s", "D", "x")  # the last stands on the one before, whose numbers are the same
    bars: dict[str, Any] = {"fmt": "k_", "capsize": 4, "label": "published, ± SD"}
    last, small = max(row.pull for steps in loads.values() for row in steps), {"fontsize": 7}
    turn, high = np.linspace(0.0, max(row.turn for run in strands.values() for row in run), 50), (0.0, 13.0)
    return draw(
        [
            panel(
                "stitch", "pull that closes 5 N [N]", series(predicted, 0, 1, ""),
                lambda axes: axes.errorbar(range(len(names)), mean, deviation, **bars),
                lambda axes: axes.set_xticks(range(len(names)), [name.replace(" ", "\n") for name in names]),
                ylim=high, legend=small,
            ),
            panel(
                "turn of a strand in the throw [°]", "pull that closes 5 N [N]", series(over_throw, 0, 1, "", marks),
                laws(by_hand, np.linspace(90.0, 360.0, 28)), curve([], [], "capstan"), ylim=high, legend=small,
            ),
        ],
        [
            panel(
                "pull of each hand [N]", "wound's tension [N]", series(loads, "pull", "tension", "", marks),
                series(unnamed(sticks), "pull", "tension", "", marks, markerfacecolor="white"),
                laws([partial(np.multiply, factor) for factor in closing], np.array([0.0, last])),
                level("y", WOUND, None, ":"), curve([], [], "a thread that bends and slides"), legend=small,
                title=f"load steps, throw {case[0]:g}°, hollow: sticks in a ring yet",
            ),
            panel(
                "turned since the nearer hand [°]", "tension over pull [-]",
                series(strands, "turn", lambda row: row.tension / row.pull, "", marks),
                curve(turn, np.exp(-loads[FITTED][0].mu * np.radians(turn)), "capstan, the same μ"), log="y",
                title=f"along the thread, throw {case[0]:g}°", legend=small,
            ),
        ],
    )  # fmt: skip


STUDY = Study(
    main=main,
    question="Which pull on the first throw closes a wound under 5 N with a single, pulley or mattress stitch, and is "
    "it what was measured?",
    independent="pulls that were measured, one coefficient fitted to the first; the capstan",
    consistency="load steps, rings a corner, and the product over rings of a thread that bends",
    table=table,
    figure=figure,
    remarks=remarks,
    quick={
        "throws": (270.0,),
        "patterns": (FITTED, "pulley"),
        "load_steps": 2,
        "control_points": 12,
    },
)
