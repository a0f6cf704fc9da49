"""Parts from Python that replace parts of a scenario.

These are the mesh, a stiffness, laws of friction, and a strain energy. Parts that do not fit the
scenario are refused before the preparation.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from typing import Any

import numpy as np
import skfem
from scipy.sparse import csr_matrix

import tissue
from coupling.interfaces import FrictionLaw
from meshes.given import given_mesh, mesh_digest
from studies.arrays import Array
from studies.scenario import Scenario, ScenarioError, Tissue
from studies.scenario.refusal import because, dotted_key, hint_at, refusal, shortened
from studies.scenario.scenario import with_given_mesh
from tissue.materials.density import Density
from tissue.materials.own import Own

Stiffness = Callable[[skfem.Basis], csr_matrix]
Energy = Density | Callable[[Any], Any]

SHOWN = 60  # letters of a given value in a refusal
SYMMETRIC = 1e-10  # of the largest entry: round-off of a sum over the cells of a node
STRESSLESS = 1e-6  # of μ: equal eigenvalues are separated by √ε = 1.5e-8 to be differentiated at F = I
INDIFFERENT = 1e-9  # of W: round-off of a turned F
SHEARED = np.array([[1.1, 0.2, 0.0], [0.0, 0.95, 0.1], [0.05, 0.0, 1.02]])  # an arbitrary F
TURN = np.array([[0.36, 0.48, -0.8], [-0.8, 0.6, 0.0], [0.48, 0.64, 0.6]])  # an arbitrary rotation

# An orthonormal basis of the symmetric strains without change of volume, shape `(5, 3, 3)`.
SHEARS: Array = np.array([
    [[0, 1, 0], [1, 0, 0], [0, 0, 0]], [[0, 0, 1], [0, 0, 0], [1, 0, 0]], [[0, 0, 0], [0, 0, 1], [0, 1, 0]],
    [[1, 0, 0], [0, -1, 0], [0, 0, 0]], np.diag([1, 1, -2]) / 3**0.5,
]) / 2**0.5  # fmt: skip


@dataclass(frozen=True)
class Given:
    """The parts from Python, as arguments of `prepare`.

    A part is None or empty if the scenario's own part is used.
    """

    mesh: object = None
    stiffness: Stiffness | None = None
    friction: Mapping[str, FrictionLaw] = field(default_factory=dict)
    energy: Energy | None = None

    @property
    def unrecorded(self) -> tuple[str, ...]:
        """Names of the arguments of `prepare` with parts that no scenario file can contain."""
        parts = {"stiffness": self.stiffness, "friction": self.friction or None, "energy": self.energy}
        return tuple(name for name, part in parts.items() if part is not None)

    @property
    def parts(self) -> dict[str, Any]:
        """The parts by their names in `prepare`."""
        return {part.name: getattr(self, part.name) for part in fields(self)}

    @cached_property
    def volume(self) -> skfem.MeshTet | None:
        """The organ's mesh from Python, or None for the scenario's own mesh.

        Raises `MeshError`.
        """
        return None if self.mesh is None else given_mesh(self.mesh)

    def applied_to(self, scenario: Scenario) -> Scenario:
        """Return the scenario with the mesh from Python.

        Raises `ScenarioError` for parts that do not fit the scenario.
        """
        of_scenario = (self._faults_of_organ, self._faults_of_friction)
        faults = [*self._faults_of_kind()] or [fault for find in of_scenario for fault in find(scenario)]
        if faults:
            raise ScenarioError(faults)
        return scenario if self.volume is None else with_given_mesh(scenario, mesh_digest(self.volume))

    def _faults_of_kind(self) -> Iterator[str]:
        """Yield the arguments of a wrong kind."""
        wanted: dict[str, tuple[Callable[[Any], bool], str]] = {
            "stiffness": (callable, "a function of a skfem.Basis, such as the assemble of a BilinearForm"),
            "energy": (lambda x: callable(x) or hasattr(x, "tangent"), "a function of F, or a Density"),
            "friction": (is_law_by_name, "a dict of laws by piercing, {'exit': law}, each a FrictionLaw"),
        }
        for name, (fits, words) in wanted.items():
            value = getattr(self, name)
            if value is not None and not fits(value):
                yield f"{name} = {shortened(repr(value), SHOWN)} is refused; give {words}"

    def _faults_of_organ(self, scenario: Scenario) -> Iterator[str]:
        table = scenario.tissue
        if table is None:
            for name in ("stiffness", "energy"):
                if getattr(self, name) is not None:
                    yield f"{name} is refused: the scenario has no organ; add [tissue]"
            return
        stiff, accuracy = self.stiffness is not None, table.mesh.accuracy
        yield from fault(stiff and table.material != "linear", "tissue.material", table.material, "stiffness-finite")
        if self.energy is not None:
            yield from faults_of_energy(table)
        yield from fault(stiff and accuracy != "given", "tissue.mesh.accuracy", accuracy, "stiffness-mesh")
        other = stiff or self.energy is not None
        yield from fault(table.mesh.bound and other, "tissue.mesh.bound", True, "bounds-law")

    def _faults_of_friction(self, scenario: Scenario) -> Iterator[str]:
        holes = {hole.name: hole for hole in scenario.piercing}
        for name in self.friction:
            if name not in holes:
                known = hint_at(name, holes, "the nearest is {!r}") or f"there are {', '.join(holes) or 'none'}"
                yield f"friction of {name!r} is refused: the scenario has no such piercing; {known}"
            elif holes[name].kind == "anchored":
                yield refusal(holes[name].key("kind"), "anchored", because("law-anchored"))
        if self.friction:
            yield from fault(scenario.solve.friction == "two-pass", "solve.friction", "two-pass", "law-two-pass")
            yield from fault(scenario.solve.scheme == "linear", "solve.scheme", "linear", "law-linear")
            yield from fault(not scenario.thread.bending, "thread.bending", False, "law-bending")

    def stiffened(self, body: tissue.Elasticity) -> tissue.Elasticity:
        """Return the body with the given stiffness.

        The body is unchanged without a stiffness. Raises `ScenarioError`.
        """
        if self.stiffness is None:
            return body
        K = self.stiffness(skfem.Basis(body.mesh, body.basis.elem))
        return replace(body, K=checked_stiffness(K, body), pressure=None)

    def distortion(self, mu: float) -> Density | None:
        """Return the given density of distortion, None without one. Raises `ScenarioError`.

        The organ has the shear modulus `mu` [Pa].
        """
        if self.energy is None:
            return None
        density: Any = self.energy if hasattr(self.energy, "tangent") else Own(self.energy)
        check_density(density, mu)
        return density


NOTHING = Given()


def fault(wrong: bool, key: str, value: object, reason: str) -> list[str]:
    """Return a list with the refusal of a value, by the reason of this name, if it is wrong."""
    return [refusal(key, value, because(reason))] if wrong else []


def is_law_by_name(value: object) -> bool:
    """Return whether a value is a dict of friction laws by the names of piercings."""
    laws = value.items() if isinstance(value, Mapping) else [(None, None)]
    needs = ("static", "kinetic", "slope")
    return all(isinstance(name, str) and all(callable(getattr(law, n, None)) for n in needs) for name, law in laws)


def faults_of_energy(table: Tissue) -> Iterator[str]:
    """Yield the refused keys of an organ's table that the energy from Python replaces."""
    yield from fault(table.material == "linear", "tissue.material", "linear", "energy-linear")
    for place, part in (("tissue", table), *((dotted_key(["tissue", "region", r.name]), r) for r in table.region)):
        for key in ("stiffening", "fibres"):
            if getattr(part, key) is not None:
                yield f"{place}.{key} is refused: the given energy replaces it; leave it out"


def checked_stiffness(K: Any, body: tissue.Elasticity) -> csr_matrix:
    """Return a stiffness [N/m] in the organ's format.

    Raises `ScenarioError` for a wrong size, for numbers that are not finite, for an unsymmetric
    matrix, and for a free unknown without resistance.
    """
    if not hasattr(K, "tocsr") or K.shape != body.K.shape:
        found = f"a {type(K).__name__} of shape {getattr(K, 'shape', '()')}"
        needed = because("stiffness-shape", nodes=len(body.nodes), shape=body.K.shape)
        raise ScenarioError(f"stiffness is refused: it is {found}; {needed}")
    if K.dtype.kind not in "fiu":
        raise ScenarioError(f"stiffness is refused: its numbers are {K.dtype}; give real numbers [N/m]")
    matrix = csr_matrix(K.astype(float))
    largest = float(np.abs(matrix.data).max(initial=0.0))
    if not np.isfinite(largest):
        raise ScenarioError("stiffness is refused: it has numbers that are not finite; correct the form")
    skew = float(np.abs((matrix - matrix.T).data).max(initial=0.0))
    if skew > SYMMETRIC * largest:
        raise ScenarioError(f"stiffness is refused: {because('stiffness-skew', share=skew / largest)}")
    if float(matrix.diagonal()[body.free].min(initial=np.inf)) <= 0.0:
        raise ScenarioError(f"stiffness is refused: {because('stiffness-diagonal')}")
    return matrix


def check_density(density: Density, mu: float) -> None:
    """Refuse a density that is stressed at rest or changes under a pure rotation.

    `mu` [Pa] is the scale of both.
    """
    at_rest = float(np.abs(density.stress(np.eye(3)[:, :, None])).max())
    if not at_rest <= STRESSLESS * mu:
        raise ScenarioError(f"energy is refused: {because('energy-stressed', stress=at_rest)}")
    here, turned = (float(density.energy(F[:, :, None])[0]) for F in (SHEARED, TURN @ SHEARED))
    if not abs(turned - here) <= INDIFFERENT * max(abs(here), mu):
        raise ScenarioError(f"energy is refused: {because('energy-rotation', here=here, turned=turned)}")


def shear_moduli(density: Density) -> tuple[float, float]:
    """Return the smallest and the largest shear modulus of a density at rest [Pa].

    All directions of shear are considered.
    """
    A = density.tangent(np.eye(3)[:, :, None])[..., 0]
    values = 0.5 * np.linalg.eigvalsh(np.einsum("aij,ijkl,bkl->ab", SHEARS, A, SHEARS))
    return float(values[0]), float(values[-1])
