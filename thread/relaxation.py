"""A thread whose stretch relaxes: a Prony series of its axial force, as for tissue.

The model is from Simo, Comput. Methods Appl. Mech. Eng. 60, 1987:

    N = EA (1 − Σ g_i) ε + EA Σ Q_i,    dQ_i/dt + Q_i/τ_i = g_i dε/dt

EA is the instantaneous stiffness. Over a step of Δt in which the strain of a material point changes
linearly from ε to ε⁺, with x_i = Δt/τ_i and φ(x) = (1 − e⁻ˣ)/x,

    Q_i⁺ = e^(−x_i) Q_i + g_i φ(x_i) (ε⁺ − ε)

The force at the end of the step is the force of an elastic thread with another stiffness and a
natural strain ε̄, and the step is a minimum as without relaxation:

    N = EA γ (ε⁺ − ε̄),    γ = 1 − Σ g_i (1 − φ_i),    γ ε̄ = Σ g_i φ_i ε − Σ e^(−x_i) Q_i.

ε and Q_i are known at material points, and travelling knots pass over these points, so that no
transfer is needed. A point has the strain of the span that contains it. A span has the mean of ε̄
over its points. The reason is the jump of strain at a hole. The jump stays in the material while
the hole moves on, and it is narrower than the spans that come there later.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from thread.arrays import Array

POINTS = 2000  # material points: a strand of 5 mm of a thread of 0.5 m has twenty
SHORT = 1e-3  # for a smaller Δt/τ, (1 − φ)/x loses digits, and its series has an error of 1e-8


class Series(Protocol):
    """A Prony series with one share g_i [-] for each time τ_i; `tissue.Prony` is one."""

    @property
    def shares(self) -> Sequence[Any]:
        """g_i, `b` numbers [-]."""

    @property
    def total(self) -> Any:
        """Σ g_i [-]."""

    def decays(self, dt: float) -> Array:
        """Return e^(−Δt/τ_i), shape `(b,)`."""

    def means(self, dt: float) -> Array:
        """Return φ(Δt/τ_i), shape `(b,)`."""

    def met(self, dt: float) -> Any:
        """Return γ, the part of the stiffness that acts in a step of Δt [-]."""

    def held(self, stresses: Array, S: Array, dt: float) -> Array:
        """Return Σ (e^(−x_i) Q_i − g_i φ_i S) of `stresses` Q_i `(b, …)` and `S` `(…)`."""

    def after(self, stresses: Array, change: Array, dt: float) -> Array:
        """Return Q_i after a step of Δt in which S changed by `change` `(…)`, shape `(b, …)`."""


@dataclass(frozen=True)
class Memory:
    """The state of a relaxing thread at the start of a step of `dt` [s], at the abscissae `s` (…)
    [m].

    `strain` (…) [-] is the strain. `held` (b, …) [-] is the force Q_i over EA for each time of the
    series.
    """

    s: Array
    strain: Array
    held: Array
    dt: float

    def natural(self, series: Series) -> Array:
        """Return ε̄, the strain without force at the end of the step, shape `(…)` [-]."""
        return np.asarray(-series.held(self.held, self.strain, self.dt) / series.met(self.dt))

    def held_after(self, series: Series, strain: Array) -> Array:
        """Return Q_i over EA at the end of a step to the `strain` (…), shape `(b, …)` [-]."""
        return series.after(self.held, strain - self.strain, self.dt)

    def stored(self, series: Series, strain: Array) -> Array:
        """Return the energy of the springs at the end of a step to the `strain` (…), per EA, shape
        `(…)` [-].
        """
        return 0.5 * ((1.0 - series.total) * strain**2 + over_shares(series, self.held_after(series, strain) ** 2))

    def dissipated(self, series: Series, strain: Array) -> Array:
        """Return the dissipation ∫Σ Q_i²/(g_i τ_i) dt over a step to the `strain` (…), per EA,
        shape `(…)` [-].

        It is the work Σ ∫Q_i dε minus the increase of the springs' energy, with the mean φ Q + g φ₂
        Δε of Q over the step.
        """
        after, change, means = self.held_after(series, strain), strain - self.strain, series.means(self.dt)
        rows = zip(means, second_means(series.decays(self.dt), means), series.shares, self.held, strict=True)
        mean = sum(mean * held + share * second * change for mean, second, share, held in rows)
        return np.asarray(change * mean - 0.5 * over_shares(series, after**2 - self.held**2))

    def over(self, breaks: Array) -> "Memory":
        """Return the memory of the spans between `breaks` (n + 1,) [m], with the means of each
        span, in rows (n, 1).
        """
        mean = lambda row: (np.diff(integral(self.s, row, breaks)) / np.diff(breaks))[:, None]  # noqa: E731
        middles = 0.5 * (breaks[:-1] + breaks[1:])[:, None]
        return Memory(middles, mean(self.strain), np.stack([mean(row) for row in self.held]), self.dt)


def over_shares(series: Series, squares: Array) -> Array:
    """Return Σ Q_i²/g_i from the `squares` Q_i² (b, …), shape `(…)`; a share of zero contributes
    nothing.
    """
    return np.asarray(sum(each / share for each, share in zip(squares, series.shares, strict=True) if share > 0.0))


def integral(s: Array, values: Array, to: Array) -> Array:
    """Return the integrals of `values` (k,) from the first of the abscissae `s` (k,) to other
    abscissae, the shape of `to`.

    The values are linear between the abscissae.
    """
    step = np.diff(s)
    sums = np.append(0.0, np.cumsum(0.5 * (values[1:] + values[:-1]) * step))
    k = np.clip(np.searchsorted(s, to, side="right") - 1, 0, len(s) - 2)
    way = to - s[k]
    return np.asarray(sums[k] + way * (values[k] + 0.5 * way * (np.diff(values) / step)[k]))


def second_means(decays: Array, means: Array) -> Array:
    """Return φ₂(x) = (1 − φ)/x from e⁻ˣ = `decays` and φ = `means`, by its series if x is small,
    shape `(b,)`.
    """
    gone = 1.0 - decays
    short = gone < SHORT
    return np.where(short, 0.5 - (1.0 - means) / 3.0, means * (1.0 - means) / np.where(short, 1.0, gone))
