"""The bundle stage: the outputs put together to a case, with its figures and warnings."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from heartcase import __version__
from heartcase.pipeline.stages.stage import Stage, Work, have
from heartcase.schemas.recipe.recipe import Part

if TYPE_CHECKING:
    from heartcase.pipeline.bundle.assembly import AssembledCase

__all__ = ["STAGE"]


def _settings(work: Work) -> dict[str, Any]:
    return {
        "software": __version__,
        "lock": [warning.text for warning in work.told.get("lock", ())],
        # The report tells what was done by hand, so all of the recipe counts, but no path of it.
        "recipe": work.recipe.model_dump(
            mode="json",
            exclude={"scan": {"path", "series", "origin"}, "markers": {"__all__": {"path"}}, "segment": {"file"}},
        ),
        "records": [record.model_dump(mode="json") for record in work.records],
    }


def _compute(work: Work) -> AssembledCase:
    from heartcase.pipeline.bundle.assembly import StageResults, assemble_case, told_of_ends, told_of_outlines

    recipe, outputs = work.recipe, work.outputs
    scan, structures = have(outputs.scan).get(), have(outputs.structures).get()
    segmentation = have(outputs.segmentation).get()
    markers = outputs.markers.get() if outputs.markers else None
    told = told_of_outlines(recipe, segmentation, markers, scan) | told_of_ends(recipe, segmentation, structures)
    results = StageResults(
        scan=scan,
        grid=have(outputs.grid).get(),
        structures=structures,
        surface=outputs.surface.get() if outputs.surface else None,
        grid_map=outputs.grid_map.get() if outputs.grid_map else None,
        filtered=have(outputs.filtered).get() if Part.SCAN in recipe.parts else None,
        whole=outputs.whole,
        stages=work.records,
        told=told | work.told,
        begun=work.begun,
    )
    return assemble_case(recipe, results, name=recipe.name, case_id=recipe.case_id)


STAGE: Stage[Any] = Stage(
    name="bundle",
    version=9,
    title="writing the case",
    deed="write the case",
    subject="",
    output="assembled",
    kind=object,  # an AssembledCase, which nothing has to tell from others: the cache does not keep it
    settings=_settings,
    compute=_compute,
    expected_seconds=2.0,
    is_kept=lambda _: False,
)
