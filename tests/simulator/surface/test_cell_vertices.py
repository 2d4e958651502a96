"""Vertices that follow the corners of a cell, against affine and smooth deformations and plain NumPy."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from heartcase.simulator.cutting.blade_sheet import Sheet
from heartcase.simulator.cutting.parted_lattice import part
from heartcase.simulator.surface.cell_vertices import NO_CELL_VERTICES, CellVertices
from heartcase.simulator.surface.deform import deform
from heartcase.simulator.surface_splitting.cuttable_surface import CuttableSurface
from heartcase.simulator.surface_splitting.free_parts import parts_of_lattice
from heartcase.simulator.surface_splitting.split_surface import split_surface
from tests.simulator.lattices import EPS, block, oblique_geometry, random_field
from tests.simulator.surface.test_surface import hung_surface
from tests.simulator.surface_splitting import surfaces

MODEL = block(4, 3, 2, geometry=oblique_geometry())
CORNERS = np.arange(8)[:, None] >> np.arange(3) & 1


def with_cells(model, surface, seed, reach=0.3, share=0.5):
    """A surface of which some vertices are anywhere in cells, or up to ``reach`` cells beyond."""
    rng = np.random.default_rng(seed)
    vertices = np.flatnonzero(rng.random(surface.vertex_count) < share)
    count = len(vertices)
    cells = rng.integers(model.cell_count, size=count).astype(np.int32)
    places = model.cells[cells] + rng.uniform(-reach, 1 + reach, (count, 3))
    normal = rng.normal(size=(count, 3))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    basis = np.linalg.qr(rng.normal(size=(count, 3, 3)))[0]
    found = CellVertices.of(model, vertices, cells, places, normal, basis)
    rest = surface.rest_mm.copy()
    rest[vertices] = model.geometry.index_to_world(places - 0.5)
    return replace(surface, rest_mm=rest, in_cells=found), places


def plain(model, cells, displacement):
    """Where the vertices go [cells] and their normals, in float64."""
    local, beyond = cells.local.astype(float)[:, None], cells.beyond.astype(float)
    factors = np.where(CORNERS == 1, local, 1 - local)
    signs = np.where(CORNERS == 1, 1.0, -1.0)
    u = displacement.astype(float)[cells.corners]
    moved = np.einsum("nc,ncx->nx", factors.prod(axis=2), u)
    gradient = np.empty((len(u), 3, 3))
    for axis in range(3):
        other = np.delete(factors, axis, axis=2).prod(axis=2)
        gradient[:, :, axis] = np.einsum("nc,ncx->nx", signs[:, axis] * other, u)
    deformation = np.eye(3) + gradient
    moved += np.einsum("nxy,ny->nx", gradient, beyond)
    cofactors = np.linalg.det(deformation)[:, None, None] * np.linalg.inv(deformation).transpose(0, 2, 1)
    normal = np.einsum("nxy,ny->nx", cofactors, cells.normal.astype(float))
    return moved, normal / np.linalg.norm(normal, axis=1, keepdims=True), deformation


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 2**32 - 1), st.sampled_from([0.0, 0.05, 0.3]), st.booleans())
def test_each_is_where_plain_numpy_puts_it(seed, size, tangents):
    surface, _ = with_cells(MODEL, hung_surface(MODEL, "all", seed=seed, tangents=tangents)[0], seed)
    cells, displacement = surface.in_cells, random_field(MODEL, seed, size)
    moved, normal, deformation = plain(MODEL, cells, displacement)
    now = deform(MODEL, surface, displacement)
    wanted = surface.rest_mm[cells.vertices].astype(float) + MODEL.to_mm(moved)
    np.testing.assert_allclose(now.vertices_mm[cells.vertices], wanted, atol=4 * EPS * 400)
    flat = np.abs(np.linalg.det(deformation)) > 0.05
    turned = normal @ MODEL.geometry.direction_matrix.T
    np.testing.assert_allclose(now.normals[cells.vertices][flat], turned[flat], atol=2e-4)
    others = np.setdiff1d(np.arange(surface.vertex_count), cells.vertices)
    as_hung = deform(MODEL, replace(surface, in_cells=NO_CELL_VERTICES), displacement)
    assert now.vertices_mm[others].tobytes() == as_hung.vertices_mm[others].tobytes()
    if tangents:
        # across the normal, and in the plane of both that the tangent at rest was turned to
        of_render = now.normals[surface.render_to_welded]
        across = np.einsum("rx,rx->r", of_render, now.tangents[:, :3])
        mine = np.flatnonzero(np.isin(surface.render_to_welded, cells.vertices[flat]))
        rows = np.searchsorted(cells.vertices, surface.render_to_welded[mine])
        still = np.einsum("rb,rbx->rx", surface.tangent[mine, :3], cells.basis[rows])
        # one along the normal has no way across it
        mine = mine[np.abs(np.einsum("rx,rx->r", still, cells.normal[rows])) < 0.9]
        assert np.abs(across[mine]).max(initial=0) < 1e-4
        np.testing.assert_allclose(np.linalg.norm(now.tangents[mine, :3], axis=1), 1.0, atol=1e-5)


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_affine_deformations_are_kept(seed):
    """Also beyond the cells: stretched, sheared and turned as all the tissue is."""
    surface, places = with_cells(MODEL, hung_surface(MODEL, "none", seed=seed)[0], seed, reach=0.8)
    rng = np.random.default_rng(seed)
    affine, shift = np.eye(3) + rng.normal(0, 0.2, (3, 3)), rng.normal(0, 1, 3)
    displacement = (MODEL.node_index @ (affine - np.eye(3)).T + shift).astype(np.float32)
    now = deform(MODEL, surface, displacement)
    wanted = MODEL.geometry.index_to_world(places @ affine.T + shift - 0.5)
    vertices = surface.in_cells.vertices
    np.testing.assert_allclose(now.vertices_mm[vertices], wanted, atol=2e-5 * np.abs(wanted).max())


def test_at_rest_every_bit_is_that_of_the_rest():
    surface, _ = with_cells(MODEL, hung_surface(MODEL, "flagged")[0], 3)
    now = deform(MODEL, surface, np.zeros((MODEL.node_count, 3), np.float32))
    assert now.vertices_mm.tobytes() == surface.rest_mm.tobytes()


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_where_cells_meet_both_say_the_same(seed):
    """So that neighbours along a lip stay neighbours, whichever cell each is in."""
    rng = np.random.default_rng(seed)
    keys = {tuple(cell): n for n, cell in enumerate(MODEL.cells.tolist())}
    pairs, places = [], []
    for cell, n in keys.items():
        for axis in range(3):
            beside = list(cell)
            beside[axis] += 1
            if tuple(beside) in keys:
                place = np.array(beside) + rng.uniform(0, 1, 3)
                place[axis] = beside[axis]
                pairs.append((n, keys[tuple(beside)]))
                places.append(place)
    displacement = random_field(MODEL, seed, 0.4)
    moved = []
    for cells in np.array(pairs, np.int32).T:
        some = np.zeros((len(cells), 3))
        some[:, 0] = 1
        found = CellVertices.of(MODEL, np.arange(len(cells)), cells, np.array(places), some, np.zeros((0, 3, 3)))
        moved.append(plain(MODEL, found, displacement)[0])
        template = hung_surface(MODEL, "none", count=len(cells))[0]
        shown = deform(MODEL, replace(template, in_cells=found), displacement)
        moved[-1] = (shown.vertices_mm - template.rest_mm) / MODEL.cell_mm
    np.testing.assert_allclose(moved[0], moved[1], atol=4 * EPS * 400)


@pytest.mark.parametrize("place", [1.0, 1.3, 2.0])
@pytest.mark.parametrize("radius", [3.0, 6.0])
def test_lips_bend_with_the_tissue(place, radius):
    """Two halves bent around cylinders, apart: cut faces lie where the deformation itself puts them.

    Trilinear interpolation of f is off by up to |f''| / 8 along each axis; bending to a radius of r cells has an f'' of
    1 / r along one axis, and as much between two.
    """
    model = surfaces.block((4, 3, 3))
    cuttable = CuttableSurface.of(model, surfaces.hung(model, *surfaces.box((8, 6, 6), np.array([4.0, 3.0, 3.0]))))
    sheet = Sheet.swept([[(-1, place, -1), (5, place, -1)], [(-1, place, 4), (5, place, 4)]])
    parted = part(model, [sheet], cuttable.samples())
    found = split_surface(cuttable, parted, [sheet])
    of_node = np.zeros(parted.model.node_count, int)
    of_node[parted.model.cell_corners] = parts_of_lattice(parted.model)[:, None]

    def bent(points, side):
        sign = np.where(side == 0, 1.0, -1.0)
        angle = sign * points[:, 0] / radius
        around = radius - sign * (points[:, 2] - 1.5)
        x, z = np.abs(around) * np.sin(np.abs(angle)), sign * (radius - around * np.cos(angle)) + 1.5
        return np.stack([x, points[:, 1] + 2.0 * sign, z], axis=1)

    index = parted.model.node_index.astype(float)
    displacement = (bent(index, of_node) - index).astype(np.float32)
    now = deform(parted.model, found.surface, displacement).vertices_mm
    faces = np.unique(found.surface.triangles[found.triangle_is_cut_face])
    side = of_node[found.surface.triangle_nodes[faces, 0]]
    geometry = parted.model.geometry
    at_rest = geometry.world_to_index(found.surface.rest_mm[faces].astype(float)) + 0.5
    away = geometry.world_to_index(now[faces].astype(float)) + 0.5 - bent(at_rest, side)
    assert np.linalg.norm(away, axis=1).max() < 2 / 8 / radius


@pytest.mark.parametrize("place", [1.3, 1.6, 2.4])
def test_each_follows_the_cell_that_it_lies_in(place):
    """Not a neighbour that its nodes are of too: what a cell does need not be carried on beyond it."""
    model = surfaces.block((4, 3, 3))
    cuttable = CuttableSurface.of(model, surfaces.hung(model, *surfaces.box((9, 8, 8), np.array([4.0, 3.0, 3.0]))))
    sheet = Sheet.swept([[(-1, place, -1), (5, place + 0.2, -1)], [(-1, place, 1.4), (5, place + 0.1, 1.4)]])
    found = split_surface(cuttable, part(model, [sheet], cuttable.samples()), [sheet])
    assert len(found.surface.in_cells.vertices) > 100
    assert np.abs(found.surface.in_cells.beyond).max() < 1e-6
