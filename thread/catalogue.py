"""Cross-sections of suture threads, and a catalogue of them: USP size × material.

Every number has its source, or its range and the word assumption. "Abstract read" marks a source of which only the
abstract was read. A range with a named source that was not read is an assumption.
"""

import difflib
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

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

    `youngs_modulus` is the apparent modulus: axial force over the area of the full circle and over strain. A
    tensile test on a suture reports this modulus, so that the axial stiffness of a braid is not reduced a second
    time. `density` is the density of the material, and `solid_fraction` the part of the circle that it fills.
    `bending_factor` is the ratio of bending and torsional stiffness to a solid rod: 1 for a monofilament and far
    less for a braid.
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
        """Polar moment of inertia per length, with the mass distributed uniformly over the circle [kg m]."""
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


USP = (
    "USP–NF, Nonabsorbable Surgical Suture and Absorbable Surgical Suture, tables of diameter (USP 32–NF 27 and "
    "USP 29–NF 24 are public; their tables were not seen); 11-0 to 2 agree digit for digit with a public code table"
)
KNOT_PULL = (
    "assumption: least averages of the same monographs, kgf × 9.80665, not looked up; a public code table differs by "
    "1 to 22 %. Measured failures of knotted 3-0 lie above them, polypropylene 18.9 N and polyglyconate 34.2 N ("
    "Naleway et al. 2015, abstract read). Look the monograph up before a strength is quoted"
)
WEB = "assumption: a public web table of thread sizes, itself in error for 2-0"

SIZES = (
    Size("11-0", 0.1, 0.010, 0.019, USP, 0.059, None),
    Size("10-0", 0.2, 0.020, 0.029, USP, 0.186, 0.245),
    Size("9-0", 0.3, 0.030, 0.039, USP, 0.422, 0.49),
    Size("8-0", 0.4, 0.040, 0.049, USP, 0.588, 0.686),
    Size("7-0", 0.5, 0.050, 0.069, USP, 1.079, 1.373),
    Size("6-0", 0.7, 0.070, 0.099, USP, 1.961, 2.452),
    Size("5-0", 1.0, 0.100, 0.149, USP, 3.923, 6.669),
    Size("4-0", 1.5, 0.150, 0.199, USP, 5.884, 9.316),
    Size("3-0", 2.0, 0.200, 0.249, USP, 9.414, 17.358),
    Size("2-0", 3.0, 0.300, 0.339, USP, 14.122, 26.282),
    Size("0", 3.5, 0.350, 0.399, USP, 21.182, 38.246),
    Size("1", 4.0, 0.400, 0.499, USP, 26.674, 49.818),
    Size("2", 5.0, 0.500, 0.599, USP, 34.519, 62.272),
    Size("3", 6.0, 0.600, 0.699, USP, 47.856, 71.49),
    Size("4", 6.0, 0.600, 0.699, USP, 47.856, 71.49),
    Size("5", 7.0, 0.700, 0.799, USP, 60.409, None),
    Size("6", 8.0, 0.800, 0.899, WEB),
    Size("7", 9.0, 0.900, 0.999, WEB),
)

# Collagen (gut) is one size larger for the same USP number: it has the diameter of the next larger metric number.
# Assumption after a public web table; USP–NF, Absorbable Surgical Suture, has a separate table for collagen. Known
# from 9-0 to 3.
COLLAGEN_SIZES = ("9-0", "8-0", "7-0", "6-0", "5-0", "4-0", "3-0", "2-0", "0", "1", "2", "3")


@dataclass(frozen=True)
class SutureMaterial:
    """A suture material; the `…_source` says where each number comes from."""

    name: str
    braided: bool
    density: float  # [kg/m³]
    density_source: str
    modulus_range: tuple[float, float] | None  # [Pa]
    range_source: str
    modulus: float | None  # the catalogue's choice [Pa]; None if no source gives a modulus
    modulus_source: str
    poisson_ratio: float = POLYMER_POISSON_RATIO
    poisson_source: str = "assumption"
    collagen: bool = False
    absorbable: bool = False
    synonyms: tuple[str, ...] = ()


TEXTBOOK = (
    "assumption: a range about what textbooks compile, not looked up there: Chu, von Fraunhofer & Greisler (eds.), "
    "Wound Closure Biomaterials and Devices, CRC 1997; von Fraunhofer, Storey & Masterson, Biomaterials 1985"
)
BULK = "assumption: the usual density of the bulk material"
NALEWAY = (
    "Naleway, Lear, Kruzic & Maughan, J Biomed Mater Res B 2015;103:735, doi 10.1002/jbm.b.33171, initial moduli of "
    "thirteen 3-0 sutures (abstract read)"
)
NINDHIA = "Nindhia et al., Int J App Pharm 2021;13 S1, doi 10.22159/ijap.2021.v13s1.Y1025 (abstract read)"
PDS = "Polydioxanone (PDS), a novel monofilament, Surg Gynecol Obstet 1981;153:497 (abstract read)"
WITHIN_RANGE = "assumption, within the range"

MATERIALS = (
    SutureMaterial(
        "polypropylene", False, 905.0, BULK, (2.2e9, 6.9e9), TEXTBOOK, 3.0e9,
        f"{WITHIN_RANGE}; five monofilaments have 4.03 GPa in the mean: {NINDHIA}",
        synonyms=("pp",),
    ),
    SutureMaterial(
        "nylon", False, 1140.0, BULK, (1.8e9, 4.5e9), TEXTBOOK, 2.0e9, f"{WITHIN_RANGE}; softer still when wet",
        synonyms=("polyamide", "pa6", "pa66", "nylon 6", "nylon 66"),
    ),
    SutureMaterial(
        "polydioxanone", False, 1360.0, BULK, (1.2e9, 1.7e9), TEXTBOOK, 1.5e9,
        f"{WITHIN_RANGE}; more pliable than polypropylene: {PDS}",
        absorbable=True, synonyms=("pds", "pdo"),
    ),
    SutureMaterial(
        "polyglyconate", False, 1300.0, BULK, (3.0e9, 3.4e9), TEXTBOOK, 3.2e9, WITHIN_RANGE,
        absorbable=True,
    ),
    SutureMaterial(
        "polyester", True, 1380.0, BULK, (1.2e9, 6.5e9), TEXTBOOK, 4.0e9, WITHIN_RANGE,
        synonyms=("pet", "polyethylene terephthalate"),
    ),
    SutureMaterial(
        "silk", True, 1300.0, BULK, (8.4e9, 12.9e9), TEXTBOOK, 8.7e9,
        f"8.701 GPa, the highest of the non-absorbable sutures: {NALEWAY}",
    ),
    SutureMaterial(
        "polyglycolic acid", True, 1530.0, BULK, (7.0e9, 14.0e9), TEXTBOOK, 8.0e9, WITHIN_RANGE,
        absorbable=True, synonyms=("pga", "polyglycolide"),
    ),
    SutureMaterial(
        "polyglactin 910", True, 1500.0, BULK, (7.0e9, 14.0e9), TEXTBOOK, 9.0e9,
        f"{WITHIN_RANGE}; the rapid kind has 9.32 GPa, the highest of the absorbable sutures: {NALEWAY}",
        absorbable=True, synonyms=("polyglactin",),
    ),
    SutureMaterial(
        "catgut", False, 1300.0, BULK, (2.4e9, 2.4e9), TEXTBOOK, 2.4e9, WITHIN_RANGE,
        collagen=True, synonyms=("gut", "collagen"),
    ),
    SutureMaterial(
        "steel", False, 7990.0, BULK, (190e9, 200e9), TEXTBOOK, 193e9, f"{WITHIN_RANGE}; 316L, single wire",
        poisson_ratio=0.3, poisson_source="assumption, the usual value of austenitic steel",
        synonyms=("stainless steel", "316l", "steel 316l"),
    ),
    SutureMaterial(
        "UHMWPE", True, 970.0, BULK, None, "none found", None,
        "none found; it is stiffer than polyester", synonyms=("polyethylene",),
    ),
)  # fmt: skip


MANUAL = "Covidien, product manual of sutures SL5628g (excerpt read)"
TABLE = "a public table of major commercial polymeric sutures (excerpt read)"
LISTS = "public lists of suture brands, which agree (excerpts read)"
# Brand, its material, and the source of the material. The catalogue has no stiffness for a material that is not
# listed above.
BRANDS = (
    ("Prolene", "polypropylene", TABLE),
    ("Surgipro", "polypropylene", MANUAL),
    ("Ethilon", "nylon", TABLE),
    ("Dermalon", "nylon", MANUAL),
    ("Monosof", "nylon", MANUAL),
    ("PDS II", "polydioxanone", LISTS),
    ("PDS Plus", "polydioxanone", LISTS),
    ("Maxon", "polyglyconate", LISTS),
    ("Dexon", "polyglycolic acid", LISTS),
    ("Vicryl", "polyglactin 910", TABLE),
    ("coated Vicryl", "polyglactin 910", TABLE),
    ("Vicryl Plus", "polyglactin 910", LISTS),
    ("Vicryl Rapide", "polyglactin 910", LISTS),
    ("Ethibond", "polyester", LISTS),
    ("Ethibond Excel", "polyester", LISTS),
    ("Mersilene", "polyester", LISTS),
    ("Ti-Cron", "polyester", TABLE),
    ("Surgidac", "polyester", TABLE),
    ("Perma-Hand", "silk", LISTS),
    ("Monocryl", "poliglecaprone 25", LISTS),
    ("Biosyn", "glycomer 631", LISTS),
    ("Caprosyn", "polyglytone 6211", LISTS),
    ("Polysorb", "a braid of glycolide and lactide", LISTS),
    ("Novafil", "polybutester", LISTS),
    ("Surgilon", "braided nylon", MANUAL),
    ("FiberWire", "braided polyethylene", LISTS),
    ("Gore-Tex", "polytetrafluoroethylene", LISTS),
)


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
    """Return the section of a suture named by USP size and material or brand, e.g. "2-0 polypropylene", "Prolene
    2-0".

    Order, case and spaces do not matter, and "2/0" and "USP" are understood. Raises `ThreadError` with the nearest
    names for an unknown suture.
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
    """Return the least average knot-pull strength that the pharmacopoeia requires of a suture [N] (`KNOT_PULL`).

    None means that no source gives a strength: collagen and steel have separate tables. Raises `ThreadError` as
    `suture` does.
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
    """Return the USP number and the key of the material from a name in either order; empty if not found."""
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
