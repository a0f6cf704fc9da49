"""The bounds of all comparisons, each relative to a scale that the test names; none is fitted to the output."""

IDENTITY = 1e-12  # two ways to write one number: a few thousand roundings of 1e-16
RESIDUAL = 1e-10  # an equation that a solver says it solved
TWO_SOLVERS = 1e-8  # one answer by two roads, both converged to RESIDUAL, times a condition number of 100
AXIAL = 2e-14  # of EA: |T|² − 1 is a difference of numbers near 1, so no axial force is known better than that
LODE = 1e-7  # of a principal value by its Lode angle: an arc cosine near ±1 knows half of the digits, 1.5e-8
SEPARATED = (
    1e-6  # of μ: equal eigenvalues are separated by √ε = 1.5e-8 to be differentiated, times the exponent squared
)
GAP = 1e-9  # a constraint at the end of an accepted step, relative to the thread's diameter
SLOPE = 0.15  # decades: a central difference's error falls by 100 ± 40 % when its step falls by 10
ORDER = 0.15  # of an observed order of convergence about the one of theory
FIRST_ORDER = 0.05  # of a force that still swings, by steps of 1 ms and of a quarter of that

ELASTICA_COARSE = 1e-3  # tip of the elastica over its length, with 20 control points
ELASTICA_FINE = 1e-5  # with 60, above the stretch P/EA of a real suture (6e-6)
CATENARY = 1e-4  # of sag and forces; the model's own EI and EA change them by less than 1e-5
ADAPTED = 1e-2  # of the tension: the default of thread.tolerance
LOCATED = 0.02  # of a step: the time of an event where the acceleration is constant; the first step is of first order
SWING = 0.01  # of a force: how far BDF2 at 400 steps a period damps a swing, and the mass of the thread slows it
SAME_TIME = 0.02  # of an event's time: what a run at a quarter of the step may differ by
BAR = 0.01  # peak of a bar of 25 Hz under a step load, at 1 ms: BDF2's damping and dispersion there are below 1 %
MOVED = 1e-3  # of a pull: mass times acceleration and damping of 20 mm of suture at 0.05 m/s are below 1e-4 of 0.05 N
LINEAR = 1e-6  # a beam in its linear range, at loads whose geometric effect is below 1e-7
BUCKLING = 1e-4  # post-buckled shape over the length
TWISTED = 0.02  # buckling and localisation of twisted rods with 40 control points
ORACLE = 2e-3  # 80 control points against the boundary-value problem of the elastica; falls with the square of the span
ORACLE_SHIPPED = 1e-2  # the same of the shipped scene, whose firm holes bend the thread within a span
DIFFERENCE = (
    1e-6  # of a slope: a central difference over 1e-5 of order one, its own error 1e-10 and its round-off 1e-11
)
DRAWN_TOGETHER = 0.01  # of a footprint's way in tissue that stiffens: P2 cells of 0.4 radii leave 0.7 % of it
