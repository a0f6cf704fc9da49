"""The commands that show results: ``suture report``, ``suture view`` and ``suture plot``."""

import argparse

from studies.command.lines import print_lines


def report_results(options: argparse.Namespace) -> int:
    """``suture report``: write one page on the given folders."""
    import plotly  # noqa: F401  # the first to be missed, because its extra brings the others too

    from studies.report.report import write_report

    print_lines(write_report(options.folders, options.out))
    return 0


def view_results(options: argparse.Namespace) -> int:
    """``suture view``: show a run in a window or as pictures."""
    from studies.pictures.looking import view

    print_lines(view(options.folder, options.out, options.time))
    return 0


def plot_results(options: argparse.Namespace) -> int:
    """``suture plot``: draw columns of a run over time."""
    from studies.report.plotting import plot

    print_lines(plot(options.folder, options.columns, options.out))
    return 0
