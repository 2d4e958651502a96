"""Cutting vessels off at end markers: the label goes from the voxels beyond, the exact plane becomes a reshaping."""

from __future__ import annotations

from collections.abc import Sequence

import cc3d
import numpy as np
import numpy.typing as npt

from heartcase.pipeline.data import Reshaping, Segmentation
from heartcase.schemas.errors import Problem, StageError
from heartcase.schemas.labels import BACKGROUND, LabelTable
from heartcase.schemas.settings import EndMarker

__all__ = ["cut_ends"]

Bool = npt.NDArray[np.bool_]
Float64 = npt.NDArray[np.float64]
UInt8 = npt.NDArray[np.uint8]


def cut_ends(
    segmentation: Segmentation, table: LabelTable, ends: Sequence[EndMarker], *, clearance_mm: float
) -> tuple[UInt8, tuple[Reshaping, ...]]:
    """Take each vessel's label from the voxels beyond its end marker.

    A stump of ``clearance_mm`` stays so that the fields are undisturbed at the plane; a reshaping takes it away.

    Parameters
    ----------
    segmentation
        Labels; not changed.
    table
        Label table with the grown walls.
    ends
        End markers.
    clearance_mm
        Length of the stump: more than the thickest wall and the reach of the smoothing.

    Returns
    -------
    labels : UInt8
        Labels without the parts beyond the stumps.
    cuts : tuple of Reshaping
        One for each marker, in order.

    Raises
    ------
    StageError
        For every marker that lies outside the volume, touches no vessel of its label, or does not cut through it.
    """
    labels = segmentation.labels.copy()
    cuts: list[Reshaping] = []
    problems: list[Problem] = []
    for number, end in enumerate(ends, start=1):
        try:
            label = table[end.label]
        except KeyError:
            problems.append(Problem(f"ends[{number}]", f"there is no label {end.label!r}: check the name"))
            continue
        position = np.array(end.position_mm)
        axis = np.array(end.axis) / np.linalg.norm(end.axis)
        message = _cut(labels, segmentation, label.value, position, axis, end.radius_mm, clearance_mm)
        if message:
            problems.append(Problem(f"ends[{number}]", message.format(name=label.name)))
            continue
        wall = table.wall_value(label.value)
        sources = (label.name,) if wall is None else (label.name, table[wall].name)
        far = position + 2.0 * clearance_mm * axis
        cuts.append(
            Reshaping(
                "cylinder",
                (end.position_mm, (float(far[0]), float(far[1]), float(far[2]))),
                end.radius_mm,
                sources,
                (table[BACKGROUND].name,),
            )
        )
    if problems:
        raise StageError(problems)
    return labels, tuple(cuts)


def _cut(
    labels: UInt8,
    segmentation: Segmentation,
    value: int,
    position: Float64,
    axis: Float64,
    radius_mm: float,
    clearance_mm: float,
) -> str:
    """Clear one vessel beyond its stump in place; what is wrong, or an empty string."""
    geometry = segmentation.geometry
    voxel = float(max(geometry.spacing_mm))
    where = np.argwhere(segmentation.labels == value)
    if len(where) == 0:
        return "there is no '{name}' in the segmentation: check the markers, or remove this end marker"
    offset = geometry.index_to_world(where[:, ::-1]) - position
    along = offset @ axis
    across = np.linalg.norm(offset - along[:, None] * axis, axis=1)
    on_disc = across <= radius_mm
    near = on_disc & (np.abs(along) <= 1.5 * voxel)
    if not near.any():
        return "the disc touches no '{name}': move its position_mm onto the vessel, or enlarge radius_mm"
    vessel = np.zeros(labels.shape, np.bool_)
    vessel[tuple(where[~(on_disc & (along >= 0.0) & (along <= 1.8 * voxel))].T)] = True
    pieces = cc3d.connected_components(vessel, connectivity=6)
    piece = pieces[tuple(where.T)]
    before = set(np.unique(piece[on_disc & (along < 0.0) & (along >= -1.8 * voxel)])) - {0}
    after = set(np.unique(piece[on_disc & (along > 1.8 * voxel) & (along <= 3.6 * voxel)])) - {0}
    if before & after:
        return "the disc does not cut through '{name}': enlarge radius_mm, or set the axis along the vessel"
    beyond = np.isin(piece, sorted(after)) & ~(on_disc & (along <= clearance_mm) & (along >= 0.0))
    labels[tuple(where[beyond].T)] = BACKGROUND
    return ""
