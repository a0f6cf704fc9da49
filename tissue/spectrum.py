"""Principal values and directions of symmetric tensors of three dimensions, in closed form for many at once.

After Eberly, A Robust Eigensolver for 3 × 3 Symmetric Matrices (Geometric Tools, 2014): of the three values, roots of a
cubic by Smith (Commun. ACM 4, 1961), one at an end of the spectrum lies apart from the other two, and its direction is
across two rows of what is left of the tensor there. In the plane across that direction the other two are those of a
tensor of two dimensions, which is exact where they meet.
"""

import numpy as np
from numpy.typing import NDArray

from tissue.arrays import Array

Flags = NDArray[np.bool_]


def spectrum(tensor: Array) -> tuple[Array, Array]:
    """Return the principal values, falling, `(3, m)`, and their unit directions, `(3, 3, m)`, the first index counting
    them, of tensors xx, yy, zz, xy, yz, xz `(6, m)`. A direction is of either sense, and of a value that is there twice
    any one across the other's."""
    size = np.abs(tensor).max(axis=0)
    unit = tensor / np.where(size > 0.0, size, 1.0)
    apart, on_top = _value_apart(unit)
    n = _direction(unit, apart)
    a, b = _across(n)
    An, Aa, Ab = (_product(unit, v) for v in (n, a, b))
    first, second, mixed = _dot(a, Aa), _dot(b, Ab), _dot(a, Ab)
    mean, half = 0.5 * (first + second), np.hypot(0.5 * (first - second), mixed)
    turn = 0.5 * np.arctan2(mixed, 0.5 * (first - second))
    cos, sin = np.cos(turn), np.sin(turn)
    upper, lower = cos * a + sin * b, cos * b - sin * a
    values = np.where(on_top, [_dot(n, An), mean + half, mean - half], [mean + half, mean - half, _dot(n, An)])
    return values * size, np.where(on_top, [n, upper, lower], [upper, lower, n])


def largest(tensor: Array) -> Array:
    """Return the largest principal value in magnitude, `(m,)`, of tensors xx, yy, zz, xy, yz, xz `(6, m)`: to
    round-off, to 1e-8 where it is there twice."""
    size = np.abs(tensor).max(axis=0)
    unit = tensor / np.where(size > 0.0, size, 1.0)
    apart, _ = _value_apart(unit)
    trace = unit[:3].sum(axis=0)
    squares = np.square(unit[:3]).sum(axis=0) + 2.0 * np.square(unit[3:]).sum(axis=0)
    mean = 0.5 * (trace - apart)
    half = np.sqrt(np.maximum(0.5 * (squares - apart**2) - mean**2, 0.0))
    return np.asarray(size * np.maximum(np.abs(apart), np.abs(mean) + half))


def _value_apart(tensor: Array) -> tuple[Array, Flags]:
    """Return the value that lies apart from the other two, and whether it is the largest; the least otherwise."""
    middle = tensor[:3].sum(axis=0) / 3.0
    rest = tensor - np.multiply.outer([1.0, 1.0, 1.0, 0.0, 0.0, 0.0], middle)
    spread = np.sqrt((np.square(rest[:3]).sum(axis=0) + 2.0 * np.square(rest[3:]).sum(axis=0)) / 6.0)
    cosine = np.clip(determinant(rest) / np.where(spread > 0.0, 2.0 * spread**3, 1.0), -1.0, 1.0)
    on_top = cosine >= 0.0
    turn = np.arccos(np.abs(cosine)) / 3.0  # at most a sixth of a half turn
    return middle + np.where(on_top, 2.0, -2.0) * spread * np.cos(turn), on_top


def determinant(tensor: Array) -> Array:
    """Return the determinant of symmetric tensors `(6, m)`."""
    xx, yy, zz, xy, yz, xz = tensor
    return np.asarray(xx * (yy * zz - yz * yz) - xy * (xy * zz - yz * xz) + xz * (xy * yz - yy * xz))


def _direction(tensor: Array, value: Array) -> Array:
    """Return the direction of a value that is there once, `(3, m)`: the longest product of two rows of A − λ1; along x
    where that is zero."""
    xx, yy, zz, xy, yz, xz = tensor
    x, y, z = xx - value, yy - value, zz - value
    products = np.array(
        [
            [xy * yz - xz * y, xz * xy - x * yz, x * y - xy * xy],  # rows x and y
            [xy * z - xz * yz, xz * xz - x * z, x * yz - xy * xz],  # rows x and z
            [y * z - yz * yz, yz * xz - xy * z, xy * yz - y * xz],  # rows y and z
        ]
    )
    lengths = np.square(products).sum(axis=1)
    longest = lengths.argmax(axis=0)[None]
    length = np.sqrt(np.take_along_axis(lengths, longest, axis=0)[0])
    n = np.take_along_axis(products, longest[None], axis=0)[0]
    return np.where(length > 0.0, n / np.where(length > 0.0, length, 1.0), np.array([[1.0], [0.0], [0.0]]))


def _across(n: Array) -> tuple[Array, Array]:
    """Return two unit vectors across unit vectors `(3, m)` and one another (Duff et al., J. Comput. Graph. Tech. 6,
    2017)."""
    x, y, z = n
    sign = np.copysign(1.0, z)
    share = -1.0 / (sign + z)
    both = x * y * share
    return np.array([1.0 + sign * x * x * share, sign * both, -sign * x]), np.array([both, sign + y * y * share, -y])


def _product(tensor: Array, v: Array) -> Array:
    xx, yy, zz, xy, yz, xz = tensor
    x, y, z = v
    return np.array([xx * x + xy * y + xz * z, xy * x + yy * y + yz * z, xz * x + yz * y + zz * z])


def _dot(v: Array, w: Array) -> Array:
    return np.asarray(v[0] * w[0] + v[1] * w[1] + v[2] * w[2])
