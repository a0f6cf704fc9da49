"""Steps made at once in compiled loops are those made one after the other: the same numbers, iterations, energies and
events; and what the loops do not do is done all the same."""

from collections.abc import Callable
from dataclasses import astuple, dataclass, replace
from typing import Any

import numpy as np
import pytest

import coupling.run.run
import tissue
from coupling.calls import asked_before_corrections
from coupling.errors import CouplingError
from coupling.rest.laying import start
from coupling.run import course, events
from coupling.run.cutting import Cut
from coupling.run.march import march
from coupling.run.run import Run, begin
from coupling.step.packets import fitted
from coupling.step.stepping import bdf2_step, release, try_step
from coupling.system import Piercing, System
from studies.scenario import Scenario, load
from studies.simulation import prepare
from tests.bounds import AXIAL, IDENTITY, RESIDUAL, TWO_SOLVERS
from tests.coupling.test_compiled import ROUGH, drawn, pulled_through
from thread.catalogue import suture
from thread.ends import Driven, End, Fixed, Free, Pulled
from thread.knots import uniform_knots
from thread.quadrature import gauss_rule
from thread.spline import Spline
from thread.thread import MASS_POINTS, Thread
from tissue.organs import krylov

EULER, BDF2 = 'solve.integrator="euler"', 'solve.integrator="bdf2"'
OUT = [[0.0, 0.005, 0.0, 0.02], [0.06, 0.005, 0.0, 0.065]]  # the free end comes out of both holes
GENTLE = [
    "tissue.mesh.h=8e-3",
    "tissue.mesh.accuracy=given",
    "tissue.element=P2",
    "tissue.element=P2",
    "tissue.mesh.h_site=4e-3",
    "tissue.inertia=false",
    "solve.gravity=[0, 0, -9.81]",
]


def figure_1(*overrides: str) -> Scenario:
    """The thread of the paper's first figure with other keys."""
    return load("paper_figure_1", ['solve.newton="compiled"', *overrides])


def slow(scene: Scenario, dt: float, **solve: Any) -> Scenario:
    """A scene in short steps."""
    return scene.model_copy(update={"solve": scene.solve.model_copy(update={"dt": dt, **solve})})


SCENES: dict[str, Callable[[], Scenario]] = {
    "rings": lambda: figure_1(EULER),
    "rings, BDF2": lambda: figure_1(BDF2),
    "friction": lambda: figure_1(EULER, *(f"piercing.{hole}.{ROUGH}" for hole in ("entry", "exit"))),
    "friction, BDF2": lambda: figure_1(BDF2, *(f"piercing.{hole}.{ROUGH}" for hole in ("entry", "exit"))),
    "directions": lambda: slow(drawn({"channel": 5e-3}), 5e-4, integrator="euler"),
    "directions, BDF2": lambda: slow(drawn({"channel": 5e-3}), 5e-4),
    "taut on long spans": lambda: slow(drawn(suture="8-0 nylon"), 2.5e-4, integrator="euler"),
    "limp": lambda: slow(drawn({"friction": None}, bending=False), 5e-4),
    "knots that stand still, BDF2": lambda: slow(drawn({"channel": 5e-3}, knots="fixed"), 5e-4),
    "organ without inertia": lambda: load("two_piercings", [*GENTLE, EULER, "solve.dt=8e-4"]),
    "organ without inertia, BDF2": lambda: load("two_piercings", [*GENTLE, BDF2]),
    "organ in its Krylov space": lambda: load("two_piercings", [*KRYLOV, EULER]),
    "organ in its Krylov space, BDF2": lambda: load("two_piercings", [*KRYLOV, BDF2]),
}
KRYLOV = [
    "tissue.mesh.h=6e-3",
    "tissue.mesh.accuracy=given",
    "tissue.element=P2",
    "tissue.mesh.h_site=3e-3",
    "solve.gravity=[0, 0, -9.81]",
    'solve.organ="krylov"',
]
BEGUN, STEPS = 12, 40


@dataclass
class Both:
    """A run after steps made at once, and after the same made one by one, with the events and iterations of these."""

    at_once: Run
    one_by_one: Run
    events: list[Any]
    iterations: int
    made: list[int]


def both(run: Run, dt: float, count: int, monkeypatch: pytest.MonkeyPatch) -> Both:
    """Make steps in both ways; `made` are those of each call of the loops."""
    made: list[int] = []

    def watched(*given: Any) -> course.Course | None:
        found = march(*given)
        made.append(0 if found is None else found.made)
        return found

    monkeypatch.setattr(coupling.run.run, "march", watched)
    at_once, now, events, iterations = run.steps(dt, count), run, [], 0
    for _ in range(count):
        now = now.step(dt)
        events, iterations = [*events, *now.events], iterations + now.iterations
    return Both(at_once, now, events, iterations, made)


def begun(scene: Scenario, steps: int = BEGUN) -> Run:
    """A run of a scene after its first steps."""
    run = prepare(scene).beginning()
    for _ in range(steps):
        run = run.step(scene.solve.dt)
    return run


def agree(found: Both, speed: float = 0.0) -> None:
    """Assert that states, energies, events and iterations are the same, each to its scale: lengths to the thread's,
    speeds to the largest or the `speed` [m/s] at which the thread is drawn, forces to the largest and to what is known
    of a strain, energies to all there is."""
    one, other = found.at_once, found.one_by_one
    thread, state = other.system.thread, other.state
    length, force = thread.spline.end, AXIAL / RESIDUAL * thread.EA + np.abs(state.lam).max(initial=0.0)
    rate = max(speed, np.abs(state.v).max(), np.abs(state.s_dot).max(initial=0.0))
    scales = {"q": length, "s": length, "v": rate, "s_dot": rate, "y": 1.0, "N": force, "lam": force, "reaction": force}
    for name, scale in scales.items():
        assert np.abs(getattr(one.state, name) - getattr(state, name)).max(initial=0.0) <= RESIDUAL * scale, name
    for name in ("sigma", "sense", "present"):
        assert np.array_equal(getattr(one.state, name), getattr(state, name))
    organ: Any = other.system.organ

    def velocity(at: Any) -> Any:
        return organ.spread(at, at.V) if hasattr(organ, "spread") else at.V

    for of in (organ.displacement, velocity) if organ.size else (velocity,):
        way = of(state.organ)
        assert np.abs(of(one.state.organ) - way).max(initial=0.0) <= RESIDUAL * np.abs(way).max(initial=0.0)
    if hasattr(organ, "bound"):  # among its terms is the difference of two places
        bounds, place = (organ.bound(each.organ) for each in (one.state, state)), organ.displacement(state.organ)
        assert np.abs(np.subtract(*bounds)).max() <= IDENTITY * np.abs(place).max()
    assert np.abs(np.array(astuple(one.energies)) - astuple(other.energies)).max() <= RESIDUAL * other.energies.at_stake
    assert (one.number, one.state.time, one.iterations) == (other.number, state.time, found.iterations)
    assert [(e.kind, e.piercing) for e in one.events] == [(e.kind, e.piercing) for e in found.events]
    assert [e.time for e in one.events] == pytest.approx([e.time for e in found.events], rel=TWO_SOLVERS)


@pytest.mark.parametrize("name", SCENES)
def test_steps_at_once_are_those_one_by_one(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Consistency check: after many steps in few calls, and as many in one call each; the next step in the ordinary way
    is the same from both ends."""
    scene = SCENES[name]()
    found = both(begun(scene), scene.solve.dt, STEPS, monkeypatch)
    assert sum(found.made) >= 0.8 * STEPS
    agree(found)
    dt = scene.solve.dt
    agree(Both(found.at_once.step(dt), after := found.one_by_one.step(dt), list(after.events), after.iterations, []))


def test_a_step_that_leaves_too_much_of_an_organ_is_left_to_single_steps(monkeypatch: pytest.MonkeyPatch) -> None:
    """Independent check: in its Krylov space every step made at once is asked what it leaves of the equations of motion
    of all unknowns; where that may be less than it is, none is made."""
    scene = SCENES["organ in its Krylov space, BDF2"]()
    run, dt = begun(scene), scene.solve.dt
    organ = run.system.organ
    assert isinstance(organ, tissue.KrylovOrgan)
    given = run.system, run.state, run.energies, dt, [run.state.time + dt], run.take
    found = march(*given)
    assert found is not None
    left = organ.residual(found.states()[-1].organ)
    assert 0.0 < left <= krylov.ACCURACY
    monkeypatch.setattr(krylov, "ACCURACY", 0.5 * left)
    object.__setattr__(organ, "_rounded", 0.0)
    assert march(*given) is None


@pytest.mark.parametrize("dt", [1e-3, 2.5e-4])
def test_a_free_thread_falls_as_backward_euler_says(dt: float) -> None:
    """Independent check: a thread that nothing holds falls from rest by n(n + 1)/2 g Δt² in n steps, as a whole, and
    its weight does the work of that."""
    thread, g = Thread(Spline(uniform_knots(0.04, 20)), suture("2-0 polypropylene")), np.array([0.0, 0.0, -9.81])
    system = System(thread, (Free(), Free()), tissue.fixed_sites([]), (), gravity=g, compiled=True)
    laid = gauss_rule(thread.spline, MASS_POINTS).s[..., None] * [1.0, 0.0, 0.0]
    run = begin(system, start(system, np.zeros(0), laid, 1.0), try_step)
    after = run.step(dt).steps(dt, STEPS - 1)
    fallen = 0.5 * STEPS * (STEPS + 1) * g * dt**2
    assert after.taken == ()  # the last one was made with the others
    assert np.abs(after.state.q - run.state.q - fallen).max() <= IDENTITY * 0.04
    mass = float(thread.mass_matrix.sum())
    assert after.energies.external_work == pytest.approx(mass * g @ fallen, rel=RESIDUAL)
    assert after.energies.kinetic == pytest.approx(0.5 * mass * (g @ g) * (STEPS * dt) ** 2, rel=RESIDUAL)


def test_events_between_are_those_of_single_steps(monkeypatch: pytest.MonkeyPatch) -> None:
    """Consistency check: a thread that sticks first, slips, and leaves a hole that lets go of it at a given time; and
    one that is cut."""
    scene = slow(drawn(knots="fixed"), 5e-4)
    run, dt = begun(scene, 2), scene.solve.dt
    system = run.system
    holes = (system.piercings[0], replace(system.piercings[1], ends=20.4 * dt))
    spline = system.thread.spline
    cut = Cut(0.5 * (spline.start + spline.end), 31.7 * dt)
    found = both(replace(run, system=replace(system, piercings=holes), cuts=(cut,)), dt, STEPS, monkeypatch)
    assert {"slips", "ends", "cut"} <= {event.kind for event in found.events}
    assert [e.time for e in found.events if e.kind == "ends"] == [pytest.approx(21 * dt)]
    assert sum(found.made) >= 5
    agree(found)


def test_a_thread_that_is_drawn_out_of_a_hole_leaves_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """Consistency check: the steps stop before the one in which its end passes the hole, and go on without it."""
    scene = slow(drawn(knots="fixed", start={"kind": "free"}, end={"kind": "driven", "waypoints": OUT}), 5e-4)
    found = both(begun(scene), scene.solve.dt, 3 * STEPS, monkeypatch)
    assert "leaves" in {event.kind for event in found.events}
    agree(found, speed=(OUT[1][3] - OUT[0][3]) / OUT[1][0])


def test_a_hole_that_no_longer_bears_the_thread_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    """Consistency check: at the strength between the least and the most that the thread presses on it by, and not
    before."""
    scene = slow(drawn({"friction": None}), 5e-4)
    run, dt = begun(scene), scene.solve.dt
    later = run.steps(dt, STEPS)
    area = run.system.thread.section.diameter * 2e-3
    borne = np.mean([np.linalg.norm(each.state.lam[0, :3]) / area for each in (run, later)])
    holes = (replace(run.system.piercings[0], bearing=2e-3, strength=borne), run.system.piercings[1])
    found = both(replace(run, system=replace(run.system, piercings=holes)), dt, STEPS, monkeypatch)
    assert "tears" in {event.kind for event in found.events}
    assert sum(found.made) >= 0.8 * STEPS
    agree(found)


def through_a_ring(ends: tuple[End, End], speed: float = 0.0) -> Run:
    """A straight thread of 40 mm through a ring in its middle, after a short step; it runs along itself at a `speed`
    [m/s]."""
    thread, ring = Thread(Spline(uniform_knots(0.04, 20)), suture("2-0 polypropylene")), Piercing("ring")
    sites = tissue.fixed_sites([tissue.Site((0.02, 0, 0), direction=(1.0, 0, 0))])
    system = System(thread, ends, sites, (ring,), compiled=True)
    laid = gauss_rule(thread.spline, MASS_POINTS).s[..., None] * [1.0, 0.0, 0.0]
    at_rest = start(system, np.array([0.02]), laid, 1.0)
    v = np.tile([speed, 0.0, 0.0], (thread.n, 1))
    return begin(system, replace(at_rest, v=v, s_dot=np.array([-speed])), try_step).step(1e-5)


def test_a_thread_that_runs_over_many_spans_goes_as_far_as_its_speed_says(monkeypatch: pytest.MonkeyPatch) -> None:
    """Independent check: nothing slows down a free thread, whose spans are 2.35 mm long, in steps of 1 ms."""
    for speed in (4.0, 6.0):
        run = through_a_ring((Free(), Free()), speed)
        found = both(run, 1e-3, 2, monkeypatch)
        assert any(found.made) and not found.events
        agree(found)
        assert abs(run.state.s[0] - found.at_once.state.s[0] - speed * 2e-3) <= RESIDUAL * 0.04


@pytest.mark.parametrize("strain", [-1e-3, 1e-3])
def test_a_thread_that_is_pressed_is_left_to_single_steps(strain: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """Independent check: a straight thread that a hand presses along itself buckles, though its straight line is an
    equilibrium too, which the loops alone would find; one that is drawn goes on in these."""
    hand = Driven(np.array([[0.0, 0.04, 0.0, 0.0], [2e-3, 0.04 * (1.0 + strain), 0.0, 0.0]]))
    found = both(through_a_ring((Fixed(np.zeros(3)), hand)).step(1e-3), 1e-3, 6, monkeypatch)
    aside = np.abs(found.at_once.state.q[:, 1:]).max()
    assert any(found.made) == (strain > 0.0)
    assert aside > 1e-2 * 0.04 * np.sqrt(-strain) if strain < 0.0 else aside <= RESIDUAL * 0.04


def test_other_steps_are_made_one_by_one(monkeypatch: pytest.MonkeyPatch) -> None:
    """Independent check: with hands on a hole, in numpy, or with a bound on the error of a step the loops make none,
    and the run is where single steps bring it."""
    scene = slow(drawn(), 5e-4)
    run, dt = begun(scene), scene.solve.dt
    pulled = slow(pulled_through(), 5e-4)
    others = [
        begun(pulled),
        replace(run, system=replace(run.system, compiled=False)),
        replace(run, tolerance=1e-3),
    ]
    for other in others:
        found = both(other, dt, 6, monkeypatch)
        assert not any(found.made)
        agree(found)


@pytest.mark.parametrize("dt", [0.0, -1e-3, np.nan, np.inf])
def test_a_step_that_does_not_go_on_is_refused(dt: float) -> None:
    """Independent check: one alone and many at once, in words that say what is allowed."""
    run = through_a_ring((Free(), Free()))
    with pytest.raises(CouplingError, match="allowed are finite numbers above 0"):
        run.step(dt)
    with pytest.raises(CouplingError, match="allowed are finite numbers above 0"):
        run.steps(dt, 3)


def test_what_is_remembered_of_steps_is_of_these(monkeypatch: pytest.MonkeyPatch) -> None:
    """Consistency check: one after the other, from one state, with an end let go, under a weight, in steps of another
    length, by the other scheme, without a hole, and as it was: what the loops keep from call to call is of none of the
    others."""
    scene = figure_1(EULER, *(f"piercing.{hole}.{ROUGH}" for hole in ("entry", "exit")))
    run, dt = begun(scene), scene.solve.dt
    system, state = run.system, run.state
    held_by, left = state.reaction[1], fitted(system, release(state, np.array([False, True])))
    others = [
        (replace(run, system=replace(system, ends=(system.ends[0], Pulled(held_by)))), dt),
        (replace(run, system=replace(system, gravity=np.array([0.0, 0.0, -9.81]))), dt),
        (run, 0.5 * dt),
        (replace(run, state=replace(state, before=None), take=bdf2_step).step(dt).step(dt), dt),
        (replace(run, system=left[0], state=left[1]), dt),
        (run, dt),
    ]
    for _ in range(2):
        for other, length in others:
            found = both(other, length, 6, monkeypatch)
            assert any(found.made)
            agree(found)


def test_what_steps_share_is_made_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Independent check: of ten steps, each asked for by itself, with a hand that another system leads in each, the
    arrays for the first and for those after it are made once, and no other."""
    run, made = begun(figure_1('thread.knots="fixed"'), 0), list[float]()
    make = course.make_plan

    def noted(system: System, scheme: Any, *others: Any) -> Any:
        made.append(scheme.a)
        return make(system, scheme, *others)

    monkeypatch.setattr(course, "make_plan", noted)
    dt, place = 1e-3, np.array([0.03, 0.0, 0.025])
    for k in range(10):
        hand = Driven(np.array([[k * dt, *place], [(k + 1) * dt, *(place + 1e-5)]]))
        run, place = replace(run, system=run.system.led(1, hand)).steps(dt, 1), place + 1e-5
        assert np.abs(run.state.q[-1] - place).max() <= IDENTITY * 0.04 and not run.taken
    assert made == [1.0 / dt**2, (1.5 / dt) ** 2]


def test_events_are_found_when_they_are_read(monkeypatch: pytest.MonkeyPatch) -> None:
    """Independent check: of forty steps with friction, in which a hole slips, no event is located until somebody
    reads them, and then once."""
    rough, located = [f"piercing.{hole}.{ROUGH}" for hole in ("entry", "exit")], list[int]()
    scene = figure_1('thread.knots="fixed"', *rough)
    locate = events.locate
    monkeypatch.setattr(events, "locate", lambda *given: located.append(1) or locate(*given))
    run = begun(scene, 0).steps(scene.solve.dt, 40)
    assert not located and not run.taken
    kinds, once = [event.kind for event in run.events], len(located)
    assert {"slips", "taut"} <= set(kinds) and len(run.events) == len(kinds) >= once > 0 == len(located) - once


def test_every_correction_counts_and_a_batch_ends() -> None:
    """Independent check: what is asked before corrections is asked once for each, and a call of the loops makes no more
    than AT_ONCE steps, after which a run can be called off."""
    scene = figure_1(EULER)
    run, asked = begun(scene), list[int]()
    with asked_before_corrections(lambda: asked.append(1)):
        after = run.steps(scene.solve.dt, 10)
    assert len(asked) == after.iterations

    def called_off() -> None:
        raise KeyboardInterrupt

    with asked_before_corrections(called_off), pytest.raises(KeyboardInterrupt):
        run.steps(scene.solve.dt, 10)
