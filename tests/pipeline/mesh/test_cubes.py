"""Extraction: the table of cases against its rule, and the sparse field and mesh against the dense ones."""

import itertools

import numba
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage
from scipy.spatial import cKDTree
from skimage.measure import marching_cubes

from heartcase.pipeline.data import Segmentation
from heartcase.pipeline.edits.apply_edits import apply_edits
from heartcase.pipeline.fields.reader import FieldReader, ownership_at_points, ownership_on_lattice
from heartcase.pipeline.mesh.decimation.decimate import mesh_defects
from heartcase.pipeline.mesh.extraction.extract import extraction_lattice, shell_volumes
from heartcase.pipeline.mesh.extraction.marching_cubes import ROOT_MARGIN, padded_field, triangulated_border
from heartcase.pipeline.mesh.extraction.marching_cubes_cases import cube_cases, edge_corners
from heartcase.pipeline.walls.grow_walls import grow_walls
from heartcase.schemas.geometry import Geometry
from heartcase.schemas.labels import Label, LabelTable, Role
from heartcase.schemas.recipe.edit_settings import SeptalDefect
from heartcase.schemas.recipe.settings import WallsSettings
from tests.pipeline.solids import LEFT_HANDED, OBLIQUE, helix, lattice, solid, sphere, torus, walled

TABLE = LabelTable(
    labels=(
        Label(value=1, name="one", role=Role.BLOOD, wall_thickness_mm=1.2),
        Label(value=2, name="muscle", role=Role.MYOCARDIUM),
        Label(value=3, name="two", role=Role.BLOOD, wall_thickness_mm=2.5),
    )
)


def dense(reader, grid):
    """The whole field: mirrored to the positive around the volume, and nowhere nearer to zero than the margin."""
    field = np.pad(ownership_on_lattice(reader, grid).tissue_mm, 1, mode="edge")
    for axis, end in itertools.product(range(3), (0, -1)):
        layer = np.moveaxis(field, axis, 0)[end]
        np.abs(layer, out=layer)
    least = np.float32(ROOT_MARGIN * min(grid.spacing_mm))
    near = np.abs(field) < least
    field[near] = np.where(field[near] < 0.0, -least, least)
    return field


def rough_structures(seed, *, spacing_mm=(1.5, 2.0, 1.2), with_defect=False):
    """Labels of smoothed noise on a turned lattice, with walls, some of them cut by the volume's border."""
    random = np.random.default_rng(seed)
    noise = np.stack([ndimage.gaussian_filter(random.normal(size=(14, 16, 18)), 1.8) for _ in range(4)])
    geometry = Geometry.of(shape=noise.shape[1:], origin_mm=(4.0, -9.0, 2.0), spacing_mm=spacing_mm, direction=OBLIQUE)
    structures = grow_walls(Segmentation(noise.argmax(axis=0).astype(np.uint8), geometry, TABLE), WallsSettings(), ())
    if with_defect:
        middle = tuple(geometry.index_to_world((8.0, 8.0, 7.0)))
        axis = tuple(random.normal(size=3))
        defect = SeptalDefect(kind="septal_defect", position_mm=middle, axis=axis, diameter_mm=4.0, length_mm=9.0)
        structures = apply_edits(structures, (defect,))
    return structures


SCENES = {
    "shell": lambda: walled(sphere(12.0), 1.0, lattice((1.2, 1.5, 2.5), 17.0, direction=OBLIQUE @ LEFT_HANDED)),
    "torus": lambda: solid(torus(12.0, 4.0), lattice(1.0, 18.0)),
    "helix": lambda: solid(helix(9.0, 8.0, 2.5), lattice(1.25, 15.0)),
    **{f"rough {seed}": lambda seed=seed: rough_structures(seed, with_defect=seed % 2 == 1) for seed in range(6)},
}


@pytest.mark.parametrize("scene", SCENES)
def test_the_field_is_the_dense_one_wherever_a_lattice_edge_crosses_zero(scene):
    reader = FieldReader.of(SCENES[scene]())
    grid = extraction_lattice(reader.structures)[0]
    found, whole = padded_field(reader, grid), dense(reader, grid)
    np.testing.assert_array_equal(found.tissue_mm < 0.0, whole < 0.0)
    exact = np.abs(found.tissue_mm) < 9999.0
    np.testing.assert_array_equal(found.tissue_mm[exact], whole[exact])
    at_border = np.zeros(whole.shape, bool)
    for axis in range(3):
        low = (slice(None),) * axis + (slice(None, -1),)
        high = (slice(None),) * axis + (slice(1, None),)
        crosses = (whole[low] < 0.0) != (whole[high] < 0.0)
        at_border[low] |= crosses
        at_border[high] |= crosses
    inner = (slice(1, -1),) * 3
    assert exact[inner][at_border[inner]].mean() > 0.9  # all but what the volume's border cuts deep inside tissue
    label = np.pad(ownership_on_lattice(reader, grid).void_label, 1, mode="edge")
    np.testing.assert_array_equal(found.void_label[exact], label[exact])


@pytest.mark.parametrize("scene", SCENES)
def test_vertices_lie_on_the_root_and_the_mesh_is_that_of_a_library(scene):
    reader = FieldReader.of(SCENES[scene]())
    grid = extraction_lattice(reader.structures)[0]
    index, label, triangles = triangulated_border(reader, grid, padded_field(reader, grid))
    assert mesh_defects(index, triangles).is_clean
    fans = np.bincount(np.unique(np.sort(edges_of(triangles), axis=1), axis=0).ravel(), minlength=len(index))
    assert np.array_equal(fans, np.bincount(triangles.ravel(), minlength=len(index)))  # one fan around each vertex
    on_end = ((index < -0.25) | (index > np.array(grid.size) - 0.75)).any(axis=1)
    inside = ~on_end & (np.abs(index - np.round(index)).max(axis=1) > 1.5 * ROOT_MARGIN)
    inside &= np.abs(index - np.round(index)).max(axis=1) < 1.0 - 1.5 * ROOT_MARGIN
    value = np.abs(ownership_at_points(reader, grid.index_to_world(index[inside])).tissue_mm)
    assert np.quantile(value, 0.98) < 2e-3 * max(grid.spacing_mm)
    assert (np.abs(index[on_end] % 1.0 - 0.5).min(axis=1) < 1e-9).all()
    # the same lattice edges, a vertex on each
    zyx, faces, _, _ = marching_cubes(dense(reader, grid), 0.0, gradient_direction="ascent")
    theirs = zyx[:, ::-1] - 1.0
    away, _ = cKDTree(theirs).query(index)
    assert away.max() < 1.0
    assert abs(len(theirs) - len(index)) <= 0.002 * len(index)
    volume = shell_volumes(index, triangles)[1].sum()
    assert volume > 0.0
    assert volume == pytest.approx(shell_volumes(theirs.astype(float), faces.astype(np.int32))[1].sum(), rel=0.02)
    assert set(np.unique(label)) <= {value for value in reader.structures.values if value in (0, 1, 3)}


def edges_of(triangles):
    return np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])


def signs_mesh(signs):
    """Marching cubes by the table on a lattice of signs, in plain Python: triangles of lattice edges."""
    cases = cube_cases()
    found = []
    for k, j, i in itertools.product(*(range(n - 1) for n in signs.shape)):
        corner = [(i + (c & 1), j + (c >> 1 & 1), k + (c >> 2)) for c in range(8)]
        case = sum(1 << c for c, (x, y, z) in enumerate(corner) if signs[z, y, x])
        for triangle in cases.edges[case, : cases.triangle_count[case]]:
            found.append([tuple(corner[c] for c in edge_corners(edge)) for edge in triangle.tolist()])
    return found


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), part=st.floats(0.1, 0.9))
def test_any_pattern_of_signs_gives_a_closed_manifold_with_tissue_connected_over_edges(seed, part):
    signs = np.zeros((6, 6, 6), bool)
    signs[1:-1, 1:-1, 1:-1] = np.random.default_rng(seed).random((4, 4, 4)) < part
    mesh = signs_mesh(signs)
    if not mesh:
        return
    number = {edge: n for n, edge in enumerate(dict.fromkeys(edge for triangle in mesh for edge in triangle))}
    triangles = np.array([[number[edge] for edge in triangle] for triangle in mesh], np.int32)
    middles = np.array([np.mean(edge, axis=0) for edge in number])
    assert mesh_defects(middles, triangles).is_clean
    fans = np.bincount(np.unique(np.sort(edges_of(triangles), axis=1), axis=0).ravel(), minlength=len(middles))
    assert np.array_equal(fans, np.bincount(triangles.ravel(), minlength=len(middles)))
    # inside and outside are the signs: the mesh's winding number at the lattice points
    corner = middles[triangles]
    for z, y, x in itertools.product(range(6), repeat=3):
        a, b, c = np.moveaxis(corner - (x, y, z), 1, 0)
        la, lb, lc = (np.linalg.norm(v, axis=1) for v in (a, b, c))
        top = np.einsum("ij,ij->i", a, np.cross(b, c))
        bottom = la * lb * lc + (a * b).sum(1) * lc + (b * c).sum(1) * la + (c * a).sum(1) * lb
        assert np.arctan2(top, bottom).sum() / (2.0 * np.pi) == pytest.approx(float(signs[z, y, x]), abs=1e-6)
    # outer shells: pieces of tissue over faces and edges; inner ones: closed pieces of void over faces
    volumes = shell_volumes(middles, triangles)[1]
    assert (volumes > 0.0).sum() == ndimage.label(signs, ndimage.generate_binary_structure(3, 2))[1]
    assert (volumes < 0.0).sum() == ndimage.label(~signs)[1] - 1


def test_the_same_mesh_at_one_and_two_threads():
    reader = FieldReader.of(rough_structures(3, with_defect=True))
    grid = extraction_lattice(reader.structures)[0]
    before, found = numba.get_num_threads(), []
    try:
        for threads in (1, 2):
            numba.set_num_threads(min(threads, before))
            found.append(triangulated_border(reader, grid, padded_field(reader, grid)))
    finally:
        numba.set_num_threads(before)
    for one, two in zip(*found, strict=True):
        assert one.tobytes() == two.tobytes()
