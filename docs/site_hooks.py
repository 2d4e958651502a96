"""Hooks of the site (``mkdocs.yml``): pages from outside ``docs/``, and names of pages as links to them.

Texts name each other as ``docs/physics.md``, as a reader of the repository finds them. On the site that is a link.
"""

from __future__ import annotations

import posixpath
import re
from pathlib import Path
from typing import Any

from mkdocs.structure.files import File, Files

ROOT = Path(__file__).parents[1]
OUTSIDE = {
    "CONTRIBUTING.md": "contributing.md",
    "CHANGELOG.md": "changelog.md",
    "SECURITY.md": "security.md",
    "readers/README.md": "readers.md",
}
"""Path in the repository -> page of the site."""

_FENCED = re.compile(r"(^```.*?^```$)", re.M | re.S)
_INFO = re.compile(r"\A(```\w*)[^\n]*")
_NAMED = re.compile(r"(?<!\[)`((?:[\w-]+/)*[\w-]+\.md)`(?!\])")
_LINKED = re.compile(r"\]\(((?:\.\./)+[\w./-]+\.md)\)")


def on_files(files: Files, config: Any) -> Files:
    """Add the pages that lie outside ``docs/``."""
    for path, page in OUTSIDE.items():
        files.append(File.generated(config, page, content=(ROOT / path).read_text(encoding="utf-8")))
    return files


def on_page_markdown(markdown: str, page: Any, files: Files, **_: Any) -> str:
    """Make links of the pages that a text names; of a fence keep the language alone: Python-Markdown takes no more."""
    here = page.file.src_uri
    pieces = _FENCED.split(markdown)
    pieces[::2] = [_with_links(piece, here, files) for piece in pieces[::2]]
    pieces[1::2] = [_INFO.sub(r"\1", piece) for piece in pieces[1::2]]
    return "".join(pieces)


def _with_links(text: str, here: str, files: Files) -> str:
    def named(match: re.Match[str]) -> str:
        target = OUTSIDE.get(match[1], match[1].removeprefix("docs/"))
        is_page = (match[1] in OUTSIDE or match[1].startswith("docs/")) and files.get_file_from_path(target) is not None
        return f"[{match[0]}]({_relative(target, here)})" if is_page else match[0]

    def linked(match: re.Match[str]) -> str:
        path = posixpath.normpath(posixpath.join("docs", posixpath.dirname(here), match[1]))
        return f"]({_relative(OUTSIDE[path], here)})" if path in OUTSIDE else match[0]

    return _LINKED.sub(linked, _NAMED.sub(named, text))


def _relative(target: str, here: str) -> str:
    return posixpath.relpath(target, posixpath.dirname(here) or ".")
