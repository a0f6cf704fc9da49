"""The commands that look at results: ``suture report``."""

import argparse

from studies.command.lines import print_lines
from studies.report.report import write_report


def report_results(options: argparse.Namespace) -> int:
    """``suture report``: one page of folders."""
    print_lines(write_report(options.folders, options.out))
    return 0
