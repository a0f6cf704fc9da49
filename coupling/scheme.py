"""Time schemes: two numbers and two reference fields that make acceleration and velocity affine in the new position."""

from dataclasses import dataclass
from typing import Protocol

from coupling.constraints import Array


class Motion(Protocol):
    """A position and its velocity, of the thread or of the organ."""

    @property
    def position(self) -> Array:
        """[m]"""

    @property
    def velocity(self) -> Array:
        """[m/s]"""


@dataclass(frozen=True)
class BackwardEuler:
    """acceleration⁺ = a (x⁺ − x − Δt v), velocity⁺ = d (x⁺ − x), with a = 1/Δt², d = 1/Δt."""

    dt: float

    @property
    def a(self) -> float:
        """Factor of the mass [1/s²]."""
        return 1.0 / self.dt**2

    @property
    def d(self) -> float:
        """Factor of the damping [1/s]."""
        return 1.0 / self.dt

    def inertia_reference(self, position: Array, velocity: Array) -> Array:
        """Where the body would be without forces [m]."""
        return position + self.dt * velocity

    def damping_reference(self, position: Array) -> Array:
        """Where the body was [m]."""
        return position
