"""A directed hole on spans longer than √(EI/T), over which the thread turns there: what it pulls, bends and rubs with.

Beyond a hole each strand is half of the syntractrix of an endless thread under its own tension T. At the hole it has
turned by α from the direction in which it goes on: M = 2 √(EI T) sin α/2 on each side, of which the hole bears the
difference, the sum where the turns are of opposite signs, and the pulls differ by the friction of what presses across
the direction, T₁ − T₂ = μN (`test_friction_capstan`).

`python -m tests.coupling.test_layer` prints the table of `coupling/README.md`.
"""

from dataclasses import dataclass

import numpy as np
import pytest

from coupling.kernels.constraints import Passage, held_energy
from coupling.kernels.steps.tension import resisting_together
from coupling.run.run import Run, begin
from coupling.system import Friction, Piercing
from tests.bounds import IDENTITY
from tests.coupling.wholes import whole
from tests.thread.threads import ORIGIN, PP, Array, laid, uniform, without_organ
from thread.ends import Driven, Pulled

HOLD, MU = 1.0, 0.2  # [N], [-]
SPANS, LAYERS = 20, 6.0  # of the whole thread, and √(EI/T) on each side of the hole, at least
STEPS, DT = 24, 2e-2  # in which a span runs through; [s], so slow that nothing is damped
RATIOS = (0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0)  # spans over √(EI/T)
TURNS = ((60.0, 30.0), (60.0, 0.0), (30.0, 60.0))  # degrees that the thread turns in all, and before the hole
ASKED = 0.03


@whole
def together(before: float, after: float, force: tuple[float, float, float]) -> float:
    """The mean, by √T, of cos ½α of two strands."""
    return resisting_together(before, after, force)


@dataclass(frozen=True)
class Seen:
    """Over a span that runs through a hole: by what force and friction are off on the mean from the elastica's, over
    these, and the couple over the sum of the sizes of both sides' couples; `swing`, the most that the friction is."""

    force: float
    couple: float
    friction: float
    swing: float


def along(angle: float) -> Array:
    """Unit vector at `angle` below x in the plane of x and z."""
    return np.array([np.cos(angle), 0.0, -np.sin(angle)])


def angle(direction: Array) -> float:
    """Angle of a direction below x in that plane."""
    return float(np.arctan2(-direction[2], direction[0]))


def drawn(ratio: float, turn: float, before: float) -> tuple[Run, Array]:
    """A thread on spans of `ratio` √(EI/T), held by a dead load, whose other end is drawn by a span in STEPS; with the
    hole's direction."""
    out, normal = along(turn), along(before)
    span = ratio * np.sqrt(PP.EI / HOLD)
    spans = max(SPANS, 2 * round(LAYERS / ratio))
    s = (spans // 2 + 0.5) * span
    arm = spans * span - s
    rest, speed = 0.5, span / (STEPS * DT)
    way = np.array([[0.0, *(arm * out)], [rest, *(arm * out)], [rest + 10.0, *((arm + 10.0 * speed) * out)]])
    hole = Piercing("hole", friction=Friction(MU, MU))
    thread = uniform(spans * span, spans + 3, PP, damping=30.0)
    system = without_organ(thread, (Pulled(-HOLD * along(0.0)), Driven(way)), (hole,), ((ORIGIN, normal),))

    def path(at: Array) -> Array:
        beyond = (np.asarray(at) - s)[..., None]
        return np.where(beyond < 0.0, beyond * along(0.0), beyond * out)

    run = begin(system, laid(system, [s], path))
    for _ in range(round(rest / DT) + STEPS // 2):
        run = run.step(DT)
    return run, normal


def seen(ratio: float, turn: float, before: float) -> Seen:
    """Draw a span through and compare each step with the elastica of its own pulls."""
    run, normal = drawn(ratio, *np.radians([turn, before]))
    rows = []
    for _ in range(STEPS):
        s, run = run.state.s[0], run.step(DT)
        hold, pull = run.state.reaction
        T = np.linalg.norm([hold, pull], axis=1)
        turned = np.array([angle(normal) - angle(-hold), angle(pull) - angle(normal)])
        M = 2.0 * np.sqrt(PP.EI * T) * np.sin(0.5 * turned)
        across = (hold + pull) - (hold + pull) @ normal * normal
        here = run.piercings[0]
        exact, rubbed = np.linalg.norm(hold + pull), MU * np.linalg.norm(across)
        jump = M[1] - M[0]
        couple = -here.couple[1] * np.sign(jump) - abs(jump)
        off = np.linalg.norm(here.force) - exact, couple, T[1] - T[0] - rubbed
        rows.append((run.state.s[0] - s, *(np.array(off) / (exact, np.abs(M).sum(), rubbed))))
    ds, force, couple, friction = np.array(rows).T
    mean = np.stack([force, couple, friction]) @ ds / ds.sum()
    return Seen(*mean.tolist(), float(np.abs(friction).max()))


@pytest.mark.parametrize(
    ("ratio", "turn", "before"),
    [
        (0.5, 60.0, 0.0),
        (2.0, 60.0, 0.0),
        (5.0, 60.0, 0.0),
        (10.0, 60.0, 30.0),
        (20.0, 60.0, 0.0),
        (20.0, 60.0, 30.0),
        (5.0, 30.0, 60.0),
        (0.2, 30.0, 60.0),
        (0.5, 30.0, 60.0),
        (2.0, 30.0, 60.0),
        (20.0, 30.0, 60.0),
    ],
)
def test_what_a_hole_does_to_a_thread_on_long_spans(ratio: float, turn: float, before: float) -> None:
    """Independent check (elastica): at a turn of 60°, and at turns of 60° and 30° of opposite signs."""
    found = seen(ratio, turn, before)
    assert abs(found.force) <= ASKED
    assert abs(found.friction) <= ASKED
    assert abs(found.couple) <= ASKED


@pytest.mark.parametrize("degrees", [10.0, 45.0, 80.0])
def test_what_turns_far_stores_what_the_elastica_does(degrees: float) -> None:
    """Independent check (elastica): strands turned by φ on the mean store 8√(EI T) (1 − cos ½φ) cos ¼θ, here per
    1/g = 2√(EI T) cos ¼θ, and a compliance gγ under the couple sin φ/(gγ) stores half of their product."""
    phi = np.radians(degrees)
    D = np.array([np.zeros(3), [np.sin(phi), 0.0, np.cos(phi)], np.zeros(3), np.zeros(3)])[None]
    c = np.zeros((1, 3, 4))
    c[:, 0, 2:] = 1.0  # under the couple 1 it stores ½γ
    at = Passage(np.zeros(1, dtype=int), np.zeros((1, 4, 4)), D, c, np.ones(1, dtype=bool))
    frame = np.array([[0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0]])
    gamma = 2.0 * held_energy(at, np.array([[0.0, 0.0, 0.0, 1.0, 0.0]]), frame)[0]
    assert abs(0.5 * np.sin(phi) ** 2 / gamma - 4.0 * (1.0 - np.cos(0.5 * phi))) <= IDENTITY


@pytest.mark.parametrize("degrees", [0.0, 30.0, 120.0, 180.0])
@pytest.mark.parametrize("other", [1.0, 0.7, 0.01])
def test_the_angle_between_strands_is_told_by_their_tensions(degrees: float, other: float) -> None:
    """Independent check (statics): what a hole bears is the difference of both tensions as vectors; each strand leaves
    the mean of their directions by tension, by ½θ where they are equal."""
    theta, T = np.radians(degrees), (1.0, other)
    force = other * along(theta) - along(0.0)
    mean = theta * other / (1.0 + other)
    exact = np.average(np.cos(0.5 * np.array([mean, theta - mean])), weights=np.sqrt(T))
    assert abs(together(*T, tuple(force)) - exact) <= np.sqrt(IDENTITY)
    if other == 1.0:
        assert abs(exact - np.cos(0.25 * theta)) <= IDENTITY


@pytest.mark.parametrize("size", [0.9, 1.0, 1.1])
def test_what_a_slack_strand_turns_by_does_not_count(size: float) -> None:
    """A strand without tension leaves no force by which its direction were told, and resists no turn: the other
    does, with all of its √(EI T), whatever the hole's force is off by."""
    slack = 1e-8
    for T in ((1.0, slack), (slack, 1.0)):
        assert abs(together(*T, (size, 0.0, 0.0)) - 1.0) <= 2.0 * np.sqrt(slack)


def main() -> None:
    """Print the table."""
    print("| turn, before the hole | h/ℓ | force | couple | friction | within a span |\n|---|---|---|---|---|---|")
    for turn, before in TURNS:
        for ratio in RATIOS:
            found = seen(ratio, turn, before)
            numbers = f"{found.force:+.1%} | {found.couple:+.1%} | {found.friction:+.1%} | ±{found.swing:.0%}"
            print(f"| {turn:g}°, {before:g}° | {ratio:g} | {numbers} |", flush=True)


if __name__ == "__main__":
    main()
