"""Septa and shared walls by anatomy: where cavities that a heart does not join touch, a wall is grown between them.

A septum of 1 to 2 mm is lost in voxels of 1.5 mm: the outlines of the two cavities then touch, and no wall grows into
background there, because there is none. Which cavities are kept apart follows from their names and from what they meet
(see :func:`pairs_kept_apart`); the recipe can say otherwise in either direction. How thick a septum is follows from the
size of the heart, or from the recipe. Where the recipe states an opening, by a landmark or by strokes that run into
each other, the septum is left open as wide as it says.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from heartcase.pipeline.checks.contact_balls import open_balls
from heartcase.pipeline.checks.openings import POINT_REACH_MM, Verdict, root_of_surface_m, states_an_opening, verdict_of
from heartcase.pipeline.data import Reshaping, Segmentation, Septum, Structures
from heartcase.pipeline.fields.contacts import Contact, Extent, find_contact
from heartcase.pipeline.markers.meeting_strokes import meetings_of
from heartcase.pipeline.walls.grown_places import ContactPatch, grown_warnings, patches_of
from heartcase.pipeline.warnings import CaseWarning
from heartcase.schemas.arrays import Bool, Float64, UInt8
from heartcase.schemas.labels import LabelTable
from heartcase.schemas.landmarks import Landmark
from heartcase.schemas.recipe.settings import ContactPlace, Stroke, WallsSettings
from heartcase.schemas.terms import Term, term_by_name

__all__ = [
    "OpenPlace",
    "SeptumFigures",
    "open_places",
    "pairs_kept_apart",
    "septum_figures",
    "septum_thickness_mm",
    "septum_warnings",
    "with_septa",
]


Pair = tuple[int, int]

ADULT_SURFACE_M2 = 1.9
"""Body surface area of the hearts for which ``ADULT_MM`` holds."""
ADULT_MM = {
    "atria": 1.8,
    "ventricles": 2.5,
    "arteries": 2.0,
    "artery and atrium": 2.0,
    "atrium and other ventricle": 2.0,
    "vein or appendage": 1.5,
}
"""What lies between -> thickness in an adult, mm. Atria: the floor of the oval fossa, 1.8 mm (SD 0.7) in Schwinger et
al., American Heart Journal 119, 1990, doi 10.1016/s0002-8703(05)80191-7; only what is so thin is lost in the voxels. No
table was found of the others: round numbers, about what two thin walls are together."""
LEAST_MM = 0.8
"""The thinnest septum, of the smallest hearts."""
ROOT_RANGE = (0.4, 1.2)
"""Least and greatest thickness against the adult's."""
ROUNDING_MM = 0.05
"""Thickness is rounded to this, so that it does not hang on a few voxels."""
BLOOD_IN_VENTRICLES = 6.0
"""All blood of a heart with its great vessels against that of one ventricle: measured on the phantoms, 5.3 to 7."""
OWN_OPENING_MM = 4.0
"""Diameter from which a contact counts as the way to a structure's own chamber, in an adult."""
OWN_SHARE = 0.5
"""Area of an atrium's way into its own ventricle against its contact with the other one, from which the latter is no
way: where the connection is discordant, or both atria open into one ventricle, the former is missing or small."""


def _term(name: str) -> Term:
    found = term_by_name(name)
    if found is None:
        raise KeyError(name)
    return found


def _terms(names: str) -> frozenset[Term]:
    return frozenset(_term(name) for name in names.split())


_LV, _RV, _LA, _RA, _AORTA, _PA, _SVC, _IVC, _CS, _PV, _LAA, _RAA = (
    _term(name) for name in ("lv", "rv", "la", "ra", "aorta", "pa", "svc", "ivc", "cs", "pv", "laa", "raa")
)
_ATRIA, _VENTRICLES, _ARTERIES = _terms("la ra"), _terms("lv rv"), _terms("aorta pa")
_INFLOWS = (_terms("ra svc ivc cs raa"), _terms("la pv laa"))
"""What drains into one atrium; within such a group nothing is grown."""
_OWN: Mapping[Term, frozenset[Term]] = {
    _RA: _terms("rv"),
    _LA: _terms("lv"),
    _RV: _terms("ra la"),
    _LV: _terms("la ra"),
    _SVC: _terms("ra"),
    _IVC: _terms("ra"),
    _CS: _terms("ra"),
    _PV: _terms("la"),
    _LAA: _terms("la"),
    _RAA: _terms("ra"),
    _AORTA: _VENTRICLES,
    _PA: _VENTRICLES,
}
"""Structure -> what it opens into, or arises from."""
_INSTEAD: Mapping[Term, frozenset[Term]] = {
    _RA: _terms("la lv"),
    _LA: _terms("ra rv"),
    _RV: _terms("lv"),
    _LV: _terms("rv"),
    _SVC: _terms("la pa"),
    _IVC: _terms("la pa"),
    _CS: _terms("la"),
    _PV: _terms("ra svc ivc cs"),
    _LAA: _terms("ra"),
    _RAA: _terms("la"),
    _AORTA: _terms("pa"),
    _PA: _terms("aorta"),
}
"""Structure -> what its blood goes to or comes from in hearts where it does not meet its own: tricuspid and mitral
atresia, anomalous veins, a cavopulmonary anastomosis, a common arterial trunk."""


class OpenPlace(NamedTuple):
    """A place where the recipe says that a septum is open: the shape of :class:`~heartcase.pipeline.data.Reshaping`."""

    shape: str
    points_mm: tuple[tuple[float, float, float], ...]
    radius_mm: float
    values: Pair | None = None
    """The two cavities that it is about; None for any."""

    def is_about(self, pair: Pair) -> bool:
        """Whether it opens a septum between these two, the lower value first."""
        return self.values in (None, pair)

    def holds(self, points_mm: Float64, margin_mm: float = 0.0) -> Bool:
        """Which points, world mm, shape (n, 3), lie in it, or no farther from it than a margin.

        A margin makes a cylinder longer and wider, so its rim has corners.
        """
        points, radius = np.array(self.points_mm), self.radius_mm + margin_mm
        if self.shape == "cylinder":
            length = float(np.linalg.norm(points[1] - points[0]))
            away = points_mm - points[0]
            along = away @ (points[1] - points[0]) / length
            squares = np.einsum("ij,ij->i", away, away) - along * along
            within: Bool = (along >= -margin_mm) & (along <= length + margin_mm) & (squares <= radius**2)
            return within
        nearest = np.full(len(points_mm), np.inf)
        for start, end in pairwise(points) if len(points) > 1 else [(points[0], points[0])]:
            away, line = points_mm - start, end - start
            share = np.clip(away @ line / max(float(line @ line), np.finfo(float).tiny), 0.0, 1.0)
            nearest = np.minimum(nearest, np.linalg.norm(away - share[:, None] * line, axis=1))
        return nearest <= radius


@dataclass(frozen=True)
class SeptumFigures:
    """A septum that was grown, and where."""

    septum: Septum
    extent: Extent
    """The contact on both sides of which it was grown, without the openings that the recipe states in it."""
    places: tuple[ContactPatch, ...] = ()
    """Its patches that are worth a look, the largest first."""
    others: ContactPatch | None = None
    """All its other patches together; None where there are none."""


def open_places(
    strokes: Sequence[Stroke],
    landmarks: Sequence[Landmark],
    table: LabelTable,
    contacts: Sequence[ContactPlace] = (),
) -> tuple[OpenPlace, ...]:
    """Where the recipe states openings, beside its edits.

    A landmark whose name says so (:func:`~heartcase.pipeline.checks.openings.states_an_opening`) opens every septum
    near it: a ring a canal of its radius, a point a ball of its radius or of
    :data:`~heartcase.pipeline.checks.openings.POINT_REACH_MM`. Strokes of two cavities that run into each other open
    the septum between these two along both lines, as wide as the narrower brush. A place of ``walls.contact`` that is
    open is a ball between its two, which keeps out of the places of the same two that are wall.
    """
    places = [_of_landmark(landmark) for landmark in landmarks if states_an_opening(landmark)]
    for one in meetings_of(strokes, table):
        places += [OpenPlace("strokes", tube, one.radius_mm, one.values) for tube in one.tubes_mm]
    places += [
        OpenPlace("strokes", (ball.center_mm,), ball.radius_mm, ball.values) for ball in open_balls(contacts, table)
    ]
    return tuple(places)


def with_septa(
    structures: Structures, labels: UInt8, settings: WallsSettings, places: Sequence[OpenPlace] = ()
) -> tuple[Structures, tuple[SeptumFigures, ...]]:
    """Structures with a septum wherever two cavities touch that are kept apart.

    Parameters
    ----------
    structures
        With walls and vessel ends, and without septa.
    labels
        Label of every voxel of their lattice, walls included.
    settings
        Which pairs are named, and how thick.
    places
        Where septa are open, from :func:`open_places`.

    Returns
    -------
    structures, figures
        The same structures where nothing touches that is kept apart. There are no figures of a septum of which the
        stated openings leave no more than a rim narrower than a voxel.
    """
    voxels = Segmentation(labels, structures.geometry, structures.table)
    contact = find_contact(structures, voxels)
    areas = _extents(contact)
    root_m = _root_m(voxels)
    wanted = pairs_kept_apart(structures.table, {pair: one.area_mm2 for pair, one in areas.items()}, settings, root_m)
    table = structures.table
    septa: list[Septum] = []
    cuts: list[Reshaping] = []
    for (first, second), thickness in sorted(wanted.items()):
        table = table.with_septum(first, second)
        label = next(one for one in table if one.septum_of == (first, second))
        septa.append(Septum(label.value, first, second, thickness))
        names = (table[first].name, table[second].name)
        cuts += [
            Reshaping(one.shape, one.points_mm, one.radius_mm, (label.name,), names)
            for one in places
            if one.is_about((first, second))
        ]
    if not septa:
        return structures, ()
    grown = replace(structures, table=table, septa=tuple(septa), reshapings=(*cuts, *structures.reshapings))
    voxel_mm = structures.geometry.voxel_volume_mm3 ** (1.0 / 3.0)
    figures = []
    for one in septa:
        closed = _closed(contact[(contact.pairs == (one.first, one.second)).all(axis=1)], places, voxel_mm)
        if closed is not None:
            figures.append(SeptumFigures(one, closed.extent(), *patches_of(closed)))
    return grown, tuple(figures)


def pairs_kept_apart(
    table: LabelTable, areas_mm2: Mapping[Pair, float], settings: WallsSettings, root_m: float
) -> dict[Pair, float]:
    """Which of the pairs that touch get a septum, and how thick.

    By their names: the atria; the ventricles; the great arteries; an artery and an atrium, vein or appendage; veins,
    appendages and atria of different sides; a vein or an appendage and a ventricle; and an atrium and the ventricle of
    the other side where its way into its own is at least half as wide. Nothing is grown between a ventricle and an
    artery, within one side's atrium, veins and appendage, and beside what the vocabulary does not know, such as a
    common atrium or a single ventricle. A structure that does not meet what it opens into in a normal heart is open to
    what can take its place: so the right atrium to the left one in tricuspid atresia.

    Parameters
    ----------
    table
        Label table.
    areas_mm2
        Label values of two cavities that touch, the lower first -> area of the contact.
    settings
        Pairs in ``connected`` get none, pairs in ``septum`` one of that thickness, whatever they are called.
    root_m
        Square root of the body surface area, m.

    Returns
    -------
    dict
        Label values, the lower first -> thickness, mm.
    """
    connected = {_values(table, names) for names in settings.connected}
    stated = {_values(table, one.between): one.thickness_mm for one in settings.septum}
    meets = _Meetings(table, areas_mm2, root_m)
    found: dict[Pair, float] = {}
    for pair in areas_mm2:
        if pair in connected:
            continue
        kind = meets.kind_of(pair)
        if pair in stated:
            found[pair] = stated[pair]
        elif kind is not None:
            found[pair] = septum_thickness_mm(kind, root_m)
    return found


def septum_thickness_mm(kind: str, root_m: float) -> float:
    """Thickness of a septum of one kind of :data:`ADULT_MM` by the square root of the body surface area, m."""
    share = float(np.clip(root_m / np.sqrt(ADULT_SURFACE_M2), *ROOT_RANGE))
    thickness = max(ADULT_MM[kind] * share, LEAST_MM)
    return round(round(thickness / ROUNDING_MM) * ROUNDING_MM, 2)


@dataclass(frozen=True)
class _Meetings:
    """What touches what, by structure."""

    table: LabelTable
    areas_mm2: Mapping[Pair, float]
    root_m: float

    def kind_of(self, pair: Pair) -> str | None:
        """Kind of septum between two labels, None where none is grown."""
        first, second = (self.table[value] for value in pair)
        one, other = first.term, second.term
        if one is None or other is None or verdict_of(first, second) is not Verdict.UNEXPECTED:
            return None
        if any({one, other} <= group for group in _INFLOWS):
            return None
        if self._takes_the_place(one, other) or self._takes_the_place(other, one):
            return None
        both = {one, other}
        if both == _ATRIA:
            return "atria"
        if both == _VENTRICLES:
            return "ventricles"
        if both == _ARTERIES:
            return "arteries"
        if both & _ATRIA and both & _VENTRICLES:
            atrium = one if one in _ATRIA else other
            own = max((self._area(atrium, term) for term in _OWN[atrium]), default=0.0)
            return "atrium and other ventricle" if own >= OWN_SHARE * self._area(one, other) else None
        if both <= _ATRIA | _ARTERIES:
            return "artery and atrium"
        return "vein or appendage"

    def _area(self, one: Term, other: Term) -> float:
        """Area of the contact between all labels of two structures, mm2."""
        both = {one, other}
        return sum(area for pair, area in self.areas_mm2.items() if {self.table[value].term for value in pair} == both)

    def _takes_the_place(self, one: Term, other: Term) -> bool:
        """Whether one structure does not meet its own and another can be what its blood goes to instead."""
        if other not in _INSTEAD[one]:
            return False
        there = {label.term for label in self.table if label.role.is_blood}
        if not _OWN[one] & there:
            return False
        diameter = OWN_OPENING_MM * self.root_m / np.sqrt(ADULT_SURFACE_M2)
        least = 0.25 * np.pi * diameter**2
        return all(self._area(one, term) < least for term in _OWN[one])


def septum_warnings(figures: Sequence[SeptumFigures], table: LabelTable) -> tuple[CaseWarning, ...]:
    """What a person must look at: walls that nobody saw, the largest first."""
    return grown_warnings(septum_figures(figures, table))


def septum_figures(figures: Sequence[SeptumFigures], table: LabelTable) -> list[dict[str, Any]]:
    """The septa as plain values for the manifest, the largest first, rounded to 0.1 mm2 and 0.1 mm."""
    return [
        {
            "between": [table[one.septum.first].name, table[one.septum.second].name],
            "label": one.septum.value,
            "thickness_mm": one.septum.thickness_mm,
            "area_mm2": round(one.extent.area_mm2, 1),
            "patches": one.extent.patches,
            "center_mm": [round(value, 1) + 0.0 for value in one.extent.center_mm],
            "places": [place.figures() for place in one.places],
        }
        | ({} if one.others is None else {"others": one.others.figures()})
        for one in sorted(figures, key=lambda one: (-round(one.extent.area_mm2, 1), one.septum.value))
    ]


def _closed(contact: Contact, places: Sequence[OpenPlace], voxel_mm: float) -> Contact | None:
    """The faces of one pair that no stated opening holds; None where they are its rim, narrower than a voxel."""
    pair = (int(contact.pairs[0, 0]), int(contact.pairs[0, 1]))
    points = contact.points_mm
    is_open, is_rim = np.zeros((2, len(points)), np.bool_)
    for place in places:
        if place.is_about(pair):
            is_open |= place.holds(points)
            is_rim |= place.holds(points, voxel_mm)
    return None if is_rim.all() else contact[~is_open]


def _of_landmark(landmark: Landmark) -> OpenPlace:
    points = np.array(landmark.points_mm, np.float64)
    center = points.mean(axis=0)
    radius = float(np.linalg.norm(points - center, axis=1).max())
    if len(points) == 1:
        radius = landmark.radius_mm or POINT_REACH_MM
    if landmark.kind != "ring":
        return OpenPlace("strokes", (_point(center),), radius)
    axis = np.linalg.svd(points - center)[2][2] if landmark.axis is None else np.array(landmark.axis, np.float64)
    reach = (radius + POINT_REACH_MM) * axis / np.linalg.norm(axis)
    return OpenPlace("cylinder", (_point(center - reach), _point(center + reach)), radius)


def _point(values: Float64) -> tuple[float, float, float]:
    x, y, z = (round(float(value), 4) for value in values)
    return x, y, z


def _values(table: LabelTable, names: tuple[str, str]) -> Pair:
    low, high = sorted(table[name].value for name in names)
    return low, high


def _extents(contact: Contact) -> dict[Pair, Extent]:
    """Each pair of labels that touch -> the extent of the contact."""
    return dict(_each_extent(contact))


def _each_extent(contact: Contact) -> Iterator[tuple[Pair, Extent]]:
    pairs = contact.pairs
    for values in np.unique(pairs, axis=0):
        yield (int(values[0]), int(values[1])), contact[(pairs == values).all(axis=1)].extent()


def _root_m(voxels: Segmentation) -> float:
    """Square root of the body surface area that goes with the heart, m: by its ventricles, else by all its blood."""
    root_m = root_of_surface_m(voxels)
    if root_m is not None:
        return root_m
    counts = np.bincount(voxels.labels.ravel(), minlength=256)
    blood = sum(int(counts[value]) for value in voxels.table.blood_values)
    volume_ml = blood * voxels.geometry.voxel_volume_mm3 / 1000.0 / BLOOD_IN_VENTRICLES
    # As for a ventricle: see root_of_surface_m.
    return float((volume_ml / 62.02) ** (0.5 / 1.3))
