"""A run: steps one after the other, with their audit, events and schedule."""

from coupling.run.run import Run, begin

__all__ = ["Run", "begin"]
