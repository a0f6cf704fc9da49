"""Time series for ParaView: ``results.pvd`` naming one file per frame of organ, thread, piercings and ties.

VTK XML with its arrays behind it as plain bytes, a quarter fewer than as text, in float32 and int32: a form that VTK
reads since 8.2, and so ParaView 5.11. Organ and thread are compressed by LZMA, the few numbers of piercings and ties by
zlib, done before LZMA has begun. It is written here rather than by VTK because the organ's mesh can then be encoded
once, and no graphics package is needed to run. Rows of the mesh and of the thread are like those before them: packed as
differences, by a filter of the format that every reader knows, a structured mesh takes a fiftieth of its bytes, and the
thread less than half. Points of the organ are those of the reference shape, with ``displacement`` beside them (Warp By
Vector); thread and piercings are where they are.

Which arrays there are is said in ``studies.output.columns``.
"""

import hashlib
import lzma
import re
import sys
import zlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from html import escape  # that of xml.sax loads what speaks HTTP
from itertools import accumulate
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
from numpy.typing import ArrayLike, NDArray

from studies.output.columns import (
    ORGAN_ARRAYS,
    ORGAN_CELLS,
    PIERCING_ARRAYS,
    THREAD_ARRAYS,
    TIE_ARRAYS,
    UNITS,
    Column,
    values,
)
from studies.output.fields import OrganRecord, OrganTopology, ThreadRecord
from studies.output.files import UNFINISHED, write_bytes, write_text
from studies.output.records import PiercingRecord, Snapshot, TieRecord

CELL_TYPES = {4: 10, 10: 24}  # VTK_TETRA, VTK_QUADRATIC_TETRA by nodes per cell
TYPE_NAMES = {"f4": "Float32", "i4": "Int32", "i8": "Int64", "u1": "UInt8"}
COMPONENTS = {6: ("XX", "YY", "ZZ", "XY", "YZ", "XZ")}  # VTK's order of a symmetric tensor
FRAME = re.compile(r"(?:organ|thread|piercings|ties)_(\d{6,})\.vt[pu]")
PARTS = ("organ", "thread", "piercings", "ties")  # of a frame, each a file
FILE = re.compile(r'file="([^"]*)"')
SEAL, SEALED = re.compile(rb"<!-- sha256 [0-9a-f]{64} -->\n"), 81  # what stands behind the end of a file, and its bytes
LZMA = "vtkLZMADataCompressor"
WORDS = {"id": lzma.FILTER_LZMA2, "lc": 0, "lp": 2, "pb": 2}  # numbers of four bytes
SMALLEST = {"preset": 6, "dict_size": 2**20, **WORDS}  # of the mesh, which is encoded once
QUICK = {"preset": 1, "dict_size": 2**20, **WORDS}  # tells how it is packed, on a sample of so many rows:
SAMPLE = 10_000
FASTEST = {"preset": 0, "dict_size": 4096, "depth": 1, "nice_len": 4, **WORDS}  # of fields, which hardly repeat
# What the elements are wrong in by far more is noise that does not shrink, and half of a frame's bytes. What is derived
# from the displacement keeps 10 of the 23 bits behind the point, 4.9e-4, and none below 1.2e-4 of the largest in its
# array; directions are of unit vectors, and a glyph shows no 0.2°; of J that is kept by which it is not 1, and that of
# neighbouring cells differs by half of it. Places keep a millionth of what is drawn.
DERIVED = frozenset({"stress", "von_mises", "principal_stress", "strain", "rotation", "energy_density"})
BITS_LEFT_OUT = 13
REFERENCES = {"volume_ratio": 1.0, "nodal_volume_ratio": 1.0}  # what is rounded is the way from there; zero for others
BITS_OF_LARGEST = dict.fromkeys([*DERIVED, "tension", "curvature"], 13) | dict.fromkeys(REFERENCES, 12)  # that are kept
BITS_OF_LARGEST |= dict.fromkeys(("first_direction", "third_direction", "first_stretch", "third_stretch"), 8)
BITS_OF_LARGEST |= dict.fromkeys(("displacement", "s"), 20)
BITS_OF_EXTENT = 20  # that are kept of the places of a thread


Pack = Callable[[NDArray[Any]], bytes]
PLACE = "\0"  # stands for the place of an array until all before it are known


@dataclass(frozen=True)
class Markup:
    """XML, with one `PLACE` in its text for each of the arrays that stand behind it in the file."""

    text: str
    arrays: tuple[bytes, ...] = ()

    def __add__(self, other: "Markup") -> "Markup":
        return Markup(self.text + other.text, self.arrays + other.arrays)

    def within(self, tag: str) -> "Markup":
        """Return this as the content of an element; `tag` is its name with its attributes."""
        return Markup(f"<{tag}>\n{self.text}</{tag.partition(' ')[0]}>\n", self.arrays)

    @property
    def placed(self) -> str:
        """The text with the places, in bytes from where the arrays begin."""
        texts, sizes = self.text.split(PLACE), map(len, self.arrays)
        return texts[0] + "".join(
            f"{at}{text}" for at, text in zip(accumulate(sizes, initial=0), texts[1:], strict=False)
        )


def as_it_is(array: NDArray[Any]) -> bytes:
    """Return a field of the organ, packed."""
    return _lzma([FASTEST], array)


def as_differences(array: NDArray[Any]) -> bytes:
    """Return arrays along the thread, packed as differences between rows."""
    return _lzma([_between_rows(array), FASTEST], array)


def by_zlib(array: NDArray[Any]) -> bytes:
    """Return arrays of a few points, packed."""
    return zlib.compress(array.tobytes(), 1)


def _lzma(filters: Sequence[dict[str, int]], array: NDArray[Any]) -> bytes:
    return lzma.compress(array.tobytes(), lzma.FORMAT_XZ, lzma.CHECK_CRC32, filters=filters)


def _between_rows(array: NDArray[Any]) -> dict[str, int]:
    """Return the filter that takes from each row the one before it."""
    return {"id": lzma.FILTER_DELTA, "dist": array.strides[0]}


class Series:
    """Writes frames and keeps ``results.pvd`` naming those that are complete."""

    def __init__(self, folder: Path, topology: OrganTopology | None = None, before: int = 0) -> None:
        """``before``: frames of earlier steps than this one are kept, as a run that is resumed wants it."""
        self._folder = folder
        self._mesh = None if topology is None else encode_mesh(topology)
        (folder / "frames").mkdir(parents=True, exist_ok=True)
        named = entries(folder / "results.pvd", before) if before else []
        self._entries = [line for line in named if (folder / file_of(line)).is_file()]
        self.missing = [file_of(line) for line in named if line not in self._entries]
        for path in frame_files(folder / "frames"):
            if path.name.startswith(".") or step_of(path.name) >= before:
                path.unlink()

    def write(self, step: int, frame: Snapshot) -> None:
        """Write the files of a frame, then the index that names them."""
        parts = {f"thread_{step:06d}.vtp": thread_file(frame.thread)}
        if frame.piercings:
            parts[f"piercings_{step:06d}.vtp"] = piercings_file(frame.piercings)
        closed = [tie for tie in frame.ties if tie.state != "open"]
        if closed:
            parts[f"ties_{step:06d}.vtp"] = ties_file(closed)
        if frame.organ is not None and self._mesh is not None:
            parts = {f"organ_{step:06d}.vtu": organ_file(self._mesh, frame.organ)} | parts
        for name, data in parts.items():
            write_bytes(self._folder / "frames" / name, data)
            self._entries.append(_entry(frame.time, name))
        write_text(self._folder / "results.pvd", index_text(self._entries))


def entries(index: Path, before: int) -> list[str]:
    """Return the lines of a ``.pvd`` file that name frames of earlier steps than ``before``."""
    lines = [line for line in index.read_text(encoding="utf-8").splitlines(keepends=True) if "<DataSet" in line]
    return [line for line in lines if step_of(line) < before]


def file_of(line: str) -> str:
    """Return the file that a line of a ``.pvd`` file names."""
    found = FILE.search(line)
    return found[1] if found else ""


def steps_in(index: Path) -> set[int]:
    """Return the steps whose frames a ``.pvd`` file names. Raises `OSError` or `ValueError` for one that is torn."""
    try:
        parts = ElementTree.fromstring(index.read_text(encoding="utf-8")).iter("DataSet")
    except ElementTree.ParseError as error:
        raise ValueError(str(error)) from None
    return {step_of(part.get("file", "")) for part in parts}


def frame_files(folder: Path) -> list[Path]:
    """List the files of frames in a folder, and those that a killed run was about to rename to one; no other's."""
    paths = folder.iterdir() if folder.is_dir() else ()
    return [path for path in paths if FRAME.fullmatch(UNFINISHED.sub(r"\1", path.name))]


def step_of(name: str) -> int:
    """Return the step in the name of a frame's file."""
    found = FRAME.search(name)
    return int(found[1]) if found else -1


def index_text(entries: Sequence[str]) -> str:
    """Write the ``.pvd`` file; the parts of one time are shown together."""
    return _head("Collection", "0.1") + Markup("".join(entries)).within("Collection").text + "</VTKFile>\n"


def encode_mesh(topology: OrganTopology) -> Markup:
    """Write the organ's mesh, the same in every frame."""
    points, cells = topology.points, topology.cells
    offsets = cells.shape[1] * np.arange(1, len(cells) + 1)
    kinds = np.full(len(cells), CELL_TYPES[cells.shape[1]])
    whole = "i4" if cells.size <= np.iinfo(np.int32).max else "i8"
    named = {"connectivity": (cells, whole), "offsets": (offsets, whole), "types": (kinds, "u1")}
    places = _array("points", _small(points, "f4"), "f4", 3).within("Points")
    return places + _joined(_array(name, _small(*given), given[1]) for name, given in named.items()).within("Cells")


def organ_file(mesh: Markup, organ: OrganRecord) -> bytes:
    """Write the organ of one frame as ``.vtu``."""
    data = _arrays("PointData", values(ORGAN_ARRAYS, organ), 'Vectors="displacement"', as_it_is)
    data += _arrays("CellData", values(ORGAN_CELLS, organ), 'Scalars="strain"', as_it_is)
    piece = f'Piece NumberOfPoints="{len(organ.displacement)}" NumberOfCells="{len(organ.strain)}"'
    return _file("UnstructuredGrid", (mesh + data).within(piece))


def thread_file(thread: ThreadRecord) -> bytes:
    """Write the thread of one frame as a polyline in ``.vtp``; ``radius`` is for the Tube filter."""
    count = len(thread.points)
    data = _arrays("PointData", values(THREAD_ARRAYS, thread), 'Scalars="tension"', as_differences)
    return _poly_data(thread.points, "Lines", thread.pieces or ([count] if count else []), data, as_differences)


def piercings_file(piercings: Sequence[PiercingRecord]) -> bytes:
    """Write the piercings of one frame as vertices in ``.vtp``."""
    return _vertices(piercings, PIERCING_ARRAYS, 'Vectors="force"')


def ties_file(ties: Sequence[TieRecord]) -> bytes:
    """Write the ties of one frame as vertices in ``.vtp``."""
    return _vertices(ties, TIE_ARRAYS, 'Scalars="force"')


def _vertices(items: Sequence[Any], columns: Sequence[Column[Any]], active: str) -> bytes:
    """Write what has a place each as vertices."""
    arrays = {column.name: np.array([column.of(item) for item in items]) for column in columns}
    points = np.array([item.x for item in items])
    return _poly_data(points, "Verts", [1] * len(items), _arrays("PointData", arrays, active, by_zlib), by_zlib)


def _data_array(name: str, values: ArrayLike, kind: str, pack: Pack, unit: str = "") -> Markup:
    """Write a field, shape `(n,)` or `(n, components)`, as a compressed ``DataArray`` with its unit."""
    array = np.ascontiguousarray(values, dtype=np.dtype(kind))
    return _array(name, _encoded(array, pack), kind, array.shape[1] if array.ndim == 2 else 1, unit)


def _array(name: str, encoded: bytes, kind: str, components: int = 1, unit: str = "") -> Markup:
    labels = "".join(f' ComponentName{index}="{label}"' for index, label in enumerate(COMPONENTS.get(components, ())))
    tag = f'DataArray type="{TYPE_NAMES[kind]}" Name="{escape(name)}" format="appended" offset="{PLACE}"'
    return Markup(_unit_key(unit), (encoded,)).within(f'{tag} NumberOfComponents="{components}"{labels}')


def _joined(parts: Iterable[Markup]) -> Markup:
    return sum(parts, start=Markup(""))


def _unit_key(unit: str) -> str:
    """Write a unit as VTK keeps it; nothing if there is none."""
    key = f'<InformationKey name="UNITS_LABEL" location="vtkDataArray">{escape(unit)}</InformationKey>\n'
    return key if unit else ""


def _small(values: NDArray[Any], kind: str) -> bytes:
    """Encode an array of the mesh as it is or as differences between its rows, by which its first rows are smaller."""
    array = np.ascontiguousarray(values, dtype=np.dtype(kind))
    step, sample = _between_rows(array), array[:SAMPLE]
    filters = min(([], [step]), key=lambda filters: len(_lzma([*filters, QUICK], sample)))
    return _encoded(array, partial(_lzma, [*filters, SMALLEST]))


def _encoded(array: NDArray[Any], pack: Pack) -> bytes:
    """Encode one compressed block after its header: blocks, their size, that of a partial last one, packed size."""
    if not array.size:
        return np.zeros(3, dtype=np.uint32).tobytes()
    packed = pack(array)
    return np.array([1, array.nbytes, 0, len(packed)], dtype=np.uint32).tobytes() + packed


def _rounded(name: str, values: NDArray[Any]) -> NDArray[Any]:
    """Return numbers rounded to what is kept of a field."""
    if name not in BITS_OF_LARGEST:
        return values
    way = values - REFERENCES.get(name, 0.0)
    kept = _without_last_bits(way) if name in DERIVED else way
    return REFERENCES.get(name, 0.0) + _on_grid(kept, float(np.abs(way).max(initial=0.0)), BITS_OF_LARGEST[name])


def _on_grid(values: NDArray[Any], size: float, bits: int) -> NDArray[Any]:
    """Return numbers rounded to so many bits of a size; as they are where that is nothing, or not finite."""
    least = 2.0 ** (np.frexp(size)[1] - bits) if 0.0 < size < np.inf else 0.0
    return np.asarray(np.rint(values / least) * least if least else values)


def _without_last_bits(values: NDArray[Any]) -> NDArray[Any]:
    """Return numbers rounded to the bits behind the point that are kept of a derived field."""
    bits = np.asarray(values, np.float32).view(np.uint32)
    half, mask = np.uint32(1 << (BITS_LEFT_OUT - 1)), np.uint32(~((1 << BITS_LEFT_OUT) - 1) & 0xFFFFFFFF)
    return ((bits + half) & mask).view(np.float32)


def _poly_data(points: NDArray[np.float64], kind: str, counts: Sequence[int], data: Markup, pack: Pack) -> bytes:
    """Write points joined in order into cells of ``counts`` points, with their data, which is packed alike."""
    cells = _data_array("connectivity", np.arange(sum(counts)), "i4", pack)
    cells += _data_array("offsets", np.cumsum(counts, dtype=np.int64), "i4", pack)
    extent = float(np.ptp(points, axis=0).max(initial=0.0)) if len(points) else 0.0
    places = _data_array("points", _on_grid(points, extent, BITS_OF_EXTENT), "f4", pack).within("Points")
    piece = f'Piece NumberOfPoints="{len(points)}" NumberOf{kind}="{len(counts)}"'
    compressor = "vtkZLibDataCompressor" if pack is by_zlib else LZMA
    return _file("PolyData", (places + cells.within(kind) + data).within(piece), compressor)


def _arrays(kind: str, arrays: Mapping[str, Any], active: str, pack: Pack) -> Markup:
    """Write fields by name, whole numbers as integers; those that are None are left out."""
    given = {name: _rounded(name, np.asarray(values)) for name, values in arrays.items() if values is not None}
    fields = (
        _data_array(name, values, "i4" if values.dtype.kind == "i" else "f4", pack, UNITS[name])
        for name, values in given.items()
    )
    return _joined(fields).within(f"{kind} {active}")


def _entry(time: float, name: str) -> str:
    label = name.partition("_")[0]
    part = PARTS.index(label)
    return f'<DataSet timestep="{float(time)!r}" group="" part="{part}" name="{label}" file="frames/{name}"/>\n'


def _file(kind: str, piece: Markup, compressor: str = LZMA) -> bytes:
    """Write a file of one data set: its XML, then its arrays, which a reader finds by their places."""
    packed = f' header_type="UInt32" compressor="{compressor}"'
    text = _head(kind, "1.0", packed) + piece.within(kind).placed + '<AppendedData encoding="raw">\n_'
    return sealed(text.encode() + b"".join(piece.arrays) + b"\n</AppendedData>\n</VTKFile>\n")


def sealed(body: bytes) -> bytes:
    """Return a file with a comment behind its end: the checksum of all before it."""
    return body + b"<!-- sha256 %s -->\n" % hashlib.sha256(body).hexdigest().encode()


def is_whole(data: bytes) -> bool:
    """Return whether a frame's file is as it was written: VTK finds no end of some that are not. One of an earlier
    version has no checksum; it ends with its last tag."""
    found = SEAL.search(data[-SEALED:])
    return sealed(data[:-SEALED]) == data if found else data.endswith(b"</VTKFile>\n")


def _head(kind: str, version: str, packed: str = "") -> str:
    order = "LittleEndian" if sys.byteorder == "little" else "BigEndian"
    return f'<?xml version="1.0"?>\n<VTKFile type="{kind}" version="{version}" byte_order="{order}"{packed}>\n'
