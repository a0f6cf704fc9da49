"""Keys of a scenario whose organ is at finite strain: what runs with the linear organ runs, or is refused in words."""

from copy import deepcopy
from typing import Any

import numpy as np
import pytest

from studies.scenario import ScenarioError, parse
from studies.simulation import prepare

AUDIT = 1e-9  # of the energy at stake
BLOCK: dict[str, Any] = {
    "tissue": {
        "material": "neo-hookean",
        "youngs_modulus": 3e4,
        "poisson_ratio": 0.45,
        "density": 1070.0,
        "clamp": ["bottom"],
        "mesh": {"kind": "block", "size": [0.03, 0.02, 0.01], "h": 5e-3, "accuracy": "given"},
    },
    "thread": {
        "suture": "2-0 polypropylene",
        "control_points": 24,
        "damping": 20.0,
        "path": [
            [-0.015, 0, 0.015],
            [-0.005, 0, 0.006],
            [-0.005, 0, -0.005],
            [0.005, 0, -0.005],
            [0.005, 0, 0.006],
            [0.015, 0, 0.015],
        ],
        "start": {"kind": "pulled", "force": [-0.1, 0, 0.1], "ramp": 0.002},
        "end": {"kind": "driven", "waypoints": [[0, 0.015, 0, 0.015], [0.004, 0.0155, 0, 0.0155]]},
    },
    "piercing": [
        {"name": "entry", "at": [-0.005, 0, 0], "direction": "normal", "footprint": 2e-3},
        {"name": "exit", "at": [0.005, 0, 0], "footprint": 2e-3},
    ],
    "solve": {"dt": 1e-3, "duration": 4e-3, "load_steps": 3},
}
SKIN = {"name": "skin", "depth": [0.0, 5e-3], "youngs_modulus": 1e5, "material": "exponential", "stiffening": 5.0}
TURNED = {
    "kind": "driven",
    "waypoints": [[0, 0.015, 0, 0.015], [0.004, 0.0155, 0, 0.0155]],
    "turn": [[0, 0], [0.004, 0.5]],
}
AT_REST = {"kind": "static", "duration": 4e-3, "load_steps": 3}
ROUGH = {"friction": {"static": 0.1, "kinetic": 0.1}}
CROSSED = {  # over its two holes
    "path": [
        [0.012, 0, 0.012],
        [-0.005, 0, 0.004],
        [-0.005, 0, -0.005],
        [0.005, 0, -0.005],
        [0.005, 0, 0.004],
        [-0.012, 0, 0.012],
    ],
    "start": {"kind": "pulled", "force": [0.05, 0, 0.05], "ramp": 0.002},
    "end": {"kind": "driven", "waypoints": [[0, -0.012, 0, 0.012]]},
}
TIE = {"name": "knot", "between": ["entry", "exit"], "force": 0.05, "until": 0.003, "hold": 0.02}
RUNS: dict[str, tuple[dict[str, Any], str]] = {  # keys added, and an event that they make
    "a cut between two holes without friction": ({"cut": [{"s": 0.03, "time": 0.002}]}, "cut"),
    "a hole that ends": ({"piercing.1": {"until": 0.002}}, "ends"),
    "a hand at a hole": ({"piercing.1": {"draw": [[0, 0], [0.002, 5e-4], [0.003]]}}, ""),
    "gravity": ({"solve": {"gravity": [0.0, 0.0, -9.81]}}, ""),
    "a region": ({"tissue": {"region": [SKIN]}}, ""),
    "a twisted thread": ({"thread": {"twist": True, "end": TURNED}}, ""),
    "a twisted thread at rest": ({"thread": {"twist": True, "end": TURNED}, "solve": AT_REST}, ""),
    "a tie that holds": ({"tie": [TIE], "thread": CROSSED, "piercing.0": ROUGH, "piercing.1": ROUGH}, "tied"),
    "springs": ({"thread": {"energy": "springs"}}, ""),
    "a floating body": ({"tissue": {"clamp": []}}, ""),
}
REFUSED: dict[str, tuple[dict[str, Any], str]] = {
    "staggered": ({"solve": {"coupling": "staggered"}}, "need a linear organ"),
    "two-pass": ({"solve": {"friction": "two-pass"}}, "need a linear organ"),
    "stiffness damping": ({"tissue": {"rayleigh": [1.0, 1e-4]}}, "take β = 0"),
}


def block(keys: dict[str, Any]) -> dict[str, Any]:
    """The block with other keys."""
    table = deepcopy(BLOCK)
    for name, value in keys.items():
        part, _, number = name.partition(".")
        if number:
            table[part][int(number)] |= value
        else:
            table[part] = table.get(part, {}) | value if isinstance(value, dict) else value
    return table


@pytest.mark.parametrize("name", RUNS)
def test_it_runs_and_no_energy_is_lost(name: str) -> None:
    """Independent check: every joule of the external work is found again, and what was asked has happened."""
    keys, event = RUNS[name]
    simulation = prepare(parse(block(keys)))
    run, events = simulation.beginning(), []
    while run.number < simulation.steps:
        run = simulation.next(run)
        events += [each.kind for each in run.events]
    assert abs(run.energies.balance_error) <= AUDIT * run.energies.at_stake
    assert not event or event in events


@pytest.mark.parametrize("stretch", [1.1, 1.35])
def test_all_energy_of_a_uniform_stretch_is_beyond_small_strain_or_none(stretch: float) -> None:
    """Independent check: a cube of neo-Hookean tissue on rollers, under the traction of this stretch in theory; its
    strain energy is that of the audit."""
    mu, kappa = 3e4 / 2.6, 3e4 / 1.2
    squares = np.array([stretch, stretch**-0.3, stretch**-0.3]) ** 2
    ratio = float(np.sqrt(squares.prod()))
    stress = mu * ratio ** (-2 / 3) * (squares - squares.mean()) / ratio + kappa * (ratio - 1.0)
    traction = np.diag(stress * ratio / np.sqrt(squares))
    sides = (("left", "right"), ("front", "back"), ("bottom", "top"))
    loads = [{"boundary": pair[1], "traction": list(force)} for pair, force in zip(sides, traction, strict=True)]
    table = block({"tissue": {"poisson_ratio": 0.3, "inertia": False, "clamp": [], "load": loads}, "solve": AT_REST})
    table["tissue"]["roller"] = [pair[0] for pair in sides]
    path = [[0.0, 0.0, 0.05], [0.01, 0.0, 0.05]]
    thread = table["thread"] | {"path": path, "start": {"kind": "fixed"}, "end": {"kind": "fixed"}}
    simulation = prepare(parse(table | {"thread": thread, "piercing": []}))
    steps = list(simulation.advance())
    organ = steps[-1][1]().organ
    assert organ.strain == pytest.approx(stretch - 1.0, rel=1e-6)
    assert organ.deformed == pytest.approx(steps[-1][0].energy.elastic_tissue, rel=1e-9)
    assert (organ.strained, organ.rotated) == (organ.deformed if stretch > 1.2 else 0.0, 0.0)


@pytest.mark.parametrize("name", REFUSED)
def test_it_is_refused_before_anything_is_computed(name: str) -> None:
    """Behaviour: the sentence says why, and what to take."""
    keys, reason = REFUSED[name]
    with pytest.raises(ScenarioError, match=reason):
        parse(block(keys))


def test_a_tie_whose_strands_are_apart_at_the_start_is_refused_when_it_is_prepared() -> None:
    """Behaviour: the path does not cross itself over the holes, so the tie cannot begin; the key and the cause are
    named before the first step."""
    keys = {"tie": [TIE], "piercing.0": ROUGH, "piercing.1": ROUGH}
    with pytest.raises(
        ScenarioError,
        match=r"tie\.knot\.from = 0\.0 is refused: .* apart at the closest points, further than its two holes",
    ):
        prepare(parse(block(keys)))


@pytest.mark.parametrize("prestretch", [[1.1, 1.1, 1.1], [1.1, 1.0, 0.95]])
def test_prestretched_tissue_at_rest_stays_at_rest_in_time(prestretch: list[float]) -> None:
    """Independent check: tissue on rollers has shrunk at the start, and its energy, all of it round-off of that of the
    prestretch, is created and lost without a step being refused."""
    organ = BLOCK["tissue"] | {"roller": ["left", "front", "bottom"], "inertia": False, "prestretch": prestretch}
    organ = {key: value for key, value in organ.items() if key != "clamp"}
    thread = {"suture": "8-0 nylon", "path": [[0.002, 0.001, 0.01], [0.002, 0.001, -0.004]]}
    table = {"tissue": organ, "thread": thread, "piercing": [{"name": "a", "at": [0.002, 0.001, 0]}]}
    records = [record for record, _ in prepare(parse(table | {"solve": {"duration": 0.02, "dt": 5e-3}})).advance()]
    moved = np.array([record.piercings[0].displacement for record in records])
    assert np.abs(moved - moved[0]).max() <= AUDIT * np.abs(moved[0]).max()
