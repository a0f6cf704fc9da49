"""What a run writes: the results folder, its tables, the ParaView series, checkpoints."""
