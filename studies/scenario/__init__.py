"""The scenario: one TOML file, validated completely before the computation.

Users call `load`, `parse`, `dump`, `schema` and `scenes`; the classes are the tables of the file.
The other packages find here what they say of a scenario, and how they refuse one.
"""

from studies.scenario.organ import BlockMesh, Contact, CylinderMesh, FileMesh, GivenMesh, Tissue, TubeMesh, WoundMesh
from studies.scenario.piercing import Piercing, Tie, Tract
from studies.scenario.refusal import as_toml, because, dotted_key, hint_at, refusal
from studies.scenario.scenario import Scenario, check_given, parse, schema
from studies.scenario.solve import Solve
from studies.scenario.table import ScenarioError, plain_values, refuse, refused
from studies.scenario.thread import ClampedEnd, Cut, DrivenEnd, End, FixedEnd, FreeEnd, PulledEnd, Thread
from studies.scenario.toml import SCENES, changed, dump, load, mesh_file, parsed, read, scenes, tables, with_mesh_copy

__all__ = [
    "SCENES", "BlockMesh", "ClampedEnd", "Contact", "Cut", "CylinderMesh", "DrivenEnd", "End",
    "FileMesh", "FixedEnd", "FreeEnd", "GivenMesh", "Piercing", "PulledEnd", "Scenario",
    "ScenarioError", "Solve", "Thread", "Tie", "Tissue", "Tract", "TubeMesh", "WoundMesh", "as_toml",
    "because", "changed", "check_given", "dotted_key", "dump", "hint_at", "load", "mesh_file",
    "parse", "parsed", "plain_values", "read", "refusal", "refuse", "refused", "scenes", "schema",
    "tables", "with_mesh_copy",
]  # fmt: skip
