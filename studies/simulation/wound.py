"""A wound between two contact surfaces: closing forces, eversion of its edges, and gaps along them.

A hole belongs to the surfaces nearest to it in the reference shape, on their left or right side.
The normal d there points from left to right, and f is the force of the thread on the tissue. The
closing force of a hole is f·d on the left and −f·d on the right. All holes and balls in a tied loop
are one stitch. A loop that changes sides more often than a pulley stitch is a running suture and
not one stitch. The balls of any other tract are one stitch, and any other hole is a stitch alone.
A stitch that lies wholly beyond one end of the wound is not counted, because it crosses intact
tissue. An end is a place of the outer surface where both sides meet.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.spatial import cKDTree

import tissue
from coupling.arrays import Flags, Indices
from coupling.joins.contact import ContactObservation
from coupling.reports.observation import PiercingObservation
from coupling.system import System
from studies.arrays import Array
from studies.output.records import GapRecord, Record, StitchRecord

CROSSINGS = 3  # of a pulley stitch, whose thread changes sides most often of all single stitches
BEYOND = 1e-9  # of the way from the middle of a wound to its end: a hole beyond the end by less is at it
BALANCED = 1e-9  # of the holes' forces: a smaller sum is round-off
SIDES = (False, True)  # values of `right`: the left side first


@dataclass(frozen=True)
class Bite:
    """A hole next to a wound.

    It has its `stitch`, and `right` is whether it is on the right side. Its `place` (3,) is in the
    reference shape [m], and `drawn` is its closing force [N]. A `ball` belongs to a tract, any
    other hole is an opening.
    """

    stitch: str
    right: bool
    place: Array
    drawn: float
    ball: bool


@dataclass(frozen=True)
class Wound:
    """Two contact surfaces, and the bites next to them.

    The surfaces are number `part` of `gaps`. All bites that are `near` are in the order of the thread.
    """

    gaps: tissue.Gaps
    part: int
    near: tuple[Bite, ...]

    @property
    def pair(self) -> str:
        """Names of the two surfaces."""
        return self.gaps.parts[self.part].name

    @cached_property
    def bites(self) -> tuple[Bite, ...]:
        """Bites of the stitches that do not lie wholly beyond one end of the wound."""
        own, points, (left, right) = self.gaps.parts[self.part], self.gaps.body.points, self.rims
        ends = np.intersect1d(left.edges, right.edges)
        if not ends.size or not self.near:
            return self.near
        middle = points[np.union1d(left.edges, right.edges)].mean(axis=0)
        lips, ways = points[np.union1d(own.left, own.facets)], points[ends] - middle
        near = ((bite.place, bite.stitch) for bite in self.near)
        places, names = (np.array(each) for each in zip(*near, strict=True))
        beyond = (places - middle) @ ways.T > (1.0 + BEYOND) * np.max((lips - middle) @ ways.T, axis=0)
        return tuple(bite for bite in self.near if not beyond[names == bite.stitch].all(axis=0).any())

    @property
    def closure_force(self) -> float:
        """Closing force of the thread [N]: the mean of both sides."""
        return 0.5 * sum(bite.drawn for bite in self.bites)

    @property
    def stitches(self) -> tuple[Record, ...]:
        """Closing force of each stitch."""
        total, size = 2.0 * self.closure_force, sum(abs(bite.drawn) for bite in self.bites)
        out = []
        for stitch in dict.fromkeys(bite.stitch for bite in self.bites):
            own = [bite for bite in self.bites if bite.stitch == stitch]
            left, right = (sum(bite.drawn for bite in own if bite.right is side) for side in SIDES)
            share = (left + right) / total if total > BALANCED * size else None
            forces = {"left_force": left, "right_force": right, "load_share": share}
            out.append(StitchRecord(stitch=stitch, pair=self.pair, **forces))
        return tuple(out)

    @cached_property
    def rims(self) -> tuple[tissue.Rim, ...]:
        """Rims of the left and the right side on the outer surface, near the openings of both."""
        openings = np.array([bite.place for bite in self.near if not bite.ball]).reshape(-1, 3)
        return tuple(rim.near(openings) for rim in self.gaps.rims[self.part])

    def eversion(self, points: Array) -> float | None:
        """Return the rise of the outer surface towards the edges, both sides together [rad].

        It is None if a side has no edge. All nodes of the organ are at `points` `(n, 3)` [m].
        """
        return sum(rim.turn(points) for rim in self.rims) if all(len(rim.edges) for rim in self.rims) else None

    def profile(self, lips: ContactObservation, points: Array) -> tuple[Record, ...]:
        """Return the gaps along the left rim from the contact of its `lips`.

        All nodes of the organ are at `points` `(n, 3)` [m].
        """
        part, (vertices, way) = self.gaps.parts[self.part], self.rims[0].way
        faces, pressure = lips.gap < self.gaps.extent, part.hats.T @ part.vertex_pressure(lips.force)
        if not vertices.size:
            return ()
        below = cKDTree(self.gaps.body.points[vertices]).query(self.gaps.body.points[part.left])[1]
        out = []
        for k, (vertex, far) in enumerate(zip(vertices.tolist(), way.tolist(), strict=True)):
            own, here = lips.gap[(part.left == vertex) & faces], (below == k) & faces
            edge = float(own[0]) if own.size else None
            deep = float(lips.gap[here].max()) if here.any() else None
            known = {"edge_gap": edge, "largest_gap": deep, "largest_pressure": float(pressure[here].max(initial=0.0))}
            out.append(GapRecord(pair=self.pair, way=far, x=points[vertex], **known))
        return tuple(out)


def wounds_of(system: System, every: Sequence[tissue.Gaps], holes: Sequence[PiercingObservation]) -> list[list[Wound]]:
    """Return the wounds of each set of gaps, pair by pair, with the nearest `holes` of a step.

    Balls of tracts are among the holes.
    """
    places = np.array([hole.x - hole.displacement for hole in holes]).reshape(-1, 3)
    pairs, away = (np.array(both) for both in zip(*(gaps.nearest(places) for gaps in every), strict=True))
    nearest = np.argmin(away, axis=0)
    order = np.argsort([hole.s for hole in holes], kind="stable").tolist()
    out = []
    for number, gaps in enumerate(every):
        own = [k for k in order if nearest[k] == number]
        found = bites_of(system, gaps, holes, pairs[number], places)
        part = np.searchsorted([own.stop for own in gaps.slices], pairs[number], side="right")
        out.append([Wound(gaps, p, tuple(found[k] for k in own if part[k] == p)) for p in range(len(gaps.parts))])
    return out


def bites_of(
    system: System, gaps: tissue.Gaps, holes: Sequence[PiercingObservation], pairs: Indices, places: Array
) -> list[Bite]:
    """Return every hole with its side and closing force.

    `pairs` (p,) are the node pairs nearest to its place in the reference shape, `places` (p, 3)
    [m].
    """
    d = gaps.start[pairs, 4:] / np.linalg.norm(gaps.start[pairs, 4:], axis=1)[:, None]
    right = np.vecdot(places - gaps.body.points[gaps.left[pairs]], d) > 0.0
    drawn = np.where(right, 1.0, -1.0) * np.vecdot(np.array([hole.force for hole in holes]).reshape(-1, 3), d)
    balls = [bool(hole.tract) for hole in holes]
    each = zip(stitches_of(system, holes, right), right.tolist(), places, drawn.tolist(), balls, strict=True)
    return [Bite(*bite) for bite in each]


def stitches_of(system: System, holes: Sequence[PiercingObservation], right: Flags) -> list[str]:
    """Return the name of each hole's stitch: its tie, its tract or the hole itself.

    `right` (p,) is its side.
    """
    names, s = [hole.tract or hole.name for hole in holes], np.array([hole.s for hole in holes])
    for tie in system.ties:
        inside = (s >= s[tie.between[0]]) & (s <= s[tie.between[1]])
        sides = right[inside][np.argsort(s[inside], kind="stable")]
        if np.count_nonzero(sides[1:] != sides[:-1]) <= CROSSINGS:
            names = [tie.name if own else name for own, name in zip(inside.tolist(), names, strict=True)]
    return names
