"""Callbacks before every correction of Newton's method, which can end a solution.

One callback checks whether the run is cancelled, another whether a load step has used all its
corrections. A load step at rest has nested loops: halving, ties, friction that decreases, and a
stretch that converges. Each loop is short, but nested loops could run for hours.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar

Question = Callable[[], None]
_questions: ContextVar[tuple[Question, ...]] = ContextVar("questions before a correction", default=())


@contextmanager
def asked_before_corrections(question: Question) -> Iterator[None]:
    """Call `question` before every correction in this context; its exception ends the solution."""
    token = _questions.set((*_questions.get(), question))
    try:
        yield
    finally:
        _questions.reset(token)


def ask_before_correction() -> None:
    """Call the active callbacks before a correction."""
    for question in _questions.get():
        question()
