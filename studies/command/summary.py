"""The end of a run, in lines for a person."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from coupling.reports.observation import PiercingObservation
from studies.arrays import MILLI
from studies.command.lines import print_lines
from studies.lists import list_of, sentences
from studies.output.columns import ENDS
from studies.output.folder import Recorder
from studies.output.manifest import files_of
from studies.output.records import Record
from studies.output.remarks import Remark
from studies.output.tally import Status
from studies.scenario import Piercing, PulledEnd, Scenario, Thread

say = sentences(list_of(__file__, "summary.toml"))
SEEN = 1e-6  # m: a smaller distance from the intended place is not shown


def summary_lines(scenario: Scenario, summary: dict[str, Any]) -> list[str]:
    """Return the summary of a run in lines for a person."""
    pace, rest = summary["seconds_per_step"], scenario.solve.start == "rest"
    words = {"title": scenario.title or "run", "begun": " from rest" if rest else ""}
    words["speed"] = f" and {pace / MILLI:.3g} ms" if pace is not None else ""
    lines = [say("run", iterations=summary["newton_iterations"] / max(summary["steps"], 1), run=summary, **words)]
    if "energy" in summary:
        lines += ["", *say("energy", **summary["energy"]).splitlines()]
        lines.append(say("thread", strain=100 * summary["thread"]["max_strain"], far=summary["constraint_max"]))
    return lines


def piercing_lines(piercings: Sequence[PiercingObservation]) -> list[str]:
    """Return a table of the piercings."""
    if not piercings:
        return []
    width = max(8, *(len(piercing.name) for piercing in piercings))
    head = f"{'piercing':{width}} {'state':8} {'x [mm]':^20} {'slip [mm]':>9} {'force [N]':>9} {'tension [N]':^21}"
    return [head, *(_piercing_line(piercing, width) for piercing in piercings)]


def _piercing_line(piercing: PiercingObservation, width: int) -> str:
    x = " ".join(f"{value / MILLI:z6.2f}" for value in piercing.x)
    force = float(np.linalg.norm(piercing.force))
    return say("piercing", hole=piercing, width=width, x=x, slip=piercing.slip / MILLI, force=force)


def remark_lines(remarks: Sequence[Remark]) -> list[str]:
    """Return the remarks, one per line, unsupported numbers first."""
    if not remarks:
        return ["remarks    none"]
    ordered = sorted(remarks, key=lambda remark: not remark.unsupported)
    return [f"{'remarks' if not k else '':10} {remark.line}" for k, remark in enumerate(ordered)]


def doubt_lines(remarks: Sequence[Remark], folder: Path) -> list[str]:
    """Return the line on the unsupported numbers of the run in a folder, as a list.

    The list is empty if all numbers are supported.
    """
    named = ", ".join(f"{remark.where} ({remark.code})" for remark in remarks if remark.unsupported)
    return [f"suture: unsupported: {named}; the reasons are in {folder / 'summary.json'}"] if named else []


def refinement_line(refinement: Mapping[str, Any]) -> str:
    """Return the line on the accuracy of the cells at the holes and their refinement."""
    if "rounds" not in refinement:
        return ""
    last, errors = refinement["rounds"][-1], refinement["errors"]
    worst = max(errors, key=errors.__getitem__, default="")
    estimate = f", estimated error of the compliance at {worst!r} {100.0 * errors[worst]:.2g} %" if worst else ""
    count = len(refinement["rounds"])
    return f"cells      {last['unknowns']} unknowns after {count} round{'s' * (count > 1)} of refinement{estimate}"


def place_lines(holes: Sequence[Piercing]) -> Iterator[str]:
    """Yield the lines on holes found on the surface, with the distance moved."""
    for hole in holes:
        if hole.moved is not None:
            at = ", ".join(f"{value / MILLI:z.2f}" for value in hole.place)
            moved = f", moved by {hole.moved / MILLI:.3g} mm" if hole.moved > SEEN else ""
            yield f"place      {hole.name}: on the surface at [{at}] mm{moved}"


def load_lines(thread: Thread) -> list[str]:
    """Return the lines on dead loads with a ramp on the ends of the thread."""
    ends = ((name, getattr(thread, name)) for name in ENDS)
    return [
        f"load       thread.{name}: {float(np.linalg.norm(end.force)):.4g} N, grows within {end.ramp:.3g} s"
        for name, end in ends
        if isinstance(end, PulledEnd) and end.ramp
    ]


def contact_line(contact: Record) -> str:
    """Return the line on two surfaces in contact."""
    rubs = say("rubs", contact=contact) if contact.friction else ""
    gaps = {"low": contact.smallest_gap / MILLI, "high": contact.largest_gap / MILLI}
    return say("contact", contact=contact, rubs=rubs, area=contact.open_area / MILLI**2, **gaps)


def wound_lines(contact: Record) -> list[str]:
    """Return the line on a stitched wound: closure force, closed area and eversion."""
    if not contact.stitches:
        return []
    shares = [(one.load_share, one.stitch) for one in contact.stitches if one.load_share is not None]
    most = f"; {max(shares)[1]} bears {100 * max(shares)[0]:.3g} % of it" if len(shares) > 1 else ""
    angle = contact.eversion
    way = "in" if angle is not None and angle < 0.0 else "out"
    turned = "" if angle is None else f", and its edges are turned {way} by {abs(np.degrees(angle)):.2g}°"
    closed = 100 * contact.approximation
    return [say("wound", contact=contact, most=most, closed=closed, turned=turned)]


def range_line(met: Mapping[str, Any]) -> str:
    """Return the line on strains and rotations of the tissue, from `range` of `summary.json`."""
    holes = met["piercings"].values()
    strain, turn = (max((hole[name] for hole in holes), default=0.0) for name in ("mean_strain", "turn"))
    return say("range", strain=strain, turn=turn, met=met)


def print_summary(scenario: Scenario, recorder: Recorder, status: Status, picture: str = "") -> None:
    """Print the end of a run; `picture` is the line on the picture, empty without a picture."""
    step, summary = recorder.tally.last_step, recorder.summary(status)
    lines = [*summary_lines(scenario, summary)]
    table = piercing_lines(step.piercings) if step else []
    folder = recorder.folder
    lines[1:1] = ["", *table] if table else []
    if step:
        lines += [range_line(summary["range"])] if "range" in summary else []
        lines += [line] if (line := refinement_line(recorder.tally.refinement)) else []
        lines += [line for pair in step.contact for line in (contact_line(pair), *wound_lines(pair))]
    lines += place_lines(scenario.piercing)
    lines += load_lines(scenario.thread)
    tables = [name for name in files_of(scenario) if name.endswith(".csv")]
    lines += [
        "",
        *remark_lines(recorder.tally.remarks),
        "",
        f"ParaView   {folder / 'results.pvd'}",
        f"numbers    {', '.join([str(folder / 'summary.json'), *tables])}",
        *([f"picture    {picture}"] if picture else []),
    ]
    print_lines(lines)
