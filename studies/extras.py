"""Optional libraries, and the extra of the project that installs each."""

from studies.lists import list_of

LIBRARIES = list_of(__file__, "extras.toml")
# of Debian, without which there is no OpenGL
SYSTEM_LIBRARIES = "libglu1-mesa libgl1 libegl1 libxrender1 libxcursor1 libxft2 libxinerama1 libgomp1"
EXTRAS = {library: entry["extra"] for library, entry in LIBRARIES.items()}


def installation(library: str) -> str:
    """Return the command that installs an optional library."""
    return f"pip install 'suturefem[{EXTRAS[library]}]'"


def missing(error: ImportError) -> str:
    """Return a sentence for a failed import of an optional library; empty for another module."""
    library = (error.name or "").partition(".")[0]
    return f"{library} is not installed; add it with {installation(library)}" if library in EXTRAS else ""
