"""Checks of the pieces of a thread before the solution.

A piece needs control points for its holes, a holder in statics, and length for hands.
"""

from collections.abc import Sequence

import numpy as np

from studies import scenario as model
from studies.arrays import Array
from studies.scenario import Scenario
from studies.scenario.scenario import check_spans
from studies.scenario.table import refuse, refused
from thread.cutting import SLIVER, cut
from thread.errors import ThreadError
from thread.spline import Spline
from thread.thread import Thread

AT_CUT = 1e-9  # of the thread: at this distance round-off decides on which side of a cut a hole is


def check_at_cuts(scenario: Scenario, length: float, s: Sequence[float]) -> None:
    """Refuse a hole, among those at `s` [m], at a cut of a thread of `length` [m]."""
    cuts = np.array(scenario.thread.cuts)
    for at in s:
        if np.abs(cuts - at).min(initial=np.inf) <= AT_CUT * length:
            raise refused("thread.cuts", scenario.thread.cuts, "cut-at-hole", s=at)


def check_pieces(scenario: Scenario, spline: Spline, s: Sequence[float]) -> None:
    """Refuse a piece of a cut thread with too few control points for its holes at `s` [m].

    In statics also refuse a piece that nothing holds.
    """
    if spline.pieces == 1:
        return
    held = np.bincount(spline.piece_of(s), minlength=spline.pieces)
    held_by_end = np.zeros(spline.pieces, dtype=bool)
    held_by_end[[0, -1]] = [end.kind != "free" for end in scenario.thread.ends]
    for k, (holes, points) in enumerate(zip(held.tolist(), spline.piece_points.tolist(), strict=True)):
        where = "the thread's piece from {:.6g} to {:.6g} m".format(*spline.piece_ends[k : k + 2])
        if points < (least := 4 + 3 * holes):
            words = {"where": where, "points": points, "least": least, "holes": holes}
            raise refused("thread.control_points", scenario.thread.control_points, "piece-coarse", **words)
        if scenario.solve.kind == "static" and not holes and not held_by_end[k]:
            raise refused("thread.cuts", scenario.thread.cuts, "piece-loose", where=where)


def check_stubs(cuts: Sequence[float], ends: Sequence[float], diameter: float, key: str) -> None:
    """Refuse cuts of this `key` that leave a piece shorter than the thread's `diameter` [m].

    The pieces end at `ends` [m]. With travelling knots this is the only bound.
    """
    every = list(ends)
    for s in cuts:
        refuse(min(abs(end - s) for end in every) < diameter, key, s, "stub", diameter=diameter)
        every.append(s)


def check_cutting(cuts: Sequence[model.Cut], thread: Thread) -> None:
    """Refuse cuts during the run near an end of the thread.

    Also refuse cuts that leave a piece of one span.
    """
    spline = thread.spline
    if thread.travels:
        check_stubs([table.s for table in cuts], spline.piece_ends.tolist(), thread.section.diameter, "cut.s")
        return
    for table in sorted(cuts, key=lambda table: table.time):
        try:
            spline, *_ = cut(spline, table.s, [np.zeros((spline.n, 1))])
        except ThreadError:
            raise refused("cut.s", table.s, "cut-near", spans=SLIVER) from None
    check_spans([table.s for table in cuts], spline.piece_ends.tolist(), spline.breaks.tolist(), "cut.s")


def check_draws(holes: Sequence[model.Piercing], spline: Spline, s: Sequence[float]) -> None:
    """Refuse hands that draw a piece of thread too far.

    A piece must not leave its hole at `s` [m], and an anchored hole must not pass another.
    """
    anchored = [
        (hole, at)
        for hole, at in zip(holes, s, strict=True)
        if hole.kind == "anchored" and hole.pull is None and hole.from_ == 0.0
    ]
    times = sorted({0.0} | {time for hole, _ in anchored for time, *_ in hole.draw or ()})
    before: dict[int, tuple[str, Array]] = {}
    for hole, at in anchored:
        piece, way = int(spline.piece_of(at)), at - drawn_length(hole, times)
        key = hole.key("draw")
        start, end = spline.piece_ends[piece : piece + 2]
        if hole.draw and (way.min() <= start or way.max() >= end):
            raise refused(key, hole.draw, "drawn-out", at=at, begins=start, ends=end)
        name, last = before.get(piece, ("", np.full(way.shape, -np.inf)))
        refuse(np.any(way <= last), key, hole.draw, "drawn-past", name=name)
        before[piece] = (hole.name, way)


def drawn_length(hole: model.Piercing, times: Sequence[float]) -> Array:
    """Return the length drawn through a hole from t = 0 to each of the times [m]."""
    table = np.array(hole.draw or [(0.0, 0.0)])
    return np.asarray(np.interp(times, *table.T) - np.interp(0.0, *table.T))
