"""Scenarios, command line, results and the studies: the only package that sees all the others.

`prepare(load("two_piercings")).advance()` simulates a scenario; `parse` takes one as tables.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from studies.scenario import load, parse
    from studies.simulation import prepare

__all__ = ["load", "parse", "prepare"]

HOMES = {"load": "studies.scenario", "parse": "studies.scenario", "prepare": "studies.simulation"}


def __getattr__(name: str) -> Any:
    """Import what the package offers when it is first asked for: a module of it is imported without the others."""
    if name not in HOMES:
        raise AttributeError(f"module 'studies' has no attribute {name!r}")
    return getattr(import_module(HOMES[name]), name)
