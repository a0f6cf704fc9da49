"""The benchmark of the organ's solvers: every solver that is there has a row; what it measures is not asserted."""

import json
from pathlib import Path

import pytest

from studies.command import command
from tissue.solvers.choice import MULTIGRID
from tissue.solvers.direct import LIBRARIES, is_installed


def test_bench_organ(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "bench.json"
    assert command.main(["bench", "organ", "--sizes", "1000", "--json", str(path)]) == 0
    head, rule, *rows = [line for line in capsys.readouterr().out.splitlines() if line.startswith("|")]
    there = [*(name for name in LIBRARIES if is_installed(name)), MULTIGRID]
    assert [row.split("|")[3].strip() for row in rows] == there
    assert {line.count("|") for line in (head, rule, *rows)} == {10}
    written = json.loads(path.read_text())
    assert [row["solver"] for row in written["rows"]] == there
    assert written["bandwidth"] > 0.0
    (assembly,) = written["assembly"]
    assert assembly["ratio"] == assembly["forms"] / assembly["loops"] > 0.0
    assert all((row["iterations"] is None) == (row["solver"] != MULTIGRID) for row in written["rows"])
