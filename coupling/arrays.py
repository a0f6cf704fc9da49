"""The types of arrays that thread and organ exchange."""

from thread.arrays import Array, Flags, Indices

__all__ = ["Array", "Flags", "Indices"]
