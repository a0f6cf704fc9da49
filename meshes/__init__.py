"""Tetrahedral meshes of organs, and checks of meshes.

The meshes are blocks, wounds, cylinders, tubes, and meshes from files and surfaces. Every function
that makes a mesh returns a `skfem.MeshTet` in metres with named `.boundaries` (facets), and with
`.subdomains` (elements) if a file has them. Each module is named by one noun: `block`, `wound`,
`cylinder`, `file`, `skin`, `grading`, `budget`, `checks`, `quality`.
"""

from meshes.errors import MeshError

__all__ = ["MeshError"]
