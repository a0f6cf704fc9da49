"""A cache of the last results: the end of a step is the start of the next one, which asks for the
same results again.
"""

from collections.abc import Callable
from operator import is_
from typing import Generic, TypeVar

Made = TypeVar("Made")
Entry = tuple[tuple[object, ...], tuple[object, ...], Made]  # large arguments, small ones, and the result


class Recent(Generic[Made]):
    """The results that were used last, by their arguments.

    Large objects are compared by identity, which is valid as long as they are not changed; small
    values are compared by value.
    """

    def __init__(self, kept: int = 2) -> None:
        """Make an empty cache of `kept` results; two are those of the start and the end of a step."""
        self._kept = kept
        self._known: tuple[Entry[Made], ...] = ()  # the newest last

    def __len__(self) -> int:
        """Return the number of cached results."""
        return len(self._known)

    def of(self, objects: tuple[object, ...], make: Callable[[], Made], values: tuple[object, ...] = ()) -> Made:
        """Return the result for `objects` and `values`; it is made if it is not among the last ones.

        The oldest result is freed before another one is made, because results can be large.
        """
        entry = self._found(objects, values)
        if entry is None:
            self._known = self._known[max(0, len(self._known) - self._kept + 1) :]
            entry = objects, values, make()
            self._known = (*self._known, entry)
        return entry[2]

    def _found(self, objects: tuple[object, ...], values: tuple[object, ...]) -> Entry[Made] | None:
        """Return a cached entry, which becomes the newest; None if there is none."""
        known = self._known
        for k, entry in enumerate(known):
            if values == entry[1] and len(objects) == len(entry[0]) and all(map(is_, objects, entry[0])):
                if k < len(known) - 1:
                    self._known = (*known[:k], *known[k + 1 :], entry)
                return entry
        return None
