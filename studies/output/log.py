"""The log of a run, ``suture.log`` in its folder.

It has the start of the run, the version of the code, and the end of the run.
"""

from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path

from studies.output.version import CODE, ROOT, commit, installed_version

LOG = "suture.log"


def begin_log(folder: Path, command: str) -> None:
    """Begin the log of a folder; a resumed run appends to the same log."""
    write_log(folder, f"{CODE} {installed_version(CODE)} ({commit(ROOT) or 'no clone'}): {command}")


def write_log(folder: Path, text: str) -> None:
    """Append lines to the log of a folder, each with its time [UTC]."""
    now = datetime.now(UTC).isoformat(timespec="seconds")
    with suppress(OSError), (folder / LOG).open("a", encoding="utf-8") as file:  # the run itself reports a full disk
        file.writelines(f"{now}  {line}\n" for line in text.splitlines())
