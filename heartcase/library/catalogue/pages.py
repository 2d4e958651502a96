"""The pages of the catalogue as HTML. Every text of a case is escaped; no page holds a script or a style of its own."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from functools import cache
from typing import TYPE_CHECKING, Any
from urllib.parse import quote

from heartcase.library.catalogue.colours import OXYGEN_COLOURS
from heartcase.library.catalogue.entries import Entry
from heartcase.library.catalogue.mesh_data import PackedMesh, group_look, script_call
from heartcase.library.catalogue.oxygenation import Oxygen, Oxygenation
from heartcase.library.catalogue.pictures import PICTURE_SIZE
from heartcase.library.catalogue.words import INTERFACE_LANGUAGES, LANGUAGE_NAMES, WORDS
from heartcase.schemas.bundle.format import CaseManifest
from heartcase.schemas.landmarks import Landmark

if TYPE_CHECKING:
    import jinja2

__all__ = ["address", "case_page", "index_page", "index_script", "list_page", "words_script"]

_NOTICE: str = CaseManifest.model_fields["notice"].default
_BODY_CUTS = ("front", "left", "right", "feet", "view")


def case_page(
    entry: Entry,
    *,
    to_cases: str,
    mesh: PackedMesh | None,
    mesh_bytes: int,
    blood: Oxygenation,
    cut_source: str,
    cuts: Sequence[str],
    languages: Sequence[str],
) -> str:
    """The page of a case.

    Parameters
    ----------
    entry
        The case.
    to_cases
        Address of the folder of the cases from the page's, ending in a slash.
    mesh, mesh_bytes
        Its surface as the viewer has it, and the size of that script; None where there is none.
    blood
        Oxygenation of its structures.
    cut_source
        How the plane of the second picture was found.
    cuts
        Cuts of the viewer that follow the heart: ``four``, ``short``.
    languages
        Languages of the texts to show; all where empty. English always is one.
    """
    manifest, table = entry.manifest, entry.manifest.labels
    groups = []
    for group in mesh.groups if mesh else ():
        look = group_look(group, table, blood)
        groups.append({"name": group.name, "part": group.part, "colour": look.structure, "blood": look.blood.value})
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
        mesh=mesh,
        mesh_size=_size(mesh_bytes),
        cuts=("none", *cuts, *_BODY_CUTS),
        groups=groups,
        blood=blood,
        bloods=[kind.value for kind in Oxygen if any(group["blood"] == kind.value for group in groups)],
        oxygen_colours={kind.value: colour for kind, colour in OXYGEN_COLOURS.items()},
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


def _render(template: str, **values: Any) -> str:
    return _environment().get_template(template).render(**values)


@cache
def _environment() -> jinja2.Environment:
    import jinja2

    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("heartcase.library.catalogue", "templates"),
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
