"""The error of this package."""


class ThreadError(ValueError):
    """A thread, section or path that cannot be; the message names the value, what is allowed, the remedy."""
