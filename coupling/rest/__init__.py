"""Equilibria: the start along a path, load steps, and a branch followed by arc length."""

from coupling.rest.laying import start

__all__ = ["start"]
