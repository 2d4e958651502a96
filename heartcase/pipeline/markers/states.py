"""How far each structure is: nothing marked, marked, or worked out to be sure or unsure."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from heartcase.pipeline.data import UNMARKED
from heartcase.pipeline.markers.suggest import RightPlace, StrokePlaces, still_right, suggest_strokes
from heartcase.pipeline.watershed.forest import Forest
from heartcase.schemas.geometry import Geometry
from heartcase.schemas.labels import LabelTable

__all__ = ["StillSegmentation", "StructureState", "structure_states"]

PLACE_COUNT = 12
"""Places that are looked at."""
UNSURE_SHARE = 0.02
"""Share of a structure's volume from which on places that may be wrong make it unsure."""


class StructureState(StrEnum):
    """How far a structure is."""

    NOTHING = "nothing"
    """Nothing is marked with it."""
    MARKED = "marked"
    """It is marked; there is nothing beside it yet that it could be told from."""
    CONFIDENT = "confident"
    """No place where a look is worth a stroke would change much of it."""
    UNSURE = "unsure"
    """There are such places, in it or beside it."""


@dataclass(frozen=True)
class StillSegmentation:
    """A segmentation as it was at one moment: it can be looked at while painting goes on."""

    forest: Forest
    """Copies of what painting changes."""
    geometry: Geometry
    """Its lattice."""
    table: LabelTable
    """What may be painted."""
    right: tuple[RightPlace, ...] = ()
    """Places that somebody found right: they make nothing unsure."""


def structure_states(still: StillSegmentation, *, places: StrokePlaces | None = None) -> dict[int, StructureState]:
    """How far each label is.

    Of the places that :func:`heartcase.pipeline.markers.suggest.suggest_strokes` names, twelve at most, those count
    for a label that have it, or may have it. It is unsure where what a look at them is worth, together, is 2% of its
    volume or more. Of k places of a label that somebody looked at and found right, the next is wrong with a
    probability of 1 / (k + 2) (Laplace's rule of succession), so that what they are worth counts 2 / (k + 2) times.

    Parameters
    ----------
    still
        The segmentation.
    places
        Its places, where they are at hand.

    Returns
    -------
    dict
        Label value -> state, of every label of the table.
    """
    forest = still.forest
    marked = set(np.flatnonzero(forest.painted_counts()).tolist()) - {UNMARKED}
    states = {
        label.value: StructureState.MARKED if label.value in marked else StructureState.NOTHING for label in still.table
    }
    if len(marked) < 2:
        return states
    if places is None:
        places = suggest_strokes(forest, still.geometry, count=PLACE_COUNT, right=still.right)
    right = still_right(forest, still.geometry, still.right)
    volumes = forest.label_counts() * (still.geometry.voxel_volume_mm3 / 1000.0)
    for value in sorted(marked & set(states)):
        right_count = sum(value in (one.label, one.rival) for one in right)
        worth = sum(place.worth_ml for place in places.places if value in (place.label, place.rival))
        worth *= 2.0 / (right_count + 2.0)
        is_unsure = worth > 0.0 and worth >= UNSURE_SHARE * volumes[value]
        states[value] = StructureState.UNSURE if is_unsure else StructureState.CONFIDENT
    return states
