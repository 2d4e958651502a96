"""Inflow of vessels and atria: where blood comes into them, and which labels have ends at all."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import cc3d
import numpy as np
from scipy.ndimage import binary_dilation, generate_binary_structure
from scipy.spatial import cKDTree

from heartcase.pipeline.data import Segmentation
from heartcase.schemas.arrays import Bool, UInt8
from heartcase.schemas.labels import Label, LabelTable, Role

__all__ = ["LEAST_VOXELS", "VEINS", "Kind", "is_great_artery", "kind_of", "sources_of"]

Kind = Literal["vessel", "atrium", "appendage", "other"]
"""``vessel`` and ``atrium`` have ends, the latter those of the veins that are a part of it."""

LEAST_VOXELS = 30
"""Pieces of a label with fewer voxels are no vessel."""
_ARTERIES = ("aorta", "pulmonary artery")
_ATRIA = ("morphologically left atrium", "morphologically right atrium")
_VENTRICLES = ("morphologically left ventricle", "morphologically right ventricle")
VEINS = {
    "morphologically left atrium": ("pulmonary vein",),
    "morphologically right atrium": ("superior vena cava", "inferior vena cava"),
}
"""Atrium -> the veins that may be a part of its label."""
_APPENDAGES = ("left atrial appendage", "right atrial appendage")


def kind_of(label: Label) -> Kind:
    """What a label is, by its role and its structure."""
    term = label.term.name if label.term is not None else ""
    if not label.role.is_blood:
        return "other"
    if term in _APPENDAGES:
        return "appendage"
    if term in _ATRIA:
        return "atrium"
    return "vessel" if label.role is Role.VESSEL_LUMEN else "other"


def is_great_artery(label: Label) -> bool:
    """Whether a label is the aorta or the pulmonary artery."""
    return label.term is not None and label.term.name in _ARTERIES


def sources_of(segmentation: Segmentation, table: LabelTable, label: Label, mask: Bool) -> Bool:
    """Where the blood comes into each piece of a label.

    That is where it touches the chamber that such a vessel belongs to, of two such chambers the one that it touches
    more; any chamber where it touches none of these; and where it touches none, what lies nearest to one.
    """
    term = label.term.name if label.term is not None else ""
    wanted = _VENTRICLES if term in (*_ARTERIES, *_ATRIA) else _ATRIA
    labels = segmentation.labels
    chambers = [one for one in table if one.role is Role.BLOOD and one.value != label.value]
    first = [one for one in chambers if one.term is not None and one.term.name in wanted]
    cross = generate_binary_structure(3, 1)
    touching = {one.value: mask & binary_dilation(labels == one.value, cross) for one in chambers}
    pieces = cc3d.connected_components(np.ascontiguousarray(mask), connectivity=6)
    counts = np.bincount(pieces.ravel())
    sources = np.zeros_like(mask)
    for number in range(1, len(counts)):
        if counts[number] < LEAST_VOXELS:
            continue
        piece = pieces == number
        for group in (first, chambers):
            contact = [np.count_nonzero(touching[one.value] & piece) for one in group]
            if group and max(contact) > 0:
                sources |= touching[group[int(np.argmax(contact))].value] & piece
                break
        else:
            sources |= _nearest(piece, labels, [one.value for one in first or chambers], segmentation)
    return sources


def _nearest(piece: Bool, labels: UInt8, values: Sequence[int], segmentation: Segmentation) -> Bool:
    """The voxels of a piece that lie within a voxel of the least distance to some labels; all where there are none."""
    others = np.argwhere(np.isin(labels, values))
    own = np.argwhere(piece)
    if len(others) == 0:
        return piece
    geometry = segmentation.geometry
    tree = cKDTree(geometry.index_to_world(others[:, ::-1]))
    distance = np.asarray(tree.query(geometry.index_to_world(own[:, ::-1]))[0])
    found = np.zeros_like(piece)
    found[tuple(own[distance <= distance.min() + max(geometry.spacing_mm)].T)] = True
    return found
