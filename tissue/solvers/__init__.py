"""Linear solvers of the organ: direct ones, conjugate gradients, and the choice between them."""
