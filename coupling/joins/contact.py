"""Unilateral contact of a wound's lips: in every pair a gap g ≥ 0, a force p ≥ 0 that pushes them
apart, and p g = 0.

The p are multipliers of the same system as those of the piercings. The organ is condensed exactly
to

    y = y_free + C f_y + C_yc p,    g = g_free + C_cy f_y + C_cc p,    f_y = Φ_yᵀλ

For the pressed pairs 𝒜, p_𝒜 = −C_𝒜𝒜⁻¹ (g_free + C_cy f_y)_𝒜 and g_𝒜 = 0; the others are open with p
= 0. The organ then has the compliance C − C_y𝒜 C_𝒜𝒜⁻¹ C_𝒜y for the thread, and Newton's method is
that without contact.

The pressed pairs are an active set. Under given site forces it is the solution of a linear
complementarity problem with a symmetric positive definite matrix, which has exactly one solution.
The solution is found by an exchange of all wrong pairs at once, or of the first wrong pair if their
number does not decrease (block principal pivoting, Júdice & Pires, Computers & Operations Research
21, 1994; the single exchange is Murty's rule, which always ends). As with stick and slip, Newton's
method judges the set only by the forces of solved iterates (`coupling.step.newton.solve`), and a
way downhill by those that hold the sites (`coupling.step.descent`).

Pairs with friction have slips after the gaps, and forces along them after the p
(`coupling.joins.rubbing`). The active set is then that of Coulomb's law, C_𝒜𝒜⁻¹ is replaced by its
tangent, and the condensed compliance is no longer symmetric.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import Generic, TypeVar

import numpy as np
from scipy.linalg import cho_factor, cho_solve, solve_triangular

from coupling.arrays import Array, Flags, Indices
from coupling.errors import CouplingError
from coupling.interfaces import Answer, Body
from coupling.joins.rubbing import (
    LAW,
    NO_HOLD,
    Law,
    Rubbing,
    find_forces,
    forces_by_tangent,
    law_of_pairs,
    stuck,
    violation,
)
from coupling.kernels.border import NINE
from coupling.kernels.constraints import site_force
from coupling.system import State, System
from tissue.errors import OrganError

Factor = TypeVar("Factor")

ROUND_OFF = 1e-12  # of the largest gap without contact: round-off times a condition number of 10³ of the compliance
CHANCES = 3  # exchanges of all wrong pairs without a decrease of their number, at most
EXCHANGES = 20  # per pair, at most; about ten in all are usual
NO_FORCES = np.zeros(0)


@dataclass(frozen=True)
class Contact(Generic[Body]):
    """The pairs in a step.

    `g_free` (k,) [m], `C_cy` (k, 9m), the organ's `answer`, and the coefficient of `friction` of
    each pair [-], empty if no pair has friction.
    """

    g_free: Array
    C_cy: Array
    answer: Answer[Body]
    friction: Array = field(default_factory=lambda: NO_FORCES)

    @property
    def rubs(self) -> bool:
        """Whether any pair has friction."""
        return bool(self.friction.any())

    @cached_property
    def law(self) -> Law:
        """Coulomb's law of pairs with friction; as expensive as `C_cc`."""
        return law_of_pairs(self.C_cc, self.friction)

    @property
    def stuck(self) -> Rubbing:
        """The active set in which all pairs with friction stick."""
        return stuck(int(np.count_nonzero(self.friction)))

    @property
    def C_cc(self) -> Array:
        """Gaps by all contact forces, shape `(k, k)` [m/N]; expensive."""
        return self.answer.gaps_by_forces(np.arange(len(self.g_free)))[: len(self.g_free)]

    def pressing(self, pressed: Flags) -> Array:
        """Return the gaps by the forces of the pairs `pressed`, shape `(k, j)` [m/N]."""
        return self.answer.gaps_by_forces(np.flatnonzero(pressed))[: len(self.g_free)]

    def acting(self, pressed: Flags) -> Indices:
        """Return the numbers of the gaps and slips along which pairs that are `pressed` have forces."""
        if not self.rubs:
            return np.flatnonzero(pressed)
        return np.flatnonzero(np.append(pressed, np.repeat(pressed[self.law.rough], 2)))

    def gaps_when_open(self, f: Array) -> Array:
        """Return the gaps without contact forces under the site forces `f` (9m,), shape `(k,)` [m]."""
        return np.asarray(self.g_free + self.C_cy @ f)

    def slack(self, open_gaps: Array, force: float) -> float:
        """Return the tolerance of a gap [m] if the holes' forces have an error of `force` [N]."""
        by_forces = np.abs(self.C_cy[:, np.arange(self.C_cy.shape[1]) % NINE < 3]).sum(axis=1)
        return float(ROUND_OFF * np.abs(open_gaps).max() + force * by_forces.max())


def closed_by(contact: Contact[Body], pressed: Flags, rubbing: Rubbing, opened: Array) -> Array:
    """Return the forces, `(k,)` or `(k, i)` [N], that close the pairs `pressed` with their friction.

    The forces can be tensile. `opened` [m] are the gaps without forces.
    """
    p = np.zeros_like(opened)
    if not pressed.any():
        return p
    if contact.rubs:
        return forces_by_tangent(contact.law, pressed, rubbing, opened)
    p[pressed] = -cho_solve(factorize_pressed(contact.pressing(pressed)[pressed], cho_factor), opened[pressed])
    return p


def factorize_pressed(C: Array, factorize: Callable[[Array], Factor]) -> Factor:
    """Return the Cholesky factor of C_cc of the pressed pairs, `C` (j, j) [m/N].

    Raises `OrganError` if a force on the lips would draw them together: beyond a point at which
    tissue at finite strain snaps.
    """
    try:
        return factorize(0.5 * (C + C.T))  # C is symmetric up to the residual of the solver
    except np.linalg.LinAlgError as error:
        raise OrganError(NO_HOLD) from error


def misfits(contact: Contact[Body], f: Array, pressed: Flags, force: float = 0.0) -> Flags:
    """Return the pressed pairs with tension and the open pairs that cross, without friction and
    under the site forces `f` (9m,), shape `(k,)`.

    The site forces have an error of `force` [N]. A contact force counts by the gap that it opens.
    """
    open_gaps = contact.gaps_when_open(f)
    p, slack = closed_by(contact, pressed, contact.stuck, open_gaps), contact.slack(open_gaps, force)
    g = open_gaps + contact.pressing(pressed) @ p[pressed]
    g[pressed] = p[pressed] * np.diag(contact.pressing(pressed)[pressed])
    return np.asarray(g < -slack)


def find_pressed(contact: Contact[Body], f: Array, pressed: Flags) -> Flags:
    """Return the pairs that are pressed under the site forces `f` (9m,), shape `(k,)`.

    The search starts from `pressed`, and its result does not depend on the start. Raises
    `CouplingError` if there is no such set, which does not happen for a body with a holder.
    """
    fewest, chances = len(pressed) + 1, CHANCES
    for _ in range(EXCHANGES * (1 + len(pressed))):
        wrong = misfits(contact, f, pressed)
        count = int(wrong.sum())
        if count == 0:
            return pressed
        fewest, chances = (count, CHANCES) if count < fewest else (fewest, chances - 1)
        pressed = pressed ^ (wrong if chances > 0 else first_of(wrong))
    raise CouplingError(f"contact of {len(pressed)} pairs of the lips: no set of pressed pairs was found")


def first_of(flags: Flags) -> Flags:
    """Return the flags with only the first set flag."""
    return flags & (np.cumsum(flags) == 1)


def condense(contact: Contact[Body], pressed: Flags, rubbing: Rubbing, y_free: Array, C: Array) -> tuple[Array, Array]:
    """Return `y_free` (m, 9) and `C` (9m, 9m) of the organ with the pairs `pressed` closed, with
    their friction.
    """
    if contact.rubs:
        given = np.column_stack([contact.C_cy, contact.g_free])
        P = forces_by_tangent(contact.law, pressed, rubbing, given)
        return y_free + (contact.C_cy.T @ P[:, -1]).reshape(y_free.shape), C + contact.C_cy.T @ P[:, :-1]
    factor = factorize_pressed(contact.pressing(pressed)[pressed], np.linalg.cholesky)
    closing = np.column_stack([contact.C_cy[pressed], contact.g_free[pressed]])
    half = solve_triangular(factor, closing, lower=True)
    by_sites = half[:, :-1]
    return y_free - (by_sites.T @ half[:, -1]).reshape(y_free.shape), C - by_sites.T @ by_sites


# -- of a system -------------------------------------------------------------------------------------------------------


def contact_of(system: System[Body], answer: Answer[Body]) -> Contact[Body] | None:
    """Return the contact of a step; None if the organ has no lips that may touch. Other holds open no gap."""
    count = len(answer.g_free)
    if system.contact is not None and system.contact.bears:  # the gaps and slips of the thread's points follow
        count -= len(answer.points) * (3 if system.contact.friction else 1)
    if not count:
        return None
    C_cy, friction = np.pad(answer.C_cy[:count], ((0, 0), (0, NINE * system.holds_off_organ))), answer.friction
    return Contact(answer.g_free[:count], C_cy, answer, friction if friction.any() else NO_FORCES)


def first_sets(contact: Contact[Body] | None, system: System[Body], state: State[Body]) -> tuple[Flags, Rubbing]:
    """Return the pairs that the site forces of a state press in the step of a contact, shape
    `(k,)`, and their friction.

    With a nonlinear organ, or with friction, the sets can be unknown before the step is solved;
    they are then those of the state, sticking.
    """
    if contact is None:
        return np.zeros(0, dtype=bool), Rubbing()
    f = site_force(system.passage_of(state), state.lam, state.y).ravel()
    before = system.organ.lips(state.organ)[1] > 0.0
    if before.any():  # a node that has slid off the other surface has nothing to press on
        before[before] = np.diag(contact.pressing(before)[np.flatnonzero(before)]) > 0.0
    try:
        return find_sets(contact, f, before, contact.stuck)[:2]
    except (CouplingError, OrganError):
        if contact.answer.linear and not contact.rubs:
            raise
        return before, contact.stuck


def find_sets(contact: Contact[Body], f: Array, pressed: Flags, rubbing: Rubbing) -> tuple[Flags, Rubbing, Array]:
    """Return the pairs pressed under the site forces `f` (9m,), their friction, and their forces (k,) [N].

    The search starts from `pressed` and `rubbing`. Raises `CouplingError`, and with friction
    `OrganError`.
    """
    if not contact.rubs:
        pressed = find_pressed(contact, f, pressed)
        p = closing_forces(contact, pressed, rubbing, f)
        return pressed, rubbing, np.maximum(p, 0.0)  # no tension by round-off
    open_gaps = contact.gaps_when_open(f)
    if (open_gaps[: len(pressed)] >= 0.0).all():
        return np.zeros_like(pressed), contact.stuck, np.zeros_like(open_gaps)
    return find_forces(contact.law, open_gaps, pressed, rubbing)


def closing_forces(contact: Contact[Body], pressed: Flags, rubbing: Rubbing, f: Array) -> Array:
    """Return the forces of the pairs `pressed` with their friction under the site forces `f` (9m,),
    shape `(k,)` [N].

    They can be tensile; such a set is then changed.
    """
    return closed_by(contact, pressed, rubbing, contact.gaps_when_open(f))


def is_lawful(contact: Contact[Body], pressed: Flags, rubbing: Rubbing, f: Array) -> bool:
    """Return whether the forces by the tangent of these sets obey Coulomb's law under the site forces `f` (9m,).

    Forces are not compared with those of another solve: where nearly all pairs slip, forces that
    obey the law to round-off can differ by a thousand times more.
    """
    opened = contact.gaps_when_open(f)
    if not pressed.any():  # open surfaces do not need their compliance
        return bool((opened[: len(pressed)] >= 0.0).all())
    P = closed_by(contact, pressed, rubbing, opened)
    return violation(contact.law, P, opened + contact.law.C @ P)[1] <= LAW


def solve_contact(system: System[Body], f_y: Array, answer: Answer[Body]) -> Array:
    """Return the contact forces of a step under given site forces `f_y` (9p,), shape `(k,)` [N]."""
    contact = contact_of(system, answer)
    if contact is None:
        return NO_FORCES
    f, k = np.pad(f_y, (0, NINE * system.holds_off_organ)), len(contact.friction) or len(contact.g_free)
    return find_sets(contact, f, np.zeros(k, dtype=bool), contact.stuck)[2]


@dataclass(frozen=True)
class ContactObservation:
    """The lips at one time.

    - `gap` (k,) [m], `force` (k,) [N]: of every pair.
    - `slide` (k,) [m]: relative motion of the nodes of a pair along the lips.
    - `friction` (k, 3) [N]: force on the node by the opposite surface.
    - `slips` (k,): whether the pair slips.
    """

    gap: Array
    force: Array
    slide: Array
    friction: Array
    slips: Flags

    def of(self, pairs: slice) -> "ContactObservation":
        """Return the observation of some pairs."""
        along = self.slide[pairs], self.friction[pairs], self.slips[pairs]
        return ContactObservation(self.gap[pairs], self.force[pairs], *along)

    @property
    def pressed(self) -> int:
        """Number of pairs with a force."""
        return int(np.count_nonzero(self.force > 0.0))

    @property
    def complementarity(self) -> float:
        """Largest |p g| over the pairs [J], zero except for round-off."""
        return float(np.abs(self.force * self.gap).max())


def observe_contact(system: System[Body], state: State[Body]) -> ContactObservation | None:
    """Return the observation of the lips of a state; None if the organ has no lips that may touch."""
    lips = system.organ.lips(state.organ)
    return ContactObservation(*lips) if lips[0].size else None
