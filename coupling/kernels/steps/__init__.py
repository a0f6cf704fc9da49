"""Whole steps in compiled loops, many in a call: predicted, solved, looked at and audited.

A package of its own, for `coupling.kernels.iteration`, which it calls by its address, is neither compiled into it nor
anew where something changes here: `march` is compiled when `coupling.run.run.Run.steps` first asks for it.
"""
