"""What `suturefem` offers, and that a name is imported only when it is used."""

import subprocess
import sys
from pathlib import Path

import pytest

import studies
import suturefem
from studies import scenario, simulation
from studies.output.provenance import CODE, installed_version
from studies.scenario import parse
from tests.studies.test_sweep import ORGAN


def test_the_package_offers_what_makes_a_run() -> None:
    names = ["__version__", "load", "open_run", "prepare", "refine", "run", "sweep"]
    assert sorted(suturefem.__all__) == dir(suturefem) == names
    assert (suturefem.load, suturefem.prepare) == (scenario.load, simulation.prepare)
    assert suturefem.__version__ == installed_version(CODE)
    with pytest.raises(AttributeError, match="'lode'"):
        _ = suturefem.lode


def test_the_package_alone_imports_nothing() -> None:
    """Independent check: a fresh interpreter lists the modules that importing the package brings with it."""
    code = "import sys, suturefem; print([name for name in sys.modules if name.startswith(('studies', 'numpy'))])"
    places = [str(Path(module.__path__[0]).parent) for module in (studies, suturefem)]
    code = f"import sys; sys.path[:0] = {places}; {code}"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_tables_are_loaded_as_a_file_is() -> None:
    """Consistency check: with overrides, and the given tables stay as they are."""
    given = {**ORGAN, "title": "before"}
    assert suturefem.load(given, ["title=after"]) == parse({**ORGAN, "title": "after"})
    assert given["title"] == "before"
