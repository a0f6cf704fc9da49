"""The command line, and what it prints of a run."""
