"""JSON Schemas of the formats, for editors and for readers in other languages."""

from __future__ import annotations

import json

from heartcase.schemas.base import Model
from heartcase.schemas.bundle import ARRAYS, CaseManifest
from heartcase.schemas.labels import LabelTable
from heartcase.schemas.landmarks import Landmark
from heartcase.schemas.recipe import Recipe
from heartcase.schemas.script import SimulationScript

__all__ = ["SCHEMAS", "schema_files"]

SCHEMAS: dict[str, type[Model]] = {
    "recipe": Recipe,
    "label-table": LabelTable,
    "landmark": Landmark,
    "case-manifest": CaseManifest,
    "simulation-script": SimulationScript,
}
"""Name -> model of every format."""


def schema_files() -> dict[str, str]:
    """File name -> text of each JSON Schema, and of the table of the bundle's arrays."""
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
    return files
