"""An elliptical wound in a sheet of skin: which force does each stitch take?

The stitches are interrupted. A sheet lies on rollers, so that it slides on the layer below; its
edges are held far away. The wound passes through it. There is one stitch per pitch, each for its
own share of the wound. It lies straight across in the middle of the sheet, between two holes at a
distance of one bite from the lips. Two hands draw its ends until the lips nearly touch there.
Stitches are drawn all at once, or one after another along the wound, as a surgeon ties them: untied
stitches are slack, tied ones keep their length. The lips press on each other where they meet.

*Theory.* A large sheet in plane stress has an elliptical hole, 2c long and W wide. A uniform
traction p = EW/(4c) on its lips closes it everywhere at once. The traction is across the wound and
per length along it. This removes the stress of a sheet stretched across its hole (Inglis 1913). In
a sheet of thickness t with one stitch every e the force is t e EW/(4c) per stitch. In total it is t
EW/2, independent of the length. A run differs by the finite size of the sheet, as a uniform
traction on the same mesh shows. It also differs by the stitches, which are forces at points, at a
distance from the lips.

*Published.* Čapek et al. (Med. Biol. Eng. Comput. 50, 2012, 193) give the largest suture force of
their finite elements and of their measurements in vivo, and Wen et al. (Appl. Math. Mech. 44, 2023,
441) the force in pig skin. The stiffness Et of the sheet is the only fitted number, fitted to the
first wound of each pair; the second is predicted.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from types import SimpleNamespace

import numpy as np
from matplotlib.figure import Figure

from coupling.arrays import Flags
from coupling.joins.contact import observe_contact
from studies.arrays import MILLI, Array
from studies.figure import MARKERS, Item, curve, described, draw, level, series, unnamed
from studies.lists import sentences, study_list
from studies.study import Job, Table, columns_of, each, measure, measured, require, require_known
from studies.verdicts import LINEAR, too_coarse
from studies.wounds import FOOTPRINT, IN_TURN, SOURCES, STIFFNESS, TOGETHER, WOUNDS, Case, Hands, Wound

PLACES = 41  # number of places along the wound for the gaps
CROSSED = 1e-9  # of the width: allowed overlap of the lips
CONVERGED = 0.05  # allowed relative change of the compared force by a check
say = sentences(study_list("wound_closure")["words"])
VERDICTS = {True: "agrees", False: "DISAGREES"}
FINER, LARGER, NEARER, HALVES = CHECKS = ("finer mesh", "larger sheet", "lips twice as near", "half the pitch and bite")


@dataclass(frozen=True, kw_only=True)
class Row(Wound):
    """One wound, closed in one way.

    Forces are for E = 0.8 MPa and proportional to E, because the closed shape does not depend on
    the force. Forces of stitches and gaps are in their order along the wound.
    """

    length: float = measured("m", lambda at: at.case.length)
    width: float = measured("m", lambda at: at.case.width)
    way: str = measured("", lambda at: at.way)  # all at once, or one after another
    variant: str = measured("", lambda at: at.case.variant)  # "", or the change of a check
    sheet: float = measured("m", lambda at: at.case.sheet)  # length of its edges
    size: float = measured("m", lambda at: at.case.size)  # of the cells at the holes
    unknowns: int = measured("", lambda at: at.hands.organ.size)
    places: tuple[float, ...] = measured("m", lambda at: at.case.places)  # of the stitches
    forces: tuple[float, ...] = measured("N", lambda at: at.hands.forces(at.state))  # of the stitches at the end
    tied: tuple[float, ...] = measured("N", lambda at: at.tied)  # of each stitch when it was tied
    along: tuple[float, ...] = measured("m", lambda at: at.along)  # places of the gaps
    gaps: tuple[float, ...] = measured("m", lambda at: at.hands.gaps(at.state, at.along))  # of the lips at the end
    # traction that closes the mesh, over the traction of a large sheet
    uniform: float = measured("-", lambda at: at.hands.uniform_traction)
    moved: float = measured("m", lambda at: np.linalg.norm(at.moved[:, :3], axis=1).max())  # largest of a hole
    contact_force: float = measured("N", lambda at: at.lips.force.sum())  # total force that pushes the lips apart
    pressure: float = measured("Pa", lambda at: at.hands.organ.gaps.pressure(at.lips.force).max())  # of the lips
    smallest_gap: float = measured("m", lambda at: at.lips.gap.min())
    complementarity: float = measured("J", lambda at: at.lips.complementarity)  # largest |force times gap| of two nodes
    pushes: bool = measured("", lambda at: np.all(at.lips.force >= 0.0))  # no contact force pulls
    closed: bool  # the hands brought the lips together

    @property
    def theory(self) -> float:
        """Force of a stitch on an infinite sheet [N]."""
        return STIFFNESS * self.width / (2.0 * len(self.forces))

    @property
    def over_uniform(self) -> float:
        """Force of the middle stitch over its share of the uniform traction [-].

        The traction acts on the same mesh.
        """
        return self.middle / (self.uniform * self.theory)

    @property
    def over_middle(self) -> float:
        """Larger force of the two end stitches over the force of the middle stitch [-]."""
        return max(self.forces[0], self.forces[-1]) / self.middle

    @property
    def comparable_force(self) -> float:
        """The force for comparison with a published one [N].

        For stitches drawn all at once it is the force in the middle, where the published force is
        largest. For stitches tied one after another it is the largest force when tied.
        """
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
    """Yield every wound in both ways, and the first wound again for every check.

    The checks are a finer mesh, a larger sheet, tighter stitches, and half the pitch and bite.
    Raises `StudyError` for wounds that do not fit, for lengths that are not above zero, and for
    other checks.
    """
    require_known("checks", checks, CHECKS)
    given = f"wounds = {wounds}, pitch = {pitch}, bite = {bite}"
    require(min(pitch, bite, *(width for _, width in wounds)) > 0.0, given, "give lengths above 0 [m]")
    every = [Case(length, width, sheet, size, far, pitch, bite) for length, width in wounds]
    first, both = every[0], (TOGETHER, IN_TURN)
    changed = {
        FINER: replace(first, size=size / 1.5, far=far / 1.5, variant=FINER),
        LARGER: replace(first, sheet=2.0 * sheet, far=1.5 * far, variant=LARGER),
        NEARER: replace(first, near=0.5 * first.near, variant=NEARER),
        HALVES: replace(first, pitch=0.5 * pitch, bite=0.5 * bite, variant=HALVES),
    }
    jobs: list[Job] = [partial(close_wound, case, both) for case in every]
    jobs += [partial(close_wound, changed[check], both if check == FINER else (TOGETHER,)) for check in checks]
    yield from each(jobs)


def close_wound(case: Case, ways: Sequence[str]) -> Iterator[Row]:
    """Yield the wound closed in each of the ways."""
    hands = Hands(case)
    along = np.unique(np.append(np.linspace(-0.5, 0.5, PLACES) * case.length, case.places))
    for way in ways:
        state, all_closed, tied = hands.straight_state, True, np.zeros(len(case.places))
        for tying, slack in turns(len(case.places), way):
            state, done = hands.tighten(state, tying, slack)
            tied, all_closed = np.where(tying, hands.forces(state), tied), all_closed and done
        end = SimpleNamespace(case=case, hands=hands, way=way, state=state, tied=tied, along=along)
        end.moved, end.lips = state.y - hands.straight_state.y, observe_contact(hands.assembly.system, state)
        yield measure(Row, end, closed=all_closed)


def turns(n: int, way: str) -> list[tuple[Flags, Flags]]:
    """Return which of `n` stitches are tied at each stage, and which are still slack."""
    each = np.arange(n)
    return [(each >= 0, each < 0)] if way == TOGETHER else [(each == k, each > k) for k in range(n)]


# --- what the rows say ------------------------------------------------------------------------------------


def row_with(rows: Sequence[Row], wound: tuple[float, float], way: str) -> Row | None:
    """Return the row of a wound without a variant, or None."""
    return next((row for row in rows if (row.wound, row.way, row.variant) == (wound, way, "")), None)


def comparisons(rows: Sequence[Row]) -> Iterator[SimpleNamespace]:
    """Yield every published wound that was run together with the fitted wound of its pair.

    It has its `source`, its `published` force [N] and its `row`. `fitted` is the sheet's stiffness
    Et [N/m] from the first wound of the pair, `is_fit` whether this is the first wound. At this
    stiffness the force is the `predicted_force` [N]. `edges` is the additional effect of the
    sheet's held edges, relative to the first wound [-].
    """
    for source in SOURCES:
        first, second = (row_with(rows, wound, source.way) for wound in source.wounds)
        for force, row in zip(source.forces, (first, second), strict=True):
            if first is not None and row is not None and first.closed and row.closed:
                found = SimpleNamespace(source=source, published=force, row=row, is_fit=row is first)
                found.fitted = STIFFNESS * source.forces[0] / first.comparable_force
                found.predicted_force = row.comparable_force * found.fitted / STIFFNESS
                found.edges = row.uniform / first.uniform - 1.0
                yield found


def table(rows: Sequence[Row]) -> Table:
    """Return the table with a line for every wound and check."""
    compared = list(comparisons(rows))

    def published(row: Row, cell: Callable[[SimpleNamespace], str]) -> str:
        return "; ".join(cell(c) for c in compared if c.row == row)

    columns = columns_of(
        "wound_closure",
        wound_name=lambda row: row.name + (f", {row.variant}" if row.variant else ""),
        stitches=lambda row: str(len(row.forces)),
        stitch_forces=lambda row: f"{row.middle:.2f} / {max(row.forces):.2f} / {min(row.forces):.2f}",
        sum=lambda row: f"{sum(row.forces) / (len(row.forces) * row.theory):.3f}",
        tied_with=lambda row: " ".join(f"{force:.2f}" for force in row.tied) if row.way == IN_TURN else "",
        widest=lambda row: f"{max(row.gaps) / MILLI:.2f}",
        source=lambda row: published(row, lambda c: c.source.name),
        fitted=lambda row: published(row, lambda c: f"{c.fitted:.0f}"),
        predicted=lambda row: published(row, lambda c: "(fitted)" if c.is_fit else f"{c.predicted_force:.2f}"),
        published=lambda row: published(row, lambda c: f"{c.published:g}"),
    )
    return Table.of(columns, rows)


def remarks(rows: Sequence[Row]) -> Iterator[str]:
    """Yield remarks on agreement, on effects of mesh, sheet and lips, and on exceeded limits."""
    yield from (sentence(c) for c in comparisons(rows) if not c.is_fit)
    yield from (*where_largest(rows), *changes(rows))
    for row in rows:
        name = f"{row.name} mm, {row.way}"
        if not row.closed:
            yield f"{name}: the lips were NOT BROUGHT TOGETHER at every stitch"
        if row.smallest_gap < -CROSSED * row.width or not row.pushes:
            yield f"{name}: the lips CROSS by {-row.smallest_gap:.1e} m, or contact holds them together"
        if row.way == TOGETHER and not row.variant and row.width > LINEAR * row.length:
            turn = row.width / row.length
            yield say("turns", row=row, turn=turn, strain=0.5 * turn, linear=LINEAR)
    strains = [row.bearing for row in rows]
    if max(strains) > LINEAR:
        yield say("bearing", least=min(strains), most=max(strains), linear=LINEAR)
    yield from too_coarse("the holes, not the lips", max(row.size for row in rows), FOOTPRINT)
    gap, worst = min(row.smallest_gap / row.width for row in rows), max(row.complementarity for row in rows)
    pulls = "no force pulls" if all(row.pushes for row in rows) else "some forces PULL"
    yield f"lips: smallest gap {gap:.0e} of the width, {pulls}, |force × gap| at most {worst:.0e} J"


def sentence(c: SimpleNamespace) -> str:
    """Return a prediction and the published value, in words."""
    first = " × ".join(f"{x / MILLI:g}" for x in c.source.wounds[0])
    off = round(100.0 * (c.predicted_force / c.published - 1.0))
    return say("prediction", c=c, first=first, edges=100.0 * c.edges, off=off)


def where_largest(rows: Sequence[Row]) -> Iterator[str]:
    """Yield the stitch with the largest force, compared with the published one, in words."""
    plain = [row for row in rows if not row.variant]
    if in_turn := [row for row in plain if row.way == IN_TURN]:
        peaks = [1 + int(np.argmax(row.tied)) for row in in_turn]
        agree = all(1 < peak < 0.5 * (len(row.tied) + 1) for peak, row in zip(peaks, in_turn, strict=True))
        shown = ", ".join(f"{peak} of {len(row.tied)}" for peak, row in zip(peaks, in_turn, strict=True))
        yield say("peak", shown=shown, verdict=VERDICTS[agree])
    if together := [row for row in plain if row.way == TOGETHER]:
        ratios = [row.over_middle for row in together]
        yield say("ends", least=min(ratios), most=max(ratios), verdict=VERDICTS[max(ratios) < 1.0])


def changes(rows: Sequence[Row]) -> Iterator[str]:
    """Yield the changes by a finer mesh, a larger sheet and other stitches, in words."""
    for row in rows:
        plain = row_with(rows, row.wound, row.way)
        if not row.variant or plain is None:
            continue
        change, largest = row.comparable_force / plain.comparable_force, max(row.forces) / max(plain.forces)
        if row.variant == HALVES:
            yield say("halves", row=row, plain=plain)
            continue
        verdict = "" if abs(change - 1.0) <= CONVERGED else ": NOT CONVERGED"
        yield say("change", row=row, change=100 * (change - 1), largest=100 * (largest - 1), verdict=verdict)


# --- figure -----------------------------------------------------------------------------------------------


def figure(rows: Sequence[Row]) -> Figure:
    """Return the figure of forces along the wound, gaps, predictions, and forces when tied.

    Predictions are compared with published forces.
    """
    plain, compared = [row for row in rows if not row.variant], list(comparisons(rows))
    together, in_turn = ([row for row in plain if row.way == way] for way in (TOGETHER, IN_TURN))
    top = 1.15 * max([c.published for c in compared] + [c.predicted_force for c in compared], default=1.0)
    by_source = {source.name: [c for c in compared if c.source == source] for source in SOURCES}
    fitted = {name: [c for c in found if c.is_fit] for name, found in by_source.items()}
    return draw(described(
        "wound_closure",
        [along(together, "places", lambda row: np.array(row.tied) / row.theory), level(1.0)],
        [along(together, "along", lambda row: 100.0 * np.array(row.gaps) / row.width)],
        [
            curve([0.0, top], [0.0, top], None, "--"), series(by_source, "published", "predicted_force", ""),
            series(unnamed(fitted), "published", "predicted_force", "", markerfacecolor="white"),
            {"xlim": (0.0, top), "ylim": (0.0, top)},
        ],
        [along(in_turn, "places", lambda row: np.array(row.tied) / row.theory)],
    ))  # fmt: skip


def along(rows: Sequence[Row], places: str, of: Callable[[Row], Array]) -> Item:
    """Return the curves of a quantity along the wounds."""
    pairs = {row.name: row.course(getattr(row, places), of(row)) for row in rows}
    return series(pairs, 0, 1, "-", MARKERS if places == "places" else [""], markersize=4)
