"""The visible surface: extraction, decimation, levels of detail, texture (thesis 11.2.2).

Extract the tissue's border at full resolution, leave out specks, tag each triangle with the void beside it and the
tissue behind it, decimate, take the true normals from the fields, and make the UV atlas and the normal map. The fields
are smooth already and marching cubes' vertices lie on their root, so the mesh itself is not smoothed, and nothing
shrinks, but along creases, where marching cubes leaves saw teeth: there it is, by less than half a lattice cell.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from heartcase.pipeline.data import Structures, Surface
from heartcase.pipeline.fields.reader import FieldReader
from heartcase.pipeline.kernels.parallel import side_by_side
from heartcase.pipeline.mesh.decimation.collapse import Collapsing
from heartcase.pipeline.mesh.decimation.decimate import (
    Decimated,
    begun_decimation,
    decimate_soundly,
    folded_triangles,
    mesh_defects,
)
from heartcase.pipeline.mesh.decimation.surface_error import ERROR_QUANTILE, fewest_triangles, two_sided_distances_mm
from heartcase.pipeline.mesh.extraction.extract import (
    FullMesh,
    drop_small_shells,
    enclosed_volume_mm3,
    extract,
    shell_volumes,
    smooth_creases,
)
from heartcase.pipeline.mesh.extraction.field_normals import fitted_normals
from heartcase.pipeline.mesh.extraction.triangle_tags import TriangleTags, cut_faces, tag_keys, tag_triangles
from heartcase.pipeline.mesh.texture.atlas import Atlas, make_atlas, tangents
from heartcase.pipeline.mesh.texture.normal_map import bake_normal_map
from heartcase.pipeline.mesh.triangles.half_edges import opposites
from heartcase.pipeline.mesh.triangles.triangle_grid import TriangleGrid, triangle_grid
from heartcase.pipeline.warning_words import sentence
from heartcase.pipeline.warnings import CaseWarning, note
from heartcase.schemas.arrays import Bool, Float32, Float64, Int32, UInt8
from heartcase.schemas.bundle.surface_kinds import plain_kinds
from heartcase.schemas.recipe.settings import LEAST_MAP_SIZE, SurfaceSettings

__all__ = ["build_surface"]


SPECK_MM3 = 20.0
SPECK_FRACTION = 1e-3
SHOWN_SHARE = 1e-3
"""Triangles that are folded, without area or beyond the count asked for are warned of beyond this part of all."""


@dataclass(frozen=True)
class _Source:
    """What all levels of detail are made from."""

    structures: Structures
    reader: FieldReader
    full: FullMesh
    """Without specks, creases smoothed."""
    dropped: Float64
    """Volume of each speck, mm3."""
    creased_count: int
    mesh: TriangleGrid
    """Triangles of the full mesh."""
    volume_mm3: float
    """Volume that it encloses."""
    reach_mm: float
    """How far from the full mesh the true surface may lie."""


def build_surface(structures: Structures, settings: SurfaceSettings, *, render: bool = True) -> Surface:
    """Make the visible surface of the tissue, and its coarser levels of detail.

    Parameters
    ----------
    structures
        The fields.
    settings
        Triangle counts, size of the normal map, kind of atlas.
    render
        Whether to make the atlas and the normal map.

    Returns
    -------
    Surface
        Closed and manifold; with figures in ``quality``. Without ``render``, or with a map of size 0, render vertices
        are the welded vertices, with zero texture coordinates and tangents, and the normal map is empty. No triangle
        is a defect's rim yet (:mod:`heartcase.pipeline.checks.rims`).

    Raises
    ------
    StageError
        There is no tissue.
    """
    warnings: list[CaseWarning] = []
    reader = FieldReader.of(structures)
    whole = extract(reader)
    opposite = opposites(whole.triangles)
    full, dropped, opposite = drop_small_shells(whole, volume_mm3=SPECK_MM3, fraction=SPECK_FRACTION, opposite=opposite)
    if np.abs(dropped).sum() > SPECK_MM3:
        warnings.append(
            note(sentence("specks", bits=len(dropped), total=f"{np.abs(dropped).sum():.0f}", most=f"{SPECK_MM3:g}"))
        )
    if full.is_capped:
        warnings.append(CaseWarning(sentence("scan-too-large")))
    is_cut = cut_faces(structures, full.vertices_mm, full.triangles, full.lattice)
    still = np.zeros(len(full.vertices_mm), bool)
    still[full.triangles[is_cut]] = True
    extracted = full
    (full, creased), key = side_by_side(
        lambda: smooth_creases(extracted, still, opposite=opposite), lambda: tag_keys(extracted, is_cut, opposite)
    )
    reach = 0.5 * min(full.lattice.spacing_mm)

    def decimated(count: int, begun: Collapsing | None = None) -> Decimated:
        return decimate_soundly(
            full.vertices_mm, full.triangles, key, triangle_count=count, reach_mm=reach, opposite=opposite, begun=begun
        )

    def sorted_full() -> TriangleGrid:
        return triangle_grid(full.vertices_mm, full.triangles)

    if settings.error_mm is None:
        # only the end of the decimation leaves a thread free
        count = settings.triangle_count
        begun = begun_decimation(full.vertices_mm, full.triangles, key, count, opposite)
        coarse, mesh = side_by_side(lambda: decimated(count, begun), sorted_full)
    else:
        mesh = sorted_full()
        coarse = fewest_triangles(
            full.vertices_mm, mesh, decimated, error_mm=settings.error_mm, most=settings.triangle_count
        )
    volume_mm3 = enclosed_volume_mm3(full.vertices_mm, full.triangles)
    source = _Source(structures, reader, full, dropped, creased, mesh, volume_mm3, reach)
    size = settings.normal_map_size if render else 0
    tagged = _tagged(source, coarse)
    ended: list[BaseException] = []

    def finest() -> Surface:
        try:
            return _finished(source, tagged, settings, size)
        except BaseException as error:
            ended.append(error)
            raise

    surface, (levels, lost) = side_by_side(finest, lambda: _levels(source, tagged, settings, size, lambda: not ended))
    quality = surface.quality
    warnings += _shape_warnings(quality, settings.triangle_count)
    if settings.error_mm is not None and quality["distance_p99_mm"] > settings.error_mm:
        warnings.append(
            CaseWarning(
                sentence(
                    "surface-error",
                    triangles=quality["triangle_count"],
                    off=f"{quality['distance_p99_mm']:.2g}",
                    asked=f"{settings.error_mm:g}",
                )
            )
        )
    return replace(surface, warnings=(*warnings, *lost), levels=levels)


@dataclass(frozen=True)
class _Tagged:
    """A decimated mesh, as exactly as it is kept, and what its triangles are."""

    coarse: Decimated
    vertices_mm: Float32
    """Shape (vertex_count, 3)."""
    tags: TriangleTags
    kind: UInt8
    """Kind of each triangle, shape (triangle_count,)."""


def _tagged(source: _Source, coarse: Decimated) -> _Tagged:
    vertices_mm = coarse.vertices_mm.astype(np.float32)
    tags = tag_triangles(source.reader, vertices_mm.astype(np.float64), coarse.triangles, source.full.lattice)
    kind = plain_kinds(tags.void, tags.tissue, tags.is_cut, source.structures.table)
    return _Tagged(coarse, vertices_mm, tags, kind)


def _levels(
    source: _Source, finest: _Tagged, settings: SurfaceSettings, size: int, is_wanted: Callable[[], bool]
) -> tuple[tuple[Surface, ...], tuple[CaseWarning, ...]]:
    """Coarser levels of detail, each decimated from the one before it, and why one is left out.

    No further one is begun once they are not wanted any more.
    """
    levels: list[Surface] = []
    lost: list[CaseWarning] = []
    last = finest
    size = max(size // 2, LEAST_MAP_SIZE) if size else 0
    for count in settings.level_counts:
        triangles = last.coarse.triangles
        if count >= len(triangles) or not is_wanted():
            continue
        coarse = decimate_soundly(
            last.vertices_mm.astype(np.float64),
            triangles,
            last.kind.astype(np.int64) * 256 + last.tags.void,
            triangle_count=count,
            reach_mm=source.reach_mm,
        )
        if len(coarse.crossing_pairs):
            lost.append(note(sentence("level-left-out", triangles=count)))
        elif len(coarse.triangles) < len(triangles):
            last = _tagged(source, coarse)
            levels.append(_finished(source, last, settings, size))
    return tuple(levels), tuple(lost)


def _finished(source: _Source, tagged: _Tagged, settings: SurfaceSettings, size: int) -> Surface:
    """Normals, atlas and normal map of ``size`` texels of a decimated mesh."""
    reader, full, table = source.reader, source.full, source.structures.table
    coarse, vertices_mm, tags = tagged.coarse, tagged.vertices_mm, tagged.tags
    triangles, vertices = coarse.triangles, vertices_mm.astype(np.float64)
    normals = _vertex_normals(reader, vertices, triangles, tags.is_cut, source.reach_mm)
    identity = np.arange(len(vertices), dtype=np.int32)
    atlas, quality = side_by_side(
        lambda: (
            make_atlas(vertices, triangles, size=size, method=settings.atlas)
            if size > 0
            else Atlas(identity, triangles, np.zeros((len(vertices), 2), np.float32), 0, 0.0, 0.0)
        ),
        lambda: _quality(source, coarse, vertices, tags),
    )
    if size > 0:
        render_tangents = tangents(atlas, vertices_mm, normals)
        normal_map = bake_normal_map(
            reader,
            atlas,
            vertices_mm,
            normals,
            render_tangents,
            tags.is_cut,
            size=size,
            reach_mm=max(source.reach_mm, quality["distance_p99_mm"]),
            full=(full.vertices_mm, full.triangles, source.mesh) if settings.baker == "exact" else None,
        )
        quality |= {
            "chart_count": atlas.chart_count,
            "atlas_used": round(atlas.used, 4),
            "texels_per_mm": round(atlas.texels_per_mm, 4),
        }
    else:
        render_tangents = np.zeros((len(vertices), 4), np.float32)
        normal_map = np.zeros((0, 0, 3), np.uint8)
    return Surface(
        vertices_mm=vertices_mm,
        triangles=triangles,
        triangle_label=tags.void,
        triangle_tissue=tags.tissue,
        triangle_is_cut=tags.is_cut.astype(np.uint8),
        triangle_kind=tagged.kind,
        normals=normals,
        vertex_label=_vertex_labels(vertices, triangles, tags.void),
        table=table,
        render_to_welded=atlas.render_to_welded,
        render_triangles=atlas.triangles,
        render_uv=atlas.uv,
        render_tangents=render_tangents,
        normal_map=normal_map,
        quality=quality,
    )


def _shape_warnings(quality: dict[str, Any], asked: int) -> list[CaseWarning]:
    """What is wrong with the triangles and can be seen, or matters to who cuts the surface."""
    warnings: list[CaseWarning] = []
    count = quality["triangle_count"]
    gaps = quality["open_edge_count"] + quality["non_manifold_edge_count"]
    if gaps:
        warnings.append(CaseWarning(sentence("surface-gaps", gaps=gaps)))
    bad = quality["degenerate_triangle_count"] + quality["flipped_triangle_count"]
    if bad > SHOWN_SHARE * count:
        warnings.append(note(sentence("surface-folded", bad=bad, triangles=count)))
    crossing = quality["self_intersection_count"]
    if crossing:
        warnings.append(CaseWarning(sentence("surface-crossing", pairs=crossing)))
    if count > (1.0 + SHOWN_SHARE) * asked:
        warnings.append(note(sentence("surface-more-triangles", triangles=count, asked=asked)))
    return warnings


def _faces(vertices: Float64, triangles: Int32) -> tuple[Float64, Float64, Float64]:
    """Centre, unit normal and area of each triangle."""
    corner = vertices[triangles]
    doubled = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    length = np.linalg.norm(doubled, axis=1)
    return corner.mean(axis=1), doubled / np.maximum(length, 1e-30)[:, None], 0.5 * length


def _vertex_labels(vertices: Float64, triangles: Int32, label: UInt8) -> UInt8:
    """Label that the widest angle around each vertex has (ties: the lowest)."""
    lowest, highest = np.full(len(vertices), 255, np.uint8), np.zeros(len(vertices), np.uint8)
    for corner in range(3):
        np.minimum.at(lowest, triangles[:, corner], label)
        np.maximum.at(highest, triangles[:, corner], label)
    mixed = np.flatnonzero(lowest != highest)
    number = np.full(len(vertices), -1, np.int64)
    number[mixed] = np.arange(len(mixed))
    angle = np.zeros((len(mixed), int(label.max(initial=0)) + 1))
    for corner in range(3):
        which = np.flatnonzero(number[triangles[:, corner]] >= 0)
        at = triangles[which]
        np.add.at(angle, (number[at[:, corner]], label[which]), _angles(vertices, at, corner))
    lowest[mixed] = angle.argmax(axis=1)
    return lowest


def _angles(vertices: Float64, triangles: Int32, corner: int) -> Float64:
    """Angle of each triangle at one of its corners."""
    here = vertices[triangles[:, corner]]
    a, b = vertices[triangles[:, (corner + 1) % 3]] - here, vertices[triangles[:, (corner + 2) % 3]] - here
    cosine = (a * b).sum(axis=1) / np.maximum(np.linalg.norm(a, axis=1) * np.linalg.norm(b, axis=1), 1e-30)
    angle: Float64 = np.arccos(np.clip(cosine, -1.0, 1.0))
    return angle


def _vertex_normals(reader: FieldReader, vertices: Float64, triangles: Int32, is_cut: Bool, reach_mm: float) -> Float32:
    """Normals fitted to the field beside each vertex; of the mesh around cut faces and where the field is creased."""
    _, face, _ = _faces(vertices, triangles)
    mesh = np.zeros_like(vertices)
    for k in range(3):
        np.add.at(mesh, triangles[:, k], _angles(vertices, triangles, k)[:, None] * face)
    mesh /= np.maximum(np.linalg.norm(mesh, axis=1), 1e-30)[:, None]
    _, normal, _ = fitted_normals(reader, vertices, mesh, reach_mm=reach_mm)
    keep_mesh = (normal * mesh).sum(axis=1) < 0.5
    keep_mesh[triangles[is_cut]] = True
    normal[keep_mesh] = mesh[keep_mesh]
    return normal.astype(np.float32)


def _quality(source: _Source, coarse: Decimated, vertices: Float64, tags: TriangleTags) -> dict[str, Any]:
    structures, full = source.structures, source.full
    triangles = coarse.triangles
    _, _, area = _faces(vertices, triangles)
    both = two_sided_distances_mm(full.vertices_mm, source.mesh, vertices, triangles)
    _, volumes = shell_volumes(vertices, triangles)
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
        "creased_vertex_count": source.creased_count,
        "relaxed_vertex_count": coarse.relaxed_count,
        "care_rounds": coarse.care_rounds,
        "self_intersection_count": len(coarse.crossing_pairs),
        "euler_characteristic": len(vertices) - edges + len(triangles),
        "shell_count": len(volumes),
        "component_count": int((volumes > 0.0).sum()),
        "dropped_shell_count": len(source.dropped),
        "dropped_volume_mm3": round(float(np.abs(source.dropped).sum()), 3),
        "volume_ml": round(float(volumes.sum()) / 1000.0, 4),
        "volume_change_fraction": round(float(volumes.sum() / source.volume_mm3) - 1.0, 6),
        "distance_mean_mm": round(float(both.mean()), 5),
        "distance_p99_mm": round(float(np.quantile(both, ERROR_QUANTILE)), 5),
        "distance_max_mm": round(float(both.max()), 5),
        "cut_triangle_count": int(tags.is_cut.sum()),
        "area_cm2": areas,
    }
