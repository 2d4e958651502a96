"""Read the point lists of 3D Slicer (.mrk.json)."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from heartcase.pipeline.formats.volumes.raw_volume import placed, require_file
from heartcase.schemas.arrays import Float64
from heartcase.schemas.errors import MarkerError, ScanError

__all__ = ["MarkupList", "read_point_lists"]

SIZE_LIMIT = 2**26
TO_LPS = {"LPS": (1.0, 1.0, 1.0), "RAS": (-1.0, -1.0, 1.0), "0": (-1.0, -1.0, 1.0), "1": (1.0, 1.0, 1.0)}
"""Signs that bring each coordinate system to LPS; early files number them."""
LINE_TYPES = ("line", "curve", "closedcurve")
DAMAGED = "the file is not a point list of 3D Slicer (.mrk.json), or is damaged: save it again"


@dataclass(frozen=True)
class MarkupList:
    """One list of points, or one line."""

    number: int
    """Its place in the file, from 1: how messages call it."""
    name: str
    """Name inside the file: to be compared with label names, never to be shown; empty where it has none."""
    file_stem: str
    """Name of the file without its ending: to be compared with label names, never to be shown."""
    is_line: bool
    """Whether the points are joined by lines."""
    labels: tuple[str, ...]
    """Label of each point: to be compared with label names, never to be shown."""
    numbers: tuple[int, ...]
    """Place of each point in its list, from 1: how messages call it."""
    points_mm: Float64
    """Points, LPS mm, shape (point_count, 3)."""


def read_point_lists(path: Path) -> tuple[MarkupList, ...]:
    """Read all lists of a .mrk.json file.

    Parameters
    ----------
    path
        The file. Points in RAS are turned to LPS; points that are not placed are left out.

    Returns
    -------
    tuple of MarkupList
        Point lists, and lines and curves as polylines through their control points; empty lists are left out.

    Raises
    ------
    MarkerError
        The file cannot be read, or holds other things than points, lines and curves in mm.
    """
    try:
        require_file(path)
    except ScanError as error:
        raise placed(error, "", MarkerError) from None
    try:
        if path.stat().st_size > SIZE_LIMIT:
            raise MarkerError(DAMAGED)
        content = json.loads(path.read_text(encoding="utf-8"))
        markups = content["markups"]
        stem = path.name.lower().removesuffix(".json").removesuffix(".mrk")
        lists = [_markup(number, markup, stem) for number, markup in enumerate(markups, start=1)]
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError, OverflowError):
        raise MarkerError(DAMAGED) from None
    return tuple(markup for markup in lists if len(markup.points_mm))


def _markup(number: int, markup: dict[str, Any], stem: str) -> MarkupList:
    kind = str(markup["type"]).lower()
    if kind != "fiducial" and kind not in LINE_TYPES:
        raise MarkerError("the file holds something else than points, lines and curves: save those alone")
    signs = TO_LPS.get(str(markup.get("coordinateSystem", "LPS")).upper())
    if signs is None:
        raise MarkerError("the coordinate system is neither LPS nor RAS: save the points in one of them")
    if str(markup.get("coordinateUnits", "mm")).strip("[]").lower() != "mm":
        raise MarkerError("the points are not in millimetres: save them in mm")
    every = list(enumerate(markup["controlPoints"], start=1))
    points = [(place, point) for place, point in every if point.get("positionStatus", "defined") == "defined"]
    positions = np.array([point["position"] for _, point in points], dtype=np.float64).reshape(len(points), 3)
    if not np.isfinite(positions).all():
        raise MarkerError("a point has a position that is not a number: set it again")
    if kind == "closedcurve" and len(points) > 1:
        positions = np.concatenate((positions, positions[:1]))
    return MarkupList(
        number=number,
        name=_one_line(markup.get("name", "")),
        file_stem=" ".join(stem.split()),
        is_line=kind in LINE_TYPES,
        labels=tuple(_one_line(point.get("label", "")) for _, point in points),
        numbers=tuple(place for place, _ in points),
        points_mm=positions * np.array(signs),
    )


def _one_line(text: Any) -> str:
    return " ".join(str(text).split())[:64]
