"""Pictures of a tissue surface: from six sides, cut open, and coloured by a value.

Directions are the patient's: in the anterior view the viewer stands in front of the patient, whose left is on the
right of the picture. Letters at the edges say which way is which: anterior, posterior, left, right, head,
feet.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Literal

import numpy as np
import numpy.typing as npt
from PIL import Image, ImageDraw
from scipy.spatial import KDTree

from heartcase.pipeline.mesh.triangles.thickness import vertex_normals
from heartcase.pipeline.report.cutaway import Plane, clipped, crossings, filled
from heartcase.pipeline.report.montage import INK, font_of_size
from heartcase.pipeline.report.outlines import rgb
from heartcase.pipeline.report.render import Camera, Mesh, camera_for, downsampled, draw_mesh
from heartcase.schemas.arrays import Bool, Float64, Integer, UInt8
from heartcase.schemas.labels import BACKGROUND, LabelTable

__all__ = [
    "VIEWS",
    "View",
    "coronal_plane",
    "cutaway_picture",
    "direction_letters",
    "four_chamber_plane",
    "surface_picture",
]

View = Literal["anterior", "posterior", "left", "right", "superior", "inferior", "surgeon"]

VIEWS: dict[View, tuple[tuple[float, float, float], tuple[float, float, float]]] = {
    "anterior": ((0, -1, 0), (0, 0, 1)),
    "posterior": ((0, 1, 0), (0, 0, 1)),
    "left": ((1, 0, 0), (0, 0, 1)),
    "right": ((-1, 0, 0), (0, 0, 1)),
    "superior": ((0, 0, 1), (0, -1, 0)),
    "inferior": ((0, 0, -1), (0, -1, 0)),
    "surgeon": ((-0.5, -math.sqrt(0.75), 0), (1, 0, 0)),
}
"""Name -> unit direction towards the viewer, and direction that shows upwards, in LPS.

``surgeon``: the patient lies on the back, the breastbone is opened, and the surgeon stands at the patient's right side
and looks down at the heart, 30 degrees from straight above: the head is on the left, the patient's right side below.
"""

_CHAMBERS = ("87878005", "53085002", "82471001", "73829009")
"""SNOMED CT codes of the ventricles and atria."""
_TISSUE_COLOUR = (196, 132, 122)
_UNKNOWN_COLOUR = (175, 175, 175)
_CAP_OVERSAMPLING = 2
_MARK_MM = 2.0
_VIRIDIS = np.frombuffer(
    bytes.fromhex(
        "440154 470d60 48186a 482374 472d7b 453781 424086 3e4989 3b528b 375b8d 33638d 2f6b8e "
        "2c728e 297a8e 26828e 23898e 21908c 1f978b 1f9f88 21a685 27ad81 31b57b 3ebc74 4dc26c "
        "5cc863 6ece58 82d34d 95d840 aadc32 c0df25 d5e21a eae51a fde725"
    ),
    np.uint8,
).reshape(-1, 3)
"""The colour map viridis (Smith and van der Walt, 2015), at even steps; between them it is off by 3 of 255 at most."""


def surface_picture(
    vertices_mm: npt.ArrayLike,
    triangles: npt.ArrayLike,
    triangle_label: npt.ArrayLike,
    table: LabelTable,
    *,
    view: View = "anterior",
    size: tuple[int, int] = (800, 600),
    triangle_tissue: npt.ArrayLike | None = None,
    normals: npt.ArrayLike | None = None,
    scalars: npt.ArrayLike | None = None,
    scalar_range: tuple[float, float] | None = None,
    scalar_title: str = "",
    clip: Plane | None = None,
) -> UInt8:
    """Picture of the surface from one side.

    Parameters
    ----------
    vertices_mm
        Vertices, shape (vertex_count, 3), LPS mm.
    triangles
        Vertex numbers, counter-clockwise from outside the tissue, shape (triangle_count, 3).
    triangle_label
        Label of the void beside each triangle: inner sides take the colour of their cavity.
    table
        Label table.
    view
        Where the viewer stands.
    size
        Width and height, pixels.
    triangle_tissue
        Label of the tissue behind each triangle: colours the outside. One colour when left out.
    normals
        Unit vertex normals; from the triangles when left out.
    scalars
        One value per vertex: colours the surface instead of the labels, with a colour bar. NaN is grey.
    scalar_range
        Values at the ends of the colour bar; the 2nd and 98th percentile when left out.
    scalar_title
        What the values are, with their unit.
    clip
        Plane that cuts the surface open; the side its normal points to is taken away. Cut tissue stays hollow.

    Returns
    -------
    UInt8
        RGB picture, shape (height, width, 3).
    """
    points = np.asarray(vertices_mm, dtype=float)
    faces = np.asarray(triangles, dtype=np.int64)
    point_normals = vertex_normals(points, faces) if normals is None else np.asarray(normals, dtype=float)
    camera = _camera(points, view, size)
    if scalars is None:
        colours = _triangle_colours(np.asarray(triangle_label), triangle_tissue, table)
        mesh = Mesh(points, faces, point_normals, colours)
        low, high = 0.0, 0.0
    else:
        values = np.asarray(scalars, dtype=float)
        low, high = _range_of(values) if scalar_range is None else scalar_range
        mesh = Mesh(points, faces, point_normals, _value_colours(values, low, high), colours_of_points=True)
    if clip is not None:
        mesh = clipped(mesh, clip)
    picture = _annotated(draw_mesh(mesh, camera, depth_shading=scalars is None), camera)
    return picture if scalars is None else _with_colour_bar(picture, low, high, scalar_title)


def cutaway_picture(
    vertices_mm: npt.ArrayLike,
    triangles: npt.ArrayLike,
    triangle_label: npt.ArrayLike,
    triangle_tissue: npt.ArrayLike,
    table: LabelTable,
    *,
    plane: Plane | None = None,
    up: npt.ArrayLike | None = None,
    marks: Mapping[str, npt.ArrayLike] | None = None,
    size: tuple[int, int] = (800, 600),
    normals: npt.ArrayLike | None = None,
) -> UInt8:
    """Picture of the heart cut open: chambers show their inner sides, cut walls are filled in their tissue's colour.

    Parameters
    ----------
    vertices_mm, triangles, triangle_label, triangle_tissue, table, normals
        As for :func:`surface_picture`; the surface must be closed for the cut to be filled.
    plane
        Where to cut; the side its normal points to is taken away, and the viewer stands there.
        :func:`four_chamber_plane` when left out.
    up
        Direction that shows upwards; the head, or the front where the viewer looks along the body, when left out.
    marks
        Name -> point, mm: written beside a cross where the point is less than 2 mm away from the plane.
    size
        Width and height, pixels.

    Returns
    -------
    UInt8
        RGB picture, shape (height, width, 3).
    """
    points = np.asarray(vertices_mm, dtype=float)
    faces = np.asarray(triangles, dtype=np.int64)
    labels, tissue = np.asarray(triangle_label), np.asarray(triangle_tissue)
    if plane is None:
        plane = four_chamber_plane(points, faces, labels, table)
    point_normals = vertex_normals(points, faces) if normals is None else np.asarray(normals, dtype=float)
    normal = np.asarray(plane[1], dtype=float)
    mesh = clipped(Mesh(points, faces, point_normals, _triangle_colours(labels, tissue, table)), plane)
    shown = mesh.points_mm[np.unique(mesh.triangles)]
    upward = _upward_for(normal) if up is None else up
    camera = camera_for(shown if len(shown) else points, towards=normal, up=upward, size=size)
    fine = camera.oversampled(_CAP_OVERSAMPLING)
    cap, inside = _cut_face(points, faces, tissue, plane, table, fine)
    picture = draw_mesh(mesh, camera, depth_shading=True).astype(float)
    share = downsampled(inside[..., None] * np.uint8(255), _CAP_OVERSAMPLING) / 255.0
    mean = downsampled(cap * inside[..., None], _CAP_OVERSAMPLING)
    whole = _annotated(np.round(picture * (1.0 - share) + mean).astype(np.uint8), camera)
    return _marked(whole, camera, plane, marks or {})


def four_chamber_plane(
    vertices_mm: npt.ArrayLike, triangles: npt.ArrayLike, triangle_label: npt.ArrayLike, table: LabelTable
) -> tuple[Float64, Float64]:
    """A plane that passes through the middle of the chambers.

    The plane that fits the centres of the four chambers best in the sense of least squares, where at least three are
    there and do not lie on a line; otherwise :func:`coronal_plane`.
    The normal points to the front or to the feet, whichever is nearer: that side is taken away.

    Returns
    -------
    point, normal
        In mm and of length one, shape (3,) each.
    """
    points, faces = np.asarray(vertices_mm, dtype=float), np.asarray(triangles)
    label = np.asarray(triangle_label)
    centres = [
        _centre(points, faces[label == entry.value])
        for entry in table
        if entry.term is not None and entry.term.code in _CHAMBERS and (label == entry.value).any()
    ]
    viewer = np.array([0.0, -1.0, -1.0])
    if len(centres) >= 3:
        middle = np.mean(centres, axis=0)
        _, spread, axes = np.linalg.svd(np.array(centres) - middle)
        if spread[1] > 0.1 * spread[0]:
            normal: Float64 = axes[2]
            return middle, normal if normal @ viewer > 0.0 else -normal
    return coronal_plane(points, faces)


def coronal_plane(vertices_mm: npt.ArrayLike, triangles: npt.ArrayLike) -> tuple[Float64, Float64]:
    """A plane across the body through the centre of the surface, tilted by 20 degrees towards the feet.

    Returns
    -------
    point, normal
        In mm, and of length one to the front, shape (3,) each.
    """
    tilt = np.radians(20.0)
    centre = _centre(np.asarray(vertices_mm, dtype=float), np.asarray(triangles))
    return centre, np.array([0.0, -np.cos(tilt), -np.sin(tilt)])


def direction_letters(direction: npt.ArrayLike, *, smallest: float = 0.35) -> str:
    """Name a direction in LPS by the letters of DICOM, the strongest first: ``A``, ``PL``, ``LAH``.

    Parts of the unit direction below ``smallest`` (about 20 degrees) are left out.
    """
    unit = np.asarray(direction, dtype=float) / np.linalg.norm(direction)
    parts = [(abs(u), "LPH"[axis] if u > 0 else "RAF"[axis]) for axis, u in enumerate(unit) if abs(u) >= smallest]
    return "".join(letter for _, letter in sorted(parts, key=lambda part: -part[0]))


def _camera(points: Float64, view: View, size: tuple[int, int]) -> Camera:
    towards, up = VIEWS[view]
    return camera_for(points, towards=towards, up=up, size=size)


def _upward_for(towards: Float64) -> tuple[float, float, float]:
    """Feet down, unless the viewer looks along the body: then the patient's front shows upwards, as radiologists do."""
    return (0.0, -1.0, 0.0) if abs(towards[2]) > 0.75 * np.linalg.norm(towards) else (0.0, 0.0, 1.0)


def _centre(points: Float64, faces: Integer) -> Float64:
    corners = points[faces]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    centre: Float64 = np.average(corners.mean(axis=1), axis=0, weights=area)
    return centre


def _colour_table(table: LabelTable) -> UInt8:
    colours = np.full((256, 3), _UNKNOWN_COLOUR, np.uint8)
    for label in table:
        colours[label.value] = rgb(label.colour)
    return colours


def _triangle_colours(label: Integer, tissue: npt.ArrayLike | None, table: LabelTable) -> UInt8:
    colours = _colour_table(table)
    outside = (
        np.broadcast_to(np.array(_TISSUE_COLOUR, np.uint8), (len(label), 3))
        if tissue is None
        else colours[np.asarray(tissue)]
    )
    return np.where((label == BACKGROUND)[:, None], outside, colours[label])


def _range_of(values: Float64) -> tuple[float, float]:
    known = values[np.isfinite(values)]
    if len(known) == 0:
        return 0.0, 1.0
    low, high = np.percentile(known, (2, 98))
    return float(low), float(high) if high > low else float(low) + 1.0


def _value_colours(values: Float64, low: float, high: float) -> UInt8:
    place = np.nan_to_num(np.clip((values - low) / (high - low), 0.0, 1.0)) * (len(_VIRIDIS) - 1)
    first = np.minimum(place.astype(np.int64), len(_VIRIDIS) - 2)
    part = (place - first)[..., None]
    colours = np.round(_VIRIDIS[first] * (1.0 - part) + _VIRIDIS[first + 1] * part).astype(np.uint8)
    return np.where(np.isfinite(values)[..., None], colours, np.array(_UNKNOWN_COLOUR, np.uint8))


def _cut_face(
    points: Float64,
    faces: Integer,
    tissue: Integer,
    plane: Plane,
    table: LabelTable,
    camera: Camera,
) -> tuple[UInt8, Bool]:
    """Colour of the cut tissue at each pixel, and which pixels it covers."""
    width, height = camera.size
    starts, ends, owner = crossings(points, faces, plane)
    inside = np.zeros((height, width), bool)
    colours = np.zeros((height, width, 3), np.uint8)
    if len(starts) == 0:
        return colours, inside
    start, end = camera.project(starts)[:, :2], camera.project(ends)[:, :2]
    inside = filled(start, end, width, height)
    row, column = np.nonzero(inside)
    if len(row) == 0:
        return colours, inside
    _, nearest = KDTree((start + end) / 2.0).query(np.stack([column, row], axis=1), workers=-1)
    label = np.zeros((height, width), np.int64)
    label[inside] = tissue[owner[nearest]]
    pale = np.round(_colour_table(table) * 0.72 + 255 * 0.28).astype(np.uint8)
    colours = pale[label]
    edge = np.zeros((height, width), bool)
    marked = np.where(inside, label, -1)
    for axis in (0, 1):
        for shift in (1, -1):
            edge |= np.roll(marked, shift, axis) != marked
    colours[edge & inside] = np.array(INK, np.uint8)
    return colours, inside


def _annotated(picture: UInt8, camera: Camera) -> UInt8:
    """Write the directions at the edges and a scale bar at the bottom."""
    height, width = picture.shape[:2]
    font = font_of_size(min(22, max(11, height // 30)))
    sheet = Image.fromarray(picture)
    draw = ImageDraw.Draw(sheet)
    inset = 6
    for direction, place, anchor in (
        (camera.right, (width - inset, height // 2), "rm"),
        (-camera.right, (inset, height // 2), "lm"),
        (camera.up, (width // 2, inset), "mt"),
        (-camera.up, (width // 2, height - inset), "mb"),
    ):
        draw.text(place, direction_letters(direction), fill=INK, font=font, anchor=anchor)
    room = 0.22 * width * camera.mm_per_pixel
    length = max((mm for mm in (1, 2, 5, 10, 20, 50, 100, 200) if mm <= room), default=1)
    pixels = length / camera.mm_per_pixel
    left, bottom = inset + 6, height - inset - 4
    draw.line((left, bottom, left + pixels, bottom), fill=INK, width=3)
    draw.text((left, bottom - 6), f"{length} mm", fill=INK, font=font, anchor="lb")
    return np.asarray(sheet)


def _marked(picture: UInt8, camera: Camera, plane: Plane, marks: Mapping[str, npt.ArrayLike]) -> UInt8:
    """Write a cross and a name at each point that lies on the plane."""
    sheet = Image.fromarray(picture)
    draw = ImageDraw.Draw(sheet)
    font = font_of_size(15)
    point, normal = (np.asarray(part, dtype=float) for part in plane)
    for name, place in marks.items():
        if abs((np.asarray(place, dtype=float) - point) @ normal) > _MARK_MM * np.linalg.norm(normal):
            continue
        column, row, _ = camera.project(place)
        for width, colour in ((5, (255, 255, 255)), (2, INK)):
            draw.line((column - 6, row, column + 6, row), fill=colour, width=width)
            draw.line((column, row - 6, column, row + 6), fill=colour, width=width)
        draw.text(
            (column + 9, row), name, fill=INK, font=font, anchor="lm", stroke_width=2, stroke_fill=(255, 255, 255)
        )
    return np.asarray(sheet)


def _with_colour_bar(picture: UInt8, low: float, high: float, title: str) -> UInt8:
    """Write a colour bar at the right edge, above the letter of that direction."""
    height, width = picture.shape[:2]
    font = font_of_size(max(11, height // 36))
    top, bottom = int(0.12 * height), int(0.42 * height)
    left, right = width - 74, width - 56
    sheet = picture.copy()
    values = np.linspace(high, low, bottom - top)
    sheet[top:bottom, left:right] = _value_colours(values, low, high)[:, None, :]
    image = Image.fromarray(sheet)
    draw = ImageDraw.Draw(image)
    draw.rectangle((left - 1, top - 1, right, bottom), outline=INK)
    for part in (0.0, 0.5, 1.0):
        y = bottom - part * (bottom - top)
        draw.text((right + 6, y), f"{low + part * (high - low):.3g}", fill=INK, font=font, anchor="lm")
    draw.text((width - 8, top - 14), title, fill=INK, font=font, anchor="rb")
    return np.asarray(image)
