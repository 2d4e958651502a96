"""JSON Schemas of the formats, for editors and for readers in other languages."""

from __future__ import annotations

import json

from heartcase.schemas.base import Model
from heartcase.schemas.bundle.format import ARRAYS, CaseManifest
from heartcase.schemas.labels import LabelTable
from heartcase.schemas.landmarks import Landmark
from heartcase.schemas.published.reference import reference_page
from heartcase.schemas.recipe.recipe import Recipe
from heartcase.schemas.recording.commands import Entry
from heartcase.schemas.recording.header import RecordingHeader
from heartcase.schemas.scripts.incision_plans import IncisionPlans
from heartcase.schemas.scripts.script import SimulationScript

__all__ = ["SCHEMAS", "schema_files"]

SCHEMAS: dict[str, type[Model]] = {
    "recipe": Recipe,
    "label-table": LabelTable,
    "landmark": Landmark,
    "case-manifest": CaseManifest,
    "simulation-script": SimulationScript,
    "recording-header": RecordingHeader,
    "session-entry": Entry,
    "incision-plans": IncisionPlans,
}
"""Name -> model of every format."""

_MADE = "Made from the code by `heartcase schema --out docs/schemas`."
_REFERENCES = {
    "recipe": ("Every setting of a recipe", f"`docs/recipe.md` says how to use them. {_MADE}"),
    "simulation-script": ("Every setting of a simulation script", f"What hands do in `heartcase simulate`. {_MADE}"),
    "incision-plans": (
        "Every setting of a file of incision plans",
        f"`docs/incisions.md` says what it is for. {_MADE}",
    ),
}
"""Name of a format -> title and introduction of its page of tables."""


def schema_files() -> dict[str, str]:
    """File name -> text of each JSON Schema, of the pages of settings, and of the table of the bundle's arrays."""
    files = {
        f"{name}.schema.json": json.dumps(
            {"$schema": "https://json-schema.org/draft/2020-12/schema", **model.model_json_schema()},
            indent=2,
            sort_keys=True,
        )
        + "\n"
        for name, model in SCHEMAS.items()
    }
    arrays = {
        role.value: [vars(spec) | {"shape": list(spec.shape)} for spec in specs] for role, specs in ARRAYS.items()
    }
    files["bundle-arrays.json"] = json.dumps(arrays, indent=2, sort_keys=True) + "\n"
    for name, (title, intro) in _REFERENCES.items():
        files[f"{name}-reference.md"] = reference_page(title, intro, SCHEMAS[name])
    return files
