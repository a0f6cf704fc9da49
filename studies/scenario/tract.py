"""The table of a tract, `[[tract]]`: the thread bears laterally on the tissue between two holes."""

from collections.abc import Sequence

from studies.scenario.piercing import Friction, Piercing
from studies.scenario.refusal import dotted_key, refusal
from studies.scenario.table import SUBGRID, ScenarioError, ScenarioTable
from studies.scenario.values import Positive, Text


class Tract(ScenarioTable):
    """Tissue along the thread's path between two neighbouring holes: the thread slides along it, not across it."""

    FORMER = SUBGRID

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

    Its holes must be neighbours along the thread, without a second tract, permanent, and with a radius. It
    needs an organ and must not use the paper's linear step.
    """
    names = [hole.name for hole in holes]
    for k, tract in enumerate(tracts):
        reason = ""
        if not in_organ:
            reason = "without [tissue] the thread bears on nothing; add [tissue]"
        elif scheme == "linear":
            reason = 'the paper\'s linear step has no tracts; use solve.scheme = "newton"'
        elif lost := next((name for name in tract.between if name not in names), None):
            reason = f"there is no piercing {lost!r}; the piercings are {', '.join(map(repr, names)) or 'none'}"
        elif any(tract.between == other.between for other in tracts[:k]):
            reason = "there are two tracts between them; leave out one"
        else:
            reason = misplaced(tract, k, holes, *(names.index(name) for name in tract.between))
        if reason:
            raise ScenarioError(refusal(f"tract.{k}.between", tract.between, reason))


def misplaced(tract: Tract, number: int, holes: Sequence[Piercing], first: int, second: int) -> str:
    """Return why a tract cannot lie between the `first` and the `second` hole, empty if it can."""
    if second != first + 1:
        one, other = tract.between
        follows = f"; after {one!r} it passes {holes[first + 1].name!r}" if first + 1 < len(holes) else ""
        return f"the thread does not pass {other!r} right after {one!r}{follows}; name neighbours"
    ends = holes[first : second + 1]
    passing = next((hole for hole in ends if hole.from_ > 0.0 or hole.until is not None), None)
    if passing is not None:
        return f"{dotted_key(['piercing', passing.name])} begins later or ends, but a tract stays; leave it out"
    if tract.radius is None and not min(hole.footprint for hole in ends):
        return f"one of the footprints is 0, and a tract's balls need a radius; give tract.{number}.radius"
    return ""
