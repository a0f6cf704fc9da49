"""The formulas of the coupling, each once, as small compiled functions of numbers, tuples and plain arrays.

`holes` has the constraints at one hole, and `friction` the law of sliding there. `border` has their
linearisation and the condensed solve of all holes, `band` the thread's matrix, and `iteration`
Newton's method with its active sets. A `Hold` is one hole at an iterate; its vectors are tuples of
three numbers. `constraints` and `bordered` call the same functions from Python for all holes at
once.

The stretch and bending of the thread, and the compilation of functions, are in `thread.kernels`.
`coupling.step.tables` makes the arrays of a problem. `coupling.step.solver` decides which problems
the compiled iteration solves alone.
"""
