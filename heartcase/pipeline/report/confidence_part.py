"""Confidence in the outlines, for the report: coloured slices, figures of each structure, places to look at."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import edt
import numpy as np

from heartcase.pipeline.data import Scan, Segmentation
from heartcase.pipeline.markers.confidence import Sureness
from heartcase.pipeline.report.montage import stacked
from heartcase.pipeline.report.plain_words import placed
from heartcase.pipeline.report.report_pictures import Picture, embedded_picture
from heartcase.pipeline.report.slices import slice_pictures
from heartcase.schemas.arrays import Float32, UInt8
from heartcase.schemas.labels import BACKGROUND

__all__ = ["ConfidenceBand", "ConfidencePart", "ConfidenceRow", "PlaceRow", "confidence_part"]


_UNSURE = 0.75
"""Confidence below which a voxel counts as unsure."""
_AROUND_MM = 5.0
"""Distance from the heart up to which background is coloured."""


@dataclass(frozen=True)
class ConfidenceBand:
    """A colour of the slices."""

    colour: str
    """``#rrggbb``."""
    below: float
    """Confidence that its voxels are below."""
    words: str
    """What it means."""


_BANDS = (
    ConfidenceBand("#ff2d95", 0.5, "below 0.5"),
    ConfidenceBand("#ff9e2c", _UNSURE, "0.5 to 0.75"),
    ConfidenceBand("#ffe66d", 0.9, "0.75 to 0.9"),
)


@dataclass(frozen=True)
class ConfidenceRow:
    """How sure one structure is."""

    name: str
    """Name of the label."""
    colour: str
    """``#rrggbb``."""
    volume_ml: float
    """Volume that the segmentation gave it, ml: without grown walls, before edits."""
    unsure_ml: float
    """Part of it with a confidence below 0.75, ml."""
    median: float
    """Median confidence of its voxels."""

    @property
    def unsure_percent(self) -> float:
        """Part of it with a confidence below 0.75, %."""
        return 100.0 * self.unsure_ml / self.volume_ml


@dataclass(frozen=True)
class PlaceRow:
    """A place where a look is worth most."""

    place: str
    """Where it is."""
    present: str
    """Name of its label."""
    rival: str
    """Name of the label that it could have instead."""
    change_ml: float
    """What a stroke of another label there would change, ml."""
    radius_mm: float
    """Radius below which a brush there changes just that, mm."""


@dataclass(frozen=True)
class ConfidencePart:
    """What the page shows of how sure the outlines are."""

    pictures: Sequence[Picture]
    """Slices with outlines, and the same coloured."""
    bands: Sequence[ConfidenceBand]
    """What the colours mean."""
    rows: Sequence[ConfidenceRow]
    """Structures in the label table's order."""
    places: Sequence[PlaceRow]
    """Places to look at, the one most worth a look first."""
    rest_ml: float
    """Worth of the best place that is not among them, ml."""


def confidence_part(scan: Scan, segmentation: Segmentation, sureness: Sureness) -> ConfidencePart:
    """Draw and measure how sure a segmentation is.

    Parameters
    ----------
    scan
        The scan, on the segmentation's lattice.
    segmentation
        Its labels before walls were grown.
    sureness
        Of the same markers.
    """
    labels, table, geometry = segmentation.labels, segmentation.table, segmentation.geometry
    confidence = sureness.confidence
    voxel_ml = geometry.voxel_volume_mm3 / 1000.0
    rows = []
    for label in table:
        values = confidence[labels == label.value]
        if label.value != BACKGROUND and len(values):
            unsure = float((values < _UNSURE).sum()) * voxel_ml
            rows.append(
                ConfidenceRow(label.name, label.colour, len(values) * voxel_ml, unsure, float(np.median(values)))
            )
    strokes = sureness.strokes
    places = [
        PlaceRow(
            placed(one.position_mm),
            table[one.label].name,
            table[one.rival].name,
            one.change_ml,
            one.radius_mm,
        )
        for one in strokes.places
    ]
    return ConfidencePart(_pictures(scan, segmentation, confidence), _BANDS, rows, places, strokes.rest_ml)


def _pictures(scan: Scan, segmentation: Segmentation, confidence: Float32) -> list[Picture]:
    labels, table, geometry = segmentation.labels, segmentation.table, segmentation.geometry
    if not labels.any():
        return []
    outlined = slice_pictures(scan.values, geometry, labels, table, modality=scan.modality)
    coloured = slice_pictures(
        scan.values,
        geometry,
        labels,
        table,
        modality=scan.modality,
        overlay=_bands_of(labels, confidence, geometry.spacing_mm[::-1]),
        overlay_colours=[band.colour for band in _BANDS],
    )
    return [
        embedded_picture(
            f"{stack.capitalize()} slices: above as they are, below coloured where the outlines are unsure",
            f"Four {stack} slices of the scan with the outline of each structure, and below them the same slices with "
            "colours where the confidence is below 0.9. The table below gives the figures.",
            stacked([outlined[stack], coloured[stack]]),
            lossy=True,
        )
        for stack in outlined
    ]


def _bands_of(labels: UInt8, confidence: Float32, spacing_mm: tuple[float, ...]) -> UInt8:
    """Number of each voxel's band, from 1; 0 where it is sure, and far from the heart."""
    bands = np.searchsorted([band.below for band in _BANDS], confidence, side="right") + 1
    bands[bands > len(_BANDS)] = 0
    outside = np.ascontiguousarray(labels == BACKGROUND)
    bands[edt.edt(outside, anisotropy=spacing_mm, black_border=False) > _AROUND_MM] = 0
    return bands.astype(np.uint8)
