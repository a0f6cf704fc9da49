"""The coupling's README: every function that it names is there, every symbol has its row, every snippet runs."""

import ast
import re
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from coupling.kernels.bordered import NO_JOINTS, columns, linearise
from coupling.kernels.constraints import driving_force, passage, site_force, spread, thread_force
from coupling.kernels.friction import Law
from tests.bounds import DIFFERENCE, IDENTITY
from tests.thread.threads import Array, Strand, bent, uniform

ROOT = Path(__file__).resolve().parents[2]
TEXT = (ROOT / "coupling" / "README.md").read_text(encoding="utf-8")
NAMED = sorted(set(re.findall(r"`([\w/]+\.py):([\w.]+)`", TEXT)))
FILES = sorted(set(re.findall(r"`([\w/]+/[\w/]+\.py)`", TEXT)))
ROWS = re.findall(r"^\| ([^|]+?) \| .+ \| (.+?) \|$", TEXT, re.MULTILINE)
SYMBOLS = [
    *("A_t", "a, d", "M", "D", "∂²E/∂q²", "H_qU", "H_qs", "H_Uq", "H_Us", "H_sq, H_sU"),
    *("ε a+H_ss", "ε", "Φ_q", "Φ_s", "Φ_y", "M_o", "C_o", "K", "F₀ ± B, μ_s, μ_k"),
    *("V", "Y", "A_o", "y_free", "C", "λ", "m", "Φ_qᵀλ", "Φ_yᵀλ", "Φ_sᵀλ", "σ", "u, v"),
    *(f"eq. {number}" for number in range(1, 10)),
    *("condensation", "stick and slip", "N", "contact", "events", "audit"),
]


@cache
def defined(file: str) -> frozenset[str]:
    """Functions, classes, and methods and fields of classes (`Class.member`) that a module defines."""
    out = set()
    for node in ast.parse((ROOT / file).read_text(encoding="utf-8")).body:
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            out.add(node.name)
        for part in node.body if isinstance(node, ast.ClassDef) else ():
            if isinstance(part, ast.FunctionDef):
                out.add(f"{node.name}.{part.name}")
            elif isinstance(part, ast.AnnAssign) and isinstance(part.target, ast.Name):
                out.add(f"{node.name}.{part.target.id}")
    return frozenset(out)


@pytest.mark.parametrize(("file", "name"), NAMED, ids=[f"{file}:{name}" for file, name in NAMED])
def test_what_is_named_exists(file: str, name: str) -> None:
    """Independent check: the text of the module."""
    assert name in defined(file), f"coupling/README.md names {file}:{name}, which is not there"


def test_the_tables_are_read() -> None:
    """Independent check: the other tests look at many names and rows, not at none."""
    assert len(NAMED) > 50 and len(ROWS) > 50
    assert "Border.H_qs" in defined("coupling/kernels/border.py") and "no_such" not in defined(
        "coupling/kernels/border.py"
    )
    assert all((ROOT / file).is_file() for file in FILES) and FILES


@pytest.mark.parametrize("symbol", SYMBOLS)
def test_each_symbol_has_a_row(symbol: str) -> None:
    """Independent check: one row, whose last cell names a function."""
    places = [where for first, where in ROWS if first == symbol]
    assert len(places) == 1 and re.search(r"`[\w/]+\.py:[\w.]+`", places[0])


def test_the_signs_of_the_blocks() -> None:
    """Independent check, by central differences of forces: H = −∂(force)/∂(unknown), with the opposite sign where the
    row says so; and ε a is in the slope by s, once."""
    thread, inertia, one = uniform(1.0, 10, Strand(EI=1.0)), 7.0, np.ones(1)
    rng = np.random.default_rng(5)
    q, s, dq = bent(thread.spline), np.array([0.43]), rng.standard_normal((10, 3))
    lam, y = rng.standard_normal((1, 5)), rng.standard_normal((1, 9))
    at = passage(thread.spline, q, s)
    V, none = columns(at, thread.n, 3), one < 0.0
    law = Law(s, s, *[0 * one] * 5, none, ~none, none, inertia * one, s, 0 * one, one, *[0 * one] * 4, NO_JOINTS)
    border = linearise(law, one, np.ones((1, 5), dtype=bool), at, lam, y)

    def slope(force: Callable[..., Array], dq: Array | float = 0.0, ds: float = 0.0) -> Array:
        ends = [force(passage(thread.spline, q + h * dq, s + h * ds), lam, y) for h in (1e-5, -1e-5)]
        return np.ravel(ends[0] - ends[1]) / 2e-5

    on_points = lambda at, lam, y: spread(thread_force(at, lam, y), at, thread.n)  # noqa: E731
    blocks = {
        "H_qs": (V @ border.H_qs[0], -slope(on_points, ds=1.0)),
        "H_Us": (border.minus_H_ys[0], -slope(site_force, ds=1.0)),
        "H_Uq": (border.R[0] @ (V.T @ dq.ravel()), -slope(site_force, dq=dq)),
        "ε a+H_ss": (border.D[0, 0, :1], inertia - slope(driving_force, ds=1.0)),
    }
    for symbol, (block, exact) in blocks.items():
        [where] = [where for first, where in ROWS if first == symbol]
        sign = -1.0 if "opposite sign" in where else 1.0
        assert np.abs(sign * block - exact).max() <= DIFFERENCE * np.abs(exact).max(), symbol


def test_every_module_is_listed() -> None:
    """Independent check: the modules of the folder and of its rooms, `arrays` and the kernels apart."""
    listed = TEXT[TEXT.index("## Rooms") : TEXT.index("## Stepping")]
    folders = [ROOT / "coupling", *(ROOT / "coupling" / room for room in ("joins", "step", "rest", "reports", "run"))]
    modules = {path.stem for folder in folders for path in folder.glob("*.py")} - {"__init__", "arrays"}
    assert {name for name in modules if f"`{name}`" not in listed} == set()


def test_the_snippets_run(capsys: pytest.CaptureFixture[str]) -> None:
    """Independent check: the hand moves by 1 mm against 0.1 N, the thread between ring and hand stretches by less than
    F L/EA of all its length, and the rest is drawn through; the audit closes."""
    snippets = re.findall(r"```python\n(.*?)```", TEXT, re.DOTALL)
    assert all(len(snippet.splitlines()) <= 15 for snippet in snippets)
    names: dict[str, object] = {}
    for snippet in snippets:
        exec(compile(snippet, "coupling/README.md", "exec"), names)
    slip, balance, at_rest = (float(x) for x in capsys.readouterr().out.split())
    EA: float = names["suture"].EA  # type: ignore[attr-defined]
    for drawn in (slip, at_rest):
        assert 1e-3 - 0.1 * 0.1 / EA <= drawn < 1e-3
    assert np.abs(balance) <= IDENTITY
