"""One trial: what is done either succeeds or is refused in words; anything else is a fault."""

import signal
import threading
import traceback
import warnings
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from types import FrameType

PATIENCE = 120  # s, after which a trial hangs
LONGEST = 40_000  # characters of a refusal


class Hangs(BaseException):
    """A trial that does not end; no `Exception`, so that nothing on the way takes it for its own."""


@dataclass
class Tally:
    """How many trials succeeded, were refused, and what was wrong with which seed."""

    counts: Counter[str] = field(default_factory=Counter)
    faults: list[str] = field(default_factory=list)

    def trial(
        self, name: str, attempt: Callable[[], str], refusals: tuple[type[Exception], ...], patience: int = PATIENCE
    ) -> None:
        """Count an attempt, which says what became of it; after `patience` [s] it hangs."""
        try:
            with warnings.catch_warnings(), limited(patience):
                warnings.simplefilter("ignore")
                outcome = attempt()
        except refusals as error:
            outcome = "refused"
            if not str(error).strip() or len(str(error)) > LONGEST:
                self.faults.append(f"{name}: a refusal of {len(str(error))} characters")
        except (Exception, Hangs, SystemExit) as error:
            outcome = "fault"
            where = traceback.extract_tb(error.__traceback__)[-1]
            self.faults.append(f"{name}: {type(error).__name__}: {str(error)[:200]} ({where.filename}:{where.lineno})")
        self.counts[outcome] += 1

    def __str__(self) -> str:
        counts = ", ".join(f"{count} {outcome}" for outcome, count in sorted(self.counts.items()))
        return "\n".join([*self.faults, f"{self.counts.total()} trials: {counts}; {len(self.faults)} faults"])


@contextmanager
def limited(seconds: int) -> Iterator[None]:
    """Raise `Hangs` after so many seconds, in the main thread where there are alarms."""
    if threading.current_thread() is not threading.main_thread() or not hasattr(signal, "SIGALRM"):
        yield
        return

    def ring(number: int, frame: FrameType | None) -> None:
        raise Hangs(f"no end in {seconds} s")

    before = signal.signal(signal.SIGALRM, ring)
    signal.alarm(seconds)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)
