"""An elastica through two sleeves in an elastic body, as a boundary-value problem of its own: nothing is shared with
the code that it is compared with.

A rod in a plane, given by EA and EI, is pulled at its start by a dead force, passes two holes that impose their own
direction, and is held by its end at a point, free to turn there. Per rest length S, with the force F on what lies
before and the moment M,

    P' = ℓ (cos θ, sin θ)     θ' = M/EI     M' = −ℓ t × F     ½ EA ℓ (ℓ² − 1) = F·t

where ℓ is the stretch of the strain ½(ℓ² − 1). Force and couple of a hole are the jumps of F and M; the body answers to
their opposites by its compliance. What a hole does along the rod is the jump of the configurational force
M²/2EI + Nℓ − ½EA(½(ℓ² − 1))²: nothing in an ideal one (Bigoni et al. 2015), friction in a rough one.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_bvp

Array = NDArray[np.float64]

X, Z, THETA, M = range(4)  # of a segment
S, F1, F2, PUSH = slice(0, 2), slice(2, 4), slice(4, 6), slice(6, 8)  # the unknown parameters
NODES = 41
TOLERANCE = 1e-6  # of solve_bvp, relative
BEND = 5.0  # lengths over which the bend at a hole has died out
YIELDING = (0.0, 0.3, 0.6, 0.8, 1.0)  # parts of the body's compliance, one solution the guess of the next


@dataclass(frozen=True)
class Rod:
    """A rod in the plane x, z: `EA` [N], `EI` [N m²], rest `length` [m], the force `pull` (2,) [N] on its start and the
    place `tip` (2,) [m] of its end."""

    EA: float
    EI: float
    length: float
    pull: Array
    tip: Array


@dataclass(frozen=True)
class Holes:
    """Two holes: `x` (2, 2) [m] and `u` (2, 2) [-], place of each and vector across it while nothing pulls;
    `compliance` (8, 8), by which forces conjugate to x and u of one, then of the other, change them; `normal` (2,)
    [rad], the direction in which the rod passes; `mu` (2,) [-], `grip` (2,) [N] and `channel` (2,) [m] of the friction
    against a rod drawn towards its end."""

    x: Array
    u: Array
    compliance: Array
    normal: Array
    mu: Array
    grip: Array
    channel: Array


@dataclass(frozen=True)
class Answer:
    """What the holes do: abscissae `s` (2,) [m], places `x` (2, 2) [m] and directions `theta` (2,) [rad], `force`
    (2, 2) [N] and `couple` (2,) [N m], from x to z, on the rod, `tension` (2, 2) [N] of the strands before and after
    each, and the `reaction` (2,) [N] of what holds the end."""

    s: Array
    x: Array
    theta: Array
    force: Array
    couple: Array
    tension: Array
    reaction: Array


def unit(theta: Array) -> Array:
    """Return the directions at angles (...), shape `(..., 2)`."""
    return np.stack([np.cos(theta), np.sin(theta)], axis=-1)


def across(a: Array) -> Array:
    """Turn vectors (..., 2) by a right angle from x to z."""
    return np.stack([-a[..., 1], a[..., 0]], axis=-1)


def stretch(N: Array, EA: float) -> Array:
    """Return ℓ of ½ ℓ (ℓ² − 1) = N/EA by Newton, from 1 + N/EA."""
    e = N / EA
    out = 1.0 + e
    for _ in range(5):
        out = out - (0.5 * out * (out**2 - 1.0) - e) / (1.5 * out**2 - 0.5)
    return out


def forces(rod: Rod, p: Array) -> Array:
    """Return the force in each segment, shape `(3, 2)` [N]."""
    return np.stack([-rod.pull, p[F1], p[F2]])


def slopes(rod: Rod, xi: Array, y: Array, p: Array) -> Array:
    """Return the derivatives of the three segments by the share ξ of each, shape `(12, k)`."""
    y, F = y.reshape(3, 4, -1), forces(rod, p)
    t = unit(y[:, THETA])
    size = stretch(np.einsum("ikc,ic->ik", t, F), rod.EA)
    turn = -size * np.einsum("ikc,ic->ik", across(t), F)
    by_S = np.stack([size * t[..., 0], size * t[..., 1], y[:, M] / rod.EI, turn], axis=1)
    return np.asarray((np.diff([0.0, *p[S], rod.length])[:, None, None] * by_S).reshape(12, -1))


def configurational(rod: Rod, theta: Array, moment: Array, F: Array) -> Array:
    """Return M²/2EI + Nℓ − ½EA(½(ℓ² − 1))² [N]."""
    N = np.sum(unit(theta) * F, axis=-1)
    size = stretch(N, rod.EA)
    return moment**2 / (2.0 * rod.EI) + N * size - 0.5 * rod.EA * (0.5 * (size**2 - 1.0)) ** 2


def friction(holes: Holes, t: Array, force: Array, couple: Array) -> Array:
    """Return what each hole takes from a rod drawn through towards its end [N]: each end of the channel bears half of
    the force across it, and the couple by a pair of forces."""
    half, pair = 0.5 * np.sum(across(t) * force, axis=1), couple / holes.channel
    return holes.grip + holes.mu * (np.abs(half + pair) + np.abs(half - pair))


def conditions(rod: Rod, holes: Holes, yielding: float, start: Array, end: Array, p: Array) -> Array:
    """Return what must vanish at the ends of the segments, shape `(20,)`, in units of 1 mm, 1 rad, 0.1 N and 1 mN m."""
    a, b, F = start.reshape(3, 4), end.reshape(3, 4), forces(rod, p)
    force, couple = F[:-1] - F[1:], b[:-1, M] - a[1:, M]
    t = unit(b[:-1, THETA])
    f = np.stack([-force, p[PUSH, None] * t], axis=1)
    given = (yielding * holes.compliance @ f.ravel()).reshape(2, 2, 2)
    x, u = holes.x + given[:, 0], holes.u + given[:, 1]
    before = configurational(rod, b[:-1, THETA], b[:-1, M], F[:-1])
    jump = configurational(rod, a[1:, THETA], a[1:, M], F[1:]) - before
    taken = friction(holes, t, force, couple) * stretch(np.sum(t * F[:-1], axis=1), rod.EA)
    metres = [b[:-1, :2] - x, a[1:, :2] - x, b[-1, :2] - rod.tip]
    radians = [np.sum(u * t, axis=1), a[1:, THETA] - b[:-1, THETA]]
    # The couple −c on the hole does the work −c δα as u turns by δα; only what lies along t turns it.
    newton_metres = [p[PUSH] * np.sum(t * across(u), axis=1) + couple, a[:1, M], b[-1:, M]]
    scaled = ((metres, 1e3), (radians, 1.0), ([jump - taken], 10.0), (newton_metres, 1e3))
    return np.concatenate([scale * np.ravel(part) for parts, scale in scaled for part in parts])


def hermite(places: Array, directions: Array, xi: Array) -> tuple[Array, Array]:
    """Return a cubic between two places (2, 2) and its angle, shapes `(k, 2)` and `(k,)`."""
    size = float(np.linalg.norm(places[1] - places[0]))
    points = np.stack(
        [places[0], places[0] + size * directions[0] / 3, places[1] - size * directions[1] / 3, places[1]]
    )
    weights = np.stack([(1 - xi) ** 3, 3 * xi * (1 - xi) ** 2, 3 * xi**2 * (1 - xi), xi**3], axis=1)
    curve = weights @ points
    slope = np.gradient(curve, xi, axis=0)
    return curve, np.unwrap(np.arctan2(slope[:, 1], slope[:, 0]))


def first_guess(rod: Rod, holes: Holes, xi: Array) -> tuple[Array, Array]:
    """Return a smooth curve through the holes at rest, taut beyond them."""
    pulled, normals = float(np.linalg.norm(rod.pull)), unit(holes.normal)
    inner, outer = 1.2 * np.linalg.norm(holes.x[1] - holes.x[0]), np.linalg.norm(rod.tip - holes.x[1])
    s = rod.length - outer - np.array([inner, 0.0])
    out = (rod.tip - holes.x[1]) / outer
    start = holes.x[0] + s[0] * rod.pull / pulled
    corners = np.stack([start, *holes.x, rod.tip])
    ways = np.stack([-rod.pull / pulled, *normals, out])
    y = np.zeros((3, 4, len(xi)))
    for k in range(3):
        curve, angle = hermite(corners[k : k + 2], ways[k : k + 2], xi)
        y[k, :2], y[k, THETA] = curve.T, angle
        y[k, M] = rod.EI * np.gradient(angle, xi) / np.linalg.norm(corners[k + 1] - corners[k])
    across_holes = (holes.x[1] - holes.x[0]) / np.linalg.norm(holes.x[1] - holes.x[0])
    return y.reshape(12, -1), np.concatenate([s, pulled * across_holes, pulled * out, np.zeros(2)])


def solve(rod: Rod, holes: Holes) -> Answer:
    """Solve for the rod in its holes, which give way little by little. Raises `ArithmeticError`."""
    xi = np.linspace(0.0, 1.0, NODES)
    y, p = first_guess(rod, holes, xi)
    for yielding in YIELDING:
        bc = partial(conditions, rod, holes, yielding)
        found = solve_bvp(partial(slopes, rod), bc, xi, y, p, tol=TOLERANCE, max_nodes=5000)
        if not found.success:
            raise ArithmeticError(f"two sleeves at {yielding} of their compliance: {found.message}")
        xi, y, p = found.x, found.y, np.asarray(found.p)
    return answer(rod, y.reshape(3, 4, -1), p, found.sol)


def answer(rod: Rod, y: Array, p: Array, at: Callable[[float], Array]) -> Answer:
    """Read off what the holes do; `at` gives the segments at a share ξ. A tension is the force along the strand BEND
    lengths √(EI/F) from the hole, or in its middle where that is nearer."""
    F, before, after = forces(rod, p), y[:-1, :, -1], y[1:, :, 0]
    size, length = np.linalg.norm(F, axis=1), np.diff([0.0, *p[S], rod.length])
    way = np.minimum(BEND * np.sqrt(rod.EI / size) / length, 0.5)
    tension = [[along(F[k], at(1.0 - way[k]), k), along(F[k + 1], at(way[k + 1]), k + 1)] for k in (0, 1)]
    couple = before[:, M] - after[:, M]
    return Answer(p[S], before[:, :2], before[:, THETA], F[:-1] - F[1:], couple, np.array(tension), F[-1])


def along(F: Array, y: Array, segment: int) -> float:
    """Return the part of a force along a segment whose values are among `y` (12,) [N]."""
    return float(F @ unit(y.reshape(3, 4)[segment, THETA]))
