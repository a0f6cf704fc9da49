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


def report_results(options: argparse.Namespace) -> int:
    """``suture report``: one page of folders."""
    print_lines(import_module("studies.report.report").write_report(options.folders, options.out))
    return 0
