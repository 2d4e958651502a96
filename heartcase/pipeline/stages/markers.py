"""The markers stage: strokes and marker files on the scan's lattice."""

from __future__ import annotations

from typing import Any

import numpy as np

from heartcase.pipeline.data import UNMARKED, Markers
from heartcase.pipeline.stages.stage import Stage, Work, have, resolved_all
from heartcase.schemas.errors import MarkerError, Problem
from heartcase.schemas.geometry import Geometry
from heartcase.schemas.labels import BACKGROUND
from heartcase.schemas.recipe.recipe import Recipe

__all__ = ["STAGE", "stroke_problems"]


def stroke_problems(recipe: Recipe) -> tuple[Problem, ...]:
    """Why a build would refuse a recipe's markers, as far as that is sure without the scan.

    A marker file may mark anything, and what the program marks by itself (``segment.automatic``) may be background.
    Where there is neither, nothing is marked but what the strokes name.

    Returns
    -------
    tuple of Problem
        In the words of :func:`heartcase.pipeline.markers.load_markers.check_markers`; none where a marker file is
        named.
    """
    from heartcase.pipeline.markers.load_markers import check_markers

    if recipe.segment.method != "watershed" or recipe.markers:
        return ()
    automatic, table = sorted({*recipe.segment.automatic}), recipe.table
    marked = {table[stroke.label].value for stroke in recipe.strokes if stroke.label is not None}
    if automatic:
        marked.add(BACKGROUND)
    labels = np.array([[[UNMARKED, *sorted(marked)]]], np.uint8)
    try:
        check_markers(Markers(labels, Geometry.of(shape=labels.shape)), table, automatic=automatic)
    except MarkerError as error:
        return error.problems
    return ()


def _settings(work: Work) -> dict[str, Any]:
    recipe = work.recipe
    settings: dict[str, Any] = {"strokes": resolved_all(recipe.strokes), "files": len(recipe.markers)}
    if recipe.segment.automatic:
        settings["automatic"] = sorted({*recipe.segment.automatic})
    return settings


def _compute(work: Work) -> Markers:
    from heartcase.pipeline.markers.load_markers import check_markers, load_markers

    recipe, scan = work.recipe, have(work.outputs.scan).get()
    automatic = sorted({*recipe.segment.automatic})
    markers = load_markers(
        recipe.markers,
        recipe.strokes,
        recipe.table,
        scan.geometry,
        work.directory,
        scan=scan,
        automatic=automatic,
        whole=work.outputs.whole,
    )
    check_markers(markers, recipe.table, automatic=automatic)
    return markers


STAGE = Stage(
    name="markers",
    version=1,
    title="painting the markers",
    deed="collect the painted markers",
    subject="",
    output="markers",
    kind=Markers,
    settings=_settings,
    compute=_compute,
    has_work=lambda recipe: recipe.segment.method == "watershed",
    is_kept=lambda _: False,
)
