"""Free memory as reported by the system."""

from pathlib import Path

KILO = 1024
UNKNOWN = float("inf")


def free_memory(proc: Path = Path("/proc/meminfo"), group: Path = Path("/sys/fs/cgroup")) -> float:
    """Return the bytes available without swapping and within a container's limit.

    The result is infinite if the system does not report it.
    """
    return min(_available(proc), _allowed(group))


def _available(proc: Path) -> float:
    try:
        lines = dict(line.split(":", 1) for line in proc.read_text().splitlines())
        return float(lines["MemAvailable"].split()[0]) * KILO
    except (OSError, KeyError, ValueError, IndexError):
        return UNKNOWN


def _allowed(group: Path) -> float:
    try:
        return float((group / "memory.max").read_text()) - float((group / "memory.current").read_text())
    except (OSError, ValueError):  # no group, or no limit: "max"
        return UNKNOWN
