"""The sample cases: recipes that make their own scan, opened as a copy that may be changed."""

from __future__ import annotations

import functools
import re
from pathlib import Path
from typing import Any

from heartcase.schemas.errors import HeartcaseError, UsageError
from heartcase.schemas.files import atomic_write
from heartcase.schemas.recipe.recipe import parse_recipe, read_recipe_text
from heartcase.schemas.toml import toml_string
from heartcase.studio.sample_folder import sample_folder

__all__ = ["copy_sample", "shown_samples"]

_SCAN_PATH = re.compile(r"^\[scan\]\n(?:(?!\[).*\n)*?path = .*$", re.MULTILINE)


@functools.cache
def shown_samples() -> tuple[dict[str, Any], ...]:
    """The sample cases for the page: name, titles by language, and whether their scan can be made here."""
    folder = sample_folder()
    found = []
    for path in sorted(folder.glob("*.toml")) if folder else ():
        text = path.read_text(encoding="utf-8")
        if "heartcase_recipe" not in text:
            continue
        try:
            recipe = parse_recipe(text)
        except HeartcaseError:
            continue
        texts = {} if recipe.about is None else recipe.about.texts
        found.append(
            {
                "name": path.stem,
                "titles": {language: one.title for language, one in texts.items()} or {"en": recipe.name},
                # the others are made from a scan that is not part of heartcase
                "can_be_opened": recipe.scan.phantom is not None,
            }
        )
    return tuple(found)


def copy_sample(name: str, folder: Path) -> Path:
    """Copy a sample case's recipe into a folder of its own, or find the copy that is there; the copy's path.

    Parameters
    ----------
    name
        As :func:`shown_samples` names it.
    folder
        Where the copy's folder goes.

    Raises
    ------
    UsageError
        There is no such sample case, its scan is not part of heartcase, or the copy cannot be written.
    """
    samples = sample_folder()
    sample = next((one for one in shown_samples() if one["name"] == name), None)
    if samples is None or sample is None:
        raise UsageError("there is no sample case of this name: load the page again", place="sample")
    if not sample["can_be_opened"]:
        raise UsageError(
            "its scan is not part of heartcase: the catalogue says where it is from; open its recipe once it is there",
            place="sample",
        )
    copy = folder / name / f"{name}.toml"
    if copy.exists():
        # what was painted in it goes on
        return copy
    text = read_recipe_text(samples / f"{name}.toml")
    found = _SCAN_PATH.search(text)
    assert found is not None
    head = found[0].rpartition("path = ")[0]
    text = f"{text[: found.start()]}{head}path = {toml_string('scan.nii.gz')}{text[found.end() :]}"
    parse_recipe(text)
    try:
        copy.parent.mkdir(parents=True, exist_ok=True)
        atomic_write(copy, text.encode())
    except OSError as error:
        reason = (error.strerror or "the system gives no reason").lower()
        raise UsageError(f"the copy cannot be written: {reason}", place="sample") from None
    return copy
