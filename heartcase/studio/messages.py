"""What a page is told: JSON text, and volumes as bytes.

A binary message is the length of its header (uint32, little-endian), the header (JSON) and the voxels, i fastest.
"""

from __future__ import annotations

import json
import os
import traceback
import zlib
from collections.abc import Sequence
from typing import Any

import numpy as np

from heartcase.pipeline.building.quick_surface import QuickSurface
from heartcase.pipeline.data import Scan
from heartcase.pipeline.watershed.boxes import Box
from heartcase.schemas.arrays import UInt8
from heartcase.schemas.errors import HeartcaseError
from heartcase.studio.message_words import problem_facts

__all__ = ["boxes_message", "labels_message", "problems_of", "scan_message", "surface_message", "text_message", "told"]

_RAW_SIZE_MAX = 1 << 15
"""Bytes up to which compressing would take longer than sending."""
_COMPRESSION = 1
_INT16_MAX = 32767


def text_message(kind: str, **fields: Any) -> str:
    """A message of one kind."""
    return json.dumps({"kind": kind} | fields, ensure_ascii=False, allow_nan=False)


def problems_of(error: HeartcaseError) -> list[dict[str, Any]]:
    """What was wrong, as plain data."""
    return [problem_facts(problem.place, problem.message) for problem in error.problems]


def told(error: BaseException) -> HeartcaseError:
    """What a page is told of an error; one that nobody foresaw ends nothing but what was asked."""
    if isinstance(error, HeartcaseError):
        return error
    if os.environ.get("HEARTCASE_DEBUG"):
        traceback.print_exception(error)
    return HeartcaseError(
        f"something unforeseen happened ({type(error).__name__}): this is a fault of heartcase; start the studio with "
        "HEARTCASE_DEBUG=1 to see where, and report it",
        place="studio",
    )


def scan_message(scan: Scan) -> bytes:
    """The intensities, in 16 bits: exact where they are whole numbers in that range, as Hounsfield units are."""
    values = scan.values
    lowest, highest = float(values.min()), float(values.max())
    is_whole = lowest >= -_INT16_MAX and highest <= _INT16_MAX and bool((values == np.rint(values)).all())
    offset = 0.0 if is_whole else 0.5 * (lowest + highest)
    # an image of one intensity has no range
    scale = (highest - lowest) / (2 * _INT16_MAX) if not is_whole and highest > lowest else 1.0
    numbers = np.rint((values.astype(np.float64) - offset) / scale).astype("<i2")
    header = {"kind": "scan", "dtype": "int16", "size": scan.geometry.size, "scale": scale, "offset": offset}
    payload = numbers.tobytes()
    if len(payload) <= _RAW_SIZE_MAX:
        return _binary(header, payload, encoding="raw")
    return _binary(header, zlib.compress(payload, _COMPRESSION), encoding="deflate")


def labels_message(labels: UInt8, box: Box) -> bytes:
    """The labels in a box of slices [z, y, x] of all."""
    part = np.ascontiguousarray(labels[box])
    header = {"kind": "labels", "low": [one.start for one in box[::-1]], "size": part.shape[::-1]}
    if part.size > _RAW_SIZE_MAX and (runs := _as_runs(part.ravel())) is not None:
        return _binary(header, runs, encoding="runs")
    return _binary(header, part.tobytes(), encoding="raw")


def boxes_message(boxes: Sequence[Box], parts: Sequence[UInt8]) -> bytes:
    """The labels in several boxes of slices [z, y, x], one after the other; what they hold is given."""
    places = [[*(one.start for one in box[::-1]), *part.shape[::-1]] for box, part in zip(boxes, parts, strict=True)]
    whole = np.concatenate([part.ravel() for part in parts])
    header = {"kind": "boxes", "boxes": places}
    if len(whole) > _RAW_SIZE_MAX and (runs := _as_runs(whole)) is not None:
        return _binary(header, runs, encoding="runs")
    return _binary(header, whole.tobytes(), encoding="raw")


def surface_message(surface: QuickSurface) -> bytes:
    """A surface: positions (float32), triangles (uint32), colours and normals (3 bytes each), one after the other."""
    header = {
        "kind": "surface",
        "vertex_count": len(surface.vertices_mm),
        "triangle_count": len(surface.triangles),
        "spacing_mm": surface.spacing_mm,
    }
    parts = (
        surface.vertices_mm.astype("<f4"),
        surface.triangles.astype("<u4"),
        surface.colours.astype(np.uint8),
        surface.normals.astype(np.int8),
    )
    return _binary(header, b"".join(part.tobytes() for part in parts), encoding="raw")


def _as_runs(values: UInt8) -> bytes | None:
    """Where each run of equal values ends (uint32, little-endian), then the value of each; None where that is longer.

    Labels are long runs: this is several times as quick as compressing them, for both sides.
    """
    ends = np.append(np.flatnonzero(values[1:] != values[:-1]) + 1, len(values))
    if 5 * len(ends) >= len(values):
        return None
    found: bytes = ends.astype("<u4").tobytes() + values[ends - 1].tobytes()
    return found


def _binary(header: dict[str, Any], payload: bytes, *, encoding: str) -> bytes:
    head = json.dumps(header | {"encoding": encoding}).encode()
    return b"".join((len(head).to_bytes(4, "little"), head, payload))
