"""From a recipe to a case: the order of the stages, the cache between them, and the files at both ends."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Generic, Protocol, TypeVar, cast

import numpy as np

from heartcase import __version__
from heartcase.pipeline.artifacts import artifact_to_bytes
from heartcase.pipeline.bundle import assemble_bundle, check_place, resolve_materials, write_bundle
from heartcase.pipeline.cache import Cache, stage_key
from heartcase.pipeline.data import GridMap, Markers, Scan, Segmentation, SimulationGrid, Structures, Surface
from heartcase.schemas.base import Model
from heartcase.schemas.bundle import MANIFEST_NAME, CaseManifest, StageRecord
from heartcase.schemas.bundle_reader import open_bundle
from heartcase.schemas.errors import BundleError, ScanError, UsageError
from heartcase.schemas.files import atomic_write, remove_leftovers, sha256_of_file
from heartcase.schemas.recipe import Part, Recipe
from heartcase.schemas.settings import resolved

__all__ = ["STAGES", "BuildListener", "BuildResult", "build_case"]

T = TypeVar("T")

STAGE_VERSIONS = {
    "read": 1,
    "markers": 1,
    "filter": 1,
    "segment": 1,
    "walls": 2,
    "edit": 1,
    "grid": 2,
    "surface": 2,
    "map": 2,
    "bundle": 1,
}
"""Raised whenever a stage's output changes for the same input, so that the cache forgets the old one."""

STAGES = tuple(STAGE_VERSIONS)
"""The stages in their order."""

SECONDS_GUESSED = {
    "filter": 2.0,
    "segment": 5.0,
    "walls": 6.0,
    "edit": 1.0,
    "grid": 4.0,
    "surface": 12.0,
    "map": 2.0,
    "bundle": 6.0,
}
"""First estimate for a scan of a million voxels, until a build has measured."""


class BuildListener(Protocol):
    """Who wants to know how a build goes on."""

    def stage_started(self, stage: str, *, seconds_expected: float, seconds_after: float) -> None:
        """Note that a stage begins to compute, how long it may take, and how long the stages after it may take."""

    def stage_finished(self, stage: str, *, seconds: float, reused: bool) -> None:
        """Note that a stage has its output, computed or found in the cache."""


class _Silent:
    def stage_started(self, stage: str, *, seconds_expected: float, seconds_after: float) -> None:
        pass

    def stage_finished(self, stage: str, *, seconds: float, reused: bool) -> None:
        pass


@dataclass
class _Node(Generic[T]):
    """A stage's output: its hash at once, itself when somebody needs it."""

    sha256: str
    fetch: Callable[[], T]
    value: T | None = None

    def get(self) -> T:
        if self.value is None:
            self.value = self.fetch()
        return self.value


@dataclass(frozen=True)
class BuildResult:
    """What a build made."""

    case: Path | None
    """The bundle, or None when the build stopped before it."""
    report: Path | None
    """The report, or None when the build stopped before it."""
    manifest: CaseManifest | None
    """The case's manifest."""
    seconds: dict[str, float]
    """Stage -> seconds that it took, now or when its output was computed."""
    reused: tuple[str, ...]
    """Stages whose output was found in the cache."""
    changed: bool
    """Whether anything in the bundle changed."""
    warnings: tuple[str, ...] = ()
    """What the user must know."""


@dataclass
class _Runner:
    """Runs stages through the cache and remembers how."""

    cache: Cache
    listener: BuildListener
    force: bool
    voxel_count: int = 1_000_000
    seconds: dict[str, float] = field(default_factory=dict)
    reused: list[str] = field(default_factory=list)
    records: list[StageRecord] = field(default_factory=list)

    def run(
        self, stage: str, *, settings: Any, inputs: Mapping[str, _Node[Any]], compute: Callable[[], T], kind: type[T]
    ) -> _Node[T]:
        """Find the stage's output, or compute and keep it."""
        version = STAGE_VERSIONS[stage]
        hashes = {name: node.sha256 for name, node in inputs.items()}
        key = stage_key(stage=stage, version=version, settings=settings, inputs=hashes)
        entry = None if self.force else self.cache.find(stage, key)
        node: _Node[T]

        def compute_and_store() -> T:
            self.announce(stage)
            start = time.perf_counter()
            output = compute()
            self.learn(stage, time.perf_counter() - start)
            stored = self.cache.store(stage, key, output, seconds=time.perf_counter() - start)
            node.sha256 = stored.output_sha256
            self.seconds[stage] = stored.seconds
            self.listener.stage_finished(stage, seconds=stored.seconds, reused=False)
            return output

        def fetch() -> T:
            cached = self.cache.load(stage, key, kind)
            if cached is not None:
                return cached
            self.reused.remove(stage)
            return compute_and_store()

        node = _Node("", fetch)
        if entry is None:
            node.value = compute_and_store()
        else:
            node.sha256 = entry.output_sha256
            self.seconds[stage] = entry.seconds
            self.reused.append(stage)
            self.listener.stage_finished(stage, seconds=entry.seconds, reused=True)
        self.records.append(
            StageRecord(stage=stage, version=version, settings=_as_dict(settings), output_sha256=node.sha256)
        )
        return node

    def run_always(self, stage: str, *, settings: Any, compute: Callable[[], T]) -> _Node[T]:
        """Compute a stage that is cheap or whose input is outside the cache's sight."""
        self.announce(stage)
        start = time.perf_counter()
        value = compute()
        node = _Node(hashlib.sha256(artifact_to_bytes(value)).hexdigest(), lambda: value, value)
        self.seconds[stage] = time.perf_counter() - start
        self.listener.stage_finished(stage, seconds=self.seconds[stage], reused=False)
        self.records.append(
            StageRecord(
                stage=stage,
                version=STAGE_VERSIONS[stage],
                settings=_as_dict(settings),
                output_sha256=node.sha256,
            )
        )
        return node

    def announce(self, stage: str) -> None:
        """Tell the listener that a stage begins, with the time it took before, scaled to this scan."""
        after = sum(self._expected(later) for later in STAGES[STAGES.index(stage) + 1 :])
        self.listener.stage_started(stage, seconds_expected=self._expected(stage), seconds_after=after)

    def _rates(self) -> dict[str, float]:
        try:
            data = json.loads((self.cache.directory / "rates.json").read_bytes())
            return {str(stage): float(seconds) for stage, seconds in data.items()}
        except (OSError, ValueError, AttributeError, TypeError):
            return {}

    def _expected(self, stage: str) -> float:
        rate = self._rates().get(stage, SECONDS_GUESSED.get(stage, 1.0))
        return rate * self.voxel_count / 1e6

    def learn(self, stage: str, seconds: float) -> None:
        """Remember how long a stage took, per million voxels."""
        rates = self._rates() | {stage: round(seconds * 1e6 / max(self.voxel_count, 1), 3)}
        atomic_write(self.cache.directory / "rates.json", json.dumps(rates, sort_keys=True).encode())


def _as_dict(settings: Any) -> dict[str, Any]:
    return settings if isinstance(settings, dict) else {"settings": settings}


def _all(models: tuple[Model, ...]) -> list[Any]:
    return [resolved(model) for model in models]


def build_case(
    recipe: Recipe,
    *,
    directory: Path,
    out: Path,
    cache: Path | None = None,
    listener: BuildListener | None = None,
    force: bool = False,
    until: str | None = None,
) -> BuildResult:
    """Build a case.

    Parameters
    ----------
    recipe
        What to build.
    directory
        Where the recipe's relative paths start.
    out
        Directory for ``NAME.case`` and ``NAME.report.html``; made when it is not there.
    cache
        Directory of the cache; ``out/.heartcase-cache`` when left out.
    listener
        Told of progress.
    force
        Compute every stage anew.
    until
        Stop after this stage: see :data:`STAGES`.

    Raises
    ------
    HeartcaseError
        A problem with the scan, the markers or a stage; the case that was there before is untouched.
    """
    if until is not None and until not in STAGES:
        raise UsageError(f"there is no stage {until!r}; the stages are: {', '.join(STAGES)}", place="until")
    try:
        out.mkdir(parents=True, exist_ok=True)
        store = Cache(cache or out / ".heartcase-cache")
    except OSError as error:
        raise UsageError(f"cannot be written to: {error.strerror}", place="output or cache directory") from None
    store.clean()
    remove_leftovers(out)
    check_place(out / f"{recipe.name}.case")
    runner = _Runner(store, listener or _Silent(), force)
    nodes = _Nodes()
    for stage in STAGES[:-1]:
        if stage in ("surface", "map") and Part.SURFACE not in recipe.parts:
            continue
        _RUN[stage](recipe, directory, runner, nodes)
        if stage == until:
            return BuildResult(None, None, None, runner.seconds, tuple(runner.reused), changed=False)
    return _finish(recipe, runner, nodes, out)


@dataclass
class _Nodes:
    """Outputs of the stages so far."""

    scan: _Node[Scan] | None = None
    filtered: _Node[Scan] | None = None
    markers: _Node[Markers] | None = None
    segmentation: _Node[Segmentation] | None = None
    grown: _Node[Structures] | None = None
    structures: _Node[Structures] | None = None
    grid: _Node[SimulationGrid] | None = None
    surface: _Node[Surface] | None = None
    grid_map: _Node[GridMap] | None = None


def _have(node: _Node[T] | None) -> _Node[T]:
    return cast("_Node[T]", node)


def _read(recipe: Recipe, directory: Path, runner: _Runner, nodes: _Nodes) -> None:
    from heartcase.pipeline.read import read_scan
    from heartcase.pipeline.region import crop_scan

    path = directory / recipe.scan.path
    if not path.exists():
        where = f" Where it comes from: {recipe.scan.origin}" if recipe.scan.origin else ""
        raise ScanError(
            f"there is no scan: check the spelling (it is relative to the recipe), or put the scan there.{where}",
            place="scan.path",
        )
    nodes.scan = runner.run_always(
        "read",
        settings={"region": resolved(recipe.region) if recipe.region else None},
        compute=lambda: crop_scan(_with_modality(read_scan(path, series=recipe.scan.series), recipe), recipe.region),
    )
    runner.voxel_count = nodes.scan.get().values.size


def _with_modality(scan: Scan, recipe: Recipe) -> Scan:
    """The file's own word on the kind of scan counts; the recipe's where the file says nothing."""
    if scan.modality != "unknown" or recipe.scan.modality is None:
        return scan
    return dataclasses.replace(scan, modality=recipe.scan.modality)


def _filter(recipe: Recipe, directory: Path, runner: _Runner, nodes: _Nodes) -> None:
    from heartcase.pipeline.filter import filter_scan

    scan = _have(nodes.scan)
    nodes.filtered = runner.run(
        "filter",
        settings=resolved(recipe.filter),
        inputs={"scan": scan},
        compute=lambda: filter_scan(scan.get(), recipe.filter),
        kind=Scan,
    )


def _markers(recipe: Recipe, directory: Path, runner: _Runner, nodes: _Nodes) -> None:
    from heartcase.pipeline.markers import check_markers, load_markers

    if recipe.segment.method != "watershed":
        return
    geometry = _have(nodes.scan).get().geometry
    nodes.markers = runner.run_always(
        "markers",
        settings={"strokes": _all(recipe.strokes), "files": len(recipe.markers)},
        compute=lambda: load_markers(recipe.markers, recipe.strokes, recipe.table, geometry, directory),
    )
    check_markers(nodes.markers.get(), recipe.table)


def _segment(recipe: Recipe, directory: Path, runner: _Runner, nodes: _Nodes) -> None:
    from heartcase.pipeline.markers import load_segmentation
    from heartcase.pipeline.segment import segment_scan

    scan, filtered, markers = _have(nodes.scan), _have(nodes.filtered), nodes.markers
    settings = resolved(recipe.segment) | {"labels": _all(recipe.labels)}
    for naming_files in ("file", "names"):
        settings.pop(naming_files)
    if recipe.segment.method == "labels":
        finished = directory / cast(str, recipe.segment.file)
        nodes.segmentation = runner.run_always(
            "segment",
            settings=settings,
            compute=lambda: load_segmentation(finished, recipe.segment.names, recipe.table, scan.get().geometry),
        )
        return
    nodes.segmentation = runner.run(
        "segment",
        settings=settings,
        inputs={"scan": filtered} | ({"markers": markers} if markers else {}),
        compute=lambda: segment_scan(filtered.get(), markers.get() if markers else None, recipe.segment, recipe.table),
        kind=Segmentation,
    )


def _walls(recipe: Recipe, directory: Path, runner: _Runner, nodes: _Nodes) -> None:
    from heartcase.pipeline.walls import grow_walls

    segmentation = _have(nodes.segmentation)
    nodes.grown = runner.run(
        "walls",
        settings=resolved(recipe.walls) | {"ends": _all(recipe.ends)},
        inputs={"segmentation": segmentation},
        compute=lambda: grow_walls(segmentation.get(), recipe.walls, recipe.ends),
        kind=Structures,
    )


def _edit(recipe: Recipe, directory: Path, runner: _Runner, nodes: _Nodes) -> None:
    from heartcase.pipeline.edit import apply_edits

    grown = _have(nodes.grown)
    if not recipe.edits:
        nodes.structures = grown
        return
    nodes.structures = runner.run(
        "edit",
        settings={"edits": _all(recipe.edits)},
        inputs={"structures": grown},
        compute=lambda: apply_edits(grown.get(), recipe.edits),
        kind=Structures,
    )


def _grid(recipe: Recipe, directory: Path, runner: _Runner, nodes: _Nodes) -> None:
    from heartcase.pipeline.grid import build_grid

    structures = _have(nodes.structures)
    nodes.grid = runner.run(
        "grid",
        settings=resolved(recipe.grid) | {"pins": _all(recipe.pins)},
        inputs={"structures": structures},
        compute=lambda: build_grid(structures.get(), recipe.grid, pins=recipe.pins),
        kind=SimulationGrid,
    )


def _surface(recipe: Recipe, directory: Path, runner: _Runner, nodes: _Nodes) -> None:
    from heartcase.pipeline.surface import build_surface

    structures = _have(nodes.structures)
    render = Part.RENDER in recipe.parts
    nodes.surface = runner.run(
        "surface",
        settings=resolved(recipe.surface) | {"render": render},
        inputs={"structures": structures},
        compute=lambda: build_surface(structures.get(), recipe.surface, render=render),
        kind=Surface,
    )


def _map(recipe: Recipe, directory: Path, runner: _Runner, nodes: _Nodes) -> None:
    from heartcase.pipeline.map import map_surface

    surface, grid = _have(nodes.surface), _have(nodes.grid)
    nodes.grid_map = runner.run(
        "map",
        settings=resolved(recipe.map),
        inputs={"surface": surface, "grid": grid},
        compute=lambda: map_surface(surface.get(), grid.get(), recipe.map),
        kind=GridMap,
    )


_RUN: dict[str, Callable[[Recipe, Path, _Runner, _Nodes], None]] = {
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


def labels_of(structures: Structures) -> Segmentation:
    """The label of every voxel of the fields' lattice, walls included."""
    from heartcase.pipeline.fields import ownership_on_lattice

    owner = ownership_on_lattice(structures, structures.geometry)
    labels = np.where(owner.tissue_mm < 0.0, owner.tissue_label, owner.void_label).astype(np.uint8)
    return Segmentation(labels, structures.geometry, structures.table)


def _finish(recipe: Recipe, runner: _Runner, nodes: _Nodes, out: Path) -> BuildResult:
    """Write the bundle and the report."""
    from heartcase.pipeline.ends import closed_vessels
    from heartcase.pipeline.mesh.glb import glb_bytes
    from heartcase.pipeline.picking import picking_surface
    from heartcase.pipeline.report.build_report import build_report
    from heartcase.pipeline.segment import segmentation_warnings
    from heartcase.pipeline.walls import structure_volumes_ml
    from heartcase.pipeline.write import segmentation_nrrd_bytes

    case, report = out / f"{recipe.name}.case", out / f"{recipe.name}.report.html"
    key = stage_key(
        stage="bundle",
        version=STAGE_VERSIONS["bundle"],
        settings={
            "software": __version__,
            "recipe": recipe.model_dump(mode="json", include={"name", "landmarks", "materials", "parts"}),
        },
        inputs={record.stage: record.output_sha256 for record in runner.records},
    )
    manifest = None if runner.force else _unchanged(case, report, runner.cache, key)
    if manifest is not None:
        runner.listener.stage_finished("bundle", seconds=0.0, reused=True)
        reused = (*runner.reused, "bundle")
        return BuildResult(case, report, manifest, runner.seconds, reused, False, manifest.warnings)
    runner.announce("bundle")
    start = time.perf_counter()
    scan, grid, structures = _have(nodes.scan).get(), _have(nodes.grid).get(), _have(nodes.structures).get()
    surface = nodes.surface.get() if nodes.surface else None
    grid_map = nodes.grid_map.get() if nodes.grid_map else None
    segmentation = _have(nodes.segmentation).get()
    markers = nodes.markers.get() if nodes.markers else None
    volumes_ml = structure_volumes_ml(structures)
    outputs: dict[str, Any] = {"walls": structures, "grid": grid, "surface": surface, "map": grid_map}
    quality: dict[str, Any] = {
        "volumes_ml": {structures.table[value].name: round(volume, 3) for value, volume in volumes_ml.items()}
    }
    quality |= {stage: output.quality for stage, output in outputs.items() if getattr(output, "quality", None)}
    warnings = [*segmentation_warnings(segmentation, markers), *closed_vessels(segmentation, recipe.ends)]
    warnings += [w for stage in ("walls", "grid", "map", "surface") for w in getattr(outputs[stage], "warnings", ())]
    content = assemble_bundle(
        name=recipe.name,
        grid=grid,
        materials=resolve_materials(recipe.materials, structures.table),
        scan_geometry=scan.geometry,
        scan_sha256=_have(nodes.scan).sha256,
        stages=runner.records,
        surface=surface,
        grid_map=grid_map,
        picking=picking_surface(grid) if Part.PICKING in recipe.parts else None,
        glb=glb_bytes(surface) if surface is not None and Part.RENDER in recipe.parts else None,
        labels_nrrd=segmentation_nrrd_bytes(labels_of(structures)) if Part.LABELS in recipe.parts else None,
        landmarks=recipe.landmarks,
        modality=scan.modality,
        acquisition=scan.acquisition,
        quality=quality,
        warnings=warnings,
    )
    changed = write_bundle(case, content)
    runner.seconds["bundle"] = time.perf_counter() - start
    html = build_report(
        recipe=recipe,
        scan=scan,
        segmentation=segmentation,
        structures=structures,
        grid=grid,
        surface=surface,
        grid_map=grid_map,
        volumes_ml=volumes_ml,
        timings_s=runner.seconds,
        stages=runner.records,
        warnings=warnings,
    )
    atomic_write(report, html.encode())
    runner.cache.note("bundle", key, {"manifest_sha256": sha256_of_file(case / MANIFEST_NAME)})
    runner.learn("bundle", time.perf_counter() - start)
    runner.listener.stage_finished("bundle", seconds=time.perf_counter() - start, reused=not changed)
    return BuildResult(case, report, content.manifest, runner.seconds, tuple(runner.reused), changed, tuple(warnings))


def _unchanged(case: Path, report: Path, cache: Cache, key: str) -> CaseManifest | None:
    """The manifest of the case that is there, when it is whole and was made from exactly these inputs."""
    note = cache.noted("bundle", key)
    try:
        if note is None or not report.exists() or note["manifest_sha256"] != sha256_of_file(case / MANIFEST_NAME):
            return None
        return open_bundle(case).manifest
    except (OSError, KeyError, BundleError):
        return None
