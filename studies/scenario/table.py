"""A table of a scenario and its refusals."""

from collections.abc import Iterable, Mapping, Sequence
from functools import cache
from itertools import pairwise
from operator import attrgetter
from typing import Any, ClassVar, Self

import numpy as np
from pydantic import BaseModel, ConfigDict, GetJsonSchemaHandler, model_validator
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema

from studies.scenario.refusal import FORMER, as_toml, because, dotted_key, meaning_of, reason_of, refusal, shortened

ALLOWED_START_ERROR = 1e-6  # distance of a driven end's first waypoint from the path's end, over the path's length
MOST_PROBLEMS, LONGEST_PROBLEM = 30, 1000  # shown for one scenario, and characters of each


class ScenarioError(ValueError):
    """A scenario that is refused; ``problems`` holds one sentence for each of the first faults."""

    def __init__(self, problems: str | Iterable[str]) -> None:
        every = [problems] if isinstance(problems, str) else list(problems)
        more = [f"and {len(every) - MOST_PROBLEMS} more"] if len(every) > MOST_PROBLEMS else []
        self.problems = tuple(shortened(problem, LONGEST_PROBLEM) for problem in [*every[:MOST_PROBLEMS], *more])
        super().__init__("\n".join(self.problems))


def refused(key: str | Iterable[object], value: object, reason: str, /, **values: object) -> ScenarioError:
    """Return the error for a refused value, with the reason of this name and its `values`.

    The key is its full name or the parts of this name.
    """
    name = key if isinstance(key, str) else dotted_key(key)
    return ScenarioError(refusal(name, value, because(reason, **values)))


def refuse(wrong: object, key: str | Iterable[object], value: object, reason: str, /, **values: object) -> None:
    """Raise the error for a value if it is wrong; the arguments are those of `refused`."""
    if wrong:
        raise refused(key, value, reason, **values)


def plain_values(value: Any) -> Any:
    """Return tables, lists and numbers as in a file, with Python's numbers instead of numpy's."""
    match value:
        case Mapping():
            return {str(key): plain_values(item) for key, item in value.items()}
        case list() | tuple():
            return [plain_values(item) for item in value]
        case np.ndarray() | np.generic():
            return value.tolist()
        case _:
            return value


class ScenarioTable(BaseModel):
    """A table of the scenario: frozen, without unknown keys.

    The meanings of its keys are in `keys.toml`. Keys of earlier versions, `FORMER`, are refused
    with their replacement. Methods `_check…` refuse impossible values. They are called after the
    table is made, in the order of their definition, and first those of base classes.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", populate_by_name=False)
    WITHIN: ClassVar[str] = "."  # between the table's name and the names of its keys in a refusal

    @model_validator(mode="before")
    @classmethod
    def _prepare(cls, data: Any) -> Any:
        if not isinstance(data, Mapping):
            return data
        for key, reason in FORMER.get(cls.__name__, {}).items():
            if key in data:
                raise ValueError(f".{key} = {as_toml(data[key])} is refused: {reason}")
        return {**cls.chosen(data), **data}

    @classmethod
    def chosen(cls, data: Mapping[str, Any]) -> dict[str, Any]:
        """Return the defaults that depend on other keys of the table.

        `data` are the keys in the file.
        """
        return {}

    @classmethod
    def __get_pydantic_json_schema__(cls, core: CoreSchema, handler: GetJsonSchemaHandler) -> JsonSchemaValue:
        """Return the JSON schema of the table, with the meanings of its keys."""
        reference = handler(core)
        for key, field in handler.resolve_ref_schema(reference)["properties"].items():
            words = zip(("description", "examples"), meaning_of(cls, key), strict=True)
            field.update({name: value for name, value in words if value})
        return reference

    def _report(self, fault: str | None) -> None:
        """Refuse the table if a check found a fault, None without a fault."""
        if fault:
            raise ValueError(self.WITHIN + fault)

    def _refuse(self, wrong: object, name: str, shown: tuple[str, object] | None = None, **values: object) -> None:
        """Refuse the value of a key if it is wrong, with a reason from `refusals.toml`.

        The `name` of the reason is the key and a word: "dt.long". `shown` are another key and its
        value. The reason can name keys of the table, "{own.dt}", and `values`. A reason that begins
        with "is" is a sentence about the key and not about its value.
        """
        if not wrong:
            return
        key, reason = name.rpartition(".")[0], reason_of(type(self), name).format(own=self, **values)
        if reason.startswith("is "):
            self._report(f"{shown[0] if shown else key} {reason}")
        key, value = shown or (key, attrgetter(key)(self))
        self._report(refusal(key, value, reason))

    @model_validator(mode="after")
    def _judge(self) -> Self:
        for name in checks_of(type(self)):
            getattr(self, name)()
        return self


@cache
def checks_of(table: type[ScenarioTable]) -> list[str]:
    """Return the names of a table's checks in the order of their definition."""
    kinds = [kind for kind in reversed(table.__mro__) if issubclass(kind, ScenarioTable)]
    return [name for name in dict.fromkeys(name for kind in kinds for name in vars(kind)) if name.startswith("_check")]


def check_ending(begins: float, until: float | None) -> None:
    """Refuse an end that is not after the beginning [s]."""
    if until is not None and until <= begins:
        raise ValueError(f".until = {until} is refused: it must be later than from = {begins}; raise it")


def check_rising(key: str, rows: Sequence[Sequence[float]]) -> None:
    """Refuse rows of a key whose times, the first number of each, do not rise."""
    for row, ((before, *_), (after, *_)) in enumerate(pairwise(rows), start=1):
        if after <= before:
            reason = because("rows-falling", before=before)
            raise ValueError(f".{key}.{row} = {as_toml(rows[row])} is refused: {reason}")


def repetition(table: str, names: Sequence[str]) -> str | None:
    """Return the refusal of the first repeated name of a table, or None."""
    twice = next((name for index, name in enumerate(names) if name in names[:index]), None)
    return None if twice is None else refusal(f"{table}.name", twice, "names must be unique; rename one")
