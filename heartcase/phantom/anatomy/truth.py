"""True labels and signed distances of any points.

A region's value (:mod:`heartcase.phantom.anatomy.regions`) is a lower bound on the distance to the region's border, and
points on the border bound it from above; :mod:`heartcase.phantom.anatomy.border` closes the gap to
:data:`TOLERANCE_MM`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

from heartcase.phantom.anatomy.border import STEEPNESS, border_distances
from heartcase.phantom.anatomy.regions import TISSUE, label_points, region_values
from heartcase.phantom.anatomy.tables import DistanceTables
from heartcase.schemas.arrays import Bool, Float64, Int64, UInt8
from heartcase.schemas.labels import LabelTable, Role
from heartcase.schemas.recipe.edit_settings import SeptalDefect
from heartcase.schemas.recipe.settings import EndMarker

__all__ = ["TOLERANCE_MM", "Truth"]

TOLERANCE_MM = 0.01
"""How far a distance may be off, unless another tolerance is asked for."""
_REACH_MM = 0.003
"""Half the way on which the sign must change for a point to count as one of the border."""
_BLOCK = 4
_SAMPLE_STEPS = 1.5
"""Steps of the tables between points of the border: 1.4 mm in the adult."""


@dataclass(frozen=True)
class Truth:
    """What is where in a phantom."""

    tables: DistanceTables
    """Distance fields of the lumens of labels 1-8 and of the left epicardial body."""
    label_table: LabelTable
    """Labels with their wall thicknesses, without grown walls."""
    ends: tuple[EndMarker, ...]
    """End discs."""
    defects: tuple[SeptalDefect, ...]
    """Holes in the septa."""
    reach_mm: float
    """How far behind an end disc the vessel is taken away."""
    _clouds: dict[int, tuple[cKDTree, Float64]] = field(default_factory=dict, repr=False, compare=False)

    @property
    def table(self) -> LabelTable:
        """All labels that occur, grown walls included."""
        return self.label_table.with_walls()

    @property
    def kernel_arguments(self) -> tuple[object, Float64, Float64, Float64, Int64]:
        """What the kernels of :mod:`heartcase.phantom.anatomy.regions` take."""
        table = self.table
        thickness = np.array([table[value].wall_thickness_mm for value in range(1, 9)])
        devices = [label.value for label in table if label.role is Role.DEVICE]
        walls = np.array([*(table.wall_value(value) or 255 for value in range(1, 9)), *(devices[:1] or [255])])
        ends = [
            [table[end.label].value - 1, *end.position_mm, *_unit(end.axis), end.radius_mm, self.reach_mm]
            for end in self.ends
        ]
        canals = []
        for defect in self.defects:
            axis = _unit(defect.axis)
            start = np.array(defect.position_mm) - 0.5 * defect.length_mm * axis
            row = [*start, *axis, 0.5 * defect.diameter_mm, defect.length_mm]
            if defect.width_mm is None or defect.long_axis is None:
                canals.append([*row, 0.0, 0.0, 0.0, 0.5 * defect.diameter_mm, 0.0])
                continue
            long = np.array(defect.long_axis) - (np.array(defect.long_axis) @ axis) * axis
            canals.append([*row, *_unit(long), 0.5 * defect.width_mm, 1.0 if defect.shape == "elliptic" else 2.0])
        return (
            self.tables.kernel_arguments,
            np.array(ends, dtype=float).reshape(-1, 9),
            np.array(canals, dtype=float).reshape(-1, 13),
            thickness,
            walls.astype(np.int64),
        )

    def label(self, points_mm: npt.ArrayLike) -> UInt8:
        """Label of each point, shape (..., 3) in mm -> (...), uint8, values of :attr:`table`."""
        points = np.asarray(points_mm, dtype=float)
        flat = np.ascontiguousarray(points.reshape(-1, 3))
        labels = np.empty(len(flat), np.uint8)
        label_points(*self.kernel_arguments, flat, labels)
        return labels.reshape(points.shape[:-1])

    def distance(self, points_mm: npt.ArrayLike, label: int, *, tolerance_mm: float = TOLERANCE_MM) -> Float64:
        """Signed distance to the border of the region with a label, mm, negative inside.

        Parameters
        ----------
        points_mm
            World points, shape (..., 3).
        label
            A value of :attr:`table`, the background and the grown walls included.
        tolerance_mm
            How far a distance may be off; the time goes up with one over it (about 1 ms a point and core).

        Returns
        -------
        Array of shape (...), within ``tolerance_mm`` of the true distance everywhere.
        """
        return self._distance(points_mm, int(label), tolerance_mm)

    def tissue_distance(self, points_mm: npt.ArrayLike, *, tolerance_mm: float = TOLERANCE_MM) -> Float64:
        """Signed distance to the border of all tissue together (myocardium and walls), mm, shape (..., 3) -> (...)."""
        return self._distance(points_mm, TISSUE, tolerance_mm)

    def value(self, points_mm: npt.ArrayLike, label: int | None = None) -> Float64:
        """Continuous value with the sign and zero set of the distance, of one label or (None) of all tissue.

        Cheaper than the distance, hardly ever larger in size, and equal to it where one smooth face of the border is
        nearest: what to contour for a picture.
        """
        points = np.asarray(points_mm, dtype=float)
        region = TISSUE if label is None else int(label)
        return self._value(np.ascontiguousarray(points.reshape(-1, 3)), region).reshape(points.shape[:-1])

    def extent(self, axes: Float64) -> tuple[Float64, Float64]:
        """Least and greatest coordinate of the tissue along the rows of ``axes``, each shape (3,), within 1 mm."""
        step = 2.0 * self.tables.spacing_mm
        lower = self.tables.origin_mm.min(axis=0)
        upper = (self.tables.origin_mm + (self.tables.size - 1) * self.tables.spacing_mm).max(axis=0)
        lattice = np.meshgrid(*(np.arange(a, b, step) for a, b in zip(lower, upper, strict=True)), indexing="ij")
        points = np.stack([axis.ravel() for axis in lattice], axis=1)
        value = self._value(points, TISSUE)
        inside = value < 0.0
        along = points[inside] @ axes.T
        room = -value[inside, None]
        return (along - room).min(axis=0), (along + room).max(axis=0)

    def surface_points(self, label: int | None = None) -> Float64:
        """Points on the border of a label's region (None: of all tissue), shape (n, 3), about 1.4 mm apart (adult)."""
        return self._cloud(TISSUE if label is None else int(label))[1]

    def _value(self, points: Float64, region: int) -> Float64:
        values = np.empty(len(points))
        region_values(*self.kernel_arguments, region, points, values)
        return values

    def _distance(self, points_mm: npt.ArrayLike, region: int, tolerance_mm: float) -> Float64:
        points = np.asarray(points_mm, dtype=float)
        flat = np.ascontiguousarray(points.reshape(-1, 3))
        value = self._value(flat, region)
        tree, _ = self._cloud(region)
        upper = np.asarray(tree.query(flat, workers=-1)[0], dtype=float) + _REACH_MM
        foot, unit = self._on_border(flat, region, steps=2)
        gap = np.linalg.norm(foot - flat, axis=1) + _REACH_MM
        upper = np.where(self._crosses(foot, unit, region), np.minimum(upper, gap), upper)
        size = np.empty(len(flat))
        border_distances(*self.kernel_arguments, region, flat, upper, tolerance_mm, STEEPNESS, size)
        return np.copysign(size, value).reshape(points.shape[:-1])

    def _on_border(self, points: Float64, region: int, *, steps: int) -> tuple[Float64, Float64]:
        """Newton steps along the value's gradient; returns the points and the last unit gradient."""
        at = points.copy()
        unit = np.zeros_like(at)
        for _ in range(steps):
            value = self._value(at, region)
            unit, length = self._gradient(at, region)
            at -= unit * (value / np.clip(length, 0.3, None))[:, None]
        return at, unit

    def _crosses(self, points: Float64, unit: Float64, region: int) -> Bool:
        """Where the value changes its sign across a point."""
        before = self._value(points - _REACH_MM * unit, region) < 0.0
        crosses: Bool = before != (self._value(points + _REACH_MM * unit, region) < 0.0)
        return crosses

    def _gradient(self, points: Float64, region: int) -> tuple[Float64, Float64]:
        step = 0.01 * self.tables.spacing_mm
        gradient = np.empty_like(points)
        for axis in range(3):
            shift = np.zeros(3)
            shift[axis] = step
            gradient[:, axis] = self._value(points + shift, region) - self._value(points - shift, region)
        gradient /= 2.0 * step
        length = np.linalg.norm(gradient, axis=1)
        return gradient / np.maximum(length, 1e-9)[:, None], length

    def _cloud(self, region: int) -> tuple[cKDTree, Float64]:
        if region not in self._clouds:
            points = self._border_samples(region)
            self._clouds[region] = (cKDTree(points), points)
        return self._clouds[region]

    def _border_samples(self, region: int) -> Float64:
        """Crossings of the border with a lattice, refined onto it."""
        step = _SAMPLE_STEPS * self.tables.spacing_mm
        corners = self.tables.origin_mm.min(axis=0)
        top = (self.tables.origin_mm + (self.tables.size - 1) * step).max(axis=0)
        blocks = np.ceil((top - corners) / (_BLOCK * step)).astype(int)
        centres = corners + (np.moveaxis(np.indices(tuple(blocks)), 0, -1).reshape(-1, 3) + 0.5) * _BLOCK * step
        reach = 0.5 * _BLOCK * step * np.sqrt(3.0)
        centres = centres[np.abs(self._value(centres, region)) <= reach * 1.05]
        offsets = (np.moveaxis(np.indices((_BLOCK + 1,) * 3), 0, -1) - 0.5 * _BLOCK) * step
        found = []
        for part in np.array_split(centres, max(1, len(centres) // 2000)):
            points = part[:, None, None, None, :] + offsets
            values = self._value(np.ascontiguousarray(points.reshape(-1, 3)), region).reshape(points.shape[:-1])
            for axis in (1, 2, 3):
                before = tuple(
                    slice(None, -1) if a == axis else slice(None, -1) if a else slice(None) for a in range(4)
                )
                after = tuple(slice(1, None) if a == axis else slice(None, -1) if a else slice(None) for a in range(4))
                crossing = (values[before] < 0.0) != (values[after] < 0.0)
                a, b = values[before][crossing], values[after][crossing]
                fraction = (a / (a - b))[:, None]
                found.append(points[before][crossing] * (1.0 - fraction) + points[after][crossing] * fraction)
        samples, unit = self._on_border(np.concatenate(found), region, steps=4)
        return samples[self._crosses(samples, unit, region)]


def _unit(axis: Sequence[float] | Float64) -> Float64:
    vector = np.asarray(axis, dtype=float)
    unit: Float64 = vector / np.linalg.norm(vector)
    return unit
