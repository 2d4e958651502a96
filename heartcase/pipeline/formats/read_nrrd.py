"""Read NRRD (.nrrd, .nhdr, .seg.nrrd) files through SimpleITK.

SimpleITK gives the values and the geometry. The text header is looked at first, because ITK ignores units, reads
whatever file a detached header names, and takes a damaged compressed stream for values without a word.
"""

from __future__ import annotations

import math
import re
import zlib
from pathlib import Path

import numpy as np
import SimpleITK

from heartcase.pipeline.formats.quiet_itk import quiet_itk
from heartcase.pipeline.formats.raw_volume import (
    DAMAGED,
    HEADER_LIMIT,
    NOT_ONE_VOLUME,
    RawVolume,
    check_size,
    geometry_from_affine,
    integers_of,
    local_data_file,
    require_file,
)
from heartcase.schemas.errors import ScanError

__all__ = ["read_nrrd"]

ZLIB_OR_GZIP = 47
SPACE = re.compile(r"(left|right|l|r)-?(anterior|posterior|a|p)-?(superior|inferior|s|i)", re.IGNORECASE)


NRRD_BYTES = {
    **dict.fromkeys(("signed char", "int8", "int8_t", "uchar", "unsigned char", "uint8", "uint8_t"), 1),
    **dict.fromkeys(("short", "short int", "signed short", "signed short int", "int16", "int16_t"), 2),
    **dict.fromkeys(("ushort", "unsigned short", "unsigned short int", "uint16", "uint16_t"), 2),
    **dict.fromkeys(
        ("int", "signed int", "int32", "int32_t", "uint", "unsigned int", "uint32", "uint32_t", "float"), 4
    ),
    **dict.fromkeys(("longlong", "long long", "long long int", "signed long long", "signed long long int"), 8),
    **dict.fromkeys(("int64", "int64_t", "ulonglong", "unsigned long long", "unsigned long long int"), 8),
    **dict.fromkeys(("uint64", "uint64_t", "double"), 8),
}
"""Type of an NRRD file -> bytes of one value."""


def _read_image(path: Path, header: dict[str, str], *, orientation_is_stated: bool) -> RawVolume:
    try:
        with quiet_itk():
            image = SimpleITK.ReadImage(str(path))
            values = SimpleITK.GetArrayFromImage(image)
    except (RuntimeError, MemoryError, ValueError, UnicodeError):
        raise ScanError(DAMAGED) from None
    if image.GetDimension() != 3:
        raise ScanError(NOT_ONE_VOLUME.format(dimension=image.GetDimension()))
    if np.iscomplexobj(values):
        raise ScanError("the voxel values are complex: export the magnitude")
    affine = np.eye(4)
    affine[:3, :3] = np.array(image.GetDirection()).reshape(3, 3) * np.array(image.GetSpacing())
    affine[:3, 3] = image.GetOrigin()
    geometry = geometry_from_affine(affine, values.shape[:3])
    return RawVolume(values=values, geometry=geometry, header=header, orientation_is_stated=orientation_is_stated)


def _check_stream(path: Path, start: int, *, byte_count: int | None) -> None:
    """Refuse a compressed stream that is cut short, damaged, or too short for ``byte_count`` bytes."""
    stream = zlib.decompressobj(ZLIB_OR_GZIP)
    total = 0
    try:
        with path.open("rb") as file:
            file.seek(start)
            while not stream.eof and (chunk := file.read(2**16)):
                total += len(stream.decompress(chunk))
    except (zlib.error, OSError, MemoryError):
        raise ScanError(DAMAGED) from None
    if not stream.eof or (byte_count is not None and total < byte_count):
        raise ScanError(DAMAGED)


def read_nrrd(path: Path) -> RawVolume:
    """Read an NRRD file: one volume, or a list of segmentation layers over one volume.

    Parameters
    ----------
    path
        .nrrd, .nhdr or .seg.nrrd file.

    Returns
    -------
    RawVolume
        With the key-value pairs of the header; a list axis becomes the last axis of the values.

    Raises
    ------
    ScanError
        It cannot be read, is damaged, sheared, not in mm, or has more axes.
    """
    require_file(path)
    with path.open("rb") as file:
        start = file.read(HEADER_LIMIT)
    if not start.startswith(b"NRRD000"):
        raise ScanError("the file is not an NRRD file, or its start is damaged: export it again")
    end = re.search(rb"\r?\n\r?\n", start)
    if end is None and (len(start) == HEADER_LIMIT or path.suffix.lower() != ".nhdr"):
        raise ScanError(DAMAGED)
    text = start[: end.start() if end else None].decode("utf-8", errors="replace")
    fields: dict[str, str] = {}
    pairs: dict[str, str] = {}
    for line in text.splitlines()[1:]:
        if line.startswith("#"):
            continue
        field = re.match(r"([^:=]+):(=?)\s*(.*)", line)
        if field:
            key, value = field.group(1).strip(), field.group(3).strip()
            (pairs if field.group(2) else fields)[key if field.group(2) else key.lower()] = value
    sizes = integers_of(fields.get("sizes", ""))
    check_size(sizes or (0,))
    kinds = fields.get("kinds", "").lower().split()
    lists = [kind for kind in kinds if kind not in ("domain", "space", "???", "none")]
    if len(sizes) > 4 or (len(sizes) == 4 and not (len(lists) == 1 and lists[0] != "time")) or "time" in lists:
        raise ScanError(NOT_ONE_VOLUME.format(dimension=len(sizes)))
    if len(sizes) < 3 or (len(sizes) == 3 and lists):
        raise ScanError("this is a flat image: a volume of several slices is needed")
    units = {unit.strip().lower() for unit in re.findall(r'"([^"]*)"', fields.get("space units", ""))}
    if units - {"", "mm", "millimeter", "millimeters", "millimetre", "millimetres"}:
        raise ScanError("the positions are not in millimetres: convert the scan to millimetres and export it again")
    name = fields.get("data file", fields.get("datafile"))
    data = local_data_file(path, name) if name is not None else path
    has_skips = any(fields.get(key, "0") != "0" for key in ("byte skip", "byteskip", "line skip", "lineskip"))
    element = NRRD_BYTES.get(" ".join(fields.get("type", "").lower().split()))
    if element is None:
        raise ScanError("the header gives no known type of values: export the file again")
    if not has_skips:
        offset = end.end() if end and name is None else 0
        encoding, byte_count = fields.get("encoding", "").lower(), math.prod(sizes) * element
        if encoding in ("gzip", "gz"):
            _check_stream(data, offset, byte_count=byte_count)
        elif encoding == "raw" and data.stat().st_size - offset < byte_count:
            raise ScanError(DAMAGED)
    stated = SPACE.match(fields.get("space", "")) is not None
    return _read_image(path, pairs, orientation_is_stated=stated)
