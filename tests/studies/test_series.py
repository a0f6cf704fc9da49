"""The ParaView series, read back by VTK: the same fields at the same times."""

from dataclasses import replace
from pathlib import Path

import meshio
import numpy as np
import pytest
import pyvista as pv
from skfem import MeshTet

from studies.output.columns import ORGAN_ARRAYS, PIERCING_ARRAYS, STATE_CODES, THREAD_ARRAYS
from studies.output.fields import OrganTopology
from studies.output.reading import FrameFiles, ResultsError
from studies.output.records import Snapshot
from studies.output.series import SEALED, Markup, Series, encode_mesh, organ_file
from tests.studies.samples import LINEAR, frame, organ, quadratic

TIMES = (0.0, 0.1 + 0.2, 1 / 3)
SINGLE = float(np.finfo(np.float32).eps)  # all are float32
DERIVED = 2.0**-11  # of stress and strain 10 bits are kept behind the point, the last one rounded
PLACE = 2.0**-20  # of the largest displacement, half of what is kept, and of the extent of what is drawn
ALONG = 2.0**-13  # of the largest tension and curvature, half of what is kept


@pytest.fixture
def reader(tmp_path: Path) -> pv.PVDReader:
    series = Series(tmp_path, LINEAR)
    for number, time in enumerate(TIMES):
        series.write(number, frame(time))
    return pv.PVDReader(str(tmp_path / "results.pvd"))


def same(actual: object, expected: object, bound: float = SINGLE) -> None:
    scale = float(np.abs(np.asarray(expected)).max()) or 1.0
    np.testing.assert_allclose(np.asarray(actual), np.asarray(expected), rtol=0, atol=bound * scale)


def test_three_parts_share_every_time(reader: pv.PVDReader) -> None:
    assert tuple(reader.time_values) == TIMES  # to the last bit: the index is text
    for number, time in enumerate(TIMES):
        reader.set_active_time_point(number)
        active = reader.active_datasets
        assert [(data.time, data.part) for data in active] == [(time, 0), (time, 1), (time, 2)]
        assert [Path(data.path).name.split("_")[0] for data in active] == ["organ", "thread", "piercings"]


def test_fields_read_back(reader: pv.PVDReader) -> None:
    reader.set_active_time_value(TIMES[-1])
    solid, thread, holes = reader.read()
    written = frame(TIMES[-1])
    assert written.organ is not None
    same(solid.points, LINEAR.points)  # the reference shape
    same(solid["displacement"], written.organ.displacement, PLACE)
    same(solid["stress"], written.organ.stress, DERIVED)
    same(solid["von_mises"], written.organ.von_mises, DERIVED)
    for name in ("strain", "rotation"):
        same(solid.cell_data[name], getattr(written.organ, name), DERIVED)
    assert [solid.GetPointData().GetArray("stress").GetComponentName(k) for k in range(6)] == [
        *("XX", "YY", "ZZ", "XY", "YZ", "XZ")
    ]
    assert list(solid.celltypes) == [pv.CellType.TETRA] * 2
    assert np.abs(thread.points - written.thread.points).max() <= PLACE * np.ptp(written.thread.points, axis=0).max()
    for name, bound in {"s": PLACE, "tension": ALONG, "curvature": ALONG}.items():
        same(thread[name], getattr(written.thread, name), bound)
    same(thread["radius"], np.full(11, 1.6e-4))
    assert thread.n_lines == 1
    assert holes.n_verts == 2
    for name in ("force", "tangent", "u", "v", "slip"):
        same(holes[name], [getattr(hole, name) for hole in written.piercings])
    assert list(holes["state"]) == [STATE_CODES["slip"]] * 2
    assert holes["state"].dtype == np.int32


def test_volume_ratios_keep_what_nearly_incompressible_tissue_leaves_of_them(tmp_path: Path) -> None:
    """Independent check: J that is off 1 by 1e-5, as under a kilopascal, is read back with it."""
    written, series = frame(0.0), Series(tmp_path, LINEAR)
    assert written.organ is not None
    cell, node = (1.0 + 1e-5 * np.linspace(-1.0, 1.0, n) for n in (2, len(LINEAR.points)))
    series.write(0, replace(written, organ=replace(written.organ, volume_ratio=cell, nodal_volume_ratio=node)))
    solid = pv.PVDReader(str(tmp_path / "results.pvd")).read()[0]
    same(solid.cell_data["volume_ratio"], cell)
    same(solid["nodal_volume_ratio"], node)


def test_directions_are_read_back_to_a_fifth_of_a_degree(tmp_path: Path) -> None:
    """Independent check: the angle between the directions of principal stress that were written and those that VTK
    reads."""
    written, along = frame(0.0), np.random.default_rng(0).standard_normal((len(LINEAR.points), 3))
    assert written.organ is not None
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    Series(tmp_path, LINEAR).write(0, replace(written, organ=replace(written.organ, first_direction=along)))
    found = np.asarray(pv.PVDReader(str(tmp_path / "results.pvd")).read()[0]["first_direction"])
    assert np.degrees(np.linalg.norm(np.cross(found, along), axis=1)).max() < 0.2


def test_frames_have_the_arrays_of_their_columns(tmp_path: Path) -> None:
    """Independent check: VTK reads one array for each column that has a value, under its name, with as many components
    as the column has parts."""
    whole = frame(0.5)
    assert whole.organ is not None
    nodes = len(LINEAR.points)
    lips = replace(whole.organ, contact_pressure=np.ones(nodes), lip_gap=np.full(nodes, np.nan))
    Series(tmp_path, LINEAR).write(0, whole)
    twisted = replace(
        whole, organ=lips, thread=replace(whole.thread, torque=whole.thread.s, bearing=whole.thread.points)
    )
    Series(tmp_path / "all", LINEAR).write(0, twisted)
    optional = {"contact_pressure", "lip_gap", "torque", "bearing"}
    parts = {"organ": ORGAN_ARRAYS, "thread": THREAD_ARRAYS, "piercings": PIERCING_ARRAYS}
    for (part, columns), kind in zip(parts.items(), ("vtu", "vtp", "vtp"), strict=True):
        expected = {column.name: len(column.parts) or 1 for column in columns}
        for folder, missing in ((tmp_path, optional), (tmp_path / "all", set[str]())):
            data = pv.read(folder / "frames" / f"{part}_000000.{kind}").GetPointData()
            arrays = [data.GetArray(index) for index in range(data.GetNumberOfArrays())]
            found = {array.GetName(): array.GetNumberOfComponents() for array in arrays}
            assert found == {name: size for name, size in expected.items() if name not in missing}


def test_a_reader_that_is_not_vtk_finds_the_same(reader: pv.PVDReader, tmp_path: Path) -> None:
    """Independent check: meshio, by its own reading of the format, finds the mesh and the fields that VTK does."""
    solid = reader.read()[0]
    found = meshio.read(tmp_path / "frames" / "organ_000000.vtu")
    assert np.array_equal(found.points, solid.points)
    assert np.array_equal(found.cells_dict["tetra"], solid.cells_dict[pv.CellType.TETRA])
    assert set(found.point_data) == set(solid.point_data.keys())
    for name, values in found.point_data.items():
        assert np.array_equal(values.squeeze(), solid.point_data[name]), name
    for name, (values,) in found.cell_data.items():
        assert np.array_equal(values.squeeze(), solid.cell_data[name]), name


def test_frames_that_are_gone_are_left_out(tmp_path: Path) -> None:
    """Independent check: a series that goes on names the files that are there, in `missing` those that are not, and
    ParaView opens it."""
    series = Series(tmp_path, LINEAR)
    for number, time in enumerate(TIMES):
        series.write(number, frame(time))
    (tmp_path / "frames" / "thread_000001.vtp").unlink()
    again = Series(tmp_path, LINEAR, before=2)
    assert again.missing == ["frames/thread_000001.vtp"]
    again.write(2, frame(TIMES[2]))
    index = (tmp_path / "results.pvd").read_text(encoding="utf-8")
    assert "thread_000001" not in index and index.count("<DataSet") == 8
    assert Series(tmp_path, LINEAR, before=2).missing == []


def test_a_frame_that_is_not_as_it_was_written_is_refused(tmp_path: Path) -> None:
    """Independent check: any byte changed, an end cut off; a file of an earlier version has no checksum and is read."""
    Series(tmp_path, LINEAR).write(0, frame(0.0))
    path = next((tmp_path / "frames").glob("thread_*"))
    data, parts = path.read_bytes(), FrameFiles(0.0, 0, {"thread": path})
    flips = (data[:at] + bytes([data[at] ^ 4]) + data[at + 1 :] for at in range(0, len(data), 97))
    for torn in [*flips, data[:-1], data[:-90]]:
        path.write_bytes(torn)
        with pytest.raises(ResultsError, match=r"thread_000000\.vtp is damaged \(its checksum differs\); run the"):
            parts.read("thread")
    path.write_bytes(data[:-SEALED])
    assert parts.read("thread").n_points == len(frame(0.0).thread.points)


def test_the_mesh_takes_a_small_part_of_a_frame(tmp_path: Path) -> None:
    """Independent check: of a structured mesh VTK reads every cell back, and it takes a tenth of the frame at most."""
    mesh = MeshTet.init_tensor(*(np.linspace(0.0, 1.0, n) for n in (12, 11, 10)))
    topology = OrganTopology(mesh.p.T, mesh.t.T)
    Series(tmp_path, topology).write(0, frame(0.5, topology))
    path = tmp_path / "frames" / "organ_000000.vtu"
    assert np.array_equal(pv.read(path).cells_dict[pv.CellType.TETRA], topology.cells)
    noisy = replace(organ(topology, 1.0), strain=np.random.default_rng(0).random(len(topology.cells)))
    size = len(organ_file(Markup(""), noisy))
    assert len(organ_file(encode_mesh(topology), noisy)) - size <= 0.1 * size


def test_quadratic_tetrahedra(tmp_path: Path) -> None:
    topology = quadratic()
    Series(tmp_path, topology).write(0, frame(0.0, topology))
    solid = pv.read(tmp_path / "frames" / "organ_000000.vtu")
    assert list(solid.celltypes) == [pv.CellType.QUADRATIC_TETRA] * 2
    volumes = solid.compute_cell_sizes(length=False, area=False)["Volume"]
    linear = pv.UnstructuredGrid({pv.CellType.TETRA: LINEAR.cells}, LINEAR.points)
    same(volumes, linear.compute_cell_sizes(length=False, area=False)["Volume"])


def test_no_organ_and_no_piercings(tmp_path: Path) -> None:
    bare = frame(0.5, None)
    Series(tmp_path, None).write(5, Snapshot(bare.time, bare.thread, ()))
    assert [path.name for path in (tmp_path / "frames").iterdir()] == ["thread_000005.vtp"]
    (thread,) = pv.PVDReader(str(tmp_path / "results.pvd")).read()
    assert isinstance(thread, pv.PolyData)
    assert thread.n_points == 11


def test_a_field_larger_than_a_block_of_the_format(tmp_path: Path) -> None:
    """VTK's own writer cuts at 32 KiB; one block of any size must read back as well."""
    generator = np.random.default_rng(1)
    points = generator.random((20_000, 3))
    topology = OrganTopology(points, generator.integers(0, 20_000, (5_000, 4)))
    thread = frame(0.0, None).thread
    Series(tmp_path, topology).write(0, Snapshot(0.0, thread, (), organ(topology, 2.0)))
    solid = pv.read(tmp_path / "frames" / "organ_000000.vtu")
    same(solid["displacement"], 2.0 * points, PLACE)
    assert np.array_equal(solid.cells_dict[pv.CellType.TETRA], topology.cells)
