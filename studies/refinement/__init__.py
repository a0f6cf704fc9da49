"""The refinement of a scenario: whether a number of it converges, at which order, and to what."""
