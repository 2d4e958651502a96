"""From a recipe to a case: the stages in their order, then the bundle and the report."""

from __future__ import annotations

import hashlib
import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from heartcase import __version__
from heartcase.pipeline.bundle import assemble_bundle, check_place, check_replacement, resolve_materials, write_bundle
from heartcase.pipeline.cache import Cache, stage_key
from heartcase.pipeline.cautions import cautions_of, worst_first
from heartcase.pipeline.data import Segmentation, Structures
from heartcase.pipeline.lock import check_lock, resolve_recipe
from heartcase.pipeline.runner import STAGE_VERSIONS, STAGES, BuildListener, Runner, SilentListener
from heartcase.pipeline.stages import RUN_STAGE, StageOutputs, filtered_tree, have
from heartcase.schemas.approval import bundle_sha256
from heartcase.schemas.bundle import CaseManifest
from heartcase.schemas.bundle_reader import open_bundle
from heartcase.schemas.errors import BundleError, UsageError
from heartcase.schemas.files import atomic_write, remove_leftovers, sha256_of_file
from heartcase.schemas.recipe import Part, Recipe

if TYPE_CHECKING:
    from heartcase.pipeline.confidence import Sureness

__all__ = ["STAGES", "BuildListener", "BuildResult", "build_case", "labels_of"]


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


def build_case(
    recipe: Recipe,
    *,
    directory: Path,
    out: Path,
    cache: Path | None = None,
    listener: BuildListener | None = None,
    force: bool = False,
    until: str | None = None,
    accept_inputs: bool = False,
    replace: bool = False,
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
    replace
        Replace a case of this name although it was made from another scan.
    accept_inputs
        Build a locked recipe although its scan or marker files are not those that it was locked with.

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
    lock_warnings: tuple[str, ...] = ()
    runner = Runner(store, listener or SilentListener(), force)
    nodes = StageOutputs()
    for stage in STAGES[:-1]:
        if stage in ("surface", "map") and Part.SURFACE not in recipe.parts:
            continue
        if stage == "grid" and Part.SURFACE in recipe.parts and until != stage:
            continue  # it comes with the surface
        RUN_STAGE[stage](recipe, directory, runner, nodes)
        if stage == "read":
            scan = have(nodes.scan).get()
            lock_warnings = check_lock(recipe, directory, scan, accept_inputs=accept_inputs)
            recipe = resolve_recipe(recipe, scan)
            if until is None and not replace:
                check_replacement(out / f"{recipe.name}.case", recipe.case_id)
        if stage == until:
            reused = tuple(runner.reused)
            return BuildResult(None, None, None, runner.seconds, reused, changed=False, warnings=lock_warnings)
    return _finish(recipe, runner, nodes, out, lock_warnings)


def labels_of(structures: Structures) -> Segmentation:
    """The label of every voxel of the fields' lattice, walls included."""
    from heartcase.pipeline.fields import ownership_on_lattice

    owner = ownership_on_lattice(structures, structures.geometry)
    labels = np.where(owner.tissue_mm < 0.0, owner.tissue_label, owner.void_label).astype(np.uint8)
    return Segmentation(labels, structures.geometry, structures.table)


def _finish(
    recipe: Recipe, runner: Runner, nodes: StageOutputs, out: Path, lock_warnings: tuple[str, ...]
) -> BuildResult:
    """Write the bundle and the report; the recipe is resolved."""
    from heartcase.pipeline.edit import made_by, with_edit_names
    from heartcase.pipeline.ends import closed_vessels
    from heartcase.pipeline.mesh.glb import glb_bytes
    from heartcase.pipeline.openings import find_openings, opening_cautions, opening_figures
    from heartcase.pipeline.picking import picking_surface
    from heartcase.pipeline.report.build_report import build_report
    from heartcase.pipeline.rims import with_rims
    from heartcase.pipeline.scan_part import scan_part
    from heartcase.pipeline.segment import segmentation_warnings
    from heartcase.pipeline.walls import structure_volumes_ml
    from heartcase.pipeline.write import segmentation_nrrd_bytes

    case, report = out / f"{recipe.name}.case", out / f"{recipe.name}.report.html"
    key = stage_key(
        stage="bundle",
        version=STAGE_VERSIONS["bundle"],
        settings={
            "software": __version__,
            "lock": list(lock_warnings),
            # The report tells what was done by hand, so all of the recipe counts, but no path of it.
            "recipe": recipe.model_dump(
                mode="json",
                exclude={"scan": {"path", "series", "origin"}, "markers": {"__all__": {"path"}}, "segment": {"file"}},
            ),
            "records": [record.model_dump(mode="json") for record in runner.records],
        },
        inputs={record.stage: record.output_sha256 for record in runner.records},
    )
    manifest = None if runner.force else _unchanged(case, report, runner.cache, key)
    if manifest is not None:
        runner.listener.stage_finished("bundle", seconds=0.0, reused=True)
        reused = (*runner.reused, "bundle")
        return BuildResult(case, report, manifest, runner.seconds, reused, False, cautions_of(manifest))
    runner.announce("bundle")
    start = time.perf_counter()
    scan, grid, structures = have(nodes.scan).get(), have(nodes.grid).get(), have(nodes.structures).get()
    surface = nodes.surface.get() if nodes.surface else None
    grid_map = nodes.grid_map.get() if nodes.grid_map else None
    segmentation = have(nodes.segmentation).get()
    markers = nodes.markers.get() if nodes.markers else None
    volumes_ml = structure_volumes_ml(structures)
    labels = labels_of(structures)
    openings = find_openings(
        structures,
        labels,
        recipe.edits,
        recipe.landmarks,
        strokes=recipe.strokes,
        connected=recipe.walls.connected,
    )
    if surface is not None:
        surface = with_rims(surface, openings, structures.geometry)
    shown = (surface, *surface.levels) if surface is not None else ()
    outputs: dict[str, Any] = {"walls": structures, "grid": grid, "surface": surface, "map": grid_map}
    quality: dict[str, Any] = {
        "volumes_ml": {structures.table[value].name: round(volume, 3) for value, volume in volumes_ml.items()},
        "openings": opening_figures(openings),
    }
    quality |= {stage: output.quality for stage, output in outputs.items() if getattr(output, "quality", None)}
    if grid_map is not None:
        pairs = zip(shown[1:], grid_map.levels, strict=True)
        quality["levels"] = [{"surface": one.quality, "map": tie.quality} for one, tie in pairs]
    warnings = worst_first(
        lock_warnings,
        scan.warnings,
        markers.warnings if markers else (),
        segmentation.warnings,
        segmentation_warnings(
            segmentation, markers, filtered=scan, made_later=made_by(recipe.edits, segmentation.table)
        ),
        closed_vessels(segmentation, recipe.ends),
        opening_cautions(openings),
        with_edit_names(structures.warnings, recipe.edits),
        *(getattr(outputs[stage], "warnings", ()) for stage in ("grid", "map", "surface")),
    )
    content = assemble_bundle(
        name=recipe.name,
        case_id=recipe.case_id,
        grid=grid,
        materials=resolve_materials(recipe.materials, structures.table),
        scan_geometry=scan.geometry,
        scan_sha256=scan.values_sha256,
        stages=runner.records,
        surface=surface,
        grid_map=grid_map,
        picking=picking_surface(grid) if Part.PICKING in recipe.parts else None,
        glbs=[glb_bytes(one, case_id=recipe.case_id) for one in shown] if Part.RENDER in recipe.parts else (),
        labels_nrrd=segmentation_nrrd_bytes(labels, case_id=recipe.case_id) if Part.LABELS in recipe.parts else None,
        scan=scan_part(have(nodes.filtered).get()) if Part.SCAN in recipe.parts else None,
        landmarks=recipe.landmarks,
        about=recipe.about,
        modality=scan.modality,
        acquisition=scan.acquisition,
        quality=quality,
        warnings=warnings,
    )
    runner.seconds["bundle"] = time.perf_counter() - start
    html = build_report(
        sureness=_sureness(recipe, runner, nodes),
        recipe=recipe,
        scan=scan,
        segmentation=segmentation,
        structures=structures,
        grid=grid,
        surface=surface,
        grid_map=grid_map,
        volumes_ml=volumes_ml,
        openings=openings,
        timings_s=runner.seconds,
        stages=runner.records,
        warnings=warnings,
        case_id=recipe.case_id,
        bundle_sha256=content.sha256,
    ).encode()
    # The report is ready before the case is touched: where drawing fails, the old case and its report stay.
    changed = write_bundle(case, content)
    atomic_write(report, html)
    runner.cache.note(
        "bundle", key, {"bundle_sha256": content.sha256, "report_sha256": hashlib.sha256(html).hexdigest()}
    )
    runner.learn("bundle", time.perf_counter() - start)
    runner.listener.stage_finished("bundle", seconds=time.perf_counter() - start, reused=not changed)
    return BuildResult(case, report, content.manifest, runner.seconds, tuple(runner.reused), changed, tuple(warnings))


def _sureness(recipe: Recipe, runner: Runner, nodes: StageOutputs) -> Sureness | None:
    """How sure the watershed is, from the tree that the cache keeps; None for other methods."""
    from heartcase.pipeline.confidence import sureness_of

    if nodes.markers is None:
        return None
    return sureness_of(filtered_tree(recipe, have(nodes.filtered), runner.cache), nodes.markers.get())


def _unchanged(case: Path, report: Path, cache: Cache, key: str) -> CaseManifest | None:
    """The manifest of the case that is there, when it and its report are whole and made from exactly these inputs."""
    note = cache.noted("bundle", key)
    try:
        if (
            note is None
            or note["report_sha256"] != sha256_of_file(report)
            or note["bundle_sha256"] != bundle_sha256(case)
        ):
            return None
        return open_bundle(case).manifest
    except (OSError, KeyError, BundleError):
        return None
