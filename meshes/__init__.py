"""Tetrahedral meshes of organs: blocks, wounds, cylinders, tubes, files, surfaces, and checks of
meshes.

Every function that makes a mesh returns a `skfem.MeshTet` in metres with named `.boundaries`
(facets), and with `.subdomains` (elements) if a file has them. Each module has one noun: `block`,
`wound`, `cylinder`, `file`, `skin`, `grading`, `budget`, `checks`, `quality`.
"""

from meshes.errors import MeshError

__all__ = ["MeshError"]
