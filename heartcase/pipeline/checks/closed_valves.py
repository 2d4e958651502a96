"""Atria and great arteries that are open to no ventricle: a valve that is closed, or labels that do not meet at it.

Of valves that are open, :mod:`heartcase.pipeline.checks.openings` judges the size.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.spatial import cKDTree

from heartcase.pipeline.checks.openings import Opening
from heartcase.pipeline.data import Segmentation
from heartcase.pipeline.warning_words import sentence
from heartcase.pipeline.warnings import CaseWarning
from heartcase.schemas.arrays import Bool, Float64, UInt8
from heartcase.schemas.labels import Label
from heartcase.schemas.terms import Term, term_by_name

__all__ = ["closed_valve_warnings"]

_VENTRICLES = frozenset((term_by_name("lv"), term_by_name("rv")))
_ON_VENTRICLES = tuple(term_by_name(name) for name in ("ra", "la", "aorta", "pa"))
"""What opens to a ventricle in every heart without atresia, whichever ventricle it is."""


def closed_valve_warnings(labels: Segmentation, openings: Sequence[Opening]) -> tuple[CaseWarning, ...]:
    """One warning for each atrium and great artery from which no blood comes to or from a ventricle.

    Parameters
    ----------
    labels
        The label of every voxel of the model: :func:`heartcase.pipeline.bundle.assembly.labels_of`.
    openings
        Where cavities are open to each other: :func:`heartcase.pipeline.checks.openings.find_openings`.

    Returns
    -------
    tuple of CaseWarning
        Each with the place half way between the two where they are nearest. Empty where there is no ventricle.
    """
    present = np.flatnonzero(np.bincount(labels.labels.ravel(), minlength=256))
    blood = [one for one in labels.table if one.role.is_blood and one.value in present]
    ventricles = [one.value for one in blood if one.term in _VENTRICLES]
    if not ventricles:
        return ()
    open_pairs = [set(one.labels) for one in openings]

    def is_open(values: list[int]) -> bool:
        return any(pair & set(values) and pair & set(ventricles) for pair in open_pairs)

    closed = [(term, values) for term in _ON_VENTRICLES if (values := _values_of(blood, term)) and not is_open(values)]
    if not closed:
        return ()
    points, owners = _border_of(labels, ventricles)
    tree = cKDTree(points)
    return tuple(_warning(labels, values, tree, owners) for _, values in closed)


def _values_of(blood: Sequence[Label], term: Term | None) -> list[int]:
    """Values of the labels of a term."""
    return [one.value for one in blood if one.term == term]


def _warning(labels: Segmentation, values: list[int], ventricles: cKDTree, owners: UInt8) -> CaseWarning:
    points, own = _border_of(labels, values)
    away, nearest = map(np.asarray, ventricles.query(points, workers=1))
    # Of places that are as near, the first: the same one on every machine.
    here = int(np.argmin(away.round(6)))
    there = int(nearest[here])
    x, y, z = (0.5 * (points[here] + ventricles.data[there])).tolist()
    said = {
        "one": labels.table[int(own[here])].name,
        "other": labels.table[int(owners[there])].name,
        "gap": f"{away[here]:.1f}",
        "place": f"({x:.1f}, {y:.1f}, {z:.1f})",
    }
    return CaseWarning(sentence("valve-closed", **said), code="valve-closed", places_mm=((x, y, z),))


def _border_of(labels: Segmentation, values: Sequence[int]) -> tuple[Float64, UInt8]:
    """Centres of voxels at the border of some labels, world mm, shape (n, 3), and the label of each, shape (n,)."""
    inside: Bool = np.isin(labels.labels, values)
    is_deep = np.zeros_like(inside)
    core = (slice(1, -1),) * 3
    is_deep[core] = inside[core]
    for axis in range(3):
        for step in (-1, 1):
            is_deep &= np.roll(inside, step, axis)
    place = np.nonzero(inside & ~is_deep)
    index = np.stack(place[::-1], axis=1).astype(float)
    return labels.geometry.index_to_world(index), labels.labels[place]
