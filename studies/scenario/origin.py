"""Hints in refusals of tables that a stitch wrote: the keys of the stitch to change.

A scenario has the long form of its stitches, whose keys the user of a stitch has not written.
"""

import re
from collections.abc import Mapping, Sequence
from typing import Any

from studies.scenario.meanings import because
from studies.scenario.refusal import as_toml

# The keys of a stitch that determine a key or a table of its long form.
CAUSES = {
    "draw": "draw",
    "pull": "force, from or until",
    "piercing": "at, bite, depth, pitch or footprint",
    "tract": "at, bite, depth or tract",
    "tie": "from, until, force or hold",
}


def stitch_names(data: Mapping[str, Any]) -> tuple[str, ...]:
    """Return the names of the stitches in tables that are not yet validated."""
    tables = data.get("stitch")
    names = [table.get("name") for table in tables if isinstance(table, Mapping)] if isinstance(tables, list) else []
    return tuple(name for name in names if isinstance(name, str))


def with_origin(problem: str, stitches: Sequence[str]) -> str:
    """Return a refusal, with a hint if one of the `stitches`, given by name, wrote the refused key.

    All piercings and tracts of a scenario with stitches are theirs, but ties can be the user's own.
    """
    if stitches and re.match(r"thread\.(path|cuts)\b", problem) and because("stitch-writes") not in problem:
        return f"{problem}; {because('stitch-path')}"
    names = "|".join(re.escape(as_toml(name)[1:-1]) for name in sorted(stitches, key=len, reverse=True))
    found = re.match(rf"""(tie)\.(?:"({names})"|({names}))\.|(piercing|tract)\b.*?["']({names})\.""", problem)
    if not stitches or found is None:
        return problem
    table, name = filter(None, found.groups())
    key = problem.partition(" = ")[0].rpartition(".")[2]
    return f"{problem}; {because('stitch-part', name=name, keys=CAUSES.get(key, CAUSES[table]))}"
