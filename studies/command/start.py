"""Where the command begins: it is read before the libraries are loaded, and an interrupt meanwhile ends in a sentence
too."""

import gc
import sys

from studies.status import INTERRUPTED

# Bytes, near the largest that glibc goes by: it keeps twice the size of the largest block that was freed for what is
# asked for next (mallopt(3), M_MMAP_THRESHOLD). Else pages of arrays go to the system, to be cleared a moment later.
KEPT = 31 * 2**20


def main() -> int:
    """Run a command; returns the exit status."""
    try:
        from studies.command.parser import read

        options = read()
        gc.disable()
        from studies.command.command import perform

        gc.freeze()  # half a million objects of the libraries, which all collections of a run would look through
        gc.enable()
        _keep_freed_memory()
        return perform(options)
    except KeyboardInterrupt:
        print("suture: interrupted", file=sys.stderr)
        return INTERRUPTED


def _keep_freed_memory() -> None:
    """Free a large array that nobody wrote to: from then on what is freed stays with the process; elsewhere than with
    glibc it does nothing."""
    import numpy as np

    np.empty(KEPT, np.uint8)


if __name__ == "__main__":
    sys.exit(main())
