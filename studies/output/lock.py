"""One run at a time in a folder: a lock that the system lets go of when its process ends, however it ends."""

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from os import PathLike
from pathlib import Path

from filelock import FileLock, Timeout

from studies.scenario import ScenarioError

LOCK = ".suture.lock"
AGAIN = 0.2  # s in which a lock is asked for again: the run that held it may be removing it


def folder_of(given: object) -> Path:
    """Return the folder that a program names. Raises `ScenarioError`."""
    if not isinstance(given, str | PathLike):
        raise ScenarioError(f"folder = {given!r} is refused: it names no folder; give the path of a new or empty one")
    return Path(given)


@contextmanager
def locked(folder: Path | str) -> Iterator[None]:
    """Lock a folder for a run; the folder is made if it is missing.

    Raises `ScenarioError` if another run is, and for a folder that cannot be made or written.
    """
    folder = Path(folder)
    lock = FileLock(folder / LOCK, timeout=AGAIN)
    try:
        if folder.exists() and not folder.is_dir():
            raise ScenarioError(f"--out {folder} is refused: it is a file; give a folder")
        folder.mkdir(parents=True, exist_ok=True)
        lock.acquire()
    except Timeout:
        reason = "another run is at work there; wait for its end, or give another folder"
        raise ScenarioError(f"--out {folder} is refused: {reason}") from None
    except (OSError, RuntimeError) as error:  # a RuntimeError where links lead in a circle
        reason = f"it cannot be written ({getattr(error, 'strerror', None) or error}); give another folder"
        raise ScenarioError(f"--out {folder} is refused: {reason}") from None
    try:
        yield
    finally:
        with suppress(OSError):  # Windows removes no open file; there `filelock` does it
            Path(lock.lock_file).unlink()
        lock.release()
