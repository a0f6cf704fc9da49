"""The organ's part of a step, for a linear organ under constant loads.

The organ has no inertia (`coupling.interfaces.Steady`), or moves in modes that are integrated
independently (`coupling.interfaces.Modal`).
"""

from typing import NamedTuple

import numpy as np

from coupling.arrays import Array
from coupling.kernels.iteration import Given
from coupling.kernels.steps.audit import (
    BODY_BY_MEAN,
    BODY_ELASTIC,
    BODY_KINETIC,
    BODY_LOADS,
    BODY_NUMERICAL,
    BODY_VISCOUS,
    Motion,
)
from thread.kernels.loops import loop
from thread.kernels.records import record


@record
class Pace(NamedTuple):
    """The time scheme.

    The step `dt` [s], the factors `a` [1/s²] and `d` [1/s], the weights of the positions `now` and
    `before`, and whether it uses two earlier states (`two_step`).
    """

    dt: float
    a: float
    d: float
    now: float
    before: float
    two_step: bool


@record
class Organ(NamedTuple):
    """An organ without inertia (`still`), or the modes of an organ.

    - `elastic` [J], `sag` (m, 9): without inertia, the elastic energy under the loads alone, and
      the displacement of the sites by the loads.
    - `mu`, `load` (n,): masses and loads of modes of stiffness one.
    - `W` (n, 9p), `Y` (9p, n), `y0` (9p,): displacement of the modes by site forces; rows and
      reference of the sites.
    - `missed` (k, n): residual of the equations of motion per acceleration of the modes.
    - `alpha` [1/s], `beta` [s]: Rayleigh's factors.
    - `accuracy`, `rounded` [√J]: the residual in a step is at most `accuracy` times the largest
      forces so far, plus `rounded`.
    """

    still: bool
    elastic: float
    sag: Array
    mu: Array
    load: Array
    W: Array
    Y: Array
    y0: Array
    missed: Array
    alpha: float
    beta: float
    accuracy: float
    rounded: float


@record
class Going(NamedTuple):
    """The motion of modes without site forces, `free` (n,), and the references of their `inertia`
    and `damping`.
    """

    free: Array
    inertia: Array
    damping: Array


@loop
def go_free(pace: Pace, organ: Organ, given: Given, now: Motion, earlier: Motion, going: Going) -> None:
    """Write the motion of the modes without site forces, and the sites that result from it."""
    for i in range(len(organ.mu)):
        U, mu = now.U[i], organ.mu[i]
        going.damping[i] = pace.now * U + pace.before * earlier.U[i]
        going.inertia[i] = going.damping[i] + (pace.now * now.V[i] + pace.before * earlier.V[i]) / pace.d
        rest = going.damping[i] - U
        moved = pace.a * (going.inertia[i] - U) + organ.alpha * pace.d * rest
        diagonal = (pace.a + organ.alpha * pace.d) * mu + (1.0 + organ.beta * pace.d)
        going.free[i] = U + (organ.load[i] + mu * moved + organ.beta * pace.d * rest - U) / diagonal
    for j in range(len(organ.y0)):
        y = organ.y0[j]
        for i in range(len(organ.mu)):
            y += organ.Y[j, i] * going.free[i]
        given.y_free[j // 9, j % 9] = y


@loop
def bear(pace: Pace, organ: Organ, now: Motion, new: Motion, going: Going) -> bool:
    """Write the modes at the end of a step under its site forces. Returns whether they are valid
    for the whole organ.
    """
    for i in range(len(organ.mu)):
        U = going.free[i]
        for j in range(len(organ.y0)):
            U += organ.W[i, j] * new.f_y[j // 9, j % 9]
        new.U[i], new.V[i], new.A[i] = U, pace.d * (U - going.damping[i]), pace.a * (U - going.inertia[i])
    return holds_for_whole(organ, now, new)


@loop
def holds_for_whole(organ: Organ, now: Motion, new: Motion) -> bool:
    """Write the largest forces so far. Returns whether the modes satisfy the equations of motion of
    the whole organ.

    The residual must be below the tolerance (`tissue.organs.krylov`).
    """
    inertia, elastic, open_ = 0.0, 0.0, 0.0
    for i in range(len(organ.mu)):
        inertia += (organ.mu[i] * (new.A[i] + organ.alpha * new.V[i])) ** 2
        elastic += (new.U[i] + organ.beta * new.V[i]) ** 2
    new.drift[0] = max(now.drift[0], np.sqrt(inertia) + np.sqrt(elastic))
    for k in range(len(organ.missed)):
        left = 0.0
        for i in range(len(organ.mu)):
            left += organ.missed[k, i] * (new.A[i] + organ.alpha * new.V[i])
        open_ += left**2
    return np.sqrt(open_) <= organ.accuracy * new.drift[0] + organ.rounded


@loop
def audit_organ(organ: Organ, two_step: bool, C: Array, now: Motion, new: Motion, out: Array) -> None:
    """Write the energy turnover of the organ in a step into `out` (7,)."""
    for i in range(len(out)):
        out[i] = 0.0
    if organ.still:
        audit_still(organ, C, now, new, out)
    else:
        audit_modes(organ, two_step, now, new, out)


@loop
def audit_still(organ: Organ, C: Array, now: Motion, new: Motion, out: Array) -> None:
    """Add the energy turnover of an organ without inertia."""
    out[BODY_ELASTIC], m = organ.elastic, len(new.f_y)
    for k in range(m):
        for i in range(9):
            f, df, by_f, by_df = new.f_y[k, i], new.f_y[k, i] - now.f_y[k, i], 0.0, 0.0
            for other in range(m):
                for j in range(9):
                    entry = C[9 * k + i, 9 * other + j]
                    by_f += entry * new.f_y[other, j]
                    by_df += entry * (new.f_y[other, j] - now.f_y[other, j])
            out[BODY_ELASTIC] += organ.sag[k, i] * f + 0.5 * f * by_f
            out[BODY_LOADS] += organ.sag[k, i] * df
            out[BODY_NUMERICAL] += 0.5 * df * by_df


@loop
def audit_modes(organ: Organ, two_step: bool, now: Motion, new: Motion, out: Array) -> None:
    """Add the energy turnover of the modes.

    After BDF2 the work of damping is by the mean of both ends.
    """
    for i in range(len(organ.mu)):
        mu, U, V, dU, dV = organ.mu[i], new.U[i], new.V[i], new.U[i] - now.U[i], new.V[i] - now.V[i]
        drag = organ.alpha * mu + organ.beta
        taken = drag * V * dU
        more = -0.5 * drag * dV * dU if two_step else 0.0
        out[BODY_KINETIC] += 0.5 * mu * V * V
        out[BODY_ELASTIC] += 0.5 * U * U
        out[BODY_LOADS] += organ.load[i] * dU
        out[BODY_VISCOUS] += taken + more
        out[BODY_NUMERICAL] += 0.5 * dU * dU + mu * (0.5 * dV * dV + new.A[i] * dU - V * dV) - more
        out[BODY_BY_MEAN] -= more
