"""Closed surfaces turned into labels, against the shapes themselves."""

from pathlib import Path

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from heartcase.pipeline.formats.labels.stl_parts import inside_of_mesh, read_parts
from heartcase.pipeline.markers.load_markers import load_segmentation
from heartcase.schemas.errors import MarkerError
from heartcase.schemas.geometry import Geometry
from heartcase.schemas.labels import default_label_table

TABLE = default_label_table()
PLAIN = Geometry.of(shape=(12, 13, 14), origin_mm=(-7, -6, -6), spacing_mm=(1.0, 1.0, 1.0))


def centres(geometry):
    k, j, i = np.meshgrid(*[np.arange(n) for n in geometry.shape], indexing="ij")
    return geometry.index_to_world(np.stack([i, j, k], axis=-1))


def inside(mesh, geometry):
    return inside_of_mesh(np.asarray(mesh.vertices, float), np.asarray(mesh.faces, np.int64), geometry)


@st.composite
def lattices(draw):
    turn = Rotation.from_euler("xyz", [draw(st.floats(-180, 180)) for _ in range(3)], degrees=True).as_matrix()
    spacing = [draw(st.floats(0.5, 2.5)) for _ in range(3)]
    size = tuple(draw(st.integers(6, 20)) for _ in range(3))
    handed = np.diag([1, 1, draw(st.sampled_from((-1, 1)))])
    middle = turn @ handed @ (np.array(spacing) * (np.array(size[::-1]) - 1) / 2)
    shift = np.array([draw(st.floats(-3, 3)) for _ in range(3)])
    return Geometry.of(shape=size, origin_mm=shift - middle, spacing_mm=spacing, direction=turn @ handed)


@settings(max_examples=40, deadline=None)
@given(geometry=lattices(), size=st.tuples(*[st.floats(1.0, 12.0)] * 3))
def test_boxes_on_oblique_lattices_are_exact(geometry, size):
    points = centres(geometry)
    reach = np.abs(points) - np.array(size) / 2
    found = inside(trimesh.creation.box(extents=size), geometry)
    clear = np.abs(reach.max(axis=-1)) > 1e-4
    np.testing.assert_array_equal(found[clear], (reach.max(axis=-1) < 0)[clear])


@settings(max_examples=25, deadline=None)
@given(geometry=lattices(), radius=st.floats(2.0, 9.0))
def test_spheres_lie_between_the_inscribed_and_the_circumscribed_one(geometry, radius):
    mesh = trimesh.creation.icosphere(subdivisions=3, radius=radius)
    inner = np.linalg.norm(mesh.triangles_center, axis=1).min()
    distance = np.linalg.norm(centres(geometry), axis=-1)
    found = inside(mesh, geometry)
    assert found[distance < inner - 1e-4].all()
    assert not found[distance > radius + 1e-4].any()
    np.testing.assert_array_equal(found, inside(trimesh.Trimesh(mesh.vertices, mesh.faces[:, ::-1]), geometry))


def test_a_torus_keeps_its_hole_and_its_volume():
    mesh = trimesh.creation.torus(major_radius=8.0, minor_radius=3.0, major_sections=96, minor_sections=64)
    turn = Rotation.from_euler("xyz", [20, 30, 40], degrees=True).as_matrix()
    middle = turn @ (np.array([69, 79, 89]) * (0.4, 0.35, 0.3) / 2)
    geometry = Geometry.of(shape=(90, 80, 70), origin_mm=-middle, spacing_mm=(0.4, 0.35, 0.3), direction=turn)
    found = inside(mesh, geometry)
    points = centres(geometry)
    tube = np.hypot(np.hypot(points[..., 0], points[..., 1]) - 8.0, points[..., 2])
    clear = np.abs(tube - 3.0) > 0.02
    np.testing.assert_array_equal(found[clear], (tube < 3.0)[clear])
    assert found.sum() * geometry.voxel_volume_mm3 == pytest.approx(mesh.volume, rel=2e-3)


def test_rays_through_corners_and_along_faces_leak_nowhere():
    """Corners, edges and faces of the octahedron and the box lie on lattice points and lattice lines."""
    points = centres(PLAIN)
    corners = np.array([(4, 0, 0), (-4, 0, 0), (0, 4, 0), (0, -4, 0), (0, 0, 4), (0, 0, -4)], float)
    octahedron = trimesh.convex.convex_hull(trimesh.PointCloud(corners).vertices)
    total = np.abs(points).sum(axis=-1)
    found = inside(octahedron, PLAIN)
    np.testing.assert_array_equal(found[total != 4], (total < 4)[total != 4])
    box = inside(trimesh.creation.box(extents=(4, 4, 4)), PLAIN)
    reach = np.abs(points).max(axis=-1)
    np.testing.assert_array_equal(box[reach != 2], (reach < 2)[reach != 2])
    # half-open: each face of the lattice-aligned box belongs to one side, so its voxels count its volume exactly
    assert box.sum() == 64


def test_overlapping_shells_are_one_body_and_an_inner_shell_turned_in_is_a_hole():
    one, two = trimesh.creation.icosphere(radius=4.0), trimesh.creation.icosphere(radius=4.0)
    two.apply_translation((3.0, 0.0, 0.0))
    both = trimesh.util.concatenate([one, two])
    np.testing.assert_array_equal(inside(both, PLAIN), inside(one, PLAIN) | inside(two, PLAIN))
    hole = trimesh.creation.icosphere(radius=2.0)
    hollow = trimesh.util.concatenate([one, trimesh.Trimesh(hole.vertices, hole.faces[:, ::-1])])
    np.testing.assert_array_equal(inside(hollow, PLAIN), inside(one, PLAIN) & ~inside(hole, PLAIN))


def write(path: Path, mesh, *, text=False, header=None):
    content = mesh.export(file_type="stl_ascii" if text else "stl")
    if text:
        path.write_text(content if header is None else content.replace("solid", f"solid {header}", 1))
    else:
        path.write_bytes(content if header is None else header.encode().ljust(80, b" ") + content[80:])


def ball(radius, *centre):
    mesh = trimesh.creation.icosphere(subdivisions=2, radius=radius)
    mesh.apply_translation(centre)
    return mesh


@pytest.mark.parametrize("text", [False, True])
def test_parts_are_named_by_their_files_and_later_ones_win(tmp_path, text):
    write(tmp_path / "LV.stl", ball(3.0, -2, 1, 0), text=text, header="x SPACE=LPS")
    write(tmp_path / "heart_atrium_left.STL", ball(3.0, 2, -1, 2), text=text, header="x SPACE=RAS")
    write(tmp_path / "Aorta.stl", ball(1.5, 2, 4, 3), text=text)
    segmentation = load_segmentation(tmp_path, {}, TABLE, PLAIN)
    ventricle = inside(ball(3.0, -2, 1, 0), PLAIN)
    atrium = inside(ball(3.0, -2, 1, 2), PLAIN)  # its file is RAS
    expected = np.zeros(PLAIN.shape, np.uint8)
    expected[inside(ball(1.5, 2, 4, 3), PLAIN)] = 5
    expected[atrium] = 3
    expected[ventricle] = 1
    np.testing.assert_array_equal(segmentation.labels, expected)
    assert set(np.unique(expected)) == {0, 1, 3, 5}
    warning, overlap = segmentation.warnings
    assert f"{np.count_nonzero(ventricle & atrium)} voxels" in overlap.text
    assert "Aorta" not in overlap.text
    assert "LPS was assumed" in warning.text
    assert "part 1)" in warning.text
    with pytest.raises(MarkerError, match="give the scan"):
        load_segmentation(tmp_path, {}, TABLE, None)


def test_every_bad_part_is_listed_by_its_number_and_no_name_is_shown(tmp_path):
    good = ball(3.0, 0, 0, 0)
    open_one = trimesh.Trimesh(good.vertices, good.faces[3:])
    write(tmp_path / "jane-1.stl", open_one)
    turned = good.faces.copy()
    turned[5] = turned[5][::-1]
    write(tmp_path / "jane-2.stl", trimesh.Trimesh(good.vertices, turned, process=False))
    (tmp_path / "jane-3.stl").write_bytes(b"\0" * 99)
    write(tmp_path / "jane-4.stl", ball(3.0, 90_000.0, 0, 0))
    (tmp_path / "jane-5.stl").write_bytes(good.export(file_type="stl")[:-7])
    (tmp_path / "jane-6.stl").write_text("solid x\n facet normal 0 0 1\n outer loop\n vertex 0 0 0\n")
    (tmp_path / "jane-7.stl").write_text("solid x\nendsolid x\n")
    with pytest.raises(MarkerError) as caught:
        load_segmentation(tmp_path, {}, TABLE, PLAIN)
    messages = [str(problem) for problem in caught.value.problems]
    words = ["open edges", "turned against each other", "not an STL", "far outside", "not an STL", "holds no triangle"]
    assert len(messages) == 7
    for number, word in enumerate([*words[:5], "", words[5]], start=1):
        assert f"part {number} of the folder" in messages[number - 1]
        assert word in messages[number - 1]
    border = trimesh.grouping.group_rows(open_one.edges_sorted, require_count=1)
    assert f"it has {len(border)} open edges" in messages[0]
    assert "jane" not in str(caught.value)
    for path in tmp_path.iterdir():
        path.unlink()
    write(tmp_path / "jane doe.stl", good)
    with pytest.raises(MarkerError, match="no label: segment 1 of the file") as caught:
        load_segmentation(tmp_path, {}, TABLE, PLAIN)
    assert "jane" not in str(caught.value)
    assert load_segmentation(tmp_path, {"Jane Doe": "SVC"}, TABLE, PLAIN).labels.max() == 7


def test_the_order_of_faces_does_not_matter(tmp_path):
    mesh = ball(3.3, 0.2, 0.1, -0.3)
    shuffled = trimesh.Trimesh(mesh.vertices, np.random.default_rng(0).permutation(mesh.faces), process=False)
    write(tmp_path / "LV.stl", mesh)
    first = read_parts(tmp_path, PLAIN).values
    write(tmp_path / "LV.stl", shuffled)
    np.testing.assert_array_equal(read_parts(tmp_path, PLAIN).values, first)


@pytest.mark.parametrize(
    "header", ["SPACE=RAS", "x SPACE: RAS", "COORDSYS=RAS", "coordinate system = ras;", "Space=RAS"]
)
def test_headers_that_say_ras(tmp_path, header):
    write(tmp_path / "LV.stl", ball(3.0, -2, 1, 0), header=header)
    volume = read_parts(tmp_path, PLAIN)
    np.testing.assert_array_equal(volume.values > 0, inside(ball(3.0, 2, -1, 0), PLAIN))
    assert volume.warnings == ()


@pytest.mark.parametrize("header", ["SPACE=LAS", "SPACE=RAS COORDSYS=LPS"])
def test_headers_that_say_something_else(tmp_path, header):
    write(tmp_path / "LV.stl", ball(3.0, -2, 1, 0), header=header)
    with pytest.raises(MarkerError, match="neither LPS nor RAS, or in both"):
        read_parts(tmp_path, PLAIN)


OFF_CENTRE = PLAIN.model_copy(update={"origin_mm": (5.0, -4.0, 3.0)})


@pytest.mark.parametrize("shift", [(0, 0, 0), (4, 3, 0), (7, 0, 0)])
def test_a_silent_surface_that_lies_better_as_ras_is_refused(tmp_path, shift):
    """Also one that lies partly in the scan either way."""
    middle = OFF_CENTRE.index_to_world((5, 5, 5)) - np.array(shift)
    write(tmp_path / "jane.stl", ball(2.5, *(middle * (-1, -1, 1))))
    with pytest.raises(MarkerError, match=r"part 1 .* better as RAS") as caught:
        read_parts(tmp_path, OFF_CENTRE)
    assert "jane" not in str(caught.value)
    write(tmp_path / "jane.stl", ball(2.5, *middle))
    (warning,) = read_parts(tmp_path, OFF_CENTRE).warnings
    assert "neither LPS nor RAS" in warning.text


def test_a_part_of_which_nothing_is_left_is_refused_unless_it_is_left_out(tmp_path):
    write(tmp_path / "LV.stl", ball(3.0, -2, 1, 0), header="SPACE=LPS")
    write(tmp_path / "RV.stl", ball(3.0, 500, 1, 0), header="SPACE=LPS")
    with pytest.raises(MarkerError, match="segment 2 of the file would vanish"):
        load_segmentation(tmp_path, {}, TABLE, PLAIN)
    assert set(np.unique(load_segmentation(tmp_path, {"rv": "background"}, TABLE, PLAIN).labels)) == {0, 1}
    (tmp_path / "RV.stl").rename(tmp_path / "a knee.stl")
    with pytest.raises(MarkerError, match="no label: segment 1 of the file"):
        load_segmentation(tmp_path, {}, TABLE, PLAIN)
    alone = load_segmentation(tmp_path, {}, TABLE, PLAIN, others="ignore").labels
    assert set(np.unique(alone)) == {0, 1}
    write(tmp_path / "thorax.stl", ball(5.0, -2, 1, 0), header="SPACE=LPS")
    np.testing.assert_array_equal(load_segmentation(tmp_path, {}, TABLE, PLAIN, others="ignore").labels, alone)
    with pytest.raises(MarkerError, match="segment 2 of the file would vanish"):
        load_segmentation(tmp_path, {"thorax": "RV"}, TABLE, PLAIN, others="ignore")


def test_many_faces_around_the_whole_scan_are_refused_at_once(tmp_path):
    lattice = Geometry.of(shape=(256, 256, 256), origin_mm=(-128, -128, -128))
    one = trimesh.creation.box(extents=(900, 900, 900))
    vertices = np.concatenate([np.asarray(one.vertices) + n / 16 for n in range(300)])
    faces = np.concatenate([np.asarray(one.faces) + len(one.vertices) * n for n in range(300)])
    with pytest.raises(MarkerError, match="too many faces that reach across"):
        inside_of_mesh(vertices, faces, lattice)
    assert inside_of_mesh(vertices[:8], faces[:12], lattice).all()


def test_a_part_that_nobody_wants_covers_none_that_is_wanted(tmp_path):
    ball = trimesh.creation.icosphere(subdivisions=2, radius=4.0)
    ball.export(tmp_path / "aorta.stl")
    trimesh.creation.box((8.0, 4.0, 4.0)).export(tmp_path / "x tumour.stl")
    found = load_segmentation(tmp_path, {}, TABLE, PLAIN, others="ignore")
    np.testing.assert_array_equal(found.labels == 5, inside(ball, PLAIN))
