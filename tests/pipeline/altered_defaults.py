"""A later heartcase, in which every default of the recipe and every rule behind one is another."""

from __future__ import annotations

import contextlib
import typing
from collections.abc import Collection
from typing import Annotated, Any

from pydantic import TypeAdapter, ValidationError
from pydantic.fields import FieldInfo
from pydantic_core import PydanticUndefined

from heartcase.pipeline.cells import build_grid as grid
from heartcase.pipeline.stages import resolve
from heartcase.pipeline.walls import grow_walls as walls
from heartcase.schemas.base import Model
from heartcase.schemas.recipe.recipe import Recipe

_POINT = (0.0, 0.0, 1.0)
CANDIDATES: list[Any] = [
    *(True, False, 9, 200, 1.25, 0.5, 300, "CT", "x", "HC-AAAA", "#123456", "87878005", _POINT),
    {"x": "cavity"},
    [{"path": "x"}],
    [{"label": "cavity", "erase": False, "points_mm": [_POINT]}],
    [{"label": "cavity", "position_mm": _POINT, "axis": _POINT, "radius_mm": 2.0}],
    [{"kind": "keep_largest", "label": "cavity"}],
    [{"position_mm": _POINT, "radius_mm": 2.0}],
    [{"name": "x", "kind": "polyline", "points_mm": [_POINT, _POINT]}],
    [{"label": "cavity", "lower": 2.0}],
    [{"value": 3, "name": "cavity", "role": "blood"}],
    ["picking"],
    [9_000],
    ["lung"],
    {"center_mm": _POINT, "size_mm": (9.0, 9.0, 9.0)},
    {"cavity": {}},
    *("01.01.01", "LA88.0", "{S,D,S}", "MR", "child", 0.9, 3.0, [4.0], (2.5, 2.5, 2.5)),
    *("transposed", [{"kind": "secundum", "diameter_mm": 4.0}], {"diameter_mm": 11.0}, ["right atriotomy"]),
    {
        "modality": "MR",
        "is_specimen": False,
        "has_noise_texture": False,
        "streak_hu": 0.0,
        "slice_thickness_mm": None,
        "heart": {"great_arteries": "concordant", "aortic_override": 0.0, "baffle": None, "defects": []},
    },
    {"reference": "x", "scope": "x", "date": "2026-01-02"},
    {
        "origin": "patient",
        "licence": "x",
        "attribution": "x",
        "diagnoses": [{"name": "x"}],
        "texts": {"en": {"title": "x", "what": "x", "look_for": "x"}},
    },
    *("hvsmr-2.0", "none", "threshold", "xatlas", "exact", "ignore", "slit", "earlier", "as segmented"),
    "infant myocardium",
    (1, 2),
    [["cavity", "myocardium"]],
    [{"between": ["cavity", "myocardium"], "position_mm": _POINT, "radius_mm": 2.0, "is_open": False}],
    [{"between": ["cavity", "myocardium"], "thickness_mm": 1.0}],
    [{"label": "cavity", "kind": "positions", "points_mm": [_POINT], "thickness_mm": [1.0]}],
]
"""Values, one of which is allowed and not the default, for every setting; add one where a new setting needs it."""


def models_in(model: type[Model]) -> list[type[Model]]:
    """Model classes that a model holds, the inner ones first, itself last."""
    found: list[type[Model]] = []

    def look(annotation: Any) -> None:
        if isinstance(annotation, type) and issubclass(annotation, Model):
            for field in annotation.model_fields.values():
                look(field.annotation)
            if annotation not in found:
                found.append(annotation)
        for inner in typing.get_args(annotation):
            look(inner)

    look(model)
    return found


def another_default(cls: type[Model], name: str, field: FieldInfo) -> Any:
    """A value that the setting may have and that is not its default."""
    if isinstance(field.default, Model):
        return type(field.default).model_construct()
    old = field.get_default(call_default_factory=True)
    adapter = TypeAdapter(Annotated[field.annotation, *field.metadata] if field.metadata else field.annotation)
    for candidate in CANDIDATES:
        with contextlib.suppress(ValidationError, TypeError):
            value = adapter.validate_python(candidate, strict=isinstance(candidate, bool))
            if value is not None and value != old and repr(value) != repr(old):
                return value
    raise AssertionError(f"CANDIDATES holds no other value for {cls.__name__}.{name}")


@contextlib.contextmanager
def altered_defaults(monkeypatch, *, only: Collection[str] = ()):
    """Every default and rule is another one within the block, or those of some classes only; yields how many."""
    classes = [cls for cls in models_in(Recipe) if cls.__name__ != "RecipeLock"]
    kept = []
    try:
        for cls in classes:
            for name, field in cls.model_fields.items():
                if field.default is PydanticUndefined and field.default_factory is None:
                    continue
                is_table = isinstance(field.default, Model)
                if name == "lock" or (only and cls.__name__ not in only and not is_table):
                    continue
                kept.append((field, field.default, field.default_factory))
                other = another_default(cls, name, field)
                field.default, field.default_factory = other, None
            cls.model_rebuild(force=True)
        with monkeypatch.context() as patch:
            if only:
                yield len(kept)
                return
            patch.setattr(walls, "default_smoothing_mm", lambda spacing: 9.875)
            patch.setattr(walls, "BAND_VOXELS", 17.0)
            patch.setattr(grid, "DEFAULT_NODE_COUNT", 11)
            patch.setattr(resolve, "made_up_case_id", lambda name, sha256: "HC-BBBB")
            yield len(kept)
    finally:
        for field, default, factory in kept:
            field.default, field.default_factory = default, factory
        for cls in classes:
            cls.model_rebuild(force=True)
