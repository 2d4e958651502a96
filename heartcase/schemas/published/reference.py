"""Every setting of a file format as a page of tables, made from the models themselves."""

from __future__ import annotations

import re
import types
import typing
from collections.abc import Iterator
from enum import Enum
from typing import Any, Literal, get_args, get_origin

from annotated_types import Ge, Gt, Le, Lt, MaxLen, MinLen
from pydantic.fields import FieldInfo

from heartcase.schemas.base import Model, field_texts

__all__ = ["reference_page"]

_WORDS = {str: "text", int: "whole number", float: "number", bool: "true or false"}
_LIMITS = ((Ge, "ge", "at least"), (Gt, "gt", "above"), (Le, "le", "at most"), (Lt, "lt", "below"))


def reference_page(title: str, intro: str, model: type[Model]) -> str:
    """A Markdown page: one table per model that the format is made of, the outermost first.

    Parameters
    ----------
    title, intro
        What stands above the tables.
    model
        The format's outermost model.

    Returns
    -------
    str
        Markdown; the same text for the same models.
    """
    parts = [f"# {title}\n\n{intro}\n"]
    for inner, places in _models(model).items():
        name = "At the top of the file" if inner is model else f"`{inner.__name__}`: {', '.join(places)}"
        rows = [
            f"| `{key}` | {_type_words(one.annotation)}{_limits(one)} | {_default(one)} | {_meaning(inner, key)} |"
            for key, one in inner.model_fields.items()
        ]
        summary = (inner.__doc__ or "").strip().split("\n\n")[0].replace("\n", " ")
        parts.append(
            f"## {name}\n\n{summary}\n\n| key | holds | default | meaning |\n|---|---|---|---|\n" + "\n".join(rows)
        )
    return "\n\n".join(part.rstrip() for part in parts) + "\n"


def _models(model: type[Model]) -> dict[type[Model], list[str]]:
    """The model and all that its fields hold, in the order in which they are met, with the TOML tables they are in."""
    found: dict[type[Model], list[str]] = {model: []}
    waiting = [(model, "")]
    for outer, above in waiting:
        for key, field in outer.model_fields.items():
            origins = {get_origin(field.annotation), *(get_origin(part) for part in get_args(field.annotation))}
            for inner in _inner(field.annotation):
                path = f"{above}{key}" + (".NAME" if dict in origins else "")
                place = f"`[[{path}]]`" if tuple in origins else f"`[{path}]`"
                if inner not in found:
                    found[inner] = []
                    waiting.append((inner, f"{path}."))
                found[inner].append(place)
    return found


def _inner(annotation: Any) -> Iterator[type[Model]]:
    if isinstance(annotation, type) and issubclass(annotation, Model):
        yield annotation
    for part in get_args(annotation):
        if not isinstance(part, str):
            yield from _inner(part)


def _type_words(annotation: Any) -> str:
    origin, parts = get_origin(annotation), get_args(annotation)
    if origin is typing.Annotated:
        return _type_words(parts[0])
    if origin in (typing.Union, types.UnionType):
        return " or ".join(dict.fromkeys(_type_words(part) for part in parts if part is not type(None)))
    if origin is Literal:
        return " or ".join(f"`{_shown(part)}`" for part in parts)
    if origin is tuple:
        if len(parts) == 2 and parts[1] is Ellipsis:
            inner = _type_words(parts[0])
            return f"list of {inner}"
        return f"[{', '.join(_type_words(part) for part in parts)}]"
    if origin is dict:
        return f"table: {_type_words(parts[0])} = {_type_words(parts[1])}"
    if isinstance(annotation, type) and issubclass(annotation, Model):
        return f"`{annotation.__name__}`"
    if isinstance(annotation, type) and issubclass(annotation, Enum):
        return " or ".join(f'`"{member.value}"`' for member in annotation)
    return _WORDS.get(annotation, "value")


def _limits(field: FieldInfo) -> str:
    words = []
    for constraint in (*field.metadata, *_of_optional(field.annotation)):
        for kind, attribute, word in _LIMITS:
            if isinstance(constraint, kind):
                words.append(f"{word} {getattr(constraint, attribute):g}")
        if isinstance(constraint, MinLen) and _type_words(field.annotation) != "text":
            words.append(f"{constraint.min_length} or more")
        if isinstance(constraint, MaxLen):
            words.append(f"no longer than {constraint.max_length}")
    return f", {', '.join(words)}" if words else ""


def _of_optional(annotation: Any) -> Iterator[Any]:
    """Limits of a value that may be left out, which stand inside its type."""
    if get_origin(annotation) not in (typing.Union, types.UnionType):
        return
    held = [part for part in get_args(annotation) if part is not type(None)]
    if len(held) == 1 and get_origin(held[0]) is typing.Annotated:
        for inner in get_args(held[0])[1:]:
            yield from inner.metadata if isinstance(inner, FieldInfo) else (inner,)


def _default(field: FieldInfo) -> str:
    if field.is_required():
        return "**needed**"
    value = field.get_default(call_default_factory=True) if field.default_factory is None else None
    if value is None or value in ((), {}) or isinstance(value, Model):
        return "see there" if isinstance(value, Model) else ""
    return f"`{_shown(value)}`"


def _shown(value: Any) -> str:
    if isinstance(value, Enum):
        return f'"{value.value}"'
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return f'"{value}"'
    if isinstance(value, tuple):
        return f"[{', '.join(_shown(item) for item in value)}]"
    return f"{value:g}" if isinstance(value, float) else str(value)


def _meaning(model: type[Model], key: str) -> str:
    text = model.model_fields[key].description or field_texts(model).get(key, "")
    return re.sub(r"\s+", " ", text).replace("``", "`").replace("|", "\\|")
