"""Each stage of a build: which settings and inputs of the recipe it takes, and what it leaves for the later ones."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar, cast

import numpy as np

from heartcase.pipeline.cache import Cache
from heartcase.pipeline.data import GridMap, Markers, Scan, Segmentation, SimulationGrid, Structures, Surface
from heartcase.pipeline.runner import Job, Node, Runner
from heartcase.schemas.base import Model
from heartcase.schemas.errors import MarkerError, Problem, ScanError
from heartcase.schemas.geometry import Geometry
from heartcase.schemas.labels import BACKGROUND
from heartcase.schemas.recipe import Part, Recipe
from heartcase.schemas.settings import resolved

if TYPE_CHECKING:
    from heartcase.pipeline.watershed.tree import BasinTree

__all__ = [
    "RUN_STAGE",
    "StageOutputs",
    "filtered_tree",
    "have",
    "region_of_scan",
    "stroke_problems",
    "surface_job",
    "whole_scan",
]

T = TypeVar("T")


def _all(models: tuple[Model, ...]) -> list[Any]:
    return [resolved(model) for model in models]


@dataclass
class StageOutputs:
    """Outputs of the stages so far."""

    whole: Geometry | None = None
    """Lattice of the scan before its region of interest was cut out."""
    scan: Node[Scan] | None = None
    filtered: Node[Scan] | None = None
    markers: Node[Markers] | None = None
    segmentation: Node[Segmentation] | None = None
    grown: Node[Structures] | None = None
    structures: Node[Structures] | None = None
    grid: Node[SimulationGrid] | None = None
    surface: Node[Surface] | None = None
    grid_map: Node[GridMap] | None = None


def have(node: Node[T] | None) -> Node[T]:
    """An output that the order of the stages puts there."""
    return cast("Node[T]", node)


def region_of_scan(recipe: Recipe, directory: Path) -> Scan:
    """Read a recipe's scan and cut its region of interest out.

    Raises
    ------
    ScanError
        There is no scan, or it cannot be read.
    """
    from heartcase.pipeline.region import crop_scan

    return crop_scan(whole_scan(recipe, directory), recipe.region)


def whole_scan(recipe: Recipe, directory: Path) -> Scan:
    """Read a recipe's scan, all of it.

    Raises
    ------
    ScanError
        There is no scan, or it cannot be read.
    """
    from heartcase.pipeline.read import read_scan

    path = directory / recipe.scan.path
    if not path.exists():
        where = f" Where it comes from: {recipe.scan.origin}" if recipe.scan.origin else ""
        raise ScanError(
            f"there is no scan: check the spelling (it is relative to the recipe), or put the scan there.{where}",
            place="scan.path",
        )
    scan = _with_modality(read_scan(path, **recipe.scan.choice), recipe)
    return dataclasses.replace(scan, whole_sha256=scan.values_sha256)


def _read(recipe: Recipe, directory: Path, runner: Runner, nodes: StageOutputs) -> None:
    from heartcase.pipeline.region import crop_scan

    def cut_out() -> Scan:
        whole = whole_scan(recipe, directory)
        nodes.whole = whole.geometry
        return crop_scan(whole, recipe.region)

    # the end of a series UID may identify the patient, so it is in no record
    choice = {name: value for name, value in recipe.scan.choice.items() if name != "series"}
    nodes.scan = runner.run_always(
        "read",
        settings=choice | {"region": resolved(recipe.region) if recipe.region else None},
        compute=cut_out,
    )
    runner.voxel_count = nodes.scan.get().values.size


def _with_modality(scan: Scan, recipe: Recipe) -> Scan:
    """The file's own word on the kind of scan counts; the recipe's where the file says nothing."""
    if scan.modality != "unknown" or recipe.scan.modality is None:
        return scan
    return dataclasses.replace(scan, modality=recipe.scan.modality)


def _filter(recipe: Recipe, directory: Path, runner: Runner, nodes: StageOutputs) -> None:
    from heartcase.pipeline.filter import filter_scan

    scan = have(nodes.scan)
    nodes.filtered = runner.run(
        Job(
            stage="filter",
            settings=resolved(recipe.filter),
            inputs={"scan": scan},
            compute=lambda: filter_scan(scan.get(), recipe.filter),
            kind=Scan,
        )
    )


def _markers(recipe: Recipe, directory: Path, runner: Runner, nodes: StageOutputs) -> None:
    from heartcase.pipeline.markers import check_markers, load_markers

    if recipe.segment.method != "watershed":
        return
    scan, automatic = have(nodes.scan).get(), sorted({*recipe.segment.automatic})
    settings: dict[str, Any] = {"strokes": _all(recipe.strokes), "files": len(recipe.markers)}
    if automatic:
        settings["automatic"] = automatic
    nodes.markers = runner.run_always(
        "markers",
        settings=settings,
        compute=lambda: load_markers(
            recipe.markers,
            recipe.strokes,
            recipe.table,
            scan.geometry,
            directory,
            scan=scan,
            automatic=automatic,
            whole=nodes.whole,
        ),
    )
    check_markers(nodes.markers.get(), recipe.table, automatic=automatic)


def stroke_problems(recipe: Recipe) -> tuple[Problem, ...]:
    """Why a build would refuse a recipe's markers, as far as that is sure without the scan.

    A marker file may mark anything, and what the program marks by itself (``segment.automatic``) may be background.
    Where there is neither, nothing is marked but what the strokes name.

    Returns
    -------
    tuple of Problem
        In the words of :func:`heartcase.pipeline.markers.check_markers`; none where a marker file is named.
    """
    from heartcase.pipeline.markers import check_markers

    if recipe.segment.method != "watershed" or recipe.markers:
        return ()
    automatic, table = sorted({*recipe.segment.automatic}), recipe.table
    marked = {table[stroke.label].value for stroke in recipe.strokes if stroke.label is not None}
    if automatic:
        marked.add(BACKGROUND)
    labels = np.array([[[Markers.UNMARKED, *sorted(marked)]]], np.uint8)
    try:
        check_markers(Markers(labels, Geometry.of(shape=labels.shape)), table, automatic=automatic)
    except MarkerError as error:
        return error.problems
    return ()


def _segment(recipe: Recipe, directory: Path, runner: Runner, nodes: StageOutputs) -> None:
    from heartcase.pipeline.markers import load_segmentation
    from heartcase.pipeline.segment import segment_scan

    scan, filtered, markers = have(nodes.scan), have(nodes.filtered), nodes.markers
    settings = resolved(recipe.segment) | {"labels": _all(recipe.labels)}
    # what concerns a file's names or the markers is in what they give
    for elsewhere in ("file", "names", "convention", "others", "order", "automatic"):
        settings.pop(elsewhere)
    if recipe.segment.method == "labels":
        finished = directory / cast(str, recipe.segment.file)
        nodes.segmentation = runner.run_always(
            "segment",
            settings=settings,
            compute=lambda: load_segmentation(
                finished,
                recipe.segment.names,
                recipe.table,
                scan.get().geometry,
                convention=recipe.segment.convention,
                others=recipe.segment.others,
                order=recipe.segment.order,
            ),
        )
        return
    nodes.segmentation = runner.run(
        Job(
            stage="segment",
            settings=settings,
            inputs={"scan": filtered} | ({"markers": markers} if markers else {}),
            compute=lambda: segment_scan(
                filtered.get(),
                markers.get() if markers else None,
                recipe.segment,
                recipe.table,
                make_tree=lambda: filtered_tree(recipe, filtered, runner.cache),
            ),
            kind=Segmentation,
        )
    )


def filtered_tree(recipe: Recipe, filtered: Node[Scan], cache: Cache | None) -> BasinTree:
    """The watershed's tree of a recipe's smoothed scan: kept from before, or made and kept."""
    from heartcase.pipeline.watershed.kept import scan_tree

    return scan_tree(
        filtered.get(),
        gradient_sigma_mm=recipe.segment.gradient_sigma_mm,
        shape_sigma_mm=recipe.segment.shape_sigma_mm,
        flat_floor=recipe.segment.flat_floor,
        cache=cache,
        scan_sha256=filtered.sha256,
    )


def _walls(recipe: Recipe, directory: Path, runner: Runner, nodes: StageOutputs) -> None:
    from heartcase.pipeline.septa import open_places
    from heartcase.pipeline.walls import grow_walls

    segmentation, walls = have(nodes.segmentation), recipe.walls_to_grow
    settings: dict[str, Any] = resolved(walls) | {"ends": _all(recipe.ends)}
    if not walls.find_ends:
        # a setting that came later: what does not use it keeps its records
        settings.pop("find_ends")
    places = open_places(recipe.strokes, recipe.landmarks, recipe.table) if walls.septa == "grown" else ()
    if places:
        # not what a landmark is called, nor a stroke that opens nothing
        settings["open_places"] = [list(one) for one in places]
    nodes.grown = runner.run(
        Job(
            stage="walls",
            settings=settings,
            inputs={"segmentation": segmentation},
            compute=lambda: grow_walls(segmentation.get(), walls, recipe.ends, open_places=places),
            kind=Structures,
        )
    )


def _edit(recipe: Recipe, directory: Path, runner: Runner, nodes: StageOutputs) -> None:
    from heartcase.pipeline.edit import apply_edits

    grown = have(nodes.grown)
    # Not what an edit is called, nor those that are switched off; the stage names an edit by its number.
    settings = [
        {"number": number} | edit.model_dump(mode="json", exclude={"name", "enabled"})
        for number, edit in enumerate(recipe.edits, start=1)
        if edit.enabled
    ]
    if not settings:
        nodes.structures = grown
        return
    nodes.structures = runner.run(
        Job(
            stage="edit",
            settings={"edits": settings},
            inputs={"structures": grown},
            compute=lambda: apply_edits(grown.get(), recipe.edits),
            kind=Structures,
        )
    )


def _grid_job(recipe: Recipe, nodes: StageOutputs) -> Job[SimulationGrid]:
    from heartcase.pipeline.grid import build_grid

    structures = have(nodes.structures)
    return Job(
        stage="grid",
        settings=resolved(recipe.grid) | {"pins": _all(recipe.pins)},
        inputs={"structures": structures},
        compute=lambda: build_grid(structures.get(), recipe.grid, pins=recipe.pins),
        kind=SimulationGrid,
    )


def _grid(recipe: Recipe, directory: Path, runner: Runner, nodes: StageOutputs) -> None:
    nodes.grid = runner.run(_grid_job(recipe, nodes))


def surface_job(recipe: Recipe, nodes: StageOutputs) -> Job[Surface]:
    """What the surface stage computes; ``RUN_STAGE`` makes the grid beside it."""
    from heartcase.pipeline.surface import build_surface

    structures = have(nodes.structures)
    render = Part.RENDER in recipe.parts
    return Job(
        stage="surface",
        settings=resolved(recipe.surface) | {"render": render},
        inputs={"structures": structures},
        compute=lambda: build_surface(structures.get(), recipe.surface, render=render),
        kind=Surface,
    )


def _surface(recipe: Recipe, directory: Path, runner: Runner, nodes: StageOutputs) -> None:
    """The surface, and with it the grid, which takes less time and waits for one core where this one does not."""
    nodes.grid, nodes.surface = runner.run_both(_grid_job(recipe, nodes), surface_job(recipe, nodes))


def _map(recipe: Recipe, directory: Path, runner: Runner, nodes: StageOutputs) -> None:
    from heartcase.pipeline.map import map_surface

    surface, grid, structures = have(nodes.surface), have(nodes.grid), have(nodes.structures)
    nodes.grid_map = runner.run(
        Job(
            stage="map",
            settings=resolved(recipe.map),
            inputs={"surface": surface, "grid": grid, "structures": structures},
            compute=lambda: map_surface(surface.get(), grid.get(), structures.get(), recipe.map),
            kind=GridMap,
        )
    )


RUN_STAGE: dict[str, Callable[[Recipe, Path, Runner, StageOutputs], None]] = {
    "read": _read,
    "markers": _markers,
    "filter": _filter,
    "segment": _segment,
    "walls": _walls,
    "edit": _edit,
    "grid": _grid,
    "surface": _surface,
    "map": _map,
}
"""What runs each stage but the last."""
