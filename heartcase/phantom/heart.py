"""The phantom: a parametric heart that knows the true label and signed distance of every point."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
import numpy.typing as npt

from heartcase.phantom.anatomy import EXTENSION_MM, LONG_AXIS, SEPTUM_AXIS, UPWARD_AXIS, Anatomy, build_anatomy
from heartcase.phantom.truth import Truth
from heartcase.schemas.edit_settings import SeptalDefect
from heartcase.schemas.errors import UsageError
from heartcase.schemas.geometry import Geometry
from heartcase.schemas.labels import LabelTable, default_label_table
from heartcase.schemas.landmarks import Landmark
from heartcase.schemas.settings import EndMarker

__all__ = ["HeartPhantom"]

Float64 = npt.NDArray[np.float64]
Size = Literal["adult", "child"]


@dataclass(frozen=True)
class HeartPhantom:
    """A heart of analytic shapes in patient LPS mm: four chambers, septa, walls, great vessels with open ends.

    Make one with :meth:`adult`, :meth:`child` or :meth:`of_size`; the first use of a size tabulates its distance
    fields, which takes some seconds.
    """

    size: Size
    """Which heart."""
    scale: float
    """Size of its cavities against the shapes of :mod:`heartcase.phantom.anatomy`."""
    table: LabelTable
    """Labels of a segmentation, with the true wall thicknesses, without grown walls."""
    left_wall_mm: float
    """Thickness of the left ventricular myocardium at its middle."""
    defects: tuple[SeptalDefect, ...] = ()
    """Holes in the septa."""

    @classmethod
    def adult(cls, *, defects: Sequence[SeptalDefect] = ()) -> HeartPhantom:
        """A heart of an adult: about 200 ml of tissue."""
        return cls("adult", 0.93, default_label_table(), 9.0, tuple(defects))

    @classmethod
    def child(cls, *, defects: Sequence[SeptalDefect] = ()) -> HeartPhantom:
        """A heart of a child of about one year: about half the adult's size, thinner walls."""
        thin = {2: 2.5, 3: 1.5, 4: 1.5, 5: 1.3, 6: 1.2, 7: 1.0, 8: 1.0}
        labels = tuple(
            label.model_copy(update={"wall_thickness_mm": thin.get(label.value, 0.0)})
            for label in default_label_table()
        )
        return cls("child", 0.52, LabelTable(labels=labels), 5.0, tuple(defects))

    @classmethod
    def of_size(cls, size: str, *, defects: Sequence[SeptalDefect] = ()) -> HeartPhantom:
        """The phantom called ``adult`` or ``child``.

        Raises
        ------
        UsageError
            There is no such phantom.
        """
        if size == "adult":
            return cls.adult(defects=defects)
        if size == "child":
            return cls.child(defects=defects)
        raise UsageError(f"there is no phantom of size {size!r}: take adult or child", place="size")

    @cached_property
    def anatomy(self) -> Anatomy:
        """Distance fields, ends and named places."""
        return _anatomy(self.scale, self.left_wall_mm)

    @cached_property
    def truth(self) -> Truth:
        """True labels and signed distances of any points."""
        return Truth(self.anatomy.tables, self.table, self.ends, self.defects, EXTENSION_MM * self.scale + 20.0)

    @property
    def ends(self) -> tuple[EndMarker, ...]:
        """Discs where the vessels are cut off: behind them there is neither lumen nor wall."""
        return self.anatomy.ends

    @property
    def landmarks(self) -> tuple[Landmark, ...]:
        """Apex and centres of the four valves."""
        names = ("apex", "mitral valve", "tricuspid valve", "aortic valve", "pulmonary valve")
        places = self.anatomy.places
        return tuple(
            Landmark(name=name, kind="point", points_mm=((*(round(float(v), 3) for v in places[name]),),))
            for name in names
        )

    def ventricular_defect(self, diameter_mm: float, *, along_mm: float = 30.0) -> SeptalDefect:
        """A hole through the ventricular septum, ``along_mm`` from the base of the adult's heart."""
        radius = 22.0 * self.scale + 0.5 * self.left_wall_mm
        position = self.scale * along_mm * LONG_AXIS + radius * SEPTUM_AXIS
        return _defect(position, SEPTUM_AXIS, diameter_mm, 2.5 * self.left_wall_mm)

    def atrial_defect(self, diameter_mm: float) -> SeptalDefect:
        """A hole through the atrial septum between the middles of the atria."""
        left, right = self.anatomy.places["left atrium"], self.anatomy.places["right atrium"]
        line = left + np.linspace(0.0, 1.0, 801)[:, None] * (right - left)
        fields = self.anatomy.tables.evaluate(line)
        between = (fields[:, 2] > 0.0) & (fields[:, 3] > 0.0)
        septum = line[between]
        length = float(np.linalg.norm(septum[-1] - septum[0]))
        return _defect(0.5 * (septum[0] + septum[-1]), right - left, diameter_mm, length + 8.0 * self.scale)

    def scan_geometry(
        self, spacing_mm: float | Sequence[float], *, margin_mm: float = 12.0, oblique: bool = False
    ) -> Geometry:
        """Geometry of a scan that holds the whole heart.

        Parameters
        ----------
        spacing_mm
            Voxel size, one number or three (i, j, k).
        margin_mm
            Least distance of the heart from the border.
        oblique
            Turn the scan's axes into the heart's short-axis plane: k along the long axis.

        Raises
        ------
        UsageError
            A spacing is not above zero.
        """
        spacing = np.broadcast_to(np.asarray(spacing_mm, dtype=float), (3,))
        if not np.all(spacing > 0.0):
            raise UsageError("every spacing must be above zero", place="spacing")
        axes = np.stack([-SEPTUM_AXIS, -UPWARD_AXIS, LONG_AXIS]) if oblique else np.eye(3)
        if np.linalg.det(axes) < 0.0:
            axes[0] *= -1.0
        lower, upper = self.truth.extent(axes)
        lower, upper = lower - margin_mm, upper + margin_mm
        size = np.ceil((upper - lower) / spacing).astype(int)
        first = 0.5 * (lower + upper) - 0.5 * (size - 1) * spacing
        return Geometry.of(shape=tuple(size[::-1]), origin_mm=axes.T @ first, spacing_mm=spacing, direction=axes.T)


_ANATOMIES: dict[tuple[float, float], Anatomy] = {}


def _anatomy(scale: float, left_wall_mm: float) -> Anatomy:
    key = (scale, left_wall_mm)
    if key not in _ANATOMIES:
        _ANATOMIES[key] = build_anatomy(scale, left_wall_mm, 1.0 + 2.5 * scale)
    return _ANATOMIES[key]


def _defect(position: Float64, axis: Float64, diameter_mm: float, length_mm: float) -> SeptalDefect:
    unit = axis / np.linalg.norm(axis)
    return SeptalDefect(
        kind="septal_defect",
        position_mm=tuple(round(float(v), 3) for v in position),
        diameter_mm=diameter_mm,
        axis=tuple(round(float(v), 5) for v in unit),
        length_mm=round(length_mm, 3),
    )
