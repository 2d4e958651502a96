"""The golden case: made the same again, found by our own kernels and by a plain reader, and lost by every slip."""

from __future__ import annotations

import json
import math
import struct

import numpy as np
import pytest

from heartcase.schemas.bundle.check import check_bundle
from heartcase.schemas.bundle.format import FileRole
from heartcase.schemas.bundle.reader import open_bundle
from heartcase.simulator.engine.backends import make_engine
from heartcase.simulator.lattice.state import State
from heartcase.simulator.load import load_case
from heartcase.simulator.simulation import Simulation
from heartcase.simulator.surface.deform import deform
from tests.golden import reader
from tests.golden.make import CASE, EXPECTED, differences, make
from tests.golden.motion import chirality, enclosed
from tests.golden.reader import MOTION_SLIPS, SURFACE_SLIPS, PlainCase

EXPECT = json.loads(EXPECTED.read_text())
TOLERANCE_MM = EXPECT["tolerance_mm"]


def gap(found, expected) -> float:
    """Largest difference of a component."""
    return float(np.abs(np.asarray(found) - np.asarray(expected)).max())


def test_it_is_made_again_to_the_last_byte(tmp_path):
    make(tmp_path)
    assert differences(tmp_path) == []


def test_it_is_sound_and_small():
    assert check_bundle(CASE) == ()
    assert sum(path.stat().st_size for path in [EXPECTED, *CASE.iterdir()]) < 150_000


def test_it_holds_what_a_reader_can_get_wrong():
    bundle = open_bundle(CASE)
    grid, mapping = bundle.arrays(FileRole.GRID), bundle.arrays(FileRole.MAPPING)
    assert len(set(grid["cell_coverage"].tolist())) > 5
    assert len(set(grid["cell_stiffness"].tolist())) == len(set(grid["cell_density"].tolist())) == 2
    assert 0 < grid["fixed"].sum() < len(grid["fixed"])
    assert 10 < mapping["curvature"].sum() < len(mapping["curvature"]) - 10
    assert np.abs(bundle.manifest.grid_geometry.direction_matrix - np.eye(3)).min() > 1e-3
    assert len(set(bundle.manifest.scan_geometry.spacing_mm)) == 3
    shapes = {mirrored.tobytes() for mirrored in lattice_images(grid["cells"])}
    assert len(shapes) == 48, "some mirror image or turn of the lattice is the tissue itself"


def lattice_images(cells):
    """The 48 images of the cells under swaps and flips of the axes, each shifted to the origin and sorted."""
    for axes in np.array([(0, 1, 2), (0, 2, 1), (1, 0, 2), (1, 2, 0), (2, 0, 1), (2, 1, 0)]):
        for signs in np.array(np.meshgrid([1, -1], [1, -1], [1, -1])).reshape(3, -1).T:
            image = cells[:, axes] * signs
            image = image - image.min(axis=0)
            yield image[np.lexsort(image.T)].astype(np.int32)


# Our own kernels.


def golden_simulation(backend) -> Simulation:
    case = load_case(CASE)
    simulation = Simulation(
        case.model,
        surface=case.surface,
        step_s=EXPECT["step_s"],
        damping_per_s=EXPECT["damping_per_s"],
        gravity_m_s2=EXPECT["gravity_m_s2"],
        backend=backend,
    )
    start = np.zeros((case.model.node_count, 3), np.float32)
    for node, offset in EXPECT["start"]["displacement_mm"]:
        start[node] = case.model.to_grid(offset)
    simulation.restore(State(start, np.zeros_like(start)))
    return simulation


@pytest.mark.parametrize("backend", ["cpu", "reference"])
def test_our_kernels_get_there(backend):
    """float32 weights and states: 7e-7 mm after 100 steps, as displacements; far below what the tolerance allows."""
    simulation = golden_simulation(backend)
    at_rest = deform(simulation.model, simulation.surface, np.zeros((simulation.model.node_count, 3), np.float32))
    assert gap(at_rest.vertices_mm, EXPECT["surface"]["0"]["vertices_mm"]) < TOLERANCE_MM["float32"]
    for count, more in ((1, 1), (100, 99)):
        simulation.step(more)
        error = gap(simulation.positions_mm(), EXPECT["steps"][str(count)]["nodes_mm"])
        assert error < 1e-5
    surface = simulation.surface_now()
    assert gap(surface.vertices_mm, EXPECT["surface"]["100"]["vertices_mm"]) < 5e-5
    assert gap(surface.normals, EXPECT["surface"]["100"]["normals"]) < 1e-4


def test_the_surface_at_rest_is_the_one_that_is_stored():
    stored = open_bundle(CASE).arrays(FileRole.SURFACE)
    assert gap(stored["vertices"], EXPECT["surface"]["0"]["vertices_mm"]) < 2e-5
    assert gap(stored["normals"], EXPECT["surface"]["0"]["normals"]) < 1e-5


def test_the_tissue_moves_enough_to_tell():
    moved = np.array(EXPECT["steps"]["100"]["nodes_mm"]) - load_case(CASE, needs=()).model.rest_positions_mm()
    assert 1.0 < np.abs(moved).max() < 4.0
    fixed = open_bundle(CASE).arrays(FileRole.GRID)["fixed"] == 1
    assert np.abs(moved[fixed]).max() < 1e-8


# A plain reader, and its slips.


@pytest.mark.parametrize("count", [1, 100])
def test_a_plain_reader_gets_there(count):
    case = PlainCase(CASE)
    nodes = case.after(count, EXPECT)
    error = gap(nodes, EXPECT["steps"][str(count)]["nodes_mm"])
    assert error < TOLERANCE_MM["float64"]
    if count == 100:
        vertices, normals = case.surface(nodes)
        assert gap(vertices, EXPECT["surface"]["100"]["vertices_mm"]) < TOLERANCE_MM["float64"]
        assert gap(normals, EXPECT["surface"]["100"]["normals"]) < TOLERANCE_MM["float64"]
        assert sum(case.masses()) * 1e3 == pytest.approx(EXPECT["checks"]["mass_g"], abs=1e-8)


@pytest.mark.parametrize("slip", MOTION_SLIPS)
def test_no_slip_in_the_motion_goes_unnoticed(slip):
    """A slip that stops a reader is noticed too."""
    try:
        nodes = PlainCase(CASE, slip).after(100, EXPECT)
    except (KeyError, OverflowError):
        return
    error = gap(nodes, EXPECT["steps"]["100"]["nodes_mm"])
    assert not error < 20 * TOLERANCE_MM["float32"]


@pytest.mark.parametrize("slip", SURFACE_SLIPS)
def test_no_slip_in_the_surface_goes_unnoticed(slip):
    nodes = [tuple(node) for node in EXPECT["steps"]["100"]["nodes_mm"]]
    vertices, _ = PlainCase(CASE, slip).surface(nodes)
    error = gap(vertices, EXPECT["surface"]["100"]["vertices_mm"])
    assert error > 20 * TOLERANCE_MM["float32"]


# Handedness.


def landmarks():
    points = {landmark.name: landmark.points_mm[0] for landmark in open_bundle(CASE).manifest.landmarks}
    return np.array([points[name] for name in EXPECT["checks"]["landmarks"]])


def test_landmarks_lie_where_their_names_say():
    corner, *tips = landmarks()
    for axis, tip in enumerate(tips):
        assert np.abs(tip - corner).argmax() == axis
        assert (tip - corner)[axis] > 0, "LPS: +x is left, +y is back, +z is head"


def test_chirality_tells_a_mirrored_case_and_not_a_turned_one():
    stated = EXPECT["checks"]["chirality_lps_mm3"]
    points = landmarks()
    assert stated > 0
    assert chirality(points) == pytest.approx(stated, abs=1e-5)
    for axis in range(3):
        mirrored = points.copy()
        mirrored[:, axis] *= -1
        assert chirality(mirrored) == pytest.approx(-stated, abs=1e-5)
    assert chirality(points[:, [1, 0, 2]]) == pytest.approx(-stated, abs=1e-5)
    assert chirality(points[:, [1, 2, 0]]) == pytest.approx(stated, abs=1e-5)


def test_frames_are_the_hand_that_they_say_and_keep_the_heart():
    """A left-handed frame's numbers have the other sign; forgetting that, or a flipped axis, is found."""
    frames = open_bundle(CASE).manifest.coordinates.frames
    size = {"m": 1e-9, "cm": 1e-3}
    example = {"gltf": (0.010, 0.030, -0.020), "unity": (0.010, 0.030, 0.020), "unreal": (2.0, 1.0, 3.0)}
    way = {"left": (1, 0, 0), "right": (-1, 0, 0), "back": (0, 1, 0), "front": (0, -1, 0), "head": (0, 0, 1)}
    assert {frame.name for frame in frames} == set(example)
    for frame in frames:
        matrix = np.array(frame.from_lps_mm)
        assert math.copysign(1, np.linalg.det(matrix)) == frame.determinant_sign
        assert (frame.determinant_sign == 1) == (frame.handedness == "right")
        np.testing.assert_allclose(matrix @ (10, 20, 30), example[frame.name], rtol=1e-12)
        for row, name in zip(matrix, frame.axes, strict=True):
            np.testing.assert_allclose(row / np.linalg.norm(row), way[name])
        stated = EXPECT["checks"]["chirality_frames"][frame.name]
        assert chirality(landmarks() @ matrix.T) == pytest.approx(stated, rel=1e-6)
        volume = frame.determinant_sign * EXPECT["checks"]["chirality_lps_mm3"] * size[frame.unit]
        assert stated == pytest.approx(volume, rel=1e-6)


@pytest.mark.parametrize("name", ["unity", "unreal"])
def test_left_handed_axes_need_the_factors_of_cross_products_swapped(name, monkeypatch):
    frame = next(frame for frame in open_bundle(CASE).manifest.coordinates.frames if frame.name == name)
    matrix = np.array(frame.from_lps_mm) * {"m": 1e3, "cm": 10.0}[frame.unit]

    def error():
        case = PlainCase(CASE)
        case.rest = [tuple(matrix @ point) for point in case.rest]
        vertices, _ = case.surface([tuple(matrix @ point) for point in EXPECT["steps"]["100"]["nodes_mm"]])
        return gap(np.array(vertices) @ matrix, EXPECT["surface"]["100"]["vertices_mm"])

    assert error() > 20 * TOLERANCE_MM["float32"]
    monkeypatch.setattr(reader, "_cross", lambda a, b, cross=reader._cross: cross(b, a))
    assert error() < TOLERANCE_MM["float64"]


def test_winding_tells_turned_triangles():
    mesh = open_bundle(CASE).arrays(FileRole.SURFACE)
    assert enclosed(mesh) == pytest.approx(EXPECT["checks"]["enclosed_mm3"], abs=1e-2)
    assert EXPECT["checks"]["enclosed_mm3"] > 100
    assert enclosed({**mesh, "triangles": mesh["triangles"][:, [0, 2, 1]]}) < -100
    assert enclosed({**mesh, "vertices": mesh["vertices"] * np.float32([-1, 1, 1])}) < -100


def test_the_glb_is_the_same_heart_in_metres():
    """Read by hand: the root's matrix (column after column) times POSITION, and the triangles' own volume."""
    content = open_bundle(CASE).path(FileRole.RENDER).read_bytes()
    length = struct.unpack_from("<I", content, 12)[0]
    gltf, data = json.loads(content[20 : 20 + length]), content[28 + length :]
    assert gltf["asset"]["extras"]["case_id"] == open_bundle(CASE).manifest.case_id
    matrix = np.array(gltf["nodes"][0]["matrix"]).reshape(4, 4).T

    def accessor(number, dtype, width):
        one = gltf["accessors"][number]
        offset = gltf["bufferViews"][one["bufferView"]]["byteOffset"]
        return np.frombuffer(data, dtype, one["count"] * width, offset).reshape(-1, width)

    primitives = gltf["meshes"][0]["primitives"]
    position = accessor(primitives[0]["attributes"]["POSITION"], "<f4", 3) @ matrix[:3, :3].T + matrix[:3, 3]
    triangles = np.concatenate([accessor(one["indices"], "<u4", 1).reshape(-1, 3) for one in primitives])
    volume = enclosed({"vertices": position, "triangles": triangles})
    assert volume * 1e9 == pytest.approx(EXPECT["checks"]["enclosed_mm3"], rel=1e-4)


def test_scan_voxels_are_where_they_should_be():
    scan = load_case(CASE, needs=("scan",)).scan
    for sample in EXPECT["checks"]["scan"]:
        i, j, k = sample["index"]
        assert scan.slice_at(k)[j, i] == sample["intensity"]
        assert gap(scan.geometry.index_to_world((i, j, k)), sample["lps_mm"]) < 1e-6
    assert len({sample["intensity"] for sample in EXPECT["checks"]["scan"]}) == 3


def test_a_reader_that_starts_at_rest_ends_elsewhere():
    model = load_case(CASE, needs=()).model
    engine = make_engine(model, "cpu")
    engine.advance(100, golden_simulation("cpu").verlet)
    at_rest = model.rest_positions_mm() + model.to_mm(engine.read().displacement)
    assert gap(at_rest, EXPECT["steps"]["100"]["nodes_mm"]) > 100 * TOLERANCE_MM["float32"]
