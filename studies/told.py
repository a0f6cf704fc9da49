"""The content of a study's `study.toml`: question and checks, published numbers, and sentences of its remarks."""

import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any


def told(name: str) -> dict[str, Any]:
    """Return the content of a study's `study.toml`."""
    return tomllib.loads((Path(__file__).parent / name / "study.toml").read_text(encoding="utf-8"))


def sentences(name: str) -> Callable[..., str]:
    """Return the function that makes a sentence of a study's `[words]`, with the values that the sentence names."""
    words = told(name)["words"]

    def say(which: str, **values: Any) -> str:
        return str(words[which].format(**values))

    return say
