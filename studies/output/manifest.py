"""The manifest of a run, ``provenance.json``: the list of the files that belong to the run.

A folder belongs to a run only if it holds a manifest of this code. Files outside the manifest,
except frames, belong to the user: they are neither removed nor overwritten.
"""

import re
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path
from typing import Any

from studies.output import files
from studies.output.columns import TABLES
from studies.output.files import read_json
from studies.output.lock import LOCK, refused
from studies.output.provenance import LOG
from studies.output.series import frame_files
from studies.output.tables import tables_of
from studies.scenario import Scenario, mesh_file

MARK = "provenance.json"  # the first file written
SCENARIO = "scenario.toml"
PROFILE = "gap_profile.csv"
FOLDERS = ("frames", "mesh")  # in the folder of a run
OF_TABLES = [f"{layout.name}.csv" for layout in TABLES]
FILES = (MARK, SCENARIO, "summary.json", *OF_TABLES, PROFILE, "checkpoint.npz", "results.pvd", "picture.png", LOG)


def files_of(scenario: Scenario) -> list[str]:
    """List the files that a run of the scenario writes, without its frames."""
    absent = set(OF_TABLES) - {f"{layout.name}.csv" for layout in tables_of(scenario)}
    absent |= set() if scenario.wounds else {PROFILE}
    mesh = mesh_file(scenario)
    return [name for name in FILES if name not in absent] + ([] if mesh is None else [f"mesh/{mesh.name}"])


def read(folder: Path) -> dict[str, Any] | None:
    """Read the manifest of a folder; None if the folder has no manifest of this code."""
    found = read_json(folder / MARK)
    return found if "suturefem" in found and isinstance(found.get("files"), list) else None


def holds_run(folder: Path) -> bool:
    """Return whether a folder holds a run, finished or not.

    False if the run stopped before it wrote its scenario.
    """
    return read(folder) is not None and (folder / SCENARIO).is_file()


def own_files(folder: Path) -> list[Path]:
    """List the files of the run in a folder, with the manifest.

    The temporary files of a killed run are included.
    """
    listed = (read(folder) or {}).get("files", [])
    known = [name for name in listed if name in FILES or re.fullmatch(r"mesh/[^/\\]+", str(name))]
    frames = frame_files(folder / "frames") if known else []
    return [*(folder / name for name in known), *frames, *unfinished(folder, known)]


def unfinished(folder: Path, known: Iterable[str] = ()) -> list[Path]:
    """List the temporary files of a killed run with the names `known`, and its lock."""
    names = {MARK, *(Path(name).name for name in known)}
    found = [path for place in (folder, folder / "mesh") for path in files.unfinished(place, names)]
    return [*found, *folder.glob(LOCK)]


def refuse_foreign(folder: Path, scenario: Scenario) -> None:
    """Raise `ScenarioError` if a run of the scenario would overwrite files that no run wrote."""
    refuse_links(folder, FOLDERS)
    own = set(own_files(folder))
    lost = [name for name in files_of(scenario) if (folder / name).exists() and folder / name not in own]
    if lost:
        remedy = "move your files, or give a new or empty folder"
        raise refused(folder, f"a run would overwrite {', '.join(lost)}, which no run wrote; {remedy}")


def refuse_links(folder: Path, names: Iterable[str]) -> None:
    """Raise `ScenarioError` if a folder inside is a link.

    The target of a link does not belong to the run.
    """
    for name in names:
        if (folder / name).is_symlink():
            remedy = "replace the link by that folder, or give a new or empty folder"
            raise refused(folder, f"{name} in it is a link to another folder; {remedy}")


def clear(folder: Path) -> None:
    """Remove the files of a run from a folder, except its manifest and the lock."""
    for path in own_files(folder):
        if path.name not in (MARK, LOCK):
            path.unlink(missing_ok=True)
    for name in FOLDERS:
        with suppress(OSError):  # it is missing, or holds files of the user
            (folder / name).rmdir()
