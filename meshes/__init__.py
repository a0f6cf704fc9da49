"""Tetrahedral meshes of organs: blocks, wounds, cylinders, tubes, files, surfaces, and the checks they pass.

Every function that makes a mesh returns a `skfem.MeshTet` in metres with named `.boundaries` (facets) and, where a
file has them, `.subdomains` (elements). One noun a module: `block`, `wound`, `cylinder`, `file`, `skin`, `grading`,
`budget`, `checks`, `quality`.
"""

from meshes.errors import MeshError

__all__ = ["MeshError"]
