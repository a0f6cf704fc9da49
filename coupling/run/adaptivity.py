"""A spline whose knots follow the holes as the thread slides (§5, "multi-resolution").

Next to a hole the thread bends over √(EI/T), and its spans there must be a part of that. As s moves, knots are inserted
ahead of the hole, exactly, and taken out behind it by a projection that keeps the thread's momentum and where and how
it passes the holes (`thread.refit`). Neither organ nor abscissae nor multipliers are touched. What this changes of
the energy is told in the event, and counts as numerical dissipation, of either sign. On a thread that is cut each piece
has its own knots: its holes ask for none on another.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from coupling.arrays import Array
from coupling.interfaces import Body
from coupling.recent import Recent
from coupling.reports.audit import initial_energies
from coupling.run.events import Event
from coupling.step.diagnosis import holds_in_force
from coupling.step.tension import layers_at, lengths_bent_over, within
from coupling.system import State, System
from thread.knots import Tree, graded, spans_at_holes, spans_by_curvature
from thread.refit import Refit, refit
from thread.spline import Spline
from thread.thread import Thread

KEPT = 0.6  # a knot goes when a span this much smaller than the largest allowed would still not need it
NEAR_SPANS = 2  # spans next to a hole where the curve says nothing of its resolution: its curvature jumps there
ACROSS = 4.0  # spans between two holes at least
COARSE = 0.25  # of √(EI/T): on longer spans friction's part of the pull is off by more than 3 % at a turn of 60°
BETWEEN = 2.0  # coarse spans between two holes: 2 leave 4 % of their stiffness against one another to be missed
TURN = 0.1  # turn of the tangent that taking out a knot may cause, of the tolerance
ONCE = 0.75  # of a span: one that may be no longer is halved, and its halves are short enough
AGAIN = 1.2  # of what a span at a hole may be: beyond, an equilibrium with friction is found again
INTERVAL = 4  # steps from one look at the knots to the next
AHEAD = 10.0  # √(EI/T) that a hole has knots ahead of it at most: a thread that snaps passes thousands of spans a step
SAME = 1e-6  # of the finest span: breaks that are no further apart are one, but for round-off


@dataclass(frozen=True)
class Resolution:
    """How fine: a `tree` of breaks, and the `tolerance` [-], the relative error of the holes' forces aimed at.

    `everywhere` False: the coarse spans stay as they are but at holes that they do not resolve, where they are longer
    than COARSE of √(EI/T), or fewer than BETWEEN to the next hole.
    """

    tree: Tree
    tolerance: float
    everywhere: bool = True

    def tree_of(self, spline: Spline) -> Tree:
        """Return the tree of a spline, with what the spline is cut at among its coarse breaks."""
        return self._recent.of((self.tree,), lambda: self.tree.cut(spline.cuts), tuple(spline.cuts.tolist()))

    @cached_property
    def _recent(self) -> Recent[Tree]:
        return Recent()

    @property
    def ratio_at_hole(self) -> float:
        """Span at a hole over √(EI/T). What the missing compliance leaves of the lattice is of second order in it."""
        return float(np.sqrt(self.tolerance))

    @property
    def ratio_next_to_hole(self) -> float:
        """Span next to a hole over √(EI/T), where the curve is smooth and its force of fourth order in it."""
        return float(self.tolerance**0.25)

    def largest_spans(self, system: System[Body], state: State[Body], ahead: float) -> Array:
        """Return the largest span allowed on each finest cell of the tree [m], for the next `ahead` [s], or as far as
        the thread runs through a hole by AHEAD."""
        here, spline = holds_in_force(system, state), system.thread.spline
        holes, layers = state.s[here], self.layers_to_resolve(system, state)
        way = np.stack([holes, holes + way_ahead(layers, state.s_dot[here], ahead)], axis=1)
        between = gaps(spline, holes) / (ACROSS * self.ratio_next_to_hole)
        layers = np.where(np.isfinite(layers), np.minimum(layers, between), np.inf)
        cells, ratios = self.tree_of(spline).middles, (self.ratio_at_hole, self.ratio_next_to_hole)
        of_cells, of_holes = spline.piece_of(cells), spline.piece_of(holes)
        pieces = [(cells[of_cells == k], of_holes == k) for k in range(spline.pieces)]
        wanted = np.concatenate([spans_at_holes(own, way[its], layers[its], *ratios) for own, its in pieces])
        return np.minimum(wanted, self.spans_of_curve(system.thread, state.q, holes)) if self.everywhere else wanted

    def spans_of_curve(self, thread: Thread, q: Array, holes: Array) -> Array:
        """Return the largest span that the curve itself allows away from the `holes` (m,) [m], on each finest cell of
        the tree [m]."""
        own = spans_by_curvature(thread.spline, q, self.ratio_next_to_hole**3)
        own[spans_near_holes(thread, holes)] = np.inf
        return own[thread.spline.spans_of(self.tree_of(thread.spline).middles)]

    def is_content(self, system: System[Body], state: State[Body]) -> bool:
        """Whether the thread is on the coarse spans, and no hold asks for others."""
        spline = system.thread.spline
        coarse = len(spline.breaks) == len(self.tree_of(spline).coarse) and not self.everywhere
        return coarse and not np.isfinite(self.layers_to_resolve(system, state)).any()

    def layers_to_resolve(self, system: System[Body], state: State[Body]) -> Array:
        """Return √(EI/T) of the holds in force [m], infinite where the coarse spans do; where spans are halved
        already, they do when KEPT of what is allowed is enough."""
        here = holds_in_force(system, state)
        s, layers = state.s[here], bending_layers(system, state)[here]
        if self.everywhere:
            return layers
        spline = system.thread.spline
        root = self.tree_of(spline).root_at(s)
        halved = np.diff(spline.breaks)[spline.spans_of(s)] < 0.75 * root
        share = np.where(halved, KEPT, 1.0)
        resolved = (root <= share * COARSE * layers) & (BETWEEN * root <= share * gaps(spline, s))
        return np.where(resolved, np.inf, layers)


def gaps(spline: Spline, s: Array) -> Array:
    """Return the way along the thread from each hole at `s` (m,) [m] to the next on its piece [m]."""
    piece = spline.piece_of(s)
    none = np.eye(len(s), dtype=bool) | (piece[:, None] != piece)
    return np.asarray((np.abs(s[:, None] - s) + np.where(none, np.inf, 0.0)).min(axis=1, initial=np.inf))


def spans_near_holes(thread: Thread, s: Array) -> Array:
    """Return the indices of the spans within NEAR_SPANS of one that holds a hole at `s` (m,) [m]."""
    spans = thread.spline.spans_of(s)[:, None] + np.arange(-NEAR_SPANS, NEAR_SPANS + 1)
    return np.unique(np.clip(spans, 0, len(thread.spline.breaks) - 2))


def bending_layers(system: System[Body], state: State[Body]) -> Array:
    """Return √(EI/T) of every hold, at most the thread's length, shape `(m,)` [m]: `coupling.step.tension`."""
    return lengths_bent_over(system, state.s, state.N, state.lam, state.present)


def span_ratio(system: System[Body], state: State[Body]) -> float:
    """Return the longest span that holds a hole over the √(EI/T) that the thread bends over there [-]; 0 without
    bending."""
    here, spline = holds_in_force(system, state), system.thread.spline
    layers = bending_layers(system, state)[here]
    spans = np.diff(spline.breaks)[spline.spans_of(state.s[here])]
    return float(np.max(spans / layers, initial=0.0)) if system.thread.EI else 0.0


def spans_between(system: System[Body], state: State[Body]) -> float:
    """Return the number of spans between the two holds that are nearest to one another along a piece of the thread
    [-]; infinite where there are no two."""
    here, spline = holds_in_force(system, state), system.thread.spline
    s = np.sort(state.s[here])
    places, piece = np.interp(s, spline.breaks, np.arange(len(spline.breaks))), spline.piece_of(s)
    return float(np.min(np.diff(places), where=np.diff(piece) == 0, initial=np.inf))


def is_too_coarse(
    resolution: Resolution, system: System[Body], state: State[Body], beyond: float = 1.5, ahead: float = 0.0
) -> bool:
    """Whether a span that holds a hole, or will within `ahead` [s], is longer than `beyond` times what it may be."""
    spline, here = system.thread.spline, holds_in_force(system, state)
    layers = resolution.layers_to_resolve(system, state)
    spans, allowed = np.diff(spline.breaks), beyond * resolution.ratio_at_hole * layers
    holes = state.s[here]
    soon = holes + way_ahead(layers, state.s_dot[here], ahead)
    return bool((np.maximum(spans[spline.spans_of(holes)], spans[spline.spans_of(soon, holes)]) > allowed).any())


def way_ahead(layers: Array, rates: Array, ahead: float) -> Array:
    """Return the ways (m,) [m] of holes at the `rates` (m,) [m/s] that knots are made for: those in the next `ahead`
    [s], at most AHEAD of the `layers` (m,) [m]."""
    return np.asarray(np.clip(ahead * rates, -AHEAD * layers, AHEAD * layers))


def adapt_when_due(
    resolution: Resolution, system: System[Body], state: State[Body], dt: float, due: bool, once: bool = False
) -> tuple[System[Body], State[Body], list[Event]]:
    """Adapt the knots for the next INTERVAL steps of `dt` [s], where that is `due` or the spans at a hole have grown
    too coarse before, or will in the next of them; spans are halved `once` at most, or as often as the state asks for.
    Elsewhere system and state are returned as they are."""
    if not (due or is_too_coarse(resolution, system, state, ahead=dt)):
        return system, state, []
    return adapt(resolution, system, state, INTERVAL * dt, once)


def adapt(
    resolution: Resolution, system: System[Body], state: State[Body], ahead: float, once: bool = False
) -> tuple[System[Body], State[Body], list[Event]]:
    """Exchange the knots for those that the state asks for, and the way of the holes in the next `ahead` [s], or for
    those of them that halve a span `once`. Returns system and state, the same ones where no knot changes, and the event
    that says what the change cost."""
    spline = system.thread.spline
    tree = resolution.tree_of(spline)
    if resolution.is_content(system, state):
        return system, state, []
    wanted = resolution.largest_spans(system, state, ahead)
    if once:
        wanted = halved_once(spline, tree, wanted)
    places = on_breaks(tree, spline)
    kept = np.intersect1d(spline.breaks, places[tree.breaks(KEPT * wanted)])
    due = graded(np.union1d(places[tree.breaks(wanted)], kept), places)
    if np.array_equal(due, spline.breaks):
        return system, state, []
    before = [] if state.before is None else [state.before.q, state.before.v]
    held = state.s[state.present & within(system, state.s)]
    new = refit(spline, due, [state.q, state.v, *before], held, TURN * resolution.tolerance)
    if np.array_equal(new.spline.breaks, spline.breaks):
        return system, state, []
    return exchange_spline(system, state, new)


def refine_for(
    resolution: Resolution,
    system: System[Body],
    state: State[Body],
    later: tuple[System[Body], State[Body]],
    once: bool = False,
) -> tuple[System[Body], State[Body], list[Event]]:
    """Insert the knots that another, `later` state asks for, or `once` those of them that halve a span once; system and
    state are returned as they are where its spans at the holes are short enough."""
    if not is_too_coarse(resolution, *later, beyond=AGAIN):
        return system, state, []
    spline = system.thread.spline
    tree = resolution.tree_of(spline)
    wanted = resolution.largest_spans(*later, 0.0)
    if once:
        wanted = halved_once(spline, tree, wanted)
    places = on_breaks(tree, spline)
    due = graded(np.union1d(spline.breaks, places[tree.breaks(wanted)]), places)
    if np.array_equal(due, spline.breaks):
        return system, state, []
    return exchange_spline(system, state, refit_state(system, state, due))


def halved_once(spline: Spline, tree: Tree, wanted: Array) -> Array:
    """Return the largest spans allowed on each finest cell of a tree [m], of those `wanted`, that halve none of a
    spline more than once."""
    return np.asarray(np.maximum(wanted, ONCE * np.diff(spline.breaks)[spline.spans_of(tree.middles)]))


def refit_state(system: System[Body], state: State[Body], breaks: Array) -> Refit:
    """Return the thread of a state on other `breaks` (k,) [m]: exactly where these are more."""
    before = [] if state.before is None else [state.before.q, state.before.v]
    return refit(system.thread.spline, breaks, [state.q, state.v, *before], np.zeros(0), 0.0)


def on_breaks(tree: Tree, spline: Spline) -> Array:
    """Return the places of a tree, shape `(cells + 1,)` [m], as the breaks of the spline have them where these are the
    same but for round-off: a tree that is cut halves other spans than that which the breaks are from, and a span of
    round-off between two of them would be as good as a double knot."""
    places, breaks = tree.places, spline.breaks
    after = np.clip(np.searchsorted(breaks, places), 1, breaks.size - 1)
    nearest = np.where(places - breaks[after - 1] < breaks[after] - places, breaks[after - 1], breaks[after])
    return np.where(np.abs(nearest - places) <= SAME * np.diff(places).min(), nearest, places)


def exchange_spline(
    system: System[Body], state: State[Body], new: Refit
) -> tuple[System[Body], State[Body], list[Event]]:
    """Put system and state on another spline, which may be cut where theirs is not, and return them with the event of
    it."""
    thread, known = system.thread.with_spline(new.spline), system.thread.axial
    other = replace(system, thread=thread)
    q, v, *before = new.fields
    N = system.thread.spline.interpolate(thread.axial.s, thread.axial.home, known.s, known.home, state.N)
    frame = None if state.frame is None else thread.interpolate_frame(state.frame, system.thread, q)
    earlier = None if state.before is None else replace(state.before, q=before[0], v=before[1])
    layers = None if state.layers is None else layers_at(other, state.s, N, state.lam, state.present)
    moved = replace(state, q=q, v=v, N=N, before=earlier, frame=frame, layers=layers)
    energies = [initial_energies(*pair) for pair in ((system, state), (other, moved))]
    stored = [e.kinetic + e.elastic_thread for e in energies]
    change = momentum(other, moved) - momentum(system, state)
    event = Event(
        state.time,
        "knots",
        loss=stored[0] - stored[1],
        impulse=(float(change[0]), float(change[1]), float(change[2])),
        control_points=new.spline.n,
    )
    return other, moved, [event]


def momentum(system: System[Body], state: State[Body]) -> Array:
    """Return the linear momentum of the thread, shape `(3,)` [N s]."""
    return np.asarray(system.thread.momentum(state.v)[:, :3].sum(axis=0))


def coarse_tree(start: float, end: float, control_points: int) -> Tree:
    """Return the tree whose coarse spans are the equal ones of so many control points."""
    return Tree(np.linspace(start, end, control_points - 2))


def first_breaks(tree: Tree, holes: Array, ratio: float) -> Array:
    """Return the breaks [m] of a thread that has not been pulled yet: at `holes` (m,) [m] `ratio` times as fine as
    elsewhere."""
    still, finest = np.stack([holes, holes], axis=1), np.full(len(holes), tree.root.max() / ratio)
    return np.asarray(tree.places[tree.breaks(spans_at_holes(tree.middles, still, finest, 1.0, np.inf))])
