"""A thread that is cut, on knots that travel with its holes: its pieces are threads of their own."""

from dataclasses import replace

import numpy as np
import pytest

from thread.catalogue import suture
from thread.errors import ThreadError
from thread.packets import END, Hold, Travel, travelling
from thread.placed import Placed
from thread.riding import field_of, potential_rates, put_on, ride, ride_of
from thread.thread import Thread

LENGTH, CUT, GRAVITY = 0.06, 0.0351, np.array([1.0, -2.0, -9.81])
HOLES = np.array([0.012, 0.022, 0.045])
MOVED = HOLES + np.array([1e-3, -2e-3, 1.5e-3])
OF_PIECES = (0.0, CUT, [0, 1]), (CUT, LENGTH, [2])
MASSES = (1e-6, 2e-6)


def holds(numbers: list[int], origin: float) -> list[Hold]:
    """Holes of which the second imposes no direction, at abscissae from an origin on."""
    return [Hold(k, HOLES[number] - origin, number != 1, 3e-4) for k, number in enumerate(numbers)]


def whole() -> Travel:
    """The knots of all of the thread."""
    return travelling(LENGTH, holds([0, 1, 2], 0.0), 3, 4e-3, (None, None), cuts=[CUT])


def thread_at(travel: Travel, s: np.ndarray, masses: tuple[float, float] = MASSES) -> Thread:
    """A thread with its holes at `s`."""
    return Thread(Placed(travel.knots, travel.places(s), travel), suture("4-0 nylon"), point_masses=masses)


def alone(piece: int, s: np.ndarray) -> Thread:
    """A piece by itself, its abscissae from its own start on, with the holes of all at `s`."""
    low, high, numbers = OF_PIECES[piece]
    travel = travelling(high - low, holds(numbers, low), len(numbers), 4e-3, (None, None))
    masses = (MASSES[0], 0.0) if piece == 0 else (0.0, MASSES[1])
    return thread_at(travel, s[numbers] - low, masses)


def wavy(thread: Thread, seed: int) -> np.ndarray:
    """A bent curve through a seeded noise."""
    spline, rng = thread.spline, np.random.default_rng(seed)
    assert isinstance(spline, Placed)
    q = np.zeros((thread.n, 3))
    q[:, 0], q[:, 1] = spline.places, 2e-3 * np.sin(150.0 * spline.places)
    return np.asarray(q + 2e-5 * rng.standard_normal(q.shape))


@pytest.mark.parametrize("s", [HOLES, MOVED], ids=["as made", "moved"])
def test_functions_are_those_of_the_pieces(s: np.ndarray) -> None:
    """Independent check: values, slopes and curvatures of each piece by itself, also at the cut from both sides."""
    spline = thread_at(whole(), s).spline
    assert spline.pieces == 2 and spline.cuts == [CUT] and (spline.piece_ends == [0.0, CUT, LENGTH]).all()
    assert CUT in spline.breaks
    shift = 0
    for piece, (low, high, _) in enumerate(OF_PIECES):
        own = alone(piece, s).spline
        at = np.linspace(low, high, 60)
        first, b = spline.basis(at, np.full(60, 0.5 * (low + high)))
        first_alone, b_alone = own.basis(at - low)
        for order in range(3):
            full, full_alone = np.zeros((60, spline.n)), np.zeros((60, own.n))
            np.put_along_axis(full, first[:, None] + np.arange(4), b[:, order], 1)
            np.put_along_axis(full_alone, first_alone[:, None] + np.arange(4), b_alone[:, order], 1)
            same = full[:, shift : shift + own.n]
            if order < 2:
                assert np.abs(same - full_alone).max() <= 1e-9 * np.abs(full_alone).max()
            assert not full[:, :shift].any() and not full[:, shift + own.n :].any()
        shift += own.n
    assert shift == spline.n


def test_values_are_interpolated_on_either_side_of_the_cut() -> None:
    """Identity: the curve through its own values, which jump at the cut."""
    spline = thread_at(whole(), MOVED).spline
    q = np.random.default_rng(2).standard_normal((spline.n, 3))
    again = spline.through(spline.curve(q, spline.greville, spline.home)[:, 0])
    assert np.abs(again - q).max() <= 1e-9 * np.abs(q).max()


def test_energies_and_mass_are_those_of_the_pieces() -> None:
    """Independent check: forces, tangents, masses and slopes by the abscissae of the holes."""
    thread, parts = thread_at(whole(), MOVED), [alone(piece, MOVED) for piece in range(2)]
    q = np.concatenate([wavy(part, 5) for part in parts])
    q[parts[0].n :, 0] += CUT
    split = np.split(q, [parts[0].n])
    force = np.concatenate([part.gradient(part.points(x)) for part, x in zip(parts, split, strict=True)])
    assert np.abs(thread.gradient(thread.points(q)) - force).max() <= 1e-8 * np.abs(force).max()
    momentum = np.concatenate([part.momentum(x) for part, x in zip(parts, split, strict=True)])
    assert np.abs(thread.momentum(q) - momentum).max() <= 1e-10 * np.abs(momentum).max()
    rates = [potential_rates(part, GRAVITY, x) for part, x in zip(parts, split, strict=True)]
    for one, each in zip(potential_rates(thread, GRAVITY, q), zip(*rates, strict=True), strict=True):
        other = np.concatenate(each)
        assert np.abs(one - other).max() <= 1e-8 * np.abs(other).max()


def test_earlier_curves_are_read_on_the_piece_that_is_meant() -> None:
    """Independent check: inertia from curves that jump at the cut, of pieces with other holes, and their velocity put
    on other knots, are those of the pieces alone."""
    thread, before = thread_at(whole(), MOVED), thread_at(whole(), HOLES)
    parts, earlier = ([alone(piece, s) for piece in range(2)] for s in (MOVED, HOLES))
    old, rng = [wavy(part, 7) for part in earlier], np.random.default_rng(3)
    old[1] += 0.02 * rng.standard_normal(3)
    q, c = np.concatenate([wavy(part, 8) for part in parts]), np.concatenate(old)
    N, fields = thread.EA * thread.points(q).strain, (field_of(before.spline, c), field_of(before.spline, 0.0 * c))
    F, out = ride(thread, ride_of(thread, GRAVITY), fields, 1e6, q, N)
    each, by_s = [], []
    for part, was, x, c_part in zip(parts, earlier, np.split(q, [parts[0].n]), old, strict=True):
        own = field_of(was.spline, c_part), field_of(was.spline, 0.0 * c_part)
        G, ridden = ride(part, ride_of(part, GRAVITY), own, 1e6, x, part.EA * part.points(x).strain)
        each.append(G)
        by_s.append(ridden.by_s)
    assert np.abs(F - np.concatenate(each)).max() <= 1e-8 * np.abs(F).max()
    assert np.abs(out.by_s - np.concatenate(by_s)).max() <= 1e-8 * np.abs(out.by_s).max()
    v = put_on(thread, [(before.spline, c)])
    alike = np.concatenate([put_on(p, [(w.spline, x)]) for p, w, x in zip(parts, earlier, old, strict=True)])
    assert np.abs(v - alike).max() <= 1e-9 * np.abs(alike).max()


def test_strands_end_at_the_cut() -> None:
    """Identity: the strands of two pieces without holes that follow one another."""
    travel = travelling(LENGTH, [Hold(0, 0.05, True, 3e-4)], 1, 4e-3, (None, None), cuts=[0.01, 0.02])
    assert (travel.between[:, 0] == END).any() and len(travel.rigid) == 4
    assert np.array_equal(np.unique(travel.strand_of_spans()), np.arange(4))


def test_holes_do_not_pass_a_cut() -> None:
    """A hole at a cut, or past one, leaves no thread between the two."""
    with pytest.raises(ThreadError, match="a cut of the thread"):
        travelling(LENGTH, [Hold(0, CUT, True, 3e-4)], 1, 4e-3, (None, None), cuts=[CUT])
    with pytest.raises(ThreadError, match="no thread remains"):
        thread_at(whole(), np.array([0.012, CUT + 1e-3, 0.045]))


def test_travels_are_alike_by_their_cuts() -> None:
    """Identity: the same holes with and without a cut are other knots."""
    one = travelling(LENGTH, holds([0, 1, 2], 0.0), 3, 4e-3, (None, None))
    assert one.is_like(replace(one)) and not one.is_like(whole())
