"""Shape functions of Lagrange elements, from scikit-fem's elements."""

import numpy as np
from skfem import Element

from tissue.arrays import Array


def shapes(element: Element, places: Array) -> tuple[Array, Array]:
    """Return an element's shape functions φ_n `(n, a)` and ∂φ_n/∂ξ_k `(n, d, a)` at `places` `(a, d)`
    of the reference cell.
    """
    values, slopes = zip(*(element.lbasis(places.T, n) for n in range(len(element.doflocs))), strict=True)
    count, axes = places.shape
    whole = [np.broadcast_to(np.reshape(slope, (axes, -1)), (axes, count)) for slope in slopes]
    return np.array([np.broadcast_to(value, count) for value in values]), np.array(whole)
