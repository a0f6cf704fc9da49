"""The thread's formulas as small compiled functions of plain arrays, and the compilation of these
functions.
"""
