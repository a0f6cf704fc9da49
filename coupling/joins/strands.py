"""The thread on the surface of the organ: its points between the holes bear on opposite facets
(`tissue.organs.skin`).

Each span of the thread has two points P(χ_j), and each free end one. The direction from the point
to the surface is d, the opposite point of the surface is x, the tangents across d are t, and the
thread's radius is r. The gap and the slip since the start of the step are

    g = d·(x − P) − r ≥ 0,   p ≥ 0,   p g = 0,     w = t·(x − x₀) − t·(P(χ_j) − P₀(S(χ_j)))

P₀ is the curve at the start of the step, and S(χ_j) the abscissa of the material at χ_j: a thread
that slides through its holes also slips on the surface. The forces P = (p, τ) obey the law of
`coupling.joins.rubbing`. Without friction they are the gradient of a potential that is convex in
the thread's place and is due to the organ's compliance. For this reason they are not unknowns of a
step: they are computed at every iterate (`Strands.touch`). `Strands.directed` closes the pressed
points in a correction, with one additional solution for each.

A step does not change d, and the forces balance at its end. With the d of its start, a thread that
turns by α = v Δt/R in a step round a radius R would be held back by the share α of its pressing
forces, which are θ T over an angle θ. In time a step therefore has the d and x of its expected end
(`Ahead`), whose error is of second order. At rest the load step is repeated with those of its end.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Generic

import numpy as np
from scipy.linalg import cholesky, solve_triangular
from scipy.optimize import nnls

from coupling.arrays import Array, Flags, Indices
from coupling.interfaces import Answer, Bearing, Body
from coupling.joins.contact import Contact, closed_by
from coupling.joins.rubbing import NO_HOLD, Law, Rubbing, find_forces, forces_by_tangent, stuck
from coupling.kernels.border import NINE
from coupling.kernels.bordered import SingularError
from coupling.kernels.constraints import LOCAL
from coupling.system import State, System
from thread.packets import END
from thread.placed import Placed
from thread.spline import Spline
from tissue.errors import OrganError
from tissue.organs.lips import tangents

ALONG, AWAY = slice(4, 7), 7  # columns of the points: d, and the distance
LABEL, ASIDE, REACH = 9, slice(10, 13), 13  # their labels: abscissa, offset from the thread's axis, radius there
ROW, STAY, STAY_AT = 14, slice(15, 18), 18  # labels too: row across, v of a spring, v·P where it is slack
CLEAR = 1.0  # diameters along the thread from a hole in which no point bears: the thread emerges there
SLIGHT = 2e-3  # of the radius: largest penetration at the start that is pushed out, so far as a pressed point yields
FIRM = 1e-4  # of the softest point's compliance, added to each point: several points may bear on few nodes
GROOVE = 3.0  # times the stiffness of a groove: with 1 a strand in a soft cylinder still swings, with 10 it creeps
HARD = 0.1  # of radius over EA: least added compliance, for held facets, whose gaps round-off would decide
OTHER_SIDE = 0.5  # cosine of the turn of d in a step beyond which the place ahead is round an edge, or behind a sheet
NEAR = 0.05  # radii: points with smaller gaps without their forces can be pressed in a correction
PER_SPAN = 2  # points: one leaves long spans between, and more are redundant for a cubic
WIDEST, MOST = 0.95, 64  # of the radius: largest offset of points across the thread, a facet apart; their number

Directions = Callable[[Sequence[tuple[Array, Array, Array]]], list[tuple[Array, Array]]]


def abscissae(system: System[Body], state: State[Body], looks: int) -> Array:
    """Return the abscissae of points on strands outside the organ, and of the ends, shape `(j,)` [m].

    There are `looks` points per span.
    """
    spline = system.at(state).thread.spline
    breaks = spline.breaks
    s = (breaks[:-1, None] + np.diff(breaks)[:, None] * (np.arange(looks) + 0.5) / looks).ravel()
    s = np.append(s, [spline.start, spline.end])
    return s[may_bear(system, state, s)]


def may_bear(system: System[Body], state: State[Body], s: Array) -> Flags:
    """Return which points of a thread at abscissae `s` (j,) [m] may bear on the organ, shape `(j,)`.

    They are outside the organ, not next to a hole from which the thread emerges, and not at held
    ends.
    """
    spline, contact = system.at(state).thread.spline, system.contact
    assert contact is not None
    of_organ = np.arange(system.holds) < len(system.piercings)
    clear = state.s[of_organ & state.present]
    out = np.abs(s[:, None] - clear).min(axis=1, initial=np.inf) > CLEAR * system.thread.section.diameter
    for at, end in zip((spline.start, spline.end), system.ends, strict=True):
        out &= (s != at) | (end.position(0.0) is None)
    places = np.append(state.s, [spline.start, spline.end])
    for low, high in contact.inside:
        k, m = system.holds if low == END else low, system.holds + 1 if high == END else high
        out &= (s < places[k]) | (s > places[m])  # the channel of a hole that was left remains
    return np.asarray(out)


@dataclass(frozen=True)
class Ahead(Generic[Body]):
    """The expected end of a step in time.

    The thread has control points `q` (n, c) [m]. The organ moves on by `ratio` times its way since
    its state `before`; without that state it stays.
    """

    q: Array
    before: Body | None = None
    ratio: float = 0.0


def touching_organ(
    system: System[Body], state: State[Body], origin: State[Body], at_rest: bool, ahead: Ahead[Body] | None = None
) -> Body:
    """Return the organ's state before a step of a thread that bears on it.

    `origin` is the state at the start of the step in time or of the load step.
    """
    if not (system.bears and isinstance(system.organ, Bearing)):
        return state.organ
    points = bearing_points(system, system.organ, state, origin, at_rest, ahead)
    touched: Body = system.organ.touched(state.organ, points)
    return touched


def bearing_points(
    system: System[Body],
    organ: Bearing,
    state: State[Body],
    origin: State[Body],
    at_rest: bool = False,
    ahead: Ahead[Body] | None = None,
) -> Array:
    """Return the facing data of the points of a thread that may bear on the organ in a state, or
    `ahead` of it, `(j, 19)`.

    Points that were closer to the surface than their radius at the `origin` of a step, such as next
    to a hole, get their distance there as radius. Contact then prevents a deeper penetration but
    lifts no point. With `at_rest` pressed points have a spring (`in_grooves`). A point whose d would
    turn too far ahead, as behind a thin sheet, keeps the place that it faces now.
    """
    points = points_facing(system, organ, state, ahead)
    first = points if origin is state and ahead is None else faced_again(system, organ, origin, points)
    if ahead is not None:
        elsewhere = np.vecdot(first[:, ALONG], points[:, ALONG]) < OTHER_SIDE
        points[elsewhere, :LABEL] = first[elsewhere, :LABEL]
    away = first[:, AWAY]
    nearer = points[:, REACH] - away > SLIGHT * 0.5 * system.thread.section.diameter
    out = in_grooves(system, organ, state, points) if at_rest else points.copy()
    out[nearer, REACH] = away[nearer]
    return out


def in_grooves(system: System[Body], organ: Bearing, state: State[Body], points: Array) -> Array:
    """Return the facing data `points` `(j, 19)` with a spring across the thread for pressed points.

    A thread makes its own groove, at whose sides d turns. With the d of one equilibrium the thread
    would swing to the other side in the next one, and farther each time. The stiffness of the groove
    against this is −p ∂²g/∂P². The spring ½ (v·P − v·P̂)² has GROOVE times this stiffness. It is slack
    at the places P̂ of this state, and does nothing once they are those of the equilibrium. A strand
    that is drawn aside without friction takes its groove along slowly: `held_aside` measures it.
    """
    old, P = organ.touching_points(state.organ)
    if not (len(old) and P.any()):
        return points.copy()
    _, was, now = np.intersect1d(identity_of(old), identity_of(points), return_indices=True)
    now, p = now[P[was] > 0.0], P[was[P[was] > 0.0]]
    out, some, step = points.copy(), points[now], 0.5 * system.thread.section.diameter
    places, across = points_at(system, state, some), across_thread(system.at(state).thread.spline, state.q, some)
    one, other = (organ.faced(state.organ, places + way * across, some[:, LABEL:]) for way in (step, -step))
    turn = np.vecdot(one[:, ALONG] - other[:, ALONG], across) / (2.0 * step)
    out[now, STAY] = np.sqrt(GROOVE * p * np.maximum(turn, 0.0))[:, None] * across
    out[now, STAY_AT] = np.vecdot(out[now, STAY], places)
    return out


def held_aside(system: System[Body], state: State[Body]) -> float:
    """Return the sum of the forces of the springs of `in_grooves` in a state [N].

    It is zero at an equilibrium whose contact acts at the places of the strand.
    """
    organ = system.organ
    points = organ.touching_points(state.organ)[0] if system.bears and isinstance(organ, Bearing) else np.zeros((0, 9))
    if not len(points):
        return 0.0
    v = points[:, STAY]
    off = np.vecdot(v, points_at(system, state, points)) - points[:, STAY_AT]
    return float(np.linalg.norm(v, axis=1) @ np.abs(off))


def identity_of(points: Array) -> Array:
    """Return one number for each of the points `(j, 19)`, `(j,)`: their abscissa, and their row."""
    return points[:, LABEL] + 1j * points[:, ROW]


def faced_again(system: System[Body], organ: Bearing, state: State[Body], points: Array) -> Array:
    """Return the facing data of points `(j, 19)` of a thread in another state, `(j, 19)`."""
    return organ.faced(state.organ, points_at(system, state, points), points[:, LABEL:])


def points_facing(system: System[Body], organ: Bearing, state: State[Body], ahead: Ahead[Body] | None = None) -> Array:
    """Return the facing data of the points of a thread that may bear on the organ in a state, or
    `ahead` of it, `(j, 19)`.

    There are PER_SPAN points per span, the free ends, and rows of points across the thread if
    facets are finer than the thread.
    """
    spline, q = system.at(state).thread.spline, state.q if ahead is None else ahead.q
    goes_on = () if ahead is None else (ahead.before, ahead.ratio)

    def faced(s: Array, aside: Array, reach: Array, row: Array) -> Array:
        """Return the facing data of points at abscissae `s` with offsets `aside` from the thread's axis."""
        labels = np.column_stack([s, aside, reach, row, np.zeros((len(s), 4))])
        return organ.faced(state.organ, places_of(spline, q, s) + aside, labels, *goes_on)

    radius, s = 0.5 * system.thread.section.diameter, abscissae(system, state, PER_SPAN)
    points = faced(s, np.zeros((len(s), 3)), np.full(len(s), radius), np.zeros(len(s)))
    most = min(int(WIDEST * radius / organ.finest), MOST)
    sides = np.where(points[:, AWAY] < 2.0 * radius, most, 0)
    if not sides.any():
        return points
    across = across_thread(spline, q, points)
    own, step = np.transpose([(k, i) for k, n in enumerate(sides.tolist()) for i in range(-n, n + 1)])
    aside = (step * WIDEST * radius / most)[:, None]
    d = points[:, ALONG] / np.linalg.norm(points[:, ALONG], axis=1, keepdims=True)
    on_thread = aside * across[own] + np.sqrt(radius**2 - aside**2) * d[own]
    return faced(s[own], on_thread, np.zeros(len(own)), step)


def places_of(spline: Spline, q: Array, s: Array) -> Array:
    """Return the places of a curve with control values `q` (n, c) at abscissae `s` (j,) [m], shape
    `(j, 3)` [m].
    """
    return spline.curve(q[:, :3], np.clip(s, spline.start, spline.end))[:, 0]


def points_at(system: System[Body], state: State[Body], points: Array) -> Array:
    """Return the places of points `(j, 19)` of a thread in a state, `(j, 3)` [m]."""
    return places_of(system.at(state).thread.spline, state.q, points[:, LABEL]) + points[:, ASIDE]


def across_thread(spline: Spline, q: Array, points: Array) -> Array:
    """Return unit vectors normal to the thread and to d at points `(j, 19)`, `(j, 3)`; zero at an upright end."""
    across = np.cross(points[:, ALONG], spline.curve(q[:, :3], points[:, LABEL])[:, 1])
    return np.asarray(across / np.maximum(np.linalg.norm(across, axis=1, keepdims=True), np.finfo(float).tiny))


def misplaced(system: System[Body], state: State[Body], origin: State[Body]) -> float:
    """Return the largest misplacement of the thread's points on the surface [m].

    A misplacement is one of three lengths: the penetration of a point into the surface that it
    faces now, the distance of a pressed point from that surface, or the turn of its direction d,
    times a diameter. `origin` is as for `touching_organ`.
    """
    organ = system.organ
    if not (system.bears and isinstance(organ, Bearing)):
        return 0.0
    old, P = organ.touching_points(state.organ)
    now = bearing_points(system, organ, state, origin)
    pressed = old[P[: len(old)] > 0.0] if len(old) else now[:0]
    again = faced_again(system, organ, state, pressed)
    deeper, higher = (points[:, AWAY] - points[:, REACH] for points in (now, again))
    turned = np.linalg.norm(again[:, ALONG] - pressed[:, ALONG], axis=1) * system.thread.section.diameter
    return float(max(-deeper.min(initial=0.0), higher.max(initial=0.0), turned.max(initial=0.0)))


@dataclass(frozen=True)
class Touch:
    """Forces of points on the organ.

    - `P` (K,) [N]: the forces of gaps, then those along slips.
    - `near` (l,): the close points.
    - `law`: their law; None if there are none.
    - `c_open` [m]: their gaps and slips without forces.
    - `pressed` (l,), `rubbing`: their active sets.
    - `by_points` (9m, …): site variables by their forces.
    """

    P: Array
    near: Indices
    law: Law | None = None
    c_open: Array = field(default_factory=lambda: np.zeros(0))
    pressed: Flags = field(default_factory=lambda: np.zeros(0, dtype=bool))
    rubbing: Rubbing = field(default_factory=Rubbing)
    by_points: Array = field(default_factory=lambda: np.zeros((0, 0)))


@dataclass(frozen=True)
class Strands(Generic[Body]):
    """The points of the thread of a `system` in a step from the state `start`.

    `answer` is the organ's, with the pairs of its `lips` that are `closed`, with their friction,
    `rubbing`.
    """

    system: System[Body]
    start: State[Body]
    answer: Answer[Body]
    lips: Contact[Body] | None
    closed: Flags
    rubbing: Rubbing

    @property
    def points(self) -> Array:
        """Facing data of the points, shape `(j, 19)`."""
        return self.answer.points

    @cached_property
    def _functions(self) -> tuple[Indices, Array]:
        """Index of the first control point of each point (j,), and its four functions (j, 4)."""
        first, b = self.spline.basis(self.points[:, LABEL])
        return first, b[:, 0]

    @property
    def first(self) -> Indices:
        """Index of the first control point that moves each point, shape `(j,)`."""
        return self._functions[0]

    @property
    def b(self) -> Array:
        """Functions of each point, shape `(j, 4)`."""
        return self._functions[1]

    @property
    def spline(self) -> Spline:
        """Spline of the thread at the start of the step."""
        return self.system.thread.spline

    @property
    def radius(self) -> float:
        """Radius of the thread [m]."""
        return 0.5 * self.system.thread.section.diameter

    @property
    def friction(self) -> float:
        """Coefficient of friction of the thread on the organ [-]."""
        assert self.system.contact is not None
        return self.system.contact.friction

    @property
    def count(self) -> int:
        """Number of points."""
        return len(self.points)

    @cached_property
    def at(self) -> Indices:
        """The point of each gap and slip, shape `(K,)`."""
        own = np.arange(self.count)
        return np.append(own, np.repeat(own, 2)) if self.friction else own

    @cached_property
    def along(self) -> Array:
        """Directions of gaps and slips, shape `(K, 3)`."""
        d = self.points[:, ALONG]
        return np.vstack([d, tangents(d).reshape(-1, 3)]) if self.friction else d

    @cached_property
    def _before(self) -> int:
        """Number of the gaps and slips of lips, which come before those of points."""
        return 0 if self.lips is None else len(self.lips.g_free)

    @cached_property
    def _shut(self) -> Indices:
        """Gaps and slips of closed lips."""
        return np.zeros(0, dtype=np.intp) if self.lips is None else self.lips.acting(self.closed)

    def _closing(self, opened: Array) -> tuple[Array, Array]:
        """Return the forces of closed lips, and the gaps and slips of points by these forces, `(K, i)`.

        `opened` `(lips, i)` are the gaps and slips of lips without forces.
        """
        assert self.lips is not None
        P = closed_by(self.lips, self.closed, self.rubbing, opened)
        return P, np.asarray(self.answer.gaps_by_forces(self._shut)[self._before :] @ P[self._shut])

    @cached_property
    def g_free(self) -> Array:
        """Gaps and slips without forces, the organ's part, shape `(K,)` [m]."""
        own = self.answer.g_free[self._before :]
        return own + self._closing(self.answer.g_free[: self._before, None])[1][:, 0] if self._shut.size else own

    @cached_property
    def C_by(self) -> Array:
        """Gaps and slips by site forces, shape `(K, 9m)`."""
        C = self.answer.C_cy
        own = C[self._before :]
        own = own + self._closing(C[: self._before])[1] if self._shut.size else own
        return np.pad(own, ((0, 0), (0, NINE * self.system.holds - own.shape[1])))

    def columns(self, some: Indices) -> tuple[Array, Array]:
        """Return gaps and slips, `(K, i)`, and site variables, `(9m, i)`, by the forces of `some`
        of them `(i,)`.
        """
        whole, C = self.answer.gaps_by_forces(self._before + some), self.answer.C_cy
        own, sites = whole[self._before :], C[self._before + some].T
        if self._shut.size and some.size:
            P, added = self._closing(whole[: self._before])
            own, sites = own + added, sites + C[: self._before].T @ P
        return own, np.pad(sites, ((0, NINE * self.system.holds - len(sites)), (0, 0)))

    def opened_lips(self, P: Array) -> Array:
        """Return the opening of the gaps and slips of lips by forces `P` (K,) of points, shape `(lips,)` [m]."""
        acts = np.flatnonzero(P)
        return np.asarray(self.answer.gaps_by_forces(self._before + acts)[: self._before] @ P[acts])

    def opens(self, q: Array, s: Array) -> Array:
        """Return the thread's part of gaps and slips at control points `q` (n, c) and abscissae `s`
        (m,), `(K,)` [m].
        """
        places = self.places(q)
        gaps = -np.vecdot(self.along[: self.count], places) - self.points[:, REACH]
        if not self.friction:
            return gaps
        slipped = places - self.points[:, ASIDE] - self.material(s)[0]
        slipped = np.vecdot(self.along[self.count :], slipped[self.at[self.count :]])
        return np.append(gaps, -slipped)

    def material(self, s: Array) -> tuple[Array, Array]:
        """Return the places of the material of the points at the start of the step, `(j, 3)` [m],
        and their derivatives.

        The derivatives are by the abscissae of the holds, `(j, 3, m)`.
        """
        if not isinstance(self.spline, Placed):
            labels = self.points[:, LABEL]
            return places_of(self.spline, self.start.q, labels), np.zeros((self.count, 3, len(s)))
        local = self.first[:, None] + LOCAL
        travel, old = self.spline.travel, self.start.spline
        assert old is not None
        S = np.einsum("ji,ji->j", self.b, travel.places(s)[local])
        P, T, *_ = old.curve(self.start.q[:, :3], np.clip(S, old.start, old.end)).swapaxes(0, 1)
        return P, T[:, :, None] * np.einsum("ji,jim->jm", self.b, travel.b[local])[:, None]

    def touch(self, q: Array, s: Array, f: Array) -> Touch:
        """Return the forces of the points at an iterate under site forces `f` (9m,). Raises `OrganError`."""
        K = len(self.at)
        c_open = self.g_free + self.C_by @ f + self.opens(q, s)
        near = np.flatnonzero(c_open[: self.count] < NEAR * self.radius)
        if not near.size:
            return Touch(np.zeros(K), near)
        while True:
            chosen = self.chosen(near)
            C, by_points = self.columns(chosen)
            own = C[chosen]
            least = max(FIRM * float(np.diag(own).max()), HARD * self.radius / float(self.system.thread.EA))
            law = self.law(own + least * np.eye(len(own)), len(near))
            pressed, rubbing, P = forces_of(law, c_open[chosen])
            gaps = (c_open + C @ P)[: self.count]
            gaps[near] = 0.0
            if gaps.min(initial=0.0) >= 0.0:
                whole = np.zeros(K)
                whole[chosen] = P
                return Touch(whole, near, law, c_open[chosen], pressed, rubbing, by_points)
            near = np.union1d(near, np.flatnonzero(gaps < 0.0))

    def chosen(self, near: Indices) -> Indices:
        """Return the numbers of the gaps and slips of some points, gaps first."""
        if not self.friction:
            return near
        return np.append(near, (self.count + 2 * near[:, None] + np.arange(2)).ravel())

    def law(self, C: Array, k: int) -> Law:
        """Return Coulomb's law of `k` points with the compliance `C` of their gaps and slips [m/N]."""
        give = np.diag(C)
        rough = np.arange(k if self.friction else 0)
        slips = give[k:].reshape(-1, 2).mean(axis=1)
        return Law(C, k, rough, np.full(len(rough), self.friction), 1.0 / give[:k], 1.0 / slips)

    def push(self, touch: Touch, q: Array) -> Array:
        """Return the forces on control points `q` (n, c), shape `(n, 3)` [N]."""
        out, parts = np.zeros((len(q), 3)), [(self.at, -touch.P[:, None] * self.along)]
        if self.held.size:
            v = self.points[self.held, STAY]
            off = self.points[self.held, STAY_AT] - np.vecdot(v, self.places(q)[self.held])
            parts.append((self.held, off[:, None] * v))
        for at, forces in parts:
            np.add.at(out, self.first[at][:, None] + LOCAL, self.b[at][:, :, None] * forces[:, None])
        return out

    @cached_property
    def held(self) -> Indices:
        """Numbers of the points with a spring (`in_grooves`), shape `(h,)`."""
        return np.flatnonzero(self.points[:, STAY].any(axis=1))

    @cached_property
    def springs(self) -> Array:
        """Stiffness of these springs, shape `(h, 4, 4, 3, 3)` [N/m]."""
        b, v = self.b[self.held], self.points[self.held, STAY]
        return np.asarray(np.einsum("ji,jk,jx,jy->jikxy", b, b, v, v))

    def places(self, q: Array) -> Array:
        """Return the places of the points for control points `q` (n, c), shape `(j, 3)` [m]."""
        P = np.einsum("ji,jix->jx", self.b, q[self.first[:, None] + LOCAL, :3])
        return np.asarray(P + self.points[:, ASIDE])

    def drive(self, P: Array, s: Array) -> Array:
        """Return the forces along the thread at the holds due to the friction of points, `(m,)` [N]."""
        if not self.friction:
            return np.zeros(len(s))
        slips = self.at[self.count :]
        return np.einsum("k,kx,kxm->m", P[self.count :], self.along[self.count :], self.material(s)[1][slips])

    def sites(self, touch: Touch) -> Array:
        """Return the motion of the sites by the points, shape `(m, 9)`."""
        if touch.law is None:
            return np.zeros((self.system.holds, NINE))
        return np.asarray((touch.by_points @ touch.P[self.chosen(touch.near)]).reshape(-1, NINE))

    def directed(
        self,
        touch: Touch,
        residuals: tuple[Array, Array, Array],
        at_holds: Callable[[Array], Array],
        s: Array,
        solve: Directions,
        forces: Callable[[Array, Array], Array],
    ) -> tuple[Array, Array]:
        """Return Newton's direction dq (n, c), dz (m, 15) with which linearised thread and organ
        obey the law of contact together.

        It is a linear complementarity problem in each correction (Josephy, Newton's method for
        generalized equations, 1979), with friction by the tangent of the law. `residuals` are as
        for `coupling.kernels.bordered.newton_directions`. `at_holds` makes residuals of the laws of
        sliding (m,) from driving forces there (m,). `solve` returns the directions of several
        residuals, and `forces` the change of site forces (9m,) in a direction. Raises
        `SingularError`.
        """
        if touch.law is None:
            return solve([residuals])[0]
        some, law = self.chosen(touch.near), touch.law
        given, slides = [residuals], self.material(s)[1] if self.friction else None
        for column, k in enumerate(some):
            r_q, r, r_y = (np.zeros_like(x) for x in residuals)
            rows = self.first[self.at[k]] + LOCAL
            r_q[rows, :3] = self.b[self.at[k]][:, None] * self.along[k]
            r_y[:] = -touch.by_points[:, column].reshape(r_y.shape)
            if slides is not None and k >= self.count:
                r[:, 0] = at_holds(self.along[k] @ slides[self.at[k]])
            given.append((r_q, r, r_y))
        solved = solve(given)
        moves = np.column_stack([self.moves(some, *way, slides) + self.C_by[some] @ forces(*way) for way in solved])
        before = touch.P[some]
        with_thread, c_open = replace(law, C=law.C + moves[:, 1:]), touch.c_open + moves[:, 0] - moves[:, 1:] @ before
        try:
            if self.friction:
                P = find_forces(with_thread, c_open, touch.pressed, touch.rubbing)[2]
            else:
                P = forces_of(with_thread, c_open)[2]
        except OrganError as error:
            raise SingularError(str(error)) from error
        (dq, dz), *rest = solved
        for part, (more_q, more_z) in zip((P - before).tolist(), rest, strict=True):
            dq, dz = dq + part * more_q, dz + part * more_z
        return dq, dz

    def moves(self, some: Indices, dq: Array, dz: Array, slides: Array | None) -> Array:
        """Return the thread's part of the change of `some` gaps and slips along a direction, shape `(i,)` [m]."""
        own = self.at[some]
        out = -np.einsum("ki,kix,kx->k", self.b[own], dq[self.first[own][:, None] + LOCAL, :3], self.along[some])
        if slides is not None:
            out += (some >= self.count) * np.einsum("kx,kxm,m->k", self.along[some], slides[own], dz[:, 0])
        return np.asarray(out)


def forces_of(law: Law, c_open: Array) -> tuple[Flags, Rubbing, Array]:
    """Return the pressed points, their friction, and their forces, shape `(k + 2m,)` [N].

    `c_open` are the gaps and slips without forces. With friction the search starts with the points
    that are pressed without it. Raises `OrganError`.
    """
    k, C = law.k, law.C[: law.k, : law.k]
    try:
        L = cholesky(0.5 * (C + C.T), lower=True)
        p, _ = nnls(L.T, -solve_triangular(L, c_open[:k], lower=True))  # min ½ pᵀCp + g·p over p ≥ 0
    except (np.linalg.LinAlgError, RuntimeError) as error:
        raise OrganError(NO_HOLD) from error
    if len(law.rough):
        return find_forces(law, c_open, p > 0.0, stuck(k))
    return p > 0.0, Rubbing(), forces_by_tangent(law, p > 0.0, Rubbing(), c_open)


def under(contact: Contact[Body], strands: Strands[Body] | None, touch: Touch | None) -> Contact[Body]:
    """Return the contact of lips with the forces of the thread's points added."""
    if strands is None or touch is None or not touch.P.any():
        return contact
    return replace(contact, g_free=contact.g_free + strands.opened_lips(touch.P))
