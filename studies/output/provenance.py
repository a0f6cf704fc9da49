"""Provenance of a result: versions and machine, without paths or host names."""

import os
import platform
import re
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, requires
from typing import Any

from studies.output.version import CODE, ROOT, commit, installed_version

NAME = re.compile(r"[A-Za-z0-9._-]+")  # of the package, at the start of a requirement
BENEATH = ("vtk", "mkl")  # packages below these that can influence results


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
