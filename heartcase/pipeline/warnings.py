"""How much a warning matters: what comes first for the clinician who must trust or reject a case.

A warning is a line of text. Where it arises it is marked as one about the anatomy, or as one for information; a plain
line without a mark is something to look at. The mark travels with the line through the cache and stands in the case,
so that nothing has to be guessed from its words.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from enum import IntEnum
from typing import Any

from heartcase.schemas.bundle.format import CaseManifest, WarningGrade

__all__ = [
    "Caution",
    "CautionGroup",
    "Severity",
    "anatomy",
    "caution_from_json",
    "caution_to_json",
    "cautions_of",
    "counted",
    "grouped",
    "note",
    "severity_of",
    "worst_first",
]


class Severity(IntEnum):
    """How much a warning matters, the worst first."""

    ANATOMY = 0
    """The model may differ from the patient's heart in shape: an opening, a wall, a vessel, a whole structure."""
    LOOK = 1
    """Something that may be right or wrong, and that a look at the slices decides."""
    NOTE = 2
    """Nothing need be done unless it disturbs."""

    @property
    def grade(self) -> WarningGrade:
        """What the manifest of a case calls it."""
        return WarningGrade[self.name]


class Caution(str):
    """A warning's text, with how much it matters."""

    severity: Severity

    def __new__(cls, text: str, severity: Severity = Severity.LOOK) -> Caution:
        """Mark a line of text."""
        caution = super().__new__(cls, text)
        caution.severity = severity
        return caution


@dataclass(frozen=True)
class CautionGroup:
    """Warnings that matter alike, as a report shows them."""

    severity: Severity
    """How much they matter."""
    title: str
    """Heading."""
    advice: str
    """What to do about all of them, one sentence."""
    lines: tuple[str, ...]
    """The warnings as sentences, in the order they were given."""


_TITLES = {
    Severity.ANATOMY: (
        "The anatomy may be wrong",
        "Do not rely on these places before you have mended or checked them.",
    ),
    Severity.LOOK: ("Look at this", "Compare these places with the slices before you approve the case."),
    Severity.NOTE: ("For your information", "Nothing need be done unless it disturbs."),
}


def anatomy(text: str) -> Caution:
    """A warning that the model's shape may not be the patient's."""
    return Caution(text, Severity.ANATOMY)


def note(text: str) -> Caution:
    """A warning that calls for nothing."""
    return Caution(text, Severity.NOTE)


def severity_of(warning: str) -> Severity:
    """How much a warning matters; a plain line is something to look at."""
    return warning.severity if isinstance(warning, Caution) else Severity.LOOK


def worst_first(*sources: Iterable[str]) -> tuple[Caution, ...]:
    """All warnings once, the worst on top; those that matter alike stay in the order of the sources.

    Parameters
    ----------
    sources
        Warnings of the stages, in the order of the stages. A line that comes twice counts as its worst.

    Returns
    -------
    tuple of Caution
        Sorted.
    """
    found: dict[str, Severity] = {}
    for warning in (line for source in sources for line in source):
        text = str(warning)
        found[text] = min(severity_of(warning), found.get(text, Severity.NOTE))
    return tuple(Caution(text, severity) for text, severity in sorted(found.items(), key=lambda item: item[1]))


def cautions_of(manifest: CaseManifest) -> tuple[Caution, ...]:
    """Warnings of a case with how much they matter; in a case that does not say so each is worth a look."""
    grades = manifest.warning_grades or (WarningGrade.LOOK,) * len(manifest.warnings)
    return tuple(Caution(text, Severity[grade.name]) for text, grade in zip(manifest.warnings, grades, strict=True))


def grouped(warnings: Iterable[str]) -> tuple[CautionGroup, ...]:
    """Warnings under the headings of a report, the worst heading first; headings without a warning are left out."""
    every = worst_first(warnings)
    groups = []
    for severity, (title, advice) in _TITLES.items():
        lines = tuple(_as_sentence(line) for line in every if line.severity is severity)
        if lines:
            groups.append(CautionGroup(severity, title, advice, lines))
    return tuple(groups)


def counted(number: int, thing: str) -> str:
    """A number of things in words: ``1 piece``, ``3 pieces``."""
    return f"{number} {thing}{'' if number == 1 else 's'}"


def caution_to_json(warning: str) -> str | dict[str, Any]:
    """A warning as JSON can hold it: plain text where it has no mark."""
    text = str(warning)
    return {"severity": warning.severity.name, "text": text} if isinstance(warning, Caution) else text


def caution_from_json(value: str | Mapping[str, Any]) -> str:
    """What :func:`caution_to_json` made, back.

    Raises
    ------
    KeyError, TypeError
        It is neither a text nor a marked one.
    """
    return value if isinstance(value, str) else Caution(value["text"], Severity[value["severity"]])


def _as_sentence(text: str) -> str:
    return f"{text[:1].upper()}{text[1:]}{'' if text.endswith(('.', '!', '?')) else '.'}"
