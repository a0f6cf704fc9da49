"""A separate process for work that can end its process.

Examples are gmsh on an inconsistent file and a plotter without OpenGL.
"""

import os
import pickle
import signal
import subprocess
import sys
import tempfile
from collections.abc import Callable, Mapping, Sequence
from importlib import import_module
from pathlib import Path
from types import MappingProxyType
from typing import Any

from meshes.errors import MeshError

PATIENCE = 1800.0  # s: a file of gigabytes is read in minutes
WORDS = 300  # characters of the last message of a child process
ROOT = str(Path(__file__).parents[1])

# The child runs a module by its name, as `python -m` does. It searches the folder of the code first
# and then the other entries of the parent's path. It is isolated (-I): it ignores the working
# folder and the variables PYTHON…, so that a file there with the name of a module is not run. The
# child's input ends when the parent ends in any way. The child then removes its working folder and
# ends too.
CHILD = """
import os, runpy, shutil, sys, threading
def end_with_parent():
    os.read(0, 1)
    shutil.rmtree(os.getcwd(), ignore_errors=True)
    os._exit(1)
threading.Thread(target=end_with_parent, daemon=True).start()
root, rest = sys.argv[1], sys.argv[2].split(os.pathsep)
del sys.argv[1:3]
sys.path[:0] = [root] if root not in sys.path else []
sys.path += [entry for entry in rest if entry not in sys.path]
runpy.run_module(sys.argv.pop(1), run_name="__main__")
"""


def call_in_child(function: Callable[..., Any], *given: Any, reader: str = "gmsh") -> Any:
    """Return the result of a function of this package, called in another process.

    `reader` names the library that reads a file there. Raises the `MeshError` of the function, and
    a `MeshError` if the process ends or does not answer within PATIENCE.
    """
    with tempfile.TemporaryDirectory() as folder:
        question, answer = Path(folder) / "question", Path(folder) / "answer"
        question.write_bytes(pickle.dumps((function.__module__, function.__qualname__, given)))
        try:
            done = run_module("meshes.child", Path(folder), [question, answer], PATIENCE)
        except subprocess.TimeoutExpired:
            raise MeshError(
                f"{reader} did not finish within {PATIENCE:g} s: the file is inconsistent; save it again"
            ) from None
        if not answer.is_file():
            words = last_words(done.returncode, done.stderr.decode(errors="replace"))
            raise MeshError(f"{reader} crashed: {words}; the file is inconsistent; save it again")
        returned, error = pickle.loads(answer.read_bytes())
    if error is not None:
        raise error
    return returned


def run_module(
    module: str,
    folder: Path,
    given: Sequence[Path],
    patience: float | None,
    setting: Mapping[str, str] = MappingProxyType({}),
) -> "subprocess.CompletedProcess[bytes]":
    """Run a module in another process, as `python -m` does, in a temporary `folder`.

    The module gets the paths `given` and the environment variables `setting`. When this process
    ends in any way, the child removes the folder and ends too. `patience` [s] is None if there is
    no limit. Raises `subprocess.TimeoutExpired` after `patience`, and `OSError` if no process can
    be started.
    """
    command = [sys.executable, "-I", "-c", CHILD, ROOT, os.pathsep.join(_own_path()), module, *map(str, given)]
    surroundings = os.environ | setting
    watched, held = os.pipe()  # nothing is written; the system closes the pipe with this process
    try:
        return subprocess.run(
            command, cwd=folder, env=surroundings, stdin=watched, capture_output=True, timeout=patience, check=False
        )
    finally:
        os.close(watched)
        os.close(held)


def _own_path() -> list[str]:
    """Return the module path of this process without its working folder."""
    here = Path.cwd()
    return [entry for entry in sys.path if entry and Path(entry).resolve() != here]


def last_words(status: int, text: str) -> str:
    """Return the last message of a child and how it ended."""
    if status < 0:
        how = f"ended by {signal.Signals(-status).name}"
    else:
        how = f"ended with status {status}" if status else "ended without an answer"
    lines = [line.strip() for line in text.splitlines() if line.strip()]
    return f"{lines[-1][:WORDS]} ({how})" if lines else how


def _answer(question: Path, answer: Path) -> None:
    """Call the function of the `question`, and write its result to `answer`.

    A `MeshError` of the function is written in place of a result. The file `answer` is always
    complete.
    """
    module, name, given = pickle.loads(question.read_bytes())
    result: tuple[Any, MeshError | None]
    try:
        result = getattr(import_module(module), name)(*given), None
    except MeshError as error:
        result = None, error
    unfinished = answer.with_suffix(".part")
    unfinished.write_bytes(pickle.dumps(result))
    os.replace(unfinished, answer)


if __name__ == "__main__":
    _answer(*map(Path, sys.argv[1:]))
