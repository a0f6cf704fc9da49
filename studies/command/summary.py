"""The end of a run, in lines to be read by a person."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from studies.output.folder import Recorder
from studies.output.records import ContactRecord, EnergyRecord, PiercingRecord
from studies.scenario import Scenario
from studies.verdicts import LINEAR, RESOLVED, SETTLED, unrest

MILLI = 1e-3


def summary_lines(scenario: Scenario, summary: dict[str, Any]) -> list[str]:
    """Write the summary of a run for a person."""
    iterations = summary["newton_iterations"] / max(summary["steps"], 1)
    pace = summary["seconds_per_step"]
    speed = f", {pace / MILLI:.3g} ms a step" if pace is not None else ""
    lines = [
        f"{scenario.title or 'run'}: {summary['status']} at t = {summary['time']:.6g} s "
        f"after {summary['steps']} steps ({iterations:.2g} Newton iterations{speed})",
    ]
    if "energy" in summary:
        lines += ["", *_energy_lines(summary["energy"])]
        lines += [
            f"thread off its holes by {summary['constraint_max']:.2e} m at most (residual "
            f"{summary['constraint_residual']:.0e} m), strained by {_strain(summary)} at most"
        ]
    return lines


def piercing_lines(piercings: Sequence[PiercingRecord]) -> list[str]:
    """Write a table of the piercings."""
    if not piercings:
        return []
    width = max(8, *(len(piercing.name) for piercing in piercings))
    head = (
        f"{'piercing':{width}}  {'state':8}  {'x [mm]':^23}  {'slip [mm]':>9}  {'force [N]':>9}  "
        f"{'tension [N]':^21}  {'tangent':^21}"
    )
    return [head, *(_piercing_line(piercing, width) for piercing in piercings)]


def _piercing_line(piercing: PiercingRecord, width: int) -> str:
    x = " ".join(f"{value / MILLI:z7.2f}" for value in piercing.x)
    tangent = " ".join(f"{value:z6.3f}" for value in piercing.tangent)
    force = float(np.linalg.norm(piercing.force))
    return (
        f"{piercing.name:{width}}  {piercing.state:8}  {x}  {piercing.slip / MILLI:z9.3f}  {force:9.4g}  "
        f"{piercing.tension_before:9.4g} | {piercing.tension_after:9.4g}  {tangent}"
    )


def _energy_lines(energy: dict[str, float]) -> list[str]:
    names = {
        "work": "external_work",
        "kinetic": "kinetic",
        "thread": "elastic_thread",
        "tissue": "elastic_tissue",
        "friction": "friction_dissipation",
        "viscous": "viscous_dissipation",
        "numerical": "numerical_dissipation",
        "balance": "balance_error",
    }
    terms = [f"{short} {energy[name]:.3g}" for short, name in names.items()]
    return [f"energy [J] {', '.join(terms[:4])}", f"           {', '.join(terms[4:])}"]


def range_line(scenario: Scenario, piercings: Sequence[PiercingRecord]) -> str:
    """Tell how far the holes moved, in footprints: what small-strain elasticity is asked to bear."""
    moved = [
        float(np.linalg.norm(record.displacement)) / hole.footprint
        for record, hole in zip(piercings, scenario.piercing, strict=True)
        if hole.footprint > 0.0
    ]
    if scenario.tissue is None or not moved:
        return ""
    verdict = "within" if max(moved) <= LINEAR else "BEYOND"
    return (
        f"tissue     the holes moved by up to {max(moved):.2g} footprints, {verdict} what small-strain elasticity "
        f"is meant for (about {LINEAR})"
    )


def motion_line(energy: EnergyRecord) -> str:
    """Tell whether a run came to rest: kinetic energy compared with what is elastic."""
    share = unrest(energy.kinetic, energy.elastic)
    verdict = "at rest" if share <= SETTLED else "still moving"
    return f"motion     {verdict} at the end: its kinetic energy is {share:.2g} of the elastic (at rest: {SETTLED:g})"


def resolution_line(ratio: float) -> str:
    """Tell whether the spline can follow the bends at the holes."""
    if ratio <= RESOLVED:
        return ""
    return (
        f"thread     its spans at the holes are {ratio:.2g} of the length it bends over there, TOO COARSE for the "
        'forces along it (a third is fine): set thread.resolution = "adaptive", or raise thread.control_points'
    )


def subgrid_line(gaps: Mapping[str, Mapping[str, Any]]) -> str:
    """Tell how much of the holes' compliance the mesh is too coarse for, and where nothing can be added for it."""
    if not gaps:
        return ""
    share = max(gap["share"] for gap in gaps.values())
    outside = ", ".join(name for name, gap in gaps.items() if not gap["holds"])
    limit = f'; NOTHING could be added, set tissue.element = "P2" or a finer mesh: {outside}' if outside else ""
    return f"sub-grid   up to {share:.0%} of a hole's compliance is added, which the mesh is too coarse for{limit}"


def contact_line(contact: ContactRecord) -> str:
    """Tell how the lips of a wound press on one another."""
    return (
        f"lips       {contact.pressed} of {contact.pairs} pairs of nodes press on one another, "
        f"{contact.largest_pressure:.3g} Pa at most, {contact.force:.3g} N in all; the smallest gap is "
        f"{contact.smallest_gap / MILLI:.3g} mm"
    )


def _strain(summary: dict[str, Any]) -> str:
    return f"{100 * summary['thread']['max_strain']:.3g} %"


def print_summary(scenario: Scenario, recorder: Recorder, status: Any) -> None:
    step = recorder.last_step
    lines = [*summary_lines(scenario, recorder.summary(status))]
    table = piercing_lines(step.piercings) if step else []
    folder = recorder.folder
    lines[1:1] = ["", *table] if table else []
    if step:
        still = "" if scenario.solve.kind == "static" else motion_line(step.energy)
        remarks = (range_line(scenario, step.piercings), resolution_line(step.span_ratio), still)
        lines += [line for line in (*remarks, subgrid_line(recorder.subgrid)) if line]
        lines += [contact_line(step.contact)] if step.contact else []
    tables = [
        "piercings.csv",
        "energy.csv",
        "steps.csv",
        "events.csv",
        *(["contact.csv"] if step and step.contact else []),
    ]
    lines += [
        "",
        f"ParaView   {folder / 'results.pvd'}",
        f"numbers    {', '.join([str(folder / 'summary.json'), *tables])}",
    ]
    print("\n".join(lines))
