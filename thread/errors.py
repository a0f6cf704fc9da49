"""The error of this package."""


class ThreadError(ValueError):
    """An impossible thread, section or path; the message has the value, the allowed values and the
    remedy.
    """
