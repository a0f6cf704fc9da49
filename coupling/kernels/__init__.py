"""The formulas of the coupling, each once, as small compiled functions of numbers, tuples and plain arrays.

`holes` has the constraints at one hole, `friction` the law of sliding there, `border` their linearisation and the
condensed solve of all holes, `band` the thread's matrix, and `iteration` Newton's method with its active sets. `Hold`
is one hole at an iterate: numbers, and vectors as tuples of three. `constraints` and `bordered` call the same functions
for all holes at once from Python. Stretch and bending of the thread, and how a function is compiled, stand in
`thread.kernels`. `coupling.step.tables` makes the arrays of a problem, and `coupling.step.solver` says which problems
the compiled iteration solves by itself.
"""
