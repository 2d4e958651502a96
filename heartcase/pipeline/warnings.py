"""Warnings of a case: what is wrong or doubtful, how much it matters, and what it is about.

A warning is a sentence for the clinician who must trust or reject a case, with its grade, and with what a program
would otherwise have to read out of the sentence: the edit that it is about, the places, the parts of a list. It travels
with the outputs of the stages through the cache; the manifest of a case has the text and the grade.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

from heartcase.schemas.bundle.format import CaseManifest, WarningGrade

__all__ = [
    "LISTED_BETWEEN",
    "CaseWarning",
    "WarningGrade",
    "WarningGroup",
    "WarningParts",
    "anatomy",
    "counted",
    "grouped",
    "note",
    "of_edit",
    "warning_from_json",
    "warning_to_json",
    "warnings_of",
    "worst_first",
]

Point = tuple[float, float, float]

LISTED_BETWEEN = "; "
"""What stands in a text between the parts of a list."""
_EDIT = re.compile(r"edits\[(\d+)\]")


class WarningParts(NamedTuple):
    """The sentence of a warning taken apart, for a page that shows what it lists as a list."""

    lead: str
    """What stands before the list; the whole sentence where there is none."""
    listed: tuple[str, ...] = ()
    """The parts of the list."""
    rest: str = ""
    """What stands behind it."""


@dataclass(frozen=True)
class CaseWarning:
    """A warning about a case."""

    text: str
    """What is wrong, where, and what to do: a sentence without a capital at its start."""
    grade: WarningGrade = WarningGrade.LOOK
    """How much it matters."""
    code: str = ""
    """Name of the kind of warning, such as ``wall-gap``; empty where the kind has none yet."""
    edit: int | None = None
    """Number of the edit of the recipe that it is about, from 1; the text begins with ``edits[number]`` then."""
    places_mm: tuple[Point, ...] = ()
    """Places that it is about, LPS mm, to 0.1 mm as in the text; empty where the kind does not give them yet."""
    listed: tuple[str, ...] = ()
    """What the text lists, joined by :data:`LISTED_BETWEEN` there."""
    has_stated_grade: bool = field(default=False, compare=False)
    """Whether stage outputs write the grade even where it is :attr:`WarningGrade.LOOK`, which goes without saying
    otherwise. The warnings of marker files and strokes do, so their stages' outputs have the same bytes as before."""

    def __post_init__(self) -> None:
        rounded = (tuple(round(float(value), 1) + 0.0 for value in place) for place in self.places_mm)
        object.__setattr__(self, "places_mm", tuple(rounded))

    def __str__(self) -> str:
        return self.text

    @property
    def sentence(self) -> str:
        """The text as a sentence of its own: a capital at its start, a full stop at its end."""
        return _as_sentence(self.text)

    @property
    def parts(self) -> WarningParts:
        """The sentence with its list taken apart, where it lists two things or more."""
        if len(self.listed) < 2:
            return WarningParts(self.sentence)
        lead, found, rest = self.sentence.partition(LISTED_BETWEEN.join(self.listed))
        return WarningParts(lead.rstrip(), self.listed, rest.lstrip(". ")) if found else WarningParts(self.sentence)


@dataclass(frozen=True)
class WarningGroup:
    """Warnings that matter alike, as a report shows them."""

    grade: WarningGrade
    """How much they matter."""
    title: str
    """Heading."""
    advice: str
    """What to do about all of them, one sentence."""
    warnings: tuple[CaseWarning, ...]
    """In the order they were given."""

    @property
    def lines(self) -> tuple[str, ...]:
        """The warnings as sentences."""
        return tuple(warning.sentence for warning in self.warnings)


_TITLES = {
    WarningGrade.ANATOMY: (
        "The anatomy may be wrong",
        "Do not rely on these places before you have mended or checked them.",
    ),
    WarningGrade.LOOK: ("Look at this", "Compare these places with the slices before you approve the case."),
    WarningGrade.NOTE: ("For your information", "Nothing need be done unless it disturbs."),
}


def anatomy(text: str, *, code: str = "", places_mm: Sequence[Point] = ()) -> CaseWarning:
    """A warning that the model's shape may not be the patient's."""
    return CaseWarning(text, WarningGrade.ANATOMY, code, places_mm=tuple(places_mm))


def note(text: str, *, code: str = "", places_mm: Sequence[Point] = ()) -> CaseWarning:
    """A warning that calls for nothing."""
    return CaseWarning(text, WarningGrade.NOTE, code, places_mm=tuple(places_mm))


def of_edit(number: int, text: str, grade: WarningGrade) -> CaseWarning:
    """A warning about one edit of the recipe, by its number from 1."""
    return CaseWarning(f"edits[{number}]: {text}", grade, edit=number)


def worst_first(*sources: Iterable[CaseWarning]) -> tuple[CaseWarning, ...]:
    """All warnings once, the worst on top; those that matter alike stay in the order of the sources.

    Parameters
    ----------
    sources
        Warnings of the stages, in the order of the stages. A text that comes twice counts as its worst.

    Returns
    -------
    tuple of CaseWarning
        Sorted.
    """
    found: dict[str, CaseWarning] = {}
    for warning in (one for source in sources for one in source):
        known = found.setdefault(warning.text, warning)
        if warning.grade.rank < known.grade.rank:
            found[warning.text] = replace(known, grade=warning.grade)
    return tuple(sorted(found.values(), key=lambda warning: warning.grade.rank))


def warnings_of(manifest: CaseManifest) -> tuple[CaseWarning, ...]:
    """Warnings of a case with how much they matter; in a case that does not say so each is worth a look."""
    grades = manifest.warning_grades or (WarningGrade.LOOK,) * len(manifest.warnings)
    return tuple(CaseWarning(text, grade) for text, grade in zip(manifest.warnings, grades, strict=True))


def grouped(warnings: Iterable[CaseWarning]) -> tuple[WarningGroup, ...]:
    """Warnings under the headings of a report, the worst heading first; headings without a warning are left out."""
    every = worst_first(warnings)
    groups = []
    for grade, (title, advice) in _TITLES.items():
        alike = tuple(warning for warning in every if warning.grade is grade)
        if alike:
            groups.append(WarningGroup(grade, title, advice, alike))
    return tuple(groups)


def counted(number: int, thing: str) -> str:
    """A number of things in words: ``1 piece``, ``3 pieces``."""
    return f"{number} {thing}{'' if number == 1 else 's'}"


def warning_to_json(warning: CaseWarning) -> str | dict[str, Any]:
    """A warning as stage outputs hold it: its text alone where that says all, else an object of what it has.

    The grade is ``severity`` there, in capitals, as it was called once: the bytes of stage outputs stay the same.
    The number of an edit is not written: the text has it, and :func:`warning_from_json` takes it from there.
    """
    more: dict[str, Any] = {"code": warning.code} if warning.code else {}
    if warning.places_mm:
        more["places_mm"] = [list(place) for place in warning.places_mm]
    if warning.listed:
        more["listed"] = list(warning.listed)
    if not more and warning.grade is WarningGrade.LOOK and not warning.has_stated_grade:
        return warning.text
    return {"severity": warning.grade.name, "text": warning.text, **more}


def warning_from_json(value: str | Mapping[str, Any]) -> CaseWarning:
    """What :func:`warning_to_json` made, back.

    Raises
    ------
    KeyError, TypeError, ValueError
        It is none.
    """
    if isinstance(value, str):
        return CaseWarning(value, edit=_edit_of(value))
    text, grade = value["text"], WarningGrade[value["severity"]]
    places = []
    for place in value.get("places_mm", ()):
        x, y, z = place
        places.append((x, y, z))
    return CaseWarning(
        text,
        grade,
        value.get("code", ""),
        _edit_of(text),
        tuple(places),
        tuple(value.get("listed", ())),
        has_stated_grade=grade is WarningGrade.LOOK,
    )


def _edit_of(text: str) -> int | None:
    """Number of the edit that a text of a stage's output begins with."""
    found = _EDIT.match(text)
    return None if found is None else int(found[1])


def _as_sentence(text: str) -> str:
    return f"{text[:1].upper()}{text[1:]}{'' if text.endswith(('.', '!', '?')) else '.'}"
