"""Remarks on the numbers of a run, in `summary.json`, on the console and from Python.

The list, `remarks.toml`, has each code once, with its severity, its bound, the reason of the bound,
and its message. It begins with the numbers of the bounds. A remark is made beyond its bound. The
severity "unsupported" means that the model does not support a number of the run. A "note" is
information for the reader. `studies.simulation.remarks` decides which remarks a run has.
"""

from collections.abc import Iterable
from dataclasses import asdict, dataclass
from types import SimpleNamespace
from typing import Literal, get_args

from studies.lists import list_of, sentences
from studies.output.records import SEEN, SWITCHES

Severity = Literal["unsupported", "note"]

LIST = list_of(__file__, "remarks.toml")
say = sentences(LIST.pop("effects"))
BOUNDS = LIST.pop("bounds") | {"SEEN": SEEN, "SWITCHES": SWITCHES}  # by their names in the list
bounds = SimpleNamespace(**BOUNDS)
# A remark by its code: the condition `bound` and its `reason`, both for the manual, and the `message` with names in
# braces for its values.
CATALOGUE = {code: {"severity": "unsupported", **table} for code, table in LIST.items()}


@dataclass(frozen=True)
class Remark:
    """A remark on a run; `where` names a piercing, a key, or a part of the run."""

    code: str
    severity: Severity
    message: str
    where: str

    @property
    def unsupported(self) -> bool:
        """Whether the remark means an unsupported number."""
        return self.severity == "unsupported"

    @property
    def line(self) -> str:
        """The remark as a line for the console."""
        return f"{self.severity}: {self.message} [{self.code}]"

    def record(self) -> dict[str, str]:
        """Return the remark as in `summary.json`."""
        return asdict(self)


def remark(code: str, where: str, **values: object) -> Remark:
    """Return a remark of the catalogue by its code, with the values that its message names."""
    kind = CATALOGUE[code]
    return Remark(code, kind["severity"], kind["message"].format(where=where, **BOUNDS, **values), where)


def judged(deserved: bool, code: str, where: str, **values: object) -> list[Remark]:
    """Return a list with a remark of the catalogue if it is `deserved`, else an empty list."""
    return [remark(code, where, **values)] if deserved else []


def any_unsupported(remarks: Iterable[Remark]) -> bool:
    """Return whether a remark means an unsupported number."""
    return any(each.unsupported for each in remarks)


def markdown() -> str:
    """Return the lists of the manual, one for each severity."""
    lines = []
    for severity in get_args(Severity):
        lines += ["", f"Severity `{severity}`:", ""]
        lines += [
            f"- `{code}`: {kind['bound'].format(**BOUNDS)}. {kind['reason'][0].upper()}{kind['reason'][1:]}."
            for code, kind in CATALOGUE.items()
            if kind["severity"] == severity
        ]
    return "\n".join([*lines, "", ""])
