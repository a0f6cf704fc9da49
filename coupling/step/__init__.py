"""One implicit step: the problem, its solution by Newton's method, and the halving of a failed step."""
