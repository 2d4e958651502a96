"""Stage outputs as bytes and back: what the cache keeps and what the stage commands hand on.

One safetensors file per output: its arrays, and the rest as JSON in the file's metadata. The same output gives the
same bytes, so their hash names it. What a stage command writes also has a history: how it came about, and what was told
on the way. The cache keeps none, as a build remembers it.
"""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt
from pydantic import TypeAdapter
from safetensors import SafetensorError
from safetensors.numpy import load as load_safetensors
from safetensors.numpy import save as save_safetensors

from heartcase.pipeline.warnings import CaseWarning, warning_from_json, warning_to_json
from heartcase.schemas.bundle.format import StageRecord
from heartcase.schemas.errors import StageError
from heartcase.schemas.geometry import Geometry
from heartcase.schemas.labels import LabelTable

__all__ = ["History", "artifact_from_bytes", "artifact_to_bytes", "load_artifact", "load_history"]

T = TypeVar("T")

_MODELS: dict[str, type] = {"geometry": Geometry, "table": LabelTable}


@dataclass(frozen=True)
class History:
    """How a stage's output came about, for the stages after it: a case made of them knows what a build knows."""

    stages: tuple[StageRecord, ...] = ()
    """Records of the stages up to this one, in the order of the stages."""
    told: Mapping[str, tuple[CaseWarning, ...]] = field(default_factory=dict)
    """What was told on the way, by what it is about (:data:`heartcase.pipeline.bundle.assembly.SOURCES`)."""
    whole: Geometry | None = None
    """Lattice of the scan before its region of interest was cut out; None where it is not known."""

    def after(
        self,
        stages: Iterable[StageRecord],
        told: Mapping[str, tuple[CaseWarning, ...]],
        *,
        whole: Geometry | None = None,
    ) -> History:
        """The history with further stages, and what was told of them."""
        return History((*self.stages, *stages), {**self.told, **told}, self.whole if whole is None else whole)

    def as_json(self) -> str:
        """As text."""
        return json.dumps(
            {
                "stages": [record.model_dump(mode="json") for record in self.stages],
                "told": {source: [warning_to_json(line) for line in lines] for source, lines in self.told.items()},
                "whole": None if self.whole is None else self.whole.model_dump(mode="json"),
            },
            sort_keys=True,
            allow_nan=False,
        )

    @classmethod
    def from_json(cls, text: str) -> History:
        """What :meth:`as_json` made, back.

        Raises
        ------
        ValueError, KeyError, TypeError, AttributeError
            It is none.
        """
        data = json.loads(text)
        return cls(
            tuple(StageRecord.model_validate(record) for record in data["stages"]),
            {str(source): tuple(warning_from_json(line) for line in lines) for source, lines in data["told"].items()},
            None if data["whole"] is None else TypeAdapter(Geometry).validate_json(json.dumps(data["whole"])),
        )


def artifact_to_bytes(artifact: Any, history: History | None = None) -> bytes:
    """Serialise a stage's output; equal outputs, with equal histories or none, give equal bytes."""
    arrays: dict[str, npt.NDArray[Any]] = {}
    rest = _taken_apart(artifact, "", arrays)
    metadata = {"artifact": type(artifact).__name__, "fields": json.dumps(rest, sort_keys=True, allow_nan=False)}
    if history is not None:
        metadata["history"] = history.as_json()
    # The library writes metadata in hash order, so one key alone keeps the bytes the same from run to run.
    return save_safetensors(arrays, {"heartcase": json.dumps(metadata, sort_keys=True)})


def _taken_apart(artifact: Any, prefix: str, arrays: dict[str, npt.NDArray[Any]]) -> dict[str, Any]:
    """The fields that are no arrays, ready for JSON; arrays go to ``arrays``, under their path in the artifact."""
    rest: dict[str, Any] = {}
    for item in dataclasses.fields(artifact):
        value = getattr(artifact, item.name)
        place = prefix + item.name
        if not item.metadata.get("is_kept_when_empty", True) and not value:
            continue  # a field that came later: what does not use it keeps its hash
        if isinstance(value, np.ndarray):
            arrays[place] = np.ascontiguousarray(value)
        elif isinstance(value, dict) and value and all(isinstance(v, np.ndarray) for v in value.values()):
            rest[item.name] = {"keys": sorted(value)}
            for key in sorted(value):
                arrays[f"{place}/{key}"] = np.ascontiguousarray(value[key])
        elif item.metadata.get("of_its_own_kind", False):
            rest[item.name] = [_taken_apart(one, f"{place}/{n}/", arrays) for n, one in enumerate(value)]
        elif item.name in _MODELS:
            rest[item.name] = value.model_dump(mode="json")
        elif item.name == "warnings":
            rest[item.name] = [warning_to_json(warning) for warning in value]
        else:
            rest[item.name] = value
    return rest


def artifact_from_bytes(content: bytes, expected: type[T]) -> T:
    """Read back what :func:`artifact_to_bytes` wrote.

    Raises
    ------
    StageError
        The bytes are damaged, or hold the output of another stage.
    """
    try:
        metadata = _metadata(content)
        found, rest = str(metadata["artifact"]), dict(json.loads(metadata["fields"]))
        arrays = load_safetensors(content)
    except (ValueError, KeyError, TypeError, SafetensorError):
        raise StageError("the file is not the output of a stage, or it is damaged", place="input") from None
    if found != expected.__name__:
        raise StageError(f"holds a {found}, but a {expected.__name__} is needed", place="input")
    try:
        return _put_together(expected, rest, "", arrays)
    except (KeyError, TypeError, ValueError):
        raise StageError("was written by another version: run the stage again", place="input") from None


def _metadata(content: bytes) -> dict[str, Any]:
    length = int.from_bytes(content[:8], "little")
    return dict(json.loads(json.loads(content[8 : 8 + length])["__metadata__"]["heartcase"]))


def _put_together(expected: type[T], rest: dict[str, Any], prefix: str, arrays: dict[str, npt.NDArray[Any]]) -> T:
    """The reverse of :func:`_taken_apart`."""
    values: dict[str, Any] = {}
    for item in dataclasses.fields(expected):  # type: ignore[arg-type]
        place = prefix + item.name
        if place in arrays:
            values[item.name] = arrays[place]
        elif item.name in rest and isinstance(rest[item.name], dict) and set(rest[item.name]) == {"keys"}:
            values[item.name] = {key: arrays[f"{place}/{key}"] for key in rest[item.name]["keys"]}
        elif not item.metadata.get("is_kept_when_empty", True) and item.name not in rest:
            continue
        elif item.metadata.get("of_its_own_kind", False):
            inner = enumerate(rest[item.name])
            values[item.name] = tuple(_put_together(expected, one, f"{place}/{n}/", arrays) for n, one in inner)
        elif item.name in _MODELS:
            values[item.name] = TypeAdapter(_MODELS[item.name]).validate_json(json.dumps(rest[item.name]))
        elif item.name == "warnings":
            values[item.name] = tuple(warning_from_json(warning) for warning in rest[item.name])
        else:
            values[item.name] = _as_tuples(rest[item.name]) if item.name != "quality" else rest[item.name]
    return expected(**values)


def _as_tuples(value: Any) -> Any:
    """Lists become tuples again, as the frozen dataclasses hold them."""
    return tuple(_as_tuples(item) for item in value) if isinstance(value, list) else value


def load_artifact(path: Path | str, expected: type[T]) -> T:
    """Read a stage's output from a file.

    Raises
    ------
    StageError
        There is no such file, or it is not that output.
    """
    try:
        content = Path(path).read_bytes()
    except OSError:
        raise StageError("the file cannot be read: check the path", place="input") from None
    return artifact_from_bytes(content, expected)


def load_history(path: Path | str) -> History | None:
    """How the stage's output in a file came about; None where the file does not say it.

    Raises
    ------
    StageError
        There is no such file, or it is no output of a stage.
    """
    try:
        metadata = _metadata(Path(path).read_bytes())
        return History.from_json(metadata["history"]) if "history" in metadata else None
    except OSError:
        raise StageError("the file cannot be read: check the path", place="input") from None
    except (ValueError, KeyError, TypeError, AttributeError):
        raise StageError("the file is not the output of a stage, or it is damaged", place="input") from None
