"""Keeping blood compartments as they were: what was apart stays apart, what was joined stays joined."""

from __future__ import annotations

from collections.abc import Sequence

import cc3d
import numpy as np
import numpy.typing as npt

__all__ = ["bridging_voxels"]

Bool = npt.NDArray[np.bool_]
UInt8 = npt.NDArray[np.uint8]
UInt32 = npt.NDArray[np.uint32]


def bridging_voxels(labels: UInt8, smoothed: UInt8, blood_values: Sequence[int]) -> Bool:
    """Voxels that must get their old label back so that the smoothing neither joins nor splits compartments.

    A compartment is a 6-connected piece of all blood. A cluster of voxels that became blood is given back when it
    touches two compartments; one that was blood is given back when it touches two pieces of what is left.

    Parameters
    ----------
    labels
        Label values before, shape [z, y, x].
    smoothed
        Label values after.
    blood_values
        Values of blood and vessel lumen.

    Returns
    -------
    Bool
        Shape of the labels.
    """
    is_blood = np.zeros(256, np.bool_)
    is_blood[list(blood_values)] = True
    before, after = is_blood[labels], is_blood[smoothed]
    given_back = _touching_two(after & ~before, before)
    given_back |= _touching_two(before & ~after, before & after)
    return given_back


def _touching_two(changed: Bool, kept: Bool) -> Bool:
    """Clusters of changed voxels that touch at least two pieces of the kept ones."""
    where = np.argwhere(changed)
    if len(where) == 0:
        return np.zeros(changed.shape, np.bool_)
    clusters = cc3d.connected_components(changed, connectivity=6)
    pieces = np.pad(cc3d.connected_components(kept, connectivity=6), 1)
    cluster = clusters[tuple(where.T)].astype(np.int64)
    pairs = []
    for axis in range(3):
        for step in (-1, 1):
            beside = where + 1
            beside[:, axis] += step
            piece = pieces[tuple(beside.T)].astype(np.int64)
            pairs.append(np.stack([cluster, piece], axis=1)[piece > 0])
    contacts = np.unique(np.concatenate(pairs), axis=0)
    touched = np.bincount(contacts[:, 0], minlength=int(clusters.max()) + 1)
    bridging: Bool = (touched >= 2)[clusters] & changed
    return bridging
