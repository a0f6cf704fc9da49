"""The table of the organ, `[tissue]`: mesh, boundaries, regions, material and loads; and `[[contact]]`."""

from abc import abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field

from studies.scenario.course import Timed
from studies.scenario.refusal import as_key, as_toml, because, hint_at, refusal
from studies.scenario.table import ScenarioTable, repetition
from studies.scenario.values import Flag, NotNegative, Number, Positive, Series, Text, Vector, one_sentence

BLOCK_BOUNDARIES = ("left", "right", "front", "back", "bottom", "top")
LIPS = ("lip_left", "lip_right")  # of a wound
BOUNDARIES = {  # the names in a generated mesh, by its kind
    "block": BLOCK_BOUNDARIES,
    "wound": (*BLOCK_BOUNDARIES, *LIPS),
    "cylinder": ("left", "right", "side"),
    "tube": ("left", "right", "inner", "outer"),
}
STUMPS = ("stump_left", "stump_right")  # of a tube that is cut
FLOOR = "wound_floor"  # of an ellipse that does not cut through
SURFACES = (".stl", ".obj", ".ply", ".vtp")  # files with a closed surface to be filled; some .vtk files too
ACCURACY = 0.03  # of a hole's compliance: tissue data are less accurate, and half of this takes 1.2 times the cells
Accuracy = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=1e-3, le=0.5)]
PoissonRatio = Annotated[float, Field(strict=True, allow_inf_nan=False, gt=-1, lt=0.5)]
Growth = Annotated[float, Field(strict=True, allow_inf_nan=False, gt=1, le=3)]
Unit = Literal["m", "dm", "cm", "mm", "um"]
Law = Literal["linear", "neo-hookean", "exponential"]
FAMILIES = 2  # largest number of fibre families at one place
HEAD = 1024  # bytes of a .vtk file that name its content


# --- organ ------------------------------------------------------------------------------------------------


class _Mesh(ScenarioTable):
    """A mesh whose cells at the piercings can be refined."""

    accuracy: Annotated[Literal["given"] | Accuracy, one_sentence("allowed-accuracy")] = ACCURACY
    bound: Flag = False


class _Sized(_Mesh):
    """A generated mesh.

    It has a size far from the piercings and optionally another size at the piercings.
    """

    h: Positive
    h_site: Positive | None = None
    growth: Growth = 1.3

    @property
    @abstractmethod
    def longest(self) -> float:
        """The longest side of the meshed body [m]."""

    def _check_sizes(self) -> None:
        self._refuse(self.h > self.longest, "h.long")
        self._refuse(self.h_site is not None and self.h_site > self.h, "h_site.long")


class _Block(_Sized):
    """Block centred in x and y with its top face at z = 0."""

    size: tuple[Positive, Positive, Positive]
    generator: Literal["structured", "gmsh"] = "structured"

    @property
    def longest(self) -> float:
        return max(self.size)

    @classmethod
    def chosen(cls, data: Mapping[str, Any]) -> dict[str, Any]:
        graded = data.get("h_site") is not None or data.get("shape") == "ellipse"
        return {"generator": "gmsh"} if graded else {}


class BlockMesh(_Block):
    """Block centred in x and y with its top face at z = 0."""

    kind: Literal["block"]


class WoundMesh(_Block):
    """Block with a wound cut down from the middle of its top.

    Boundaries: all boundaries of the block, lip_left, lip_right, and wound_floor for an ellipse
    that does not cut through.
    """

    kind: Literal["wound"]
    shape: Literal["slit", "ellipse"] = "slit"
    along: Literal["x", "y"] = "y"
    length: Positive
    width: NotNegative = 0.0
    depth: Positive

    def _check_shape(self) -> None:
        closed = self.shape == "slit"
        self._refuse(closed and self.width, "width.slit")
        self._refuse(not closed and not self.width, "width.ellipse")
        self._refuse(not closed and self.generator == "structured", "generator.ellipse")

    def _check_fits(self) -> None:
        across, along = self.size[:2] if self.along == "y" else self.size[1::-1]
        self._refuse(self.depth > self.size[2], "depth.high")
        through = self.length > along or (self.width and self.length == along)
        self._refuse(through, "length.long", along=along)
        self._refuse(self.width >= across, "width.wide", across=across)


class CylinderMesh(_Sized):
    """Cylinder about the x axis, centred at the origin; boundaries left, side, right."""

    kind: Literal["cylinder"]
    radius: Positive
    length: Positive

    @property
    def longest(self) -> float:
        return max(self.length, 2.0 * self.radius)


class TubeMesh(_Sized):
    """Tube about the x axis, centred at the origin; boundaries left, right, inner, outer.

    A tube cut in the middle is two stumps, two separate bodies; the cut faces are stump_left and
    stump_right.
    """

    kind: Literal["tube"]
    radius: Positive
    wall: Positive
    length: Positive
    gap: NotNegative | None = None

    @property
    def longest(self) -> float:
        return max(self.length, 2.0 * self.radius)

    def _check_wall(self) -> None:
        self._refuse(self.wall >= self.radius, "wall.thick")
        self._refuse(self.gap is not None and self.gap >= self.length, "gap.long")


class FileMesh(_Mesh):
    """Volume mesh read from a file, or closed surface that is filled."""

    kind: Literal["file"]
    path: Text
    unit: Annotated[Unit | Positive, one_sentence("allowed-unit")] = "m"
    h: Positive | None = None
    h_site: Positive | None = None
    growth: Growth = 1.3

    @property
    def is_surface(self) -> bool:
        """Whether the file holds a surface to be filled."""
        path = Path(self.path)
        if path.suffix.lower() != ".vtk" or not path.is_file():
            return path.suffix.lower() in SURFACES
        with path.open("rb") as file:
            return b"POLYDATA" in file.read(HEAD).upper()

    def _check_sizes(self) -> None:
        self._refuse(self.is_surface and self.h is None, "h.missing")
        for key in ("h", "h_site"):
            solid = not self.is_surface and getattr(self, key) is not None
            self._refuse(solid, f"{key}.solid", surfaces=", ".join(SURFACES))
        self._refuse(self.h is not None and self.h_site is not None and self.h_site > self.h, "h_site.long")


class GivenMesh(_Mesh):
    """Volume mesh given from Python, by `prepare(scenario, mesh=…)`."""

    kind: Literal["given"]
    sha256: Text | None = None


Mesh = Annotated[BlockMesh | WoundMesh | CylinderMesh | TubeMesh | FileMesh | GivenMesh, Field(discriminator="kind")]


def check_box(box: tuple[Vector, Vector]) -> None:
    """Refuse a box without a volume."""
    if any(low == high for low, high in zip(*box, strict=True)):
        reason = "its corners must differ in x, y and z; give two opposite corners"
        raise ValueError(f".box = {as_toml(box)} is refused: {reason}")


class Load(Timed):
    """Force per area on a boundary of the organ."""

    boundary: Text
    traction: Vector | None = None
    pressure: Number | None = None
    ramp: NotNegative = 0.0

    def _check_kind(self) -> None:
        self._refuse(self.traction is not None and self.pressure is not None, "pressure.traction")
        self._refuse(self.traction is None and self.pressure is None, "traction.missing")


class Fibre(ScenarioTable):
    """Family of fibres that carry tension only."""

    direction: Vector
    k1: NotNegative
    k2: Positive

    def _check_direction(self) -> None:
        self._refuse(not any(self.direction), "direction.zero")


class MaterialKeys(ScenarioTable):
    """Keys of a material at finite strain."""

    stiffening: Positive | None = None
    fibres: Annotated[tuple[Fibre, ...], Field(max_length=FAMILIES)] | None = None
    prestretch: tuple[Positive, Positive, Positive] | None = None


def material_fault(material: Law, keys: MaterialKeys, stiffening: float | None) -> str | None:
    """Return the fault in the keys of a material, or None; `stiffening` is its effective value."""
    values = keys.model_dump(include=set(MaterialKeys.model_fields), exclude_none=True)
    if material == "linear" and values:
        key, value = next(iter(values.items()))
        return f"{key} = {as_toml(value)} is refused: {because('material-linear')}"
    if material == "neo-hookean" and "stiffening" in values:
        return refusal("stiffening", keys.stiffening, because("material-neo-hookean"))
    if material == "exponential" and stiffening is None:
        return f"stiffening is missing: {because('material-exponential')}"
    return None


class Boundary(ScenarioTable):
    """Named set of the surface facets whose centre lies in a box."""

    name: Text
    box: tuple[Vector, Vector]

    def _check_box(self) -> None:
        check_box(self.box)


class Contact(ScenarioTable):
    """Contact between two boundaries of the organ: nodes of one boundary, facets of the other."""

    between: tuple[Text, Text]
    friction: Annotated[NotNegative, one_sentence("allowed-contact")] = 0.0

    def _check(self) -> None:
        self._refuse(self.between[0] == self.between[1], "between.one")


class Region(MaterialKeys):
    """Part of the organ with its own material; the default of a key is the organ's value.

    A later region overrides an earlier one.
    """

    name: Text
    box: tuple[Vector, Vector] | None = None
    depth: tuple[NotNegative, NotNegative] | None = None
    youngs_modulus: Positive | None = None
    poisson_ratio: PoissonRatio | None = None
    density: Positive | None = None
    strength: Positive | None = None
    material: Law | None = None
    relaxation: Series | None = None

    def _check_place(self) -> None:
        self._refuse(self.box is not None and self.depth is not None, "depth.box")
        self._refuse(self.depth is not None and self.depth[0] >= self.depth[1], "depth.order")
        if self.box is not None:
            check_box(self.box)


class Tissue(MaterialKeys):
    """Organ of a linear material at small strain, or of a hyperelastic material."""

    youngs_modulus: Positive
    poisson_ratio: PoissonRatio
    density: Positive
    strength: Positive | None = None
    material: Law = "linear"
    relaxation: Series = ()
    element: Literal["P1", "P2"] = "P2"
    dilatation: Literal["auto", "cell", "mean", "nodal"] = "auto"
    inertia: Flag = True
    solver: Literal["auto", "superlu", "cholmod", "pardiso", "multigrid"] = "auto"
    rayleigh: tuple[NotNegative, NotNegative] = (0.0, 0.0)
    clamp: tuple[Text, ...] = ()
    roller: tuple[Text, ...] = ()
    contact: Flag = False
    mesh: Mesh
    boundary: tuple[Boundary, ...] = ()
    region: tuple[Region, ...] = ()
    load: tuple[Load, ...] = ()

    @classmethod
    def chosen(cls, data: Mapping[str, Any]) -> dict[str, Any]:
        mesh = data.get("mesh")
        return {"element": "P1"} if isinstance(mesh, Mapping) and mesh.get("accuracy") == "given" else {}

    @property
    def boundaries(self) -> tuple[str, ...]:
        """Names of the known boundaries, those of the mesh first.

        They are empty if only the file has them.
        """
        there = boundaries_of(self.mesh)
        return (*there, *(boundary.name for boundary in self.boundary)) if there else ()

    def _check_boundaries(self) -> None:
        own = [boundary.name for boundary in self.boundary]
        self._report(repetition("boundary", own))
        self._report(taken_boundary(own, boundaries_of(self.mesh), self.mesh.kind))
        for key in ("clamp", "roller") if self.boundaries else ():
            self._report(unknown_clamp(getattr(self, key), self.boundaries, key))

    def _check_loads(self) -> None:
        self._report(idle_load(self.load, self.boundaries or None, self.clamp, self.roller))

    def _check_material(self) -> None:
        self._report(material_fault(self.material, self, self.stiffening))
        linear = self.material == "linear"
        remedy = 'give tissue.material, for example "neo-hookean"' if linear else 'use "neo-hookean"'
        for region in self.region:
            own, key = region.material or self.material, f"region.{as_key(region.name)}"
            mixed = (own == "linear") != linear
            self._refuse(mixed, "region.material", (f"{key}.material", own), remedy=remedy)
            fault = material_fault(own, region, region.stiffening or self.stiffening)
            self._report(fault and f"{key}.{fault}")
        self._refuse(not linear and self.rayleigh[1], "rayleigh.finite")

    @property
    def relaxes(self) -> bool:
        """Whether stress relaxes anywhere in the organ."""
        return bool(self.relaxation) or any(region.relaxation for region in self.region)

    def _check_cells(self) -> None:
        self._refuse((self.element, self.dilatation) == ("P1", "mean"), "dilatation.mean")
        self._refuse(self.mesh.bound and self.material != "linear", "mesh.bound.finite")

    def _check_lips(self) -> None:
        self._refuse(self.contact and self.mesh.kind != "wound", "contact.lips")

    def _check_regions(self) -> None:
        self._report(repetition("region", [region.name for region in self.region]))
        height = self.mesh.size[2] if isinstance(self.mesh, _Block) else 0.0
        for region in self.region:
            key = f"region.{as_key(region.name)}"
            if region.depth is not None:
                shown = f"{key}.depth", region.depth
                self._refuse(not height, "region.depth.top", shown)
                self._refuse(region.depth[1] > height, "region.depth.high", shown, height=height)
            elif region.box is None:
                self._refuse(self.mesh.kind not in ("file", "given"), "region.place", (key, None))


def boundaries_of(mesh: Mesh) -> tuple[str, ...]:
    """Return the names of the boundaries of a mesh; empty if only the file has them."""
    floor = isinstance(mesh, WoundMesh) and mesh.shape == "ellipse" and mesh.depth < mesh.size[2]
    cut = isinstance(mesh, TubeMesh) and mesh.gap is not None
    return BOUNDARIES.get(mesh.kind, ()) + ((FLOOR,) if floor else ()) + (STUMPS if cut else ())


# --- faults that the simulation also looks for, with the names of the boundaries of a file ---------------


def taken_boundary(own: Iterable[str], there: Sequence[str], kind: str) -> str | None:
    """Return the fault in the names of a scenario's additional boundaries, or None."""
    name = next((name for name in own if name in there), None)
    return name and f"boundary.{as_key(name)} is refused: the {kind} already has a {name}; rename it"


def unknown_clamp(clamp: Iterable[str], boundaries: Sequence[str], key: str) -> str | None:
    """Return the fault in the boundaries that a clamp or another `key` names, or None."""
    unknown = next((name for name in clamp if name not in boundaries), None)
    return None if unknown is None else refusal(key, [unknown], no_boundary(unknown, boundaries))


def no_boundary(name: str, boundaries: Sequence[str]) -> str:
    """Return the sentence that a boundary does not exist, with the names of all boundaries."""
    otherwise = "; add it as [[tissue.boundary]], or name it in the mesh"
    hint = hint_at(name, boundaries, '; the nearest is "{}"') or otherwise
    there = ", ".join(boundaries) or "none"
    return f"there is no such boundary; the boundaries are {there}{hint}"


def idle_load(
    loads: Iterable[Load], boundaries: Sequence[str] | None, clamp: Sequence[str], roller: Sequence[str]
) -> str | None:
    """Return the fault in the boundary of a load, or None.

    `boundaries` are the known boundaries, or None if only the file has them.
    """
    for number, load in enumerate(loads):
        name, reason = load.boundary, ""
        if boundaries is not None and name not in boundaries:
            reason = no_boundary(name, boundaries)
        elif name in clamp:
            reason = because("load-clamped")
        elif name in roller and load.pressure is not None:
            reason = because("load-on-roller")
        if reason:
            return refusal(f"load.{number}.boundary", name, reason)
    return None


# --- faults in the names of a scenario that is not yet valid ---------------------------------------------
# Whether a name is known does not depend on refused numbers. So unknown and repeated names are reported together with
# refused values, and not only after these are corrected.


def name_faults(data: Mapping[str, Any]) -> list[str]:
    """Describe the unknown, taken and repeated names in plain tables, one sentence each."""
    tissue = _table(data.get("tissue"))
    twice = [repetition(key, _names(data.get(key))) for key in ("piercing", "tie")]
    twice += [repetition(f"tissue.{key}", _names(tissue.get(key))) for key in ("boundary", "region")]
    return [fault for fault in (*twice, *_boundary_faults(tissue)) if fault]


def _boundary_faults(tissue: Mapping[str, Any]) -> list[str | None]:
    """Describe boundaries that a generated mesh lacks or already has.

    Boundaries of a file are not known here.
    """
    mesh = _table(tissue.get("mesh"))
    there = BOUNDARIES.get(str(mesh.get("kind")), ())
    if not there:
        return []
    there = (*there, FLOOR) if mesh.get("shape") == "ellipse" else there
    there = (*there, *STUMPS) if mesh["kind"] == "tube" and "gap" in mesh else there
    own = _names(tissue.get("boundary"))
    repeated = taken_boundary(own, there, str(mesh["kind"]))
    unknown = [unknown_clamp(_words(tissue.get(key)), [*there, *own], key) for key in ("clamp", "roller")]
    return [fault and f"tissue.{fault}" for fault in (repeated, *unknown)]


def _table(value: Any) -> Mapping[str, Any]:
    return value if isinstance(value, Mapping) else {}


def _words(value: Any) -> list[str]:
    return [word for word in value if isinstance(word, str) and word] if isinstance(value, list | tuple) else []


def _names(value: Any) -> list[str]:
    """Return the names of a list of tables."""
    tables = value if isinstance(value, list | tuple) else ()
    return _words([_table(item).get("name") for item in tables])
