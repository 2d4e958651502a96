"""The surface stage: what the surgeon sees (thesis 11.2.2).

Extract the tissue's border at full resolution, leave out specks, tag each triangle with the void beside it and the
tissue behind it, decimate, take the true normals from the fields, and make the UV atlas and the normal map. The fields
are smooth already and marching cubes' vertices lie on their root, so the mesh itself is not smoothed, and nothing
shrinks, but along creases, where marching cubes leaves saw teeth: there it is, by less than half a lattice cell.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from heartcase.pipeline.cautions import note
from heartcase.pipeline.data import Structures, Surface
from heartcase.pipeline.fields import FieldReader
from heartcase.pipeline.mesh.atlas import Atlas, make_atlas, tangents
from heartcase.pipeline.mesh.decimate import Decimated, decimate_soundly, folded_triangles, mesh_defects
from heartcase.pipeline.mesh.extract import (
    FullMesh,
    drop_small_shells,
    enclosed_volume_mm3,
    extract,
    shell_volumes,
    smooth_creases,
)
from heartcase.pipeline.mesh.field_normals import fitted_normals
from heartcase.pipeline.mesh.half_edges import opposites
from heartcase.pipeline.mesh.normal_map import bake_normal_map
from heartcase.pipeline.mesh.surface_error import ERROR_QUANTILE, fewest_triangles, two_sided_distances_mm
from heartcase.pipeline.mesh.tags import TriangleTags, cut_faces, tag_keys, tag_triangles
from heartcase.schemas.settings import SurfaceSettings

__all__ = ["build_surface"]

Float32 = npt.NDArray[np.float32]
Float64 = npt.NDArray[np.float64]
Int32 = npt.NDArray[np.int32]
UInt8 = npt.NDArray[np.uint8]
Bool = npt.NDArray[np.bool_]

SPECK_MM3 = 20.0
SPECK_FRACTION = 1e-3
SHOWN_SHARE = 1e-3
"""Triangles that are folded, without area or beyond the count asked for are warned of beyond this part of all."""


def build_surface(structures: Structures, settings: SurfaceSettings, *, render: bool = True) -> Surface:
    """Make the visible surface of the tissue.

    Parameters
    ----------
    structures
        The fields.
    settings
        Triangle count, size of the normal map, kind of atlas.
    render
        Whether to make the atlas and the normal map.

    Returns
    -------
    Surface
        Closed and manifold; with figures in ``quality``. Without ``render``, or with a map of size 0, render vertices
        are the welded vertices, with zero texture coordinates and tangents, and the normal map is empty.

    Raises
    ------
    StageError
        There is no tissue.
    """
    warnings: list[str] = []
    reader = FieldReader.of(structures)
    whole = extract(reader)
    full, dropped = drop_small_shells(whole, volume_mm3=SPECK_MM3, fraction=SPECK_FRACTION)
    if np.abs(dropped).sum() > SPECK_MM3:
        warnings.append(
            note(
                f"{len(dropped)} tiny loose bits of tissue or hollows in it, {np.abs(dropped).sum():.0f} mm3 together "
                f"and none above {SPECK_MM3:g} mm3, are not shown: nothing need be done unless "
                "something that small matters"
            )
        )
    if full.is_capped:
        warnings.append("the scan is too large to show its thinnest walls in full detail: make the [region] smaller")
    opposite = opposites(full.triangles)
    is_cut = cut_faces(structures, full.vertices_mm, full.triangles, full.lattice)
    key = tag_keys(full, is_cut, opposite)
    still = np.zeros(len(full.vertices_mm), bool)
    still[full.triangles[is_cut]] = True
    full, creased = smooth_creases(full, still, opposite=opposite)
    reach = 0.5 * min(full.lattice.spacing_mm)

    def decimated(count: int) -> Decimated:
        return decimate_soundly(
            full.vertices_mm, full.triangles, key, triangle_count=count, reach_mm=reach, opposite=opposite
        )

    if settings.error_mm is None:
        coarse = decimated(settings.triangle_count)
    else:
        coarse = fewest_triangles(
            full.vertices_mm, full.triangles, decimated, error_mm=settings.error_mm, most=settings.triangle_count
        )
    triangles = coarse.triangles
    vertices_mm = coarse.vertices_mm.astype(np.float32)
    vertices = vertices_mm.astype(np.float64)
    tags = tag_triangles(reader, vertices, triangles, full.lattice)
    normals = _vertex_normals(reader, vertices, triangles, tags.is_cut, reach)
    quality = _quality(structures, whole, full, dropped, coarse, vertices, tags, creased)
    warnings += _shape_warnings(quality, settings.triangle_count)
    if settings.error_mm is not None and quality["distance_p99_mm"] > settings.error_mm:
        warnings.append(
            f"with {len(triangles)} triangles 1% of the visible surface is {quality['distance_p99_mm']:.2g} mm or more "
            f"off its full resolution, not {settings.error_mm:g} mm: allow more with surface.triangle_count"
        )
    if render and settings.normal_map_size > 0:
        atlas = make_atlas(vertices, triangles, size=settings.normal_map_size, method=settings.atlas)
        render_tangents = tangents(atlas, vertices_mm, normals)
        normal_map = bake_normal_map(
            reader,
            atlas,
            vertices_mm,
            normals,
            render_tangents,
            tags.is_cut,
            size=settings.normal_map_size,
            reach_mm=reach,
            full=(full.vertices_mm, full.triangles) if settings.baker == "exact" else None,
        )
        quality |= {
            "chart_count": atlas.chart_count,
            "atlas_used": round(atlas.used, 4),
            "texels_per_mm": round(atlas.texels_per_mm, 4),
        }
    else:
        count = len(vertices)
        identity = np.arange(count, dtype=np.int32)
        atlas = Atlas(identity, triangles, np.zeros((count, 2), np.float32), 0, 0.0, 0.0)
        render_tangents = np.zeros((count, 4), np.float32)
        normal_map = np.zeros((0, 0, 3), np.uint8)
    return Surface(
        vertices_mm=vertices_mm,
        triangles=triangles,
        triangle_label=tags.void,
        triangle_tissue=tags.tissue,
        triangle_is_cut=tags.is_cut.astype(np.uint8),
        normals=normals,
        vertex_label=_vertex_labels(len(vertices), triangles, tags.void),
        table=structures.table,
        render_to_welded=atlas.render_to_welded,
        render_triangles=atlas.triangles,
        render_uv=atlas.uv,
        render_tangents=render_tangents,
        normal_map=normal_map,
        quality=quality,
        warnings=tuple(warnings),
    )


def _shape_warnings(quality: dict[str, Any], asked: int) -> list[str]:
    """What is wrong with the triangles and can be seen, or matters to who cuts the surface."""
    warnings: list[str] = []
    count = quality["triangle_count"]
    gaps = quality["open_edge_count"] + quality["non_manifold_edge_count"]
    if gaps:
        warnings.append(
            f"the visible surface has gaps or overlaps at {gaps} places and may not cut cleanly: ask for more triangles"
        )
    bad = quality["degenerate_triangle_count"] + quality["flipped_triangle_count"]
    if bad > SHOWN_SHARE * count:
        warnings.append(
            note(
                f"{bad} of the surface's {count} triangles are folded over and may show as dark spots: ask for more "
                "triangles if they disturb"
            )
        )
    crossing = quality["self_intersection_count"]
    if crossing:
        warnings.append(
            f"the visible surface passes through itself at {crossing} pairs of triangles and may not cut or print "
            "cleanly there: ask for more triangles"
        )
    if count > (1.0 + SHOWN_SHARE) * asked:
        warnings.append(
            note(
                f"the surface has {count} triangles instead of the {asked} asked for, as fewer would break its shape: "
                "nothing need be done unless the display is slow"
            )
        )
    return warnings


def _faces(vertices: Float64, triangles: Int32) -> tuple[Float64, Float64, Float64]:
    """Centre, unit normal and area of each triangle."""
    corner = vertices[triangles]
    doubled = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    length = np.linalg.norm(doubled, axis=1)
    return corner.mean(axis=1), doubled / np.maximum(length, 1e-30)[:, None], 0.5 * length


def _vertex_labels(count: int, triangles: Int32, label: UInt8) -> UInt8:
    lowest = np.full(count, 255, np.uint8)
    for corner in range(3):
        np.minimum.at(lowest, triangles[:, corner], label)
    return lowest


def _vertex_normals(reader: FieldReader, vertices: Float64, triangles: Int32, is_cut: Bool, reach_mm: float) -> Float32:
    """Normals fitted to the field beside each vertex; of the mesh around cut faces and where the field is creased."""
    corner = vertices[triangles]
    _, face, _ = _faces(vertices, triangles)
    mesh = np.zeros_like(vertices)
    for k in range(3):
        a, b = corner[:, (k + 1) % 3] - corner[:, k], corner[:, (k + 2) % 3] - corner[:, k]
        cosine = (a * b).sum(axis=1) / np.maximum(np.linalg.norm(a, axis=1) * np.linalg.norm(b, axis=1), 1e-30)
        np.add.at(mesh, triangles[:, k], np.arccos(np.clip(cosine, -1.0, 1.0))[:, None] * face)
    mesh /= np.maximum(np.linalg.norm(mesh, axis=1), 1e-30)[:, None]
    _, normal, _ = fitted_normals(reader, vertices, mesh, reach_mm=reach_mm)
    keep_mesh = (normal * mesh).sum(axis=1) < 0.5
    keep_mesh[triangles[is_cut]] = True
    normal[keep_mesh] = mesh[keep_mesh]
    return normal.astype(np.float32)


def _quality(
    structures: Structures,
    whole: FullMesh,
    full: FullMesh,
    dropped: Float64,
    coarse: Decimated,
    vertices: Float64,
    tags: TriangleTags,
    creased: int,
) -> dict[str, Any]:
    triangles = coarse.triangles
    _, _, area = _faces(vertices, triangles)
    both = two_sided_distances_mm(full.vertices_mm, full.triangles, vertices, triangles)
    _, volumes = shell_volumes(vertices, triangles)
    full_volume = enclosed_volume_mm3(full.vertices_mm, full.triangles)
    edges = 3 * len(triangles) // 2
    names = {0: "outside", **{label.value: label.name for label in structures.table if label.value != 0}}
    areas = {
        names[int(value)]: round(float(area[(tags.void == value) & ~tags.is_cut].sum()) / 100.0, 3)
        for value in np.unique(tags.void[~tags.is_cut])
    }
    return {
        "lattice_spacing_mm": [round(float(s), 4) for s in full.lattice.spacing_mm],
        "lattice_point_count": int(np.prod(full.lattice.size)),
        "lattice_is_capped": full.is_capped,
        "full_triangle_count": len(full.triangles),
        "triangle_count": len(triangles),
        "vertex_count": len(vertices),
        **mesh_defects(vertices, triangles),
        "flipped_triangle_count": int(folded_triangles(vertices, triangles).sum()),
        "creased_vertex_count": creased,
        "relaxed_vertex_count": coarse.relaxed_count,
        "care_rounds": coarse.care_rounds,
        "self_intersection_count": len(coarse.crossing_pairs),
        "euler_characteristic": len(vertices) - edges + len(triangles),
        "shell_count": len(volumes),
        "component_count": int((volumes > 0.0).sum()),
        "dropped_shell_count": len(dropped),
        "dropped_volume_mm3": round(float(np.abs(dropped).sum()), 3),
        "volume_ml": round(float(volumes.sum()) / 1000.0, 4),
        "volume_change_fraction": round(float(volumes.sum() / full_volume) - 1.0, 6),
        "distance_mean_mm": round(float(both.mean()), 5),
        "distance_p99_mm": round(float(np.quantile(both, ERROR_QUANTILE)), 5),
        "distance_max_mm": round(float(both.max()), 5),
        "cut_triangle_count": int(tags.is_cut.sum()),
        "area_cm2": areas,
    }
