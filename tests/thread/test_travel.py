"""Knots that travel with the holes: where they are, and what energy and inertia owe to the abscissae of the holes."""

from dataclasses import replace

import numpy as np
import pytest

from tests.bounds import IDENTITY, SLOPE
from thread.catalogue import suture
from thread.errors import ThreadError
from thread.kernels.travel import Field
from thread.packets import FAR, Hold, Travel, travelling, widths
from thread.placed import Placed
from thread.relaxation import Memory
from thread.riding import field_of, potential_rates, put_on, ride, ride_of
from thread.thread import Thread
from tissue.relaxation import Prony

LENGTH, GRAVITY = 0.06, np.array([1.0, -2.0, -9.81])
S0 = np.array([0.022, 0.045])
FACTOR = 1e6  # 1/s²


def knots(s: np.ndarray = S0, first: float = 3e-4) -> Travel:
    """Two directed holes in a thread of 60 mm."""
    return travelling(LENGTH, [Hold(k, x, True, first) for k, x in enumerate(s)], len(s), 4e-3, (None, None))


@pytest.fixture(scope="module")
def thread() -> Thread:
    travel = knots()
    return Thread(Placed(travel.knots, travel.places(S0), travel), suture("4-0 nylon"), point_masses=(1e-6, 2e-6))


@pytest.fixture(scope="module")
def wavy(thread: Thread) -> np.ndarray:
    spline, rng = thread.spline, np.random.default_rng(3)
    assert isinstance(spline, Placed)
    q = np.zeros((thread.n, 3))
    q[:, 0], q[:, 1] = spline.places, 2e-3 * np.sin(9.0 * spline.places / LENGTH)
    return np.asarray(q + 2e-5 * rng.standard_normal(q.shape))


def test_packets_move_rigidly_and_the_rest_is_shared() -> None:
    """Identity: holes stand at their knots, spans next to them keep their lengths, and the thread its own."""
    travel, moved = knots(), S0 + np.array([3e-3, -2e-3])
    one, other = (Placed(travel.knots, travel.places(s), travel) for s in (S0, moved))
    assert np.allclose(one.breaks[travel.at], S0, rtol=IDENTITY)
    assert np.allclose(other.breaks[travel.at], moved, rtol=IDENTITY)
    for k in travel.at:
        near = slice(k - 1, k + 2)
        assert np.allclose(np.diff(one.breaks[near]), np.diff(other.breaks[near]), rtol=1e-9)
    assert other.end == pytest.approx(LENGTH, rel=IDENTITY) and (np.diff(other.breaks) > 0.0).all()


def test_holes_at_one_place_are_refused() -> None:
    with pytest.raises(ThreadError, match="one abscissa"):
        knots(np.array([0.03, 0.03]))


def test_a_straight_thread_is_unstrained_wherever_its_holes_are(thread: Thread) -> None:
    """Identity: P = S is in the space, with P_S = 1 and no curvature, and stores nothing."""
    placed = thread.placed(S0 + np.array([2e-3, 1e-3]))
    spline = placed.spline
    assert isinstance(spline, Placed)
    q = np.outer(spline.places, [1.0, 0.0, 0.0])
    D = spline.curve(q, np.linspace(0.0, LENGTH, 40))
    assert np.allclose(D[:, 0, 0], np.linspace(0.0, LENGTH, 40), atol=IDENTITY * LENGTH)
    assert np.allclose(D[:, 1, 0], 1.0, rtol=IDENTITY) and np.abs(D[:, 2]).max() * LENGTH < 1e-8
    assert np.abs(placed.points(q).strain).max() < IDENTITY


def earlier(thread: Thread, wavy: np.ndarray) -> tuple[Field, Field]:
    """Two curves on other knots, in whose sum the inertia begins."""
    spline = thread.spline
    assert isinstance(spline, Placed)
    rng = np.random.default_rng(4)
    moved = spline.moved(S0 + np.array([3e-4, -2e-4]))
    return field_of(moved, 0.7 * (wavy + 1e-3 * rng.standard_normal(wavy.shape))), field_of(spline, 0.3 * wavy)


def remembering(thread: Thread) -> Thread:
    """The same thread after strains that rise along it, of which some have relaxed."""
    s = np.linspace(0.0, LENGTH, 50)
    strain = 0.02 * s / LENGTH
    relaxing = replace(thread, relaxation=Prony([0.3, 0.2], [1.0, 20.0]))
    return relaxing.with_memory(Memory(s, strain, np.array([0.06 * strain - 3e-4, 0.16 * strain]), 0.5))


@pytest.mark.parametrize("relaxes", [False, True])
def test_the_slopes_by_abscissae_are_those_of_the_potential(thread: Thread, wavy: np.ndarray, relaxes: bool) -> None:
    """Independent check: central differences of the elastic energy, whose error falls by 100 when the step does by
    10."""
    thread = remembering(thread) if relaxes else thread
    _, _, slopes = potential_rates(thread, GRAVITY, wavy)
    errors = np.empty((2, 2))
    for row, h in enumerate((1e-5, 1e-6)):
        for k in range(2):
            near = [thread.placed(S0 + sign * h * np.eye(2)[k]) for sign in (1.0, -1.0)]
            plus, minus = (each.energy(each.points(wavy)) for each in near)
            errors[row, k] = abs((plus - minus) / (2.0 * h) - slopes[k]) / np.abs(slopes).max()
    assert np.all(np.log10(errors[0] / errors[1]) == pytest.approx(2.0, abs=SLOPE))


@pytest.mark.parametrize("relaxes", [False, True])
def test_mixed_and_second_slopes_are_those_of_the_first(thread: Thread, wavy: np.ndarray, relaxes: bool) -> None:
    """Independent check: central differences of forces and slopes, inertia and weight among them."""
    thread = remembering(thread) if relaxes else thread
    fields, h = earlier(thread, wavy), 1e-6

    def at(s: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        placed = thread.placed(s)
        points = placed.points(wavy)
        F, ridden = ride(placed, ride_of(placed, GRAVITY), fields, FACTOR, wavy, thread.EA * points.strain)
        return placed.gradient(points) + F, ridden.by_s, ridden.by_qs, ridden.by_ss

    _, _, by_qs, by_ss = at(S0)
    for k in range(2):
        (F, slopes, *_), (G, less, *_) = (at(S0 + sign * h * np.eye(2)[k]) for sign in (1.0, -1.0))
        assert np.abs((F - G) / (2.0 * h) - by_qs[:, :, k]).max() < 1e-6 * np.abs(by_qs).max()
        assert np.abs((slopes - less) / (2.0 * h) - by_ss[k]).max() < 1e-5 * np.abs(by_ss).max()


def test_what_is_put_on_other_knots_keeps_its_momentum(thread: Thread, wavy: np.ndarray) -> None:
    """Identity: momentum and moment of momentum about any place that is a curve of the new knots, by the mass rule of
    these, whatever the velocity was on."""
    spline = thread.spline
    assert isinstance(spline, Placed)
    v, other = np.random.default_rng(5).standard_normal(wavy.shape), thread.placed(S0 + np.array([1e-3, -1e-3]))
    new = put_on(other, [(spline, v)])
    old = np.einsum("mi,mic->mc", spline.basis(rule_places(other))[1][:, 0], v[first_four(spline, rule_places(other))])
    w, P = masses(other), curve_at_rule(other, wavy)
    ends = np.array(other.point_masses)[:, None]
    total = (w[:, None] * old).sum(axis=0) + (ends * v[[0, -1]]).sum(axis=0)
    spin = (w[:, None] * np.cross(P, old)).sum(axis=0) + (ends * np.cross(wavy[[0, -1]], v[[0, -1]])).sum(axis=0)
    M = other.mass_matrix
    assert np.allclose((M @ new).sum(axis=0), total, rtol=1e-10)
    assert np.allclose(np.cross(wavy, M @ new).sum(axis=0), spin, rtol=1e-10)


def rule_places(thread: Thread) -> np.ndarray:
    """Abscissae of the mass rule."""
    return mass_rule(thread).s.ravel()


def masses(thread: Thread) -> np.ndarray:
    """Masses at them."""
    return thread.section.rhoA * mass_rule(thread).w.ravel()


def mass_rule(thread: Thread):  # type: ignore[no-untyped-def]
    from thread.quadrature import gauss_rule
    from thread.thread import MASS_POINTS

    return gauss_rule(thread.spline, MASS_POINTS)


def curve_at_rule(thread: Thread, q: np.ndarray) -> np.ndarray:
    """Places of the curve at them."""
    rule = mass_rule(thread)
    return np.einsum("egi,eic->egc", rule.b[:, :, 0], q[thread.points_of_span]).reshape(-1, 3)


def first_four(spline: Placed, s: np.ndarray) -> np.ndarray:
    """Control points of the functions at abscissae."""
    return spline.basis(s)[0][:, None] + np.arange(4)


def test_crushing_has_no_end() -> None:
    """Identity: the energy against |T| → 0 at a hole has no bound, 1/|T|²: no thread collapses there."""
    travel = travelling(LENGTH, [Hold(0, 0.03, True, 1e-3)], 1, 4e-3, (None, None))
    thread = Thread(Placed(travel.knots, travel.places(np.array([0.03])), travel), suture("4-0 nylon"))
    spline = thread.spline
    assert isinstance(spline, Placed)
    q, sizes = np.outer(spline.places, [1.0, 0.0, 0.0]), np.array([0.1, 0.03, 0.01])
    stretch = [0.5 * thread.EA * LENGTH * (0.5 * (x * x - 1.0)) ** 2 for x in sizes]
    crush = np.array([thread.energy(thread.points(x * q)) for x in sizes]) - stretch
    spans = spline.evaluate(spline.chi.breaks[travel.at])[1]  # S' at the hole times one span of χ, half on either side
    each = 0.5 * thread.EA * (0.5 * (1.0 - sizes**2)) ** 4
    assert crush == pytest.approx(each * (LENGTH + spans / sizes**2), rel=1e-6)


def test_point_masses_are_where_the_ends_are(thread: Thread) -> None:
    """Identity: the mass of all is that of the thread and its ends, wherever its knots are."""
    total = thread.section.rhoA * LENGTH + sum(thread.point_masses)
    for placed in (thread, thread.placed(S0 + 1e-3)):
        assert placed.mass_matrix.sum() == pytest.approx(total, rel=IDENTITY)


def test_a_thread_placed_twice_is_one(thread: Thread) -> None:
    """Identity: the same abscissae give the same thread, others another, with the rules of its own knots' places."""
    one, other = thread.placed(S0 + 1e-3), thread.placed(S0 + 2e-3)
    assert one is not other and thread.placed(S0 + 2e-3) is other and one.placed(S0 + 1e-3) is one
    for placed in (one, other):
        anew = replace(thread, spline=placed.spline)
        for rule, known in ((placed.elastic_rule, anew.elastic_rule), (placed.axial_rule, anew.axial_rule)):
            assert all(np.array_equal(getattr(rule, part), getattr(known, part)) for part in "swb")


def test_a_hole_is_at_its_knot_whatever_its_strands() -> None:
    """Identity: S at the knot of a hole is the hole's abscissa, though one of its strands is much shorter than the
    other and leaves less room for a packet, for holes that impose a direction and for others."""
    s = np.array([0.002, 0.03, 0.0335, 0.05])
    for directed in (True, False):
        holds = [Hold(k, x, directed, 1.2e-3) for k, x in enumerate(s)]
        travel = travelling(LENGTH, holds, len(s), 4e-3, (None, None))
        assert np.allclose(Placed(travel.knots, travel.places(s), travel).breaks[travel.at], s, rtol=IDENTITY)


def test_round_off_does_not_decide_how_many_spans_a_packet_has() -> None:
    """Independent check: a slack packet, whose spans are all as long as the longest, reaches 2 FAR of them in any
    unit."""
    counts = [len(widths(longest, longest, 100.0 * longest)) for longest in np.random.default_rng(36).uniform(size=99)]
    assert set(counts) == {int(2.0 * FAR)}
