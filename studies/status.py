"""The exit statuses of the command; those of a run are those of a case of a sweep."""

import signal

COMPLETED = 0
FAILED = 1
REFUSED = 2  # before anything is computed
UNSUPPORTED = 3  # with ``--strict``: a number that is not supported, or not converged
SIGNALLED = 128  # and the number of the signal, as a shell tells it
INTERRUPTED = SIGNALLED + signal.SIGINT
