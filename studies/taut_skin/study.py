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

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray
from scipy.optimize import brentq
from threadpoolctl import threadpool_limits

import tissue
from coupling.errors import EquilibriumError
from coupling.system import State
from studies.arrays import Array
from studies.figure import COLOURS, MARKERS, panels
from studies.simulation.assembly import assemble
from studies.study import Job, Study, StudyError, Table, each, unit_field
from studies.wound_closure.study import (
    MILLI,
    MOVES,
    NEAR,
    NU,
    PRECISE,
    SOURCES,
    THICKNESS,
    Case,
    E,
    Hands,
    scenario,
)
from tissue.materials.density import Sum
from tissue.materials.isotropic import Exponential, Volumetric

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

    def stress(self, stretch: float, thinned: float) -> Array:
        """Return the first Piola stress of the uncut sheet from where it bears nothing `(3, 3)` [Pa], at a stretch in
        its plane and one across its thickness."""
        material = tissue.Material(E, NU, 1.0)
        density = Sum([Exponential(material.lame_mu, self.stiffening), Volumetric(material.bulk_modulus)])
        return np.asarray(density.stress(np.diag([stretch, stretch, thinned])[:, :, None])[:, :, 0])

    def thinned(self, stretch: float) -> float:
        """Return the stretch across the thickness at which nothing presses on the sheet [-]."""
        return float(brentq(lambda x: float(self.stress(stretch, x)[2, 2]), 0.5 / stretch**2, 1.5))

    def tension_at(self, stretch: float) -> float:
        """Return σ₀ t of the uncut sheet at a stretch in its plane [N/m]."""
        thinned = self.thinned(stretch)
        return float(self.stress(stretch, thinned)[0, 0]) / (stretch * thinned) * THICKNESS

    @cached_property
    def stretch(self) -> float:
        """That in the plane at which the sheet bears its tension [-]."""
        return float(brentq(lambda x: self.tension_at(x) - self.tension, 1.0, 2.0)) if self.tension else 1.0

    @property
    def keys(self) -> Mapping[str, object]:
        """Those of the scenario."""
        in_plane = self.stretch
        stretched = {"prestretch": [in_plane, in_plane, self.thinned(in_plane)]} if self.tension else {}
        return {"material": "exponential", "stiffening": self.stiffening, "inertia": False, **stretched}


@dataclass(frozen=True, kw_only=True)
class Row:
    """One wound, closed by stitches drawn all at once. Forces are those of E = 0.8 MPa, and grow with it."""

    length: float = unit_field("m")  # cut
    width: float = unit_field("m")  # cut; 0 for a slit
    skin: str
    stiffening: float = unit_field("-")
    stretch: float = unit_field("-")  # before it was cut
    tension: float = unit_field("N/m")  # of the uncut sheet
    opened: float = unit_field("m")  # in the middle, before it is closed
    unknowns: int
    places: tuple[float, ...] = unit_field("m")  # of the stitches
    forces: tuple[float, ...] = unit_field("N")
    widest: float = unit_field("m")  # gap that is left at a stitch
    contact_force: float = unit_field("N")
    closed: bool  # as near as was asked

    @property
    def wound(self) -> tuple[float, float]:
        """Length and width [m]."""
        return self.length, self.width

    @property
    def name(self) -> str:
        """The wound [mm]."""
        return f"{self.length / MILLI:g} × {self.width / MILLI:g}" if self.width else f"slit of {self.length / MILLI:g}"

    @property
    def middle(self) -> float:
        """Force of the stitch in the middle, or of the two next to it [N]."""
        n = len(self.forces)
        return float(np.mean(self.forces[(n - 1) // 2 : n // 2 + 1]))

    @property
    def of_tension(self) -> float:
        """What all stitches bear over what the uncut sheet bears there, σ₀ t L [-]."""
        return sum(self.forces) / (self.tension * self.length) if self.tension else float("nan")


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
    for length, width in wounds:
        if not (0.0 <= width <= length < 0.5 * sheet) or length < PITCH:
            reason = "a width up to the length, 0 for a slit, and a length from 5e-3 m to half the sheet's edge"
            raise StudyError(f"wounds: {length} × {width} m in a sheet of {sheet} m; give {reason}")
    if min(tensions) < 0.0 or max(tensions) > TAUT:
        raise StudyError(
            f"tensions = {list(tensions)} N/m is refused: give 0 for none to {TAUT:g}; skin is not pressed together"
        )
    if stiffening <= 0.0:
        raise StudyError(f"stiffening = {stiffening} is refused: give a number above 0; soft tissue has about 5")
    skins = [Skin(stiffening, tension) for tension in tensions]
    cases = [Case(length, width, sheet, size, far, PITCH, BITE) for length, width in wounds]
    with threadpool_limits(limits=1, user_api="blas"):
        jobs: list[Job] = [partial(close_wound, case, skins) for case in cases]
        yield from each(jobs)


def close_wound(case: Case, skins: Sequence[Skin]) -> Iterator[Row]:
    """Yield the wound closed in the linear sheet, if it has a width, and in each skin."""
    flat = replace(case, width=case.width or APPROACH)
    linear = Hands(flat, assemble(scenario(flat)))
    if case.width:
        n = len(case.places)
        state, done = linear.tighten(linear.straight_state, np.ones(n, dtype=bool), np.zeros(n, dtype=bool))
        yield Row(
            length=case.length,
            width=case.width,
            skin=LINEAR_SHEET,
            stiffening=0.0,
            stretch=1.0,
            tension=0.0,
            opened=case.width,
            unknowns=linear.organ.size,
            places=tuple(case.places.tolist()),
            forces=tuple(linear.forces(state).tolist()),
            widest=float(linear.gaps(state, case.places).max()),
            contact_force=float(linear.organ.contact_forces(state.organ).sum()),
            closed=done,
        )
    for skin in skins:
        if case.width or skin.tension:
            yield close_skin(TautHands(case, assemble(scenario(case, skin.keys))), skin, linear.answers[0])


@dataclass(frozen=True)
class TautHands(Hands):
    """Hands that draw the stitches of a sheet at finite strain."""

    @property
    def finite(self) -> tissue.FiniteOrgan:
        """The sheet."""
        assert isinstance(self.assembly.organ, tissue.FiniteOrgan)
        return self.assembly.organ

    @cached_property
    def straight_state(self) -> State:
        """Before anything is drawn: straight, every stitch as much longer as its holes have gone apart."""
        now, laid = (y.reshape(-1, 2, 9) for y in (self.finite.site_variables(self.finite.start()), self.finite.y0))
        apart, before = (np.linalg.norm(y[:, 0, :3] - y[:, 1, :3], axis=1) for y in (now, laid))
        longer = 0.5 * np.repeat(apart - before, 2) * np.tile([-1.0, 1.0], len(apart))
        gaping = replace(self.assembly, s=self.assembly.s + longer)
        return self.draw(gaping.start(), np.zeros(len(apart)))

    @cached_property
    def pairs(self) -> tuple[NDArray[np.intp], Array]:
        """Nodes of the lips on the sheet's upper side that lay across from one another, `(k, 2)`, and their places
        along the wound [m]."""
        gaps, at = self.finite.gaps, self.finite.elasticity.points
        assert gaps is not None
        nodes = gaps.nodes
        upper = np.flatnonzero(at[nodes[:, 0], 2] >= -1e-9 * THICKNESS)
        order = upper[np.argsort(at[nodes[upper, 0], 1])]
        return nodes[order], at[nodes[order, 0], 1]

    def gaps(self, state: State, y: Array) -> Array:
        """Return how far apart what lay across from one another is, across the wound, at y [m]."""
        body, (nodes, at) = self.finite.elasticity, self.pairs
        x = body.points[:, 0] + body.nodal(self.finite.displacement(state.organ))[:, 0]
        end = 0.5 * self.case.length
        return np.interp(y, [-end, *at, end], [0.0, *(x[nodes[:, 1]] - x[nodes[:, 0]]), 0.0])


def close_skin(hands: TautHands, skin: Skin, answer: Array) -> Row:
    """Return the wound closed bit by bit; `answer` is by how much the linear sheet's lips close at the stitches, as
    each is drawn [-]. Broyden's method learns what stiffening and contact change."""
    case, state = hands.case, hands.straight_state
    opened = hands.gaps(state, case.places)
    limit, bits = PRECISE * opened.max(), int(np.ceil(opened.max() / APPROACH))
    for bit in range(1, bits + 1):
        goal = opened * (1.0 - (1.0 - NEAR) * bit / bits)
        missing = hands.gaps(state, case.places) - goal
        for _ in range(MOVES if bit == bits else 1):
            if np.abs(missing).max() <= limit:
                break
            step = np.linalg.solve(answer, -missing)
            try:
                state = hands.draw(state, np.asarray(step))
            except EquilibriumError:
                return closed_skin(hands, skin, state, opened, False)
            before, missing = missing, hands.gaps(state, case.places) - goal
            answer = answer + np.outer(missing - before - answer @ step, step) / (step @ step)
    return closed_skin(hands, skin, state, opened, bool(np.abs(missing).max() <= limit))


def closed_skin(hands: TautHands, skin: Skin, state: State, opened: Array, closed: bool) -> Row:
    """Return what there is to know of a wound that is `closed`, or was drawn together so far; `opened` is how far it
    was open at the stitches [m]."""
    case = hands.case
    return Row(
        length=case.length,
        width=case.width,
        skin=skin.name,
        stiffening=skin.stiffening,
        stretch=skin.stretch,
        tension=skin.tension,
        opened=float(opened.max()),
        unknowns=hands.finite.size,
        places=tuple(case.places.tolist()),
        forces=tuple(hands.forces(state).tolist()),
        widest=float(hands.gaps(state, case.places).max()),
        contact_force=float(hands.finite.contact_forces(state.organ).sum()),
        closed=closed,
    )


# --- what the rows say ------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Ratio:
    """What the second of a published pair of wounds takes over what the first does: published, as W/L says, and by
    runs in one skin [-]."""

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
    head = (
        "wound [mm]", "skin", "σ₀ t [N/m]", "open [mm]", "stitches", "middle / largest / smallest [N]",
        "over the linear sheet [-]", "all over σ₀ t L [-]", "lips press with [N]", "gap left [mm]",
    )  # fmt: skip
    flat = {row.wound: row.middle for row in rows if row.skin == LINEAR_SHEET}
    return Table(
        head,
        [
            (
                row.name,
                row.skin,
                f"{row.tension:.3g}",
                f"{row.opened / MILLI:.2f}",
                str(len(row.forces)),
                f"{row.middle:.3f} / {max(row.forces):.3f} / {min(row.forces):.3f}",
                f"{row.middle / flat[row.wound]:.3f}" if row.wound in flat else "",
                f"{row.of_tension:.3f}" if row.tension else "",
                f"{row.contact_force:.2g}",
                f"{row.widest / MILLI:.3f}",
            )
            for row in rows
        ],
    )


def remarks(rows: Sequence[Row]) -> list[str]:
    """Say what the slit bears, what is predicted of each pair, and what was not closed."""
    out = []
    for row in rows:
        if not row.width:
            out.append(
                f"slit of {row.length / MILLI:g} mm, {row.skin}: it gapes by {row.opened / MILLI:.2f} mm, and its "
                f"stitches bear {row.of_tension:.3f} of what the uncut skin bears there"
            )
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
    drawing, ((along, slits), (gaping, published)) = panels(2, 2)
    names, skins = [dict.fromkeys(getattr(row, key) for row in rows if row.width) for key in ("name", "skin")]
    styles = dict(zip(skins, (":", "--", "-", "-."), strict=False))
    for row in rows:
        place = 2.0 * np.array(row.places) / row.length
        if row.width:
            colour = COLOURS[list(names).index(row.name) % len(COLOURS)]
            along.plot(place, row.forces, styles.get(row.skin, "-"), color=colour)
        else:
            share = np.array(row.forces) * len(row.forces) / (row.tension * row.length)
            slits.plot(place, share, "o-", label=f"{row.name} mm, {row.skin}")
    for name, colour in zip(names, COLOURS, strict=False):
        along.plot([], [], color=colour, label=f"{name} mm")
    for skin, style in styles.items():
        along.plot([], [], style, color="black", label=skin)
    along.legend(fontsize=6, ncols=2)
    along.set(title="stitches drawn all at once", ylabel="force of a stitch [N]", ylim=(0.0, None))
    slits.axhline(1.0, color="black", linewidth=0.8, linestyle="--")
    slits.set(title="slits that gaped", ylabel="force / its share of σ₀ t L [-]", ylim=(0.0, None))
    for axes in (along, slits):
        axes.set(xlabel="place along the wound, over its half length [-]", xlim=(-1.0, 1.0))
    if slits.lines[1:]:
        slits.legend(fontsize=6)
    gaping_axes(gaping, rows)
    ratio_axes(published, ratios(rows))
    return drawing


def gaping_axes(axes: Axes, rows: Sequence[Row]) -> None:
    """Draw by how much wounds gape beyond what was cut, over σ₀ t L/(E t)."""
    stretched = [row for row in rows if row.tension]
    for row, marker in zip(stretched, MARKERS * len(stretched), strict=False):
        by_law = 2.0 * row.tension * row.length / (E * THICKNESS)
        axes.plot(by_law / MILLI, (row.opened - row.width) / MILLI, marker, label=f"{row.name} mm, {row.tension:g} N/m")
    top = 1.1 * max(axes.get_xlim()[1], axes.get_ylim()[1])
    axes.plot([0.0, top], [0.0, top], color="black", linewidth=0.8, linestyle="--")
    axes.set(xlabel="crack in a large linear sheet, 2 σ₀ L/E [mm]", ylabel="opened beyond what was cut [mm]")
    axes.set(title="how far stretched skin gapes", xlim=(0.0, top), ylim=(0.0, top))
    if stretched:
        axes.legend(fontsize=6)


def ratio_axes(axes: Axes, found: Sequence[Ratio]) -> None:
    """Draw what the second wound takes over what the first does: found against published, and strips of scalp."""
    skins = list(dict.fromkeys(ratio.skin for ratio in found))
    for source, marker in zip(dict.fromkeys(ratio.source for ratio in found), MARKERS, strict=False):
        for ratio in (ratio for ratio in found if ratio.source == source):
            colour = COLOURS[skins.index(ratio.skin)]
            axes.plot(ratio.published, ratio.found, marker, color=colour, label=f"{source}, {ratio.skin}")
    for width in (12, 13, 14, 15):
        label = "Ahmad 2019, scalp, by width" if width == 15 else None
        axes.plot(STRIPS[width] / STRIPS[11], width / 11.0, "x", color="grey", label=label)
    axes.plot([0.8, 4.0], [0.8, 4.0], color="black", linewidth=0.8, linestyle="--")
    axes.set(xlabel="published, second wound over first [-]", ylabel="this study [-]", title="pairs of wounds")
    axes.legend(fontsize=5)


STUDY = Study(
    main=main,
    question="How far does a wound in stretched, stiffening skin gape, and which forces close it?",
    independent="a slit's stitches bear what the uncut sheet bore, σ₀ t L; ratios of published forces",
    consistency="the linear sheet on the same cells",
    table=table,
    figure=figure,
    remarks=remarks,
    quick={"wounds": (SLIT,), "tensions": (90.0,)},
)
