"""The volume that all readers of image files return, and the checks that they share.

No message names a path or a file: both may hold a patient's name, and the user knows which file was given.
"""

from __future__ import annotations

import contextlib
import stat
from collections.abc import Iterator, Sequence
from contextvars import ContextVar
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import numpy as np
import numpy.typing as npt
from pydantic import ValidationError

from heartcase.pipeline.formats.volumes.agreement import AGREEMENT_MM, corner_distance_mm, right_angled
from heartcase.pipeline.formats.volumes.frames import FrameFound
from heartcase.schemas.arrays import Float64
from heartcase.schemas.errors import HeartcaseError, Problem, ScanError
from heartcase.schemas.geometry import ORIGIN_LIMIT_MM, SPACING_LIMITS_MM, Geometry

__all__ = [
    "DAMAGED",
    "NOT_ONE_VOLUME",
    "VOXEL_LIMIT",
    "RawVolume",
    "at_most",
    "check_size",
    "geometry_from_affine",
    "placed",
    "require_file",
]

E = TypeVar("E", bound=HeartcaseError)

DAMAGED = "the file is cut short or damaged: copy or export it again"
NOT_ONE_VOLUME = "the file is {dimension}-D: export the one volume that is wanted as a 3-D file"

VOXEL_LIMIT = 2**30
"""Largest number of values in a volume, as many as 1024 x 1024 x 1024: a header that claims more is not believed."""


class _Bound(NamedTuple):
    """How many values a volume may have, and what is said of one that claims more."""

    most: int
    message: str


_TOO_LARGE = "the header claims more than 1024 x 1024 x 1024 values: crop the scan, or export it again"
_WIDEST = _Bound(VOXEL_LIMIT, _TOO_LARGE)
_BOUND: ContextVar[_Bound | None] = ContextVar("bound", default=None)


@contextlib.contextmanager
def at_most(count: int, message: str) -> Iterator[None]:
    """Refuse, in this thread, volumes of more values, before any is read.

    What is packed in a small file may be large: who reads what anybody may send says how large.

    Parameters
    ----------
    count
        Number of values; above :data:`VOXEL_LIMIT` that one counts.
    message
        What is said of a volume with more.
    """
    mark = _BOUND.set(_Bound(count, message)) if count < VOXEL_LIMIT else None
    try:
        yield
    finally:
        if mark is not None:
            _BOUND.reset(mark)


@dataclass(frozen=True)
class RawVolume:
    """A volume as a file holds it."""

    values: npt.NDArray[Any]
    """Values, shape ``geometry.shape``; with a fourth axis where every voxel holds several values."""
    geometry: Geometry
    """Where the voxel centres lie."""
    header: dict[str, str] = field(default_factory=dict)
    """NRRD: the key-value pairs of the header, which hold the segment table. For this package's eyes only."""
    orientation_is_stated: bool = True
    """Whether the file says which way the axes point in the patient."""
    frame: FrameFound | None = None
    """Which volume it is, of a file that holds several."""


def require_file(path: Path) -> None:
    """Make sure that this is a file with something in it (a pipe or a device could block for ever).

    Raises
    ------
    ScanError
        It is not.
    """
    try:
        status = path.stat()
    except (OSError, ValueError):
        raise ScanError("there is no such file or folder, or it may not be read: check the path") from None
    if not stat.S_ISREG(status.st_mode):
        raise ScanError("this is neither a file nor a folder: give an image file or a DICOM folder")
    if status.st_size == 0:
        raise ScanError("the file is empty: copy or export it again")


def check_size(size: Sequence[int], *, components: int = 1, limit: int | None = None) -> None:
    """Refuse sizes that no scan has.

    Parameters
    ----------
    size
        Number of voxels along each axis.
    components
        Number of values per voxel.
    limit
        How many values are too many where they are not kept; what :func:`at_most` says when left out.

    Raises
    ------
    ScanError
        A size is below one, or the product is above :data:`VOXEL_LIMIT`, or above what :func:`at_most` says.
    """
    if any(count < 1 for count in size) or components < 1:
        raise ScanError("the header gives a size below 1: the file is damaged, export it again")
    total = components
    for count in size:
        total *= count
    bound = (_BOUND.get() or _WIDEST) if limit is None else _Bound(limit, _TOO_LARGE)
    if total > bound.most:
        raise ScanError(bound.message)


def geometry_from_affine(affine: npt.ArrayLike, shape: tuple[int, ...]) -> Geometry:
    """Geometry from a homogeneous matrix.

    Parameters
    ----------
    affine
        Map from index (i, j, k, 1) to patient LPS mm, shape (4, 4).
    shape
        Shape ``[z, y, x]`` of the array.

    Returns
    -------
    Geometry
        Spacing is the length, direction the unit vector of each column; of columns that are not quite at right angles
        the nearest ones that are, about the middle of the volume.

    Raises
    ------
    ScanError
        The columns are zero, not finite, or so far from right angles that evening them out would move a corner of the
        volume by more than :data:`~heartcase.pipeline.formats.volumes.agreement.AGREEMENT_MM`.
    """
    matrix = np.asarray(affine, dtype=np.float64)
    with np.errstate(over="ignore", invalid="ignore"):
        spacing = np.linalg.norm(matrix[:3, :3], axis=0)
    low, high = SPACING_LIMITS_MM
    if not np.isfinite(matrix).all() or not low <= spacing.min() <= spacing.max() <= high:
        raise ScanError("the voxel spacing or position in the header is zero or not a number: export the file again")
    if np.abs(matrix[:3, 3]).max() > ORIGIN_LIMIT_MM:
        raise ScanError("the position in the header is kilometres away: export the file again")
    straight = right_angled(matrix, shape[::-1])
    off = corner_distance_mm(matrix, straight, shape[::-1])
    if off > AGREEMENT_MM:
        raise ScanError(
            f"the voxel axes are not at right angles (a sheared volume, by {off:.2g} mm at its corners): resample it "
            "onto a straight grid, for instance with 'Resample Scalar Volume' of 3D Slicer"
        )
    try:
        return _geometry(matrix, spacing, shape)
    except ValidationError:
        return _geometry(straight, spacing, shape)


def _geometry(matrix: Float64, spacing: Float64, shape: tuple[int, ...]) -> Geometry:
    return Geometry.of(shape=shape, origin_mm=matrix[:3, 3], spacing_mm=spacing, direction=matrix[:3, :3] / spacing)


def placed(error: HeartcaseError, place: str, kind: type[E]) -> E:
    """The same problems as an error of another kind, with ``place`` before each place."""
    return kind(
        Problem(f"{place}, {problem.place}" if problem.place and place else place or problem.place, problem.message)
        for problem in error.problems
    )
