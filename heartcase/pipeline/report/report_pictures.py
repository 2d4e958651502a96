"""The pictures of the build report, each with its words for those who cannot see it."""

from __future__ import annotations

import base64
import io
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from PIL import Image

from heartcase.pipeline.data import Scan, Segmentation, Structures, Surface
from heartcase.pipeline.fields import ownership_on_lattice
from heartcase.pipeline.mesh.thickness import ThicknessFigures, thickness_figures, triangle_normals, wall_thickness_mm
from heartcase.pipeline.report.montage import png_bytes
from heartcase.pipeline.report.pictures import View, coronal_plane, cutaway_picture, surface_picture
from heartcase.pipeline.report.slices import slice_pictures
from heartcase.schemas.geometry import Geometry
from heartcase.schemas.labels import LabelTable

__all__ = ["Picture", "SurfaceParts", "ThicknessRow", "slice_parts", "surface_parts"]

UInt8 = npt.NDArray[np.uint8]

_LINES = ("-", "--", ":")
_SIDES: dict[View, str] = {
    "anterior": "From the front",
    "posterior": "From behind",
    "left": "From the patient's left",
    "right": "From the patient's right",
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


@dataclass(frozen=True)
class ThicknessRow:
    """Thickness of one tissue, as measured on the surface, and as asked for."""

    figures: ThicknessFigures
    """Measured."""
    colour: str
    """``#rrggbb``."""
    wanted_mm: float | None
    """Thickness that the recipe asks for; None for tissue that was segmented."""


@dataclass(frozen=True)
class SurfaceParts:
    """What the page shows of the surface; all empty for a case without one."""

    sides: Sequence[Picture] = ()
    """From four sides."""
    cutaway: Sequence[Picture] = ()
    """Cut open."""
    thickness: Sequence[Picture] = ()
    """Thickness maps and histogram."""
    thickness_rows: Sequence[ThicknessRow] = ()
    """Thickness per tissue."""


def slice_parts(scan: Scan, segmentation: Segmentation, structures: Structures) -> list[Picture]:
    """Draw slices of the scan with the outlines of the final structures."""
    labels = segmentation.labels
    if _is_parallel(structures.geometry, scan.geometry):
        owner = ownership_on_lattice(structures, scan.geometry)
        labels = np.where(owner.tissue_mm < 0.0, owner.tissue_label, owner.void_label)
    pictures = slice_pictures(scan.values, scan.geometry, labels, structures.table, modality=scan.modality)
    return [
        _picture(
            f"{stack.capitalize()} slices",
            f"Four {stack} slices of the scan with the outline of each structure in its colour.",
            picture,
            lossy=True,
        )
        for stack, picture in pictures.items()
    ]


def _is_parallel(one: Geometry, other: Geometry) -> bool:
    return bool(np.allclose(one.direction_matrix, other.direction_matrix, atol=1e-6))


def surface_parts(surface: Surface | None) -> SurfaceParts:
    """Draw the surface from four sides, cut open and by thickness, and measure the thickness."""
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
    sides = [
        _picture(title, f"The surface of the heart from the {view} side.", surface_picture(**mesh, view=view))
        for view, title in _SIDES.items()
    ]
    cuts = [
        _picture(
            title,
            "The heart cut open: the inner sides of the chambers and vessels, and the cut walls.",
            cutaway_picture(**mesh, plane=plane),
        )
        for title, plane in (
            ("Cut through the middle of the chambers", None),
            ("Cut from the front", coronal_plane(points, faces)),
        )
    ]
    thick = wall_thickness_mm(points, faces, normals=surface.normals, triangle_is_cut=surface.triangle_is_cut)
    figures = thickness_figures(thick, points, faces, tissue, table, triangle_is_cut=surface.triangle_is_cut)
    known = thick[np.isfinite(thick)]
    colouring: dict[str, Any] = {
        "scalars": thick,
        "scalar_range": (0.0, max(1.0, float(np.ceil(np.percentile(known, 98))) if len(known) else 1.0)),
        "scalar_title": "thickness (mm)",
    }
    views: tuple[View, ...] = ("anterior", "posterior")
    maps = [
        _picture(
            _SIDES[view],
            f"The surface from the {view} side, coloured by the thickness of the tissue in mm.",
            surface_picture(**mesh, **colouring, view=view),
        )
        for view in views
    ]
    maps.append(
        _picture(
            "How the thickness is spread",
            "Histogram of the thickness over the surface, one curve per tissue. The table below gives the figures.",
            _histogram(thick, surface, figures),
        )
    )
    rows = [ThicknessRow(one, table[one.label].colour, _wanted_mm(table, one.label)) for one in figures]
    return SurfaceParts(sides, cuts, maps, rows)


def _wanted_mm(table: LabelTable, tissue: int) -> float | None:
    cavity = table[tissue].wall_of
    return table[cavity].wall_thickness_mm if cavity is not None else None


def _histogram(thickness: npt.NDArray[np.float32], surface: Surface, figures: Sequence[ThicknessFigures]) -> UInt8:
    """Curves of the surface's area by thickness, one per tissue."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8.0, 3.4), dpi=100, facecolor="white", layout="constrained")
    canvas = FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    _, area = triangle_normals(surface.vertices_mm, surface.triangles)
    value = thickness[surface.triangles].mean(axis=1)
    highest = max((one.p95_mm for one in figures), default=1.0) * 1.4
    edges = np.linspace(0.0, highest, 61)
    for n, one in enumerate(figures):
        member = (surface.triangle_tissue == one.label) & np.isfinite(value) & (surface.triangle_is_cut == 0)
        counts, _ = np.histogram(value[member], bins=edges, weights=area[member] / 100.0)
        axes.stairs(
            counts, edges, color=surface.table[one.label].colour, linewidth=1.8, linestyle=_LINES[n % 3], label=one.name
        )
    axes.set_xlabel("thickness (mm)")
    axes.set_ylabel("area of the surface (cm²)")
    axes.set_xlim(0.0, highest)
    axes.spines[["top", "right"]].set_visible(False)
    if figures:
        axes.legend(frameon=False, fontsize=8, loc="upper right")
    canvas.draw()  # type: ignore[no-untyped-call]
    return np.array(canvas.buffer_rgba())[..., :3].copy()  # type: ignore[no-untyped-call]


def _picture(title: str, alt: str, pixels: UInt8, *, lossy: bool = False) -> Picture:
    if lossy:
        stream = io.BytesIO()
        Image.fromarray(pixels).save(stream, format="JPEG", quality=88, subsampling=0)
        kind, content = "jpeg", stream.getvalue()
    else:
        kind, content = "png", png_bytes(pixels)
    height, width = pixels.shape[:2]
    return Picture(title, alt, f"data:image/{kind};base64,{base64.b64encode(content).decode()}", width, height)
