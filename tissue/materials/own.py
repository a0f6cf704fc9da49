"""A user-defined density: a function of F in Python, differentiated twice without difference
quotients.

The function is called with a `tensortrax.Tensor` of shape `(3, 3)`, whose components carry their
first and second derivatives (hyper-dual numbers: Fike & Alonso, AIAA 2011-886). Stress and tangent
are therefore exact to round-off. The function can use + − * / and powers, `F.T`, `@`, and the
functions of `tensortrax.math`:

    import tensortrax.math as tm

    def ogden(F):
        squares = tm.linalg.eigvalsh(F.T @ F)
        J = tm.linalg.det(F)
        return 2e4 / 8 * (tm.sum(squares**4) * J ** (-8 / 3) - 3)
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from tissue.arrays import Array
from tissue.errors import TissueError


@dataclass(frozen=True)
class Own:
    """The density that a function `W` returns for F, shape `(3, 3)`.

    W does not depend on the position. Every method raises `TissueError` if W fails or does not
    return a function of F, or if tensortrax is not installed.
    """

    W: Callable[[Any], Any]

    def _by(self, derivative: str, F: Array) -> Array:
        """Return a function of tensortrax, for example the gradient, of W at points `(3, 3, …)`."""
        try:
            import tensortrax
        except ModuleNotFoundError:
            raise TissueError("a strain energy from Python needs pip install 'suturefem[materials]'") from None

        def W(at: Any) -> Any:
            try:
                out = self.W(at)
            except Exception as error:
                raise TissueError(
                    f"W(F) raised {type(error).__name__}: {error}; allowed are functions of tensortrax.math"
                ) from error
            if not isinstance(out, tensortrax.Tensor) or out.shape:
                raise TissueError(f"W(F) returned {type(out).__name__}: allowed is a scalar function of F")
            return out

        found: Array = getattr(tensortrax, derivative)(W, ntrax=F.ndim - 2)(F)
        return found

    def energy(self, F: Array) -> Array:
        """Return W, shape `(…)` [J/m³]."""
        return self._by("function", F)

    def stress(self, F: Array) -> Array:
        """Return P, shape `(3, 3, …)` [Pa]."""
        return self._by("gradient", F)

    def tangent(self, F: Array) -> Array:
        """Return A, shape `(3, 3, 3, 3, …)` [Pa].

        It is symmetric to the last bit. The second derivative of an eigenvalue is symmetric to 1e-8
        only, where eigenvalues are equal.
        """
        A = self._by("hessian", F)
        return 0.5 * (A + np.moveaxis(A, (0, 1), (2, 3)))
