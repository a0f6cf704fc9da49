"""The error of this package."""


class MeshError(ValueError):
    """A mesh that cannot be made, read or used; the message names the fault and the remedy."""
