"""The job of `two_piercings` at rest, on softer tissue and as it is shipped, against a boundary-value problem that
shares no line with it: two sleeves in an elastic body.
"""

import ast
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from coupling.reports.observation import site_compliance
from coupling.run.run import Run
from studies.scenario import load
from studies.simulation import Simulation, prepare
from tests.bounds import IDENTITY, ORACLE, ORACLE_SHIPPED
from tests.coupling import sleeves

MESH = ("tissue.mesh.h=6e-3", "tissue.mesh.accuracy=given", "tissue.mesh.h_site=2.5e-3")
SOFT = ("tissue.youngs_modulus=2e5", "piercing.entry.footprint=1.5e-3", "piercing.exit.footprint=1.5e-3")
FIRM = ("tissue.youngs_modulus=6e5", "piercing.entry.footprint=2e-3", "piercing.exit.footprint=2e-3")
FEW = ("thread.tolerance=1e-3", "thread.control_points=20")
POINTS = 80
ROUGH = tuple(f"piercing.{name}.friction={{static=0.12,kinetic=0.1,grip=2e-3}}" for name in ("entry", "exit"))
DRAWN = "thread.end.waypoints=[[0, 0.02, 0, 0.02], [0.5, 0.036, 0, 0.03]]"  # to the end of the last load step
WAYS = {
    "statics": ("solve.kind='static'",),
    "motion": ("solve.integrator='euler'", "solve.dt=5e-3", "solve.duration=0.7"),  # the hand rests from 0.4 s on
    "rough": ("solve.kind='static'", *ROUGH, DRAWN),
    "firm": (
        "solve.kind='static'",
        "solve.load_steps=5",
        *FIRM,
        *FEW,
    ),  # where the thread bends sharply at the holes
    "shipped": ("solve.kind='static'",),
}
PLANE = np.array([0, 2, 3, 5])  # x and z of a site's x and u among its nine numbers
FINER = 2  # times as many control points, and spans as much shorter


@cache
def at_rest(way: str, points: int = POINTS) -> tuple[Simulation, Run]:
    """Run a way of the scene to its end. But for the shipped one, it is on softer tissue, on a coarse mesh, and has so
    many control `points`: of the organ the oracle takes what its mesh answers."""
    other = () if way == "shipped" else (*MESH, *SOFT, f"thread.control_points={points}")
    simulation = prepare(load("two_piercings", [*other, *WAYS[way]]))
    now = simulation.beginning()
    while now.number < simulation.steps:
        now = simulation.next(now)
    return simulation, now


def oracle(simulation: Simulation) -> sleeves.Answer:
    """The same rod, pull, hand and holes for the oracle; of the organ the compliance of its sites alone."""
    system: Any = simulation.assembly.system
    thread, (pulled, driven) = system.thread, system.ends
    rod = sleeves.Rod(thread.EA, thread.EI, thread.spline.end, pulled.load[[0, 2]], driven.waypoints[-1, [1, 3]])
    of_plane = np.concatenate([PLANE, 9 + PLANE])
    y = system.organ.y0[of_plane].reshape(2, 2, 2)
    still = simulation if simulation.scenario.solve.kind == "static" else at_rest("statics")[0]  # without inertia
    C = site_compliance(still.assembly.system, still.start)[np.ix_(of_plane, of_plane)]
    rough = [hole.friction for hole in system.piercings]
    mu, grip, channel = (
        np.array([getattr(law, name) if law else none for law in rough])
        for name, none in (("kinetic", 0.0), ("grip", 0.0), ("channel", 1.0))
    )
    return sleeves.solve(rod, sleeves.Holes(y[:, 0], y[:, 1], C, np.pi * np.array([-0.5, 0.5]), mu, grip, channel))


def errors(way: str, points: int = POINTS) -> dict[str, float]:
    """Largest difference of each kind of number over the largest number of its kind; of places, over the largest
    displacement."""
    simulation, now = at_rest(way, points)
    told, start = oracle(simulation), simulation.start.s
    seen, holes = now.piercings, simulation.assembly.system.organ.y0.reshape(2, 9)[:, [0, 2]]
    pairs = {
        "force": (np.array([hole.force[[0, 2]] for hole in seen]), told.force),
        "couple": (np.array([-hole.couple[1] for hole in seen]), told.couple),
        "reaction": (now.state.reaction[1, [0, 2]], told.reaction),
        "tension": (np.array([[hole.tension_before, hole.tension_after] for hole in seen]), told.tension),
        "drawn through": (np.array([hole.slip for hole in seen]), start - told.s),
        "abscissa": (np.array([hole.s for hole in seen]), told.s),
        "displacement": (np.array([hole.x[[0, 2]] for hole in seen]) - holes, told.x - holes),
        "direction": (np.array([hole.tangent[[0, 2]] for hole in seen]), sleeves.unit(told.theta)),
    }
    return {kind: float(np.abs(got - exact).max() / np.abs(exact).max()) for kind, (got, exact) in pairs.items()}


@pytest.mark.parametrize("way", [way for way in WAYS if way != "shipped"])
def test_the_main_job_ends_where_the_elastica_does(way: str) -> None:
    """Independent check (an extensible elastica through two sleeves, solved by collocation): forces, couples, tensions,
    the hand's reaction, lengths drawn through, places and directions of the holes; at rest after a damped motion, in
    statics, slipping in rough holes whose couple presses, and bent sharply in a firm body."""
    _, now = at_rest(way)
    assert all(hole.state == "slip" and hole.slip > 1e-3 for hole in now.piercings)
    forces = np.array([hole.force for hole in now.piercings])
    assert np.abs(forces[:, 1]).max() <= IDENTITY * np.abs(forces).max()  # in the plane of the oracle
    off = errors(way)
    assert max(off.values()) <= ORACLE, off


def test_the_shipped_scene_ends_near_the_elastica() -> None:
    """Independent check: firm tissue bends the thread sharply, and the 160 control points of the scene leave more."""
    off = errors("shipped")
    assert max(off.values()) <= ORACLE_SHIPPED, off


def test_a_finer_thread_ends_nearer() -> None:
    """Independent check: what is between the two is the spans' length, of second order."""
    off = errors("rough", FINER * POINTS)
    assert max(off.values()) <= ORACLE / FINER**2, off


def test_the_oracle_knows_nothing_of_the_code() -> None:
    """Independent check: the text of the oracle imports numpy, scipy and the standard library alone."""
    tree = ast.parse(Path(sleeves.__file__).read_text(encoding="utf-8"))
    froms = {node.module for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)}
    names = {alias.name for node in ast.walk(tree) if isinstance(node, ast.Import) for alias in node.names}
    known = {"numpy", "scipy", "collections", "dataclasses", "functools"}
    assert {str(name).split(".")[0] for name in froms | names} == known
