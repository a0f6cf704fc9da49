"""A call in a process of its own: what gmsh makes of a file that contradicts itself may end the process it is in."""

import os
import pickle
import signal
import subprocess
import sys
import tempfile
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any

from meshes.errors import MeshError

PATIENCE = 1800.0  # s: files of gigabytes are read in minutes


def call_in_child(function: Callable[..., Any], *given: Any) -> Any:
    """Return what a function of this package returns when called in another process.

    Raises the `MeshError` that it raises there, and one where the process ends or is silent for PATIENCE.
    """
    with tempfile.TemporaryDirectory() as folder:
        question, answer = Path(folder) / "question", Path(folder) / "answer"
        question.write_bytes(pickle.dumps((function.__module__, function.__qualname__, given)))
        # Safe path: modules that lie in the user's folder are none of ours.
        command = [sys.executable, "-P", "-m", "meshes.child", str(question), str(answer)]
        try:
            done = subprocess.run(command, env=_surroundings(), capture_output=True, timeout=PATIENCE, check=False)
        except subprocess.TimeoutExpired:
            raise MeshError(
                f"gmsh came to no end in {PATIENCE:g} s: the file contradicts itself; save it anew"
            ) from None
        if not answer.is_file():
            raise MeshError(f"gmsh broke down on it ({_end(done)}): the file contradicts itself; save it anew by gmsh")
        returned, error = pickle.loads(answer.read_bytes())
    if error is not None:
        raise error
    return returned


def _surroundings() -> dict[str, str]:
    root = str(Path(__file__).parents[1])
    return dict(os.environ, PYTHONPATH=os.pathsep.join([root, *filter(None, [os.environ.get("PYTHONPATH")])]))


def _end(done: "subprocess.CompletedProcess[bytes]") -> str:
    """Say how a process ended: by which signal, or with which last words."""
    if done.returncode < 0:
        return signal.strsignal(-done.returncode) or f"signal {-done.returncode}"
    said = done.stderr.decode(errors="replace").split("\n")
    return next((line.strip() for line in reversed(said) if line.strip()), f"status {done.returncode}")[:200]


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
