"""Cross-sections of suture threads, and a catalogue of them: USP size × material
(`catalogue.toml`).
"""

import difflib
import math
import re
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any

from thread.errors import ThreadError

# EI and GJ of a braid over EI and GJ of a solid rod with its diameter: the filaments slide on one another.
# Assumption, within 0.01 … 0.1. Not read yet: Chu & Kizil, Surg Gynecol Obstet 1989, on the stiffness of commercial
# sutures.
BRAID_BENDING_FACTOR = 0.05
# Solid part of a braid's nominal cross-section. Assumption, within 0.6 … 0.8: USP <861> measures the
# diameter under a presser foot, and there is air between the filaments.
BRAID_SOLID_FRACTION = 0.7
# Poisson's ratio of the polymers and of gut. Assumption; it only enters the torsional stiffness.
POLYMER_POISSON_RATIO = 0.4


@dataclass(frozen=True)
class Section:
    """Round cross-section of a thread; raises `ThreadError` for a value that is not physical.

    `youngs_modulus` is the apparent modulus: axial force over the area of the full circle and over
    strain. A tensile test on a suture reports this modulus, so that the axial stiffness of a braid
    is not reduced a second time. `density` is the density of the material, and `solid_fraction` the
    part of the circle that it fills. `bending_factor` is the ratio of bending and torsional
    stiffness to a solid rod: 1 for a monofilament and far less for a braid.
    """

    diameter: float  # [m]
    density: float  # of the material [kg/m³]
    youngs_modulus: float  # apparent, along the thread [Pa]
    poisson_ratio: float = POLYMER_POISSON_RATIO  # [-]
    solid_fraction: float = 1.0  # [-]
    bending_factor: float = 1.0  # [-]

    def __post_init__(self) -> None:
        for name in ("diameter", "density", "youngs_modulus"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0):
                raise ThreadError(f"{name} = {value!r} must be positive and finite")
        if not -1 < self.poisson_ratio <= 0.5:
            raise ThreadError(f"poisson_ratio = {self.poisson_ratio!r} must be above -1 and at most 0.5")
        if not 0 < self.solid_fraction <= 1:
            raise ThreadError(f"solid_fraction = {self.solid_fraction!r} must be above 0 and at most 1")
        if not 0 <= self.bending_factor <= 1:
            raise ThreadError(f"bending_factor = {self.bending_factor!r} must be between 0 and 1")

    @property
    def area(self) -> float:
        """Area of the full circle [m²]."""
        return math.pi * self.diameter**2 / 4

    @property
    def I(self) -> float:  # noqa: E743  the paper's symbol
        """Second moment of area of the full circle [m⁴]."""
        return math.pi * self.diameter**4 / 64

    @property
    def rhoA(self) -> float:
        """Mass per length [kg/m]."""
        return self.density * self.solid_fraction * self.area

    @property
    def rhoJ(self) -> float:
        """Polar moment of inertia per length, with the mass distributed uniformly over the circle
        [kg m].
        """
        return self.rhoA * self.diameter**2 / 8

    @property
    def EA(self) -> float:
        """Axial stiffness [N]."""
        return self.youngs_modulus * self.area

    @property
    def EI(self) -> float:
        """Bending stiffness [N m²]."""
        return self.bending_factor * self.youngs_modulus * self.I

    @property
    def GJ(self) -> float:
        """Torsional stiffness [N m²], G = E/2(1+ν) and J = 2I."""
        return self.bending_factor * self.youngs_modulus / (2 * (1 + self.poisson_ratio)) * 2 * self.I


@dataclass(frozen=True)
class Size:
    """A USP size and its limits on the average diameter, for sutures without collagen."""

    usp: str
    metric: float  # European Pharmacopoeia number, tenths of a millimetre
    d_min: float  # [mm]
    d_max: float  # [mm]
    source: str
    knot_nonabsorbable: float | None = None  # least average knot-pull strength, class I [N]
    knot_absorbable: float | None = None  # the same for a synthetic absorbable suture [N]

    @property
    def diameter(self) -> float:
        """Middle of the range [m]."""
        return (self.d_min + self.d_max) / 2 * 1e-3


@dataclass(frozen=True)
class SutureMaterial:
    """A suture material; the `…_source` says where each number comes from."""

    name: str
    braided: bool
    density: float  # [kg/m³]
    density_source: str
    range_source: str
    modulus_source: str
    modulus_range: tuple[float, float] | None = None  # [Pa]
    modulus: float | None = None  # the catalogue's choice [Pa]; None if no source gives a modulus
    poisson_ratio: float = POLYMER_POISSON_RATIO
    poisson_source: str = "assumption"
    collagen: bool = False
    absorbable: bool = False
    synonyms: tuple[str, ...] = ()


LISTS = tomllib.loads((Path(__file__).parent / "catalogue.toml").read_text(encoding="utf-8"))
SOURCES: Mapping[str, str] = MappingProxyType(LISTS["sources"])


def _with_sources(value: Any) -> Any:
    """Return a value of the catalogue, in a text with the sources that it names."""
    return value.format_map(SOURCES) if isinstance(value, str) else tuple(value) if isinstance(value, list) else value


SIZES = tuple(Size(*map(_with_sources, row)) for row in LISTS["sizes"])
MATERIALS = tuple(SutureMaterial(**{key: _with_sources(x) for key, x in row.items()}) for row in LISTS["materials"])
BRANDS = tuple((brand, of, _with_sources(source)) for brand, of, source in LISTS["brands"])
COLLAGEN_SIZES = tuple(LISTS["collagen_sizes"])


def _key(text: str) -> str:
    """Return a name reduced to lower case letters and digits, which distinguish materials."""
    return re.sub(r"[^a-z0-9]", "", text.casefold())


SIZE_OF: Mapping[str, Size] = MappingProxyType({size.usp: size for size in SIZES})
_GENERIC = {_key(word): material for material in MATERIALS for word in (material.name, *material.synonyms)}
_BRANDED = {_key(brand): _GENERIC[_key(of)] for brand, of, _ in BRANDS if _key(of) in _GENERIC}
MATERIAL_OF: Mapping[str, SutureMaterial] = MappingProxyType(_GENERIC | _BRANDED)
UNKNOWN_OF: Mapping[str, str] = MappingProxyType(
    {_key(brand): f"{brand} is {of}" for brand, of, _ in BRANDS if _key(of) not in _GENERIC}
)
SIZE_WORDS, MATERIAL_WORDS = r"(?:usp)?\s*#?\s*(\d+(?:\s*[-/]\s*0)?)", r"([^\W\d].*?|316l)"


def names() -> tuple[str, ...]:
    """Return the names of all sutures of the catalogue, e.g. "2-0 polypropylene"."""
    return tuple(
        f"{size.usp} {material.name}"
        for material in MATERIALS
        if material.modulus is not None
        for size in SIZES
        if not material.collagen or size.usp in COLLAGEN_SIZES
    )


def suture(name: str) -> Section:
    """Return the section of a suture named by USP size and material or brand, e.g. "2-0
    polypropylene", "Prolene 2-0".

    Order, case and spaces do not matter, and "2/0" and "USP" are understood. Raises `ThreadError`
    with the nearest names for an unknown suture.
    """
    size, material = _parse(name)
    if material.modulus is None:
        raise ThreadError(
            f"suture = {name!r}: no source gives the modulus of {material.name}; "
            "give diameter, youngs_modulus and density instead"
        )
    return Section(
        diameter=_diameter(name, size, material),
        density=material.density,
        youngs_modulus=material.modulus,
        poisson_ratio=material.poisson_ratio,
        solid_fraction=BRAID_SOLID_FRACTION if material.braided else 1.0,
        bending_factor=BRAID_BENDING_FACTOR if material.braided else 1.0,
    )


def knot_pull(name: str) -> float | None:
    """Return the least average knot-pull strength that the pharmacopoeia requires of a suture [N].

    None means that no source gives a strength: collagen and steel have separate tables. Raises
    `ThreadError` as `suture` does.
    """
    size, material = _parse(name)
    if material.collagen or material.name == "steel":
        return None
    return size.knot_absorbable if material.absorbable else size.knot_nonabsorbable


def _parse(name: str) -> tuple[Size, SutureMaterial]:
    usp, word = _split(name)
    size, material = SIZE_OF.get(usp), MATERIAL_OF.get(word)
    if size is None or material is None:
        raise ThreadError(_miss(name, usp, word))
    return size, material


def _split(name: str) -> tuple[str, str]:
    """Return the USP number and the key of the material from a name in either order; empty if not
    found.
    """
    if not isinstance(name, str):
        raise ThreadError(f"suture = {name!r} is not a name; give for example '2-0 polypropylene'")
    text = name.strip().casefold()
    if _key(text) in MATERIAL_OF:  # nylon 6 is a material and not a size of nylon
        return "", _key(text)
    first = re.fullmatch(rf"{SIZE_WORDS}\s*[-,]?\s*{MATERIAL_WORDS}", text)
    last = re.fullmatch(rf"{MATERIAL_WORDS}[\s,]+{SIZE_WORDS}", text)
    found = [(_usp(first[1]), _key(first[2]))] if first else []
    found += [(_usp(last[2]), _key(last[1]))] if last else []
    known = [(usp, word) for usp, word in found if usp in SIZE_OF and word in MATERIAL_OF]
    return [*known, *found, ("", _key(text))][0]


def _usp(text: str) -> str:
    """Return the canonical USP number: "2 / 0" and "00" are "2-0".

    "1-0" is not changed and is unknown, because some authors mean 0 by "1-0" and others 1.
    """
    compact = re.sub(r"\s", "", text).replace("/", "-")
    zeros = len(compact)
    return f"{zeros}-0" if compact == "0" * zeros and zeros > 1 else compact


def _miss(name: str, usp: str, word: str) -> str:
    """Return the message for an unknown suture, with the nearest known sutures."""
    if word in UNKNOWN_OF:
        return (
            f"suture = {name!r}: {UNKNOWN_OF[word]}, and the catalogue has no stiffness of this material; give "
            "diameter, youngs_modulus and density instead"
        )
    alike = difflib.get_close_matches(word, MATERIAL_OF, n=1)
    sizes = [usp] if usp in SIZE_OF else difflib.get_close_matches(usp, SIZE_OF, n=3, cutoff=0.5)
    near = [f"{size} {MATERIAL_OF[each].name}" for each in alike for size in sizes]
    hint = f"; the nearest are {', '.join(near)}" if near[1:] else f"; the nearest is {near[0]}" if near else ""
    return (
        f"suture = {name!r} is not in the catalogue{hint}; sizes: {' '.join(SIZE_OF)}; "
        f"materials: {', '.join(material.name for material in MATERIALS)}"
    )


def _diameter(name: str, size: Size, material: SutureMaterial) -> float:
    """Return the nominal diameter [m]; for collagen the diameter of the next larger metric number.

    Raises `ThreadError` for a collagen size that the catalogue does not know.
    """
    if not material.collagen:
        return size.diameter
    if size.usp not in COLLAGEN_SIZES:
        raise ThreadError(
            f"suture = {name!r}: collagen sizes are known from {COLLAGEN_SIZES[0]} to {COLLAGEN_SIZES[-1]} only"
        )
    return next(larger.diameter for larger in SIZES if larger.metric > size.metric)
