"""Benchmarks: milliseconds per step, and times of the organ's solvers."""
