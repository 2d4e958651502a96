"""In which folder a recipe's case is built, with what was done to the recipe: the same one whoever opens it."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from heartcase.pipeline.building.recipe_history import history_file
from heartcase.studio.starting.recent import Recent

__all__ = ["building_folder", "left_elsewhere"]


def building_folder(recipe: Path, recent: Recent) -> Path:
    """Where a recipe is built when nobody says: where it was when last open; else, or if that is gone, beside it."""
    remembered = recent.out_of(recipe)
    # the folder itself is made when something is written into it
    return remembered if remembered is not None and remembered.parent.is_dir() else recipe.parent


def left_elsewhere(recipe: Path, name: str, out: Path, others: Iterable[Path]) -> str | None:
    """What is said of a folder that has a recipe's history or case, where the one that it is opened in has none.

    Parameters
    ----------
    recipe, name
        The recipe's file, and its name.
    out
        The folder that it is opened in.
    others
        Folders that it may have been built in, the likeliest first.

    Returns
    -------
    str or None
        None where there is nothing to say.
    """
    if _holds_history(recipe, out) or _holds_case(name, out):
        return None
    for other in others:
        if other.resolve() == out.resolve():
            continue
        if _holds_history(recipe, other):
            return f'what was done to this recipe is remembered in another folder; to take it back: --out "{other}"'
        if _holds_case(name, other):
            return f'a case of this name lies in another folder; to go on with it: --out "{other}"'
    return None


def _holds_history(recipe: Path, out: Path) -> bool:
    return history_file(recipe, out=out).is_file()


def _holds_case(name: str, out: Path) -> bool:
    return (out / f"{name}.case" / "case.json").is_file()
