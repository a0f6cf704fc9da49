"""How the loops are compiled: each part once, the step apart from steps at once, and no array that nobody counts."""

import ast
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from numba import config
from numba.core.codegen import JITCPUCodegen

from coupling.kernels import iteration
from coupling.kernels.address import address_of, by_address
from coupling.kernels.steps import march
from coupling.run import begin
from studies.simulation.assembly import assemble
from tests.coupling.test_compiled import drawn
from thread.kernels import loops
from thread.kernels.records import record

MODULES = loops.files_of(march.__file__)
ARRAYS = {"Array", "Indices", "Flags", "Border", "Motion", "Found", "Passing", "Unknowns", "Stretched", "Any"}


@pytest.fixture(autouse=True)
def no_loops_of_before(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Keep what is compiled here in a folder of its own."""
    monkeypatch.setattr(config, "CACHE_DIR", str(tmp_path))


@loops.loop
def third(x: float) -> float:
    """A part that two others call."""
    return x / 3.0


@loops.loop
def ninth(x: float) -> float:
    """A part that a whole calls, and another part."""
    return third(third(x))


@loops.owning
def ninths(n: int) -> Any:
    """A part that makes an array."""
    out = np.zeros(n)
    for i in range(n):
        out[i] = ninth(float(i))
    return out


def total_of(n: int) -> float:
    """A whole."""
    total = 0.0
    for _ in range(n):
        total += ninth(1.0)
    return total


def test_a_part_has_no_code_of_its_own(monkeypatch: pytest.MonkeyPatch) -> None:
    """Independent check: of a part that calls parts, and of these, nothing is given a place in memory but the whole."""
    placed: list[str] = []
    place = JITCPUCodegen._add_module

    def noted(self: Any, module: Any) -> Any:
        placed.append(module.name)
        return place(self, module)

    monkeypatch.setattr(JITCPUCodegen, "_add_module", noted)
    whole = loops.outermost(total_of)
    assert whole(18) == pytest.approx(2.0)
    assert [name for name in placed if "total_of" in name] == ["total_of"]
    assert not [name for name in placed if "third" in name or "ninth" in name]


def test_arrays_that_a_part_makes_are_given_back() -> None:
    """Independent check: the sum of an array that a part makes, of each of a thousand, by a part that counts them."""

    @loops.owning
    def sum_of_ninths(n: int) -> float:
        made, total = ninths(n), 0.0
        for i in range(n):
            total += made[i]
        return total

    def sums(n: int, times: int) -> float:
        total = 0.0
        for _ in range(times):
            total += sum_of_ninths(n)
        return total

    assert loops.outermost(sums)(10, 1000) == pytest.approx(5000.0)


@record
class Row(NamedTuple):
    """Numbers, and what they are multiplied by."""

    x: Any
    used: bool
    factor: float


@record
class Rows(NamedTuple):
    """A row, two more, and an array."""

    first: Row
    pair: tuple[Row, Row]
    out: Any


@loops.loop
def scaled(row: Row, out: Any) -> None:
    """Write the numbers of a row, if it is used."""
    for i in range(len(row.x)):
        out[i] = row.factor * row.x[i] if row.used else -1.0


def spread(rows: Rows) -> float:
    """Write all rows."""
    scaled(rows.first, rows.out[0])
    scaled(rows.pair[0], rows.out[1])
    scaled(rows.pair[1], rows.out[2])
    return rows.out[-1, 0] + len(rows.out)


def test_a_record_is_read_by_its_address() -> None:
    """Independent check: a compiled function finds the fields of records that are in records and in tuples."""
    x, out = np.arange(12.0).reshape(3, 4), np.zeros((3, 4))
    rows = Rows(Row(x[0], True, 2.0), (Row(x[:, 1], True, 0.5), Row(x[2], False, 1.0)), out)
    assert loops.outermost(spread)(rows) == 2.0
    assert out.tolist() == [[0.0, 2.0, 4.0, 6.0], [0.5, 2.5, 4.5, 0.0], [-1.0, -1.0, -1.0, -1.0]]


def test_a_function_is_called_where_it_stands() -> None:
    """Independent check: what stands at the address is called, and not what has the name."""
    one = loops.outermost(lambda x, n: x + n)
    other = loops.outermost(lambda x, n: x - n)
    call = by_address(one)
    caller = loops.outermost(lambda address, x, n: call(address, (x, n)))
    assert caller(address_of(one, (2.5, 1)), 2.5, 1) == 3.5
    assert caller(address_of(other, (2.5, 1)), 2.5, 1) == 1.5


def test_without_numba_it_is_called_by_name(monkeypatch: pytest.MonkeyPatch) -> None:
    """Independent check: where Numba is switched off there is no address."""
    monkeypatch.setattr(config, "DISABLE_JIT", 1)
    assert address_of(total_of, (3,)) == 0
    assert by_address(max)(0, (3, 4)) == 4


def test_steps_at_once_have_no_code_of_the_step() -> None:
    """Independent check: Newton's iteration is in the code of one step, and not in that of many at once."""
    scene = drawn()
    assembly = assemble(scene)
    begin(assembly.system, assembly.start()).steps(scene.solve.dt, 4)
    step, steps = defined(iteration.solve), defined(march.march)
    for own in ("solve_set", "newton_direction", "thread_matrix"):
        assert any(own in name for name in step)
        assert not any(own in name for name in steps)
    assert any("audit_march" in name for name in steps)


def defined(function: Any) -> list[str]:
    """The names of the functions in the code of a compiled one."""
    modules = [made.library._get_module_for_linking() for made in function.overloads.values()]
    return [each.name for module in modules for each in module.functions if not each.is_declaration]


def kernels() -> dict[str, tuple[str, ast.FunctionDef]]:
    """Each function of the loops by its name: how it is compiled, and its text; of one name, all that make arrays."""
    found: dict[str, tuple[str, ast.FunctionDef]] = {}
    for path in MODULES:
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.FunctionDef) and node.decorator_list:
                (how,) = (ast.unparse(each) for each in node.decorator_list)
                if how in ("loop", "owning", "outermost") and found.get(node.name, ("", node))[0] != "owning":
                    found[node.name] = how, node
    return found


def returns_arrays(node: ast.FunctionDef) -> bool:
    """Whether a function says that it returns an array, or a tuple of arrays."""
    told = {each.id for each in ast.walk(node.returns) if isinstance(each, ast.Name)} if node.returns else set()
    return bool(told & ARRAYS)


def test_no_array_is_lost() -> None:
    """Independent check: nobody counts who refers to an array in a function that does not own any, so none returns one,
    nor calls what does: that would be freed too early, or never."""
    all_of = kernels()
    making = {name for name, (_, node) in all_of.items() if returns_arrays(node)}
    assert {"full_band", "thread_matrix"} <= making
    for name, (how, node) in all_of.items():
        calls = {
            each.func.id for each in ast.walk(node) if isinstance(each, ast.Call) and isinstance(each.func, ast.Name)
        }
        assert how == "owning" or not (name in making or calls & making), name
