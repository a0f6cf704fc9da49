"""The table of a load on the organ, `[[tissue.load]]`."""

from studies.scenario.course import Timed
from studies.scenario.values import NotNegative, Number, Text, Vector


class Load(Timed):
    """Force per area on a boundary of the organ."""

    boundary: Text
    traction: Vector | None = None
    pressure: Number | None = None
    ramp: NotNegative = 0.0

    def _check_kind(self) -> None:
        self._refuse(self.traction is not None and self.pressure is not None, "pressure.traction")
        self._refuse(self.traction is None and self.pressure is None, "traction.missing")
        self._refuse(self.course is not None and self.ramp, "ramp.course")
