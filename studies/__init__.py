"""Scenarios, command line, results and the studies: the only package that sees all the others.

From Python: `load` a scenario or `parse` one given as tables, `prepare` it and step through it, or `run` it into a
folder; `open_run` gives what is in one; `sweep` varies keys, `refine` says whether a number converges.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from studies.output.opened import open_run
    from studies.refinement.refine import refine
    from studies.scenario import load, parse
    from studies.simulation import prepare
    from studies.simulation.recorded import run
    from studies.sweeps.sweep import sweep

__all__ = ["load", "open_run", "parse", "prepare", "refine", "run", "sweep"]

HOMES = {
    "load": "studies.scenario",
    "open_run": "studies.output.opened",
    "parse": "studies.scenario",
    "prepare": "studies.simulation",
    "refine": "studies.refinement.refine",
    "run": "studies.simulation.recorded",
    "sweep": "studies.sweeps.sweep",
}


def __getattr__(name: str) -> Any:
    """Import what the package offers when it is first asked for: a module of it is imported without the others."""
    if name not in HOMES:
        raise AttributeError(f"module 'studies' has no attribute {name!r}")
    return getattr(import_module(HOMES[name]), name)


def __dir__() -> list[str]:
    """Name what the package offers."""
    return sorted([*globals(), *__all__])
