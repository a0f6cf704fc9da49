"""A process of its own for what may end the one it is in: gmsh by a file that contradicts itself, a plotter without
OpenGL.
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

PATIENCE = 1800.0  # s: files of gigabytes are read in minutes
WORDS = 300  # letters of what a child said last
ROOT = str(Path(__file__).parents[1])

# A module by its name as `python -m` runs it, found where the parent finds its own: first where the code is, last what
# else is on the parent's path. Isolated (-I), the child sees neither the working folder nor what PYTHON… names, so a
# file there that is called like a module is not run. Its input ends with the parent, however that ends: then the child
# removes the folder that it works in, and ends too.
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
    """Return what a function of this package, by which a `reader` reads a file, returns when called in another process.

    Raises the `MeshError` that it raises there, and one where the process ends or is silent for PATIENCE.
    """
    with tempfile.TemporaryDirectory() as folder:
        question, answer = Path(folder) / "question", Path(folder) / "answer"
        question.write_bytes(pickle.dumps((function.__module__, function.__qualname__, given)))
        try:
            done = run_module("meshes.child", Path(folder), [question, answer], PATIENCE)
        except subprocess.TimeoutExpired:
            raise MeshError(
                f"{reader} came to no end in {PATIENCE:g} s: the file contradicts itself; save it anew"
            ) from None
        if not answer.is_file():
            words = last_words(done.returncode, done.stderr.decode(errors="replace"))
            raise MeshError(f"{reader} broke down on it: {words}; the file contradicts itself; save it anew")
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
    """Run a module as `python -m` does with paths `given`, in a temporary `folder`, with the environment's `setting`.

    The child ends with this process, however it ends, and removes the folder then. Raises `subprocess.TimeoutExpired`
    after `patience` [s], None: never, and `OSError` where there can be no process.
    """
    command = [sys.executable, "-I", "-c", CHILD, ROOT, os.pathsep.join(_own_path()), module, *map(str, given)]
    surroundings = os.environ | setting
    watched, held = os.pipe()  # nothing is written: the system closes it with this process
    try:
        return subprocess.run(
            command, cwd=folder, env=surroundings, stdin=watched, capture_output=True, timeout=patience, check=False
        )
    finally:
        os.close(watched)
        os.close(held)


def _own_path() -> list[str]:
    """Return where this process finds its modules, but for the folder that it works in."""
    here = Path.cwd()
    return [entry for entry in sys.path if entry and Path(entry).resolve() != here]


def last_words(status: int, text: str) -> str:
    """Return what a child said last, or how it ended where it said nothing."""
    if status < 0:
        how = f"ended by {signal.Signals(-status).name}"
    else:
        how = f"ended with status {status}" if status else "ended without an answer"
    lines = [line.strip() for line in text.splitlines() if line.strip()]
    return f"{lines[-1][:WORDS]} ({how})" if lines else how


def _answer(question: Path, answer: Path) -> None:
    """Call the function that is asked for, and leave what it returns or refuses, complete or not at all."""
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
