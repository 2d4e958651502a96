"""Confidence in the label of each voxel, for the report.

    confidence = 1 - (own / other)^4 * (d_own / (d_own + d_rival))^2

with the passes ``own`` and ``other`` of :mod:`heartcase.pipeline.watershed.certainty` and the distances to the nearest
voxels painted with the voxel's label and with its rival's: what :mod:`heartcase.pipeline.markers.suggest` weighs its
places by. It is 1 on a marker, and where there is no other label.

The passes alone say little inside blood: where chambers are open to each other, both are those of the noise. It is an
order, no probability: ``heartcase bench segment-confidence`` measures it against the phantom's truth.
"""

from __future__ import annotations

from dataclasses import dataclass

import edt
import numpy as np

from heartcase.pipeline.data import UNMARKED, Markers
from heartcase.pipeline.kernels.boxes import box_of
from heartcase.pipeline.markers.distances import doubt
from heartcase.pipeline.markers.suggest import StrokePlaces, suggest_strokes
from heartcase.pipeline.watershed.certainty import FootCertainty, foot_certainty, voxel_certainty
from heartcase.pipeline.watershed.forest import Forest, solve_forest
from heartcase.pipeline.watershed.tree import BasinTree
from heartcase.schemas.arrays import Float32
from heartcase.schemas.geometry import Geometry

__all__ = ["Sureness", "sureness_of", "voxel_confidence"]


@dataclass(frozen=True)
class Sureness:
    """How sure a segmentation is, and where a look is worth most."""

    confidence: Float32
    """Confidence of each voxel, float32, shape [z, y, x], 0 to 1."""
    strokes: StrokePlaces
    """Places for one more stroke."""


def sureness_of(tree: BasinTree, markers: Markers, *, count: int = 5) -> Sureness:
    """How sure the watershed of some markers is.

    Parameters
    ----------
    tree
        The tree of the smoothed scan's landscape.
    markers
        Its markers.
    count
        Number of places, at most.
    """
    forest = solve_forest(tree, markers.labels)
    feet = foot_certainty(forest)
    places = suggest_strokes(forest, markers.geometry, count=count, feet=feet)
    return Sureness(voxel_confidence(forest, markers.geometry, feet), places)


def voxel_confidence(forest: Forest, geometry: Geometry, feet: FootCertainty | None = None) -> Float32:
    """Confidence of every voxel.

    Parameters
    ----------
    forest
        A solved forest.
    geometry
        Its lattice.
    feet
        Its :func:`heartcase.pipeline.watershed.certainty.foot_certainty`, where it is at hand.

    Returns
    -------
    ndarray
        float32, the lattice's shape, 0 to 1.
    """
    feet = feet or foot_certainty(forest)
    labels, basin = forest.labels, forest.tree.basin
    rival = feet.rival[basin]
    # above a marked voxel the label may be the foot's rival: then the foot's own is the other one
    rival = np.where(rival == labels, forest.foot_label[basin], rival)
    own_mm, rival_mm = np.zeros(labels.shape, np.float32), np.zeros(labels.shape, np.float32)
    for value in np.unique(forest.painted[forest.painted != UNMARKED]).tolist():
        # The label's markers have its label, so they lie in the box of those that ask for it.
        box = box_of((labels == value) | (rival == value))
        unmarked = np.ascontiguousarray(forest.painted[box] != value)
        away = edt.edt(unmarked, anisotropy=geometry.spacing_mm[::-1], black_border=False, parallel=0)
        np.copyto(own_mm[box], away, where=labels[box] == value)
        np.copyto(rival_mm[box], away, where=rival[box] == value)
    nearness = own_mm / np.maximum(own_mm + rival_mm, np.finfo(np.float32).tiny)
    doubts = doubt(voxel_certainty(forest, feet), nearness)
    confidence: Float32 = np.where(labels == UNMARKED, np.float32(0.0), np.float32(1.0) - doubts)
    return confidence
