"""The commands for help: ``suture new | scenes | doctor | completion``."""

import argparse
import json
import os
import platform
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from shlex import quote
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from studies.command.lines import print_lines
from studies.extras import LIBRARIES, SYSTEM_LIBRARIES, installation
from studies.lists import list_of
from studies.output.provenance import installed_version
from studies.scenario import ScenarioError, scenes
from studies.scenario.reference import cost_of, title_of

TEMPLATE, STITCHES = (Path(__file__).with_name(name) for name in ("new.toml", "stitches.toml"))
GL = f"on Debian: apt-get install --no-install-recommends {SYSTEM_LIBRARIES}"


def new(options: argparse.Namespace) -> int:
    """``suture new``: write a scenario with a comment on every key, for the user to change."""
    path = options.name if options.name.suffix == ".toml" else options.name.with_name(f"{options.name.name}.toml")
    if path.exists():
        raise ScenarioError(f"{path} is refused: it already exists; give another name")
    path.parent.mkdir(parents=True, exist_ok=True)
    template = STITCHES if options.stitches else TEMPLATE
    path.write_text(template.read_text(encoding="utf-8"), encoding="utf-8")
    file, folder = quote(str(path)), quote(str(Path("results") / path.stem))
    print(f"{path} is written\ncheck it  suture check {file}\nrun it    suture run {file} --out {folder}")
    return 0


def list_scenes(options: argparse.Namespace) -> int:
    """``suture scenes``: list the shipped scenarios with their titles and costs."""
    listed = {name: {"title": title_of(name), "cost": cost_of(name)} for name in scenes()}
    if options.json:
        print(json.dumps(listed, ensure_ascii=False))
    else:
        print_lines([f"{name:22}  {scene['title']} ({scene['cost']})" for name, scene in listed.items()])
    return 0


def finding(name: str, there: bool, found: str, needed: str, remedy: str = "") -> dict[str, Any]:
    """Return the state of a component.

    `found` describes it in words, `needed` is its purpose, and `remedy` helps if it is missing.
    """
    return {"name": name, "there": there, "found": found, "needed": needed, "remedy": remedy}


def examine(options: argparse.Namespace) -> int:
    """``suture doctor``: list the installed components, and remedies for missing ones."""
    findings = [check() for check in CHECKS]
    if options.json:
        print(json.dumps(findings, ensure_ascii=False))
        return 0
    for one in findings:
        print_lines([f"{'ok     ' if one['there'] else 'missing'} {one['name']:14}  {one['found']}"])
        if not one["there"]:
            print_lines([f"{'':24}needed for {one['needed']}; {one['remedy']}"])
    return 0


def find_code() -> dict[str, Any]:
    """Return the version of the code and of Python."""
    found = f"{installed_version('suturefem') or 'not installed'}, Python {platform.python_version()}"
    return finding("suturefem", True, found, "everything")


def find_memory() -> dict[str, Any]:
    """Return the available memory and the number of processors."""
    import psutil

    free = psutil.virtual_memory().available / 1e9
    return finding("machine", True, f"{os.cpu_count()} processors, {free:.3g} GB of memory available", "large organs")


def find_gmsh() -> dict[str, Any]:
    """Return the state of gmsh, which needs libraries of the system."""
    needed = "graded blocks, open wounds, cylinders, tubes, .msh files, surfaces"
    try:
        import_module("gmsh")
    except (ImportError, OSError) as error:
        remedy = installation("gmsh") if isinstance(error, ImportError) else GL
        return finding("gmsh", False, str(error), needed, remedy)
    return finding("gmsh", True, installed_version("gmsh") or "", needed)


def find_gl() -> dict[str, Any]:
    """Return the state of 3-D drawing, by a test picture of a thread."""
    from studies.output.fields import ThreadRecord
    from studies.pictures.picture import draw_scene
    from studies.pictures.scene import Frame

    s = np.linspace(0.0, 0.01, 3)
    thread = ThreadRecord(s[:, None] * [1.0, 0.0, 0.0], s, 0.0 * s, 0.0 * s, 1e-4)
    with TemporaryDirectory() as folder:
        line, _ = draw_scene(([Frame(0.0, thread, (), None)], None, ""), Path(folder) / "picture.png")
    state, there = line.partition(": ")[2], "3-D picture" in line.partition(";")[0]
    needed = "3-D pictures; without it, pictures are sections"
    remedy = GL if installed_version("pyvista") else installation("pyvista")
    return finding("GL", there, state if there else state.partition("; ")[2].partition(", for the")[0], needed, remedy)


def finder(name: str, library: str, needed: str) -> Callable[[], dict[str, Any]]:
    """Return the function that finds an optional library."""

    def find() -> dict[str, Any]:
        version = installed_version(library)
        return finding(name, version is not None, version or "not installed", needed, installation(library))

    return find


CHECKS: tuple[Callable[[], dict[str, Any]], ...] = (
    find_code,
    find_memory,
    find_gmsh,
    find_gl,
    *(finder(entry["name"], library, entry["needed"]) for library, entry in LIBRARIES.items() if "needed" in entry),
)


SCENARIO, PREAMBLE = list_of(__file__, "completion.toml").values()


def print_completion(options: argparse.Namespace) -> int:
    """``suture completion``: print the script by which a shell completes the command line.

    It completes commands, options and scenes.
    """
    import shtab

    from studies.command.parser import TABLE, parser_for

    parser = parser_for(list(TABLE))
    [subparsers] = [action for action in parser._actions if isinstance(action, argparse._SubParsersAction)]
    for action in (action for sub in subparsers.choices.values() for action in sub._actions if action.type is Path):
        plain = shtab.DIRECTORY if action.metavar == "DIR" else shtab.FILE
        action.complete = SCENARIO if action.dest == "file" else plain
    preamble = {shell: text.format(" ".join(scenes())) for shell, text in PREAMBLE.items()}
    shell = options.shell or Path(os.environ.get("SHELL", "")).name
    print(shtab.complete(parser, shell if shell in PREAMBLE else "bash", preamble=preamble))
    return 0
