"""A cache of the last results: the end of a step is the start of the next one, which asks for the
same results again.
"""

from collections import deque
from collections.abc import Callable
from typing import Generic, TypeVar

Made = TypeVar("Made")

KEPT = 2  # for the start and the end of a step


class Recent(Generic[Made]):
    """The last results, by their arguments.

    Large objects are compared by identity, which is valid as long as they are not changed; small
    values are compared by value.
    """

    def __init__(self) -> None:
        self._known: deque[tuple[tuple[object, ...], tuple[object, ...], Made]] = deque(maxlen=KEPT)

    def of(self, objects: tuple[object, ...], make: Callable[[], Made], values: tuple[object, ...] = ()) -> Made:
        """Return the result for `objects` and `values`; it is made if it is not among the last ones."""
        for others, known, made in tuple(self._known):
            if all(one is other for one, other in zip(objects, others, strict=True)) and values == known:
                return made
        self._known.append((objects, values, made := make()))
        return made
