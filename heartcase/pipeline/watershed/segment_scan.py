"""A label for each voxel, by watershed or thresholds (thesis 11.1.1, and 12.3.2 for plastinated specimens)."""

from __future__ import annotations

from collections.abc import Callable, Collection

import cc3d
import numpy as np

from heartcase.pipeline.data import UNMARKED, Markers, Scan, Segmentation
from heartcase.pipeline.warning_words import sentence
from heartcase.pipeline.warnings import CaseWarning, anatomy
from heartcase.pipeline.watershed.forest import solve_forest
from heartcase.pipeline.watershed.tree import BasinTree
from heartcase.pipeline.watershed.tree_cache import scan_tree
from heartcase.schemas.arrays import Bool, Float32, Int64, Integer, UInt8
from heartcase.schemas.errors import MarkerError, Problem, StageError
from heartcase.schemas.geometry import Geometry
from heartcase.schemas.labels import BACKGROUND, LabelTable
from heartcase.schemas.recipe.settings import SegmentSettings, ThresholdRange

__all__ = ["keep_large_pieces", "segment_by_threshold", "segment_scan", "segmentation_warnings"]


TISSUE_CONNECTIVITY = 26
BLOOD_CONNECTIVITY = 6
PIECES_NAMED = 3
"""How many stray pieces of a label a warning describes; the rest is counted."""


def segment_scan(
    filtered: Scan,
    markers: Markers | None,
    settings: SegmentSettings,
    table: LabelTable,
    *,
    make_tree: Callable[[], BasinTree] | None = None,
) -> Segmentation:
    """Give each voxel a label, by marker-based watershed or by intensity ranges.

    A marked voxel keeps the label it was marked with, by either method.

    Parameters
    ----------
    filtered
        The smoothed scan.
    markers
        Marked voxels on the same lattice; None where there are none (enough for thresholds).
    settings
        Method and its numbers. A finished segmentation (``method="labels"``) is read, not computed: not here.
    table
        What the label values stand for.
    make_tree
        Gives the tree of the scan's gradient where it is kept; it is worked out when left out.

    Returns
    -------
    Segmentation
        Labels on the scan's lattice: by watershed, those of :mod:`heartcase.pipeline.watershed`.

    Raises
    ------
    StageError
        The scan holds values that are not finite, or the method is ``labels``.
    MarkerError
        The watershed has no marker at all, the markers lie on another lattice, or mark values that are not in the
        table.
    """
    if settings.method == "labels":
        raise StageError("a finished segmentation is read from its file, there is nothing to compute", place="segment")
    bad = int(np.size(filtered.values) - np.count_nonzero(np.isfinite(filtered.values)))
    if bad:
        raise StageError(
            f"{bad} voxels of the scan are NaN or infinite; give them the intensity of air or crop them away",
            place="segment",
        )
    if markers is not None:
        _check_markers(markers, filtered.geometry, table)
    if settings.method == "watershed":
        if markers is None or not np.any(markers.labels != UNMARKED):
            raise MarkerError(
                "no voxel of the scan is marked; paint at least one marker for each structure and one for background",
                place="markers",
            )
        tree = make_tree() if make_tree else scan_tree(filtered, settings)
        labels = solve_forest(tree, markers.labels).labels
    else:
        labels = segment_by_threshold(filtered.values, settings.ranges, table)
        marked = np.zeros(labels.shape, bool) if markers is None else markers.labels != UNMARKED
        if markers is not None:
            labels[marked] = markers.labels[marked]
        labels = keep_large_pieces(
            labels, filtered.geometry, table, smallest_piece_ml=settings.smallest_piece_ml, keep=marked
        )
    return Segmentation(labels=labels, geometry=filtered.geometry, table=table)


def segment_by_threshold(values: Float32, ranges: tuple[ThresholdRange, ...], table: LabelTable) -> UInt8:
    """Label voxels by intensity, bounds included; the first range that holds a voxel wins, the rest is background."""
    labels = np.full(values.shape, BACKGROUND, np.uint8)
    for wanted in reversed(ranges):
        inside = np.ones(values.shape, bool)
        if wanted.lower is not None:
            inside &= values >= wanted.lower
        if wanted.upper is not None:
            inside &= values <= wanted.upper
        labels[inside] = table[wanted.label].value
    return labels


def keep_large_pieces(
    labels: UInt8,
    geometry: Geometry,
    table: LabelTable,
    *,
    smallest_piece_ml: float,
    keep: Bool | None = None,
) -> UInt8:
    """Turn the small pieces of each label into background.

    Pieces of tissue hang together over faces, edges and corners (26 neighbours), pieces of blood over faces (6).

    Parameters
    ----------
    labels
        Label values, uint8, shape [z, y, x]; not changed.
    geometry
        Their lattice.
    table
        Which labels are tissue and which are blood.
    smallest_piece_ml
        Pieces of less volume than this go; 0 keeps all.
    keep
        Voxels whose pieces stay whatever their size: the marked ones.

    Returns
    -------
    ndarray
        uint8, same shape.
    """
    if smallest_piece_ml <= 0.0:
        return labels
    smallest = smallest_piece_ml * 1000.0 / geometry.voxel_volume_mm3
    cleaned = labels.copy()
    for connectivity, values in _groups(table):
        pieces, counts = _pieces(labels, values, connectivity)
        small = counts < smallest
        small[0] = False
        if keep is not None:
            small[np.unique(pieces[keep])] = False
        cleaned[small[pieces]] = BACKGROUND
    return cleaned


def segmentation_warnings(
    segmentation: Segmentation,
    markers: Markers | None = None,
    *,
    filtered: Scan | None = None,
    made_later: Collection[int] = (),
) -> tuple[CaseWarning, ...]:
    """What a reader of the result should know, in plain words.

    Parameters
    ----------
    segmentation
        The result.
    markers
        The markers it was made from, if any: then labels and a background without markers are named.
    filtered
        The scan it was made from, if at hand: then a scan without contrast is named.
    made_later
        Label values that edits make: that these are absent is not told.

    Returns
    -------
    tuple of str
        One line each: no contrast, no marker, absent or stray pieces of a label with volume and place in mm.
    """
    warnings: list[CaseWarning] = []
    if filtered is not None and filtered.values.size and filtered.values.min() == filtered.values.max():
        warnings.append(anatomy(sentence("no-contrast")))
    table = segmentation.table
    unmarked: set[int] = set()
    if markers is not None:
        unmarked = set(table.values) - set(np.unique(markers.labels).tolist())
        if BACKGROUND in unmarked:
            warnings.append(anatomy(sentence("no-background")))
    found = np.bincount(segmentation.labels.ravel(), minlength=256)
    for label in table:
        if label.value != BACKGROUND and not found[label.value] and label.value not in made_later:
            kind = "not-painted" if label.value in unmarked else "not-found"
            warnings.append(CaseWarning(sentence(kind, label=label.name)))
    for connectivity, values in _groups(table):
        warnings += _stray_pieces(segmentation, values, connectivity)
    return tuple(warnings)


def _stray_pieces(segmentation: Segmentation, values: tuple[int, ...], connectivity: int) -> list[CaseWarning]:
    """A warning for each label that is in several pieces."""
    pieces, counts = _pieces(segmentation.labels, values, connectivity)
    total = len(counts) - 1
    if total < 1:
        return []
    # The first voxel of a piece stands for its label and, unlike a centroid, always lies in it.
    numbers, first = np.unique(pieces, return_index=True)
    owner = segmentation.labels.ravel()[first]
    warnings: list[CaseWarning] = []
    for value in values:
        own = [int(n) for n, label in zip(numbers, owner, strict=True) if n and label == value]
        if len(own) < 2:
            continue
        own.sort(key=lambda n: (-counts[n], first[n]))
        stray = []
        for n in own[1 : 1 + PIECES_NAMED]:
            k, j, i = np.unravel_index(first[n], pieces.shape)
            x, y, z = segmentation.geometry.index_to_world((i, j, k))
            volume = counts[n] * segmentation.geometry.voxel_volume_mm3 / 1000.0
            stray.append(f"{volume:.2g} ml near ({x:.0f}, {y:.0f}, {z:.0f}) mm")
        more = len(own) - 1 - len(stray)
        rest = f" and {more} more" if more else ""
        name, listed = segmentation.table[value].name, f"{', '.join(stray)}{rest}"
        warnings.append(CaseWarning(sentence("stray-pieces", label=name, pieces=len(own), listed=listed)))
    return warnings


def _groups(table: LabelTable) -> tuple[tuple[int, tuple[int, ...]], ...]:
    """Connectivity and label values of tissue and of blood."""
    return (TISSUE_CONNECTIVITY, table.tissue_values), (BLOOD_CONNECTIVITY, table.blood_values)


def _pieces(labels: UInt8, values: tuple[int, ...], connectivity: int) -> tuple[Integer, Int64]:
    """Number of the piece of each voxel of these labels (0 elsewhere), and the voxel count of each number."""
    wanted = np.isin(np.arange(256), values)
    masked = np.where(wanted[labels], labels, np.uint8(0))
    pieces = cc3d.connected_components(np.ascontiguousarray(masked), connectivity=connectivity)
    return pieces, np.bincount(pieces.ravel())


def _check_markers(markers: Markers, geometry: Geometry, table: LabelTable) -> None:
    """Refuse markers on another lattice or with values that the table does not have."""
    if not markers.geometry.matches(geometry) or markers.labels.shape != geometry.shape:
        raise MarkerError("the markers lie on another lattice than the scan; put them on the scan's", place="markers")
    present = set(np.unique(markers.labels).tolist()) - {UNMARKED}
    unknown = sorted(present - set(table.values))
    if unknown:
        listed = ", ".join(str(value) for value in unknown)
        known = ", ".join(f"{label.value} {label.name}" for label in table)
        raise MarkerError(
            [Problem("markers", f"value {listed} is not in the label table ({known}); mark with those, or add it")]
        )
