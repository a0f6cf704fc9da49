"""Errors of the tissue package."""


class TissueError(ValueError):
    """An impossible organ, material or site.

    The message is one sentence with the value, the allowed values and the remedy.
    """


class FactorError(RuntimeError):
    """A matrix that could not be factorised, or a solve whose residual is too large."""


class OrganError(RuntimeError):
    """No converged answer of an organ to its forces.

    The step is then repeated as two half steps.
    """
