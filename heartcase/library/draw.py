"""The drawn part of a recipe whose scan is synthetic: markers, ends, edits and landmarks, below what people write."""

from __future__ import annotations

from pathlib import Path

from heartcase.phantom.drawing.recipe import drawn_part
from heartcase.schemas.errors import RecipeError
from heartcase.schemas.files import atomic_write
from heartcase.schemas.recipe.recipe import parse_recipe, read_recipe_text

__all__ = ["DRAWN_BELOW", "draw_recipe"]

DRAWN_BELOW = "# Below this line everything is drawn by:  heartcase library draw"
"""The line of a recipe where what people write ends."""


def draw_recipe(path: Path, *, write: bool = True) -> bool:
    """Draw the markers of a recipe anew, from the heart that its ``[scan.phantom]`` describes.

    Parameters
    ----------
    path
        The recipe; what stands above :data:`DRAWN_BELOW` stays as it is.
    write
        Write it; otherwise only look whether it would change.

    Returns
    -------
    bool
        Whether it changes.

    Raises
    ------
    RecipeError
        It cannot be read, its scan is not synthetic, or it has already what would be drawn, but not below the line.
    UsageError
        The heart has no place for a defect or an incision.
    """
    text = read_recipe_text(path)
    written, line, _ = text.partition(DRAWN_BELOW)
    recipe = parse_recipe(written, needs_markers=False)
    if recipe.scan.phantom is None:
        raise RecipeError(
            "its scan is not a synthetic one, so nothing is known to draw: paint with  heartcase paint  instead",
            place="scan.phantom",
        )
    whole = f"{written.rstrip()}\n\n{DRAWN_BELOW}\n\n{drawn_part(recipe.scan.phantom)}"
    if whole == text:
        return False
    try:
        parse_recipe(whole)
    except RecipeError as error:
        if line:
            raise
        message = (
            "it has labels, strokes or landmarks of its own, which what is drawn would repeat: delete those to "
            f"be drawn, or put this line above them:  {DRAWN_BELOW}"
        )
        raise RecipeError(message, place="recipe") from error
    if write:
        atomic_write(path, whole.encode())
    return True
