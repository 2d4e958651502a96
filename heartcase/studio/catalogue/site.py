"""Writing the catalogue: a page for each case that may be shown, and the index over all of them."""

from __future__ import annotations

import hashlib
import json
import os
import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import Any
from urllib.parse import quote

from heartcase import __version__
from heartcase.schemas.bundle.approval import approval_log
from heartcase.schemas.bundle.format import MANIFEST_NAME
from heartcase.schemas.errors import HeartcaseError, MissingPathError, Problem, UsageError
from heartcase.schemas.files import exclusive, is_there, remove_leftovers
from heartcase.simulator.load import load_case
from heartcase.studio.catalogue.entries import Entry, read_entry
from heartcase.studio.catalogue.ledger import (
    LEDGER,
    SITE,
    Ledger,
    Page,
    is_ours,
    is_unchanged,
    read_ledgers,
    remove_page,
    write_page,
)
from heartcase.studio.catalogue.pages import address, case_page, index_page, index_script, list_page, words_script
from heartcase.studio.catalogue.words import INTERFACE_LANGUAGES
from heartcase.studio.offline.pictures import case_pictures
from heartcase.studio.offline.shown import shown_of
from heartcase.studio.offline.surfaces import middle_level, surface_of
from heartcase.studio.offline.toured import tours_of
from heartcase.studio.offline.web_page import case_script, linked_page, viewer_script, viewer_style
from heartcase.studio.operating.scene.normal_map import load_normal_map
from heartcase.studio.sample_folder import sample_folder
from heartcase.studio.touring.found_tours import tours_sha256

__all__ = ["CatalogueResult", "write_catalogue"]

_PACKAGE = Path(__file__).parent
_ASSETS = ("style.css", "catalogue.js", "finder.js")


@dataclass(frozen=True)
class CatalogueResult:
    """What became of the catalogue."""

    site: Path
    """Its folder."""
    shown: tuple[str, ...]
    """Names of the cases that it shows."""
    made: tuple[str, ...]
    """Those whose page was made now; the others had not changed."""
    removed: tuple[str, ...]
    """Cases whose page was removed: gone, or refused now."""
    refused: dict[str, tuple[Problem, ...]] = field(default_factory=dict)
    """Name of a case -> why it is not shown."""
    warnings: dict[str, tuple[Problem, ...]] = field(default_factory=dict)
    """Name of a case that is shown -> what its page goes without, such as a tour that is wrong."""
    seconds: float = 0.0
    """How long it took, s."""

    @property
    def index(self) -> Path:
        """The page to open."""
        return self.site / "index.html"


def write_catalogue(
    cases: Path | str,
    out: Path | str | None = None,
    *,
    languages: Sequence[str] = (),
    say: Callable[[str], None] = lambda name: None,
) -> CatalogueResult:
    """Write the catalogue of a folder of cases, or bring it up to date.

    Parameters
    ----------
    cases
        Folder that holds ``NAME.case`` folders, and their reports: the OUT of a library build.
    out
        Folder of the site; ``catalogue`` in that of the cases where left out. Links to the cases are relative, so
        that both can be moved together.
    languages
        Languages to offer, as codes; those of the texts and of the interface where empty. English always is one.
    say
        Is told the name of each case before its page is made.

    Raises
    ------
    UsageError
        There is no such folder, or no case in it; or the site's folder holds what the catalogue did not write.
    """
    start = time.perf_counter()
    cases = Path(cases)
    if not (is_there(cases) and cases.is_dir()):
        raise MissingPathError("there is no such folder: give the OUT of a library build", place="OUT")
    folders = {path.name.removesuffix(".case"): path for path in sorted(cases.glob("*.case")) if path.is_dir()}
    if not folders:
        raise UsageError("there is no case in this folder: give the OUT of a library build", place="OUT")
    site = cases / "catalogue" if out is None else Path(out)
    if not is_ours(site):
        raise UsageError(
            "the folder holds something that the catalogue did not write: give a new or an empty one", place="--to"
        )
    (site / LEDGER).mkdir(parents=True, exist_ok=True)
    with exclusive(site):
        result = _Run(cases, site, tuple(languages), say).write(folders)
    return replace(result, seconds=time.perf_counter() - start)


_SAME_NAME = "another case has this name but for upper and lower case, and so one page with it: rename one of them"


@dataclass
class _Run:
    cases: Path
    site: Path
    languages: tuple[str, ...]
    say: Callable[[str], None]

    def __post_init__(self) -> None:
        folders = [self.cases] if (samples := sample_folder()) is None else [self.cases, samples]
        self._tours = tours_sha256(folders)

    def write(self, folders: dict[str, Path]) -> CatalogueResult:
        """Judge, remove, make, list: a page that must go is gone before anything takes time."""
        ledgers = read_ledgers(self.site)
        before = {name: page for name, page in ledgers.items() if name != SITE}
        stamps = {name: self._stamp(name, folder) for name, folder in folders.items()}
        count = Counter(name.casefold() for name in folders)
        pages: Ledger = {}
        stale: dict[str, Entry] = {}
        for name, folder in folders.items():
            if count[name.casefold()] > 1:
                pages[name] = Page(problems=(("name", _SAME_NAME),))
                continue
            known = before.get(name)
            if known and stamps[name] and known.stamp == stamps[name] and is_unchanged(self.site, known):
                pages[name] = known
                continue
            try:
                stale[name] = read_entry(folder)
            except HeartcaseError as error:
                problems = tuple((one.place, one.message) for one in error.problems)
                pages[name] = Page(stamps[name], problems=problems)
        gone = [name for name in before if name not in stale and (name not in pages or pages[name] is not before[name])]
        removed = tuple(sorted(name for name in gone if before[name].card is not None))
        if removed:
            self._write_site({name: page for name, page in before.items() if name not in gone}, ledgers)
            ledgers = read_ledgers(self.site)
        for name in gone:
            remove_page(self.site, name, before[name])
        made = []
        for name, entry in stale.items():
            self.say(name)
            try:
                pages[name] = self._write_case(entry, stamps[name], before.get(name))
                made.append(name)
            except HeartcaseError as error:
                problems = tuple((one.place, one.message) for one in error.problems)
                pages[name] = Page(problems=problems)
                if name in before:
                    remove_page(self.site, name, before[name])
        for name, page in pages.items():
            if page.problems and page.stamp and page is not before.get(name) and _is_safe(name):
                write_page(self.site, name, {}, None, page)
        self._write_site(pages, ledgers)
        for part in ("", "assets", "cases", "data", "pictures", "view", LEDGER):
            remove_leftovers(self.site / part)
        in_order = sorted(pages.items())
        refused = {name: tuple(Problem(*one) for one in page.problems) for name, page in in_order if page.problems}
        warnings = {name: tuple(Problem(*one) for one in page.warnings) for name, page in in_order if page.warnings}
        shown = tuple(name for name, page in in_order if page.card is not None)
        return CatalogueResult(self.site, shown, tuple(made), removed, refused, warnings)

    def _stamp(self, name: str, folder: Path) -> str:
        """What the page would be made from: the manifest, which holds the hash of every other file, and the code."""
        try:
            manifest = (folder / MANIFEST_NAME).read_bytes()
            sizes = sorted((path.name, path.lstat().st_size) for path in folder.iterdir())
            log = approval_log(folder)
            approved = hashlib.sha256(log.read_bytes()).hexdigest() if log.is_file() else ""
        except OSError:
            return ""
        report = (self.cases / f"{name}.report.html").is_file()
        what = [_code(), self.languages, self._to_cases(), sizes, report, hashlib.sha256(manifest).hexdigest()]
        what += [self._tours, approved]
        return hashlib.sha256(json.dumps(what).encode()).hexdigest()

    def _to_cases(self) -> str:
        """Address of the cases' folder from that of the pages."""
        pages = (self.site / "cases").resolve()
        try:
            relative = os.path.relpath(self.cases.resolve(), pages)
        except ValueError:
            raise UsageError(
                "it is on another drive than the cases, which its pages must link to: give a folder on the same one",
                place="--to",
            ) from None
        return quote(Path(relative).as_posix()) + "/"

    def _write_case(self, entry: Entry, stamp: str, before: Page | None) -> Page:
        name, bundle = entry.name, entry.bundle
        content: dict[str, bytes] = {}
        cut_source = ""
        wrong: tuple[Problem, ...] = ()
        if bundle.levels:
            if entry.is_tied:
                viewer, wrong = self._viewer_of(entry)
                content |= viewer
            surface = surface_of(bundle, min(bundle.levels))
            pictures, cut_source = case_pictures(surface, entry.manifest.labels, entry.landmarks)
            content |= {f"pictures/{name}.{which}.webp": data for which, data in pictures.items()}
        content[f"cases/{name}.html"] = case_page(
            entry,
            to_cases=self._to_cases(),
            view_bytes=len(content.get(f"view/{name}.js", b"")),
            cut_source=cut_source,
            languages=self.languages,
        ).encode()
        warnings = tuple((one.place, one.message) for one in wrong)
        return write_page(self.site, name, content, before, Page(stamp, entry.card(), warnings=warnings))

    def _viewer_of(self, entry: Entry) -> tuple[dict[str, bytes], tuple[Problem, ...]]:
        """The page that shows a case in 3-D, and the case for it; what is wrong with its tours."""
        level = middle_level(entry.bundle)
        path = entry.bundle.directory
        case = load_case(path, needs=("surface", "structures", "tissue", "cell_labels"), level=level)
        assert case.surface is not None
        page = linked_page(
            style="../assets/viewer.css",
            script="../assets/viewer.js",
            case=f"{address(entry.name)}.js",
            back=f"../cases/{address(entry.name)}.html",
            back_word="offline_back",
        )
        tours, problems = tours_of(case, path, does_acts=False)
        normal_map = load_normal_map(path, case.surface, level)
        data = case_script(case, shown_of(entry.bundle, level), tours=tours, normal_map=normal_map)
        wrong = (*problems, *(problem for one in tours for problem in one.problems))
        return {f"view/{entry.name}.html": page, f"view/{entry.name}.js": data}, wrong

    def _write_site(self, pages: Ledger, ledgers: Ledger) -> None:
        """The index and what all pages share; what did not change is not written."""
        cards = [page.card for _, page in sorted(pages.items()) if page.card is not None]
        content = {f"assets/{name}": (_PACKAGE / "assets" / name).read_bytes() for name in _ASSETS}
        content["assets/viewer.js"] = viewer_script().encode()
        content["assets/viewer.css"] = viewer_style().encode()
        content["assets/words.js"] = words_script(self._offered(cards)).encode()
        content["data/index.js"] = index_script(cards).encode()
        content["list.html"] = list_page(cards).encode()
        content["index.html"] = index_page().encode()
        write_page(self.site, SITE, content, ledgers.get(SITE), Page("site"))

    def _offered(self, cards: Sequence[dict[str, Any]]) -> list[str]:
        """Languages to choose from, English first."""
        found = {language for card in cards for language in card["titles"]} | set(INTERFACE_LANGUAGES)
        wanted = found & {"en", *self.languages} if self.languages else found
        return sorted(wanted, key=lambda language: (language != "en", language))


def _is_safe(name: str) -> bool:
    """Whether a case's name can be that of a ledger; one that cannot is judged anew each time."""
    return name != SITE and not name.startswith(".") and "/" not in name and len(name.encode()) < 200


@cache
def _code() -> str:
    """Hash of what makes pages: a page made by other code is made again."""
    studio = _PACKAGE.parent
    folders = [_PACKAGE, studio / "offline", studio / "operating"]
    files = [
        path
        for folder in folders
        for path in folder.rglob("*")
        if path.suffix in (".py", ".js", ".css", ".j2", ".html")
    ]
    digest = hashlib.sha256(__version__.encode())
    for path in sorted(files):
        digest.update(path.relative_to(studio).as_posix().encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()
