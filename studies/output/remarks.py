"""Remarks on the numbers of a run, in `summary.json`, on the console and from Python.

The catalogue, `remarks.toml`, has each code once, with its severity, its bound, the reason of the
bound, and its message. A remark is made beyond its bound. The severity "unsupported" means that the
model does not support a number of the run. A "note" is information for the reader.
`studies.simulation.remarks` decides which remarks a run has.
"""

from collections.abc import Iterable
from dataclasses import asdict, dataclass
from typing import Literal, get_args

from studies.lists import list_of
from studies.output.records import SEEN, SWITCHES

Severity = Literal["unsupported", "note"]

SMALL_STRAIN = 0.2  # linear elasticity neglects ½ε² compared with ε: a tenth of ε here
SMALL_ROTATION = 0.2  # rad: a pure rotation strains a linear body by 1 − cos θ, which is 0.02 here
EARLY = 0.8  # factor on both for a prediction, which can be too low: a check should miss few runs beyond the bounds
EARLY_STRAIN, EARLY_ROTATION = EARLY * SMALL_STRAIN, EARLY * SMALL_ROTATION
RULES = 1.1  # times the force across the thread: above this, the couple over the channel presses more than the force
UNSURE = 0.05  # of the tension: allowed difference of friction between half and twice the channel
SHARE = 0.05  # of the organ's strain energy: a smaller share hardly affects the forces
THREAD_STRAIN = 0.1  # stress of monofilaments is proportional to strain up to about this strain (assumption)
KINKED = 1.0  # diameters: in a bend of a smaller radius the inner fibres are compressed to half their length or less
OFF_PATH = 10.0  # diameters: a beginning hole draws the thread by at most this distance
CREATED = 1e-4  # of a run's energy: round-off is 1e-9 of it, and the time steps of the shipped scenes create no energy
DISSIPATED = 0.05  # of a run's energy
OUTDONE = 1.0  # of the friction loss: above this, time steps rather than friction determine where the thread stops
FALLEN = 1e-6  # of the loads: round-off is smaller
CROSSED = 0.01  # of the lips' extent: a smaller overlap counts as closed
SWUNG = 0.01  # of the largest force
SLID = 1.0  # diameters: a thread at rest slides less than this in another run of the same duration
OFF_LAW = 0.01  # of the largest tension: allowed error of friction
LOCKED = 0.9  # of the hands' force on a tie: below this the hands still drew, at more than a tenth of their speed
STEEP = 1.0  # coefficient of friction
BARE = 4.0  # radii: at an angle of 30° or more this length of a tract's path is near the surface, at both ends together
STIFF = 1.0  # EI times the turn per ball, over T r²: 2 % of the closing effect of a bite of two or four radii
SLIGHT = 0.05  # rad per ball: a slack thread with a smaller turn lies straight in its tract
IN_TISSUE = 1.0  # diameters: a deeper thread lies in tissue and not on tissue
MOVED = 2.0  # footprints: a hole moved by this distance still touches its former place
NEAR = 2.0  # times the sum of two footprints: nearer, a hole moves its neighbour by a quarter of its displacement
REDUCED = 0.03  # of the largest displacement of a hole: allowed error of a small basis, equal to the error of the cells
COARSE = {"P1": 0.25, "P2": 0.5}  # cell size over footprint: the hole's compliance then has an error of at most 8 %
BOUNDS = {name: value for name, value in globals().items() if name.isupper()}  # by the names in the catalogue
BOUNDS |= {"SEEN": SEEN, "SWITCHES": SWITCHES}


@dataclass(frozen=True)
class Remark:
    """A remark on a run; `where` names a piercing, a key, or a part of the run."""

    code: str
    severity: Severity
    message: str
    where: str

    @property
    def unsupported(self) -> bool:
        """Whether the remark means an unsupported number."""
        return self.severity == "unsupported"

    @property
    def line(self) -> str:
        """The remark as a line for the console."""
        return f"{self.severity}: {self.message} [{self.code}]"

    def record(self) -> dict[str, str]:
        """Return the remark as in `summary.json`."""
        return asdict(self)


# A remark by its code: the condition `bound` and its `reason`, both for the manual, and the `message` with names in
# braces for its values.
CATALOGUE = {code: {"severity": "unsupported", **table} for code, table in list_of(__file__, "remarks.toml").items()}


def remark(code: str, where: str, **values: object) -> Remark:
    """Return a remark of the catalogue by its code, with the values that its message names."""
    kind = CATALOGUE[code]
    return Remark(code, kind["severity"], kind["message"].format(where=where, **BOUNDS, **values), where)


def judged(deserved: bool, code: str, where: str, **values: object) -> list[Remark]:
    """Return a list with a remark of the catalogue if it is `deserved`, else an empty list."""
    return [remark(code, where, **values)] if deserved else []


def any_unsupported(remarks: Iterable[Remark]) -> bool:
    """Return whether a remark means an unsupported number."""
    return any(each.unsupported for each in remarks)


def markdown() -> str:
    """Return the lists of the manual, one for each severity."""
    lines = []
    for severity in get_args(Severity):
        lines += ["", f"Severity `{severity}`:", ""]
        lines += [
            f"- `{code}`: {kind['bound'].format(**BOUNDS)}. {kind['reason'][0].upper()}{kind['reason'][1:]}."
            for code, kind in CATALOGUE.items()
            if kind["severity"] == severity
        ]
    return "\n".join([*lines, "", ""])
