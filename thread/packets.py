"""Knots that travel with the holes: the thread as one spline of position and rest abscissa, (P, S),
on fixed knots χ.

    P(χ) = Σ b_i(χ) q_i,     S(χ) = Σ b_i(χ) S_i,     S_i = a_i + Σ_k b_ik s_k

Hole k stays at one knot χ_k: a double knot if it imposes a direction, because the curvature can
jump there, and a simple knot otherwise. Its abscissa s_k moves the control values S_i. The material
knots τ next to the hole are a packet. The packet moves rigidly with the hole, τ = s_k ± δ. Its
spans δ grow geometrically, from a fraction of √(EI/T) on. The rest of a strand is divided affinely
between the edges of its two packets. S_i are the Greville means of the τ, so that S increases with
χ. If the strand is straight outside the packet, a motion of the packet does not change the energy:
no hole feels a lattice. If a strand bends between its packets, its spans are short enough for the
bend.

At a cut of the thread, χ has a knot of multiplicity four. Strands end there as at the thread's own
ends, and no function crosses the cut.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from thread.arrays import Array, Flags, Indices
from thread.errors import ThreadError
from thread.spline import DEGREE, ORDERS, Spline

GROWTH = 1.7  # ratio of neighbouring spans
FAR = 5.0  # reach of a packet in √(EI/T): the bend has decayed to e^−5 there
FIRST = 0.5  # of √(EI/T): the span next to a hole
SLOPE = (GROWTH - 1.0) / GROWTH**0.5  # growth of spans with the distance from shorter spans
TURN = 0.35  # rad, largest turn of the thread in a span between packets, when the spans are made
TURNED, FLAT = 1.8, 0.25  # times TURN: spans are made anew if one turns further, or if all of a strand turn by less
COARSE, FINE = 1.3, 0.4  # times the wanted first span: a packet with a longer or a shorter first span is made anew
GROWN = 1.5  # largest ratio by which the spans between two packets can grow or shrink
RIGID = 2  # least number of spans that move rigidly with a hole: its control values then depend only on its abscissa
SHARE = 0.3  # of a strand: largest share of one packet
EQUAL = 1e-9  # of lengths: a smaller difference is round-off and does not change a number of spans
END = -1  # instead of a hole: an end of the thread or of a piece


@dataclass(frozen=True)
class Hold:
    """A hole in the description of the knots.

    Its `number` among the holds, abscissa `s` [m], whether it imposes a direction, and the length
    `first` [m] of the span next to it.
    """

    number: int
    s: float
    directed: bool
    first: float


@dataclass(frozen=True)
class Bends:
    """Bends of a thread: the lengths `spans` (k,) [m] that they need at the abscissae `at` (k,)
    [m].
    """

    at: Array
    spans: Array

    def between(self, low: float, high: float) -> "Bends":
        """Return the bends between two abscissae, with abscissae counted from `low`."""
        inside = (self.at > low) & (self.at < high)
        return Bends(self.at[inside] - low, self.spans[inside])

    def span_at(self, s: float, longest: float) -> float:
        """Return the length of a span at `s` [m] that the bends need, at most `longest` [m]."""
        return float((self.spans + SLOPE * np.abs(self.at - s)).min(initial=longest))


STRAIGHT = Bends(np.zeros(0), np.zeros(0))


def bends_of(at: Array, curvature: Array, scale: float) -> Bends:
    """Return the bends of a thread with a `curvature` (k,) [1/m] at the abscissae `at` (k,) [m].

    A span turns by TURN times `scale`.
    """
    bent = curvature > 0.0
    return Bends(at[bent], TURN * scale / curvature[bent])


@dataclass(frozen=True)
class Travel:
    """The travel of knots: `knots` χ, and S_i = `a` (n,) [m] + `b` (n, m) s.

    `at` (m,) is the break of each hold. `between` (spans, 2) are the holds at both ends of the
    strand of each span, END for an end of a piece of the thread. `limits` (spans, 2) [m] has the
    abscissa of this end, and zero for a hold.

    The other fields describe how the travel was made. `holds` (k,) are the numbers of the holds,
    and `first` (m,) [m] the spans next to every hold. For each strand, `rigid` [m] is the length of
    its packets, and `middle` [m] the length between them. `bent` says whether bends made its spans
    shorter. `strand` (n,) is the strand whose middle contains each control point, −1 for control
    points of packets. Spans are not longer than `longest` [m]; FIRST √(EI/T) and TURN were
    multiplied by `scale`.
    """

    knots: Array
    a: Array
    b: Array
    at: Indices
    between: Indices
    limits: Array
    holds: Indices
    first: Array
    rigid: Array
    middle: Array
    bent: Flags
    strand: Indices
    longest: float
    scale: float

    def is_like(self, other: "Travel") -> bool:
        """Return whether both have the same knots with the same travel."""
        same = self.knots.size == other.knots.size and self.b.shape == other.b.shape
        return self is other or bool(same and (self.a == other.a).all() and (self.b == other.b).all())

    def wanted(self, layers: Array) -> Array:
        """Return the wanted spans next to holes with boundary layers `layers` (m,) [m], shape
        `(m,)` [m].
        """
        return np.minimum(FIRST * self.scale * layers, self.longest)

    def strand_of_spans(self) -> Indices:
        """Return the strand that each span is on, shape `(spans,)`."""
        ends = np.hstack([self.between, self.limits])
        return np.cumsum(np.append(False, (ends[1:] != ends[:-1]).any(axis=1)))

    def places(self, s: Array) -> Array:
        """Return the rest abscissae S_i of the control values, shape `(n,)` [m], for holds at `s`
        (m,) [m].
        """
        return np.asarray(self.a + self.b @ s)


@dataclass(frozen=True)
class Strand:
    """The spans between two neighbouring holes.

    The material knots after the first hole are `constant` [m] + (1 − `share`) s_left + `share`
    s_right, shape `(spans,)` each. The last one is the second hole. Its packets have the length
    `rigid` [m] together. `bent` says whether bends made the spans between the packets shorter.
    `middle` are the numbers of the knots between the packets.
    """

    constant: Array
    share: Array
    rigid: float
    bent: bool
    middle: Indices


def widths(first: float, longest: float, length: float) -> Array:
    """Return the spans of a packet [m], from the hole on, in a strand of a `length` [m].

    They grow geometrically from `first` [m], are not longer than `longest` [m], and end at FAR
    times twice the first.
    """
    first = min(first, longest, SHARE * length / (1.0 + GROWTH))
    spans = np.minimum(first * GROWTH ** np.arange(64), longest)
    reach = np.cumsum(spans)
    wanted = int(np.searchsorted(reach, (1.0 - EQUAL) * 2.0 * FAR * first)) + 1
    room = int(np.searchsorted(reach, (1.0 + EQUAL) * SHARE * length))
    return spans[: max(RIGID, min(wanted, room))]


def strand_of(length: float, longest: float, left: float | None, right: float | None, bends: Bends) -> Strand:
    """Return the spans of a strand of a `length` [m], not longer than `longest` [m].

    Packets begin with spans `left` and `right` [m] at its two ends, None at an end of the thread
    without a packet. The spans between the packets are as short as the `bends` need. The abscissae
    of the bends are counted from the start of the strand.
    """
    one, other = (np.zeros(0) if first is None else widths(first, longest, length) for first in (left, right))
    middle = length - one.sum() - other.sum()
    x = np.linspace(0.0, middle, 2001)
    wanted = np.full(x.shape, longest)
    for packet, distance in ((one, x), (other, middle - x)):
        if packet.size:
            wanted = np.minimum(wanted, packet[-1] * GROWTH**0.5 + distance * SLOPE)
    least = max(4 - one.size - other.size, 1)
    straight, _ = divided(x, wanted, least)
    near = bends.spans + SLOPE * np.abs(x[:, None] + one.sum() - bends.at)
    spans, g = divided(x, np.minimum(wanted, near.min(axis=1, initial=np.inf)), least)
    g /= middle
    g[-1] = 1.0
    edges = one.sum(), other.sum()
    before_end = other.sum() - np.cumsum(other[::-1])
    before_end[-1:] = 0.0
    constant = [np.cumsum(one), (1.0 - g) * edges[0] - g * edges[1], -before_end]
    share = np.concatenate([np.zeros(one.size), g, np.ones(other.size)])
    return Strand(np.concatenate(constant), share, sum(edges), spans > straight, one.size + np.arange(spans - 1))


def divided(x: Array, wanted: Array, least: int) -> tuple[int, Array]:
    """Return the number of spans, at least `least`, with the lengths `wanted` (k,) [m] along `x`
    (k,) [m], and their ends.

    The ends have shape `(spans,)` [m].
    """
    count = np.concatenate([[0.0], np.cumsum(np.diff(x) * 2.0 / (wanted[1:] + wanted[:-1]))])
    spans = max(int(np.ceil(count[-1] - EQUAL)), least)
    return spans, np.interp(np.linspace(0.0, count[-1], spans + 1)[1:], count, x)


def travelling(
    length: float,
    holds: Sequence[Hold],
    total: int,
    longest: float,
    ends: tuple[float | None, float | None],
    scale: float = 1.0,
    cuts: Sequence[float] = (),
    bends: Bends = STRAIGHT,
) -> Travel:
    """Return the travel of the knots of a thread of a rest `length` [m], cut at the abscissae
    `cuts` [m].

    The knots travel with the `holds`; `total` also counts holds outside the thread. Spans are not
    longer than `longest` [m]. Spans next to an end of the thread have the lengths `ends` [m], None
    if no bend is expected there. `scale` is the scale of the packets (`Travel`). Spans between
    packets are as short as the `bends` need.

    Raises `ThreadError` if two holds are at one abscissa, or if a hold is at an end or at a cut.
    """
    first_at: dict[float, float | None] = {0.0: ends[0], length: ends[1]}
    stops: list[tuple[float, Hold | None]] = [(at, None) for at in (0.0, *cuts, length)]
    stops = sorted([*stops, *((hold.s, hold) for hold in holds if 0.0 < hold.s < length)], key=lambda stop: stop[0])
    places = np.array([at for at, _ in stops])
    if np.any(np.diff(places) <= 1e-9 * length):
        raise ThreadError("holes: two are at one abscissa, or one at an end or a cut of the thread; put them apart")
    room = SHARE / (1.0 + GROWTH) * np.diff(places)  # for the first span of a packet of RIGID spans
    nearest = zip(stops[1:-1], np.minimum(room[:-1], room[1:]).tolist(), strict=True)
    # The first spans are equal on both sides of a hole. Otherwise S at its knot would not be the hole's abscissa.
    alike = {at: min(hold.first, longest, most) for (at, hold), most in nearest if hold}
    rows, between, limits, breaks = [np.zeros(total + 1)], [], [], [0] * ORDERS
    at, rigid, bent = np.zeros(total, dtype=np.intp), np.zeros(len(places) - 1), np.zeros(len(places) - 1, dtype=bool)
    strands = [-1]
    for k, ((low, left), (high, right)) in enumerate(pairwise(stops)):
        packets = alike.get(low, first_at.get(low)), alike.get(high, first_at.get(high))
        strand = strand_of(high - low, longest, *packets, bends.between(low, high))
        rigid[k], bent[k] = strand.rigid, strand.bent
        strands += [k if i in strand.middle else -1 for i in range(len(strand.share))]
        for constant, share in zip(strand.constant, strand.share, strict=True):
            row = np.zeros(total + 1)
            row[-1] = constant + (0.0 if left else (1.0 - share) * low) + (0.0 if right else share * high)
            if left:
                row[left.number] += 1.0 - share
            if right:
                row[right.number] += share
            rows.append(row)
            between.append((left.number if left else END, right.number if right else END))
            limits.append((0.0 if left else low, 0.0 if right else high))
            breaks.append(len(rows) - 1)
        if right:
            at[right.number] = len(rows) - 1
        breaks += [len(rows) - 1] * (right.directed if right else DEGREE)
    for hold in holds:
        at[hold.number] = 0 if hold.s <= 0.0 else at[hold.number] if hold.s < length else len(rows) - 1
    material, inside = np.array(rows)[breaks], np.array(strands, dtype=np.intp)[breaks]
    strand_of_points = np.max([inside[1:-3], inside[2:-2], inside[3:-1]], axis=0)
    S = (material[1:-3] + material[2:-2] + material[3:-1]) / DEGREE
    knots = np.array(breaks, dtype=np.float64)
    for cut, after in zip(cuts, Spline(knots).piece_starts[1:], strict=True):
        S[after - 1 : after + 1, -1] = cut  # exactly
    numbers, first = np.array([hold.number for hold in holds], dtype=np.intp), np.zeros(total)
    first[numbers] = [hold.first for hold in holds]
    return Travel(
        knots, S[:, -1].copy(), S[:, :-1].copy(), at, np.array(between, dtype=np.intp), np.array(limits), numbers,
        first, rigid, np.diff(places) - rigid, bent, strand_of_points, longest, scale,
    )  # fmt: skip
