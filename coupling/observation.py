"""What one wants to know of a piercing, from the state."""

from dataclasses import dataclass

import numpy as np

from coupling.constraints import LOCAL, Array, Indices, couple_on_thread, tangent, thread_force
from coupling.sliding import cone_residual, law_of, normal_force
from coupling.system import State, System


@dataclass(frozen=True)
class PiercingObservation:
    """One piercing at one time.

    `s`, `slip` [m, thread drawn through towards rising s at the end of the thread since the start]; `x`,
    `displacement`, `tangent` (unit), `u`, `v` (3,); `force` (3,) [N] of the hole on the thread, `tangential_force` λ·t
    [N], `normal_force` [N] that of the law of sliding (`coupling.sliding.normal_force`), with the couple's share where
    the hole has a `channel` [m], None where it has none; `couple` (3,) [N m] of the direction constraint on the thread;
    `tension_before`, `tension_after` [N] at lower and higher s; `state`: "stick", "slip", "anchored" or "left";
    `cone_residual` [N], by how much the force along the thread breaks Coulomb's law (`coupling.sliding.cone_residual`;
    what accelerates an abscissa with ε counts as well).
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
    channel: float | None = None


def observe(system: System, start: State, state: State) -> tuple[PiercingObservation, ...]:
    """All piercings of a state; `start` is the state that slip and displacement are measured from."""
    at = system.passage(state.q, state.s)
    _, t = tangent(at, state.lam, state.y)
    couple = couple_on_thread(at, state.lam, state.y)
    internal = system.thread.gradient(system.thread.points(state.q, state.frame))[:, :3]
    shares = at.b[:, :2].swapaxes(1, 2) @ thread_force(at, state.lam, state.y)
    law = law_of(system, state.s, state.present, 0.0, state.s)
    normal = normal_force(at, state.lam, state.y, law.per_channel)
    cone = cone_residual(law, state.slip, at, state.s, state.lam, state.y)
    out = []
    for k, piercing in enumerate(system.piercings):
        force, y = state.lam[k, :3], state.y[k]
        along = float(force @ t[k])
        before, after = tensions(internal, at.first, shares, state.s, k, t[k])
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
                tension_before=before,
                tension_after=after,
                state=sliding_state(system, state, k),
                tangent=t[k],
                u=y[3:6],
                v=y[6:],
                cone_residual=float(cone[k]),
                channel=piercing.friction.channel if piercing.friction else None,
            )
        )
    return tuple(out)


def sliding_state(system: System, state: State, k: int) -> str:
    """ "left", "anchored", "slip" or "stick"."""
    if not state.present[k]:
        return "left"
    if not system.piercings[k].slides:
        return "anchored"
    return "slip" if state.slip[k] else "stick"


def tensions(internal: Array, first: Indices, shares: Array, s: Array, k: int, t: Array) -> tuple[float, float]:
    """Tension just before and after hole k [N], from the elastic forces (n, 3) on the control points.

    ψ = Σ b_i over the points beyond the hole rises from 0 to 1 over the spans next to it, so the sum of their elastic
    forces is the force ∫(EA ε T + …)·ψ' ds that the thread transmits there: in equilibrium exactly the pull on that
    side. A pointwise strain would not do, since a C² curve cannot jump at the hole. What another hole puts on the
    points on this one's far side, `shares` (m, 4, 3) at the points from `first` (m,) on, is counted with the others of
    its side. The sign is that of the component along the tangent `t`; a push is negative. Zero where no point lies
    beyond.
    """
    points = first[:, None] + LOCAL
    beyond, behind = points >= first[k], points < first[k] + len(LOCAL)
    before = -internal[: first[k]].sum(axis=0) - shares[beyond & (s < s[k])[:, None]].sum(axis=0)
    after = internal[first[k] + len(LOCAL) :].sum(axis=0) + shares[behind & (s > s[k])[:, None]].sum(axis=0)
    return signed_length(before, t), signed_length(after, t)


def signed_length(force: Array, t: Array) -> float:
    """|F| with the sign of F·t."""
    return float(np.copysign(np.linalg.norm(force), force @ t))
