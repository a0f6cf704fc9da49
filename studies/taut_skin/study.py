"""A wound in stretched, stiffening skin: how far does it gape, and which forces close it?

The sheet of `studies.wound_closure` is used on coarser cells at finite strain. It is exponential,
and has an in-plane tension before the cut, with the stretch and thickness of a sheet under this
tension. After the cut the wound gapes. One stitch per pitch, all drawn at once, then brings the
lips into contact. Every wound is also closed in the linear sheet of the same cells.

*Tension.* Natural tension of skin is published as 4 to 24 N/m (Alexander and Cook, J. Invest.
Dermatol. 69 (1977) 310, cited from memory). It is also published as a stress of 28 to 92 kPa, found
by inverse finite elements of the forearm and the upper arm (Flynn, Taberner and Nielsen, Ann.
Biomed. Eng. 39 (2011) 1935, its abstract). At the thickness of this sheet this is 42 to 138 N/m.
The maximum of the first and the middle of the second are run.

*Theory.* A slit has no width. After closing, the sheet is as before the cut. So the sum of its
stitch forces equals the former force across the slit, σ₀ t L, for any law. Here σ₀ is the stress of
the stretched sheet, t its thickness, and L the length.

*Published.* The pairs of wounds of `studies.wound_closure`: the ratio of the second force to the
first does not need a stiffness. Also strips of scalp of 10 to 15 mm, removed from 20 patients
(Ahmad, J. Cosmet. Dermatol. 2019, 10.1111/jocd.12739, its abstract): the mean pull on a loop that
closes them, by the width of the strip. Their length is not in the abstract, and is assumed
constant; in a linear sheet the pull is then proportional to the width.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from types import SimpleNamespace

import numpy as np
from matplotlib.figure import Figure
from scipy.optimize import brentq

from coupling.system import State
from studies.arrays import MILLI, Array
from studies.figure import COLOURS, curve, described, draw, level, series, unnamed
from studies.lists import sentences, study_list
from studies.study import Table, columns_of, each, grouped, measure, measured, require
from studies.theory import Fibrous
from studies.wounds import MOVES, NEAR, NU, PRECISE, SOURCES, STIFFNESS, THICKNESS, Case, E, Hands, Wound

SHEET, SIZE, FAR, PITCH, BITE = 0.12, 4e-3, 20e-3, 5e-3, 4e-3  # of the sheet, its cells and its stitches [m]
APPROACH = 2.5e-3  # largest step of closing the lips [m]
TENSIONS = (0.0, 24.0, 90.0)  # of the uncut sheet [N/m]
TAUT = 500.0  # [N/m]: far above published values of skin at rest
MEASURED = SOURCES[1:]  # pairs; the finite elements belong to the linear sheet, and 30 × 15 mm cannot be closed here
SLIT = (0.030, 0.0)  # length and width [m]
WOUNDS = (SLIT, *(wound for source in MEASURED for wound in source.wounds))
POUND = 4.4482216  # pound-force [N]
STRIPS = {10: 0.90, 11: 2.693, 12: 2.445, 13: 2.545, 14: 2.701, 15: 3.063}  # width [mm]: pull [lbf], Ahmad 2019
LINEAR_SHEET = "linear sheet"
say = sentences(study_list("taut_skin")["words"])


@dataclass(frozen=True)
class Skin:
    """Exponential skin of `wound_closure`'s E and ν.

    It has a stiffening b [-] and a tension σ₀ t in its plane [N/m].
    """

    stiffening: float
    tension: float

    @property
    def name(self) -> str:
        """The skin in words."""
        return f"b = {self.stiffening:g}" + (f", {self.tension:g} N/m" if self.tension else "")

    @property
    def tissue(self) -> Fibrous:
        """The law of the skin."""
        return Fibrous(E, NU, self.stiffening)

    def tension_at(self, stretch: float) -> float:
        """Return σ₀ t of the uncut sheet at an in-plane stretch [N/m]."""
        thinned = self.tissue.thinned(stretch)
        return float(self.tissue.stress(stretch, stretch, thinned)[0, 0]) / (stretch * thinned) * THICKNESS

    @cached_property
    def stretch(self) -> float:
        """In-plane stretch at which the sheet has its tension [-]."""
        return float(brentq(lambda x: self.tension_at(x) - self.tension, 1.0, 2.0)) if self.tension else 1.0

    @property
    def keys(self) -> Mapping[str, object]:
        """The keys of the skin in a scenario."""
        in_plane = self.stretch
        stretched = {"prestretch": [in_plane, in_plane, self.tissue.thinned(in_plane)]} if self.tension else {}
        return {"material": "exponential", "stiffening": self.stiffening, "inertia": False, **stretched}


@dataclass(frozen=True, kw_only=True)
class Row(Wound):
    """One wound, closed by stitches drawn all at once.

    Forces are for E = 0.8 MPa and proportional to E.
    """

    length: float = measured("m", lambda at: at.case.length)  # of the cut
    width: float = measured("m", lambda at: at.case.width)  # of the cut; 0 for a slit
    skin: str = measured("", lambda at: at.skin.name if at.skin else LINEAR_SHEET)
    stiffening: float = measured("-", lambda at: at.skin.stiffening if at.skin else 0.0)
    stretch: float = measured("-", lambda at: at.skin.stretch if at.skin else 1.0)  # before the cut
    tension: float = measured("N/m", lambda at: at.skin.tension if at.skin else 0.0)  # of the uncut sheet
    opened: float = measured("m", lambda at: at.opened.max())  # in the middle, before closing
    unknowns: int = measured("", lambda at: at.hands.organ.size)
    places: tuple[float, ...] = measured("m", lambda at: at.case.places)  # of the stitches
    forces: tuple[float, ...] = measured("N", lambda at: at.hands.forces(at.state))
    widest: float = measured("m", lambda at: at.hands.gaps(at.state, at.case.places).max())  # remaining gap at a stitch
    contact_force: float = measured("N", lambda at: at.state.organ.p.sum())
    closed: bool  # within the tolerance

    @property
    def of_tension(self) -> float:
        """Force of all stitches over the force of the uncut sheet, σ₀ t L [-]."""
        return sum(self.forces) / (self.tension * self.length) if self.tension else float("nan")

    @property
    def crack(self) -> float:
        """Opening of a crack of the same length in a large linear sheet, 2 σ₀ L/E [m]."""
        return 2.0 * self.tension * self.length / STIFFNESS

    @property
    def shares(self) -> Array:
        """Force of each stitch over its share of σ₀ t L [-]."""
        return np.array(self.forces) * len(self.forces) / (self.tension * self.length)


def main(
    wounds: Sequence[tuple[float, float]] = WOUNDS,
    tensions: Sequence[float] = TENSIONS,
    stiffening: float = 5.0,
    sheet: float = SHEET,
    size: float = SIZE,
    far: float = FAR,
) -> Iterator[Row]:
    """Yield every wound in the linear sheet and in skin of every tension.

    A slit is run only in skin under tension.

    Raises `StudyError` for wounds that do not fit, and for skin under compression.
    """
    allowed = min(tensions) >= 0.0 and max(tensions) <= TAUT
    remedy = f"give 0 (no tension) to {TAUT:g}; compression is not allowed"
    require(allowed, f"tensions = {list(tensions)} N/m", remedy)
    require(stiffening > 0.0, f"stiffening = {stiffening}", "give a number above 0; soft tissue has about 5")
    skins = [Skin(stiffening, tension) for tension in tensions]
    cases = [Case(length, width, sheet, size, far, PITCH, BITE) for length, width in wounds]
    yield from each([partial(close_wound, case, skins) for case in cases])


def close_wound(case: Case, skins: Sequence[Skin]) -> Iterator[Row]:
    """Yield the wound closed in the linear sheet, if it has a width, and in each skin."""
    linear = Hands(replace(case, width=case.width or APPROACH))
    if case.width:
        all_of_them = np.ones(len(case.places), dtype=bool)
        state, done = linear.tighten(linear.straight_state, all_of_them, ~all_of_them)
        yield row_of(linear, None, state, np.array([case.width]), done)
    for skin in skins:
        if case.width or skin.tension:
            yield close_skin(Hands(case, skin.keys), skin, linear.answers[0])


def close_skin(hands: Hands, skin: Skin, answer: Array) -> Row:
    """Return the wound closed in steps.

    `answer` is the closing of the linear sheet's lips per drawn stitch [-].
    """
    state, y = hands.straight_state, hands.case.places
    opened = hands.gaps(state, y)
    limit, bits = PRECISE * opened.max(), int(np.ceil(opened.max() / APPROACH))
    for bit in range(1, bits + 1):
        goal = opened * (1.0 - (1.0 - NEAR) * bit / bits)
        missing = partial(beyond_goal, hands, goal)
        state, answer, left = hands.reach(state, missing, answer, limit, moves=MOVES if bit == bits else 1)
        if np.isinf(left).any():
            break
    return row_of(hands, skin, state, opened, bool(np.abs(left).max() <= limit))


def beyond_goal(hands: Hands, goal: Array, state: State) -> Array:
    """Return the distance of the lips above a goal at each stitch [m]."""
    return hands.gaps(state, hands.case.places) - goal


def row_of(hands: Hands, skin: Skin | None, state: State, opened: Array, closed: bool) -> Row:
    """Return the row of a wound, `closed` or partly closed, in a skin.

    None means the linear sheet. `opened` is its width at the stitches before closing [m].
    """
    end = SimpleNamespace(case=hands.case, hands=hands, skin=skin, state=state, opened=opened)
    return measure(Row, end, closed=closed)


# --- what the rows say ------------------------------------------------------------------------------------


def ratios(rows: Sequence[Row]) -> Iterator[SimpleNamespace]:
    """Yield the force ratios of the second to the first wound of every published pair [-].

    A ratio has its `source` and `skin`. It is the `published` one, the one `by_law` W/L, and the
    one `found` in this skin.
    """
    for source in SOURCES:
        (l1, w1), (l2, w2) = source.wounds
        known = {"source": source.name, "published": source.forces[1] / source.forces[0]}
        known["by_law"] = (w2 / l2) / (w1 / l1)
        for skin in dict.fromkeys(row.skin for row in rows):
            found = {row.wound: row.middle for row in rows if row.skin == skin and row.closed}
            if all(wound in found for wound in source.wounds):
                share = found[source.wounds[1]] / found[source.wounds[0]]
                yield SimpleNamespace(**known, skin=skin, found=share)


def table(rows: Sequence[Row]) -> Table:
    """Return the table with a line for each wound."""
    flat = {row.wound: row.middle for row in rows if row.skin == LINEAR_SHEET}
    columns = columns_of(
        "taut_skin",
        stitches=lambda row: str(len(row.forces)),
        stitch_forces=lambda row: f"{row.middle:.3f} / {max(row.forces):.3f} / {min(row.forces):.3f}",
        over_linear=lambda row: f"{row.middle / flat[row.wound]:.3f}" if row.wound in flat else "",
        share=lambda row: f"{row.of_tension:.3f}" if row.tension else "",
    )
    return Table.of(columns, rows)


def remarks(rows: Sequence[Row]) -> Iterator[str]:
    """Yield remarks on the slit, the predictions of each pair, and wounds that were not closed."""
    for row in rows:
        if not row.width:
            yield say("gapes", row=row, opened=row.opened / MILLI)
        if not row.closed:
            yield f"{row.name} mm, {row.skin}: the lips were NOT BROUGHT TOGETHER at every stitch"
    for ratio in ratios(rows):
        yield say("ratio", ratio=ratio, off=round(100 * (ratio.found / ratio.published - 1)))
    yield strips_words()


def strips_words() -> str:
    """Return in words the growth of the pull on strips of scalp with their width."""
    pulls = {width: POUND * pull for width, pull in STRIPS.items()}
    shown = ", ".join(f"{width} mm {pull:.1f} N" for width, pull in pulls.items())
    return say("strips", shown=shown, wide=pulls[15] / pulls[11], narrow=pulls[15] / pulls[10])


# --- figure -----------------------------------------------------------------------------------------------


def figure(rows: Sequence[Row]) -> Figure:
    """Return the figure of forces along wounds and slits, of gaping, and of published ratios."""
    wide, slits = [row for row in rows if row.width], [row for row in rows if not row.width]
    skins, names = (dict.fromkeys(getattr(row, key) for row in wide) for key in ("skin", "name"))
    forces = {
        skin: {f"{row.name} mm": row.course(row.places, np.array(row.forces)) for row in wide if row.skin == skin}
        for skin in skins
    }
    styles = dict(zip(skins, (":", "--", "-", "-."), strict=False))
    legend = [curve([], [], f"{name} mm", "-", of) for name, of in zip(names, COLOURS, strict=False)]
    legend += [curve([], [], skin, style) for skin, style in styles.items()]
    shares = {f"{r.name} mm, {r.skin}": r.course(r.places, r.shares) for r in slits}
    gaped = grouped((row for row in rows if row.tension), lambda row: f"{row.name} mm, {row.tension:g} N/m")
    most = [max(row.crack, row.opened - row.width) / MILLI for row in rows if row.tension]
    top = 1.1 * max(most, default=1.0)
    pairs = grouped(ratios(rows), lambda ratio: f"{ratio.source}, {ratio.skin}")
    scalp = {"Ahmad 2019, scalp, by width": [(pull / STRIPS[11], w / 11.0) for w, pull in STRIPS.items() if w > 11]}
    return draw(described(
        "taut_skin",
        [*legend, *(series(unnamed(of), 0, 1, styles[skin], [""]) for skin, of in forces.items())],
        [level(1.0), series(shares, 0, 1)],
        [
            series(gaped, "crack [mm]", lambda row: (row.opened - row.width) / MILLI, ""),
            curve([0.0, top], [0.0, top], None, "--"), {"xlim": (0.0, top), "ylim": (0.0, top)},
        ],
        [
            series(pairs, "published", "found", ""), series(scalp, 0, 1, "", ["x"], ["grey"]),
            curve([0.8, 4.0], [0.8, 4.0], None, "--"),
        ],
    ))  # fmt: skip
