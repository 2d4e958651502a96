"""Whether a case has what a tour names: landmarks and structures. Neither the case nor its scan has to be there."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Sequence

from heartcase.schemas.errors import Problem
from heartcase.schemas.labels import Label
from heartcase.schemas.landmarks import Landmark
from heartcase.schemas.terms import term_by_name
from heartcase.schemas.touring.places import Beside, direction_of_words, known_name, names_in
from heartcase.schemas.touring.reading import ReadTour
from heartcase.schemas.touring.tour import (
    CloseAlong,
    OpenAlong,
    PassThrough,
    PatchOver,
    SessionAct,
    Tour,
    TourAct,
    TourStep,
    TourView,
)

__all__ = ["CUT_FACES_NAME", "grown_septa", "labels_meant", "tour_problems"]

CUT_FACES_NAME = "cut faces"
"""How walls of incisions are called among the structures."""


_WALL = " wall"
"""How the name of a grown wall ends, behind that of the cavity or the vessel that it is of."""
_GROWN_SEPTUM = "septum (grown)"


def labels_meant(name: str, labels: Iterable[Label]) -> tuple[int, ...]:
    """Values of the labels that a structure's name stands for: a cavity or a vessel is meant with its grown wall.

    Parameters
    ----------
    name
        The name, or another one of the same structure.
    labels
        Labels of the case.

    Returns
    -------
    tuple
        The values, that of the structure itself first; none where the case has no such structure.
    """
    values = {label.name: label.value for label in labels if label.role != "background"}
    found = known_name(name, values)
    if found is None:
        stem = name[: -len(_WALL)] if name.lower().endswith(_WALL) else ""
        own = known_name(stem, values) if stem else None
        return (values[own + _WALL],) if own is not None and own + _WALL in values else ()
    return (values[found], *((values[found + _WALL],) if found + _WALL in values else ()))


def grown_septa(names: Iterable[str], labels: Iterable[Label]) -> tuple[int, ...]:
    """Values of the grown septa that are beside one of these structures."""
    terms = [term.name for name in names if (term := term_by_name(name)) is not None]
    septa = [label for label in labels if label.name.endswith(_GROWN_SEPTUM)]
    return tuple(label.value for label in septa if any(name.lower() in label.name.lower() for name in (*names, *terms)))


def tour_problems(tour: Tour | ReadTour, landmarks: Sequence[Landmark], labels: Iterable[Label]) -> tuple[Problem, ...]:
    """What a tour names that a case does not have, or that is of another kind there.

    Parameters
    ----------
    tour
        The tour; of one that is wrong, what is sound in it is looked at.
    landmarks, labels
        Of the case, or of its recipe.
    """
    names = _Names(landmarks, labels)
    found: list[Problem] = []
    for number, step in enumerate(tour.steps, start=1):
        where = f"line {step.line} (step {number})"
        found += [Problem(f"{where}: {one.place}", one.message) for one in names.of_step(step)]
    return tuple(found)


class _Names:
    def __init__(self, landmarks: Sequence[Landmark], labels: Iterable[Label]) -> None:
        self.landmarks = {one.name: one for one in landmarks}
        self._is_listed = False
        self.structures = [label.name for label in labels if label.role != "background"]

    def of_step(self, step: TourStep) -> list[Problem]:
        scene, found = step.scene, []
        if scene.view is not None:
            found += self._of_view(scene.view)
        for key in ("show", "hide"):
            for name in getattr(scene, key) or ():
                stem = name[: -len(_WALL)] if name.lower().endswith(_WALL) else name
                if known_name(name, (*self.structures, CUT_FACES_NAME)) is None and self._is_no_structure(stem):
                    instead = self._instead(name, (*self.structures, CUT_FACES_NAME))
                    found.append(Problem(key, f"the case has no structure {name!r}{instead}"))
        plane = scene.cut_plane
        if plane is not None:
            found += self._place(plane.through, "cut_plane.through") + self._towards(plane.removes, "cut_plane.removes")
            if plane.through is None and scene.view is None:
                found.append(Problem("cut_plane.through", "say where it lies: this step has no view of its own"))
        for number, act in enumerate(step.acts, start=1):
            found += self._of_act(act, f"do[{number}]")
        return found

    def _of_view(self, view: TourView) -> list[Problem]:
        found = self._place(view.at, "view.at") + self._towards(view.from_, "view.from")
        if view.square and isinstance(view.at, str) and not found:
            mark = self._landmark(view.at)
            is_ring = mark is not None and mark.kind == "ring"
            is_incision = mark is not None and mark.kind == "polyline" and not mark.is_vessel
            if not is_ring and not is_incision:
                found.append(Problem("view.square", f"{view.at} is neither a ring nor a planned incision"))
            elif is_ring and view.from_ is None:
                found.append(Problem("view.from", "say from which side of the ring"))
        return found

    def _of_act(self, act: TourAct, place: str) -> list[Problem]:
        found: list[Problem] = []
        if isinstance(act, OpenAlong | CloseAlong):
            mark = self._landmark(act.landmark)
            has = (
                ", ".join(one.name for one in self.landmarks.values() if one.kind == "polyline" and one.depth_mm)
                or "none"
            )
            if mark is None or mark.kind != "polyline" or mark.depth_mm is None:
                message = f"the case has no planned incision {act.landmark!r}; it has: {has}"
                found.append(Problem(f"{place}.landmark", message))
        elif isinstance(act, PatchOver | PassThrough):
            mark = self._landmark(act.landmark)
            if mark is None or mark.kind != "ring":
                has = ", ".join(one.name for one in self.landmarks.values() if one.kind == "ring") or "none"
                message = f"the case has no ring {act.landmark!r}, such as a defect; it has: {has}"
                found.append(Problem(f"{place}.landmark", message))
            found += self._place(act.side, f"{place}.side")
        elif isinstance(act, SessionAct):
            for keys, name in names_in(act.command):
                if self._is_unknown(name):
                    found.append(Problem(f"{place}.{'.'.join(map(str, keys))}", self._no_place(name)))
        return found

    def _place(self, place: object, at: str) -> list[Problem]:
        if isinstance(place, Beside):
            return self._place(place.near, f"{at}.near") + self._towards(place.towards, f"{at}.towards")
        return [Problem(at, self._no_place(place))] if isinstance(place, str) and self._is_unknown(place) else []

    def _towards(self, towards: object, at: str) -> list[Problem]:
        if not isinstance(towards, str) or direction_of_words(towards) is not None or not self._is_unknown(towards):
            return []
        return [Problem(at, f"{self._no_place(towards)}; directions are left, right, front, back, above, below")]

    def _landmark(self, name: str) -> Landmark | None:
        found = known_name(name, self.landmarks)
        return None if found is None else self.landmarks[found]

    def _is_unknown(self, name: str) -> bool:
        return known_name(name, (*self.landmarks, *self.structures)) is None

    def _is_no_structure(self, name: str) -> bool:
        return known_name(name, self.structures) is None

    def _no_place(self, name: object) -> str:
        instead = self._instead(str(name), (*self.landmarks, *self.structures))
        return f"the case has no landmark or structure {name!r}{instead}"

    def _instead(self, name: str, known: Iterable[str]) -> str:
        """What was probably meant, or, once, all that there is."""
        names = [one for one in known if not one.endswith(_WALL)]
        near = difflib.get_close_matches(name, names, n=1)
        if near:
            return f": did you mean {near[0]!r}?"
        if self._is_listed:
            return ""
        self._is_listed = True
        return f"; it has: {', '.join(names) or 'none'}"
