"""Balances that know nothing of the multipliers: forces on both sides' nodes, the drawn curve, work and energy."""

from typing import Any

import numpy as np
import pytest
from scipy.interpolate import BSpline

from coupling.reports.audit import initial_energies
from coupling.reports.observation import largest_gap, observe
from coupling.step.stepping import Step
from coupling.system import Friction, Piercing, State, System
from tests.bounds import GAP, ORDER, TWO_SOLVERS
from tests.coupling.test_two_ways import DT, END, ORGANS, START, scene, steps
from tests.thread.threads import (
    ABSCISSAE,
    LENGTH,
    RADIUS,
    Array,
    X,
    Z,
    block_organ,
    hairpin,
    hairpin_system,
    laid,
    load_step,
)
from thread.ends import Driven, Fixed


def forces_on_thread(system: System, step: Step) -> Array:
    """What inertia and elasticity ask for on the control points beyond the weight, shape `(n, 3)` [N]."""
    thread, new = system.thread, step.new
    inertia = thread.mass_matrix @ ((new.v - step.old.v) / DT - system.gravity)
    return inertia + thread.gradient(thread.points(new.q))


def forces_on_organ(organ: Any, step: Step) -> Array:
    """What inertia, damping and elasticity ask for on the nodes of the mesh beyond the weight, shape `(m, 3)` [N]; the
    clamp takes what is asked for on its own nodes, and they count as zero."""
    body, old, new = organ.elasticity, step.old.organ, step.new.organ
    free, N = body.free, organ.size
    K, M = body.K[free][:, free], body.M[free][:, free]
    asked = K @ organ.field(new)[:N] - body.body_force(np.asarray(organ.gravity))[free]
    if new.V.size:
        alpha, beta = organ.rayleigh
        V = (new.U - old.U)[:N] / DT
        asked += M @ ((V - old.V[:N]) / DT + alpha * V) + beta * (K @ V)
    return body.nodal(body.extended(asked))


@pytest.mark.parametrize("name", ORGANS)
def test_both_sides_feel_one_force(name: str) -> None:
    """Independent check, from masses, stiffness and motion alone, at every step: what the control points around the
    holes are pushed with is what the organ's nodes below them push back with. Around each hole it is what is recorded
    as its force, and its moment about the hole the couple recorded."""
    system, start = scene(name)
    for step in steps(name):
        on_thread, on_organ = forces_on_thread(system, step), forces_on_organ(system.organ, step)
        seen = observe(system, start, step.new)
        scale, pushed = max(np.linalg.norm(hole.force) for hole in seen), np.zeros(3)
        for hole in seen:
            first = int(system.thread.spline.basis(np.array([hole.s]))[0][0])
            around = slice(first, first + 4)
            force = on_thread[around].sum(axis=0)
            assert np.abs(force - hole.force).max() <= TWO_SOLVERS * scale
            moment = np.cross(step.new.q[around] - hole.x, on_thread[around]).sum(axis=0)
            assert np.abs(moment - hole.couple).max() <= TWO_SOLVERS * scale * RADIUS
            pushed += force
        assert np.abs(pushed + on_organ.sum(axis=0)).max() <= TWO_SOLVERS * scale
    assert scale > 0.1


@pytest.mark.parametrize("name", ["P1 quasi-static normal", "P1 dynamic fibre"])
def test_the_curve_passes_through_its_holes(name: str) -> None:
    """Independent check, at every step: P(s) by another code for splines, the hole's place from the organ's own field.
    `constraint_max` is what they are apart."""
    system, _ = scene(name)
    thread = system.thread
    organ: Any = system.organ
    for step in steps(name):
        new = step.new
        P = BSpline(thread.spline.knots, new.q, 3)(new.s)
        x = (organ.y0 + organ.Y @ organ.field(new.organ)).reshape(-1, 9)[:, :3]
        distance = np.linalg.norm(P - x, axis=1)
        assert distance.max() <= GAP * thread.section.diameter
        assert abs(largest_gap(system, new) - distance.max()) <= GAP * thread.section.diameter


def drawn_slowly(rough: Friction | None, parts: int) -> tuple[System, list[State]]:
    """Equilibria of the hairpin in an organ while a hand draws its end by 3 mm, in equal `parts` of the way."""
    way = np.array([[0.0, *END], [1.0, *(END + 3e-3 * Z + 1e-3 * X)]])
    holes = (Piercing("entry", friction=rough), Piercing("exit", friction=rough))
    system = hairpin_system(block_organ("P1", False), (Fixed(START), Driven(way)), 60, holes)
    states = [load_step(system, laid(system, ABSCISSAE, hairpin(RADIUS, LENGTH)), 1.0 / 3.0, 1.0)[-1].new]
    for k in range(1, parts + 1):
        states.append(load_step(system, states[-1], (1.0 + 2.0 * k / parts) / 3.0, 1.0)[-1].new)
    return system, states


def trapezium(force: Array, way: Array) -> float:
    """∫ F·dx over rows (k, …) by the trapezoidal rule."""
    return float(0.5 * np.sum((force[1:] + force[:-1]) * np.diff(way, axis=0)))


@pytest.mark.parametrize("rough", [None, Friction(0.1, 0.1, 2e-3, channel=4e-3)], ids=["ideal", "rough"])
def test_the_hands_work_is_stored_or_rubbed_away(rough: Friction | None) -> None:
    """Independent check (the force is the slope of the energy): the hand's work, by differences of its place and the
    force recorded there, is what thread and organ store, and F₀ + μN times the stretched length drawn where the holes
    are rough. The difference is that of the trapezoidal rule, of forces that swing where a knot that stays passes a
    hole: it falls faster than the step, without such knots with its square."""
    open_ = []
    for parts in (24, 48):
        system, states = drawn_slowly(rough, parts)
        work = trapezium(np.array([s.reaction[1] for s in states]), np.array([s.q[-1] for s in states]))
        stored = [initial_energies(system, state).elastic for state in (states[0], states[-1])]
        seen = [observe(system, states[0], state) for state in states]
        law = rough or Friction()
        friction = np.array([[law.grip + law.kinetic * hole.normal_force for hole in at] for at in seen])
        stretched = np.array([np.linalg.norm(system.passage_of(state).T, axis=1) for state in states])
        rubbed = trapezium(friction * stretched, np.array([[hole.slip for hole in at] for at in seen]))
        assert all(hole.state == "slip" for at in seen for hole in at)
        open_.append(abs(work - (stored[1] - stored[0]) - rubbed) / work)
    assert (rubbed > 0.05 * work) == (rough is not None)
    assert open_[1] < 1e-3
    assert np.log2(open_[0] / open_[1]) > 1.0 + ORDER
