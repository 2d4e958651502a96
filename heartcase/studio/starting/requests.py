"""What the start page asks for: one JSON object a message."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from heartcase.schemas.base import Model, Name
from heartcase.studio.asking import RequestId

__all__ = ["Begin", "List", "Look", "Open", "Reopen", "Sample", "StartRequest"]

_Path = Annotated[str, Field(min_length=1, max_length=4096, pattern=r"^[^\x00]*$")]
_Milliseconds = Annotated[float, Field(ge=0.0, le=1e6, allow_inf_nan=False)]


class List(Model):
    """Say what a folder holds."""

    id: RequestId
    """Number that the answer names."""
    do: Literal["list"]
    """Which request."""
    path: _Path | None = None
    """The folder; where the studio begins when left out."""


class Look(Model):
    """List the series of a folder of DICOM files, or say what another scan is."""

    id: RequestId
    """Number that the answer names."""
    do: Literal["look"]
    """Which request."""
    path: _Path
    """The folder or file."""


class Begin(Model):
    """Write a recipe for a scan, and open it."""

    id: RequestId
    """Number that the answer names."""
    do: Literal["begin"]
    """Which request."""
    path: _Path
    """The folder or file."""
    series: Annotated[str, Field(max_length=100)] | None = None
    """DICOM: which series, by its code."""
    trigger_time_ms: _Milliseconds | None = None
    """The cardiac phase nearest to this time."""
    echo_time_ms: _Milliseconds | None = None
    """The echo nearest to this time."""
    frame: Annotated[int, Field(ge=0, le=100_000)] | None = None
    """Other files of several volumes: which one, from 0."""
    folder: _Path
    """Where the recipe goes."""
    file: Annotated[
        str, Field(min_length=1, max_length=100, pattern=r"^[^/\\\x00-\x1f:*?\"<>|.][^/\\\x00-\x1f:*?\"<>|]*$")
    ]
    """The recipe's file name there; .toml is added where it lacks."""
    name: Name | None = None
    """Name of the case: not the patient's. Made up when left out."""


class Open(Model):
    """Open a recipe or a case."""

    id: RequestId
    """Number that the answer names."""
    do: Literal["open"]
    """Which request."""
    path: _Path
    """The recipe's file or the case's folder."""


class Reopen(Model):
    """Open what was opened before, or take it off the list."""

    id: RequestId
    """Number that the answer names."""
    do: Literal["reopen", "forget"]
    """Which request."""
    key: Annotated[str, Field(max_length=32)]
    """The entry's key."""


class Sample(Model):
    """Open a copy of a sample case."""

    id: RequestId
    """Number that the answer names."""
    do: Literal["sample"]
    """Which request."""
    name: Annotated[str, Field(max_length=100)]
    """The sample case."""
    folder: _Path
    """Where the copy's folder goes."""


StartRequest = Annotated[List | Look | Begin | Open | Reopen | Sample, Field(discriminator="do")]
