"""Time series for ParaView: ``results.pvd``, and the files of each frame.

A frame has one file for each of organ, thread, piercings and ties. The files are VTK XML with
appended arrays as plain bytes, a quarter smaller than as text, in float32 and int32. VTK 8.2 and
ParaView 5.11 or newer read them. Organ and thread are compressed by LZMA. The few numbers of
piercings and ties are compressed by zlib, which is faster for small arrays. The files are not
written by VTK, so the organ's mesh is encoded once, and a run needs no graphics package.
Neighbouring rows of the mesh and of the thread are similar. A standard filter of the format stores
their differences: a structured mesh then takes a fiftieth of its bytes, and the thread less than
half. The organ's points are in the reference shape, with the array ``displacement`` (Warp By
Vector); thread and piercings are in the deformed shape.

``studies.output.columns`` defines the arrays.
"""

import hashlib
import lzma
import re
import sys
import zlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from html import escape  # the same function of xml.sax would load a HTTP library
from itertools import accumulate
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
from numpy.typing import ArrayLike, NDArray

from studies.output import columns
from studies.output.columns import Column, values
from studies.output.fields import OrganTopology, ThreadRecord
from studies.output.files import UNFINISHED, write_bytes, write_text
from studies.output.records import Record, Snapshot

CELL_TYPES = {4: 10, 10: 24}  # VTK_TETRA, VTK_QUADRATIC_TETRA by nodes per cell
TYPE_NAMES = {"f4": "Float32", "i4": "Int32", "i8": "Int64", "u1": "UInt8"}
COMPONENTS = {6: ("XX", "YY", "ZZ", "XY", "YZ", "XZ")}  # VTK's order of a symmetric tensor
FRAME = re.compile(r"(?:organ|thread|piercings|ties)_(\d{6,})\.vt[pu]")
PARTS = ("organ", "thread", "piercings", "ties")  # parts of a frame, one file each
SEAL, SEALED = re.compile(rb"<!-- sha256 [0-9a-f]{64} -->\n"), 81  # the last comment of a file, and its bytes
LZMA = "vtkLZMADataCompressor"
WORDS = {"id": lzma.FILTER_LZMA2, "lc": 0, "lp": 2, "pb": 2}  # for numbers of four bytes
SMALLEST = {"preset": 6, "dict_size": 2**20, **WORDS}  # for the mesh, which is encoded once
QUICK = {"preset": 1, "dict_size": 2**20, **WORDS}  # to choose the packing by a sample of this number of rows
SAMPLE = 10_000
FASTEST = {"preset": 0, "dict_size": 4096, "depth": 1, "nice_len": 4, **WORDS}  # for fields, which hardly repeat
# Bits below the error of the elements are noise: they cannot be compressed, and would be half of a
# frame's bytes. Quantities derived from the displacement keep 10 of 23 mantissa bits (4.9e-4), and
# nothing below 1.2e-4 of the largest in their array. Directions are unit vectors: an error of 0.2°
# is invisible. Of J the difference from 1 is kept, because neighbouring cells differ by half of it.
# Places are kept to a millionth of the extent.
DERIVED = frozenset({"stress", "von_mises", "principal_stress", "strain", "rotation", "energy_density"})
BITS_LEFT_OUT = 13
REFERENCES = {"volume_ratio": 1.0, "nodal_volume_ratio": 1.0}  # a field's difference from this is rounded; else zero
BITS_OF_LARGEST = dict.fromkeys([*DERIVED, "tension", "curvature"], 13) | dict.fromkeys(REFERENCES, 12)  # bits kept
BITS_OF_LARGEST |= dict.fromkeys(("first_direction", "third_direction", "first_stretch", "third_stretch"), 8)
BITS_OF_LARGEST |= dict.fromkeys(("displacement", "s"), 20)
BITS_OF_EXTENT = 20  # number of bits kept for the places of a thread


Pack = Callable[[NDArray[Any]], bytes]
PLACE = "\0"  # stands for the offset of an array until the sizes of all arrays before it are known


@dataclass(frozen=True)
class Markup:
    """XML, with one `PLACE` in its text for each array that follows in the file."""

    text: str
    arrays: tuple[bytes, ...] = ()

    def __add__(self, other: "Markup") -> "Markup":
        return Markup(self.text + other.text, self.arrays + other.arrays)

    def within(self, tag: str) -> "Markup":
        """Return this markup as the content of an element.

        `tag` is the element's name with its attributes.
        """
        return Markup(f"<{tag}>\n{self.text}</{tag.partition(' ')[0]}>\n", self.arrays)

    @property
    def placed(self) -> str:
        """The text with the offsets of the arrays, in bytes from the start of the arrays."""
        texts, sizes = self.text.split(PLACE), map(len, self.arrays)
        following = zip(accumulate(sizes, initial=0), texts[1:], strict=False)
        return texts[0] + "".join(f"{at}{text}" for at, text in following)


def as_it_is(array: NDArray[Any]) -> bytes:
    """Return a field of the organ, compressed."""
    return _lzma([FASTEST], array)


def as_differences(array: NDArray[Any]) -> bytes:
    """Return arrays along the thread, compressed as differences between rows."""
    return _lzma([_between_rows(array), FASTEST], array)


def by_zlib(array: NDArray[Any]) -> bytes:
    """Return arrays of a few points, compressed."""
    return zlib.compress(array.tobytes(), 1)


def _lzma(filters: Sequence[dict[str, int]], array: NDArray[Any]) -> bytes:
    return lzma.compress(array.tobytes(), lzma.FORMAT_XZ, lzma.CHECK_CRC32, filters=filters)


def _between_rows(array: NDArray[Any]) -> dict[str, int]:
    """Return the filter that subtracts from each row the row before it."""
    return {"id": lzma.FILTER_DELTA, "dist": array.strides[0]}


class Series:
    """Writes frames and updates ``results.pvd``, which names the complete frames."""

    def __init__(self, folder: Path, topology: OrganTopology | None = None, before: int = 0) -> None:
        """``before``: frames of steps before this one are kept, for a resumed run."""
        self._folder = folder
        self._mesh = None if topology is None else encode_mesh(topology)
        (folder / "frames").mkdir(parents=True, exist_ok=True)
        listed = named_files(folder / "results.pvd") if before else []
        named = [(time, file) for time, file in listed if 0 <= step_of(file) < before]
        self._entries = [_entry(time, file) for time, file in named if (folder / file).is_file()]
        self.missing = [file for _, file in named if not (folder / file).is_file()]
        for path in frame_files(folder / "frames"):
            if path.name.startswith(".") or step_of(path.name) >= before:
                path.unlink()

    def write(self, step: int, frame: Snapshot) -> None:
        """Write the files of a frame, then the index that names them."""
        parts = {f"thread_{step:06d}.vtp": thread_file(frame.thread)}
        if frame.piercings:
            parts[f"piercings_{step:06d}.vtp"] = _vertices(frame.piercings, columns.PIERCING_ARRAYS, 'Vectors="force"')
        closed = [tie for tie in frame.ties if tie.state != "open"]
        if closed:
            parts[f"ties_{step:06d}.vtp"] = _vertices(closed, columns.TIE_ARRAYS, 'Scalars="force"')
        if frame.organ is not None and self._mesh is not None:
            parts = {f"organ_{step:06d}.vtu": organ_file(self._mesh, frame.organ)} | parts
        for name, data in parts.items():
            write_bytes(self._folder / "frames" / name, data)
            self._entries.append(_entry(repr(float(frame.time)), f"frames/{name}"))
        listed = Markup("".join(self._entries)).within("Collection").text  # parts of one time are shown together
        write_text(self._folder / "results.pvd", f"{_head('Collection', '0.1')}{listed}</VTKFile>\n")


def named_files(index: Path) -> list[tuple[str, str]]:
    """Return the files that a ``.pvd`` file names, each after the text of its time [s].

    Raises `OSError` or `ValueError` for a damaged file.
    """
    try:
        parts = ElementTree.fromstring(index.read_text(encoding="utf-8")).iter("DataSet")
    except ElementTree.ParseError as error:
        raise ValueError(str(error)) from None
    return [(part.get("timestep", "nan"), part.get("file", "")) for part in parts]


def frame_files(folder: Path) -> list[Path]:
    """List the files of frames in a folder, and no other files.

    The temporary files of a killed run are included.
    """
    paths = folder.iterdir() if folder.is_dir() else ()
    return [path for path in paths if FRAME.fullmatch(UNFINISHED.sub(r"\1", path.name))]


def step_of(name: str) -> int:
    """Return the step in the name of a frame's file, or −1."""
    found = FRAME.search(name)
    return int(found[1]) if found else -1


def part_of(file: str) -> str:
    """Return the part of a frame that is in a file."""
    return Path(file).name.partition("_")[0]


def encode_mesh(topology: OrganTopology) -> Markup:
    """Return the organ's mesh, the same in every frame, as markup."""
    points, cells = topology.points, topology.cells
    offsets = cells.shape[1] * np.arange(1, len(cells) + 1)
    kinds = np.full(len(cells), CELL_TYPES[cells.shape[1]])
    whole = "i4" if cells.size <= np.iinfo(np.int32).max else "i8"
    named = {"connectivity": (cells, whole), "offsets": (offsets, whole), "types": (kinds, "u1")}
    places = _array("points", _small(points, "f4"), "f4", 3).within("Points")
    return places + _joined(_array(name, _small(*given), given[1]) for name, given in named.items()).within("Cells")


def organ_file(mesh: Markup, organ: Record) -> bytes:
    """Return the organ of one frame as a ``.vtu`` file."""
    data = _arrays("PointData", values(columns.ORGAN_ARRAYS, organ), 'Vectors="displacement"', as_it_is)
    data += _arrays("CellData", values(columns.ORGAN_CELLS, organ), 'Scalars="strain"', as_it_is)
    piece = f'Piece NumberOfPoints="{len(organ.displacement)}" NumberOfCells="{len(organ.strain)}"'
    return _file("UnstructuredGrid", (mesh + data).within(piece))


def thread_file(thread: ThreadRecord) -> bytes:
    """Return the thread of one frame as a polyline in a ``.vtp`` file.

    The array ``radius`` is for the Tube filter.
    """
    count = len(thread.points)
    data = _arrays("PointData", values(columns.THREAD_ARRAYS, thread), 'Scalars="tension"', as_differences)
    return _poly_data(thread.points, "Lines", thread.pieces or ([count] if count else []), data, as_differences)


def _vertices(items: Sequence[Any], chosen: Sequence[Column[Any]], active: str) -> bytes:
    """Write piercings or ties of one frame, which have a place each, as vertices in ``.vtp``."""
    arrays = {column.name: np.array([column.of(item) for item in items]) for column in chosen}
    points = np.array([item.x for item in items])
    return _poly_data(points, "Verts", [1] * len(items), _arrays("PointData", arrays, active, by_zlib), by_zlib)


def _data_array(name: str, values: ArrayLike, kind: str, pack: Pack, unit: str = "") -> Markup:
    """Return a field as a compressed ``DataArray`` with its unit.

    Its shape is `(n,)` or `(n, components)`.
    """
    array = np.ascontiguousarray(values, dtype=np.dtype(kind))
    return _array(name, _encoded(array, pack), kind, array.shape[1] if array.ndim == 2 else 1, unit)


def _array(name: str, encoded: bytes, kind: str, components: int = 1, unit: str = "") -> Markup:
    labels = "".join(f' ComponentName{index}="{label}"' for index, label in enumerate(COMPONENTS.get(components, ())))
    tag = f'DataArray type="{TYPE_NAMES[kind]}" Name="{escape(name)}" format="appended" offset="{PLACE}"'
    key = f'<InformationKey name="UNITS_LABEL" location="vtkDataArray">{escape(unit)}</InformationKey>\n'
    return Markup(key if unit else "", (encoded,)).within(f'{tag} NumberOfComponents="{components}"{labels}')


def _joined(parts: Iterable[Markup]) -> Markup:
    return sum(parts, start=Markup(""))


def _small(values: NDArray[Any], kind: str) -> bytes:
    """Encode an array of the mesh directly or as row differences.

    The choice is the one that compresses its first rows better.
    """
    array = np.ascontiguousarray(values, dtype=np.dtype(kind))
    step, sample = _between_rows(array), array[:SAMPLE]
    filters = min(([], [step]), key=lambda filters: len(_lzma([*filters, QUICK], sample)))
    return _encoded(array, partial(_lzma, [*filters, SMALLEST]))


def _encoded(array: NDArray[Any], pack: Pack) -> bytes:
    """Encode one compressed block after its header.

    The header has the number of blocks, the block size, the size of a partial last block, and the
    compressed size.
    """
    if not array.size:
        return np.zeros(3, dtype=np.uint32).tobytes()
    packed = pack(array)
    return np.array([1, array.nbytes, 0, len(packed)], dtype=np.uint32).tobytes() + packed


def _rounded(name: str, values: NDArray[Any]) -> NDArray[Any]:
    """Return numbers rounded to the kept bits of a field."""
    if name not in BITS_OF_LARGEST:
        return values
    way = values - REFERENCES.get(name, 0.0)
    kept = _without_last_bits(way) if name in DERIVED else way
    return REFERENCES.get(name, 0.0) + _on_grid(kept, float(np.abs(way).max(initial=0.0)), BITS_OF_LARGEST[name])


def _on_grid(values: NDArray[Any], size: float, bits: int) -> NDArray[Any]:
    """Return numbers rounded to this number of bits of a size.

    They are unchanged if the size is zero or not finite.
    """
    least = 2.0 ** (np.frexp(size)[1] - bits) if 0.0 < size < np.inf else 0.0
    return np.asarray(np.rint(values / least) * least if least else values)


def _without_last_bits(values: NDArray[Any]) -> NDArray[Any]:
    """Return numbers rounded to the mantissa bits that a derived field keeps."""
    bits = np.asarray(values, np.float32).view(np.uint32)
    half, mask = np.uint32(1 << (BITS_LEFT_OUT - 1)), np.uint32(~((1 << BITS_LEFT_OUT) - 1) & 0xFFFFFFFF)
    return ((bits + half) & mask).view(np.float32)


def _poly_data(points: NDArray[np.float64], kind: str, counts: Sequence[int], data: Markup, pack: Pack) -> bytes:
    """Return a file of points joined in order into cells of ``counts`` points.

    The data of the points have the same compression.
    """
    cells = _data_array("connectivity", np.arange(sum(counts)), "i4", pack)
    cells += _data_array("offsets", np.cumsum(counts, dtype=np.int64), "i4", pack)
    extent = float(np.ptp(points, axis=0).max(initial=0.0)) if len(points) else 0.0
    places = _data_array("points", _on_grid(points, extent, BITS_OF_EXTENT), "f4", pack).within("Points")
    piece = f'Piece NumberOfPoints="{len(points)}" NumberOf{kind}="{len(counts)}"'
    compressor = "vtkZLibDataCompressor" if pack is by_zlib else LZMA
    return _file("PolyData", (places + cells.within(kind) + data).within(piece), compressor)


def _arrays(kind: str, arrays: Mapping[str, Any], active: str, pack: Pack) -> Markup:
    """Return fields by name as markup, whole numbers as integers.

    A field that is None is left out.
    """
    given = {name: _rounded(name, np.asarray(values)) for name, values in arrays.items() if values is not None}
    fields = (
        _data_array(name, values, "i4" if values.dtype.kind == "i" else "f4", pack, columns.UNITS[name])
        for name, values in given.items()
    )
    return _joined(fields).within(f"{kind} {active}")


def _entry(time: str, file: str) -> str:
    label = part_of(file)
    part = PARTS.index(label)
    return f'<DataSet timestep="{time}" group="" part="{part}" name="{label}" file="{file}"/>\n'


def _file(kind: str, piece: Markup, compressor: str = LZMA) -> bytes:
    """Return a file of one data set: its XML, then its arrays.

    A reader finds the arrays by their offsets.
    """
    packed = f' header_type="UInt32" compressor="{compressor}"'
    text = _head(kind, "1.0", packed) + piece.within(kind).placed + '<AppendedData encoding="raw">\n_'
    return sealed(text.encode() + b"".join(piece.arrays) + b"\n</AppendedData>\n</VTKFile>\n")


def sealed(body: bytes) -> bytes:
    """Return a file with a comment at its end: the checksum of everything before the comment."""
    return body + b"<!-- sha256 %s -->\n" % hashlib.sha256(body).hexdigest().encode()


def is_whole(data: bytes) -> bool:
    """Return whether a frame's file is complete and unchanged, by its checksum.

    VTK does not notice every damaged file. A file of an earlier version has no checksum: its last
    tag is checked.
    """
    found = SEAL.search(data[-SEALED:])
    return sealed(data[:-SEALED]) == data if found else data.endswith(b"</VTKFile>\n")


def _head(kind: str, version: str, packed: str = "") -> str:
    order = "LittleEndian" if sys.byteorder == "little" else "BigEndian"
    return f'<?xml version="1.0"?>\n<VTKFile type="{kind}" version="{version}" byte_order="{order}"{packed}>\n'
