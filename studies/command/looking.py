"""The commands that look at results: ``suture report``, ``suture view`` and ``suture plot``."""

import argparse
from importlib import import_module
from pathlib import Path
from typing import Any

from studies.command.summary import print_lines


def add_looking(commands: Any) -> None:
    """Add the commands to those of ``suture``."""
    text = "write runs, studies and sweeps into one page of HTML, which needs no network"
    report = commands.add_parser("report", help=text, description=text)
    report.add_argument("folders", metavar="DIR", type=Path, nargs="+", help="folder of a run, a study or a sweep")
    report.add_argument("--out", metavar="FILE.html", type=Path, required=True, help="page to be written")
    report.set_defaults(command=report_results)
    text = "show a run in a window, or as a picture and an animation where there is no screen"
    view = commands.add_parser("view", help=text, description=text)
    view.add_argument("folder", metavar="DIR", type=Path, help="folder of a run")
    view.add_argument("--out", metavar="FILE", type=Path, help="draw into a .png or .gif file instead")
    view.add_argument("--time", metavar="SECONDS", type=float, help="of the picture, default: the end")
    view.add_argument("--macro", metavar="FILE.py", type=Path, help="write a macro that draws the run in ParaView")
    view.set_defaults(command=view_results)
    text = "draw columns of a run over time"
    plot = commands.add_parser("plot", help=text, description=text)
    plot.add_argument("folder", metavar="DIR", type=Path, help="folder of a run")
    plot.add_argument("columns", metavar="NAME", nargs="+", help="a column, as piercings.exit.tension_after")
    plot.add_argument("--out", metavar="FILE", type=Path, help=".png, .svg or .pdf, default DIR/plot.png")
    plot.set_defaults(command=plot_results)


def report_results(options: argparse.Namespace) -> int:
    """``suture report``: one page of folders."""
    print_lines(import_module("studies.report.report").write_report(options.folders, options.out))
    return 0


def view_results(options: argparse.Namespace) -> int:
    """``suture view``: a run in a window or as pictures."""
    found = import_module("studies.pictures.looking")
    if options.macro is not None:
        print_lines(found.write_macro(options.macro))
        return 0
    print_lines(found.view(options.folder, options.out, options.time))
    return 0


def plot_results(options: argparse.Namespace) -> int:
    """``suture plot``: columns of a run over time."""
    print_lines(import_module("studies.pictures.plotting").plot(options.folder, options.columns, options.out))
    return 0
