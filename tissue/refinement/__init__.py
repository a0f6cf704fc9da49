"""Mesh refinement at the holes: error estimate, marking and bisection."""
