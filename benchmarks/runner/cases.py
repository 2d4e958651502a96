"""Benchmarks: cases as data, results as records that anything can read."""

from __future__ import annotations

import itertools
import re
import tomllib
from collections import Counter
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field, ValidationError, model_validator

from heartcase.schemas.base import Model
from heartcase.schemas.errors import Problem, UsageError, problems_from_validation

__all__ = ["BenchmarkCase", "BenchmarkRecord", "MethodSkipped", "load_cases"]


class MethodSkipped(UsageError):
    """A method cannot run here or would take too long: its case goes on without it, and says why."""


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
    sweep: dict[str, Annotated[tuple[Any, ...], Field(min_length=1)]] = {}
    """Further parameters with the values that each takes in turn: one case for each combination, the last the
    fastest. They are measured in one process per method, and their error is drawn against the last parameter."""
    group: str | None = None
    """Name of the entry that a case of a sweep comes from; not to be given."""

    @model_validator(mode="after")
    def _one_value_each(self) -> BenchmarkCase:
        twice = sorted(set(self.sweep) & set(self.params))
        if twice:
            raise ValueError(f"{', '.join(twice)} stands in params and in sweep: give it once")
        return self

    def expanded(self) -> tuple[BenchmarkCase, ...]:
        """One case for each combination of the sweep; the case itself where it has none."""
        if not self.sweep:
            return (self,)
        cases = []
        for values in itertools.product(*self.sweep.values()):
            chosen = dict(zip(self.sweep, values, strict=True))
            name = "-".join([self.name, *(_word(f"{key}{value}") for key, value in chosen.items())])
            update = {"name": name, "params": self.params | chosen, "group": self.name}
            cases.append(self.model_copy(update=update))
        return tuple(cases)


def _word(text: str) -> str:
    return re.sub(r"[^a-z0-9.]", "", text.lower())


class BenchmarkRecord(Model):
    """What one method reached on one case."""

    case: str
    """Name of the case."""
    group: str | None = None
    """Name of the sweep that the case is part of."""
    swept: tuple[str, ...] = ()
    """Parameters that the sweep varies, the fastest last."""
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
    """Largest resident memory of the process that ran it, inputs included, in MB; None where it is not known. In a
    sweep, of all its cases up to this one."""
    machine: str
    """Processor, cores, system and Python."""
    version: str
    """Version of heartcase."""


def load_cases(directory: Path) -> tuple[BenchmarkCase, ...]:
    """Read ``cases.toml`` of a benchmark directory: every case, with the sweeps written out.

    Raises
    ------
    UsageError
        It is not there, not valid, or names a case twice.
    """
    try:
        data = tomllib.loads((directory / "cases.toml").read_text(encoding="utf-8"))
    except OSError:
        raise UsageError("there is no cases.toml in the folder", place="--dir") from None
    except tomllib.TOMLDecodeError as error:
        raise UsageError(f"is not valid TOML: {error}", place="cases.toml") from None
    try:
        entries = [BenchmarkCase.model_validate(item) for item in data.get("case", [])]
    except ValidationError as error:
        raise UsageError(problems_from_validation(error, place="cases.toml")) from None
    cases = tuple(case for entry in entries for case in entry.expanded())
    twice = [name for name, count in Counter(case.name for case in cases).items() if count > 1]
    if twice:
        raise UsageError(
            [Problem("cases.toml", f"{name} is there more than once: name it otherwise") for name in twice]
        )
    return cases
