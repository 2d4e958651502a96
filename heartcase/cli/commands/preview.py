"""``heartcase preview``: make a picture of a scan or a case."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from heartcase.cli.commands.info import kind_of
from heartcase.cli.shared.output import echo_json, file_size, working
from heartcase.cli.shared.output_path import OutputPath
from heartcase.cli.shared.stage_io import scan_options
from heartcase.schemas.bundle.format import LEVEL_MAX, FileRole
from heartcase.schemas.bundle.reader import read_manifest
from heartcase.schemas.errors import UsageError
from heartcase.schemas.files import atomic_write

if TYPE_CHECKING:
    from heartcase.pipeline.report.pictures import View
    from heartcase.schemas.arrays import UInt8

__all__ = ["command"]

_SIDES: tuple[View, ...] = ("anterior", "posterior", "left", "right")
_VIEWS = ("anterior", "posterior", "left", "right", "superior", "inferior", "surgeon", "cutaway")
_STACKS = ("axial", "coronal", "sagittal")


@click.command()
@click.argument("path", type=click.Path(path_type=Path, readable=False))
@click.option(
    "-o",
    "--out",
    "--output",
    "output",
    type=OutputPath(),
    required=True,
    help="The picture to write (.png).",
)
@click.option(
    "--view",
    type=click.Choice((*_VIEWS, *_STACKS)),
    help="One picture instead of all: a side or the cutaway of a case, a stack of slices of a scan.",
)
@click.option(
    "--level",
    type=click.IntRange(0, LEVEL_MAX),
    default=0,
    help="Level of detail of a case's surface; 0 is the finest.",
)
@scan_options
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object about the picture.")
@working("drawing")
def command(path: Path, output: Path, view: str | None, level: int, as_json: bool, choice: dict[str, Any]) -> None:
    """Make a picture of PATH: slices of a scan, or the surface of a case from four sides and cut open."""
    if output.suffix.lower() != ".png":
        raise UsageError("the picture must end in .png", place="--out")
    kind = kind_of(path)
    if kind == "recording":
        raise UsageError("a recording is shown in motion: take 'heartcase export CASE --recording'", place="PATH")
    if view is not None and (view in _STACKS) == (kind == "case"):
        choices = ", ".join(_VIEWS if kind == "case" else _STACKS)
        raise UsageError(f"{view!r} is no view of a {kind}: choose {choices}", place="--view")
    if level and kind != "case":
        raise UsageError(f"a {kind} has no levels of detail: leave it out", place="--level")
    case_id = read_manifest(path).case_id if kind == "case" else None
    picture = _case_picture(path, view, level) if kind == "case" else _scan_picture(path, kind, view, choice)
    from heartcase.pipeline.report.montage import png_bytes

    content = png_bytes(picture, comment=f"heartcase {case_id}" if case_id else "")
    try:
        atomic_write(output, content)
    except OSError as error:
        raise UsageError(f"cannot be written: {error.strerror}", place="--out") from None
    height, width = picture.shape[:2]
    if as_json:
        shown = [view] if view else list((*_SIDES, "cutaway", "front cut") if kind == "case" else _STACKS)
        echo_json({"kind": kind, "views": shown, "width": width, "height": height, "bytes": len(content)})
    else:
        click.echo(f"wrote {output}: a picture of {width} x {height} pixels, {file_size(len(content))}")


def _scan_picture(path: Path, kind: str, view: str | None, choice: dict[str, Any]) -> UInt8:
    from heartcase.pipeline.formats.read_scan import read_scan
    from heartcase.pipeline.report.montage import stacked
    from heartcase.pipeline.report.slices import STACKS, slice_pictures

    if kind == "recipe":
        from heartcase.schemas.recipe.recipe import load_recipe

        recipe = load_recipe(path)
        path, choice = path.parent / recipe.scan.path, recipe.scan.choice | choice
        if not path.exists():
            origin = f" Where it comes from: {recipe.scan.origin}" if recipe.scan.origin else ""
            raise UsageError(f"the recipe's scan is not there.{origin}", place="scan.path")
    scan = read_scan(path, **choice)
    stacks = tuple(stack for stack in STACKS if view in (None, stack))
    rows = slice_pictures(scan.values, scan.geometry, None, None, modality=scan.modality, stacks=stacks)
    return stacked(list(rows.values()))


def _case_picture(path: Path, view: str | None, level: int) -> UInt8:
    from heartcase.pipeline.report.montage import label_colours, legend_picture, montage, stacked
    from heartcase.pipeline.report.pictures import VIEWS, coronal_plane, cutaway_picture, surface_picture
    from heartcase.schemas.bundle.reader import open_bundle

    case = open_bundle(path)
    table = case.manifest.labels
    names = ("vertices", "triangles", "normals", "triangle_label", "triangle_tissue")
    arrays = case.arrays(case.surface_role(level, place="--level") if level else FileRole.SURFACE, names)
    mesh: dict[str, Any] = {
        "vertices_mm": arrays["vertices"],
        "triangles": arrays["triangles"],
        "triangle_label": arrays["triangle_label"],
        "triangle_tissue": arrays["triangle_tissue"],
        "normals": arrays["normals"],
        "table": table,
    }
    sides = [side for side in (tuple(VIEWS) if view else _SIDES) if view in (None, side)]
    pictures: dict[str, UInt8] = {side: surface_picture(**mesh, view=side) for side in sides}
    if view in (None, "cutaway"):
        pictures["cut through the chambers"] = cutaway_picture(**mesh)
    if view is None:
        plane = coronal_plane(mesh["vertices_mm"], mesh["triangles"])
        pictures["cut from the front"] = cutaway_picture(**mesh, plane=plane)
    sheet = montage(pictures, columns=2 if view is None else 1)
    present = {int(value) for name in names[3:] for value in set(arrays[name].tolist())} - {0}
    return stacked([sheet, legend_picture(label_colours(table, present), width=sheet.shape[1])])
