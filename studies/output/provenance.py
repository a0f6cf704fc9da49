"""Where a result comes from: versions and machine, without any path or host name."""

import os
import platform
import re
import subprocess
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, requires, version
from pathlib import Path
from typing import Any

CODE = "suturefem"
NAME = re.compile(r"[A-Za-z0-9._-]+")  # of the package at the beginning of a requirement
BENEATH = ("vtk", "mkl")  # what its packages bring and results may hang on


def provenance() -> dict[str, Any]:
    """Return the versions of the code, of Python and of the packages, the machine, and the time [UTC]."""
    return {
        "suturefem": installed_version(CODE),
        "commit": commit(Path(__file__).parents[2]),
        "python": platform.python_version(),
        "packages": {name: found for name in packages() if (found := installed_version(name)) is not None},
        "machine": {"system": platform.system(), "machine": platform.machine(), "cpus": os.cpu_count()},
        "started": datetime.now(UTC).isoformat(timespec="seconds"),
    }


def packages() -> list[str]:
    """Name the packages that the code asks for, those of its options too; none where it is not installed."""
    try:
        asked = requires(CODE) or []
    except PackageNotFoundError:
        asked = []
    return sorted({NAME.match(line)[0] for line in asked} | set(BENEATH))  # type: ignore[index]


def installed_version(package: str) -> str | None:
    """Return the version of an installed package, None if it is not installed."""
    try:
        return version(package)
    except PackageNotFoundError:
        return None


def commit(folder: Path) -> str | None:
    """Name the commit that is checked out in a folder, marked when files differ from it; None outside a clone."""
    if not (folder / ".git").exists():
        return None
    try:
        head = _git(folder, "rev-parse", "--verify", "HEAD").strip()
        return head + ("+changes" if _git(folder, "status", "--porcelain", "-uno").strip() else "")
    except (OSError, subprocess.SubprocessError):
        return None


def _git(folder: Path, *arguments: str) -> str:
    done = subprocess.run(
        ["git", "-C", str(folder), *arguments], capture_output=True, text=True, check=True, timeout=10
    )
    return done.stdout
