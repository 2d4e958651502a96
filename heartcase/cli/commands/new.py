"""``heartcase new``: a commented starter recipe for a scan."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from heartcase.cli.shared.output import working
from heartcase.cli.shared.output_path import OutputPath
from heartcase.cli.shared.stage_io import scan_options

__all__ = ["command"]


@click.command()
@click.argument("scan", type=click.Path(path_type=Path, readable=False))
@click.option("--out", type=OutputPath(), default=Path("case.toml"), help="The recipe; case.toml.")
@click.option("--name", help="Name of the case: not the patient's. Made up when left out.")
@scan_options
@click.option("--force", is_flag=True, help="Replace a recipe that is there.")
@working("reading the scan")
def command(scan: Path, out: Path, name: str | None, force: bool, choice: dict[str, Any]) -> None:
    """Read SCAN and write a commented recipe for it, ready for the markers."""
    from heartcase.pipeline.building.starter_recipe import write_recipe

    for warning in write_recipe(scan, out, name=name, choice=choice, force=force):
        click.echo(f"note: {warning}", err=True)
    click.echo(
        f"wrote {out}: put your markers in the place of its two example strokes, then run  heartcase build {out}"
    )
