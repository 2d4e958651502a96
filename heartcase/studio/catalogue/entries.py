"""What the catalogue says of a case: from its manifest, in the words of the report."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter, ValidationError

from heartcase.pipeline.checks.openings import Verdict
from heartcase.pipeline.report.build_report import VERDICT_WORDS
from heartcase.pipeline.report.plain_words import Fact, figure_facts
from heartcase.pipeline.warnings import WarningGrade, WarningGroup, grouped, warnings_of
from heartcase.schemas.about import About
from heartcase.schemas.base import Name
from heartcase.schemas.bundle.format import MANIFEST_NAME, CaseManifest, FileRole
from heartcase.schemas.bundle.reader import OpenBundle, open_bundle
from heartcase.schemas.errors import BundleError
from heartcase.schemas.landmarks import Landmark

__all__ = ["Download", "Entry", "OpeningLine", "read_entry"]

_NO_ABOUT = (
    "the case does not say what it teaches, where it comes from and under which licence: add [about] to its recipe and "
    "build it again, or keep it out of the catalogue"
)
_PURPOSES = {
    FileRole.RENDER: "visible surface with normal map, for any 3-D program",
    FileRole.SURFACE: "visible surface with labels",
    FileRole.GRID: "cells and nodes of the simulation",
    FileRole.MAPPING: "tie between surface and nodes",
    FileRole.PICKING: "surface of the cells, for picking",
    FileRole.LABELS: "label volume",
    FileRole.SCAN: "filtered scan",
}
_MANIFEST_PURPOSE = "manifest: what the case is, and the list of its files"
_WEB_FIRST = (FileRole.RENDER, FileRole.LABELS, FileRole.SCAN)


@dataclass(frozen=True)
class Download:
    """A file of the case."""

    name: str
    """File name inside the case's folder."""
    size: int
    """Bytes."""
    purpose: str
    """What it is, in words."""


@dataclass(frozen=True)
class OpeningLine:
    """Where two cavities are open to each other."""

    between: str
    """Names of the two."""
    area_mm2: float
    """Area, mm2."""
    verdict: str
    """What to think of it."""


@dataclass(frozen=True)
class Entry:
    """A case that the catalogue shows."""

    name: str
    """Name of its folder, without ``.case``."""
    bundle: OpenBundle
    """The case."""
    about: About
    """What it teaches."""
    report: str | None
    """File name of the report beside it; None where there is none."""

    @property
    def manifest(self) -> CaseManifest:
        """What the case says of itself."""
        return self.bundle.manifest

    @property
    def landmarks(self) -> tuple[Landmark, ...]:
        """Named points, rings and lines."""
        return self.manifest.landmarks

    @property
    def warnings(self) -> tuple[WarningGroup, ...]:
        """Warnings by how much they matter, the worst first."""
        return grouped(warnings_of(self.manifest))

    @property
    def doubtful_count(self) -> int:
        """Number of warnings that are more than information."""
        return sum(len(group.lines) for group in self.warnings if group.grade is not WarningGrade.NOTE)

    @property
    def surface_p99_mm(self) -> float | None:
        """Distance that 99 % of the finest surface keeps to the true one, mm; None where it was not measured."""
        return _number(_table(self.manifest.quality.get("surface")).get("distance_p99_mm"))

    @property
    def facts(self) -> list[Fact]:
        """Quality figures of surface and grid that are of use to all."""
        quality = self.manifest.quality
        return [
            fact
            for stage in ("surface", "grid")
            for fact in _facts(_table(quality.get(stage)))
            if not fact.is_technical
        ]

    @property
    def openings(self) -> list[OpeningLine]:
        """Where cavities are open to each other, as far as the manifest tells it in the form of this version."""
        found = []
        openings = self.manifest.quality.get("openings")
        for one in openings if isinstance(openings, list) else ():
            between, area = _table(one).get("between"), _number(_table(one).get("area_mm2"))
            if not isinstance(between, list) or len(between) != 2 or area is None:
                continue
            try:
                words = VERDICT_WORDS[Verdict(str(one.get("verdict")))]
            except ValueError:
                continue
            if one.get("stated_by"):
                words = _stated_words(str(one["stated_by"]))
            found.append(OpeningLine(f"{between[0]} and {between[1]}", area, words))
        return found

    @property
    def volumes_ml(self) -> list[tuple[str, float]]:
        """Label name -> volume, ml, but for the background."""
        volumes = _table(self.manifest.quality.get("volumes_ml"))
        names = [label.name for label in self.manifest.labels if label.value != 0]
        return [(name, volume) for name in names if (volume := _number(volumes.get(name))) is not None]

    @property
    def is_tied(self) -> bool:
        """Whether its surface is tied to its grid, so that it can move."""
        return all(self.manifest.file(FileRole.MAPPING.at(level)) is not None for level in self.bundle.levels)

    @property
    def downloads(self) -> list[Download]:
        """Every file of the case, what other programs read first."""
        manifest_size = (self.bundle.directory / MANIFEST_NAME).stat().st_size
        files = sorted(self.manifest.files, key=lambda file: (_rank(file.role), file.role.value))
        return [
            *(Download(file.name, file.size, _purpose(file.role)) for file in files),
            Download(MANIFEST_NAME, manifest_size, _MANIFEST_PURPOSE),
        ]

    def card(self) -> dict[str, Any]:
        """What the index says of the case, as JSON holds it."""
        return {
            "name": self.name,
            "titles": {language: text.title for language, text in sorted(self.about.texts.items())},
            "diagnoses": [
                {
                    "name": one.name,
                    **({"more": list(one.synonyms)} if one.synonyms else {}),
                    **({"codes": codes} if (codes := [code for code in (one.ipccc, one.icd11) if code]) else {}),
                }
                for one in self.about.diagnoses
            ],
            "segmental": self.about.segmental,
            "origin": self.about.origin,
            "doubtful": self.doubtful_count,
            "p99": None if self.surface_p99_mm is None else round(self.surface_p99_mm, 3),
            "nodes": self.manifest.simulation.node_count,
            "picture": bool(self.bundle.levels),
        }


def read_entry(case: Path) -> Entry:
    """Open a case for the catalogue.

    Raises
    ------
    BundleError
        It is damaged; or it must not be shown, because it says nothing about itself or is a patient's without a
        recorded release.
    """
    name = case.name.removesuffix(".case")
    try:
        TypeAdapter(Name).validate_python(name)
    except ValidationError:
        raise BundleError(
            "the folder's name cannot be an address: take letters a to z without accents, digits, spaces and "
            "_ . ( ) + -, and begin with a letter or a digit",
            place="case",
        ) from None
    bundle = open_bundle(case)
    about = bundle.manifest.about
    if about is None:
        raise BundleError(_NO_ABOUT, place="about")
    if about.refusal is not None:
        raise BundleError(about.refusal, place="about.release")
    report = f"{name}.report.html"
    return Entry(name, bundle, about, report if (case.parent / report).is_file() else None)


def _stated_words(stated_by: str) -> str:
    """That an opening is meant, for those who know no recipe."""
    if stated_by.startswith("edits["):
        return "not in a normal heart, but meant here: the hole was made in the model"
    return f"not in a normal heart, but meant here: {stated_by}"


def _rank(role: FileRole) -> int:
    return _WEB_FIRST.index(role.finest) if role.finest in _WEB_FIRST else len(_WEB_FIRST)


def _purpose(role: FileRole) -> str:
    words = _PURPOSES[role.finest]
    return f"{words}, coarser ({role.level})" if role.level else words


def _table(value: Any) -> Mapping[str, Any]:
    return value if isinstance(value, Mapping) else {}


def _number(value: Any) -> float | None:
    if isinstance(value, bool) or not isinstance(value, int | float):
        return None
    try:
        return float(value)
    except OverflowError:
        return None


def _facts(figures: Mapping[str, Any]) -> list[Fact]:
    """Facts of figures that any version may have written: one that is not in the form of ours is passed over."""
    try:
        return figure_facts(figures)
    except (ValueError, TypeError, KeyError, AttributeError, OverflowError):
        return [fact for key, value in figures.items() if len(figures) > 1 for fact in _facts({key: value})]
