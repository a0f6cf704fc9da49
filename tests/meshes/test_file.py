"""Mesh files: every gmsh version reads to the same mesh, VTK too, units, names, and every fault in words."""

import operator
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import meshio
import numpy as np
import psutil
import pytest

from meshes import child, gmsh_session
from meshes.block import block, graded_block_gmsh
from meshes.checks import volumes
from meshes.errors import LONGEST, MeshError
from meshes.file import read
from meshes.gmsh_session import load_gmsh, session
from meshes.grading import Grading
from meshes.groups import named_groups
from meshes.units import metres_per_unit
from tests.meshes.samples import NEEDS_GMSH

# A small organ in gmsh's format 1: an octahedron about a centre, 2 × 2 × 4 units, its lower half group 1, its
# upper half group 2; two triangles at the bottom are group 7, one at the top is group 8. Node numbers have
# gaps, as such files do.
NODES = {
    10: (1, 0, 0),
    11: (0, 1, 0),
    12: (-1, 0, 0),
    13: (0, -1, 0),
    20: (0, 0, 2),
    21: (0, 0, -2),
    30: (0, 0, 0),
}
RING = [(10, 11), (11, 12), (12, 13), (13, 10)]
LOWER = [(4, 1, 1, (b, a, 30, 21)) for a, b in RING]
UPPER = [(4, 2, 2, (a, b, 30, 20)) for a, b in RING]
SKIN = [(2, 7, 3, (10, 11, 21)), (2, 7, 3, (11, 12, 21)), (2, 8, 4, (10, 11, 20))]
OCTAHEDRON = 8 * (1 * 1 * 2) / 6  # volume, cubic units


def old_format(nodes: dict[int, tuple[float, ...]], elements: list) -> str:
    lines = ["$NOD", str(len(nodes)), *(f"{n} {x} {y} {z}" for n, (x, y, z) in nodes.items()), "$ENDNOD"]
    lines += ["$ELM", str(len(elements))]
    for number, (kind, physical, entity, corners) in enumerate(elements, start=1):
        lines.append(f"{number} {kind} {physical} {entity} {len(corners)} {' '.join(map(str, corners))}")
    return "\n".join([*lines, "$ENDELM", ""])


@pytest.fixture
def old_file(tmp_path):
    def write(nodes=NODES, elements=None) -> Path:
        path = tmp_path / "organ.msh"
        path.write_text(old_format(nodes, LOWER + UPPER + SKIN if elements is None else elements))
        return path

    return write


@NEEDS_GMSH
def test_a_small_organ_in_the_old_format(old_file):
    mesh = read(old_file(), 0.05)
    assert mesh.p.shape == (3, 7) and mesh.t.shape == (4, 8)
    assert volumes(mesh.p.T, mesh.t.T).sum() == pytest.approx(OCTAHEDRON * 0.05**3, rel=1e-12)
    assert np.ptp(mesh.p, axis=1) == pytest.approx([0.1, 0.1, 0.2], rel=1e-12)


@NEEDS_GMSH
def test_numbered_groups_are_boundaries_and_subdomains(old_file):
    mesh = read(old_file())
    assert set(mesh.boundaries) == {"7", "8", "surface"}
    assert set(mesh.subdomains) == {"1", "2"}
    assert len(mesh.boundaries["7"]) == 2 and len(mesh.boundaries["8"]) == 1
    assert np.array_equal(np.sort(mesh.boundaries["surface"]), np.sort(mesh.boundary_facets()))
    assert np.all(mesh.p[2, mesh.t[:, mesh.subdomains["1"]]] <= 0)
    assert np.all(mesh.p[2, mesh.t[:, mesh.subdomains["2"]]] >= 0)
    corners = mesh.p[:, mesh.facets[:, mesh.boundaries["8"][0]]].T.tolist()
    assert sorted(corners) == [[0, 0, 2], [0, 1, 0], [1, 0, 0]]


def write_box(path: Path, version: float, binary: bool) -> Path:
    """A meshed box of 2 × 1 × 1 with a named volume, the face x = 0 named and two more under one name."""
    with session() as gmsh:
        gmsh.model.occ.addBox(0, 0, 0, 2, 1, 1)
        gmsh.model.occ.synchronize()
        gmsh.model.addPhysicalGroup(3, [1], 1, name="organ")
        gmsh.model.addPhysicalGroup(2, [1], 2, name="bed")
        gmsh.model.addPhysicalGroup(2, [2, 3], 3, name="rim")
        gmsh.option.setNumber("Mesh.MeshSizeMax", 0.7)
        gmsh.model.mesh.generate(3)
        gmsh.option.setNumber("Mesh.MshFileVersion", version)
        gmsh.option.setNumber("Mesh.Binary", binary)
        gmsh.write(str(path))
    return path


@NEEDS_GMSH
@pytest.mark.parametrize(
    ("version", "binary"), [(1.0, False), (2.2, False), (2.2, True), (4.0, False), (4.1, False), (4.1, True)]
)
def test_every_version_reads_to_the_same_mesh(tmp_path, version, binary):
    mesh = read(write_box(tmp_path / "box.msh", version, binary), 1e-3)
    latest = read(write_box(tmp_path / "latest.msh", 4.1, False), 1e-3)
    # Text files keep 16 digits.
    assert np.abs(mesh.p - latest.p).max() <= 1e-12 * 2e-3 and np.array_equal(mesh.t, latest.t)
    assert volumes(mesh.p.T, mesh.t.T).sum() == pytest.approx(2e-9, rel=1e-12)
    organ, bed, rim = ("1", "2", "3") if version == 1.0 else ("organ", "bed", "rim")
    assert set(mesh.subdomains) == {organ} and len(mesh.subdomains[organ]) == mesh.nelements
    assert set(mesh.boundaries) == {bed, rim, "surface"}
    assert np.array_equal(mesh.boundaries[bed], latest.boundaries["bed"])
    assert np.array_equal(mesh.boundaries[rim], latest.boundaries["rim"])
    assert np.abs(mesh.p[0, mesh.facets[:, mesh.boundaries[bed]]]).max() == 0


@NEEDS_GMSH
def test_a_block_written_and_read_is_the_same_block(tmp_path):
    made = graded_block_gmsh((0.06, 0.04, 0.02), Grading(8e-3, 4e-3), [[0, 0, 0]])
    path = tmp_path / "block.vtu"
    meshio.Mesh(made.p.T, {"tetra": made.t.T}).write(path)
    again = read(path)
    assert np.array_equal(again.p, made.p) and np.array_equal(again.t, made.t)


@pytest.mark.parametrize("name", ["block.vtu", "block.vtk"])
def test_vtk_files_scale_by_their_unit_and_have_a_surface(tmp_path, name):
    made = block((60.0, 40.0, 20.0), 10.0)
    triangle = made.facets[:, made.boundary_facets()].T
    meshio.Mesh(made.p.T, {"triangle": triangle, "tetra": made.t.T}).write(tmp_path / name)
    mesh = read(tmp_path / name, metres_per_unit("mm"))
    assert volumes(mesh.p.T, mesh.t.T).sum() == pytest.approx(0.06 * 0.04 * 0.02, rel=1e-12)
    assert set(mesh.boundaries) == {"surface"}
    assert np.array_equal(mesh.boundaries["surface"], mesh.boundary_facets())


def two_layers():
    """A block of 2 × 1 × 1, its more than 200 cells' regions 1 and 2 below and above the middle, and its bed."""
    made = block((2.0, 1.0, 1.0), 0.25)
    upper = made.p[2, made.t].mean(axis=0) > made.p[2].mean()
    bed = made.facets[:, made.facets_satisfying(lambda x: x[2] == x[2].min())].T
    return made, np.where(upper, 2, 1), bed


@pytest.mark.parametrize("name", ["a.vtu", "a.vtk"])
def test_cell_arrays_name_regions_and_boundaries(tmp_path, name):
    """Independent check: whole numbers above zero by their number, ones by the name of their array, on tetrahedra and
    triangles; quality, ids and zeros name nothing."""
    made, region, bed = two_layers()
    data = {
        "region": [region, np.full(len(bed), -1)],
        "upper": [(region == 2).astype(np.int32), np.zeros(len(bed), np.int32)],
        "boundary_bed": [np.zeros(len(region), np.int32), np.ones(len(bed), np.int32)],
        "ids": [np.arange(len(region)) + 5000, np.arange(len(bed))],
        "quality": [np.ones(len(region)), np.ones(len(bed))],
    }
    cells = [("tetra", made.t.T), ("triangle", bed)]
    meshio.Mesh(made.p.T, cells, cell_data=data).write(tmp_path / name)
    mesh = read(tmp_path / name)
    assert set(mesh.subdomains) == {"1", "2", "upper"}
    assert np.array_equal(mesh.subdomains["upper"], np.flatnonzero(region == 2))
    assert np.array_equal(mesh.subdomains["1"], np.flatnonzero(region == 1))
    assert set(mesh.boundaries) == {"bed", "surface"} and np.ptp(mesh.p[2, mesh.facets[:, mesh.boundaries["bed"]]]) == 0


def test_an_xdmf_file_with_its_numbers_in_it_is_read(tmp_path):
    """Independent check: points, tetrahedra and regions of a file written by hand."""
    pytest.importorskip("h5py")
    made, region, _ = two_layers()

    def item(values: np.ndarray) -> str:
        shape, kind = " ".join(map(str, values.shape)), "Float" if values.dtype.kind == "f" else "Int"
        text = " ".join(map(repr, values.ravel().tolist()))
        return f'<DataItem Dimensions="{shape}" NumberType="{kind}" Precision="8" Format="XML">{text}</DataItem>'

    (tmp_path / "a.xdmf").write_text(
        '<Xdmf Version="3.0"><Domain><Grid Name="Grid">'
        f'<Geometry GeometryType="XYZ">{item(made.p.T)}</Geometry>'
        f'<Topology TopologyType="Tetrahedron" NumberOfElements="{made.nelements}">{item(made.t.T)}</Topology>'
        f'<Attribute Name="layer" AttributeType="Scalar" Center="Cell">{item(region)}</Attribute>'
        "</Grid></Domain></Xdmf>"
    )
    mesh = read(tmp_path / "a.xdmf")
    assert np.array_equal(mesh.p, made.p) and set(mesh.subdomains) == {"1", "2"}


def test_sets_of_an_abaqus_file_are_regions(tmp_path):
    """Independent check: an element set of a file as Abaqus writes it."""
    made, region, _ = two_layers()
    parts = [np.flatnonzero(region == 2)]
    meshio.Mesh(made.p.T, [("tetra", made.t.T)], cell_sets={"upper": parts}).write(tmp_path / "a.inp")
    mesh = read(tmp_path / "a.inp")
    assert volumes(mesh.p.T, mesh.t.T).sum() == pytest.approx(2.0, rel=1e-12)
    assert np.array_equal(mesh.subdomains["upper"], parts[0])


def test_families_of_a_med_file_are_regions_and_boundaries():
    """Independent check: Salome numbers the families of elements from −1 down, a family being in several groups."""
    made, region, bed = two_layers()
    families = {"cell_tags": [-region, np.full(len(bed), -7)]}
    data = meshio.Mesh(made.p.T, [("tetra", made.t.T), ("triangle", bed)], cell_data=families)
    data.cell_tags = {-1: ["skin"], -2: ["skin", "fat"], -7: ["bed"]}
    surfaces, regions = named_groups(data)
    assert surfaces.keys() == {"bed"} and np.array_equal(surfaces["bed"], bed)
    assert {name: len(cells) for name, cells in regions.items()} == {"skin": len(region), "fat": (region == 2).sum()}


def test_a_format_that_needs_more_says_what(tmp_path, monkeypatch):
    """Independent check: meshio reads .med by h5py, which is not asked for otherwise."""
    monkeypatch.setitem(sys.modules, "h5py", None)
    (tmp_path / "a.med").write_bytes(b"HDF")
    assert "to read it meshio needs h5py: `pip install h5py`" in refusal(tmp_path / "a.med")


def test_units():
    found = [metres_per_unit(unit) for unit in ("m", "dm", "cm", "mm", "um", "µm", 0.03, 2)]
    assert found == [1.0, 0.1, 0.01, 1e-3, 1e-6, 1e-6, 0.03, 2.0]
    for unit in ("inch", "MM", "", 0.0, -1.0, float("nan"), float("inf"), True):
        with pytest.raises(MeshError, match="unit = "):
            metres_per_unit(unit)


def refusal(path: Path) -> str:
    with pytest.raises(MeshError) as caught:
        read(path)
    message = str(caught.value)
    assert message.startswith(str(path)) and "\n" not in message
    return message


@NEEDS_GMSH
@pytest.mark.parametrize(
    ("nodes", "elements", "says"),
    [
        (NODES, SKIN, "not a volume mesh, it has only Triangle 3 elements"),
        (NODES, [], "no elements"),
        (
            NODES,
            [*LOWER, *((k, p, e, (b, a, c, d)) for k, p, e, (a, b, c, d) in UPPER)],
            "4 of 8 tetrahedra are inverted",
        ),
        ({**NODES, 99: (5, 5, 5)}, LOWER + UPPER, "1 of 8 nodes belong to no element"),
        (NODES, LOWER, "1 of 7 nodes belong to no element"),
        (NODES, LOWER + SKIN, "1 of 7 nodes belong to no tetrahedron"),
        (NODES, [*LOWER, (4, 1, 1, (10, 11, 30, 77))], "gmsh cannot read it: Wrong node index 77"),
        (NODES, LOWER + UPPER + [(2, 7, 3, (10, 12, 20))], "are not facets of tetrahedra"),
        (
            NODES,
            LOWER + UPPER + [(2, 7, 3, (10, 11, 21)), (2, 8, 3, (11, 12, 21))],
            r"physical groups [7, 8]",
        ),
        (NODES, LOWER + UPPER + UPPER[:1], "more than two tetrahedra"),
        ({**NODES, 20: (0, 0, "nan")}, LOWER + UPPER, "1 of 7 nodes have coordinates that are not finite"),
        ({**NODES, 20: (0, 0, 0)}, LOWER + UPPER, "1 pairs of nodes lie at the same place"),
        ({**NODES, 20: (0.1, 0, 0)}, LOWER + UPPER, "4 of 8 tetrahedra are degenerate"),
        (
            {**NODES, 41: (10, 0, 0), 42: (9, 1, 0), 43: (9, 0, 1)},
            LOWER + UPPER + [(4, 1, 1, (20, 41, 42, 43))],
            "1 nodes belong to bodies that share no facet (index 4): join the bodies",
        ),
    ],
)
def test_faults_of_a_gmsh_file_are_named(old_file, nodes, elements, says):
    assert says in refusal(old_file(nodes, elements))


@NEEDS_GMSH
def test_quadratic_and_hexahedral_meshes_are_refused(tmp_path):
    path = tmp_path / "box.msh"
    with session() as gmsh:
        gmsh.model.occ.addBox(0, 0, 0, 1, 1, 1)
        gmsh.model.occ.synchronize()
        gmsh.model.mesh.generate(3)
        gmsh.model.mesh.setOrder(2)
        gmsh.write(str(path))
    assert "Tetrahedron 10, Triangle 6; allowed are only linear tetrahedra" in refusal(path)
    cube = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1]], float)
    meshio.Mesh(cube, {"hexahedron": np.arange(8)[None]}).write(tmp_path / "cube.vtu")
    assert "hexahedron; allowed are only linear tetrahedra" in refusal(tmp_path / "cube.vtu")


def test_missing_empty_and_unknown_files(tmp_path):
    assert "no such file" in refusal(tmp_path / "none.msh")
    assert "not a file" in refusal(tmp_path)
    for name in ("empty.msh", "empty.vtu"):
        (tmp_path / name).touch()
        assert "the file is empty" in refusal(tmp_path / name)
    (tmp_path / "organ.stl").write_text("solid")
    assert "'.stl' is not one of .msh" in refusal(tmp_path / "organ.stl")


def test_a_file_that_is_no_gmsh_mesh_is_not_run_as_a_script(tmp_path):
    path, trace = tmp_path / "script.msh", tmp_path / "trace"
    path.write_text(f'SystemCall "touch {trace}";\n')
    assert "does not begin like a gmsh mesh" in refusal(path)
    assert not trace.exists()


@NEEDS_GMSH
def test_a_gmsh_file_cut_short_is_refused(old_file):
    path = old_file()
    path.write_text(path.read_text()[:60])
    assert "gmsh cannot read it" in refusal(path)


@NEEDS_GMSH
def test_a_file_that_brings_gmsh_down_is_refused(tmp_path):
    """Independent check: a group of dimension 7 ends the process that gmsh is in, and not this one."""
    path = write_box(tmp_path / "box.msh", 4.1, False)
    text = path.read_text()
    assert '3 1 "organ"' in text
    path.write_text(text.replace('3 1 "organ"', '7 1 "organ"'))
    message = refusal(path)
    assert "gmsh crashed: ended by SIGSEGV; the file is inconsistent; save it again" in message


def test_a_child_says_what_it_refuses_and_how_it_ends(monkeypatch, tmp_path):
    """Independent check: what is returned, what is refused, a defect, a killed process, and no end."""
    assert child.call_in_child(metres_per_unit, "mm") == 1e-3
    with pytest.raises(MeshError, match="unit = 'inch'"):
        child.call_in_child(metres_per_unit, "inch")
    with pytest.raises(
        MeshError, match=r"gmsh crashed: ZeroDivisionError: .* \(ended with status 1\); the file is inconsistent"
    ):
        child.call_in_child(operator.truediv, 1, 0)
    with pytest.raises(MeshError, match=r"gmsh crashed: ended by SIGKILL"):
        child.call_in_child(signal.raise_signal, signal.SIGKILL)
    monkeypatch.setattr(child, "PATIENCE", 0.5)
    with pytest.raises(MeshError, match=r"gmsh did not finish within 0\.5 s"):
        child.call_in_child(time.sleep, 60)
    monkeypatch.chdir(tmp_path)
    (tmp_path / "pickle.py").write_text("raise SystemExit(7)")  # not looked for in the user's folder
    monkeypatch.setattr(child, "PATIENCE", 60)
    assert child.call_in_child(metres_per_unit, "mm") == 1e-3


@pytest.mark.skipif(sys.platform == "win32", reason="has no signals")
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGKILL])
def test_a_child_ends_with_its_parent_and_leaves_no_folder(tmp_path, number):
    """Independent check: the process is gone and the folder for temporary files is empty, soon after the parent."""
    script = "import time\nfrom meshes.child import call_in_child\ncall_in_child(time.sleep, 600)"
    surroundings = dict(os.environ, TMPDIR=str(tmp_path))
    with subprocess.Popen([sys.executable, "-c", script], env=surroundings) as parent:
        until(lambda: psutil.Process(parent.pid).children())
        [begun] = psutil.Process(parent.pid).children()
        parent.send_signal(number)
    until(lambda: not begun.is_running() or begun.status() == psutil.STATUS_ZOMBIE)
    assert list(tmp_path.iterdir()) == []


def until(is_so):
    """Wait for something, half a minute at most."""
    end = time.monotonic() + 30
    while not is_so():
        assert time.monotonic() < end
        time.sleep(0.05)


def test_the_last_words_of_a_child():
    """Independent check: the last line that is not empty, or the signal where nothing was said."""
    assert child.last_words(1, "Traceback\n  x\nOSError: no display\n\n") == "OSError: no display (ended with status 1)"
    assert child.last_words(-11, "") == "ended by SIGSEGV"
    assert child.last_words(0, " ") == "ended without an answer"


@pytest.mark.parametrize("factor", [1e308, 1e200, 1e16, 1e-17, 1e-300, 5e-324])
def test_lengths_whose_cubes_are_no_numbers_are_refused(tmp_path, factor):
    """Independent check: coordinates in the file, and the unit."""
    made = block((1, 1, 1), 0.5)
    meshio.Mesh(factor * made.p.T, {"tetra": made.t.T}).write(tmp_path / "far.vtu")
    assert "its nodes lie up to" in refusal(tmp_path / "far.vtu") or factor == 5e-324
    meshio.Mesh(made.p.T, {"tetra": made.t.T}).write(tmp_path / "far.vtu")
    with pytest.raises(MeshError, match=r"its nodes lie up to|same place"):
        read(tmp_path / "far.vtu", factor)


def test_a_refusal_is_short(tmp_path):
    """Independent check: a reader that repeats the file is cut short."""
    (tmp_path / "long.vtu").write_text("<VTKFile " + "x" * 50_000 + ">")
    assert len(refusal(tmp_path / "long.vtu")) <= LONGEST
    assert len(str(MeshError("x" * 50_000))) == LONGEST


@pytest.mark.parametrize("name", ["bad.vtu", "bad.vtk"])
def test_meshio_neither_prints_nor_ends_the_interpreter(tmp_path, capfd, name):
    (tmp_path / name).write_text("# vtk DataFile Version 3.0\nx\nASCII\nDATASET POLYDATA\nPOINTS 0 float\n")
    assert "meshio cannot read it" in refusal(tmp_path / name)
    assert capfd.readouterr() == ("", "")


def test_surface_only_vtk_is_not_a_volume(tmp_path):
    meshio.Mesh(np.eye(3), {"triangle": np.array([[0, 1, 2]])}).write(tmp_path / "skin.vtk")
    assert "not a volume mesh, it has only triangle elements" in refusal(tmp_path / "skin.vtk")


def test_a_vtk_file_with_an_unused_node_is_refused(tmp_path):
    made = block((1, 1, 1), 0.5)
    meshio.Mesh(np.vstack([made.p.T, [9, 9, 9]]), {"tetra": made.t.T}).write(tmp_path / "extra.vtu")
    assert "1 of 28 nodes belong to no tetrahedron (index 27)" in refusal(tmp_path / "extra.vtu")


def test_a_unit_that_is_no_length_is_refused(tmp_path):
    (tmp_path / "a.vtu").write_text("x")
    with pytest.raises(MeshError, match="metres_per_unit = 0"):
        read(tmp_path / "a.vtu", 0)


@pytest.mark.parametrize(
    ("error", "says"),
    [
        (
            OSError("libGLU.so.1: cannot open shared object file: No such file or directory"),
            "system library libGLU.so.1 is missing",
        ),
        (OSError("libXft.so.2: cannot open shared object file"), "system library libXft.so.2 is missing"),
        (OSError("wrong ELF class"), "a system library is missing (wrong ELF class)"),
        (ModuleNotFoundError("No module named 'gmsh'"), "gmsh is not installed: pip install 'suturefem[mesh]'"),
    ],
)
def test_without_gmsh_the_error_says_what_to_install_and_what_works(monkeypatch, error, says):
    def fail(name: str) -> None:
        raise error

    monkeypatch.setattr(gmsh_session, "import_module", fail)
    with pytest.raises(MeshError) as caught:
        load_gmsh()
    message = str(caught.value)
    assert says in message
    assert "structured block" in message and ".vtu" in message
    assert ("apt-get install --no-install-recommends libglu1-mesa" in message) == isinstance(error, OSError)


def test_gmsh_is_loaded_only_when_asked_for():
    # Another test may have loaded it: a fresh interpreter tells.
    code = (
        "import sys, meshes.block, meshes.file, meshes.cylinder; meshes.block.block((1, 1, 1), 1); "
        "print('gmsh' in sys.modules)"
    )
    root = Path(gmsh_session.__file__).parents[1]
    done = subprocess.run([sys.executable, "-c", code], cwd=root, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"


@NEEDS_GMSH
def test_a_session_always_ends_and_refuses_to_share():
    with pytest.raises(ZeroDivisionError), session() as gmsh:
        raise ZeroDivisionError
    gmsh = load_gmsh()
    assert not gmsh.isInitialized()
    with session(), pytest.raises(MeshError, match="already initialised"), session():
        pass
    assert not gmsh.isInitialized()


@NEEDS_GMSH
def test_a_session_leaves_the_handler_of_interrupts_alone():
    def ours(number, frame):
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGINT, ours)
    try:
        with session():
            assert signal.getsignal(signal.SIGINT) is ours
        assert signal.getsignal(signal.SIGINT) is ours
    finally:
        signal.signal(signal.SIGINT, before)


@NEEDS_GMSH
def test_gmsh_is_silent(old_file, capfd):
    read(old_file())
    graded_block_gmsh((1, 1, 1), Grading(0.5, 0.4), [[0, 0, 0]])
    assert capfd.readouterr() == ("", "")
