"""What a case teaches, where it comes from, and whether it may be shown: what a catalogue tells about it."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from heartcase.schemas.base import Model
from heartcase.schemas.errors import ModelProblems, Problem

__all__ = ["About", "Diagnosis", "Release", "TeachingText"]

_Line = Annotated[str, Field(min_length=1, max_length=300, pattern=r"^[^\x00-\x1f\x7f-\x9f]+$")]
_Paragraph = Annotated[str, Field(min_length=1, max_length=4000, pattern=r"^[^\x00-\x08\x0b-\x1f\x7f-\x9f]+$")]
_Language = Annotated[str, Field(pattern=r"^[a-z]{2,3}(-[A-Za-z0-9]{2,8})*$")]


class Diagnosis(Model):
    """A diagnosis, by its name and its codes."""

    name: _Line
    """What it is called."""
    ipccc: Annotated[str, Field(pattern=r"^\d{2}\.\d{2}\.\d{2}$")] | None = None
    """Six-digit code of the International Paediatric and Congenital Cardiac Code."""
    icd11: Annotated[str, Field(pattern=r"^[0-9A-Z]{4}(\.[0-9A-Z]{1,2})?$")] | None = None
    """Code of the International Classification of Diseases, 11th revision."""
    synonyms: tuple[_Line, ...] = ()
    """Other names that people search for."""


class TeachingText(Model):
    """What a student reads, in one language."""

    title: _Line
    """Title of the case."""
    what: _Paragraph
    """What it is."""
    look_for: _Paragraph
    """What to look for."""
    access: _Paragraph | None = None
    """Which accesses to compare."""


class Release(Model):
    """The record that a patient's case may be shown; nothing in it may name the patient."""

    reference: _Line
    """Where the consent or the decision is filed: a number, never a name."""
    scope: _Line
    """What was released, and to whom: "teaching within the hospital", "public"."""
    date: Annotated[str, Field(pattern=r"^\d{4}-\d{2}-\d{2}$")]
    """When, as year-month-day."""


class About(Model):
    """What a library tells about a case."""

    origin: Literal["synthetic", "specimen", "patient"]
    """Where the scan comes from: made by a program, of a prepared specimen, or of a patient."""
    licence: _Line
    """Licence under which the case may be used, by its SPDX name where it has one."""
    attribution: _Line
    """Who is to be named."""
    release: Release | None = None
    """Of a patient: the record that the case may be shown. No catalogue takes a patient's case without it."""
    segmental: Annotated[str, Field(pattern=r"^\{[A-Z],[A-Z],[A-Z]\}$")] | None = None
    """Segmental notation: atrial situs, ventricular loop, great arteries, such as {S,D,S}."""
    diagnoses: Annotated[tuple[Diagnosis, ...], Field(min_length=1)]
    """What the heart has, the main one first; "normal heart" is one."""
    texts: dict[_Language, TeachingText]
    """Language code -> text; ``en`` is always there, and stands in for the languages that are missing."""

    @model_validator(mode="after")
    def _is_complete(self) -> About:
        problems: list[Problem] = []
        if "en" not in self.texts:
            problems.append(Problem("texts", "the English text (en) is missing: other languages fall back on it"))
        if self.release is not None and self.origin != "patient":
            problems.append(
                Problem("release", f"only a patient's case has one, and this is {self.origin}: leave it out")
            )
        if problems:
            raise ModelProblems(problems)
        return self

    @property
    def refusal(self) -> str | None:
        """Why a catalogue must not show the case; None where it may."""
        if self.origin == "patient" and self.release is None:
            return "it is a patient's, and no release is recorded: add [about.release], or keep it out of the catalogue"
        return None

    def text(self, language: str) -> TeachingText:
        """The text in a language; of its main language, or in English, where there is none in it."""
        return self.texts.get(language) or self.texts.get(language.partition("-")[0]) or self.texts["en"]
