"""Strokes that are drawn to time the server, without a page: those of ``tests.studio.page.latency``, as messages."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

NORMALS = ((0.0, 0.0, 1.0), (0.0, -1.0, 0.0), (1.0, 0.0, 0.0))
POINTS = 14
"""Points of a stroke."""


def planes(middle: Sequence[float]) -> list[dict[str, Any]]:
    """The three planes that are looked at, through a point, LPS mm."""
    return [{"point_mm": tuple(middle), "normal": normal} for normal in NORMALS]


def messages(
    stroke: int, middle: Sequence[float], names: Sequence[str], mm_per_pixel: float
) -> Iterator[tuple[str, dict[str, Any]]]:
    """What a page asks for while a stroke is drawn outwards from a point, LPS mm: each request and what it says."""
    x, y, z = middle
    angle = 2.4 * stroke
    for step in range(POINTS):
        way = (4.0 + 6.0 * step) * mm_per_pixel
        points = [(x + way * math.cos(angle), y + way * math.sin(angle), z)]
        if step:
            yield "extend", {"points_mm": points}
        else:
            yield "paint", {"label": names[stroke % 5], "radius_mm": 3.0, "points_mm": points}


def print_times(size: Sequence[int], took: dict[str, list[float]]) -> None:
    """Print what each kind of request took, ms."""
    print(f"{list(size)} voxels, ms: median, 99%, most")
    for kind, times in took.items():
        half, most = np.percentile(times, [50, 99])
        print(f"{kind:8} {len(times):5} {half:8.1f} {most:8.1f} {max(times):8.1f}")
