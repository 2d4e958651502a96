"""Overlaps in marker files and finished segmentations: which label wins is always told."""

from __future__ import annotations

from collections import Counter

from heartcase.pipeline.data import UNMARKED
from heartcase.pipeline.formats.labels.segments import LabelVolume
from heartcase.pipeline.markers.naming import called
from heartcase.pipeline.warnings import CaseWarning, counted, note
from heartcase.schemas.arrays import UInt8
from heartcase.schemas.geometry import Geometry
from heartcase.schemas.labels import LabelTable

__all__ = ["file_over_file", "overlap_warnings"]


def overlap_warnings(volume: LabelVolume, lookup: UInt8, table: LabelTable, place: str) -> tuple[CaseWarning, ...]:
    """Which segments of a file overlap, how far, and which of them has the voxels.

    Parameters
    ----------
    volume
        What was read.
    lookup
        Value of the file -> label value: :class:`heartcase.pipeline.markers.naming.LabelLookup`.
    table
        Label table of the recipe.
    place
        Where in the recipe the file is named; ``order`` is to be written there.

    Returns
    -------
    tuple of CaseWarning
        One line for each pair of segments that stand for different labels.
    """
    warnings = []
    for one in volume.overlaps:
        under, over = int(lookup[one.under]), int(lookup[one.over])
        if under == over or UNMARKED in (under, over):
            continue
        lower = f"the {table[under].name} ({called(volume, [one.under])})"
        upper = f"the {table[over].name} ({called(volume, [one.over])})"
        warnings.append(
            CaseWarning(
                f"{place}: {_amount(one.voxel_count, volume.geometry)} lie in both {lower} and {upper}: the "
                f"{table[over].name} lies on top and has them; for another one on top name the labels under order, the "
                "topmost last",
                has_stated_grade=True,
            )
        )
    return tuple(warnings)


def file_over_file(
    before: UInt8, painted: UInt8, table: LabelTable, geometry: Geometry, place: str
) -> tuple[CaseWarning, ...]:
    """What a marker file paints over that earlier files of the recipe marked otherwise.

    Parameters
    ----------
    before
        Markers of the earlier files, uint8, shape [z, y, x]; 255 where nothing is marked.
    painted
        Those of this file, likewise.
    table
        Label table.
    geometry
        Their lattice.
    place
        Where in the recipe the file is named.

    Returns
    -------
    tuple of CaseWarning
        One line for all of it, for information: the order of the files is the recipe's own.
    """
    both = (before != UNMARKED) & (painted != UNMARKED) & (before != painted)
    if not both.any():
        return ()
    pairs = Counter(zip(before[both].tolist(), painted[both].tolist(), strict=True))
    said = ", ".join(
        f"{_amount(count, geometry)} of the {table[old].name} become {table[new].name}"
        for (old, new), count in sorted(pairs.items())
    )
    return (note(f"{place} paints over what earlier marker files mark: {said}; the later file of the recipe counts"),)


def _amount(voxel_count: int, geometry: Geometry) -> str:
    return f"{counted(voxel_count, 'voxel')} ({voxel_count * geometry.voxel_volume_mm3 / 1000.0:.2g} ml)"
