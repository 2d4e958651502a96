from __future__ import annotations

import numpy as np
import pytest
import trimesh
from scipy import ndimage

from heartcase.pipeline.mesh.decimation.decimate import decimate
from heartcase.pipeline.mesh.extraction.extract import extract
from heartcase.pipeline.mesh.texture.atlas import make_atlas, tangents
from heartcase.schemas.errors import StageError
from tests.pipeline.solids import bumps, helix, lattice, solid, sphere, torus, walled

SOLIDS = {
    "shell": (lambda: walled(sphere(12.0), 1.5, lattice(1.75, 17.0)), 4000),
    "torus": (lambda: solid(torus(12.0, 4.0), lattice(1.0, 18.0)), 3000),
    "helix": (lambda: solid(helix(9.0, 7.0, 2.5), lattice(1.0, 18.0)), 6000),
    "bumps": (lambda: solid(bumps, lattice(1.0, 22.0)), 6000),
}


def mesh_of(name):
    make, count = SOLIDS[name]
    full = extract(make())
    vertices, triangles, _ = decimate(
        full.vertices_mm, full.triangles, np.zeros(len(full.triangles), int), triangle_count=count
    )
    return vertices, triangles


def coverage(uv, triangles, size):
    """How many triangles hold each sample well inside, by half planes in plain NumPy."""
    count = np.zeros((size, size), np.int32)
    for a, b, c in uv[triangles].astype(float) * size:
        low = np.ceil(np.minimum(np.minimum(a, b), c) - 0.5).astype(int)
        high = np.floor(np.maximum(np.maximum(a, b), c) - 0.5).astype(int)
        if (high < low).any():
            continue
        x, y = np.meshgrid(np.arange(low[0], high[0] + 1) + 0.5, np.arange(low[1], high[1] + 1) + 0.5)
        turn = np.sign((b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]))
        inside = np.ones(x.shape, bool)
        for p, q in ((a, b), (b, c), (c, a)):
            side = turn * ((q[0] - p[0]) * (y - p[1]) - (q[1] - p[1]) * (x - p[0]))
            inside &= side > 1e-3 * np.hypot(*(q - p))
        count[low[1] : high[1] + 1, low[0] : high[0] + 1] += inside
    return count


@pytest.mark.parametrize("name", SOLIDS)
def test_charts_do_not_overlap_and_keep_their_gutters(name):
    vertices, triangles = mesh_of(name)
    size = 256
    atlas = make_atlas(vertices, triangles, size=size)
    assert np.array_equal(atlas.render_to_welded[atlas.triangles], triangles)
    assert (np.diff(atlas.render_to_welded) >= 0).all()
    assert atlas.uv.min() >= 2.0 / size - 1e-6
    assert atlas.uv.max() <= 1.0 - 2.0 / size + 1e-6
    fine = coverage(atlas.uv, atlas.triangles, 8 * size)
    assert fine.max() == 1
    assert fine.mean() == pytest.approx(atlas.used, rel=0.05)
    assert atlas.used > 0.25
    # Charts at least four texels apart: growing each by less than two joins none.
    parts = len(
        trimesh.Trimesh(np.c_[atlas.uv, np.zeros(len(atlas.uv))], atlas.triangles, process=False).split(
            only_watertight=False
        )
    )
    assert parts >= atlas.chart_count
    corner = atlas.uv[atlas.triangles].astype(float)
    chart = np.unique(
        trimesh.graph.connected_component_labels(
            np.concatenate([atlas.triangles[:, :2], atlas.triangles[:, 1:]]), node_count=len(atlas.uv)
        )[atlas.triangles[:, 0]],
        return_inverse=True,
    )[1]
    owner = np.zeros((2 * size, 2 * size), np.int32)
    for number in range(chart.max() + 1):
        own = coverage(atlas.uv, atlas.triangles[chart == number], 2 * size) > 0
        reach = ndimage.binary_dilation(own, iterations=1)
        assert not owner[reach & (owner > 0)].any()
        owner[own] = number + 1
    assert np.abs(corner).max() <= 1.0


@pytest.mark.parametrize("name", SOLIDS)
def test_scale_is_uniform_and_stretch_is_bounded(name):
    vertices, triangles = mesh_of(name)
    atlas = make_atlas(vertices, triangles, size=512)
    corner, flat = vertices[triangles], atlas.uv[atlas.triangles].astype(float) * 512 / atlas.texels_per_mm
    area = 0.5 * np.linalg.norm(np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]), axis=1)
    a, b = flat[:, 1] - flat[:, 0], flat[:, 2] - flat[:, 0]
    flat_area = 0.5 * np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])
    shrunk = flat_area / area
    assert shrunk.max() < 1.001
    assert shrunk.min() > np.cos(np.radians(45.0)) - 0.001


@pytest.mark.parametrize("method", ["cone", "xatlas"])
def test_tangents_follow_u_and_bitangents_go_up_the_picture(method):
    vertices, triangles = mesh_of("torus")
    atlas = make_atlas(vertices, triangles, size=256, method=method)
    assert atlas.uv.min() >= 0.0
    assert atlas.uv.max() <= 1.0
    normals = np.array(trimesh.Trimesh(vertices, triangles, process=False).vertex_normals)
    found = tangents(atlas, vertices, normals).astype(float)
    normal = normals[atlas.render_to_welded]
    assert np.allclose(np.linalg.norm(found[:, :3], axis=1), 1.0, atol=1e-5)
    assert np.abs((found[:, :3] * normal).sum(axis=1)).max() < 1e-5
    assert set(np.unique(found[:, 3])) <= {-1.0, 1.0}
    position = vertices[atlas.render_to_welded]
    for k in range(3):
        here, there = atlas.triangles[:, k], atlas.triangles[:, (k + 1) % 3]
        way = position[there] - position[here]
        turn = (atlas.uv[there] - atlas.uv[here]).astype(float)
        bitangent = np.cross(normal[here], found[here, :3]) * found[here, 3:]
        right, up = (way * found[here, :3]).sum(axis=1), (way * bitangent).sum(axis=1)
        assert np.corrcoef(right, turn[:, 0])[0, 1] > 0.97
        assert np.corrcoef(up, -turn[:, 1])[0, 1] > 0.97


def test_the_same_atlas_twice():
    vertices, triangles = mesh_of("helix")
    one, two = (make_atlas(vertices, triangles, size=256) for _ in range(2))
    assert one.uv.tobytes() == two.uv.tobytes()
    assert one.triangles.tobytes() == two.triangles.tobytes()


def test_too_small_a_picture_is_refused():
    with pytest.raises(StageError, match="larger map"):
        make_atlas(*mesh_of("torus"), size=8)
