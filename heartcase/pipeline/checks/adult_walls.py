"""Walls as thick as an adult's, grown around the heart of a child."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from heartcase.pipeline.checks.openings import root_of_surface_m
from heartcase.pipeline.data import Segmentation
from heartcase.pipeline.warning_words import sentence
from heartcase.pipeline.warnings import CaseWarning
from heartcase.schemas.labels import default_label_table

__all__ = ["adult_wall_warnings"]

ADULT_ROOT_M = 1.75**0.5
"""Square root of an adult's body surface area in m2, a round number, enough for SMALL. That lengths of a heart go with
it is from the source at ``_VALVES_MM`` of :mod:`heartcase.pipeline.checks.openings`."""
SMALL = 0.7
"""Length of a heart over an adult's up to which an adult's walls are told of: some 0.86 m2 of body surface."""


def adult_wall_warnings(labels: Segmentation, varying: Collection[str] = ()) -> tuple[CaseWarning, ...]:
    """Tell of walls whose thickness is that of the usual labels, an adult's, where the ventricles are a child's.

    Parameters
    ----------
    labels
        Label of every voxel, after edits and end cuts.
    varying
        Names of cavities whose walls a table of thicknesses gives.
    """
    root_m = root_of_surface_m(labels)
    if root_m is None or root_m > SMALL * ADULT_ROOT_M:
        return ()
    share = root_m / ADULT_ROOT_M
    usual = {label.term: label.wall_thickness_mm for label in default_label_table() if label.wall_thickness_mm > 0.0}
    counts = np.bincount(labels.labels.ravel(), minlength=256)
    names = {name.casefold() for name in varying}
    adult = [
        label
        for label in labels.table
        if counts[label.value]
        and label.name.casefold() not in names
        and label.term is not None
        and label.wall_thickness_mm == usual.get(label.term)
    ]
    if not adult:
        return ()
    listed = ", ".join(
        f"{label.name} {label.wall_thickness_mm:g} mm (some {share * label.wall_thickness_mm:.1f})" for label in adult
    )
    text = sentence("adult-walls", area=f"{root_m**2:.1f}", listed=listed)
    return (CaseWarning(text, code="adult-walls"),)
