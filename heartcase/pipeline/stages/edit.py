"""The edit stage: septal defects made and closed, structures sculpted and cleaned of stray pieces."""

from __future__ import annotations

from typing import Any

from heartcase.pipeline.data import Structures
from heartcase.pipeline.stages.stage import Stage, Work, have

__all__ = ["STAGE"]


def _settings(work: Work) -> dict[str, Any]:
    # Not what an edit is called, nor those that are switched off; the stage names an edit by its number.
    return {
        "edits": [
            {"number": number} | edit.model_dump(mode="json", exclude={"name", "enabled"})
            for number, edit in enumerate(work.recipe.edits, start=1)
            if edit.enabled
        ]
    }


def _compute(work: Work) -> Structures:
    from heartcase.pipeline.edits.apply_edits import apply_edits
    from heartcase.pipeline.fields.reader import forget_layout

    grown = have(work.outputs.grown).get()
    edited = apply_edits(grown, work.recipe.edits)
    if edited is not grown:
        forget_layout(grown)  # nothing reads them any more
    return edited


STAGE = Stage(
    name="edit",
    version=5,
    title="editing",
    deed="make the edits",
    subject="",
    output="structures",
    kind=Structures,
    settings=_settings,
    compute=_compute,
    inputs={"structures": "grown"},
    has_work=lambda recipe: any(edit.enabled for edit in recipe.edits),
    passes_on="grown",
)
