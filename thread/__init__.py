"""The suture thread: a dynamic cubic spline with stretch and bending energy, its ends and its catalogue."""

SUTUREFEM = True  # lets `coupling` tell this package from another project called thread
