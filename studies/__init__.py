"""Scenarios, command line, results and the studies: the only package that sees all the others.

Python programs import `suturefem` (`studies/api`).
"""
