"""The log of a run, ``suture.log`` in its folder.

It has the start of the run, the version of the code, and the end of the run.
"""

from collections.abc import Iterable
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path

from studies.output.remarks import Remark
from studies.output.version import CODE, ROOT, commit, installed_version

LOG = "suture.log"


class RunLog:
    """Appends lines to the log of a folder, each with its time [UTC].

    A resumed run appends to the same log.
    """

    def __init__(self, folder: Path, command: str) -> None:
        self._path = folder / LOG
        self.write(f"{CODE} {installed_version(CODE)} ({commit(ROOT) or 'no clone'}): {command}")

    def write(self, text: str) -> None:
        """Append lines."""
        now = datetime.now(UTC).isoformat(timespec="seconds")
        with suppress(OSError), self._path.open("a", encoding="utf-8") as file:  # the run itself reports a full disk
            file.writelines(f"{now}  {line}\n" for line in text.splitlines())

    def end(self, status: str, remarks: Iterable[Remark]) -> None:
        """Append the end of the run and its remarks."""
        self.write("\n".join([status, *(remark.line for remark in remarks)]))
