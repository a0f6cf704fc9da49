"""Entry point of the command, which reads the arguments before it loads the libraries.

An interrupt gives a sentence.
"""

import codecs
import gc
import io
import json
import os
import sys

from studies.status import INTERRUPTED

# Bytes, near the largest threshold of glibc. After a block of this size is freed, glibc keeps up to
# twice its size for later requests (mallopt(3), M_MMAP_THRESHOLD). Otherwise the pages of freed
# arrays return to the system, which clears them before the next use.
KEPT = 31 * 2**20


def main() -> int:
    """Run a command; return its exit status."""
    _mend_streams()
    # No command needs more threads, and a process with several threads cannot be forked safely.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    try:
        from studies.command.parser import read

        options = read()
        gc.disable()
        from studies.command.command import perform

        gc.freeze()  # half a million objects of the libraries, which each collection would search
        gc.enable()
        _keep_freed_memory()
        return perform(options)
    except KeyboardInterrupt:
        print("suture: interrupted", file=sys.stderr)
        return INTERRUPTED


def _mend_streams() -> None:
    """Redirect closed streams to nowhere, and write letters outside an encoding as escapes.

    The escapes are those of JSON. JSON output therefore remains valid.
    """
    codecs.register_error("escaped", _escaped)
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        stream = getattr(sys, name)
        if stream is None:
            setattr(sys, name, open(os.devnull, mode, encoding="utf-8"))  # noqa: SIM115
        elif mode == "w" and isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="escaped")


def _escaped(error: UnicodeError) -> tuple[str, int]:
    """Return the letters outside an encoding as JSON escapes them, and the next position."""
    assert isinstance(error, UnicodeEncodeError)
    return json.dumps(error.object[error.start : error.end])[1:-1], error.end


def _keep_freed_memory() -> None:
    """Free a large unused array, so that freed memory then stays with the process.

    Without glibc this has no effect.
    """
    import numpy as np

    np.empty(KEPT, np.uint8)


if __name__ == "__main__":
    sys.exit(main())
