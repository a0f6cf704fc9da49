"""The notebook: executed, its output agrees with the stored output."""

import math
import re
from pathlib import Path
from typing import Any

import pytest

nbformat = pytest.importorskip("nbformat")
nbclient = pytest.importorskip("nbclient")
pytest.importorskip("ipykernel")
pytest.importorskip("pandas")
NOTEBOOK = Path(__file__).resolve().parents[2] / "studies" / "site" / "python.ipynb"
NUMBER = re.compile(r"-?\d+\.?\d*(?:e[-+]?\d+)?")
AGREE = 0.02  # of a number: it is kept with three digits, and another machine rounds the last one otherwise
LAST = 0.0015  # of its unit, the same of a small one


def words_and_numbers(text: str) -> tuple[str, list[float]]:
    """A text without its numbers, and these."""
    return NUMBER.sub("#", text), [float(found) for found in NUMBER.findall(text)]


def outputs(notebook: Any) -> list[tuple[str, list[str]]]:
    """What the cells of code say, and the kinds of their outputs: the name of a stream, or the richest type of data."""
    code = [cell.outputs for cell in notebook.cells if cell.cell_type == "code"]
    return [("".join(map(text_of, out)), [part.get("name") or min(part.data) for part in out]) for out in code]


def text_of(output: Any) -> str:
    """The text of an output."""
    return output.text if output.output_type == "stream" else output.data["text/plain"]


def test_it_runs_and_says_what_is_kept(tmp_path: Path) -> None:
    """Consistency check: every cell of the notebook runs, and words and numbers are those of the outputs in it."""
    kept = nbformat.read(NOTEBOOK, as_version=4)
    client = nbclient.NotebookClient(nbformat.read(NOTEBOOK, as_version=4), coalesce_streams=True)
    made = client.execute(cwd=str(tmp_path))
    shown = [kind for _, kinds in outputs(kept) for kind in kinds]
    assert shown.count("image/png") == 1 and set(shown) == {"image/png", "stdout", "text/plain"}
    for (old, kinds), (new, made_kinds) in zip(outputs(kept), outputs(made), strict=True):
        (words, numbers), (new_words, new_numbers) = words_and_numbers(old), words_and_numbers(new)
        assert new_words == words
        assert made_kinds == kinds
        assert all(math.isclose(a, b, rel_tol=AGREE, abs_tol=LAST) for a, b in zip(numbers, new_numbers, strict=True))
