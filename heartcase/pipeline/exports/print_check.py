"""Checks of a model before it is 3-D printed: closed, thick enough, of one piece."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from heartcase.pipeline.exports.models import TaggedMesh
from heartcase.pipeline.mesh.decimation.decimate import mesh_defects
from heartcase.pipeline.mesh.extraction.extract import shell_volumes
from heartcase.pipeline.mesh.triangles.half_edges import connected_parts, opposites
from heartcase.pipeline.mesh.triangles.intersections import self_intersections
from heartcase.pipeline.mesh.triangles.thickness import triangle_normals, wall_thickness_mm
from heartcase.pipeline.warnings import counted
from heartcase.schemas.arrays import Float64, Int32
from heartcase.schemas.errors import StageError

__all__ = ["PrintCheck", "ThinPlaces", "check_for_printing"]

PointMm = tuple[float, float, float]

AREA_SHARE_MIN = 1e-4
"""Part of the area from which on thin places are warned of: less is the odd triangle at a sharp rim."""


@dataclass(frozen=True)
class ThinPlaces:
    """Where a model is thinner than can be printed."""

    area_fraction: float
    """Part of the area that is thinner; faces where the model was cut off do not count, nor to the whole."""
    area_cm2: float
    """That area, cm2."""
    largest_patch_cm2: float
    """Area of the largest connected thin part, cm2."""
    largest_patch_mm: PointMm
    """Middle of a triangle near the middle of that part, patient LPS, mm."""


@dataclass(frozen=True)
class PrintCheck:
    """Figures of a closed model."""

    extent_mm: PointMm
    """Size of its box along x, y, z of the patient, mm."""
    volume_ml: float
    """Volume of its material, ml."""
    piece_count: int
    """Pieces that hang together."""
    closed_hollow_count: int
    """Hollows without a way out: what supports the print stays in them."""
    self_intersection_count: int
    """Pairs of triangles that cross."""
    self_intersection_mm: PointMm | None
    """Middle of one of them, patient LPS, mm."""
    shared_edge_count: int
    """Edges that lie on each other where the model touches itself: programs that join equal corners find them."""
    min_thickness_mm: float
    """What the thickness was compared with, mm."""
    thinnest_mm: float | None
    """Least thickness at a vertex, mm; None where nothing was thin enough to be measured."""
    thinnest_at_mm: PointMm | None
    """That vertex, patient LPS, mm."""
    thin: ThinPlaces | None
    """Where it is thinner than ``min_thickness_mm``; None where it is nowhere."""

    @property
    def warnings(self) -> tuple[str, ...]:
        """What may go wrong in the print, in plain words."""
        lines = []
        if self.self_intersection_mm is not None:
            lines.append(
                f"the model passes through itself at {counted(self.self_intersection_count, 'pair')} of triangles, "
                f"one of them at {_place(self.self_intersection_mm)}: look at the slicer's preview there, or build "
                "with more triangles"
            )
        if self.shared_edge_count:
            lines.append(
                f"the model touches itself along {counted(self.shared_edge_count, 'edge')}, which some slicers call "
                "not manifold: let the slicer repair it"
            )
        if self.thin is not None and self.thin.area_fraction >= AREA_SHARE_MIN:
            assert self.thinnest_mm is not None
            assert self.thinnest_at_mm is not None
            percent = 100.0 * self.thin.area_fraction
            lines.append(
                f"{percent:{'.0f' if percent >= 10.0 else '.2g'}}% of the surface ({self.thin.area_cm2:.1f} cm2) is "
                f"thinner than {self.min_thickness_mm:g} mm and may break or not be printed: thinnest "
                f"{self.thinnest_mm:.2f} mm at {_place(self.thinnest_at_mm)}, the largest such place "
                f"({self.thin.largest_patch_cm2:.1f} cm2) around {_place(self.thin.largest_patch_mm)}"
            )
        if self.piece_count > 1:
            lines.append(f"the model is {counted(self.piece_count, 'separate piece')}, which will come apart")
        if self.closed_hollow_count:
            lines.append(
                f"the model has {counted(self.closed_hollow_count, 'hollow')} without a way out, and support, resin "
                "or powder stays inside: say in the recipe where vessels are cut open ([[ends]]), or cut the model in "
                "the slicer"
            )
        return tuple(lines)


def check_for_printing(mesh: TaggedMesh, *, min_thickness_mm: float) -> PrintCheck:
    """Check a model before it is written for a printer.

    Parameters
    ----------
    mesh
        The model.
    min_thickness_mm
        The least thickness that can be printed, mm.

    Returns
    -------
    PrintCheck
        Thickness is that of :mod:`heartcase.pipeline.mesh.triangles.thickness`.

    Raises
    ------
    StageError
        The model is empty, not closed (an edge does not have just one triangle on each side) or turned inside out.
    """
    vertices, triangles = mesh.vertices_mm.astype(np.float64), mesh.triangles
    defects = mesh_defects(vertices, triangles)
    gaps = defects["open_edge_count"] + defects["non_manifold_edge_count"]
    if not len(triangles):
        raise StageError("the surface has no triangles: build the case again", place="surface")
    if gaps:
        raise StageError(
            f"the surface is not closed at {gaps} edges, so nothing can be printed from it: build the case again",
            place="surface",
        )
    opposite = opposites(triangles)
    _, volumes = shell_volumes(vertices, triangles, opposite=opposite)
    if volumes.sum() <= 0.0:
        raise StageError("the surface is turned inside out: build the case again", place="surface")
    crossing = self_intersections(vertices, triangles)
    thickness = wall_thickness_mm(
        vertices, triangles, normals=mesh.normals, triangle_is_cut=mesh.triangle_is_cut
    ).astype(np.float64)
    measured = np.isfinite(thickness)
    thinnest = int(np.argmin(np.where(measured, thickness, np.inf))) if measured.any() else None
    return PrintCheck(
        extent_mm=_point(vertices.max(axis=0) - vertices.min(axis=0)),
        volume_ml=float(volumes.sum()) / 1000.0,
        piece_count=int((volumes > 0.0).sum()),
        closed_hollow_count=int((volumes < 0.0).sum()),
        self_intersection_count=len(crossing),
        self_intersection_mm=_point(vertices[triangles[crossing[0, 0]]].mean(axis=0)) if len(crossing) else None,
        shared_edge_count=_shared_edges(vertices, triangles),
        min_thickness_mm=min_thickness_mm,
        thinnest_mm=None if thinnest is None else float(thickness[thinnest]),
        thinnest_at_mm=None if thinnest is None else _point(vertices[thinnest]),
        thin=_thin_places(mesh, thickness, min_thickness_mm, opposite),
    )


def _thin_places(mesh: TaggedMesh, thickness: Float64, least: float, opposite: Int32) -> ThinPlaces | None:
    _, area = triangle_normals(mesh.vertices_mm, mesh.triangles)
    counts = ~mesh.triangle_is_cut.astype(bool)
    # NaN, thicker than is measured, is not less than anything
    thin = counts & (thickness[mesh.triangles].mean(axis=1) < least)
    if not thin.any():
        return None
    part, _ = connected_parts(thin.astype(np.int64), opposite)
    patches = np.bincount(part[thin], weights=area[thin])
    largest = int(np.argmax(patches))
    members = np.flatnonzero(thin & (part == largest))
    centres = mesh.vertices_mm[mesh.triangles[members]].astype(np.float64).mean(axis=1)
    middle = np.average(centres, axis=0, weights=area[members])
    nearest = centres[np.argmin(np.linalg.norm(centres - middle, axis=1))]
    return ThinPlaces(
        area_fraction=float(area[thin].sum() / area[counts].sum()),
        area_cm2=float(area[thin].sum()) / 100.0,
        largest_patch_cm2=float(patches[largest]) / 100.0,
        largest_patch_mm=_point(nearest),
    )


def _shared_edges(vertices: Float64, triangles: Int32) -> int:
    """Edges that more than two triangles have once vertices at the same place are one, as in every STL file."""
    places, number = np.unique(vertices, axis=0, return_inverse=True)
    if len(places) == len(vertices):
        return 0
    return mesh_defects(places, number.reshape(-1)[triangles].astype(np.int32))["non_manifold_edge_count"]


def _point(values: Float64) -> PointMm:
    return float(values[0]), float(values[1]), float(values[2])


def _place(point: PointMm) -> str:
    return "({:.1f}, {:.1f}, {:.1f}) mm".format(*point)
