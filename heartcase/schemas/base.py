"""What all schema models share: strict, immutable, numbers finite, true and false never as text."""

from __future__ import annotations

import ast
import inspect
import textwrap
from dataclasses import dataclass
from functools import cache
from itertools import pairwise
from typing import Annotated, Any, cast

from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    GetCoreSchemaHandler,
    GetJsonSchemaHandler,
    ValidationError,
    ValidatorFunctionWrapHandler,
)
from pydantic_core import CoreSchema, InitErrorDetails, PydanticCustomError, core_schema

__all__ = [
    "BladePoses",
    "CaseId",
    "Colour",
    "Direction",
    "JawAngle",
    "JawOpening",
    "LipLine",
    "Model",
    "Name",
    "OneOf",
    "Outline",
    "PadLimit",
    "PadStiffness",
    "PatchScale",
    "PointMm",
    "PositiveMm",
    "RestPoses",
    "RowPlaces",
    "Vector3",
    "field_texts",
]


def _make_booleans_strict(node: Any) -> None:
    """Mark every boolean of a core schema as strict, in place."""
    if isinstance(node, dict):
        if node.get("type") == "bool":
            node["strict"] = True
        inner = [value for key, value in node.items() if key not in ("default", "metadata")]
    else:
        inner = list(node) if isinstance(node, list | tuple) else []
    for value in inner:
        _make_booleans_strict(value)


@cache
def field_texts(model: type[BaseModel]) -> dict[str, str]:
    """Name of each field -> the docstring below it, inherited ones too; read from the source when somebody asks.

    pydantic would read the sources of all models when they are imported, which takes a third of the time for that.
    """
    texts: dict[str, str] = {}
    for base in reversed(model.__mro__):
        if not issubclass(base, BaseModel) or base is BaseModel:
            continue
        try:
            parsed = ast.parse(textwrap.dedent(inspect.getsource(base))).body[0]
        except (OSError, TypeError, SyntaxError):  # an installation without sources, or a class within a function
            continue
        body = cast("ast.ClassDef", parsed).body
        for field, text in pairwise(body):
            if (
                isinstance(field, ast.AnnAssign)
                and isinstance(field.target, ast.Name)
                and isinstance(text, ast.Expr)
                and isinstance(text.value, ast.Constant)
                and isinstance(text.value.value, str)
            ):
                texts[field.target.id] = inspect.cleandoc(text.value.value)
    return texts


class Model(BaseModel):
    """Base of the schema models: unknown keys refused, instances immutable, no NaN or infinity.

    A field that is true or false takes nothing else: ``"no"``, which pydantic would read as false, is refused.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    @classmethod
    def __get_pydantic_core_schema__(cls, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        """The schema that pydantic makes, with its booleans strict."""
        schema = handler(source)
        _make_booleans_strict(schema)
        return schema

    @classmethod
    def __get_pydantic_json_schema__(cls, core_schema: CoreSchema, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        """The schema that pydantic makes, with what the class says of its fields."""
        schema = handler(core_schema)
        properties = handler.resolve_ref_schema(schema).get("properties", {})
        for name, text in field_texts(cls).items():
            key = cls.model_fields[name].alias or name if name in cls.model_fields else ""
            if key in properties:
                properties[key].setdefault("description", text)
        return schema


@dataclass(frozen=True)
class OneOf:
    """Added to a type that has alternatives of different kinds: a value that is none is one mistake, in these words.

    pydantic would tell what is wrong with it as each of the alternatives, by the names that these have in the code.
    What is wrong within a table or a text is told as it is where one alternative is such a thing.
    """

    words: str
    """What the value must be, behind ``must be``."""

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        """The schema of the alternatives, with this around it."""
        return core_schema.no_info_wrap_validator_function(self._checked, handler(source))

    def _checked(self, value: Any, handler: ValidatorFunctionWrapHandler) -> Any:
        try:
            return handler(value)
        except ValidationError as error:
            details = error.errors(include_url=False)
        of_another_kind = {one["loc"][0] for one in details if len(one["loc"]) == 1 and one["type"] in _OTHER_KINDS}
        fitting = [one for one in details if one["loc"] and one["loc"][0] not in of_another_kind]
        if not isinstance(value, str | dict):
            fitting = [one for one in fitting if one["type"] == "value_error"]
        if not fitting:
            raise PydanticCustomError(_ONE_OF, "must be {words}", {"words": self.words})
        lines = [
            InitErrorDetails(
                type=PydanticCustomError(_ONE_OF, one["msg"]) if one["type"] == _ONE_OF else one["type"],
                loc=one["loc"][1:],
                input=one["input"],
                ctx=one.get("ctx", {}),
            )
            for one in fitting
        ]
        raise ValidationError.from_exception_data("alternatives", lines)


_ONE_OF = "one_of"
_OTHER_KINDS = ("string_type", "tuple_type", "model_type", "model_attributes_type", "bool_type", "float_type")
"""Types of errors that say that a value is of another kind than an alternative."""

Vector3 = tuple[float, float, float]
"""Three numbers, in the order x, y, z."""

PointMm = Annotated[Vector3, Field(description="Point in patient LPS space: x, y, z in mm.")]
"""A point (x, y, z) in patient LPS space, in mm."""


def _points_somewhere(vector: Vector3) -> Vector3:
    if not any(vector):
        raise ValueError("a direction needs three numbers that are not all zero")
    return vector


Direction = Annotated[
    Vector3, AfterValidator(_points_somewhere), Field(description="Direction in patient LPS space, of any length.")
]
"""A direction (x, y, z) in patient LPS space, of any length but zero."""

BladePoses = Annotated[
    tuple[Annotated[tuple[PointMm, ...], Field(min_length=2, max_length=4096)], ...],
    Field(min_length=2, max_length=4096, description="Points of a blade's edge at each of its poses."),
]
"""Points (x, y, z) of a blade at each pose, patient LPS space, mm."""

RestPoses = Annotated[
    tuple[Annotated[tuple[PointMm | None, ...], Field(min_length=2, max_length=4096)], ...],
    Field(
        min_length=2,
        max_length=4096,
        description="Points of a blade's edge at each of its poses; null where it met no tissue.",
    ),
]
"""Points (x, y, z) of a blade at each pose, in the tissue at rest, patient LPS space, mm; None where it met none."""

PositiveMm = Annotated[float, Field(gt=0.0, le=1000.0)]
"""A length in mm, above zero."""

Name = Annotated[str, Field(min_length=1, max_length=64, pattern=r"^[A-Za-z0-9][A-Za-z0-9 _.()+-]*$")]
"""A name of a label, a landmark or a case: letters, digits, space and ``_ . ( ) + -``."""

CaseId = Annotated[str, Field(pattern=r"^[A-Z0-9](-?[A-Z0-9]){2,31}$")]
"""A made-up identifier of a case: capital letters, digits and single hyphens. Nothing in it tells who was scanned."""

Colour = Annotated[str, Field(pattern=r"^#[0-9a-fA-F]{6}$", description="Colour as #rrggbb.")]
"""A colour as ``#rrggbb``."""

JawOpening = Annotated[float, Field(gt=0.0, le=90.0)]
"""Angle between fully open jaws, degrees."""

JawAngle = Annotated[float, Field(ge=0.0, le=90.0)]
"""Angle between jaws, degrees; 0 is closed."""

LipLine = Annotated[tuple[PointMm, ...], Field(min_length=2, max_length=4096)]
"""Points of a line along a lip."""

PadStiffness = Annotated[float, Field(gt=0.0, le=1000.0)]
"""Stiffness of pads, N/mm2."""

PadLimit = Annotated[float, Field(gt=0.0, le=1000.0)]
"""Pull along a line at which pads give way, N/mm."""

RowPlaces = Annotated[tuple[tuple[PointMm, PointMm], ...], Field(min_length=2, max_length=1000)]
"""Both places of each chosen stitch of a row."""

Outline = Annotated[tuple[PointMm, ...], Field(min_length=3, max_length=1000)]
"""Points of a closed outline."""

PatchScale = Annotated[float, Field(ge=0.25, le=4.0)]
"""Size of a patch over that of its outline laid out flat."""
