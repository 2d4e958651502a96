"""The walls stage: distance fields of the structures, and walls grown outward from the cavities (thesis 11.2.3)."""

from __future__ import annotations

from typing import Any

from heartcase.pipeline.data import Structures
from heartcase.pipeline.stages.stage import Stage, Work, have, resolved_all
from heartcase.schemas.recipe.recipe import Recipe
from heartcase.schemas.recipe.settings import resolved

__all__ = ["STAGE"]


def _open_places(recipe: Recipe) -> Any:
    from heartcase.pipeline.walls.septa import open_places

    if recipe.walls_to_grow.septa != "grown":
        return ()
    return open_places(recipe.strokes, recipe.landmarks, recipe.table, recipe.walls.contact)


def _settings(work: Work) -> dict[str, Any]:
    walls = work.recipe.walls_to_grow
    settings: dict[str, Any] = resolved(walls) | {"ends": resolved_all(work.recipe.ends)}
    if not walls.find_ends:
        # a setting that came later: what does not use it keeps its records
        settings.pop("find_ends")
    # open ones are among the open places; the others change no wall
    settings.pop("contact")
    places = _open_places(work.recipe)
    if places:
        # not what a landmark is called, nor a stroke that opens nothing
        settings["open_places"] = [list(one) for one in places]
    return settings


def _compute(work: Work) -> Structures:
    from heartcase.pipeline.walls.grow_walls import grow_walls

    recipe = work.recipe
    labels = have(work.outputs.segmentation).get()
    return grow_walls(labels, recipe.walls_to_grow, recipe.ends, open_places=_open_places(recipe))


STAGE = Stage(
    name="walls",
    version=18,
    title="distance fields and walls",
    deed="grow the walls",
    subject="walls and outlines",
    output="grown",
    kind=Structures,
    settings=_settings,
    compute=_compute,
    inputs={"segmentation": "segmentation"},
    expected_seconds=6.0,
)
