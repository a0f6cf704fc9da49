"""Contact of the organ with itself and with the thread within a step, with and without friction."""
