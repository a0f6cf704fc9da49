"""The choice of a solver, and organs that are solved by different ones: the same coupled step."""

from functools import cache
from pathlib import Path
from weakref import ReferenceType, ref

import numpy as np
import pytest
from scipy.sparse import csc_matrix, csr_matrix
from scipy.sparse.linalg import splu
from skfem import MeshTet

import tissue
from coupling.reports.audit import audit_step, initial_energies
from coupling.step.stepping import advance
from studies.scenario import ScenarioError, load
from studies.simulation.assembly import assemble
from tests.bounds import TWO_SOLVERS
from tissue.arrays import Array
from tissue.solvers import choice, iterative
from tissue.solvers.direct import BYTES, LIBRARIES, is_installed, ordering
from tissue.solvers.factor import Factor
from tissue.solvers.iterative import ConjugateGradients
from tissue.solvers.memory import free_memory
from tissue.solvers.multigrid import Multigrid, multigrid

SCENARIO = Path(__file__).parents[2] / "studies" / "scenario" / "scenes" / "two_piercings.toml"
STEPS = 5


def held_block() -> tissue.Elasticity:
    lines = [np.linspace(-side / 2, side / 2, n) for side, n in ((0.06, 10), (0.04, 8), (0.02, 6))]
    mesh = MeshTet.init_tensor(*lines).with_boundaries({"bottom": lambda x: x[2] < -0.01 + 1e-9})
    return tissue.elasticity(mesh, tissue.Material(1.0e5, 0.45, 1070.0), "P1", ("bottom",))


def organ(name: str = "auto", inertia: bool = False) -> tissue.DynamicOrgan | tissue.QuasiStaticOrgan:
    body = held_block()
    sites = tissue.build_sites(body, [tissue.Site([0.0, 0.0, 0.01], 3e-3, direction="normal")])
    kind = tissue.DynamicOrgan if inertia else tissue.QuasiStaticOrgan
    return kind(body, sites, (0.5, 0.0, -9.81), solver=name)


@cache
def after_some_steps(name: str, inertia: bool) -> tuple[np.ndarray, ...]:
    """Thread, organ, multipliers and site variables after a few steps of the main job, whose audit closes."""
    keys = [f"tissue.inertia={str(inertia).lower()}", "tissue.mesh.h=6e-3", "tissue.mesh.h_site=2e-3"]
    scenario = load(SCENARIO, [*keys, f'tissue.solver="{name}"'])
    assembly = assemble(scenario)
    system, state = assembly.system, assembly.start()
    energies = initial_energies(system, state)
    for _ in range(STEPS):
        for step in advance(system, state, scenario.solve.dt):
            energies, state = audit_step(system, energies, step), step.new
    assert abs(energies.balance_error) <= TWO_SOLVERS * abs(energies.external_work)
    return state.q, system.organ.displacement(state.organ), state.lam, state.y


@pytest.mark.parametrize("inertia", [True, False])
@pytest.mark.parametrize("name", ["cholmod", "pardiso", choice.MULTIGRID])
def test_a_coupled_step_does_not_depend_on_the_solver(name: str, inertia: bool) -> None:
    """Consistency check of two solvers, SuperLU and another."""
    if name in LIBRARIES and not is_installed(name):
        pytest.skip(f"{name} needs {LIBRARIES[name]}: not installed here")
    for one, other in zip(after_some_steps("superlu", inertia), after_some_steps(name, inertia), strict=True):
        assert np.abs(one - other).max() <= TWO_SOLVERS * np.abs(one).max()


def test_auto_takes_what_is_installed_and_what_there_is_room_for(monkeypatch: pytest.MonkeyPatch) -> None:
    best = next(name for name in LIBRARIES if is_installed(name))
    assert organ().choice.name == organ(inertia=True).choice.name == best
    monkeypatch.setattr(choice, "SMALL", 100)
    assert organ().choice == choice.SolverChoice(best, choice.MANY)
    monkeypatch.setattr(choice, "FACTOR_ONCE", dict.fromkeys(LIBRARIES, 1000))
    assert organ().choice.name == choice.MULTIGRID
    assert organ(inertia=True).choice.name == best
    factor = choice.factor_bytes(organ().K, organ().places, best)
    monkeypatch.setattr(choice, "free_memory", lambda: 2.5 * factor / choice.SHARE)
    assert organ(inertia=True).choice == choice.SolverChoice(best, 2)
    monkeypatch.setattr(choice, "free_memory", lambda: 0.5 * factor / choice.SHARE)
    assert organ(inertia=True).choice.name == choice.MULTIGRID
    with pytest.raises(tissue.TissueError, match=r"solver = 'superlu': the factor of .* GB are available; take 'multi"):
        organ("superlu", inertia=True)


def test_columns_are_solved_for_by_a_factor_as_long_as_there_is_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    """Consistency check of solvers: by a factor, and by multigrid where it does not fit, to the same answer."""
    held = organ()
    b = np.random.default_rng(2).standard_normal((held.size, 2))
    roomy = choice.solver_of_columns(held.K, held.places)
    monkeypatch.setattr(choice, "SMALL", 100)
    monkeypatch.setattr(choice, "free_memory", lambda: 1.0)
    scarce = choice.solver_of_columns(held.K, held.places)
    assert isinstance(roomy, Factor) and isinstance(scarce, ConjugateGradients)
    x = roomy.solve(b)
    assert np.abs(scarce.solve(b) - x).max() <= TWO_SOLVERS * np.abs(x).max()


def test_the_levels_of_an_organ_at_rest_are_let_go_and_made_anew(monkeypatch: pytest.MonkeyPatch) -> None:
    """Independent check: once its columns are made nothing holds the levels; a column that is asked for then is still
    that of the compliance."""
    made: list[ReferenceType[Multigrid]] = []

    def watched(A: csr_matrix, places: Array) -> Multigrid:
        levels = multigrid(A, places)
        made.append(ref(levels))
        return levels

    monkeypatch.setattr(iterative, "multigrid", watched)
    held = organ(choice.MULTIGRID)
    operator = held.operator(0.0, 0.0)
    assert len(made) == 1 and made[0]() is None
    y = held.Y @ operator.factor.solve(held.Y[[0]].toarray()[0])
    assert len(made) == 2 and np.abs(y - operator.C[:, 0]).max() <= TWO_SOLVERS * np.abs(y).max()


def test_no_more_operators_are_kept_than_there_is_room_for(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(choice, "MANY", 1)
    floating = organ(inertia=True)
    assert isinstance(floating, tissue.DynamicOrgan)
    first = floating.operator(1e6, 1e3)
    assert floating.operator(1e6, 1e3) is first
    floating.operator(4e6, 2e3)
    assert floating.operator(1e6, 1e3) is not first


def test_the_memory_of_a_factor_is_foreseen(monkeypatch: pytest.MonkeyPatch) -> None:
    """Consistency check: entries by dissection against those of the factor that SuperLU makes on the order it takes."""
    held = organ(inertia=True)
    assert isinstance(held, tissue.DynamicOrgan)
    A, order = held.K + 1e3 * held.M, ordering(held.K, held.places)
    symmetric = {"SymmetricMode": True}
    lu = splu(csc_matrix(A[order][:, order]), permc_spec="NATURAL", options=symmetric, diag_pivot_thresh=0.0)
    monkeypatch.setattr(choice, "SMALL", 0)
    foreseen = choice.factor_bytes(held.K, held.places, "superlu") / BYTES["superlu"]
    assert lu.nnz / 2 <= 1.1 * foreseen
    assert foreseen <= 1.6 * lu.nnz / 2


def test_free_memory(tmp_path: Path) -> None:
    proc, group = tmp_path / "meminfo", tmp_path / "group"
    assert free_memory(proc, group) == np.inf
    proc.write_text("MemTotal:  2000 kB\nMemAvailable:  1000 kB\n")
    assert free_memory(proc, group) == 1_024_000
    group.mkdir()
    (group / "memory.max").write_text("max\n")
    assert free_memory(proc, group) == 1_024_000
    (group / "memory.max").write_text("500000\n")
    (group / "memory.current").write_text("100000\n")
    assert free_memory(proc, group) == 400_000


def test_a_solver_that_is_not_there_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(tissue.TissueError, match="solver = 'magic': allowed are 'auto', 'cholmod'"):
        organ("magic")
    with pytest.raises(ScenarioError, match=r"tissue\.solver"):
        load(SCENARIO, ['tissue.solver="magic"'])
    monkeypatch.setitem(LIBRARIES, "pardiso", "no_such_library")
    with pytest.raises(tissue.TissueError, match="solver = 'pardiso' needs no_such_library; pip install it"):
        organ("pardiso")
    with pytest.raises(tissue.FactorError, match="'pardiso' needs no_such_library"):
        tissue.factorize(organ().K, method="pardiso")
