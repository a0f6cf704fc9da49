"""Contact: two surfaces of the organ that press on each other where they meet."""

from typing import Annotated

from studies.scenario.table import ScenarioTable
from studies.scenario.values import NotNegative, Text, one_sentence


class Contact(ScenarioTable):
    """Contact between two boundaries of the organ: nodes of one boundary, facets of the other."""

    between: tuple[Text, Text]
    friction: Annotated[NotNegative, one_sentence("allowed-contact")] = 0.0

    def _check(self) -> None:
        self._refuse(self.between[0] == self.between[1], "between.one")
