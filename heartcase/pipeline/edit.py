"""The edit stage: septal defects made and closed, structures sculpted; each edit becomes a reshaping of the structures.

Nothing is resampled: a reshaping is worked out wherever the structures are read, so a defect is as round and a patch
as thin as the recipe says, and taking an edit out of the recipe takes it out of the heart.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace

import cc3d
import numpy as np
import numpy.typing as npt

from heartcase.pipeline.data import Reshaping, Structures
from heartcase.pipeline.fields import ownership_at_points
from heartcase.schemas.errors import Problem, StageError
from heartcase.schemas.labels import Label, LabelTable, Role
from heartcase.schemas.settings import CloseDefect, Edit, Sculpt, SeptalDefect

__all__ = ["apply_edits"]

Bool = npt.NDArray[np.bool_]
Float64 = npt.NDArray[np.float64]
UInt8 = npt.NDArray[np.uint8]

PATCH_COLOUR = "#e8e4d0"
PROBES_ACROSS = 24
"""Points across a cylinder at which it is asked what it meets."""
PROBE_STEP_MM = 0.25
"""Distance of those points along it."""
MOST_PROBES_ALONG = 400


@dataclass(frozen=True)
class _Found:
    """What lies inside a shape."""

    labels: frozenset[int]
    """Labels of the points."""
    is_inside_volume: bool
    """Whether any point lies within the volume."""


def apply_edits(structures: Structures, edits: Sequence[Edit]) -> Structures:
    """Carry out edits in order.

    ``septal_defect``
        A round canal with flat ends. The tissue in it becomes blood, each point that of the nearest of the cavities
        which the canal meets. Background beside the heart stays.
    ``close_defect``
        A round sheet of a device label, in the place of blood only: it ends flush at the tissue around it.
    ``add``, ``remove``
        All points within a radius of a polyline go to a structure from whatever is there, or from a structure to
        another one (the nearest, point by point, when none is named).

    Parameters
    ----------
    structures
        Structures of the walls stage, or edited ones; not changed.
    edits
        The edits, in the order of the recipe.

    Returns
    -------
    Structures
        With one more reshaping for each edit, and the labels of new patches in the table.

    Raises
    ------
    StageError
        With every edit that meets nothing: a defect that touches no tissue or does not join two cavities, a patch
        that touches no blood, a stroke outside the volume or one that changes nothing.
    """
    problems: list[Problem] = []
    for number, edit in enumerate(edits, start=1):
        try:
            structures = _apply(structures, edit)
        except StageError as error:
            problems += [Problem(f"edits[{number}]", problem.message) for problem in error.problems]
    if problems:
        raise StageError(problems)
    return structures


def _apply(structures: Structures, edit: Edit) -> Structures:
    if isinstance(edit, SeptalDefect):
        return _make_defect(structures, edit)
    if isinstance(edit, CloseDefect):
        return _close_defect(structures, edit)
    return _sculpt(structures, edit)


def _make_defect(structures: Structures, edit: SeptalDefect) -> Structures:
    points = _ends_of(edit.position_mm, edit.axis, edit.length_mm)
    table = structures.table
    found = _look(structures, "cylinder", points, 0.5 * edit.diameter_mm)
    _need_volume(found, "the defect")
    tissues = tuple(value for value in structures.values if table[value].role.is_tissue)
    cavities = tuple(value for value in table.blood_values if value in found.labels)
    if not found.labels & set(tissues):
        raise StageError("the defect touches no tissue: move its position_mm into the septum")
    if len(cavities) < 2:
        met = f"only '{table[cavities[0]].name}'" if cavities else "no cavity"
        raise StageError(
            f"the defect does not join two cavities, it meets {met}: enlarge length_mm, or mend position_mm and axis"
        )
    edited = _reshaped(structures, "cylinder", points, 0.5 * edit.diameter_mm, tissues, cavities)
    if not _joins_cavities(edited, np.array(points), 0.5 * edit.diameter_mm, cavities):
        raise StageError(
            "background lies between the walls that the defect goes through, so it does not join the cavities: "
            "thicken a wall with wall_thickness_mm, or fill the gap with an edit of kind 'add' before"
        )
    return edited


def _close_defect(structures: Structures, edit: CloseDefect) -> Structures:
    points = _ends_of(edit.position_mm, edit.axis, edit.thickness_mm)
    found = _look(structures, "cylinder", points, 0.5 * edit.diameter_mm)
    _need_volume(found, "the patch")
    table = structures.table
    cavities = tuple(value for value in table.blood_values if value in structures.values)
    if not found.labels & set(cavities):
        raise StageError("the patch touches no blood: move its position_mm into the defect")
    try:
        patch = table[edit.label]
    except KeyError:
        patch = Label(value=table.free_value(), name=edit.label, role=Role.DEVICE, colour=PATCH_COLOUR)
        structures = replace(structures, table=table.with_label(patch))
    if not patch.role.is_tissue:
        raise StageError(f"the patch cannot be made of '{patch.name}', which is not tissue: take another label")
    return _reshaped(structures, "cylinder", points, 0.5 * edit.diameter_mm, cavities, (patch.value,))


def _sculpt(structures: Structures, edit: Sculpt) -> Structures:
    table = structures.table
    label = _label(table, edit.label)
    found = _look(structures, "strokes", edit.points_mm, edit.radius_mm)
    _need_volume(found, "the stroke")
    others = tuple(value for value in structures.values if value != label.value)
    if edit.kind == "add":
        if not found.labels & set(others):
            raise StageError(f"the stroke lies in '{label.name}' already: move it, or take it out of the recipe")
        return _reshaped(structures, "strokes", edit.points_mm, edit.radius_mm, others, (label.value,))
    if label.value not in found.labels:
        raise StageError(f"the stroke touches no '{label.name}': move its points_mm, or enlarge radius_mm")
    targets = others if edit.into is None else (_label(table, edit.into).value,)
    if label.value in targets:
        raise StageError(f"'{label.name}' cannot be removed into itself: change into")
    return _reshaped(structures, "strokes", edit.points_mm, edit.radius_mm, (label.value,), targets)


def _reshaped(
    structures: Structures,
    shape: str,
    points: Sequence[tuple[float, float, float]],
    radius_mm: float,
    sources: Sequence[int],
    targets: Sequence[int],
) -> Structures:
    names = {label.value: label.name for label in structures.table}
    one = Reshaping(
        shape,
        tuple((float(x), float(y), float(z)) for x, y, z in points),
        float(radius_mm),
        tuple(names[value] for value in sources),
        tuple(names[value] for value in targets),
    )
    return replace(structures, reshapings=(*structures.reshapings, one))


def _label(table: LabelTable, name: str) -> Label:
    try:
        return table[name]
    except KeyError:
        listed = ", ".join(label.name for label in table)
        raise StageError(f"there is no label {name!r} (labels: {listed})") from None


def _need_volume(found: _Found, what: str) -> None:
    if not found.is_inside_volume:
        raise StageError(f"{what} lies outside the region of interest: check its position in mm")


def _ends_of(
    position_mm: tuple[float, float, float], axis: tuple[float, float, float], length_mm: float
) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
    unit = np.array(axis) / np.linalg.norm(axis)
    low, high = np.array(position_mm) - 0.5 * length_mm * unit, np.array(position_mm) + 0.5 * length_mm * unit
    return (float(low[0]), float(low[1]), float(low[2])), (float(high[0]), float(high[1]), float(high[2]))


def _look(structures: Structures, shape: str, points: Sequence[tuple[float, float, float]], radius_mm: float) -> _Found:
    """Who owns the points inside a shape, on a lattice that is fine against its extent and the voxels."""
    line = np.array(points, dtype=float)
    probes = _probes_in_cylinder(line, radius_mm) if shape == "cylinder" else _probes_in_strokes(line, radius_mm)
    index = structures.geometry.world_to_index(probes)
    size = np.array(structures.geometry.size)
    inside = np.all((index >= -0.5) & (index <= size - 0.5), axis=1)
    if not inside.any():
        return _Found(frozenset(), False)
    owner = ownership_at_points(structures, probes[inside])
    labels = np.where(owner.tissue_mm < 0.0, owner.tissue_label, owner.void_label)
    return _Found(frozenset(int(value) for value in np.unique(labels)), True)


def _joins_cavities(structures: Structures, ends: Float64, radius_mm: float, cavities: Sequence[int]) -> bool:
    """Whether one piece of the blood inside a canal belongs to two cavities."""
    probes, in_disc = _cylinder_lattice(ends, radius_mm)
    owner = ownership_at_points(structures, probes.reshape(-1, 3))
    label = np.where(owner.tissue_mm < 0.0, owner.tissue_label, owner.void_label).reshape(probes.shape[:3])
    pieces = cc3d.connected_components(np.isin(label, cavities) & in_disc, connectivity=6)
    met = np.unique(np.stack([pieces[pieces > 0], label[pieces > 0]]), axis=1)
    return bool(np.bincount(met[0].astype(np.int64), minlength=1).max() > 1)


def _cylinder_lattice(ends: Float64, radius_mm: float) -> tuple[Float64, Bool]:
    """Points in rows along a cylinder and across its discs, shape (n, m, m, 3), and which of them are in the disc."""
    length = float(np.linalg.norm(ends[1] - ends[0]))
    unit = (ends[1] - ends[0]) / length
    side = np.cross(unit, np.eye(3)[np.argmin(np.abs(unit))])
    side /= np.linalg.norm(side)
    across = ((np.arange(PROBES_ACROSS) + 0.5) / PROBES_ACROSS * 2.0 - 1.0) * radius_mm
    u, v = np.meshgrid(across, across)
    flat = u[..., None] * side + v[..., None] * np.cross(unit, side)
    count = int(np.clip(np.ceil(length / PROBE_STEP_MM), PROBES_ACROSS, MOST_PROBES_ALONG))
    along = (np.arange(count) + 0.5) * (length / count)
    probes: Float64 = ends[0] + along[:, None, None, None] * unit + flat
    return probes, np.hypot(u, v) <= radius_mm


def _probes_in_cylinder(ends: Float64, radius_mm: float) -> Float64:
    probes, in_disc = _cylinder_lattice(ends, radius_mm)
    return probes[:, in_disc].reshape(-1, 3)


def _probes_in_strokes(line: Float64, radius_mm: float) -> Float64:
    step = 0.5 * radius_mm
    pieces = [line[:1]]
    for first, last in itertools.pairwise(line):
        count = max(1, int(np.ceil(np.linalg.norm(last - first) / step)))
        pieces.append(first + np.linspace(0.0, 1.0, count + 1)[1:, None] * (last - first))
    middles = np.concatenate(pieces)
    across = (np.arange(9) - 4.0) / 4.0
    ball = np.stack(np.meshgrid(across, across, across, indexing="ij"), axis=-1).reshape(-1, 3)
    ball = radius_mm * ball[np.linalg.norm(ball, axis=1) <= 1.0]
    probes: Float64 = (middles[:, None] + ball).reshape(-1, 3)
    return probes
