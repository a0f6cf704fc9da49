"""The table of a load on the organ, `[[tissue.load]]`."""

from pydantic import Field

from studies.scenario.course import Timed
from studies.scenario.table import NotNegative, Number, Text, Vector, by_default, optional


class Load(Timed):
    """Force per area on a boundary of the organ."""

    boundary: Text = Field(description="name of the boundary that the load acts on", examples=["top"])
    traction: Vector | None = optional(
        "dead load per area of the reference shape [Pa]; instead of pressure", [0, 0, 1.0e4]
    )
    pressure: Number | None = optional(
        "pressure [Pa], positive if it pushes on the organ",
        2.0e3,
    )
    ramp: NotNegative = by_default(0.0, "time in which the load grows from zero [s]; in statics over the load steps")

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
