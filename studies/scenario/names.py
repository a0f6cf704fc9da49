"""Faults in the names of a scenario that is not yet valid.

Whether a name is known does not depend on refused numbers. So unknown and repeated names are
reported together with refused values, and not only after these are corrected.
"""

from collections.abc import Mapping
from typing import Any

from studies.scenario.organ import BOUNDARIES, FLOOR, STUMPS, taken_boundary, unknown_clamp
from studies.scenario.table import repetition


def name_faults(data: Mapping[str, Any]) -> list[str]:
    """Describe the unknown, taken and repeated names in plain tables, one sentence each."""
    tissue = _table(data.get("tissue"))
    faults = [
        repetition("piercing", _names(data.get("piercing"))),
        repetition("tie", _names(data.get("tie"))),
        repetition("tissue.boundary", _names(tissue.get("boundary"))),
        repetition("tissue.region", _names(tissue.get("region"))),
        *_boundary_faults(tissue),
    ]
    return [fault for fault in faults if fault]


def _boundary_faults(tissue: Mapping[str, Any]) -> list[str | None]:
    """Describe boundaries that a generated mesh lacks or already has.

    Boundaries of a file are not known here.
    """
    mesh = _table(tissue.get("mesh"))
    there = BOUNDARIES.get(str(mesh.get("kind")), ())
    if not there:
        return []
    there = (*there, FLOOR) if mesh.get("shape") == "ellipse" else there
    there = (*there, *STUMPS) if mesh["kind"] == "tube" and "gap" in mesh else there
    own = _names(tissue.get("boundary"))
    repeated = taken_boundary(own, there, str(mesh["kind"]))
    unknown = [unknown_clamp(_words(tissue.get(key)), [*there, *own], key) for key in ("clamp", "roller")]
    return [fault and f"tissue.{fault}" for fault in (repeated, *unknown)]


def _table(value: Any) -> Mapping[str, Any]:
    return value if isinstance(value, Mapping) else {}


def _words(value: Any) -> list[str]:
    return [word for word in value if isinstance(word, str) and word] if isinstance(value, list | tuple) else []


def _names(value: Any) -> list[str]:
    """Return the names of a list of tables."""
    tables = value if isinstance(value, list | tuple) else ()
    return _words([_table(item).get("name") for item in tables])
