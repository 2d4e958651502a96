"""From a recipe to a case: the stages in their order, then the bundle and the report."""

from __future__ import annotations

import hashlib
import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from heartcase.pipeline.artifacts.cache import Cache, stage_key
from heartcase.pipeline.building.kernels_ahead import kernels_ahead
from heartcase.pipeline.building.lock import check_lock
from heartcase.pipeline.building.runner import BuildListener, Runner, SilentListener, run_stages
from heartcase.pipeline.building.work_ahead import WorkAhead, sureness
from heartcase.pipeline.bundle.write_bundle import check_place, check_replacement, write_bundle
from heartcase.pipeline.markers.placeholders import placeholder_problems
from heartcase.pipeline.stages.bundle import STAGE as BUNDLE
from heartcase.pipeline.stages.stage import Work, have
from heartcase.pipeline.stages.table import REPORT, stage_names
from heartcase.pipeline.warnings import CaseWarning, warnings_of
from heartcase.schemas.bundle.approval import bundle_sha256
from heartcase.schemas.bundle.format import CaseManifest
from heartcase.schemas.bundle.reader import open_bundle
from heartcase.schemas.errors import BundleError, RecipeError, UsageError
from heartcase.schemas.files import atomic_write, remove_leftovers, sha256_of_file
from heartcase.schemas.recipe.recipe import Recipe

if TYPE_CHECKING:
    from heartcase.pipeline.bundle.assembly import AssembledCase

__all__ = ["BuildListener", "BuildResult", "build_case"]


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
    warnings: tuple[CaseWarning, ...] = ()
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
    compile_processes: int = 0,
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
        Stop after the stage of this name: see :func:`heartcase.pipeline.stages.table.stage_names`.
    replace
        Replace a case of this name although it was made from another scan.
    accept_inputs
        Build a locked recipe although its scan or marker files are not those that it was locked with.
    compile_processes
        Processes that compile kernels ahead, beside this one, where not all of them were compiled on this machine
        before; as many as there are cores make the first build fastest, and each holds some 600 MB. By default none
        is started: a program that calls this may not want it.

    Raises
    ------
    HeartcaseError
        A problem with the scan, the markers or a stage; the case that was there before is untouched. A case is
        written before its report: where the report cannot be drawn, the case is the new one, the report still tells
        the bundle hash of the old one, and the next build draws it.
    """
    if until is not None and until not in stage_names():
        raise UsageError(f"there is no stage {until!r}; the stages are: {', '.join(stage_names())}", place="until")
    try:
        out.mkdir(parents=True, exist_ok=True)
        store = Cache(cache or out / ".heartcase-cache")
    except OSError as error:
        raise UsageError(f"cannot be written to: {error.strerror}", place="output or cache directory") from None
    store.clean()
    remove_leftovers(out)
    check_place(out / f"{recipe.name}.case")
    runner = Runner(store, listener or SilentListener(), force)
    work = Work(recipe, directory, cache=store)

    def after(stage: str) -> None:
        """Once the scan is known, refuse what does not suit it, and state every setting; then begin what can be."""
        if stage != "read":
            if until in (None, BUNDLE.name):
                ahead.look()
            return
        scan = have(work.outputs.scan).get()
        examples = placeholder_problems(recipe, work.outputs.whole)
        if examples:
            raise RecipeError(examples)
        work.told["lock"] = check_lock(recipe, directory, scan, accept_inputs=accept_inputs)
        resolved = work.resolve()
        if until in (None, BUNDLE.name) and not replace:
            check_replacement(out / f"{recipe.name}.case", resolved.case_id)

    with kernels_ahead(recipe, until=until, processes=compile_processes), WorkAhead(work) as ahead:
        run_stages(runner, work, until=until, after=after)
        if until not in (None, BUNDLE.name):
            warnings = work.told["lock"]
            return BuildResult(None, None, None, runner.seconds, tuple(runner.reused), changed=False, warnings=warnings)
        return _finish(runner, work, out)


def _finish(runner: Runner, work: Work, out: Path) -> BuildResult:
    """Write the bundle, then the report about it."""
    case, report = out / f"{work.recipe.name}.case", out / f"{work.recipe.name}.report.html"
    key = stage_key(
        stage=BUNDLE.name,
        version=BUNDLE.version,
        settings=BUNDLE.settings(work),
        inputs={record.stage: record.output_sha256 for record in work.records},
    )
    manifest = None if runner.force else _unchanged(case, report, runner.cache, key)
    if manifest is not None:
        for step in (BUNDLE, REPORT):
            runner.listener.stage_finished(step.name, seconds=0.0, reused=True)
        reused = (*runner.reused, BUNDLE.name)
        return BuildResult(case, report, manifest, runner.seconds, reused, False, warnings_of(manifest))
    runner.announce(BUNDLE.name)
    start = time.perf_counter()
    assembled: AssembledCase = BUNDLE.compute(work)
    work.begun.pop("structure_figures", None)  # a volume of labels that nobody reads any more
    runner.seconds[BUNDLE.name] = time.perf_counter() - start
    changed = write_bundle(case, assembled.content)
    _finished(runner, BUNDLE.name, time.perf_counter() - start, reused=not changed)
    # The case can be used from here on. What is noted last makes the next build draw a report that was not finished.
    runner.announce(REPORT.name)
    start = time.perf_counter()
    html = _report(runner, work, assembled).encode()
    atomic_write(report, html)
    sums = {"bundle_sha256": assembled.content.sha256, "report_sha256": hashlib.sha256(html).hexdigest()}
    runner.cache.note(BUNDLE.name, key, sums)
    runner.seconds[REPORT.name] = time.perf_counter() - start
    _finished(runner, REPORT.name, runner.seconds[REPORT.name], reused=False)
    manifest = assembled.content.manifest
    return BuildResult(case, report, manifest, runner.seconds, tuple(runner.reused), changed, assembled.warnings)


def _finished(runner: Runner, step: str, seconds: float, *, reused: bool) -> None:
    runner.learn(step, seconds)
    runner.listener.stage_finished(step, seconds=seconds, reused=reused)


def _report(runner: Runner, work: Work, assembled: AssembledCase) -> str:
    """The page about an assembled case."""
    from heartcase.pipeline.report.build_report import ReportInputs, build_report

    outputs = work.outputs
    return build_report(
        ReportInputs(
            sureness=work.begun.get("sureness", lambda: sureness(work)),
            thickness_mm=work.begun.get("thickness"),
            recipe=work.recipe,
            rules=work.rules,
            scan=have(outputs.scan).get(),
            segmentation=have(outputs.segmentation).get(),
            structures=have(outputs.structures).get(),
            grid=have(outputs.grid).get(),
            surface=assembled.surface,
            grid_map=outputs.grid_map.get() if outputs.grid_map else None,
            volumes_ml=assembled.volumes_ml,
            openings=assembled.openings,
            septa=assembled.septa,
            timings_s=runner.seconds,
            stages=work.records,
            warnings=assembled.warnings,
            case_id=work.recipe.case_id,
            bundle_sha256=assembled.content.sha256,
        )
    )


def _unchanged(case: Path, report: Path, cache: Cache, key: str) -> CaseManifest | None:
    """The manifest of the case that is there, when it and its report are whole and made from exactly these inputs."""
    note = cache.noted(BUNDLE.name, key)
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
