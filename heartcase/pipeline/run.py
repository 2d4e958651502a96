"""From a recipe to a case: the stages in their order, then the bundle and the report."""

from __future__ import annotations

import hashlib
import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from heartcase import __version__
from heartcase.pipeline.assembly import StageResults, assemble_case, labels_of, told_of_ends, told_of_outlines
from heartcase.pipeline.bundle import check_place, check_replacement, write_bundle
from heartcase.pipeline.cache import Cache, stage_key
from heartcase.pipeline.cautions import cautions_of
from heartcase.pipeline.lock import check_lock, resolve_recipe
from heartcase.pipeline.placeholders import placeholder_problems
from heartcase.pipeline.runner import STAGE_VERSIONS, STAGES, BuildListener, Runner, SilentListener
from heartcase.pipeline.stages import RUN_STAGE, StageOutputs, filtered_tree, have
from heartcase.schemas.approval import bundle_sha256
from heartcase.schemas.bundle import CaseManifest
from heartcase.schemas.bundle_reader import open_bundle
from heartcase.schemas.errors import BundleError, RecipeError, UsageError
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
            examples = placeholder_problems(recipe, nodes.whole)
            if examples:
                raise RecipeError(examples)
            lock_warnings = check_lock(recipe, directory, scan, accept_inputs=accept_inputs)
            recipe = resolve_recipe(recipe, scan)
            if until is None and not replace:
                check_replacement(out / f"{recipe.name}.case", recipe.case_id)
        if stage == until:
            reused = tuple(runner.reused)
            return BuildResult(None, None, None, runner.seconds, reused, changed=False, warnings=lock_warnings)
    return _finish(recipe, runner, nodes, out, lock_warnings)


def _finish(
    recipe: Recipe, runner: Runner, nodes: StageOutputs, out: Path, lock_warnings: tuple[str, ...]
) -> BuildResult:
    """Write the bundle and the report; the recipe is resolved."""
    from heartcase.pipeline.report.build_report import build_report

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
    grid_map = nodes.grid_map.get() if nodes.grid_map else None
    segmentation = have(nodes.segmentation).get()
    markers = nodes.markers.get() if nodes.markers else None
    told = told_of_outlines(recipe, segmentation, markers, scan) | told_of_ends(recipe, segmentation, structures)
    assembled = assemble_case(
        recipe,
        StageResults(
            scan=scan,
            grid=grid,
            structures=structures,
            surface=nodes.surface.get() if nodes.surface else None,
            grid_map=grid_map,
            filtered=have(nodes.filtered).get() if Part.SCAN in recipe.parts else None,
            whole=nodes.whole,
            stages=runner.records,
            told=told | {"lock": lock_warnings},
        ),
        name=recipe.name,
        case_id=recipe.case_id,
    )
    content, warnings = assembled.content, assembled.warnings
    runner.seconds["bundle"] = time.perf_counter() - start
    html = build_report(
        sureness=_sureness(recipe, runner, nodes),
        recipe=recipe,
        scan=scan,
        segmentation=segmentation,
        structures=structures,
        grid=grid,
        surface=assembled.surface,
        grid_map=grid_map,
        volumes_ml=assembled.volumes_ml,
        openings=assembled.openings,
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
    return BuildResult(case, report, content.manifest, runner.seconds, tuple(runner.reused), changed, warnings)


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
