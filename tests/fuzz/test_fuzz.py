"""Few of the seeded faults; `python -m tests.fuzz` tries many."""

import time
import tomllib
from pathlib import Path
from random import Random

import pytest

from meshes.errors import MeshError
from tests.fuzz import chains, folders, mesh_files, scenarios
from tests.fuzz.mutations import mutated_bytes, mutated_tables
from tests.fuzz.trial import Hangs, Tally, limited


def test_mutated_scenarios_are_refused_in_words_or_prepared(tmp_path: Path) -> None:
    """Independent check: no other error, no endless refusal, and not all are refused."""
    tally = scenarios.run(45, 0, tmp_path, share=1.0)
    assert tally.faults == []
    assert tally.counts["prepared"] > 1 < tally.counts["read"]


def test_every_key_is_in_a_scenario_that_is_mutated() -> None:
    """Independent check: the keys of the schema."""

    def keys(table: object) -> set[str]:
        if isinstance(table, dict):
            return set(table).union(*map(keys, table.values()))
        return set[str]().union(*map(keys, table)) if isinstance(table, list) else set()

    found = set[str]().union(*(keys(tomllib.loads(text)) for text in scenarios.sources()))
    assert found == set(scenarios.every_key())


def test_mutated_meshes_are_refused_in_words_or_read(tmp_path: Path) -> None:
    """Independent check: as the scenarios; of the kinds that need no process of their own."""
    tally = mesh_files.run(80, 0, tmp_path, (".vtk", ".vtu", ".obj", ".ply", ".stl"))
    assert tally.faults == []
    assert tally.counts["refused"] > 40 and tally.counts["read"] + tally.counts["filled"] > 3


def test_mutated_folders_are_shown_or_refused_in_words(tmp_path: Path) -> None:
    """Independent check: as the scenarios; report, plot, view, what Python opens, and runs that go on."""
    pytest.importorskip("plotly")
    pytest.importorskip("pandas")
    tally = folders.run(80, 0, tmp_path)
    assert tally.faults == []
    assert min(tally.counts[word] for word in ("shown", "opened", "resumed", "refused")) > 2


@pytest.mark.parametrize("seed", [4, 5, 6, 7])
def test_a_chain_of_kills_ends_in_the_bytes_of_one_run(tmp_path: Path, seed: int) -> None:
    """Consistency check: one chain of a run, of a sweep, of a refinement and of a report."""
    tally = chains.run(1, seed, tmp_path)
    assert (tally.faults, tally.counts["same bytes"]) == ([], 1)


def test_mutations_are_the_same_for_the_same_seed() -> None:
    """Independent check: and differ for others; what is mutated is left as it is."""
    data, table = b"POINTS 3 float\n0 0 0\n1 0 0\n0 1.5 0\n" * 3, {"a": {"b": [1.0, 2.0]}, "c": [{"name": "x"}]}
    assert [mutated_bytes(data, Random(k)) for k in range(50)] == [mutated_bytes(data, Random(k)) for k in range(50)]
    assert len({mutated_bytes(data, Random(k)) for k in range(50)}) > 40
    assert len({repr(mutated_tables(table, Random(k))) for k in range(50)}) > 20
    assert table == {"a": {"b": [1.0, 2.0]}, "c": [{"name": "x"}]}


def test_a_trial_sees_what_it_should() -> None:
    """Independent check: a defect, a refusal without words or without an end, and an attempt without an end."""
    tally = Tally()

    def fails(error: BaseException) -> str:
        raise error

    for error in (KeyError("lost"), MeshError(""), SystemExit(1), Hangs()):
        tally.trial("seed 7", lambda error=error: fails(error), (MeshError,))
    tally.trial("seed 8", lambda: fails(MeshError("it is open; close it")), (MeshError,))
    assert [fault.partition(": ")[2].partition(":")[0] for fault in tally.faults] == [
        "KeyError",
        "a refusal of 0 characters",
        "SystemExit",
        "Hangs",
    ]
    assert str(tally).endswith("5 trials: 3 fault, 2 refused; 4 faults")
    with pytest.raises(Hangs), limited(1):
        time.sleep(60)
