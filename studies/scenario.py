"""The scenario: one TOML file, validated in full before anything is computed.

The models below are the contract; each field says its unit in brackets. SI units throughout; the mesh file's
own unit is the only exception.

``load`` reads a file (with ``--set`` overrides), ``dump`` writes a scenario with every default, ``schema``
gives the JSON schema.
"""

import tomllib
from collections.abc import Callable, Iterable, Mapping, Sequence
from itertools import combinations, pairwise
from math import dist, inf
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError, WrapValidator, model_validator

from studies.refusal import BARE, as_key, as_toml, dotted, nearest, refused, sentences

ALLOWED_START_ERROR = 1e-6  # distance of a driven end's first waypoint from the path's end, over the path's length
INLINE = ("start", "end", "friction")  # tables written on one line
BLOCK_BOUNDARIES = ("left", "right", "front", "back", "bottom", "top")
BOUNDARIES = {  # that a generated mesh names, by its kind
    "block": BLOCK_BOUNDARIES,
    "wound": (*BLOCK_BOUNDARIES, "lip_left", "lip_right"),
    "cylinder": ("left", "right", "side"),
    "tube": ("left", "right", "inner", "outer"),
}
SURFACES = (".stl", ".obj", ".ply")  # files that hold a closed surface, to be filled

Number = Annotated[float, Field(strict=True, allow_inf_nan=False)]
Positive = Annotated[float, Field(strict=True, allow_inf_nan=False, gt=0)]
NotNegative = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=0)]
Text = Annotated[str, Field(strict=True, min_length=1, pattern=r"^[^\x00-\x1f\x7f]+$")]
Whole = Annotated[int, Field(strict=True, ge=1)]
Vector = tuple[Number, Number, Number]
Growth = Annotated[float, Field(strict=True, allow_inf_nan=False, gt=1, le=3)]
GROWTH = "ratio of the sizes of neighbouring elements [-], above 1 to 3: the size grows by ln(growth) per distance"
Waypoint = tuple[Number, Number, Number, Number]
Turn = tuple[Number, Number]


class ScenarioError(ValueError):
    """A scenario that is refused; ``problems`` holds one sentence for each fault."""

    def __init__(self, problems: str | Sequence[str]) -> None:
        self.problems = (problems,) if isinstance(problems, str) else tuple(problems)
        super().__init__("\n".join(self.problems))


def _or(allowed: str) -> WrapValidator:
    """One sentence instead of one for each member of a union."""

    def validate(value: Any, handler: Callable[[Any], Any]) -> Any:
        try:
            return handler(value)
        except ValidationError:
            raise ValueError(f" = {as_toml(value)} is refused: allowed are {allowed}") from None

    return WrapValidator(validate)


class Table(BaseModel):
    """A table of the scenario: frozen, no unknown keys."""

    model_config = ConfigDict(frozen=True, extra="forbid", populate_by_name=False)


# --- organ ------------------------------------------------------------------------------------------------


class _Sized(Table):
    """A mesh that is generated, with a size far from the piercings and perhaps another at them."""

    h: Positive = Field(description="mesh size far from the piercings [m]", examples=[4.0e-3])
    h_site: Positive | None = Field(
        default=None, description="mesh size at the piercings [m]; default: uniform", examples=[0.5e-3]
    )
    growth: Growth = Field(default=1.3, description=GROWTH)

    @model_validator(mode="after")
    def _check_sizes(self) -> Self:
        if self.h_site is not None and self.h_site > self.h:
            raise ValueError(f".h_site = {self.h_site} is refused: it must not exceed h = {self.h}; make it smaller")
        return self


class _Block(_Sized):
    """Block centred in x and y with its top face at z = 0."""

    size: tuple[Positive, Positive, Positive] = Field(
        description="lengths of the block along x, y, z [m]", examples=[[0.06, 0.04, 0.02]]
    )
    generator: Literal["structured", "gmsh"] = Field(
        default="structured",
        description='mesh generator; default "gmsh" when h_site is given, else "structured"',
    )

    @model_validator(mode="before")
    @classmethod
    def _choose_generator(cls, data: Any) -> Any:
        if isinstance(data, Mapping) and "generator" not in data and data.get("h_site") is not None:
            return {**data, "generator": "gmsh"}
        return data


class BlockMesh(_Block):
    """Block centred in x and y with its top face at z = 0."""

    kind: Literal["block"]


class WoundMesh(_Block):
    """Block with a wound cut down from the middle of its top; boundaries as the block's, lip_left, lip_right and in an
    ellipse that does not go through wound_floor.
    """

    kind: Literal["wound"]
    shape: Literal["slit", "ellipse"] = Field(
        default="slit", description='"slit": closed, its two lips at one place; "ellipse": open, with upright walls'
    )
    along: Literal["x", "y"] = Field(
        default="y", description="axis that the wound runs along; the left lip is that at lower x, or lower y"
    )
    length: Positive = Field(description="length of the wound [m]", examples=[0.02])
    width: NotNegative = Field(default=0.0, description="widest opening of an ellipse [m]; 0 for a slit")
    depth: Positive = Field(description="depth of the wound [m]; that of the block cuts through", examples=[0.008])

    @model_validator(mode="before")
    @classmethod
    def _choose_gmsh(cls, data: Any) -> Any:
        if isinstance(data, Mapping) and "generator" not in data and data.get("shape") == "ellipse":
            return {**data, "generator": "gmsh"}
        return data

    @model_validator(mode="after")
    def _check_shape(self) -> Self:
        if self.shape == "slit" and self.width:
            raise ValueError(f'.width = {self.width} is refused: a slit is closed; take 0, or shape = "ellipse"')
        if self.shape == "ellipse" and not self.width:
            raise ValueError('.width = 0.0 is refused: an ellipse is open; give its width, or shape = "slit"')
        if self.shape == "ellipse" and self.generator == "structured":
            raise ValueError('.generator = "structured" is refused: an ellipse needs generator = "gmsh"')
        return self

    @model_validator(mode="after")
    def _check_fits(self) -> Self:
        across, along = self.size[:2] if self.along == "y" else self.size[1::-1]
        if self.depth > self.size[2]:
            raise ValueError(f".depth = {self.depth} is refused: the block is {self.size[2]} m high; lower it")
        if self.length > along or (self.width and self.length == along):
            raise ValueError(f".length = {self.length} is refused: the block is {along} m long there; shorten it")
        if self.width >= across:
            raise ValueError(f".width = {self.width} is refused: the block is {across} m wide there; lower it")
        return self


class CylinderMesh(_Sized):
    """Cylinder about the x axis, centred at the origin; boundaries left, side, right."""

    kind: Literal["cylinder"]
    radius: Positive = Field(description="radius of the cylinder [m]", examples=[0.02])
    length: Positive = Field(description="length of the cylinder [m]", examples=[0.05])


class TubeMesh(_Sized):
    """Tube about the x axis, centred at the origin; boundaries left, right, inner, outer."""

    kind: Literal["tube"]
    radius: Positive = Field(description="outer radius of the tube [m]", examples=[0.01])
    wall: Positive = Field(description="thickness of the wall [m], below the radius", examples=[0.002])
    length: Positive = Field(description="length of the tube [m]", examples=[0.05])

    @model_validator(mode="after")
    def _check_wall(self) -> Self:
        if self.wall >= self.radius:
            raise ValueError(f".wall = {self.wall} is refused: it must be below radius = {self.radius}; lower it")
        return self


class FileMesh(Table):
    """Volume mesh read from a file, or closed surface that is filled."""

    kind: Literal["file"]
    path: Text = Field(
        description="mesh file (.msh, .vtk, .vtu) or closed surface to be filled (.stl, .obj, .ply), relative to the "
        "scenario file",
        examples=["liver.msh"],
    )
    unit: Annotated[
        Literal["m", "dm", "cm", "mm", "um"] | Positive,
        _or('"m", "dm", "cm", "mm", "um" or the number of metres per file unit, for example unit = "mm"'),
    ] = Field(default="m", description="length unit of the file: a name, or metres per file unit")
    h: Positive | None = Field(
        default=None, description="mesh size far from the piercings, of a surface to be filled [m]", examples=[4.0e-3]
    )
    h_site: Positive | None = Field(
        default=None, description="mesh size at the piercings, of a surface to be filled [m]; default: uniform"
    )
    growth: Growth = Field(default=1.3, description=GROWTH)

    @property
    def is_surface(self) -> bool:
        """Whether the file holds a surface to be filled."""
        return Path(self.path).suffix.lower() in SURFACES

    @model_validator(mode="after")
    def _check_sizes(self) -> Self:
        if self.is_surface and self.h is None:
            raise ValueError(".h is missing: a surface is filled with tetrahedra of this size; write h = 4e-3 [m]")
        given = next((key for key in ("h", "h_site") if getattr(self, key) is not None), None)
        if given and not self.is_surface:
            raise ValueError(
                f".{given} = {getattr(self, given)} is refused: the file holds the tetrahedra already; leave it out, "
                f"or give a surface ({', '.join(SURFACES)})"
            )
        if self.h is not None and self.h_site is not None and self.h_site > self.h:
            raise ValueError(f".h_site = {self.h_site} is refused: it must not exceed h = {self.h}; make it smaller")
        return self


Mesh = Annotated[BlockMesh | WoundMesh | CylinderMesh | TubeMesh | FileMesh, Field(discriminator="kind")]


class Boundary(Table):
    """Named set of the surface facets whose centre lies in a box."""

    name: Text = Field(description="name of the boundary", examples=["bed"])
    box: tuple[Vector, Vector] = Field(
        description="two opposite corners [m]; the surface facets whose centre is inside",
        examples=[[[-0.1, -0.1, -0.1], [0.1, 0.1, -0.015]]],
    )

    @model_validator(mode="after")
    def _check_box(self) -> Self:
        if any(low == high for low, high in zip(*self.box, strict=True)):
            raise ValueError(
                f".box = {as_toml(self.box)} is refused: its corners must differ in x, y and z; "
                "give two opposite corners"
            )
        return self


class Region(Table):
    """Part of the organ with a material of its own; what is not given is the organ's. A later region overrides an
    earlier one.
    """

    name: Text = Field(description="name of the region; without box and depth that of a volume in the mesh file")
    box: tuple[Vector, Vector] | None = Field(
        default=None, description="two opposite corners [m]; the cells whose centre is inside"
    )
    depth: tuple[NotNegative, NotNegative] | None = Field(
        default=None, description="layer of a block or wound, from and to, below its top [m]", examples=[[0.0, 2.0e-3]]
    )
    youngs_modulus: Positive | None = Field(default=None, description="Young's modulus [Pa]; default the organ's")
    poisson_ratio: Annotated[float, Field(strict=True, allow_inf_nan=False, gt=-1, lt=0.5)] | None = Field(
        default=None, description="Poisson's ratio [-], between -1 and 0.5; default the organ's"
    )
    density: Positive | None = Field(default=None, description="density [kg/m³]; default the organ's")

    @model_validator(mode="after")
    def _check_place(self) -> Self:
        if self.box is not None and self.depth is not None:
            raise ValueError(".depth is refused: box places the region already; leave one of them out")
        if self.depth is not None and self.depth[0] >= self.depth[1]:
            raise ValueError(f".depth = {as_toml(self.depth)} is refused: it must grow, for example [0, 2e-3]")
        if self.box is not None and any(low == high for low, high in zip(*self.box, strict=True)):
            raise ValueError(
                f".box = {as_toml(self.box)} is refused: its corners must differ in x, y and z; "
                "give two opposite corners"
            )
        return self


class Tissue(Table):
    """Organ of small-strain isotropic linear elasticity."""

    youngs_modulus: Positive = Field(description="Young's modulus of the tissue [Pa]", examples=[1.0e5])
    poisson_ratio: Annotated[float, Field(strict=True, allow_inf_nan=False, gt=-1, lt=0.5)] = Field(
        description="Poisson's ratio of the tissue [-], between -1 and 0.5", examples=[0.45]
    )
    density: Positive = Field(description="density of the tissue [kg/m³]", examples=[1070.0])
    element: Literal["P1", "P2"] = Field(default="P1", description="tetrahedral element, linear or quadratic")
    dilatation: Literal["auto", "cell", "nodal"] = Field(
        default="auto",
        description="where the volume is held to change as ν says: in each cell, which locks as ν nears 0.5, or nodal, "
        "averaged at the vertices; auto: nodal above ν = 0.45",
    )
    inertia: Annotated[bool, Field(strict=True)] = Field(
        default=True, description="whether the organ has inertia; false: quasi-static organ"
    )
    solver: Literal["auto", "superlu", "cholmod", "pardiso", "multigrid"] = Field(
        default="auto",
        description='what solves the organ: "auto" (by size, memory and what is installed), or "superlu", "cholmod" '
        '(needs cvxopt), "pardiso" (needs pypardiso), "multigrid"',
    )
    rayleigh: tuple[NotNegative, NotNegative] = Field(
        default=(0.0, 0.0), description="Rayleigh damping α [1/s] of the mass and β [s] of the stiffness"
    )
    clamp: tuple[Text, ...] = Field(default=(), description="names of the boundaries held fixed", examples=[["bottom"]])
    roller: tuple[Text, ...] = Field(
        default=(),
        description="names of the plane boundaries, each across x, y or z, that are held across themselves alone: what "
        "slides on a bed, or a plane of symmetry",
        examples=[["bottom"]],
    )
    contact: Annotated[bool, Field(strict=True)] = Field(
        default=False, description="whether the lips of a wound press on one another where they meet; else they cross"
    )
    mesh: Mesh = Field(
        description="the organ's mesh", examples=[{"kind": "block", "size": [0.06, 0.04, 0.02], "h": 4.0e-3}]
    )
    boundary: tuple[Boundary, ...] = Field(
        default=(), description="boundaries beside those the mesh names", examples=[[]]
    )
    region: tuple[Region, ...] = Field(default=(), description="parts of another material", examples=[[]])

    @model_validator(mode="after")
    def _check_boundaries(self) -> Self:
        own = [boundary.name for boundary in self.boundary]
        if problem := _repeated("boundary", own):
            raise ValueError(f".{problem}")
        there = boundaries_of(self.mesh)
        if taken := next((name for name in own if name in there), None):
            raise ValueError(
                f".boundary.{as_key(taken)} is refused: the {self.mesh.kind} has a {taken} already; rename it"
            )
        for key in ("clamp", "roller"):
            if there and (problem := unknown_clamp(getattr(self, key), [*there, *own], key)):
                raise ValueError(f".{problem}")
        return self

    @model_validator(mode="after")
    def _check_lips(self) -> Self:
        if self.contact and self.mesh.kind != "wound":
            raise ValueError(
                f".contact = true is refused: tissue.mesh.kind is {self.mesh.kind}, which has no lips; leave it out or "
                'take kind = "wound"'
            )
        return self

    @model_validator(mode="after")
    def _check_regions(self) -> Self:
        if problem := _repeated("region", [region.name for region in self.region]):
            raise ValueError(f".{problem}")
        for region in self.region:
            key = f".region.{as_key(region.name)}"
            height = self.mesh.size[2] if isinstance(self.mesh, _Block) else 0.0
            if region.depth is not None and not height:
                raise ValueError(f"{key}.depth is refused: a {self.mesh.kind} has no flat top; give a box")
            if region.depth is not None and region.depth[1] > height:
                raise ValueError(
                    f"{key}.depth = {as_toml(region.depth)} is refused: the block is {height} m high; lower it"
                )
            if region.depth is None and region.box is None and self.mesh.kind != "file":
                raise ValueError(f"{key} is refused: only a mesh file names regions; give depth or a box")
        return self


def boundaries_of(mesh: Mesh) -> tuple[str, ...]:
    """The boundaries that a mesh will name; none where only the file tells."""
    floor = isinstance(mesh, WoundMesh) and mesh.shape == "ellipse" and mesh.depth < mesh.size[2]
    return BOUNDARIES.get(mesh.kind, ()) + (("wound_floor",) if floor else ())


# --- thread -----------------------------------------------------------------------------------------------


class _End(Table):
    mass: NotNegative = Field(default=0.0, description="point mass carried by this end of the thread [kg]")


class FreeEnd(_End):
    """End on which nothing acts."""

    kind: Literal["free"]


class _HeldEnd(_End):
    turn: Annotated[tuple[Turn, ...], Field(min_length=1)] | None = Field(
        default=None,
        description="rows of t [s], angle [rad] by which the end is turned about the thread's tangent, right-handed "
        "towards the end of the path, t increasing, angle 0 at t = 0; needs thread.twist; default: a clamped end does "
        "not turn, any other turns freely",
        examples=[[[0.0, 0.0], [1.0, 6.28]]],
    )

    @model_validator(mode="after")
    def _check_turn(self) -> Self:
        rows = self.turn or ()
        for row, ((before, _), (after, _)) in enumerate(pairwise(rows), start=1):
            if after <= before:
                raise ValueError(
                    f".turn.{row} = {as_toml(rows[row])} is refused: "
                    f"its time must be later than {before} s, the one before it; sort them by time"
                )
        if rows and (start := float(np.interp(0.0, *np.transpose(rows)))) != 0.0:
            raise ValueError(f".turn is refused: at t = 0 its angle is {start:.3g} rad; let it begin at [0, 0]")
        return self


class FixedEnd(_HeldEnd):
    """End whose position is held."""

    kind: Literal["fixed"]


class ClampedEnd(_HeldEnd):
    """End whose position and tangent are held, and with twist its section."""

    kind: Literal["clamped"]


class PulledEnd(_End):
    """End under a dead load."""

    kind: Literal["pulled"]
    force: Vector = Field(description="dead load on the end [N]", examples=[[0, 0, 1.0e-2]])
    ramp: NotNegative = Field(default=0.0, description="time in which the load grows linearly from zero [s]")


class DrivenEnd(_HeldEnd):
    """End that follows waypoints, linearly in between; it rests before the first and after the last."""

    kind: Literal["driven"]
    waypoints: Annotated[tuple[Waypoint, ...], Field(min_length=1)] = Field(
        description="rows of t [s], x, y, z [m], t increasing",
        examples=[[[0.0, 0.03, 0, 0.01], [1.0, 0.05, 0, 0.03]]],
    )

    @model_validator(mode="after")
    def _check_times(self) -> Self:
        for row, ((before, *_), (after, *_)) in enumerate(pairwise(self.waypoints), start=1):
            if after <= before:
                raise ValueError(
                    f".waypoints.{row} = {as_toml(self.waypoints[row])} is refused: "
                    f"its time must be later than {before} s, the one before it; sort them by time"
                )
        return self

    def position(self, time: float) -> Vector:
        """Position (3,) [m] at a time [s]."""
        table = np.array(self.waypoints)
        x, y, z = (float(np.interp(time, table[:, 0], column)) for column in table[:, 1:].T)
        return x, y, z


End = Annotated[FreeEnd | FixedEnd | ClampedEnd | PulledEnd | DrivenEnd, Field(discriminator="kind")]


class Thread(Table):
    """Suture thread laid along a path."""

    suture: Text | None = Field(
        default=None,
        description="USP size and material from the catalogue; instead of diameter, youngs_modulus, density",
        examples=["2-0 polypropylene"],
    )
    diameter: Positive | None = Field(default=None, description="diameter of the thread [m]", examples=[3.2e-4])
    youngs_modulus: Positive | None = Field(
        default=None, description="Young's modulus of the thread [Pa]", examples=[2.0e9]
    )
    density: Positive | None = Field(default=None, description="density of the thread [kg/m³]", examples=[910.0])
    poisson_ratio: Annotated[float, Field(strict=True, allow_inf_nan=False, gt=-1, le=0.5)] | None = Field(
        default=None,
        description="Poisson's ratio of the thread [-], from above -1 to 0.5; default 0.4",
        examples=[0.4],
    )
    bending_factor: Annotated[float, Field(strict=True, allow_inf_nan=False, gt=0, le=1)] | None = Field(
        default=None,
        description="bending and torsional stiffness over that of a solid rod [-], above 0 to 1; default: that of the "
        "suture (an assumption for braids), else 1",
        examples=[0.05],
    )
    control_points: Annotated[int, Field(strict=True, ge=4, le=5000)] = Field(
        default=40, description="number of control points of the cubic spline [-], from 4 to 5000"
    )
    graded: Annotated[float, Field(strict=True, allow_inf_nan=False, ge=1)] = Field(
        default=3.0,
        description="ratio of the largest to the smallest knot span [-], fine near the piercings; 1: uniform",
    )
    resolution: Literal["fixed", "adaptive"] = Field(
        default="fixed",
        description="whether the knots stay, or follow the piercings as the thread slides: control_points are then "
        "those of the coarse spline, which is refined beside the piercings and where the thread bends",
    )
    tolerance: Annotated[float, Field(strict=True, allow_inf_nan=False, gt=0, le=0.1)] = Field(
        default=0.01, description="relative error of the piercings' forces that adaptive knots aim at [-], up to 0.1"
    )
    path: Annotated[tuple[Vector, ...], Field(min_length=2)] = Field(
        description="points along which the thread is laid at the start [m], corners rounded",
        examples=[[[-0.03, 0, 0.01], [-0.01, 0, 0], [0.01, 0, 0], [0.03, 0, 0.01]]],
    )
    cuts: tuple[Positive, ...] = Field(
        default=(),
        description="abscissae where the thread is cut from the start, rising [m]: the pieces share nothing, and the "
        "new ends are free",
        examples=[[0.05, 0.1]],
    )
    length: Positive | None = Field(
        default=None,
        description="rest length of the thread [m]; default: that of the path",
        examples=[0.0483],
    )
    damping: NotNegative = Field(default=0.0, description="mass-proportional damping of the thread [1/s]")
    bending: Annotated[bool, Field(strict=True)] = Field(
        default=True, description="whether the thread resists bending; false: EI = 0"
    )
    energy: Literal["continuous", "springs"] = Field(
        default="continuous",
        description='elastic energies: "continuous", integrals over the thread, or "springs" between points spread '
        "along it (the paper's §3), calibrated by EA, EI and GJ",
    )
    springs: Whole | None = Field(
        default=None,
        description="number of stretch springs along the thread [-], from control_points - 1 (the default with energy "
        '= "springs") on; more of them lock a stiff thread',
        examples=[39],
    )
    twist: Annotated[bool, Field(strict=True)] = Field(
        default=False,
        description="whether the thread resists twist: the angle of its section becomes a fourth coordinate",
    )
    coil_radius: Positive | None = Field(
        default=None,
        description="radius of the coil that the thread remembers of its packet [m]; needs thread.twist; default: "
        "straight at rest",
        examples=[0.02],
    )
    coil_towards: Vector | None = Field(
        default=None,
        description="side to which the start of the thread coils [-], across the path; default: one of the axes",
        examples=[[0, 0, 1]],
    )
    start: End = Field(
        default=FreeEnd(kind="free"),
        description="what holds the thread at the start of the path",
        examples=[{"kind": "free"}],
    )
    end: End = Field(
        default=FreeEnd(kind="free"),
        description="what holds the thread at the end of the path",
        examples=[{"kind": "free"}],
    )

    @model_validator(mode="before")
    @classmethod
    def _default_poisson_ratio(cls, data: Any) -> Any:
        if isinstance(data, Mapping) and "suture" not in data and "poisson_ratio" not in data:
            return {**data, "poisson_ratio": 0.4}
        return data

    @model_validator(mode="after")
    def _check_material(self) -> Self:
        own = {key: getattr(self, key) for key in ("diameter", "youngs_modulus", "density", "poisson_ratio")}
        given = [key for key, value in own.items() if value is not None]
        if self.suture is not None and given:
            raise ValueError(
                f".{given[0]} = {own[given[0]]} is refused: the suture {as_toml(self.suture)} sets it "
                f"already; leave out either suture or {', '.join(given)}"
            )
        missing = [key for key in ("diameter", "youngs_modulus", "density") if key not in given]
        if self.suture is None and missing:
            raise ValueError(
                f".{missing[0]} is missing: give suture (USP size and material, for example suture = "
                '"2-0 polypropylene") or all of diameter [m], youngs_modulus [Pa] and density [kg/m³]'
            )
        return self

    @model_validator(mode="after")
    def _check_cuts(self) -> Self:
        if any(after <= before for before, after in pairwise(self.cuts)):
            raise ValueError(f".cuts = {as_toml(self.cuts)} is refused: they must rise; sort them and drop repeats")
        kept = {"resolution": "fixed", "energy": "continuous", "twist": False}
        lost = next((key for key, value in kept.items() if getattr(self, key) != value), None)
        if self.cuts and lost is not None:
            raise ValueError(
                f".cuts = {as_toml(self.cuts)} is refused: thread.{lost} = {as_toml(getattr(self, lost))} goes through "
                f"cuts; set it to {as_toml(kept[lost])}"
            )
        return self

    @model_validator(mode="after")
    def _check_springs(self) -> Self:
        if self.springs is not None and self.energy != "springs":
            raise ValueError(f'.springs = {self.springs} is refused: thread.energy is continuous; set it to "springs"')
        if self.springs is not None and self.springs < self.control_points - 1:
            raise ValueError(
                f".springs = {self.springs} is refused: {self.control_points} control points need at least "
                f"{self.control_points - 1}, else the thread could stretch unseen; raise it"
            )
        return self

    @model_validator(mode="after")
    def _check_resolution(self) -> Self:
        if self.resolution == "adaptive" and (self.energy == "springs" or not self.bending):
            raise ValueError(
                '.resolution = "adaptive" is refused: it goes by the length over which a thread bends, and springs or '
                'a thread without bending have none; set it to "fixed", or energy = "continuous" and bending = true'
            )
        return self

    @model_validator(mode="after")
    def _check_twist(self) -> Self:
        if self.twist and not self.bending:
            raise ValueError(
                ".twist = true is refused: without bending stiffness a twisted thread collapses; set bending = true"
            )
        turned = next((key for key in ("start", "end") if getattr(getattr(self, key), "turn", None)), None)
        if turned is not None and not self.twist:
            raise ValueError(f".{turned}.turn is refused: the thread does not resist twist; set thread.twist = true")
        if self.coil_radius is not None and not self.twist:
            raise ValueError(
                f".coil_radius = {self.coil_radius} is refused: the side to which a thread coils turns with its "
                "section; set thread.twist = true"
            )
        if self.coil_towards is not None:
            self._check_coil_towards(self.coil_towards)
        return self

    def _check_coil_towards(self, towards: Vector) -> None:
        if self.coil_radius is None:
            raise ValueError(
                f".coil_towards = {as_toml(towards)} is refused: the thread does not coil; give coil_radius"
            )
        along = np.subtract(self.path[1], self.path[0])
        if np.linalg.norm(np.cross(towards, along)) <= 1e-3 * np.linalg.norm(towards) * np.linalg.norm(along):
            raise ValueError(
                f".coil_towards = {as_toml(towards)} is refused: it must not lie along the start of the path; give a "
                "direction across it"
            )

    @model_validator(mode="after")
    def _check_path(self) -> Self:
        for row, (before, after) in enumerate(pairwise(self.path), start=1):
            if before == after:
                raise ValueError(
                    f".path.{row} = {as_toml(after)} is refused: it must differ from the one before; drop it"
                )
        return self

    @model_validator(mode="after")
    def _check_driven_ends(self) -> Self:
        total = sum(dist(a, b) for a, b in pairwise(self.path))
        for key, end, place in (("start", self.start, self.path[0]), ("end", self.end, self.path[-1])):
            away = dist(end.position(0.0), place) if isinstance(end, DrivenEnd) else 0.0
            if away > ALLOWED_START_ERROR * total:
                raise ValueError(
                    f".{key}.waypoints is refused: at t = 0 it is {away:.3g} m away from the {key} of "
                    f"thread.path, {as_toml(place)}; let it begin there"
                )
        return self


# --- piercings --------------------------------------------------------------------------------------------


class Friction(Table):
    """Coulomb friction and grip at a piercing."""

    static: NotNegative = Field(description="coefficient of static friction [-]", examples=[0.12])
    kinetic: NotNegative = Field(description="coefficient of kinetic friction [-]", examples=[0.10])
    grip: NotNegative = Field(default=0.0, description="friction force without any tension [N]")

    @model_validator(mode="after")
    def _check_order(self) -> Self:
        if self.kinetic > self.static:
            raise ValueError(
                f".kinetic = {self.kinetic} is refused: it must not exceed static = {self.static}; "
                "lower it or raise static"
            )
        return self


class Piercing(Table):
    """Hole through which the thread passes."""

    name: Text = Field(description="name of the piercing", examples=["entry"])
    at: Vector = Field(
        description="place of the piercing, on the organ's surface or inside it [m]",
        examples=[[-0.01, 0.0, 0.0]],
    )
    kind: Literal["sliding", "anchored"] = Field(
        default="sliding", description='"sliding", or "anchored": this point of the thread never slides'
    )
    direction: Annotated[
        Literal["free", "normal"] | Vector,
        _or('"free", "normal" or three numbers [x, y, z], for example direction = "normal"'),
    ] = Field(
        default="free",
        description='direction of the thread in the hole: "free", "normal" to the surface, or cut by the '
        "needle along [x, y, z] [-]",
    )
    footprint: NotNegative = Field(
        default=1.0e-3,
        description="radius of the averaging disc (surface) or ball (inside) [m]; 0: the paper's bare point",
    )
    weight: Literal["uniform", "parabolic"] = Field(default="parabolic", description="weight over the footprint [-]")
    subgrid: Annotated[bool, Field(strict=True)] = Field(
        default=True,
        description="whether to add the compliance of the tissue around the footprint that the mesh is too coarse to "
        "show; none on a fine mesh or for a bare point",
    )
    s: NotNegative | None = Field(
        default=None,
        description="abscissa of the piercing where it begins [m], at an end of the thread only if anchored; default: "
        "where the thread is nearest to it then",
        examples=[0.031],
    )
    friction: Friction | None = Field(
        default=None,
        description="friction coefficients [-] and grip [N]; default none",
        examples=[{"static": 0.12, "kinetic": 0.10, "grip": 0.0}],
    )
    draw: Annotated[tuple[Turn, ...], Field(min_length=1)] | None = Field(
        default=None,
        description='rows of t [s], length [m] of thread that a hand draws through an "anchored" hole towards the end '
        "of the path, negative towards its start, t increasing; linear in between, at rest before and after, and "
        "counted from the moment the piercing begins; in statics t goes from 0 to solve.duration; default: none",
        examples=[[[0.0, 0.0], [1.0, 0.005]]],
    )
    channel: Positive | None = Field(
        default=None,
        description="length of the channel, at whose ends the reaction couple presses [m]; default with friction and a "
        "direction: two footprints, or ten diameters of the thread where there is no footprint",
        examples=[2.0e-3],
    )
    from_: NotNegative = Field(
        default=0.0,
        alias="from",
        description="time at which the piercing begins [s], at the first end of a step not before it; until then its "
        "state is left",
    )
    until: Positive | None = Field(
        default=None,
        description="time at which the piercing ends [s], at the first end of a step not before it; default: never",
        examples=[0.5],
    )

    @model_validator(mode="after")
    def _check_effect(self) -> Self:
        if self.direction == (0.0, 0.0, 0.0):
            raise ValueError(".direction = [0, 0, 0] is refused: it must not be zero; give a direction")
        if self.until is not None and self.until <= self.from_:
            raise ValueError(f".until = {self.until} is refused: it must be later than from = {self.from_}; raise it")
        if self.draw is not None and self.kind == "sliding":
            raise ValueError('.draw is refused: a hand holds the thread that it draws; set kind = "anchored"')
        for row, ((before, _), (after, _)) in enumerate(pairwise(self.draw or ()), start=1):
            if after <= before:
                raise ValueError(
                    f".draw.{row} = {as_toml((self.draw or ())[row])} is refused: "
                    f"its time must be later than {before} s, the one before it; sort them by time"
                )
        if self.kind == "anchored" and self.friction is not None:
            raise ValueError('.friction is refused: with kind = "anchored" nothing slides; leave it out')
        if self.channel is not None and (self.friction is None or self.direction == "free"):
            raise ValueError(
                f".channel = {self.channel} is refused: it acts through friction and a direction; "
                "give both or leave it out"
            )
        return self


# --- solution and output ----------------------------------------------------------------------------------


class Solve(Table):
    """What is solved, and how."""

    kind: Literal["dynamic", "static"] = Field(
        default="dynamic", description='"dynamic", or "static": equilibrium under the final loads'
    )
    dt: Positive = Field(default=1.0e-3, description="time step [s]")
    duration: Positive = Field(default=1.0, description="simulated time [s]")
    load_steps: Whole = Field(default=10, description="number of load steps [-] of a static solution")
    scheme: Literal["newton", "linear"] = Field(
        default="newton", description='time step: "newton", or "linear" (Baumgarte, one linear solve)'
    )
    integrator: Literal["euler", "bdf2"] = Field(
        default="euler",
        description='integration in time: "euler" (backward, order 1) or "bdf2" (order 2), constraints met at the end '
        "of the step by either",
    )
    coupling: Literal["monolithic", "staggered"] = Field(
        default="monolithic", description="thread and organ solved together, or one after the other"
    )
    friction: Literal["implicit", "two-pass"] = Field(default="implicit", description="friction solver")
    epsilon: NotNegative = Field(default=0.0, description="inertia of an abscissa ε (eq. 7) [kg]")
    gravity: Vector = Field(default=(0.0, 0.0, 0.0), description="gravity on thread and organ [m/s²]")

    @model_validator(mode="after")
    def _check_step(self) -> Self:
        if self.kind == "dynamic" and self.dt > self.duration:
            raise ValueError(f".dt = {self.dt} is refused: it must not exceed duration = {self.duration}; lower it")
        return self

    @model_validator(mode="after")
    def _check_method(self) -> Self:
        if self.integrator == "bdf2" and (self.scheme == "linear" or self.friction == "two-pass"):
            raise ValueError(
                '.integrator = "bdf2" is refused: the linear scheme and two-pass friction step by backward Euler; use '
                'integrator = "euler", or scheme = "newton" with friction = "implicit"'
            )
        if self.scheme == "linear" and self.kind == "static":
            raise ValueError(
                '.scheme = "linear" is refused: solve.kind is static, an equilibrium and not a step in time; use '
                'scheme = "newton" or kind = "dynamic"'
            )
        if self.friction == "two-pass" and (self.kind == "static" or self.integrator == "bdf2"):
            raise ValueError(
                '.friction = "two-pass" is refused: it is a step in time of backward Euler; use friction = "implicit", '
                'or kind = "dynamic" with integrator = "euler"'
            )
        if self.coupling == "staggered" and self.kind == "static":
            raise ValueError(
                '.coupling = "staggered" is refused: solve.kind is static, where nothing moves from step to step; use '
                'coupling = "monolithic" or kind = "dynamic"'
            )
        return self


class Output(Table):
    """What is written while running."""

    every: Whole = Field(default=10, description="steps between frames [-]")


class Scenario(Table):
    """A suture thread, an organ it pierces, and what is done to them."""

    title: Annotated[str, Field(strict=True)] = Field(default="", description="title of the scenario")
    tissue: Tissue | None = Field(
        default=None,
        description="the organ; left out: the piercings are points fixed in space",
        examples=[{"youngs_modulus": 1.0e5}],
    )
    thread: Thread = Field(description="the thread", examples=[{"suture": "2-0 polypropylene"}])
    piercing: tuple[Piercing, ...] = Field(
        default=(), description="the piercings, in the order in which the thread passes them"
    )
    solve: Solve = Field(default=Solve(), description="what is solved, and how", examples=[{"dt": 1.0e-3}])
    output: Output = Field(default=Output(), description="what is written while running", examples=[{"every": 10}])

    @model_validator(mode="after")
    def _check_piercings(self) -> Self:
        if problem := _repeated("piercing", [piercing.name for piercing in self.piercing]):
            raise ValueError(problem)
        check_order(
            [(piercing, piercing.s) for piercing in self.piercing if piercing.s is not None], self.thread.length
        )
        check_control_points(self.thread.control_points, len(self.piercing))
        loose = next((piercing.name for piercing in self.piercing if piercing.direction == "normal"), None)
        if self.tissue is None and loose is not None:
            key = dotted(["piercing", loose, "direction"])
            reason = 'without [tissue] there is no surface; use "free" or [x, y, z], or add [tissue]'
            raise ValueError(refused(key, "normal", reason))
        return self

    @model_validator(mode="after")
    def _check_apart(self) -> Self:
        pairs = combinations(self.piercing, 2) if self.tissue is not None else ()
        for one, other in pairs:
            apart, reach = dist(one.at, other.at), one.footprint + other.footprint
            together = max(one.from_, other.from_) < min(hole.until or inf for hole in (one, other))
            if together and apart < reach:
                reason = (
                    f"it is {apart:.3g} m from {dotted(['piercing', one.name])}, nearer than their footprints "
                    f"together, {reach:.3g} m; move them apart or take smaller footprints"
                )
                raise ValueError(refused(dotted(["piercing", other.name, "at"]), other.at, reason))
        return self

    @model_validator(mode="after")
    def _check_friction(self) -> Self:
        rough = next((piercing.name for piercing in self.piercing if piercing.friction is not None), None)
        if rough is not None and self.solve.scheme == "linear" and self.solve.friction == "implicit":
            key = dotted(["piercing", rough, "friction"])
            reason = f'solve.scheme is linear, which has no implicit {key}; use "two-pass", or scheme = "newton"'
            raise ValueError(refused("solve.friction", "implicit", reason))
        if rough is not None and not self.thread.bending:
            reason = (
                f"{dotted(['piercing', rough, 'friction'])} acts along the tangent that the bend at a hole gives the "
                "thread, however thin the thread, and a spline without bending has none; set bending = true, and for a "
                "limp thread a small thread.bending_factor"
            )
            raise ValueError(refused("thread.bending", False, reason))
        return self

    @model_validator(mode="after")
    def _check_contact(self) -> Self:
        linear = self.solve.scheme == "linear" and self.solve.coupling == "monolithic"
        if self.tissue is not None and self.tissue.contact and linear:
            reason = 'the linear scheme has no inequalities; use solve.scheme = "newton", or coupling = "staggered"'
            raise ValueError(refused("tissue.contact", True, reason))
        return self

    @model_validator(mode="after")
    def _check_knots(self) -> Self:
        if self.thread.resolution == "adaptive" and self.solve.scheme == "linear":
            reason = "the linear scheme knows no missing compliance, by which the knots are placed; set it to fixed"
            raise ValueError(refused("thread.resolution", "adaptive", reason))
        return self

    @model_validator(mode="after")
    def _check_linear(self) -> Self:
        drawn = next((hole.name for hole in self.piercing if hole.draw is not None), None)
        if self.solve.scheme == "linear" and (self.thread.cuts or drawn is not None):
            key = "thread.cuts" if self.thread.cuts else dotted(["piercing", str(drawn), "draw"])
            reason = f'the paper\'s linear step knows no {key}; use "newton"'
            raise ValueError(refused("solve.scheme", "linear", reason))
        return self

    @model_validator(mode="after")
    def _check_turning(self) -> Self:
        ends = (self.thread.start, self.thread.end)
        held = any(isinstance(end, ClampedEnd) or getattr(end, "turn", None) for end in ends)
        if self.thread.twist and self.solve.kind == "static" and not held:
            reason = "solve.kind is static and nothing keeps the thread from spinning; clamp an end or give it a turn"
            raise ValueError(refused("thread.twist", True, reason))
        return self

    @model_validator(mode="after")
    def _check_held(self) -> Self:
        tissue = self.tissue
        if tissue is None or tissue.clamp or tissue.roller or (tissue.inertia and self.solve.kind == "dynamic"):
            return self
        why = "solve.kind is static" if self.solve.kind == "static" else "tissue.inertia is false"
        reason = f'{why}, so the organ must be held; name a boundary, for example clamp = ["bottom"]'
        raise ValueError(refused("tissue.clamp", [], reason))


# --- checks that the simulation repeats once it knows more ------------------------------------------------


def check_order(placed: Sequence[tuple[Piercing, float]], length: float | None = None) -> None:
    """Refuse piercings whose abscissas [m] do not increase along the list or are off the thread, and at an end of the
    thread those that do not anchor it."""
    for hole, s in placed:
        check_within(hole, s, length)
    for (before, low), (after, high) in pairwise(placed):
        if high <= low:
            reason = (
                f"it must be greater than {dotted(['piercing', before.name, 's'])} = {low}, because the piercings "
                "are listed in the order in which the thread passes them; reorder them or correct s"
            )
            raise ScenarioError(refused(dotted(["piercing", after.name, "s"]), high, reason))


def check_within(hole: Piercing, s: float, length: float | None) -> None:
    """Refuse a piercing whose abscissa [m] is off the thread, or at its end where it is free to slide out."""
    last = inf if length is None else length
    if (hole.kind == "anchored" and 0.0 <= s <= last) or 0.0 < s < last:
        return
    limit = "the thread's length" if length is None else f"the thread's length of {length} m"
    reason = f"it must lie between 0 and {limit}; move the piercing, or let the path go on beyond it"
    at_end = s in (0.0, last) and ', or hold the end of the thread there: kind = "anchored"'
    raise ScenarioError(refused(dotted(["piercing", hole.name, "s"]), s, reason + (at_end or "")))


def check_cuts(cuts: Sequence[float], length: float) -> None:
    """Refuse cuts that lie off the thread of that length [m]."""
    lost = next((s for s in cuts if s >= length), None)
    if lost is not None:
        reason = f"it must lie between 0 and the thread's length of {length} m; move it"
        raise ScenarioError(refused("thread.cuts", lost, reason))


def check_spans(cuts: Sequence[float], ends: Sequence[float], breaks: Sequence[float]) -> None:
    """Refuse cuts that leave a piece of a single span; `ends` of the pieces and of the spans, `breaks` [m]."""
    for before, after in pairwise(ends) if cuts else ():
        if sum(before <= s <= after for s in breaks) < 3:
            reason = (
                f"the piece from {before:.6g} to {after:.6g} m is shorter than two spans of the thread; cut elsewhere, "
                "or raise thread.control_points"
            )
            raise ScenarioError(refused("thread.cuts", cuts, reason))


def check_control_points(control_points: int, piercings: int) -> None:
    """Refuse a spline too coarse for its holes.

    A hole takes up to 5 constraints, on 3 unknowns of each control point and its own abscissa; and the
    thread turns there, so a span of the spline should lie on either side of the hole and one at it: 3
    control points for each hole, beside the 4 of a single cubic.
    """
    least = 4 + 3 * piercings
    if control_points < least:
        reason = f"{piercings} piercings need at least {least} (4 and 3 for each piercing); raise it"
        raise ScenarioError(refused("thread.control_points", control_points, reason))


def check_clamp(clamp: Iterable[str], boundaries: Sequence[str], key: str = "clamp") -> None:
    """Refuse a clamp, or another `key`, that names no boundary of the organ."""
    if problem := unknown_clamp(clamp, boundaries, key):
        raise ScenarioError(f"tissue.{problem}")


def unknown_clamp(clamp: Iterable[str], boundaries: Sequence[str], key: str = "clamp") -> str | None:
    """What is wrong with a clamp, None if nothing."""
    lost = next((name for name in clamp if name not in boundaries), None)
    if lost is None:
        return None
    match = nearest(lost, boundaries)
    hint = f'; the nearest is "{match}"' if match else "; add it as [[tissue.boundary]]"
    there = ", ".join(boundaries) or "none"
    return refused(key, [lost], f"there is no such boundary; the boundaries are {there}{hint}")


def _repeated(table: str, names: Sequence[str]) -> str | None:
    twice = next((name for index, name in enumerate(names) if name in names[:index]), None)
    return None if twice is None else refused(f"{table}.name", twice, "names must be unique; rename one")


# --- reading and writing ----------------------------------------------------------------------------------


def load(path: Path | str, overrides: Sequence[str] = ()) -> Scenario:
    """Read a scenario file; each override is ``dotted.key=value`` with the value in TOML."""
    path = Path(path)
    data = _read(path)
    for override in overrides:
        _override(data, override)
    _make_mesh_path_absolute(data, path.parent)
    scenario = parse(data)
    _check_mesh_file(scenario)
    return scenario


def parse(data: Mapping[str, Any]) -> Scenario:
    """Validate a scenario given as tables."""
    try:
        return Scenario.model_validate(dict(data))
    except ValidationError as error:
        raise ScenarioError(sentences(error, Scenario, data)) from None


def schema() -> dict[str, Any]:
    """JSON schema (draft 2020-12) of the scenario file."""
    declared = {"$schema": "https://json-schema.org/draft/2020-12/schema"}
    return declared | Scenario.model_json_schema(by_alias=True)


def tables(scenario: Scenario) -> dict[str, Any]:
    """The scenario as plain tables with every default, what is not given left out."""
    plain = scenario.model_dump(mode="json", by_alias=True, exclude_none=True)
    return {key: _kind_first(value) for key, value in plain.items()}


def _kind_first(value: Any) -> Any:
    """The same tables with ``kind`` as the first key, as one would write them."""
    match value:
        case dict():
            first = {"kind": value["kind"]} if "kind" in value and "name" not in value else {}
            return first | {key: _kind_first(item) for key, item in value.items()}
        case list():
            return [_kind_first(item) for item in value]
        case _:
            return value


def dump(scenario: Scenario) -> str:
    """The scenario in TOML, every default written out; reads back to an equal scenario."""
    return "\n".join(_lines(tables(scenario), ()))


def resolved(scenario: Scenario, length: float, s: Sequence[float]) -> Scenario:
    """The scenario with the defaults that only the geometry tells: the rest length and the abscissas [m].

    A piercing that begins later takes its abscissa, unless given, from where the thread is then.
    """
    thread = scenario.thread.model_copy(update={"length": length})
    pairs = zip(scenario.piercing, s, strict=True)
    piercing = tuple(
        hole.model_copy(update={"s": float(value)}) if hole.s is None and hole.from_ == 0.0 else hole
        for hole, value in pairs
    )
    return scenario.model_copy(update={"thread": thread, "piercing": piercing})


def mesh_file(scenario: Scenario) -> Path | None:
    """The mesh file that the scenario names, None if it names none."""
    if scenario.tissue is None or not isinstance(scenario.tissue.mesh, FileMesh):
        return None
    return Path(scenario.tissue.mesh.path)


def with_mesh_file(scenario: Scenario, path: str) -> Scenario:
    """The scenario with another mesh file; unchanged if it has none."""
    if scenario.tissue is None or not isinstance(scenario.tissue.mesh, FileMesh):
        return scenario
    mesh = scenario.tissue.mesh.model_copy(update={"path": path})
    return scenario.model_copy(update={"tissue": scenario.tissue.model_copy(update={"mesh": mesh})})


def _read(path: Path) -> dict[str, Any]:
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise ScenarioError(f"{path} does not exist; give the path of a scenario file (.toml)") from None
    except UnicodeDecodeError as error:
        raise ScenarioError(
            f"{path} is not UTF-8 text (byte {error.start}); give a scenario file (.toml) saved as UTF-8"
        ) from None
    except OSError as error:
        raise ScenarioError(f"{path} cannot be read ({error.strerror}); give a readable scenario file") from None
    except tomllib.TOMLDecodeError as error:
        raise ScenarioError(f"{path} is not valid TOML: {error}; correct that line") from None


def _override(data: dict[str, Any], text: str) -> None:
    """Set one key in place."""
    *parents, last = parts = _override_key(text)
    value = _override_value(text)
    table: Any = data
    for depth, part in enumerate(parents):
        table = _enter(table, part, dotted(parts[:depth]), text)
    if isinstance(table, list):
        table[_index(table, last, dotted(parents), text)] = value
    else:
        table[last] = value


def _override_key(text: str) -> list[str]:
    key, equals, _ = text.partition("=")
    try:
        table = tomllib.loads(f"{key}=0") if equals else {}
    except tomllib.TOMLDecodeError:
        table = {}
    if not table:
        raise ScenarioError(f"--set {text} is refused: write a dotted key, = and a value, for example solve.dt=5e-4")
    parts: list[str] = []
    while isinstance(table, dict):
        ((part, table),) = table.items()
        parts.append(part)
    return parts


def _override_value(text: str) -> Any:
    """The value in TOML; a bare word is a string, because a shell takes the quotes away."""
    key, _, value = text.partition("=")
    try:
        return tomllib.loads(f"value = {value}")["value"]
    except tomllib.TOMLDecodeError as error:
        if BARE.fullmatch(value.strip()):
            return value.strip()
        reason = str(error).partition(" (at")[0]
        raise ScenarioError(
            f"--set {key}={value} is refused: the value is not TOML ({reason}); write for example 5e-4, "
            'true, [0, 0, 1] or "text"'
        ) from None


def _enter(table: Any, part: str, parent: str, text: str) -> Any:
    if isinstance(table, list):
        return table[_index(table, part, parent, text)]
    inner = table.setdefault(part, {})
    if not isinstance(inner, dict | list):
        where = f"{parent}.{part}" if parent else part
        raise ScenarioError(f"--set {text} is refused: {where} is a value, not a table; set {where} itself")
    return inner


def _index(entries: list[Any], part: str, parent: str, text: str) -> int:
    names = [entry.get("name") if isinstance(entry, dict) else None for entry in entries]
    if part in names:
        return names.index(part)
    if part.isdecimal() and int(part) < len(entries):
        return int(part)
    there = [str(index) if name is None else str(name) for index, name in enumerate(names)]
    raise ScenarioError(f"--set {text} is refused: {parent} has no entry {part}; its entries are {', '.join(there)}")


def _make_mesh_path_absolute(data: dict[str, Any], folder: Path) -> None:
    tissue = data.get("tissue")
    mesh = tissue.get("mesh") if isinstance(tissue, dict) else None
    if isinstance(mesh, dict) and isinstance(path := mesh.get("path"), str) and path:
        mesh["path"] = str((folder / path).resolve())


def _check_mesh_file(scenario: Scenario) -> None:
    path = mesh_file(scenario)
    if path is None:
        return
    if not path.is_file():
        problem = "there is no such file; give the path relative to the scenario file"
        raise ScenarioError(refused("tissue.mesh.path", str(path), problem))
    if path.stat().st_size == 0:
        raise ScenarioError(refused("tissue.mesh.path", str(path), "the file is empty; give a volume mesh"))


def _lines(table: Mapping[str, Any], parents: tuple[str, ...]) -> list[str]:
    """A table in TOML: values first, then tables, then lists of tables."""
    under_headers = {key for key, value in table.items() if _is_table(key, value) or _is_tables(value)}
    values = {key: value for key, value in table.items() if key not in under_headers}
    lines = [f"{as_key(key)} = {as_toml(value)}" for key, value in values.items()]
    for key, value in table.items():
        name = (*parents, key)
        if _is_table(key, value):
            lines += ["", f"[{dotted(name)}]", *_lines(value, name)]
        if _is_tables(value):
            for item in value:
                lines += ["", f"[[{dotted(name)}]]", *_lines(item, name)]
    return lines if parents else [*lines, ""]


def _is_table(key: str, value: object) -> bool:
    return isinstance(value, dict) and key not in INLINE


def _is_tables(value: object) -> bool:
    return isinstance(value, list) and bool(value) and all(isinstance(item, dict) for item in value)
