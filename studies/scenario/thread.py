"""The table of the thread, `[thread]`, and of its ends."""

from collections.abc import Mapping
from itertools import pairwise
from math import dist
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import AfterValidator, Field

from studies.scenario.course import Timed
from studies.scenario.refusal import as_toml
from studies.scenario.table import ALLOWED_START_ERROR, ScenarioTable, check_rising
from studies.scenario.values import Flag, NotNegative, Number, Positive, Series, Text, Turn, Vector, Whole, one_sentence
from thread.catalogue import suture
from thread.errors import ThreadError

Waypoint = tuple[Number, Number, Number, Number]  # time [s] and place [m]


class _End(ScenarioTable):
    mass: NotNegative = 0.0


class FreeEnd(_End):
    """End without a holder and without a load."""

    kind: Literal["free"]


class _HeldEnd(_End):
    turn: Annotated[tuple[Turn, ...], Field(min_length=1)] | None = None

    def _check_turn(self) -> None:
        if self.turn is not None:
            check_rising("turn", self.turn)
            start = float(np.interp(0.0, *np.transpose(self.turn)))
            self._refuse(start, "turn.start", start=start)


class FixedEnd(_HeldEnd):
    """End whose position is held."""

    kind: Literal["fixed"]


class ClampedEnd(_HeldEnd):
    """End whose position and tangent are held, and with twist also its rotation."""

    kind: Literal["clamped"]


class PulledEnd(_End, Timed):
    """End under a dead load."""

    kind: Literal["pulled"]
    force: Vector
    ramp: NotNegative | None = None


class DrivenEnd(_HeldEnd):
    """End that follows waypoints, linearly in between.

    It is at rest before the first and after the last.
    """

    kind: Literal["driven"]
    waypoints: Annotated[tuple[Waypoint, ...], Field(min_length=1)]

    def _check_times(self) -> None:
        check_rising("waypoints", self.waypoints)

    def position(self, time: float) -> Vector:
        """Return the position (3,) [m] at a time [s]."""
        times, *columns = np.transpose(self.waypoints)
        x, y, z = (float(np.interp(time, times, column)) for column in columns)
        return x, y, z


End = Annotated[FreeEnd | FixedEnd | ClampedEnd | PulledEnd | DrivenEnd, Field(discriminator="kind")]


class Cut(ScenarioTable):
    """Cut of the thread during a run."""

    s: Positive
    time: Positive


def _known(name: str) -> str:
    """Return the name of a suture, or refuse one that is not in the catalogue."""
    try:
        suture(name)
    except ThreadError as error:
        raise ValueError(str(error).removeprefix("suture")) from None
    return name


class OnSurface(ScenarioTable):
    """Contact of the thread with the surface of the organ."""

    friction: NotNegative = 0.0


class Thread(ScenarioTable):
    """Suture thread laid along a path."""

    suture: Annotated[Text, AfterValidator(_known)] | None = None
    diameter: Positive | None = None
    youngs_modulus: Positive | None = None
    density: Positive | None = None
    poisson_ratio: Annotated[float, Field(strict=True, allow_inf_nan=False, gt=-1, le=0.5)] | None = None
    bending_factor: Annotated[float, Field(strict=True, allow_inf_nan=False, gt=0, le=1)] | None = None
    control_points: Annotated[int, Field(strict=True, ge=4, le=5000)] = 40
    knots: Literal["travelling", "fixed"] = "travelling"
    tolerance: Annotated[float, Field(strict=True, allow_inf_nan=False, gt=0, le=0.1)] = 0.01
    path: Annotated[tuple[Vector, ...], Field(min_length=2)]
    cuts: tuple[Positive, ...] = ()
    length: Positive | None = None
    damping: NotNegative = 0.0
    relaxation: Series = ()
    contact: Annotated[Flag | OnSurface, one_sentence("allowed-thread-contact")] = False
    bending: Flag = True
    energy: Literal["continuous", "springs"] = "continuous"
    springs: Whole | None = None
    twist: Flag = False
    coil_radius: Positive | None = None
    coil_towards: Vector | None = None
    start: End = FreeEnd(kind="free")
    end: End = FreeEnd(kind="free")

    @classmethod
    def chosen(cls, data: Mapping[str, Any]) -> dict[str, Any]:
        return {} if "suture" in data else {"poisson_ratio": 0.4}

    @property
    def thickness(self) -> float:
        """Diameter of the thread, given or of its suture [m]."""
        return self.diameter or suture(self.suture or "").diameter

    @property
    def ends(self) -> tuple[End, End]:
        """Start and end."""
        return self.start, self.end

    @property
    def surface(self) -> OnSurface | None:
        """Contact of the thread with the organ's surface, None without contact."""
        if isinstance(self.contact, OnSurface):
            return self.contact
        return OnSurface() if self.contact else None

    def _check_material(self) -> None:
        own = {key: getattr(self, key) for key in ("diameter", "youngs_modulus", "density", "poisson_ratio")}
        present = [key for key, value in own.items() if value is not None]
        for key in present:
            self._refuse(self.suture is not None, "suture.given", (key, own[key]), given=", ".join(present))
        for key in ("diameter", "youngs_modulus", "density"):
            self._refuse(self.suture is None and key not in present, "suture.missing", (key, None))

    def _check_cuts(self) -> None:
        self._refuse(any(after <= before for before, after in pairwise(self.cuts)), "cuts.order")

    def _check_springs(self) -> None:
        least = self.control_points - 1 - len(self.cuts)
        self._refuse(self.springs is not None and self.energy != "springs", "springs.energy")
        self._refuse(self.springs is not None and self.springs < least, "springs.few", least=least)

    def _check_twist(self) -> None:
        self._refuse(self.twist and not self.bending, "twist.bending")
        for key in ("start", "end"):
            self._refuse(not self.twist and getattr(getattr(self, key), "turn", None), f"{key}.turn.twist")
        self._refuse(self.coil_radius is not None and not self.twist, "coil_radius.twist")
        if self.coil_towards is not None:
            self._refuse(self.coil_radius is None, "coil_towards.straight")
            along = np.subtract(self.path[1], self.path[0])
            across, size = np.cross(self.coil_towards, along), np.linalg.norm(self.coil_towards)
            self._refuse(np.linalg.norm(across) <= 1e-3 * size * np.linalg.norm(along), "coil_towards.parallel")

    def _check_path(self) -> None:
        for row, (before, after) in enumerate(pairwise(self.path), start=1):
            self._refuse(before == after, "path.twice", (f"path.{row}", after))

    def _check_driven_ends(self) -> None:
        total = sum(dist(a, b) for a, b in pairwise(self.path))
        for key, end, place in (("start", self.start, self.path[0]), ("end", self.end, self.path[-1])):
            away = dist(end.position(0.0), place) if isinstance(end, DrivenEnd) else 0.0
            far = away > ALLOWED_START_ERROR * total
            self._refuse(far, f"{key}.waypoints.away", away=away, key=key, place=as_toml(place))
