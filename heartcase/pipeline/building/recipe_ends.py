"""Finding the vessel ends of a recipe's scan, for ``heartcase suggest --ends`` and for the lock."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

from heartcase.pipeline.artifacts.cache import Cache
from heartcase.pipeline.building.runner import BuildListener, Runner, SilentListener, run_stages
from heartcase.pipeline.building.session_file import write_with_tables
from heartcase.pipeline.data import Segmentation, VesselEnd
from heartcase.pipeline.stages.stage import Work, have
from heartcase.pipeline.vessel_ends.cut_ends import cut_ends
from heartcase.pipeline.vessel_ends.discs import Stumps, end_marker
from heartcase.pipeline.vessel_ends.find_ends import find_ends
from heartcase.schemas.errors import Problem, RecipeError, StageError
from heartcase.schemas.labels import LabelTable
from heartcase.schemas.recipe.recipe import Recipe, parse_recipe, read_recipe_text
from heartcase.schemas.recipe.resolved import ResolvedRecipe
from heartcase.schemas.toml import toml_text

__all__ = ["ProposedEnds", "ends_at_locking", "propose_ends"]


_FIRST_TABLE = re.compile(r"(.*?)((?:^[ \t]*\[|\Z))(.*)", re.S | re.M)
_AUTOMATIC_ENDS = re.compile(r"""^[ \t]*ends[ \t]*=[ \t]*(["'])automatic\1[ \t]*(?:\#[^\n]*)?(?:\n|\Z)""", re.M)


@dataclass(frozen=True)
class ProposedEnds:
    """Ends that a recipe does not cut yet. Made by :func:`propose_ends`."""

    path: Path
    """The recipe's file."""
    text: str
    """Its text as it was read."""
    recipe: Recipe
    """What it says."""
    ends: tuple[VesselEnd, ...]
    """Discs to cut at, and lumens that are open at a face already."""
    dropped: tuple[str, ...]
    """Branches that end without a place for a disc, in plain words."""
    problems: tuple[Problem, ...]
    """What is wrong with the ends that the recipe has."""

    @property
    def toml(self) -> str:
        """The discs as ``[[ends]]`` tables; empty where there are none."""
        tables = [end_marker(end).model_dump(mode="json") for end in self.ends if not end.is_open]
        return toml_text({"ends": tables}) if tables else ""

    def save(self) -> int:
        """Write the discs at the end of the recipe, the rest of which stays to the letter; how many they are.

        Only a line ``ends = "automatic"`` goes, which leaves no room for tables: what it asked for is written down.

        Raises
        ------
        RecipeError
            Another program changed the file meanwhile, its ends are one array, which cannot be added to, or the file
            cannot be written.
        """
        if not self.toml:
            return 0
        if read_recipe_text(self.path) != self.text:
            raise RecipeError("the recipe was changed by another program meanwhile: try again", place="recipe")
        advice = "write its ends as [[ends]] tables instead of ends = [...]"
        addition = f"\n# Vessel ends that were found.\n{self.toml}"
        write_with_tables(self.path, _without_automatic_ends(self.text), addition, place="ends", advice=advice)
        return sum(not end.is_open for end in self.ends)


def _without_automatic_ends(text: str) -> str:
    """A recipe's text without a line ``ends = "automatic"``, which stands before its first table."""
    top, header, rest = _FIRST_TABLE.match(text).groups()  # type: ignore[union-attr]
    return _AUTOMATIC_ENDS.sub("", top, count=1) + header + rest


def propose_ends(
    path: Path, *, out: Path, cache: Path | None = None, listener: BuildListener | None = None
) -> ProposedEnds:
    """Find the ends of a recipe's vessels that none of its own cuts.

    Parameters
    ----------
    path
        The recipe's file.
    out
        Directory that the case is built in.
    cache
        Directory of the cache; ``out/.heartcase-cache`` when left out.
    listener
        Told of progress.

    Raises
    ------
    HeartcaseError
        A problem with the recipe, the scan or the markers.
    """
    text = read_recipe_text(path)
    recipe = parse_recipe(text)
    segmentation, resolved = _segmented(recipe, path.parent, Cache(cache or out / ".heartcase-cache"), listener)
    table, stumps = _stumps(segmentation, resolved)
    problems: tuple[Problem, ...] = ()
    try:
        known = cut_ends(segmentation, table, recipe.ends, stumps).ends
    except StageError as error:
        known, problems = recipe.ends, error.problems
    found = find_ends(segmentation, table, stumps, known=known)
    return ProposedEnds(path, text, recipe, found.ends, found.dropped, problems)


def ends_at_locking(recipe: Recipe, directory: Path, cache: Path) -> tuple[VesselEnd, ...]:
    """The ends that a build of a recipe with ``walls.find_ends`` finds beside those that it states.

    Parameters
    ----------
    recipe
        The recipe.
    directory
        Where its relative paths start.
    cache
        Directory for what the stages make on the way.

    Raises
    ------
    HeartcaseError
        A problem with the scan, the markers or the stated ends.
    """
    segmentation, resolved = _segmented(recipe, directory, Cache(cache), None)
    table, stumps = _stumps(segmentation, resolved)
    cut = cut_ends(segmentation, table, recipe.ends, stumps, find=True)
    return tuple(end for end in cut.vessel_ends if end.found == "found" and not end.is_open)


def _segmented(
    recipe: Recipe, directory: Path, cache: Cache, listener: BuildListener | None
) -> tuple[Segmentation, ResolvedRecipe]:
    """The segmentation of a build, and the recipe with everything resolved."""
    runner, work = Runner(cache, listener or SilentListener(), force=False), Work(recipe, directory, cache=cache)

    def after(stage: str) -> None:
        if stage == "read":
            work.resolve()

    run_stages(runner, work, until="segment", after=after)
    return have(work.outputs.segmentation).get(), work.resolve()


def _stumps(segmentation: Segmentation, resolved: ResolvedRecipe) -> tuple[LabelTable, Stumps]:
    table = segmentation.table.with_walls()
    return table, Stumps.of(resolved.walls, table, segmentation.geometry.spacing_mm)
