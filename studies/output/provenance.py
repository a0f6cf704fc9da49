"""Provenance of a result: versions and machine, without paths or host names, and the log of a run.

The versions are found without importing the packages. The log, ``suture.log`` in the folder of a
run, has the start of the run, the version of the code, and the end of the run.
"""

import os
import platform
import re
import subprocess
from contextlib import suppress
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, requires, version
from pathlib import Path
from typing import Any

CODE = "suturefem"
ROOT = Path(__file__).parents[2]  # the clone, or the folder of the installed packages
NAME = re.compile(r"[A-Za-z0-9._-]+")  # of the package, at the start of a requirement
BENEATH = ("vtk", "mkl")  # packages below these that can influence results
LOG = "suture.log"


def installed_version(package: str) -> str | None:
    """Return the version of an installed package, None if it is not installed."""
    try:
        return version(package)
    except PackageNotFoundError:
        return None


def commit(folder: Path) -> str | None:
    """Return the commit of a folder, marked if files differ from it; None outside a clone."""
    if not (folder / ".git").exists():
        return None
    try:
        head = _git(folder, "rev-parse", "--verify", "HEAD").strip()
        return head + ("+changes" if _git(folder, "status", "--porcelain", "-uno").strip() else "")
    except (OSError, subprocess.SubprocessError):
        return None


def _git(folder: Path, *arguments: str) -> str:
    command = ["git", "-C", str(folder), *arguments]
    return subprocess.run(command, capture_output=True, text=True, check=True, timeout=10).stdout


__version__ = installed_version(CODE)


def provenance() -> dict[str, Any]:
    """Return the versions of code, Python and packages, the machine, and the time [UTC]."""
    return {
        "suturefem": installed_version(CODE),
        "commit": commit(ROOT),
        "python": platform.python_version(),
        "packages": {name: found for name in packages() if (found := installed_version(name)) is not None},
        "machine": {"system": platform.system(), "machine": platform.machine(), "cpus": os.cpu_count()},
        "started": datetime.now(UTC).isoformat(timespec="seconds"),
    }


def packages() -> list[str]:
    """Return the names of the required and optional packages; none if the code is not installed."""
    try:
        asked = requires(CODE) or []
    except PackageNotFoundError:
        asked = []
    return sorted({NAME.match(line)[0] for line in asked} | set(BENEATH))  # type: ignore[index]


def begin_log(folder: Path, command: str) -> None:
    """Begin the log of a folder; a resumed run appends to the same log."""
    write_log(folder, f"{CODE} {installed_version(CODE)} ({commit(ROOT) or 'no clone'}): {command}")


def write_log(folder: Path, text: str) -> None:
    """Append lines to the log of a folder, each with its time [UTC]."""
    now = datetime.now(UTC).isoformat(timespec="seconds")
    with suppress(OSError), (folder / LOG).open("a", encoding="utf-8") as file:  # the run itself reports a full disk
        file.writelines(f"{now}  {line}\n" for line in text.splitlines())
