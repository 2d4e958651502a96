"""``heartcase upgrade``: what a newer heartcase would change in a recipe, a script or a case."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click

from heartcase import __version__
from heartcase.cli.shared.output import echo_json, working
from heartcase.schemas.bundle.format import FORMAT_VERSION, VERSION_WITHOUT_SEPTA
from heartcase.schemas.bundle.manifest import nothing_there
from heartcase.schemas.bundle.placing import refuse_inside_case
from heartcase.schemas.bundle.reader import read_manifest
from heartcase.schemas.errors import MissingPathError, UsageError
from heartcase.schemas.files import atomic_write
from heartcase.schemas.migrate import RECIPE, SCRIPT, bundle_changes
from heartcase.schemas.recipe.recipe import Recipe, load_recipe
from heartcase.schemas.toml import toml_text

__all__ = ["Preview", "command", "preview"]


@dataclass(frozen=True)
class Preview:
    """What would change in a file."""

    kind: str
    """``recipe``, ``simulation script`` or ``case``."""
    changes: tuple[str, ...]
    """What would change, a line each."""
    notes: tuple[str, ...] = ()
    """What else must be known."""
    text: str | None = None
    """The file as it would be; None where it is not rewritten."""
    remedy: str = ""
    """Why it is not rewritten, and what to do instead."""


@click.command()
@click.argument("path", type=click.Path(path_type=Path, readable=False))
@click.option("--write", is_flag=True, help="Make the changes; the old file is kept as NAME.bak beside it.")
@click.option("--json", "as_json", is_flag=True, help="Print the result as JSON.")
@working("comparing")
def command(path: Path, write: bool, as_json: bool) -> None:
    """Say what this heartcase would change in PATH, a recipe or a simulation script (.toml) or a case.

    Of a locked recipe, that is each setting whose default is another one today, and each stage whose version differs.
    Nothing is changed without --write.
    """
    if write and path.is_file():
        refuse_inside_case(path, place="PATH")
    found = preview(path)
    backup = _write(path, found) if write else None
    if as_json:
        echo_json(
            {
                "kind": found.kind,
                "changes": list(found.changes),
                "notes": list(found.notes),
                "written": backup is not None,
                "backup": str(backup) if backup else None,
            }
        )
        return
    for line in found.changes:
        click.echo(line)
    if not found.changes:
        click.echo(f"nothing to upgrade: the {found.kind} is as heartcase {__version__} would have it")
    for note in found.notes:
        click.echo(f"note: {note}")
    if backup is not None:
        click.echo(f"wrote {path}; the old file is {backup}")
    elif found.changes:
        click.echo(found.remedy or "nothing was changed: --write does it, and keeps the old file")


def preview(path: Path) -> Preview:
    """Find out what this heartcase would change in a file.

    Raises
    ------
    HeartcaseError
        It is no recipe, script or case, or of a version that is not known.
    """
    if not path.exists():
        raise MissingPathError(nothing_there(path), place="PATH")
    if path.is_dir():
        return _of_case(path)
    if path.suffix.lower() != ".toml":
        raise UsageError("must be a recipe or a script (.toml), or a case", place="PATH")
    data = _toml(path)
    return _of_recipe(path, data) if RECIPE.key in data else _of_script(path, data)


def _toml(path: Path) -> dict[str, Any]:
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError):
        raise UsageError("this is no TOML file: heartcase validate says where it goes wrong", place="PATH") from None


def _of_script(path: Path, data: dict[str, Any]) -> Preview:
    from heartcase.simulator.session.script import load_script

    migrated, words = SCRIPT.migrated(data)
    load_script(path)
    return Preview(SCRIPT.name, words, text=toml_text(migrated) if words else None)


def _of_recipe(path: Path, data: dict[str, Any]) -> Preview:
    migrated, words = RECIPE.migrated(data)
    recipe = load_recipe(path)
    if recipe.lock is not None:
        return _of_locked(path, recipe, words)
    notes = (
        "the recipe is not locked: what it leaves out takes the defaults of the heartcase that builds it; "
        "heartcase lock writes them down",
    )
    return Preview(RECIPE.name, words, notes, text=toml_text(migrated) if words else None)


def _of_locked(path: Path, recipe: Recipe, words: tuple[str, ...]) -> Preview:
    from heartcase.pipeline.building.lock import (
        lock_recipe,
        recipe_text,
        setting_changes,
        stage_changes,
        unlocked_recipe,
    )

    assert recipe.lock is not None
    today = unlocked_recipe(recipe)
    notes: tuple[str, ...] = ()
    text, remedy = None, ""
    missing = today.missing_files(path.parent)
    if missing:
        remedy = "nothing was changed: put the files that it names back, then --write locks it anew"
        notes = ("the scan or a marker file is not there: settings that are worked out from them were not compared",)
    else:
        today = lock_recipe(today, directory=path.parent, out=path.parent)
        text = recipe_text(today)
        if today.lock is None or today.lock.inputs != recipe.lock.inputs:
            text, remedy = None, "nothing was changed: heartcase lock --force locks the recipe to what is there now"
            notes = ("the scan or a marker file is not the one that the recipe was locked with",)
    changes = [*words, *(str(change) for change in setting_changes(recipe, today))]
    changes += _stage_lines(stage_changes(recipe.lock.stages), "the lock")
    return Preview(RECIPE.name, tuple(changes), notes, text if changes else None, remedy)


def _of_case(path: Path) -> Preview:
    from heartcase.pipeline.building.lock import stage_changes

    manifest = read_manifest(path)
    changes = [
        f"format {version} adds: {sentence}"
        for version, sentence in bundle_changes(manifest.format_version, FORMAT_VERSION)
        # a case without septa is written as the version before them today as well
        if manifest.format_version != VERSION_WITHOUT_SEPTA
    ]
    changes += _stage_lines(stage_changes({record.stage: record.version for record in manifest.stages}), "the case")
    notes: tuple[str, ...] = ()
    if manifest.software_version != __version__:
        notes = (f"the case was built by heartcase {manifest.software_version}; this is heartcase {__version__}",)
    remedy = "a case is not rewritten: build it again from its recipe"
    return Preview("case", tuple(changes), notes, remedy=remedy)


def _stage_lines(changes: dict[str, tuple[int, int | None]], where: str) -> list[str]:
    return [
        f"stage {stage}: version {old} in {where}, {'gone' if new is None else f'version {new}'} today; "
        "its output may differ"
        for stage, (old, new) in changes.items()
    ]


def _write(path: Path, found: Preview) -> Path | None:
    """Put the new text in the file's place; returns where the old one is, None where there is nothing to change."""
    if not found.changes:
        return None
    if found.text is None:
        raise UsageError(found.remedy, place="--write")
    backup = path.with_name(f"{path.name}.bak")
    number = 2
    while backup.exists():
        backup = path.with_name(f"{path.name}.bak{number}")
        number += 1
    try:
        atomic_write(backup, path.read_bytes())
        atomic_write(path, found.text.encode())
    except OSError as error:
        raise UsageError(f"cannot be written: {error.strerror}", place="PATH") from None
    return backup
