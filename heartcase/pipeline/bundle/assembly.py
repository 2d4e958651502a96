"""The outputs of the stages put together to a case: its files, figures and warnings.

There is one way for it, so that a case made with one command (``heartcase build``) and a case made stage by stage
(``heartcase bundle``) say the same.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from heartcase.pipeline.bundle.write_bundle import (
    BundleContent,
    BundleParts,
    BundleRecord,
    BundleSource,
    assemble_bundle,
    resolve_materials,
)
from heartcase.pipeline.checks.closed_valves import closed_valve_warnings
from heartcase.pipeline.checks.openings import (
    Opening,
    find_openings,
    opening_figures,
    opening_warnings,
)
from heartcase.pipeline.checks.scan_border import cut_warnings, voxel_warnings
from heartcase.pipeline.data import GridMap, Markers, Scan, Segmentation, SimulationGrid, Structures, Surface
from heartcase.pipeline.kernels.parallel import side_by_side
from heartcase.pipeline.warnings import CaseWarning, worst_first
from heartcase.schemas.bundle.format import StageRecord
from heartcase.schemas.geometry import Geometry
from heartcase.schemas.recipe.recipe import Part, Recipe

__all__ = ["SOURCES", "AssembledCase", "StageResults", "assemble_case", "labels_of", "told_of_ends", "told_of_outlines"]

SOURCES = (
    "cut",
    "lock",
    "scan",
    "unknown",
    "markers",
    "segment",
    "outlines",
    "ends",
    "openings",
    "structures",
    "grid",
    "map",
    "surface",
)
"""What warnings are about, in the order in which those that matter alike are told."""


@dataclass(frozen=True)
class StageResults:
    """What the stages made, and what was told of it."""

    scan: Scan
    """The scan's region of interest, as it was read."""
    grid: SimulationGrid
    """Its cells."""
    structures: Structures | None = None
    """The fields after edits; without them volumes, openings and cut faces are not known, and a warning says so."""
    surface: Surface | None = None
    """The visible surface."""
    grid_map: GridMap | None = None
    """How the surface follows the grid."""
    filtered: Scan | None = None
    """The smoothed scan, for the part that shows it."""
    whole: Geometry | None = None
    """Lattice of the whole scan; None where it is not known."""
    stages: Sequence[StageRecord] = ()
    """How the stages came to their outputs."""
    told: Mapping[str, Sequence[CaseWarning]] = field(default_factory=dict)
    """Warnings that are not in these outputs, by their source: a part of :data:`SOURCES`."""
    begun: Mapping[str, Callable[[], Any]] = field(default_factory=dict)
    """What gives the results of :func:`structure_figures` and :func:`normal_maps`, where they are worked out ahead."""


@dataclass(frozen=True)
class StructureFigures:
    """What the fields after edits say of a case."""

    volumes_ml: dict[int, float]
    """Label value -> volume, ml."""
    labels: Segmentation
    """The label of every voxel of the fields' lattice, walls included."""
    openings: tuple[Opening, ...]
    """Where cavities are open to each other, the worst first."""


@dataclass(frozen=True)
class AssembledCase:
    """A case, and what its report needs beside it."""

    content: BundleContent
    """What is written."""
    warnings: tuple[CaseWarning, ...]
    """All of them, the worst first."""
    surface: Surface | None
    """The surface with the rims of the openings marked."""
    volumes_ml: dict[int, float]
    """Label value -> volume, ml."""
    openings: tuple[Opening, ...]
    """Where cavities are open to each other, the worst first."""
    septa: tuple[dict[str, Any], ...] = ()
    """The septa that were grown, with what is to be thought of their places."""


def labels_of(structures: Structures) -> Segmentation:
    """The label of every voxel of the fields' lattice, walls included."""
    from heartcase.pipeline.fields.reader import ownership_on_lattice

    owner = ownership_on_lattice(structures, structures.geometry)
    labels = np.where(owner.tissue_mm < 0.0, owner.tissue_label, owner.void_label).astype(np.uint8)
    return Segmentation(labels, structures.geometry, structures.table)


def structure_figures(
    recipe: Recipe, structures: Structures, is_wanted: Callable[[], bool] = lambda: True
) -> StructureFigures:
    """Volumes, labels and openings of the structures.

    Raises
    ------
    CancelledError
        They are not wanted any more.
    """
    from heartcase.pipeline.walls.grow_walls import structure_volumes_ml

    volumes_ml, labels = structure_volumes_ml(structures, is_wanted), labels_of(structures)
    openings = find_openings(
        structures,
        labels,
        recipe.edits,
        recipe.landmarks,
        strokes=recipe.strokes,
        connected=recipe.walls.connected,
        contacts=recipe.walls.contact,
    )
    return StructureFigures(volumes_ml, labels, openings)


def normal_maps(recipe: Recipe, surface: Surface | None) -> list[bytes]:
    """The normal maps of a surface and its levels as PNG files, where the case has a part to render."""
    from heartcase.pipeline.bundle.glb import normal_map_png

    rendered = (surface, *surface.levels) if surface is not None and Part.RENDER in recipe.parts else ()
    return [normal_map_png(one) for one in rendered]


def told_of_outlines(
    recipe: Recipe, segmentation: Segmentation, markers: Markers | None, scan: Scan | None
) -> dict[str, tuple[CaseWarning, ...]]:
    """What is to be told of a segmentation and of the markers that it was made from.

    Parameters
    ----------
    recipe
        For what its edits make later.
    segmentation, markers
        As the stages made them; the markers None where there are none.
    scan
        What was segmented; None where it is not at hand.
    """
    from heartcase.pipeline.edits.apply_edits import made_by
    from heartcase.pipeline.watershed.segment_scan import segmentation_warnings

    made_later = made_by(recipe.edits, segmentation.table)
    return {
        "markers": markers.warnings if markers else (),
        "segment": segmentation.warnings,
        "outlines": segmentation_warnings(segmentation, markers, filtered=scan, made_later=made_later),
    }


def told_of_ends(
    recipe: Recipe, segmentation: Segmentation, structures: Structures
) -> dict[str, tuple[CaseWarning, ...]]:
    """What is to be told of vessels that nothing cuts open."""
    from heartcase.pipeline.vessel_ends.cut_ends import closed_vessels

    return {"ends": closed_vessels(segmentation, (*recipe.ends, *structures.vessel_ends))}


def assemble_case(recipe: Recipe, results: StageResults, *, name: str, case_id: str | None) -> AssembledCase:
    """Put a case together.

    Parameters
    ----------
    recipe
        What was asked for: materials, landmarks, diagnoses, edits and parts are its.
    results
        What the stages made.
    name, case_id
        Of the case.

    Raises
    ------
    BundleError
        See :func:`heartcase.pipeline.bundle.write_bundle.assemble_bundle`.
    """
    from heartcase.pipeline.bundle.glb import glb_bytes
    from heartcase.pipeline.cells.picking import picking_surface
    from heartcase.pipeline.checks.adult_walls import adult_wall_warnings
    from heartcase.pipeline.checks.rims import with_rims
    from heartcase.pipeline.edits.apply_edits import with_edit_names
    from heartcase.pipeline.formats.write_images import segmentation_nrrd_bytes
    from heartcase.pipeline.image.scan_part import scan_part
    from heartcase.pipeline.walls.grown_places import judged_places
    from heartcase.pipeline.walls.said_places import said_warnings

    scan, grid, structures, surface = results.scan, results.grid, results.structures, results.surface
    grid_map, filtered = results.grid_map, results.filtered
    told: dict[str, Sequence[CaseWarning]] = {"cut": voxel_warnings(scan.geometry), "scan": scan.warnings} | dict(
        results.told
    )
    quality: dict[str, Any] = {}
    volumes_ml: dict[int, float] = {}
    openings: tuple[Opening, ...] = ()
    septa: list[dict[str, Any]] = []
    labels: Segmentation | None = None
    # Compressing the normal maps takes one thread, and as long as the kernels that measure take both.
    found, maps = side_by_side(
        results.begun.get(
            "structure_figures", lambda: None if structures is None else structure_figures(recipe, structures)
        ),
        results.begun.get("normal_maps", lambda: normal_maps(recipe, surface)),
    )
    if structures is not None and found is not None:
        volumes_ml, labels, openings = found.volumes_ml, found.labels, found.openings
        quality["volumes_ml"] = {structures.table[value].name: round(ml, 3) for value, ml in volumes_ml.items()}
        quality["openings"] = opening_figures(openings)
        told["cut"] = (*cut_warnings(labels, whole=results.whole, ends=structures.vessel_ends), *told["cut"])
        voxel_mm = structures.geometry.voxel_volume_mm3 ** (1.0 / 3.0)
        grown = structures.quality.get("septa", ())
        septa, of_septa = judged_places(grown, openings, recipe.walls.contact, structures.table, voxel_mm)
        of_said = said_warnings(grown, openings, recipe.walls, structures.table, voxel_mm, recipe.edits)
        of_walls = adult_wall_warnings(labels, [one.label for one in recipe.walls.thickness])
        closed = closed_valve_warnings(labels, openings)
        told["openings"] = (*of_said, *opening_warnings(openings), *closed, *of_walls)
        # the walls stage did not know of edits, nor of what a person said
        others = with_edit_names(structures.warnings, recipe.edits)
        told["structures"] = [
            told_now for one in others for told_now in (of_septa if one.code == "grown-septum" else (one,))
        ]
        if surface is not None:
            surface = with_rims(surface, openings, structures.geometry)
    else:
        unknown = (
            "the structures were not given, so it is not known what the scan's faces cut off, nor what is open to each "
            "other: give the output of 'walls' or 'edit'"
        )
        told["unknown"] = (*told.get("unknown", ()), CaseWarning(unknown))
    shown = (surface, *surface.levels) if surface is not None else ()
    outputs = {"walls": structures, "grid": grid, "surface": surface, "map": grid_map}
    quality |= {stage: output.quality for stage, output in outputs.items() if output is not None and output.quality}
    if septa:
        quality["walls"] = {**quality["walls"], "septa": septa}
    if grid_map is not None and surface is not None:
        pairs = zip(shown[1:], grid_map.levels, strict=True)
        quality["levels"] = [{"surface": one.quality, "map": tie.quality} for one, tie in pairs]
    told |= {"grid": grid.warnings, "map": grid_map.warnings if grid_map else ()}
    told["surface"] = surface.warnings if surface is not None else ()
    warnings = worst_first(*(told.get(source, ()) for source in SOURCES))
    content = assemble_bundle(
        BundleParts(
            grid=grid,
            surface=surface,
            grid_map=grid_map,
            picking=picking_surface(grid) if Part.PICKING in recipe.parts else None,
            glbs=[glb_bytes(one, case_id=case_id, png=png) for one, png in zip(shown, maps, strict=False)],
            labels_nrrd=segmentation_nrrd_bytes(labels, case_id=case_id)
            if labels and Part.LABELS in recipe.parts
            else None,
            scan=scan_part(filtered) if filtered is not None and Part.SCAN in recipe.parts else None,
        ),
        resolve_materials(recipe.materials, grid.table),
        BundleSource(
            geometry=scan.geometry, sha256=scan.values_sha256, modality=scan.modality, acquisition=scan.acquisition
        ),
        BundleRecord(
            name=name,
            case_id=case_id,
            stages=results.stages,
            landmarks=recipe.landmarks,
            about=recipe.about,
            quality=quality,
            warnings=warnings,
        ),
    )
    return AssembledCase(content, warnings, surface, volumes_ml, openings, tuple(septa))
