"""The label table: what each label value of a segmentation stands for."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from enum import StrEnum
from itertools import combinations
from typing import Annotated, Any

from pydantic import Field, SerializerFunctionWrapHandler, field_validator, model_serializer, model_validator

from heartcase.schemas.base import Colour, Model, Name
from heartcase.schemas.errors import ModelProblems, Problem
from heartcase.schemas.terms import TERMS, Term, normalised, term_by_code, term_by_name

__all__ = ["BACKGROUND", "Label", "LabelTable", "Role", "default_label_table", "further_labels", "repeated_names"]

_MYOCARDIUM = next(term for term in TERMS if term.name == "myocardium")

BACKGROUND = 0
"""The label value of everything that is not part of the heart."""

_COLOURS = {
    "morphologically left ventricle": "#d41515",
    "morphologically right ventricle": "#4c529f",
    "morphologically left atrium": "#fa7f43",
    "morphologically right atrium": "#a8b9d2",
    "morphologically left ventricular myocardium": "#c1a29a",
    "morphologically right ventricular myocardium": "#997a67",
    "myocardium": "#c1a29a",
    "aorta": "#993848",
    "pulmonary artery": "#9a8bd6",
    "superior vena cava": "#267e89",
    "inferior vena cava": "#f2d64b",
    "pulmonary vein": "#ebf1c7",
    "coronary sinus": "#1b158d",
    "left atrial appendage": "#381a14",
    "right atrial appendage": "#221a37",
}
"""Name of a term -> its colour, so that a structure looks the same in every case whose recipe states none."""


class Role(StrEnum):
    """What kind of thing a label is. Tissue is myocardium, wall and device; the rest is void to the simulator."""

    BACKGROUND = "background"
    BLOOD = "blood"
    VESSEL_LUMEN = "vessel_lumen"
    MYOCARDIUM = "myocardium"
    WALL = "wall"
    DEVICE = "device"

    @property
    def is_tissue(self) -> bool:
        """Whether the simulator gives this role mass and stiffness."""
        return self in (Role.MYOCARDIUM, Role.WALL, Role.DEVICE)

    @property
    def is_blood(self) -> bool:
        """Whether blood flows here: the cavity of a chamber or of a vessel."""
        return self in (Role.BLOOD, Role.VESSEL_LUMEN)


class Label(Model):
    """One label: a structure of the heart, or something beside it."""

    value: Annotated[int, Field(ge=0, le=250)]
    """Value in the label volume; 0 is background."""
    name: Name
    """Unique name; chambers by morphology, since sides may be swapped."""
    role: Role
    """What kind of thing it is."""
    colour: Colour = "#a0a0a0"
    """Colour in pictures and in the surface. Left out, it is the fixed one of its structure, by code or else by name;
    grey where the vocabulary lacks the structure."""
    wall_thickness_mm: Annotated[float, Field(ge=0.0, le=50.0)] = 0.0
    """Thickness of the wall to grow around this cavity, in mm; 0 grows none."""
    wall_of: int | None = None
    """For a grown wall: the value of the cavity around which it was grown."""
    septum_of: tuple[int, int] | None = None
    """For a grown septum: the values of the two cavities that it keeps apart, the lower first. Not written where it is
    none."""
    snomed: Annotated[str, Field(pattern=r"^[0-9]{6,18}$")] | None = None
    """SNOMED CT concept identifier."""

    @model_validator(mode="before")
    @classmethod
    def _colour_of_structure(cls, data: Any) -> Any:
        if not isinstance(data, Mapping) or "colour" in data:
            return data
        code, name = data.get("snomed"), data.get("name")
        term = (term_by_code(code) if isinstance(code, str) else None) or (
            term_by_name(name) if isinstance(name, str) else None
        )
        return data if term is None else {**data, "colour": _COLOURS[term.name]}

    @model_serializer(mode="wrap")
    def _without_what_is_new(self, write: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """Leave ``septum_of`` out where it is none: what has no septa keeps its bytes."""
        written: dict[str, Any] = write(self)
        if self.septum_of is None:
            written.pop("septum_of", None)
        return written

    @property
    def term(self) -> Term | None:
        """The structure that its code, or else its name, stands for; None for one that the vocabulary lacks."""
        return (term_by_code(self.snomed) if self.snomed else None) or term_by_name(self.name)


class LabelTable(Model):
    """All labels of a case, by ascending value; value 0 is always the background."""

    labels: tuple[Label, ...]

    @field_validator("labels")
    @classmethod
    def _check(cls, labels: tuple[Label, ...]) -> tuple[Label, ...]:
        repeated = _repeated(labels)
        labels = tuple(sorted(labels, key=lambda label: label.value))
        if not labels or labels[0].value != BACKGROUND:
            labels = (
                Label(value=BACKGROUND, name="background", role=Role.BACKGROUND, colour="#000000"),
                *labels,
            )
        problems = repeated
        if labels[0].role is not Role.BACKGROUND:
            problems.append(f"label value 0 is the background and cannot have the role {labels[0].role.value!r}")
        seen_values: dict[int, str] = {}
        seen_names: dict[str, int] = {}
        for label in labels:
            if label.wall_thickness_mm > 0.0 and not label.role.is_blood:
                problems.append(f"{label.name!r}: only a blood or vessel_lumen label can grow a wall")
            named, coded = term_by_name(label.name), term_by_code(label.snomed or "")
            if named and coded and named is not coded and _MYOCARDIUM not in (named, coded):
                problems.append(f"{label.name!r} has the SNOMED CT code of {coded.name!r}: change one of them")
            seen_values[label.value] = label.name
            seen_names[label.name.lower()] = label.value
        walled = {label.wall_of for label in labels}
        for label in labels:
            wall = _wall_name(label)
            if label.wall_thickness_mm > 0.0 and label.value not in walled and wall.lower() in seen_names:
                problems.append(
                    f"{label.name!r} grows a wall, but {wall!r} is a label of its own: set wall_thickness_mm = 0, or "
                    "wall_of in that label"
                )
            if label.wall_of is not None and label.wall_of not in seen_values:
                problems.append(f"{label.name!r}: wall_of names value {label.wall_of}, which is not in the table")
            if label.septum_of is not None and not set(label.septum_of) <= set(seen_values):
                problems.append(f"{label.name!r}: septum_of names a value that is not in the table")
        if problems:
            raise ModelProblems(Problem("", message) for message in problems)
        return labels

    def __iter__(self) -> Iterator[Label]:  # type: ignore[override]
        return iter(self.labels)

    def __len__(self) -> int:
        return len(self.labels)

    def __contains__(self, value: object) -> bool:
        return any(label.value == value for label in self.labels)

    def __getitem__(self, key: int | str) -> Label:
        """The label with this value, or the one that :meth:`find` finds by this name.

        Raises
        ------
        KeyError
            No label has it.
        """
        found = self.find(key) if isinstance(key, str) else next((one for one in self.labels if one.value == key), None)
        if found is None:
            raise KeyError(key)
        return found

    def find(self, name: str) -> Label | None:
        """The label that a name stands for.

        Parameters
        ----------
        name
            A label's own name; or another name of its structure (:mod:`heartcase.schemas.terms`); or either with
            "wall" behind it, for the wall grown around a cavity. Case, spaces, underscores and hyphens do not count.

        Returns
        -------
        Label or None
            The label with just this name before one with a synonym; None where no label, or more than one, fits.
        """
        for spelt in (str.lower, normalised):
            same = [label for label in self.labels if spelt(label.name) == spelt(name)]
            if same:
                return same[0] if len(same) == 1 else None
        term = term_by_name(name)
        if term is not None:
            return self._of_term(term)
        cavity = self.find(name[: -len("wall")].rstrip(" _-")) if re.fullmatch(r"(?i).+[\s_-]wall", name) else None
        wall = None if cavity is None else self.wall_value(cavity.value)
        return None if wall is None else self[wall]

    def find_code(self, snomed: str) -> Label | None:
        """The label with this SNOMED CT code, given or by its name; None where none, or more than one, has it."""
        same = [label for label in self.labels if label.snomed == snomed]
        if same:
            return same[0] if len(same) == 1 else None
        term = term_by_code(snomed)
        return None if term is None else self._of_term(term)

    def _of_term(self, term: Term) -> Label | None:
        fitting = [label for label in self.labels if label.term is term]
        if not fitting and term is _MYOCARDIUM:
            fitting = [label for label in self.labels if label.role is Role.MYOCARDIUM and label.wall_of is None]
        return fitting[0] if len(fitting) == 1 else None

    @property
    def values(self) -> tuple[int, ...]:
        """All values, ascending, background included."""
        return tuple(label.value for label in self.labels)

    @property
    def tissue_values(self) -> tuple[int, ...]:
        """Values of myocardium, wall and device."""
        return tuple(label.value for label in self.labels if label.role.is_tissue)

    @property
    def void_values(self) -> tuple[int, ...]:
        """Values of everything else: background, blood, vessel lumen."""
        return tuple(label.value for label in self.labels if not label.role.is_tissue)

    @property
    def blood_values(self) -> tuple[int, ...]:
        """Values of blood and vessel lumen."""
        return tuple(label.value for label in self.labels if label.role.is_blood)

    def with_label(self, label: Label) -> LabelTable:
        """A table with this label added, or put in place of the one with the same value."""
        return LabelTable(labels=(*(old for old in self.labels if old.value != label.value), label))

    def free_value(self) -> int:
        """The lowest value that is not in use.

        Raises
        ------
        ValueError
            All are.
        """
        free = set(range(1, 251)) - set(self.values)
        if not free:
            raise ValueError("every label value from 1 to 250 is taken: remove a label, or the wall of one")
        return min(free)

    def wall_value(self, cavity: int) -> int | None:
        """Value of the wall grown around this cavity, or None."""
        return next((label.value for label in self.labels if label.wall_of == cavity), None)

    def with_walls(self) -> LabelTable:
        """A table with one wall label for each cavity that asks for a wall and has none yet.

        The wall of a chamber (role ``blood``) is myocardium, that of a vessel is ``wall``. They take the lowest
        values that are free, in the order of the cavities.
        """
        table = self
        for label in self.labels:
            if label.wall_thickness_mm > 0.0 and table.wall_value(label.value) is None:
                table = table.with_label(
                    Label(
                        value=table.free_value(),
                        name=_wall_name(label),
                        role=Role.MYOCARDIUM if label.role is Role.BLOOD else Role.WALL,
                        colour=_darker(label.colour),
                        wall_of=label.value,
                    )
                )
        return table

    @property
    def septum_names(self) -> frozenset[str]:
        """Names that septa grown between two cavities of the table would have, in lower case."""
        cavities = [label for label in self.labels if label.role.is_blood]
        return frozenset(_septum_name(low, high).lower() for low, high in combinations(cavities, 2))

    def with_septum(self, first: int, second: int) -> LabelTable:
        """A table with a label for the septum that is grown between two cavities.

        It has the role ``wall``, the lowest value that is free, and a name of both cavities' names.

        Parameters
        ----------
        first, second
            Label values of the two cavities, in any order.
        """
        low, high = self[min(first, second)], self[max(first, second)]
        if any(label.septum_of == (low.value, high.value) for label in self.labels):
            return self
        value, colour = self.free_value(), _between(low.colour, high.colour)
        name = _septum_name(low, high)
        if any(label.name.lower() == name.lower() for label in self.labels):
            name = f"{name} {value}"
        return self.with_label(
            Label(value=value, name=name, role=Role.WALL, colour=colour, septum_of=(low.value, high.value))
        )


def _repeated(labels: Sequence[Label]) -> list[str]:
    """The values and names that several labels have, each once, with the rows that have it."""
    problems = []
    rows_of_value: dict[int, list[int]] = {}
    for row, label in enumerate(labels, start=1):
        rows_of_value.setdefault(label.value, []).append(row)
    for value, rows in rows_of_value.items():
        if len(rows) > 1:
            names = ", ".join(dict.fromkeys(repr(labels[row - 1].name) for row in rows))
            problems.append(f"value {value} is used by {_rows_in_words(rows)} ({names}): give each its own")
    return problems + repeated_names([label.name for label in labels])


def repeated_names(names: Sequence[str]) -> list[str]:
    """What to say of each name that several rows have, case aside: once, with the rows."""
    rows_of: dict[str, list[int]] = {}
    for row, name in enumerate(names, start=1):
        rows_of.setdefault(name.lower(), []).append(row)
    return [
        f"the name {names[rows[0] - 1]!r} is used by {_rows_in_words(rows)}: give each its own"
        for rows in rows_of.values()
        if len(rows) > 1
    ]


def _rows_in_words(rows: Sequence[int]) -> str:
    """Several rows in words: ``rows 1, 2 and 5``."""
    return f"rows {', '.join(map(str, rows[:-1]))} and {rows[-1]}"


def _septum_name(low: Label, high: Label) -> str:
    """Name of a grown septum, of at most 60 letters; "grown" stays in it, so that nobody takes it for seen."""
    one, other = (label.name.removeprefix("morphologically ")[:22].strip() for label in (low, high))
    return f"{one}-{other} septum (grown)"


def _between(first: str, second: str) -> str:
    """The middle of two colours."""
    channels = [[int(colour[i : i + 2], 16) for i in (1, 3, 5)] for colour in (first, second)]
    return "#" + "".join(f"{(one + other) // 2:02x}" for one, other in zip(*channels, strict=True))


def _wall_name(cavity: Label) -> str:
    return f"{cavity.name[:59]} wall"


def _darker(colour: str) -> str:
    channels = (int(colour[i : i + 2], 16) for i in (1, 3, 5))
    return "#" + "".join(f"{channel * 7 // 10:02x}" for channel in channels)


def default_label_table() -> LabelTable:
    """The labels of a heart with four chambers: what ``heartcase new`` writes and the phantom uses.

    Wall thicknesses are usual adult values in mm; the left ventricle has none because its myocardium is segmented.
    """
    rows: tuple[tuple[int, str, Role, float, str | None], ...] = (
        (1, "morphologically left ventricle", Role.BLOOD, 0.0, "87878005"),
        (2, "morphologically right ventricle", Role.BLOOD, 4.0, "53085002"),
        (3, "morphologically left atrium", Role.BLOOD, 2.5, "82471001"),
        (4, "morphologically right atrium", Role.BLOOD, 2.5, "73829009"),
        (5, "aorta", Role.VESSEL_LUMEN, 2.0, "15825003"),
        (6, "pulmonary artery", Role.VESSEL_LUMEN, 2.0, "81040000"),
        (7, "superior vena cava", Role.VESSEL_LUMEN, 1.5, "48345005"),
        (8, "inferior vena cava", Role.VESSEL_LUMEN, 1.5, "64131007"),
        (9, "morphologically left ventricular myocardium", Role.MYOCARDIUM, 0.0, "49848007"),
    )
    background = Label(
        value=BACKGROUND, name="background", role=Role.BACKGROUND, colour="#000000", wall_thickness_mm=0.0, snomed=None
    )
    structures = (
        Label(value=value, name=name, role=role, wall_thickness_mm=wall, snomed=snomed)
        for value, name, role, wall, snomed in rows
    )
    return LabelTable(labels=(background, *structures))


def further_labels() -> tuple[Label, ...]:
    """Labels that are often added to the usual table, by ascending value behind it.

    Walls in mm: of a vein as thick as that of the venae cavae, of an appendage as that of its atrium.
    """
    rows: tuple[tuple[str, Role, float], ...] = (
        ("pulmonary vein", Role.VESSEL_LUMEN, 1.5),
        ("coronary sinus", Role.VESSEL_LUMEN, 1.5),
        ("left atrial appendage", Role.BLOOD, 2.5),
        ("right atrial appendage", Role.BLOOD, 2.5),
        ("morphologically right ventricular myocardium", Role.MYOCARDIUM, 0.0),
    )
    codes = {term.name: term.code for term in TERMS}
    return tuple(
        Label(value=value, name=name, role=role, wall_thickness_mm=wall, snomed=codes[name])
        for value, (name, role, wall) in enumerate(rows, start=len(default_label_table()))
    )
