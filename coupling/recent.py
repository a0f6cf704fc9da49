"""What was made last, and of what: the end of a step is the start of the next, and asks for the same once more."""

from collections import deque
from collections.abc import Callable
from typing import Generic, TypeVar

Made = TypeVar("Made")

KEPT = 2  # a step's start and its end


class Recent(Generic[Made]):
    """The last things that were made, by what they were made of: large objects by their identity, which says that they
    are the same as long as nobody writes into them, and small values by what they are."""

    def __init__(self) -> None:
        self._known: deque[tuple[tuple[object, ...], tuple[object, ...], Made]] = deque(maxlen=KEPT)

    def of(self, objects: tuple[object, ...], make: Callable[[], Made], values: tuple[object, ...] = ()) -> Made:
        """Return what was made of `objects` and `values`, and make it where it is not among the last."""
        for others, known, made in tuple(self._known):
            if all(one is other for one, other in zip(objects, others, strict=True)) and values == known:
                return made
        self._known.append((objects, values, made := make()))
        return made
