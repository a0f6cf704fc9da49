"""One implicit step: the problem, its solution by Newton's method, and the halves that a step which fails is made
in."""
