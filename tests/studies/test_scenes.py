"""The shipped scenes: each runs to its end, and the models support its numbers."""

from pathlib import Path

import pytest

from studies.scenario import scenes
from suturefem import load, run
from tests.meshes.samples import NEEDS_GMSH


@NEEDS_GMSH
@pytest.mark.parametrize("scene", scenes())
def test_a_shipped_scene_completes_in_its_range(scene: str, tmp_path: Path) -> None:
    """Behaviour: as a user runs it, at its own mesh; no remark says that a number is not supported."""
    summary = run(load(scene), tmp_path).summary
    assert summary["status"] == "completed"
    assert [each["code"] for each in summary["remarks"] if each["severity"] == "unsupported"] == []
