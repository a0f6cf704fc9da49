"""The notebook: executed to its end, what it says as it is kept, and what a cell shows."""

import math
import re
from typing import Any

import matplotlib.pyplot as plt
import pytest

from studies.site.notebook import cells_of, executed, markdown, outputs_of, text_of

NUMBER = re.compile(r"-?\d+\.?\d*(?:e[-+]?\d+)?")
AGREE = 0.02  # of a number: it is kept with three digits, and another machine rounds the last one otherwise
LAST = 0.0015  # of its unit, the same of a small one


def words_and_numbers(text: str) -> tuple[str, list[float]]:
    """A text without its numbers, and these."""
    return NUMBER.sub("#", text), [float(found) for found in NUMBER.findall(text)]


def outputs(cells: list[dict[str, Any]]) -> list[tuple[str, list[str]]]:
    """What the cells of code say, and the kinds of their outputs."""
    code = [cell["outputs"] for cell in cells if cell["cell_type"] == "code"]
    return [("".join(map(text_of, out)), [part["output_type"] for part in out]) for out in code]


def test_it_runs_and_says_what_is_kept() -> None:
    """Consistency check: every cell of the notebook runs, and words and numbers are those of the outputs in it."""
    pytest.importorskip("pandas")
    cells = cells_of()
    kept, made = outputs(cells), outputs(list(executed(cells)))
    assert sum("display_data" in kinds for _, kinds in kept) == 1
    for (old, kinds), (new, made_kinds) in zip(kept, made, strict=True):
        (words, numbers), (new_words, new_numbers) = words_and_numbers(old), words_and_numbers(new)
        assert new_words == words
        assert made_kinds == kinds
        assert all(math.isclose(a, b, rel_tol=AGREE, abs_tol=LAST) for a, b in zip(numbers, new_numbers, strict=True))


def test_what_a_cell_shows() -> None:
    """Independent check: what is printed, the value of the last line unless a semicolon hides it, the open figures; an
    error is raised."""
    names: dict[str, Any] = {"plt": plt}
    assert [text_of(out) for out in outputs_of("print(1)\n2 + 1", names, 1)] == ["1\n", "3"]
    assert outputs_of("a = 4\na;", names, 2) == []
    assert names["a"] == 4
    [drawn] = outputs_of("plt.plot([0, 1]);", names, 3)
    assert drawn["data"]["image/png"].startswith("iVBOR")
    assert plt.get_fignums() == []
    with pytest.raises(ZeroDivisionError):
        outputs_of("1 / 0", names, 4)


def test_its_page_has_text_code_and_outputs() -> None:
    """Independent check: in their order, the figure within the page."""
    page = markdown([
        {"cell_type": "markdown", "source": ["# T"]},
        {"cell_type": "code", "source": ["print(1)"], "outputs": [
            {"output_type": "stream", "text": ["1\n"]}, {"output_type": "display_data", "data": {"image/png": "AA=="}}
        ]},
    ])  # fmt: skip
    first = "# T\n\n```python\nprint(1)\n```\n\n```\n1\n```\n\n"
    assert page == first + '<img alt="figure of the cell" src="data:image/png;base64,AA==">\n'
