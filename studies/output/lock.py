"""One run at a time in a folder: a lock that the system releases at any end of its process."""

from collections.abc import Collection, Iterator
from contextlib import contextmanager, suppress
from os import PathLike
from pathlib import Path

from filelock import FileLock, Timeout

from studies.output.files import unfinished
from studies.scenario import ScenarioError

LOCK = ".suture.lock"
AGAIN = 0.2  # s of repeated attempts to lock: the earlier run is perhaps removing its lock


def folder_of(given: object) -> Path:
    """Return the folder that a program names. Raises `ScenarioError`."""
    if not isinstance(given, str | PathLike):
        raise ScenarioError(f"folder = {given!r} is refused: it is no path; give the path of a new or empty folder")
    return Path(given)


def refused(folder: Path, reason: str) -> ScenarioError:
    """Return the refusal of a folder that ``--out`` names."""
    return ScenarioError(f"--out {folder} is refused: {reason}")


def foreign_file(folder: Path, names: Collection[str], known: bool) -> str:
    """Return the first name in a folder that does not belong to its results; empty without one.

    `names` belong to the results if they are `known`, that is if the folder has their mark. The
    lock and temporary files belong to them in any case.
    """
    there = sorted(path.name for path in folder.iterdir()) if folder.is_dir() else []
    begun = {LOCK, *(path.name for path in unfinished(folder, names))}
    return next((name for name in there if name not in begun and not (known and name in names)), "")


def refuse_foreign_files(folder: Path, names: Collection[str], known: bool, what: str) -> None:
    """Refuse a folder with files that no `what` wrote; the others are as in `foreign_file`.

    Raises `ScenarioError`.
    """
    if other := foreign_file(folder, names, known):
        raise refused(folder, f"it holds files that no {what} wrote ({other}); give a new or empty folder")


@contextmanager
def locked(folder: Path | str) -> Iterator[None]:
    """Lock a folder for a run; a missing folder is made.

    Raises `ScenarioError` if another run has locked it, or if the folder cannot be made or written.
    """
    folder = Path(folder)
    lock = FileLock(folder / LOCK, timeout=AGAIN)
    try:
        if folder.exists() and not folder.is_dir():
            raise refused(folder, "it is a file; give a folder")
        folder.mkdir(parents=True, exist_ok=True)
        lock.acquire()
    except Timeout:
        raise refused(folder, "another run uses it; wait until this run ends, or give another folder") from None
    except (OSError, RuntimeError) as error:  # a RuntimeError if links form a circle
        cause = getattr(error, "strerror", None) or error
        raise refused(folder, f"it cannot be written ({cause}); give another folder") from None
    try:
        yield
    finally:
        with suppress(OSError):  # Windows cannot remove an open file; there `filelock` removes it
            Path(lock.lock_file).unlink()
        lock.release()
