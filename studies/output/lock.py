"""One run at a time in a folder: a lock that the system lets go of when its process ends, however it ends."""

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO

from studies.scenario import ScenarioError

LOCK = ".suture.lock"


@contextmanager
def locked(folder: Path | str) -> Iterator[None]:
    """Hold a folder, made where there is none, while a run is at work in it.

    Raises `ScenarioError` where another run is, and for a folder that cannot be made or written.
    """
    path = Path(folder) / LOCK
    file = _held(path)
    try:
        yield
    finally:
        if sys.platform == "win32":  # where an open file cannot be removed, and so never one that is held
            file.close()
            with suppress(OSError):
                path.unlink()
        else:
            path.unlink(missing_ok=True)
            file.close()


def _held(path: Path) -> IO[bytes]:
    """Open and lock the file; anew where the run that held it removed it in between."""
    while True:
        file = _opened(path)
        if not _is_locked(file):
            file.close()
            raise ScenarioError(
                f"--out {path.parent} is refused: another run is at work there; wait for its end, or give another "
                "folder"
            )
        if _is_at(path, file):
            return file
        file.close()


def _opened(path: Path) -> IO[bytes]:
    folder = path.parent
    try:
        if folder.exists() and not folder.is_dir():
            raise ScenarioError(f"--out {folder} is refused: it is a file; give a folder")
        folder.mkdir(parents=True, exist_ok=True)
        return path.open("a+b")
    except (OSError, RuntimeError) as error:  # a RuntimeError where links lead in a circle
        reason = getattr(error, "strerror", None) or error
        raise ScenarioError(
            f"--out {folder} is refused: it cannot be written ({reason}); give another folder"
        ) from None


def _is_locked(file: IO[bytes]) -> bool:
    """Lock an open file; tell whether it could be. A file system that knows no locks refuses nobody."""
    try:
        if sys.platform == "win32":
            import msvcrt

            file.seek(0)
            msvcrt.locking(file.fileno(), msvcrt.LK_NBLCK, 1)
        else:
            import fcntl

            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except (BlockingIOError, PermissionError):
        return False
    except OSError:
        return True
    return True


def _is_at(path: Path, file: IO[bytes]) -> bool:
    """Tell whether an open file is still the one of that name."""
    try:
        return os.path.samestat(os.stat(path), os.fstat(file.fileno()))
    except FileNotFoundError:
        return False
