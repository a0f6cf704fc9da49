"""What one wants to know of a piercing, from the state."""

from dataclasses import dataclass

import numpy as np

from coupling.arrays import Array, Indices
from coupling.configuration import Configuration, configuration_of
from coupling.constraints import LOCAL, Passage, couple_on_thread, phi, site_force, tangent, thread_force
from coupling.integrators import Equilibrium
from coupling.interfaces import Body
from coupling.sliding import Law, cone_residual, law_of, normal_force
from coupling.system import State, System
from thread.vectors import dot

BEND = 5.0  # lengths √(EI/T) over which a bend at a hole falls to less than 1 % of its angle


@dataclass(frozen=True)
class PiercingObservation:
    """One piercing at one time.

    `s`, `slip` [m, thread drawn through towards rising s at the end of the thread since the start]; `x`,
    `displacement`, `tangent` (unit), `u`, `v` (3,); `force` (3,) [N] of the hole on the thread, `tangential_force` λ·t
    [N], `normal_force` [N] that of the law of sliding (`coupling.sliding.normal_force`), with the couple's share where
    the hole has a `channel` [m], None where it has none; `couple` (3,) [N m] of the direction constraint on the thread;
    `tension_before`, `tension_after` [N] of the strands at lower and higher s (`axial_forces`); `state`: "stick",
    "slip", "anchored" or "left"; `cone_residual` [N], by how much the force along the thread breaks Coulomb's law
    (`coupling.sliding.cone_residual`; what accelerates an abscissa with ε counts as well); `mean_strain` [-] and `turn`
    [rad] of the tissue, averaged over the footprint (`strains_and_turns`);
    `bearing_pressure` [Pa] of the thread on the tissue (`bearing_pressures`); the `tract` that it is a ball of, empty
    for none, and the length `bearing` [m] on which the thread bears, None where that is not known.
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


def observe(
    system: System[Body], start: State[Body], state: State[Body], now: Configuration | None = None
) -> tuple[PiercingObservation, ...]:
    """Return all piercings of a state; `start` is the state that slip and displacement are measured from.

    `now` is the configuration of the state where that is known already.
    """
    now = now or configuration_of(system, state)
    at = now.at
    _, t = tangent(at, state.lam, state.y)
    couple = couple_on_thread(at, state.lam, state.y)
    shares = at.b[:, :2].swapaxes(1, 2) @ thread_force(at, state.lam, state.y)
    transmitted = transmitted_forces(now.elastic[:, :3], at.first, shares, state.s)[: len(system.piercings)]
    law = law_of(system, state.s, state.present, 0.0, state.s)
    normal = normal_force(at, state.lam, state.y, law.per_channel)
    cone = broken_cones(system, law, state, at)
    tensions = axial_forces(system, state, transmitted)
    pressures = bearing_pressures(system, state)
    strains, turns = strains_and_turns(system.organ.y0, state.y[: len(system.piercings)])
    out = []
    for k, piercing in enumerate(system.piercings):
        force, y = state.lam[k, :3], state.y[k]
        along = float(force @ t[k])
        before, after = tensions[k]
        out.append(
            PiercingObservation(
                name=piercing.name,
                s=float(state.s[k]),
                slip=float(start.s[k] - state.s[k]),
                x=y[:3],
                displacement=y[:3] - system.organ.y0.reshape(-1, 9)[k, :3],
                force=force,
                normal_force=float(normal[k]),
                tangential_force=along,
                couple=couple[k],
                tension_before=float(before),
                tension_after=float(after),
                state=sliding_state(system, state, k),
                tangent=t[k],
                u=y[3:6],
                v=y[6:],
                cone_residual=float(cone[k]),
                mean_strain=float(strains[k]),
                turn=float(turns[k]),
                bearing_pressure=float(pressures[k]),
                channel=piercing.friction.channel if piercing.friction else None,
                tract=piercing.tract,
                bearing=piercing.bearing,
            )
        )
    return tuple(out)


def bearing_pressures(system: System[Body], state: State[Body]) -> Array:
    """Return |λ|/(d ℓ), the force of the thread on each hole over the area on which it bears, shape `(p,)` [Pa]: d is
    its diameter and ℓ the length of the bearing. Zero where that is not known."""
    return np.asarray(np.linalg.norm(state.lam[: len(system.piercings), :3], axis=1) / system.bearing_areas)


def strains_and_turns(y0: Array, y: Array) -> tuple[Array, Array]:
    """Return the mean strain [-] and the turn [rad] of the tissue at every hole, shape `(p,)` each, from the site
    variables in the reference shape `y0` (9p,) and now `y` (p, 9).

    u and v change by ⟨∇U⟩ or by −⟨∇U⟩ᵀ, the averages over the footprint (`tissue.sites.site`): either way the strain
    is the largest principal value, in magnitude, of sym ⟨∇U⟩ across the hole's direction. The turn is the angle of the
    rotation nearest to what carries the frame (u, v, u × v) from there to here.
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


def broken_cones(system: System[Body], law: Law, state: State[Body], at: Passage) -> Array:
    """Return by how much the force along the thread breaks Coulomb's law at every hold, shape `(m,)` [N]."""
    if not system.rough.any():
        return np.zeros(system.holds)
    return cone_residual(law, state.sigma, at, state.s, state.lam, state.y)


def largest_gap(system: System[Body], state: State[Body], at: Passage | None = None) -> float:
    """Return the largest |P(s) − x| of the drawn curve over the holes the thread is in [m]: what the spline lacks in
    compliance there, and the residual."""
    at = at or system.passage_of(state)
    return largest_at_holes(system, state, at.P - state.y[:, :3])


def largest_residual(system: System[Body], state: State[Body], at: Passage | None = None) -> float:
    """Return the largest |P̂ − x| over the holes the thread is in [m]: what the solve leaves open of the constraint."""
    at = at or system.passage_of(state)
    return largest_at_holes(system, state, phi(at, state.lam, state.y)[:, :3])


def largest_at_holes(system: System[Body], state: State[Body], gap: Array) -> float:
    """Return the length of the longest of vectors (holds, 3) at the holes the thread is in."""
    size = np.linalg.norm(gap, axis=1)
    return float(np.max(size[system.rows[:, 0] & state.present], initial=0.0))


def sliding_state(system: System[Body], state: State[Body], k: int) -> str:
    """Return "left", "anchored", "slip" or "stick"."""
    if not state.present[k]:
        return "left"
    if not system.piercings[k].slides:
        return "anchored"
    return "slip" if state.sigma[k] else "stick"


def transmitted_forces(internal: Array, first: Indices, shares: Array, s: Array) -> Array:
    """Return the forces that the thread transmits just before and just after every hold, shape `(m, 2, 3)` [N], from
    the elastic forces (n, 3) on the control points. Each is the force of what lies beyond on what lies before.

    ψ = Σ b_i over the points beyond the hole rises from 0 to 1 over the spans next to it, so the sum of their elastic
    forces is the force ∫(EA ε T + …)·ψ' ds that the thread transmits there: in equilibrium exactly the pull on that
    side. A pointwise strain would not do, since a C² curve cannot jump at the hole. What another hole puts on the
    points on this one's far side, `shares` (m, 4, 3) at the points from `first` (m,) on, is counted with the others of
    its side. Zero where no point lies beyond.
    """
    points, last = first[:, None] + LOCAL, first + len(LOCAL)
    sums = np.concatenate([np.zeros((1, 3)), np.cumsum(internal, axis=0)])
    beyond = (points >= first[:, None, None]) & (s < s[:, None])[:, :, None]
    behind = (points < last[:, None, None]) & (s > s[:, None])[:, :, None]
    sides = np.stack([beyond, behind], axis=1).reshape(len(s), 2, len(LOCAL) * len(s))
    before_after = np.stack([-sums[first], sums[-1] - sums[last]], axis=1)
    return np.asarray(before_after + np.array([[-1.0], [1.0]]) * (sides @ shares.reshape(-1, 3)))


def axial_forces(system: System[Body], state: State[Body], forces: Array) -> Array:
    """Return the tensions F·t of the strands before and after every hole, shape `(p, 2)` [N], a push negative, from the
    `forces` (p, 2, 3) [N] that they transmit.

    In the bend at the hole a part of F is shear, and the tangent is that of the hole. So t is taken where the bend has
    died out, BEND lengths √(EI/|F|) along the strand, or in the middle of a strand that is shorter: without a load
    between, the same tension at both its ends.
    """
    sizes = np.maximum(np.linalg.norm(forces, axis=2), np.finfo(float).tiny)
    here, ends = strands(system, state)
    way = ends - here[:, None]
    way = np.sign(way) * np.minimum(BEND * np.sqrt(system.thread.EI / sizes), 0.5 * np.abs(way))
    places = here[:, None] + way
    tangents = system.thread.spline.curve(state.q[:, :3], places.ravel())[:, 1].reshape(forces.shape)
    return dot(forces, tangents) / np.linalg.norm(tangents, axis=2)


def strands(system: System[Body], state: State[Body]) -> tuple[Array, Array]:
    """Return where each hole is on its piece of the thread, shape `(p,)` [m], and the abscissae before and after it up
    to which the thread is in no other, shape `(p, 2)` [m]."""
    spline, p = system.thread.spline, len(system.piercings)
    s = state.s[:p]
    low, high = spline.piece_ends[spline.piece_of(s)[:, None] + np.arange(2)].T
    there = state.present[:p]
    before = np.where(there & (s < s[:, None]), s, -np.inf).max(axis=1, initial=-np.inf)
    after = np.where(there & (s > s[:, None]), s, np.inf).min(axis=1, initial=np.inf)
    return s.clip(low, high), np.stack([np.maximum(before, low), np.minimum(after, high)], axis=1)
