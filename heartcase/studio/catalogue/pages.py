"""The pages of the catalogue as HTML. Every text of a case is escaped; no page holds a script or a style of its own."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Mapping, Sequence
from functools import cache
from typing import TYPE_CHECKING, Any
from urllib.parse import quote

from heartcase.schemas.bundle.format import CaseManifest
from heartcase.schemas.landmarks import Landmark
from heartcase.studio.catalogue.entries import Entry
from heartcase.studio.catalogue.words import INTERFACE_LANGUAGES, LANGUAGE_NAMES, WORDS
from heartcase.studio.offline.pictures import PICTURE_SIZE

if TYPE_CHECKING:
    import jinja2

__all__ = ["address", "case_page", "index_page", "index_script", "list_page", "words_script"]

_NOTICE: str = CaseManifest.model_fields["notice"].default


def case_page(
    entry: Entry,
    *,
    to_cases: str,
    view_bytes: int,
    cut_source: str,
    languages: Sequence[str],
) -> str:
    """The page of a case.

    Parameters
    ----------
    entry
        The case.
    to_cases
        Address of the folder of the cases from the page's, ending in a slash.
    view_bytes
        Size of the file with the case for the 3-D view; 0 where there is none.
    cut_source
        How the plane of the second picture was found.
    languages
        Languages of the texts to show; all where empty. English always is one.
    """
    manifest = entry.manifest
    texts = [
        (language, text.model_dump())
        for language, text in sorted(entry.about.texts.items(), key=lambda item: (item[0] != "en", item[0]))
        if not languages or language == "en" or language in languages
    ]
    p99 = entry.surface_p99_mm
    return _render(
        "case.html.j2",
        root="../",
        name=entry.name,
        about=entry.about,
        texts=texts,
        notice=manifest.notice,
        doubtful_count=entry.doubtful_count,
        counted_doubtful=_counted_doubtful(entry.doubtful_count),
        p99=None if p99 is None else f"{round(p99, 3):g}",
        nodes=manifest.simulation.node_count,
        pictures=bool(entry.bundle.levels),
        picture_size=PICTURE_SIZE,
        cut_source=cut_source,
        view_size=_size(view_bytes) if view_bytes else "",
        landmarks=entry.landmarks,
        warnings=[(group.grade.value, group.lines) for group in entry.warnings],
        facts=entry.facts,
        openings=entry.openings,
        volumes=entry.volumes_ml,
        report=entry.report,
        to_cases=to_cases,
        downloads=entry.downloads,
        modality={"CT": "CT", "MR": "MR"}.get(manifest.modality, ""),
        case_id=manifest.case_id,
        software_version=manifest.software_version,
    )


def index_page() -> str:
    """The page that searches and filters; what it lists is in :func:`index_script`."""
    return _render("index.html.j2", root="", notice=_NOTICE)


def list_page(cards: Sequence[Mapping[str, Any]]) -> str:
    """All cases as a list of links, for whoever has scripts switched off."""
    return _render("list.html.j2", root="", notice=_NOTICE, cards=cards)


def index_script(cards: Sequence[Mapping[str, Any]]) -> str:
    """The script that hands the cards of all cases to the index."""
    return script_call("HeartcaseIndex.register", list(cards))


def words_script(languages: Sequence[str]) -> str:
    """The script with the interface's words and the languages to choose from."""
    words = {
        language: {key: texts[number] for key, texts in WORDS.items()}
        for number, language in enumerate(INTERFACE_LANGUAGES)
    }
    names = [[language, LANGUAGE_NAMES.get(language.partition("-")[0], language)] for language in languages]
    shared = {name for _, name in names if [other for _, other in names].count(name) > 1}
    named = [[code, f"{name} ({code})" if name in shared else name] for code, name in names]
    return f"window.HeartcaseWords = {script_call('Object', {'languages': named, 'words': words})}"


def address(name: str) -> str:
    """A file's name as it stands in an address."""
    return quote(name, safe="")


def script_call(function: str, data: Any) -> str:
    """A line of JavaScript that calls a function with data in which nothing can end the script or the string."""
    text = json.dumps(data, ensure_ascii=True, allow_nan=False, separators=(",", ":"))
    for letter in "<>&":
        text = text.replace(letter, f"\\u{ord(letter):04x}")
    return f"{function}({text});\n"


def _render(template: str, **values: Any) -> str:
    return _environment().get_template(template).render(**values)


@cache
def _environment() -> jinja2.Environment:
    import jinja2

    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("heartcase.studio.catalogue", "templates"),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.globals["word"] = lambda key: WORDS[key][0]
    environment.filters |= {
        "address": address,
        "diameter": _diameter,
        "paragraphs": _paragraphs,
        "point": _point,
        "size": _size,
    }
    return environment


def _paragraphs(text: str) -> list[str]:
    return [part.strip() for part in re.split(r"\n\s*\n", text) if part.strip()]


def _diameter(landmark: Landmark) -> str:
    """Diameter of a ring or of a vessel, mm; of a ring of points, that of the mean distance from their middle."""
    radius = landmark.radius_mm
    if landmark.kind == "ring" and radius is None:
        middle = [sum(values) / len(landmark.points_mm) for values in zip(*landmark.points_mm, strict=True)]
        radius = sum(math.dist(point, middle) for point in landmark.points_mm) / len(landmark.points_mm)
    return "" if radius is None else f"{2.0 * radius:.3g}"


def _point(point: Sequence[float]) -> str:
    return ", ".join(f"{value:.1f}" for value in point)


def _counted_doubtful(count: int) -> str:
    return WORDS[f"doubtful_{count if count < 2 else 'n'}"][0].replace("{count}", str(count))


def _size(byte_count: int) -> str:
    """A size in words."""
    if byte_count < 1000:
        return f"{byte_count} B"
    return f"{byte_count / 1e3:.0f} kB" if byte_count < 1e6 else f"{byte_count / 1e6:.1f} MB"
