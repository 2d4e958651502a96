"""The page's modules as one script: a browser loads no module from another file where a page was opened from a folder.

The script makes a blob of each module, those that it imports first, and imports the one that begins.
"""

from __future__ import annotations

import json
import re
from pathlib import Path

from heartcase.schemas.errors import UsageError

__all__ = ["bundled_script", "for_script_element", "modules_from"]

_IMPORT = re.compile(
    r"""(?P<before>\b(?:from|import)\s*)(?P<quote>["'])(?P<target>\.{1,2}/[^"'\n]+)(?P=quote)(?=\s*(?:;|$|import|export))""",
    re.MULTILINE,
)
"""A static import or export of another module of the page. JSDoc's ``import("...")`` has a bracket, and is none."""
_MARK = "\N{SYMBOL FOR ESCAPE}{}\N{SYMBOL FOR ESCAPE}"
_LOADER = """\
"use strict";
(() => {
  const modules = MODULES;
  const urls = [];
  for (const text of modules) {
    const whole = text.replace(/\\u241B(\\d+)\\u241B/g, (_, number) => urls[Number(number)]);
    urls.push(URL.createObjectURL(new Blob([whole], { type: "text/javascript" })));
  }
  import(urls.at(-1));
})();
"""


def modules_from(folder: Path, first: str) -> dict[str, str]:
    """The modules that one needs, each after those that it imports, itself last.

    Parameters
    ----------
    folder
        The page's files.
    first
        The module that begins, from ``folder`` on.

    Returns
    -------
    dict
        Name from ``folder`` on -> source, with each import as the number of the module in this order, between marks.

    Raises
    ------
    UsageError
        A module imports one that is not there, or itself by way of others.
    """
    done: dict[str, str] = {}
    numbers: dict[str, int] = {}
    root = folder.resolve()

    def take(name: str, asking: tuple[str, ...]) -> int:
        if name in numbers:
            return numbers[name]
        if name in asking:
            raise UsageError(f"{' imports '.join((*asking, name))}: modules of a page may not go round", place="page")
        path = (root / name).resolve()
        if not path.is_file() or not path.is_relative_to(root):
            raise UsageError(f"{asking[-1] if asking else name} imports {name}, which is not there", place="page")
        here = (*asking, name)

        def number(found: re.Match[str]) -> str:
            target = (path.parent / found["target"]).resolve()
            other = target.relative_to(root) if target.is_relative_to(root) else target
            mark = _MARK.format(take(other.as_posix(), here))
            return f"{found['before']}{found['quote']}{mark}{found['quote']}"

        text = _IMPORT.sub(number, path.read_text(encoding="utf-8"))
        numbers[name] = len(numbers)
        done[name] = text
        return numbers[name]

    take(first, ())
    return done


def bundled_script(folder: Path, first: str) -> str:
    """One classic script that runs a module with all that it imports; for a ``<script>`` element."""
    sources = list(modules_from(folder, first).values())
    return _LOADER.replace("MODULES", for_script_element(json.dumps(sources, ensure_ascii=False)))


def for_script_element(text: str) -> str:
    """JSON that may stand in a ``<script>`` element: nothing in it ends the element or begins a comment."""
    escaped = text.replace("<", "\\u003c")
    return escaped.replace("\N{LINE SEPARATOR}", "\\u2028").replace("\N{PARAGRAPH SEPARATOR}", "\\u2029")
