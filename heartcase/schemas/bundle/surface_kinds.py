"""What each triangle of the visible surface is: endocardium, epicardium, a vessel's inside, a cut end and so on."""

from __future__ import annotations

from enum import IntEnum

import numpy as np
import numpy.typing as npt

from heartcase.schemas.arrays import UInt8
from heartcase.schemas.labels import BACKGROUND, LabelTable, Role

__all__ = ["SurfaceKind", "group_labels", "plain_kinds"]


class SurfaceKind(IntEnum):
    """Kind of a triangle. The numbers are part of the bundle's format."""

    ENDOCARDIUM = 1
    """Inside of a chamber."""
    VESSEL_INSIDE = 2
    """Inside of a vessel."""
    EPICARDIUM = 3
    """Outside of muscle and of the walls of chambers."""
    VESSEL_OUTSIDE = 4
    """Outside of a vessel's wall."""
    DEVICE = 5
    """A patch or another device, from whichever side."""
    DEFECT_RIM = 6
    """Around an opening between chambers or vessels that no normal heart has, or that the recipe states."""
    CUT_FACE = 7
    """Where the tissue was cut off, by the end of a vessel or of the scan."""
    GROWN_SEPTUM = 8
    """A wall between two cavities that was grown where their outlines touch and not seen, from inside either."""

    @property
    def is_of_void(self) -> bool:
        """Whether such triangles go by the cavity before them."""
        return self in (SurfaceKind.ENDOCARDIUM, SurfaceKind.VESSEL_INSIDE)

    @property
    def is_of_tissue(self) -> bool:
        """Whether such triangles go by the tissue behind them."""
        return self in (SurfaceKind.VESSEL_OUTSIDE, SurfaceKind.DEVICE, SurfaceKind.GROWN_SEPTUM)


def plain_kinds(void: UInt8, tissue: UInt8, is_cut: npt.ArrayLike, table: LabelTable) -> UInt8:
    """Kind of each triangle by the labels on its two sides; no triangle is a defect's rim.

    Parameters
    ----------
    void, tissue
        Label of the void before, and of the tissue behind each triangle, shape (triangle_count,).
    is_cut
        Where the tissue was cut off, same shape.
    table
        Label table, grown walls included.
    """
    inside = np.full(256, SurfaceKind.ENDOCARDIUM, np.uint8)
    outside = np.full(256, SurfaceKind.EPICARDIUM, np.uint8)
    is_device, is_septum = np.zeros(256, np.bool_), np.zeros(256, np.bool_)
    roles = {label.value: label.role for label in table}
    for label in table:
        if label.role is Role.VESSEL_LUMEN:
            inside[label.value] = SurfaceKind.VESSEL_INSIDE
        elif label.role is Role.WALL and (label.wall_of is None or roles.get(label.wall_of) is not Role.BLOOD):
            outside[label.value] = SurfaceKind.VESSEL_OUTSIDE
        is_device[label.value] = label.role is Role.DEVICE
        is_septum[label.value] = label.septum_of is not None
    kinds = np.where(void == BACKGROUND, outside[tissue], inside[void])
    kinds[is_septum[tissue] & (void != BACKGROUND)] = SurfaceKind.GROWN_SEPTUM
    kinds[is_device[tissue]] = SurfaceKind.DEVICE
    kinds[np.asarray(is_cut).astype(np.bool_)] = SurfaceKind.CUT_FACE
    return kinds.astype(np.uint8)


def group_labels(kinds: UInt8, void: UInt8, tissue: UInt8) -> UInt8:
    """Label by which triangles of one kind are told apart; 0 where all of the kind go together."""
    of_void = np.isin(kinds, [kind for kind in SurfaceKind if kind.is_of_void])
    of_tissue = np.isin(kinds, [kind for kind in SurfaceKind if kind.is_of_tissue])
    return np.where(of_void, void, np.where(of_tissue, tissue, 0)).astype(np.uint8)
