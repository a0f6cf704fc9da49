"""Sentences for refused input: the key's full name, its value, the allowed values and the remedy.

pydantic finds the faults; this module describes them in plain words. A key's full name is the name
in ``--set``: table names joined by dots; an entry of a list of tables has its ``name``
(``piercing.entry.footprint``).
"""

import difflib
import re
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple, get_args

from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails

from studies.lists import list_of

KEYS, REASONS = list_of(__file__, "keys.toml"), list_of(__file__, "refusals.toml")
FORMER = REASONS.pop("former")  # keys of earlier versions, by the class of their table
CAUSES = REASONS.pop("causes")  # keys of a stitch that determine a key or a table of its long form
BARE = re.compile(r"[A-Za-z0-9_-]+")
LONGEST_VALUE = 60  # largest number of shown characters of a refused value, unless it is text
LONGEST_TEXT = 300  # largest number of shown characters of a text: a path is useful only as a whole
LONGEST_MEANING = 120  # number of characters above which only the first clause of a key's meaning is shown
LONGEST_WORD = 100  # largest number of characters for a search of similar words
MOST_DETAILS = 100  # largest number of faults with a sentence
LARGEST_WHOLE = 10**100  # above this a number is shown by its size: Python does not print 4300 digits


def meaning_of(table: type, key: str) -> tuple[str, list[Any]]:
    """Return the meaning of a key of a table with its unit in brackets, and examples of its value.

    A base class of the table can have the meaning. Without a meaning the text is empty.
    """
    entry = next((KEYS[kind.__name__][key] for kind in table.__mro__ if key in KEYS.get(kind.__name__, ())), "")
    return (entry, []) if isinstance(entry, str) else (entry[0], entry[1:])


def reason_of(table: type, name: str) -> str:
    """Return the reason for a refusal by a table, which a base class of the table can have."""
    return next(REASONS[kind.__name__][name] for kind in table.__mro__ if name in REASONS.get(kind.__name__, ()))


def because(name: str, /, **values: object) -> str:
    """Return the reason of this name for a refusal by a function, with its values."""
    return str(REASONS["functions"][name].format(**values))


def as_toml(value: object) -> str:
    """Return a value in TOML, on one line; floats read back to the same bits."""
    match value:
        case bool():
            return "true" if value else "false"
        case str():
            return f'"{"".join(map(_escaped, value))}"'
        case Mapping():
            return "{ " + ", ".join(f"{as_key(key)} = {as_toml(item)}" for key, item in value.items()) + " }"
        case list() | tuple():
            return "[" + ", ".join(map(as_toml, value)) + "]"
        case int() if abs(value) > LARGEST_WHOLE:
            return f"a whole number of {value.bit_length()} bits"
        case _:
            return str(value)


def as_key(key: str) -> str:
    """Return a TOML key, quoted if necessary."""
    return key if BARE.fullmatch(key) else as_toml(key)


def nearest(word: str, known: Iterable[str]) -> str | None:
    """Return the known word most similar to ``word``, or None."""
    if len(word) > LONGEST_WORD:
        return None
    matches = difflib.get_close_matches(word, list(known), n=1, cutoff=0.5)
    return matches[0] if matches else None


def hint_at(word: str, known: Iterable[str], form: str = "; the nearest is {}") -> str:
    """Return a hint at the known word most similar to ``word``, empty without one."""
    found = nearest(word, known)
    return form.format(found) if found else ""


def sentences(error: ValidationError, model: type[BaseModel], data: object) -> list[str]:
    """Return one sentence for each fault that pydantic found in ``data`` for ``model``."""
    details = error.errors(include_url=False)[:MOST_DETAILS]
    unknown = [detail["loc"] for detail in details if detail["type"] == "extra_forbidden"]
    meant = {(*loc[:-1], nearest(str(loc[-1]), _keys(_place(loc, model, data).table))) for loc in unknown}
    # a missing key is not reported if it is only misspelt
    wanted = (detail for detail in details if detail["type"] != "missing" or detail["loc"] not in meant)
    return [_sentence(detail, model, data) for detail in wanted if not _follows(detail, details)]


def refusal(key: str, value: object, reason: str) -> str:
    """Return the common form of a refusal: ``key = value is refused: reason``."""
    longest = LONGEST_TEXT if isinstance(value, str) else LONGEST_VALUE
    return f"{key} = {shortened(as_toml(value), longest)} is refused: {reason}"


def shortened(text: str, longest: int) -> str:
    """Return a text shortened to a number of characters, with a mark."""
    return text if len(text) <= longest else text[: longest - 2] + " …"


def dotted_key(parts: Iterable[object]) -> str:
    """Return the full name of a key from its parts."""
    return ".".join(as_key(str(part)) for part in parts)


def _follows(detail: ErrorDetails, details: Sequence[ErrorDetails]) -> bool:
    """Return whether a list is too short only because one of its items was refused."""
    loc = detail["loc"]
    inner = (other["loc"] for other in details if len(other["loc"]) > len(loc))
    return detail["type"] == "too_short" and any(other[: len(loc)] == loc for other in inner)


class Place(NamedTuple):
    """The location of a fault in pydantic's report."""

    parts: list[str]  # parts of the key's full name
    table: type[BaseModel]  # the table of the key
    field: str | None  # the table's field of this key, None for an unknown key
    kind: Any  # the type that the field allows

    @property
    def key(self) -> str:
        return dotted_key(self.parts)


def _sentence(detail: ErrorDetails, model: type[BaseModel], data: object) -> str:
    place = _place(detail["loc"], model, data)
    match detail["type"]:
        case "extra_forbidden":
            return _unknown_key(place, detail["input"])
        case "missing":
            return f"{place.key} is missing: {_remedy(place)}"
        case "union_tag_not_found":
            return f"{place.key}.kind is missing: allowed are {_tags(place.kind)}"
        case "union_tag_invalid":
            tag = detail["ctx"]["tag"]
            hint = hint_at(tag, _models(place.kind), '; the nearest is "{}"')
            return refusal(f"{place.key}.kind", tag, f"allowed are {_tags(place.kind)}{hint}")
        case "value_error":  # our own errors continue the key's name
            return f"{place.key}{detail['ctx']['error']}"
        case _:
            return refusal(place.key, detail["input"], f"{_allowed(detail)}; {_remedy(place)}")


def _unknown_key(place: Place, value: object) -> str:
    known = _keys(place.table)
    match = nearest(place.parts[-1], known)
    names = ", ".join(known)
    hint = f"the nearest is {dotted_key([*place.parts[:-1], match])}; known here are" if match else "known here are"
    return refusal(place.key, value, f"there is no such key; {hint} {names}")


def _allowed(detail: ErrorDetails) -> str:
    """Return the allowed values, from pydantic's message."""
    text = re.sub(r"^Input should be|^Value error,", "it must be", detail["msg"])
    text = re.sub(r"^(Tuple|List|String) should have", "it must have", text)
    value = detail["input"]
    match = nearest(value, re.findall(r"'([^']*)'", text)) if isinstance(value, str) else None
    text = text.replace("'", '"').replace(" after validation", "")
    text = text.replace("a valid tuple", "a list").replace("a valid dictionary or instance of", "a table:")
    return f'{text}; the nearest is "{match}"' if match and detail["type"] == "literal_error" else text


def _remedy(place: Place) -> str:
    """Return an example of a key with its meaning, from its field."""
    if place.field is None:
        return f"correct {place.key}"
    info = place.table.model_fields[place.field]
    name = info.alias or place.field
    key = dotted_key(place.parts[: len(place.parts) - place.parts[::-1].index(name)])
    text, examples = meaning_of(place.table, name)
    example, meaning = next(iter(examples), info.default), _in_short(text)
    if example is None:
        return f"correct it, or leave {key} out ({meaning})"
    return f"write for example {key} = {as_toml(example)} ({meaning})"


def _in_short(description: str) -> str:
    """Return a key's meaning, shortened to the first clause if it is long.

    The manual has the rest.
    """
    for mark in "; ", ": ":
        if len(description) > LONGEST_MEANING:
            description = re.split(mark + r"(?![^(]*\))", description)[0]  # but not within parentheses
    return description


def _place(loc: Sequence[int | str], model: type[BaseModel], data: object) -> Place:
    """Return the place of pydantic's location, in which a union's tag appears like a key."""
    parts: list[str] = []
    table: type[BaseModel] = model
    field: str | None = None
    kind: Any = model
    tagged = False
    for step in loc:
        models = _models(kind)
        if isinstance(step, str) and step in models and not tagged:  # a key can have the name of its table's kind
            kind, tagged = models[step], True
            continue
        tagged = False
        data, name = _item(data, step)
        parts.append(name)
        if isinstance(step, str) and models:
            table = next(iter(models.values()))
            field = next((name for name, info in table.model_fields.items() if (info.alias or name) == step), None)
            kind = table.model_fields[field].annotation if field else None
    return Place(parts, table, field, kind)


def _item(data: object, step: int | str) -> tuple[object, str]:
    """Return the entry of ``data`` at ``step`` and its name.

    A table in a list has its ``name``, any other entry has the ``step``.
    """
    try:
        item = data[step]  # type: ignore[index]
    except (KeyError, IndexError, TypeError):
        return None, str(step)
    named = isinstance(step, int) and isinstance(item, Mapping) and isinstance(item.get("name"), str)
    return item, str(item["name"]) if named else str(step)


def _keys(table: type[BaseModel]) -> list[str]:
    return [info.alias or name for name, info in table.model_fields.items()]


def _models(kind: Any) -> dict[str, type[BaseModel]]:
    """Return the tables that a type allows: itself, or the members of a union by their ``kind``."""
    if isinstance(kind, type) and issubclass(kind, BaseModel):
        info = kind.model_fields.get("kind")
        tags = get_args(info.annotation) if info else ()
        return {tags[0] if len(tags) == 1 else kind.__name__: kind}
    return {tag: model for part in get_args(kind) for tag, model in _models(part).items()}


def _tags(kind: Any) -> str:
    return ", ".join(f'"{tag}"' for tag in _models(kind))


def _escaped(character: str) -> str:
    if character in '"\\':
        return "\\" + character
    return f"\\u{ord(character):04x}" if ord(character) < 0x20 or ord(character) == 0x7F else character
