"""Errors of the tissue package."""


class TissueError(ValueError):
    """An impossible organ, material or site: one sentence with the value, the allowed values and the remedy."""


class FactorError(RuntimeError):
    """A matrix that could not be factorised, or a solve whose residual is too large."""


class OrganError(RuntimeError):
    """An organ that finds no answer to the forces on it: in words, for the step to be taken again in halves."""
