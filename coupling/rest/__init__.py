"""Equilibria: the start along a path, load steps, and a branch that is followed by arc length."""

from coupling.rest.laying import start

__all__ = ["start"]
