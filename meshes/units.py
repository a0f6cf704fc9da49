"""Length units of mesh files; the code uses only metres."""

import math
from collections.abc import Mapping
from types import MappingProxyType

from meshes.errors import MeshError

METRES: Mapping[str, float] = MappingProxyType(
    {"m": 1.0, "dm": 1e-1, "cm": 1e-2, "mm": 1e-3, "um": 1e-6, "µm": 1e-6, "μm": 1e-6}
)


def metres_per_unit(unit: str | float) -> float:
    """Return the metres per file unit, from its name (`"mm"`) or from the number itself [m].

    Raises `MeshError` for an unknown name and for a number that is not positive and finite.
    """
    if isinstance(unit, str):
        return _named(unit)
    if isinstance(unit, bool) or not math.isfinite(unit) or unit <= 0:
        raise MeshError(f"unit = {unit!r}: the metres per file unit must be a positive, finite number")
    return float(unit)


def _named(unit: str) -> float:
    try:
        return METRES[unit.strip()]
    except KeyError:
        raise MeshError(
            f"unit = {unit!r} is not a length unit: use m, dm, cm, mm or um, or the metres per file unit as a number"
        ) from None
