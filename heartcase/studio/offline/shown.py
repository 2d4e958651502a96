"""What the page shows of a case besides its moving surface: looks of structures, vessels, landmarks, planes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from heartcase.pipeline.exports.tubes import VESSEL_COLOUR, TubeMesh, vessel_tubes
from heartcase.schemas.arrays import Float64, UInt8
from heartcase.schemas.bundle.approval import approval_state
from heartcase.schemas.bundle.format import FileRole
from heartcase.schemas.bundle.reader import OpenBundle
from heartcase.schemas.labels import BACKGROUND, LabelTable
from heartcase.schemas.landmarks import Landmark
from heartcase.studio.offline.colours import (
    OXYGEN_COLOURS,
    RIM_COLOUR,
    SAFE_RIM_COLOUR,
    SAFE_VESSEL_COLOUR,
    safe_colour,
)
from heartcase.studio.offline.oxygenation import Oxygen, Oxygenation, oxygenation
from heartcase.studio.offline.pictures import lesion_view
from heartcase.studio.offline.surfaces import RIM, surface_of
from heartcase.studio.operating.scene.heart_axes import heart_axes

__all__ = ["FIRST_VESSEL", "Shown", "landmark_lines", "shown_of"]

FIRST_VESSEL = 1000
"""Number of the first vessel that has a surface of its own; the others follow."""
_VESSEL_SIDES = 12
_RING_POINTS = 48


@dataclass(frozen=True)
class Shown:
    """What the page shows of a case besides its moving surface."""

    of_triangles: UInt8
    """Structure of each triangle, shape (triangle_count,)."""
    structures: list[dict[str, Any]]
    """Number, name, colours and oxygenation of each structure, as JSON holds them; vessels stand last."""
    vessels: Mapping[str, TubeMesh]
    """Name -> surface of a vessel that stands beside the heart's."""
    landmarks: list[dict[str, Any]]
    """Landmarks as points and lines."""
    inside: list[dict[str, Any]]
    """As of ``structures``: tissue that no triangle shows, and a cut alone does."""
    axes: dict[str, Any]
    """The heart's own planes, as of :func:`heartcase.studio.operating.scene.heart_axes.heart_axes`; ``lesion`` goes
    through what the case is about, where landmarks tell."""
    oxygen: dict[str, Any]
    """How oxygenation was worked out, and its colours."""
    is_approved: bool
    """Whether somebody approved these bytes."""


def shown_of(bundle: OpenBundle, level: int) -> Shown:
    """What the page shows of a case, with its surface at a level of detail."""
    surface, table = surface_of(bundle, level), bundle.manifest.labels
    landmarks = bundle.manifest.landmarks
    blood = oxygenation(table, bundle.manifest.quality.get("openings"))
    vessels = vessel_tubes(landmarks, side_count=_VESSEL_SIDES)
    of_triangles = surface.structures
    numbers = np.unique(of_triangles).tolist()
    structures = [_structure(number, table, blood) for number in numbers]
    structures += [_vessel(number, name, table, blood) for number, name in enumerate(vessels, FIRST_VESSEL)]
    oxygen = {
        "colours": {kind.value: colour for kind, colour in OXYGEN_COLOURS.items()},
        "is_from_openings": blood.is_from_openings,
        "joined": [list(pair) for pair in blood.joined],
    }
    labels = np.unique(bundle.arrays(FileRole.GRID, ("cell_label",))["cell_label"]).tolist()
    inside = [_structure(number, table, blood) for number in labels if number and number not in numbers]
    lines, is_approved = landmark_lines(landmarks), approval_state(bundle.directory).state == "approved"
    return Shown(of_triangles, structures, vessels, lines, inside, _axes(bundle), oxygen, is_approved)


def _structure(number: int, table: LabelTable, blood: Oxygenation) -> dict[str, Any]:
    if number == RIM:
        looks = _looks(RIM_COLOUR, SAFE_RIM_COLOUR, Oxygen.MIXED)
        return {"value": number, "name": "", "part": "rim"} | looks
    label = table[number]
    part = "device" if label.role.value == "device" else "outside" if label.role.is_tissue else "inside"
    looks = _looks(label.colour, safe_colour(label, table), blood.of_label.get(number, Oxygen.UNKNOWN))
    return {"value": number, "name": label.name, "part": part} | looks


def _vessel(number: int, name: str, table: LabelTable, blood: Oxygenation) -> dict[str, Any]:
    """A vessel on the heart: arteries carry the aorta's blood."""
    aorta = next((one.value for one in table if one.term is not None and one.term.name == "aorta"), BACKGROUND)
    carried = blood.of_label.get(aorta, Oxygen.UNKNOWN) if "artery" in name.lower() else Oxygen.UNKNOWN
    return {"value": number, "name": name, "part": "vessel"} | _looks(VESSEL_COLOUR, SAFE_VESSEL_COLOUR, carried)


def _looks(colour: str, safe: str, blood: Oxygen) -> dict[str, str]:
    return {"colour": colour, "safe": safe, "oxygen": OXYGEN_COLOURS[blood], "blood": blood.value}


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


def _axes(bundle: OpenBundle) -> dict[str, Any]:
    """The heart's own planes, and the one through its defect."""
    found = heart_axes(bundle.directory)
    lesion = lesion_view(bundle.manifest.landmarks)
    if lesion is None:
        return found
    towards, up = np.asarray(lesion.plane[1], dtype=float), np.asarray(lesion.up, dtype=float)
    plane = {
        "right": np.cross(up, towards).tolist(),
        "down": (-up).tolist(),
        "towards": towards.tolist(),
        "point_mm": np.asarray(lesion.plane[0], dtype=float).tolist(),
    }
    return found | {"planes": {"lesion": plane} | found["planes"]}
