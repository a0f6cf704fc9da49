"""Vectors as tuples of three numbers and matrices as tuples of three rows: they stay in registers."""

from thread.arrays import Array
from thread.kernels.loops import loop

Vector = tuple[float, float, float]
Matrix = tuple[Vector, Vector, Vector]

ZERO = (0.0, 0.0, 0.0)


@loop
def vector(a: Array, at: int) -> Vector:
    """Return three numbers of an array from `at` on."""
    return a[at], a[at + 1], a[at + 2]


@loop
def dot(a: Vector, b: Vector) -> float:
    """Return a · b."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@loop
def norm(a: Vector) -> float:
    """Return |a|."""
    return (a[0] * a[0] + a[1] * a[1] + a[2] * a[2]) ** 0.5


@loop
def cross(a: Vector, b: Vector) -> Vector:
    """Return a × b."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@loop
def plus(a: Vector, b: Vector) -> Vector:
    """Return a + b."""
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


@loop
def minus(a: Vector, b: Vector) -> Vector:
    """Return a − b."""
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@loop
def times(x: float, a: Vector) -> Vector:
    """Return x a."""
    return x * a[0], x * a[1], x * a[2]


@loop
def sum_of(x: float, a: Vector, y: float, b: Vector) -> Vector:
    """Return x a + y b."""
    return x * a[0] + y * b[0], x * a[1] + y * b[1], x * a[2] + y * b[2]


@loop
def outer(a: Vector, b: Vector) -> Matrix:
    """Return a ⊗ b."""
    return times(a[0], b), times(a[1], b), times(a[2], b)


@loop
def diagonal(x: float) -> Matrix:
    """Return x times the identity."""
    return (x, 0.0, 0.0), (0.0, x, 0.0), (0.0, 0.0, x)


@loop
def added(A: Matrix, B: Matrix) -> Matrix:
    """Return A + B."""
    return plus(A[0], B[0]), plus(A[1], B[1]), plus(A[2], B[2])


@loop
def combined(x: float, A: Matrix, y: float, B: Matrix) -> Matrix:
    """Return x A + y B."""
    return sum_of(x, A[0], y, B[0]), sum_of(x, A[1], y, B[1]), sum_of(x, A[2], y, B[2])


@loop
def transposed(A: Matrix) -> Matrix:
    """Return Aᵀ."""
    return (A[0][0], A[1][0], A[2][0]), (A[0][1], A[1][1], A[2][1]), (A[0][2], A[1][2], A[2][2])


@loop
def add_row(x: float, a: Vector, M: Array, i: int, j: int) -> None:
    """Add x a to row i of an array, from column j on."""
    M[i, j] += x * a[0]
    M[i, j + 1] += x * a[1]
    M[i, j + 2] += x * a[2]


@loop
def add_column(x: float, a: Vector, M: Array, i: int, j: int) -> None:
    """Add x a to column j of an array, from row i on."""
    M[i, j] += x * a[0]
    M[i + 1, j] += x * a[1]
    M[i + 2, j] += x * a[2]


@loop
def add_matrix(x: float, A: Matrix, M: Array, i: int, j: int) -> None:
    """Add x A to an array, from row i and column j on."""
    add_row(x, A[0], M, i, j)
    add_row(x, A[1], M, i + 1, j)
    add_row(x, A[2], M, i + 2, j)
