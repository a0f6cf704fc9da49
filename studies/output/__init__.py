"""Output of a run: the results folder, its tables, the ParaView series, checkpoints."""
