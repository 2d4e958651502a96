from __future__ import annotations

import numba
import numpy as np
import pytest
import trimesh

from heartcase.pipeline.data import Structures, Surface
from heartcase.pipeline.mesh.build_surface import build_surface
from heartcase.pipeline.mesh.decimation import collapse
from heartcase.pipeline.mesh.decimation.decimate import (
    decimate,
    decimate_soundly,
    folded_triangles,
    mesh_defects,
    relax_folds,
    without_folds,
)
from heartcase.pipeline.mesh.extraction.extract import (
    drop_small_shells,
    extract,
    extraction_lattice,
    shell_volumes,
    smooth_creases,
)
from heartcase.pipeline.mesh.triangles.half_edges import opposites
from heartcase.pipeline.mesh.triangles.intersections import self_intersections
from heartcase.pipeline.mesh.triangles.mesh_distance import mesh_distance_mm
from heartcase.pipeline.mesh.triangles.triangle_grid import triangle_grid
from heartcase.schemas.errors import StageError
from heartcase.schemas.labels import Label, LabelTable, Role
from heartcase.schemas.recipe.settings import SurfaceSettings
from tests.pipeline.random_phantoms import random_heart
from tests.pipeline.solids import LEFT_HANDED, OBLIQUE, lattice, points, solid, sphere, torus, tube, walled

PLAIN = SurfaceSettings(normal_map_size=0)
COARSE = SurfaceSettings(normal_map_size=0, triangle_count=6000)


def mesh_of(surface: Surface) -> trimesh.Trimesh:
    return trimesh.Trimesh(surface.vertices_mm.astype(float), surface.triangles, process=False)


def assert_sound(surface: Surface) -> None:
    """Closed, manifold, outward: according to trimesh."""
    mesh = mesh_of(surface)
    assert mesh.is_watertight
    assert mesh.is_winding_consistent
    assert mesh.area_faces.min() > 0.0
    assert len(np.unique(np.sort(surface.triangles, axis=1), axis=0)) == len(surface.triangles)
    around = np.bincount(np.unique(np.sort(mesh.edges, axis=1), axis=0).ravel(), minlength=len(mesh.vertices))
    assert np.array_equal(around, np.bincount(surface.triangles.ravel(), minlength=len(mesh.vertices)))


@pytest.mark.parametrize(
    ("spacing", "direction"),
    [
        (1.75, np.eye(3)),
        ((1.2, 1.5, 2.5), np.eye(3)),
        (1.75, OBLIQUE),
        (1.75, LEFT_HANDED),
        ((1.2, 1.5, 2.5), OBLIQUE @ LEFT_HANDED),
    ],
    ids=["isotropic", "anisotropic", "oblique", "left-handed", "all at once"],
)
@pytest.mark.parametrize("settings", [PLAIN, COARSE], ids=["full", "decimated"])
def test_a_wall_of_one_millimetre_survives_voxels_of_two(spacing, direction, settings):
    structures = walled(sphere(12.0), 1.0, lattice(spacing, 17.0, direction=direction))
    surface = build_surface(structures, settings)
    assert_sound(surface)
    mesh = mesh_of(surface)
    assert mesh.euler_number == 4
    assert len(mesh.split()) == 2
    # Linear interpolation of a distance with curvatures 1/r errs by at most h^2 / 8 (1/r + 1/r).
    bound = max(np.broadcast_to(spacing, 3)) ** 2 / 8.0 * 2.0 / 11.0
    radius = np.linalg.norm(surface.vertices_mm, axis=1)
    inner = surface.vertex_label == 1
    # Decimation is asked to a twentieth of the triangles' size; it stays within a tenth of a millimetre.
    slack = 0.0 if settings is PLAIN else 0.1
    assert np.abs(radius[inner] - 12.0).max() < bound + slack
    assert np.abs(radius[~inner] - 13.0).max() < bound + slack
    true_volume = 4.0 / 3.0 * np.pi * (13.0**3 - 12.0**3)
    assert mesh.volume == pytest.approx(true_volume, rel=0.04)
    assert surface.quality["volume_ml"] == pytest.approx(mesh.volume / 1000.0, abs=1e-3)


def test_tags_and_normals_of_a_shell():
    surface = build_surface(walled(sphere(12.0), 2.0, lattice(1.5, 17.0)), COARSE)
    corner = surface.vertices_mm[surface.triangles].astype(float)
    middle = corner.mean(axis=1)
    inner = np.linalg.norm(middle, axis=1) < 13.0
    assert np.array_equal(surface.triangle_label, inner.astype(np.uint8))
    assert (surface.triangle_tissue == 2).all()
    assert not surface.triangle_is_cut.any()
    outward = middle * np.where(inner, -1.0, 1.0)[:, None]
    face = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    assert ((outward * face).sum(axis=1) > 0.0).all()
    assert np.allclose(np.linalg.norm(surface.normals, axis=1), 1.0, atol=1e-6)
    unit = surface.vertices_mm / np.linalg.norm(surface.vertices_mm, axis=1)[:, None]
    unit = unit * np.where(surface.vertex_label == 1, -1.0, 1.0)[:, None]
    # Differences over half a voxel of a field made of flat pieces one voxel long: the normal turns h / r from end to
    # end of a piece, and errs by at most half of that.
    angle = np.degrees(np.arccos(np.clip((surface.normals * unit).sum(axis=1), -1.0, 1.0)))
    assert angle.max() < np.degrees(0.5 * 1.5 * np.sqrt(3.0) / 12.0)
    assert angle.mean() < 1.5
    assert surface.render_uv.shape == (len(surface.vertices_mm), 2)
    assert not surface.render_uv.any()
    assert surface.normal_map.shape == (0, 0, 3)
    assert np.array_equal(surface.render_to_welded, np.arange(len(surface.vertices_mm)))


def test_a_torus_keeps_its_hole():
    surface = build_surface(solid(torus(12.0, 4.0), lattice(1.0, 18.0)), COARSE)
    assert_sound(surface)
    assert mesh_of(surface).euler_number == 0
    assert surface.quality["euler_characteristic"] == 0
    assert np.abs(torus(12.0, 4.0)(surface.vertices_mm.astype(float))).max() < 0.12
    # Linear interpolation draws the surface in by at most h^2 / 8 (1/minor + 1/(major + minor)).
    shrunk = 4.0 * np.pi**2 * 12.0 * 4.0 / 8.0 * (1.0 / 4.0 + 1.0 / 16.0)
    assert mesh_of(surface).volume == pytest.approx(2.0 * np.pi**2 * 12.0 * 16.0, abs=shrunk)


@pytest.mark.parametrize("direction", [np.eye(3), OBLIQUE, LEFT_HANDED])
def test_tissue_at_the_border_is_closed_by_flat_cut_faces(direction):
    def along(p):
        return tube(8.0)(p @ direction)

    geometry = lattice((1.75, 1.75, 2.0), 14.0, direction=direction, centre=(0.0, 0.0, 0.0))
    surface = build_surface(walled(along, 2.0, geometry), PLAIN)
    assert_sound(surface)
    mesh = mesh_of(surface)
    assert mesh.euler_number == 0
    cut = surface.triangle_is_cut == 1
    assert (surface.triangle_label[cut] == 0).all()
    local = geometry.world_to_index(surface.vertices_mm)
    ends = np.unique(surface.triangles[cut])
    outside = np.minimum(np.abs(local[ends, 2] + 0.5), np.abs(local[ends, 2] - geometry.size[2] + 0.5))
    assert outside.max() * 2.0 < 0.02
    ring = np.pi * (10.0**2 - 8.0**2)
    rim = 2.0 * np.pi * 18.0 * 0.5 * surface.quality["lattice_spacing_mm"][2]
    area = mesh.area_faces[cut].sum() / 2.0
    assert ring - rim < area < ring * 1.02
    assert mesh.volume == pytest.approx(ring * geometry.size[2] * 2.0, rel=0.03)
    assert set(np.unique(surface.triangle_label[~cut])) == {0, 1}


def test_the_disc_of_an_end_marker_is_a_cut_face():
    def closed(p):
        return np.maximum(tube(8.0)(p), p[..., 2] - 6.0)

    def body(p):
        return np.maximum(np.maximum(tube(10.0)(p), -tube(8.0)(p)), p[..., 2] - 6.0)

    geometry = lattice(1.0, 14.0)
    table = LabelTable(
        labels=(
            Label(value=1, name="lumen", role=Role.VESSEL_LUMEN),
            Label(value=2, name="wall", role=Role.WALL),
        )
    )
    p = points(geometry)
    fields = {1: closed(p), 2: body(p)}
    fields[0] = -np.minimum(fields[1], fields[2])
    structures = Structures(
        {value: field.astype(np.float32) for value, field in sorted(fields.items())},
        geometry,
        table,
        20.0,
        fixed_planes=(((0.0, 0.0, 6.0), (0.0, 0.0, 2.0), 12.0),),
    )
    surface = build_surface(structures, PLAIN)
    height = surface.vertices_mm[surface.triangles].mean(axis=1)[:, 2]
    at_disc = (surface.triangle_is_cut == 1) & (height > 0.0)
    assert at_disc.any()
    assert np.abs(height[at_disc] - 6.0).max() < 0.5
    assert mesh_of(surface).area_faces[at_disc].sum() > 0.5 * np.pi * (100.0 - 64.0)
    assert (surface.triangle_label[at_disc] == 0).all()


def test_specks_and_bubbles_are_left_out_and_said():
    def body(p):
        speck = np.linalg.norm(p - [14.0, 14.0, 0.0], axis=-1) - 1.5
        bubble = np.linalg.norm(p - [0.0, 0.0, 3.0], axis=-1) - 1.5
        return np.minimum(np.maximum(sphere(12.0)(p), -bubble), speck)

    everything = extract(solid(body, lattice(1.0, 18.0)))
    shells, volumes = shell_volumes(everything.vertices_mm, everything.triangles)
    assert len(volumes) == 3
    kept, dropped, opposite = drop_small_shells(
        everything, volume_mm3=20.0, fraction=0.01, opposite=opposites(everything.triangles)
    )
    np.testing.assert_array_equal(opposite, opposites(kept.triangles))
    assert len(dropped) == 2
    assert sorted(np.sign(dropped)) == [-1.0, 1.0]
    _, left = shell_volumes(kept.vertices_mm, kept.triangles)
    assert left == pytest.approx([4.0 / 3.0 * np.pi * 12.0**3], rel=0.01)
    assert shells.max() == 2
    tiny = solid(
        lambda p: np.minimum(sphere(12.0)(p), np.linalg.norm(p - [14.0, 14.0, 0.0], axis=-1) - 0.9), lattice(1.0, 18.0)
    )
    said = build_surface(tiny, PLAIN)
    assert said.quality["component_count"] == 1
    assert said.quality["dropped_shell_count"] == 1
    assert not any("not shown" in line.text for line in said.warnings)
    # Seven balls of 4 mm3 each: together more than 20 mm3.
    places = np.array([(x, y, z) for x in (-14, 14) for y in (-14, 14) for z in (-8, 8)][:7], dtype=float)
    many = solid(
        lambda p: np.minimum(sphere(12.0)(p), np.linalg.norm(p[..., None, :] - places, axis=-1).min(axis=-1) - 1.2),
        lattice(0.75, 18.0),
    )
    said = build_surface(many, PLAIN)
    assert said.quality["dropped_shell_count"] == 7
    assert said.quality["dropped_volume_mm3"] > 20.0
    assert any(line.text.startswith("7 tiny loose bits") for line in said.warnings)


def test_noise_is_closed_and_manifold_at_every_triangle_count():
    noise = np.random.default_rng(5).standard_normal((14, 14, 14)).astype(np.float32)
    geometry = lattice(1.0, 7.0)
    table = LabelTable(labels=(Label(value=1, name="muscle", role=Role.MYOCARDIUM),))
    mesh = extract(Structures({0: -noise, 1: noise}, geometry, table, 20.0))
    for count in (len(mesh.triangles), len(mesh.triangles) // 3, 100):
        vertices, triangles, source = decimate(
            mesh.vertices_mm, mesh.triangles, np.zeros(len(mesh.triangles), int), triangle_count=count
        )
        assert mesh_defects(vertices, triangles).is_clean
        check = trimesh.Trimesh(vertices, triangles, process=False)
        assert check.is_watertight
        assert check.is_winding_consistent
        assert check.euler_number == trimesh.Trimesh(mesh.vertices_mm, mesh.triangles, process=False).euler_number
        assert len(source) == len(triangles)


def test_decimation_keeps_tag_borders_and_the_true_surface():
    mesh = extract(solid(sphere(15.0), lattice(1.0, 18.0)))
    middle = mesh.vertices_mm[mesh.triangles].mean(axis=1)
    tags = (middle[:, 2] > 3.0).astype(int)
    vertices, triangles, source = decimate(mesh.vertices_mm, mesh.triangles, tags, triangle_count=1500)
    assert len(triangles) == 1500
    assert np.abs(np.linalg.norm(vertices, axis=1) - 15.0).max() < 0.12
    new_tags = tags[source]
    owners: dict[tuple[int, int], set[int]] = {}
    for tag, triangle in zip(new_tags, triangles, strict=True):
        for a, b in ((0, 1), (1, 2), (2, 0)):
            owners.setdefault(tuple(sorted((int(triangle[a]), int(triangle[b])))), set()).add(int(tag))
    border = np.unique([edge for edge, found in owners.items() if len(found) == 2])
    assert len(border) > 20
    # The border of the full mesh zigzags by one triangle, 1 mm; the decimated one stays within that.
    assert np.abs(vertices[border, 2] - 3.0).max() < 1.2


def test_folds_are_relaxed():
    ball = trimesh.creation.icosphere(subdivisions=3, radius=10.0)
    vertices = np.array(ball.vertices)
    triangles = np.array(ball.faces, dtype=np.int32)
    assert not folded_triangles(vertices, triangles).any()
    neighbour = ball.vertex_neighbors[200][0]
    vertices[200] += 2.2 * (vertices[neighbour] - vertices[200])
    assert folded_triangles(vertices, triangles).any()
    mended, moved, pairs = relax_folds(vertices, triangles, reach_mm=3.0)
    assert len(pairs) == 0
    assert not folded_triangles(mended, triangles).any()
    assert 0 < moved < 40
    still = np.linalg.norm(mended - vertices, axis=1) == 0.0
    assert still.sum() == len(vertices) - moved


def test_distance_to_a_mesh_matches_an_independent_library():
    import pyvista as pv

    rng = np.random.default_rng(3)
    ball = trimesh.creation.icosphere(subdivisions=2, radius=5.0)
    queries = rng.uniform(-9.0, 9.0, (500, 3))
    ours = mesh_distance_mm(queries, triangle_grid(np.array(ball.vertices), np.array(ball.faces, dtype=np.int32)))
    mesh = pv.PolyData.from_regular_faces(np.array(ball.vertices), np.array(ball.faces))
    _, closest = mesh.find_closest_cell(queries, return_closest_point=True)
    assert ours == pytest.approx(np.linalg.norm(queries - closest, axis=1), abs=1e-5)


def test_the_lattice_is_fine_enough_for_the_thinnest_wall_and_capped():
    structures = walled(sphere(12.0), 1.0, lattice((1.0, 1.75, 3.0), 16.0))
    fine, is_capped = extraction_lattice(structures)
    assert max(fine.spacing_mm) <= 0.6
    assert not is_capped
    outer = (
        structures.geometry.index_to_world([-0.5] * 3),
        structures.geometry.index_to_world(np.array(structures.geometry.size) - 0.5),
    )
    assert fine.index_to_world([-0.5] * 3) == pytest.approx(outer[0])
    assert fine.index_to_world(np.array(fine.size) - 0.5) == pytest.approx(outer[1])
    coarse, is_capped = extraction_lattice(structures, point_cap=20_000)
    assert is_capped
    assert np.prod(coarse.size) <= 20_000
    assert coarse.index_to_world([-0.5] * 3) == pytest.approx(outer[0])


def test_the_same_bytes_at_one_and_two_threads():
    structures = walled(sphere(9.0), 1.5, lattice(1.75, 12.5))
    settings = SurfaceSettings(triangle_count=3000, normal_map_size=128)
    before = numba.get_num_threads()
    found = []
    try:
        for threads in (1, 2):
            numba.set_num_threads(min(threads, before))
            found.append(build_surface(structures, settings))
    finally:
        numba.set_num_threads(before)
    for name in vars(found[0]):
        one, two = (getattr(surface, name) for surface in found)
        assert one.tobytes() == two.tobytes() if isinstance(one, np.ndarray) else one == two


def test_no_tissue_is_one_clear_error():
    with pytest.raises(StageError, match="no tissue"):
        build_surface(solid(lambda p: np.full(p.shape[:-1], 5.0), lattice(2.0, 6.0)), PLAIN)


def test_a_map_too_small_for_its_charts_is_one_clear_error():
    with pytest.raises(StageError, match="larger map"):
        build_surface(
            solid(torus(12.0, 4.0), lattice(1.0, 18.0)),
            SurfaceSettings.model_construct(triangle_count=4000, normal_map_size=8, atlas="cone"),
        )


def test_only_creases_are_smoothed_and_by_less_than_half_a_cell():
    def box(p):
        return np.abs(p @ OBLIQUE).max(axis=-1) - 8.0

    ball = extract(solid(sphere(12.0), lattice(1.0, 15.0)))
    same, moved = smooth_creases(ball, np.zeros(len(ball.vertices_mm), bool))
    assert moved == 0
    assert same is ball
    full = extract(solid(box, lattice(1.0, 15.0)))
    smooth, moved = smooth_creases(full, np.zeros(len(full.vertices_mm), bool))
    way = np.linalg.norm(smooth.vertices_mm - full.vertices_mm, axis=1)
    assert 0 < moved < len(way) / 2
    assert way.max() <= 0.5 + 1e-9
    # Two rings of cells around the edges of the box.
    inside = np.sort(8.0 - np.abs(full.vertices_mm @ OBLIQUE), axis=1)
    assert inside[way > 0.0, 1].max() < 3.5
    _, before = shell_volumes(full.vertices_mm, full.triangles)
    _, after = shell_volumes(smooth.vertices_mm, smooth.triangles)
    assert after == pytest.approx(before, rel=0.005)


@pytest.mark.parametrize("count", [250, *(pytest.param(count, marks=pytest.mark.slow) for count in (300, 350))])
@pytest.mark.thorough
def test_sheets_that_so_few_triangles_would_cross_get_more_of_them(count):
    # two curved sheets 0.8 mm apart, which so few triangles are too coarse for
    def sheets(p):
        r = np.linalg.norm(p, axis=-1)
        return np.minimum(np.abs(r - 10.0) - 0.8, np.abs(r - 12.4) - 0.8)

    full = extract(solid(sheets, lattice(0.5, 15.0)))
    tags = np.zeros(len(full.triangles), int)
    plain, faces, _ = decimate(full.vertices_mm, full.triangles, tags, triangle_count=count)
    assert len(self_intersections(plain, faces)) > 0
    sound = decimate_soundly(full.vertices_mm, full.triangles, tags, triangle_count=count, reach_mm=0.3)
    assert len(sound.crossing_pairs) == len(self_intersections(sound.vertices_mm, sound.triangles)) == 0
    assert folded_triangles(sound.vertices_mm, sound.triangles).sum() == 0
    assert sound.care_rounds > 0
    if count == 300:
        assert len(sound.triangles) < 2.5 * count


@pytest.mark.parametrize("seed", [18, 25])
def test_a_neck_of_one_cell_is_no_fold(seed):
    # in these hearts smoothing alone leaves a fold
    heart = random_heart(seed)
    count = heart.triangle_count
    surface = build_surface(
        heart.structures, heart.surface_settings.model_copy(update={"level_counts": (count // 3,)}), render=False
    )
    for level in (surface, *surface.levels):
        assert folded_triangles(level.vertices_mm.astype(float), level.triangles).sum() == 0
        assert_sound(level)


def test_collapsing_a_fold_takes_the_fold_and_leaves_the_rest():
    full = extract(solid(sphere(10.0), lattice(1.0, 13.0)))
    vertices = full.vertices_mm.copy()
    # one vertex pulled through the triangles on its other side
    at = int(full.triangles[500, 0])
    ring = np.unique(full.triangles[(full.triangles == at).any(axis=1)])
    far = ring[np.linalg.norm(vertices[ring] - vertices[at], axis=1).argmax()]
    vertices[at] += 1.3 * (vertices[far] - vertices[at])
    assert folded_triangles(vertices, full.triangles).sum() > 0
    smooth, triangles = without_folds(vertices, full.triangles)
    assert folded_triangles(smooth, triangles).sum() == 0
    assert len(self_intersections(smooth, triangles)) == 0
    assert mesh_defects(smooth, triangles).is_clean
    assert len(full.triangles) - 12 <= len(triangles) < len(full.triangles)


def test_parts_that_are_swept_at_the_same_time_make_as_good_a_mesh(monkeypatch):
    full = extract(solid(torus(12.0, 4.0), lattice(0.5, 18.0)))
    tags = (full.vertices_mm[full.triangles].mean(axis=1)[:, 0] > 0.0).astype(int)
    whole = triangle_grid(full.vertices_mm, full.triangles)
    errors = []
    for part_triangles in (10**9, 3000):
        monkeypatch.setattr(collapse, "PART_TRIANGLES", part_triangles)
        vertices, triangles, source = decimate(full.vertices_mm, full.triangles, tags, triangle_count=3000)
        assert mesh_defects(vertices, triangles).is_clean
        assert len(triangles) == 3000
        assert np.array_equal(source, np.unique(source))
        errors.append(mesh_distance_mm(vertices, whole).mean())
    assert errors[1] < 1.1 * errors[0]


def test_care_keeps_triangles_where_it_is_asked_for():
    full = extract(solid(sphere(10.0), lattice(1.0, 13.0)))
    tags = np.zeros(len(full.triangles), int)
    above = full.vertices_mm[:, 2] > 0.0
    care = np.where(above, 1e4, 1.0)
    shares = []
    for factor in (None, care):
        vertices, triangles, _ = decimate(full.vertices_mm, full.triangles, tags, triangle_count=600, care=factor)
        shares.append((vertices[triangles].mean(axis=1)[:, 2] > 0.0).mean())
    assert 0.4 < shares[0] < 0.6
    assert shares[1] > 0.75


def test_as_few_triangles_as_an_asked_error_takes():
    structures = solid(torus(12.0, 4.0), lattice(1.0, 18.0))
    counts = []
    for error_mm in (0.2, 0.05):
        surface = build_surface(structures, SurfaceSettings(error_mm=error_mm, normal_map_size=0))
        vertices, count = surface.vertices_mm.astype(float), len(surface.triangles)
        counts.append(count)
        assert surface.quality["distance_p99_mm"] <= error_mm
        fewer = build_surface(structures, SurfaceSettings(triangle_count=int(0.8 * count), normal_map_size=0))
        assert fewer.quality["distance_p99_mm"] > error_mm
        away = np.abs(torus(12.0, 4.0)(vertices))
        assert np.quantile(away, 0.99) < error_mm + 1.0 / 8.0 / 4.0
    assert counts[0] < counts[1]
    coarse = build_surface(structures, SurfaceSettings(error_mm=0.001, triangle_count=1000, normal_map_size=0))
    assert len(coarse.triangles) == 1000
    assert any("surface.triangle_count" in warning.text for warning in coarse.warnings)
