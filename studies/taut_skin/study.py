"""A wound in skin that is stretched and stiffens: how far does it gape by itself, and which forces close it?

The sheet of `studies.wound_closure`, on coarser cells, at finite strain: exponential, with a tension in its plane that
it has before it is cut, and the stretch and thickness that go with it where nothing presses on it. Cut, the wound
gapes; one stitch a pitch, all drawn at once, then brings the lips together, which touch. Every wound is closed in the
linear sheet of the same cells too.

*Tension.* Natural tension of skin is published as 4 to 24 N/m (Alexander and Cook, J. Invest. Dermatol. 69 (1977) 310,
cited from memory) and as a stress of 28 to 92 kPa, found by inverse finite elements of the forearm and the upper arm
(Flynn, Taberner and Nielsen, Ann. Biomed. Eng. 39 (2011) 1935, its abstract), 42 to 138 N/m at the thickness of this
sheet: the most of the one and the middle of the other are run.

*Theory.* A slit has no width of its own. Closed again it leaves the sheet as it was, so its stitches bear in all what
the lips had borne, σ₀ t L, whatever the law: σ₀ is the stress of the stretched sheet, t its thickness, L the length.

*Published.* The pairs of wounds of `studies.wound_closure`: what the second takes over what the first does asks for no
stiffness. And strips of scalp of 10 to 15 mm, removed from 20 patients (Ahmad, J. Cosmet. Dermatol. 2019,
10.1111/jocd.12739, its abstract): the mean pull on a loop that closes them, by the width of the strip. Their length is
not in the abstract, and is taken to be the same; a linear sheet then asks for a pull that grows as the width.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from types import SimpleNamespace
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from scipy.optimize import brentq

from coupling.system import State
from studies.arrays import Array
from studies.figure import COLOURS, curve, draw, level, panel, series, unnamed
from studies.study import Columns, Table, described, each, grouped, measure, measured, require
from studies.theory import Fibrous
from studies.wounds import MILLI, MOVES, NEAR, NU, PRECISE, SOURCES, STIFFNESS, THICKNESS, Case, E, Hands, Wound

SHEET, SIZE, FAR, PITCH, BITE = 0.12, 4e-3, 20e-3, 5e-3, 4e-3  # of the sheet, its cells and its stitches [m]
APPROACH = 2.5e-3  # by which lips are drawn together at a time, at most [m]
TENSIONS = (0.0, 24.0, 90.0)  # of the uncut sheet [N/m]
TAUT = 500.0  # [N/m]: beyond what is published of skin at rest by far
MEASURED = SOURCES[1:]  # pairs; those of finite elements go with the linear sheet, and 30 × 15 mm is not closed here
SLIT = (0.030, 0.0)  # length and width [m]
WOUNDS = (SLIT, *(wound for source in MEASURED for wound in source.wounds))
POUND = 4.4482216  # pound-force [N]
STRIPS = {10: 0.90, 11: 2.693, 12: 2.445, 13: 2.545, 14: 2.701, 15: 3.063}  # width [mm]: pull [lbf], Ahmad 2019
LINEAR_SHEET = "linear sheet"


@dataclass(frozen=True)
class Skin:
    """Exponential skin of `wound_closure`'s E and ν, with a stiffening b [-] and a tension σ₀ t in its plane [N/m]."""

    stiffening: float
    tension: float

    @property
    def name(self) -> str:
        """In words."""
        return f"b = {self.stiffening:g}" + (f", {self.tension:g} N/m" if self.tension else "")

    @property
    def tissue(self) -> Fibrous:
        """Its law."""
        return Fibrous(E, NU, self.stiffening)

    def tension_at(self, stretch: float) -> float:
        """Return σ₀ t of the uncut sheet at a stretch in its plane [N/m]."""
        thinned = self.tissue.thinned(stretch)
        return float(self.tissue.stress(stretch, stretch, thinned)[0, 0]) / (stretch * thinned) * THICKNESS

    @cached_property
    def stretch(self) -> float:
        """Stretch in the plane at which the sheet bears its tension [-]."""
        return float(brentq(lambda x: self.tension_at(x) - self.tension, 1.0, 2.0)) if self.tension else 1.0

    @property
    def keys(self) -> Mapping[str, object]:
        """Those of the scenario."""
        in_plane = self.stretch
        stretched = {"prestretch": [in_plane, in_plane, self.tissue.thinned(in_plane)]} if self.tension else {}
        return {"material": "exponential", "stiffening": self.stiffening, "inertia": False, **stretched}


@dataclass(frozen=True, kw_only=True)
class Row(Wound):
    """One wound, closed by stitches drawn all at once. Forces are those of E = 0.8 MPa, and grow with it."""

    length: float = measured("m", lambda at: at.case.length)  # cut
    width: float = measured("m", lambda at: at.case.width)  # cut; 0 for a slit
    skin: str = measured("", lambda at: at.skin.name if at.skin else LINEAR_SHEET)
    stiffening: float = measured("-", lambda at: at.skin.stiffening if at.skin else 0.0)
    stretch: float = measured("-", lambda at: at.skin.stretch if at.skin else 1.0)  # before it was cut
    tension: float = measured("N/m", lambda at: at.skin.tension if at.skin else 0.0)  # of the uncut sheet
    opened: float = measured("m", lambda at: at.opened.max())  # in the middle, before it is closed
    unknowns: int = measured("", lambda at: at.hands.organ.size)
    places: tuple[float, ...] = measured("m", lambda at: at.case.places)  # of the stitches
    forces: tuple[float, ...] = measured("N", lambda at: at.hands.forces(at.state))
    widest: float = measured("m", lambda at: at.hands.gaps(at.state, at.case.places).max())  # gap left at a stitch
    contact_force: float = measured("N", lambda at: at.hands.organ.contact_forces(at.state.organ).sum())
    closed: bool  # as near as was asked

    @property
    def of_tension(self) -> float:
        """Force of all stitches over that of the uncut sheet, σ₀ t L [-]."""
        return sum(self.forces) / (self.tension * self.length) if self.tension else float("nan")

    @property
    def crack(self) -> float:
        """Opening of a crack as long in a large linear sheet, 2 σ₀ L/E [m]."""
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
    """Yield every wound in the linear sheet and in skin of every tension; a slit in skin that is taut alone.

    Raises `StudyError` for wounds that do not fit, and for skin that is pressed together.
    """
    allowed = min(tensions) >= 0.0 and max(tensions) <= TAUT
    remedy = f"give 0 for none to {TAUT:g}; skin is not pressed together"
    require(allowed, f"tensions = {list(tensions)} N/m", remedy)
    require(stiffening > 0.0, f"stiffening = {stiffening}", "give a number above 0; soft tissue has about 5")
    skins = [Skin(stiffening, tension) for tension in tensions]
    cases = [Case(length, width, sheet, size, far, PITCH, BITE) for length, width in wounds]
    yield from each([partial(close_wound, case, skins) for case in cases])


def close_wound(case: Case, skins: Sequence[Skin]) -> Iterator[Row]:
    """Yield the wound closed in the linear sheet, if it has a width, and in each skin."""
    linear = Hands.of(replace(case, width=case.width or APPROACH))
    if case.width:
        all_of_them = np.ones(len(case.places), dtype=bool)
        state, done = linear.tighten(linear.straight_state, all_of_them, ~all_of_them)
        yield row_of(linear, None, state, np.array([case.width]), done)
    for skin in skins:
        if case.width or skin.tension:
            yield close_skin(Hands.of(case, skin.keys), skin, linear.answers[0])


def close_skin(hands: Hands, skin: Skin, answer: Array) -> Row:
    """Return the closed wound, drawn together bit by bit; `answer` is the closing of the linear sheet's lips per drawn
    stitch [-]."""
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
    """Return by how much the lips are farther apart than a goal at each stitch [m]."""
    return hands.gaps(state, hands.case.places) - goal


def row_of(hands: Hands, skin: Skin | None, state: State, opened: Array, closed: bool) -> Row:
    """Return the row of a wound that is `closed` or as far as it was drawn together, in a skin, None for the linear
    sheet; `opened` is its width at the stitches before [m]."""
    end = SimpleNamespace(case=hands.case, hands=hands, skin=skin, state=state, opened=opened)
    return measure(Row, end, closed=closed)


# --- what the rows say ------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Ratio:
    """Force of the second of a published pair of wounds over that of the first: published, by W/L, and by runs in one
    skin [-]."""

    source: str
    skin: str
    published: float
    by_law: float
    found: float


def ratios(rows: Sequence[Row]) -> list[Ratio]:
    """Return those of every published pair that was run, by skin."""
    out = []
    for source in SOURCES:
        (l1, w1), (l2, w2) = source.wounds
        for skin in dict.fromkeys(row.skin for row in rows):
            found = {row.wound: row.middle for row in rows if row.skin == skin and row.closed}
            if all(wound in found for wound in source.wounds):
                share = found[source.wounds[1]] / found[source.wounds[0]]
                out.append(Ratio(source.name, skin, source.forces[1] / source.forces[0], (w2 / l2) / (w1 / l1), share))
    return out


def table(rows: Sequence[Row]) -> Table:
    """Make a line a wound."""
    flat = {row.wound: row.middle for row in rows if row.skin == LINEAR_SHEET}
    columns: Columns = (
        ("wound [mm]", lambda row: row.name),
        ("skin", lambda row: row.skin),
        ("σ₀ t [N/m]", lambda row: f"{row.tension:.3g}"),
        ("open [mm]", lambda row: f"{row.opened / MILLI:.2f}"),
        ("stitches", lambda row: str(len(row.forces))),
        ("middle / largest / smallest [N]", lambda r: f"{r.middle:.3f} / {max(r.forces):.3f} / {min(r.forces):.3f}"),
        ("over the linear sheet [-]", lambda r: f"{r.middle / flat[r.wound]:.3f}" if r.wound in flat else ""),
        ("all over σ₀ t L [-]", lambda row: f"{row.of_tension:.3f}" if row.tension else ""),
        ("lips press with [N]", lambda row: f"{row.contact_force:.2g}"),
        ("gap left [mm]", lambda row: f"{row.widest / MILLI:.3f}"),
    )
    return Table.of(columns, rows)


def remarks(rows: Sequence[Row]) -> list[str]:
    """Return remarks on the slit, the predictions of each pair, and wounds that were not closed."""
    out = []
    for row in rows:
        if not row.width:
            gapes = f"it gapes by {row.opened / MILLI:.2f} mm"
            bears = f"its stitches bear {row.of_tension:.3f} of what the uncut skin bears there"
            out.append(f"{row.name} mm, {row.skin}: {gapes}, and {bears}")
        if not row.closed:
            out.append(f"{row.name} mm, {row.skin}: the lips were NOT BROUGHT TOGETHER at every stitch")
    for ratio in ratios(rows):
        out.append(
            f"{ratio.source}, {ratio.skin}: the second wound takes {ratio.found:.2f} times the first; published "
            f"{ratio.published:.2f} ({round(100 * (ratio.found / ratio.published - 1)):+d} %), by width over length "
            f"{ratio.by_law:.2f}"
        )
    return [*out, strips_words()]


def strips_words() -> str:
    """Say how the pull on strips of scalp grows with their width."""
    pulls = {width: POUND * pull for width, pull in STRIPS.items()}
    shown = ", ".join(f"{width} mm {pull:.1f} N" for width, pull in pulls.items())
    return (
        f"Ahmad 2019, strips of scalp, mean pull on one loop: {shown}. From 11 to 15 mm it grows "
        f"{pulls[15] / pulls[11]:.2f} times where the width grows {15 / 11:.2f} times, from 10 to 15 mm "
        f"{pulls[15] / pulls[10]:.2f} times where it grows 1.50 times: force ∝ width DISAGREES with both. What skin "
        "bears before it is cut would explain the first and stiffening the second, not both; how many patients had "
        "each width is not in the abstract"
    )


# --- figure -----------------------------------------------------------------------------------------------


def figure(rows: Sequence[Row]) -> Figure:
    """Draw the forces along the wounds, those of slits, how far wounds gape, and the published ratios."""
    wide, slits, found = [row for row in rows if row.width], [row for row in rows if not row.width], ratios(rows)
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
    pairs = grouped(found, lambda ratio: f"{ratio.source}, {ratio.skin}")
    scalp = {"Ahmad 2019, scalp, by width": [(pull / STRIPS[11], w / 11.0) for w, pull in STRIPS.items() if w > 11]}
    place, small = "place along the wound, over its half length [-]", {"fontsize": 6}
    half: dict[str, Any] = {"xlim": (-1.0, 1.0), "ylim": (0.0, None)}
    return draw(
        [
            panel(
                place, "force of a stitch [N]", *legend,
                *(series(unnamed(of), 0, 1, styles[skin], [""]) for skin, of in forces.items()),
                title="stitches drawn all at once", above=1.4, legend={"fontsize": 6, "ncols": 2}, **half,
            ),
            panel(
                place, "force / its share of σ₀ t L [-]", level("y", 1.0), series(shares, 0, 1),
                title="slits that gaped", legend=small, **half,
            ),
        ],
        [
            panel(
                "crack in a large linear sheet, 2 σ₀ L/E [mm]", "opened beyond what was cut [mm]",
                series(gaped, "crack [mm]", lambda row: (row.opened - row.width) / MILLI, ""),
                curve([0.0, top], [0.0, top], None, "--"), title="how far stretched skin gapes", legend=small,
                xlim=(0.0, top), ylim=(0.0, top),
            ),
            panel(
                "published, second wound over first [-]", "this study [-]", series(pairs, "published", "found", ""),
                series(scalp, 0, 1, "", ["x"], ["grey"]), curve([0.8, 4.0], [0.8, 4.0], None, "--"),
                title="pairs of wounds", legend=small,
            ),
        ],
    )  # fmt: skip


STUDY = described("taut_skin", main, table, figure, remarks)
