"""The drawn part of a recipe whose scan is synthetic: markers, ends, edits and landmarks, below what people write."""

from __future__ import annotations

import hashlib
import re
from collections import Counter
from pathlib import Path

from heartcase.phantom.drawing.recipe import drawn_part
from heartcase.schemas.errors import RecipeError
from heartcase.schemas.files import atomic_write
from heartcase.schemas.recipe.recipe import parse_recipe, read_recipe_text

__all__ = ["DRAWN_BELOW", "draw_recipe"]

DRAWN_BELOW = "# Below this line everything is drawn by:  heartcase library draw"
"""The line of a recipe where what people write ends."""
_CHECKSUM = "# (write above it, not here; checksum of what was drawn: {})"
_CHECKSUM_LINE = re.compile(re.escape(_CHECKSUM).replace(r"\{\}", "([0-9a-f]{16})"))
_LINES_NAMED_MAX = 8


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
        It cannot be read, its scan is not synthetic, it has already what would be drawn, but not below the line, or
        somebody wrote below the line: nothing is written then.
    UsageError
        The heart has no place for a defect or an incision.
    """
    text = read_recipe_text(path)
    written, line, below = text.partition(DRAWN_BELOW)
    recipe = parse_recipe(written, needs_markers=False)
    if recipe.scan.phantom is None:
        raise RecipeError(
            "its scan is not a synthetic one, so nothing is known to draw: paint with  heartcase paint  instead",
            place="scan.phantom",
        )
    drawn = drawn_part(recipe.scan.phantom)
    whole = f"{written.rstrip()}\n\n{DRAWN_BELOW}\n{_CHECKSUM.format(_checksum(drawn))}\n\n{drawn}"
    if whole == text:
        return False
    if line:
        _refuse_lines_of_people(below, drawn, first_line=written.count("\n") + 1)
    try:
        parse_recipe(whole)
    except RecipeError as error:
        if line:
            raise
        message = (
            "it has labels, strokes or landmarks of its own, which what is drawn would repeat: delete those; what is "
            f"drawn comes below a line  {DRAWN_BELOW}"
        )
        raise RecipeError(message, place="recipe") from error
    if write:
        atomic_write(path, whole.encode())
    return True


def _refuse_lines_of_people(below: str, drawn: str, *, first_line: int) -> None:
    """RecipeError where what stands below the line is not what was drawn there, and so would be lost.

    What was drawn tells by its checksum. An older heartcase wrote none: then a line that is not drawn now either may
    be a person's.
    """
    lines = below.split("\n")
    sealed = [
        (number, found[1]) for number, one in enumerate(lines) if (found := _CHECKSUM_LINE.fullmatch(one.rstrip()))
    ]
    there = lines
    if sealed:
        there = ["" if number == sealed[0][0] else one for number, one in enumerate(lines)]
        if len(sealed) == 1 and _checksum("\n".join(there)) == sealed[0][1]:
            return
    expected = Counter(one.rstrip() for one in drawn.split("\n"))
    strange = []
    for number, one in enumerate(there, start=first_line):
        if not one.strip():
            continue
        if expected[one.rstrip()] > 0:
            expected[one.rstrip()] -= 1
        else:
            strange.append(number)
    if not strange:
        # Lines were only taken out: nothing is lost when they come back.
        return
    where = _spans(strange)
    if sealed:
        among = "" if sealed[0][1] == _checksum(drawn) else "it is among "
        message = (
            f"somebody wrote below the line of what is drawn, and drawing would delete it ({among}{where}): move what "
            "is yours above that line, and delete the rest below it"
        )
    else:
        message = (
            f"drawing would delete {where}, and this part has no checksum that says whether they were drawn by an "
            "older heartcase or written by somebody: move what is yours above the line, and delete the rest below it"
        )
    raise RecipeError(f"{message}; then draw again. Nothing was written", place="recipe")


def _checksum(text: str) -> str:
    """Of the lines' text alone: blank lines around, and how lines end, do not count."""
    lines = "\n".join(line.rstrip() for line in text.strip().split("\n"))
    return hashlib.sha256(lines.encode()).hexdigest()[:16]


def _spans(numbers: list[int]) -> str:
    """Line numbers in words: ``lines 3, 7-9``."""
    spans: list[list[int]] = []
    for number in numbers:
        if spans and number == spans[-1][1] + 1:
            spans[-1][1] = number
        else:
            spans.append([number, number])
    shown = [f"{a}" if a == b else f"{a}-{b}" for a, b in spans[:_LINES_NAMED_MAX]]
    more = f" and {len(spans) - _LINES_NAMED_MAX} places more" if len(spans) > _LINES_NAMED_MAX else ""
    return f"line{'s' * (len(numbers) > 1)} {', '.join(shown)}{more}"
