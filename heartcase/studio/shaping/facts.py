"""What the recipe's schema allows, as plain data: a page builds its forms from it."""

from __future__ import annotations

from typing import Any

from heartcase.schemas.base import Model
from heartcase.schemas.labels import Role, default_label_table, further_labels
from heartcase.schemas.landmarks import Landmark
from heartcase.schemas.recipe.edit_settings import (
    CloseDefect,
    Fill,
    KeepLargest,
    RemoveIslands,
    Sculpt,
    SeptalDefect,
    Smooth,
)
from heartcase.schemas.recipe.named_materials import MATERIALS
from heartcase.schemas.recipe.settings import (
    ContactPlace,
    EndMarker,
    GridSettings,
    MaterialSettings,
    Pin,
    SeptumThickness,
    SurfaceSettings,
    WallsSettings,
    WallThickness,
)

__all__ = ["LINES", "SETTINGS", "shaping_facts"]

LINES: dict[str, dict[str, type[Model]]] = {
    "ends": {"": EndMarker},
    "edits": {
        "septal_defect": SeptalDefect,
        "close_defect": CloseDefect,
        "add": Sculpt,
        "remove": Sculpt,
        "smooth": Smooth,
        "fill": Fill,
        "keep_largest": KeepLargest,
        "remove_islands": RemoveIslands,
    },
    "landmarks": {"point": Landmark, "ring": Landmark, "polyline": Landmark},
    "pins": {"": Pin},
    "walls.thickness": {"centreline": WallThickness, "positions": WallThickness},
    "walls.septum": {"": SeptumThickness},
    "walls.contact": {"": ContactPlace},
}
"""List of the recipe -> kind of line -> what such a line says; no kind where all are alike."""

SETTINGS: dict[str, tuple[type[Model], tuple[str, ...]]] = {
    "walls": (WallsSettings, ("find_ends", "septa", "smoothing_mm")),
    "materials": (MaterialSettings, ("material", "youngs_modulus_kpa", "density_kg_m3")),
    "grid": (GridSettings, ("node_count", "cell_mm")),
    "surface": (SurfaceSettings, ("triangle_count", "error_mm", "normal_map_size")),
}
"""Table of the recipe -> its model, and which of its settings a page changes."""

_UNITS = {"_mm": "mm", "_ml": "ml", "_kpa": "kPa", "_kg_m3": "kg/m3"}
_TYPES = {
    "label": "structure",
    "into": "structure",
    "only_from": "structures",
    "between": "structures",
    "position_mm": "point",
    "points_mm": "points",
    "axis": "direction",
    "long_axis": "direction",
}
_FOREIGN = {
    "add": {"into"},
    "remove": {"only_from"},
    "point": {"axis", "radius_mm", "depth_mm"},
    "ring": {"depth_mm"},
    "polyline": {"axis"},
}
"""Kind of line -> what only another kind of the same model says."""


def shaping_facts() -> dict[str, Any]:
    """What may be said where: fields with their types, units, limits, defaults and meaning."""
    return {
        "lines": {
            name: {
                kind: [field for field in _fields(model) if field["name"] not in {"kind", *_FOREIGN.get(kind, ())}]
                for kind, model in kinds.items()
            }
            for name, kinds in LINES.items()
        },
        "settings": {
            name: [field for field in _fields(model) if field["name"] in keys]
            for name, (model, keys) in SETTINGS.items()
        },
        "materials": {name: {"ratio": one.ratio, "basis": one.basis} for name, one in MATERIALS.items()},
        "new_labels": [
            {
                "name": label.name,
                "role": label.role.value,
                "colour": label.colour,
                "wall_thickness_mm": label.wall_thickness_mm,
            }
            for label in (*default_label_table(), *further_labels())
            if label.role is not Role.BACKGROUND
        ],
        "roles": [role.value for role in Role if role is not Role.BACKGROUND],
        "usual_wall_mm": {
            label.term.name: label.wall_thickness_mm for label in default_label_table() if label.term is not None
        },
    }


def _fields(model: type[Model]) -> list[dict[str, Any]]:
    schema = model.model_json_schema()
    needed = set(schema.get("required", ()))
    return [_field(name, one, name in needed) for name, one in schema["properties"].items()]


def _field(name: str, schema: dict[str, Any], is_needed: bool) -> dict[str, Any]:
    parts = [schema, *schema.get("anyOf", ())]
    stated: dict[str, Any] = next((one for one in parts if one.get("type") not in (None, "null") or "enum" in one), {})
    found: dict[str, Any] = {"name": name, "type": _TYPES.get(name), "needed": is_needed}
    if found["type"] is None:
        found["type"] = "choice" if "enum" in stated else stated.get("type", "text").replace("string", "text")
    if found["type"] == "choice":
        found["choices"] = stated["enum"]
    for key in ("minimum", "exclusiveMinimum", "maximum", "maxLength"):
        if key in stated:
            found[key] = stated[key]
    if schema.get("default") is not None:
        found["default"] = schema["default"]
    unit = next((unit for ending, unit in _UNITS.items() if name.endswith(ending)), None)
    if unit is not None:
        found["unit"] = unit
    found["meaning"] = schema.get("description", "").replace("``", "").replace("\n", " ")
    return found
