"""The exit statuses of the command; a run and a case of a sweep have the same."""

import signal

COMPLETED = 0
FAILED = 1
REFUSED = 2  # before the computation
UNSUPPORTED = 3  # with ``--strict``: a number is unsupported or not converged
SIGNALLED = 128  # plus the number of the signal, as in a shell
INTERRUPTED = SIGNALLED + signal.SIGINT
