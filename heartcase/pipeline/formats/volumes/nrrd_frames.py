"""One volume of an NRRD file with four axes: the fields are those of Teem's definition of the NRRD file format.

ITK takes a list axis for values of a voxel and a time axis for a direction in space, so these files are read here.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np

from heartcase.pipeline.formats.volumes.frames import FrameChoice, InflatedStream, fully, pick_frame, read_frame
from heartcase.pipeline.formats.volumes.raw_volume import DAMAGED, RawVolume, check_size, geometry_from_affine
from heartcase.schemas.arrays import Float64
from heartcase.schemas.errors import ScanError

__all__ = ["frame_axis", "read_nrrd_frame"]

FRAME_KINDS = ("list", "time")
UNIT_MS = {"s": 1000.0, "sec": 1000.0, "second": 1000.0, "seconds": 1000.0, "ms": 1.0, "msec": 1.0, "us": 1e-3}
"""Units of time -> ms."""
SIGNS = {"l": 1.0, "r": -1.0, "p": 1.0, "a": -1.0, "s": 1.0, "i": -1.0}
"""Which way an axis of the space runs -> sign in LPS."""


def frame_axis(fields: dict[str, str], sizes: Sequence[int]) -> int | None:
    """The axis of a file with four that counts volumes; None where no one can tell, or it holds values of a voxel."""
    if len(sizes) != 4:
        return None
    kinds = fields.get("kinds", "").lower().split()
    if len(kinds) == 4:
        others = [axis for axis, kind in enumerate(kinds) if kind not in ("domain", "space", "???", "none")]
        if others:
            return others[0] if len(others) == 1 and kinds[others[0]] in FRAME_KINDS else None
    vectors = _vectors(fields)
    if vectors is not None and len(vectors) == 4:
        without = [axis for axis, vector in enumerate(vectors) if vector is None]
        if len(without) == 1:
            return without[0]
        if not without and all(vector is not None and len(vector) == 4 for vector in vectors):
            return 3
    return None


def read_nrrd_frame(
    fields: dict[str, str],
    pairs: dict[str, str],
    data: tuple[Path, int],
    *,
    sizes: Sequence[int],
    axis: int,
    element: str,
    choice: FrameChoice,
    orientation_is_stated: bool,
) -> RawVolume:
    """Read one volume.

    Parameters
    ----------
    fields, pairs
        Of the header.
    data
        The file that holds the values, and the byte at which they start.
    sizes
        Number of values along each axis.
    axis
        Which one counts the volumes.
    element
        NumPy's name of the type of a value, without the byte order.
    choice
        Which volume is wanted.
    orientation_is_stated
        Whether the header says which way the axes point in the patient.

    Raises
    ------
    ScanError
        It is not there, or the file is damaged or packed in another way than gzip.
    """
    space_axes = [number for number in range(4) if number != axis]
    check_size([sizes[number] for number in space_axes])
    found = pick_frame(sizes[axis], _times(fields, pairs, axis, sizes[axis]), choice)
    order = ">" if fields.get("endian", "little").lower() == "big" else "<"
    dtype = np.dtype(order + element)
    encoding = fields.get("encoding", "").lower()
    if encoding not in ("raw", "gzip", "gz"):
        raise ScanError("the volumes are packed in a way that is not read: write them raw or as gzip")
    try:
        with data[0].open("rb") as file:
            file.seek(data[1])
            stream = InflatedStream(file) if encoding != "raw" else None
            values = read_frame(fully(stream or file, DAMAGED), sizes, axis, found.number, dtype)
            if stream is not None and (stream.read(2**16) or not stream.is_whole):
                raise ScanError(DAMAGED)
    except (OSError, EOFError, MemoryError, ValueError):
        raise ScanError(DAMAGED) from None
    except Exception as error:
        if isinstance(error, ScanError):
            raise
        raise ScanError(DAMAGED) from None
    geometry = geometry_from_affine(_affine(fields, space_axes), values.shape)
    return RawVolume(
        values=values, geometry=geometry, header=pairs, orientation_is_stated=orientation_is_stated, frame=found
    )


def _affine(fields: dict[str, str], axes: Sequence[int]) -> Float64:
    affine = np.eye(4)
    vectors = _vectors(fields)
    try:
        if vectors is None:
            words = fields["spacings"].split()
            affine[:3, :3] = np.diag([float(words[axis]) for axis in axes])
            return affine
        for column, axis in enumerate(axes):
            vector = vectors[axis]
            if vector is None or len(vector) not in (3, 4) or any(vector[3:]):
                raise ScanError("the directions of the axes in the header are no directions in space: export it again")
            affine[:3, column] = vector[:3]
        origin = re.search(r"\(([^()]*)\)", fields.get("space origin", ""))
        if origin is not None:
            affine[:3, 3] = [float(word) for word in origin.group(1).split(",")][:3]
    except (KeyError, IndexError, ValueError):
        raise ScanError(DAMAGED) from None
    space = re.match(
        r"(left|right|l|r)-?(anterior|posterior|a|p)-?(superior|inferior|s|i)", fields.get("space", "").lower()
    )
    signs = [SIGNS[word[0]] for word in space.groups()] if space else [1.0, 1.0, 1.0]
    return np.asarray(np.diag([*signs, 1.0]) @ affine)


def _vectors(fields: dict[str, str]) -> list[list[float] | None] | None:
    """The directions of the axes; None for one that has none, and where the header gives none at all."""
    if "space directions" not in fields:
        return None
    found: list[list[float] | None] = []
    for match in re.finditer(r"\(([^()]*)\)|none", fields["space directions"], re.IGNORECASE):
        try:
            found.append([float(word) for word in match.group(1).split(",")] if match.group(1) is not None else None)
        except ValueError:
            raise ScanError(DAMAGED) from None
    return found


def _times(fields: dict[str, str], pairs: dict[str, str], axis: int, count: int) -> tuple[float, ...] | None:
    """The time of each volume, ms, as 3D Slicer writes it or as spacing of a time axis; None without a unit."""
    units = [word.strip().lower() for word in re.findall(r'"([^"]*)"', fields.get("units", ""))]
    unit = UNIT_MS.get(units[axis]) if axis < len(units) else None
    slicer_unit = UNIT_MS.get(pairs.get("MultiVolume.FrameIdentifyingDICOMTagUnits", "").strip().lower())
    try:
        if slicer_unit is not None and "MultiVolume.FrameLabels" in pairs:
            times = [slicer_unit * float(word) for word in pairs["MultiVolume.FrameLabels"].split(",")]
        elif unit is not None and f"axis {axis} index values" in pairs:
            times = [unit * float(word) for word in pairs[f"axis {axis} index values"].split()]
        elif unit is not None and "spacings" in fields:
            step = float(fields["spacings"].split()[axis])
            starts = fields.get("axis mins", fields.get("axismins", "")).split()
            start = float(starts[axis]) if axis < len(starts) else 0.0
            times = [unit * ((start if np.isfinite(start) else 0.0) + step * number) for number in range(count)]
        else:
            return None
    except (ValueError, IndexError):
        return None
    is_ascending = all(later > earlier for earlier, later in pairwise(times))
    return tuple(times) if len(times) == count and is_ascending and np.isfinite(times).all() else None
