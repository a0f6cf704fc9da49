"""Versions of the code and of its packages, without importing any of them."""

import subprocess
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

CODE = "suturefem"
ROOT = Path(__file__).parents[2]  # the clone, or the folder of the installed packages


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
    done = subprocess.run(
        ["git", "-C", str(folder), *arguments], capture_output=True, text=True, check=True, timeout=10
    )
    return done.stdout


__version__ = installed_version(CODE)
