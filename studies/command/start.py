"""Where the command begins: it is read before the libraries are loaded, and an interrupt meanwhile ends in a sentence
too."""

import gc
import sys

from studies.status import INTERRUPTED


def main() -> int:
    """Run a command; returns the exit status."""
    try:
        from studies.command.parser import read

        options = read()
        gc.disable()
        from studies.command.command import perform

        gc.freeze()  # half a million objects of the libraries, which all collections of a run would look through
        gc.enable()
        return perform(options)
    except KeyboardInterrupt:
        print("suture: interrupted", file=sys.stderr)
        return INTERRUPTED


if __name__ == "__main__":
    sys.exit(main())
