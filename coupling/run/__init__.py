"""A run: one step after another, with audit, events and schedule."""

from coupling.run.run import Run, begin

__all__ = ["Run", "begin"]
