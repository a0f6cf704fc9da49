"""Suture sections against the products of the published size and modulus tables."""

import math
from dataclasses import FrozenInstanceError
from itertools import pairwise

import pytest

from thread.catalogue import (
    BRAID_BENDING_FACTOR,
    BRAID_SOLID_FRACTION,
    BRANDS,
    MATERIALS,
    SIZES,
    Section,
    knot_pull,
    names,
    suture,
)
from thread.errors import ThreadError

DIGITS4 = 6e-4  # tables of four digits


def test_reference_thread_2_0_polypropylene():
    thread = suture("2-0 polypropylene")
    assert thread.diameter == pytest.approx(0.3195e-3, rel=1e-12)
    assert thread.rhoA == pytest.approx(7.25571e-5, rel=1e-6)
    assert pytest.approx(240.521, rel=3e-6) == thread.EA
    assert pytest.approx(1.534527e-6, rel=1e-6) == thread.EI
    assert pytest.approx(1.096091e-6, rel=1e-6) == thread.GJ


@pytest.mark.parametrize(
    ("name", "EA", "EI_solid"),
    [
        ("7-0 polypropylene", 8.342, 1.846e-9),
        ("5-0 polypropylene", 36.52, 3.538e-8),
        ("0 polypropylene", 330.5, 2.897e-6),
        ("1 polypropylene", 476.1, 6.012e-6),
        ("4-0 nylon", 47.83, 9.103e-8),
        ("2-0 PDS", 120.3, 7.673e-7),
        ("3-0 steel", 7640, 2.407e-5),
        ("3-0 silk", 344.4, 1.085e-6),
        ("0 silk", 958.3, 8.400e-6),
    ],
)
def test_stiffness_of_other_sutures(name, EA, EI_solid):
    thread = suture(name)
    assert pytest.approx(EA, rel=DIGITS4) == thread.EA
    factor = BRAID_BENDING_FACTOR if "silk" in name else 1.0
    assert pytest.approx(factor * EI_solid, rel=DIGITS4) == thread.EI


@pytest.mark.parametrize(("usp", "rhoA"), [("7-0", 2.516e-6), ("4-0", 2.164e-5), ("1", 1.436e-4)])
def test_mass_per_length_of_polypropylene(usp, rhoA):
    assert suture(f"{usp} polypropylene").rhoA == pytest.approx(rhoA, rel=DIGITS4)


def test_a_braid_is_lighter_and_softer_in_bending_than_the_solid_rod_but_as_stiff_axially():
    braid = suture("2-0 polyester")
    rod = Section(braid.diameter, braid.density, braid.youngs_modulus, braid.poisson_ratio)
    assert braid.EA == rod.EA
    assert braid.rhoA == pytest.approx(BRAID_SOLID_FRACTION * rod.rhoA, rel=1e-12)
    assert pytest.approx(BRAID_BENDING_FACTOR * rod.EI, rel=1e-12) == braid.EI
    assert pytest.approx(BRAID_BENDING_FACTOR * rod.GJ, rel=1e-12) == braid.GJ


def test_section_products_of_a_unit_circle():
    section = Section(diameter=2.0, density=3.0, youngs_modulus=5.0, poisson_ratio=0.25)
    assert section.area == pytest.approx(math.pi, rel=1e-15)
    assert pytest.approx(math.pi / 4, rel=1e-15) == section.I
    assert pytest.approx(5.0 / 2.5 * math.pi / 2, rel=1e-15) == section.GJ


def test_size_table_has_the_areas_and_moments_of_its_mid_diameters():
    table = {  # A [mm²], I [mm⁴]
        "11-0": (1.6513e-4, 2.1699e-9), "10-0": (4.7144e-4, 1.7686e-8), "9-0": (9.3482e-4, 6.9542e-8),
        "8-0": (1.5553e-3, 1.9249e-7), "6-0": (5.6079e-3, 2.5026e-6), "3-0": (3.9584e-2, 1.2469e-4),
        "2": (2.3715e-1, 4.4755e-3), "3": (3.3132e-1, 8.7355e-3), "4": (3.3132e-1, 8.7355e-3),
        "5": (4.4120e-1, 1.5490e-2),
    }  # fmt: skip
    for usp, (area, moment) in table.items():
        section = suture(f"{usp} nylon")
        assert section.area * 1e6 == pytest.approx(area, rel=5e-5), usp
        assert pytest.approx(moment, rel=5e-5) == section.I * 1e12, usp


def test_sizes_are_in_order_and_their_limits_hold_their_metric_number():
    for thin, thick in pairwise(SIZES):
        assert thin.d_max < thick.d_min or thin.metric == thick.metric
    for size in SIZES:
        assert size.d_min == pytest.approx(size.metric / 10, rel=1e-12) and size.d_min < size.d_max


def test_catgut_is_one_size_larger():
    assert suture("2-0 catgut").diameter == suture("0 nylon").diameter
    assert suture("3-0 gut").diameter == suture("2-0 nylon").diameter
    assert suture("2 collagen").diameter == suture("3 nylon").diameter
    assert suture("3 catgut").diameter == suture("5 nylon").diameter
    with pytest.raises(ThreadError, match="from 9-0 to 3"):
        suture("11-0 catgut")


@pytest.mark.parametrize(
    "spelling",
    [
        "2-0 Polypropylene",
        "  2-0   polypropylene ",
        "USP 2-0 PP",
        "2/0 pp",
        "00 polypropylene",
        "2 - 0 poly propylene",
        "Prolene 2-0",
        "2-0 Prolene",
        "polypropylene, USP 2/0",
    ],
)
def test_spellings_of_one_suture(spelling):
    assert suture(spelling) == suture("2-0 polypropylene")


@pytest.mark.parametrize(
    ("one", "other"),
    [
        ("3-0 PDS", "3-0 polydioxanone"), ("1 PGA", "1 polyglycolic acid"), 
        ("4-0 polyglactin", "4-0 Polyglactin-910"),
        ("0 316L", "0 stainless steel"), ("#5 PET", "5 polyester"), ("6-0 polyamide", "6-0 nylon"),
        ("PDS 4-0", "4-0 polydioxanone"), ("PDS II 4-0", "4-0 PDS"), ("silk 4-0", "4-0 silk"),
        ("Vicryl 3-0", "3-0 polyglactin 910"), ("nylon 3-0", "3-0 nylon"), ("nylon 6 3-0", "3-0 nylon"),
        ("Ti-Cron 2-0", "2-0 polyester"), ("Ethilon 10-0", "10-0 nylon"), ("316L 0", "0 steel"),
    ],
)  # fmt: skip
def test_synonyms(one, other):
    assert suture(one) == suture(other)


def test_every_name_of_the_catalogue_makes_a_section_and_every_number_has_a_source():
    assert len(names()) == 9 * 18 + 12
    assert all(suture(name).EA > 0 for name in names())
    for material in MATERIALS:
        assert material.density_source and material.range_source and material.modulus_source
        if material.modulus is not None and material.modulus_range is not None:
            assert material.modulus_range[0] <= material.modulus <= material.modulus_range[1]
    assert all(size.source for size in SIZES)


@pytest.mark.parametrize(
    ("name", "newton"),
    [("2-0 polypropylene", 14.122), ("2-0 PDS", 26.282), ("11-0 nylon", 0.059), ("5 silk", 60.409), ("3-0 PGA", 17.358),
     ("5 PDS", None), ("2-0 steel", None), ("0 catgut", None), ("7 nylon", None)],
)  # fmt: skip
def test_knot_pull_strength(name, newton):
    assert knot_pull(name) == newton


def test_knot_pull_grows_with_the_size_and_stays_below_the_strength_of_the_solid():
    for kind in ("nylon", "PDS"):
        strengths = [knot_pull(f"{size.usp} {kind}") for size in SIZES]
        given = [x for x in strengths if x is not None]
        assert len(given) >= 14 and given == sorted(given)
        for size, strength in zip(SIZES, strengths, strict=True):
            assert strength is None or strength < 1e9 * math.pi / 4 * size.diameter**2


@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("2-0 polypropilene", "2-0 polypropylene"),
        ("20-0 nylon", "0 nylon"),
        ("vicril 2-0", "the nearest is 2-0 polyglactin 910; sizes"),
        ("nylon 30", "the nearest are 3-0 nylon, "),
        ("nylon 6", "sizes: 11-0"),
        (
            "Monocryl 4-0",
            "Monocryl is poliglecaprone 25, and the catalogue has no stiffness of this material; give diameter",
        ),
        ("polypropylene", "sizes: 11-0"),
        ("1-0 PDS", "not in the catalogue"),
        ("", "not in the catalogue"),
        ("2-0 UHMWPE", "no source gives the modulus of UHMWPE"),
    ],
)
def test_a_miss_names_the_nearest(name, says):
    with pytest.raises(ThreadError, match=says):
        suture(name)


def test_every_brand_has_a_source_and_is_a_material_or_known_to_be_none():
    for brand, of, source in BRANDS:
        assert source
        if of in {material.name for material in MATERIALS}:
            assert suture(f"{brand} 3-0") == suture(f"3-0 {of}")
        else:
            with pytest.raises(ThreadError, match=f"{brand} is {of}"):
                suture(f"3-0 {brand}")


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("diameter", 0.0), ("diameter", math.nan), ("density", -1.0), ("youngs_modulus", math.inf),
        ("poisson_ratio", -1.0), ("poisson_ratio", 0.51), ("poisson_ratio", math.nan),
        ("solid_fraction", 0.0), ("solid_fraction", 1.1), ("bending_factor", -0.1), ("bending_factor", 2.0),
    ],
)  # fmt: skip
def test_a_section_that_cannot_be_is_refused(key, value):
    good = {"diameter": 1e-3, "density": 1e3, "youngs_modulus": 1e9}
    with pytest.raises(ThreadError, match=f"{key} = "):
        Section(**{**good, key: value})


def test_a_section_is_frozen():
    with pytest.raises(FrozenInstanceError):
        setattr(suture("2-0 nylon"), "diameter", 1.0)  # noqa: B010  a type checker forbids the plain way
