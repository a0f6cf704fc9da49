"""A thread whose stretch relaxes: a Prony series of its axial force, as of tissue (Simo, Comput. Methods Appl. Mech.
Eng. 60, 1987).

    N = EA (1 − Σ g_i) ε + EA Σ g_i h_i,    dh_i/dt + h_i/τ_i = dε/dt

EA is that of a sudden pull. Over a step of Δt in which the strain of a material point goes evenly from ε to ε⁺, with
x_i = Δt/τ_i and φ(x) = (1 − e⁻ˣ)/x,

    h_i⁺ = e^(−x_i) h_i + φ(x_i) (ε⁺ − ε)

so the force at its end is that of an elastic thread with another stiffness and a natural strain ε̄, and the step is a
minimum as before:

    N = EA γ (ε⁺ − ε̄),    γ = 1 − Σ g_i (1 − φ_i),    γ ε̄ = Σ g_i (φ_i ε − e^(−x_i) h_i).

ε and h_i are known at points of the material, which knots that travel pass by: nothing is transferred. A point has the
strain of the span that it is on, and a span has the mean of ε̄ over its points, since the jump of strain at a hole stays
in the material where the hole was, narrower than the spans that come there.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from thread.arrays import Array

POINTS = 2000  # of the material: a strand of 5 mm of a thread of 0.5 m has twenty
SHORT = 1e-3  # Δt/τ below which (1 − φ)/x loses digits, and its series has an error of 1e-8


class Series(Protocol):
    """A Prony series with one share g_i [-] for each time τ_i; `tissue.Prony` is one."""

    @property
    def shares(self) -> Sequence[Any]:
        """g_i, `b` numbers [-]."""

    def decays(self, dt: float) -> Array:
        """Return e^(−Δt/τ_i), shape `(b,)`."""

    def means(self, dt: float) -> Array:
        """Return φ(Δt/τ_i), shape `(b,)`."""


@dataclass(frozen=True)
class Memory:
    """The strain that a thread remembers at the start of a step of `dt` [s], at the abscissae `s` (…) [m]: `strain` (…)
    [-], and of each time of the series the strain h_i that is `held` (b, …) [-]."""

    s: Array
    strain: Array
    held: Array
    dt: float

    def part(self, series: Series) -> float:
        """Return γ, the part of the stiffness that the step meets [-]."""
        return 1.0 - float(np.asarray(series.shares) @ (1.0 - series.means(self.dt)))

    def natural(self, series: Series) -> Array:
        """Return ε̄, the strain without force at the end of the step, shape `(…)` [-]."""
        shares, decays, means = np.asarray(series.shares), series.decays(self.dt), series.means(self.dt)
        kept = (shares @ means) * self.strain - np.tensordot(shares * decays, self.held, 1)
        return np.asarray(kept / self.part(series))

    def held_after(self, series: Series, strain: Array) -> Array:
        """Return h_i at the end of the step under the `strain` (…) there, shape `(b, …)` [-]."""
        rows = zip(series.decays(self.dt), series.means(self.dt), self.held, strict=True)
        return np.stack([decay * held + mean * (strain - self.strain) for decay, mean, held in rows])

    def dissipated(self, series: Series, strain: Array) -> Array:
        """Return ∫Σ g_i h_i²/τ_i dt over the step to the `strain` (…), per EA, shape `(…)` [-].

        It is the work Σ g_i ∫h_i dε less what h_i stores more, with the mean φ h + φ₂ Δε of h_i over the step.
        """
        after, change, means = self.held_after(series, strain), strain - self.strain, series.means(self.dt)
        rows = zip(means, second_means(series.decays(self.dt), means), self.held, strict=True)
        over = np.stack([mean * held + second * change for mean, second, held in rows])
        return np.tensordot(np.asarray(series.shares), change * over - 0.5 * (after**2 - self.held**2), 1)

    def over(self, low: Array, high: Array) -> "Memory":
        """Return the memory of spans from abscissae `low` to `high` (…) [m], each by its means."""
        mean = lambda row: (integral(self.s, row, high) - integral(self.s, row, low)) / (high - low)  # noqa: E731
        return Memory(0.5 * (low + high), mean(self.strain), np.stack([mean(row) for row in self.held]), self.dt)


def integral(s: Array, values: Array, to: Array) -> Array:
    """Return the integrals from the first of the abscissae `s` (k,) on `to` others, of `values` (k,) linear in
    between, of the shape of `to`."""
    step = np.diff(s)
    sums = np.append(0.0, np.cumsum(0.5 * (values[1:] + values[:-1]) * step))
    k = np.clip(np.searchsorted(s, to, side="right") - 1, 0, len(s) - 2)
    way = to - s[k]
    return np.asarray(sums[k] + way * (values[k] + 0.5 * way * (np.diff(values) / step)[k]))


def second_means(decays: Array, means: Array) -> Array:
    """Return φ₂(x) = (1 − φ)/x of e⁻ˣ = `decays` and φ = `means`, by its series where x is small, shape `(b,)`."""
    gone = 1.0 - decays
    short = gone < SHORT
    return np.where(short, 0.5 - (1.0 - means) / 3.0, means * (1.0 - means) / np.where(short, 1.0, gone))
