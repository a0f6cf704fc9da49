"""Ways of stepping that are here to be compared with: the paper's linear step and two passes, the staggered variant."""
