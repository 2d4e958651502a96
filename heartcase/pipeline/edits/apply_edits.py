"""Carrying out edits: septal defects made and closed, structures sculpted and cleaned of stray components.

Defects, patches and strokes that add or remove become reshapings: nothing is resampled, they are worked out wherever
the structures are read, so a defect is as round and a patch as thin as the recipe says. Smoothing, filling and the
removal of pieces change the stored fields of the bare structures near the place, below all reshapings; grown walls
follow. Taking an edit out of the recipe, or setting ``enabled = false``, takes it out of the heart.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from heartcase.pipeline.data import Reshaping, Structures
from heartcase.pipeline.edits.brushes import fill_structure, smooth_structure
from heartcase.pipeline.edits.components import keep_largest_piece, remove_islands
from heartcase.pipeline.edits.probes import Found, joins_cavities, look
from heartcase.pipeline.warnings import CaseWarning
from heartcase.schemas.errors import Problem, StageError
from heartcase.schemas.labels import BACKGROUND, Label, LabelTable, Role
from heartcase.schemas.recipe.edit_settings import (
    CloseDefect,
    Edit,
    Fill,
    KeepLargest,
    RemoveIslands,
    Sculpt,
    SeptalDefect,
    Smooth,
    edit_place,
)

__all__ = ["apply_edits", "made_by", "with_edit_names"]

Point = tuple[float, float, float]

PATCH_COLOUR = "#e8e4d0"


def apply_edits(structures: Structures, edits: Sequence[Edit]) -> Structures:
    """Carry out the edits that are enabled, in order.

    ``septal_defect``
        A canal with flat ends; its cross-section is a circle, an ellipse or a slit. The tissue in it becomes blood,
        each point that of the nearest of the cavities which the canal meets. Background beside the heart stays.
    ``close_defect``
        A flat sheet of a device label with such a cross-section, in the place of blood only: it ends flush at the
        tissue around it.
    ``add``, ``remove``
        All points within a radius of a polyline go to a structure from whatever is there, or from the structures
        that are named; or from a structure to another one (the nearest, point by point, when none is named).
    ``smooth``, ``fill``
        Within such a brush the border of a bare structure is smoothed, or its holes and notches are filled:
        :mod:`heartcase.pipeline.edits.brushes`.
    ``keep_largest``, ``remove_islands``
        Pieces of bare structures go to another one: :mod:`heartcase.pipeline.edits.components`.

    Parameters
    ----------
    structures
        Structures of the walls stage, or edited ones; not changed.
    edits
        The edits, in the order of the recipe. Those that are not enabled count in the numbers of messages only.

    Returns
    -------
    Structures
        With one more reshaping for each defect, patch and stroke that adds or removes, other fields where the other
        kinds of edits changed them, and the labels of new patches in the table.

    Raises
    ------
    StageError
        With every edit that meets nothing: a defect that touches no tissue or does not join two cavities, a patch
        that touches no blood, a stroke outside the volume or one that changes nothing; and with every one that names
        a label which is not there or cannot be edited in this way.
    """
    problems: list[Problem] = []
    for number, edit in enumerate(edits, start=1):
        if not edit.enabled:
            continue
        try:
            structures = _apply(structures, edit, number)
        except StageError as error:
            problems += [Problem(edit_place(number, edit), problem.message) for problem in error.problems]
    if problems:
        raise StageError(problems)
    return structures


def made_by(edits: Sequence[Edit], table: LabelTable) -> frozenset[int]:
    """Values of the labels of a table that the enabled edits give something to by name."""
    names = [
        edit.label if isinstance(edit, CloseDefect) or edit.kind == "add" else getattr(edit, "into", None)
        for edit in edits
        if edit.enabled
    ]
    found = (table.find(name) for name in names if name)
    return frozenset(label.value for label in found if label is not None)


def with_edit_names(warnings: Iterable[CaseWarning], edits: Sequence[Edit]) -> tuple[CaseWarning, ...]:
    """Warnings of :func:`apply_edits` with the names of the edits beside their numbers, for people.

    The stage itself knows numbers only, so that a new name for an edit computes nothing anew.

    Parameters
    ----------
    warnings
        Any warnings; those that are not about a named edit stay as they are.
    edits
        The recipe's edits.
    """
    return tuple(_with_name(warning, edits) for warning in warnings)


def _with_name(warning: CaseWarning, edits: Sequence[Edit]) -> CaseWarning:
    number = warning.edit
    if number is None or not 0 < number <= len(edits) or not edits[number - 1].name:
        return warning
    rest = warning.text.removeprefix(f"edits[{number}]")
    return replace(warning, text=f"{edit_place(number, edits[number - 1])}{rest}")


def _apply(structures: Structures, edit: Edit, number: int) -> Structures:
    if isinstance(edit, SeptalDefect):
        return _make_defect(structures, edit)
    if isinstance(edit, CloseDefect):
        return _close_defect(structures, edit)
    if isinstance(edit, Sculpt):
        return _sculpt(structures, edit)
    if isinstance(edit, Smooth):
        return smooth_structure(structures, edit, _bare(structures, edit.label), number)
    if isinstance(edit, Fill):
        return fill_structure(structures, edit, _bare(structures, edit.label), number)
    return _clean(structures, edit, number)


def _clean(structures: Structures, edit: KeepLargest | RemoveIslands, number: int) -> Structures:
    into = None if edit.into is None else _bare(structures, edit.into)
    if edit.label is None:
        values = sorted(set(structures.distance_mm) - {BACKGROUND})
        return remove_islands(structures, edit, tuple(structures.table[value] for value in values), into, number)
    label = _bare(structures, edit.label)
    if into is not None and into.value == label.value:
        raise StageError(f"pieces of '{label.name}' cannot become '{into.name}': change into")
    if isinstance(edit, KeepLargest):
        return keep_largest_piece(structures, label, into, number)
    return remove_islands(structures, edit, (label,), into, number)


def _make_defect(structures: Structures, edit: SeptalDefect) -> Structures:
    table = structures.table
    canal = _canal(edit, edit.length_mm)
    found = look(structures, canal)
    _need_volume(found, "the defect")
    tissues = [value for value in structures.values if table[value].role.is_tissue]
    cavities = [value for value in table.blood_values if value in found.labels]
    if not found.labels & set(tissues):
        raise StageError("the defect touches no tissue: move its position_mm into the septum")
    if len(cavities) < 2:
        met = f"only '{table[cavities[0]].name}'" if cavities else "no cavity"
        raise StageError(
            f"the defect does not join two cavities, it meets {met}: enlarge length_mm, or mend position_mm and axis"
        )
    edited = _reshaped(structures, canal, tissues, cavities)
    if not joins_cavities(edited, canal, cavities):
        raise StageError(
            "background lies between the walls that the defect goes through, so it does not join the cavities: "
            "thicken a wall with wall_thickness_mm, or fill the gap with an edit of kind 'add' before"
        )
    return edited


def _close_defect(structures: Structures, edit: CloseDefect) -> Structures:
    sheet = _canal(edit, edit.thickness_mm)
    found = look(structures, sheet)
    _need_volume(found, "the patch")
    table = structures.table
    cavities = [value for value in table.blood_values if value in structures.values]
    if not found.labels & set(cavities):
        raise StageError("the patch touches no blood: move its position_mm into the defect")
    try:
        patch = table[edit.label]
    except KeyError:
        patch = Label(value=table.free_value(), name=edit.label, role=Role.DEVICE, colour=PATCH_COLOUR)
        structures = replace(structures, table=table.with_label(patch))
    if not patch.role.is_tissue:
        raise StageError(f"the patch cannot be made of '{patch.name}', which is not tissue: take another label")
    return _reshaped(structures, sheet, cavities, [patch.value])


def _sculpt(structures: Structures, edit: Sculpt) -> Structures:
    table = structures.table
    label = _label(table, edit.label)
    brush = Reshaping("strokes", tuple(_point(point) for point in edit.points_mm), float(edit.radius_mm), (), ())
    found = look(structures, brush)
    _need_volume(found, "the stroke")
    others = [value for value in structures.values if value != label.value]
    if edit.kind == "add":
        if not found.labels & set(others):
            raise StageError(f"the stroke lies in '{label.name}' already: move it, or take it out of the recipe")
        if edit.only_from is not None:
            others = sorted({_label(table, name).value for name in edit.only_from})
            if label.value in others:
                raise StageError(f"'{label.name}' cannot be added to from itself: change only_from")
            if not found.labels & set(others):
                named = ", ".join(f"'{table[value].name}'" for value in others)
                raise StageError(f"the stroke touches nothing of {named}: move its points_mm, or change only_from")
        return _reshaped(structures, brush, others, [label.value])
    if label.value not in found.labels:
        raise StageError(f"the stroke touches no '{label.name}': move its points_mm, or enlarge radius_mm")
    targets = others if edit.into is None else [_label(table, edit.into).value]
    if label.value in targets:
        raise StageError(f"'{label.name}' cannot be removed into itself: change into")
    return _reshaped(structures, brush, [label.value], targets)


def _reshaped(structures: Structures, shape: Reshaping, sources: Sequence[int], targets: Sequence[int]) -> Structures:
    names = {label.value: label.name for label in structures.table}
    one = shape._replace(
        sources=tuple(names[value] for value in sources), targets=tuple(names[value] for value in targets)
    )
    return replace(structures, reshapings=(*structures.reshapings, one))


def _label(table: LabelTable, name: str) -> Label:
    try:
        return table[name]
    except KeyError:
        listed = ", ".join(label.name for label in table)
        raise StageError(f"there is no label {name!r} (labels: {listed})") from None


def _bare(structures: Structures, name: str) -> Label:
    """The label of this name, which must have a field of its own."""
    label = _label(structures.table, name)
    if label.value in structures.grown_walls:
        cavity = structures.table[structures.grown_walls[label.value][0]]
        raise StageError(f"'{label.name}' is grown around '{cavity.name}' and follows it: name '{cavity.name}'")
    if label.septum_of is not None:
        raise StageError(f"'{label.name}' is grown between two cavities and follows them: name one of the two")
    if label.value in structures.distance_mm:
        return label
    if label.value in structures.values:
        raise StageError(f"'{label.name}' is made by an earlier edit: change that one")
    raise StageError(f"there is nothing of '{label.name}': take another label, or take the edit out of the recipe")


def _need_volume(found: Found, what: str) -> None:
    if not found.is_inside_volume:
        raise StageError(f"{what} lies outside the region of interest: check its position in mm")


def _canal(edit: SeptalDefect | CloseDefect, length_mm: float) -> Reshaping:
    """The shape of a defect or a patch, which takes nothing from nobody yet."""
    unit = np.array(edit.axis) / np.linalg.norm(edit.axis)
    middle = np.array(edit.position_mm)
    ends = (_point(middle - 0.5 * length_mm * unit), _point(middle + 0.5 * length_mm * unit))
    radius = 0.5 * edit.diameter_mm
    if edit.width_mm is None or edit.long_axis is None:
        return Reshaping("cylinder", ends, float(radius), (), ())
    side = np.array(edit.long_axis) - (np.array(edit.long_axis) @ unit) * unit
    side /= np.linalg.norm(side)
    tips = (_point(middle + radius * side), _point(middle + 0.5 * edit.width_mm * np.cross(unit, side)))
    return Reshaping(edit.shape, (*ends, *tips), float(radius), (), ())


def _point(values: Iterable[float]) -> Point:
    x, y, z = values
    return float(x), float(y), float(z)
