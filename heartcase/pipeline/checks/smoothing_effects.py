"""Effects of smoothing the outlines: volumes of the structures, and widths of the narrowest lumens."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numba
import numpy as np

from heartcase.compiling.kernel import loop_kernel
from heartcase.pipeline.checks.lumens import narrowest_lumens
from heartcase.pipeline.warning_words import sentence
from heartcase.pipeline.warnings import CaseWarning, anatomy
from heartcase.schemas.arrays import Float32, UInt8
from heartcase.schemas.geometry import Geometry
from heartcase.schemas.labels import BACKGROUND, LabelTable

__all__ = ["NARROWED_VOXELS", "smoothing_effects", "volume_voxels"]


LOSS_LIMIT = 0.10
"""Part of a structure's volume that the smoothing may take without a warning."""
NARROWED_VOXELS = 0.5
"""A narrow place may become narrower by this part of a voxel without a warning."""


def smoothing_effects(
    labels: UInt8, distances: Mapping[int, Float32], geometry: Geometry, table: LabelTable
) -> tuple[dict[str, Any], tuple[CaseWarning, ...]]:
    """Compare the smoothed structures with the labels they were made from.

    Parameters
    ----------
    labels
        Label values, shape [z, y, x].
    distances
        Label value -> smoothed signed distance, mm, negative inside; without the structures that vanished.
    geometry, table
        Their lattice and their label table.

    Returns
    -------
    figures : dict
        ``volume_change_percent`` by label name, and ``narrowest_lumens``: label name, place, and diameter in mm as
        segmented and as smoothed.
    warnings : tuple of CaseWarning
        Structures that shrank or vanished, and narrow places that became narrower by more than half a voxel.
    """
    counts = np.bincount(labels.ravel(), minlength=256)
    width = float(np.mean(geometry.spacing_mm))
    changes: dict[str, float] = {}
    warnings: list[CaseWarning] = []
    for value in table.values:
        if counts[value] == 0 or value == BACKGROUND:
            continue
        name = table[value].name
        if value not in distances:
            warnings.append(anatomy(sentence("smoothed-away", label=name)))
            continue
        change = volume_voxels(distances[value], width) / int(counts[value]) - 1.0
        changes[name] = round(100.0 * change, 2) + 0.0
        if change < -LOSS_LIMIT:
            warnings.append(CaseWarning(sentence("smoothed-smaller", label=name, percent=f"{-100.0 * change:.0f}")))
    lumens = []
    for one in narrowest_lumens(labels, distances, geometry, table):
        name, place = table[one.label].name, ", ".join(f"{x:.1f}" for x in one.position_mm)
        lumens.append(
            {
                "label": name,
                "position_mm": [round(x, 1) + 0.0 for x in one.position_mm],
                "segmented_mm": round(one.segmented_mm, 2),
                "smoothed_mm": round(one.smoothed_mm, 2),
            }
        )
        if one.smoothed_mm < one.segmented_mm - NARROWED_VOXELS * width:
            kind = "smoothed-narrower" if one.smoothed_mm > 0.0 else "smoothed-shut"
            said = {"label": name, "place": f"({place})", "before": f"{one.segmented_mm:.1f}"}
            warnings.append(anatomy(sentence(kind, **said, after=f"{one.smoothed_mm:.1f}")))
    return {"volume_change_percent": changes, "narrowest_lumens": lumens}, tuple(warnings)


def volume_voxels(distance: Float32, width_mm: float) -> float:
    """Volume inside a field in voxels, from 27 points in each voxel within two widths of its face."""
    found = np.empty(len(distance), np.int64)
    _count_inside(np.ascontiguousarray(distance, np.float32), np.float32(2.0 * width_mm), found)
    return float(found.sum()) / 27.0


@loop_kernel
def _count_inside(distance, near, found):
    """Count the points of each plane that are inside, of 27 in each voxel; the border's values go on beyond it."""
    nz, ny, nx = distance.shape
    for k in numba.prange(nz):
        count = 0
        for j in range(ny):
            for i in range(nx):
                value = distance[k, j, i]
                if value >= near:
                    continue
                if value <= -near:
                    count += 27
                    continue
                for dk in range(-1, 2):
                    kk = min(max(k + dk, 0), nz - 1)
                    for dj in range(-1, 2):
                        jj = min(max(j + dj, 0), ny - 1)
                        for di in range(-1, 2):
                            ii = min(max(i + di, 0), nx - 1)
                            a, b, c = abs(dk) / 3.0, abs(dj) / 3.0, abs(di) / 3.0
                            low = (1.0 - c) * distance[k, j, i] + c * distance[k, j, ii]
                            high = (1.0 - c) * distance[k, jj, i] + c * distance[k, jj, ii]
                            front = (1.0 - b) * low + b * high
                            low = (1.0 - c) * distance[kk, j, i] + c * distance[kk, j, ii]
                            high = (1.0 - c) * distance[kk, jj, i] + c * distance[kk, jj, ii]
                            back = (1.0 - b) * low + b * high
                            if (1.0 - a) * front + a * back < 0.0:
                                count += 1
        found[k] = count
