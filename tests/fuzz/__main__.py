"""`python -m tests.fuzz scenarios | meshes | folders | chains --count N --seed N`: faults by seed, and a count."""

import argparse
import sys
import tempfile
from pathlib import Path

from tests.fuzz import chains, folders, mesh_files, scenarios

KINDS = {"scenarios": scenarios.run, "meshes": mesh_files.run, "folders": folders.run, "chains": chains.run}


def main() -> int:
    """Try as many as asked for; status 1 where there are faults."""
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz")
    parser.add_argument("kind", choices=KINDS)
    parser.add_argument("--count", type=int, default=100)
    parser.add_argument("--seed", type=int, default=0, help="of the first; each has its own, one more than the last")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        tally = KINDS[options.kind](options.count, options.seed, Path(folder))
    print(tally)
    return 1 if tally.faults else 0


if __name__ == "__main__":
    sys.exit(main())
