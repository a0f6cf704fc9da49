"""Whether a step goes uphill: what it makes of energy, and what it may make.

A step of backward Euler without friction is a stationary point of the incremental potential; the one that mechanics
means is the minimum reached downhill from where the thread was. A root of the same equations that lies higher is
another branch, on which Newton has landed: its residuals are as small and its balance closes, but it makes energy,
which the audit books as numerical dissipation below zero. Friction and damping only take more.

BDF2 falls in a norm of its own, over two steps: where a stiff motion begins at once it takes in one step what it gives
back in the next. For linear motion with losses, in the norm of its energy E, the formula
A δ − B δ⁻ of the last two ways, A = (1+2ω)/(1+ω), B = ω²/(1+ω) (`coupling.integrators.BDF2`), dotted with x⁺ is

    A (ΔE + β) − B (ΔE⁻ + β⁻ + δ·δ⁻) = A W − B W⁻ − losses,

W being the work from outside and β = ½δ² what backward Euler takes on the same way. With 2 δ·δ⁻ ≤ δ² + δ⁻², and
D = W − ΔE what a step takes,

    −D ≤ r (2β⁻ − D⁻) − (1 − r) β,     r = B/A = ω²/(1+2ω),

and r < 1 where the formula is zero-stable, a third at equal steps (Dahlquist's G-stability, BIT 18, 1978). 2β⁻ − D⁻ is
the loan of the step before, of which the next one may give back the part r. An organ's β is taken to be its D.
Forces from outside that change, steps that do, and a curved way add terms of either sign that the bound leaves out.
"""

from math import sqrt
from typing import NamedTuple

from coupling.arrays import Array
from thread.kernels.loops import entry, loop


class Shares(NamedTuple):
    """Shares of energies that a step may make [-]: of what there is `create` besides what it gives back, and with that
    `there`, or `turned` of what it turns over; and by how much a force draws the thread out, `give` [m/N]."""

    create: float
    there: float
    turned: float
    give: float


def at_stake(kinetic: float, thread: float, tissue: float, prestretch: float, external: float) -> float:
    """Return the kinetic energy, the elastic one of deformation, and the work done so far, of either sign [J]."""
    return kinetic + thread + abs(tissue - prestretch) + abs(external)


def given_back(weight: float, loan: float) -> float:
    """Return what a step of BDF2 may give back of a loan [J], whose scheme has that `weight` of the position before."""
    return -weight * max(loan, 0.0)


stake, lent = loop(at_stake), loop(given_back)


@loop
def rounded_work(give: float, rounded: float, there: float) -> float:
    """Return the work of the round-off F of forces, `rounded`, where so much energy is `there` [J] and L/EA is what the
    thread may `give` [m/N]: on the way √(2 E L/EA) on which a thread that is drawn out stores that energy E, and on the
    way F L/EA on which F itself draws it out."""
    return rounded * (sqrt(2.0 * give * max(there, 0.0)) + give * rounded)


@loop
def weigh(shares: Shares, rounded: float, weight: float, old: Array, new: Array) -> tuple[float, float, float, float]:
    """Return what a step makes, what of that it may give back, what it may make besides that, and what it may make in
    all [J], from the energies before and after it, those of `coupling.reports.audit.Energies`. Its forces are `rounded`
    [N]; `weight` is as for `given_back`, zero of backward Euler."""
    there = stake(new[0], new[1], new[2], old[9], new[3])
    moved = abs(new[3] - old[3]) + abs(new[0] - old[0]) + abs(new[1] - old[1]) + abs(new[2] - old[2])
    least = rounded_work(shares.give, rounded, there)
    loose = max(shares.turned * moved, shares.there * there, least)
    return old[6] - new[6], lent(weight, old[8]), max(shares.create * there, least), loose


@loop
def goes_uphill(shares: Shares, rounded: float, weight: float, old: Array, new: Array) -> bool:
    """Whether a step makes more than it may; the arguments are those of `weigh`."""
    made, back, bound, loose = weigh(shares, rounded, weight, old, new)
    return not (made - back <= bound and made <= loose)


ask = entry(weigh)  # as Python calls it
