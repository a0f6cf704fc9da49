"""What a result supports: linear range, cells and spans fine enough, a run that came to rest; and the remark if not."""

LINEAR = 0.3  # footprints that a hole may move by, or strain in the tissue that bears a thread: both of its size
RESOLVED = 0.5  # spans at a hole over √(EI/T): beyond, forces along the thread are off by several per cent
SETTLED = 1e-4  # kinetic over elastic energy: what still swings is below 1 % of what is deformed, as (v/ω)² is to u²


def beyond_linear(what: str, moved: float, footprint: float) -> list[str]:
    """A remark where a hole moved [m] farther than small strains allow with its footprint [m]."""
    if moved <= LINEAR * footprint:
        return []
    return [f"{what}: a hole moved by {moved / footprint:.2g} footprints, BEYOND the linear range (about {LINEAR})"]


def beyond_bearing(what: str, tension: float, diameter: float, bite: float, youngs_modulus: float) -> list[str]:
    """A remark where the bearing strain T/(d ℓ E) of a thread of a tension [N] and diameter [m] in a bite [m] of tissue
    [Pa] is not small."""
    strain = bearing_strain(tension, diameter, bite, youngs_modulus)
    if strain <= LINEAR:
        return []
    return [f"{what}: the bearing strain T/(d ℓ E) is {strain:.2g}, BEYOND the linear range (about {LINEAR})"]


def bearing_strain(tension: float, diameter: float, bite: float, youngs_modulus: float) -> float:
    """T/(d ℓ E): mean pressure of a thread on the tissue that it lies in over a length ℓ, over the tissue's E."""
    return tension / (diameter * bite * youngs_modulus)


def too_coarse(what: str, size: float, footprint: float) -> list[str]:
    """A remark where cells [m] are larger than the radius of a footprint [m] that nothing else makes up for."""
    if size <= footprint:
        return []
    return [f"{what}: cells of {size / footprint:.3g} footprint radii, TOO COARSE: the hole is as stiff as the mesh is"]


def spans_too_coarse(what: str, ratio: float) -> list[str]:
    """A remark where the spans at the holes are too long for the bends there; `ratio` is a step's `span_ratio`."""
    if ratio <= RESOLVED:
        return []
    reason = f"spans at the holes of {ratio:.2g} bending lengths √(EI/T), TOO COARSE for the forces along the thread"
    return [f"{what}: {reason}"]


def not_settled(what: str, kinetic: float, elastic: float) -> list[str]:
    """A remark where a run still moves at its end: by its kinetic energy [J] over what is elastic in it [J]."""
    share = unrest(kinetic, elastic)
    if share <= SETTLED:
        return []
    return [f"{what}: NOT SETTLED, its kinetic energy is {share:.2g} of the elastic (at most {SETTLED:g})"]


def unrest(kinetic: float, elastic: float) -> float:
    """Kinetic over elastic energy, zero where nothing moves and infinite where nothing but motion is there."""
    return kinetic / elastic if elastic else float("inf") if kinetic else 0.0
