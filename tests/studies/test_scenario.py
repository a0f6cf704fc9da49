"""The scenario: what is accepted, what is refused and in which words, and that it survives being written."""

import ast
import codecs
import hashlib
import json
import re
import tomllib
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError

from studies.scenario import SCENES, DrivenEnd, FileMesh, Piercing, Scenario, ScenarioError, dump, load, parse, schema
from studies.scenario.organ import unknown_clamp
from studies.scenario.refusal import FORMER, KEYS, REASONS, as_key, as_toml
from studies.scenario.scenario import RAMP, check_control_points, check_order, resolved
from studies.scenario.table import LONGEST_PROBLEM, MOST_PROBLEMS, ScenarioTable
from studies.scenario.toml import scenario_file, with_mesh_copy
from tests.studies.samples import CONTRACT


@pytest.fixture
def contract(tmp_path: Path) -> Path:
    path = tmp_path / "contract.toml"
    path.write_text(CONTRACT, encoding="utf-8")
    for name in ("a.stl", "a.msh"):
        (tmp_path / name).write_text("there", encoding="utf-8")
    return path


WOUND = (
    "tissue.mesh={kind='wound',size=[0.06,0.04,0.02],h=4e-3,length=0.02,depth=0.008"  # a slit; to be closed by a brace
)

ROOMS = ("scenario", "simulation", "output", "sweeps", "refinement")  # folders of `studies` with reasons of the list

# (override, the words that the one sentence must contain: key, value, what is allowed or the remedy)
REFUSED = [
    ("contact=[{between=['top','tpo']}]", ["contact.0.between", "tpo", "no such boundary", 'nearest is "top"']),
    ("contact=[{between=['top','top']}]", ["contact.0.between", "not in contact with itself", "name two"]),
    ("contact=[{between=['top','left'],friction=-0.2}]", ["contact.0.friction = -0.2", "zero or more"]),
    (
        "contact=[{between=['top','left'],friction={static=0.2,kinetic=0.1}}]",
        ["contact.0.friction = { static = 0.2", "one coefficient", "friction = 0.2"],
    ),
    (
        "contact=[{between=['top','left']},{between=['left','top']}]",
        ["contact.1.between", "already in contact", "leave one out"],
    ),
    ("tissue.poison_ratio=0.4", ["tissue.poison_ratio = 0.4", "no such key", "tissue.poisson_ratio"]),
    ("tissue.mesh.szie=1", ["tissue.mesh.szie = 1", "no such key", "tissue.mesh.size"]),
    ("thread.end.wayponts=1", ["thread.end.wayponts = 1", "no such key", "thread.end.waypoints"]),
    ("piercing.entry.subgrid=true", ["piercing.entry.subgrid = true", "is refused", "tissue.mesh.accuracy"]),
    ("tract=[{between=['entry','exit'],subgrid=false}]", ["tract.0.subgrid = false", "tissue.mesh.accuracy"]),
    ("piercing.entry.dirction=1", ["piercing.entry.dirction = 1", "piercing.entry.direction"]),
    ("piercing.exit.form=0.1", ["piercing.exit.form = 0.1", "piercing.exit.from"]),
    ("piercing.exit.from_=0.1", ["piercing.exit.from_ = 0.1", "piercing.exit.from"]),
    ("sovle={dt=1.0}", ["sovle = { dt = 1.0 }", "solve"]),
    ("tissue.poisson_ratio=0.5", ["tissue.poisson_ratio = 0.5", "less than 0.5", "0.45"]),
    ("tissue.poisson_ratio=-1", ["tissue.poisson_ratio = -1", "greater than -1", "0.45"]),
    ("tissue.youngs_modulus=0", ["tissue.youngs_modulus = 0", "greater than 0", "[Pa]"]),
    ("tissue.youngs_modulus=-1e5", ["tissue.youngs_modulus = -100000.0", "greater than 0", "[Pa]"]),
    ("tissue.density=0.0", ["tissue.density = 0.0", "greater than 0", "[kg/m³]"]),
    ("tissue.density=-1", ["tissue.density = -1", "greater than 0", "[kg/m³]"]),
    ("tissue.element=P3", ['tissue.element = "P3"', '"P1" or "P2"']),
    ("tissue.inertia=1", ["tissue.inertia = 1", "boolean", "true"]),
    ("tissue.rayleigh=[0.0, -1.0]", ["tissue.rayleigh.1 = -1.0", "greater than or equal to 0"]),
    ("tissue.rayleigh=[0.0]", ["tissue.rayleigh.1", "missing"]),
    ('tissue.clamp=["botom"]', ['tissue.clamp = ["botom"]', "left, right, front", "bed", '"bottom"']),
    ("tissue.clamp=bottom", ['tissue.clamp = "bottom"', "a list", '["bottom"]']),
    ('tissue.clamp=[""]', ['tissue.clamp.0 = ""', "at least 1 character"]),
    ("tissue.mesh={}", ["tissue.mesh.kind", "missing", '"block"']),
    ("tissue.mesh={kind='blok'}", ['tissue.mesh.kind = "blok"', '"block"', '"cylinder"', '"file"']),
    (f"{WOUND},width=2e-3}}", ["tissue.mesh.width = 0.002", "a slit is closed", '"ellipse"']),
    (f"{WOUND},shape='ellipse'}}", ["tissue.mesh.width = 0.0", "give its width"]),
    (f"{WOUND},shape='ellipse',width=0.06}}", ["tissue.mesh.width = 0.06", "0.06 m wide"]),
    (f"{WOUND},along='z'}}", ['tissue.mesh.along = "z"', '"x" or "y"']),
    (
        f"{WOUND},shape='ellipse',width=2e-3,generator='structured'}}",
        ['tissue.mesh.generator = "structured"', "an ellipse needs", '"gmsh"'],
    ),
    (f"{WOUND.replace('0.008', '0.03')}}}", ["tissue.mesh.depth = 0.03", "0.02 m high"]),
    (f"{WOUND.replace('length=0.02', 'length=0.05')}}}", ["tissue.mesh.length = 0.05", "0.04 m long"]),
    ("tissue.mesh={kind='file',path='a.stl'}", ["tissue.mesh.h is missing", "filled"]),
    ("tissue.mesh={kind='file',path='a.msh',file='a.msh'}", ["tissue.mesh.file = ", "no such key", "path"]),
    ("tissue.mesh={kind='file',path='a.msh',h=1e-3}", ["tissue.mesh.h = 0.001", "already holds tetrahedra", ".stl"]),
    ("tissue.mesh={kind='file',path='a.stl',h=1e-3,h_site=2e-3}", ["tissue.mesh.h_site = 0.002", "not exceed"]),
    ("tissue.mesh.growth=1.0", ["tissue.mesh.growth = 1.0", "greater than 1"]),
    ("tissue.material='rubber'", ['tissue.material = "rubber"', "neo-hookean", "exponential"]),
    ("tissue.stiffening=5.0", ["tissue.stiffening = 5.0", "a linear material has none", "exponential"]),
    ("tissue.prestretch=[1.1,1.0,0.9]", ["tissue.prestretch = [1.1, 1.0, 0.9]", "a linear material has none"]),
    ("tissue.material='exponential'", ["tissue.stiffening is missing", "neo-hookean"]),
    (
        "tissue.region=[{name='a',box=[[0,0,0],[1,1,-1]],material='neo-hookean'}]",
        ["tissue.region.a.material", "small and finite strain cannot be combined"],
    ),
    ("tissue.region=[{name='a'}]", ["tissue.region.a is refused", "only a mesh file names regions"]),
    ("tissue.region=[{name='a',depth=[2e-3,1e-3]}]", ["tissue.region.a.depth = [0.002, 0.001]", "write for example"]),
    ("tissue.region=[{name='a',depth=[0,0.03]}]", ["tissue.region.a.depth = [0.0, 0.03]", "0.02 m high"]),
    (
        "tissue.region=[{name='a',depth=[0,1e-3],box=[[0,0,0],[1,1,1]]}]",
        ["tissue.region.a.depth", "box also places the region"],
    ),
    ("tissue.region=[{name='a',box=[[0,0,0],[1,0,1]]}]", ["tissue.region.a.box", "must differ in x, y and z"]),
    (
        "tissue.region=[{name='a',depth=[0,1e-3]},{name='a',depth=[1e-3,2e-3]}]",
        ['tissue.region.name = "a"', "must be unique"],
    ),
    ("tissue.region=[{name='a',depth=[0,1e-3],poisson_ratio=0.5}]", ["tissue.region.a.poisson_ratio = 0.5", "less"]),
    (
        "piercing.exit.at=[-0.0085, 0.0, 0.0]",
        ["piercing.exit.at = [-0.0085, 0.0, 0.0]", "0.0015 m from piercing.entry", "0.002 m", "move them apart"],
    ),
    ("tissue.mesh.size=[0.06, 0.04]", ["tissue.mesh.size.2", "missing", "[m]"]),
    ("tissue.mesh.size=[0.06, 0.04, 0]", ["tissue.mesh.size.2 = 0", "greater than 0", "[m]"]),
    ("tissue.mesh.h=-1e-3", ["tissue.mesh.h = -0.001", "greater than 0", "[m]"]),
    ("tissue.mesh.h=true", ["tissue.mesh.h = true", "number", "[m]"]),
    ("tissue.mesh.h='4 mm'", ['tissue.mesh.h = "4 mm"', "number", "[m]"]),
    ("tissue.mesh.h_site=0.01", ["tissue.mesh.h_site = 0.01", "must not exceed h", "smaller"]),
    ("tissue.mesh.h=5", ["tissue.mesh.h = 5.0", "in metres", "h = 4e-3"]),
    ("tissue.mesh.generator=netgen", ['tissue.mesh.generator = "netgen"', '"structured" or "gmsh"']),
    ("tissue.boundary.bed.box=[[0,0,0],[1,0,1]]", ["tissue.boundary.bed.box", "must differ", "corners"]),
    ("tissue.boundary.bed.name=top", ["tissue.boundary.top", "already has a top", "rename"]),
    ("thread.suture=3", ["thread.suture = 3", "string", "2-0 polypropylene"]),
    ("thread.diameter=3e-4", ["thread.diameter = 0.0003", "also sets it", "leave out"]),
    ("thread.control_points=40.5", ["thread.control_points = 40.5", "integer", "40"]),
    ("thread.control_points=true", ["thread.control_points = true", "integer", "40"]),
    ("thread.control_points=3", ["thread.control_points = 3", "greater than or equal to 4"]),
    ("thread.graded=0.5", ["thread.graded = 0.5", "refused", "leave it out"]),
    ("tissue.reduction.blocks=2", ["tissue.reduction = { blocks = 2 }", "refused", "Krylov space", "leave it out"]),
    ("thread.path=[[0,0,0]]", ["thread.path = [[0, 0, 0]]", "at least 2"]),
    ("thread.path=[[0,0,0],[0,0,0]]", ["thread.path.1 = [0.0, 0.0, 0.0]", "must differ", "remove"]),
    ("thread.path=[[0,0,nan],[0,0,0]]", ["thread.path.0.2 = nan", "finite"]),
    ("thread.length=0", ["thread.length = 0", "greater than 0", "[m]"]),
    ("thread.damping=nan", ["thread.damping = nan", "finite", "[1/s]"]),
    ("thread.damping=-inf", ["thread.damping = -inf", "finite", "[1/s]"]),
    ("thread.bending='no'", ['thread.bending = "no"', "boolean", "true"]),
    ("thread.start={}", ["thread.start.kind", "missing", '"free", "fixed", "clamped", "pulled", "driven"']),
    ("thread.start.kind=freed", ['thread.start.kind = "freed"', '"driven"', 'nearest is "free"']),
    ("thread.start.mass=-1", ["thread.start.mass = -1", "greater than or equal to 0", "[kg]"]),
    ("thread.start={kind='pulled'}", ["thread.start.force", "missing", "[N]"]),
    ("thread.start={kind='pulled',force=[0,0,1],ramp=-1}", ["thread.start.ramp = -1", "[s]"]),
    ("thread.end={kind='driven',waypoints=[]}", ["thread.end.waypoints", "at least 1"]),
    ("thread.end={kind='driven',waypoints=[[0,0,0,0]]}", ["thread.end.waypoints", "0.0316 m away", "begin"]),
    (
        "thread.end={kind='driven',waypoints=[[0,0.03,0,0.01],[0,0,0,0]]}",
        ["thread.end.waypoints.1 = [0.0, 0.0, 0.0, 0.0]", "later than 0.0 s", "sort"],
    ),
    ("piercing.entry.name=exit", ['piercing.name = "exit"', "unique", "rename"]),
    ("piercing.entry.at=[0,0]", ["piercing.entry.at = [0, 0]", "three numbers", "[m]"]),
    ("piercing.entry.kind=slide", ['piercing.entry.kind = "slide"', '"sliding"', '"anchored"']),
    ("piercing.entry.direction=up", ['piercing.entry.direction = "up"', '"free", "normal" or three numbers']),
    ("piercing.entry.direction=[0,0,0]", ["piercing.entry.direction = [0, 0, 0]", "zero"]),
    ("piercing.entry.direction=[0,0,inf]", ["piercing.entry.direction = [0, 0, inf]", "three numbers"]),
    ("piercing.entry.footprint=-1e-3", ["piercing.entry.footprint = -0.001", "[m]"]),
    ("piercing.entry.weight=cubic", ['piercing.entry.weight = "cubic"', '"uniform" or "parabolic"']),
    ("piercing.entry.s=0.05", ["piercing.entry.s = 0.05", "0.0483 m", "move"]),
    ("piercing.exit.s=0.021", ["piercing.exit.s = 0.021", "piercing.entry.s = 0.021", "reorder"]),
    ("piercing.exit.s=0.01", ["piercing.exit.s = 0.01", "piercing.entry.s = 0.021", "reorder"]),
    ("piercing.entry.friction.static=-0.1", ["piercing.entry.friction.static = -0.1", "coefficient"]),
    (
        "piercing.entry.friction.kinetic=0.2",
        ["piercing.entry.friction.kinetic = 0.2", "static = 0.12", "lower"],
    ),
    (
        "piercing.entry.friction.grip=[0.1]",
        ["piercing.entry.friction.grip = [0.1]", "two of them", "[rising, falling]"],
    ),
    ("thread.bending=false", ["thread.bending = false", "piercing.entry.friction", "bending = true", "bending_factor"]),
    ("piercing.entry.kind=anchored", ["piercing.entry.friction", "anchored", "leave it out"]),
    ("piercing.exit.channel=1e-3", ["piercing.exit.channel = 0.001", "friction and a direction"]),
    ("piercing.entry.from=0.95", ["piercing.entry.until = 0.9", "later than from = 0.95", "raise"]),
    ("solve.dt=0", ["solve.dt = 0", "greater than 0", "[s]"]),
    ("solve.dt=-1e-3", ["solve.dt = -0.001", "greater than 0", "[s]"]),
    ("solve.dt=2", ["solve.dt = 2.0", "duration = 1.0", "lower"]),
    ("solve.dt=2026-01-01", ["solve.dt = 2026-01-01", "number", "[s]"]),
    ("solve.kind=statics", ['solve.kind = "statics"', '"dynamic" or "static"', 'nearest is "static"']),
    ("solve.load_steps=0", ["solve.load_steps = 0", "greater than or equal to 1"]),
    ("solve.epsilon=-1", ["solve.epsilon = -1", "greater than or equal to 0"]),
    ("solve.gravity=[0,0,nan]", ["solve.gravity.2 = nan", "finite", "[m/s²]"]),
    ("solve=5", ["solve = 5", "table"]),
    ("output.every=0", ["output.every = 0", "greater than or equal to 1"]),
    ("output.every=1e1", ["output.every = 10.0", "integer"]),
    ("title=3", ["title = 3", "string"]),
    # the override itself
    ("solve.dt", ["--set solve.dt", "a dotted key, = and a value"]),
    ("piercing.縫合 - x.at=[0,0,0]", ["--set piercing.縫合 - x.at", "quote", 'piercing."縫合 - x".at']),
    ("solve.dt=1e-3,", ["--set solve.dt=1e-3,", "not TOML"]),
    ("solve.dt=", ["--set solve.dt=", "not TOML"]),
    ("thread.suture=3-0 nylons", ["thread.suture = '3-0 nylons'", "not in the catalogue"]),
    ("piercing.middle.at=[0,0,0]", ["--set piercing.middle.at", "no entry middle", "entry, exit"]),
    ("piercing.2.at=[0,0,0]", ["--set piercing.2.at", "no entry 2", "entry, exit"]),
    ("title.text='a'", ["--set title.text", "title is a value", "set title itself"]),
]


@pytest.mark.parametrize(("override", "words"), REFUSED, ids=[override for override, _ in REFUSED])
def test_bad_input_is_refused_in_one_sentence(contract: Path, override: str, words: list[str]) -> None:
    with pytest.raises(ScenarioError) as caught:
        load(contract, [override])
    assert len(caught.value.problems) == 1
    message = caught.value.problems[0]
    assert "\n" not in message
    assert [word for word in words if word not in message] == [], message


def test_fixed_knots_need_points_for_every_piercing(contract: Path) -> None:
    with pytest.raises(ScenarioError) as caught:
        load(contract, ["thread.knots=fixed", "thread.control_points=9"])
    (message,) = caught.value.problems
    assert all(word in message for word in ("thread.control_points = 9", "2 piercings", "at least 10", "raise"))


def test_every_problem_has_its_sentence(contract: Path) -> None:
    with pytest.raises(ScenarioError) as caught:
        load(contract, ["solve.dt=0", "tissue.poisson_ratio=0.6", "thread.bogus=1"])
    assert [problem.split(" = ")[0] for problem in caught.value.problems] == [
        "tissue.poisson_ratio",
        "thread.bogus",
        "solve.dt",
    ]


def test_names_are_told_together_with_values(contract: Path) -> None:
    """Independent check: unknown, taken and repeated names, of a suture and a file too, beside a value and a key that
    are wrong; none is told twice."""
    faults = {
        "solve.dt": "0",
        "tissue.bogus": "1",
        "thread.suture": '"2-0 polypropylen"',
        "tissue.clamp": '["botom"]',
        "tissue.roller": '["bed", "bet"]',
        "tissue.boundary.bed.name": '"top"',
        "piercing.exit.name": '"entry"',
    }
    with pytest.raises(ScenarioError) as caught:
        load(contract, [f"{key}={value}" for key, value in faults.items()])
    told = [problem.split(" = ")[0].split(" is refused")[0] for problem in caught.value.problems]
    names = ["piercing.name", "tissue.boundary.top", "tissue.clamp", "tissue.roller"]
    assert told == ["tissue.bogus", "thread.suture", "solve.dt", *names]
    assert "the nearest is 2-0 polypropylene" in caught.value.problems[1]
    with pytest.raises(ScenarioError) as caught:
        load(contract, ['tissue.clamp=["botom"]'])
    assert len(caught.value.problems) == 1
    with pytest.raises(ScenarioError) as caught:
        load(contract, ["solve.dt=0", "tissue.mesh={kind='file',path='none.msh'}"])
    assert [problem.split(" = ")[0] for problem in caught.value.problems] == ["solve.dt", "tissue.mesh.path"]


def test_a_tube_is_told_of_its_wall_and_of_its_boundaries(contract: Path) -> None:
    """Independent check: the names that a mesh of that kind has, though its numbers are impossible."""
    with pytest.raises(ScenarioError) as caught:
        load(contract, ["tissue.mesh={kind='tube',radius=0.01,wall=0.01,length=0.05,h=2e-3}"])
    wall, clamp = caught.value.problems
    assert wall.startswith("tissue.mesh.wall = 0.01 is refused: it must be below radius")
    assert clamp.startswith('tissue.clamp = ["bottom"]') and "left, right, inner, outer" in clamp
    with pytest.raises(ScenarioError) as caught:
        load(contract, ["tissue.mesh={kind='tube',radius=0.01,wall=2e-3,length=0.05,gap=0.05,h=2e-3}"])
    gap, clamp = caught.value.problems
    assert gap.startswith("tissue.mesh.gap = 0.05 is refused: it must be below length") and "stump_left" in clamp


NEO = "tissue.material='neo-hookean'"


@pytest.mark.parametrize(
    ("overrides", "words"),
    [
        ([NEO, "tissue.stiffening=5.0"], ["tissue.stiffening = 5.0", "a neo-Hookean material has no stiffening"]),
        ([NEO, "tissue.rayleigh=[0.0,1e-3]"], ["tissue.rayleigh = [0.0, 0.001]", "take β = 0"]),
        ([NEO, "solve.coupling=staggered"], ['solve.coupling = "staggered"', "monolithic", 'material = "linear"']),
        ([NEO, "solve.scheme=linear", "solve.friction=two-pass"], ['solve.scheme = "linear"', "newton"]),
        ([NEO, "solve.friction=two-pass"], ['solve.friction = "two-pass"', "implicit"]),
        (
            [NEO, "tissue.fibres=[{direction=[0,0,0],k1=1.0,k2=1.0}]"],
            ["tissue.fibres.0.direction = [0.0, 0.0, 0.0]", "other than zero"],
        ),
        (
            [NEO, "tissue.region=[{name='a',box=[[0,0,0],[1,1,-1]],material='exponential'}]"],
            ["tissue.region.a.stiffening is missing"],
        ),
        (
            [NEO, "tissue.region=[{name='a',box=[[0,0,0],[1,1,-1]],material='linear'}]"],
            ["tissue.region.a.material", "small and finite strain cannot be combined"],
        ),
    ],
)
def test_what_does_not_go_with_finite_strain_is_refused(contract: Path, overrides: list[str], words: list[str]) -> None:
    """Independent check: one sentence with the key and the remedy, before anything is computed."""
    with pytest.raises(ScenarioError) as caught:
        load(contract, overrides)
    assert len(caught.value.problems) == 1, caught.value.problems
    assert [word for word in words if word not in caught.value.problems[0]] == [], caught.value.problems


@pytest.mark.parametrize(
    ("overrides", "words"),
    [
        (["solve.dt=5e-324"], ["solve.dt = 5e-324", "takes inf steps", "100000000", "1e-08 or more"]),
        (["solve.dt=1e-9"], ["solve.dt = 1e-09", "takes 1e+09 steps", "use 1e-08 or more", "shorten"]),
        (["solve.kind=static", "solve.load_steps=1000000000"], ["solve.load_steps = 1000000000", "at most 100000000"]),
        (["solve.dt=1e-5", "output.every=1"], ["output.every = 1", "100000 frames", "raise it to 5 or more"]),
    ],
)
def test_too_many_steps_or_frames_are_refused(contract: Path, overrides: list[str], words: list[str]) -> None:
    """Independent check: the key, how many it makes, how many are allowed and the remedy, which is enough."""
    with pytest.raises(ScenarioError) as caught:
        load(contract, overrides)
    assert len(caught.value.problems) == 1
    assert [word for word in words if word not in caught.value.problems[0]] == [], caught.value.problems
    load(contract, ["solve.dt=1e-5", "output.every=5"])


@pytest.mark.parametrize(
    "text",
    [
        "a = " + "[" * 100_000,
        "a = 1" + "0" * 5000,
        "[solve]\ndt = 0x" + "f" * 10_000,
        '"' + "k" * 100_000 + '" = 1',
        'title = "' + "x" * 100_000,
        "[solve]\n" + "\n".join(f"x{k} = 1" for k in range(3000)),
        '[[piercing]]\nname = "' + "n" * 50_000 + '"\nat = 1\n' * 2,
        "[thread]\npath = [" + "[0, 0, true]," * 20_000 + "]",
        '[thread]\nsuture = "' + "s" * 50_000 + '"',
        "[tissue]\nclamp = [" + '"c",' * 20_000 + "]",
    ],
    ids=lambda text: text[:20],
)
def test_a_refusal_is_short(tmp_path: Path, text: str) -> None:
    """Independent check: what is endless in a file is not repeated, nor a traceback."""
    (tmp_path / "endless.toml").write_text(text, encoding="utf-8")
    with pytest.raises(ScenarioError) as caught:
        load(tmp_path / "endless.toml")
    assert len(caught.value.problems) <= MOST_PROBLEMS + 1
    assert all(0 < len(problem) <= LONGEST_PROBLEM for problem in caught.value.problems)


@pytest.mark.parametrize("key", ["youngs_modulus", "poisson_ratio", "density", "mesh"])
def test_a_missing_key_is_named(key: str) -> None:
    data = tomllib.loads(CONTRACT)
    del data["tissue"][key]
    with pytest.raises(ScenarioError, match=rf"tissue\.{key} is missing: write for example"):
        parse(data)


def test_a_remedy_tells_what_a_key_means_and_not_its_whole_manual() -> None:
    """Independent check: what is told of a key with a long manual is its first clause, whole."""
    data = tomllib.loads(CONTRACT)
    data["solve"] |= {"organ": "reduced", "integrator": "trapezoidal"}
    with pytest.raises(ScenarioError) as caught:
        parse(data)
    integrator, organ = sorted(caught.value.problems)
    assert organ.endswith('(solution of a linear organ with inertia: "whole" or in a "krylov" space)')
    assert integrator.endswith('(time integration: "bdf2" (order 2) or "euler" (backward, order 1))')


def test_a_refused_value_without_a_default_is_shown_no_none() -> None:
    """Independent check: TOML has no None to write."""
    data = tomllib.loads(CONTRACT)
    data["tract"] = [{"between": ["entry", "exit"], "radius": -1e-3}]
    with pytest.raises(ScenarioError, match=r"correct it, or leave tract\.0\.radius out") as refused:
        parse(data)
    assert "None" not in str(refused.value)


def test_a_misspelt_key_is_not_missing_too() -> None:
    """Independent check: one sentence for one fault, with the key that was meant."""
    data = tomllib.loads(CONTRACT)
    data["tissue"]["young_modulus"] = data["tissue"].pop("youngs_modulus")
    with pytest.raises(ScenarioError) as caught:
        parse(data)
    assert len(caught.value.problems) == 1, caught.value.problems
    assert "tissue.young_modulus = " in caught.value.problems[0]
    assert "the nearest is tissue.youngs_modulus;" in caught.value.problems[0]


def test_a_thread_without_material_is_told_both_ways() -> None:
    data = tomllib.loads(CONTRACT)
    del data["thread"]["suture"]
    data["thread"] |= {"diameter": 3e-4, "density": 900}
    with pytest.raises(ScenarioError, match=r"thread\.youngs_modulus is missing: give suture .* or all of"):
        parse(data)
    thread = parse(data | {"thread": data["thread"] | {"youngs_modulus": 2e9}}).thread
    assert thread.poisson_ratio == 0.4


def test_without_tissue_there_is_no_normal() -> None:
    data = tomllib.loads(CONTRACT)
    del data["tissue"]
    with pytest.raises(ScenarioError, match=r"piercing\.entry\.direction = \"normal\" is refused: without"):
        parse(data)
    data["piercing"][0]["direction"] = [0, 0, 1]
    assert parse(data).tissue is None


@pytest.mark.parametrize("override", ["tissue.inertia=false", "solve.kind=static"])
def test_an_organ_without_inertia_must_be_held(contract: Path, override: str) -> None:
    load(contract, ["tissue.clamp=[]"])  # free, with inertia
    with pytest.raises(ScenarioError, match=r"tissue\.clamp = \[\] is refused: .* must be held"):
        load(contract, ["tissue.clamp=[]", override])


def test_files_that_cannot_be_read(tmp_path: Path) -> None:
    with pytest.raises(ScenarioError, match="does not exist; give"):
        load(tmp_path / "none.toml")
    with pytest.raises(ScenarioError, match="cannot be read"):
        load(tmp_path)
    bad = tmp_path / "bad.toml"
    bad.write_text('title = "a"\nsolve = [\n', encoding="utf-8")
    with pytest.raises(ScenarioError, match=r"not valid TOML: .*(line|end of document)"):
        load(bad)
    bad.write_text('title = "a"\ntitle = "b"\n', encoding="utf-8")
    with pytest.raises(ScenarioError, match=r"not valid TOML: .*line 2"):
        load(bad)
    bad.write_bytes(b'title = "\xff"')
    with pytest.raises(ScenarioError, match=r"not UTF-8 text \(byte 9\)"):
        load(bad)
    bad.write_bytes(b"")
    with pytest.raises(ScenarioError, match="thread is missing"):
        load(bad)


def test_a_byte_order_mark_is_no_part_of_a_scenario(tmp_path: Path) -> None:
    """Consistency check: a scene as editors of Windows save it is the scene."""
    plain = scenario_file("two_piercings").read_bytes()
    marked = tmp_path / "marked.toml"
    marked.write_bytes(codecs.BOM_UTF8 + plain)
    assert load(marked) == load("two_piercings")


def test_a_mesh_file_is_found_beside_the_scenario(contract: Path) -> None:
    mesh = 'tissue.mesh={kind="file", path="liver.msh", unit="mm"}'
    with pytest.raises(ScenarioError, match=r"tissue\.mesh\.path = .*liver\.msh.*no such file"):
        load(contract, [mesh])
    (contract.parent / "liver.msh").write_bytes(b"")
    with pytest.raises(ScenarioError, match=r"tissue\.mesh\.path = .*the file is empty"):
        load(contract, [mesh])
    (contract.parent / "liver.msh").write_text("$MeshFormat", encoding="utf-8")
    scenario = load(contract, [mesh])
    assert scenario.tissue is not None and isinstance(scenario.tissue.mesh, FileMesh)
    assert Path(scenario.tissue.mesh.path) == (contract.parent / "liver.msh").resolve()
    with pytest.raises(ScenarioError, match=r'tissue\.mesh\.unit = "inch" is refused: allowed are "m", "dm"'):
        load(contract, [mesh.replace("mm", "inch")])
    copied, digest = with_mesh_copy(scenario)
    assert digest == hashlib.sha256(b"$MeshFormat").hexdigest()
    assert parse(tomllib.loads(dump(copied))) == copied


def test_a_shipped_scene_by_its_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Independent check: a file of that name wins, a folder does not; an unknown name is told which are there."""
    monkeypatch.chdir(tmp_path)
    shipped = load("paper_figure_1")
    assert shipped == load(SCENES / "paper_figure_1.toml")
    (tmp_path / "paper_figure_1").mkdir()
    assert load("paper_figure_1") == shipped
    (tmp_path / "paper_figure_1").rmdir()
    (tmp_path / "paper_figure_1").write_text(CONTRACT, encoding="utf-8")
    assert load("paper_figure_1") == parse(tomllib.loads(CONTRACT))
    with pytest.raises(
        ScenarioError, match=r"paper_figure_2 does not exist; .* nearest name is paper_figure_1; .*two_pi"
    ):
        load("paper_figure_2")


def test_overrides_reach_every_place(contract: Path) -> None:
    scenario = load(
        contract,
        [
            "solve.dt=5e-4",
            "piercing.exit.footprint=2e-3",
            "piercing.0.at=[-0.011, 0, 0]",
            "tissue.element=P2",
            "thread.suture=3-0 nylon",
            "thread.end.mass=0.01",
            'thread.start={kind="pulled", force=[0, 0, 1]}',
            "output={every=1}",
        ],
    )
    entry, exit_ = scenario.piercing
    assert scenario.solve.dt == 5e-4
    assert (exit_.footprint, entry.at) == (2e-3, (-0.011, 0.0, 0.0))
    assert scenario.tissue is not None and scenario.tissue.element == "P2"
    assert scenario.thread.suture == "3-0 nylon"
    assert (scenario.thread.end.mass, scenario.thread.start.kind, scenario.output.every) == (
        0.01,
        "pulled",
        1,
    )


def test_defaults_that_depend_on_other_keys(contract: Path) -> None:
    graded, uniform = load(contract), load(contract, ["tissue.mesh={kind='block', size=[1,1,1], h=0.1}"])
    assert graded.tissue is not None and uniform.tissue is not None
    assert (graded.tissue.mesh.generator, uniform.tissue.mesh.generator) == ("gmsh", "structured")  # type: ignore[union-attr]
    assert graded.thread.poisson_ratio is None  # the catalogue's


def test_a_scenario_survives_being_written(contract: Path) -> None:
    scenario = load(contract, ["solve.dt=0.00033333333333333335", 'title="a \\"b\\" \\\\ \\t é 😀"'])
    text = dump(scenario)
    assert parse(tomllib.loads(text)) == scenario
    assert dump(parse(tomllib.loads(text))) == text
    for default in (
        "tolerance = 0.01",
        "load_steps = 10",
        "ramp",
        "mass = 0.0",
        'generator = "gmsh"',
        "from = 0.0",
    ):
        assert (default in text) == (default != "ramp"), default


@pytest.mark.parametrize(
    ("end", "kind", "ramp"),
    [("", "dynamic", RAMP), ("", "static", 0.0), (", ramp=0.0", "dynamic", 0.0), (", ramp=0.2", "dynamic", 0.2)],
)
def test_a_dead_load_grows_unless_it_is_said_to_be_there_at_once(
    contract: Path, end: str, kind: str, ramp: float
) -> None:
    """Independent check: 0.05 s in a dynamic run, or all of it, the load steps in a static one, and what is given is
    kept."""
    given = [f'thread.start={{kind="pulled", force=[0, 0, 1]{end}}}', f'solve.kind="{kind}"']
    start = resolved(load(contract, given), 0.0483, [0.021, 0.0323]).thread.start
    assert start.kind == "pulled" and start.ramp == ramp
    short = resolved(load(contract, [*given, "solve.duration=0.01"]), 0.0483, [0.021, 0.0323]).thread.start
    assert short.kind == "pulled" and short.ramp == (0.01 if ramp == RAMP else ramp)


def test_what_the_geometry_tells_is_written_too(contract: Path) -> None:
    scenario = resolved(load(contract), 0.0483, [0.021, 0.0323])
    written = tomllib.loads(dump(scenario))
    assert [hole["s"] for hole in written["piercing"]] == [0.021, 0.0323]
    assert written["thread"]["length"] == 0.0483
    assert parse(written) == scenario


TOML_VALUES = st.recursive(
    st.booleans()
    | st.integers(-(2**63), 2**63 - 1)
    | st.floats(allow_nan=False)
    | st.text(st.characters(exclude_categories=["Cs"])),
    lambda inner: st.lists(inner) | st.dictionaries(st.text(st.characters(exclude_categories=["Cs"])), inner),
    max_leaves=8,
)


@settings(deadline=None)
@given(TOML_VALUES, st.text(st.characters(exclude_categories=["Cs"])))
def test_any_value_reads_back_from_toml(value: object, key: str) -> None:
    assert tomllib.loads(f"{as_key(key)} = {as_toml(value)}") == {key: value}


def test_the_schema_describes_every_key() -> None:
    written = json.loads(json.dumps(schema(), allow_nan=False))
    tables = [written, *written["$defs"].values()]
    nameless = [
        (table["title"], key)
        for table in tables
        for key, field in table.get("properties", {}).items()
        if "description" not in field and key != "kind"
    ]
    assert nameless == []
    expected = {"title", "tissue", "thread", "piercing", "tract", "cut", "tie", "stitch", "contact", "solve", "output"}
    assert expected == set(written["properties"])
    assert "from" in written["$defs"]["Piercing"]["properties"]
    assert all(table.get("additionalProperties") is False for table in tables)


def test_every_meaning_is_of_a_key() -> None:
    """Consistency check: `keys.toml` against the classes of the tables."""
    tables = list(ScenarioTable.__subclasses__())
    for table in tables:
        tables += table.__subclasses__()
    keys = {(table.__name__, info.alias or name) for table in tables for name, info in table.model_fields.items()}
    assert {(table, key) for table, own in KEYS.items() for key in own} <= keys


def test_every_refusal_has_a_reason() -> None:
    """Consistency check: `refusals.toml` against the checks of the tables, and against the functions that refuse."""
    sources = [path for room in ROOMS for path in (SCENES.parents[1] / room).glob("*.py")]
    calls = [call for path in sources for call in ast.walk(ast.parse(path.read_text(encoding="utf-8")))]
    named = {"_refuse": set[str](), "because": set[str]()}
    # the place of a reason's name among the arguments
    places = {"_refuse": 1, "because": 0, "refuse": 3, "refused": 2, "fault": 3, "place_refused": 1, "one_sentence": 0}
    for call in (call for call in calls if isinstance(call, ast.Call)):
        called = call.func.attr if isinstance(call.func, ast.Attribute) else getattr(call.func, "id", "")
        if called in places and len(call.args) <= places[called]:  # of a folder, whose reason is a sentence
            continue
        if called in places and not isinstance(call.args[places[called]], ast.Name):  # which passes a name on
            name = ast.unparse(call.args[places[called]])
            reasons = named["_refuse" if called == "_refuse" else "because"]
            reasons.add(re.sub(r"\{\w+\}", r"[a-z_.]+", name.lstrip("f")[1:-1]))
    told = {name for table, own in REASONS.items() if table != "functions" for name in own}
    assert all(any(re.fullmatch(name, known) for known in told) for name in named["_refuse"])
    assert all(any(re.fullmatch(name, known) for name in named["_refuse"]) for known in told)
    assert named["because"] == set(REASONS["functions"])


def test_quantities_name_their_unit() -> None:
    units = ("[m]", "[Pa]", "[-]", "[kg/m³]", "[s]", "[1/s]", "[N]", "[kg]", "[m/s]", "[m/s²]")
    tables = schema()["$defs"]
    numbers = [
        (name, key)
        for name, table in tables.items()
        for key, field in table.get("properties", {}).items()
        if '"number"' in json.dumps(field) or '"integer"' in json.dumps(field)
        if not any(unit in field.get("description", "") for unit in units)
    ]
    assert numbers == [("FileMesh", "unit")]


def placed(*s: float, names: str = "abc", kind: str = "sliding") -> list[tuple[Piercing, float]]:
    """Piercings at abscissae."""
    return [(Piercing(name=name, at=(0.0, 0.0, 0.0), kind=kind), at) for name, at in zip(names, s, strict=False)]


def test_order_of_the_piercings() -> None:
    check_order(placed(0.01, 0.02, 0.03), 0.04)
    with pytest.raises(ScenarioError, match=r"piercing\.c\.s = 0\.02 is refused: .*piercing\.b\.s = 0\.02"):
        check_order(placed(0.01, 0.02, 0.02))
    with pytest.raises(ScenarioError, match=r"piercing\.\"my hole\"\.at = .* path is at s = 0\.05 m, .*0\.04 m"):
        check_order([(Piercing(name="my hole", at=(0.0, 0.0, 0.0)), 0.05)], 0.04)
    with pytest.raises(ScenarioError, match=r"piercing\.\"my hole\"\.s = 0\.05 is refused: it .*0\.04 m"):
        check_order([(Piercing(name="my hole", at=(0.0, 0.0, 0.0), s=0.05), 0.05)], 0.04)


def test_only_an_anchor_sits_at_an_end_of_the_thread() -> None:
    check_order(placed(0.0, 0.04, kind="anchored"), 0.04)
    for s in (0.0, 0.04):
        with pytest.raises(ScenarioError, match=rf'piercing\.a\.at = .* at s = {s:g} m, .*kind = "anchored"'):
            check_order(placed(s), 0.04)
    for s in (-0.001, 0.041):
        with pytest.raises(ScenarioError, match=r"which must lie between 0 and"):
            check_order(placed(s, kind="anchored"), 0.04)


def test_control_points_and_clamps() -> None:
    check_control_points(10, 2)
    with pytest.raises(ScenarioError, match=r"thread\.control_points = 9 is refused: .*at least 10"):
        check_control_points(9, 2)
    assert unknown_clamp(["bed"], ["bed"], "clamp") is None
    fault = unknown_clamp(["bad"], ["bed", "side"], "clamp")
    assert fault and re.match(r"clamp = \[\"bad\"\] .* boundaries are bed, side", fault)


def test_a_driven_end_rests_before_and_after() -> None:
    end = DrivenEnd(kind="driven", waypoints=((1.0, 0.0, 0.0, 0.0), (3.0, 2.0, 4.0, 8.0)))
    assert [end.position(time) for time in (0.0, 2.0, 9.0)] == [(0, 0, 0), (1, 2, 4), (2, 4, 8)]


class Above(ScenarioTable):
    """A table with a check."""

    x: float

    def _check_x(self) -> None:
        if self.x < 0.0:
            raise ValueError("above")


class Below(Above):
    """A table with a check more."""

    def _check_more(self) -> None:
        raise ValueError("below")


@pytest.mark.parametrize(
    ("given", "words"), [({"x": -1.0}, "above"), ({"x": 1.0}, "below"), ({"x": 1.0, "old": 2}, r".old = 2 .* write x")]
)
def test_a_table_is_checked_once_it_is_made(
    given: dict[str, float], words: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Independent check: the checks of the classes above come first, and former keys before all of them."""
    monkeypatch.setitem(FORMER, "Below", {"old": "write x"})
    with pytest.raises(ValidationError, match=words):
        Below(**given)
    assert Above(x=1.0).x == 1.0


def test_a_scenario_is_frozen(contract: Path) -> None:
    scenario: Scenario = load(contract)
    with pytest.raises(ValueError, match="frozen"):
        scenario.solve.dt = 1.0
