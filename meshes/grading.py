"""Element size as a function of the distance to the nearest site, shared by every graded mesh."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from meshes.errors import MeshError

Array = NDArray[np.float64]


def require_positive(name: str, value: float) -> float:
    """Return the value. Raises `MeshError` unless the value is a positive, finite number."""
    if not (math.isfinite(value) and value > 0):
        raise MeshError(f"{name} = {value!r} must be positive and finite")
    return float(value)


@dataclass(frozen=True)
class Grading:
    """Element size as a function of the distance to a site [m].

    The size is `h_site` within the distance `flat`, and then grows up to `h`. The size grows by the
    factor `growth` from element to element. A geometric sequence of elements has a size that is
    linear in the distance. `slope` is ln(growth), so that the ratio of neighbours never exceeds
    `growth`. `radius` [m] is the radius of the region with the size `h_site` (a piercing's
    footprint); at least one element has this size.
    """

    h: float
    h_site: float
    growth: float = 1.3
    radius: float = 0.0

    def __post_init__(self) -> None:
        require_positive("h", self.h)
        require_positive("h_site", self.h_site)
        if self.h_site > self.h:
            raise MeshError(f"h_site = {self.h_site!r} must not exceed h = {self.h!r}: swap them, or leave h_site out")
        if not (math.isfinite(self.growth) and self.growth > 1):
            raise MeshError(f"growth = {self.growth!r} must be finite and above 1, e.g. 1.3")
        if not (math.isfinite(self.radius) and self.radius >= 0):
            raise MeshError(f"radius = {self.radius!r} must be finite and not negative")

    @property
    def slope(self) -> float:
        """Increase of size per distance [-]."""
        return math.log(self.growth)

    @property
    def flat(self) -> float:
        """Distance from a site up to which the size is `h_site` [m]."""
        return max(self.radius, self.h_site)

    @property
    def reach(self) -> float:
        """Distance from a site at which the size `h` is reached [m]."""
        return self.flat + (self.h - self.h_site) / self.slope

    def size(self, distance: ArrayLike) -> Array:
        """Return the wanted element size at a distance from the nearest site, any shape [m]."""
        beyond = np.maximum(np.asarray(distance, dtype=float) - self.flat, 0.0)
        return np.minimum(self.h_site + self.slope * beyond, self.h)

    def cells(self, distance: ArrayLike) -> Array:
        """Return the number of elements from a site to a distance, any shape [-].

        The number is ∫ dx / size(x).
        """
        d = np.asarray(distance, dtype=float)
        growing = np.clip(d - self.flat, 0.0, self.reach - self.flat)
        return np.asarray(
            np.minimum(d, self.flat) / self.h_site
            + np.log1p(self.slope * growing / self.h_site) / self.slope
            + np.maximum(d - self.reach, 0.0) / self.h
        )

    def distance(self, cells: ArrayLike) -> Array:
        """Return the distance from a site after a number of elements, any shape [m].

        This is the inverse of `cells`.
        """
        n = np.asarray(cells, dtype=float)
        n_flat, n_reach = self.cells(self.flat), self.cells(self.reach)
        growing = np.clip(n - n_flat, 0.0, n_reach - n_flat)
        return np.asarray(
            np.minimum(n, n_flat) * self.h_site
            + np.expm1(self.slope * growing) * self.h_site / self.slope
            + np.maximum(n - n_reach, 0.0) * self.h
        )


Gradings = Grading | Sequence[Grading]  # one for all sites, or one for each


def far_size(gradings: Gradings) -> float:
    """Return the largest size far from the sites [m]."""
    return gradings.h if isinstance(gradings, Grading) else max(each.h for each in gradings)


def grading_at(gradings: Gradings, count: int) -> list[Grading]:
    """Return the grading of each of `count` sites.

    Raises `MeshError` unless there is one grading for all sites, or one for each.
    """
    each = [gradings] * count if isinstance(gradings, Grading) else list(gradings)
    if len(each) != count:
        raise MeshError(f"{len(each)} gradings for {count} sites: give one for all sites, or one for each")
    return each


def site_points(sites: ArrayLike) -> Array:
    """Return the sites as an array of shape `(p, 3)` [m], p ≥ 0.

    Raises `MeshError` for another shape and for values that are not finite.
    """
    points = np.asarray(sites, dtype=float)
    if points.size == 0:
        return np.empty((0, 3))
    if points.ndim != 2 or points.shape[1] != 3 or not np.isfinite(points).all():
        raise MeshError(f"sites must be finite points of three coordinates, shape (p, 3), not {points.tolist()!r}")
    return points
