"""Lines that are printed."""

import sys
from collections.abc import Sequence

LONGEST_LINE, MOST_LINES = 1000, 40  # characters, and lines, of what is told of an error


def print_lines(lines: Sequence[str]) -> None:
    """Print lines."""
    print("\n".join(lines))


def complain(why: object, status: int) -> int:
    """Say on standard error why there is no result, a line for each problem; return the exit status."""
    lines = str(why).splitlines()
    for line in lines[:MOST_LINES]:
        print(f"suture: {line if len(line) <= LONGEST_LINE else line[:LONGEST_LINE] + ' …'}", file=sys.stderr)
    if len(lines) > MOST_LINES:
        print(f"suture: and {len(lines) - MOST_LINES} more", file=sys.stderr)
    return status
