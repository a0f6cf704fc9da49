"""The parser of the command line.

The arguments and the module of a command are loaded only for its call, so help and version are fast.
"""

import argparse
import os
import sys
from collections.abc import Callable, Sequence
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import NamedTuple

COMMANDS = "studies.command.command"
Adder = Callable[[argparse.ArgumentParser], None]


class Command(NamedTuple):
    """A command: its description, the function that adds its arguments, and the module with the function that
    performs it."""

    text: str
    add: Adder
    function: str
    module: str = COMMANDS


def parser_for(arguments: Sequence[str]) -> argparse.ArgumentParser:
    """Return the parser of the command line, with the arguments of the named commands."""
    parser = argparse.ArgumentParser(prog="suture", description="A suture thread and the organ it pierces.")
    parser.add_argument("--version", action=Version, nargs=0, help="print the version, and the commit of a clone")
    commands = parser.add_subparsers(required=True, metavar="command")
    for name, command in TABLE.items():
        sub = commands.add_parser(name, help=command.text, description=command.text)
        sub.set_defaults(command=partial(carry_out, command))
        if name in arguments:
            command.add(sub)
    return parser


def read(arguments: Sequence[str] | None = None) -> argparse.Namespace:
    """Return the parsed command line (None: the arguments of the process); end the process at a fault."""
    given = sys.argv[1:] if arguments is None else arguments
    parser = parser_for(given)
    asked = next((word for word in given if not word.startswith("-")), None)
    if asked is not None and asked not in TABLE:
        from studies.scenario.refusal import nearest

        near = nearest(asked, TABLE)
        hint = f"the nearest is {near}; " if near else ""
        parser.error(f"{asked} is refused: there is no such command; {hint}there are {', '.join(TABLE)}")
    options = parser.parse_args(given)
    options.words = list(given)
    return options


def carry_out(command: Command, options: argparse.Namespace) -> int:
    """Carry out a command; return its exit status."""
    status: int = getattr(import_module(command.module), command.function)(options)
    return status


class Version(argparse.Action):
    """Print the version."""

    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> None:
        """Print the version and end."""
        from studies.output.version import CODE, ROOT, commit, installed_version

        at = commit(ROOT)
        print(f"{CODE} {installed_version(CODE) or '(not installed)'}{f' ({at})' if at else ''}")
        parser.exit()


Options = argparse.ArgumentParser | argparse._MutuallyExclusiveGroup


def _flag(options: Options, name: str, text: str) -> None:
    options.add_argument(name, action="store_true", help=text)


def _path(options: Options, name: str, kind: str, text: str, required: bool = False) -> None:
    options.add_argument(name, metavar=kind, type=Path, required=required, help=text)


def _add_nothing(parser: argparse.ArgumentParser) -> None:
    pass


def _add_json(parser: argparse.ArgumentParser) -> None:
    _flag(parser, "--json", "print only JSON on standard output")


def _add_scenario(parser: argparse.ArgumentParser) -> None:
    from studies.scenario import scenes

    parser.add_argument("file", metavar="FILE.toml", type=Path, help=f"scenario file, or one of {', '.join(scenes())}")
    parser.add_argument(
        "--set",
        metavar="KEY=VALUE",
        action="append",
        default=[],
        help="set one key, the value in TOML; a piercing by name: --set piercing.entry.footprint=2e-3",
    )


def _add_strict(parser: argparse.ArgumentParser) -> None:
    _flag(parser, "--strict", "exit with 3 if a number is not supported")


def _add_run(parser: argparse.ArgumentParser) -> None:
    _add_scenario(parser)
    _add_strict(parser)
    _add_json(parser)
    _path(parser, "--out", "DIR", "results folder, new or empty", required=True)
    earlier = parser.add_mutually_exclusive_group()
    _flag(earlier, "--resume", "continue from the last checkpoint in DIR, also to a larger solve.duration")
    _flag(earlier, "--overwrite", "replace the run in DIR; keep other files")
    _flag(parser, "--quiet", "print only errors and unsupported numbers")
    _flag(parser, "--no-picture", "draw no picture of the last frame")
    _flag(parser, "--no-remedies", "do not search for a remedy if the run fails")


def _add_check(parser: argparse.ArgumentParser) -> None:
    _add_scenario(parser)
    _add_strict(parser)
    _add_json(parser)
    shown = parser.add_mutually_exclusive_group()
    _path(shown, "--picture", "FILE.png", "draw the start: thread, holes, footprints, organ and held nodes")
    _flag(shown, "--write", "only print the scenario with path, piercings and ties for its stitches")


def _add_mesh(parser: argparse.ArgumentParser) -> None:
    _add_scenario(parser)
    _path(parser, "--out", "ORGAN.vtu", "mesh file to be written", required=True)


def _add_workers(parser: argparse.ArgumentParser, cluster: bool = True) -> None:
    who = parser.add_mutually_exclusive_group()
    who.add_argument("--jobs", metavar="N", type=_count, default=1, help="number of processes, default 1")
    if cluster:
        who.add_argument("--dask", metavar="ADDRESS", help="work on the cluster of this Dask scheduler")


def _count(text: str) -> int:
    if not text.isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"{text} is refused: give a whole number, 1 or more")
    return int(text)


def _levels(text: str) -> int:
    from studies.refinement.ladder import LEAST

    if not text.isdecimal() or int(text) < LEAST:
        raise argparse.ArgumentTypeError(f"{text} is refused: a verdict needs {LEAST} or more levels")
    return int(text)


def _add_sweep(parser: argparse.ArgumentParser) -> None:
    _add_scenario(parser)
    parser.add_argument(
        "--over",
        metavar="KEY=[…]",
        action="append",
        default=[],
        help="values of a key as a list in TOML; several keys give all combinations",
    )
    _flag(parser, "--paired", "combine the first values of all keys, then the second values, and so on")
    _path(parser, "--table", "FILE.csv", "read cases from a table; each column has a key as its head")
    _path(parser, "--out", "DIR", "folder, new or of an earlier sweep", required=True)
    parser.add_argument(
        "--plot", metavar=("X", "Y"), nargs="+", action=Columns, help="draw column Y over X [one line per BY]"
    )
    _add_workers(parser)
    _add_json(parser)


class Columns(argparse.Action):
    """Accept two or three names."""

    def __call__(
        self, parser: argparse.ArgumentParser, namespace: argparse.Namespace, values: object, option: str | None = None
    ) -> None:
        """Store the names, or end the process for another number of names."""
        names = list(values) if isinstance(values, list) else []
        if len(names) not in (2, 3):
            parser.error(f"{option} needs two columns, x and y, or three, x, y and by; got {len(names)}")
        setattr(namespace, self.dest, names)


def _add_refine(parser: argparse.ArgumentParser) -> None:
    from studies.refinement.ladder import KINDS, LEVELS

    _add_scenario(parser)
    parser.add_argument(
        "--quantity",
        metavar="NAME",
        action="append",
        required=True,
        help="number of summary.json, for example piercings.exit.tension_after; can be repeated",
    )
    parser.add_argument(
        "--levels", metavar="N", type=_levels, default=LEVELS, help=f"number of levels, at least 3, default {LEVELS}"
    )
    parser.add_argument(
        "--over", choices=(*KINDS, "all"), default="all", help="quantity to be refined, default all together"
    )
    _flag(parser, "--adaptive", "refine the cells at the holes by their accuracy, like --over accuracy")
    parser.add_argument(
        "--ratio", metavar="R", type=float, default=None, help="ratio of levels, default √2, or 2 for accuracies"
    )
    _path(parser, "--out", "DIR", "folder, new or of an earlier refinement", required=True)
    _flag(parser, "--strict", "exit with 3 if a number is not converged")
    _add_workers(parser)
    _add_json(parser)


def _add_study(parser: argparse.ArgumentParser) -> None:
    from studies.study import PRESETS

    parser.add_argument("name", metavar="NAME", help="a study, or list")
    parser.add_argument("--preset", choices=PRESETS, default="quick", help="default: quick, at most two minutes")
    parser.add_argument("--set", metavar="NAME=VALUE", action="append", default=[], help="set one argument, in TOML")
    _path(parser, "--out", "DIR", "folder, default results/NAME")
    _flag(parser, "--overwrite", "replace the study in DIR")
    _add_workers(parser, cluster=False)


def _add_schema(parser: argparse.ArgumentParser) -> None:
    _flag(parser, "--table", "list the keys of each table in Markdown")


def _add_bench(parser: argparse.ArgumentParser) -> None:
    from tissue.solvers.choice import SOLVERS

    parser.add_argument(
        "what",
        nargs="?",
        choices=("all", "step", "many", "finite", "organ"),
        default="all",
        help="default: all = step, many, finite and the assembly of a large organ",
    )
    parser.add_argument(
        "--sizes", metavar="N", type=_count, nargs="+", default=[3_000, 10_000, 30_000], help="unknowns, for organ"
    )
    parser.add_argument("--element", choices=("P1", "P2"), default="P1", help="element of the organ, for organ")
    parser.add_argument("--solver", choices=SOLVERS, default="auto", help="solver of the organ, for step and finite")
    parser.add_argument("--tensions", metavar="N", type=_count, default=64, help="tensions on one organ, for many")
    _path(parser, "--json", "FILE", "write the numbers as JSON")


def _add_report(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("folders", metavar="DIR", type=Path, nargs="+", help="folder of a run, a study or a sweep")
    _path(parser, "--out", "FILE.html", "page to be written", required=True)


def _add_view(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("folder", metavar="DIR", type=Path, help="folder of a run")
    _path(parser, "--out", "FILE", "draw into a .png or .gif file")
    parser.add_argument("--time", metavar="SECONDS", type=float, help="time of the picture, default the end")
    _path(parser, "--macro", "FILE.py", "write a ParaView macro that draws the run")


def _add_plot(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("folder", metavar="DIR", type=Path, help="folder of a run")
    parser.add_argument("columns", metavar="NAME", nargs="+", help="a column, for example piercings.exit.tension_after")
    _path(parser, "--out", "FILE", ".png, .svg or .pdf, default DIR/plot.png")


def _add_new(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("name", metavar="NAME", type=Path, help="name of the new file; .toml is added if missing")
    _flag(parser, "--stitches", "write a wound with three tied stitches")


def _add_completion(parser: argparse.ArgumentParser) -> None:
    shell = os.path.basename(os.environ.get("SHELL", "bash"))
    known = ("bash", "zsh", "fish")
    parser.add_argument(
        "shell", choices=known, nargs="?", default=shell if shell in known else "bash", help="default: from $SHELL"
    )


SWEEPS, LOOKING, HELP = "studies.command.sweeps", "studies.command.looking", "studies.command.help"
TABLE = {
    "new": Command("write a commented scenario as a start", _add_new, "new", HELP),
    "scenes": Command("list the shipped scenarios", _add_json, "list_scenes", HELP),
    "check": Command("check whether a scenario can be run, and its cost", _add_check, "check"),
    "run": Command("simulate a scenario into a folder", _add_run, "run"),
    "sweep": Command("run a scenario for many values of its keys, into one table", _add_sweep, "run_sweep", SWEEPS),
    "refine": Command("check whether a number of a scenario converges", _add_refine, "run_refinement", SWEEPS),
    "report": Command("write runs, studies and sweeps into one offline page", _add_report, "report_results", LOOKING),
    "view": Command(
        "show a run in a window, or draw a picture and an animation without a screen",
        _add_view,
        "view_results",
        LOOKING,
    ),
    "plot": Command("draw columns of a run over time", _add_plot, "plot_results", LOOKING),
    "mesh": Command("make a scenario's mesh, write it and report its quality", _add_mesh, "make_mesh"),
    "study": Command("run a study into a table and a figure", _add_study, "run_study"),
    "schema": Command("print the JSON schema of the scenario file, or its keys as tables", _add_schema, "print_schema"),
    "catalogue": Command("list the sutures that a scenario can name", _add_nothing, "print_catalogue"),
    "bench": Command("measure the speed of steps and of the organ's solvers", _add_bench, "run_bench"),
    "doctor": Command("list optional software, and how to install it", _add_json, "examine", HELP),
    "completion": Command(
        'print the shell completion: eval "$(suture completion)"',
        _add_completion,
        "print_completion",
        HELP,
    ),
}
