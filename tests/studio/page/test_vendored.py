"""What the page carries of others is what was pinned, with its licence, and the first page stays small."""

import gzip
import json
import re

from heartcase.studio.serving.app import PAGE
from tests.studio.page.vendoring import PACKAGES, TABLE, VENDOR, sha256

FIRST_PAGE_MOST = 700_000
"""Compressed, bytes."""
OWN = {"three.module.min.d.ts"}
"""Files there that are the project's own."""


def test_every_file_is_the_pinned_one_and_no_other_is_there():
    table = json.loads(TABLE.read_text())
    assert set(table) == set(PACKAGES)
    listed = {}
    for name, package in PACKAGES.items():
        assert {key: table[name][key] for key in ("version", "integrity", "licence")} == {
            key: package[key] for key in ("version", "integrity", "licence")
        }
        assert f"{name}/LICENSE" in table[name]["sha256"]
        listed |= table[name]["sha256"]
    there = {file.relative_to(VENDOR).as_posix(): file for file in VENDOR.rglob("*") if file.is_file()}
    there = {name: file for name, file in there.items() if file != TABLE and file.name not in OWN}
    assert {name: sha256(file) for name, file in there.items()} == listed


def closure(files):
    """Modules that modules import, with themselves."""
    found, waiting = set(), list(files)
    while waiting:
        file = waiting.pop().resolve()
        if file not in found:
            found.add(file)
            text = file.read_text(encoding="utf-8")
            named = re.findall(r'(?:^(?:import|export) .*|[}*]\s*)from\s*"(\.[^"]+)"', text, re.MULTILINE)
            waiting += [file.parent / one for one in named]
    return found


def test_the_page_that_operates_is_small():
    files = closure([PAGE / "operating" / "main.js"])
    assert {"three.module.min.js", "three.core.min.js", "en.js"} <= {file.name for file in files}
    files |= {PAGE / "operating" / "operate.html", PAGE / "operating" / "operate.css", PAGE / "style.css"}
    assert sum(len(gzip.compress(file.read_bytes(), 6)) for file in files) < FIRST_PAGE_MOST
