"""Coulomb's law of pressed surfaces: a slip w in the tangent plane of every pair with friction, and a force τ.

    |τ| ≤ μ p,   w = 0 if |τ| < μ p,   τ = −μ p w/|w| if w ≠ 0

w counts from the start of the step, so that a sticking pair keeps its place and no other memory is
needed. With g ≥ 0, p ≥ 0 and p g = 0 the law states that two terms are zero (Alart & Curnier, Computer
Methods in Applied Mechanics and Engineering 92, 1991), for any r > 0 [N/m]:

    p − ⟨p − r g⟩,   τ − b min(1, μ p/|b|) with b = τ − r w

Pairs and slips respond by c = c_open + C_cc P, with c = (g, w) and P = (p, τ). Under given site
forces the law is solved by a semismooth Newton method. Each pair is open, sticks or slips according
to the last forces, and if it slips, b rotates according to its tangent. The law is homogeneous, so
that its tangent is linear, with the unit vector n = b/|b| and β = μ p/|b|:

    (1 − β (1 − n nᵀ)) τ + β r (1 − n nᵀ) w − μ p n = 0

This is also the part of contact in a correction of the coupled system (`coupling.joins.contact`).
A correction is shortened until the violation of the law decreases, because full corrections can
return to the same active sets again and again. In the first corrections the violation need only be
less than the largest of the last three (Grippo, Lampariello & Lucidi, SIAM J. Numer. Anal. 23,
1986).
"""

from dataclasses import dataclass, field

import numpy as np
from scipy.sparse import csr_array

from coupling.arrays import Array, Flags, Indices
from tissue.errors import OrganError

NO_PAIRS = np.zeros(0, dtype=bool)
LAW = 1e-10  # of the largest contact force: allowed violation of the law when corrections no longer reduce it
BETTER = 0.5  # ratio of the violation after and before a correction that still reduces it
FIRM = 1e-12  # of its own compliance: slip of a sticking pair, because a roller may hold one of its nodes too
CORRECTIONS = 200  # at most; of 402 laws, of points on a cylinder and of lips, the slowest took 63
SHORTEST = 1e-3  # part of a correction: of these laws 0, 1, 7 and 63 fail with 1/1000, 1/64, 1/16 and whole ones
SOFT = 0.5  # of the stiffness of a pair, for r: of 321 laws 1 fails, and with 1 and 0.7 six, with 0.6 three
LATEST, LENIENT = 3, 24  # violations that bound the next, in the first corrections; with one, 2 laws fail
TINY = np.finfo(float).tiny
NO_HOLD = "pressed surfaces give way to each other, as if the tissue snaps"


@dataclass(frozen=True)
class Rubbing:
    """The active set of m pairs with friction, and the tangent of their law.

    `slips` (m,) are those that slip if they are pressed. The tangent has n, `along` `(m, 2)`, and
    β, `share` `(m,)`.
    """

    slips: Flags = field(default_factory=lambda: NO_PAIRS)
    along: Array = field(default_factory=lambda: np.zeros((0, 2)))
    share: Array = field(default_factory=lambda: np.zeros(0))


def stuck(pairs: int) -> Rubbing:
    """Return the active set of `pairs` pairs with friction that all stick."""
    return Rubbing(np.zeros(pairs, dtype=bool), np.zeros((pairs, 2)), np.zeros(pairs))


@dataclass(frozen=True)
class Law:
    """Coulomb's law of `k` pairs with compliance `C` `(k + 2m, k + 2m)` [m/N].

    `rough` `(m,)` are those with friction, `mu` `(m,)` [-] is μ, and `r_gap` `(k,)` and `r_slip`
    `(m,)` [N/m] are r of gaps and of slips.
    """

    C: Array
    k: int
    rough: Indices
    mu: Array
    r_gap: Array
    r_slip: Array


def law_of_pairs(C: Array, friction: Array) -> Law:
    """Return the law of pairs with compliance `C` (k + 2m, k + 2m) [m/N] and coefficients of `friction` (k,) [-].

    r is about half of the stiffness of each pair.
    """
    k, rough = len(friction), np.flatnonzero(friction)
    give = np.diag(C)
    least = TINY + np.finfo(float).eps * give.max()
    slips = give[k:].reshape(-1, 2).mean(axis=1)
    stiff = SOFT / np.maximum(give[:k], least), SOFT / np.maximum(slips, least)
    return Law(C, k, rough, friction[rough], *stiff)


def rows_of(law: Law, pressed: Flags, rubbing: Rubbing) -> tuple[csr_array, csr_array]:
    """Return L_c and L_P of the tangent of the law, L_c c + L_P P = 0 [N], shape `(k + 2m, k + 2m)` each."""
    on, m = pressed[law.rough], len(law.rough)
    slips = on & rubbing.slips
    across = np.eye(2) - rubbing.along[:, :, None] * rubbing.along[:, None]
    beta, sticks = (rubbing.share * slips)[:, None, None], (on & ~slips)[:, None, None]
    by_slip = law.r_slip[:, None, None] * (beta * across + sticks * np.eye(2))
    by_force = np.where(sticks, FIRM * np.eye(2), np.eye(2) - beta * across)
    by_push = -(law.mu * slips)[:, None] * rubbing.along
    gaps, own = np.arange(law.k), law.k + np.arange(2 * m)
    of_push, pairs = (own, np.repeat(law.rough, 2)), own.reshape(m, 2)
    of_block = np.repeat(pairs, 2, axis=1).ravel(), np.tile(pairs, (1, 2)).ravel()

    def rows(of_gaps: Array, *parts: tuple[Array, tuple[Indices, Indices]]) -> csr_array:
        i, j = (np.concatenate([gaps, *(at[axis] for _, at in parts)]) for axis in (0, 1))
        values = np.concatenate([of_gaps, *(part.ravel() for part, _ in parts)])
        return csr_array((values, (i, j)), shape=(law.k + 2 * m,) * 2)

    L_c = rows(np.where(pressed, law.r_gap, 0.0), (by_slip, of_block))
    return L_c, rows(np.where(pressed, 0.0, 1.0), (by_force, of_block), (by_push, of_push))


def forces_by_tangent(law: Law, pressed: Flags, rubbing: Rubbing, c_open: Array) -> Array:
    """Return P by the tangent of the law for gaps and slips `c_open` without forces.

    `c_open` and P have shape `(k + 2m, …)`, for one or several columns. Raises `OrganError`.
    """
    L_c, L_P = rows_of(law, pressed, rubbing)
    acts = np.concatenate([pressed, np.repeat(pressed[law.rough], 2)])
    P = np.zeros_like(c_open)
    if acts.any():
        matrix = (L_c[acts] @ law.C[:, acts]) + L_P[acts][:, acts].toarray()
        try:
            P[acts] = np.linalg.solve(matrix, -(L_c[acts] @ c_open))
        except np.linalg.LinAlgError as error:
            raise OrganError(NO_HOLD) from error
    return P


def targets(law: Law, P: Array, c: Array) -> tuple[Array, Array]:
    """Return p − r g `(k,)` and b = τ − r w `(m, 2)` [N]."""
    by_slip = np.repeat(law.r_slip, 2) * c[law.k :]
    return P[: law.k] - law.r_gap * c[: law.k], (P[law.k :] - by_slip).reshape(-1, 2)


def bounds(law: Law, P: Array) -> Array:
    """Return μ p of the pairs with friction, shape `(m,)` [N]."""
    return np.asarray(law.mu * np.maximum(P[law.rough], 0.0))


def projected(law: Law, P: Array, c: Array) -> Array:
    """Return P projected on the law, shape `(k + 2m,)` [N]."""
    push, b = targets(law, P, c)
    size = np.linalg.norm(b, axis=1)
    share = np.minimum(1.0, bounds(law, P) / np.maximum(size, TINY))
    return np.concatenate([np.maximum(push, 0.0), (share[:, None] * b).ravel()])


def violation(law: Law, P: Array, c: Array) -> tuple[float, float]:
    """Return the norm of what violates the law in P at the gaps and slips `c` [N], and its largest
    part of the largest force [-].
    """
    lawful = projected(law, P, c)
    wrong, largest = P - lawful, max(np.abs(P).max(), np.abs(lawful).max(), TINY)
    return float(np.linalg.norm(wrong)), float(np.abs(wrong).max() / largest)


def active_sets(law: Law, P: Array, c: Array) -> tuple[Flags, Rubbing]:
    """Return which pairs are pressed and which slip at given forces and gaps, with the tangent of
    the law there.
    """
    push, b = targets(law, P, c)
    size, bound = np.linalg.norm(b, axis=1), bounds(law, P)
    along = b / np.maximum(size, TINY)[:, None]
    return push > 0.0, Rubbing(size > bound, along, np.minimum(1.0, bound / np.maximum(size, TINY)))


def find_forces(law: Law, c_open: Array, pressed: Flags, rubbing: Rubbing) -> tuple[Flags, Rubbing, Array]:
    """Solve the law for gaps and slips `c_open` (k + 2m,) [m] without forces, from a given active set.

    Returns the active set of the last correction, and P (k + 2m,) [N]. Raises `OrganError`, so that
    the step is halved.
    """
    P, last, violations = forces_by_tangent(law, pressed, rubbing, c_open), np.inf, list[float]()
    for number in range(CORRECTIONS):
        c = c_open + law.C @ P
        wrong, off = violation(law, P, c)
        if off == 0.0 or BETTER * last <= off <= LAW:
            return pressed, rubbing, P
        violations.append(wrong)
        (pressed, rubbing), last = active_sets(law, P, c), off
        bound = max(violations[-LATEST if number < LENIENT else -1 :])
        P = on_the_way(law, c_open, P, forces_by_tangent(law, pressed, rubbing, c_open), bound)
    raise OrganError(f"no forces of {law.k} pairs in contact obey Coulomb's law; use shorter steps, or less friction")


def on_the_way(law: Law, c_open: Array, P: Array, new: Array, bound: float) -> Array:
    """Return the `new` forces, or the first on the way back to P that violate the law by less than `bound` [N].

    After the shortest part the search ends without this condition.
    """
    share, tried = 1.0, new
    while share > SHORTEST and not violation(law, tried, c_open + law.C @ tried)[0] < bound:
        share *= 0.5
        tried = P + share * (new - P)
    return tried
