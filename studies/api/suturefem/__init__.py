"""A suture thread and the organ that it pierces, from Python.

`load` reads a scenario, `prepare` gives its steps, and `run` writes it into a folder. `open_run`
gives the content of a folder. `sweep` varies keys, and `refine` judges whether a number converges.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from studies.output.provenance import __version__
    from studies.output.reading import open_run
    from studies.refinement.refine import refine
    from studies.scenario import load
    from studies.simulation import prepare
    from studies.simulation.recorded import run
    from studies.sweeps.sweep import sweep

__all__ = ["__version__", "load", "open_run", "prepare", "refine", "run", "sweep"]

HOMES = {
    "__version__": "studies.output.provenance",
    "load": "studies.scenario",
    "open_run": "studies.output.reading",
    "prepare": "studies.simulation",
    "refine": "studies.refinement.refine",
    "run": "studies.simulation.recorded",
    "sweep": "studies.sweeps.sweep",
}


def __getattr__(name: str) -> Any:
    """Import a name at its first use.

    The import of the package then takes only a millisecond.
    """
    if name not in HOMES:
        raise AttributeError(f"module 'suturefem' has no attribute {name!r}")
    return getattr(import_module(HOMES[name]), name)


def __dir__() -> list[str]:
    """Return the names of the package."""
    return __all__
