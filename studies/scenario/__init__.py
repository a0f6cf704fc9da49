"""The scenario: one TOML file, validated completely before the computation.

Users call `load`, `parse`, `dump`, `schema` and `scenes`; the classes are the tables of the file.
"""

from studies.scenario.organ import BlockMesh, Contact, CylinderMesh, FileMesh, GivenMesh, Tissue, TubeMesh, WoundMesh
from studies.scenario.piercing import Piercing, Tie, Tract
from studies.scenario.scenario import Scenario, parse, schema
from studies.scenario.solve import Solve
from studies.scenario.table import ScenarioError
from studies.scenario.thread import ClampedEnd, Cut, DrivenEnd, End, FixedEnd, FreeEnd, PulledEnd, Thread
from studies.scenario.toml import SCENES, dump, load, scenes

__all__ = [
    "SCENES", "BlockMesh", "ClampedEnd", "Contact", "Cut", "CylinderMesh", "DrivenEnd", "End",
    "FileMesh", "FixedEnd", "FreeEnd", "GivenMesh", "Piercing", "PulledEnd", "Scenario",
    "ScenarioError", "Solve", "Thread", "Tie", "Tissue", "Tract", "TubeMesh", "WoundMesh", "dump",
    "load", "parse", "scenes", "schema",
]  # fmt: skip
