"""Who may import whom: meshes, thread and tissue know nothing of one another, coupling sees the last two and never
scikit-fem, studies may use all, and nothing below imports studies or the tests. And what an installed package holds."""

import ast
import tomllib
from fnmatch import fnmatchcase
from graphlib import TopologicalSorter
from itertools import pairwise
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
PACKAGES = {"meshes", "thread", "tissue", "coupling", "studies"}
MAY = {
    "meshes": set(),
    "thread": set(),
    "tissue": set(),
    "coupling": {"thread", "tissue"},
    "studies": {"meshes", "thread", "tissue", "coupling"},
}
NEVER = {"coupling": {"skfem", "meshio", "gmsh", "pyvista"}, "thread": {"skfem", "meshio", "gmsh", "pyvista"}}
ABOVE = {"tests", "pytest", "suturefem"}  # tests and users' programs
FILES = sorted(path for package in PACKAGES for path in (ROOT / package).rglob("*.py"))


def imported(source: str, package: str) -> set[str]:
    """Top-level names that a module imports anywhere in it, its own package (relative imports) included."""
    out = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            out |= {alias.name.split(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            out.add(package if node.level else str(node.module).split(".")[0])
        elif isinstance(node, ast.Call) and getattr(node.func, "attr", getattr(node.func, "id", "")) in (
            "import_module",
            "__import__",
        ):
            out |= {str(a.value).split(".")[0] for a in node.args if isinstance(a, ast.Constant)}
    return out


def against(names: set[str], package: str) -> set[str]:
    """Imports that go against the arrows."""
    others = (names & PACKAGES) - MAY[package] - {package}
    return others | (names & ABOVE) | (names & NEVER.get(package, set()))


@pytest.mark.parametrize("path", FILES, ids=lambda path: str(path.relative_to(ROOT)))
def test_no_import_against_the_arrows(path: Path) -> None:
    """Independent check: the text of every module."""
    package = path.relative_to(ROOT).parts[0]
    assert against(imported(path.read_text(encoding="utf-8"), package), package) == set()


def modules_of(path: Path) -> set[str]:
    """Modules of this house that a module imports anywhere in it, in a function too, each by its whole name."""
    out = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            out |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and not node.level:
            out |= {str(node.module), *(f"{node.module}.{alias.name}" for alias in node.names)}
    return out


def name_of(path: Path) -> str:
    """Name of a module, as others import it."""
    return ".".join(path.relative_to(ROOT).with_suffix("").parts)


def test_no_circle_of_imports() -> None:
    """Independent check: the text of every module. A package's own door may name what is in its room."""
    names = {name_of(path): path for path in FILES if path.name != "__init__.py"}
    TopologicalSorter({name: modules_of(path) & set(names) - {name} for name, path in names.items()}).prepare()


def room_of(module: str) -> str:
    """Name of the room of `coupling` that a module stands in; of a module beside the rooms its own name."""
    _, first, *_ = module.split(".")
    return first


def test_no_circle_between_the_rooms_of_the_coupling() -> None:
    """Independent check: the text of every module; `coupling/README.md` names the order."""
    names = {name_of(path): path for path in FILES if path.parts[-2:] != ("coupling", "__init__.py")}
    names = {name.removesuffix(".__init__"): path for name, path in names.items() if name.startswith("coupling.")}
    above: dict[str, set[str]] = {}
    for name, path in names.items():
        asked = {room_of(module) for module in modules_of(path) & set(names)}
        above.setdefault(room_of(name), set()).update(asked - {room_of(name)})
    for lower, upper in pairwise(["kernels", "joins", "step", "rest", "reports", "paper", "run"]):
        above[upper].add(lower)
    TopologicalSorter(above).prepare()


def test_reports_import_pictures_and_never_the_other_way() -> None:
    """Independent check: the text of every module of the pictures."""
    asked = {module for path in (ROOT / "studies" / "pictures").glob("*.py") for module in modules_of(path)}
    assert [module for module in asked if module.startswith("studies.report")] == []


def test_imports_of_modules_are_seen_in_functions_too() -> None:
    """Independent check: the solver of a step imports the compiled loops' tables when it first needs them."""
    assert "coupling.step.tables" in modules_of(ROOT / "coupling/step/solver.py")


def test_the_check_sees_what_it_should() -> None:
    """Independent check: imports of every form, hidden in a function too, are found."""
    assert {path.relative_to(ROOT).parts[0] for path in FILES} == PACKAGES
    text = "import skfem.mesh as m\ndef f():\n    from studies.scenario import x\n    import importlib\n"
    text += "    importlib.import_module('meshes.block')\nfrom . import y\n"
    found = imported(text, "coupling")
    assert found == {"skfem", "studies", "importlib", "meshes", "coupling"}
    assert against(found, "coupling") == {"skfem", "studies", "meshes"}
    assert against({"tissue", "skfem"}, "tissue") == set()
    assert against({"thread"}, "tissue") == {"thread"}
    assert against({"tests", "suturefem"}, "studies") == {"tests", "suturefem"}


WHEEL = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["hatch"]["build"]["targets"][
    "wheel"
]


def test_every_module_is_installed() -> None:
    """Independent check: each lies in an included folder with an `__init__.py` and type information, and `suturefem` at
    the top."""
    assert set(WHEEL["only-include"]) == PACKAGES
    assert [path for path in FILES if not (path.parent / "__init__.py").is_file() or excluded(path)] == []
    door = ROOT / "studies" / "api" / "suturefem"
    assert WHEEL["sources"] == {"studies/api/": ""}
    assert [
        folder for folder in (*(ROOT / name for name in PACKAGES), door) if not (folder / "py.typed").is_file()
    ] == []


def test_every_scene_is_installed() -> None:
    """Independent check: the shipped scenes with their surfaces, those of the studies, a new scenario, and the files of
    the report."""
    scenes = [path for kind in ("toml", "obj", "html", "css", "js") for path in (ROOT / "studies").rglob(f"*.{kind}")]
    assert len(scenes) > 20
    assert [path for path in scenes if excluded(path)] == []
    assert excluded(ROOT / "studies/friction/results/figure.png")


def excluded(path: Path) -> bool:
    """Whether a file, or a folder that it lies in, is left out of what is installed."""
    name = path.relative_to(ROOT)
    return any(fnmatchcase(str(part), pattern) for part in (name, *name.parents) for pattern in WHEEL["exclude"])
