"""Entry point of the command: arguments are read before the libraries are loaded, and an interrupt ends in a
sentence."""

import codecs
import gc
import io
import json
import os
import sys

from studies.status import INTERRUPTED

# Bytes, near the largest that glibc goes by: it keeps twice the size of the largest block that was freed for what is
# asked for next (mallopt(3), M_MMAP_THRESHOLD). Else pages of arrays go to the system, to be cleared a moment later.
KEPT = 31 * 2**20


def main() -> int:
    """Run a command; returns the exit status."""
    _mend_streams()
    # No command uses more threads, and a process with others cannot be forked.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
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


def _mend_streams() -> None:
    """Lead a stream that is closed to nowhere, and write what the encoding of another lacks as JSON escapes it, so that
    what is JSON stays JSON."""
    codecs.register_error("escaped", _escaped)
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        stream = getattr(sys, name)
        if stream is None:
            setattr(sys, name, open(os.devnull, mode, encoding="utf-8"))  # noqa: SIM115
        elif mode == "w" and isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="escaped")


def _escaped(error: UnicodeError) -> tuple[str, int]:
    """Return letters that an encoding lacks as JSON escapes them, and where to go on."""
    assert isinstance(error, UnicodeEncodeError)
    return json.dumps(error.object[error.start : error.end])[1:-1], error.end


def _keep_freed_memory() -> None:
    """Free a large array that nobody wrote to: from then on what is freed stays with the process; elsewhere than with
    glibc it does nothing."""
    import numpy as np

    np.empty(KEPT, np.uint8)


if __name__ == "__main__":
    sys.exit(main())
