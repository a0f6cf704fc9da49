"""Cells where the holes are: error estimate, marking and bisection."""
