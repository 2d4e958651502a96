"""What a case holds, for the page: warnings with their places, figures of the report, whether it is approved."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from heartcase.pipeline.warning_words import recognised
from heartcase.pipeline.warnings import warnings_of
from heartcase.schemas.bundle.approval import approval_state, bundle_sha256, report_beside
from heartcase.schemas.bundle.format import CaseManifest
from heartcase.schemas.bundle.reader import open_bundle
from heartcase.schemas.errors import BundleError, HeartcaseError

__all__ = ["Outcome", "outcome_of"]

Point = tuple[float, float, float]

_PLACE = re.compile(r"\((-?\d+(?:\.\d+)?), (-?\d+(?:\.\d+)?), (-?\d+(?:\.\d+)?)\)")
"""A place as the sentences of warnings write it, mm."""


@dataclass(frozen=True)
class Outcome:
    """A case as the page shows it."""

    sha256: str
    """Its bundle hash."""
    figures: Mapping[str, Any] = field(default_factory=dict)
    """All that is shown, as plain data."""
    places_mm: Mapping[str, Sequence[Point]] = field(default_factory=dict)
    """Places that the build told, by the text of their warning."""
    case: Path = Path()
    """The case's folder."""


def outcome_of(case: Path, places_mm: Mapping[str, Sequence[Point]] | None = None) -> Outcome | None:
    """What a case holds; None where there is none that is whole.

    Parameters
    ----------
    case
        The case's folder.
    places_mm
        Places that warnings are about, by their text, where the build told them; of others those that the sentence
        names.
    """
    if not case.is_dir():
        return None
    try:
        sha256 = bundle_sha256(case)
        manifest = open_bundle(case).manifest
        return Outcome(sha256, _figures(case, manifest, sha256, places_mm or {}), places_mm or {}, case)
    except (HeartcaseError, AttributeError, KeyError, TypeError, ValueError):
        # also one whose figures are not what builds write
        return None


def _figures(
    case: Path, manifest: CaseManifest, sha256: str, places_mm: Mapping[str, Sequence[Point]]
) -> dict[str, Any]:
    return {
        "sha256": sha256,
        "name": manifest.name,
        "notice": manifest.notice,
        "warnings": _warnings(manifest, places_mm),
        "volumes_ml": _volumes(manifest),
        "openings": _openings(manifest),
        "grown": _grown(manifest),
        "node_count": manifest.simulation.node_count,
        "cell_mm": manifest.simulation.cell_mm,
        "tissue_volume_ml": manifest.simulation.tissue_volume_ml,
        "approval": _approval(case),
        "has_report": _has_report(case, sha256),
    }


def _warnings(manifest: CaseManifest, told: Mapping[str, Sequence[Point]]) -> list[dict[str, Any]]:
    found = []
    for warning in warnings_of(manifest):
        named = [[float(number) for number in match] for match in _PLACE.findall(warning.text)]
        places = [list(place) for place in told.get(warning.text, ())] or named
        code, parts = recognised(warning.text)
        one = {"text": warning.sentence, "grade": warning.grade.value, "places_mm": places}
        found.append(one | {"code": code, "parts": parts})
    return found


def _volumes(manifest: CaseManifest) -> dict[str, float]:
    volumes = manifest.quality.get("volumes_ml")
    known = volumes if isinstance(volumes, dict) else {}
    # the background says how large the scan was cut
    return {label.name: float(known[label.name]) for label in manifest.labels if label.value and label.name in known}


def _openings(manifest: CaseManifest) -> list[dict[str, Any]]:
    return [
        {
            "between": list(one["between"]),
            "area_mm2": one["area_mm2"],
            "center_mm": list(one["center_mm"]),
            "verdict": one["verdict"],
            "reach_mm": one.get("reach_mm"),
        }
        for one in manifest.quality.get("openings") or ()
    ]


def _grown(manifest: CaseManifest) -> list[dict[str, Any]]:
    """The places where walls were grown between two cavities whose outlines touch."""
    walls = manifest.quality.get("walls")
    septa = walls.get("septa") or () if isinstance(walls, dict) else ()
    return [
        {
            "between": list(one["between"]),
            "thickness_mm": one["thickness_mm"],
            "area_mm2": place["area_mm2"],
            "center_mm": list(place["center_mm"]),
            "radius_mm": place["radius_mm"],
            "state": place["state"],
        }
        for one in septa
        for place in one.get("places", ())
    ]


def _approval(case: Path) -> dict[str, Any]:
    state = approval_state(case)
    entry = state.entry
    return {
        "state": state.state,
        "words": state.words,
        "role": entry.role if entry is not None else None,
        "time": entry.time if entry is not None else None,
    }


def _has_report(case: Path, sha256: str) -> bool:
    try:
        return report_beside(case, sha256) is not None
    except BundleError:
        return False
