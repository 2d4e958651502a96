"""The heart's own planes, as a page is told of them."""

from __future__ import annotations

from collections.abc import Sequence

from heartcase.pipeline.markers.session import SegmentationSession
from heartcase.pipeline.report.heart_planes import heart_planes
from heartcase.pipeline.report.views import places_of
from heartcase.schemas.landmarks import Landmark
from heartcase.studio.messages import text_message

__all__ = ["planes_message"]


def planes_message(number: int, session: SegmentationSession, landmarks: Sequence[Landmark]) -> str:
    """The planes that labels and landmarks tell now, and what the others lack, for the request with this number."""
    found = heart_planes(session.labels, session.geometry, session.table, places=places_of(landmarks))
    planes = {
        name: {"right": plane.right.tolist(), "down": plane.down.tolist(), "normal": plane.normal.tolist()}
        for name, plane in found.planes.items()
    }
    centre = None if found.centre_mm is None else found.centre_mm.tolist()
    return text_message("planes", id=number, planes=planes, missing=found.missing, centre_mm=centre)
