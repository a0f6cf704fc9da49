"""The keys of the organ's material beyond E, ν and ρ, of `[tissue]` and of `[[tissue.region]]`."""

from typing import Annotated, Literal

from pydantic import Field

from studies.scenario.refusal import as_key, as_toml
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


def missing_or_idle(material: Law, keys: MaterialKeys, stiffening: float | None) -> str | None:
    """Return the fault in the keys of a material, or None; `stiffening` is its effective value."""
    given = next((key for key in MaterialKeys.model_fields if getattr(keys, key) is not None), None)
    if material == "linear" and given:
        return (
            f".{given} = {as_toml(keys.model_dump(exclude_none=True)[given])} is refused: a linear material has none; "
            'use material = "neo-hookean" or "exponential", or leave it out'
        )
    if material == "neo-hookean" and keys.stiffening is not None:
        return (
            f".stiffening = {keys.stiffening} is refused: a neo-Hookean material has no stiffening; take "
            '"exponential", or leave it out'
        )
    if material == "exponential" and stiffening is None:
        return '.stiffening is missing: material is exponential; soft tissue has about 5.0, or use "neo-hookean"'
    return None


def region_problem(organ: Law, name: str, region: Law | None) -> str | None:
    """Return the fault in the material of a region in an organ of a material, or None."""
    if region is None or (region == "linear") == (organ == "linear"):
        return None
    remedy = 'give tissue.material, for example "neo-hookean"' if organ == "linear" else 'use "neo-hookean"'
    return (
        f".region.{as_key(name)}.material = {as_toml(region)} is refused: the organ's material is {organ}, and small "
        f"and finite strain cannot be combined; {remedy}"
    )
