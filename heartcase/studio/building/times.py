"""How long the stages of a build may take: as long as they took before, on scans of about this size."""

from __future__ import annotations

import contextlib
import json
import statistics
from collections.abc import Iterable, Mapping
from pathlib import Path

from heartcase.schemas.files import atomic_write

__all__ = ["StageTimes"]

_KEPT = 8
"""Times of a stage that are remembered; the newest ones."""
_ALIKE = 1.5
"""Scans of which one has up to so many times the voxels of the other take alike, in proportion."""


class StageTimes:
    """What builds took, in a file of the cache.

    Parameters
    ----------
    file
        Where it is remembered; what cannot be read there is as if nothing were known.
    """

    def __init__(self, file: Path) -> None:
        self._file = file

    def learn(self, voxel_count: int, seconds: Mapping[str, float]) -> None:
        """Remember how long stages took, s, by their names, on a scan of so many voxels; 0 of one without work."""
        known = self._known()
        for stage, one in seconds.items():
            every = [*known.get(stage, []), (voxel_count, round(one, 3))]
            # builds in which it had nothing to do push none out in which it had
            kinds = ([time for time in every if time[1] > 0.0], [time for time in every if time[1] <= 0.0])
            known[stage] = [time for kind in kinds for time in kind[-_KEPT:]]
        # no build is worse for it
        with contextlib.suppress(OSError):
            self._file.parent.mkdir(parents=True, exist_ok=True)
            atomic_write(self._file, json.dumps(known, sort_keys=True).encode())

    def expected(self, voxel_count: int | None, stages: Iterable[str]) -> float | None:
        """How long some stages may take together, s; None where that is not known of each of them.

        Parameters
        ----------
        voxel_count
            Voxels of the scan; None where they are not known.
        stages
            Names of the stages.
        """
        if voxel_count is None:
            return None
        known, total = self._known(), 0.0
        for stage in stages:
            alike = [
                seconds * voxel_count / count
                for count, seconds in known.get(stage, ())
                if voxel_count / _ALIKE <= count <= voxel_count * _ALIKE
            ]
            if not alike:
                return None
            # without work only as long as none is known that it had
            total += statistics.median([time for time in alike if time > 0.0] or alike)
        return total

    def _known(self) -> dict[str, list[tuple[int, float]]]:
        try:
            data = json.loads(self._file.read_bytes())
            return {
                str(stage): [(int(count), float(seconds)) for count, seconds in found if count > 0]
                for stage, found in data.items()
            }
        except (OSError, ValueError, AttributeError, TypeError):
            return {}
