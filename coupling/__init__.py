"""One Lagrange system of a spline thread and an elastic organ.

The thread enters the system by P, T and T' at the holes, and the organ by the nine numbers y = (x,
u, v) of each piercing. This package has the constraints, friction, the step and its linear algebra.
"""

import thread as _thread

if not hasattr(_thread, "SUTUREFEM"):
    raise ImportError(
        f"the package 'thread' that Python found ({getattr(_thread, '__file__', 'unknown place')}) is not the one "
        "of suturefem: another project of that name comes before it on the path; use a fresh virtual environment "
        "and install suturefem from its clone"
    )
