"""The table of a load on the organ, `[[tissue.load]]`."""

from studies.scenario.course import Timed
from studies.scenario.table import NotNegative, Number, Text, Vector


class Load(Timed):
    """Force per area on a boundary of the organ."""

    boundary: Text
    traction: Vector | None = None
    pressure: Number | None = None
    ramp: NotNegative = 0.0

    def _check_kind(self) -> None:
        if self.traction is not None and self.pressure is not None:
            raise ValueError(
                f".pressure = {self.pressure} is refused: the load already has a traction; leave out one of "
                "them, or write a second [[tissue.load]]"
            )
        if self.traction is None and self.pressure is None:
            raise ValueError(".traction is missing: write traction = [0, 0, 1e4] or pressure = 2e3 [Pa]")
        if self.course is not None and self.ramp:
            raise ValueError(f".ramp = {self.ramp} is refused: course also gives the growth; leave out one of them")
