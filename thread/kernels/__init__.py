"""The thread's formulas as small compiled functions of plain arrays, and how such functions are compiled."""
