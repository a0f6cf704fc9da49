"""The table of a tie, `[[tie]]`.

A tie is a loop of thread that hands draw tight over the tissue and lock.
"""

from collections.abc import Sequence
from math import inf

from studies.scenario.piercing import Piercing
from studies.scenario.refusal import as_toml, nearest
from studies.scenario.table import ScenarioError, ScenarioTable, check_ending, refused, repetition
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


def check_ties(ties: Sequence[Tie], holes: Sequence[Piercing]) -> None:
    """Refuse ties with a repeated name, and a tie of impossible holes.

    Whether the thread has slid out of a hole is not considered.
    """
    if fault := repetition("tie", [tie.name for tie in ties]):
        raise ScenarioError(fault)
    known, pairs = {hole.name: hole for hole in holes}, [set(tie.between) for tie in ties]
    for k, tie in enumerate(ties):
        key = "tie", tie.name, "between"
        for name in tie.between:
            if name not in known:
                match = nearest(name, known)
                hint = f", did you mean {as_toml(match)}" if match else ""
                raise refused(key, tie.between, "tie-unknown", name=as_toml(name), hint=hint)
        if pairs[k] in pairs[:k]:
            other = ties[pairs.index(pairs[k])].name
            raise refused(key, tie.between, "tie-twice", other=as_toml(other))
        for hole in map(known.__getitem__, tie.between):
            if not hole.from_ <= tie.from_ < (hole.until or inf):
                raise refused(("tie", tie.name, "from"), tie.from_, "tie-early", name=as_toml(hole.name))
