"""Read NRRD (.nrrd, .nhdr, .seg.nrrd) files through SimpleITK.

SimpleITK gives the values and the geometry. The text header is looked at first, because ITK ignores units, takes a
missing spacing for 1 mm, reads whatever file a detached header names, and takes a damaged compressed stream for values
without a word. The fields are those of Teem's definition of the NRRD file format.
"""

from __future__ import annotations

import math
import re
import zlib
from pathlib import Path

import numpy as np

from heartcase.pipeline.formats.volumes.frames import FrameChoice
from heartcase.pipeline.formats.volumes.nrrd_frames import frame_axis, read_nrrd_frame
from heartcase.pipeline.formats.volumes.quiet_itk import quiet_itk
from heartcase.pipeline.formats.volumes.raw_volume import (
    DAMAGED,
    NOT_ONE_VOLUME,
    RawVolume,
    check_size,
    geometry_from_affine,
)
from heartcase.pipeline.formats.volumes.text_header import (
    HEADER_LIMIT,
    MILLIMETRES,
    NO_KNOWN_TYPE,
    NO_SPACING,
    NOT_MILLIMETRES,
    integers_of,
    local_data_file,
    start_of_file,
)
from heartcase.schemas.errors import ScanError

__all__ = ["nrrd_data_file", "read_nrrd"]

ZLIB_OR_GZIP = 47
_MORE_THAN_VALUES = 2**22
"""Bytes that may follow the values in a compressed stream."""
SKIPS = ("byte skip", "byteskip", "line skip", "lineskip")
SPACE = re.compile(r"(left|right|l|r)-?(anterior|posterior|a|p)-?(superior|inferior|s|i)", re.IGNORECASE)

NRRD_TYPES = {
    **dict.fromkeys(("signed char", "int8", "int8_t"), "i1"),
    **dict.fromkeys(("uchar", "unsigned char", "uint8", "uint8_t"), "u1"),
    **dict.fromkeys(("short", "short int", "signed short", "signed short int", "int16", "int16_t"), "i2"),
    **dict.fromkeys(("ushort", "unsigned short", "unsigned short int", "uint16", "uint16_t"), "u2"),
    **dict.fromkeys(("int", "signed int", "int32", "int32_t"), "i4"),
    **dict.fromkeys(("uint", "unsigned int", "uint32", "uint32_t"), "u4"),
    **dict.fromkeys(("longlong", "long long", "long long int", "signed long long", "signed long long int"), "i8"),
    **dict.fromkeys(("int64", "int64_t"), "i8"),
    **dict.fromkeys(("ulonglong", "unsigned long long", "unsigned long long int", "uint64", "uint64_t"), "u8"),
    "float": "f4",
    "double": "f8",
}
"""Type of an NRRD file -> NumPy's name without the byte order."""


def _read_image(path: Path, header: dict[str, str], *, orientation_is_stated: bool) -> RawVolume:
    import SimpleITK

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
    """Refuse a compressed stream that is cut short, damaged, or too short for ``byte_count`` bytes, or far too long."""
    stream = zlib.decompressobj(ZLIB_OR_GZIP)
    total = 0
    try:
        with path.open("rb") as file:
            file.seek(start)
            while not stream.eof and (chunk := file.read(2**16)):
                total += len(stream.decompress(chunk))
                if byte_count is not None and total > byte_count + _MORE_THAN_VALUES:
                    raise ScanError(DAMAGED)
    except (zlib.error, OSError, MemoryError):
        raise ScanError(DAMAGED) from None
    if not stream.eof or (byte_count is not None and total < byte_count):
        raise ScanError(DAMAGED)


def _check_spacing(fields: dict[str, str], axes: list[int]) -> None:
    """Refuse a header that does not give the spacing of these axes in mm."""
    units = [word.strip().lower() for word in re.findall(r'"([^"]*)"', fields.get("units", ""))]
    stated = {units[axis] for axis in axes if axis < len(units)}
    stated |= {word.strip().lower() for word in re.findall(r'"([^"]*)"', fields.get("space units", ""))}
    if stated - MILLIMETRES:
        raise ScanError(NOT_MILLIMETRES)
    if "space directions" in fields:
        vectors = re.findall(r"\(([^()]*)\)|none", fields["space directions"], re.IGNORECASE)
        spacings = [math.hypot(*_numbers_of(vectors[axis].replace(",", " "))) for axis in axes if axis < len(vectors)]
    else:
        words = fields.get("spacings", "").split()
        spacings = [_numbers_of(words[axis])[0] for axis in axes if axis < len(words)]
    if len(spacings) < len(axes) or not all(0.0 < spacing < math.inf for spacing in spacings):
        raise ScanError(NO_SPACING)


def _numbers_of(text: str) -> list[float]:
    try:
        return [float(word) for word in text.split()] or [math.nan]
    except ValueError:
        raise ScanError(DAMAGED) from None


def read_nrrd(path: Path, choice: FrameChoice | None = None) -> RawVolume:
    """Read an NRRD file: one volume, or a list of segmentation layers over one volume.

    Parameters
    ----------
    path
        .nrrd, .nhdr or .seg.nrrd file.
    choice
        Which volume of a file of several; None where the file is to hold one, or layers.

    Returns
    -------
    RawVolume
        With the key-value pairs of the header; a list axis becomes the last axis of the values.

    Raises
    ------
    ScanError
        It cannot be read, is damaged, sheared, without a spacing, not in mm, or has more axes.
    """
    fields, pairs, end = _header(path)
    sizes = integers_of(fields.get("sizes", ""))
    axis = frame_axis(fields, sizes) if choice is not None else None
    if choice is not None and axis is not None and sizes[axis] > 1:
        return _read_one_of_several(path, fields, pairs, end, sizes=sizes, axis=axis, choice=choice)
    check_size(sizes or (0,))
    kinds = fields.get("kinds", "").lower().split()
    lists = [kind for kind in kinds if kind not in ("domain", "space", "???", "none")]
    if len(sizes) > 4 or (len(sizes) == 4 and not (len(lists) == 1 and lists[0] != "time")) or "time" in lists:
        raise ScanError(NOT_ONE_VOLUME.format(dimension=len(sizes)))
    if len(sizes) < 3 or (len(sizes) == 3 and lists):
        raise ScanError("this is a flat image: a volume of several slices is needed")
    _check_spacing(fields, [axis for axis in range(len(sizes)) if kinds[axis : axis + 1] != lists or not lists])
    detached = _data_file(path, fields)
    data = detached or path
    has_skips = any(fields.get(key, "0") != "0" for key in SKIPS)
    element = np.dtype(_element_of(fields)).itemsize
    if not has_skips:
        offset = end if detached is None else 0
        encoding, byte_count = fields.get("encoding", "").lower(), math.prod(sizes) * element
        if encoding in ("gzip", "gz"):
            _check_stream(data, offset, byte_count=byte_count)
        elif encoding == "raw" and data.stat().st_size - offset < byte_count:
            raise ScanError(DAMAGED)
    return _read_image(path, pairs, orientation_is_stated=_is_orientation_stated(fields))


def _is_orientation_stated(fields: dict[str, str]) -> bool:
    return SPACE.match(fields.get("space", "")) is not None and "space directions" in fields


def _element_of(fields: dict[str, str]) -> str:
    element = NRRD_TYPES.get(" ".join(fields.get("type", "").lower().split()))
    if element is None:
        raise ScanError(NO_KNOWN_TYPE)
    return element


def _read_one_of_several(
    path: Path,
    fields: dict[str, str],
    pairs: dict[str, str],
    end: int,
    *,
    sizes: tuple[int, ...],
    axis: int,
    choice: FrameChoice,
) -> RawVolume:
    _check_spacing(fields, [number for number in range(4) if number != axis])
    if any(fields.get(key, "0") != "0" for key in SKIPS):
        raise ScanError("the header skips a part of its data file: export the scan again without that")
    detached = _data_file(path, fields)
    return read_nrrd_frame(
        fields,
        pairs,
        (path, end) if detached is None else (detached, 0),
        sizes=sizes,
        axis=axis,
        element=_element_of(fields),
        choice=choice,
        orientation_is_stated=_is_orientation_stated(fields),
    )


def nrrd_data_file(path: Path) -> Path | None:
    """As :func:`heartcase.pipeline.formats.read_scan.detached_data_file`, whatever the header's own file is called."""
    return _data_file(path, _header(path)[0])


def _data_file(path: Path, fields: dict[str, str]) -> Path | None:
    name = fields.get("data file", fields.get("datafile"))
    return None if name is None else local_data_file(path, name)


def _header(path: Path) -> tuple[dict[str, str], dict[str, str], int]:
    """Fields and key-value pairs of the header, and the byte at which values that follow it start."""
    start = start_of_file(path)
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
    return fields, pairs, end.end() if end else 0
