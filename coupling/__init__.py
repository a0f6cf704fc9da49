"""One Lagrange system of a spline thread and an elastic organ.

The thread is seen through P, T and T' at the holes, the organ through the nine numbers y = (x, u, v) of each
piercing; the constraints, friction, the step and its linear algebra live here.
"""

import thread as _thread

if not hasattr(_thread, "SUTUREFEM"):
    raise ImportError(
        f"the package 'thread' that Python found ({getattr(_thread, '__file__', 'unknown place')}) is not the one "
        "of suturefem: another project of that name stands before it on the path; use a fresh virtual environment "
        "and install suturefem from its clone"
    )
