"""Observations of piercings, from the state."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from coupling.arrays import Array, Flags
from coupling.integrators import Equilibrium
from coupling.interfaces import Body
from coupling.kernels.constraints import (
    LOCAL,
    Passage,
    couple_on_thread,
    pressing_force,
    site_force,
    tangent,
    thread_force,
)
from coupling.step.configuration import Configuration, configuration_of
from coupling.step.diagnosis import holds_in_force
from coupling.step.sliding import cone_residual, law_of, side_by_side
from coupling.step.tension import lengths_bent_over
from coupling.system import Piercing, State, System
from thread.placed import Placed
from thread.vectors import dot

Number = TypeVar("Number", bound="np.generic[Any]")

BEND = 5.0  # lengths √(EI/T) over which a bend at a hole decays to less than 1 % of its angle


@dataclass(frozen=True)
class PiercingObservation:
    """One piercing at one time.

    - `s`, `slip` [m]: abscissa, and length of thread drawn through towards the end of the thread
      since the start.
    - `x`, `displacement`, `tangent` (unit), `u`, `v` (3,).
    - `force` (3,) [N]: force of the hole on the thread; `tangential_force` [N] is λ·t.
    - `normal_force` [N]: that of the law of sliding (`coupling.kernels.friction.normal_force`). If
      the hole has a `channel` [m], it contains the couple's share; None if it has none.
    - `couple` (3,) [N m]: couple of the direction constraint on the thread.
    - `tension_before`, `tension_after` [N]: tensions of the strands at lower and higher s
      (`axial_forces`).
    - `state`: "stick", "slip", "anchored" or "left".
    - `cone_residual` [N]: violation of Coulomb's law by the force along the thread
      (`coupling.step.sliding.cone_residual`). The acceleration of an abscissa with ε is included.
    - `mean_strain` [-], `turn` [rad]: strain and turn of the tissue, averaged over the footprint
      (`strains_and_turns`).
    - `bearing_pressure` [Pa]: pressure of the thread on the tissue (`bearing_pressures`).
    - `tract`: the tract of which the hole is a ball; empty for other holes.
    - `bearing` [m]: length on which the thread bears; None if it is unknown.
    """

    name: str
    s: float
    slip: float
    x: Array
    displacement: Array
    force: Array
    normal_force: float
    tangential_force: float
    couple: Array
    tension_before: float
    tension_after: float
    state: str
    tangent: Array
    u: Array
    v: Array
    cone_residual: float
    mean_strain: float = 0.0
    turn: float = 0.0
    bearing_pressure: float = 0.0
    channel: float | None = None
    tract: str = ""
    bearing: float | None = None


@dataclass(frozen=True)
class Seen:
    """A thread and its holes in `k` states with the same present holds, one after the other.

    - `present` (m,).
    - `q` (k, n, c), and the `elastic` forces (k, n, 3) [N] on it.
    - `s`, `sigma`, `stretch` and `by_hand` (k, m), `lam` (k, m, 5) and `y` (k, m, 9) as in a
      `State`.
    - `at`: the passage through the m holds of the first state, then of the second, and so on.
    """

    present: Flags
    q: Array
    elastic: Array
    s: Array
    sigma: Array
    stretch: Array
    by_hand: Flags
    lam: Array
    y: Array
    at: Passage

    @cached_property
    def each_lam(self) -> Array:
        """Multipliers of all holds of all states, shape `(k m, 5)`."""
        return self.lam.reshape(-1, 5)

    @cached_property
    def each_y(self) -> Array:
        """Site variables of all holds of all states, shape `(k m, 9)`."""
        return self.y.reshape(-1, 9)

    def by_state(self, values: NDArray[Number]) -> NDArray[Number]:
        """Return numbers of all holds of all states, `(k m, …)`, by state, `(k, m, …)`."""
        return values.reshape(*self.s.shape, *values.shape[1:])


def seen_at(state: State[Body], now: Configuration) -> Seen:
    """Return the data of one state for observations, with its configuration."""
    q, elastic, s, sigma = (x[None] for x in (state.q, now.elastic[:, :3], state.s, state.sigma))
    stretch = np.ones_like(state.s) if state.stretch is None else state.stretch
    by_hand = np.zeros_like(state.present) if state.by_hand is None else state.by_hand
    holds = s, sigma, stretch[None], by_hand[None], state.lam[None], state.y[None]
    return Seen(state.present, q, elastic, *holds, now.at)


def observe(
    system: System[Body], start: State[Body], state: State[Body], now: Configuration | None = None
) -> tuple[PiercingObservation, ...]:
    """Return the observations of all piercings of a state; slip and displacement are measured from
    the state `start`.

    `now` is the configuration of the state; None if it is not computed yet.
    """
    return observe_each(system, start.s, seen_at(state, now or configuration_of(system, state)))[0]


def observe_each(system: System[Body], s_begun: Array, seen: Seen) -> list[tuple[PiercingObservation, ...]]:
    """Return the observations of all piercings in every state, with slip from the abscissae `s_begun` (m,) [m]."""
    p, at, lam, y = len(system.piercings), seen.at, seen.each_lam, seen.each_y
    t = tangent(at)
    normal = pressing_force(at, lam, y, np.tile(system.friction[4], len(seen.s)))
    strains, turns = strains_and_turns(np.tile(system.organ.y0, len(seen.s)), seen.y[:, :p].reshape(-1, 9))
    force, tangents = seen.lam[:, :, :3], seen.by_state(t)
    tensions = axial_forces(system, seen, transmitted_forces(seen)[:, :p])
    numbers = {
        "s": seen.s,
        "slip": s_begun - seen.s,
        "normal_force": seen.by_state(normal),
        "tangential_force": dot(force, tangents),
        "tension_before": tensions[:, :, 0],
        "tension_after": tensions[:, :, 1],
        "cone_residual": broken_cones(system, seen),
        "mean_strain": strains.reshape(len(seen.s), p),
        "turn": turns.reshape(len(seen.s), p),
        "bearing_pressure": bearing_pressures(system, seen.lam),
    }
    vectors = {
        "x": seen.y[:, :, :3],
        "displacement": seen.y[:, :p, :3] - system.organ.y0.reshape(-1, 9)[:, :3],
        "force": force,
        "couple": seen.by_state(couple_on_thread(at, lam, y)),
        "tangent": tangents,
        "u": seen.y[:, :, 3:6],
        "v": seen.y[:, :, 6:],
    }
    plain = {name: values.tolist() for name, values in numbers.items()}
    return [
        tuple(
            PiercingObservation(
                name=piercing.name,
                state=sliding_state(piercing, bool(seen.present[k]), seen.sigma[step, k]),
                channel=piercing.friction.channel if piercing.friction else None,
                tract=piercing.tract,
                bearing=piercing.bearing,
                **{name: values[step][k] for name, values in plain.items()},
                **{name: values[step, k] for name, values in vectors.items()},
            )
            for k, piercing in enumerate(system.piercings)
        )
        for step in range(len(seen.s))
    ]


@dataclass(frozen=True)
class Sight(Generic[Body]):
    """The observed thread in a `state`.

    It has its `piercings`, the largest `gap` at its holes (`largest_gap`) [m] and its largest axial
    `strain` [-].
    """

    state: State[Body]
    piercings: tuple[PiercingObservation, ...]
    gap: float
    strain: float


def bearing_pressures(system: System[Body], lam: Array) -> Array:
    """Return |λ|/(d ℓ), the force of the thread on each hole over its bearing area, shape `(…, p)` [Pa].

    The multipliers have shape (…, m, 5). d is the thread's diameter and ℓ the length of the
    bearing. The pressure is zero if ℓ is unknown.
    """
    return np.asarray(np.linalg.norm(lam[..., : len(system.piercings), :3], axis=-1) / system.bearing_areas)


def strains_and_turns(y0: Array, y: Array) -> tuple[Array, Array]:
    """Return the mean strain [-] and the turn [rad] of the tissue at every hole, shape `(p,)` each.

    `y0` (9p,) are the site variables in the reference shape, and `y` (p, 9) those now. u and v
    change by ⟨∇U⟩ or by −⟨∇U⟩ᵀ, the averages over the footprint (`tissue.sites.site`). In both
    cases the strain is the principal value of sym ⟨∇U⟩ across the hole's direction with the largest
    magnitude. The turn is the angle of the rotation closest to the map from the reference frame (u,
    v, u × v) to the present one.
    """
    before, now = hole_frames(y0.reshape(-1, 9)), hole_frames(y)
    slope = (now - before)[:, :2] @ before[:, :2].swapaxes(1, 2)
    strain = np.abs(np.linalg.eigvalsh(0.5 * (slope + slope.swapaxes(1, 2)))).max(axis=1, initial=0.0)
    left, _, right = np.linalg.svd(now.swapaxes(1, 2) @ before)
    rotation = left @ right
    sine = np.linalg.norm(rotation - rotation.swapaxes(1, 2), axis=(1, 2)) / np.sqrt(8.0)
    return strain, np.arctan2(sine, 0.5 * (np.trace(rotation, axis1=1, axis2=2) - 1.0))


def hole_frames(y: Array) -> Array:
    """Return u, v and the unit vector along u × v of every hole as rows, shape `(p, 3, 3)`."""
    u, v = y[:, 3:6], y[:, 6:]
    t = np.cross(u, v)
    length = np.linalg.norm(t, axis=1, keepdims=True)
    return np.stack([u, v, t / np.maximum(length, np.finfo(float).tiny)], axis=1)


def site_forces(system: System[Body], state: State[Body]) -> Array:
    """Return the forces f_y on the organ conjugate to y, shape `(p, 9)` [N, N m]."""
    at = system.passage_of(state)
    return site_force(at, state.lam, state.y)[: len(system.piercings)]


def site_compliance(system: System[Body], state: State[Body]) -> Array:
    """Return the compliance C of the sites of an organ at rest, shape `(9p, 9p)`."""
    return system.organ.answer(Equilibrium(), [state.organ], state.time).C


def broken_cones(system: System[Body], seen: Seen) -> Array:
    """Return the violation of Coulomb's law by the force along the thread at every hold of every
    state, shape `(k, m)` [N]. It is zero where hands draw.
    """
    if not system.rough.any():
        return np.zeros_like(seen.s)
    law = side_by_side(law_of(system, seen.s[0], seen.present, 0.0, seen.s[0]), len(seen.s))
    law, own = law._replace(stretch=seen.stretch.ravel()), system.own_friction * len(seen.s)
    holds = seen.sigma.ravel(), seen.at, seen.s.ravel(), seen.each_lam, seen.each_y
    return np.where(seen.by_hand, 0.0, seen.by_state(cone_residual(law, own, *holds)))


def largest_gap(system: System[Body], state: State[Body], at: Passage | None = None) -> float:
    """Return the largest |P(s) − x| over the holes that contain the thread [m]: the remaining error
    of the constraint.
    """
    at = at or system.passage_of(state)
    return float(largest_at_holes(system, state.present, gaps_at(at, state.y)))


def gaps_at(at: Passage, y: Array) -> Array:
    """Return |P(s) − x| at every hold, shape `(m,)` [m]."""
    return np.asarray(np.linalg.norm(at.P - y[:, :3], axis=1))


def largest_at_holes(system: System[Body], present: Flags, sizes: Array) -> Array:
    """Return the largest of the sizes (…, m) over the holes that contain the thread, shape `(…,)`."""
    return np.asarray(np.max(sizes, axis=-1, where=system.rows[:, 0] & present, initial=0.0))


def look(
    system: System[Body], s_begun: Array, seen: Seen, states: Sequence[State[Body]], strains: Array
) -> list[Sight[Body]]:
    """Return the observed thread in each of the `states`, with its largest axial `strains` (k,) [-].

    Slip is measured from `s_begun` (m,) [m].
    """
    gaps = largest_at_holes(system, seen.present, seen.by_state(gaps_at(seen.at, seen.each_y))).tolist()
    each = states, observe_each(system, s_begun, seen), gaps, strains.tolist()
    return [Sight(*one) for one in zip(*each, strict=True)]


def sliding_state(piercing: Piercing, present: bool, sigma: float) -> str:
    """Return "left", "anchored", "slip" or "stick"."""
    if not present:
        return "left"
    if not piercing.slides:
        return "anchored"
    return "slip" if sigma else "stick"


def transmitted_forces(seen: Seen) -> Array:
    """Return the forces that the thread transmits just before and just after every hold, shape `(k,
    m, 2, 3)` [N].

    Each is the force of the part beyond on the part before. ψ = Σ b_i over the points beyond the
    hole rises from 0 to 1 over the spans next to it. The sum of their elastic forces is therefore
    the force ∫(EA ε T + …)·ψ' ds that the thread transmits there: in equilibrium it is exactly the
    pull on that side. A pointwise strain is not suitable, because a C² curve cannot jump at the
    hole. The forces of other holes on points on the far side of this hole are added to those of
    their own side. The force is zero if no point lies beyond.
    """
    at, (count, m) = seen.at, seen.s.shape
    shares = at.b[:, :2].swapaxes(1, 2) @ thread_force(at, seen.each_lam, seen.each_y)  # on four points each
    first, s = seen.by_state(at.first), seen.s
    points, last = first[:, :, None] + LOCAL, first + len(LOCAL)
    sums = np.concatenate([np.zeros((count, 1, 3)), np.cumsum(seen.elastic, axis=1)], axis=1)
    beyond = (points[:, None] >= first[:, :, None, None]) & (s[:, None] < s[:, :, None])[:, :, :, None]
    behind = (points[:, None] < last[:, :, None, None]) & (s[:, None] > s[:, :, None])[:, :, :, None]
    sides = np.stack([beyond, behind], axis=2).reshape(count, m, 2, len(LOCAL) * m)
    step = np.arange(count)[:, None]
    before_after = np.stack([-sums[step, first], sums[:, -1:] - sums[step, last]], axis=2)
    by_others = sides @ shares.reshape(count, 1, len(LOCAL) * m, 3)
    return np.asarray(before_after + np.array([[-1.0], [1.0]]) * by_others)


def axial_forces(system: System[Body], seen: Seen, forces: Array) -> Array:
    """Return the tensions F·t of the strands before and after every hole, shape `(k, p, 2)` [N];
    compression is negative.

    `forces` (k, p, 2, 3) [N] are those that the strands transmit. In the bend at the hole a part of
    F is shear, and the tangent is that of the hole. For this reason t is taken BEND lengths
    √(EI/|F|) away along the strand, where the bend has decayed, or in the middle of a shorter
    strand. Without a load on the strand, the tensions at both its ends are then equal.
    """
    sizes = np.maximum(np.linalg.norm(forces, axis=3), np.finfo(float).tiny)
    here, ends = strands(system, seen)
    way = ends - here[:, :, None]
    way = np.sign(way) * np.minimum(BEND * np.sqrt(system.thread.EI / sizes), 0.5 * np.abs(way))
    tangents = tangents_at(system, seen, here[:, :, None] + way)
    return dot(forces, tangents) / np.linalg.norm(tangents, axis=3)


def tangents_at(system: System[Body], seen: Seen, s: Array) -> Array:
    """Return P' of every state at its abscissae `s` (k, …) [m], shape `(k, …, 3)`."""
    spline = system.thread.spline
    if isinstance(spline, Placed):
        each = zip((spline.moved(own) for own in seen.s), seen.q, s, strict=True)
        return np.array([own.curve(q[:, :3], at.ravel())[:, 1].reshape(*at.shape, 3) for own, q, at in each])
    first, b = spline.basis(s.ravel())
    step = np.repeat(np.arange(len(seen.q)), s[0].size)[:, None]
    return np.asarray((b @ seen.q[step, first[:, None] + LOCAL, :3])[:, 1].reshape(*s.shape, 3))


def strands(system: System[Body], seen: Seen) -> tuple[Array, Array]:
    """Return the abscissa of each hole on its piece of the thread, shape `(k, p)` [m], and those of
    its neighbours.

    The neighbours are the next holes, knots or ends before and after it, shape `(k, p, 2)` [m].
    """
    spline, s = system.thread.spline, seen.s[:, : len(system.piercings)]
    low, high = np.moveaxis(spline.piece_ends[spline.piece_of(s)[:, :, None] + np.arange(2)], 2, 0)
    others, own, there = seen.s[:, None], s[:, :, None], seen.present
    before = np.where(there & (others < own), others, -np.inf).max(axis=2, initial=-np.inf)
    after = np.where(there & (others > own), others, np.inf).min(axis=2, initial=np.inf)
    return s.clip(low, high), np.stack([np.maximum(before, low), np.minimum(after, high)], axis=2)


def span_ratio(system: System[Body], state: State[Body]) -> float:
    """Return the longest span with a hole over the length √(EI/T) in which the thread bends there [-].

    It is 0 without bending, and with travelling knots, which fit this length.
    """
    if system.thread.travels:
        return 0.0
    here, spline = holds_in_force(system, state), system.thread.spline
    layers = lengths_bent_over(system, state.s, state.N, state.present)[here]
    spans = np.diff(spline.breaks)[spline.spans_of(state.s[here])]
    return float(np.max(spans / layers, initial=0.0)) if system.thread.EI else 0.0


def spans_between(system: System[Body], state: State[Body]) -> float:
    """Return the number of spans between the two closest holds on a piece of the thread [-];
    infinite without two holds.
    """
    here, spline = holds_in_force(system, state), system.thread.spline
    s = np.sort(state.s[here])
    places, piece = np.interp(s, spline.breaks, np.arange(len(spline.breaks))), spline.piece_of(s)
    return float(np.min(np.diff(places), where=np.diff(piece) == 0, initial=np.inf))
