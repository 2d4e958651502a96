"""Where the places that a tour names lie in a case at rest, and which way its directions go. LPS, mm."""

from __future__ import annotations

from functools import cached_property

import numpy as np
import numpy.typing as npt

from heartcase.schemas.arrays import Float64
from heartcase.schemas.errors import ScriptError
from heartcase.schemas.landmarks import Landmark
from heartcase.schemas.scripts.incision_plans import PlannedCut
from heartcase.schemas.touring.names import labels_meant
from heartcase.schemas.touring.places import Beside, Way, direction_of_words, known_name
from heartcase.simulator.incisions.planned import DrawnLine, drawn_line
from heartcase.simulator.incisions.triangle_tree import TriangleTree, triangle_tree
from heartcase.simulator.live.rays import Ray, first_hit
from heartcase.simulator.load import Case
from heartcase.simulator.simulation import Simulation

__all__ = ["CasePlaces"]

_NEAREST = 200
"""So many vertices of a structure say on which side of a ring it is."""


class CasePlaces:
    """Places of a case.

    Parameters
    ----------
    case
        The case, loaded with its surface and structures.
    """

    def __init__(self, case: Case) -> None:
        assert case.surface is not None
        assert case.triangle_structures is not None
        self.case = case
        self.rest_mm: Float64 = case.surface.rest_mm.astype(float)
        self._triangles = case.surface.triangles
        self._of_triangles = case.triangle_structures.astype(np.int64)
        self.landmarks = {one.name: one for one in case.manifest.landmarks}
        self._lines: dict[str, DrawnLine] = {}

    @property
    def middle_mm(self) -> Float64:
        """Middle of the heart's box."""
        middle: Float64 = 0.5 * (self.rest_mm.min(axis=0) + self.rest_mm.max(axis=0))
        return middle

    @property
    def size_mm(self) -> float:
        """Diagonal of that box."""
        return float(np.linalg.norm(self.rest_mm.max(axis=0) - self.rest_mm.min(axis=0)))

    @cached_property
    def tree(self) -> TriangleTree:
        """The visible surface at rest."""
        return triangle_tree(self.rest_mm, self._triangles)

    @cached_property
    def _normals(self) -> Float64:
        simulation = Simulation(self.case.model, surface=self.case.surface)
        return simulation.surface_now().normals.astype(float)

    def landmark(self, name: str) -> Landmark | None:
        """The landmark of a name; None where there is none."""
        found = known_name(name, self.landmarks)
        return None if found is None else self.landmarks[found]

    def point(self, place: object) -> Float64:
        """Where a place is, shape (3,).

        Raises
        ------
        ScriptError
            The case has no such place.
        """
        if isinstance(place, dict):
            place = Beside.model_validate(place)
        if isinstance(place, Beside):
            middle = self.point(place.near)
            return middle + place.by_mm * self.direction(place.towards, middle, self.landmark(place.near))
        if not isinstance(place, str):
            return np.asarray(place, dtype=float)
        mark = self.landmark(place)
        if mark is not None:
            return self._of_landmark(mark)
        corners = self._triangles[:0]
        for number in labels_meant(place, self.case.manifest.labels):
            if not len(corners):
                corners = self._triangles[self._of_triangles == number]
        if not len(corners):
            raise ScriptError(f"the case has no landmark and no visible structure {place!r}", place="tour")
        centre: Float64 = self.rest_mm[np.unique(corners)].mean(axis=0)
        return centre

    def direction(self, towards: object, from_mm: npt.ArrayLike, ring: Landmark | None = None) -> Float64:
        """Which way something is, unit length, shape (3,).

        Parameters
        ----------
        towards
            Words, a place, or a vector.
        from_mm
            From where a place is looked for.
        ring
            Where this is a ring with an axis, a place is on one side of it: the axis on that side is taken.

        Raises
        ------
        ScriptError
            There is no such place, or it is just where the way begins.
        """
        if not isinstance(towards, str):
            found = np.asarray(towards, dtype=float)
        elif (words := direction_of_words(towards)) is not None:
            found = np.array(words, dtype=float)
        else:
            found = self.point(towards) - np.asarray(from_mm, dtype=float)
            if ring is not None and ring.kind == "ring":
                axis = self.axis(ring)
                beside = self._beside(ring, towards)
                found = axis if axis @ (found if beside is None else beside) >= 0.0 else -axis
        size = float(np.linalg.norm(found))
        if size < 1e-6:
            raise ScriptError(f"{towards} lies just where the way towards it begins", place="tour")
        return found / size

    def way(self, way: object) -> tuple[float, float, float]:
        """Numbers of a direction or a way of a command."""
        if isinstance(way, dict):
            read = Way.model_validate(way)
            start = self.middle_mm if read.near is None else self.point(read.near)
            ring = None if read.near is None else self.landmark(read.near)
            return _numbers(read.by_mm * self.direction(read.towards, start, ring))
        return _numbers(self.direction(way, self.middle_mm))

    def axis(self, ring: Landmark) -> Float64:
        """Axis of a ring, unit length, shape (3,)."""
        if ring.axis is not None:
            axis = np.asarray(ring.axis, dtype=float)
        else:
            points = np.asarray(ring.points_mm, dtype=float)
            axis = np.linalg.svd(points - points.mean(axis=0))[2][-1]
        unit: Float64 = axis / np.linalg.norm(axis)
        return unit

    def radius_mm(self, ring: Landmark) -> float:
        """Radius of a ring; the mean where it is given by points."""
        if ring.radius_mm is not None:
            return ring.radius_mm
        points = np.asarray(ring.points_mm, dtype=float)
        return float(np.linalg.norm(points - points.mean(axis=0), axis=1).mean())

    def line(self, name: str) -> DrawnLine:
        """A planned incision's line on the outside of the tissue at rest.

        Raises
        ------
        ScriptError
            The case has no planned incision of this name.
        """
        mark = self.landmark(name)
        if mark is None or mark.kind != "polyline" or mark.is_vessel:
            raise ScriptError(f"the case has no planned incision {name!r}", place="tour")
        if mark.name not in self._lines:
            cut = PlannedCut(landmark=mark.name)
            found = drawn_line(cut, self.case.manifest.landmarks, self.tree, self.rest_mm, self._normals)
            assert found is not None
            self._lines[mark.name] = found
        return self._lines[mark.name]

    def _beside(self, ring: Landmark, name: str) -> Float64 | None:
        """The side of a ring on which a structure is: where it is seen through the ring, else where it is nearest.

        Where its middle lies says nothing: a cavity may wrap around another. None where no structure has the name.
        """
        values = () if self.landmark(name) is not None else labels_meant(name, self.case.manifest.labels)
        vertices = np.unique(self._triangles[np.isin(self._of_triangles, values[:1])])
        if not len(vertices):
            return None
        middle, axis = self._of_landmark(ring), self.axis(ring)
        first = np.cross(axis, np.eye(3)[int(np.argmin(np.abs(axis)))])
        first *= 0.5 * self.radius_mm(ring) / np.linalg.norm(first)
        second = np.cross(axis, first)
        starts = [middle + x * first + y * second for x, y in ((0, 0), (1, 0), (-1, 0), (0, 1), (0, -1))]
        seen = sum(sign for start in starts for sign in (1, -1) if self._seen(Ray(start, sign * axis)) in values)
        if seen != 0:
            return seen * axis
        ways = self.rest_mm[vertices] - middle
        nearest = np.argsort(np.linalg.norm(ways, axis=1))[:_NEAREST]
        found: Float64 = ways[nearest].mean(axis=0)
        return found

    def _seen(self, ray: Ray) -> int | None:
        """The structure that a ray meets first."""
        hit = first_hit(ray, self.rest_mm, self._triangles)
        return None if hit is None else int(self._of_triangles[hit.triangle])

    def _of_landmark(self, mark: Landmark) -> Float64:
        points = np.asarray(mark.points_mm, dtype=float)
        if mark.kind != "polyline":
            middle: Float64 = points.mean(axis=0)
            return middle
        # the middle of a line lies on it
        along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
        return np.array([np.interp(0.5 * along[-1], along, points[:, axis]) for axis in range(3)])


def _numbers(vector: Float64) -> tuple[float, float, float]:
    x, y, z = vector.tolist()
    return x, y, z
