"""Where a volume or a grid lies in patient space."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from pydantic import Field, field_validator

from heartcase.schemas.arrays import Float64
from heartcase.schemas.base import Model, Vector3

__all__ = ["ORIGIN_LIMIT_MM", "SPACING_LIMITS_MM", "Geometry"]

Matrix3 = tuple[Vector3, Vector3, Vector3]
ORIGIN_LIMIT_MM = 1e7
"""Ten kilometres: whatever is farther away is no patient, and loses digits."""
SPACING_LIMITS_MM = (1e-6, 1e4)
IDENTITY: Matrix3 = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


class Geometry(Model):
    """Position, spacing and orientation of a regular lattice of points in patient LPS space, in mm.

    World point of index (i, j, k): ``origin_mm + direction @ (spacing_mm * (i, j, k))``. The arrays that go with
    it are indexed ``[k, j, i]``, that is ``[z, y, x]``. The direction may be oblique and may be left-handed.
    """

    size: tuple[int, int, int]
    """Number of points along i, j, k (the reverse of the array's shape)."""
    origin_mm: Vector3 = (0.0, 0.0, 0.0)
    """World position of point (0, 0, 0): for a volume the centre of its first voxel."""
    spacing_mm: Vector3 = (1.0, 1.0, 1.0)
    """Distance between neighbours along i, j, k."""
    direction: Matrix3 = Field(default=IDENTITY)
    """Rows of a 3 x 3 matrix whose columns are the unit vectors of i, j, k in world space."""

    @field_validator("size")
    @classmethod
    def _size_is_positive(cls, value: tuple[int, int, int]) -> tuple[int, int, int]:
        if min(value) < 1:
            raise ValueError("every size must be at least 1")
        return value

    @field_validator("origin_mm")
    @classmethod
    def _origin_is_near(cls, value: Vector3) -> Vector3:
        if max(map(abs, value)) > ORIGIN_LIMIT_MM:
            raise ValueError(f"the origin must be within {ORIGIN_LIMIT_MM:g} mm")
        return value

    @field_validator("spacing_mm")
    @classmethod
    def _spacing_is_positive(cls, value: Vector3) -> Vector3:
        if not SPACING_LIMITS_MM[0] <= min(value) <= max(value) <= SPACING_LIMITS_MM[1]:
            low, high = SPACING_LIMITS_MM
            raise ValueError(f"every spacing must be above zero: from {low:g} to {high:g} mm")
        return value

    @field_validator("direction")
    @classmethod
    def _direction_is_orthonormal(cls, value: Matrix3) -> Matrix3:
        matrix = np.array(value)
        if np.abs(matrix).max() > 1.1 or not np.allclose(matrix.T @ matrix, np.eye(3), atol=1e-4):
            raise ValueError("the direction vectors must be at right angles and of length one (sheared volume?)")
        return value

    @classmethod
    def of(
        cls,
        *,
        shape: tuple[int, ...],
        origin_mm: npt.ArrayLike = (0.0, 0.0, 0.0),
        spacing_mm: npt.ArrayLike = (1.0, 1.0, 1.0),
        direction: npt.ArrayLike = IDENTITY,
    ) -> Geometry:
        """Make a geometry from array-likes; ``shape`` is an array's ``[z, y, x]``, direction is 3 x 3 or 9 long.

        Parameters
        ----------
        shape
            Shape ``[z, y, x]`` of the arrays.
        origin_mm
            World position of the centre of voxel (0, 0, 0), LPS mm, shape (3,).
        spacing_mm
            Distance of voxel centres along i, j, k, mm, shape (3,).
        direction
            Columns are the unit vectors of i, j, k in LPS axes, shape (3, 3) or (9,).
        """
        matrix = np.asarray(direction, dtype=float).reshape(3, 3)
        data: dict[str, Any] = {
            "size": tuple(int(n) for n in reversed(shape)),
            "origin_mm": tuple(float(v) for v in np.asarray(origin_mm)),
            "spacing_mm": tuple(float(v) for v in np.asarray(spacing_mm)),
            "direction": tuple(tuple(float(v) for v in row) for row in matrix),
        }
        return cls(**data)

    @property
    def shape(self) -> tuple[int, int, int]:
        """Shape ``[z, y, x]`` of the arrays that go with this geometry."""
        return self.size[2], self.size[1], self.size[0]

    @property
    def direction_matrix(self) -> Float64:
        """Direction, shape (3, 3), columns are the axes."""
        return np.array(self.direction)

    @property
    def index_to_world_matrix(self) -> Float64:
        """Linear part of the map from index (i, j, k) to world mm, shape (3, 3)."""
        matrix: Float64 = self.direction_matrix * np.array(self.spacing_mm)
        return matrix

    @property
    def affine(self) -> Float64:
        """Homogeneous map from index (i, j, k, 1) to world mm, shape (4, 4)."""
        affine = np.eye(4)
        affine[:3, :3] = self.index_to_world_matrix
        affine[:3, 3] = self.origin_mm
        return affine

    @property
    def is_right_handed(self) -> bool:
        """Whether i, j, k form a right-handed frame in world space."""
        return bool(np.linalg.det(self.direction_matrix) > 0.0)

    @property
    def voxel_volume_mm3(self) -> float:
        """Volume of one voxel or cell, in mm3."""
        return float(np.prod(self.spacing_mm))

    def index_to_world(self, points: npt.ArrayLike) -> Float64:
        """Map continuous indices (i, j, k), shape (..., 3), to world mm (x, y, z)."""
        world: Float64 = np.asarray(points, dtype=float) @ self.index_to_world_matrix.T
        world += np.array(self.origin_mm)
        return world

    def world_to_index(self, points: npt.ArrayLike) -> Float64:
        """Map world points (x, y, z) in mm, shape (..., 3), to continuous indices (i, j, k)."""
        shifted = np.asarray(points, dtype=float) - np.array(self.origin_mm)
        index: Float64 = shifted @ np.linalg.inv(self.index_to_world_matrix).T
        return index

    def cropped(self, start: tuple[int, int, int], size: tuple[int, int, int]) -> Geometry:
        """Geometry of the box that starts at index (i, j, k) with this size; may also reach outside.

        Parameters
        ----------
        start
            Index (i, j, k) of the box's first voxel.
        size
            Voxels along i, j, k.
        """
        origin = self.index_to_world(start)
        return self.model_copy(update={"size": size, "origin_mm": tuple(float(v) for v in origin)})

    def flipped(self, axis: int) -> Geometry:
        """Geometry of the same points counted backwards along axis 0 (i), 1 (j) or 2 (k)."""
        last = [0, 0, 0]
        last[axis] = self.size[axis] - 1
        matrix = self.direction_matrix
        matrix[:, axis] *= -1.0
        return Geometry.of(
            shape=self.shape,
            origin_mm=self.index_to_world(last),
            spacing_mm=self.spacing_mm,
            direction=matrix,
        )

    def refined(self, factor: int) -> Geometry:
        """Geometry of a lattice ``factor`` times as fine over the same voxels (same outer faces)."""
        shift = -0.5 + 0.5 / factor
        return Geometry.of(
            shape=tuple(n * factor for n in self.shape),
            origin_mm=self.index_to_world((shift, shift, shift)),
            spacing_mm=np.array(self.spacing_mm) / factor,
            direction=self.direction,
        )

    def matches(self, other: Geometry, *, tolerance_mm: float = 1e-3) -> bool:
        """Whether both describe the same points: same size, and corners within ``tolerance_mm``.

        Parameters
        ----------
        other
            What is compared.
        tolerance_mm
            How far apart corners may be, mm.
        """
        if self.size != other.size:
            return False
        last = np.array(self.size) - 1
        corners = np.array([[i, j, k] for i in (0, last[0]) for j in (0, last[1]) for k in (0, last[2])])
        gap = self.index_to_world(corners) - other.index_to_world(corners)
        return bool(np.abs(gap).max() <= tolerance_mm)
