"""``heartcase bundle``: write a case from the outputs of the stages."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from heartcase.cli.output import working
from heartcase.cli.stage_io import load_outputs, optional_recipe, read_scan_or_output, scan_options
from heartcase.schemas.errors import UsageError

__all__ = ["command"]


@click.command()
@click.argument("grid", type=click.Path(path_type=Path, readable=False))
@click.argument("output", type=click.Path(path_type=Path, readable=False))
@click.option(
    "--scan",
    type=click.Path(path_type=Path, readable=False),
    required=True,
    help="The scan that the case was made from.",
)
@click.option("--surface", type=click.Path(path_type=Path, readable=False), help="Output of 'heartcase surface'.")
@click.option("--map", "grid_map", type=click.Path(path_type=Path, readable=False), help="Output of 'heartcase map'.")
@click.option(
    "--structures",
    type=click.Path(path_type=Path, readable=False),
    help="Output of 'walls' or 'edit': adds the labels and the rims of defects.",
)
@click.option(
    "--recipe", type=click.Path(path_type=Path, readable=False), help="Materials and landmarks from a recipe."
)
@scan_options
@working("writing the case")
def command(
    grid: Path,
    output: Path,
    scan: Path,
    surface: Path | None,
    grid_map: Path | None,
    structures: Path | None,
    recipe: Path | None,
    choice: dict[str, Any],
) -> None:
    """Write the case OUTPUT (NAME.case) from GRID and the other stages' outputs."""
    from heartcase.pipeline.bundle import assemble_bundle, resolve_materials, write_bundle
    from heartcase.pipeline.case_id import made_up_case_id
    from heartcase.pipeline.data import GridMap, SimulationGrid, Structures, Surface
    from heartcase.pipeline.mesh.glb import glb_bytes
    from heartcase.pipeline.openings import find_openings
    from heartcase.pipeline.picking import picking_surface
    from heartcase.pipeline.rims import with_rims
    from heartcase.pipeline.run import labels_of
    from heartcase.pipeline.write import segmentation_nrrd_bytes
    from heartcase.schemas.settings import MaterialsSettings

    loaded = optional_recipe(recipe)
    cells, mesh, tied, fields = load_outputs(
        {
            "GRID": (grid, SimulationGrid),
            "--surface": (surface, Surface),
            "--map": (grid_map, GridMap),
            "--structures": (structures, Structures),
        }
    )
    volume = read_scan_or_output(scan, choice)
    name = output.name.removesuffix(".case")
    case_id = (loaded.case_id if loaded else None) or made_up_case_id(name, volume.values_sha256)
    labels = labels_of(fields) if fields else None
    if labels is not None and not labels.geometry.matches(volume.geometry):
        raise UsageError(
            "lie on another lattice than the scan: give the scan that they were made from", place="--structures"
        )
    if mesh is not None and fields is not None and labels is not None:
        edits, landmarks = (loaded.edits, loaded.landmarks) if loaded else ((), ())
        strokes, connected = (loaded.strokes, loaded.walls.connected) if loaded else ((), ())
        openings = find_openings(fields, labels, edits, landmarks, strokes=strokes, connected=connected)
        mesh = with_rims(mesh, openings, fields.geometry)
    content = assemble_bundle(
        name=name,
        case_id=case_id,
        grid=cells,
        materials=resolve_materials(loaded.materials if loaded else MaterialsSettings(), cells.table),
        scan_geometry=volume.geometry,
        scan_sha256=volume.values_sha256,
        stages=(),
        surface=mesh,
        grid_map=tied,
        picking=picking_surface(cells),
        glbs=[glb_bytes(one, case_id=case_id) for one in (mesh, *mesh.levels)] if mesh else (),
        labels_nrrd=segmentation_nrrd_bytes(labels, case_id=case_id) if labels else None,
        landmarks=loaded.landmarks if loaded else (),
        modality=volume.modality,
        acquisition=volume.acquisition,
    )
    write_bundle(output, content)
    click.echo(f"wrote {output}", err=True)
