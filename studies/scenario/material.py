"""The keys of the organ's material beyond E, ν and ρ, of `[tissue]` and of `[[tissue.region]]`."""

from typing import Annotated, Literal

from pydantic import Field

from studies.scenario.meanings import because
from studies.scenario.refusal import as_toml, refusal
from studies.scenario.table import ScenarioTable
from studies.scenario.values import NotNegative, Positive, Vector

Law = Literal["linear", "neo-hookean", "exponential"]
FAMILIES = 2  # largest number of fibre families at one place


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
