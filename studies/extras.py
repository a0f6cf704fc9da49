"""Optional libraries, and the extra of the project that installs each."""

LIBRARIES = {  # by the extra that installs them
    "pictures": ("matplotlib", "pyvista", "vtkmodules"),
    "mesh": ("gmsh",),
    "large": ("pyamg",),
    "fast": ("cvxopt", "pypardiso"),
    "report": ("plotly",),
    "tables": ("pandas", "pyarrow"),
    "cluster": ("distributed",),
    "mpi": ("mpi4py",),
    "docs": ("mkdocs", "latex2mathml"),
}
EXTRAS = {library: extra for extra, own in LIBRARIES.items() for library in own}


def installation(library: str) -> str:
    """Return the command that installs an optional library."""
    return f"pip install 'suturefem[{EXTRAS[library]}]'"


def missing(error: ImportError) -> str:
    """Return a sentence for a failed import of an optional library; empty for another module."""
    library = (error.name or "").partition(".")[0]
    return f"{library} is not installed; add it with {installation(library)}" if library in EXTRAS else ""
