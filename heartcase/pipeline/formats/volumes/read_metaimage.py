"""Read MetaImage (.mha, .mhd) files.

The header is a few lines of text and the values follow as they are or as one zlib stream. Both are read here because
ITK's own reader ends the process on some damaged headers (tests/fuzz); tests compare what is read with ITK's.
"""

from __future__ import annotations

import math
import re
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from heartcase.pipeline.formats.volumes.frames import FrameChoice, InflatedStream, fully, pick_frame, read_frame
from heartcase.pipeline.formats.volumes.raw_volume import (
    DAMAGED,
    NOT_ONE_VOLUME,
    RawVolume,
    check_size,
    geometry_from_affine,
)
from heartcase.pipeline.formats.volumes.text_header import (
    MILLIMETRES,
    NO_KNOWN_TYPE,
    NO_SPACING,
    NOT_MILLIMETRES,
    integers_of,
    local_data_file,
    start_of_file,
)
from heartcase.schemas.arrays import Float64
from heartcase.schemas.errors import ScanError

__all__ = ["metaimage_data_file", "read_metaimage"]

ELEMENT_TYPES = {
    "MET_CHAR": "i1",
    "MET_UCHAR": "u1",
    "MET_SHORT": "i2",
    "MET_USHORT": "u2",
    "MET_INT": "i4",
    "MET_UINT": "u4",
    "MET_LONG": "i4",
    "MET_ULONG": "u4",
    "MET_LONG_LONG": "i8",
    "MET_ULONG_LONG": "u8",
    "MET_FLOAT": "f4",
    "MET_DOUBLE": "f8",
}
"""Type of the values -> NumPy's name without the byte order."""
SPACING_KEYS = ("ElementSpacing", "ElementSize")
DIRECTION_KEYS = ("TransformMatrix", "Rotation", "Orientation")
_NOT_METAIMAGE = "the file is not a MetaImage file, or its start is damaged: export it again"


def read_metaimage(path: Path, choice: FrameChoice | None = None) -> RawVolume:
    """Read a volume from a MetaImage file.

    Parameters
    ----------
    path
        .mha or .mhd file.
    choice
        Which volume of a file of four axes; None where the file is to hold one.

    Returns
    -------
    RawVolume
        The volume.

    Raises
    ------
    ScanError
        It cannot be read, is damaged or sheared, is without a spacing, not in mm, scales its values, or has more axes.
    """
    fields, end = _header(path)
    size = integers_of(fields["DimSize"])
    channels = integers_of(fields.get("ElementNumberOfChannels", "1"))
    has_frames = len(size) == 4 and size[3] > 1 and choice is not None and channels == (1,)
    check_size(size[:3] if has_frames else size or (0,), components=channels[0] if channels else 0)
    if len(size) > 3 and any(count > 1 for count in size[3:]) and not has_frames:
        raise ScanError(NOT_ONE_VOLUME.format(dimension=len(size)))
    if not has_frames and (len(size) != 3 or fields.get("NDims", "3") != "3"):
        raise ScanError("a volume with three axes is needed: export the scan as a 3-D file")
    element = ELEMENT_TYPES.get(fields.get("ElementType", "").removesuffix("_ARRAY"))
    if element is None:
        raise ScanError(NO_KNOWN_TYPE)
    _check_meaning(fields)
    order = ">" if _is_true(fields, "BinaryDataByteOrderMSB", "ElementByteOrderMSB") else "<"
    dtype = np.dtype(order + element)
    count = math.prod(size) * channels[0]
    detached = _data_file(path, fields)
    data = detached or path
    offset = end if detached is None else _skipped(fields, data, count * dtype.itemsize)
    if has_frames and choice is not None:
        found = pick_frame(size[3], None, choice)
        values = _frame(data, offset, size, found.number, dtype, fields)
        geometry = geometry_from_affine(_affine(fields, axes=4), size[2::-1])
        stated = any(key in fields for key in DIRECTION_KEYS)
        return RawVolume(values=values, geometry=geometry, orientation_is_stated=stated, frame=found)
    values = _values(data, offset, count, dtype, fields)
    shape = (*size[::-1], channels[0]) if channels[0] > 1 else size[::-1]
    geometry = geometry_from_affine(_affine(fields), size[::-1])
    stated = any(key in fields for key in DIRECTION_KEYS)
    return RawVolume(values=values.reshape(shape), geometry=geometry, orientation_is_stated=stated)


def metaimage_data_file(path: Path) -> Path | None:
    """As :func:`heartcase.pipeline.formats.read_scan.detached_data_file`, whatever the header's own file is called."""
    return _data_file(path, _header(path)[0])


def _data_file(path: Path, fields: dict[str, str]) -> Path | None:
    name = fields["ElementDataFile"]
    return None if name.upper() == "LOCAL" else local_data_file(path, name)


def _header(path: Path) -> tuple[dict[str, str], int]:
    """Key -> text of the header, and where it ends."""
    start = start_of_file(path)
    end = re.search(rb"^\s*ElementDataFile\s*=\s*([^\r\n]*)(\r?\n|$)", start, re.M)
    fields: dict[str, str] = {}
    for line in start[: end.end() if end else 0].decode("utf-8", errors="replace").splitlines():
        key, _, value = line.partition("=")
        fields[key.strip()] = value.strip()
    if end is None or "DimSize" not in fields or fields.get("ObjectType", "Image") != "Image":
        raise ScanError(_NOT_METAIMAGE)
    return fields, end.end()


def _is_true(fields: dict[str, str], *keys: str) -> bool:
    return any(fields.get(key, "").lower() in ("true", "1") for key in keys)


def _check_meaning(fields: dict[str, str]) -> None:
    """Refuse lengths in another unit, and values that are to be scaled."""
    if fields.get("DistanceUnits", "").lower() not in MILLIMETRES | {"?"}:
        raise ScanError(NOT_MILLIMETRES)
    for key, neutral in (("Slope", 1.0), ("Offset", 0.0)):
        try:
            is_neutral = float(fields.get(f"ElementToIntensityFunction{key}", neutral)) == neutral
        except ValueError:
            is_neutral = False
        if not is_neutral:
            raise ScanError("the header scales the values by an intensity function: export the scan with true values")


def _skipped(fields: dict[str, str], data: Path, byte_count: int) -> int:
    """Bytes before the values in a data file of its own; -1 says that they are its end."""
    header_size = (*integers_of(fields.get("HeaderSize", "0")), 0)[0]
    return max(0, data.stat().st_size - byte_count) if header_size < 0 else header_size


def _values(data: Path, offset: int, count: int, dtype: np.dtype[Any], fields: dict[str, str]) -> npt.NDArray[Any]:
    is_binary = fields.get("BinaryData", "True").lower() in ("true", "1")
    is_compressed = _is_true(fields, "CompressedData")
    byte_count = count * dtype.itemsize
    if is_binary and not is_compressed and data.stat().st_size - offset < byte_count:
        raise ScanError(DAMAGED)
    try:
        with data.open("rb") as file:
            file.seek(offset)
            if not is_binary:
                return np.array(file.read().split(maxsplit=count)[:count], dtype=np.float64).reshape(count)
            content = _inflated(file.read(), byte_count) if is_compressed else file.read(byte_count)
        return np.frombuffer(content, dtype=dtype, count=count)
    except (zlib.error, OSError, ValueError, MemoryError):
        raise ScanError(DAMAGED) from None


def _frame(
    data: Path, offset: int, size: tuple[int, ...], frame: int, dtype: np.dtype[Any], fields: dict[str, str]
) -> npt.NDArray[Any]:
    if fields.get("BinaryData", "True").lower() not in ("true", "1"):
        raise ScanError("the volumes are written as text: export the scan with binary values")
    try:
        with data.open("rb") as file:
            file.seek(offset)
            stream = InflatedStream(file) if _is_true(fields, "CompressedData") else None
            values = read_frame(fully(stream or file, DAMAGED), size, 3, frame, dtype)
            if stream is not None and (stream.read(1) or not stream.is_whole):
                raise ScanError(DAMAGED)
            return values
    except (zlib.error, OSError, ValueError, MemoryError):
        raise ScanError(DAMAGED) from None


def _inflated(content: bytes, byte_count: int) -> bytes:
    """What is packed in a zlib or gzip stream, which must be whole and hold just so much."""
    stream = zlib.decompressobj(zlib.MAX_WBITS | 32)
    # One more, so that the stream's end and its checksum are reached.
    found = stream.decompress(content, byte_count + 1)
    if not stream.eof or len(found) != byte_count:
        raise ScanError(DAMAGED)
    return found


def _affine(fields: dict[str, str], axes: int = 3) -> Float64:
    """Map from index to LPS mm; the matrix's rows are the directions of the axes, of which the first three count."""
    spacing = _numbers(fields, SPACING_KEYS, (math.nan,) * axes)[:3]
    origin = _numbers(fields, ("Offset", "Position", "Origin"), (0.0,) * axes)[:3]
    rows = _numbers(fields, DIRECTION_KEYS, tuple(np.eye(axes).ravel().tolist())).reshape(axes, axes)
    if not ((spacing > 0.0) & (spacing < math.inf)).all():
        raise ScanError(NO_SPACING)
    if rows[:3, 3:].any() or rows[3:, :3].any():
        raise ScanError("the fourth axis has a part in space: export the one volume that is wanted as a 3-D file")
    affine = np.eye(4)
    with np.errstate(over="ignore", invalid="ignore"):
        affine[:3, :3] = rows[:3, :3].T * spacing
    affine[:3, 3] = origin
    return affine


def _numbers(fields: dict[str, str], keys: tuple[str, ...], default: tuple[float, ...]) -> Float64:
    text = next((fields[key] for key in keys if key in fields), None)
    if text is None:
        return np.array(default)
    try:
        numbers = np.array([float(word) for word in text.split()])
    except ValueError:
        raise ScanError(DAMAGED) from None
    if numbers.shape != np.shape(default):
        raise ScanError(DAMAGED)
    return numbers
