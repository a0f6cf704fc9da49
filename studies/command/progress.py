"""Current stage, progress and remaining time of a run, on standard error."""

import logging
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from time import monotonic
from typing import TextIO

WIDTH = 30  # largest number of characters of the bar
TICK = 1.0  # s between two updates of the elapsed time
REFRESH = 0.1  # s between two drawings on a terminal
TERMINAL = 79  # characters of a line that is overwritten
PACKAGES = ("tissue", "coupling", "studies")  # packages that log their stages
LOOP_LOGGERS = ("coupling.step.tables", "coupling.run.course")  # these log compilation
STEP_LOGGERS = (*LOOP_LOGGERS, "coupling.run.run", "coupling.rest.equilibrium", "tissue.organs.krylov")
TENTHS = 10  # number of plain lines if the output is not a terminal


class Progress:
    """A bar that redraws itself on a terminal; elsewhere a plain line at every tenth of the run."""

    def __init__(self, steps: int, quiet: bool = False, stream: TextIO | None = None) -> None:
        self._steps = max(steps, 1)
        self._quiet = quiet
        self._stream = stream or sys.stderr
        self._is_terminal = self._stream.isatty()
        self._start = self._first = self._drawn = monotonic()
        self._tenth = 0
        self._first_step: int | None = None  # start of the pace measurement; not 1 in a resumed run

    def update(self, step: int, time: float, newton_iterations: int, seconds: float) -> None:
        """Show a completed step.

        It has its simulated time [s], its Newton iterations, and its computing time [s].
        """
        if step <= 1 or self._first_step is None:
            self._first = monotonic()  # not in the pace: the first step prepares data for the others
            self._first_step = max(step, 1)
        if self._quiet or seconds == 0.0 or not self._is_due(step):  # 0: the start of a run or of its continuation
            return
        self._drawn = monotonic()
        self._draw(step, time, newton_iterations, seconds)

    def begin_anew(self) -> None:
        """Restart the measurement of the pace at the next step, to exclude a wait."""
        self._first_step = None

    def _draw(self, step: int, time: float, newton_iterations: int, seconds: float) -> None:
        text = f"step {step}/{self._steps}, t = {time:.4g} s, Newton {newton_iterations}, {self._left(step, seconds)}"
        if self._is_terminal:
            width = max(0, min(WIDTH, TERMINAL - len(text) - len("[] ")))
            done = round(width * step / self._steps)
            bar = f"[{'#' * done}{'.' * (width - done)}] " if width else ""
            write(self._stream, f"\r\x1b[K{(bar + text)[:TERMINAL]}")
        else:
            write(self._stream, f"{100 * step // self._steps:3d} %  {text}\n")

    def close(self) -> None:
        """End the line of the bar."""
        if self._is_terminal and not self._quiet:
            write(self._stream, "\n")

    def _is_due(self, step: int) -> bool:
        if self._is_terminal:
            return step >= self._steps or monotonic() - self._drawn > REFRESH
        tenth = TENTHS * step // self._steps
        due, self._tenth = tenth > self._tenth, max(tenth, self._tenth)
        return due

    def _left(self, step: int, seconds: float) -> str:
        now = monotonic()
        if step >= self._steps:
            return f"{duration(now - self._start)} in all"
        steps = step - (self._first_step or 1)
        pace = (now - self._first) / steps if steps > 0 else seconds
        return f"{duration(pace * (self._steps - step))} left"


class Stages(logging.Handler):
    """Shows the stage before the first step.

    It writes one line per stage. On a terminal one overwritten line shows the elapsed time, until
    the end or a record that is `over`, which stays. After this record `waited` is called, if given.
    """

    def __init__(
        self, stream: TextIO | None = None, every: float = TICK, waited: Callable[[], None] | None = None
    ) -> None:
        super().__init__(logging.INFO)
        self._stream = stream or sys.stderr
        self._is_terminal = self._stream.isatty()
        self._told = ""
        self._every = every
        self._waited = waited
        self._stopped = threading.Event()
        self._clock: threading.Thread | None = None  # shows the time of the current stage on a terminal

    def emit(self, record: logging.LogRecord) -> None:
        """Show the new stage, unless it is already shown."""
        text, over = record.getMessage(), getattr(record, "over", False)
        if over and self._waited is not None:
            self._waited()
        if text == self._told:
            return
        self._stop()
        self._told = text
        stays = over or not self._is_terminal
        write(self._stream, (f"\r\x1b[K{text[:TERMINAL]}" if self._is_terminal else text) + "\n" * stays)
        if not stays:
            self._stopped.clear()
            self._clock = threading.Thread(target=self._show_time, args=(text,), daemon=True)
            self._clock.start()

    def close(self) -> None:
        """Remove the overwritten line."""
        self._stop()
        if self._is_terminal and self._told:
            write(self._stream, "\r\x1b[K")
        self._told = ""
        super().close()

    def _show_time(self, text: str) -> None:
        """Show the elapsed time next to the stage `text` until the stage ends."""
        start = monotonic()
        while not self._stopped.wait(self._every):
            end = f", {duration(monotonic() - start)}"
            write(self._stream, f"\r\x1b[K{text[: TERMINAL - len(end)]}{end}")

    def _stop(self) -> None:
        if self._clock is not None:
            self._stopped.set()
            self._clock.join()
        self._clock = None


def write(stream: TextIO, text: str) -> None:
    """Write a text at once."""
    with suppress(BrokenPipeError):  # nobody reads the output; the work continues
        stream.write(text)
        stream.flush()


@contextmanager
def stages(
    quiet: bool = False, names: Sequence[str] = PACKAGES, waited: Callable[[], None] | None = None
) -> Iterator[None]:
    """Show the stages that packages or modules log on standard error.

    `waited` is called at the end of a wait.
    """
    if quiet:
        yield
        return
    handler = Stages(waited=waited)
    loggers = [logging.getLogger(name) for name in names]
    levels = [logger.level for logger in loggers]
    for logger in loggers:
        logger.addHandler(handler)
        logger.setLevel(logging.INFO)
    try:
        yield
    finally:
        for logger, level in zip(loggers, levels, strict=True):
            logger.removeHandler(handler)
            logger.setLevel(level)
        handler.close()


def duration(seconds: float) -> str:
    """Return a duration in words."""
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    if hours:
        return f"{hours} h {minutes:02d} min"
    return f"{minutes} min {rest:02d} s" if minutes else f"{rest} s"
