"""Connected components of a bare structure: keeping the largest, removing small ones.

Pieces are those of the voxels that the structure owns before any reshaping: 26-connected in tissue, 6-connected in
blood and background. A piece that goes takes the wall grown around it along.
"""

from __future__ import annotations

from dataclasses import replace

import cc3d
import edt
import numpy as np
import numpy.typing as npt

from heartcase.pipeline.data import Structures
from heartcase.pipeline.edits.borders import Borders, distance_beyond_band
from heartcase.pipeline.warnings import CaseWarning, WarningGrade, counted, of_edit
from heartcase.schemas.arrays import Bool, Int64
from heartcase.schemas.labels import BACKGROUND, Label
from heartcase.schemas.recipe.edit_settings import RemoveIslands

__all__ = ["keep_largest_piece", "remove_islands"]


def keep_largest_piece(structures: Structures, label: Label, into: Label | None, number: int) -> Structures:
    """Give all pieces of a structure but the largest (ties: the first in the volume's order) away."""
    borders = Borders(structures)
    gone = _remove_pieces(borders, label, np.inf, into)
    return _told(borders.changed, {label.name: gone} if gone else {}, f"'{label.name}' is one piece", number)


def remove_islands(
    structures: Structures, edit: RemoveIslands, labels: tuple[Label, ...], into: Label | None, number: int
) -> Structures:
    """Give the pieces below a volume away, label by label; each label's largest piece stays however small it is."""
    borders = Borders(structures)
    most = 1000.0 * edit.smallest_ml / structures.geometry.voxel_volume_mm3
    found: dict[str, list[int]] = {}
    for label in labels:
        if into is not None and label.value == into.value:
            continue
        gone = _remove_pieces(borders, label, most, into)
        if gone:
            found[label.name] = gone
    return _told(borders.changed, found, f"no piece is below {edit.smallest_ml:g} ml", number)


def _told(structures: Structures, gone: dict[str, list[int]], nothing: str, number: int) -> Structures:
    lines: list[CaseWarning] = []
    for name, counts in gone.items():
        volume = sum(counts) * structures.geometry.voxel_volume_mm3 / 1000.0
        text = f"{counted(len(counts), 'piece')} of '{name}' given away, {volume:.2f} ml in all"
        lines.append(of_edit(number, text, WarningGrade.NOTE))
    if not gone:
        lines.append(of_edit(number, f"{nothing}, so the edit changes nothing", WarningGrade.NOTE))
    return replace(structures, warnings=(*structures.warnings, *lines))


def _remove_pieces(borders: Borders, label: Label, most: float, into: Label | None) -> list[int]:
    """Give the pieces of fewer voxels than ``most`` away, the largest excepted; voxels of each that went."""
    mine: Bool = borders.owner() == label.value
    pieces = cc3d.connected_components(mine, connectivity=26 if label.role.is_tissue else 6)
    counts = np.bincount(pieces.ravel()).astype(np.int64)
    counts[0] = 0
    if len(counts) < 3:
        return []
    goes = counts < most
    goes[[0, int(counts.argmax())]] = False
    numbers = np.flatnonzero(goes)
    if len(numbers) == 0:
        return []
    stays = mine & ~goes[pieces]
    boxes = cc3d.statistics(pieces)["bounding_boxes"]
    for number in numbers:
        k, j, i = boxes[number]
        _remove_piece(borders, label, pieces, int(number), stays, np.array([i, j, k]), into)
    if label.value != BACKGROUND:
        borders.replace_beyond(label.value, distance_beyond_band(stays, borders.spacing_mm))
    return [int(counts[number]) for number in numbers]


def _remove_piece(
    borders: Borders,
    label: Label,
    pieces: Int64,
    number: int,
    stays: Bool,
    extent: npt.NDArray[np.object_],
    into: Label | None,
) -> None:
    """Move the border away from around one piece."""
    low = np.array([part.start for part in extent], dtype=float)
    high = np.array([part.stop for part in extent], dtype=float) - 1.0
    box = borders.box_around(low, high, 2.0 * borders.structures.band_mm + 3.0 * float(borders.spacing_mm.max()))
    if box is None:
        return
    spacing = borders.spacing_mm
    to_piece = np.asarray(
        edt.edt(pieces[box] != number, anisotropy=tuple(float(v) for v in spacing), parallel=1)
    ) - np.float32(0.5 * spacing.mean())
    to_rest = distance_beyond_band(stays[box], spacing)
    own = borders.fields[label.value][box]
    beside = (to_piece < to_rest) & ~stays[box]
    outside = np.maximum(to_rest, np.float32(0.25 * spacing.min()))
    field = np.where(beside, outside, own).astype(np.float32)
    borders.move(label.value, box, field, None if into is None else into.value)
