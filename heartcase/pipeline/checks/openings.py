"""Openings: where two cavities touch without a wall between them, and whether a normal heart has that opening.

Walls grow into background only, so two cavities whose outlines touch are open to each other. At a valve that is
right; at a septum it is a hole that the patient may not have.

What touches, and over which area, is found in :mod:`heartcase.pipeline.fields.contacts`; here it is judged.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from heartcase.pipeline.checks.contact_balls import open_balls
from heartcase.pipeline.data import Segmentation, Structures
from heartcase.pipeline.fields.contacts import Contact, find_contact
from heartcase.pipeline.markers.meeting_strokes import meetings_of
from heartcase.pipeline.warning_words import sentence
from heartcase.pipeline.warnings import CaseWarning, anatomy, note
from heartcase.schemas.arrays import Bool, Float64
from heartcase.schemas.labels import Label, LabelTable
from heartcase.schemas.landmarks import Landmark
from heartcase.schemas.recipe.edit_settings import Edit, SeptalDefect, edit_place
from heartcase.schemas.recipe.settings import ContactPlace, Stroke
from heartcase.schemas.terms import Term, term_by_name

__all__ = [
    "POINT_REACH_MM",
    "REACH_VOXELS",
    "Opening",
    "Verdict",
    "find_openings",
    "opening_figures",
    "opening_warnings",
    "root_of_surface_m",
    "states_an_opening",
    "verdict_of",
]


POINT_REACH_MM = 8.0
"""What a landmark that is a point speaks for: this far around it. A ring speaks for its own radius."""
REACH_VOXELS = 2.0
"""How much farther than its radius a stated defect reaches, in edges of a cube with the volume of a voxel."""
MORE_THAN_ASKED = 1.5
"""An opening at a septal_defect edit is looked at when it is this many times as large as the edit asks for."""
CANAL_COSINE = 0.7
"""What faces along a canal's axis less than this is its wall."""
_LEAST_FACES = 6
"""An opening of fewer faces has no axis of its own."""
_NORMAL_PAIRS = (
    ("lv", "la"),
    ("lv", "aorta"),
    ("rv", "ra"),
    ("rv", "pa"),
    ("ra", "svc"),
    ("ra", "ivc"),
    ("ra", "coronary sinus"),
    ("ra", "raa"),
    ("la", "pulmonary vein"),
    ("la", "laa"),
)
_VALVES_MM = ((("lv", "la"), 30.0), (("rv", "ra"), 30.0), (("lv", "aorta"), 20.0), (("rv", "pa"), 20.0))
"""Diameter of a valve at a body surface area of 1 m2: round numbers, enough for VALVE_SHARES. That diameters go with
the area's square root is from Lopez et al., Circulation: Cardiovascular Imaging 10, 2017, doi
10.1161/CIRCIMAGING.117.006979."""
VALVE_SHARES = (0.4, 2.0)
"""A valve's opening is looked at when it is less or more than this many times the usual one: wider than any normal
heart, a dilated one, or blood whose border does not lie flat in the valve."""
LEAST_VENTRICLE_ML = 3.0
"""Half of a newborn's: of a smaller one nothing is said."""
_OTHER_VENTRICLE = (("lv", "pa"), ("rv", "aorta"))
_STATING_WORDS = re.compile(
    r"defect|fistula|shunt|anastomos[ei]s|fenestration|ductus|window|opening|connection|drainage"
    r"|(?<![a-z])(?:asd|vsd|avsd|pfo|pda)(?![a-z])"
)


class Verdict(StrEnum):
    """What is to be thought of an opening."""

    EXPECTED = "expected"
    """A normal heart has it: a valve, a vein's mouth, an appendage."""
    STATED = "stated"
    """The recipe says that it is meant."""
    OTHER_VENTRICLE = "other ventricle"
    """A great artery arises from the ventricle that is not its own, as some malformed hearts have it."""
    UNKNOWN = "unknown"
    """The vocabulary does not know one of the two."""
    UNEXPECTED = "unexpected"
    """No normal heart has it, and the recipe does not say that this one does."""


_WORST_FIRST = (Verdict.UNEXPECTED, Verdict.OTHER_VENTRICLE, Verdict.UNKNOWN, Verdict.STATED, Verdict.EXPECTED)


@dataclass(frozen=True)
class _Statement:
    """A place of the recipe at which an opening is meant: a canal, or a ball where there is no axis."""

    words: str
    center_mm: Float64
    radius_mm: float
    axis: Float64 | None = None
    half_length_mm: float = 0.0
    asked_mm2: float | None = None
    long_axis: Float64 | None = None
    """Direction of the long diameter of a canal that is not round; its part at right angles to the axis counts."""
    short_radius_mm: float = 0.0
    """Half of the short diameter of such a canal."""
    values: tuple[int, int] | None = None
    """The two labels that it is about, the lower first; None for any."""

    @property
    def line_mm(self) -> tuple[Float64, Float64]:
        """The ends of the canal's axis."""
        reach = self.half_length_mm * (np.zeros(3) if self.axis is None else self.axis)
        return self.center_mm - reach, self.center_mm + reach

    def covers(self, points_mm: Float64, margin_mm: float) -> Bool:
        """Which points, shape (n, 3), lie within its reach."""
        away = points_mm - self.center_mm
        if self.axis is None:
            near: Bool = np.linalg.norm(away, axis=1) <= self.radius_mm + margin_mm
            return near
        along = away @ self.axis
        across = np.linalg.norm(self._from_middle_line(away - along[:, None] * self.axis), axis=1)
        radius = self.radius_mm if self.long_axis is None else self.short_radius_mm
        within: Bool = (across <= radius + margin_mm) & (np.abs(along) <= self.half_length_mm + margin_mm)
        return within

    def _from_middle_line(self, across: Float64) -> Float64:
        """Vectors in the plane of the opening, less the way along the middle line of one that is not round."""
        if self.long_axis is None or self.axis is None:
            return across
        side = self.long_axis - (self.long_axis @ self.axis) * self.axis
        side = side / np.linalg.norm(side)
        half = self.radius_mm - self.short_radius_mm
        shortened: Float64 = across - np.clip(across @ side, -half, half)[:, None] * side
        return shortened


@dataclass(frozen=True)
class Opening:
    """Where two cavities are open to each other, as far as one verdict goes."""

    labels: tuple[int, int]
    """Values of the two labels, the lower first."""
    names: tuple[str, str]
    """Their names in the label table."""
    area_mm2: float
    """Area of all patches together, mm2."""
    patches: int
    """Pieces of it that do not touch."""
    center_mm: tuple[float, float, float]
    """The point of the largest patch that is nearest to its mean, world mm."""
    verdict: Verdict
    """What is to be thought of it."""
    stated_by: str = ""
    """What in the recipe says that it is meant."""
    asked_mm2: float | None = None
    """Area that the septal_defect edit asks for, mm2."""
    usual_mm: float | None = None
    """Usual diameter of this valve in a heart with ventricles of this volume, mm; None for what is no valve, or where
    the volume is not known."""
    points_mm: Float64 = field(default_factory=lambda: np.empty((0, 3)), compare=False, repr=False)
    """Centres of the faces between the two, world mm, shape (face_count, 3)."""
    centers_mm: tuple[tuple[float, float, float], ...] = field(default=(), compare=False, repr=False)
    """``center_mm`` and the like of the next largest patches."""
    reach_mm: float = field(default=0.0, compare=False)
    """Distance from its centre to the farthest face of the largest patch, mm."""
    statement: _Statement | None = field(default=None, compare=False, repr=False)
    """The place that the recipe states."""

    @property
    def diameter_mm(self) -> float:
        """Diameter of a circle of this area, mm."""
        return 2.0 * math.sqrt(self.area_mm2 / math.pi)

    @property
    def axis(self) -> Float64 | None:
        """Unit vector through the hole, shape (3,): of the edit that states it, else where its faces spread least."""
        if self.statement is not None and self.statement.axis is not None:
            return self.statement.axis
        if len(self.points_mm) < _LEAST_FACES:
            return None
        away = self.points_mm - self.points_mm.mean(axis=0)
        _, vectors = np.linalg.eigh(away.T @ away)
        least: Float64 = vectors[:, 0]
        # either way round is right: the same one on every machine
        return least * (1.0 if least[np.abs(least).argmax()] > 0.0 else -1.0)

    @property
    def is_too_large(self) -> bool:
        """Whether it is larger than the edit that states it asks for, by more than voxels explain."""
        return self.asked_mm2 is not None and self.area_mm2 > MORE_THAN_ASKED * self.asked_mm2

    @property
    def is_odd_size(self) -> bool:
        """Whether it is far narrower or wider than this valve is in any heart of this size."""
        low, high = VALVE_SHARES
        return self.usual_mm is not None and not low <= self.diameter_mm / self.usual_mm <= high

    @property
    def is_doubtful(self) -> bool:
        """Whether a person must look at it."""
        return self.is_too_large or self.is_odd_size or self.verdict not in (Verdict.EXPECTED, Verdict.STATED)

    def holds(self, points_mm: Float64, margin_mm: float) -> Bool:
        """Which points, world mm, shape (n, 3), lie within the place that states it, or so near; none if none does."""
        none: Bool = np.zeros(len(points_mm), np.bool_)
        return none if self.statement is None else self.statement.covers(points_mm, margin_mm)

    def has_rim_at(self, points_mm: Float64, normals: Float64, reach_mm: float) -> Bool:
        """Which points of the tissue's border are its rim: near its faces, or on the wall of the canal it was cut by.

        Parameters
        ----------
        points_mm, normals
            Points and unit normals of the border, shape (n, 3).
        reach_mm
            How far from a face.
        """
        near: Bool = np.isfinite(cKDTree(self.points_mm).query(points_mm, distance_upper_bound=reach_mm, workers=1)[0])
        if self.statement is not None and self.statement.axis is not None:
            is_wall = np.abs(normals @ self.statement.axis) < CANAL_COSINE
            near |= is_wall & self.statement.covers(points_mm, reach_mm)
        return near


def find_openings(
    structures: Structures,
    labels: Segmentation,
    edits: Sequence[Edit] = (),
    landmarks: Sequence[Landmark] = (),
    *,
    strokes: Sequence[Stroke] = (),
    connected: Sequence[tuple[str, str]] = (),
    contacts: Sequence[ContactPlace] = (),
) -> tuple[Opening, ...]:
    """Find every place where two labels of blood or vessel lumen touch with no tissue between.

    Parameters
    ----------
    structures
        The final structures, after edits and end cuts.
    labels
        The label of every voxel of their lattice: :func:`heartcase.pipeline.bundle.assembly.labels_of`.
    edits
        The recipe's edits: a ``septal_defect`` states the opening at its canal.
    landmarks
        The recipe's landmarks: one that :func:`states_an_opening` states the opening around it, out to its radius or,
        for a point, :data:`POINT_REACH_MM`.
    strokes
        The recipe's strokes: those of two cavities that run into each other state an opening between them there.
    connected
        Names of pairs that the recipe says are open to each other, wherever they touch.
    contacts
        Places of ``walls.contact``: those that are open state an opening between their two.

    Returns
    -------
    tuple of Opening
        The worst verdict first, then by area, the largest first. The faces of one pair are told apart by what states
        them: what lies beyond the reach of a stated defect is an opening of its own. Pairs of a normal heart are one
        opening each; whether one of their patches lies where it should not is not judged.
    """
    statements = (
        *_stated_by_edits(edits),
        *_stated_by_landmarks(landmarks),
        *_stated_by_strokes(strokes, labels.table),
        *_stated_by_contacts(contacts, labels.table),
        *_stated_by_pairs(connected, labels.table),
    )
    contact = find_contact(structures, labels, [one.line_mm for one in statements if one.axis is not None])
    points, pairs = contact.points_mm, contact.pairs
    margin = REACH_VOXELS * labels.geometry.voxel_volume_mm3 ** (1.0 / 3.0)
    root_m = root_of_surface_m(labels)
    found: list[Opening] = []
    for values in np.unique(pairs, axis=0):
        of_pair = (pairs == values).all(axis=1)
        pair = (labels.table[int(values[0])], labels.table[int(values[1])])
        plain = verdict_of(*pair)
        if plain is Verdict.EXPECTED:
            found.append(replace(_opening(contact[of_pair], pair, plain), usual_mm=_usual_mm(pair, root_m)))
            continue
        for statement in statements:
            if statement.values not in (None, (pair[0].value, pair[1].value)):
                continue
            covered = of_pair & statement.covers(points, margin)
            if covered.any():
                of_pair &= ~covered
                one = _opening(contact[covered], pair, Verdict.STATED)
                found.append(
                    replace(one, stated_by=statement.words, asked_mm2=statement.asked_mm2, statement=statement)
                )
        if of_pair.any():
            found.append(_opening(contact[of_pair], pair, plain))
    return tuple(sorted(found, key=lambda one: (_WORST_FIRST.index(one.verdict), -one.area_mm2, one.labels)))


def opening_warnings(openings: Sequence[Opening]) -> tuple[CaseWarning, ...]:
    """What the user must know about the openings, in their order."""
    return tuple(warning for one in openings for warning in _warnings_of(one))


def opening_figures(openings: Sequence[Opening]) -> list[dict[str, Any]]:
    """The openings as plain values for the manifest, rounded to 0.1 mm2 and 0.1 mm."""
    figures = []
    for one in openings:
        figure: dict[str, Any] = {
            "between": list(one.names),
            "labels": list(one.labels),
            "area_mm2": round(one.area_mm2, 1),
            "patches": one.patches,
            "center_mm": [round(value, 1) + 0.0 for value in one.center_mm],
            "verdict": one.verdict.value,
        }
        if one.verdict is Verdict.STATED and (axis := one.axis) is not None:
            # of the hole: who looks through it needs to know where it lies
            figure["middle_mm"] = [round(value, 1) + 0.0 for value in one.points_mm.mean(axis=0).tolist()]
            figure["axis"] = [round(value, 3) + 0.0 for value in axis.tolist()]
        if one.stated_by:
            figure["stated_by"] = one.stated_by
        if one.asked_mm2 is not None:
            figure["asked_mm2"] = round(one.asked_mm2, 1)
        if one.verdict not in (Verdict.EXPECTED, Verdict.STATED):
            # what has to be said to state it
            figure["reach_mm"] = round(one.reach_mm, 1)
        figures.append(figure)
    return figures


def states_an_opening(landmark: Landmark) -> bool:
    """Whether a landmark says by its name that two cavities are open to each other there: "defect", "VSD" and so on."""
    return _STATING_WORDS.search(landmark.name.casefold().replace("_", " ")) is not None


def verdict_of(first: Label, second: Label) -> Verdict:
    """What is to be thought of an opening between two cavities, by their names alone."""
    one, other = first.term, second.term
    if one is None or other is None:
        return Verdict.UNKNOWN
    pair = frozenset((one, other))
    if len(pair) == 1 or pair in _EXPECTED:
        return Verdict.EXPECTED
    return Verdict.OTHER_VENTRICLE if pair in _DISCORDANT else Verdict.UNEXPECTED


def _term_pairs(pairs: Sequence[tuple[str, str]]) -> frozenset[frozenset[Term]]:
    def term(name: str) -> Term:
        found = term_by_name(name)
        if found is None:
            raise KeyError(name)
        return found

    return frozenset(frozenset((term(one), term(other))) for one, other in pairs)


_EXPECTED = _term_pairs(_NORMAL_PAIRS)
_VALVES = {next(iter(_term_pairs([pair]))): diameter for pair, diameter in _VALVES_MM}
_VENTRICLES = frozenset(term for pair in _term_pairs([("lv", "rv")]) for term in pair)
_DISCORDANT = _term_pairs(_OTHER_VENTRICLE)


def root_of_surface_m(labels: Segmentation) -> float | None:
    """Square root of the body surface area that goes with the larger ventricle's volume, m; None where it is not known.

    The larger one, since the smaller may be malformed, or taken by its neighbour. Of a ventricle that the volume's
    border cuts only a part is known.
    """
    counts = np.bincount(labels.labels.ravel(), minlength=256)
    values = [one.value for one in labels.table if one.term in _VENTRICLES and one.role.is_blood]
    value = max(values, key=lambda one: counts[one], default=None)
    if value is None or any((labels.labels.take((0, -1), axis) == value).any() for axis in range(3)):
        return None
    volume_ml = float(counts[value]) * labels.geometry.voxel_volume_mm3 / 1000.0
    # 62.02 A^1.3 ml for an area of A m2: the source named at _VALVES_MM.
    return (volume_ml / 62.02) ** (0.5 / 1.3) if volume_ml >= LEAST_VENTRICLE_ML else None


def _usual_mm(pair: tuple[Label, Label], root_m: float | None) -> float | None:
    """Usual diameter of the valve between two structures, mm."""
    terms = frozenset(term for label in pair if (term := label.term) is not None)
    diameter = _VALVES.get(terms)
    return None if diameter is None or root_m is None else diameter * root_m


def _opening(contact: Contact, pair: tuple[Label, Label], verdict: Verdict) -> Opening:
    """Measure the faces of one pair; ``pair`` is by ascending value."""
    extent = contact.extent()
    return Opening(
        (pair[0].value, pair[1].value),
        (pair[0].name, pair[1].name),
        extent.area_mm2,
        extent.patches,
        extent.center_mm,
        verdict,
        points_mm=contact.points_mm,
        centers_mm=extent.centers_mm,
        reach_mm=extent.reach_mm,
    )


def _stated_by_edits(edits: Sequence[Edit]) -> Iterator[_Statement]:
    for number, edit in enumerate(edits, start=1):
        if isinstance(edit, SeptalDefect) and edit.enabled:
            long_axis = None if edit.long_axis is None else np.array(edit.long_axis)
            yield _Statement(
                edit_place(number, edit),
                np.array(edit.position_mm),
                0.5 * edit.diameter_mm,
                np.array(edit.axis) / np.linalg.norm(edit.axis),
                0.5 * edit.length_mm,
                edit.area_mm2,
                long_axis,
                0.5 * (edit.width_mm or edit.diameter_mm),
            )


def _stated_by_landmarks(landmarks: Sequence[Landmark]) -> Iterator[_Statement]:
    for landmark in landmarks:
        if states_an_opening(landmark):
            points = np.array(landmark.points_mm)
            center = points.mean(axis=0)
            radius = float(np.linalg.norm(points - center, axis=1).max())
            if len(points) == 1:
                radius = landmark.radius_mm or POINT_REACH_MM
            yield _Statement(f"the landmark '{landmark.name}'", center, radius)


def _stated_by_strokes(strokes: Sequence[Stroke], table: LabelTable) -> Iterator[_Statement]:
    for one in meetings_of(strokes, table):
        words = f"strokes {one.numbers[0]} and {one.numbers[1]}, which run into each other"
        yield _Statement(words, np.array(one.center_mm), one.radius_mm, values=one.values)


def _stated_by_pairs(pairs: Sequence[tuple[str, str]], table: LabelTable) -> Iterator[_Statement]:
    for names in pairs:
        low, high = sorted(table[name].value for name in names)
        yield _Statement("walls.connected", np.zeros(3), math.inf, values=(low, high))


def _stated_by_contacts(places: Sequence[ContactPlace], table: LabelTable) -> Iterator[_Statement]:
    for ball in open_balls(places, table):
        words = f"walls.contact[{ball.number}]"
        yield _Statement(words, np.array(ball.center_mm), ball.radius_mm, values=ball.values)


def _warnings_of(one: Opening) -> Iterator[CaseWarning]:
    places = one.centers_mm or (one.center_mm,)
    said = {
        "one": one.names[0],
        "other": one.names[1],
        "area": _number(one.area_mm2),
        "patches": one.patches if one.patches > 1 else None,
        "place": f"({', '.join(f'{value:.1f}' for value in one.center_mm)})",
    }
    if one.verdict is Verdict.UNEXPECTED:
        code = "opening-unexpected"
        yield anatomy(sentence(code, **said), code=code, places_mm=places)
    elif one.verdict is Verdict.OTHER_VENTRICLE:
        code = "opening-other-ventricle"
        yield CaseWarning(sentence(code, **said), code=code, places_mm=places)
    elif one.verdict is Verdict.UNKNOWN:
        code = "opening-unknown"
        yield CaseWarning(sentence(code, **said), code=code, places_mm=places)
    elif one.is_odd_size and one.usual_mm is not None:
        kind = "valve-narrow" if one.diameter_mm < one.usual_mm else "valve-wide"
        text = sentence(kind, **said, diameter=f"{one.diameter_mm:.0f}", usual=f"{one.usual_mm:.0f}")
        yield CaseWarning(text, code="valve-size", places_mm=places)
    elif one.verdict is Verdict.STATED:
        code = "opening-too-large" if one.is_too_large else "opening-stated"
        asked = None if one.asked_mm2 is None else _number(one.asked_mm2)
        text = sentence(code, **said, by=one.stated_by, asked=asked)
        yield (CaseWarning if one.is_too_large else note)(text, code=code, places_mm=places)


def _number(area_mm2: float) -> str:
    return f"{area_mm2:,.0f}" if area_mm2 >= 10.0 else f"{area_mm2:.1f}"
