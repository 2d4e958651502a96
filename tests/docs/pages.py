"""Takes the examples out of a documentation page and runs them.

Fenced blocks that are run::

    ```python              executed; all blocks of a page share their names
    ```console             "$ heartcase ..." is run, what follows must be its output; "..." stands for anything
    ```console fails       the same, of a command that must end with 1 or 2
    ```toml file=NAME      written to NAME
    ```markdown file=NAME  written to NAME; with more backticks where it holds blocks of its own
    ```toml recipe         a part of a recipe: must fit in one

All others (text, bash, json, a plain fence) are only read.
"""

from __future__ import annotations

import re
import shlex
import tomllib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from heartcase.schemas.recipe.recipe import Recipe

ROOT = Path(__file__).parents[2]
PAGES = sorted([*ROOT.glob("*.md"), *(ROOT / "docs").glob("*.md")])
_FENCE = re.compile(r"^(```+)([^\n`]*)\n(.*?)^\1$", re.M | re.S)
_SMALLEST: dict[str, Any] = {
    "heartcase_recipe": 1,
    "name": "fragment",
    "scan": {"path": "scan.nii.gz"},
    "strokes": [{"label": "background", "points_mm": [[0.0, 0.0, 0.0]]}],
}


@dataclass(frozen=True)
class Example:
    """One fenced block."""

    kind: str
    content: str
    line: int


def examples_of(page: Path) -> list[Example]:
    """All fenced blocks of a page, in order."""
    text = page.read_text(encoding="utf-8")
    return [
        Example(match.group(2).strip(), match.group(3), text[: match.start()].count("\n") + 1)
        for match in _FENCE.finditer(text)
    ]


def is_run(example: Example) -> bool:
    """Whether the block is one that is run."""
    return example.kind.split(" ")[0] in ("python", "console") or example.kind.startswith(
        ("toml file=", "markdown file=", "toml recipe")
    )


def run_page(page: Path, run: Callable[[list[str]], tuple[int, str]], *, kinds: Sequence[str] = ()) -> None:
    """Run the examples of a page in the present directory; ``run`` runs a command and gives exit code and output.

    Only those of some ``kinds``, where they are named.
    """
    names: dict[str, Any] = {"__name__": "__main__"}
    for example in examples_of(page):
        if kinds and example.kind not in kinds:
            continue
        where = f"{page.name}:{example.line}"
        if example.kind == "python":
            exec(compile(example.content, where, "exec"), names)
        elif example.kind in ("console", "console fails"):
            for command, expected in _sessions(example.content):
                code, said = run(command)
                assert (code in (1, 2)) if example.kind == "console fails" else (code == 0), f"{where}: {code}\n{said}"
                assert _fits(expected, said), f"{where}: {command} said\n{said}\nand not\n{expected}"
        elif example.kind.startswith(("toml file=", "markdown file=")):
            Path(example.kind.partition("=")[2]).write_text(example.content, encoding="utf-8")
        elif example.kind == "toml recipe":
            Recipe.model_validate(_SMALLEST | tomllib.loads(example.content))


def _sessions(content: str) -> list[tuple[list[str], str]]:
    found = []
    for part in re.split(r"^\$ ", content, flags=re.M)[1:]:
        command, _, expected = part.partition("\n")
        program, *arguments = shlex.split(command, comments=True)
        assert program == "heartcase", command
        found.append((arguments, expected.strip("\n")))
    return found


def _fits(expected: str, said: str) -> bool:
    """Whether the lines are there, in order; ``...`` stands for anything, a line of it for any lines."""
    if not expected:
        return True
    pattern = ".*?".join(re.escape(piece) for piece in expected.split("..."))
    return re.search(pattern, said, re.S) is not None
