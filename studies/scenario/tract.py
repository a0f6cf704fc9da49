"""The table of a tract, `[[tract]]`: the thread bears laterally on the tissue between two holes."""

from collections.abc import Sequence

from studies.scenario.piercing import Friction, Piercing
from studies.scenario.table import ScenarioTable, refuse, refused
from studies.scenario.values import Positive, Text


class Tract(ScenarioTable):
    """Tissue along the thread's path between two neighbouring holes.

    The thread slides along the path, and not across it.
    """

    between: tuple[Text, Text]
    radius: Positive | None = None
    spacing: Positive | None = None
    friction: Friction | None = None

    @property
    def name(self) -> str:
        """Name of the tract, made of the names of its holes."""
        return "-".join(self.between)


def check_tracts(tracts: Sequence[Tract], holes: Sequence[Piercing], in_organ: bool, scheme: str) -> None:
    """Refuse a tract that is impossible.

    Its holes must be neighbours along the thread, without a second tract, permanent, and with a
    radius. It needs an organ and must not use the paper's linear step.
    """
    names = [hole.name for hole in holes]
    for k, tract in enumerate(tracts):
        key, value = f"tract.{k}.between", tract.between
        refuse(not in_organ, key, value, "tract-organ")
        refuse(scheme == "linear", key, value, "tract-linear")
        for name in value:
            if name not in names:
                known = ", ".join(map(repr, names)) or "none"
                raise refused(key, value, "tract-unknown", name=name, known=known)
        refuse(any(value == other.between for other in tracts[:k]), key, value, "tract-twice")
        (one, other), (first, last) = value, map(names.index, value)
        if last != first + 1:
            following = f"; after {one!r} it passes {names[first + 1]!r}" if first + 1 < len(names) else ""
            raise refused(key, value, "tract-apart", one=one, other=other, following=following)
        ends = holes[first : last + 1]
        for hole in ends:
            refuse(hole.from_ > 0.0 or hole.until is not None, key, value, "tract-passing", hole=hole.key())
        refuse(tract.radius is None and not min(hole.footprint for hole in ends), key, value, "tract-radius", number=k)
