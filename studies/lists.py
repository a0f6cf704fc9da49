"""Lists of words and numbers that the code reads from TOML files.

They are next to its modules, and each study has its `study.toml`.
"""

import tomllib
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any


def list_of(module: str, name: str) -> dict[str, Any]:
    """Return the content of the TOML file of this name next to a module.

    The module is given as its `__file__`.
    """
    return tomllib.loads((Path(module).parent / name).read_text(encoding="utf-8"))


def study_list(name: str) -> dict[str, Any]:
    """Return the content of a study's `study.toml`.

    It has the question, the checks, published numbers, the sentences of remarks, and the labels of
    panels.
    """
    return list_of(__file__, f"{name}/study.toml")


def sentences(words: Mapping[str, str]) -> Callable[..., str]:
    """Return the function that makes a sentence of a list of words.

    Its arguments are the values that the sentence names.
    """

    def say(which: str, /, **values: Any) -> str:
        return str(words[which].format(**values))

    return say
