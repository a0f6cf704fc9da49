"""The table of a tie, `[[tie]]`: a loop of thread that hands draw tight over the tissue and lock."""

from collections.abc import Sequence

from studies.scenario.piercing import Piercing
from studies.scenario.refusal import as_toml, dotted_key, nearest, refusal
from studies.scenario.table import ScenarioTable, check_ending, repetition
from studies.scenario.values import From, NotNegative, Positive, Text


class Tie(ScenarioTable):
    """Tie of the outer strands at two holes."""

    name: Text
    between: tuple[Text, Text]
    force: Positive
    from_: From = 0.0
    until: Positive
    ramp: NotNegative | None = None
    speed: Positive = 0.05
    hold: Positive | None = None

    @property
    def growth(self) -> float:
        """Time in which the force grows [s]."""
        return 0.5 * (self.until - self.from_) if self.ramp is None else self.ramp

    def _check(self) -> None:
        self._refuse(self.between[0] == self.between[1], "between.one")
        check_ending(self.from_, self.until)
        drawn = self.until - self.from_
        self._refuse(self.ramp is not None and self.ramp > drawn, "ramp.long", drawn=drawn)


def tie_fault(ties: Sequence[Tie], holes: Sequence[Piercing]) -> str | None:
    """Return the fault of the first tie with a repeated name or impossible holes, or None."""
    if problem := repetition("tie", [tie.name for tie in ties]):
        return problem
    known, pairs = {hole.name: hole for hole in holes}, [set(tie.between) for tie in ties]
    for k, tie in enumerate(ties):
        key = dotted_key(["tie", tie.name, "between"])
        lost = next((name for name in tie.between if name not in known), None)
        if lost is not None:
            like = nearest(lost, known)
            guess = f", did you mean {as_toml(like)}" if like else ""
            return refusal(key, tie.between, f"there is no piercing {as_toml(lost)}{guess}; name existing ones")
        if pairs[k] in pairs[:k]:
            other = ties[pairs.index(pairs[k])].name
            return refusal(key, tie.between, f"tie {as_toml(other)} already joins these strands; leave out one of them")
        late = next((known[name] for name in tie.between if not is_there(known[name], tie.from_)), None)
        if late is not None:
            reason = f"the thread is not in piercing {as_toml(late.name)} at this time; begin the tie while it is"
            return refusal(dotted_key(["tie", tie.name, "from"]), tie.from_, reason)
    return None


def is_there(hole: Piercing, time: float) -> bool:
    """Return whether a hole exists at a time [s]; a thread that has slid out is not considered."""
    return hole.from_ <= time and (hole.until is None or time < hole.until)
