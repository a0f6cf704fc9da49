"""Optional libraries, and the extra of the project that installs each."""

EXTRAS = {
    "matplotlib": "pictures",
    "pyvista": "pictures",
    "vtkmodules": "pictures",
    "gmsh": "mesh",
    "pyamg": "large",
    "cvxopt": "fast",
    "pypardiso": "fast",
    "plotly": "report",
    "pandas": "tables",
    "pyarrow": "tables",
    "distributed": "cluster",
    "mpi4py": "mpi",
    "mkdocs": "docs",
    "latex2mathml": "docs",
}


def installation(library: str) -> str:
    """Return the command that installs an optional library."""
    return f"pip install 'suturefem[{EXTRAS[library]}]'"


def missing(error: ImportError) -> str:
    """Return a sentence for a failed import of an optional library; empty for another module."""
    library = (error.name or "").partition(".")[0]
    return f"{library} is not installed; add it with {installation(library)}" if library in EXTRAS else ""
