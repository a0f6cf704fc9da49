"""The scenario: one TOML file, validated completely before the computation.

Users call `load`, `parse`, `dump`, `schema` and `scenes`; the classes are the tables of the file.
"""

from studies.scenario.organ import (
    BlockMesh,
    Boundary,
    Contact,
    CylinderMesh,
    FileMesh,
    GivenMesh,
    Load,
    Mesh,
    Region,
    Tissue,
    TubeMesh,
    WoundMesh,
)
from studies.scenario.piercing import Friction, Piercing, Tie, Tract
from studies.scenario.scenario import Scenario, parse, schema
from studies.scenario.solve import Output, Solve
from studies.scenario.table import ScenarioError
from studies.scenario.thread import ClampedEnd, Cut, DrivenEnd, End, FixedEnd, FreeEnd, PulledEnd, Thread
from studies.scenario.toml import SCENES, dump, load, scenes

__all__ = [
    "SCENES", "BlockMesh", "Boundary", "ClampedEnd", "Contact", "Cut", "CylinderMesh",
    "DrivenEnd", "End", "FileMesh", "FixedEnd", "FreeEnd", "Friction", "GivenMesh", "Load",
    "Mesh", "Output", "Piercing", "PulledEnd", "Region", "Scenario", "ScenarioError", "Solve",
    "Thread", "Tie", "Tissue", "Tract", "TubeMesh", "WoundMesh", "dump", "load", "parse",
    "scenes", "schema",
]  # fmt: skip
