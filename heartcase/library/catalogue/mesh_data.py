"""The surface of a case packed into a script for the viewer: a browser may load that from a folder, but no other data.

Positions are 16-bit fractions of the bounding box, normals are folded onto an octahedron in two signed bytes, and the
triangles of one structure lie together, so that a structure is shown, hidden or coloured without touching the data.
"""

from __future__ import annotations

import base64
import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from heartcase.library.catalogue.colours import (
    OXYGEN_COLOURS,
    RIM_COLOUR,
    SAFE_RIM_COLOUR,
    SAFE_VESSEL_COLOUR,
    safe_colour,
)
from heartcase.library.catalogue.oxygenation import Oxygen, Oxygenation
from heartcase.pipeline.exports.tubes import VESSEL_COLOUR, TubeMesh
from heartcase.pipeline.report.views import four_chamber_view, places_of, short_axis_view
from heartcase.schemas.arrays import Float32, Float64, Int8, Int32, UInt8
from heartcase.schemas.bundle.reader import OpenBundle
from heartcase.schemas.bundle.surface_kinds import SurfaceKind
from heartcase.schemas.labels import BACKGROUND, LabelTable
from heartcase.schemas.landmarks import Landmark

__all__ = [
    "PACKED_MAX",
    "Group",
    "GroupLook",
    "PackedMesh",
    "SurfaceArrays",
    "group_look",
    "landmark_lines",
    "mesh_script",
    "pack",
    "script_call",
    "surface_of",
    "viewer_levels",
]

PACKED_MAX = 1_900_000
"""Largest mesh script, bytes: with its page it stays below about 2 MB."""

_STEPS = 65535
_FOLDED = 127
_RING_POINTS = 48
_RIM = 255
"""Group number of rims; label values end at 250."""
_VESSEL = 251
"""Group number of all vessels that have a surface of their own."""

Bytes = UInt8


@dataclass(frozen=True)
class SurfaceArrays:
    """One level of detail of a case's surface."""

    vertices_mm: Float32
    """LPS mm, shape (vertex_count, 3)."""
    normals: Float32
    """Unit normals out of the tissue, shape (vertex_count, 3)."""
    triangles: Int32
    """Vertex numbers, shape (triangle_count, 3)."""
    void: Bytes
    """Label before each triangle, shape (triangle_count,)."""
    tissue: Bytes
    """Label behind each triangle, shape (triangle_count,)."""
    kind: Bytes | None
    """:class:`~heartcase.schemas.bundle.surface_kinds.SurfaceKind` of each triangle; None in versions 1.0 and 1.1."""


@dataclass(frozen=True)
class Group:
    """The triangles of one structure."""

    number: int
    """Label value; 255 for rims of defects, 251 for vessels with a surface of their own."""
    name: str
    """Name of the label or vessel; empty for rims."""
    part: str
    """``inside`` of a cavity, ``outside`` of tissue, ``device``, ``vessel`` or ``rim``."""
    first: int
    """Place of its first vertex number among all."""
    count: int
    """How many vertex numbers, three times its triangles."""


@dataclass(frozen=True)
class PackedMesh:
    """A surface in few bytes; all numbers little-endian."""

    low_mm: tuple[float, float, float]
    """Corner of the bounding box, LPS mm."""
    step_mm: tuple[float, float, float]
    """Length of one step along each axis, mm: the error is half of it."""
    positions: bytes
    """uint16 (x, y, z) of each vertex, in steps from the corner."""
    normals: bytes
    """int8 (u, v) of each vertex, 127 being 1: the octahedral fold of the normal."""
    indices: bytes
    """Vertex numbers, group by group."""
    index_bytes: int
    """2 or 4: bytes of a vertex number."""
    groups: tuple[Group, ...]
    """By number; vessels stand last."""


@dataclass(frozen=True)
class GroupLook:
    """Colours of a structure in the three modes of the viewer, ``#rrggbb``, and its oxygenation."""

    structure: str
    safe: str
    blood: Oxygen

    @property
    def oxygen(self) -> str:
        """Colour by oxygenation."""
        return OXYGEN_COLOURS[self.blood]


def viewer_levels(bundle: OpenBundle) -> tuple[int, ...]:
    """Levels of detail that the viewer may show, the best first: the middle one, then the coarser."""
    return tuple(sorted(bundle.levels, key=lambda level: (level != 1, -level)))


def surface_of(bundle: OpenBundle, level: int) -> SurfaceArrays:
    """Read a level of detail.

    Raises
    ------
    BundleError
        Its values are not sound.
    """
    role = bundle.surface_role(level)
    names = ["vertices", "normals", "triangles", "triangle_label", "triangle_tissue"]
    has_kind = "triangle_kind" in bundle.headers[role].arrays
    arrays = bundle.arrays(role, [*names, "triangle_kind"] if has_kind else names)
    vertices, normals, triangles, void, tissue = (arrays[name] for name in names)
    return SurfaceArrays(vertices, normals, triangles, void, tissue, arrays.get("triangle_kind"))


def pack(surface: SurfaceArrays, table: LabelTable, vessels: Mapping[str, TubeMesh] | None = None) -> PackedMesh:
    """Pack a surface; its error along each axis is at most half a step (and half of float32's last digit).

    Parameters
    ----------
    surface, table
        The heart, and what its labels stand for.
    vessels
        Name -> surface of a vessel that stands beside the heart's.
    """
    vessels = vessels or {}
    points = np.concatenate([surface.vertices_mm, *(tube.vertices_mm for tube in vessels.values())]).astype(np.float64)
    normals = np.concatenate([surface.normals, *(tube.normals for tube in vessels.values())])
    low = points.min(axis=0)
    # Something flat along an axis has no extent there.
    step = np.maximum((points.max(axis=0) - low) / _STEPS, 1e-9)
    positions = np.clip(np.rint((points - low) / step), 0, _STEPS).astype("<u2")
    number = _numbers(surface)
    order = np.argsort(number, kind="stable")
    index_bytes = 2 if len(points) <= 1 << 16 else 4
    indices = [surface.triangles[order]]
    groups, first = [], 0
    for value, triangles in zip(*np.unique(number, return_counts=True), strict=True):
        count = 3 * int(triangles)
        groups.append(Group(int(value), *_name_and_part(int(value), table), first, count))
        first += count
    vertex = len(surface.vertices_mm)
    for name, tube in vessels.items():
        indices.append(tube.triangles + vertex)
        groups.append(Group(_VESSEL, name, "vessel", first, tube.triangles.size))
        first += tube.triangles.size
        vertex += len(tube.vertices_mm)
    return PackedMesh(
        _three(low), _three(step), positions.tobytes(), _folded(normals).tobytes(),
        np.concatenate(indices).astype(f"<u{index_bytes}").tobytes(), index_bytes, tuple(groups),
    )  # fmt: skip


def _numbers(surface: SurfaceArrays) -> Bytes:
    """Group of each triangle: the cavity before it, else the tissue behind it."""
    number = np.where(surface.void == BACKGROUND, surface.tissue, surface.void).astype(np.uint8)
    if surface.kind is not None:
        number = np.where(surface.kind == SurfaceKind.DEVICE, surface.tissue, number)
        number = np.where(surface.kind == SurfaceKind.DEFECT_RIM, _RIM, number)
    return number.astype(np.uint8)


def _name_and_part(number: int, table: LabelTable) -> tuple[str, str]:
    if number == _RIM:
        return "", "rim"
    label = table[number]
    if label.role.value == "device":
        return label.name, "device"
    return label.name, "outside" if label.role.is_tissue else "inside"


def _folded(normals: Float32) -> Int8:
    """Unit vectors folded onto the square that an octahedron unfolds to."""
    vectors = normals.astype(np.float64)
    vectors /= np.maximum(np.abs(vectors).sum(axis=1, keepdims=True), 1e-12)
    flat = vectors[:, :2]
    turned = (1.0 - np.abs(flat[:, ::-1])) * np.where(flat >= 0.0, 1.0, -1.0)
    folded = np.where(vectors[:, 2:] < 0.0, turned, flat)
    rounded: Int8 = np.rint(folded * _FOLDED).astype(np.int8)
    return rounded


def landmark_lines(landmarks: tuple[Landmark, ...]) -> list[dict[str, Any]]:
    """Landmarks as points and lines that can be drawn: rings given by a centre become closed lines.

    Vessels are not among them: they have a surface.
    """
    lines = []
    for one in landmarks:
        if one.is_vessel:
            continue
        points = np.array(one.points_mm, dtype=float)
        closed = one.kind == "ring"
        if closed and len(points) == 1 and one.axis is not None and one.radius_mm is not None:
            points = _circle(points[0], np.array(one.axis, dtype=float), one.radius_mm)
        lines.append(
            {
                "name": one.name,
                "kind": "incision" if one.depth_mm is not None else one.kind,
                "closed": closed,
                "depth": one.depth_mm,
                "points": np.round(points, 2).tolist(),
            }
        )
    return lines


def _circle(centre: Float64, axis: Float64, radius: float) -> Float64:
    axis = axis / np.linalg.norm(axis)
    aside = np.cross(axis, np.eye(3)[int(np.argmin(np.abs(axis)))])
    aside /= np.linalg.norm(aside)
    angle = np.linspace(0.0, 2.0 * np.pi, _RING_POINTS, endpoint=False)[:, None]
    circle: Float64 = centre + radius * (np.cos(angle) * aside + np.sin(angle) * np.cross(axis, aside))
    return circle


def group_look(group: Group, table: LabelTable, blood: Oxygenation) -> GroupLook:
    """How a structure is coloured; arteries on the heart carry the aorta's blood."""
    if group.part == "rim":
        return GroupLook(RIM_COLOUR, SAFE_RIM_COLOUR, Oxygen.MIXED)
    if group.part == "vessel":
        aorta = next((one.value for one in table if one.term is not None and one.term.name == "aorta"), BACKGROUND)
        carried = blood.of_label.get(aorta, Oxygen.UNKNOWN) if "artery" in group.name.lower() else Oxygen.UNKNOWN
        return GroupLook(VESSEL_COLOUR, SAFE_VESSEL_COLOUR, carried)
    label = table[group.number]
    return GroupLook(label.colour, safe_colour(label, table), blood.of_label.get(group.number, Oxygen.UNKNOWN))


def mesh_script(
    mesh: PackedMesh, surface: SurfaceArrays, table: LabelTable, landmarks: tuple[Landmark, ...], blood: Oxygenation
) -> str:
    """The script that hands a mesh, its colours, landmarks and cuts to the viewer."""
    groups = []
    for group in mesh.groups:
        look = group_look(group, table, blood)
        groups.append(
            {
                "first": group.first,
                "count": group.count,
                "structure": look.structure,
                "oxygen": look.oxygen,
                "blood": look.blood.value,
                "safe": look.safe,
            }
        )
    data = {
        "low": mesh.low_mm,
        "step": mesh.step_mm,
        "indexBytes": mesh.index_bytes,
        "groups": groups,
        "landmarks": landmark_lines(landmarks),
        "cuts": _cuts(surface, table, landmarks),
        "positions": base64.b64encode(mesh.positions).decode(),
        "normals": base64.b64encode(mesh.normals).decode(),
        "indices": base64.b64encode(mesh.indices).decode(),
    }
    return script_call("HeartcaseViewer.register", data)


def _cuts(surface: SurfaceArrays, table: LabelTable, landmarks: tuple[Landmark, ...]) -> list[dict[str, Any]]:
    """Cuts that follow the heart and not the body, as far as its landmarks or labels tell them."""
    shape = (surface.vertices_mm, surface.triangles, surface.void, table)
    places = places_of(landmarks)
    views = {"four": four_chamber_view(places, *shape), "short": short_axis_view(places, *shape)}
    return [
        {
            "key": key,
            "point": np.round(np.asarray(view.plane[0], dtype=float), 3).tolist(),
            "normal": np.round(np.asarray(view.plane[1], dtype=float), 5).tolist(),
            "up": np.round(np.asarray(view.up, dtype=float), 5).tolist(),
        }
        for key, view in views.items()
        if view is not None
    ]


def script_call(function: str, data: Any) -> str:
    """A line of JavaScript that calls a function with data in which nothing can end the script or the string."""
    text = json.dumps(data, ensure_ascii=True, allow_nan=False, separators=(",", ":"))
    for letter in "<>&":
        text = text.replace(letter, f"\\u{ord(letter):04x}")
    return f"{function}({text});\n"


def _three(values: Float64) -> tuple[float, float, float]:
    x, y, z = (float(value) for value in values)
    return x, y, z
