"""The pictures of the build report, each with its words for those who cannot see it."""

from __future__ import annotations

import base64
import io
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import numpy.typing as npt
from PIL import Image

from heartcase.pipeline.data import Scan, Segmentation, Structures, Surface
from heartcase.pipeline.fields.reader import ownership_on_lattice
from heartcase.pipeline.kernels.parallel import all_side_by_side
from heartcase.pipeline.mesh.triangles.thickness import (
    ThicknessFigures,
    thickness_figures,
    triangle_normals,
    wall_thickness_mm,
)
from heartcase.pipeline.report.histogram import Curve, histogram_picture
from heartcase.pipeline.report.montage import png_bytes
from heartcase.pipeline.report.pictures import View, coronal_plane, cutaway_picture, surface_picture
from heartcase.pipeline.report.plain_words import cardiac_phase_words
from heartcase.pipeline.report.slices import slice_pictures
from heartcase.pipeline.report.views import CutView, Place, four_chamber_view, places_of, short_axis_view
from heartcase.schemas.arrays import Float32, UInt8
from heartcase.schemas.geometry import Geometry
from heartcase.schemas.labels import LabelTable
from heartcase.schemas.landmarks import Landmark
from heartcase.schemas.recipe.settings import WallsSettings

__all__ = [
    "Picture",
    "SurfaceParts",
    "ThicknessRow",
    "embedded_picture",
    "slice_parts",
    "surface_parts",
    "surface_thickness_mm",
    "thickness_spread",
]


_VIEW_COUNT = 4
_PNG_LEVEL = 4
"""Half the time of level 6 for 4 % more bytes, with the thirteen pictures of the adult phantom's surface."""
_SIDES: dict[View, str] = {
    "anterior": "From the front",
    "posterior": "From behind",
    "left": "From the patient's left",
    "right": "From the patient's right",
    "superior": "From above",
    "inferior": "From below",
}


@dataclass(frozen=True)
class Picture:
    """One picture of the page."""

    title: str
    """Short title."""
    alt: str
    """What it shows, in words, for those who cannot see it."""
    uri: str
    """The picture itself as a ``data:`` address."""
    width: int
    """Pixels."""
    height: int
    """Pixels."""
    note: str = ""
    """What else to know of it, one or two sentences."""


@dataclass(frozen=True)
class ThicknessRow:
    """Thickness of one tissue, as measured on the surface, and as asked for."""

    figures: ThicknessFigures
    """Measured."""
    colour: str
    """``#rrggbb``."""
    wanted_mm: float | None
    """Thickness that the recipe asks for; None for tissue that was segmented, and where it varies along the vessel."""


@dataclass(frozen=True)
class SurfaceParts:
    """What the page shows of the surface; all empty for a case without one."""

    sides: Sequence[Picture] = ()
    """From all six sides."""
    views: Sequence[Picture] = ()
    """The surgeon's view, and the heart cut open."""
    without_short_axis: bool = False
    """Whether nothing tells where the short axis is."""
    thickness: Sequence[Picture] = ()
    """Thickness maps and histogram."""
    thickness_rows: Sequence[ThicknessRow] = ()
    """Thickness per tissue."""
    thickness_mm: Float32 | None = None
    """Thickness at each vertex, mm, shape (vertex_count,), for :func:`thickness_spread`."""


def slice_parts(scan: Scan, segmentation: Segmentation, structures: Structures) -> list[Picture]:
    """Draw slices of the scan with the outlines of the final structures; each row tells the cardiac phase."""
    labels = segmentation.labels
    if _is_parallel(structures.geometry, scan.geometry):
        owner = ownership_on_lattice(structures, scan.geometry)
        labels = np.where(owner.tissue_mm < 0.0, owner.tissue_label, owner.void_label)
    phase = f"Cardiac phase: {cardiac_phase_words(scan.acquisition)}"
    pictures = slice_pictures(
        scan.values, scan.geometry, labels, structures.table, modality=scan.modality, footnote=phase
    )
    return [
        embedded_picture(
            f"{stack.capitalize()} slices",
            f"Four {stack} slices of the scan with the outline of each structure in its colour. {phase}.",
            picture,
            lossy=True,
        )
        for stack, picture in pictures.items()
    ]


def _is_parallel(one: Geometry, other: Geometry) -> bool:
    return bool(np.allclose(one.direction_matrix, other.direction_matrix, atol=1e-6))


def surface_thickness_mm(surface: Surface) -> Float32:
    """Thickness of the tissue under each vertex of a surface: :func:`wall_thickness_mm`."""
    return wall_thickness_mm(
        surface.vertices_mm, surface.triangles, normals=surface.normals, triangle_is_cut=surface.triangle_is_cut
    )


def surface_parts(
    surface: Surface | None,
    landmarks: Sequence[Landmark] = (),
    walls: WallsSettings | None = None,
    septa_mm: Mapping[int, float] | None = None,
    thickness_mm: Callable[[], Float32] | None = None,
) -> SurfaceParts:
    """Draw the surface from all six sides, in the surgeon's view, cut open and by thickness; measure the thickness.

    ``walls`` are the recipe's, of which some may vary in thickness; ``septa_mm`` the thickness of each grown septum;
    ``thickness_mm`` gives :func:`surface_thickness_mm` where it is worked out already.
    """
    if surface is None or len(surface.triangles) == 0:
        return SurfaceParts()
    points, faces, tissue, table = surface.vertices_mm, surface.triangles, surface.triangle_tissue, surface.table
    mesh: dict[str, Any] = {
        "vertices_mm": points,
        "triangles": faces,
        "triangle_label": surface.triangle_label,
        "triangle_tissue": tissue,
        "table": table,
        "normals": surface.normals,
    }
    # Each is drawn by one thread, and the thickness takes longest.
    tasks: list[Callable[[], Any]] = [
        thickness_mm or partial(surface_thickness_mm, surface),
        *(partial(_side, mesh, view, title) for view, title in _SIDES.items()),
        *_views(mesh, places_of(landmarks)),
    ]
    thick, *drawn = all_side_by_side(tasks)
    sides, views = drawn[: len(_SIDES)], drawn[len(_SIDES) :]
    figures = thickness_figures(thick, points, faces, tissue, table, triangle_is_cut=surface.triangle_is_cut)
    known = thick[np.isfinite(thick)]
    colouring: dict[str, Any] = {
        "scalars": thick,
        "scalar_range": (0.0, max(1.0, float(np.ceil(np.percentile(known, 98))) if len(known) else 1.0)),
        "scalar_title": "thickness (mm)",
    }
    both: tuple[View, ...] = ("anterior", "posterior")
    maps = all_side_by_side([partial(_map, {**mesh, **colouring}, view) for view in both])
    varying = {label.value for one in (walls.thickness if walls else ()) if (label := table.find(one.label))}
    wanted = {one.label: _wanted_mm(table, one.label, varying) for one in figures} | dict(septa_mm or {})
    rows = [ThicknessRow(one, table[one.label].colour, wanted[one.label]) for one in figures]
    return SurfaceParts(sides, views, len(views) < _VIEW_COUNT, maps, rows, thick)


def thickness_spread(surface: Surface | None, shown: SurfaceParts) -> list[Picture]:
    """The histogram of the thickness; none without a surface."""
    if surface is None or shown.thickness_mm is None:
        return []
    figures = [row.figures for row in shown.thickness_rows]
    return [
        embedded_picture(
            "How the thickness is spread",
            "Histogram of the thickness over the surface, one curve per tissue. The table below gives the figures.",
            _histogram(shown.thickness_mm, surface, figures),
        )
    ]


def _side(mesh: dict[str, Any], view: View, title: str) -> Picture:
    return embedded_picture(
        title, f"The surface of the heart from the {view} side.", surface_picture(**mesh, view=view)
    )


def _map(mesh: dict[str, Any], view: View) -> Picture:
    return embedded_picture(
        _SIDES[view],
        f"The surface from the {view} side, coloured by the thickness of the tissue in mm.",
        surface_picture(**mesh, view=view),
    )


def _views(mesh: dict[str, Any], places: Mapping[str, Place]) -> list[Callable[[], Picture]]:
    """Draw the surgeon's view, the four-chamber and the short-axis cut, and a cut from the front."""
    shape = {name: mesh[name] for name in ("vertices_mm", "triangles", "triangle_label", "table")}
    marks = {place.name: place.position_mm for place in places.values()}
    front = coronal_plane(mesh["vertices_mm"], mesh["triangles"])
    cuts = (
        ("Four-chamber cut, seen from the feet", four_chamber_view(places, **shape)),
        ("Short-axis cut, seen from the apex", short_axis_view(places, **shape)),
        ("Cut from the front", CutView(front, np.array([0.0, 0.0, 1.0]), "Plane through the middle of the heart.")),
    )
    return [
        partial(_surgeons_view, mesh),
        *(partial(_cut, mesh, view, title, marks) for title, view in cuts if view is not None),
    ]


def _surgeons_view(mesh: dict[str, Any]) -> Picture:
    return embedded_picture(
        "Surgeon's view",
        "The closed heart as a surgeon sees it who stands at the patient's right side: the head is on the left.",
        surface_picture(**mesh, view="surgeon"),
        note="The patient lies on the back; the surgeon stands at the patient's right and looks down, 30 degrees from "
        "straight above. Head on the left, feet on the right, the patient's right side below.",
    )


def _cut(mesh: dict[str, Any], view: CutView, title: str, marks: Mapping[str, npt.ArrayLike]) -> Picture:
    return embedded_picture(
        title,
        f"The heart cut open, with the inner sides of the chambers and vessels, and the cut walls. {view.source}",
        cutaway_picture(**mesh, plane=view.plane, up=view.up, marks=marks),
        note=view.source,
    )


def _wanted_mm(table: LabelTable, tissue: int, varying: Collection[int]) -> float | None:
    """The one thickness that is asked for; None where there is none, or more than one."""
    cavity = table[tissue].wall_of
    return None if cavity is None or cavity in varying else table[cavity].wall_thickness_mm


def _histogram(thickness: Float32, surface: Surface, figures: Sequence[ThicknessFigures]) -> UInt8:
    """Curves of the surface's area by thickness, one per tissue."""
    _, area = triangle_normals(surface.vertices_mm, surface.triangles)
    value = thickness[surface.triangles].mean(axis=1)
    highest = max((one.p95_mm for one in figures), default=1.0) * 1.4
    edges = np.linspace(0.0, highest, 61)
    curves = []
    for one in figures:
        member = (surface.triangle_tissue == one.label) & np.isfinite(value) & (surface.triangle_is_cut == 0)
        heights, _ = np.histogram(value[member], bins=edges, weights=area[member] / 100.0)
        curves.append(Curve(one.name, surface.table[one.label].colour, heights))
    return histogram_picture(curves, edges, across="thickness (mm)", up="area of the surface (cm²)")


def embedded_picture(title: str, alt: str, pixels: UInt8, *, lossy: bool = False, note: str = "") -> Picture:
    """A picture as the page holds it: PNG, or JPEG where it may be lossy."""
    if lossy:
        stream = io.BytesIO()
        Image.fromarray(pixels).save(stream, format="JPEG", quality=88, subsampling=0)
        kind, content = "jpeg", stream.getvalue()
    else:
        kind, content = "png", png_bytes(pixels, level=_PNG_LEVEL)
    height, width = pixels.shape[:2]
    return Picture(title, alt, f"data:image/{kind};base64,{base64.b64encode(content).decode()}", width, height, note)
