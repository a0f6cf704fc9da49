"""A sweep: one scenario, run for many values of its keys, in one table."""
