"""The path of a thread at the start: straight pieces joined by tangent circular arcs."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from thread.arrays import Array
from thread.errors import ThreadError

# Without a radius, a right angle takes this part of the shorter of its two segments: a compromise between a gentle
# bend and a path near the corner. Other corners are as far from the path. Small turns, as of a bite that is given by
# points, then take all of their segments, so that the curvature is as even as the points allow.
TRIM = 0.25
# The largest part of a segment that one of two corners takes: just under a half, so that a straight piece remains
# between them. A corner takes twice as much if the other end of the segment has no corner.
TRIM_MAX = 0.49
# A smaller turn is round-off. A turn that differs less from 180° is a reversal, which no arc can round [rad].
ANGLE = 1e-7
# Distances that differ by less than this part of the path's length are a tie.
TIE = 1e-12


@dataclass(frozen=True)
class RoundedPath:
    """Curve of k pieces of constant curvature with a continuous tangent, parametrised by arc
    length.

    Made by `rounded_path`. Within a piece, at l from its beginning: P = o + t sin(κl)/κ + n (1 −
    cos κl)/κ.
    """

    starts: Array  # abscissa at which each piece begins, shape (k,) [m]
    lengths: Array  # shape (k,) [m]
    origins: Array  # o, shape (k, 3) [m]
    tangents: Array  # t at the beginning, unit, shape (k, 3)
    normals: Array  # n at the beginning, unit, toward the centre, zero on a straight piece, shape (k, 3)
    curvatures: Array  # κ, zero on a straight piece, shape (k,) [1/m]

    @property
    def length(self) -> float:
        """Arc length of the whole path [m]."""
        return float(self.starts[-1] + self.lengths[-1])

    def position(self, at: ArrayLike) -> Array:
        """Return the points at abscissae of any shape [m], shape `at.shape + (3,)` [m].

        Raises `ThreadError` outside the path.
        """
        k, x = self._locate(at)
        angle = self.curvatures[k] * x
        along = x * np.sinc(angle / np.pi)
        across = 0.5 * angle * x * np.sinc(angle / (2 * np.pi)) ** 2
        return np.asarray(self.origins[k] + along[..., None] * self.tangents[k] + across[..., None] * self.normals[k])

    def tangent(self, at: ArrayLike) -> Array:
        """Return the unit tangents at abscissae of any shape [m], shape `at.shape + (3,)`.

        Raises `ThreadError` outside the path.
        """
        k, x = self._locate(at)
        angle = self.curvatures[k] * x
        return np.asarray(np.cos(angle)[..., None] * self.tangents[k] + np.sin(angle)[..., None] * self.normals[k])

    def nearest(self, point: ArrayLike) -> tuple[float, float]:
        """Return abscissa and distance [m] of the path's nearest point to a point, shape `(3,)`
        [m].

        Of equal distances the smallest abscissa is returned.
        """
        abscissae, distances = self.passes(point)
        tie = distances <= distances.min() + TIE * self.length
        best = int(np.argmax(tie))
        return float(abscissae[best]), float(distances[best])

    def passes(self, point: ArrayLike) -> tuple[Array, Array]:
        """Return every local minimum of the distance to a point, shape `(3,)` [m].

        The minima are abscissae in increasing order and distances, shapes `(m,)` [m]. A thread that
        passes a place twice has two minima. On an arc about the point only the ends count. Raises
        `ThreadError` for a point that is not three finite coordinates.
        """
        x = np.asarray(point, dtype=float)
        if x.shape != (3,) or not np.isfinite(x).all():
            raise ThreadError(f"point = {x.tolist()!r} must be three finite coordinates [m]")
        candidates = self.starts + self._candidates_in_pieces(x)
        candidates = candidates[np.r_[True, np.diff(candidates) > 1e-9 * self.length]]
        minima = candidates[self._is_minimum(candidates, x)]
        return minima, np.linalg.norm(self.position(minima) - x, axis=1)

    def _locate(self, at: ArrayLike) -> tuple[NDArray[np.intp], Array]:
        """Return the piece of each abscissa and the distance from the beginning of the piece [m].

        Round-off beyond the ends of the path is clipped.
        """
        s = np.asarray(at, dtype=float)
        slack = 1e-12 * self.length
        if not np.all((s >= -slack) & (s <= self.length + slack)):
            raise ThreadError(f"abscissa outside the path: it must lie between 0 and its length {self.length!r} m")
        k = np.clip(np.searchsorted(self.starts, s, side="right") - 1, 0, len(self.starts) - 1)
        return k, np.clip(s - self.starts[k], 0.0, self.lengths[k])

    def _candidates_in_pieces(self, x: Array) -> Array:
        """Return the distance from the beginning of each piece to its only candidate for the
        nearest point to x, shape `(k,)`.

        On an arc the candidate lies in the direction of x from the centre. If this direction misses
        the arc, no point of the arc is a minimum, because a straight piece continues from either
        end. All points of the arc have the same distance from the centre; for x at the centre the
        first point is returned.
        """
        along = np.sum((x - self.origins) * self.tangents, axis=1)
        cosine = 1 - self.curvatures * np.sum((x - self.origins) * self.normals, axis=1)
        sine = self.curvatures * along
        angle = np.where(np.hypot(cosine, sine) > TIE, np.arctan2(sine, cosine), 0.0)
        straight = self.curvatures == 0
        on_arc = angle / np.where(straight, 1.0, self.curvatures)
        return np.asarray(np.clip(np.where(straight, along, on_arc), 0.0, self.lengths))

    def _is_minimum(self, at: Array, x: Array) -> NDArray[np.bool_]:
        """Return whether the distance to x decreases neither forward nor backward from each
        abscissa, shape `(k,)`.

        Half the squared distance has the slope (P − x)·P' along the path.
        """
        gap = self.position(at) - x
        slope = np.sum(gap * self.tangent(at), axis=1)
        slack = 1e-9 * np.maximum(self.length, np.linalg.norm(gap, axis=1))
        first, last = at <= TIE * self.length, at >= (1 - TIE) * self.length
        return np.asarray(((slope >= -slack) | last) & ((slope <= slack) | first), dtype=np.bool_)


def rounded_path(points: ArrayLike, radius: float | None = None) -> RoundedPath:
    """Return the path through points, shape `(m, 3)` [m], m ≥ 2, its corners rounded by arcs of
    `radius` [m].

    Each arc is tangent to both segments of its corner. Two corners take at most 0.98 of the segment
    between them; if `radius` would take more, the arc is smaller. With a radius of None the path passes
    every corner at a tenth of its shorter segment, or nearer if the turn is small.

    Raises `ThreadError` for fewer than two points, values that are not finite, equal consecutive
    points, a reversal, and a radius that is not positive.
    """
    vertices = _vertices(points)
    steps = np.diff(vertices, axis=0)
    lengths = np.linalg.norm(steps, axis=1)
    _check_steps(vertices, lengths)
    directions = steps / lengths[:, None]
    turns = _turns(directions)
    _check_turns(vertices, turns)
    trims = _trims(lengths, turns, radius)
    return _pieces(vertices, directions, lengths, turns, trims)


def _vertices(points: ArrayLike) -> Array:
    vertices = np.asarray(points, dtype=float)
    if vertices.ndim != 2 or vertices.shape[1] != 3 or len(vertices) < 2:
        raise ThreadError(
            f"a path needs two points or more of three coordinates each, not an array of shape {vertices.shape}"
        )
    bad = np.flatnonzero(~np.isfinite(vertices).all(axis=1))
    if bad.size:
        raise ThreadError(f"path point {bad[0]} = {vertices[bad[0]].tolist()} must be finite")
    return vertices


def _check_steps(vertices: Array, lengths: Array) -> None:
    short = np.flatnonzero(lengths <= 1e-12 * np.abs(vertices).max())
    if short.size:
        i = int(short[0])
        raise ThreadError(f"path points {i} and {i + 1} are equal, {vertices[i].tolist()}: drop one")


def _turns(directions: Array) -> Array:
    """Return the angle of each inner corner, shape `(m − 2,)` [rad]; zero for a turn within
    round-off.
    """
    a, b = directions[:-1], directions[1:]
    angles = np.arctan2(np.linalg.norm(np.cross(a, b), axis=1), np.sum(a * b, axis=1))
    return np.where(angles < ANGLE, 0.0, angles)


def _check_turns(vertices: Array, turns: Array) -> None:
    back = np.flatnonzero(turns > np.pi - ANGLE)
    if back.size:
        i = int(back[0]) + 1
        raise ThreadError(
            f"the path turns back on itself at point {i}, {vertices[i].tolist()}: no arc can "
            "round a turn of 180°; put a point next to it"
        )


def _trims(lengths: Array, turns: Array, radius: float | None) -> Array:
    """Return the length that each corner takes of both its segments, R tan(turn/2) capped, shape
    `(m − 2,)` [m].

    Raises `ThreadError` for a radius that is not positive.
    """
    shorter = np.minimum(lengths[:-1], lengths[1:])
    if radius is None:
        wanted = TRIM * np.tan(np.pi / 8) / np.tan(np.maximum(turns, ANGLE) / 4) * shorter
    elif np.isfinite(radius) and radius > 0:
        wanted = radius * np.tan(turns / 2)
    else:
        raise ThreadError(f"radius = {radius!r} must be positive and finite")
    corners = np.concatenate([[False], turns > 0, [False]])
    parts = TRIM_MAX * np.where(corners[:-1] & corners[1:], 1.0, 2.0) * lengths
    return np.where(turns > 0, np.minimum(wanted, np.minimum(parts[:-1], parts[1:])), 0.0)


def _pieces(vertices: Array, directions: Array, lengths: Array, turns: Array, trims: Array) -> RoundedPath:
    """Return the straight pieces and the arcs in order; a corner without a turn has no arc."""
    before, after = np.r_[0.0, trims], np.r_[trims, 0.0]
    corner = np.flatnonzero(turns > 0)
    bend = directions[1:][corner] - np.cos(turns[corner])[:, None] * directions[:-1][corner]
    curvature = np.tan(turns[corner] / 2) / trims[corner]
    order = np.argsort(np.r_[2 * np.arange(len(lengths)), 2 * corner + 1])

    def merged(straight: Array, arc: Array) -> Array:
        return np.concatenate([straight, arc])[order]

    piece_lengths = merged(lengths - before - after, turns[corner] / curvature)
    return RoundedPath(
        starts=np.r_[0.0, np.cumsum(piece_lengths)[:-1]],
        lengths=piece_lengths,
        origins=merged(
            vertices[:-1] + before[:, None] * directions,
            vertices[1:-1][corner] - trims[corner][:, None] * directions[:-1][corner],
        ),
        tangents=merged(directions, directions[:-1][corner]),
        normals=merged(np.zeros_like(directions), bend / np.sin(turns[corner])[:, None]),
        curvatures=merged(np.zeros(len(lengths)), curvature),
    )
