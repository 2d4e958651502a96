"""``heartcase schema``: the JSON Schemas of recipe, label table, landmark, manifest, script and recording."""

from __future__ import annotations

from pathlib import Path

import click

from heartcase.cli.shared.output_path import OutputPath
from heartcase.schemas.errors import UsageError
from heartcase.schemas.files import atomic_write
from heartcase.schemas.published.json_schemas import schema_files

__all__ = ["command"]


@click.command()
@click.argument("name", required=False)
@click.option("--out", type=OutputPath(is_folder=True), help="Write all of them into this directory.")
def command(name: str | None, out: Path | None) -> None:
    """Print the JSON Schema NAME, list the names, or write all into a directory."""
    files = schema_files()
    if out is not None:
        out.mkdir(parents=True, exist_ok=True)
        for file_name, text in files.items():
            atomic_write(out / file_name, text.encode())
        return
    if name is None:
        for file_name in files:
            click.echo(file_name.split(".")[0])
        return
    found = next((text for file_name, text in files.items() if file_name.split(".")[0] == name), None)
    if found is None:
        raise UsageError(f"there is no schema {name!r}; run 'heartcase schema' for the list", place="NAME")
    click.echo(found, nl=False)
