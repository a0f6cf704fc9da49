"""Compiled loops that are kept on disk."""

from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from typing import Any

import numba
import pytest

SOURCE = """
from tissue.loops import compiled

@compiled
def twice(x):
    return 2.0 * x
"""


def loaded(path: Path) -> Any:
    """The module of a file, as another process would load it."""
    spec = spec_from_file_location("kept_loops", path)
    assert spec is not None and spec.loader is not None
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.skipif(numba.config.DISABLE_JIT, reason="nothing is compiled")
@pytest.mark.parametrize("kind", ["*.nbi", "*.nbc"])
@pytest.mark.parametrize("torn", [b"", b"torn", b"\x80\x05"])
def test_torn_files_of_compiled_loops_are_made_anew(
    tmp_path: Path, kind: str, torn: bytes, caplog: pytest.LogCaptureFixture
) -> None:
    """Independent check: the index or the code cut off: the loop still does what it did, the folder is named, and the
    next process takes what is kept."""
    path = tmp_path / "kept_loops.py"
    path.write_text(SOURCE)
    assert loaded(path).twice(3.0) == 6.0
    [file] = tmp_path.rglob(kind)
    file.write_bytes(torn)
    assert loaded(path).twice(3.0) == 6.0
    assert "are damaged" in caplog.text and str(file.parent) in caplog.text
    caplog.clear()
    again = loaded(path)
    assert again.twice(3.0) == 6.0 and sum(again.twice.stats.cache_hits.values()) == 1 and not caplog.text
