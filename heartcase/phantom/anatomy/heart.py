"""The phantom: a parametric heart that knows the true label and signed distance of every point."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from heartcase.phantom.anatomy.axes import LONG_AXIS, SEPTUM_AXIS, UPWARD_AXIS
from heartcase.phantom.anatomy.build import EXTENSION_MM, Anatomy, build_anatomy
from heartcase.phantom.anatomy.defects import mirrored_defect, place_defect, straight_defect
from heartcase.phantom.anatomy.sizes import proportions_of
from heartcase.phantom.anatomy.truth import Truth
from heartcase.schemas.errors import UsageError
from heartcase.schemas.geometry import Geometry
from heartcase.schemas.labels import Label, LabelTable, Role, default_label_table
from heartcase.schemas.landmarks import Landmark
from heartcase.schemas.recipe.edit_settings import SeptalDefect
from heartcase.schemas.recipe.heart_form import HeartDefect, HeartForm, HeartSize
from heartcase.schemas.recipe.settings import EndMarker

__all__ = ["HeartPhantom"]

_BAFFLE = Label(value=10, name="baffle", role=Role.DEVICE, colour="#e8e0c8")
_LEAFLETS = Label(value=10, name="valve leaflets", role=Role.DEVICE, colour="#f0d8b0")


@dataclass(frozen=True)
class HeartPhantom:
    """A heart of analytic shapes in patient LPS mm: four chambers, septa, walls, great vessels with open ends.

    Make one with :meth:`of_form`, :meth:`adult` or :meth:`child`; the first use of a form tabulates its distance
    fields, which takes some seconds.
    """

    form: HeartForm
    """Its size, its connections and what is wrong with it."""
    scale: float
    """Size of its cavities against the shapes of :mod:`heartcase.phantom.anatomy.build`."""
    table: LabelTable
    """Labels of a segmentation, with the true wall thicknesses, without grown walls."""
    left_wall_mm: float
    """Thickness of the left ventricular myocardium at its middle."""
    more_defects: tuple[SeptalDefect, ...] = ()
    """Holes in the septa beside those of the form."""

    @classmethod
    def of_form(cls, form: HeartForm, *, defects: Sequence[SeptalDefect] = ()) -> HeartPhantom:
        """The heart of a form."""
        sizes = proportions_of(form)
        labels = [
            label.model_copy(update={"wall_thickness_mm": sizes.walls_mm.get(label.value, label.wall_thickness_mm)})
            for label in default_label_table()
        ]
        if form.baffle is not None:
            labels.append(_BAFFLE)
        elif form.has_valve_leaflets:
            labels.append(_LEAFLETS)
        return cls(form, sizes.scale, LabelTable(labels=tuple(labels)), sizes.left_wall_mm, tuple(defects))

    @classmethod
    def adult(cls, *, defects: Sequence[SeptalDefect] = ()) -> HeartPhantom:
        """A heart of an adult: about 200 ml of tissue."""
        return cls.of_form(HeartForm(size="adult"), defects=defects)

    @classmethod
    def child(cls, *, defects: Sequence[SeptalDefect] = ()) -> HeartPhantom:
        """A heart of a child of about one year: about half the adult's size, thinner walls."""
        return cls.of_form(HeartForm(size="child"), defects=defects)

    @classmethod
    def of_size(cls, size: str, *, defects: Sequence[SeptalDefect] = ()) -> HeartPhantom:
        """The normal heart called ``adult`` or ``child``.

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

    @property
    def size(self) -> HeartSize:
        """Which heart."""
        return self.form.size

    @cached_property
    def twin(self) -> HeartPhantom:
        """The same heart not mirrored; itself where it is not."""
        if not self.form.is_mirrored:
            return self
        plain = self.form.model_copy(update={"is_mirrored": False})
        return replace(self, form=plain, more_defects=tuple(mirrored_defect(one) for one in self.more_defects))

    @cached_property
    def defects(self) -> tuple[SeptalDefect, ...]:
        """All holes in the septa."""
        if self.form.is_mirrored:
            return tuple(mirrored_defect(one) for one in self.twin.defects)
        return (*(place_defect(one, self.anatomy, self.scale) for one in self.form.defects), *self.more_defects)

    def prepare(self, told: Callable[[float], None]) -> None:
        """Work out the distance fields, which takes seconds, and tell meanwhile how far they are, from 0 to 1."""
        _anatomy(self.form, told)

    @cached_property
    def anatomy(self) -> Anatomy:
        """Distance fields, ends and named places."""
        if self.form.is_mirrored:
            return self.twin.anatomy.mirrored()
        return _anatomy(self.form)

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
        return straight_defect(position, SEPTUM_AXIS, diameter_mm, 2.5 * self.left_wall_mm)

    def atrial_defect(self, diameter_mm: float) -> SeptalDefect:
        """A hole through the atrial septum between the middles of the atria."""
        return place_defect(HeartDefect(kind="secundum", diameter_mm=diameter_mm), self.anatomy, self.scale)

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
        if oblique and self.form.is_mirrored:
            axes = axes * np.array((-1.0, 1.0, 1.0))
        if np.linalg.det(axes) < 0.0:
            axes[0] *= -1.0
        lower, upper = self.truth.extent(axes)
        lower, upper = lower - margin_mm, upper + margin_mm
        size = np.ceil((upper - lower) / spacing).astype(int)
        first = 0.5 * (lower + upper) - 0.5 * (size - 1) * spacing
        return Geometry.of(shape=tuple(size[::-1]), origin_mm=axes.T @ first, spacing_mm=spacing, direction=axes.T)


_ANATOMIES: dict[str, Anatomy] = {}
_KEPT_COUNT = 4
"""Hearts whose tables are kept, 60 MB each."""


def _anatomy(form: HeartForm, told: Callable[[float], None] = lambda _: None) -> Anatomy:
    # Those defects that are canals alone leave the shapes as they are.
    moving = tuple(defect for defect in form.defects if defect.kind == "sinus venosus")
    shaping = form.model_copy(update={"defects": moving, "right_ventricular_wall_mm": None})
    key = shaping.model_dump_json()
    if key not in _ANATOMIES:
        if len(_ANATOMIES) >= _KEPT_COUNT:
            _ANATOMIES.pop(next(iter(_ANATOMIES)))
        _ANATOMIES[key] = build_anatomy(shaping, told)
    return _ANATOMIES[key]
