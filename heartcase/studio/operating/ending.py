"""What pages are told when a session ends, and of errors: never where on this machine the case lies."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from heartcase.studio.message_words import problem_facts
from heartcase.studio.messages import told
from heartcase.studio.operating.stage import Stage

__all__ = ["ended", "problems_at"]

_KEPT = "what was done is kept in the recording {name}"
_LOST = "what was done is not kept: {why}"


def ended(stage: Stage, problems: Callable[[BaseException], list[dict[str, Any]]]) -> str | None:
    """End a stage's session; what is to be read of what was done in it, None where nothing is to be kept.

    Parameters
    ----------
    stage
        The stage; it is of no more use.
    problems
        What a page is told of an error.
    """
    try:
        name = stage.end()
    except Exception as error:
        return _LOST.format(why=problems(error)[0]["message"])
    return None if name is None else _KEPT.format(name=name.removesuffix(".recording"))


def problems_at(case: Path, error: BaseException) -> list[dict[str, Any]]:
    """What a page is told of an error; not where on this machine the case lies.

    Parameters
    ----------
    case
        The case's folder.
    error
        The error.
    """
    folders = {str(folder) for one in (case, case.resolve()) for folder in (one, one.parent)}

    def without(text: str) -> str:
        for folder in sorted(folders - {".", "/"}, key=len, reverse=True):
            text = text.replace(folder, "case")
        return text

    return [problem_facts(without(one.place), without(one.message)) for one in told(error).problems]
