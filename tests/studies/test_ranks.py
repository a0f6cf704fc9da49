"""Columns shared by several processes: the numbers of one, by threads of a test and by what MPI starts."""

import importlib.util
import json
import shutil
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from threading import Barrier

import numpy as np
import pytest

import tissue
from studies.arrays import Array
from studies.scenario import ScenarioError, load
from studies.simulation import prepare
from tests.bounds import TWO_SOLVERS
from tissue.organs.meshed import compliance
from tissue.solvers.ranks import SharedColumns

STILL = [
    "tissue.inertia=false",
    'tissue.solver="multigrid"',
    "tissue.mesh.h_site=3.0e-3",
    "tissue.mesh.h=6.0e-3",
    "tissue.mesh.accuracy=given",
    "thread.control_points=60",
    "solve.duration=3.0e-3",
    "solve.gravity=[0, 0, -9.81]",
]
BY_MPI = """
import json
from mpi4py import MPI
from tests.studies.test_ranks import compliance_by
C = compliance_by(MPI.COMM_WORLD)
if MPI.COMM_WORLD.Get_rank() == 0:
    print(json.dumps(C.tolist()))
"""


@dataclass
class Meeting:
    """Where threads hand one another what they send; `asked` counts the columns of each."""

    size: int
    sent: dict[int, Array] = field(default_factory=dict)
    asked: list[int] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.barrier = Barrier(self.size, timeout=60.0)


@dataclass
class Thread:
    """One of several threads, with the members of an MPI communicator that are asked for."""

    meeting: Meeting
    rank: int

    def Get_rank(self) -> int:
        return self.rank

    def Get_size(self) -> int:
        return self.meeting.size

    def allgather(self, sendobj: Array) -> list[Array]:
        self.meeting.sent[self.rank] = sendobj
        self.meeting.asked.append(sendobj.shape[1])
        self.meeting.barrier.wait()
        found = [self.meeting.sent[rank] for rank in range(self.meeting.size)]
        self.meeting.barrier.wait()
        return found


def compliance_by(ranks: tissue.Ranks | None) -> Array:
    """The compliance of the main job's holes at rest, by these processes; None: by this one alone."""
    organ = prepare(load("two_piercings", STILL), ranks=ranks).assembly.organ
    assert isinstance(organ, tissue.QuasiStaticOrgan)
    return organ.operator(0.0, 0.0).C


def test_columns_are_shared_by_those_that_make_the_same_calls() -> None:
    """Consistency check: two and three threads, each with its share of the columns, have the compliance of one, and the
    same as one another to the last bit."""
    organ = prepare(load("two_piercings", [*STILL, 'tissue.solver="superlu"'])).assembly.organ
    assert isinstance(organ, tissue.QuasiStaticOrgan)
    factor = organ.solver_of(organ.K)
    alone = compliance(factor, organ.Y)
    for size in (2, 3):
        meeting = Meeting(size)
        shares = [SharedColumns(factor, Thread(meeting, rank)) for rank in range(size)]
        with ThreadPoolExecutor(size) as pool:
            found = list(pool.map(lambda share: compliance(share, organ.Y), shares))
        assert len(meeting.asked) == size and max(meeting.asked) <= min(meeting.asked) + 1
        for W, C in found:
            assert np.array_equal(W, found[0][0]) and np.array_equal(C, found[0][1])
            assert np.abs(W - alone[0]).max() <= TWO_SOLVERS * np.abs(W).max()
            assert np.abs(C - alone[1]).max() <= TWO_SOLVERS * np.abs(C).max()


def test_two_ranks_of_mpi_have_the_numbers_of_one() -> None:
    """Consistency check: the same from a launch by MPI, where it is installed."""
    beside = Path(sys.executable).with_name("mpiexec")
    launch = str(beside) if beside.exists() else shutil.which("mpiexec")
    if launch is None or importlib.util.find_spec("mpi4py") is None:
        pytest.skip("needs mpi4py and an MPI: pip install 'suturefem[mpi]'")
    command = [launch, "-n", "2", sys.executable, "-c", BY_MPI]
    done = subprocess.run(command, capture_output=True, text=True, check=True, cwd=Path(__file__).parents[2])
    alone = compliance_by(None)
    assert np.abs(np.array(json.loads(done.stdout)) - alone).max() <= TWO_SOLVERS * np.abs(alone).max()


REFUSED = {
    "inertia": (["tissue.inertia=true"], r"tissue\.inertia = true is refused: ranks share"),
    "finite": (['tissue.material="neo-hookean"', "tissue.rayleigh=[1, 0]"], r"tissue\.material = .*tangent"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_ranks_cannot_share_is_refused(case: str) -> None:
    """Independent check: by its key, before anything is made."""
    keys, text = REFUSED[case]
    with pytest.raises(ScenarioError, match=text):
        prepare(load("two_piercings", [*STILL, *keys]), ranks=Thread(Meeting(1), 0))
