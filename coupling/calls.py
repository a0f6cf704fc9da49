"""What is asked before every correction of Newton's method: whether somebody calls the run off, and whether a load step
has taken all the corrections that it may.

A load step at rest halves and halves again, with ties, friction that is let down and a stretch that settles inside:
each of these loops is short, and one inside the other they would go on for hours.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar

Question = Callable[[], None]
_questions: ContextVar[tuple[Question, ...]] = ContextVar("questions before a correction", default=())


@contextmanager
def asked_before_corrections(question: Question) -> Iterator[None]:
    """Put a `question` before every correction within; an exception from it ends what is being solved."""
    token = _questions.set((*_questions.get(), question))
    try:
        yield
    finally:
        _questions.reset(token)


def ask_before_correction() -> None:
    """Put the questions that are to be asked before a correction."""
    for question in _questions.get():
        question()
