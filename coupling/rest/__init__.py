"""Equilibria: the start along a path, load steps, and a branch that is followed by arc length."""
