"""The heart's own planes of a built case, for a page: how each is looked at, and the middle of the long axis."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from heartcase.pipeline.formats.read_scan import read_labels
from heartcase.pipeline.report.heart_planes import heart_planes
from heartcase.pipeline.report.views import places_of
from heartcase.schemas.bundle.format import FileRole
from heartcase.schemas.bundle.reader import open_bundle
from heartcase.schemas.errors import HeartcaseError

__all__ = ["heart_axes"]


def heart_axes(path: Path) -> dict[str, Any]:
    """The planes that a case's labels and landmarks tell.

    Parameters
    ----------
    path
        The case's folder.

    Returns
    -------
    dict
        ``planes``: name -> ``right`` and ``down`` of the picture and ``towards`` the viewer, unit vectors, LPS;
        ``centre_mm``: the middle of the long axis, LPS mm, or None. Without planes where the case tells none.

    Raises
    ------
    BundleError
        The bundle is broken.
    """
    bundle = open_bundle(path)
    manifest = bundle.manifest
    labels, geometry = np.zeros((1, 1, 1), np.uint8), manifest.scan_geometry
    if bundle.has(FileRole.LABELS):
        try:
            volume = read_labels(bundle.path(FileRole.LABELS))
            labels, geometry = volume.values.astype(np.uint8), volume.geometry
        except HeartcaseError:
            # Labels are not what is operated on: landmarks may tell the planes.
            pass
    found = heart_planes(labels, geometry, manifest.labels, places=places_of(manifest.landmarks))
    planes = {
        name: {
            "right": plane.right.tolist(),
            "down": plane.down.tolist(),
            "towards": np.cross(plane.down, plane.right).tolist(),
        }
        for name, plane in found.planes.items()
    }
    return {"planes": planes, "centre_mm": None if found.centre_mm is None else found.centre_mm.tolist()}
