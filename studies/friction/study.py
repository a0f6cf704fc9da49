"""Friction at a hole: the exact point law, its limit for many holes, and the paper's two passes.

A hole turns a thread by θ, and its tangent is half-way between the strands. Slip begins if the pull
is (1 + μt)/(1 − μt) times the hold, with t = tan θ/2. From θ = 2 atan 1/μ on, no pull moves the
thread. Around a capstan the ratio is exp(μθ), and many holes in a row approach this with the square
of their number. One lagged correction (§4.3) gives 1 + 2μt for a given hold and 1/(1 − 2μt) for a
given pull. A bending thread finds its own tangent, and its ratio follows from the elastica. If the
thread is drawn out and let back, the load makes a loop: the ratio on the way out, and its inverse
on the way back. For several holes the ratios multiply, and the loop grows as their power.

A rod of 20 mm in a sleeve fixed in space shows the first three, a suture around fixed holes the
last.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from matplotlib.figure import Figure

import tissue
from coupling.paper.two_pass import two_pass
from coupling.rest.laying import start
from coupling.run import begin
from coupling.step.stepping import try_step
from coupling.system import Friction, Piercing, State, System
from studies.arrays import Array
from studies.figure import curve, described, draw, laws, series
from studies.study import Job, Table, each, grouped, require, unit_field
from studies.theory import bent_ratio, capstan, point_ratio
from thread.catalogue import Section, suture
from thread.ends import Driven, End, Pulled
from thread.knots import uniform_knots
from thread.path import RoundedPath, rounded_path
from thread.placed import through_holes
from thread.quadrature import gauss_rule
from thread.spline import Spline
from thread.thread import MASS_POINTS, Thread

HOLD = 0.1  # [N]
DT = 3e-3  # of the one step that shows whether a rod slips [s]; long, because bending of the rod takes time
GLIDE = 0.05  # speed of a rod in the two passes [m/s]
ROD = Section(diameter=7e-3, density=260.0, youngs_modulus=2.6e9, poisson_ratio=0.3)  # bends by 1e-4 under 1 N
TINY = 1e-3  # of a pull: distance on both sides of the threshold at which the rod sticks and slips

SUTURE = suture("2-0 polypropylene")
LOOP_HOLD, LOOP_WAY, LOOP_TIME = 0.2, 3e-3, 1.0  # [N], out and back [m], each [s]
LOOP_STEPS, LOOP_SPANS = 40, 20  # steps each way, and spans per hole in addition to its packet
REST = 0.05  # settling time of the thread before it is drawn [s]


@dataclass(frozen=True, kw_only=True)
class Row:
    """One ratio of pull to hold; for `kind` "loop" at one moment of a loop."""

    kind: str  # "one hole", "holes in a row", "two passes, hold given", "two passes, pull given" or "loop"
    mu: float = unit_field("-")
    turn: float = unit_field("degree")
    holes: int = unit_field("-", default=1)
    way: float = unit_field("m", default=0.0)  # of the hand, in a loop
    ratio: float = unit_field("-")
    theory: float = unit_field("-")
    settled: bool  # the rod sticks and slips on the two sides of the threshold; in a loop, the thread slips

    @property
    def exact(self) -> float:
        """Ratio by the exact point law at one hole [-]."""
        return point_ratio(self.mu, np.radians(self.turn))

    @property
    def limit(self) -> float:
        """Ratio at a capstan with the same turn [-]."""
        return capstan(self.mu, np.radians(self.turn))

    @property
    def error(self) -> float:
        """Error of the ratio relative to theory [-]."""
        return abs(self.ratio / self.theory - 1.0)


def main(
    mus: Sequence[float] = (0.1, 0.2, 0.3),
    turns: Sequence[float] = (15.0, 30.0, 60.0, 90.0, 120.0),
    wrap: float = 180.0,
    rows_of_holes: Sequence[int] = (2, 4, 8, 16),
    loop_turn: float = 90.0,
    loop_holes: Sequence[int] = (1, 2, 3),
) -> Iterator[Row]:
    """Yield every ratio: single holes, lags, loops, and holes in a row.

    Every coefficient has all of them. Holes in a row turn the thread by `wrap` [degree] together.

    Raises `StudyError` for arguments without a threshold.
    """
    allowed = min(*mus, *turns, wrap) > 0.0 and max(turns) < 180.0 and min(rows_of_holes) > 1 and min(loop_holes) > 0
    given = f"mus = {mus}, turns = {turns}, wrap = {wrap}, rows_of_holes = {rows_of_holes}, loops = {loop_holes}"
    remedy = "give coefficients and wrap above 0, turns from 0 to 180 degrees, rows of two or more holes, loops of one"
    require(allowed, given, remedy)
    jobs: list[Job] = []
    for mu in mus:
        jobs += [partial(holes_in_a_row, mu, turn, 1) for turn in turns]
        jobs += [partial(two_passes, mu, turn) for turn in turns]
        jobs += [partial(holes_in_a_row, mu, wrap, holes) for holes in sorted(set(rows_of_holes))]
        jobs += [partial(loop, mu, loop_turn, holes) for holes in loop_holes]
    yield from each(jobs)


def unit_vector(angle: float) -> Array:
    """Return the unit vector at `angle` [rad] below x in the plane of x and z."""
    return np.array([np.cos(angle), 0.0, -np.sin(angle)])


def fixed_holes(
    thread: Thread, ends: tuple[End, End], mu: float, places: Array, directed: Array | None = None
) -> System:
    """Return a thread through rough holes at `places` (p, 3) [m], fixed in space.

    All holes have the direction `directed` (3,), or None for free directions.
    """
    sites = tissue.fixed_sites([tissue.Site(place, direction=directed) for place in places])
    rough = Friction(mu, mu)
    holes = [Piercing(f"hole {k}", directed=directed is not None, friction=rough) for k in range(len(places))]
    return System(thread, ends, sites, tuple(holes))


def laid_through(
    places: Array, mu: float, path: RoundedPath, s: Array, ends: tuple[End, End], section: Section, spans: int,
    stretch: float = 1.0, damping: float = 0.0,
) -> tuple[System, State]:  # fmt: skip
    """Return a thread laid through rough holes, and its state.

    The holes are at `places` (p, 3) [m], and at the abscissae `s` (p,) [m] of the thread. The
    thread is stretched by `stretch` to the length of its path, and has `spans` per hole in addition
    to the spans of the packets.
    """
    length = path.length / stretch
    knots = through_holes(length, s, False, length / (spans * s.size))
    system = fixed_holes(Thread(knots, section, damping=damping), ends, mu, places)
    laid = path.position(stretch * gauss_rule(system.thread.spline, MASS_POINTS).s)
    return system, start(system, s, laid, stretch)


# --- a rod in a sleeve ------------------------------------------------------------------------------------


def rod(mu: float, half: float, pull: float, hold: float) -> tuple[System, State]:
    """Return a rod along x in a sleeve, at rest, and its state.

    Its ends are pulled at an angle `half` [rad] to its axis.
    """
    thread = Thread(Spline(uniform_knots(0.02, 8)), ROD)
    ends = (Pulled(-hold * unit_vector(-half)), Pulled(pull * unit_vector(half)))
    system = fixed_holes(thread, ends, mu, np.zeros((1, 3)), unit_vector(0.0))
    path = (gauss_rule(thread.spline, MASS_POINTS).s - 0.01)[..., None] * unit_vector(0.0)
    return system, start(system, np.array([0.01]), path, 1.0)


def slips(mu: float, half: float, pull: float, hold: float) -> bool:
    """Return whether the rod slips towards its pulled end."""
    return bool(begin(*rod(mu, half, pull, hold)).step(DT).state.sigma[0] < 0.0)


def pull_at_slip(mu: float, half: float, hold: float) -> tuple[float, bool]:
    """Return the pull [N] at which |f| − μN vanishes, and whether it is the threshold of slip.

    At the threshold the rod sticks just below this pull and slips just above it. This function is
    linear in the pull and is measured while the rod sticks.
    """
    pulls, margins = (hold, 1.01 * hold), []
    for pull in pulls:
        hole = begin(*rod(mu, half, pull, hold)).step(DT).piercings[0]
        margins.append(abs(hole.tangential_force) - mu * hole.normal_force)
    pull = pulls[0] - margins[0] * (pulls[1] - pulls[0]) / (margins[1] - margins[0])
    return pull, slips(mu, half, (1 + TINY) * pull, hold) and not slips(mu, half, (1 - TINY) * pull, hold)


def holes_in_a_row(mu: float, wrap: float, holes: int) -> Row:
    """Return the ratio of one rod, or of several in a row, each held by the pull of the one before.

    Together they turn by `wrap` [degree].
    """
    pull, settled, kind = HOLD, True, "holes in a row" if holes > 1 else "one hole"
    for _ in range(holes):
        pull, sure = pull_at_slip(mu, np.radians(wrap) / holes / 2, pull)
        settled &= sure
    theory, ratio = point_ratio(mu, np.radians(wrap / holes)) ** holes, pull / HOLD
    return Row(kind=kind, mu=mu, turn=wrap, holes=holes, ratio=ratio, theory=theory, settled=settled)


def two_passes(mu: float, turn: float) -> list[Row]:
    """Return the ratios of a gliding rod after the second pass.

    This pass changes the tension by its friction. Either the hold or the pull is given.
    """
    half = np.radians(turn) / 2
    system, state = rod(mu, half, HOLD, HOLD)
    v = np.outer(np.ones(system.thread.n), GLIDE * unit_vector(0.0))
    state = replace(state, v=v, s_dot=np.array([-GLIDE]), sigma=np.array([-1.0]))
    change = abs(float(two_pass(system, state, DT).new.lam[0, :3] @ unit_vector(0.0))) / float(np.cos(half)) / HOLD
    lag = float(2 * mu * np.tan(half))
    given = {"hold": (1 + change, 1 + lag), "pull": (inverse(1 - change), inverse(1 - lag))}
    return [
        Row(kind=f"two passes, {name} given", mu=mu, turn=turn, ratio=ratio, theory=law, settled=ratio < np.inf)
        for name, (ratio, law) in given.items()
    ]


def inverse(x: float) -> float:
    """Return 1/x, or infinity if x is not positive."""
    return float(1.0 / x) if x > 0.0 else float("inf")


# --- a suture round a hole --------------------------------------------------------------------------------


def loop(mu: float, turn: float, holes: int) -> Iterator[Row]:
    """Yield the moments of a suture through a zigzag of holes.

    One end has a dead load, and a hand holds the other. The hand moves out and back.
    """
    sides = unit_vector(0.0), unit_vector(np.radians(turn))
    arm = 10 * float(np.sqrt(SUTURE.EI / LOOP_HOLD))
    corners = np.cumsum([np.zeros(3), *(2 * arm * sides[k % 2] for k in range(1, holes))], axis=0)
    last = corners[-1] + (arm + LOOP_WAY) * sides[holes % 2]
    path = rounded_path([-arm * sides[0], *corners, last], arm / 10)
    s = np.array([path.nearest(corner)[0] for corner in corners])
    way = np.array([[0.0, 0.0], [REST, 0.0], [REST + LOOP_TIME, LOOP_WAY], [REST + 2 * LOOP_TIME, 0.0]])
    hand = np.column_stack([way[:, 0], last + way[:, 1, None] * sides[holes % 2]])
    hands = Pulled(-LOOP_HOLD * sides[0]), Driven(hand)
    run = begin(*laid_through(corners, mu, path, s, hands, SUTURE, LOOP_SPANS, damping=100.0), try_step)
    for _ in range(10):
        run = run.step(REST / 10)
    for number in range(2 * LOOP_STEPS):
        run = run.step(LOOP_TIME / LOOP_STEPS)
        place = float(np.interp(run.state.time, way[:, 0], way[:, 1]))
        yield moment(run.state, mu, turn, place, outwards=number < LOOP_STEPS)


def moment(state: State, mu: float, turn: float, place: float, outwards: bool) -> Row:
    """Return the ratio of pull and hold at one moment.

    Its theory is a bending thread, with the turns measured from the forces.
    """
    hold, pull = np.linalg.norm(state.reaction, axis=1)
    inner = np.cumsum([-state.reaction[0], *-state.lam[:, :3]], axis=0)
    inner /= np.linalg.norm(inner, axis=1)[:, None]
    turns = np.arccos(np.sum(inner[:-1] * inner[1:], axis=1))
    ratio = float(np.prod([bent_ratio(mu, angle) for angle in turns]))
    settled = bool(np.all(state.sigma == (-1.0 if outwards else 1.0)))
    theory, found = ratio if outwards else 1.0 / ratio, float(pull / hold)
    return Row(kind="loop", mu=mu, turn=turn, holes=len(turns), way=place, ratio=found, theory=theory, settled=settled)


# --- what was found ---------------------------------------------------------------------------------------


def rows_of_kind(rows: Sequence[Row], kind: str, mu: float, holes: int | None = None) -> list[Row]:
    """Return the rows of a kind, a coefficient, and optionally a number of holes."""
    return [row for row in rows if (row.kind, row.mu) == (kind, mu) and holes in (None, row.holes)]


def loops_of(rows: Sequence[Row]) -> list[tuple[float, int]]:
    """Return the coefficient and number of holes of every loop."""
    return list(dict.fromkeys((row.mu, row.holes) for row in rows if row.kind == "loop"))


def by_coefficient(rows: Sequence[Row], kind: str) -> dict[str, list[Row]]:
    """Return the rows of a kind by the name of their coefficient."""
    return grouped((row for row in rows if row.kind == kind), lambda row: f"μ = {row.mu:g}")


def coefficients(rows: Sequence[Row]) -> list[float]:
    """Return every coefficient of friction [-]."""
    return list(dict.fromkeys(row.mu for row in rows))


def error(rows: Sequence[Row]) -> float:
    """Return the largest relative error of the settled ratios; NaN if none settled."""
    return max((row.error for row in rows if row.settled), default=float("nan"))


def order_in_number(runs: Sequence[Row]) -> float:
    """Return the order in 1/N with which the last two holes in a row approach exp(μθ)."""
    few, many = runs[-2:]
    return float(np.log((few.ratio - many.limit) / (many.ratio - many.limit)) / np.log(many.holes / few.holes))


def branches(runs: Sequence[Row]) -> tuple[list[Row], list[Row]]:
    """Return a loop as its way out and its way back."""
    top = max(range(len(runs)), key=lambda k: runs[k].way) if runs else -1
    return list(runs[: top + 1]), list(runs[top + 1 :])


def table(rows: Sequence[Row]) -> Table:
    """Return the table with a line for each ratio of a rod, then for each branch of a loop."""
    head = ("case", "μ [-]", "turn [°]", "T₁/T₂, measured", "theory", "exp(μθ)", "error [%]", "remark")
    lines = [line(row) for row in rows if row.kind != "loop"]
    for mu, holes in loops_of(rows):
        for name, turns in zip(("drawn", "let back"), branches(rows_of_kind(rows, "loop", mu, holes)), strict=True):
            if slid := [row for row in turns if row.settled]:
                case = f"suture, {holes} hole{'s' * (holes > 1)}, {name}"
                lines.append((case, *cells(slid[-1]), f"{100 * error(slid):.2g}", "largest of the branch"))
    return Table(head, lines)


def line(row: Row) -> tuple[str, ...]:
    """Return the cells of a ratio of a rod."""
    name = f"{row.holes} {row.kind}" if row.kind == "holes in a row" else row.kind
    off = f"{100 * (row.ratio / row.exact - 1.0):+.2g} % off the exact law" if np.isfinite(row.ratio) else "LOCKS"
    return name, *cells(row), f"{100 * row.error:.2g}" if row.settled else "-", off if "passes" in row.kind else ""


def cells(row: Row) -> tuple[str, ...]:
    """Return coefficient, angle, ratio, theory and capstan as text.

    On the way back the last is the inverse of the capstan.
    """
    limit = row.limit ** ((row.holes if row.kind == "loop" else 1) * (1 if row.theory >= 1.0 else -1))
    return f"{row.mu:g}", f"{row.turn:g}", f"{row.ratio:.5g}", f"{row.theory:.5g}", f"{limit:.5g}"


def remarks(rows: Sequence[Row]) -> Iterator[str]:
    """Yield the orders of the holes in a row, and the runs that did not settle."""
    for mu in coefficients(rows):
        runs = rows_of_kind(rows, "holes in a row", mu)
        far = runs[-1].ratio / runs[-1].limit - 1.0
        order = f"order {order_in_number(runs):.2f} in 1/N" if len(runs) > 1 else "too few for an order"
        yield f"μ = {mu:g}: {runs[-1].holes} holes in a row are {100 * far:.2g} % above exp(μθ), {order}"
        locked = [f"{row.turn:g}°" for row in rows_of_kind(rows, "two passes, pull given", mu) if not row.settled]
        if locked:
            lock = f"LOCK at {', '.join(locked)}, the exact law does not lock"
            yield f"μ = {mu:g}: two passes with the pull given {lock}"
    for row in rows:
        if row.kind in ("one hole", "holes in a row") and not row.settled:
            yield f"{row.kind}, μ = {row.mu:g}, {row.turn:g}°: the threshold was NOT FOUND"


def figure(rows: Sequence[Row]) -> Figure:
    """Return the figure of the laws over the angle, the lag, holes in a row, and loops.

    The loops are shown for the middle coefficient.
    """
    mus, many = coefficients(rows), by_coefficient(rows, "holes in a row")
    angles = np.linspace(0.0, max(row.turn for row in rows if row.kind == "one hole"), 101)
    last, middle = list(many.values())[-1], mus[len(mus) // 2]
    N = np.array([row.holes for row in last])
    settled = [row for row in rows if row.settled]
    held, pulled = (by_coefficient(settled, f"two passes, {name} given") for name in ("hold", "pull"))
    loops = {f"N = {n}": rows_of_kind(rows, "loop", mu, n) for mu, n in loops_of(rows) if mu == middle}
    parts = [branch for run in loops.values() for branch in branches(run)]
    bent = {f"_{number}": part for number, part in enumerate(parts)}
    return draw(described(
        "friction",
        [
            curve([], [], "(1 + μt)/(1 − μt)"),
            laws([partial(over_degrees, point_ratio, mu) for mu in mus], angles),
            laws([partial(over_degrees, capstan, mu) for mu in mus], angles, ":"),
            series(by_coefficient(rows, "one hole"), "turn", "ratio", ""), curve([], [], "exp(μθ)", ":"),
        ],
        [
            series(held, "turn", lambda row: above(row, row.exact)),
            series(pulled, "turn", lambda row: above(row, row.exact), markerfacecolor="white"),
            lambda axes: axes.set_yscale("symlog", linthresh=1.0),
        ],
        [
            series(many, "holes", lambda row: above(row, row.limit)), {"ticks": {"x": list(N)}},
            curve(N, above(last[-1], last[-1].limit) * (N[-1] / N) ** 2, "N⁻²", ":"),
        ],
        [
            series(loops, "way [mm]", "ratio", markers=[""]),
            series(bent, "way [mm]", "theory", ":", [""], ["black"]), curve([], [], "a thread that bends", ":"),
        ],
        turn=last[0].turn, loop_turn=parts[0][0].turn, mu=middle,
    ))  # fmt: skip


def over_degrees(law: Callable[[float, float], float], mu: float, angles: Array) -> list[float]:
    """Return a law over angles [degree]."""
    return [law(mu, turn) for turn in np.radians(angles)]


def above(row: Row, law: float) -> float:
    """Return the difference of a ratio from a law [%]."""
    return 100 * (row.ratio / law - 1.0)
