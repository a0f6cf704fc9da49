"""The check whether a step goes uphill: the energy that it creates, and the energy that it may create.

A step of backward Euler without friction is a stationary point of the incremental potential. The
correct solution is the minimum reached downhill from the old state of the thread. A higher root of
the same equations is another branch to which Newton's method has jumped. Its residuals are as small
and its balance closes, but it creates energy, which the audit books as negative numerical
dissipation. Friction and damping only dissipate energy.

BDF2 is dissipative in its own norm, over two steps: in a stiff motion that starts suddenly, one
step takes energy that the next one returns. For linear motion with losses, in the norm of its
energy E, the formula is A δ − B δ⁻ of the last two ways, with A = (1+2ω)/(1+ω) and B = ω²/(1+ω)
(`coupling.integrators.BDF2`). Its product with x⁺ is

    A (ΔE + β) − B (ΔE⁻ + β⁻ + δ·δ⁻) = A W − B W⁻ − losses.

W is the external work, and β = ½δ² the dissipation of backward Euler on the same way. With 2 δ·δ⁻ ≤
δ² + δ⁻², and with the energy D = W − ΔE taken by a step,

    −D ≤ r (2β⁻ − D⁻) − (1 − r) β,     r = B/A = ω²/(1+2ω).

r < 1 if the formula is zero-stable; it is a third at equal steps (Dahlquist's G-stability, BIT 18,
1978). 2β⁻ − D⁻ is the loan of the last step, of which the next step may return the part r. The β of
an organ is assumed equal to its D. External forces that change, step sizes that change, and a
curved way add terms of either sign, which the bound does not contain.
"""

from math import sqrt
from typing import NamedTuple

from coupling.arrays import Array
from thread.kernels.loops import entry, loop
from thread.kernels.records import record


@record
class Shares(NamedTuple):
    """Shares of energies that a step may create [-].

    - `create`: of the available energy, in addition to the returned loan.
    - `there`, `turned`: limits of the energy created including the loan, of the available energy or
      of the turnover, whichever is larger.
    - `give` [m/N]: extension of the thread per force.
    """

    create: float
    there: float
    turned: float
    give: float


def at_stake(kinetic: float, thread: float, tissue: float, prestretch: float, external: float) -> float:
    """Return the sum of the kinetic energy, the elastic energy of deformation, and the absolute
    value of the work so far [J].
    """
    return kinetic + thread + abs(tissue - prestretch) + abs(external)


def given_back(weight: float, loan: float) -> float:
    """Return the energy that a step of BDF2 may return of a loan [J].

    `weight` is the weight of the earlier position in its scheme.
    """
    return -weight * max(loan, 0.0)


stake, lent = loop(at_stake), loop(given_back)


@loop
def rounded_work(give: float, rounded: float, there: float) -> float:
    """Return the work of the round-off F of forces, `rounded` [N], with the energy E that is `there` [J].

    The thread's compliance L/EA is `give` [m/N]. The work has two parts, on two ways. On the way
    √(2 E L/EA) a thread that is drawn out stores the energy E. On the way F L/EA the force F itself
    draws the thread out.
    """
    return rounded * (sqrt(2.0 * give * max(there, 0.0)) + give * rounded)


@loop
def weigh(shares: Shares, rounded: float, weight: float, old: Array, new: Array) -> tuple[float, float, float, float]:
    """Return four energies of a step [J]: the created one, the part of the loan that it may return,
    and two bounds.

    The first bound is for the created energy minus the returned loan, and the second one for the
    whole created energy. The energies before and after the step are those of
    `coupling.reports.audit.Energies`. Its forces have the round-off `rounded` [N]. `weight` is as
    for `given_back`; it is zero for backward Euler.
    """
    there = stake(new[0], new[1], new[2], old[9], new[3])
    moved = abs(new[3] - old[3]) + abs(new[0] - old[0]) + abs(new[1] - old[1]) + abs(new[2] - old[2])
    least = rounded_work(shares.give, rounded, there)
    loose = max(shares.turned * moved, shares.there * there, least)
    return old[6] - new[6], lent(weight, old[8]), max(shares.create * there, least), loose


@loop
def goes_uphill(shares: Shares, rounded: float, weight: float, old: Array, new: Array) -> bool:
    """Return whether a step creates more energy than it may; the arguments are those of `weigh`."""
    made, back, bound, loose = weigh(shares, rounded, weight, old, new)
    return not (made - back <= bound and made <= loose)


ask = entry(weigh)  # for Python
