"""Newton's method of `coupling.step.newton` in compiled loops over plain arrays: the same equations, corrections and
bounds.

The functions have the names of those in numpy that they repeat, so that the two can be read side by side:
`curve` (`thread.energies`), `band` (`thread.banded`), `holes` (`coupling.kernels.constraints`), `friction`
(`coupling.step.sliding`), `border` (`coupling.kernels.bordered`) and `iteration` (`coupling.step.newton`). What a
hold is and has, `Hold`, is a tuple of numbers and of vectors, which are tuples of three. `coupling.step.solver` says
what they cover, and `coupling.step.tables` makes the arrays; it imports the loops, and with them Numba, when the
first step is solved. `loops`, `parts` and `address` are how they are compiled.
"""
