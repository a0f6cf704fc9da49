"""The spline of (P, S) of a thread whose knots travel with its holes (`thread.packets`), at given
abscissae of the holes.

Its functions are the functions of the knots χ. Their derivatives by the rest abscissa S follow from
the chain rule:

    P_S = P'/S',   P_SS = (P'' − P_S S'')/S'²,   P_SSS = (P''' − 3 P_SS S' S'' − P_S S''')/S'³
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from thread.arrays import Array, Indices
from thread.errors import ThreadError
from thread.kernels.travel import functions_of
from thread.packets import Hold, Travel, travelling
from thread.spline import ORDERS, Spline

NEWTON = 12  # corrections at most for the χ of an abscissa, within the span that contains it
ROUND_OFF = 1e-15  # of the largest χ


@dataclass(frozen=True)
class Placed(Spline):
    """A spline of (P, S) on knots χ, with the methods of `Spline`.

    `knots` are χ. `places` (n,) [m] are the control values of S; they increase, and are equal on
    both sides of a cut. `travel` says how they move with the holes. All abscissae are S, as in any
    other spline. Raises `ThreadError` if the control values do not increase.
    """

    places: Array
    travel: Travel

    def __post_init__(self) -> None:
        super().__post_init__()
        rise = np.diff(self.places)
        rise[self.piece_starts[1:] - 1] += 1.0  # across a cut
        if not np.all(rise > 0.0):
            at = 1e3 * self.places[np.argmin(rise)]
            raise ThreadError(
                f"knots: two holes near s = {at:.4g} mm are too close, no thread remains between their knots; "
                "put them apart"
            )

    def moved(self, s: Array) -> "Placed":
        """Return the spline with its holes at `s` (m,) [m]."""
        placed = Placed(self.knots, self.travel.places(s), self.travel)
        placed.__dict__["chi"] = self.chi  # its functions do not change
        return placed

    @cached_property
    def chi(self) -> Spline:
        """The same functions over the knots χ themselves."""
        return Spline(self.knots)

    @property
    def start(self) -> float:
        """First abscissa [m]."""
        return float(self.places[0])

    @property
    def end(self) -> float:
        """Last abscissa [m]."""
        return float(self.places[-1])

    @cached_property
    def cuts(self) -> Array:
        """Abscissae of the cuts of the curve, shape `(pieces − 1,)` [m]."""
        return self.places[self.piece_starts[1:]]

    @property
    def parameters(self) -> Array:
        """Ends of the spans in χ, shape `(spans + 1,)`."""
        return self.chi.breaks

    @cached_property
    def breaks(self) -> Array:
        """Ends of the spans, shape `(spans + 1,)` [m]."""
        breaks = self.evaluate(self.chi.breaks)[0]
        breaks[np.searchsorted(self.chi.breaks, self.chi.piece_ends)] = self.piece_ends
        return breaks

    @cached_property
    def first(self) -> Indices:
        """Index of the first of the four functions on each span, shape `(spans,)`."""
        return self.chi.first

    @cached_property
    def polynomials(self) -> Array:
        """Local power coefficients in χ, as in `Spline`."""
        return self.chi.polynomials

    @cached_property
    def greville(self) -> Array:
        """Abscissae at the Greville means of χ, shape `(n,)` [m]."""
        return self.evaluate(np.clip(self.chi.greville, self.chi.start, self.chi.end))[0]

    def through(self, values: Array) -> Array:
        """Return the control values of the curve that has `values` (n, c) at `greville`."""
        return self.chi.through(values)

    def evaluate(self, parameter: Array, span: Indices | None = None) -> tuple[Array, Array, Array]:
        """Return abscissae (m,) [m], S' (m,) [m] and the functions `(m, 4, 4)` as in `basis`, at
        parameters χ (m,).

        `span` (m,) are the spans of the parameters; None: the spans that contain them.
        """
        span = self.chi.spans_of(parameter) if span is None else span
        S, S1, b = self.carried(self.chi.basis_on(span, parameter)[:, None], self.first[span])
        return S[:, 0], S1[:, 0], b[:, 0]

    def carried(self, b: Array, first: Indices) -> tuple[Array, Array, Array]:
        """Return abscissae (m, g) [m], S' (m, g) [m] and the functions (m, g, 4, 4) as in `basis`.

        The functions of χ there are `b` (m, g, 4, 4), from the control points `first` (m,) on.
        """
        out = np.empty(b.shape[:2]), np.empty(b.shape[:2]), np.empty(b.shape)
        functions_of(first.astype(np.int64), b, self.places, *out)
        return out

    def parameter(self, s: Array, span: Indices | None = None) -> Array:
        """Return χ of abscissae `s` (m,) [m], by Newton's method.

        `span` (m,) are the spans of the abscissae; None: the spans that contain them.
        """
        span = self.spans_of(s) if span is None else span
        low, high = self.chi.breaks[span], self.chi.breaks[span + 1]
        share = (s - self.breaks[span]) / (self.breaks[span + 1] - self.breaks[span])
        chi, local = low + share * (high - low), self.places[self.first[span][:, None] + np.arange(ORDERS)]
        poly = np.einsum("mri,mi->mr", self.polynomials[span], local)
        for _ in range(NEWTON):
            x = (chi - low)[:, None] ** np.arange(ORDERS)
            slope = np.sum(poly[:, 1:] * np.arange(1, ORDERS) * x[:, :-1], axis=1)
            step = (np.sum(poly * x, axis=1) - s) / slope
            chi = chi - step
            if np.abs(step).max(initial=0.0) <= ROUND_OFF * self.chi.end:
                break
        return np.asarray(chi)

    def basis(self, s: ArrayLike, home: Array | None = None) -> tuple[Indices, Array]:
        """Return the functions and their derivatives by S at abscissae `s`, as in `Spline`."""
        s = np.asarray(s, dtype=np.float64)
        span = self.spans_of(s, home)
        return self.first[span], self.evaluate(self.parameter(s, span), span)[2]


def through_holes(length: float, s: Array, directed: bool, longest: float) -> Placed:
    """Return the spline of a slack thread of a rest `length` [m] whose knots travel with holes at
    `s` (m,) [m].

    All holes are `directed`, or none. No span is longer than `longest` [m], and no span is much
    shorter before the thread bends.
    """
    holds = [Hold(k, at, directed, longest) for k, at in enumerate(s.tolist())]
    travel = travelling(length, holds, len(holds), longest, (None, None))
    return Placed(travel.knots, travel.places(s), travel)
