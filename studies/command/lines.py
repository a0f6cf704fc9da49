"""Printing of lines: wrapped on a terminal, unchanged elsewhere so that they can be searched."""

import re
import sys
from collections.abc import Sequence
from shutil import get_terminal_size
from textwrap import wrap
from typing import TextIO

LONGEST_LINE, MOST_LINES = 1000, 40  # largest number of characters of a line, and of lines, of an error
LABEL = re.compile(r".{,24}\s{2,}(?=\S)|suture: |")  # the label before the words of a line


def print_lines(lines: Sequence[str], stream: TextIO | None = None) -> None:
    """Print lines on standard output, unless another stream is given.

    An empty list prints nothing.
    """
    if not lines:
        return
    stream = stream or sys.stdout
    width = get_terminal_size().columns if stream.isatty() else None
    print("\n".join(lines if width is None else [part for line in lines for part in fold(line, width)]), file=stream)


def fold(line: str, width: int) -> list[str]:
    """Wrap a line at `width`, with later lines indented below the first word after the label.

    Longer words, for example paths, stay whole.
    """
    if len(line) <= width:
        return [line]
    found = LABEL.match(line)
    hang = " " * (found.end() if found else 0)
    words = line[len(hang) :]
    folded = wrap(words, max(width - len(hang), 1), break_long_words=False, break_on_hyphens=False)
    return [line[: len(hang)] + folded[0], *(hang + part for part in folded[1:])]


def complain(why: object, status: int) -> int:
    """Print the causes of a missing result on standard error; return the exit status.

    Each cause has a line.
    """
    lines = str(why).splitlines()
    shown = [line if len(line) <= LONGEST_LINE else line[:LONGEST_LINE] + " …" for line in lines[:MOST_LINES]]
    shown += [f"and {len(lines) - MOST_LINES} more"] if len(lines) > MOST_LINES else []
    print_lines([f"suture: {line}" for line in shown], sys.stderr)
    return status
