"""The study of suture tension, coarse: two holes beside those of a half-space, and what is beyond theory."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from coupling.reports.observation import site_compliance
from studies import unbounded
from studies.figure import render_figure
from studies.simulation import prepare
from studies.study import StudyError
from studies.study import study as study_named
from studies.suture_tension import study
from studies.suture_tension.study import FOOTPRINT, POISSON, SIZE, Case, Row, limits, main, run, scenario
from studies.theory import TwoHoles, direct_term, image_term
from tests.bounds import IDENTITY, RESIDUAL
from tests.tissue.layers import layer_compliance

STUDY = study_named("suture_tension")

CELLS = 0.03  # of a hole's compliance: the accuracy that cells are refined to
LEANING = 0.03  # of the tensions' directions: the thread leans by √(EI/T) over its leg of 30 mm, 2 % at 0.1 N


@cache
def rows() -> tuple[Row, ...]:
    return tuple(
        main(
            materials=("linear", "exponential, b = 5"),
            scaled_tensions=(0.2,),
            bites=(0.02,),
            depths=(4e-3,),
            refinements=(1.0,),
        )
    )


def rows_of_sweep(sweep: str) -> list[Row]:
    return [row for row in rows() if row.sweep == sweep]


def test_half_space_between_its_limits() -> None:
    """Independent check: Mindlin's two holes on the surface are Cerruti's and Boussinesq's, deep ones Kelvin's."""
    whole = unbounded.surface_force(np.array([0.01, 0.0, 0.0]), POISSON)[np.ix_([0, 2], [0, 2])]
    assert (
        np.abs(direct_term(0.01, POISSON) + image_term(0.01, 0.0, POISSON) - whole).max()
        <= IDENTITY * np.abs(whole).max()
    )
    deep = TwoHoles(0.01, 10.0, 1e-3, 1.0, POISSON).compliance
    assert deep[0, 0] == pytest.approx(unbounded.ball_compliance(POISSON) / 1e-3, rel=1e-3)
    assert np.abs(deep[:2, 2:] - direct_term(0.01, POISSON)).max() <= 1e-2 * deep[0, 2]
    shallow = TwoHoles(0.01, 3e-3, 1e-3, 1.0, POISSON).compliance
    assert np.abs(shallow - shallow.T).max() <= IDENTITY * shallow.max()


@pytest.mark.parametrize("depth", [2e-3, 4e-3, 8e-3])
def test_half_space_at_any_depth(depth: float) -> None:
    """Independent check (Betti): what a free surface adds is minus the work of Kelvin's tractions on it, about one
    hole, through the displacements there by forces on the other, which are Boussinesq's and Cerruti's inside it."""
    bite, nodes = 0.01, np.polynomial.legendre.leggauss(60)
    share, weight = 0.5 * (nodes[0] + 1.0), 0.5 * nodes[1]
    angle = 2.0 * np.pi * (np.arange(64) + 0.5) / 64
    scale = depth + bite
    R, A = np.meshgrid(scale * share / (1.0 - share), angle, indexing="ij")
    area = np.repeat(R[:, 0] * weight * scale / (1.0 - share) ** 2, 64) * 2.0 * np.pi / 64
    surface = np.stack([R * np.cos(A), R * np.sin(A), np.zeros_like(R)], axis=-1).reshape(-1, 3)
    ways = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    entry, leave = np.array([[-0.5 * bite, 0.0, -depth], [0.5 * bite, 0.0, -depth]])
    r = np.linalg.norm(surface - entry, axis=1)[:, None, None]
    e = (surface - entry) / r[:, 0]
    up, along = e[:, 2], e @ ways.T
    z = np.array([0.0, 0.0, 1.0])
    bracket = ways * up[:, None, None] + ways[None] @ z[:, None] * e[:, None, :] - along[..., None] * z
    traction = -((1.0 - 2.0 * POISSON) * bracket + 3.0 * (along * up[:, None])[..., None] * e[:, None, :])
    traction = traction / (8.0 * np.pi * (1.0 - POISSON) * r**2)
    moved = np.einsum("bj,kji->kbi", ways, unbounded.surface_force(leave - surface, POISSON))
    work = -np.einsum("k,kai,kbi->ba", area, traction, moved)
    found = image_term(bite, depth, POISSON)
    assert np.abs(found - work).max() <= 1e-3 * np.abs(found).max()


def test_stress_of_the_half_space_carries_its_forces() -> None:
    """Independent check: the tractions on a hemisphere about a hole are in equilibrium with its force."""
    theory, force = TwoHoles(0.01, 0.0, 1e-3, 5e5, POISSON), np.array([[0.0, 0.0, 0.0], [-0.1, 0.05, 0.2]])
    cosine, weight = np.polynomial.legendre.leggauss(16)
    angle = 2.0 * np.pi * np.arange(24) / 24
    Z, A = np.meshgrid(0.5 * (cosine - 1.0), angle, indexing="ij")
    across = np.sqrt(1.0 - Z**2)
    normal = np.stack([across * np.cos(A), across * np.sin(A), Z], axis=-1).reshape(-1, 3)
    radius = 3e-3
    stress = theory.stress(theory.places[1] + radius * normal, force)
    area = np.repeat(0.5 * weight, 24) * 2.0 * np.pi * radius**2 / 24
    assert np.abs(np.einsum("k,kij,kj->i", area, stress, normal) + force[1]).max() <= 1e-3 * 0.2


def test_compliance_is_that_of_a_layer() -> None:
    """Independent check: the block is a layer of 30 footprints on a rigid base."""
    simulation = prepare(scenario(Case(sweep="reference")))
    now = simulation.beginning()
    C = site_compliance(now.system, now.state)
    normal, along = layer_compliance("parabolic", FOOTPRINT, SIZE[2], 500e3, POISSON)
    assert C[9, 9] == pytest.approx(along, rel=CELLS)
    assert C[11, 11] == pytest.approx(normal, rel=CELLS)


def test_displacement_and_approach_of_a_half_space() -> None:
    """Independent check: the reference under 0.1 N. Along, the block is as soft as a half-space within the 3 % of its
    cells; normal to it a layer of 30 footprints lacks 3 % more."""
    for row in (*rows_of_sweep("reference"), *rows_of_sweep("bite width")):
        assert row.exit_along == pytest.approx(row.theory_along, rel=CELLS + LEANING)
        assert row.exit_normal == pytest.approx(row.theory_normal, rel=CELLS + LEANING + 0.03)
        assert row.approach == pytest.approx(row.theory_approach, rel=CELLS + LEANING)


def test_displacement_goes_like_load_over_stiffness() -> None:
    """Independent check: u ∝ T/E among linear rows."""
    (soft,), (stiff,) = rows_of_sweep("reference"), run(Case(sweep="reference", youngs_modulus=1e6))
    assert not soft.shortcomings and not stiff.shortcomings
    assert soft.exit_along * soft.youngs_modulus == pytest.approx(stiff.exit_along * stiff.youngs_modulus, rel=LEANING)


def test_holes_below_the_surface_move_less() -> None:
    """Independent check: Mindlin's solution."""
    (deep,) = rows_of_sweep("bite depth")
    assert deep.exit_along == pytest.approx(deep.theory_along, rel=CELLS + LEANING)
    assert deep.exit_along < 0.5 * rows()[0].exit_along


def test_stress_below_a_hole() -> None:
    """Independent check: Cerruti's and Boussinesq's stresses under the forces of the run, from below on coarse cells;
    none is said where cells are not for it, or at finite strain."""
    assert all(0.5 < row.stress / row.theory_stress < 1.0 for row in rows_of_sweep("cells"))
    other = [row for row in rows() if row.material != "linear" or not row.refinement]
    assert other and all(np.isnan(row.stress) for row in other)


def test_compliance_times_force_is_displacement() -> None:
    """Consistency check."""
    assert max(row.residual for row in rows() if row.material == "linear") <= RESIDUAL


def test_tissues_leave_the_linear_range_long_before_clinical_tensions() -> None:
    """Independent check: run in liver and skin, the tension that the reference tells of each moves a hole by 0.3
    footprints, in liver some mN; a clinical tension is named with its source and marked."""
    (reference,) = rows_of_sweep("reference")
    moving, bearing = limits(reference, 6e3)
    for E in (6e3, 500e3):
        (row,) = run(Case(sweep="reference", youngs_modulus=E, tension=limits(reference, E)[0]))
        assert row.moved == pytest.approx(0.3 * FOOTPRINT, rel=0.1)
    assert moving < 3e-3
    assert bearing == pytest.approx(0.3 * 2.245e-4 * 0.01 * 6e3, rel=1e-9)
    said = list(STUDY.remarks(rows()))
    assert any(line.startswith("liver") and "BEYOND" in line for line in said)
    assert any(line.startswith("skin") and "BEYOND" in line and "Capek" in line for line in said)
    assert any("were not refined" in line for line in said)


def test_what_is_not_supported_is_said() -> None:
    """A load beyond the linear range by either measure, spans that are too long, numbers that do not converge."""
    (base,) = rows_of_sweep("reference")
    assert base.bearing < 0.1 and not base.shortcomings
    assert "moved by 0.4 footprints, BEYOND" in replace(base, moved=4e-4).shortcomings[0]
    assert "bearing strain is" not in "".join(replace(base, moved=4e-4).shortcomings)
    assert "T/(d ℓ E) is 0.45, BEYOND" in replace(base, load=0.5).shortcomings[0]
    assert "TOO COARSE" in replace(base, span_ratio=0.9).shortcomings[0]
    swinging = [replace(base, sweep="cells", cells=h, stress=f) for h, f in ((1.0, 1.0), (2.0, 2.0), (3.0, 1.5))]
    said = "\n".join(STUDY.remarks([*rows(), *swinging]))
    assert "von Mises stress below the hole: NOT CONVERGED" in said


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"bites": (1e-3,)}, "bites = [0.001] is refused"),
        ({"depths": (1e-3,)}, "give 0 or 2 footprints"),
        ({"refinements": (1.0, 2.0)}, "three for a verdict"),
        ({"scaled_tensions": (-1.0, 0.2)}, "scaled_tensions = [-1.0, 0.2] is refused: give numbers above 0"),
        ({"materials": ("bone",)}, "linear; neo-hookean"),
    ],
)
def test_what_has_no_meaning_is_refused(given: dict[str, tuple[float, ...]], words: str) -> None:
    with pytest.raises(StudyError) as caught:
        next(main(**given))  # type: ignore[arg-type]
    assert words in str(caught.value)


def test_table_and_figure() -> None:
    """A line a run, and an axis with its unit for each panel."""
    shown = STUDY.table(rows())
    assert len(shown.lines) == 1 + 2 + 1 + 1 + 1
    assert {len(line) for line in shown.lines} == {len(shown.head)}
    text = render_figure(STUDY.figure, rows(), "sample")["svg"].decode()
    assert all(label in text for label in ("T/(E a²) [-]", "linear organ off by [%]", "what is changed alone [mm]"))


def material_row(name: str, load: float, moved: float) -> Row:
    """A row of the sweep of materials."""
    return replace(rows()[0], sweep="material", material=name, load=load, tension=load, exit_along=moved)


def test_the_range_of_a_linear_organ_is_measured() -> None:
    """Independent check: of a hole that moves by u/(1 + βu) where the linear organ says u, that is off by βu: by 5 %
    at u = 0.05/β, said with its τ."""
    slope, beta = 1.4e-3, 250.0
    loads = np.linspace(0.02, 0.4, 20)
    ways = {"linear": slope * loads, "exponential, b = 5": slope * loads / (1.0 + beta * slope * loads)}
    swept = [material_row(name, t, u) for name, moved in ways.items() for t, u in zip(loads, moved, strict=True)]
    by_material = study.runs_by_material(swept)
    linear, other = by_material.values()
    assert study.departures(linear, other) == pytest.approx(beta * slope * loads)
    tau, moved = study.measured_range(linear, other)
    u = 0.05 / beta
    assert tau == pytest.approx(u / slope / (5e5 * 1e-6), rel=1e-6)
    assert moved == pytest.approx(u / 1.05 / 1e-3, rel=1e-3)
    assert np.isinf(study.measured_range(linear, linear)).all()
    (said,) = study.measured_ranges(swept)
    assert "u/a = 0.19" in said and "at τ = 0.8 it is +14%" in said


def test_a_stiffening_organ_is_the_linear_one_at_small_tension() -> None:
    """Independent check: on the same cells the linear organ is less than 1 % off at τ = 0.1, and more than twice as far
    off at twice that, where tissue stiffens."""
    linear, other = study.runs_by_material(rows()).values()
    off = np.abs(study.departures(linear, other))
    at = [row.scaled_load for row in other]
    assert at[3] == pytest.approx(0.1) and at[7] == pytest.approx(0.2)
    assert off[3] < 0.01 < off[7]
    assert off[7] > 2.0 * off[3]
