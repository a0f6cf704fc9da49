"""What the package offers at its top, and that it is imported only when it is asked for."""

import subprocess
import sys
from pathlib import Path

import pytest

import studies
from studies import load, parse, prepare, scenario, simulation


def test_the_package_offers_what_makes_a_run() -> None:
    assert (load, parse, prepare) == (scenario.load, scenario.parse, simulation.prepare)
    with pytest.raises(AttributeError, match="'lode'"):
        _ = studies.lode


def test_the_package_alone_imports_nothing() -> None:
    """Independent check: a fresh interpreter tells what importing the package brings with it."""
    code = "import sys, studies; print([name for name in sys.modules if name.startswith(('studies.', 'numpy'))])"
    root = Path(studies.__file__).parents[1]
    done = subprocess.run([sys.executable, "-c", code], cwd=root, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
