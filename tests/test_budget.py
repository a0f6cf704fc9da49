"""How large the packages may grow: lines of code without blank lines, comments and docstrings."""

import ast
import io
import re
import tokenize
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
TEXT = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
BUDGET = {name: int(most) for name, most in re.findall(r"^\| `(\w+)` \| (\d+) \|$", TEXT, re.MULTILINE)}
SILENT = {tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT, tokenize.ENDMARKER}
DOCUMENTED = ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef


def code_lines(source: str) -> int:
    """Count the lines of a module that hold code."""
    docstrings: set[int] = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, DOCUMENTED) and ast.get_docstring(node, clean=False) is not None:
            docstrings.update(range(node.body[0].lineno, (node.body[0].end_lineno or 0) + 1))
    tokens = tokenize.generate_tokens(io.StringIO(source).readline)
    spoken = [token for token in tokens if token.type not in SILENT]
    return len({line for token in spoken for line in range(token.start[0], token.end[0] + 1)} - docstrings)


@pytest.mark.parametrize("package", ["thread", "coupling", "tissue", "meshes", "studies"])
def test_a_package_stays_within_its_budget(package: str) -> None:
    """Independent check: the text of every module, and the table of CONTRIBUTING.md."""
    modules = (ROOT / package).rglob("*.py")
    assert sum(code_lines(path.read_text(encoding="utf-8")) for path in modules) <= BUDGET[package]


def test_comments_and_docstrings_do_not_count() -> None:
    """Independent check: a module whose two lines of code one can see."""
    assert code_lines('"""What it is.\n\nMore."""\n\n# why\nx = (1,\n     2)  # unit\n') == 2
