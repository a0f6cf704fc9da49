"""How fast: milliseconds a step, and what the organ's solvers take."""
