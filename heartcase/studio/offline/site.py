"""Several cases as a website of files: an index with pictures, and for each case its page; one copy of the viewer.

It opens from a folder and from any web server: scripts are classic ones and a case comes in one, because a browser
loads neither modules nor data into a page of a folder. The site is written beside its place under another name, and
put there whole.
"""

from __future__ import annotations

import hashlib
import json
import os
import secrets
import shutil
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import quote

from pydantic import TypeAdapter, ValidationError

from heartcase.pipeline.warnings import WarningGrade, grouped, warnings_of
from heartcase.schemas.base import Name
from heartcase.schemas.bundle.approval import approval_state
from heartcase.schemas.bundle.format import CaseManifest
from heartcase.schemas.bundle.reader import OpenBundle, open_bundle
from heartcase.schemas.errors import HeartcaseError, Problem, UsageError
from heartcase.schemas.files import TEMPORARY_PREFIX, sha256_of_file
from heartcase.simulator.load import Case, load_case
from heartcase.studio.offline.bundling import bundled_script
from heartcase.studio.offline.pictures import SMALL_SIZE, small_picture
from heartcase.studio.offline.shown import shown_of
from heartcase.studio.offline.surfaces import middle_level, surface_of
from heartcase.studio.offline.toured import tours_of
from heartcase.studio.offline.web_page import (
    FRAMES_PER_SECOND,
    LINKED_POLICY,
    PAGE,
    Recorded,
    case_script,
    icons,
    linked_page,
    viewer_script,
    viewer_style,
)
from heartcase.studio.operating.scene.normal_map import load_normal_map

if TYPE_CHECKING:
    import jinja2

__all__ = ["MARK", "SiteCase", "SiteResult", "write_site"]

MARK = ".heartcase-site.json"
"""File that says which files of a folder are the site's."""
_VERSION = 1
_OF_FILE_MANAGERS = frozenset({".DS_Store", "Thumbs.db", "desktop.ini"})
_NOTICE: str = CaseManifest.model_fields["notice"].default


@dataclass(frozen=True)
class SiteCase:
    """A case for a site."""

    path: Path
    """Its folder, ``NAME.case``."""
    recordings: Callable[[Case], Sequence[Recorded]] = lambda case: ()
    """Makes the recordings that its page plays, from the case as it is loaded."""
    has_tours: bool = True
    """Whether its page has its guided tours."""

    @property
    def name(self) -> str:
        """Name of its page."""
        return self.path.name.removesuffix(".case")


@dataclass(frozen=True)
class SiteResult:
    """A site as it was written."""

    index: Path
    """The page to open."""
    names: tuple[str, ...]
    """Names of the cases."""
    tours: dict[str, tuple[str, ...]]
    """Name of each case that has guided tours -> their titles."""
    byte_count: int
    """Bytes of all files."""
    warnings: tuple[str, ...]
    """What to know before it is passed on."""


def write_site(
    cases: Sequence[SiteCase],
    out: Path,
    *,
    level: int | None = None,
    frames_per_second: float = FRAMES_PER_SECOND,
    say: Callable[[str], None] = lambda name: None,
) -> SiteResult:
    """Write the site of some cases, or write it anew.

    Parameters
    ----------
    cases
        The cases, in the order of the index.
    out
        Folder of the site: one that is not there, an empty one, or a site that nobody has changed, which is replaced
        whole.
    level
        Level of detail of the surfaces; the middle one of each case where left out.
    frames_per_second
        How many moments of a recording make a second of its simulated time.
    say
        Is told the name of each case before its page is made.

    Raises
    ------
    UsageError
        Two cases have one name, a name cannot be an address, or the folder holds what is not the site's.
    BundleError
        A case is damaged, or was made without its surface.
    """
    out = out.resolve()
    opened = _opened(cases, out)
    temporary = out.with_name(f"{TEMPORARY_PREFIX}{os.getpid()}-{secrets.token_hex(4)}-site")
    warnings, tours = [], {}
    try:
        site = _Files(temporary)
        cards = []
        for case, bundle in zip(cases, opened, strict=True):
            say(case.name)
            titles, problems = _write_case(site, case, bundle, level, frames_per_second)
            if titles:
                tours[case.name] = titles
            warnings += [f"{case.name}: {problem}" for problem in problems]
            cards.append(_card(case, bundle, site.sizes[f"cases/{case.name}.js"]))
            about = bundle.manifest.about
            if about is not None and about.refusal is not None:
                warnings.append(f"{case.name}: {about.refusal}; do not publish this site")
        site.write("assets/viewer.js", viewer_script().encode())
        site.write("assets/viewer.css", viewer_style().encode())
        site.write("assets/index.js", bundled_script(PAGE, "offline/index.js").encode())
        site.write("index.html", _index(cards).encode())
        files = {"site_version": _VERSION, "files": site.hashes}
        site.write(MARK, json.dumps(files, indent=1).encode())
        _put(temporary, out)
    finally:
        shutil.rmtree(temporary, ignore_errors=True)
    names = tuple(case.name for case in cases)
    return SiteResult(out / "index.html", names, tours, sum(site.sizes.values()), tuple(warnings))


class _Files:
    """Files of a site in a folder of its own."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.sizes: dict[str, int] = {}
        self.hashes: dict[str, str] = {}
        folder.mkdir()

    def write(self, name: str, content: bytes) -> None:
        path = self.folder / name
        path.parent.mkdir(exist_ok=True)
        path.write_bytes(content)
        self.sizes[name] = len(content)
        self.hashes[name] = hashlib.sha256(content).hexdigest()


def _opened(cases: Sequence[SiteCase], out: Path) -> list[OpenBundle]:
    """The cases, opened; all that is wrong is told at once."""
    problems = []
    named = Counter(case.name.casefold() for case in cases)
    for case in cases:
        try:
            TypeAdapter(Name).validate_python(case.name)
        except ValidationError:
            words = "the folder's name cannot be an address: take letters a to z, digits, spaces and _ . ( ) + -"
            problems.append(Problem("CASE", words))
    for name, count in named.items():
        if count > 1:
            problems.append(Problem("CASE", f"{count} cases are called {name}: rename one, its page has that name"))
    if (reason := _reason_to_keep(out)) is not None:
        problems.append(Problem("--out", reason))
    elif not out.parent.is_dir():
        problems.append(Problem("--out", "the folder that it is to lie in is not there: make it, or give another"))
    if problems:
        raise UsageError(problems)
    opened = []
    for case in cases:
        try:
            opened.append(open_bundle(case.path))
        except HeartcaseError as error:
            problems += [replace(each, place=f"CASE {case.name}") for each in error.problems]
    if problems:
        raise UsageError(problems)
    return opened


def _reason_to_keep(out: Path) -> str | None:
    """Why a folder may not be replaced by a site; None where it may, or is not there."""
    if not out.exists():
        return None
    if not out.is_dir():
        return "it is a file, and a site is a folder: give another name"
    there = [path for path in out.rglob("*") if not path.is_dir() or path.is_symlink()]
    there = [path for path in there if path.name not in _OF_FILE_MANAGERS]
    if not there:
        return None
    ours = _listed(out)
    if ours is None:
        return "the folder holds files that no site of heartcase left there: give a new or an empty one"
    foreign = [path for path in there if not _is_listed(path, path.relative_to(out).as_posix(), ours)]
    if foreign:
        counted = "a file" if len(foreign) == 1 else f"{len(foreign)} files"
        return f"the site in it has {counted} that somebody else put there or changed: move them away, or give another"
    return None


def _listed(out: Path) -> dict[str, str] | None:
    """Path of each file of a site -> its hash; None where there is no site."""
    try:
        data = json.loads((out / MARK).read_text(encoding="utf-8"))
        return {str(name): str(sha256) for name, sha256 in data["files"].items()} if data["site_version"] else None
    except (OSError, ValueError, TypeError, KeyError, AttributeError):
        return None


def _is_listed(path: Path, name: str, ours: dict[str, str]) -> bool:
    if path.is_symlink():
        return False
    return name == MARK or (name in ours and sha256_of_file(path) == ours[name])


def _put(temporary: Path, out: Path) -> None:
    """Put a folder that is whole in its place; what stood there goes."""
    if (reason := _reason_to_keep(out)) is not None:
        raise UsageError(reason, place="--out")
    if not out.exists():
        temporary.rename(out)
        return
    old = temporary.with_name(f"{temporary.name}-old")
    out.rename(old)
    try:
        temporary.rename(out)
    except BaseException:
        old.rename(out)
        raise
    shutil.rmtree(old, ignore_errors=True)


def _write_case(
    site: _Files, case: SiteCase, bundle: OpenBundle, level: int | None, frames_per_second: float
) -> tuple[tuple[str, ...], tuple[Problem, ...]]:
    """Write its page; the titles of its tours, and what is wrong with others."""
    if level is not None:
        bundle.surface_role(level, place="--level")
    elif not bundle.levels:
        bundle.surface_role(0)
    shown_level = middle_level(bundle) if level is None else level
    loaded = load_case(case.path, needs=("surface", "structures", "tissue", "cell_labels"), level=shown_level)
    assert loaded.surface is not None
    played = case.recordings(loaded)
    # what a step does would take minutes for each case
    tours, problems = tours_of(loaded, case.path, does_acts=False) if case.has_tours else ([], ())
    script = case_script(
        loaded,
        shown_of(bundle, shown_level),
        played,
        tours=tours,
        normal_map=load_normal_map(case.path, loaded.surface, shown_level),
        frames_per_second=frames_per_second,
    )
    site.write(f"cases/{case.name}.js", script)
    page = linked_page(
        style="../assets/viewer.css",
        script="../assets/viewer.js",
        case=f"{quote(case.name)}.js",
        back="../index.html",
        back_word="offline_index",
    )
    site.write(f"cases/{case.name}.html", page)
    finest = surface_of(bundle, min(bundle.levels))
    site.write(f"pictures/{case.name}.webp", small_picture(finest, bundle.manifest.labels))
    return tuple(one.tour.tour.title for one in tours), problems


def _card(case: SiteCase, bundle: OpenBundle, byte_count: int) -> dict[str, Any]:
    """What the index says of a case."""
    manifest = bundle.manifest
    about = manifest.about
    titles = {language: text.title for language, text in about.texts.items()} if about else {"en": case.name}
    doubtful = sum(len(group.lines) for group in grouped(warnings_of(manifest)) if group.grade is not WarningGrade.NOTE)
    state = approval_state(case.path)
    simulation = manifest.simulation
    figures: list[tuple[str, dict[str, Any]]] = [
        ("offline_site_approved" if state.state == "approved" else "offline_site_draft", {}),
        (f"offline_site_doubtful_{min(doubtful, 2)}", {"count": doubtful}),
        ("offline_site_tissue", {"ml": round(simulation.tissue_volume_ml, 1)}),
        ("offline_site_nodes", {"count": simulation.node_count}),
        ("offline_site_size", {"mb": round(byte_count / 1e6, 1)}),
    ]
    return {
        "name": case.name,
        "titles": titles,
        "diagnoses": [one.name for one in about.diagnoses] if about else [],
        "figures": figures,
    }


def _index(cards: Sequence[dict[str, Any]]) -> str:
    return _template().render(cards=cards, notice=_NOTICE, policy=LINKED_POLICY, size=SMALL_SIZE, icons=icons())


@cache
def _template() -> jinja2.Template:
    import jinja2

    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(Path(__file__).parent),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["address"] = quote
    environment.filters["json"] = lambda value: json.dumps(value, ensure_ascii=False)
    return environment.get_template("site.html.j2")
