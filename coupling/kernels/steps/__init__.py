"""Whole steps in compiled loops, many in one call: predicted, solved, checked and audited.

The steps call `coupling.kernels.iteration` by its address. In a package of their own they are
compiled without it, and a change here does not cause it to be compiled again. `march` is compiled
at the first call of `coupling.run.run.Run.steps`.
"""
