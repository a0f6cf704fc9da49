"""The functions of the command line: run, check, mesh, study, schema, catalogue and bench.

Exit status: 0 for success, 1 for a failed run. 2 for refused input: a sentence for each problem on
standard error, and nothing computed. 3 with ``--strict`` if a remark means an unsupported number.
130 or 143 for a run interrupted by SIGINT or SIGTERM. 141 if the output pipe is closed.
"""

import argparse
import json
import logging
import os
import signal
import sys
import threading
import traceback
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from importlib import import_module
from pathlib import Path
from time import monotonic
from types import FrameType
from typing import Any

from coupling.calls import asked_before_corrections
from coupling.errors import CouplingError
from studies.arrays import MILLI
from studies.command.lines import complain, print_lines
from studies.command.parser import read
from studies.command.progress import LOOP_LOGGERS, STEP_LOGGERS, Progress, duration, stages
from studies.command.summary import doubt_lines, place_lines, print_summary, remark_lines, say
from studies.extras import missing
from studies.output.budget import frame_bytes, peak_memory, row_bytes, size_text
from studies.output.files import as_json
from studies.output.folder import Recorder, check_folder
from studies.output.lock import locked
from studies.output.provenance import begin_log, write_log
from studies.output.reading import ResultsError, open_run
from studies.output.remarks import Remark, any_unsupported, remark
from studies.output.tally import Status
from studies.pictures.picture import draw_scene
from studies.pictures.scene import frame_of
from studies.scenario import Scenario, load, schema
from studies.scenario.reference import reference
from studies.scenario.toml import scenario_file, written
from studies.simulation.recorded import begin
from studies.simulation.remedies import try_remedies
from studies.simulation.sharing import Shared
from studies.simulation.simulation import REFUSALS, Moments, Simulation, prepare
from studies.status import FAILED, INTERRUPTED, REFUSED, SIGNALLED, UNSUPPORTED
from studies.study import NAMES, StudyError, arguments, carry_out, study
from studies.study import check_folder as check_study_folder
from studies.workers import WorkersError, workers_of
from thread.catalogue import BRANDS, SOURCES, knot_pull, names, suture
from tissue.errors import FactorError

log = logging.getLogger(__name__)

ALL_REFUSALS = (*REFUSALS, StudyError, ResultsError)
FAILURES = (*ALL_REFUSALS, CouplingError, FactorError, OSError, MemoryError)
SIGPIPE = 13  # its number, which Windows lacks: a closed pipe has the exit status of a shell


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command; return its exit status."""
    return perform(read(arguments))


def perform(options: argparse.Namespace) -> int:
    """Perform the parsed command and return the exit status."""
    try:
        status = _carry_out(options)
        sys.stdout.flush()
    except BrokenPipeError:
        close_output()
        return SIGNALLED + SIGPIPE
    except OSError as error:
        return complain(_in_words(error), FAILED)
    except KeyboardInterrupt:
        return complain("interrupted", INTERRUPTED)
    return status


def _carry_out(options: argparse.Namespace) -> int:
    """Perform the command, or print why it is refused; return the exit status."""
    try:
        return int(options.command(options))
    except ALL_REFUSALS as error:
        return complain(error, REFUSED)
    except (FactorError, WorkersError) as error:
        return complain(error, FAILED)
    except ModuleNotFoundError as error:
        if not (sentence := missing(error)):
            raise
        return complain(sentence, REFUSED)
    except MemoryError as error:
        reason = f"there is not enough memory ({error}); use fewer control points or a coarser mesh"
        return complain(reason, REFUSED)


def run(options: argparse.Namespace) -> int:
    """``suture run``: simulate a scenario into a folder; return the exit status."""
    scenario = load(options.file, options.set)
    with locked(options.out):
        check_folder(options.out, scenario, scenario_file(options.file), options.resume, options.overwrite)
        with stages(options.quiet or options.json):
            simulation = prepare(scenario)
        return _run(options, simulation)


def _run(options: argparse.Namespace, simulation: Simulation) -> int:
    """Simulate into a writable folder, and draw the last frame; return the exit status."""
    begun = begin(simulation, options.out, options.resume)
    if begun is None:
        if not options.quiet:
            print_lines([f"the run in {options.out} is complete; nothing remains to be done"])
        return _doubt(options, [Remark(**record) for record in open_run(options.out).remarks])
    recorder, moments = begun
    begin_log(options.out, " ".join(["suture", *options.words]))
    status, outcome, failure = _simulate(simulation, moments, recorder, options.quiet or options.json)
    picture = "" if options.no_picture else _draw(simulation, recorder)
    if failure is not None and not options.no_remedies:
        _try_remedies(options, simulation, recorder, failure)
    write_log(options.out, "\n".join([outcome, *(remark.line for remark in recorder.tally.remarks)]))
    if options.json:
        print(as_json(recorder.summary(outcome)), end="")
    elif not options.quiet:
        print_summary(simulation.scenario, recorder, outcome, picture)
    return status or _doubt(options, recorder.tally.remarks)


def check(options: argparse.Namespace) -> int:
    """``suture check``: check a scenario and solve its start; return the exit status.

    The start is drawn if a picture is requested.
    """
    if options.write:
        print(written(options.file, options.set), end="")
        return 0
    with stages(options.json):
        simulation = prepare(load(options.file, options.set))
    remarks, counts = simulation.remarks(), counts_of(simulation)
    picture = "" if options.picture is None else _draw_start(simulation, options.picture)
    if options.json:
        found = counts | {"remarks": [remark.record() for remark in remarks], "picture": picture or None}
        print(as_json(found), end="")
        return strict_status(options.strict, remarks)
    memory = f" and {size_text(counts['memory'])} of memory" if counts["memory"] else ""
    takes = f"about {size_text(counts['bytes'])} of results{memory}"
    size = f"{counts['steps']} steps, {takes}"
    size_line = f"{options.file} can be run: {parts_of(simulation.scenario, counts)}, {size}"
    places = place_lines(simulation.scenario.piercing)
    print_lines([size_line, *places, *remark_lines(remarks), *([f"picture    {picture}"] if picture else [])])
    return strict_status(options.strict, remarks)


def parts_of(scenario: Scenario, counts: Mapping[str, Any]) -> str:
    """Return the parts of a run in words: holes, tracts, ties, pieces and unknowns."""
    organ = f"{counts['tissue_dofs']} tissue unknowns" if scenario.tissue else "no organ"
    names = ("piercing", "tract", "tie")
    holes, tracts, ties = (f"{counts[f'{name}s']} {name}{'s' * (counts[f'{name}s'] != 1)}" for name in names)
    balls = f"{tracts} of {counts['balls']} balls in total" if counts["tracts"] else ""
    pieces = f"{counts['pieces']} pieces of thread" if counts["pieces"] > 1 else ""
    parts = [holes, balls, ties * (counts["ties"] > 0), pieces, f"{counts['control_points']} control points", organ]
    return ", ".join(filter(None, parts))


def counts_of(simulation: Simulation) -> dict[str, Any]:
    """Return the size of a run: counts of its parts, and bytes of results and memory."""
    scenario, topology = simulation.scenario, simulation.topology
    return {
        "piercings": len(scenario.piercing),
        "tracts": len(scenario.tract),
        "balls": simulation.balls,
        "ties": len(scenario.tie),
        "pieces": len(scenario.thread.cuts) + 1,
        "control_points": scenario.thread.control_points,
        "tissue_dofs": simulation.tissue_dofs,
        "steps": simulation.steps,
        "moved": {hole.name: hole.moved for hole in scenario.piercing if hole.moved is not None},
        "bytes": round(frame_bytes(scenario, topology) + row_bytes(scenario)),
        "memory": peak_memory(),
    }


def _draw_start(simulation: Simulation, path: Path) -> str:
    """Draw the scene before the first step; return the line on the picture.

    The picture has the thread, holes with footprints, the organ and its held nodes.

    Raises `OSError`.
    """
    _, frame = next(iter(simulation.advance()))
    footprints = [hole.footprint for hole in simulation.scenario.piercing]
    title = f"{simulation.scenario.title or 'start'}: the start"
    shown = frame_of(frame(), simulation.held, footprints)
    line, failure = draw_scene(([shown], simulation.topology, title), path)
    if failure:
        raise OSError(f"--picture {path}: no picture could be drawn: {failure}")
    return line


def _doubt(options: argparse.Namespace, remarks: Sequence[Remark]) -> int:
    """Return the exit status for remarks; with ``--quiet``, print unsupported remarks."""
    if options.quiet and not options.json:
        print_lines(doubt_lines(remarks, options.out), sys.stderr)
    return strict_status(options.strict, remarks)


def strict_status(strict: bool, remarks: Sequence[Remark]) -> int:
    """Return the exit status for remarks."""
    return UNSUPPORTED if strict and any_unsupported(remarks) else 0


def make_mesh(options: argparse.Namespace) -> int:
    """``suture mesh``: write the organ's mesh for ParaView, with its quality and a picture.

    Nothing is run.
    """
    from studies.pictures.mesh_report import write_report

    print_lines(write_report(load(options.file, options.set), options.out))
    return 0


def print_schema(options: argparse.Namespace) -> int:
    """``suture schema``: print the JSON schema of the scenario file, or its keys by table."""
    if options.table:
        print("\n".join(f"## {name}\n\n{table}" for name, table in reference().items()))
    else:
        print(json.dumps(schema(), indent=2, ensure_ascii=False))
    return 0


def print_catalogue(options: argparse.Namespace) -> int:
    """``suture catalogue``: print the sutures that a scenario can name."""
    print(say("catalogue"))
    for name in names():
        thread, strength = suture(name), knot_pull(name)
        sizes = {"d": thread.diameter / MILLI, "E": thread.youngs_modulus / 1e9, "mass": thread.rhoA * 1e6}
        pull = "" if strength is None else f"{strength:.3g}"
        print(say("suture", name=name, thread=thread, pull=pull, **sizes))
    brands = ", ".join(f"{brand} ({of})" for brand, of, _ in BRANDS)
    titles = {"sizes": "usp", "moduli": "textbook", "knot pull, minimum average": "knot_pull"}
    print_lines([f"brands  {brands}", *(f"{title}  {SOURCES[name]}" for title, name in titles.items())])
    return 0


def run_bench(options: argparse.Namespace) -> int:
    """``suture bench``: measure times of the code; return the exit status.

    It measures steps of shipped scenes, many tensions on one organ and finite strain, or an organ's solvers.
    """
    if options.what == "organ":
        return int(import_module("studies.bench.organ").main(options.sizes, options.element, options.json))
    given = {"step": options.solver, "many": options.tensions, "finite": options.solver}
    for name, value in given.items():
        if options.what in (name, "all"):
            import_module(f"studies.bench.{name}").main(options.json, value)
    return 0


def run_study(options: argparse.Namespace) -> int:
    """``suture study``: write the table, figure and remarks of a study into a folder.

    The question and the checks of the study are printed first.
    """
    if options.name == "list":
        print_lines([f"{name:20}  {study(name).question}" for name in NAMES])
        return 0
    found, folder = study(options.name), options.out or Path("results") / options.name
    given = arguments(found, options.preset, options.set)
    check_study_folder(folder, options.overwrite)
    checks = [f"independent  {found.independent}", f"consistency  {found.consistency}"]
    print_lines([found.question, *checks, ""])
    rows, began = list[Any](), monotonic()

    def tell(done: Sequence[Any]) -> None:
        words = words_of(done[-1])
        if not rows or words != words_of(rows[-1]):
            log.info("row %d, %s: %s", len(done), duration(monotonic() - began), words)
        rows[:] = done

    try:
        workers = None if options.jobs == 1 else workers_of(options.jobs)
        with stages(names=(*LOOP_LOGGERS, __name__)):
            carry_out(options.name, options.preset, given, folder, tell, workers)
    except (CouplingError, FactorError, WorkersError, OSError, KeyboardInterrupt) as error:
        kept = f"; the completed rows are in {folder / 'runs.csv'}" if rows else ""
        interrupted = isinstance(error, KeyboardInterrupt)
        cause, status = ("interrupted", INTERRUPTED) if interrupted else (str(error), FAILED)
        return complain(f"{cause}{kept}", status)
    print((folder / "table.md").read_text(encoding="utf-8"))
    print(f"table, numbers and figure ({options.preset} preset) are in {folder}")
    return 0


def words_of(row: Any) -> str:
    """Return the words of a study's row, as a title of its case."""
    return ", ".join(value for value in vars(row).values() if isinstance(value, str) and value)


def _draw(simulation: Simulation, recorder: Recorder) -> str:
    """Draw the last frame; return the line on the picture.

    If there is no picture, a remark is added.
    """
    if recorder.last_frame is None:
        return ""
    target = recorder.folder / "picture.png"
    shown = frame_of(recorder.last_frame)
    line, failure = draw_scene(([shown], simulation.topology, simulation.scenario.title), target)
    if failure:
        recorder.remark(remark("no-picture", target.name, failure=failure))
    return line


def _try_remedies(
    options: argparse.Namespace, simulation: Simulation, recorder: Recorder, failure: CouplingError
) -> None:
    """Add a remark on a remedy for a failed run, unless the user interrupts the search."""
    store = Shared()
    with stages(options.quiet or options.json), suppress(KeyboardInterrupt):
        scenario, last = simulation.scenario, recorder.tally.last_step
        recorder.remark(try_remedies(scenario, failure, last, lambda copy: prepare(copy, store)))


def _simulate(
    simulation: Simulation, moments: Moments, recorder: Recorder, quiet: bool
) -> tuple[int, Status, CouplingError | None]:
    """Record every step; results before a failure are kept.

    Returns the exit status, the status of the run, and the failure of a step, or None.
    """
    outcome: Status
    failure: CouplingError | None = None
    progress = Progress(simulation.steps, quiet)
    with _signals() as received:
        try:
            with recorder, stages(quiet, STEP_LOGGERS, progress.begin_anew):
                for step, frame in moments:
                    recorder.record(step, frame)
                    progress.update(step.step, step.time, step.newton_iterations, step.seconds)
                    if received:
                        raise KeyboardInterrupt
            status, outcome, text = 0, "completed", ""
        except KeyboardInterrupt:
            status, outcome = SIGNALLED + (received or [signal.SIGINT])[0], "interrupted"
            text = "interrupted; --resume continues from the last checkpoint"
        except FAILURES as error:
            status, outcome, text = FAILED, "failed", _where(recorder, error)
            failure = error if isinstance(error, CouplingError) else None
        except BaseException:
            write_log(recorder.folder, traceback.format_exc())
            raise
        finally:
            progress.close()
    if text:
        write_log(recorder.folder, text)
        complain(f"{text}; the results so far are in {recorder.folder}", status)
    return status, outcome, failure


def _where(recorder: Recorder, error: BaseException) -> str:
    done = recorder.tally.last_step
    place = "at the start" if done is None else f"in step {done.step + 1}, after t = {done.time:.6g} s"
    return f"the run failed {place}: {error or type(error).__name__}"


@contextmanager
def _signals() -> Iterator[list[int]]:
    """Collect the signals that end a run.

    They act between two steps or two corrections. A second signal acts at once.
    """
    received: list[int] = []
    if threading.current_thread() is not threading.main_thread():
        yield received
        return

    def heed() -> None:
        if received:
            raise KeyboardInterrupt

    def receive(number: int, frame: FrameType | None) -> None:
        heed()
        received.append(number)

    earlier = {number: signal.signal(number, receive) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        with asked_before_corrections(heed):
            yield received
    finally:
        for number, handler in earlier.items():
            signal.signal(number, handler)


def _in_words(error: OSError) -> str:
    """Return the reason of an error of the system, with the name of the file."""
    reason = error.strerror or str(error) or type(error).__name__
    return f"{error.filename}: {reason}" if error.filename else reason


def close_output() -> None:
    """Discard remaining output, because Python would report the closed pipe at its end."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    for stream in (sys.stdout, sys.stderr):
        with suppress(OSError, ValueError):  # a stream without a file has no reader
            os.dup2(nowhere, stream.fileno())
    os.close(nowhere)


if __name__ == "__main__":
    sys.exit(main())
