"""The build cache: outputs of stages, found again by what went into them.

The key of an output is the hash of the stage's name and version, its resolved settings, and the hashes of its inputs:
nothing of a patient, a path or a clock. Entries are written atomically and checked when they are read, so a damaged
or half-written entry is merely absent.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from heartcase.pipeline.artifacts.serialise import artifact_from_bytes, artifact_to_bytes
from heartcase.schemas.errors import StageError
from heartcase.schemas.files import atomic_write, remove_leftovers

__all__ = ["Cache", "CacheEntry", "stage_key"]

T = TypeVar("T")

CACHE_SIZE_MAX = 20 << 30


def stage_key(*, stage: str, version: int, settings: Any, inputs: dict[str, str]) -> str:
    """Key of a stage's output: 64 hexadecimal digits. ``settings`` is plain JSON, ``inputs`` name -> hash."""
    text = json.dumps([stage, version, settings, inputs], sort_keys=True, allow_nan=False)
    return hashlib.sha256(text.encode()).hexdigest()


@dataclass(frozen=True)
class CacheEntry:
    """What the cache knows of an output without reading it."""

    output_sha256: str
    """Hash of the output."""
    seconds: float
    """How long the stage took."""


class Cache:
    """A directory of stage outputs.

    Parameters
    ----------
    directory
        Made when it is not there.
    """

    def __init__(self, directory: Path | str) -> None:
        self.directory = Path(directory)
        self.directory.mkdir(parents=True, exist_ok=True)

    def clean(self) -> None:
        """Remove what killed runs left, and the entries unused for longest beyond 20 GiB."""
        remove_leftovers(self.directory)
        files = [(path.stat().st_mtime, path.stat().st_size, path) for path in self.directory.glob("*.safetensors")]
        total = sum(size for _, size, _ in files)
        for _, size, path in sorted(files):
            if total <= CACHE_SIZE_MAX:
                break
            with contextlib.suppress(OSError):
                path.with_suffix(".json").unlink(missing_ok=True)
                path.unlink()
                total -= size

    def find(self, stage: str, key: str) -> CacheEntry | None:
        """Look an output up; None when it has to be computed."""
        try:
            data = json.loads(self._record(stage, key).read_bytes())
            entry = CacheEntry(str(data["output_sha256"]), float(data["seconds"]))
            os.utime(self._content(stage, key))
        except (OSError, ValueError, KeyError, TypeError):
            return None
        return entry

    def load(self, stage: str, key: str, expected: type[T]) -> T | None:
        """Read an output; None when it is absent or damaged."""
        entry = self.find(stage, key)
        if entry is None:
            return None
        try:
            content = self._content(stage, key).read_bytes()
            if hashlib.sha256(content).hexdigest() != entry.output_sha256:
                return None
            return artifact_from_bytes(content, expected)
        except (OSError, StageError):
            return None

    def store(self, stage: str, key: str, artifact: Any, *, seconds: float) -> CacheEntry:
        """Keep an output; its content first, then the record that makes it found."""
        content = artifact_to_bytes(artifact)
        entry = CacheEntry(hashlib.sha256(content).hexdigest(), seconds)
        atomic_write(self._content(stage, key), content, is_flushed=False)
        record = {"output_sha256": entry.output_sha256, "seconds": round(seconds, 3)}
        atomic_write(self._record(stage, key), json.dumps(record).encode(), is_flushed=False)
        return entry

    def note(self, stage: str, key: str, facts: dict[str, Any]) -> None:
        """Keep a few facts, as plain JSON, where there is no output to keep."""
        atomic_write(self._record(stage, key), json.dumps(facts, sort_keys=True).encode())

    def noted(self, stage: str, key: str) -> dict[str, Any] | None:
        """Read what :meth:`note` kept; None when there is nothing."""
        try:
            facts = json.loads(self._record(stage, key).read_bytes())
        except (OSError, ValueError):
            return None
        return facts if isinstance(facts, dict) else None

    def _content(self, stage: str, key: str) -> Path:
        return self.directory / f"{stage}-{key}.safetensors"

    def _record(self, stage: str, key: str) -> Path:
        return self.directory / f"{stage}-{key}.json"
