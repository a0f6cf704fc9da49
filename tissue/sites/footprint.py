"""Averaging rules over the width of the hole.

    ⟨f⟩ = Σ_q w_q f(x_q) with Σ_q w_q = 1,    ⟨∇f⟩ = Σ_q c_q f(x_q)

Points are in units of the radius. The rules are products of Gauss rules and equal angles, so that
they are exact for polynomials far above the degree of the shape functions. The rules have many
points, because a shape function is only piecewise polynomial.

The gradient is averaged by parts, ⟨∂f/∂x_j⟩ = ∫ w ∂f/∂x_j = ∮ w f n_j − ∫ f ∂w/∂x_j, which uses
only values of f. Gradients of shape functions jump from cell to cell. A sum of gradients needs many
more points than cells under the footprint. With fewer points this sum is as wrong as a bare point
(measured: a couple's compliance doubled at a/h = 5).

The number of points must grow while the cells shrink. A fixed sum is a set of bare points, and
their compliance has no limit (measured with 640 points and P2: orders fell from 3 to 0.5 from a/h =
4 to 6). A disc is therefore integrated exactly, facet by facet.
"""

from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from tissue.arrays import Array

WEIGHTS = ("uniform", "parabolic")  # the weights of a `tissue.sites.site.Site`
RADIAL, AROUND, RIM = 16, 40, 720  # 640 points on the disc
INWARD, ALONG, ARC = 4, 4, 16  # exact for a weight and shape functions of degree two; an arc has an angle below π
POLAR = 8  # 8 · 16 · 24 = 3072 points in the ball, half of them in a half ball


@dataclass(frozen=True)
class FootprintRule:
    """Points of the unit disc (z = 0) or of the unit ball, with their weights.

    The `points` have shape `(k, 3)`. The `weights` `(k,)` sum to one.
    """

    points: Array
    weights: Array


def disc(weight: str) -> FootprintRule:
    """Return the rule of the unit disc: weight 1/π (uniform) or 2(1 − r²)/π (parabolic)."""
    # With τ = r², w r dr dθ is dτ dθ / 2π or (1 − τ) dτ dθ / π. A Gauss rule on τ and equal angles
    # are exact.
    tau, d_tau = _gauss(RADIAL)
    radial = d_tau * (2.0 * (1.0 - tau) if weight == "parabolic" else np.ones(RADIAL))
    angle = (np.arange(AROUND) + 0.5) * (2.0 * np.pi / AROUND)
    r, theta = (a.ravel() for a in np.meshgrid(np.sqrt(tau), angle, indexing="ij"))
    points = np.column_stack([r * np.cos(theta), r * np.sin(theta), np.zeros_like(r)])
    return FootprintRule(points, np.repeat(radial / AROUND, AROUND))


def density(weight: str, r: Array) -> Array:
    """Return the weight of the unit disc at distances r from its centre.

    The weight integrates to one. It is zero outside the disc.
    """
    inside = 2.0 * (1.0 - r**2) if weight == "parabolic" else np.ones_like(r)
    return np.where(r < 1.0, inside, 0.0) / np.pi


@dataclass(frozen=True)
class Cover:
    """The unit disc cut by triangles.

    It has `points` `(k, 2)`, the triangle of each point `(k,)`, and weights `flat` `(k,)`. These
    weights are for the density 1/π. They integrate polynomials up to degree six over each part.
    Points can lie outside the disc.
    """

    points: Array
    triangles: NDArray[np.intp]
    flat: Array

    def weights(self, weight: str) -> Array:
        """Return the weights of the points for a footprint's `weight`."""
        return self.flat * (2.0 * (1.0 - np.sum(self.points**2, axis=1)) if weight == "parabolic" else 1.0)


def cover(triangles: Array) -> Cover:
    """Return the unit disc cut by triangles of a plane, shape `(f, 3, 2)`.

    A triangle is the sum of signed triangles, one between each edge and the centre. The disc cuts
    each signed triangle. Below the part of its edge inside the disc, a smaller triangle remains.
    Below each part outside the disc, a sector remains.
    """
    turn = np.sign(_cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]))
    begin, end, of = _pieces(triangles)
    outside = np.linalg.norm(0.5 * (begin + end), axis=1) > 1.0
    parts = [
        _fan(*border(begin[those], end[those]), turn[of[those]], of[those])
        for border, those in ((_chords, ~outside), (_arcs, outside))
    ]
    return Cover(*(np.concatenate(column) for column in zip(*parts, strict=True)))


def _fan(rim: Array, spread: Array, turn: Array, of: NDArray[np.intp]) -> tuple[Array, NDArray[np.intp], Array]:
    """Return points, triangles and weights between the centre and points `rim` `(k, n, 2)`.

    `spread` `(k, n)` is twice the area of each point of the rim.
    """
    rho, d_rho = _gauss(INWARD)
    weights = (turn[:, None] * spread / np.pi)[..., None] * (rho * d_rho)
    return (rim[:, :, None] * rho[:, None]).reshape(-1, 2), np.repeat(of, weights[:1].size), weights.ravel()


def _chords(begin: Array, end: Array) -> tuple[Array, Array]:
    """Return points on pieces inside the disc, and twice the area of each point."""
    t, dt = _gauss(ALONG)
    return begin[:, None] + t[:, None] * (end - begin)[:, None], _cross(begin, end)[:, None] * dt


def _arcs(begin: Array, end: Array) -> tuple[Array, Array]:
    """Return points on the circle below pieces outside the disc.

    Twice the area of each point is returned too.
    """
    t, dt = _gauss(ARC)
    angle = np.arctan2(_cross(begin, end), np.sum(begin * end, axis=1))[:, None]
    theta = np.arctan2(begin[:, 1], begin[:, 0])[:, None] + angle * t
    return np.stack([np.cos(theta), np.sin(theta)], axis=-1), angle * dt


def _pieces(triangles: Array) -> tuple[Array, Array, NDArray[np.intp]]:
    """Return the edges of triangles that reach into the unit disc, cut where they cross the circle.

    The pieces are returned as first points, last points, `(k, 2)` each, and the triangle of each
    piece `(k,)`.
    """
    a = triangles
    d = np.roll(triangles, -1, axis=1) - a
    dd, ad, aa = (np.sum(x * y, axis=-1) for x, y in ((d, d), (a, d), (a, a)))
    root = np.sqrt(np.maximum(ad**2 - dd * (aa - 1.0), 0.0))
    cuts = np.clip(np.stack([0.0 * dd, (-ad - root) / dd, (-ad + root) / dd, 1.0 + 0.0 * dd], axis=-1), 0.0, 1.0)
    corner = a[:, :, None] + cuts[..., None] * d[:, :, None]
    longer = np.diff(cuts, axis=-1) > 0.0
    longer &= _reaching(a, dd, ad)[:, None, None]
    of = np.broadcast_to(np.arange(len(a))[:, None, None], longer.shape)
    return corner[:, :, :-1][longer], corner[:, :, 1:][longer], of[longer]


def _reaching(a: Array, dd: Array, ad: Array) -> NDArray[np.bool_]:
    """Return which triangles with corners `(f, 3, 2)` have a point in the unit disc.

    The products d·d and a·d of their edges d are given, `(f, 3)`.
    """
    along = np.clip(-ad / dd, 0.0, 1.0)
    nearest = a + along[..., None] * (np.roll(a, -1, axis=1) - a)
    side = _cross(a, np.roll(a, -1, axis=1))
    holds_centre = (side >= 0.0).all(axis=1) | (side <= 0.0).all(axis=1)
    return np.asarray(holds_centre | (np.sum(nearest**2, axis=-1) < 1.0).any(axis=1))


def _cross(a: Array, b: Array) -> Array:
    return np.asarray(a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0])


def ball(weight: str) -> FootprintRule:
    """Return the rule of the unit ball: weight 3/4π (uniform) or 15(1 − ρ²)/8π (parabolic).

    The rule is composite, exact on each half z < 0 and z > 0.
    """
    rho, d_rho = _gauss(POLAR)
    density = 7.5 * (1.0 - rho**2) if weight == "parabolic" else np.full(POLAR, 3.0)
    half, d_half = _gauss(POLAR)
    cosine, d_cosine = np.concatenate([-half, half]), np.concatenate([d_half, d_half]) / 2.0
    angle = (np.arange(3 * POLAR) + 0.5) * (2.0 * np.pi / (3 * POLAR))
    R, Z, A = (a.ravel() for a in np.meshgrid(rho, cosine, angle, indexing="ij"))
    across = R * np.sqrt(1.0 - Z**2)
    weights = np.einsum("i,j,k->ijk", density * rho**2 * d_rho, d_cosine, np.full(angle.size, 1.0 / angle.size))
    return FootprintRule(np.column_stack([across * np.cos(A), across * np.sin(A), R * Z]), weights.ravel())


@dataclass(frozen=True)
class Slope:
    """The average gradient ⟨∇f⟩ = Σ_q c_q f(x_q) over the unit disc or ball.

    It has the `points` x_q `(k, 3)` and the `vectors` c_q `(k, 3)`, with Σ_q c_q = 0.
    """

    points: Array
    vectors: Array


def disc_slope(weight: str) -> Slope:
    """Return the tangential gradient over the unit disc.

    Its vectors are −∇w = 4x/π (parabolic), or only n/π on the rim (uniform).
    """
    if weight == "parabolic":
        flat = disc("uniform")
        return Slope(flat.points, 4.0 * flat.weights[:, None] * flat.points)
    angle = (np.arange(RIM) + 0.5) * (2.0 * np.pi / RIM)
    rim = np.column_stack([np.cos(angle), np.sin(angle), np.zeros(RIM)])
    return Slope(rim, 2.0 * rim / RIM)


def ball_slope(weight: str) -> Slope:
    """Return the gradient over the unit ball.

    Its vectors are −∇w = 15x/4π (parabolic), or only 3n/4π on the sphere (uniform).
    """
    rule, factor = (ball("uniform"), 5.0) if weight == "parabolic" else (_sphere(), 3.0)
    return Slope(rule.points, factor * rule.weights[:, None] * rule.points)


def half_ball_slope(weight: str) -> Slope:
    """Return the gradient over the half z < 0 of the unit ball.

    It is averaged as over the ball, plus ∮ w f n over the flat side.
    """
    whole, flat = ball_slope(weight), disc(weight)
    below = whole.points[:, 2] < 0.0
    lid = (15.0 / 8.0 if weight == "parabolic" else 3.0 / 2.0) * flat.weights[:, None] * np.array([0.0, 0.0, 1.0])
    return Slope(np.vstack([whole.points[below], flat.points]), np.vstack([2.0 * whole.vectors[below], lid]))


def _sphere() -> FootprintRule:
    """Return the uniform rule of the unit sphere; composite, exact on each half."""
    half, d_half = _gauss(2 * POLAR)
    cosine, d_cosine = np.concatenate([-half, half]), np.concatenate([d_half, d_half]) / 2.0
    angle = (np.arange(8 * POLAR) + 0.5) * (2.0 * np.pi / (8 * POLAR))
    Z, A = (a.ravel() for a in np.meshgrid(cosine, angle, indexing="ij"))
    across = np.sqrt(1.0 - Z**2)
    return FootprintRule(
        np.column_stack([across * np.cos(A), across * np.sin(A), Z]), np.repeat(d_cosine / angle.size, angle.size)
    )


@cache
def _gauss(count: int) -> tuple[Array, Array]:
    """Return Gauss–Legendre points and weights on [0, 1]."""
    x, w = np.polynomial.legendre.leggauss(count)
    return 0.5 * (x + 1.0), 0.5 * w
