"""The suture thread: a dynamic cubic spline that stretches, bends and twists, its ends and its
catalogue.
"""

SUTUREFEM = True  # lets `coupling` tell this package from another project called thread
