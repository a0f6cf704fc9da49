"""The refinement of a scenario: convergence, order and limit of a number."""
