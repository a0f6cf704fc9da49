"""Stitches that write their threads: the places of each kind, its long form, refusals, and a wound that gapes."""

import tomllib
from copy import deepcopy
from typing import Any

import numpy as np
import pytest

from studies.command import command
from studies.scenario import ScenarioError, load, parse
from studies.scenario.stitch import NEAR, Stitch, bites_of, long_form, with_origin
from studies.scenario.toml import changed, read
from studies.simulation import prepare
from studies.simulation.assembly import assemble
from studies.simulation.remarks import not_across
from studies.simulation.tracts import Ball
from studies.simulation.wound import wounds_of
from tests.meshes.samples import NEEDS_GMSH
from thread.path import rounded_path
from tissue import TissueError

BITE, DEPTH, PITCH = 5e-3, 4e-3, 7e-3
STITCH: dict[str, Any] = {"name": "first", "at": [0.0, 0.0, 0.0], "bite": BITE, "depth": DEPTH, "force": 0.2}
WOUND: dict[str, Any] = {
    "tissue": {
        "youngs_modulus": 4e5,
        "poisson_ratio": 0.4,
        "density": 1070.0,
        "clamp": ["bottom"],
        "mesh": {
            "kind": "wound",
            "size": [0.04, 0.04, 0.016],
            "length": 0.016,
            "depth": 0.008,
            "h": 4e-3,
            "accuracy": "given",
        },
    },
    "thread": {"suture": "4-0 polypropylene"},
    "solve": {"kind": "static", "load_steps": 4},
}
DRAWN = {"force": None, "draw": [[0.0, 0.0], [1.0, 1e-3]]}
KINDS = {
    "single": ["left", "right"],
    "running": ["1.left", "1.right", "2.left", "2.right", "3.left", "3.right"],
    "vertical-mattress": ["far.left", "far.right", "near.right", "near.left"],
    "horizontal-mattress": ["1.left", "1.right", "2.right", "2.left"],
    "figure-of-eight": ["1.left", "1.right", "2.left", "2.right"],
    "purse-string": ["1.left", "1.right", "2.left", "2.right", "3.left", "3.right"],
}


def wound(*stitches: dict[str, Any], **more: Any) -> dict[str, Any]:
    """The wound with stitches, each the first with other keys."""
    return deepcopy(WOUND) | {"stitch": [STITCH | stitch for stitch in stitches or ({},)]} | more


def of_kind(kind: str) -> dict[str, Any]:
    """The keys of a stitch of a kind with a pitch, and three bites where it may have them."""
    return {"kind": kind, "pitch": PITCH} | ({"count": 3} if kind in ("running", "purse-string") else {})


@pytest.mark.parametrize("kind", KINDS)
def test_each_kind_leads_its_thread_through_its_holes(kind: str) -> None:
    """Independent check: the path passes each hole, in their order and upright, and is DEPTH deep between those of a
    bite (less near the edges), nowhere above half an ellipse; a tie joins the first and the last, of a running stitch
    none."""
    scenario = parse(wound(of_kind(kind)))
    assert [hole.name for hole in scenario.piercing] == [f"first.{name}" for name in KINDS[kind]]
    path, after = rounded_path(scenario.thread.path), 0.0
    for number, hole in enumerate(scenario.piercing):
        at, away = path.nearest(hole.place)
        assert away <= 1e-9 and at > after
        assert path.tangent([at])[0] == pytest.approx([0, 0, 1.0 if number % 2 else -1.0], abs=1e-9)
        if number % 2:
            deep = path.position(np.linspace(after, at, 101))[:, 2].min()
            assert -deep == pytest.approx(DEPTH * (NEAR if ".near." in hole.name else 1.0), rel=1e-9)
        after = at
    pairs = [(scenario.piercing[0].name, scenario.piercing[-1].name)] if kind != "running" else []
    assert [tie.between for tie in scenario.tie] == pairs
    assert [tract.between for tract in scenario.tract] == [
        (one.name, other.name) for one, other in zip(scenario.piercing[::2], scenario.piercing[1::2], strict=True)
    ]


@pytest.mark.parametrize("kind", KINDS)
def test_a_tract_fits_into_its_bite(kind: str) -> None:
    """Independent check: somewhere between the surface z = 0 and the lip x = 0 the path of each bite is deeper than
    the default radius, which is the footprint if half of that depth is larger."""
    for depth in (2.5 * DEPTH, DEPTH, 1.5e-3, 0.4e-3):
        scenario = parse(wound(of_kind(kind) | {"depth": depth}))
        path, holes = rounded_path(scenario.thread.path), {hole.name: hole for hole in scenario.piercing}
        for tract in scenario.tract:
            ends = [path.nearest(holes[name].place)[0] for name in tract.between]
            inside, footprint = path.position(np.linspace(*ends, 1001)), holes[tract.between[0]].footprint
            to_lip = np.inf if kind == "purse-string" else np.abs(inside[:, 0])
            deepest = np.minimum(-inside[:, 2], to_lip).max()
            assert tract.radius is not None
            assert min(footprint, 0.5 * deepest) <= tract.radius <= min(footprint, 0.9 * deepest)


@pytest.mark.parametrize("kind", KINDS)
def test_holes_are_where_surgeons_make_them(kind: str) -> None:
    """Independent check: distances of the holes from the line, along it, and of a purse-string from its middle."""
    bites = bites_of(Stitch.model_validate(STITCH | of_kind(kind)))
    places = {name: place for bite in bites for name, place in zip(bite.names, (bite.first, bite.last), strict=True)}
    if kind == "purse-string":
        radii = [np.hypot(*place) for place in places.values()]
        assert radii == pytest.approx([PITCH] * 6)
        bite = bites[0]
        assert np.linalg.norm(np.subtract(bite.first, bite.last)) == pytest.approx(2 * PITCH * np.sin(BITE / PITCH))
        return
    for name, (_, across) in places.items():
        share = NEAR if "near" in name else 1.0
        assert across == pytest.approx(share * BITE * (1.0 if "right" in name else -1.0))
    along = sorted({along for along, _ in places.values()})
    apart = {"single": 0, "vertical-mattress": 0, "running": 2}.get(kind, 1)
    assert along[-1] - along[0] == pytest.approx(apart * PITCH)


def test_a_stitch_turns_with_its_wound() -> None:
    """Independent check: along x the left hole is at lower y, as the left lip is; a surface that is no plane is asked
    for the places; unequal bites are on their sides; without an organ the thread is led as before."""
    table = wound({"bite": [4e-3, 6e-3]})
    table["tissue"]["mesh"] |= {"along": "x"}
    left, right = parse(table).piercing
    assert left.at == pytest.approx((0, -4e-3, 0)) and right.at == pytest.approx((0, 6e-3, 0))
    tube = wound({"at": [0, 0, 0.02], "along": [1, 0, 0]})
    tube["tissue"] |= {
        "clamp": ["left"],
        "mesh": {"kind": "tube", "radius": 0.02, "wall": 8e-3, "length": 0.05, "h": 4e-3},
    }
    left, right = parse(tube).piercing
    assert left.at == "surface" and left.near == pytest.approx((0, BITE, 0.02)) and left.along == (0, 0, 1)
    bare = parse({key: value for key, value in wound({"tract": False}).items() if key != "tissue"})
    assert [hole.direction for hole in bare.piercing] == [(0, 0, -1), (0, 0, 1)]


def test_stitches_are_one_thread_that_is_cut_between() -> None:
    """Independent check: each cut is on the strand between two stitches, and pieces have the holes of one."""
    scenario = parse(wound({"at": [0, -8e-3, 0]}, {"name": "second"}, {"name": "third", "at": [0, 8e-3, 0]}))
    path = rounded_path(scenario.thread.path)
    s = [path.nearest(hole.place)[0] for hole in scenario.piercing]
    assert len(scenario.thread.cuts) == 2
    assert np.searchsorted(scenario.thread.cuts, s).tolist() == [0, 0, 1, 1, 2, 2]
    assert all(path.position([cut])[0, 2] > 0.0 for cut in scenario.thread.cuts)


@pytest.mark.parametrize("force", [0.05, 0.2])
@pytest.mark.parametrize("kind", ["single", "figure-of-eight"])
def test_a_stiff_loop_does_not_run_out_of_its_knot(kind: str, force: float) -> None:
    """Independent check: 2-0 polypropylene in bites of 2 mm straightens its bends, which takes thread from both tails;
    the loop that is then tied is as long as with tails 10 mm longer."""
    table = wound({"kind": kind, "pitch": 3e-3, "bite": 2e-3, "depth": 1.5e-3, "force": force, "tract": False})
    table = long_form({key: value for key, value in table.items() if key != "tissue"})
    longer = deepcopy(table)
    longer["thread"]["suture"] = table["thread"]["suture"] = "2-0 polypropylene"
    for end in (0, -1):
        longer["thread"]["path"][end][2] += 0.01
    found, more = ([step for step, _ in prepare(parse(each)).advance()][-1].ties[0] for each in (table, longer))
    assert found.state == more.state == "tied"
    assert found.length == pytest.approx(more.length, rel=2e-3)


def test_the_long_form_is_the_same_scenario(tmp_path: Any, capsys: pytest.CaptureFixture[str]) -> None:
    """Independent check: what `check --write` prints is parsed to an equal scenario; a key that names no entry is set
    in all of them."""
    import tomli_w

    file = tmp_path / "wound.toml"
    file.write_text(
        tomli_w.dumps(
            wound(
                {"friction": {"static": 0.2, "kinetic": 0.1}}, of_kind("running") | {"name": "row", "at": [0, -0.01, 0]}
            )
        )
    )
    assert command.main(["check", str(file), "--write", "--set", "stitch.bite=6e-3"]) == 0
    text = capsys.readouterr().out
    assert "[[stitch]]" not in text and parse(tomllib.loads(text)) == load(file, ["stitch.bite=6e-3"])
    bites = [stitch["bite"] for stitch in changed(wound({}, {"name": "b"}), {"stitch.bite": 6e-3})["stitch"]]
    assert bites == [6e-3, 6e-3]


@pytest.mark.parametrize(
    ("stitch", "words"),
    [
        ({"bite": 0.0}, r"stitch\.first\.bite = 0\.0 is refused"),
        ({"kind": "singel"}, r'nearest is "single"'),
        ({"count": 3}, r"count = 3 is refused: a single stitch has a fixed count"),
        (DRAWN | {"from": 0.5}, r"from = 0\.5 is refused: the rows of draw have their own times"),
        (DRAWN | {"tract": False, "friction": {"static": 0.2, "kinetic": 0.1}}, r"friction is refused: hands hold"),
        ({"along": [0, 0, 1]}, r"along = .*it is parallel to normal"),
        ({"normal": [0, 0, 0]}, r"normal = .*must not be zero"),
        ({"from": 0.5, "until": 0.4}, r"until = 0\.4 is refused: it must be later than from"),
        ({"from": 0.75}, r"stitch\.first\.from = 0\.75 is refused: .*default is three quarters .* 0\.75 s; lower it"),
        (
            {"footprint": 1e-7},
            r'piercing\."first\.left"\.footprint = .*; it is part of stitch \'first\': change its at, ',
        ),
        ({"kind": "running", "hold": 1.0}, r"hold = 1\.0 is refused: a stitch without a tie"),
        ({"draw": [[0, 0]]}, r"force = 0\.2 is refused: hands draw with a force or by a length"),
        ({"depth": 0.0}, r"depth = 0\.0 is refused: without depth a stitch is straight"),
        ({"depth": 0.0, "kind": "running", "tract": 1e-3}, r"tract = 0\.001 is refused: a stitch without depth"),
        ({"kind": "purse-string", "pitch": 5e-3, "count": 6}, r"bite = 0\.005 is refused: 6 bites"),
        (
            {"bites": 1},
            r"stitch\.first\.bites = 1 is refused: there is no such key; the nearest is stitch\.first\.bite",
        ),
    ],
)
def test_refused_stitches(stitch: dict[str, Any], words: str) -> None:
    """Independent check: each fault has the key, the value and the remedy, and no fault of a path that is missing."""
    with pytest.raises(ScenarioError, match=words) as refused:
        parse(wound(stitch))
    assert "thread.path" not in str(refused.value)


@pytest.mark.parametrize(
    ("stitch", "words"),
    [
        ({"bite": 0.03}, r'piercing\."first\.left"\.at = .*, which is 0\.01 m away; .* \[-0\.02, 0\.0, 0\.0\]; {}'),
        ({"at": [0, 0, -3e-3]}, r"""piercing "first\.left": direction = 'normal' .*; {}"""),
        ({"tract": 4e-3}, r'tract\.0\.between = \["first\.left", .* use a smaller tract\.0\.radius; {}'),
    ],
)
def test_a_refused_part_of_a_stitch_names_the_stitch(stitch: dict[str, Any], words: str) -> None:
    """Independent check: a hole outside of the organ, one without a normal and a tract without room are found in the
    organ only, under keys that are not in the file; in the long form nothing is said of a stitch."""
    table = wound(stitch)
    for data, hint in (
        (table, r"it is part of stitch 'first': change its at, bite, depth"),
        (tomllib.loads(_written(table)), ""),
    ):
        with pytest.raises((ScenarioError, TissueError), match=words.format(hint).removesuffix("; ")) as refused:
            prepare(parse(data))
        assert ("stitch" in str(refused.value)) == bool(hint)


@pytest.mark.parametrize(("along", "axis"), [("y", 0), ("x", 1)])
@pytest.mark.parametrize(("way", "named"), [(0.0, False), (0.9 * BITE, False), (1.1 * BITE, True), (-1.1 * BITE, True)])
def test_a_stitch_on_one_side_of_the_wound_has_a_remark(along: str, axis: int, way: float, named: bool) -> None:
    """Independent check: the stitch is moved across the wound, along either axis, until both holes are on one side."""
    table = wound({"at": [way if axis == k else 0.0 for k in range(3)]})
    table["tissue"]["mesh"]["along"] = along
    assert [(each.code, each.where) for each in not_across(parse(table))] == [("not-across", "first")] * named


@pytest.mark.parametrize(("along", "axis"), [("y", 1), ("x", 0)])
@pytest.mark.parametrize(("way", "named"), [(0.008, False), (-0.0079, False), (0.0081, True), (-0.0081, True)])
def test_a_stitch_beyond_the_end_of_the_wound_has_a_remark(along: str, axis: int, way: float, named: bool) -> None:
    """Independent check: the stitch is moved along the wound, whose ends are 8 mm from the middle."""
    table = wound({"at": [way if axis == k else 0.0 for k in range(3)]})
    table["tissue"]["mesh"]["along"] = along
    remarks = list(not_across(parse(table)))
    assert [(each.code, each.where) for each in remarks] == [("not-across", "first")] * named
    assert all("beyond the end of the wound, 0.1 mm" in each.message for each in remarks)


@pytest.mark.parametrize(
    "shape", [{"generator": "structured"}, pytest.param({"shape": "ellipse", "width": 3e-3}, marks=NEEDS_GMSH)]
)
@pytest.mark.parametrize(
    ("stitch", "closes"),
    [
        ({"at": [0, -0.0079, 0]}, True),
        ({"at": [0, -0.0081, 0]}, False),
        ({"at": [0, 0.009, 0], "kind": "figure-of-eight", "pitch": 4e-3}, True),
        ({"kind": "purse-string", "pitch": 0.014, "count": 6, "bite": 2e-3}, True),
    ],
)
def test_a_stitch_beyond_the_end_of_the_wound_does_not_close_it(
    shape: dict[str, Any], stitch: dict[str, Any], closes: bool
) -> None:
    """Independent check: a stitch beyond the end crosses intact tissue; one next to the end crosses the wound, and so
    do a purse-string around it and an eight whose holes are on both sides of the end."""
    table = wound({"tract": False} | stitch)
    table["tissue"]["mesh"] |= shape
    simulation = prepare(parse(table))
    now, lips = simulation.beginning(), simulation.open_lips
    assert lips is not None
    ((found,),) = wounds_of(now.system, [lips], now.piercings)
    assert [bite.stitch for bite in found.near] == ["first"] * len(now.piercings)
    assert found.bites == (found.near if closes else ())


@pytest.mark.parametrize("short", [0.0, 1e-13, 2e-12])
def test_a_tract_that_grazes_the_end_of_the_wound_is_laid(short: float) -> None:
    """Independent check: at a radius from the end, short of it by round-off, the tract is in one part; nearer, in
    two."""
    table = wound({"at": [0, 0.013 - short, 0]})
    table["tissue"]["mesh"] |= {"size": [0.05, 0.05, 0.016], "length": 0.024, "h": 5e-3, "generator": "structured"}
    holes = prepare(parse(table)).assembly.holes
    assert {hole.part for hole in holes if isinstance(hole, Ball)} == ({0, 1} if short > 1e-12 else {0})


def test_a_tie_of_another_name_is_no_part_of_a_stitch() -> None:
    """Independent check: only ties can be written next to stitches, and names can begin alike."""
    late, none = "tie.{} = 0.2 is refused: it must be later", "thread.suture = 1 is refused"
    for key, name in (("first.until", "first"), ('"first.b".until', "first.b"), ("firsts.until", None)):
        said = with_origin(late.format(key), ["first", "first.b"])
        assert said.endswith(f"stitch {name!r}: change its from, until, force or hold") == (name is not None)
    assert with_origin(none, ["first"]) == none and with_origin(late, []) == late
    assert with_origin("thread.cuts = [0.1] is refused: it", ["first"]).endswith(
        "change at, bite, depth or pitch of one"
    )


def test_stitches_and_a_path_are_refused() -> None:
    """Independent check: there is one thread, and names are unique."""
    with pytest.raises(ScenarioError, match=r"thread\.path is refused: \[\[stitch\]\] writes it"):
        parse(wound(thread=WOUND["thread"] | {"path": [[0, 0, 0], [0, 0, 1]]}))
    with pytest.raises(ScenarioError, match=r"stitch\.name"):
        parse(wound({}, {"at": [0, 8e-3, 0]}))


@pytest.mark.parametrize("mesh", ["x", [1], 5])
def test_a_stitch_in_an_organ_without_a_table_for_its_mesh_is_refused_by_that(mesh: Any) -> None:
    """Independent check: the mesh that is none is named, and no traceback is left."""
    tables = read("figure_of_eight")
    with pytest.raises(ScenarioError, match=r"tissue\.mesh = .* is refused"):
        parse(tables | {"tissue": tables["tissue"] | {"mesh": mesh}})


def test_a_stitch_is_drawn_to_its_force_and_locked() -> None:
    """Independent check: hands draw both strands to the force, the loop keeps that when it is locked, and its images
    under the half turn of the wound are equal."""
    *_, (drawn, _), (locked, _) = prepare(parse(wound({"friction": {"static": 0.1, "kinetic": 0.1}}))).advance()
    assert [tie.state for tie in locked.ties] == ["tied"]
    assert drawn.ties[0].force == pytest.approx(STITCH["force"], rel=1e-3)
    assert locked.ties[0].force == pytest.approx(STITCH["force"], rel=1e-3)
    left, right = locked.piercings
    assert left.tension_before == pytest.approx(right.tension_after, rel=0.02)


@pytest.mark.parametrize("depth", [0.0, DEPTH])
def test_hands_draw_a_length_at_both_ends(depth: float) -> None:
    """Independent check: two hands draw the strand between them shorter, and its tension is EA times that over its rest
    length (within 3 %: the strain jumps at a hole over a part of √(EI/T)); their tails are slack. Without depth the
    stitch is straight."""
    drawn = 2e-5
    stitch = {key: value for key, value in STITCH.items() if key != "force"}
    table = {"thread": WOUND["thread"], "solve": WOUND["solve"]}
    table["stitch"] = [stitch | {"depth": depth, "draw": [[0.0, 0.0], [1.0, drawn]]}]
    simulation = prepare(parse(table))
    assert not simulation.assembly.system.ties
    *_, (last, _) = simulation.advance()
    left, right = last.piercings
    assert max(abs(left.tension_before), abs(right.tension_after)) < 1e-9
    assert [left.slip, right.slip] == pytest.approx([-drawn, drawn])
    if not depth:
        taut = simulation.assembly.system.thread.EA * 2 * drawn / (2 * BITE - 2 * drawn)
        assert left.tension_after == pytest.approx(taut, rel=0.03)
        assert right.tension_before == pytest.approx(left.tension_after)
        places = simulation.assembly.path.position(np.linspace(0.0, 0.02, 9))
        assert np.ptp(places, axis=0)[1:] == pytest.approx([0, 0])


@pytest.mark.parametrize("length", [None, 0.034])
def test_a_thread_is_laid_into_the_gaping_wound(length: float | None) -> None:
    """Independent check: an ellipse in prestretched skin gapes before the thread is there. The thread that is laid into
    it is longer by that, and bears less than a hundredth of what the same thread, of the length of its path on the
    undeformed organ, would bear; a length that is given stays."""
    table = wound({"tract": False})
    table["tissue"] |= {"material": "neo-hookean", "prestretch": [1.1, 1.0, 0.91], "clamp": ["left", "right", "bottom"]}
    if length is not None:
        table = tomllib.loads(_written(table))
        table["thread"]["length"] = length
    assembly = assemble(parse(table))
    holes = assembly.organ.site_variables(assembly.organ.start()).reshape(-1, 9)[:, :3]
    gape = np.linalg.norm(holes[1] - holes[0]) - 2 * BITE
    assert gape > 2e-4
    rest = assembly.system.thread.spline.end
    assert rest == pytest.approx(length or assembly.laid.length)
    assert 0.5 * gape < assembly.laid.length - assembly.path.length < gape  # the gape draws across, and little down
    if length is None:
        strained = assembly.system.thread.EA * gape / np.diff(assembly.s)[0]
        assert np.abs(assembly.start().N).max() < 0.01 * strained


def _written(table: dict[str, Any]) -> str:
    """The long form of a scenario in TOML."""
    import tomli_w

    from studies.scenario.stitch import long_form

    return tomli_w.dumps(long_form(table))


def test_a_rough_running_stitch_is_drawn_through_its_tracts() -> None:
    """Independent check: from slack, in four load steps, a hand draws at the last hole, whose own friction takes a part
    of its force. No hole and no ball breaks the law of friction, and behind the last bite less of the force is left."""
    rough = {"friction": {"static": 0.2, "kinetic": 0.2}, "count": 2, "until": 1.0, "at": [0, -3e-3, 0]}
    table = wound(of_kind("running") | rough)
    *_, (last, _) = prepare(parse(table)).advance()
    assert 0.8 * STITCH["force"] < last.piercings[-1].tension_before < STITCH["force"]
    assert max(hole.cone_residual for hole in last.piercings) <= 1e-6 * STITCH["force"]
    assert last.piercings[-2].tension_before < last.piercings[-1].tension_before
