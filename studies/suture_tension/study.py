"""Tension of a suture: how far it moves two holes of an organ, the stress around them, and where linear theory ends."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial

from studies.study import Job, Study, StudyError, each
from studies.suture_tension.case import CLEAR, GIVEN, MATERIAL_STEPS, MATERIALS, REFERENCE, SIZE, SOFT, TISSUES, Row
from studies.suture_tension.figure import figure
from studies.suture_tension.findings import remarks, table
from studies.suture_tension.runs import last_step, run_tensions


def main(
    tissues: Sequence[str] = tuple(TISSUES),
    tensions: Sequence[float] = (0.02, 0.2, 2.0, 5.0),
    moduli: Sequence[float] = (1e5, 2e5, 5e5, 2e6, 1e7),
    bites: Sequence[float] = (0.005, 0.0075, 0.01, 0.015, 0.02),
    depths: Sequence[float] = (0.0, 2e-3, 4e-3, 8e-3),
    footprints: Sequence[float] = (0.5e-3, 1e-3, 2e-3),
    mus: Sequence[float] = (0.0, 0.1, 0.2, 0.3, 0.4),
    distances: Sequence[float] = (1.5, 2.0, 3.0, 4.0),
    refinements: Sequence[float] = (1.5, 2.0, 2.5, 3.0),
    soft_ways: Sequence[str] = ("10 load steps", "40 load steps", "damped motion"),
    materials: Sequence[str] = tuple(MATERIALS),
    scaled_tensions: Sequence[float] = (0.4, 2.0),
    refinement: float = 1.5,
) -> Iterator[Row]:
    """Yield every load step of the tensions, by tissue or material and up to the first that fails; the last one of
    everything else. `scaled_tensions` are T/(E a²) of the materials.

    Raises `StudyError`.
    """
    check(tissues, soft_ways, materials, bites, depths, footprints, refinements)
    check_positive({"tensions": tensions, "moduli": moduli, "distances": distances, "scaled_tensions": scaled_tensions})
    if min(mus) < 0.0 or max(mus) >= 1.0:
        raise StudyError(f"mus = {list(mus)} is refused: give coefficients from 0 to below 1")
    case = replace(REFERENCE, refinement=refinement)
    jobs: list[Job] = [
        partial(run_tensions, replace(case, sweep="tension", name=name, youngs_modulus=TISSUES[name]), tensions)
        for name in tissues
    ]
    jobs += [partial(last_step, replace(case, sweep="stiffness", youngs_modulus=E)) for E in moduli]
    jobs += [partial(last_step, replace(case, sweep="friction", mu=mu, given=GIVEN)) for mu in mus]
    fine = replace(case, sweep="distance", refinement=max((refinement, *refinements)))
    jobs += [partial(last_step, replace(fine, ring=r)) for r in distances]
    jobs += [partial(last_step, replace(case, sweep="cells", refinement=k)) for k in sorted(refinements, reverse=True)]
    jobs += [partial(last_step, replace(case, sweep="bite width", bite=w)) for w in bites]
    jobs += [partial(last_step, replace(case, sweep="bite depth", depth=c)) for c in depths]
    jobs += [partial(last_step, replace(case, sweep="footprint", footprint=a)) for a in footprints]
    jobs += [
        partial(last_step, replace(case, sweep="direction", name=holes, holes=holes)) for holes in ("free", "normal")
    ]
    soft = replace(
        case, sweep="soft organ", suture="2-0 polypropylene", knots="fixed", holes="normal", tension=0.5,
        youngs_modulus=TISSUES["liver"],
    )  # fmt: skip
    jobs += [partial(last_step, replace(soft, name=name, **SOFT[name])) for name in soft_ways]
    one = case.youngs_modulus * case.footprint**2
    jobs += [
        partial(
            run_tensions,
            replace(case, sweep="material", name=name, load_steps=MATERIAL_STEPS, **MATERIALS[name]),
            [one * scaled for scaled in scaled_tensions],
        )
        for name in materials
    ]
    yield from each(jobs)


def check(
    tissues: Sequence[str],
    soft_ways: Sequence[str],
    materials: Sequence[str],
    bites: Sequence[float],
    depths: Sequence[float],
    footprints: Sequence[float],
    refinements: Sequence[float],
) -> None:
    """Refuse what has no meaning here. Raises `StudyError`."""
    for name in tissues:
        if name not in TISSUES:
            raise StudyError(f'tissues: "{name}" is refused: those known are {", ".join(TISSUES)}')
    for name in soft_ways:
        if name not in SOFT:
            raise StudyError(f'soft_ways: "{name}" is refused: those known are {", ".join(SOFT)}')
    for name in materials:
        if name not in MATERIALS:
            raise StudyError(f'materials: "{name}" is refused: those known are {"; ".join(MATERIALS)}')
    if min(bites) < 4.0 * REFERENCE.footprint or max(bites) > 0.5 * SIZE[0]:
        raise StudyError(f"bites = {list(bites)} is refused: give 4 footprints (4e-3) to half the block (0.04) [m]")
    if any(0.0 < depth < CLEAR * REFERENCE.footprint for depth in depths) or max(depths) > 0.5 * SIZE[2]:
        raise StudyError(f"depths = {list(depths)} is refused: give 0 or 2 footprints (2e-3) to half the block [m]")
    if min(footprints) <= 0.0 or max(footprints) > 0.25 * REFERENCE.bite:
        raise StudyError(f"footprints = {list(footprints)} is refused: give numbers above 0 to 2.5e-3 [m]")
    if len(set(refinements)) == 2 or min(refinements) < 1.0:
        raise StudyError(
            f"refinements = {list(refinements)} is refused: give one, or three for a verdict, none below 1"
        )


def check_positive(numbers: Mapping[str, Sequence[float]]) -> None:
    """Refuse tensions, moduli and distances that are none. Raises `StudyError`."""
    for name, values in numbers.items():
        if min(values) <= 0.0:
            raise StudyError(f"{name} = {list(values)} is refused: give numbers above 0")


STUDY = Study(
    main=main,
    question="How far does a suture under tension draw two holes together, what stress is around them, and up to which "
    "tension may a linear organ say so?",
    independent="displacement, approach and stress of two holes in a half-space (Cerruti, Boussinesq, Mindlin, and a "
    "footprint's own by Fourier transform), length drawn through and fall of tension of an elastica, u ∝ T/E",
    consistency="compliance times reported force is the reported displacement; sub-grid P1 of the runs against P2 of "
    "the mesh for stress; the linear organ beside those at finite strain, on the same P2 cells",
    table=table,
    figure=figure,
    remarks=remarks,
    quick={
        "tissues": ("liver", "skin"),
        "tensions": (0.02, 0.2),
        "moduli": (1e5, 1e6),
        "bites": (0.005, 0.01, 0.02),
        "depths": (0.0, 4e-3),
        "footprints": (0.5e-3, 1e-3),
        "mus": (0.0, 0.2, 0.4),
        "distances": (1.5, 3.0),
        "refinements": (1.0,),
        "soft_ways": ("10 load steps",),
        "materials": ("linear", "exponential, b = 5"),
        "scaled_tensions": (1.0,),
        "refinement": 1.0,
    },
)
