"""What must hold of surface, grid and map of any heart: 19 hearts drawn at random, and 531 more."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest
import trimesh

from heartcase.pipeline.bundle.glb import glb_bytes
from heartcase.pipeline.bundle.write_bundle import (
    BundleParts,
    BundleRecord,
    BundleSource,
    assemble_bundle,
    resolve_materials,
    write_bundle,
)
from heartcase.pipeline.cells.build_grid import build_grid
from heartcase.pipeline.cells.map_surface import map_surface
from heartcase.pipeline.cells.picking import picking_surface, split_faces
from heartcase.pipeline.data import GridMap, SimulationGrid, Surface
from heartcase.pipeline.mesh.build_surface import build_surface
from heartcase.pipeline.mesh.decimation.decimate import folded_triangles
from heartcase.pipeline.mesh.triangles.intersections import self_intersections
from heartcase.schemas.bundle.check import check_bundle
from heartcase.schemas.recipe.settings import MaterialsSettings
from tests.pipeline.random_phantoms import RandomHeart, random_heart
from tests.pipeline.sides import sides

QUICK, MANY = 2, 550
FOUND = (58, 61, 70, 72, 105, 109, 168, 175, 228, 312, 375)
"""Of the many, those that showed a fault once: tissue thinner than its samples, ends of vessels at the scan's edge, a
cell that a repair adds and that holds no tissue."""


def seeds() -> Iterator[object]:
    for seed in range(MANY):
        if seed < QUICK or seed in FOUND[::5]:
            yield seed
        else:
            yield pytest.param(seed, marks=pytest.mark.thorough if seed in FOUND else pytest.mark.slow)


every_seed = pytest.mark.parametrize("seed", list(seeds()), scope="module")


@lru_cache(maxsize=2)
def made(seed: int) -> tuple[RandomHeart, SimulationGrid, Surface, GridMap]:
    heart = random_heart(seed)
    grid = build_grid(heart.structures, heart.grid_settings, pins=heart.pins)
    surface = build_surface(heart.structures, heart.surface_settings, render=False)
    return heart, grid, surface, map_surface(surface, grid, heart.structures, heart.map_settings)


def edges_of(triangles: np.ndarray) -> np.ndarray:
    return np.concatenate([triangles[:, pair] for pair in ([0, 1], [1, 2], [2, 0])])


@every_seed
def test_the_surface_is_closed_and_manifold(seed):
    heart, _, surface, _ = made(seed)
    edges = edges_of(surface.triangles)
    ways, count = np.unique(edges, axis=0, return_counts=True)
    assert count.max() == 1, heart.words
    np.testing.assert_array_equal(ways, np.unique(edges[:, ::-1], axis=0), err_msg=heart.words)
    mesh = trimesh.Trimesh(surface.vertices_mm, surface.triangles, process=False)
    assert mesh.is_watertight, heart.words
    assert mesh.is_winding_consistent, heart.words
    assert surface.quality["non_manifold_edge_count"] == surface.quality["open_edge_count"] == 0, heart.words


@every_seed
def test_no_triangle_is_turned_over_or_passes_through_another(seed):
    heart, _, surface, _ = made(seed)
    vertices = surface.vertices_mm.astype(np.float64)
    assert folded_triangles(vertices, surface.triangles).sum() == 0, heart.words
    assert len(self_intersections(vertices, surface.triangles)) == 0, heart.words


@every_seed
def test_no_vertex_follows_what_is_beyond_a_wall_or_a_gap(seed):
    heart, grid, surface, mapped = made(seed)
    found = sides(heart.structures, surface, grid, mapped)
    assert not found.wrong.any(), (heart.words, surface.vertices_mm[found.wrong].tolist())
    assert found.inner.sum() == mapped.quality["inner_face_count"], heart.words
    assert mapped.quality["other_label_count"] == 0, heart.words


@every_seed
def test_vertices_are_near_the_triangle_that_they_follow(seed):
    heart, grid, surface, mapped = made(seed)
    corners = grid.node_positions_mm()[mapped.triangle_nodes]
    reference = np.einsum("vc,vcx->vx", mapped.weights.astype(float), corners)
    assert np.linalg.norm(reference - surface.vertices_mm, axis=1).max() < 2.0 * heart.cell_mm, heart.words


@every_seed
def test_the_picking_surface_is_closed_and_is_the_grids_boundary(seed):
    heart, grid, _, _ = made(seed)
    surface = picking_surface(grid)
    edges = edges_of(surface.triangles)
    forward, forward_count = np.unique(edges, axis=0, return_counts=True)
    backward, backward_count = np.unique(edges[:, ::-1], axis=0, return_counts=True)
    np.testing.assert_array_equal(forward, backward, err_msg=heart.words)
    np.testing.assert_array_equal(forward_count, backward_count, err_msg=heart.words)
    np.testing.assert_array_equal(surface.nodes, np.unique(grid.faces))
    np.testing.assert_array_equal(surface.nodes[surface.triangles], split_faces(grid.faces))
    corners = grid.node_positions_mm()[surface.nodes][surface.triangles]
    volume = np.einsum("tx,tx->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) / 6.0
    assert volume == pytest.approx(len(grid.cells) * grid.geometry.voxel_volume_mm3, rel=1e-6), heart.words


@every_seed
def test_topology_is_kept_or_its_loss_is_placed(seed):
    heart, grid, _, _ = made(seed)
    quality = grid.quality
    for name in ("tissue", "blood"):
        numbers = quality[f"betti_{name}"]
        places = quality["change_places_mm"][name]
        assert len(places) == min(quality[f"{name}_changes"], 100), heart.words
        assert numbers["full_resolution"] == numbers["grid"] or places, heart.words
    for name in ("blood", "tissue"):
        places = quality["change_places_mm"][name]
        if places:
            x, y, z = places[0]
            assert any(f"({x:.1f}, {y:.1f}, {z:.1f})" in warning.text for warning in grid.warnings), heart.words
            break
    assert quality["leaks_left"] == 0, heart.words


@every_seed
def test_the_case_of_it_is_sound(seed):
    """Also where vertices follow faces between cells, whose nodes are not of the boundary."""
    heart, grid, surface, mapped = made(seed)
    geometry = heart.structures.geometry
    content = assemble_bundle(
        BundleParts(
            grid=grid,
            surface=surface,
            grid_map=mapped,
            picking=picking_surface(grid),
            glbs=[glb_bytes(one) for one in (surface, *surface.levels)],
        ),
        resolve_materials(MaterialsSettings(), grid.table),
        BundleSource(geometry=geometry, sha256="0" * 64),
        BundleRecord(name="random"),
    )
    with tempfile.TemporaryDirectory() as folder:
        write_bundle(Path(folder) / "random.case", content)
        assert check_bundle(Path(folder) / "random.case") == (), heart.words
