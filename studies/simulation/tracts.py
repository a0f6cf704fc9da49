"""Tracts: the tissue balls on which the thread bears between two holes, in a row along its path."""

from collections.abc import Callable, Container, Sequence
from itertools import pairwise
from typing import Any, TypeVar

import numpy as np
import skfem

import tissue
from studies.arrays import Array
from studies.scenario import Piercing, Scenario, Thread, Tract, refuse
from studies.simulation.laid import LaidPath
from thread.path import RoundedPath

Distances = Callable[[Array], Array]
Value = TypeVar("Value")

LOOKS = 8  # per radius: number of places along a path at which its depth is computed
MOST_LOOKS = 2000
BITE_LOOKS = 32  # places on half a strand, with linear depth in between
GRAZING = 1e-6  # of the half strand: depth from round-off of a strand on the surface
ROUND_OFF = 1e-9  # of a number of balls, and of a radius
TOUCHED = 1.01  # radii from a ball to a surface that it touches: one radius, and the error of HALVINGS
HALVINGS = 20  # of the interval between two places, to find the depth of one radius


class Ball(Piercing):
    """A hole that is one ball of a tract.

    It has the tract's name, and the length of path that it represents [m]. Its `part` is a number
    among the deep parts of the path.
    """

    tract: str
    length: float
    part: int


def with_balls(
    scenario: Scenario, through: LaidPath, s: Sequence[float], length: float, mesh: skfem.MeshTet | None
) -> tuple[tuple[Piercing, ...], list[float]]:
    """Return the holes with the balls of tracts in between, and their abscissae.

    Both are in the order of the thread. The thread has `length` [m] and its path leads `through` its
    holes, which are at `s` (p,) [m].
    """
    holes, places = list(scenario.piercing), list(s)
    if mesh is None or not scenario.tract:
        return tuple(holes), places
    depths = tissue.depths(mesh)
    for number, tract in enumerate(scenario.tract):
        first, last = (next(k for k, hole in enumerate(holes) if hole.name == name) for name in tract.between)
        low, high = places[first], places[last]
        for cut in scenario.thread.cuts:
            refuse(low < cut < high, f"tract.{number}.between", tract.between, "tract-cut", cut=cut)
        whole = through.path.length
        radius, ends = radius_of(tract, holes), (low * whole / length, high * whole / length)
        deep = deep_parts(through, *ends, radius, depths)
        refuse(not len(deep), f"tract.{number}.between", tract.between, "tract-shallow", radius=radius, number=number)
        balls = balls_of(tract, through, deep, radius)
        shares = [(at - ends[0]) / (ends[1] - ends[0]) for at, _ in balls]
        holes[last:last] = [ball for _, ball in balls]
        places[last:last] = [low + share * (high - low) for share in shares]
    return tuple(holes), places


def radius_of(tract: Tract, holes: Sequence[Piercing]) -> float:
    """Return the radius of a tract's balls [m]."""
    return tract.radius or min(hole.footprint for hole in holes if hole.name in tract.between)


def deep_parts(path: LaidPath, first: float, last: float, radius: float, depths: Distances) -> Array:
    """Return the parts of a path at least a `radius` deep in the tissue, `(k, 2)` [m].

    Only the path between two abscissae is considered. `depths` returns the depth of points `(k, 3)`
    [m].
    """
    number = int(np.clip(np.ceil(LOOKS * (last - first) / radius), LOOKS, MOST_LOOKS))
    at = np.linspace(first, last, number + 1)
    below = depths(path.position(at)) - radius
    deep = np.concatenate([[False], below >= -ROUND_OFF * radius, [False]])
    begins, stops = np.flatnonzero(deep[1:-1] & ~deep[:-2]), np.flatnonzero(deep[1:-1] & ~deep[2:])

    def border(inside: int, outside: int) -> float:
        """Return the abscissa between two places where the path is a radius deep."""
        if not 0 <= outside < len(at):
            return float(at[inside])
        low, high = at[inside], at[outside]
        for _ in range(HALVINGS):
            middle = 0.5 * (low + high)
            enough = depths(path.position([middle]))[0] >= radius
            low, high = (middle, high) if enough else (low, middle)
        return float(low)

    parts = [(border(b, b - 1), border(e, e + 1)) for b, e in zip(begins.tolist(), stops.tolist(), strict=True)]
    return np.reshape([part for part in parts if part[1] > part[0]], (-1, 2))


def of_piercings(holes: Sequence[Piercing], values: Sequence[Value]) -> list[Value]:
    """Return the values of holes that belong to piercings, without balls."""
    return [value for hole, value in zip(holes, values, strict=True) if not isinstance(hole, Ball)]


def balls_of(tract: Tract, path: LaidPath, deep: Array, radius: float) -> list[tuple[float, Ball]]:
    """Return the balls of a tract and their abscissae on the path [m].

    They are evenly spaced from end to end of each `deep` part (k, 2) [m]. Balls at both ends make
    this converge fast, because the thread presses hardest there.
    """
    balls: list[tuple[float, float, int]] = []
    for part, (low, high) in enumerate(deep.tolist()):
        count = int(np.ceil((high - low) / (tract.spacing or radius) * (1.0 - ROUND_OFF)))
        step = (high - low) / count
        balls += [(low + k * step, step * (0.5 if k in (0, count) else 1.0), part) for k in range(count + 1)]
    friction = tract.friction and tract.friction.shared(len(balls))
    same: dict[str, Any] = {"footprint": radius, "friction": friction, "tract": tract.name}
    return [
        (at, Ball(name=f"{tract.name}.{k}", at=tuple(path.position(at).tolist()), length=length, part=part, **same))
        for k, (at, length, part) in enumerate(balls, start=1)
    ]


def bites_of(
    scenario: Scenario, path: RoundedPath, at: Sequence[float], rough: Container[str], depths: Distances
) -> dict[str, float]:
    """Return the length of the path in tissue at holes with friction, by their names [m].

    Only the `rough` holes without a given channel are considered. The length is measured along the
    path's direction at the hole, from the middle of the strand before it to the middle of the
    strand after it. It is the depth of a bite, or half of a wall that is pierced on both sides. It
    is the whole wall if the path leaves it without a hole. `at` (p,) are the abscissae on the path
    [m].
    """
    if scenario.tissue is None or not at:
        return {}
    between = [0.0, *(0.5 * (low + high) for low, high in pairwise(at)), path.length]
    ways = zip(scenario.piercing, between[:-1], at, between[1:], strict=True)
    return {
        hole.name: sum(covered(path, *part, path.tangent(place), depths) for part in ((low, place), (place, high)))
        for hole, low, place, high in ways
        if hole.name in rough and hole.direction != "free" and hole.channel is None
    }


def covered(path: RoundedPath, low: float, high: float, along: Array, depths: Distances) -> float:
    """Return the length of a path in tissue `along` a unit vector (3,) between two abscissae [m].

    A strand on the surface is not in tissue.
    """
    points = path.position(np.linspace(low, high, BITE_LOOKS + 1))
    deep = depths(points) - GRAZING * (high - low)
    inside, away = np.maximum(deep, 0.0), np.abs(deep)
    shares = (inside[1:] + inside[:-1]) / np.maximum(away[1:] + away[:-1], np.finfo(float).tiny)
    return float(shares @ np.maximum(np.diff(points, axis=0) @ along, 0.0))


def gaps_of(
    scenario: Scenario, mesh: skfem.MeshTet, balls: Sequence[tuple[Ball, float]]
) -> list[tuple[float, float, bool]]:
    """Return the gaps of a tract between its deep parts.

    Each has its two abscissae on the path [m], and whether it is across a wound or a contact: the
    path then leaves the tissue at one surface and enters it at the other. `balls` have their
    abscissae on the path [m].
    """
    away = [(tissue.distances(mesh, one), tissue.distances(mesh, other)) for one, other in scenario.wounds]
    gaps = [(one, other, low, high) for (one, low), (other, high) in pairwise(balls) if one.part != other.part]
    return [(low, high, any(are_beside(*sides, one, other) for sides in away)) for one, other, low, high in gaps]


def are_beside(first: Distances, second: Distances, one: Ball, other: Ball) -> bool:
    """Return whether two balls touch two opposite surfaces.

    `first` and `second` return distances from these surfaces.
    """
    places, touched = np.array([one.place, other.place]), TOUCHED * one.footprint
    a, b = first(places), second(places)
    return bool(max(a[0], b[1]) <= touched or max(b[0], a[1]) <= touched)


def check_balls(thread: Thread, holes: Sequence[Piercing]) -> None:
    """Refuse a spline too coarse for the balls of its tracts.

    Each ball takes two of the three unknowns of a control point, and the thread bends between two
    balls.
    """
    balls = sum(isinstance(hole, Ball) for hole in holes)
    least = 4 + 3 * (len(holes) - balls) + 2 * balls
    wrong = balls and thread.knots == "fixed" and thread.control_points < least
    words = {"holes": len(holes) - balls, "balls": balls, "least": least}
    refuse(wrong, "thread.control_points", thread.control_points, "balls-many", **words)
