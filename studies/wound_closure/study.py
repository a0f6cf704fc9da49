"""An elliptical wound in a sheet of skin, closed by interrupted stitches: which force does each of them take?

A sheet lies on rollers, so that it slides on what is below it, its edges held far away. The wound goes through it. One
stitch a pitch, each over its own share of the wound, lies straight across in the middle of the sheet, between two holes
a bite away from the lips; two hands draw its ends until the lips nearly touch there, and no further. Stitches are drawn
together, all at once, or one after another along the wound as a surgeon ties them: what is not tied yet is slack, what
is tied keeps its length. The lips press on one another where they meet.

*Theory.* A large sheet in plane stress with an elliptical hole, 2c long and W wide, is closed everywhere at once by a
uniform traction p = EW/(4c) on its lips, across the wound and per length along it: it is the stress of a sheet drawn
across its hole (Inglis 1913) taken back. That is t e EW/(4c) a stitch in a sheet of thickness t with one stitch every
e, and t EW/2 in all, whatever the length. What a run adds to it is the sheet's own size (the same mesh closed by the
uniform traction shows how much) and the stitches: forces at a distance from the lips, and at points.

*Published.* Čapek et al. (Med. Biol. Eng. Comput. 50, 2012, 193) give the largest suture force of their finite
elements and of what they measured in vivo, Wen et al. (Appl. Math. Mech. 44, 2023, 441) that of pig skin. The stiffness
Et of the sheet is the one number that is fitted, to the first wound of each pair; the second is predicted.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from types import SimpleNamespace

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray
from skfem import ElementVector, FacetBasis, LinearForm

import tissue
from coupling.arrays import Flags
from coupling.joins.contact import observe_contact
from coupling.run import begin
from coupling.system import State, System
from studies.arrays import Array
from studies.figure import MARKERS, Item, curve, draw, level, panel, series, unnamed
from studies.scenario import Scenario
from studies.simulation.assembly import Assembly, assemble
from studies.study import Columns, Job, Study, StudyError, Table, each, measure, measured, require, require_known, scene
from studies.verdicts import LINEAR, bearing_strain, too_coarse
from thread.catalogue import suture
from thread.path import rounded_path
from tissue.elasticity import ELEMENTS

E, NU, THICKNESS = 0.8e6, 0.45, 1.5e-3  # [Pa], [-], [m]: skin, as in the numbers that follow from it (Et = 1.2 kN/m)
FOOTPRINT = 0.7e-3  # radius of the hole's averaging ball, which the sheet's thickness allows [m]
SUTURE = "3-0 polypropylene"
SPAN = 1e-3  # of the thread [m]
TAIL = 6e-3  # of thread beyond the holes, in addition to what is drawn out [m]
NEAR = 0.02  # of the open width there: lips this near are together; nearer, the force of the last stitch has no limit
PRECISE = 1e-4  # of the width: how well the hands do that
MOVES = 30  # of theirs at most
PLACES = 41  # along the wound at which gaps are recorded
CROSSED = 1e-9  # of the width: lips may cross by no more
CONVERGED = 0.05  # a check may change the force that is compared by no more
MILLI = 1e-3
VERDICTS = {True: "agrees", False: "DISAGREES"}


@dataclass(frozen=True)
class Source:
    """A published pair of wounds: length and width [m], and the largest force of a stitch [N]."""

    name: str
    wounds: tuple[tuple[float, float], tuple[float, float]]
    forces: tuple[float, float]
    way: str  # in which the stitches are drawn here to compare with it


TOGETHER, IN_TURN = "all at once", "one after another"
FINER, LARGER, NEARER, HALVES = CHECKS = ("finer mesh", "larger sheet", "lips twice as near", "half the pitch and bite")
SOURCES = (
    Source("Čapek 2012, finite elements", ((0.030, 0.005), (0.030, 0.015)), (0.5, 1.5), TOGETHER),
    Source("Čapek 2012, in vivo", ((0.036, 0.005), (0.046, 0.013)), (1.1, 3.2), TOGETHER),
    Source("Wen 2023, pig skin", ((0.040, 0.010), (0.040, 0.014)), (1.7, 2.5), IN_TURN),
)

WOUNDS = tuple(dict.fromkeys(wound for source in SOURCES for wound in source.wounds))


@dataclass(frozen=True, kw_only=True)
class Row:
    """One wound, closed in one way. Forces are those of E = 0.8 MPa, and grow with it: closed is closed, whatever the
    thread takes for it. Those of the stitches come along the wound, and so do the gaps."""

    length: float = measured("m", lambda at: at.case.length)
    width: float = measured("m", lambda at: at.case.width)
    way: str = measured("", lambda at: at.way)  # all at once, or one after another
    variant: str = measured("", lambda at: at.case.variant)  # "", or what is changed for a check
    sheet: float = measured("m", lambda at: at.case.sheet)  # length of its edges
    size: float = measured("m", lambda at: at.case.size)  # of the cells at the holes
    unknowns: int = measured("", lambda at: at.hands.organ.size)
    places: tuple[float, ...] = measured("m", lambda at: at.case.places)  # of the stitches
    forces: tuple[float, ...] = measured("N", lambda at: at.hands.forces(at.state))  # of the stitches at the end
    tied: tuple[float, ...] = measured("N", lambda at: at.tied)  # of each stitch when it was tied
    along: tuple[float, ...] = measured("m", lambda at: at.along)  # places of the gaps
    gaps: tuple[float, ...] = measured("m", lambda at: at.hands.gaps(at.state, at.along))  # of the lips at the end
    uniform: float = measured("-", lambda at: at.uniform)  # traction that closes the mesh, over that of a large sheet
    moved: float = measured("m", lambda at: np.linalg.norm(at.moved[:, :3], axis=1).max())  # farthest a hole moved
    contact_force: float = measured("N", lambda at: at.lips.force.sum())  # that pushes the lips apart, in all
    pressure: float = measured(
        "Pa", lambda at: at.hands.organ.gaps.pressure(at.lips.force).max()
    )  # largest of the lips
    smallest_gap: float = measured("m", lambda at: at.lips.gap.min())
    complementarity: float = measured("J", lambda at: at.lips.complementarity)  # largest |force times gap| of two nodes
    pushes: bool = measured("", lambda at: np.all(at.lips.force >= 0.0))  # no contact force pulls
    closed: bool = measured("", lambda at: at.all_closed)  # the hands brought the lips together

    @property
    def wound(self) -> tuple[float, float]:
        """Length and width [m]."""
        return self.length, self.width

    @property
    def name(self) -> str:
        """The wound [mm]."""
        return f"{self.length / MILLI:g} × {self.width / MILLI:g}"

    @property
    def theory(self) -> float:
        """Force of a stitch on an infinite sheet [N]."""
        return E * THICKNESS * self.width / (2.0 * len(self.forces))

    @property
    def over_theory(self) -> float:
        """Force of all stitches over that on an infinite sheet [-]."""
        return sum(self.forces) / (len(self.forces) * self.theory)

    @property
    def middle(self) -> float:
        """Force of the stitch in the middle, or of the two next to it [N]."""
        n = len(self.forces)
        return float(np.mean(self.forces[(n - 1) // 2 : n // 2 + 1]))

    @property
    def over_uniform(self) -> float:
        """The stitch in the middle over its share of the uniform traction on the same mesh [-]."""
        return self.middle / (self.uniform * self.theory)

    @property
    def over_middle(self) -> float:
        """The stitch at the end that takes more over that in the middle [-]."""
        return max(self.forces[0], self.forces[-1]) / self.middle

    @property
    def comparable_force(self) -> float:
        """The force to be compared with a published one [N]: of stitches drawn all at once that in the middle, where
        the published force is largest; of stitches tied one after another the largest that one was tied with."""
        return self.middle if self.way == TOGETHER else max(self.tied)


def main(
    wounds: Sequence[tuple[float, float]] = WOUNDS,
    sheet: float = 0.2,
    size: float = 1e-3,
    far: float = 12e-3,
    pitch: float = 5e-3,
    bite: float = 4e-3,
    checks: Sequence[str] = CHECKS,
) -> Iterator[Row]:
    """Yield every wound both ways, and the first again for every check: on a finer mesh, in a larger sheet, drawn
    tighter, and with stitches nearer to one another and to the lips.

    Raises `StudyError` for wounds or stitches that do not fit, and for other checks.
    """
    require_known("checks", checks, CHECKS)
    require(min(pitch, bite) > 0.0, f"pitch = {pitch}, bite = {bite}", "give lengths above 0 [m]")
    check_wounds(wounds, sheet, pitch, 1e-9)
    every = [Case(length, width, sheet, size, far, pitch, bite) for length, width in wounds]
    first, both = every[0], (TOGETHER, IN_TURN)
    changed = {
        FINER: replace(first, size=size / 1.5, far=far / 1.5, variant=FINER),
        LARGER: replace(first, sheet=2.0 * sheet, far=1.5 * far, variant=LARGER),
        NEARER: replace(first, near=0.5 * NEAR, variant=NEARER),
        HALVES: replace(first, pitch=0.5 * pitch, bite=0.5 * bite, variant=HALVES),
    }
    jobs: list[Job] = [partial(close_wound, case, both) for case in every]
    jobs += [partial(close_wound, changed[check], both if check == FINER else (TOGETHER,)) for check in checks]
    yield from each(jobs)


def check_wounds(wounds: Sequence[tuple[float, float]], sheet: float, shortest: float, narrowest: float) -> None:
    """Raise `StudyError` for wounds that do not fit their sheet, are shorter than a pitch or too narrow [m]."""
    for length, width in wounds:
        if not (narrowest <= width <= length < 0.5 * sheet) or length < shortest:
            reason = f"a width up to the length, and a length from {shortest:g} m to half the sheet's edge"
            raise StudyError(f"wounds: {length} × {width} m in a sheet of {sheet} m; give {reason}")


@dataclass(frozen=True)
class Case:
    """A wound in its sheet [m]."""

    length: float
    width: float
    sheet: float
    size: float
    far: float
    pitch: float
    bite: float
    near: float = NEAR  # of the open width: how near the lips are drawn together
    variant: str = ""

    @property
    def places(self) -> Array:
        """Places of the stitches along the wound, each in the middle of its share [m]."""
        n = max(round(self.length / self.pitch), 1)
        return np.asarray((np.arange(n) - 0.5 * (n - 1)) * self.length / n)

    def opening(self, y: Array) -> Array:
        """Return the width of the open wound at y [m]."""
        return np.asarray(self.width * np.sqrt(np.maximum(1.0 - (2.0 * y / self.length) ** 2, 0.0)))


def scenario(case: Case, material: Mapping[str, object] | None = None) -> Scenario:
    """Return the sheet and the stitches, laid to and fro as one thread and cut where it turns; nothing is drawn yet.
    A wound without width is a slit. `material` are keys of the sheet's, None of a linear one."""
    y, depth = case.places, -0.5 * THICKNESS
    half = 0.5 * case.opening(y) + case.bite
    reach = 1.5 * case.width + case.bite + TAIL
    sides = np.where(np.arange(len(y)) % 2 == 0, -1.0, 1.0)
    path = [[float(s * side * reach), float(at), depth] for at, side in zip(y, sides, strict=True) for s in (1, -1)]
    hole = {"kind": "anchored", "footprint": FOOTPRINT, "draw": [[0.0, 0.0]]}
    holes = [
        {"name": f"{k + 1} {'left' if s < 0 else 'right'}", "at": [s * half[k], y[k], depth], **hole}
        for k, side in enumerate(sides)
        for s in (side, -side)
    ]
    turns = [[-side * reach, 0.5 * (a + b), depth] for side, a, b in zip(sides, y, y[1:], strict=False)]
    shape = {"shape": "ellipse", "width": case.width} if case.width else {"generator": "gmsh"}
    sizes = {"size": [case.sheet, case.sheet, THICKNESS], "length": case.length, "depth": THICKNESS}
    values = {
        "tissue.mesh": {"kind": "wound", **shape, **sizes, "h": case.far, "h_site": case.size, "accuracy": "given"},
        "thread.control_points": (round(2.0 * reach / SPAN) + 3) * len(y),
        "thread.path": path,
        "thread.cuts": [nearest_abscissa(path, turn) for turn in turns],
        "piercing": holes,
    }
    return scene("wound_closure", values | {f"tissue.{key}": value for key, value in (material or {}).items()})


def nearest_abscissa(path: Sequence[Sequence[float]], point: Sequence[float]) -> float:
    """Return the abscissa of the thread's nearest pass by a point [m]."""
    places, distances = rounded_path(path).passes(point)
    return float(places[np.argmin(distances)])


# --- hands ------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Hands:
    """The hands that draw the stitches of a case and measure the lips."""

    case: Case
    assembly: Assembly

    @property
    def system(self) -> System:
        """Thread, sheet and holes."""
        return self.assembly.system

    @property
    def organ(self) -> tissue.QuasiStaticOrgan:
        """The sheet."""
        organ = self.assembly.organ
        assert isinstance(organ, tissue.QuasiStaticOrgan) and organ.gaps is not None
        return organ

    def draw(self, state: State, lengths: Array) -> State:
        """Return the equilibrium after stitch k has been drawn shorter by `lengths` (k,) [m], half at either end. One
        unit of time is one move of the hands."""
        now, half = state.time, 0.5 * np.repeat(lengths, 2) * np.tile([-1.0, 1.0], len(lengths))
        tables = [np.array([[now, 0.0], [now + 1.0, length]]) for length in half]
        pulled = zip(self.system.piercings, tables, strict=True)
        system = replace(self.system, piercings=tuple(replace(hole, draw=draw) for hole, draw in pulled))
        return begin(system, state).load(1.0, now + 1.0).state

    def forces(self, state: State) -> Array:
        """Return the tension of each stitch [N], which its two holes take whole, for its tails are free."""
        first, last = state.lam[0::2, :3], state.lam[1::2, :3]
        across = state.y[0::2, :3] - state.y[1::2, :3]
        return 0.5 * np.vecdot(first - last, across) / np.linalg.norm(across, axis=1)

    @cached_property
    def rim(self) -> tuple[NDArray[np.intp], Array]:
        """Pairs of the lips on the sheet's upper side in their order along the wound, and their places along it [m]."""
        gaps, body = self.organ.gaps, self.organ.elasticity
        assert gaps is not None
        at = body.points[gaps.nodes[:, 0]]
        upper = np.flatnonzero(at[:, 2] >= -1e-9 * THICKNESS)
        order = upper[np.argsort(at[upper, 1])]
        return order, at[order, 1]

    def gaps(self, state: State, y: Array) -> Array:
        """Return the distance of the lips at y [m]; none at the ends of the wound."""
        order, at = self.rim
        end = 0.5 * self.case.length
        return np.interp(y, [-end, *at, end], [0.0, *self.organ.gap(state.organ)[order], 0.0])

    @cached_property
    def straight_state(self) -> State:
        """Before anything is drawn: straight."""
        return self.draw(self.assembly.start(), np.zeros(len(self.case.places)))

    @cached_property
    def answers(self) -> tuple[Array, Array]:
        """Changes of all gaps [-] and forces [N/m] per length drawn at each stitch, while the lips are open."""
        y, length = self.case.places, 0.01 * self.case.width
        each = [self.draw(self.straight_state, length * unit) for unit in np.eye(len(y))]
        gaps = np.column_stack([self.gaps(state, y) - self.gaps(self.straight_state, y) for state in each])
        forces = np.column_stack([self.forces(state) - self.forces(self.straight_state) for state in each])
        return gaps / length, forces / length

    def tighten(self, state: State, tying: Flags, slack: Flags) -> tuple[State, bool]:
        """Return the stitches `tying` drawn until the lips nearly touch there, those `slack` until they bear nothing,
        the others unchanged; and whether that was reached. Broyden's method learns the effect of contact."""
        moving = tying | slack
        by_gap, by_force = self.answers
        answer = np.where(tying[:, None], by_gap, by_force)[np.ix_(moving, moving)]
        limit = np.where(tying, self.case.width, E * THICKNESS * self.case.width)[moving] * PRECISE
        missing = self.shortfall(state, tying)[moving]
        for _ in range(MOVES):
            if np.all(np.abs(missing) <= limit):
                return state, True
            lengths = np.zeros(moving.size)
            lengths[moving] = step = np.linalg.solve(answer, -missing)
            state = self.draw(state, lengths)
            before, missing = missing, self.shortfall(state, tying)[moving]
            answer = answer + np.outer(missing - before - answer @ step, step) / (step @ step)
        return state, False

    def shortfall(self, state: State, tying: Flags) -> Array:
        """Return by how much the lips are too far apart where a stitch is tied [m], and the force of the others [N]."""
        y = self.case.places
        return np.where(tying, self.gaps(state, y) - self.case.near * self.case.opening(y), self.forces(state))


def close_wound(case: Case, ways: Sequence[str]) -> Iterator[Row]:
    """Yield the wound closed in each of the ways."""
    hands = Hands(case, assemble(scenario(case)))
    n, uniform = len(case.places), uniform_traction(hands) / (E * case.width / (2.0 * case.length))
    along = np.unique(np.append(np.linspace(-0.5, 0.5, PLACES) * case.length, case.places))
    for way in ways:
        state, all_closed, tied = hands.straight_state, True, np.zeros(n)
        for tying, slack in turns(n, way):
            state, done = hands.tighten(state, tying, slack)
            tied, all_closed = np.where(tying, hands.forces(state), tied), all_closed and done
        moved, lips = state.y - hands.straight_state.y, observe_contact(hands.system, state)
        end = SimpleNamespace(case=case, hands=hands, way=way, state=state, moved=moved, lips=lips)
        yield measure(Row, SimpleNamespace(**vars(end), tied=tied, along=along, uniform=uniform, all_closed=all_closed))


def turns(n: int, way: str) -> list[tuple[Flags, Flags]]:
    """Tell which of `n` stitches are tied at a time, and which are still slack."""
    each = np.arange(n)
    return [(each >= 0, each < 0)] if way == TOGETHER else [(each == k, each > k) for k in range(n)]


def uniform_traction(hands: Hands) -> float:
    """Return the traction on the lips, across the wound and per length along it, that closes this sheet in the middle
    [Pa]."""
    organ, body = hands.organ, hands.organ.elasticity
    load = np.zeros(body.N)
    for name, inward in (("lip_left", 1.0), ("lip_right", -1.0)):
        lip = FacetBasis(body.mesh, ElementVector(ELEMENTS[body.element]()), facets=body.mesh.boundaries[name])
        load += inward * LinearForm(lambda v, w: abs(w.n[0]) * v[0]).assemble(lip)
    U = organ.operator(0.0, 0.0).factor.solve(load[body.free])
    order, at = hands.rim
    return hands.case.width / -float(np.interp(0.0, at, (organ.G @ U)[order]))


# --- what the rows say ------------------------------------------------------------------------------------


def row_with(rows: Sequence[Row], wound: tuple[float, float], way: str, variant: str = "") -> Row | None:
    """Return one of the rows, or None."""
    return next((row for row in rows if (row.wound, row.way, row.variant) == (wound, way, variant)), None)


@dataclass(frozen=True)
class Comparison:
    """A published wound and its run; `fitted` is the sheet's stiffness Et [N/m] from the first of the pair, `edges`
    by how much more the held edges of the sheet are felt than by that one [-]."""

    source: Source
    published: float
    row: Row
    fitted: float
    edges: float

    @property
    def predicted_force(self) -> float:
        """Force at the fitted stiffness [N]; the published one where it was fitted to."""
        return self.row.comparable_force * self.fitted / (E * THICKNESS)

    @property
    def is_fit(self) -> bool:
        """Whether the stiffness was fitted to this wound."""
        return self.row.wound == self.source.wounds[0]


def comparisons(rows: Sequence[Row]) -> list[Comparison]:
    """Return every published wound that was run together with the one its pair is fitted to."""
    out = []
    for source in SOURCES:
        pair = [row_with(rows, wound, source.way) for wound in source.wounds]
        if pair[0] is not None:
            fitted = E * THICKNESS * source.forces[0] / pair[0].comparable_force
            found = [(force, row) for force, row in zip(source.forces, pair, strict=True) if row is not None]
            edges = [row.uniform / pair[0].uniform - 1.0 for _, row in found]
            out += [Comparison(source, *one, fitted, edge) for one, edge in zip(found, edges, strict=True)]
    return out


def table(rows: Sequence[Row]) -> Table:
    """Make the published wounds, one a line; then every wound, and the checks."""
    compared = comparisons(rows)

    def published(row: Row, cell: Callable[[Comparison], str]) -> str:
        return "; ".join(cell(c) for c in compared if c.row == row)

    columns: Columns = (
        ("wound [mm]", lambda row: row.name + (f", {row.variant}" if row.variant else "")),
        ("drawn", lambda row: row.way),
        ("stitches", lambda row: str(len(row.forces))),
        ("theory [N]", lambda row: f"{row.theory:.3f}"),
        ("middle / largest / smallest [N]", lambda r: f"{r.middle:.2f} / {max(r.forces):.2f} / {min(r.forces):.2f}"),
        ("sum / theory", lambda row: f"{row.over_theory:.3f}"),
        ("uniform traction / theory", lambda row: f"{row.uniform:.3f}"),
        ("middle / uniform traction", lambda row: f"{row.over_uniform:.3f}"),
        ("tied with, first to last [N]", lambda r: " ".join(f"{f:.2f}" for f in r.tied) if r.way == IN_TURN else ""),
        ("lips press with [N]", lambda row: f"{row.contact_force:.2g}"),
        ("widest gap [mm]", lambda row: f"{max(row.gaps) / MILLI:.2f}"),
        ("source", lambda row: published(row, lambda c: c.source.name)),
        ("fitted Et [N/m]", lambda row: published(row, lambda c: f"{c.fitted:.0f}")),
        ("predicted [N]", lambda row: published(row, lambda c: "(fitted)" if c.is_fit else f"{c.predicted_force:.2f}")),
        ("published [N]", lambda row: published(row, lambda c: f"{c.published:g}")),
    )
    return Table.of(columns, rows)


def remarks(rows: Sequence[Row]) -> list[str]:
    """Return agreement and disagreement in numbers; mesh, sheet and lips; shortcomings beyond small strains."""
    out = [sentence(c) for c in comparisons(rows) if not c.is_fit]
    out += [*where_largest(rows), *changes(rows)]
    for row in rows:
        name = f"{row.name} mm, {row.way}"
        if not row.closed:
            out.append(f"{name}: the lips were NOT BROUGHT TOGETHER at every stitch")
        if row.smallest_gap < -CROSSED * row.width or not row.pushes:
            out.append(f"{name}: the lips CROSS by {-row.smallest_gap:.1e} m, or contact holds them together")
        if row.way == TOGETHER and not row.variant:
            out += beyond_small_turns(row)
    out += beyond_small_bearing(rows)
    out += too_coarse("the holes, not the lips", max(row.size for row in rows), FOOTPRINT)
    gap, worst = min(row.smallest_gap / row.width for row in rows), max(row.complementarity for row in rows)
    pulls = "no force pulls" if all(row.pushes for row in rows) else "some forces PULL"
    return [*out, f"lips: smallest gap {gap:.0e} of the width, {pulls}, |force × gap| at most {worst:.0e} J"]


def sentence(c: Comparison) -> str:
    """Return a prediction and the published value, in words."""
    first = " × ".join(f"{x / MILLI:g}" for x in c.source.wounds[0])
    off = 100.0 * (c.predicted_force / c.published - 1.0)
    return (
        f"{c.source.name}: Et = {c.fitted:.0f} N/m, fitted to {first} mm, predicts {c.predicted_force:.2f} N for "
        f"{c.row.name} mm, {100.0 * c.edges:+.1f} % of it by the edges of the sheet; published are {c.published:g} N "
        f"({round(off):+d} %)"
    )


def where_largest(rows: Sequence[Row]) -> list[str]:
    """Return the stitch with the largest force, compared with the published one, in words."""
    out, plain = [], [row for row in rows if not row.variant]
    if in_turn := [row for row in plain if row.way == IN_TURN]:
        peaks = [1 + int(np.argmax(row.tied)) for row in in_turn]
        agree = all(1 < peak < 0.5 * (len(row.tied) + 1) for peak, row in zip(peaks, in_turn, strict=True))
        shown = ", ".join(f"{peak} of {len(row.tied)}" for peak, row in zip(peaks, in_turn, strict=True))
        out.append(
            f"one after another: the force when tied is largest at stitch {shown}; published, it rises to a peak "
            f"before the centre and falls (Wen 2023): {VERDICTS[agree]}"
        )
    if together := [row for row in plain if row.way == TOGETHER]:
        ratios = [row.over_middle for row in together]
        out.append(
            f"all at once: the stitches at the ends take {min(ratios):.2f} to {max(ratios):.2f} times that in the "
            f"middle; published, the largest is in the middle (Čapek 2012): {VERDICTS[max(ratios) < 1.0]}"
        )
    return out


def changes(rows: Sequence[Row]) -> list[str]:
    """Return the changes by a finer mesh, a larger sheet and other stitches."""
    out = []
    for row in rows:
        plain = row_with(rows, row.wound, row.way)
        if not row.variant or plain is None:
            continue
        change, largest = row.comparable_force / plain.comparable_force, max(row.forces) / max(plain.forces)
        if row.variant == HALVES:
            out.append(
                f"{row.name} mm, {HALVES}: the stitch in the middle takes {row.over_uniform:.3f} of its share of the "
                f"uniform traction, {plain.over_uniform:.3f} before; those at the ends {row.over_middle:.2g} times "
                f"that in the middle, {plain.over_middle:.2g} before: NOT CONVERGED in the pitch"
            )
            continue
        verdict = "" if abs(change - 1.0) <= CONVERGED else ": NOT CONVERGED"
        out.append(
            f"{row.name} mm, {row.way}, {row.variant}: {100 * (change - 1):+.1f} % in the force that is compared, "
            f"{100 * (largest - 1):+.1f} % in the largest at the end{verdict}"
        )
    return out


def beyond_small_bearing(rows: Sequence[Row]) -> list[str]:
    """Return a remark if the strain of the holes is not small."""
    strains = [bearing_strain(max(row.forces), suture(SUTURE).diameter, THICKNESS, E) for row in rows]
    if max(strains) <= LINEAR:
        return []
    return [
        f"bearing strains T/(d ℓ E) at the holes of {min(strains):.2g} to {max(strains):.2g}, BEYOND the linear range "
        f"(about {LINEAR}): how far the thread cuts in is not supported; what it takes to close the lips hardly asks"
    ]


def beyond_small_turns(row: Row) -> list[str]:
    """Return a remark if closing turns and strains the sheet too much."""
    slope = row.width / row.length
    if slope <= LINEAR:
        return []
    return [
        f"{row.name} mm: closing turns the lips by up to {slope:.2g} rad and strains the sheet beside them by "
        f"{0.5 * slope:.2g}, BEYOND the linear range (about {LINEAR} rad)"
    ]


# --- figure -----------------------------------------------------------------------------------------------


def figure(rows: Sequence[Row]) -> Figure:
    """Draw the forces along the wound, gaps, published against predicted, and forces when tied."""
    plain, compared = [row for row in rows if not row.variant], comparisons(rows)
    together, in_turn = ([row for row in plain if row.way == way] for way in (TOGETHER, IN_TURN))
    top = 1.15 * max([c.published for c in compared] + [c.predicted_force for c in compared], default=1.0)
    by_source = {source.name: [c for c in compared if c.source == source] for source in SOURCES}
    fitted = {name: [c for c in found if c.is_fit] for name, found in by_source.items()}
    return draw(
        [
            along(together, "places", lambda row: np.array(row.tied) / row.theory, "force of a stitch / theory [-]",
                  level("y", 1.0), title="stitches drawn all at once"),
            along(together, "along", lambda row: 100.0 * np.array(row.gaps) / row.width,
                  "gap / width of the open wound [%]", title="lips after that"),
        ],
        [
            panel(
                "published force [N]", "this study [N]", curve([0.0, top], [0.0, top], None, "--"),
                series(by_source, "published", "predicted_force", ""),
                series(unnamed(fitted), "published", "predicted_force", "", markerfacecolor="white"),
                title="filled: predicted, hollow: fitted to", xlim=(0.0, top), ylim=(0.0, top),
            ),
            along(in_turn, "places", lambda row: np.array(row.tied) / row.theory, "force when tied / theory [-]",
                  title="stitches tied one after another"),
        ],
    )  # fmt: skip


def along(rows: Sequence[Row], places: str, of: Callable[[Row], Array], name: str, *items: Item, title: str) -> Item:
    """Draw a quantity along the wounds."""
    pairs = {
        row.name: list(zip(2.0 * np.array(getattr(row, places)) / row.length, of(row), strict=True)) for row in rows
    }
    return panel(
        "place along the wound, over its half length [-]", name,
        series(pairs, 0, 1, "-", MARKERS if places == "places" else [""], markersize=4), *items,
        legend={"title": "wound [mm]", "ncols": 2}, title=title, xlim=(-1.0, 1.0), ylim=(0.0, None),
    )  # fmt: skip


STUDY = Study(
    main=main,
    question="Which force closes a wound of a given length and width, stitch by stitch?",
    independent="the closed form of a large sheet, tEW/2 in all; the second of each published pair of wounds, "
    "predicted from a stiffness fitted to the first",
    consistency="a uniform traction on the same mesh, a finer mesh, a larger sheet, lips that neither cross nor pull",
    table=table,
    figure=figure,
    remarks=remarks,
    quick={
        "wounds": ((0.030, 0.005), (0.030, 0.015)),
        "size": 2e-3,
        "checks": (LARGER,),
    },
)
