"""Benchmarks: cases as data, results as records that anything can read."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field, ValidationError

from heartcase.schemas.base import Model
from heartcase.schemas.errors import UsageError, problems_from_validation

__all__ = ["BenchmarkCase", "BenchmarkRecord", "load_cases"]


class BenchmarkCase(Model):
    """One case: what is run, on what, by which methods. Its code is the module of the stage in benchmarks/."""

    name: Annotated[str, Field(pattern=r"^[a-z][a-z0-9.]*(-[a-z0-9.]+)*$")]
    """Unique; starts with the stage."""
    module: Annotated[str, Field(pattern=r"^[a-z_]+$")]
    """Module in benchmarks/ with ``prepare``, ``METHODS`` and ``errors``."""
    methods: Annotated[tuple[str, ...], Field(min_length=1)]
    """``heartcase`` for ours, the peer's own name for each peer."""
    repeats: Annotated[int, Field(ge=1, le=1000)] = 5
    """Timed runs after the warm-up; the median counts."""
    params: dict[str, Any] = {}
    """What ``prepare`` is given."""


class BenchmarkRecord(Model):
    """What one method reached on one case."""

    case: str
    """Name of the case."""
    method: str
    """Name of the method."""
    seconds: float
    """Median time of one run after warm-up, s."""
    errors: dict[str, float]
    """Name with unit -> value."""
    params: dict[str, Any]
    """Parameters of the case."""
    repeats: int
    """Timed runs."""
    peak_memory_mb: float | None
    """Largest resident memory of the process that ran it, inputs included, in MB; None where it is not known."""
    machine: str
    """Processor, cores, system and Python."""
    version: str
    """Version of heartcase."""


def load_cases(directory: Path) -> tuple[BenchmarkCase, ...]:
    """Read ``cases.toml`` of a benchmark directory.

    Raises
    ------
    UsageError
        It is not there or not valid.
    """
    try:
        data = tomllib.loads((directory / "cases.toml").read_text(encoding="utf-8"))
    except OSError:
        raise UsageError(
            "there is no cases.toml: run it in heartcase's repository, or name the directory with --dir", place="--dir"
        ) from None
    except tomllib.TOMLDecodeError as error:
        raise UsageError(f"is not valid TOML: {error}", place="cases.toml") from None
    try:
        return tuple(BenchmarkCase.model_validate(item) for item in data.get("case", []))
    except ValidationError as error:
        raise UsageError(problems_from_validation(error, place="cases.toml")) from None
