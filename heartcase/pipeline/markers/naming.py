"""Matching the segments and values of a file to labels: by the recipe's names, by terms, by codes.

What a file calls its segments may be a patient's name: messages call them by their place in the file.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from heartcase.pipeline.data import UNMARKED
from heartcase.pipeline.formats.labels.segments import LabelVolume, SegmentInfo
from heartcase.schemas.arrays import UInt8
from heartcase.schemas.errors import MarkerError, Problem
from heartcase.schemas.labels import Label, LabelTable
from heartcase.schemas.terms import CONVENTIONS, contradicts, is_of_another_version

__all__ = ["LabelLookup", "Naming", "called", "label_lookup", "left_out", "listed", "rank_by_label", "value_of"]


@dataclass(frozen=True)
class Naming:
    """What the recipe says of the names in a file."""

    names: Mapping[str, str]
    """Name of a segment, or value, in the file -> label name."""
    convention: str | None = None
    """Key of :data:`heartcase.schemas.terms.CONVENTIONS`: what the values of a file without segments stand for."""
    others: str = "refuse"
    """What is no label: ``refuse`` the file, or ``ignore`` it."""
    leaves_out_walls: bool = False
    """Whether segments named like a wall that heartcase will grow are left out."""
    order: Sequence[str] = ()
    """Label names from the lowest to the topmost, where segments overlap; the others lie below."""


@dataclass(frozen=True)
class LabelLookup:
    """What the values of a file stand for."""

    values: UInt8
    """Value of the file -> label value, uint8, shape (highest value + 1,); 255 for 0 and for what is left out."""
    walls: tuple[str, ...] = ()
    """Names of the grown walls that are left out, as the table of the case has them, in the order of their values."""


def label_lookup(volume: LabelVolume, naming: Naming, table: LabelTable) -> LabelLookup:
    """Find the label of each value that a file holds.

    A segment is found by ``names``, with its name or value, then by the label or synonym that it is named like, then by
    its SNOMED CT code. A value of a file without segments is found by ``names``, then by the convention. Only where
    neither is given is it a value of the table: a number that was forgotten under ``names`` must not become another
    organ.

    Parameters
    ----------
    volume
        The file's values and segments.
    naming
        What the recipe says of them.
    table
        Label table of the recipe.

    Returns
    -------
    LabelLookup
        From the file's values to the table's.

    Raises
    ------
    MarkerError
        With all that is no label and not to be ignored, and every segment whose name and code contradict each other;
        or the values follow another version of the convention.
    """
    counts = np.bincount(volume.values.ravel())
    values = sorted({*np.flatnonzero(counts).tolist(), *volume.vanished} - {0})
    lookup = np.full(max(values, default=0) + 1, UNMARKED, dtype=np.uint8)
    unknown, contrary = [], []
    for value in values:
        segment = volume.segments.get(value)
        label, is_contrary = _label_of(segment, value, naming, table)
        if is_contrary:
            contrary.append(value)
        if label is None and not volume.segments:
            label = _value_without_name(value, naming, table)
        if label is None:
            unknown.append(value)
        else:
            lookup[value] = label
    walls = _grown_walls(volume, unknown, naming, table) if naming.leaves_out_walls and unknown else {}
    unknown = [value for value in unknown if value not in walls]
    problems = []
    if contrary:
        problems.append(
            f"the name and the SNOMED CT code of {called(volume, contrary)} stand for different structures: correct "
            "one of them, or map the name under names"
        )
    if not volume.segments and naming.convention and is_of_another_version(naming.convention, dict(enumerate(counts))):
        problems.append(
            f"the values seem to follow another version's numbering than {naming.convention}, in which 44 to 49 are "
            "vertebrae and 51 is the heart: leave out convention, and say under names what each value is"
        )
    if unknown and naming.others == "refuse":
        problems.append(_refusal(volume, unknown, naming, table))
    if problems:
        raise MarkerError(Problem("", message) for message in problems)
    return LabelLookup(lookup, tuple(walls[value] for value in sorted(walls)))


def _label_of(segment: SegmentInfo | None, value: int, naming: Naming, table: LabelTable) -> tuple[int | None, bool]:
    """Label value that names, name or code give a segment, or ``names`` a value; and whether name and code disagree."""
    label, is_contrary = None, False
    if segment is not None:
        given = {_as_compared(key) for key in naming.names}
        key = next((key for key in (segment.name, str(value)) if _as_compared(key) in given), None)
        label = value_of(segment.name if key is None else key, naming.names, table)
        coded = table.find_code(segment.snomed) if segment.snomed else None
        is_contrary = key is None and _is_contrary(segment, label, coded)
        if label is None and coded is not None:
            label = coded.value
    return value_of(str(value), naming.names, table) if label is None else label, is_contrary


def left_out(naming: Naming, table: LabelTable) -> Callable[[SegmentInfo], bool]:
    """Which segments of a file with several layers are not taken: they must not cover those that are."""
    grown, septa = table.with_walls(), table.septum_names

    def is_left_out(segment: SegmentInfo) -> bool:
        label, is_contrary = _label_of(segment, segment.number, naming, table)
        if label is not None or is_contrary:
            return False
        is_grown = value_of(segment.name, naming.names, grown) is not None or segment.name.lower() in septa
        return naming.others == "ignore" or (naming.leaves_out_walls and is_grown)

    return is_left_out


def rank_by_label(naming: Naming, table: LabelTable) -> Callable[[SegmentInfo], int]:
    """How high each segment of a file lies where segments overlap: by its label's place in ``order``, else below."""
    places = {label.value: at for at, name in enumerate(naming.order, start=1) if (label := table.find(name))}

    def rank(segment: SegmentInfo) -> int:
        label, _ = _label_of(segment, segment.number, naming, table)
        return 0 if label is None else places.get(label, 0)

    return rank


def _is_contrary(segment: SegmentInfo, label: int | None, coded: Label | None) -> bool:
    """Whether a segment's name and code stand for different structures, be they in the table or not."""
    if segment.snomed is not None and contradicts(segment.name, segment.snomed):
        return True
    return coded is not None and label is not None and coded.value != label


def _refusal(volume: LabelVolume, unknown: Sequence[int], naming: Naming, table: LabelTable) -> str:
    what = called(volume, unknown)
    if volume.segments or not naming.names or naming.convention:
        return (
            f"the file holds what is no label: {what}; rename it, map it under names, or leave it out with "
            f'others = "ignore" ({listed(table)})'
        )
    return (
        f"{what} {'have' if len(unknown) > 1 else 'has'} no name under names: add it there, or leave it out with "
        f'others = "ignore"; once names are given, no value is taken for the label of the same number ({listed(table)})'
    )


def _grown_walls(volume: LabelVolume, values: Sequence[int], naming: Naming, table: LabelTable) -> dict[int, str]:
    """Those values whose segments are named like a wall or a septum that the walls stage may grow, with its name."""
    grown, septa = table.with_walls(), table.septum_names
    found = {}
    for value in values:
        segment = volume.segments.get(value)
        label = None if segment is None else value_of(segment.name, naming.names, grown)
        if label is not None and label not in table:
            found[value] = grown[label].name
        elif segment is not None and segment.name.lower() in septa:
            found[value] = segment.name
    return found


def called(volume: LabelVolume, values: Sequence[int]) -> str:
    """What messages call these values of a file."""
    words = []
    for value in values:
        segment = volume.segments.get(value)
        words.append(f"value {value}" if segment is None else f"segment {segment.number}")
    return ", ".join(words) + " of the file"


def _as_compared(name: str) -> str:
    return " ".join(name.split()).lower()


def value_of(name: str, names: Mapping[str, str], table: LabelTable) -> int | None:
    """Label value of a name or value of a file, mapped through ``names``; None where it is no label."""
    lowered = {_as_compared(key): target for key, target in names.items()}
    found = table.find(lowered.get(_as_compared(name), name))
    return None if found is None else found.value


def _value_without_name(value: int, naming: Naming, table: LabelTable) -> int | None:
    """Label value of a value in a file without names that ``names`` does not have either."""
    if naming.convention is not None:
        name = CONVENTIONS[naming.convention].get(value)
        found = table.find(name) if name is not None else None
        return None if found is None else found.value
    return value if value in table and not naming.names else None


def listed(table: LabelTable) -> str:
    """The labels that there are, for a message."""
    return "labels: " + ", ".join(label.name for label in table)
