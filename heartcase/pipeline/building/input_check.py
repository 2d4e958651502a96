"""Checks of a recipe's scan, markers and finished segmentation that a build would make, before anything long runs."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from heartcase.pipeline.data import Scan
from heartcase.pipeline.markers.placeholders import placeholder_problems
from heartcase.pipeline.stages.markers import stroke_problems
from heartcase.pipeline.stages.read import whole_scan
from heartcase.pipeline.warnings import CaseWarning, worst_first
from heartcase.schemas.errors import HeartcaseError, Problem
from heartcase.schemas.geometry import Geometry
from heartcase.schemas.recipe.recipe import Recipe

__all__ = ["InputFindings", "check_inputs", "modality_warnings"]


@dataclass(frozen=True)
class InputFindings:
    """What is wrong with the inputs of a recipe, and what is to be known of them."""

    problems: tuple[Problem, ...] = ()
    """Why a build would refuse."""
    warnings: tuple[CaseWarning, ...] = ()
    """What overlaps, is cut off or was assumed, the worst first."""


def check_inputs(recipe: Recipe, directory: Path) -> InputFindings:
    """Read what a recipe names, as a build does, and say what it finds.

    Files that are not there are no finding here (:meth:`heartcase.schemas.recipe.recipe.Recipe.missing_files`), nor is
    a scan that building makes. Without the scan only what is sure without it is said.

    Parameters
    ----------
    recipe
        The recipe.
    directory
        Where its relative paths start.
    """
    problems: list[Problem] = []
    whole, cut = None, None
    if (directory / recipe.scan.path).exists():
        try:
            whole, cut = _scan(recipe, directory)
        except HeartcaseError as error:
            problems += error.problems
    examples = placeholder_problems(recipe, None if whole is None else whole.geometry)
    # Where examples stand for strokes, what the strokes lack follows from that.
    lacking = () if any(one.place.startswith("strokes") for one in examples) else stroke_problems(recipe)
    problems = [*examples, *lacking, *problems]
    if cut is None or whole is None or any(not (directory / path).exists() for _, path in recipe.input_files):
        return InputFindings(tuple(problems))
    try:
        warnings = _told(recipe, directory, cut, whole.geometry)
    except HeartcaseError as error:
        return InputFindings((*problems, *error.problems))
    return InputFindings(tuple(problems), worst_first((*warnings, *modality_warnings(whole))))


def modality_warnings(scan: Scan) -> tuple[CaseWarning, ...]:
    """What is to be said where nobody says what kind of scan it is, which settings are found by."""
    if scan.modality in ("CT", "MR"):
        return ()
    message = (
        'whether it is a CT or an MR is stated neither by the scan nor by the recipe: write modality = "CT" or '
        '"MR" under [scan]; without that it is treated as an MR'
    )
    return (CaseWarning(f"scan.modality: {message}"),)


def _scan(recipe: Recipe, directory: Path) -> tuple[Scan, Scan]:
    from heartcase.pipeline.image.region import crop_scan

    whole = whole_scan(recipe, directory)
    return whole, crop_scan(whole, recipe.region)


def _told(recipe: Recipe, directory: Path, scan: Scan, whole: Geometry) -> tuple[CaseWarning, ...]:
    """Warnings of the markers or of the finished segmentation.

    Raises
    ------
    MarkerError
        What a build would refuse of them.
    """
    from heartcase.pipeline.markers.load_markers import check_markers, load_markers, load_segmentation

    segment = recipe.segment
    if segment.finished_file is not None:
        return load_segmentation(
            directory / segment.finished_file,
            segment.names,
            recipe.table,
            scan.geometry,
            convention=segment.convention,
            others=segment.others,
            order=segment.order,
        ).warnings
    if segment.method != "watershed":
        return ()
    painted = load_markers(recipe.markers, recipe.strokes, recipe.table, scan.geometry, directory, whole=whole)
    # what strokes alone mark is known without the scan, and what the program marks by itself takes long
    if recipe.markers and not segment.automatic:
        check_markers(painted, recipe.table)
    return painted.warnings
