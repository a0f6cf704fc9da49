"""Other ways of stepping, for comparison: the paper's linear step and two passes, and the staggered variant."""
