"""Friction at a hole: the exact point law, the continuum it tends to, and the paper's two passes.

At one hole that turns a thread by θ, its tangent half-way, the pull at slip is (1 + μt)/(1 − μt) times the hold,
t = tan θ/2, and no pull moves it from θ = 2 atan 1/μ on. Round a capstan it is exp(μθ); many holes in a row tend to
that with the square of their number. One lagged correction (§4.3) gives 1 + 2μt where the hold is given and
1/(1 − 2μt) where the pull is. A thread that bends finds its own tangent, and its ratio is that of the elastica. Drawn
out and let back, it shows the loop of the load: the ratio on the way out, one over it on the way back. Through several
holes the ratios multiply, and the loop grows as their power.

A rod of 20 mm in a sleeve that is fixed in space shows the first three, a suture round fixed holes the last.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy.optimize import brentq

import tissue
from coupling.paper.two_pass import two_pass
from coupling.rest.laying import start
from coupling.run import begin
from coupling.step.stepping import try_step
from coupling.system import Friction, Piercing, State, System
from studies.arrays import Array
from studies.figure import COLOURS, MARKERS, panels, ticks
from studies.study import Job, Study, StudyError, Table, each, unit_field
from thread.catalogue import Section, suture
from thread.ends import Driven, End, Pulled
from thread.knots import graded_knots, uniform_knots
from thread.path import rounded_path
from thread.quadrature import gauss_rule
from thread.spline import Spline
from thread.thread import MASS_POINTS, Thread

HOLD = 0.1  # [N]
DT = 3e-3  # of the one step that shows whether a rod slips [s]; long, for the rod bends and that takes inertia
GLIDE = 0.05  # speed of a rod in the two passes [m/s]
ROD = Section(diameter=7e-3, density=260.0, youngs_modulus=2.6e9, poisson_ratio=0.3)  # bends by 1e-4 under 1 N
TINY = 1e-3  # of a pull: as far on either side of its threshold it sticks and slips

SUTURE = suture("2-0 polypropylene")
LOOP_HOLD, LOOP_WAY, LOOP_TIME = 0.2, 3e-3, 1.0  # [N], out and back [m], each [s]
LOOP_STEPS, LOOP_POINTS, FINER = 40, 90, 3.0  # steps each way, control points a hole, knots at it
REST = 0.05  # in which the thread settles before it is drawn [s]
MILLI = 1e-3
PULLS = (0.25, 0.5, 1.0, 2.0, 4.0)  # ticks [-]


@dataclass(frozen=True, kw_only=True)
class Row:
    """One ratio of pull to hold, or for `kind` "loop" the moment of one."""

    kind: str  # "one hole", "holes in a row", "two passes, hold given", "two passes, pull given" or "loop"
    mu: float = unit_field("-")
    turn: float = unit_field("degree")
    holes: int = unit_field("-")
    way: float = unit_field("m")  # of the hand, in a loop
    ratio: float = unit_field("-")
    theory: float = unit_field("-")
    settled: bool  # sticks and slips on either side of the threshold found; in a loop, slips


def main(
    mus: Sequence[float] = (0.1, 0.2, 0.3),
    turns: Sequence[float] = (15.0, 30.0, 60.0, 90.0, 120.0),
    wrap: float = 180.0,
    rows_of_holes: Sequence[int] = (2, 4, 8, 16),
    loop_turn: float = 90.0,
    loop_holes: Sequence[int] = (1, 2, 3),
) -> Iterator[Row]:
    """Yield every ratio: single holes, lags and a loop for every coefficient, and holes in a row over `wrap` [degree].

    Raises `StudyError` for what has no threshold.
    """
    if (
        min(loop_holes) < 1
        or min(mus) <= 0.0
        or min(turns) <= 0.0
        or max(turns) >= 180.0
        or min(rows_of_holes) < 2
        or wrap <= 0.0
    ):
        reason = (
            "coefficients and wrap above 0, turns between 0 and 180 degrees, rows of two holes or more, loops of one"
        )
        given = f"mus = {mus}, turns = {turns}, wrap = {wrap}, rows_of_holes = {rows_of_holes}, loops = {loop_holes}"
        raise StudyError(f"{given}: give {reason}")
    jobs: list[Job] = []
    for mu in mus:
        jobs += [partial(one_hole, mu, turn) for turn in turns]
        jobs += [partial(two_passes, mu, turn) for turn in turns]
        jobs += [partial(holes_in_a_row, mu, wrap, holes) for holes in sorted(set(rows_of_holes))]
        jobs += [partial(loop, mu, loop_turn, holes) for holes in loop_holes]
    yield from each(jobs)


def unit_vector(angle: float) -> Array:
    """Return the unit vector at `angle` [rad] below x in the plane of x and z."""
    return np.array([np.cos(angle), 0.0, -np.sin(angle)])


def fixed_holes(
    thread: Thread, ends: tuple[End, End], friction: Friction, places: Array, directed: Array | None = None
) -> System:
    """Build a thread through holes at `places` (p, 3) [m], fixed in space, all `directed` (3,) or none."""
    sites = tissue.fixed_sites([tissue.Site(place, direction=directed) for place in places])
    holes = [Piercing(f"hole {k}", directed=directed is not None, friction=friction) for k in range(len(places))]
    return System(thread, ends, sites, tuple(holes))


# --- a rod in a sleeve ------------------------------------------------------------------------------------


def rod(mu: float, half: float, pull: float, hold: float) -> tuple[System, State]:
    """Build a rod along x in a sleeve, at rest, its ends pulled out of line by `half` [rad] each."""
    thread = Thread(Spline(uniform_knots(0.02, 8)), ROD)
    ends = (Pulled(-hold * unit_vector(-half)), Pulled(pull * unit_vector(half)))
    system = fixed_holes(thread, ends, Friction(mu, mu), np.zeros((1, 3)), unit_vector(0.0))
    path = (gauss_rule(thread.spline, MASS_POINTS).s - 0.01)[..., None] * unit_vector(0.0)
    return system, start(system, np.array([0.01]), path, 1.0)


def slips(mu: float, half: float, pull: float, hold: float) -> bool:
    """Tell whether the rod slips towards its pulled end."""
    return bool(begin(*rod(mu, half, pull, hold)).step(DT).state.sigma[0] < 0.0)


def pull_at_slip(mu: float, half: float, hold: float) -> tuple[float, bool]:
    """Find the pull [N] where |f| − μN, linear in the pull, has its zero, as seen while the rod sticks; and whether it
    sticks just below and slips just above."""
    pulls, margins = (hold, 1.01 * hold), []
    for pull in pulls:
        run = begin(*rod(mu, half, pull, hold)).step(DT)
        seen = run.piercings[0]
        margins.append(abs(seen.tangential_force) - mu * seen.normal_force)
    pull = pulls[0] - margins[0] * (pulls[1] - pulls[0]) / (margins[1] - margins[0])
    return pull, slips(mu, half, (1 + TINY) * pull, hold) and not slips(mu, half, (1 - TINY) * pull, hold)


def exact_ratio(mu: float, turn: float) -> float:
    """Return (1 + μt)/(1 − μt) of one hole that turns the thread by `turn` [degree]; infinite where it locks."""
    mt = mu * np.tan(np.radians(turn) / 2)
    return float((1 + mt) / (1 - mt)) if mt < 1.0 else float("inf")


def one_hole(mu: float, turn: float) -> Row:
    """Measure the ratio at which a rod slips."""
    pull, settled = pull_at_slip(mu, np.radians(turn) / 2, HOLD)
    theory = exact_ratio(mu, turn)
    return Row(kind="one hole", mu=mu, turn=turn, holes=1, way=0.0, ratio=pull / HOLD, theory=theory, settled=settled)


def holes_in_a_row(mu: float, wrap: float, holes: int) -> Row:
    """Measure rods in a row, each held by the pull of the one before; they turn by `wrap` [degree] in all."""
    pull, settled = HOLD, True
    for _ in range(holes):
        pull, sure = pull_at_slip(mu, np.radians(wrap) / holes / 2, pull)
        settled &= sure
    theory, ratio = exact_ratio(mu, wrap / holes) ** holes, pull / HOLD
    return Row(
        kind="holes in a row", mu=mu, turn=wrap, holes=holes, way=0.0, ratio=ratio, theory=theory, settled=settled
    )


def two_passes(mu: float, turn: float) -> list[Row]:
    """Return what the second pass makes of a gliding rod under equal pulls: the tension changes by its friction, from
    the hold up or from the pull down."""
    half = np.radians(turn) / 2
    system, state = rod(mu, half, HOLD, HOLD)
    v = np.outer(np.ones(system.thread.n), GLIDE * unit_vector(0.0))
    state = replace(state, v=v, s_dot=np.array([-GLIDE]), sigma=np.array([-1.0]))
    change = abs(float(two_pass(system, state, DT).new.lam[0, :3] @ unit_vector(0.0))) / np.cos(half)
    lag = 2 * mu * np.tan(half)
    given = {"hold": (1 + change / HOLD, 1 + lag), "pull": (inverse(1 - change / HOLD), inverse(1 - lag))}
    return [
        Row(
            kind=f"two passes, {name} given",
            mu=mu,
            turn=turn,
            holes=1,
            way=0.0,
            ratio=float(ratio),
            theory=float(theory),
            settled=bool(np.isfinite(ratio)),
        )
        for name, (ratio, theory) in given.items()
    ]


def inverse(x: float) -> float:
    """Return 1/x, infinite where nothing is left to hold."""
    return float(1.0 / x) if x > 0.0 else float("inf")


# --- a suture round a hole --------------------------------------------------------------------------------


def loop(mu: float, turn: float, holes: int) -> Iterator[Row]:
    """Run a suture held by a dead load and drawn through a zigzag of holes by a hand that goes out and comes back."""
    sides = unit_vector(0.0), unit_vector(np.radians(turn))
    arm = 10 * float(np.sqrt(SUTURE.EI / LOOP_HOLD))
    corners = np.cumsum([np.zeros(3), *(2 * arm * sides[k % 2] for k in range(1, holes))], axis=0)
    last = corners[-1] + (arm + LOOP_WAY) * sides[holes % 2]
    path = rounded_path([-arm * sides[0], *corners, last], arm / 10)
    s = np.array([path.nearest(corner)[0] for corner in corners])
    thread = Thread(Spline(graded_knots(path.length, LOOP_POINTS * holes, s, FINER, arm / 2)), SUTURE, damping=100.0)
    way = np.array([[0.0, 0.0], [REST, 0.0], [REST + LOOP_TIME, LOOP_WAY], [REST + 2 * LOOP_TIME, 0.0]])
    hand = np.column_stack([way[:, 0], last + way[:, 1, None] * sides[holes % 2]])
    ends = (Pulled(-LOOP_HOLD * sides[0]), Driven(hand))
    system = fixed_holes(thread, ends, Friction(mu, mu), corners)
    laid = start(system, s, path.position(gauss_rule(thread.spline, MASS_POINTS).s), 1.0)
    run = begin(system, laid, try_step)
    for _ in range(10):
        run = run.step(REST / 10)
    for number in range(2 * LOOP_STEPS):
        run = run.step(LOOP_TIME / LOOP_STEPS)
        place = float(np.interp(run.state.time, way[:, 0], way[:, 1]))
        yield moment(system, run.state, mu, turn, place, outwards=number < LOOP_STEPS)


def moment(system: System, state: State, mu: float, turn: float, place: float, outwards: bool) -> Row:
    """Pull over hold; the theory is that of a thread that bends, for the angles by which the force in it turns."""
    hold, pull = np.linalg.norm(state.reaction, axis=1)
    inner = np.cumsum([-state.reaction[0], *-state.lam[:, :3]], axis=0)
    inner /= np.linalg.norm(inner, axis=1)[:, None]
    turns = np.arccos(np.sum(inner[:-1] * inner[1:], axis=1))
    ratio = float(np.prod([bent_ratio(mu, angle) for angle in turns]))
    sense = -1.0 if outwards else 1.0
    return Row(
        kind="loop",
        mu=mu,
        turn=turn,
        holes=len(turns),
        way=place,
        ratio=float(pull / hold),
        theory=ratio if outwards else 1.0 / ratio,
        settled=bool(np.all(state.sigma == sense)),
    )


def bent_ratio(mu: float, turn: float) -> float:
    """Return T₁/T₂ of a thread that bends, turned by `turn` [rad]: T₁(1 − cos α) = T₂(1 − cos β), for its moment is the
    same on both sides (elastica), and T₁ − T₂ = μ(T₁ sin α + T₂ sin β), α + β the turn."""

    def ratio(alpha: float) -> float:
        return float((1 + mu * np.sin(turn - alpha)) / (1 - mu * np.sin(alpha)))

    def jump_of_moment(alpha: float) -> float:
        return float(ratio(alpha) * (1 - np.cos(alpha)) - (1 - np.cos(turn - alpha)))

    return ratio(brentq(jump_of_moment, 1e-9, turn / 2))


# --- table and figure -------------------------------------------------------------------------------------


def rows_of_kind(rows: Sequence[Row], kind: str, mu: float, holes: int | None = None) -> list[Row]:
    """Return the rows of a kind and a coefficient, and of a number of holes."""
    return [row for row in rows if (row.kind, row.mu) == (kind, mu) and holes in (None, row.holes)]


def loops_of(rows: Sequence[Row]) -> list[tuple[float, int]]:
    """Return the coefficient and number of holes of every loop."""
    return list(dict.fromkeys((row.mu, row.holes) for row in rows if row.kind == "loop"))


def coefficients(rows: Sequence[Row]) -> list[float]:
    """Return every coefficient of friction [-]."""
    return list(dict.fromkeys(row.mu for row in rows))


def error(rows: Sequence[Row]) -> float:
    """Return the largest error of the ratios that settled, over theirs of theory; NaN where there are none."""
    return max((abs(row.ratio / row.theory - 1.0) for row in rows if row.settled), default=float("nan"))


def order_in_number(runs: Sequence[Row]) -> float:
    """Return the order in 1/N by which the last two holes in a row tend to exp(μθ)."""
    few, many = runs[-2:]
    limit = np.exp(many.mu * np.radians(many.turn))
    return float(np.log((few.ratio - limit) / (many.ratio - limit)) / np.log(many.holes / few.holes))


def table(rows: Sequence[Row]) -> Table:
    """Make one line a coefficient and angle, then those of the holes in a row, then those of the loops."""
    head = ("case", "μ [-]", "turn [°]", "T₁/T₂, measured", "theory", "exp(μθ)", "error [%]", "remark")
    lines: list[tuple[str, ...]] = []
    for row in rows:
        if row.kind == "loop":
            continue
        name = f"{row.holes} {row.kind}" if row.kind == "holes in a row" else row.kind
        exact = exact_ratio(row.mu, row.turn)
        off = f"{100 * (row.ratio / exact - 1.0):+.2g} % off the exact law" if np.isfinite(row.ratio) else "LOCKS"
        lagged = off if "passes" in row.kind else ""
        lines.append((name, *cells(row), f"{100 * error([row]):.2g}" if row.settled else "-", lagged))
    for mu, holes in loops_of(rows):
        for name, turns in zip(("drawn", "let back"), branches(rows_of_kind(rows, "loop", mu, holes)), strict=True):
            slid = [row for row in turns if row.settled]
            if slid:
                case = f"suture, {holes} hole{'s' * (holes > 1)}, {name}"
                lines.append((case, *cells(slid[-1]), f"{100 * error(slid):.2g}", "largest of the branch"))
    return Table(head, lines)


def cells(row: Row) -> tuple[str, ...]:
    """Write the coefficient, angle, ratio, theory and that of the continuum, one over it where the thread goes back."""
    wrap = row.turn * row.holes if row.kind == "loop" else row.turn
    capstan = np.exp(row.mu * np.radians(wrap))
    capstan = capstan if row.theory >= 1.0 else 1.0 / capstan
    return f"{row.mu:g}", f"{row.turn:g}", f"{row.ratio:.5g}", f"{row.theory:.5g}", f"{capstan:.5g}"


def branches(runs: Sequence[Row]) -> tuple[list[Row], list[Row]]:
    """Return a loop on its way out and on its way back."""
    top = max(range(len(runs)), key=lambda k: runs[k].way) if runs else -1
    return list(runs[: top + 1]), list(runs[top + 1 :])


def remarks(rows: Sequence[Row]) -> list[str]:
    """List the orders of the holes in a row, and what did not settle."""
    out = []
    for mu in coefficients(rows):
        runs = rows_of_kind(rows, "holes in a row", mu)
        limit = np.exp(mu * np.radians(runs[0].turn))
        far = runs[-1].ratio / limit - 1.0
        order = f"order {order_in_number(runs):.2f} in 1/N" if len(runs) > 1 else "too few for an order"
        out.append(f"μ = {mu:g}: {runs[-1].holes} holes in a row are {100 * far:.2g} % above exp(μθ), {order}")
        locked = [f"{row.turn:g}°" for row in rows_of_kind(rows, "two passes, pull given", mu) if not row.settled]
        if locked:
            out.append(
                f"μ = {mu:g}: two passes with the pull given LOCK at {', '.join(locked)}, the exact law does not"
            )
    holes = [row for row in rows if row.kind in ("one hole", "holes in a row") and not row.settled]
    out += [f"{row.kind}, μ = {row.mu:g}, {row.turn:g}°: the threshold was NOT FOUND" for row in holes]
    return out


def figure(rows: Sequence[Row]) -> Figure:
    """Draw the laws over the angle, the lag, holes in a row, and the loops of the load."""
    drawing, grid = panels(2, 3)
    over_angle(grid[0, 0], rows)
    lag(grid[0, 1], rows)
    rows_of_holes(grid[0, 2], rows)
    fewest = min(holes for _, holes in loops_of(rows))
    middle = coefficients(rows)[len(coefficients(rows)) // 2]
    one = [(mu, holes, f"μ = {mu:g}") for mu, holes in loops_of(rows) if holes == fewest]
    several = [(mu, holes, f"N = {holes}") for mu, holes in loops_of(rows) if mu == middle]
    loops(grid[1, 0], rows, one, f"N = {fewest}")
    loops(grid[1, 1], rows, several, f"μ = {middle:g}")
    over_holes(grid[1, 2], rows)
    return drawing


def over_angle(axes: Axes, rows: Sequence[Row]) -> None:
    """Draw the ratios over the angle: points are measured, full lines the exact law, dotted the capstan."""
    for mu, colour, marker in zip(coefficients(rows), COLOURS, MARKERS, strict=False):
        runs = rows_of_kind(rows, "one hole", mu)
        turn = np.linspace(0.0, max(run.turn for run in runs), 101)
        axes.plot(turn, [exact_ratio(mu, t) for t in turn], color=colour)
        axes.plot(turn, np.exp(mu * np.radians(turn)), color=colour, linestyle=":")
        x, y = [run.turn for run in runs], [run.ratio for run in runs]
        axes.plot(x, y, marker, color=colour, label=f"μ = {mu:g}")
    axes.plot([], [], color="black", label="(1 + μt)/(1 − μt)")
    axes.plot([], [], color="black", linestyle=":", label="exp(μθ)")
    axes.set(xlabel="turn θ [°]", ylabel="pull over hold at slip [-]", title="one hole")
    axes.legend()


def lag(axes: Axes, rows: Sequence[Row]) -> None:
    """Draw the two passes over the exact law, filled where the hold is given, hollow where the pull is."""
    for mu, colour, marker in zip(coefficients(rows), COLOURS, MARKERS, strict=False):
        for name, face in (("hold", colour), ("pull", "white")):
            runs = [run for run in rows_of_kind(rows, f"two passes, {name} given", mu) if run.settled]
            off = [100 * (run.ratio / exact_ratio(mu, run.turn) - 1.0) for run in runs]
            label = f"μ = {mu:g}, {name} given"
            axes.plot([r.turn for r in runs], off, color=colour, marker=marker, markerfacecolor=face, label=label)
    axes.set_yscale("symlog", linthresh=1.0)
    axes.set(xlabel="turn θ [°]", ylabel="two passes over the exact law, less 1 [%]", title="lag of two passes")
    axes.legend()


def rows_of_holes(axes: Axes, rows: Sequence[Row]) -> None:
    """Draw how far holes in a row are from the capstan."""
    for mu, colour, marker in zip(coefficients(rows), COLOURS, MARKERS, strict=False):
        runs = rows_of_kind(rows, "holes in a row", mu)
        N = np.array([run.holes for run in runs])
        far = np.array([run.ratio for run in runs]) / np.exp(mu * np.radians(runs[0].turn)) - 1.0
        axes.plot(N, 100 * far, color=colour, marker=marker, label=f"μ = {mu:g}")
    axes.plot(N, 100 * far[-1] * (N[-1] / N) ** 2, color="black", linestyle=":", label="N⁻²")
    axes.set(xscale="log", yscale="log", xlabel="holes in a row N [-]", ylabel="ratio over exp(μθ), less 1 [%]")
    axes.set_title(f"a turn of {runs[0].turn:g}° by N holes")
    ticks(axes, "x", list(N))
    axes.legend()


def loops(axes: Axes, rows: Sequence[Row], shown: Sequence[tuple[float, int, str]], common: str) -> None:
    """Pull over hold as the hand goes out and back, for coefficients, numbers of holes and their labels; dotted, a
    thread that bends."""
    for (mu, holes, label), colour in zip(shown, COLOURS, strict=False):
        runs = rows_of_kind(rows, "loop", mu, holes)
        axes.plot([run.way / MILLI for run in runs], [run.ratio for run in runs], color=colour, label=label)
        for branch in branches(runs):
            way = [run.way / MILLI for run in branch]
            axes.plot(way, [run.theory for run in branch], color="black", linestyle=":")
    axes.plot([], [], color="black", linestyle=":", label="a thread that bends")
    axes.set(yscale="log", xlabel="way of the hand [mm]", ylabel="pull over hold [-]")
    axes.set_title(f"out and back, {runs[0].turn:g}° at each hole, {common}")
    ticks(axes, "y", PULLS)
    axes.legend(ncols=2, loc="lower left")


def over_holes(axes: Axes, rows: Sequence[Row]) -> None:
    """Draw the last ratio of both branches over the number of holes; dotted, the capstan."""
    for mu, colour, marker in zip(coefficients(rows), COLOURS, MARKERS, strict=False):
        counts = [holes for coefficient, holes in loops_of(rows) if coefficient == mu]
        for side in (0, 1):
            ends = [branches(rows_of_kind(rows, "loop", mu, holes))[side][-1] for holes in counts]
            label = f"μ = {mu:g}" if side == 0 else None
            axes.plot(counts, [run.theory for run in ends], color=colour)
            axes.plot(counts, [run.ratio for run in ends], marker, color=colour, label=label)
            turned = np.radians(ends[0].turn) * np.array(counts)
            axes.plot(counts, np.exp((1 - 2 * side) * mu * turned), color=colour, linestyle=":")
    axes.plot([], [], color="black", label="a thread that bends")
    axes.plot([], [], color="black", linestyle=":", label="exp(±μθ)")
    axes.set(yscale="log", xlabel="holes N [-]", ylabel="pull over hold [-]", title="drawn, and let back")
    axes.set_xticks(sorted({holes for _, holes in loops_of(rows)}))
    ticks(axes, "y", PULLS)
    axes.set_ylim(top=2.5 * axes.get_ylim()[1])
    axes.legend(loc="upper left", ncols=2)


STUDY = Study(
    main=main,
    question="Which pull draws a thread through rough holes, and how far are the capstan and two passes from it?",
    independent="the balance at one hole, its product over holes in a row and its limit exp(μθ), the lag of two passes "
    "in closed form, and the elastica of a thread that bends",
    consistency="two passes against the exact law",
    table=table,
    figure=figure,
    remarks=remarks,
    quick={"mus": (0.1, 0.3), "turns": (30.0, 60.0, 90.0), "rows_of_holes": (2, 4, 8), "loop_holes": (1, 2)},
)
