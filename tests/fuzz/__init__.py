"""Seeded faults: scenarios, mesh files and kills, for `python -m tests.fuzz` in numbers and for the tests in few."""
