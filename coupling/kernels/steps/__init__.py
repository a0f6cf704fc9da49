"""Whole steps in compiled loops, many in one call: predicted, solved, checked and audited.

The steps call the compiled iteration of `coupling.kernels.iteration` by its address. This package
is separate so that a change here does not cause that iteration to be compiled again. `march` is
compiled at the first call of `coupling.run.run.Run.steps`.
"""
