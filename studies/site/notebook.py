"""The notebook of the site: executed by the tests, and a page of the site with its stored outputs.

``python -m studies.site.notebook`` executes the notebook and stores its outputs. Its cells are
plain Python and need no kernel, because nbclient would add about thirty packages. As in Jupyter, a
cell shows its printed text, the value of its last line, and the open figures of pyplot.
"""

import ast
import base64
import io
import json
from collections.abc import Iterator
from contextlib import redirect_stdout
from pathlib import Path
from typing import Any

NOTEBOOK = Path(__file__).parent / "python.ipynb"
DOTS = 80  # per inch of a figure

Cell = dict[str, Any]


def cells_of(path: Path = NOTEBOOK) -> list[Cell]:
    """Return the cells of a notebook."""
    found: list[Cell] = json.loads(path.read_text(encoding="utf-8"))["cells"]
    return found


def executed(cells: list[Cell]) -> Iterator[Cell]:
    """Execute cells in order and yield them with their output. An exception of a cell is raised."""
    names: dict[str, Any] = {"__name__": "__main__"}
    number = 0
    for cell in cells:
        if cell["cell_type"] != "code":
            yield cell
            continue
        number += 1
        yield cell | {"execution_count": number, "outputs": outputs_of("".join(cell["source"]), names, number)}


def outputs_of(source: str, names: dict[str, Any], number: int) -> list[dict[str, Any]]:
    """Execute a cell, and return its outputs in notebook format.

    The cell knows the names defined by earlier cells.
    """
    tree = ast.parse(source)
    tail = tree.body[-1]
    shown = isinstance(tail, ast.Expr) and not source.rstrip().endswith(";")
    last = ast.Expression(tree.body.pop().value) if shown else None  # type: ignore[attr-defined]
    printed, value = io.StringIO(), None
    with redirect_stdout(printed):
        exec(compile(tree, f"cell {number}", "exec"), names)
        if last is not None:
            value = eval(compile(last, f"cell {number}", "eval"), names)
    text = printed.getvalue()
    out: list[dict[str, Any]] = []
    if text:
        out.append({"name": "stdout", "output_type": "stream", "text": text.splitlines(keepends=True)})
    if value is not None:
        data = {"text/plain": repr(value).splitlines(keepends=True)}
        out.append({"data": data, "execution_count": number, "metadata": {}, "output_type": "execute_result"})
    return [*out, *figures()]


def figures() -> Iterator[dict[str, Any]]:
    """Yield the open figures, and close them."""
    import matplotlib.pyplot as plt

    for number in plt.get_fignums():
        picture = io.BytesIO()
        plt.figure(number).savefig(picture, dpi=DOTS, bbox_inches="tight", metadata={"Software": None})
        data = {"image/png": base64.b64encode(picture.getvalue()).decode()}
        yield {"data": data, "metadata": {}, "output_type": "display_data"}
    plt.close("all")


def text_of(output: dict[str, Any]) -> str:
    """Return the text of an output, empty for a figure."""
    return "".join(output.get("text", output.get("data", {}).get("text/plain", ())))


def markdown(cells: list[Cell]) -> str:
    """Return a notebook as a page with its figures."""
    parts: list[str] = []
    for cell in cells:
        source = "".join(cell["source"])
        if cell["cell_type"] == "markdown":
            parts.append(source)
            continue
        parts.append(f"```python\n{source}\n```")
        for output in cell["outputs"]:
            if text := text_of(output).rstrip():
                parts.append(f"```\n{text}\n```")
            if picture := output.get("data", {}).get("image/png"):
                parts.append(f'<img alt="figure of the cell" src="data:image/png;base64,{picture}">')
    return "\n\n".join(parts) + "\n"


def keep(path: Path = NOTEBOOK) -> None:
    """Execute a notebook and write it with its outputs."""
    import matplotlib

    matplotlib.use("agg")
    kept = json.loads(path.read_text(encoding="utf-8"))
    kept["cells"] = list(executed(kept["cells"]))
    path.write_text(json.dumps(kept, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")


if __name__ == "__main__":
    keep()
