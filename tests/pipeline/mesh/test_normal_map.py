from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from heartcase.pipeline.fields.distance import default_smoothing_mm, label_distances
from heartcase.pipeline.fields.reader import FieldReader
from heartcase.pipeline.mesh.build_surface import build_surface
from heartcase.pipeline.mesh.extraction.field_normals import rings_of, to_index_matrix
from heartcase.pipeline.mesh.texture import normal_map
from heartcase.pipeline.mesh.triangles.half_edges import opposites
from heartcase.schemas.recipe.settings import SurfaceSettings
from tests.pipeline.solids import (
    LEFT_HANDED,
    OBLIQUE,
    bump_normals,
    bumps,
    lattice,
    points,
    solid,
    sphere,
    torus,
    walled,
)


def samples(surface, count):
    """Points on random triangles: triangle, weights and texture coordinates."""
    rng = np.random.default_rng(11)
    corner = surface.vertices_mm[surface.triangles].astype(float)
    area = np.linalg.norm(np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]), axis=1)
    triangle = rng.choice(len(area), count, p=area / area.sum())
    weights = rng.dirichlet((1.0, 1.0, 1.0), count)
    return triangle, weights


def area_weighted(surface):
    """Vertex normals of the mesh itself: what a viewer shows that is given none."""
    corner = surface.vertices_mm[surface.triangles].astype(float)
    doubled = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    normals = np.zeros(surface.vertices_mm.shape)
    for k in range(3):
        np.add.at(normals, surface.triangles[:, k], doubled)
    return unit(normals)


def mixed(weights, values):
    return np.einsum("nk,nkd->nd", weights, values.astype(float))


def unit(vectors):
    return vectors / np.linalg.norm(vectors, axis=-1)[..., None]


def shaded(surface, triangle, weights):
    """Normals as a renderer decodes them: glTF 2.0, section 3.9.3, bilinear sampling, clamped to the edge."""
    render = surface.render_triangles[triangle]
    normal = unit(mixed(weights, surface.normals[surface.triangles[triangle]]))
    tangent = unit(mixed(weights, surface.render_tangents[render][..., :3]))
    bitangent = np.cross(normal, tangent) * surface.render_tangents[render[:, 0], 3:].astype(float)
    size = len(surface.normal_map)
    place = mixed(weights, surface.render_uv[render]) * size - 0.5
    low = np.floor(place).astype(int)
    part = place - low
    texel = np.zeros((len(triangle), 3))
    for dy in (0, 1):
        for dx in (0, 1):
            weight = (part[:, 0] if dx else 1 - part[:, 0]) * (part[:, 1] if dy else 1 - part[:, 1])
            at = np.clip(low + np.array([dx, dy]), 0, size - 1)
            texel += weight[:, None] * surface.normal_map[at[:, 1], at[:, 0]]
    local = texel / 127.5 - 1.0
    return unit(local[:, :1] * tangent + local[:, 1:2] * bitangent + local[:, 2:] * normal)


def degrees(one, two):
    return np.degrees(np.arccos(np.clip((one * two).sum(axis=1), -1.0, 1.0)))


@pytest.mark.parametrize("direction", [np.eye(3), OBLIQUE @ LEFT_HANDED])
@pytest.mark.parametrize(("atlas", "baker"), [("cone", "quick"), ("cone", "exact"), ("xatlas", "quick")])
def test_the_map_beats_the_vertex_normals_against_the_truth(atlas, baker, direction):
    structures = solid(bumps, lattice(0.7, 22.0, direction=direction))
    settings = SurfaceSettings(triangle_count=3000, normal_map_size=512, atlas=atlas, baker=baker)
    surface = build_surface(structures, settings)
    triangle, weights = samples(surface, 20_000)
    at = mixed(weights, surface.vertices_mm[surface.triangles[triangle]])
    truth = bump_normals(at)
    with_map = degrees(shaded(surface, triangle, weights), truth)
    for normals in (surface.normals, area_weighted(surface)):
        without = degrees(unit(mixed(weights, normals[surface.triangles[triangle]])), truth)
        assert with_map.mean() < 0.65 * without.mean()
        assert np.quantile(with_map, 0.95) < 0.8 * np.quantile(without, 0.95)


@pytest.mark.parametrize("baker", ["quick", "exact"])
@pytest.mark.parametrize("spacing", [(1.0, 1.0, 1.0), (0.8, 0.8, 1.6)])
def test_the_map_of_labels_is_nearer_to_the_truth_than_the_mesh(baker, spacing):
    body = torus(14.0, 6.0)
    geometry = lattice(spacing, 24.0, direction=OBLIQUE)
    labels = (body(points(geometry)) < 0.0).astype(np.uint8)
    fields = label_distances(labels, spacing, smoothing_mm=default_smoothing_mm(spacing), band_mm=6.0)
    structures = replace(solid(body, geometry), distance_mm=fields, has_voxel_steps=True)
    surface = build_surface(structures, SurfaceSettings(triangle_count=4000, normal_map_size=512, baker=baker))
    triangle, weights = samples(surface, 20_000)
    at = mixed(weights, surface.vertices_mm[surface.triangles[triangle]])
    ring = at * [1.0, 1.0, 0.0]
    truth = unit(at - 14.0 * unit(ring))
    without = degrees(unit(mixed(weights, area_weighted(surface)[surface.triangles[triangle]])), truth)
    with_map = degrees(shaded(surface, triangle, weights), truth)
    assert with_map.mean() < 0.65 * without.mean()
    assert np.quantile(with_map, 0.95) < 0.8 * np.quantile(without, 0.95)


def test_charts_are_continued_into_the_gutters_and_the_rest_is_flat():
    surface = build_surface(solid(bumps, lattice(1.0, 22.0)), SurfaceSettings(triangle_count=3000, normal_map_size=256))
    assert surface.normal_map.shape == (256, 256, 3)
    texel = surface.render_uv * 256 - 0.5
    for corner in (np.floor, np.ceil):
        around = corner(texel).astype(int)
        z = surface.normal_map[around[:, 1], around[:, 0], 2].astype(float) / 127.5 - 1.0
        assert z.min() > 0.3
    length = np.linalg.norm(surface.normal_map / 127.5 - 1.0, axis=2)
    # 8 bits move a component by at most 1 / 255, and the means of neighbours in the gutters by as much again.
    assert length.max() < 1.0 + 2.0 * np.sqrt(3.0) / 255.0
    assert length.min() > 0.7


def test_cut_faces_are_baked_flat():
    geometry = lattice((1.5, 1.5, 1.5), 13.0, centre=(0.0, 0.0, 0.0))
    assert points(geometry).shape[-1] == 3
    surface = build_surface(
        walled(lambda p: np.hypot(p[..., 0], p[..., 1]) - 6.0, 4.0, geometry),
        SurfaceSettings(triangle_count=4000, normal_map_size=256),
    )
    triangle, weights = samples(surface, 20_000)
    cut = surface.triangle_is_cut[triangle] == 1
    corner = surface.vertices_mm[surface.triangles[triangle[cut]]].astype(float)
    face = unit(np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]))
    assert degrees(shaded(surface, triangle[cut], weights[cut]), face).mean() < 4.0


def test_the_exact_baker_takes_the_near_side_of_a_thin_wall():
    # Its two sides are nearer to each other than the coarse triangles are to either.
    structures = walled(sphere(12.0), 1.0, lattice(0.8, 15.0))
    surface = build_surface(structures, SurfaceSettings(triangle_count=400, normal_map_size=256, baker="exact"))
    triangle, weights = samples(surface, 20_000)
    at = mixed(weights, surface.vertices_mm[surface.triangles[triangle]])
    outward = np.where(surface.triangle_label[triangle] == 0, 1.0, -1.0)[:, None] * unit(at)
    error = degrees(shaded(surface, triangle, weights), outward)
    assert error.mean() < 1.5
    assert error.max() < 15.0


def test_points_that_two_triangles_share_are_fitted_once_and_right():
    structures = solid(torus(14.0, 6.0), lattice(0.8, 24.0, direction=OBLIQUE))
    surface = build_surface(structures, SurfaceSettings(triangle_count=2500, normal_map_size=0, level_counts=()))
    corners, vertices = surface.triangles, surface.vertices_mm.astype(float)
    reader = FieldReader.of(structures)
    edge = np.linalg.norm(vertices[np.roll(corners, -1, axis=1)] - vertices[corners], axis=2).max(axis=1)
    parts = np.ceil(edge / 0.6).astype(np.int64)
    start = np.concatenate([[0], np.cumsum((parts + 1) * (parts + 2) // 2)])
    flat = np.zeros(len(corners), bool)
    known = {}
    # where every half-edge is its own opposite, no triangle gives anything to another
    for name, opposite in (("shared", opposites(corners)), ("alone", np.arange(corners.size, dtype=np.int32))):
        known[name] = np.full((int(start[-1]), 3), np.nan, np.float32)
        normal_map._fit_lattices(
            *(reader.layout, reader.tables, to_index_matrix(reader), corners, vertices, surface.normals.astype(float)),
            *(flat, opposite, parts, start, rings_of(reader), 0.4, known[name]),
        )
        normal_map._take_given(flat, opposite, parts, start, known[name])
    assert np.isfinite(known["shared"]).all()
    away = degrees(unit(known["shared"].astype(float)), unit(known["alone"].astype(float)))
    assert away.max() < 0.1
