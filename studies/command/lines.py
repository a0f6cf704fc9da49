"""Lines that are printed."""

from collections.abc import Sequence


def print_lines(lines: Sequence[str]) -> None:
    """Print lines."""
    print("\n".join(lines))
