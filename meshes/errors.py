"""The error of this package."""

LONGEST = 1000  # characters of a message: a reader of files can write a message about every line


class MeshError(ValueError):
    """A mesh that cannot be made, read or used; the message names the fault and the remedy."""

    def __init__(self, message: str) -> None:
        super().__init__(message if len(message) <= LONGEST else message[: LONGEST - 2] + " …")
