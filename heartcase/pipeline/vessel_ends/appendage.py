"""Telling the appendage of an atrium from its veins.

An appendage lies on the heart: towards the atrium's valve, on other chambers, and beside a great artery. Veins lead
away from it, but a lower one may run close behind a ventricle. Where a great artery's root is labelled as the ventricle
below it, the artery is further away than it seems: what leads forwards is no vein all the same, as these come from
behind, from above or from below.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from heartcase.pipeline.data import Segmentation
from heartcase.pipeline.vessel_ends.inflow import is_great_artery, kind_of
from heartcase.pipeline.vessel_ends.lumen_sections import angle_between
from heartcase.schemas.arrays import Float64
from heartcase.schemas.labels import Label, LabelTable, Role

__all__ = ["Surroundings"]


APPENDAGE_SHARE = 0.6
"""A branch of an atrium is an appendage where the way from the atrium's middle to its tip makes an acute angle with
that to the valve, and the tip is nearer to another chamber than this plus the angle's cosine, in radii of the largest
ball in the atrium."""
ARTERY_SHARE = 1.5
"""Its tip is nearer to a great artery than this, in the same radii, where there is one in the labels."""
FORWARDS = 0.4
"""Cosine between that way and the patient's front from which the tip need not be near a great artery."""


@dataclass(frozen=True)
class Surroundings:
    """What lies around an atrium."""

    segmentation: Segmentation
    """Labels."""
    chambers: tuple[int, ...]
    """Values of the other chambers and of muscle."""
    arteries: tuple[int, ...]
    """Values of the great arteries that there are."""

    @classmethod
    def of(cls, segmentation: Segmentation, table: LabelTable, label: Label) -> Surroundings:
        """The surroundings of one label."""
        values = np.flatnonzero(np.bincount(segmentation.labels.ravel(), minlength=256))
        return cls(
            segmentation,
            tuple(
                one.value
                for one in table
                if one.role in (Role.BLOOD, Role.MYOCARDIUM) and one != label and kind_of(one) != "appendage"
            ),
            tuple(one.value for one in table if is_great_artery(one) and one.value in values),
        )

    def is_appendage(self, tip: Float64, middle: Float64, valve: Float64, widest_mm: float) -> bool:
        """Whether an arm of the atrium is an appendage.

        Parameters
        ----------
        tip
            Its tip, world mm.
        middle
            Middle of the atrium, world mm.
        valve
            Middle of its valve, world mm.
        widest_mm
            Radius of the largest ball in the atrium.
        """
        cosine = np.cos(np.radians(angle_between(valve - middle, tip - middle)))
        if cosine <= 0.0 or self._distance(self.chambers, tip) >= (APPENDAGE_SHARE + cosine) * widest_mm:
            return False
        # towards the front is -y in LPS
        forwards = (middle[1] - tip[1]) / np.linalg.norm(tip - middle)
        if not self.arteries or forwards > FORWARDS:
            return True
        return self._distance(self.arteries, tip) < ARTERY_SHARE * widest_mm

    def _distance(self, values: Sequence[int], point: Float64) -> float:
        """Distance of the nearest voxel of some labels, mm."""
        index = np.argwhere(np.isin(self.segmentation.labels, values))
        away = self.segmentation.geometry.index_to_world(index[:, ::-1]) - point
        return float(np.sqrt((away**2).sum(axis=1)).min(initial=np.inf))
