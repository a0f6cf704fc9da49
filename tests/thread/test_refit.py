"""Knots that come and go: what they leave as it was, and how well."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.interpolate import make_lsq_spline

from tests.bounds import IDENTITY, ORDER
from tests.thread.threads import bent
from thread.arrays import Array
from thread.catalogue import suture
from thread.errors import ThreadError
from thread.knots import GRADE, Tree, clamped_knots, graded, spans_at_holes, spans_by_curvature, uniform_knots
from thread.quadrature import gauss_rule
from thread.refit import Projection, insert_knots, refit
from thread.spline import Spline
from thread.thread import Thread

TREE = Tree(np.linspace(0.0, 0.1, 11))
ROOT = 0.01
UNBOUNDED = np.inf


def by_hole(hole: float, at: float = 5e-4) -> Array:
    """Breaks that are fine about a hole."""
    return TREE.breaks(at + 0.5 * np.abs(TREE.middles - hole))


def spline_on(index: Array) -> Spline:
    """The spline with simple knots at breaks of the tree."""
    return Spline(clamped_knots(TREE.places[index]))


def everywhere(spline: Spline) -> Array:
    """Abscissae all along a thread."""
    return np.linspace(spline.start, spline.end, 777)


@settings(max_examples=30, deadline=None)
@given(st.floats(0.0, 0.1), st.floats(1e-4, 1e-2), st.floats(0.05, 1.0))
def test_no_span_is_longer_than_wanted(hole: float, at: float, slope: float) -> None:
    """Independent check: on every span the smallest wanted length is not exceeded, twice the span would exceed it, and
    what is wanted finer everywhere has all the breaks of the coarser (the tree is nested)."""
    wanted = np.maximum(at + slope * np.abs(TREE.middles - hole), ROOT / 512)
    index = TREE.breaks(wanted)
    smallest = np.minimum.reduceat(wanted, index[:-1])
    spans = np.diff(TREE.places[index])
    assert np.all(spans <= smallest * (1.0 + IDENTITY))
    assert spans.max() <= ROOT * (1.0 + IDENTITY)
    parents = index[:-1] // (2 * np.diff(index)) * (2 * np.diff(index))
    of_parent = [wanted[p : p + 2 * s].min() for p, s in zip(parents, np.diff(index), strict=True)]
    assert np.all((2 * spans > np.array(of_parent)) | np.isclose(spans, ROOT))
    assert np.isin(index, TREE.breaks(0.6 * wanted)).all()


def test_a_tree_needs_roots() -> None:
    """Independent check: refused in words."""
    with pytest.raises(ThreadError, match="0 coarse spans; allowed"):
        Tree(np.zeros(1))


def test_insertion_changes_nothing() -> None:
    """Independent check (Boehm 1980): the curve and its derivatives are the same functions."""
    spline = Spline(uniform_knots(0.1, 13))
    q, v = bent(spline), bent(spline, 1)
    fine, (q_fine, v_fine) = insert_knots(spline, np.array([0.011, 0.0523, 0.0524, 0.0999]), [q, v])
    assert fine.n == spline.n + 4
    for old, new in ((q, q_fine), (v, v_fine)):
        before, after = spline.curve(old, everywhere(spline)), fine.curve(new, everywhere(spline))
        scale = np.abs(before).max(axis=(0, 2))
        assert np.all(np.abs(before - after).max(axis=(0, 2))[:3] <= 1e3 * IDENTITY * scale[:3])


def test_what_a_projection_keeps() -> None:
    """Independent check: ∫ ds (momentum), and the value and slope at the abscissae kept; a curve of the coarse space
    comes back."""
    coarse, union = spline_on(by_hole(0.04)), spline_on(np.union1d(by_hole(0.03), by_hole(0.04)))
    kept = np.array([0.0, 0.0412, 0.1])
    projection = Projection(union, coarse, kept)
    q = bent(union)
    new = projection.project(q)
    rule, other = gauss_rule(union, 4), gauss_rule(coarse, 4)
    total = np.einsum("eg,ega->a", rule.w, union.curve(q, rule.s.ravel())[:, 0].reshape(*rule.s.shape, 3))
    after = np.einsum("eg,ega->a", other.w, coarse.curve(new, other.s.ravel())[:, 0].reshape(*other.s.shape, 3))
    assert np.abs(total - after).max() <= 10 * IDENTITY * np.abs(total).max()
    for order in (0, 1):
        a, b = union.curve(q, kept)[:, order], coarse.curve(new, kept)[:, order]
        assert np.abs(a - b).max() <= 1e2 * IDENTITY * np.abs(a).max()
    smooth = bent(coarse, 2)
    _, (lifted,) = insert_knots(coarse, np.setdiff1d(union.breaks, coarse.breaks), [smooth])
    assert np.abs(projection.project(lifted) - smooth).max() <= 1e2 * IDENTITY * np.abs(smooth).max()


def test_taking_out_knots_is_of_fourth_order() -> None:
    """Independent check (theory): every second knot of a smooth curve out, at half the span a sixteenth."""
    errors, s = [], np.linspace(0.0, 1.0, 2001)
    for spans in (16, 32, 64):
        fine, coarse = Spline(uniform_knots(1.0, 2 * spans + 3)), Spline(uniform_knots(1.0, spans + 3))
        q = make_lsq_spline(s, np.sin(2.0 * np.pi * s)[:, None], fine.knots).c
        new = Projection(fine, coarse, np.array([0.0, 0.5, 1.0])).project(q)
        errors.append(np.abs(fine.curve(q, s)[:, 0] - coarse.curve(new, s)[:, 0]).max())
    assert abs(np.log2(errors[-2] / errors[-1]) - 4.0) <= ORDER


def test_a_knot_that_is_needed_stays() -> None:
    """Independent check: the tangent turns by no more than the bound, whatever is asked to go."""
    fine = spline_on(by_hole(0.05, 2e-4))
    q = bent(fine)
    roots = TREE.places[::512]
    s = everywhere(fine)
    for bound in (1e-6, 1e-2):
        new = refit(fine, roots, [q, q], np.zeros(0), bound)
        turned = np.linalg.norm(fine.curve(q, s)[:, 1] - new.spline.curve(new.fields[0], s)[:, 1], axis=1)
        assert turned.max() <= 2.0 * bound
        assert np.isin(roots, new.spline.breaks).all()
        assert np.array_equal(new.fields[0], new.fields[1])
    all_out = refit(fine, roots, [q], np.zeros(0), UNBOUNDED)
    assert all_out.spline.n == TREE.roots + 3


def test_spans_beside_a_hole() -> None:
    """Independent check: a part of √(EI/T) at the hole and on its way, growing by half the distance at most, and
    the finer the more tension there is."""
    s = np.linspace(0.0, 0.1, 2001)
    layer = np.array([1e-3])
    wanted = spans_at_holes(s, np.array([[0.05, 0.052]]), layer, 0.1, 0.3)
    on_the_way = (s >= 0.05) & (s <= 0.052)
    assert np.allclose(wanted[on_the_way], 1e-4)
    assert np.abs(np.diff(wanted[np.abs(s - 0.051) < 3e-3]) / np.diff(s)[0]).max() <= 0.5 + IDENTITY * 1e3
    assert np.all(spans_at_holes(s, np.array([[0.05, 0.052]]), 0.5 * layer, 0.1, 0.3)[on_the_way] == 5e-5)


def test_a_bend_wants_knots_and_a_straight_thread_does_not() -> None:
    """Independent check: of third order, the angle that a span misses is eight times less on half of it."""
    straight = Spline(uniform_knots(0.1, 13))
    line = np.outer(np.linspace(0, 1, 13), [1.0, 0.0, 0.0])
    line[:, 0] = (straight.knots[1:-3] + straight.knots[2:-2] + straight.knots[3:-1]) / 3
    h = 0.1 / 10
    assert np.allclose(spans_by_curvature(straight, line, 1e-3), 4 * h)
    assert spans_by_curvature(straight, bent(straight), 1e-3).min() < h


def test_knots_of_any_request_have_a_positive_rule() -> None:
    """Independent check: holes come and go, and of some crooked threads not all knots can go; no span that is left is
    more than four times its neighbour, and the weights of the stretching energy are positive, which they are not where
    one is 42 times as long."""
    for seed in range(40):
        rng = np.random.default_rng(seed)
        tree = Tree(np.linspace(0.0, 0.1, int(rng.integers(6, 31))))

        def asked(rng: np.random.Generator = rng, tree: Tree = tree) -> Array:
            m = int(rng.integers(0, 4))
            holes, layers = rng.uniform(0.0, 0.1, m), 10.0 ** rng.uniform(-4.5, -2.3, m)
            way = np.stack([holes, holes + rng.uniform(-10.0, 10.0, m) * layers], axis=1)
            return graded(tree.places[tree.breaks(spans_at_holes(tree.middles, way, layers, 0.2, 0.45))], tree.places)

        spline = Spline(clamped_knots(asked()))
        q = np.outer(spline.greville, [1.0, 0.0, 0.0]) + 1e-4 * np.cumsum(rng.normal(size=(spline.n, 3)), axis=0)
        for _ in range(3):
            new = refit(spline, asked(), [q], np.zeros(0), 10.0 ** rng.uniform(-3.0, -0.3))
            spline, q = new.spline, new.fields[0]
            h = np.diff(spline.breaks)
            assert max((h[1:] / h[:-1]).max(), (h[:-1] / h[1:]).max()) <= GRADE * (1.0 + 1e-6)
            assert Thread(spline, suture("6-0 polyester")).axial_rule.w.min() > 0.0


def test_graded_breaks_are_among_the_places_and_no_more_than_it_takes() -> None:
    """Independent check: spans that are graded stay as they are; where places run out, so does the grading."""
    places = np.linspace(0.0, 64.0, 65)
    fine = np.array([0.0, 1.0, 2.0, 6.0, 22.0, 64.0])
    assert np.array_equal(graded(fine, places), fine)
    coarse = np.array([0.0, 1.0, 64.0])
    found = graded(coarse, places)
    assert np.isin(coarse, found).all() and np.isin(found, places).all()
    assert np.diff(found)[1:].max() / np.diff(found)[0] > GRADE  # neighbours only
    assert np.max(np.diff(found)[1:] / np.diff(found)[:-1]) <= GRADE
    assert np.array_equal(graded(coarse, coarse), coarse)
