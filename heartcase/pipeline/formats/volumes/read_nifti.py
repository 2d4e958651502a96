"""Read NIfTI-1 and NIfTI-2 files (.nii, .nii.gz).

Read here and not through ITK because ITK fills up a truncated file with zeros, and where the sform is sheared takes
the qform without a word. The format is that of the NIfTI-1.1 and NIfTI-2 headers of the NIfTI data format working
group (nifti1.h, nifti2.h); as there, the sform goes before the qform. A file in which they disagree is refused: each
program would put it elsewhere.
"""

from __future__ import annotations

import gzip
import math
import struct
import zlib
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from heartcase.pipeline.formats.volumes.agreement import AGREEMENT_MM, corner_distance_mm, corners_of
from heartcase.pipeline.formats.volumes.frames import FrameChoice, fully, pick_frame, read_frame
from heartcase.pipeline.formats.volumes.raw_volume import RawVolume, check_size, geometry_from_affine, require_file
from heartcase.schemas.arrays import Float64
from heartcase.schemas.errors import ScanError
from heartcase.schemas.geometry import Geometry

__all__ = ["read_nifti"]

SCALAR_TYPES = {
    2: "u1",
    4: "i2",
    8: "i4",
    16: "f4",
    64: "f8",
    256: "i1",
    512: "u2",
    768: "u4",
    1024: "i8",
    1280: "u8",
}
OTHER_TYPES = {128: "colour", 2304: "colour", 32: "complex", 1792: "complex", 2048: "complex"}
UNIT_MS_OF_TIME = {8: 1000.0, 16: 1.0, 24: 1e-3}
UNIT_MM = {0: 1.0, 1: 1000.0, 2: 1.0, 3: 0.001}
RAS_TO_LPS = np.diag([-1.0, -1.0, 1.0, 1.0])
DAMAGED = "the file is cut short or damaged: copy or export it again"
QUATERNION_ROUNDING = 2.5e-7
"""How far float32 rounding of the quaternion may be off in 1 - b2 - c2 - d2."""


class _Header:
    """The fields of the header that are used, from either version."""

    def __init__(self, data: bytes) -> None:
        order, version = _order_and_version(data)
        if version == 1:
            self.dim = struct.unpack_from(order + "8h", data, 40)
            self.datatype = struct.unpack_from(order + "h", data, 70)[0]
            self.pixdim = struct.unpack_from(order + "8f", data, 76)
            self.vox_offset = float(struct.unpack_from(order + "f", data, 108)[0])
            self.slope, self.inter = struct.unpack_from(order + "2f", data, 112)
            self.units = data[123]
            self.time_offset = float(struct.unpack_from(order + "f", data, 136)[0])
            self.qform_code, self.sform_code = struct.unpack_from(order + "2h", data, 252)
            self.quatern = struct.unpack_from(order + "6f", data, 256)
            self.srow = struct.unpack_from(order + "12f", data, 280)
        else:
            self.datatype = struct.unpack_from(order + "h", data, 12)[0]
            self.dim = struct.unpack_from(order + "8q", data, 16)
            self.pixdim = struct.unpack_from(order + "8d", data, 104)
            self.vox_offset = float(struct.unpack_from(order + "q", data, 168)[0])
            self.slope, self.inter = struct.unpack_from(order + "2d", data, 176)
            self.qform_code, self.sform_code = struct.unpack_from(order + "2i", data, 344)
            self.quatern = struct.unpack_from(order + "6d", data, 352)
            self.srow = struct.unpack_from(order + "12d", data, 400)
            self.units = struct.unpack_from(order + "i", data, 500)[0]
            self.time_offset = float(struct.unpack_from(order + "d", data, 216)[0])
        self.order = order
        self.version = version

    def size(self) -> tuple[int, int, int]:
        """Size along i, j, k.

        Raises
        ------
        ScanError
            The file holds no volume.
        """
        if not 1 <= self.dim[0] <= 7:
            raise ScanError(DAMAGED)
        size = [int(count) for count in self.dim[1 : self.dim[0] + 1]]
        check_size(size[:3])
        if any(count < 1 for count in size):
            raise ScanError(DAMAGED)
        if len(size) < 3:
            raise ScanError("this is a flat image: a volume of several slices is needed")
        return size[0], size[1], size[2]

    def frame_count(self) -> int:
        """Number of volumes along the fourth axis.

        Raises
        ------
        ScanError
            There are several along another one.
        """
        others = [int(count) for count in self.dim[4 : self.dim[0] + 1]]
        if any(count > 1 for count in others[1:]):
            raise ScanError(
                f"the file is {self.dim[0]}-D and holds {math.prod(others)} volumes (times or channels): "
                "export the one that is wanted as a 3-D file"
            )
        return others[0] if others else 1

    def times_ms(self) -> tuple[float, ...] | None:
        """Time of each volume, ms; None where no step or no unit is stated."""
        unit, step = UNIT_MS_OF_TIME.get(self.units & 0x38), float(self.pixdim[4])
        if unit is None or not (0.0 < step < math.inf and math.isfinite(self.time_offset)):
            return None
        # The header has float32 in NIfTI-1: of its digits nine are enough to write one.
        return tuple(round(unit * (self.time_offset + step * n), 6) for n in range(self.frame_count()))

    def dtype(self) -> np.dtype[Any]:
        """Type of the stored values.

        Raises
        ------
        ScanError
            They are not plain numbers.
        """
        if self.datatype not in SCALAR_TYPES:
            kind = OTHER_TYPES.get(self.datatype, "of an unusual kind")
            raise ScanError(f"the voxel values are {kind}: export the scan with one plain number per voxel")
        return np.dtype(self.order + SCALAR_TYPES[self.datatype])

    def geometry(self) -> Geometry:
        """Where the voxel centres lie; where no orientation is stated the axes are taken as L, P, S.

        Raises
        ------
        ScanError
            There is no such lattice, or sform and qform put it at different places.
        """
        if self.sform_code <= 0 and self.qform_code <= 0:
            return self._lattice(RAS_TO_LPS @ np.diag([*np.abs(self.pixdim[1:4]), 1.0]))
        if self.sform_code <= 0:
            return self._lattice(self._qform())
        sform = np.eye(4)
        sform[:3] = np.array(self.srow, dtype=np.float64).reshape(3, 4)
        geometry = self._lattice(sform)
        if self.qform_code > 0:
            apart = corner_distance_mm(geometry.affine, self._lattice(self._qform()).affine, self.size())
            world = geometry.index_to_world(corners_of(self.size()))
            if apart > AGREEMENT_MM + self._turn_by_rounding() * np.linalg.norm(world[-1] - world[0]):
                raise ScanError(
                    f"the header states two orientations (sform and qform) that lie {apart:.1f} mm apart: find out "
                    "which one is right, and export the scan with that one alone"
                )
        return geometry

    def _lattice(self, affine: Float64) -> Geometry:
        """Geometry of a map from index to RAS in the header's unit."""
        with np.errstate(over="ignore", invalid="ignore"):
            in_mm = affine * np.array([[UNIT_MM.get(self.units & 7, 1.0)]] * 3 + [[1.0]])
            return geometry_from_affine(RAS_TO_LPS @ in_mm, self.size()[::-1])

    def _turn_by_rounding(self) -> float:
        """Angle, rad, by which the qform may be off because the first part of its quaternion is not stored."""
        a_squared = 1.0 - sum(float(part) * float(part) for part in self.quatern[:3])
        low, high = max(0.0, a_squared - QUATERNION_ROUNDING), max(0.0, a_squared + QUATERNION_ROUNDING)
        return 2.0 * float(np.sqrt(high) - np.sqrt(low))

    @np.errstate(over="ignore", invalid="ignore")
    def _qform(self) -> Float64:
        if min(self.pixdim[1:4]) < 0.0:
            raise ScanError("the header gives a voxel size below zero beside its qform: export the file again")
        b, c, d, *offset = (float(value) for value in self.quatern)
        a_squared = 1.0 - (b * b + c * c + d * d)
        if a_squared < 1e-7:
            length = np.sqrt(b * b + c * c + d * d)
            a, b, c, d = 0.0, b / length, c / length, d / length
        else:
            a = np.sqrt(a_squared)
        rotation = np.array(
            [
                [a * a + b * b - c * c - d * d, 2 * (b * c - a * d), 2 * (b * d + a * c)],
                [2 * (b * c + a * d), a * a + c * c - b * b - d * d, 2 * (c * d - a * b)],
                [2 * (b * d - a * c), 2 * (c * d + a * b), a * a + d * d - c * c - b * b],
            ]
        )
        spacing = np.array(self.pixdim[1:4], dtype=np.float64)
        spacing[2] *= -1.0 if self.pixdim[0] < 0.0 else 1.0
        affine = np.eye(4)
        affine[:3, :3] = rotation * spacing
        affine[:3, 3] = offset
        return affine


def _order_and_version(data: bytes) -> tuple[str, int]:
    for order in ("<", ">"):
        length = struct.unpack_from(order + "i", data, 0)[0] if len(data) >= 348 else 0
        if length == 348 and data[344:347] == b"n+1":
            return order, 1
        if length == 348 and data[344:347] == b"ni1":
            raise ScanError("the values are in a separate .img file: export the scan as one .nii.gz file")
        if length == 540 and len(data) >= 540 and data[4:7] == b"n+2":
            return order, 2
    raise ScanError("the file is not a NIfTI file, or its start is damaged: export it again")


class _Rest:
    """What follows a start that was read already."""

    def __init__(self, start: bytes, stream: BinaryIO) -> None:
        self._start, self._stream = start, stream

    def read(self, count: int) -> bytes:
        head, self._start = self._start[:count], self._start[count:]
        return head + self._stream.read(count - len(head))


def _read(stream: BinaryIO, choice: FrameChoice | None) -> RawVolume:
    start = stream.read(540)
    header = _Header(start)
    size, dtype, count = header.size(), header.dtype(), header.frame_count()
    if count > 1 and choice is None:
        raise ScanError(
            f"the file is 4-D and holds {count} volumes (times or channels): export the one that is wanted as a 3-D "
            "file"
        )
    found = pick_frame(count, header.times_ms(), choice) if count > 1 and choice is not None else None
    geometry = header.geometry()
    shortest = 348 if header.version == 1 else 540
    if not shortest <= header.vox_offset <= 2**24:
        raise ScanError(DAMAGED)
    read = fully(_Rest(start, stream), DAMAGED)
    read(int(header.vox_offset))
    values = read_frame(read, (*size, count), 3, found.number if found else 0, dtype)
    # Reading on to the end makes gzip compare its checksum.
    stream.read(2**16)
    if np.isfinite(header.slope) and header.slope != 0.0 and (header.slope, header.inter) != (1, 0):
        if not np.isfinite(header.inter):
            raise ScanError("the header scales the values, but its intercept is not a number: export the file again")
        with np.errstate(over="ignore", invalid="ignore"):
            values = values * np.float64(header.slope) + np.float64(header.inter)
    return RawVolume(
        values=values,
        geometry=geometry,
        orientation_is_stated=header.sform_code > 0 or header.qform_code > 0,
        frame=found,
    )


def read_nifti(path: Path, choice: FrameChoice | None = None) -> RawVolume:
    """Read a volume of plain numbers from a NIfTI file.

    Parameters
    ----------
    path
        The file; compressed or not is told from its content.
    choice
        Which volume of a file of several; None where the file is to hold one.

    Returns
    -------
    RawVolume
        Values with slope and intercept applied, in the file's own type where there are none.

    Raises
    ------
    ScanError
        It is not such a file, it is cut short or damaged, its axes are sheared, or sform and qform disagree.
    """
    require_file(path)
    try:
        with path.open("rb") as file:
            if file.read(2) == b"\x1f\x8b":
                file.seek(0)
                with gzip.GzipFile(fileobj=file) as stream:
                    return _read(stream, choice)  # type: ignore[arg-type]
            file.seek(0)
            return _read(file, choice)
    except (OSError, EOFError, zlib.error, MemoryError):
        raise ScanError(DAMAGED) from None
