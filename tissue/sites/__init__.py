"""Where a thread bears on the organ: footprints, the rows they give, and what a mesh is too coarse for."""
