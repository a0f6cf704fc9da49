"""An installation without optional libraries: the main commands work, the others name the extra to install."""

import os
import subprocess
import sys
import tomllib
from pathlib import Path
from sysconfig import get_paths

import pytest

from studies.extras import EXTRAS

ROOT = Path(__file__).parents[2]
RUN = "run two_piercings --set solve.duration=0.002 --set tissue.mesh.accuracy=given --out run"
WORKS = [
    (RUN, "no picture could be drawn: pyvista is not installed; matplotlib is not installed"),
    ("check two_piercings --set tissue.mesh.accuracy=given", "can be run"),
    ("mesh two_piercings --set tissue.mesh.accuracy=given --out mesh.vtu", "none, pyvista is not installed"),
    ("doctor", "pip install 'suturefem[mesh]'"),
]
REFUSED = {
    "view run": "pictures",
    "plot run piercings.exit.tension_after": "pictures",
    "report run --out page.html": "report",
    "study friction --preset quick --out study": "pictures",
    "refine paper_figure_1 --quantity piercings.exit.slip --out refined": "pictures",
    "sweep paper_figure_1 --over solve.duration=[0.01] --plot solve.duration energy.kinetic --out sweep": "pictures",
    "check running_anastomosis": "mesh",
    "check two_piercings --set tissue.solver=multigrid": "large",
    "check two_piercings --set tissue.mesh.accuracy=given --picture picture.png": "pictures",
}
CODE = """
import shlex, sys
from studies.command.command import main
for line in sys.stdin.read().splitlines():
    print("==", main(shlex.split(line)), flush=True)
"""


@pytest.fixture(scope="module")
def answers(tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    """The outputs of the commands, one after the other, where the installed packages are links to all but the optional
    ones; each ends in its exit status."""
    folder = tmp_path_factory.mktemp("bare")
    links = folder / "packages"
    links.mkdir()
    for path in Path(get_paths()["purelib"]).iterdir():
        if path.name.partition(".")[0] not in {*EXTRAS, "vtk"}:
            (links / path.name).symlink_to(path)
    setting = os.environ | {"PYTHONPATH": os.pathsep.join([str(ROOT), str(links)])}
    done = subprocess.run(
        [sys.executable, "-S", "-c", CODE], input="\n".join([*dict(WORKS), *REFUSED]), cwd=folder, env=setting,
        text=True, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, check=True,
    )  # fmt: skip
    return done.stdout.splitlines()


def answer(answers: list[str], number: int) -> tuple[str, int]:
    """The output of a command and its exit status."""
    ends = [k for k, line in enumerate(answers) if line.startswith("== ")]
    begin = ends[number - 1] + 1 if number else 0
    return "\n".join(answers[begin : ends[number]]), int(answers[ends[number]].removeprefix("== "))


@pytest.mark.parametrize("number", range(len(WORKS)), ids=[command.partition(" ")[0] for command, _ in WORKS])
def test_main_commands_need_no_optional_library(answers: list[str], number: int) -> None:
    """Independent check: a process that cannot import any of them."""
    said, status = answer(answers, number)
    assert status == 0, said
    assert WORKS[number][1] in said


@pytest.mark.parametrize("number", range(len(REFUSED)), ids=[" ".join(command.split()[:2]) for command in REFUSED])
def test_other_commands_name_the_extra(answers: list[str], number: int) -> None:
    """Independent check: one sentence and the status of a refusal, no traceback."""
    said, status = answer(answers, len(WORKS) + number)
    assert status in (1, 2) and "Traceback" not in said
    assert f"suturefem[{list(REFUSED.values())[number]}]" in said


def test_extras_install_what_they_say() -> None:
    """Independent check: the requirements of pyproject.toml."""
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["optional-dependencies"]
    for library, extra in EXTRAS.items():
        assert library == "vtkmodules" or any(line.startswith(library) for line in extras[extra])
    chosen = set(extras) - {"all", "test", "docs"}
    assert extras["all"] == [f"suturefem[{','.join(name for name in extras if name in chosen)}]"]
