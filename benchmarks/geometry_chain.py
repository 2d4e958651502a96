"""From labels to everything that a case shows and moves: fields, grid, surface, atlas, normal map, mapping.

Beside it the same from stock parts: ``stock`` the fastest of their kind (VTK's flying edges, fast-simplification,
xatlas with larger charts, embreex for the rays of the normal map), ``naive`` what is tried first (scikit-image's
marching cubes, VTK's quadric decimation, xatlas as it comes). Both get smoothed distances of each structure and grow
walls by them; their grid is the mean of the tissue in each cell, their mapping the nearest cell, without tags, repairs
or a choice of side: less than a case needs, in their favour.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import edt
import numpy as np
from scipy import ndimage
from scipy.spatial import cKDTree

from benchmarks.phantom_inputs import PhantomInputs, bare_truth, phantom_inputs
from benchmarks.runner.cases import MethodSkipped
from heartcase.phantom.metrics import closest_distance_mm
from heartcase.pipeline.cells.build_grid import build_grid
from heartcase.pipeline.cells.map_surface import map_surface
from heartcase.pipeline.data import Segmentation
from heartcase.pipeline.kernels.parallel import side_by_side
from heartcase.pipeline.mesh.build_surface import build_surface
from heartcase.pipeline.mesh.decimation.decimate import mesh_defects
from heartcase.pipeline.mesh.texture.atlas import Atlas, tangents
from heartcase.pipeline.mesh.triangles.intersections import self_intersections
from heartcase.pipeline.walls.grow_walls import grow_walls
from heartcase.schemas.arrays import Float32, Float64
from heartcase.schemas.recipe.settings import EndMarker, GridSettings, MapSettings, SurfaceSettings, WallsSettings

TRIANGLE_COUNT = 80_000
CELL_VOXELS = 2.7
SMOOTH_VOXELS = 0.8
RAY_MM = 1.0
SAMPLE_COUNT = 4000
END_MM = 6.0
"""Nothing is judged this near to a vessel's end: stock parts leave the ends closed."""


@dataclass(frozen=True)
class Inputs:
    """Labels as a person paints them, without grown walls, and where vessels end."""

    segmentation: Segmentation
    ends: Sequence[EndMarker]
    map_size: int
    source: PhantomInputs | None
    """The phantom whose true labels they are."""


@dataclass(frozen=True)
class Shown:
    """A textured surface."""

    vertices_mm: Float64
    triangles: Any
    normals: Any
    atlas: Atlas
    tangents: Any
    picture: Any


def prepare(params: dict[str, Any]) -> Inputs:
    map_size = params.pop("map_size", 2048)
    source = phantom_inputs(params)
    labels = Segmentation(bare_truth(source), source.truth.geometry, source.phantom.table)
    return Inputs(labels, source.phantom.ends, map_size, source)


def heartcase(inputs: Inputs, baker: Literal["quick", "exact"] = "quick") -> Shown:
    structures = grow_walls(inputs.segmentation, WallsSettings(), inputs.ends)
    settings = SurfaceSettings(
        triangle_count=TRIANGLE_COUNT, normal_map_size=inputs.map_size, baker=baker, level_counts=()
    )
    surface, grid = side_by_side(
        lambda: build_surface(structures, settings), lambda: build_grid(structures, GridSettings())
    )
    map_surface(surface, grid, structures, MapSettings())
    atlas = Atlas(surface.render_to_welded, surface.render_triangles, surface.render_uv, 0, 0.0, 0.0)
    vertices = surface.vertices_mm.astype(np.float64)
    return Shown(vertices, surface.triangles, surface.normals, atlas, surface.render_tangents, surface.normal_map)


def heartcase_exact(inputs: Inputs) -> Shown:
    return heartcase(inputs, "exact")


def stock(inputs: Inputs) -> Shown:
    import fast_simplification
    import vtk
    from vtk.util.numpy_support import numpy_to_vtk

    field, spacing, to_world = _tissue_field(inputs.segmentation)
    image = vtk.vtkImageData()
    image.SetDimensions(*field.shape[::-1])
    image.GetPointData().SetScalars(numpy_to_vtk(field.ravel()))
    contour = vtk.vtkFlyingEdges3D()
    contour.SetInputData(image)
    contour.SetValue(0, 0.0)
    contour.ComputeNormalsOff()
    smoother = vtk.vtkWindowedSincPolyDataFilter()
    smoother.SetInputConnection(contour.GetOutputPort())
    smoother.SetNumberOfIterations(30)
    smoother.SetPassBand(0.03)
    smoother.NormalizeCoordinatesOn()
    smoother.Update()
    points, faces = _mesh_of(smoother.GetOutput(), to_world)
    full = points, np.ascontiguousarray(faces[:, ::-1])  # its triangles face lower values
    points, faces = fast_simplification.simplify(full[0].astype(np.float32), full[1], target_count=TRIANGLE_COUNT)
    return _finish(inputs, field, spacing, full, (points.astype(np.float64), faces.astype(np.int32)), large_charts=True)


def naive(inputs: Inputs) -> Shown:
    import vtk
    from skimage.measure import marching_cubes
    from vtk.util.numpy_support import numpy_to_vtk, numpy_to_vtkIdTypeArray

    field, spacing, to_world = _tissue_field(inputs.segmentation)
    vertices, faces, _, _ = marching_cubes(field, 0.0, gradient_direction="ascent")
    full = to_world(vertices[:, ::-1].astype(np.float64)), faces.astype(np.int32)
    mesh, points, cells = vtk.vtkPolyData(), vtk.vtkPoints(), vtk.vtkCellArray()
    points.SetData(numpy_to_vtk(full[0]))
    cells.SetData(3, numpy_to_vtkIdTypeArray(full[1].astype(np.int64).ravel()))
    mesh.SetPoints(points)
    mesh.SetPolys(cells)
    decimator = vtk.vtkQuadricDecimation()
    decimator.SetInputData(mesh)
    decimator.SetTargetReduction(1.0 - TRIANGLE_COUNT / len(full[1]))
    decimator.Update()
    coarse = _mesh_of(decimator.GetOutput(), lambda points: points)
    return _finish(inputs, field, spacing, full, coarse, large_charts=False)


METHODS = {"heartcase": heartcase, "heartcase_exact": heartcase_exact, "stock": stock, "naive": naive}


def _tissue_field(segmentation: Segmentation) -> tuple[Float32, float, Any]:
    """Signed distance to tissue, walls included, at half the voxel spacing; the spacing; and the way to world mm."""
    geometry, table = segmentation.geometry, segmentation.table
    spacing = geometry.spacing_mm[::-1]

    def distance(values: Any) -> Any:
        mask = np.ascontiguousarray(np.isin(segmentation.labels, values))
        outside = edt.edt(~mask, anisotropy=spacing, parallel=2) - edt.edt(mask, anisotropy=spacing, parallel=2)
        smooth = ndimage.gaussian_filter(outside, SMOOTH_VOXELS, mode="nearest")
        return ndimage.zoom(smooth, 2, order=1, grid_mode=True, mode="nearest")

    blood = [label.value for label in table if label.role.is_blood]
    tissue = distance([label.value for label in table if label.role.is_tissue])
    cavities = distance(blood)
    for value in blood:
        if table[value].wall_thickness_mm > 0.0:
            tissue = np.minimum(tissue, distance([value]) - table[value].wall_thickness_mm)
    field = np.ascontiguousarray(np.maximum(tissue, -cavities), np.float32)
    # closed where the volume ends
    for axis in range(3):
        for end in (0, -1):
            layer = np.moveaxis(field, axis, 0)[end]
            np.abs(layer, out=layer)

    return field, 0.5 * geometry.spacing_mm[0], geometry.refined(2).index_to_world


def _mesh_of(data: Any, to_world: Any) -> tuple[Float64, Any]:
    from vtk.util.numpy_support import vtk_to_numpy

    points = vtk_to_numpy(data.GetPoints().GetData()).astype(np.float64)
    return to_world(points), vtk_to_numpy(data.GetPolys().GetConnectivityArray()).reshape(-1, 3).astype(np.int32)


def _finish(inputs: Inputs, field: Any, spacing: float, full: Any, coarse: Any, *, large_charts: bool) -> Shown:
    """Atlas, normal map, grid and mapping from stock parts."""
    import xatlas

    vertices, triangles = coarse
    normals = _vertex_normals(vertices, triangles)
    charts, pack, maker = xatlas.ChartOptions(), xatlas.PackOptions(), xatlas.Atlas()
    if large_charts:
        charts.max_chart_area = 2000.0
    pack.resolution, pack.padding, pack.bilinear = inputs.map_size, 4, True
    maker.add_mesh(vertices.astype(np.float32), triangles.astype(np.uint32))
    maker.generate(charts, pack)
    source, corners, uv = maker[0]
    uv = np.column_stack([uv[:, 0], 1.0 - uv[:, 1]]).astype(np.float32)
    atlas = Atlas(source.astype(np.int32), corners.astype(np.int32), uv, 0, 0.0, 0.0)
    render_tangents = tangents(atlas, vertices, normals)
    picture = _bake(inputs.map_size, atlas, vertices, normals, render_tangents, full)
    size = max(round(CELL_VOXELS * 2), 1)
    shape = [n // size * size for n in field.shape]
    blocks = (field[: shape[0], : shape[1], : shape[2]] < 0.0).reshape(
        shape[0] // size, size, shape[1] // size, size, shape[2] // size, size
    )
    cells = np.argwhere(blocks.mean(axis=(1, 3, 5)) > 0.02)[:, ::-1]
    cKDTree(cells * size * spacing).query(vertices, workers=2)
    return Shown(vertices, triangles, normals, atlas, render_tangents, picture)


def _vertex_normals(vertices: Float64, triangles: Any) -> Float64:
    """Area-weighted normals."""
    corner = vertices[triangles]
    face = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    total = np.zeros_like(vertices)
    for k in range(3):
        np.add.at(total, triangles[:, k], face)
    unit: Float64 = total / np.maximum(np.linalg.norm(total, axis=1), 1e-30)[:, None]
    return unit


def _bake(size: int, atlas: Atlas, vertices: Float64, normals: Float64, render_tangents: Any, full: Any) -> Any:
    """Normals of the full mesh, by a ray out and a ray in from every texel."""
    try:
        from embreex.mesh_construction import TriangleMesh
        from embreex.rtcore_scene import EmbreeScene
    except ImportError as error:
        raise MethodSkipped("embreex is not installed: pip install embreex") from error
    scene = EmbreeScene()
    TriangleMesh(scene, full[0].astype(np.float32), full[1].astype(np.int32))
    smooth = _vertex_normals(*full)
    texel, owner, weights = _texels(size, atlas)
    welded = atlas.render_to_welded[atlas.triangles[owner]]
    at = np.einsum("nk,nkd->nd", weights, vertices[welded])
    normal = _unit(np.einsum("nk,nkd->nd", weights, normals[welded]))
    hit = np.full(len(at), -1, np.int64)
    best = np.full(len(at), np.inf)
    for side in (1.0, -1.0):
        start = (at - side * 1e-3 * normal).astype(np.float32)
        found = scene.run(start, (side * normal).astype(np.float32), output=True)
        nearer = (found["primID"] >= 0) & (found["tfar"] < np.minimum(best, RAY_MM))
        hit[nearer], best[nearer] = found["primID"][nearer], found["tfar"][nearer]
    true = normal.copy()
    seen = np.flatnonzero(hit >= 0)
    corner = full[0][full[1][hit[seen]]]
    a, b, p = corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0], at[seen] - corner[:, 0]
    aa, ab, bb, pa, pb = ((x * y).sum(1) for x, y in ((a, a), (a, b), (b, b), (p, a), (p, b)))
    turn = np.maximum(aa * bb - ab * ab, 1e-30)
    v, w = np.clip((bb * pa - ab * pb) / turn, 0, 1), np.clip((aa * pb - ab * pa) / turn, 0, 1)
    mixed = np.stack([np.clip(1.0 - v - w, 0, 1), v, w], axis=1)
    true[seen] = _unit(np.einsum("nk,nkd->nd", mixed, smooth[full[1][hit[seen]]]))
    tangent = _unit(np.einsum("nk,nkd->nd", weights, render_tangents[atlas.triangles[owner], :3].astype(np.float64)))
    bitangent = np.cross(normal, tangent) * render_tangents[atlas.triangles[owner, 0], 3:4]
    local = np.stack([(true * axis).sum(1) for axis in (tangent, bitangent, normal)], axis=1)
    picture = np.full((size, size, 3), (128, 128, 255), np.uint8)
    picture.reshape(-1, 3)[texel] = np.round((_unit(local) + 1.0) * 127.5).astype(np.uint8)
    return picture


def _texels(size: int, atlas: Atlas) -> tuple[Any, Any, Any]:
    """Flat number, triangle and corner weights of every texel whose centre a triangle holds."""
    corner = atlas.uv[atlas.triangles].astype(np.float64) * size - 0.5
    low = np.ceil(corner.min(axis=1)).astype(np.int64)
    count = np.maximum(np.floor(corner.max(axis=1)).astype(np.int64) - low + 1, 0)
    total = count.prod(axis=1)
    owner = np.repeat(np.arange(len(corner)), total)
    rank = np.arange(len(owner)) - np.repeat(np.cumsum(total) - total, total)
    point = low[owner] + np.stack([rank % count[owner, 0], rank // count[owner, 0]], axis=1)
    a, b, p = corner[owner, 1] - corner[owner, 0], corner[owner, 2] - corner[owner, 0], point - corner[owner, 0]
    turn = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
    turn = np.where(turn == 0.0, 1.0, turn)
    v = (p[:, 0] * b[:, 1] - p[:, 1] * b[:, 0]) / turn
    w = (a[:, 0] * p[:, 1] - a[:, 1] * p[:, 0]) / turn
    keep = (v >= 0.0) & (w >= 0.0) & (v + w <= 1.0) & (point >= 0).all(axis=1) & (point < size).all(axis=1)
    weights = np.stack([1.0 - v - w, v, w], axis=1)[keep]
    return (point[:, 1] * size + point[:, 0])[keep], owner[keep], weights


def _unit(vectors: Any) -> Any:
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1), 1e-30)[..., None]


def errors(inputs: Inputs, output: Shown) -> dict[str, float]:
    """Distance to the true surface, both ways, and the angle of the shaded normal to the true one."""
    assert inputs.source is not None
    truth, ends = inputs.source.phantom.truth, inputs.ends
    voxel = min(inputs.segmentation.geometry.spacing_mm)

    def judged(points: Float64) -> Any:
        far = np.ones(len(points), bool)
        for end in ends:
            away = np.linalg.norm(points - np.array(end.position_mm), axis=1)
            axis = np.array(end.axis) / np.linalg.norm(end.axis)
            behind = (points - np.array(end.position_mm)) @ axis > -END_MM
            far &= ~(behind & (away < 4.0 * end.radius_mm + END_MM))
        index = inputs.segmentation.geometry.world_to_index(points)
        return far & (index > 1.0).all(axis=1) & (index < np.array(inputs.segmentation.geometry.size) - 2.0).all(axis=1)

    random = np.random.default_rng(1)
    corner = output.vertices_mm[output.triangles]
    area = 0.5 * np.linalg.norm(np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]), axis=1)
    chosen = random.choice(len(area), SAMPLE_COUNT, p=area / area.sum())
    weights = random.dirichlet((1.0, 1.0, 1.0), SAMPLE_COUNT)
    points = np.einsum("nk,nkd->nd", weights, corner[chosen])
    kept = judged(points)
    points, chosen, weights = points[kept], chosen[kept], weights[kept]
    there = np.abs(truth.tissue_distance(points, tolerance_mm=0.02))
    samples = truth.surface_points()
    back = closest_distance_mm(samples[judged(samples)], output.vertices_mm, output.triangles)
    both = np.concatenate([there, back]) / voxel
    step = 0.25
    gradient = np.stack(
        [truth.value(points + step * axis) - truth.value(points - step * axis) for axis in np.eye(3)], axis=1
    )
    # elsewhere the truth has an edge, and no normal
    smooth = np.linalg.norm(gradient, axis=1) > 0.9 * 2.0 * step
    true, size = _unit(gradient), output.picture.shape[0]
    welded = output.atlas.render_to_welded[output.atlas.triangles[chosen]]
    render = output.atlas.triangles[chosen]
    plain = _unit(np.einsum("nk,nkd->nd", weights, _vertex_normals(output.vertices_mm, output.triangles)[welded]))
    normal = _unit(np.einsum("nk,nkd->nd", weights, output.normals[welded].astype(np.float64)))
    tangent = _unit(np.einsum("nk,nkd->nd", weights, output.tangents[render, :3].astype(np.float64)))
    bitangent = np.cross(normal, tangent) * output.tangents[render[:, 0], 3:4]
    uv = np.einsum("nk,nkd->nd", weights, output.atlas.uv[render].astype(np.float64)) * size
    column, row = (np.clip(uv[:, k].astype(int), 0, size - 1) for k in (0, 1))
    local = output.picture[row, column].astype(np.float64) / 127.5 - 1.0
    shaded = _unit(local[:, :1] * tangent + local[:, 1:2] * bitangent + local[:, 2:] * normal)

    def degrees(found: Any) -> float:
        return float(np.degrees(np.arccos(np.clip((found * true).sum(axis=1), -1.0, 1.0)))[smooth].mean())

    return {
        "distance to the truth, mean [voxel]": float(both.mean()),
        "distance to the truth, 99% [voxel]": float(np.percentile(both, 99)),
        "shaded normal to the true one, mean [degree]": degrees(shaded),
        "without the map, area-weighted, mean [degree]": degrees(plain),
        **soundness(output),
    }


def soundness(output: Shown) -> dict[str, float]:
    """Counts of triangles and of what is wrong with them."""
    defects = mesh_defects(output.vertices_mm, output.triangles)
    return {
        "triangles [1]": float(len(output.triangles)),
        "open and non-manifold edges [1]": float(defects["open_edge_count"] + defects["non_manifold_edge_count"]),
        "pairs of triangles that cross [1]": float(len(self_intersections(output.vertices_mm, output.triangles))),
    }
