"""Finding the ends of vessels from the labels, with the discs that cut them open.

A vessel's blood comes in where its lumen touches the chamber that it belongs to. From there the lumen is followed to
the tips of its branches (:mod:`heartcase.pipeline.vessel_ends.lumen_branches`), and at each tip a disc is looked for,
from outside in: across the lumen, where it is a tube on the heart's side, cutting it through as
:func:`heartcase.pipeline.vessel_ends.cut_ends.cut_ends` asks for, and nothing else of the same label. Veins that are a
part of an atrium's label are found in the same way, from its valve. There a branch is an appendage, and no vessel,
where it lies towards the valve. Where branches have no place for a disc before they join, the vessel is cut behind the
joint.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np

from heartcase.pipeline.data import Segmentation, VesselEnd
from heartcase.pipeline.vessel_ends.discs import Stumps, end_marker
from heartcase.pipeline.vessel_ends.inflow import VEINS, kind_of
from heartcase.pipeline.vessel_ends.label_ends import LabelSearch
from heartcase.schemas.labels import LabelTable
from heartcase.schemas.recipe.settings import EndMarker

__all__ = ["FoundEnds", "find_ends"]


@dataclass(frozen=True)
class FoundEnds:
    """The ends of the vessels of a segmentation."""

    ends: tuple[VesselEnd, ...]
    """Discs that cut a vessel open, and lumens that are open at a face of the volume already."""
    dropped: tuple[str, ...]
    """Branches that end without a place for a disc, in plain words."""

    @property
    def markers(self) -> tuple[EndMarker, ...]:
        """The discs as a recipe has them."""
        return tuple(end_marker(end) for end in self.ends if not end.is_open)


def find_ends(
    segmentation: Segmentation,
    table: LabelTable,
    stumps: Stumps,
    *,
    known: Sequence[EndMarker] = (),
    only: Collection[int] | None = None,
) -> FoundEnds:
    """Find where vessels end, and propose the discs that cut them open.

    Parameters
    ----------
    segmentation
        Labels; not changed.
    table
        Label table. Ends are sought of vessels, and of veins that are a part of an atrium; of those labels alone that
        get a wall, as nothing closes the others.
    stumps
        What the cuts will leave behind their discs.
    known
        End markers that there are already; branches that they cut are not told.
    only
        Label values to look at; all when left out.

    Returns
    -------
    FoundEnds
        By label value; the longest way from the heart first. Positions are rounded to 0.1 mm, axes to 0.001.
    """
    ends: list[VesselEnd] = []
    dropped: list[str] = []
    values = np.flatnonzero(np.bincount(segmentation.labels.ravel(), minlength=256))
    there = {label.term.name for label in table if label.term is not None and label.value in values}
    for label in table:
        if kind_of(label) not in ("vessel", "atrium") or stumps.wall_mm(label) == 0.0:
            continue
        if only is not None and label.value not in only:
            continue
        if label.term is not None and label.term.name in VEINS and there >= {*VEINS[label.term.name]}:
            continue
        search = LabelSearch.of(segmentation, table, label, stumps, known)
        if search is None:
            continue
        found, lost = search.ends()
        ends += found
        dropped += lost
    return FoundEnds(tuple(ends), tuple(dropped))
