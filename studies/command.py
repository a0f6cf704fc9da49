"""The command line: ``suture run | check | mesh | study | schema | catalogue | bench``.

Exit status: 0 when all is well, 1 for a run that failed, 2 for input that is refused (a sentence for each
problem on standard error, nothing computed), 130 or 143 for a run that was interrupted by SIGINT or SIGTERM.
"""

import argparse
import json
import signal
import sys
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from types import FrameType
from typing import Any, Protocol

import numpy as np

from coupling.errors import CouplingError
from meshes.errors import MeshError
from studies.checkpoint import Arrays, read_checkpoint
from studies.limits import LINEAR, RESOLVED, SETTLED, unrest
from studies.observables import ContactRecord, EnergyRecord, Frame, OrganTopology, PiercingRecord, StepRecord
from studies.picture import picture
from studies.progress import Progress, StudyProgress
from studies.record import Recorder, check_folder, completed_run, resumable
from studies.scenario import Scenario, ScenarioError, load, schema
from studies.study import NAMES, PRESETS, StudyError, arguments, carried_out, study
from studies.study import check_folder as check_study_folder
from thread.catalogue import KNOT_PULL, TEXTBOOK, USP, knot_pull, names, suture
from thread.errors import ThreadError
from tissue.errors import FactorError, TissueError
from tissue.solver import SOLVERS

REFUSALS = (ScenarioError, StudyError, MeshError, TissueError, ThreadError)
FAILURES = (*REFUSALS, CouplingError, FactorError, OSError, MemoryError)
FAILED, REFUSED = 1, 2
MILLI = 1e-3
Moments = Iterator[tuple[StepRecord, Callable[[], Frame]]]


class Simulation(Protocol):
    """What ``studies.simulation.prepare(scenario)`` gives: all that can be known before the first step."""

    @property
    def scenario(self) -> Scenario:
        """As run: with the defaults that the geometry tells."""

    @property
    def topology(self) -> OrganTopology | None:
        """The organ's mesh, None without an organ."""

    @property
    def tissue_dofs(self) -> int:
        """Unknowns of the organ that are not held."""

    @property
    def subgrid(self) -> dict[str, dict[str, Any]]:
        """By piercing, what the organ's mesh is too coarse for, where that is added."""

    @property
    def steps(self) -> int:
        """Steps to be taken."""

    def advance(self, memory: Arrays | None = None) -> Moments:
        """The start, then every accepted step, each with a function that makes its frame; with the memory of a step,
        that step again and those after it."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command; returns the exit status."""
    options = _parser().parse_args(arguments)
    try:
        status: int = options.command(options)
    except REFUSALS as error:
        return _complain(error, REFUSED)
    except FactorError as error:
        return _complain(error, FAILED)
    except MemoryError as error:
        reason = f"there is not enough memory ({error}); take fewer control points or a coarser mesh"
        return _complain(MemoryError(reason), REFUSED)
    return status


def run(options: argparse.Namespace) -> int:
    """``suture run``: simulate a scenario into a folder."""
    check_folder(options.out, None if options.resume else options.file)
    simulation = _prepare(load(options.file, options.set))
    checkpoint = None
    if options.resume and resumable(options.out, simulation.scenario):
        if completed_run(options.out) is not None:
            _say(options, f"the run in {options.out} is completed; nothing is left to do")
            return 0
        checkpoint = read_checkpoint(options.out)
    moments = simulation.advance(checkpoint)
    mesh = simulation.topology, simulation.tissue_dofs
    recorder = Recorder(options.out, simulation.scenario, *mesh, checkpoint, simulation.subgrid)
    status = _simulate(simulation, moments, recorder, options.quiet)
    if recorder.last_frame is not None and not options.no_picture:
        title = simulation.scenario.title
        line = picture(recorder.last_frame, simulation.topology, recorder.folder / "picture.png", title)
        _say(options, f"picture    {line}")
    return status


def check(options: argparse.Namespace) -> int:
    """``suture check``: all that is refused is refused, nothing is computed."""
    simulation = _prepare(load(options.file, options.set))
    scenario = simulation.scenario
    organ = f"{simulation.tissue_dofs} tissue unknowns" if scenario.tissue else "no organ"
    counts = f"{len(scenario.piercing)} piercings, {scenario.thread.control_points} control points, {organ}"
    print(f"{options.file} can be run: {counts}, {simulation.steps} steps")
    return 0


def make_mesh(options: argparse.Namespace) -> int:
    """``suture mesh``: the organ's mesh as a file for ParaView, its quality and a picture; nothing is run."""
    report: list[str] = import_module("studies.mesh_report").write_report(load(options.file, options.set), options.out)
    print("\n".join(report))
    return 0


def print_schema(options: argparse.Namespace) -> int:
    """``suture schema``: the JSON schema of the scenario file."""
    print(json.dumps(schema(), indent=2, ensure_ascii=False))
    return 0


def print_catalogue(options: argparse.Namespace) -> int:
    """``suture catalogue``: the sutures that a scenario can name."""
    print(
        f"{'suture':28} {'d [mm]':>8} {'E [GPa]':>8} {'mass [mg/m]':>12} {'EA [N]':>10} {'EI [N m²]':>11} "
        f"{'GJ [N m²]':>11} {'knot pull [N]':>14}"
    )
    for name in names():
        thread, strength = suture(name), knot_pull(name)
        print(
            f"{name:28} {thread.diameter / MILLI:8.4f} {thread.youngs_modulus / 1e9:8.2f} "
            f"{thread.rhoA * 1e6:12.4g} {thread.EA:10.4g} {thread.EI:11.3e} "
            f"{thread.GJ:11.3e} {'' if strength is None else f'{strength:.3g}':>14}"
        )
    print(f"sizes: {USP}\nmoduli: {TEXTBOOK}\nknot pull, least average: {KNOT_PULL}")
    return 0


def run_bench(options: argparse.Namespace) -> int:
    """``suture bench``: time per step beside baselines, or what the organ's solvers take."""
    if options.what == "organ":
        return int(import_module("studies.bench_organ").main(options.sizes, options.element, options.json))
    return int(import_module("studies.bench").main(options.json, options.solver))


def run_study(options: argparse.Namespace) -> int:
    """``suture study``: what a study asks, its table and what it does not support; everything into a folder."""
    if options.name == "list":
        print("\n".join(f"{name:20} {study(name).question}" for name in NAMES))
        return 0
    found, folder = study(options.name), options.out or Path("results") / options.name
    given = arguments(found, options.preset, options.set)
    check_study_folder(folder)
    print(f"{found.question}\nindependent check: {found.independent}\nconsistency check: {found.consistency}\n")
    progress = StudyProgress()
    try:
        carried_out(options.name, options.preset, given, folder, progress.update)
    except (CouplingError, FactorError, OSError) as error:
        return _stopped(str(error), progress, folder, FAILED)
    except KeyboardInterrupt:
        return _stopped("interrupted", progress, folder, 128 + signal.SIGINT)
    finally:
        progress.close()
    print((folder / "table.md").read_text(encoding="utf-8"))
    print(f"table, numbers and figure ({options.preset} preset) are in {folder}")
    return 0


def summary_lines(scenario: Scenario, summary: dict[str, Any]) -> list[str]:
    """The summary of a run to be read by a person."""
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
    """A table of the piercings."""
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
    """How far the holes moved, in footprints: what small-strain elasticity is asked to bear."""
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
    """Whether a run came to rest: kinetic energy beside what is elastic."""
    share = unrest(energy.kinetic, energy.elastic)
    verdict = "at rest" if share <= SETTLED else "still moving"
    return f"motion     {verdict} at the end: its kinetic energy is {share:.2g} of the elastic (at rest: {SETTLED:g})"


def resolution_line(ratio: float) -> str:
    """Whether the spline can follow the bends at the holes."""
    if ratio <= RESOLVED:
        return ""
    return (
        f"thread     its spans at the holes are {ratio:.2g} of the length it bends over there, TOO COARSE for the "
        'forces along it (a third is fine): set thread.resolution = "adaptive", or raise thread.control_points'
    )


def subgrid_line(gaps: Mapping[str, Mapping[str, Any]]) -> str:
    """How much of the holes' compliance the mesh is too coarse for, and where what is added for it does not hold."""
    if not gaps:
        return ""
    share = max(gap["share"] for gap in gaps.values())
    outside = ", ".join(name for name, gap in gaps.items() if not gap["holds"])
    limit = f"; TOO NEAR an edge, a clamp or another hole for that: {outside}" if outside else ""
    return f"sub-grid   up to {share:.0%} of a hole's compliance is added, which the mesh is too coarse for{limit}"


def contact_line(contact: ContactRecord) -> str:
    """How the lips of a wound press on one another."""
    return (
        f"lips       {contact.pressed} of {contact.pairs} pairs of nodes press on one another, "
        f"{contact.largest_pressure:.3g} Pa at most, {contact.force:.3g} N in all; the smallest gap is "
        f"{contact.smallest_gap / MILLI:.3g} mm"
    )


def _strain(summary: dict[str, Any]) -> str:
    return f"{100 * summary['thread']['max_strain']:.3g} %"


def _simulate(simulation: Simulation, moments: Moments, recorder: Recorder, quiet: bool) -> int:
    """Record every step; a failure keeps what was written."""
    progress = Progress(simulation.steps, quiet)
    with _signals() as received:
        try:
            with recorder:
                for step, frame in moments:
                    recorder.record(step, frame)
                    progress.update(step.step, step.time, step.newton_iterations)
                    if received:
                        raise KeyboardInterrupt
            status, outcome, text = 0, "completed", ""
        except KeyboardInterrupt:
            status, outcome, text = 128 + (received or [signal.SIGINT])[0], "interrupted", "interrupted"
        except FAILURES as error:
            status, outcome, text = FAILED, "failed", _where(recorder, error)
        finally:
            progress.close()
    if text:
        print(f"suture: {text}; what was computed is in {recorder.folder}", file=sys.stderr)
    if not quiet:
        _print_summary(simulation.scenario, recorder, outcome)
    return status


def _where(recorder: Recorder, error: BaseException) -> str:
    done = recorder.last_step
    place = "at the start" if done is None else f"in step {done.step + 1}, after t = {done.time:.6g} s"
    return f"the run failed {place}: {error or type(error).__name__}"


def _print_summary(scenario: Scenario, recorder: Recorder, status: Any) -> None:
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


def _prepare(scenario: Scenario) -> Simulation:
    prepared: Simulation = import_module("studies.simulation").prepare(scenario)
    return prepared


@contextmanager
def _signals() -> Iterator[list[int]]:
    """Signals that ask for an end, gathered to be heeded between two steps; a second one ends at once."""
    received: list[int] = []
    if threading.current_thread() is not threading.main_thread():
        yield received
        return

    def receive(number: int, frame: FrameType | None) -> None:
        if received:
            raise KeyboardInterrupt
        received.append(number)

    earlier = {number: signal.signal(number, receive) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield received
    finally:
        for number, handler in earlier.items():
            signal.signal(number, handler)


def _complain(error: Exception, status: int) -> int:
    for line in str(error).splitlines():
        print(f"suture: {line}", file=sys.stderr)
    return status


def _stopped(cause: str, progress: StudyProgress, folder: Path, status: int) -> int:
    """Say why a study ended early, and where what it has done is."""
    progress.close()
    kept = f"; the rows that were done are in {folder / 'runs.csv'}" if progress.rows else ""
    print(f"suture: {cause}{kept}", file=sys.stderr)
    return status


def _say(options: argparse.Namespace, text: str) -> None:
    if not options.quiet:
        print(text)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="suture", description="A suture thread and the organ it pierces.")
    commands = parser.add_subparsers(required=True, metavar="command")
    for name, command, text in (
        ("run", run, "simulate a scenario into a folder"),
        ("check", check, "say whether a scenario can be run"),
        ("mesh", make_mesh, "make a scenario's mesh, write it and say how good it is"),
        ("study", run_study, "run a study into a table and a figure"),
        ("schema", print_schema, "print the JSON schema of the scenario file"),
        ("catalogue", print_catalogue, "list the sutures that a scenario can name"),
        ("bench", run_bench, "measure milliseconds per step beside two baselines, or the organ's solvers"),
    ):
        sub = commands.add_parser(name, help=text, description=text)
        sub.set_defaults(command=command)
        if name in ("run", "check", "mesh"):
            _add_scenario(sub)
        if name == "run":
            _add_run(sub)
        if name == "mesh":
            sub.add_argument("--out", metavar="ORGAN.vtu", type=Path, required=True, help="mesh file to be written")
        if name == "study":
            _add_study(sub)
        if name == "bench":
            _add_bench(sub)
    return parser


def _add_scenario(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("file", metavar="FILE.toml", type=Path, help="scenario file")
    parser.add_argument(
        "--set",
        metavar="KEY=VALUE",
        action="append",
        default=[],
        help="set one key, the value in TOML; a piercing by name: --set piercing.entry.footprint=2e-3",
    )


def _add_study(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("name", metavar="NAME", help="a study, or list")
    parser.add_argument("--preset", choices=PRESETS, default="quick", help="default: quick, less than a minute")
    parser.add_argument("--set", metavar="NAME=VALUE", action="append", default=[], help="set one argument, in TOML")
    parser.add_argument("--out", metavar="DIR", type=Path, help="folder, default results/NAME")


def _add_bench(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("what", nargs="?", choices=("step", "organ"), default="step", help="default: step")
    parser.add_argument(
        "--sizes", metavar="N", type=int, nargs="+", default=[3_000, 10_000, 30_000], help="unknowns, for organ"
    )
    parser.add_argument("--element", choices=("P1", "P2"), default="P1", help="of the organ, for organ")
    parser.add_argument("--solver", choices=SOLVERS, default="auto", help="of the organ, for step")
    parser.add_argument("--json", metavar="FILE", type=Path, help="write the numbers as JSON")


def _add_run(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--out", metavar="DIR", type=Path, required=True, help="results folder, earlier results replaced"
    )
    parser.add_argument("--resume", action="store_true", help="go on from the last checkpoint of the run in DIR")
    parser.add_argument("--quiet", action="store_true", help="print nothing but errors")
    parser.add_argument("--no-picture", action="store_true", help="draw no picture of the last frame")


if __name__ == "__main__":
    sys.exit(main())
