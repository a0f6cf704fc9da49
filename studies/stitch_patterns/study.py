"""Stitch patterns: the pull on the first throw that closes a wound under tension.

The patterns are a single stitch, a pulley and two mattress stitches. Marsidi, Vermeulen, Horeman &
Genders (J. Surg. Res. 255 (2020) 135, abstract read) closed a wound model of neoprene under 5 N
with five stitches, and measured the pull on the first throw. A loop that crosses a wound several
times is a tackle: without friction each of n crossing strands bears the same, 1/n of the wound's
tension. Friction reduces it at every turn.

*Model.* The lips are closed and fixed; the force of the thread on one lip across the wound is the
wound's tension. A hole turns the thread by 90° at the skin and by 90° below it, each over a row of
rough rings fixed in space. Both hands pull equally. The throw also turns each strand, over rings
that belong to no lip; in a mattress stitch it lies on one side of the wound. One μ, for thread on
skin and for thread on thread, is fitted to the single stitch; the other pulls are predictions. The
capstan law estimates their error for a pull of the single stitch one standard deviation away.

*Assumed.* The turn of a strand in a throw is not published. The minimum of a half knot are two
strands that twist around each other by one and a half turns. At a pitch angle α each then bends by
540° sin α: 180° to 360° for 20° to 42°. The abstract also does not describe the modified pulley
stitch, so it is not run. Sizes have no effect if the rings are many √(EI/T) apart.

*By hand.* A strand that has turned by φ from its hand bears exp(−μφ) of the pull (capstan). For a
bending thread this is the product over the rings of `studies.theory.bent_ratio`.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from matplotlib.figure import Figure
from scipy.optimize import brentq

from coupling.run.run import Run, begin
from studies.arrays import Array
from studies.figure import curve, described, deviations, draw, laws, level, series
from studies.friction.study import laid_through
from studies.lists import sentences, study_list
from studies.study import Table, columns_of, each, grouped, require, require_known, unit_field
from studies.theory import bent_ratio, capstan
from thread.catalogue import suture
from thread.ends import Pulled
from thread.path import rounded_path

WOUND = 5.0  # tension of the wound [N]
SUTURE = "3-0 polypropylene"  # assumed
X, Y, Z = np.eye(3)
RING, STRAIGHT, ARM = 4e-3, 6e-3, 8e-3  # between rings of a corner, between corners, from the last ring to a hand [m]
SLACK = 1.005  # rest length over the polygon of rings: the thread begins slack, and slides towards both hands
MOST = 1.0  # coefficient of friction [-]: upper limit of the fit
AGREES = 1.0  # standard deviations: a prediction within this agrees
LEFT, RIGHT = False, True  # lip

Pull = Callable[["Way", float, float], Iterator[tuple[float, Run]]]  # the equilibria of a way, for a μ and a pull [N]
Law = Callable[[float], float]  # ratio of tensions at one ring, by the angle of the turn [rad]


@dataclass(frozen=True)
class Pattern:
    """A stitch.

    `published` is its pull and `spread` the standard deviation [N]. `first` is the direction of the
    strand from the throw. `corners` are the corners of the loop back to the throw, each with its
    new direction and its lip.
    """

    published: float
    spread: float
    first: Array
    corners: tuple[tuple[Array, bool], ...]

    @property
    def text(self) -> str:
        """The published pull and its standard deviation [N]."""
        return f"{self.published:g} ± {self.spread:g}"


LOOP = ((-Z, LEFT), (X, LEFT), (Z, RIGHT), (-X, RIGHT))  # through both lips, and back over the wound
BACK = ((-Z, RIGHT), (-X, RIGHT), (Z, LEFT))  # through both lips in the other direction
PATTERNS = {
    "single": Pattern(5.69, 0.88, -X, LOOP),
    "pulley": Pattern(3.46, 0.61, -X, LOOP * 2),
    "vertical mattress": Pattern(7.25, 1.33, -X, (*LOOP, *BACK, (-X, LEFT))),
    "horizontal mattress": Pattern(8.11, 1.00, -Y, (*LOOP[:3], (Y, RIGHT), *BACK, (-Y, LEFT))),
}
say = sentences(study_list("stitch_patterns")["words"])
FITTED = "single"  # stitch of the fit of μ


@dataclass(frozen=True, kw_only=True)
class Row:
    """A load step of a stitch, or a strand between two rings at the last load step.

    The `kind` is "load" or "strand". For a strand, `turn` is the turn from its nearer hand, and
    `tension` its own tension. For a load step, `tension` is the force of the thread on a lip,
    across the wound.
    """

    kind: str
    pattern: str
    throw: float = unit_field("degree")
    rings: int = unit_field("-")  # per corner
    mu: float = unit_field("-")
    pull: float = unit_field("N")
    turn: float = unit_field("degree")
    tension: float = unit_field("N")
    slides: bool  # in all rings except two in the middle, towards the nearer hand

    @property
    def stitch(self) -> Pattern:
        """The stitch of this row."""
        return PATTERNS[self.pattern]

    @property
    def closing_pull(self) -> float:
        """The pull that closes the wound [N], by proportion."""
        return WOUND * self.pull / self.tension

    @property
    def off_published(self) -> float:
        """Number of standard deviations above the published pull."""
        return (self.closing_pull - self.stitch.published) / self.stitch.spread

    @property
    def by_capstan(self) -> float:
        """The pull that closes the wound by the capstan law only [N]."""
        return predicted_by_capstan(self.pattern, self.throw)


def main(
    throws: Sequence[float] = (180.0, 270.0),
    patterns: Sequence[str] = tuple(PATTERNS),
    rings: int = 2,
    load_steps: int = 4,
    control_points: int = 24,
) -> Iterator[Row]:
    """Yield the load steps and strands of every stitch for every turn of a throw [degree].

    `rings` are per corner, `control_points` per ring. Raises `StudyError`.
    """
    require_known("patterns", patterns, PATTERNS)
    allowed = min(throws) > 0.0 and max(throws) <= 360.0 and rings >= 2
    remedy = "give turns above 0 up to 360 degrees, and two or more rings per corner"
    require(allowed, f"throws = {list(throws)}, rings = {rings}", remedy)
    require(FITTED in patterns, f"patterns = {list(patterns)}", f"μ is fitted to {FITTED!r}; add it")
    how = partial(pulled, load_steps=load_steps, control_points=control_points)
    yield from each([partial(stitches, throw, rings, tuple(patterns), how) for throw in throws])


def stitches(throw: float, rings: int, patterns: Sequence[str], how: Pull) -> Iterator[Row]:
    """Yield the rows of all stitches, pulled by `how`.

    Their μ is fitted to the published pull of the single stitch.
    """
    mu = fit(throw, rings, PATTERNS[FITTED].published, how)
    for name in patterns:
        way = Way.of(PATTERNS[name], throw, rings)
        pull = WOUND / way.closing(partial(bent_ratio, mu))
        case = Row(
            kind="load", pattern=name, throw=throw, rings=rings, mu=mu, pull=pull, turn=0.0, tension=np.nan,
            slides=False,
        )  # fmt: skip
        for share, run in how(way, mu, pull):
            case = replace(case, pull=share * pull, tension=across(way, run), slides=is_sliding(way, run))
            yield case
        for turn, hole in zip(np.degrees(way.from_hand), run.piercings[:-1], strict=True):
            yield replace(case, kind="strand", turn=float(turn), tension=hole.tension_after)


def fit(throw: float, rings: int, pull: float, how: Pull) -> float:
    """Return the μ fitted to the pull [N] that closes a single stitch.

    A first fit by the law of a bending thread is corrected once by the error of a run.
    """
    way = Way.of(PATTERNS[FITTED], throw, rings)
    guess = way.friction(bent_ratio, WOUND / pull)
    *_, (_, run) = how(way, guess, pull)
    return way.friction(bent_ratio, (WOUND / pull) ** 2 / (across(way, run) / pull))


# --- the way of a thread ----------------------------------------------------------------------------------


@dataclass(frozen=True)
class Way:
    """The polygon of a thread.

    It has the `headings` (k + 1, 3) and `lengths` (k + 1,) [m] of its sides. `on_right` (k,) tells
    which of its k corners, the rings, are on the right lip.
    """

    headings: Array
    lengths: Array
    on_right: Array

    @classmethod
    def of(cls, pattern: Pattern, throw: float, rings: int) -> "Way":
        """Return the way of a stitch from hand to hand.

        It has `rings` per corner. `throw` [degree] is the turn of each strand.
        """
        turns = max(1, round(rings * throw / 90.0))
        angles = np.radians(throw) * np.arange(turns + 1) / turns
        headings = list(turned(pattern.first, Z, angles[::-1]))
        for heading, _ in pattern.corners:
            headings += list(turned(headings[-1], heading, 0.5 * np.pi * np.arange(1, rings + 1) / rings))
        headings += list(turned(headings[-1], Z, angles[1:]))
        counts = [turns, *[rings] * len(pattern.corners), turns]
        corner = np.repeat(np.arange(len(counts)), counts)
        lengths = [ARM, *np.where(np.diff(corner) == 0, RING, STRAIGHT), ARM]
        on_right = np.repeat([False, *(lip for _, lip in pattern.corners), False], counts)
        return cls(np.array(headings), np.array(lengths), on_right)

    @property
    def corners(self) -> Array:
        """Rings, with a hand before and after them, shape `(k + 2, 3)` [m]."""
        return np.cumsum(np.vstack([np.zeros(3), self.lengths[:, None] * self.headings]), axis=0)

    @property
    def turns(self) -> Array:
        """Turn of the thread at each ring, shape `(k,)` [rad]."""
        return np.arccos(np.clip(np.sum(self.headings[:-1] * self.headings[1:], axis=1), -1.0, 1.0))

    @property
    def from_hand(self) -> Array:
        """Turn of the thread from the nearer hand at each inner side, shape `(k − 1,)` [rad]."""
        turned_by = np.cumsum(self.turns)
        return np.minimum(turned_by, turned_by[-1] - turned_by)[:-1]

    def closing(self, law: Law) -> float:
        """Return the force of the thread on the right lip, over the pull of each hand [-].

        The force is across the wound, for a `law`.
        """
        loss = np.concatenate([[0.0], np.cumsum(np.log([law(turn) for turn in self.turns]))])
        tensions = np.exp(-np.minimum(loss, loss[-1] - loss))[:, None] * self.headings
        return float((tensions[:-1] - tensions[1:])[self.on_right, 0].sum())

    def friction(self, law: Callable[[float, float], float], closing: float) -> float:
        """Return the μ for which a `law` of μ and the turn gives this ratio `closing`."""
        return float(brentq(lambda mu: self.closing(partial(law, mu)) - closing, 1e-6, MOST))


def turned(heading: Array, towards: Array, angles: Array) -> Array:
    """Return a unit vector turned by `angles` (k,) [rad], shape `(k, 3)`.

    It turns towards a perpendicular unit vector.
    """
    return np.outer(np.cos(angles), heading) + np.outer(np.sin(angles), towards)


# --- the coupled system -----------------------------------------------------------------------------------


def pulled(way: Way, mu: float, pull: float, *, load_steps: int, control_points: int) -> Iterator[tuple[float, Run]]:
    """Yield the equilibria of a suture in rough rings along a way, with the share of the pull.

    Both ends are pulled by `pull` [N], in equal steps.
    """
    corners, radius = way.corners, 0.25 * RING
    path = rounded_path(corners, radius)
    saved = radius * (2.0 * np.tan(0.5 * way.turns) - way.turns)  # by a rounded corner
    stretch = path.length / (SLACK * way.lengths.sum())
    s = (np.cumsum(way.lengths[:-1]) - np.cumsum(saved) + 0.5 * saved) / stretch
    hands = Pulled(-pull * way.headings[0]), Pulled(pull * way.headings[-1])
    run = begin(*laid_through(corners[1:-1], mu, path, s, hands, suture(SUTURE), control_points, stretch))
    for share in np.arange(1, load_steps + 1) / load_steps:
        run = run.load(float(share), 1.0)
        yield float(share), run


def across(way: Way, run: Run) -> float:
    """Return the force of the thread on the right lip, across the wound [N]."""
    return float(run.state.lam[way.on_right, 0].sum())


def is_sliding(way: Way, run: Run) -> bool:
    """Return whether the thread slides towards its nearer hand in all rings.

    One or two rings in the middle are not tested.
    """
    half = (way.on_right.size - 1) // 2
    sigma = run.state.sigma
    return bool((sigma[:half] > 0.0).all() and (sigma[-half:] < 0.0).all())


# --- table and figure -------------------------------------------------------------------------------------


def ends(rows: Sequence[Row]) -> list[Row]:
    """Return the last load step of every stitch for every throw."""
    loads = grouped((row for row in rows if row.kind == "load"), lambda row: (row.throw, row.pattern))
    return [steps[-1] for steps in loads.values()]


def of_middle_throw(rows: Sequence[Row], kind: str) -> dict[str, list[Row]]:
    """Return the load steps, or the strands, by stitch, for the middle throw."""
    throws = sorted({row.throw for row in rows})
    case = kind, throws[len(throws) // 2]
    return grouped((row for row in rows if (row.kind, row.throw) == case), lambda row: row.pattern)


def predicted_by_capstan(name: str, throw: float, fitted: float = PATTERNS[FITTED].published) -> float:
    """Return the pull [N] that closes the wound by the capstan law only.

    Its own μ is fitted to the pull `fitted` of the single stitch.
    """
    mu = Way.of(PATTERNS[FITTED], throw, 1).friction(capstan, WOUND / fitted)
    return WOUND / Way.of(PATTERNS[name], throw, 1).closing(partial(capstan, mu))


def table(rows: Sequence[Row]) -> Table:
    """Return the table with a line for each throw and stitch."""
    columns = columns_of(
        "stitch_patterns",
        off=lambda row: "fitted" if row.pattern == FITTED else f"{row.off_published:+.2f}",
        everywhere=lambda row: "yes" if row.slides else "NO",
    )
    return Table.of(columns, ends(rows))


def remarks(rows: Sequence[Row]) -> Iterator[str]:
    """Yield remarks on the fit, the agreement, the error of the capstan, and open points."""
    found = ends(rows)
    yield from map(case_words, grouped(found, lambda row: row.throw).values())
    yield spread_words(found, of_middle_throw(rows, "load")[FITTED][-1])
    yield say("assumed")
    yield say("open")
    for row in (row for row in found if not row.slides):
        yield f"{row.pattern}, throw {row.throw:g}°: the thread does NOT slide everywhere"


def case_words(found: Sequence[Row]) -> str:
    """Return the predictions for a throw and their errors, in words."""
    fitted, predictions = next(row for row in found if row.pattern == FITTED), []
    for row in found:
        if row is not fitted:
            word = "agrees" if abs(row.off_published) <= AGREES else "DISAGREES"
            far = f"({row.off_published:+.2f} SD; {row.closing_pull / row.by_capstan - 1.0:+.1%} of the capstan)"
            predictions.append(f"{row.pattern} {row.closing_pull:.3g} N, published {row.stitch.text}: {word} {far}")
    return say("case", fitted=fitted, said="; ".join(predictions))


def spread_words(found: Sequence[Row], fitted: Row) -> str:
    """Return the range of the predictions over the spread of the fitted pull, in words.

    The predictions are by the capstan law.
    """
    away = [fitted.stitch.published + sign * fitted.stitch.spread for sign in (-1.0, 1.0)]
    others = dict.fromkeys(row.pattern for row in found if row.pattern != FITTED)
    pulls = {name: [predicted_by_capstan(name, fitted.throw, pull) for pull in away] for name in others}
    ranges = ", ".join(f"{name} {few:.3g} to {many:.3g} N" for name, (few, many) in pulls.items())
    return f"throw {fitted.throw:g}°, fitted to {away[0]:.3g} to {away[1]:.3g} N instead, by the capstan: {ranges}"


def figure(rows: Sequence[Row]) -> Figure:
    """Return the figure of pulls, load steps, and tension along the thread."""
    loads, strands, found = of_middle_throw(rows, "load"), of_middle_throw(rows, "strand"), ends(rows)
    names, fitted = list(loads), loads[FITTED][-1]
    predicted = grouped(found, lambda row: f"throw {row.throw:g}°")
    stitches = [PATTERNS[name] for name in names]
    by_hand = [np.vectorize(partial(predicted_by_capstan, name)) for name in names]
    law = partial(bent_ratio, fitted.mu)
    closing = [Way.of(stitch, fitted.throw, fitted.rings).closing(law) for stitch in stitches]
    marks = ("o", "s", "D", "x")  # the last is drawn over the one before, which has the same numbers
    last = max(row.pull for steps in loads.values() for row in steps)
    turn = np.linspace(0.0, max(row.turn for run in strands.values() for row in run), 50)
    return draw(described(
        "stitch_patterns",
        [
            series(predicted, lambda row: names.index(row.pattern) + 0.1, "closing_pull", ""),
            deviations(
                range(len(names)), [stitch.published for stitch in stitches],
                [stitch.spread for stitch in stitches], "published, ± SD",
            ),
            lambda axes: axes.set_xticks(range(len(names)), [name.replace(" ", "\n") for name in names]),
        ],
        [
            series(grouped(found, lambda row: row.pattern), "throw", "closing_pull", "", marks),
            laws(by_hand, np.linspace(90.0, 360.0, 28)), curve([], [], "capstan"),
        ],
        [
            series(loads, "pull", "tension", "", marks),
            laws([partial(np.multiply, factor) for factor in closing], np.array([0.0, last])),
            level(WOUND, None, ":"), curve([], [], "a thread that bends and slides"),
        ],
        [
            series(strands, "turn", lambda row: row.tension / row.pull, "", marks),
            curve(turn, np.exp(-fitted.mu * np.radians(turn)), "capstan, the same μ"),
        ],
        throw=fitted.throw,
    ))  # fmt: skip
