"""The lopsided tissue of the golden case: no mirror image, no swap of axes and no turned order leaves it the same.

Everything is made from whole numbers, roots and quotients, so the bytes are the same on every processor.
"""

from __future__ import annotations

from fractions import Fraction

import numpy as np

from heartcase.pipeline.bundle.glb import glb_bytes
from heartcase.pipeline.bundle.write_bundle import (
    BundleContent,
    BundleParts,
    BundleRecord,
    BundleSource,
    assemble_bundle,
)
from heartcase.pipeline.cells.build_grid import FACE_CORNERS
from heartcase.pipeline.cells.map_surface import map_surface
from heartcase.pipeline.cells.picking import picking_surface
from heartcase.pipeline.data import Scan, SimulationGrid, Surface
from heartcase.pipeline.image.scan_part import scan_part
from heartcase.schemas.bundle.format import Material, StageRecord
from heartcase.schemas.bundle.lattice import FULL_MOMENTS, cell_nodes
from heartcase.schemas.bundle.surface_kinds import plain_kinds
from heartcase.schemas.geometry import Geometry
from heartcase.schemas.labels import Label, LabelTable, Role
from heartcase.schemas.landmarks import Landmark
from heartcase.schemas.recipe.settings import MapSettings
from tests.cell_fields import structures_of_cells

__all__ = ["CASE_NAME", "LANDMARKS", "golden_content"]

CASE_NAME = "lopsided"
CASE_ID = "GOLDEN-LOPSIDED"
CELL_MM = 4.0
ORIGIN_MM = (-37.5, 12.25, 140.0)
CAVITY, MUSCLE, WALL = 1, 2, 3

LANDMARKS = ("corner", "left tip", "back tip", "head tip")
"""Four points whose tetrahedron has a positive volume in LPS; each tip lies that way from the corner."""

_STEPS = np.array([(-1, 0, 0), (1, 0, 0), (0, -1, 0), (0, 1, 0), (0, 0, -1), (0, 0, 1)])
_CAVITY_CELLS = {(1, 2, 0), (1, 2, 1), (1, 3, 0), (1, 3, 1), (2, 2, 0)}


def _direction() -> list[list[float]]:
    """The rotation of the quaternion (20, 1, -2, 3): some 21 degrees, about no axis."""
    w, x, y, z = (Fraction(n) for n in (20, 1, -2, 3))
    n = w * w + x * x + y * y + z * z
    rows = [
        [w * w + x * x - y * y - z * z, 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), w * w - x * x + y * y - z * z, 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), w * w - x * x - y * y + z * z],
    ]
    return [[float(value / n) for value in row] for row in rows]


def _cells() -> list[tuple[int, int, int]]:
    """A core of 2 x 2 x 2 cells with an arm of 4 x 2 x 1 along i, one of 1 x 3 x 2 along j, and a hook along k."""
    core = [(i, j, k) for i in (0, 1) for j in (0, 1) for k in (0, 1)]
    arm_i = [(i, j, 0) for i in (2, 3, 4, 5) for j in (0, 1)]
    arm_j = [(0, j, k) for j in (2, 3, 4) for k in (0, 1)]
    hook = [(1, 1, 2), (1, 1, 3), (2, 1, 3)]
    return sorted(core + arm_i + arm_j + hook, key=lambda c: c[::-1])


def _table() -> LabelTable:
    return LabelTable(
        labels=(
            Label(value=CAVITY, name="left ventricle", role=Role.BLOOD, colour="#d8412f"),
            Label(value=MUSCLE, name="left ventricular myocardium", role=Role.MYOCARDIUM, colour="#b5605a"),
            Label(value=WALL, name="aorta wall", role=Role.WALL, colour="#9c2940"),
        )
    )


def _grid() -> SimulationGrid:
    cells = np.array(_cells(), np.int32)
    nodes, corners = cell_nodes(cells)
    inside = {tuple(cell) for cell in cells.tolist()}
    faces, labels, owners = [], [], []
    for number, cell in enumerate(cells.tolist()):
        for step, face in zip(_STEPS.tolist(), FACE_CORNERS, strict=True):
            beside = (cell[0] + step[0], cell[1] + step[1], cell[2] + step[2])
            if beside not in inside:
                faces.append(corners[number][face])
                labels.append(CAVITY if beside in _CAVITY_CELLS else 0)
                owners.append(number)
    i, j, k = cells.T
    is_wall = (j >= 2) | (k >= 2)
    coverage = np.where(is_wall, 8 + (3 * i + 5 * j + 7 * k) % 25, 32) / np.float32(32)
    return SimulationGrid(
        geometry=Geometry.of(shape=(5, 6, 7), origin_mm=ORIGIN_MM, spacing_mm=(CELL_MM,) * 3, direction=_direction()),
        cells=cells,
        cell_coverage=coverage.astype(np.float32),
        cell_moments=_moments(cells, coverage.astype(np.float64)),
        cell_label=np.where(is_wall, WALL, MUSCLE).astype(np.uint8),
        nodes=nodes,
        fixed=((nodes[:, 0] == 0) & (nodes[:, 1] <= 1)).astype(np.uint8),
        faces=np.array(faces, np.int32),
        face_label=np.array(labels, np.uint8),
        face_cell=np.array(owners, np.int32),
        table=_table(),
    )


def _moments(cells: np.ndarray, coverage: np.ndarray) -> np.ndarray:
    """Moments of cells whose tissue fills them up to a plane, from the lower side along i, j or k in turn."""
    moments = np.tile(FULL_MOMENTS.astype(np.float64), (len(cells), 1))
    row, axis = np.arange(len(cells)), cells.sum(axis=1) % 3
    moments[row, axis] = (coverage - 1.0) / 2.0
    moments[row, 3 + axis] = (coverage**2 + 3.0 * (1.0 - coverage) ** 2) / 12.0
    return moments.astype(np.float32)


def _surface(grid: SimulationGrid) -> Surface:
    """The boundary of the cells, four triangles to a face, pushed in and made uneven."""
    corners, quads = np.unique(grid.faces, return_inverse=True)
    quads = quads.reshape(-1, 4)
    face_count = len(quads)
    # corner numbers of a face go around; its normal by the right hand is the step to the void.
    index = grid.nodes.astype(float)
    first, second = (index[grid.faces[:, n]] - index[grid.faces[:, 0]] for n in (1, 2))
    outward = np.cross(first, second)
    at_corner = np.zeros((len(corners), 3))
    np.add.at(at_corner, quads.ravel(), np.repeat(outward, 4, axis=0))
    normals = np.concatenate([at_corner, outward])
    normals /= np.sqrt((normals * normals).sum(axis=1, keepdims=True))
    places = np.concatenate([index[corners], index[grid.faces].mean(axis=1)])
    number = np.arange(len(places))
    uneven = np.stack([(7 * number) % 11, (3 * number) % 13, (5 * number) % 9], axis=1) - np.array([5, 6, 4])
    places = places - normals / 4 + uneven / 64

    centre = len(corners) + np.arange(face_count)
    around = [np.stack([quads[:, n], quads[:, (n + 1) % 4], centre], axis=1) for n in range(4)]
    triangles = np.stack(around, axis=1).reshape(-1, 3).astype(np.int32)
    triangle_label = np.repeat(grid.face_label, 4)
    triangle_tissue = np.repeat(grid.cell_label[grid.face_cell], 4)
    vertex_label = np.full(len(places), 255, np.uint8)
    np.minimum.at(vertex_label, triangles.ravel(), np.repeat(triangle_label, 3))
    world = normals @ grid.geometry.direction_matrix.T
    tangents = np.cross(world, np.roll(world, 1, axis=1) + np.array([0.5, 0.25, 0.125]))
    tangents /= np.sqrt((tangents * tangents).sum(axis=1, keepdims=True))
    welded = np.concatenate([number, number[:3]]).astype(np.int32)
    is_cut = (grid.fixed[grid.faces] == 1).all(axis=1)
    return Surface(
        vertices_mm=grid.geometry.index_to_world(places - 0.5).astype(np.float32),
        triangles=triangles,
        triangle_label=triangle_label,
        triangle_tissue=triangle_tissue,
        triangle_is_cut=np.repeat(is_cut, 4).astype(np.uint8),
        triangle_kind=plain_kinds(triangle_label, triangle_tissue, np.repeat(is_cut, 4), grid.table),
        normals=world.astype(np.float32),
        vertex_label=vertex_label,
        table=grid.table,
        render_to_welded=welded,
        render_triangles=triangles,
        render_uv=np.zeros((len(welded), 2), np.float32),
        render_tangents=np.column_stack([tangents, np.where(number % 2, -1.0, 1.0)])[welded].astype(np.float32),
        normal_map=np.zeros((0, 0, 3), np.uint8),
    )


def _landmarks(grid: SimulationGrid) -> tuple[Landmark, ...]:
    corners = ((0, 0, 0), (6, 0, 0), (0, 5, 0), (1, 1, 4))
    points = grid.geometry.index_to_world(np.array(corners) - 0.5).round(6).tolist()
    named = [
        Landmark(name=name, kind="point", points_mm=((x, y, z),))
        for name, (x, y, z) in zip(LANDMARKS, points, strict=True)
    ]
    opening = Landmark(
        name="opening", kind="ring", points_mm=((-30.5, 21.0, 141.5),), axis=(0.0, 1.0, 0.25), radius_mm=3.0
    )
    return (*named, opening)


def _scan() -> Scan:
    """A ramp along each axis: 40 units a voxel along i, 7 along j, 1 along k."""
    k, j, i = np.indices((6, 7, 8))
    geometry = Geometry.of(shape=k.shape, origin_mm=ORIGIN_MM, spacing_mm=(3.5, 3.75, 4.25), direction=_direction())
    return Scan((40 * i + 7 * j + k - 100).astype(np.float32), geometry, modality="CT")


def golden_content() -> BundleContent:
    """The golden case in memory: grid, surface, mapping, picking surface, GLB and scan."""
    grid = _grid()
    surface = _surface(grid)
    scan = _scan()
    content = assemble_bundle(
        BundleParts(
            grid=grid,
            surface=surface,
            grid_map=map_surface(surface, grid, structures_of_cells(grid, inset=0.25), MapSettings()),
            picking=picking_surface(grid),
            glbs=[glb_bytes(surface, case_id=CASE_ID)],
            scan=scan_part(scan),
        ),
        (
            Material(label=MUSCLE, youngs_modulus_kpa=30.0, density_kg_m3=1060.0),
            Material(label=WALL, youngs_modulus_kpa=75.0, density_kg_m3=1200.0),
        ),
        BundleSource(geometry=scan.geometry, sha256=scan.values_sha256),
        BundleRecord(
            name=CASE_NAME,
            case_id=CASE_ID,
            stages=(StageRecord(stage="grid", version=1, settings={}, output_sha256="0" * 64),),
            landmarks=_landmarks(grid),
        ),
    )
    manifest = content.manifest.model_copy(update={"software_version": "golden"})
    return BundleContent(manifest, content.files)
