"""An incision as it is held open now: its lips, and its figures for each defect that is looked at through it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from heartcase.schemas.arrays import Bool, Float32, Float64, Int32
from heartcase.schemas.landmarks import Landmark
from heartcase.schemas.scripts.incision_plans import LookingSettings, ShaftSettings
from heartcase.simulator.incisions.cut_tissue import CellTissues
from heartcase.simulator.incisions.figures import IncisionFigures
from heartcase.simulator.incisions.measure import IncisionPlan, Scene, measured_and_seen
from heartcase.simulator.incisions.nearness import Carrier
from heartcase.simulator.incisions.planned import DrawnLine, lips
from heartcase.simulator.incisions.rim import DefectRim
from heartcase.simulator.incisions.surgical_freedom import Shaft
from heartcase.simulator.incisions.triangle_tree import TriangleTree, triangle_tree
from heartcase.simulator.incisions.visibility import View, visibility
from heartcase.simulator.lattice.model import LatticeModel
from heartcase.simulator.surface.deform import DeformedSurface, SurfaceModel

__all__ = ["Incision", "SeenThrough", "ShownHeart", "seen_through"]


@dataclass(frozen=True)
class ShownHeart:
    """The visible surface at a moment."""

    rest_mm: Float32
    """Its vertices at rest, LPS mm, shape (vertex_count, 3)."""
    now_mm: Float32
    """The same at that moment."""
    normals: Float32
    """Their unit normals at that moment, shape (vertex_count, 3)."""
    triangles: Int32
    """Vertex numbers, shape (triangle_count, 3)."""
    is_cut_face: Bool | None = None
    """Which triangles are walls of cuts, shape (triangle_count,); None where nothing is cut."""

    @classmethod
    def of(cls, surface: SurfaceModel, shown: DeformedSurface, is_cut_face: Bool | None = None) -> ShownHeart:
        """A surface, and where its vertices are."""
        return cls(surface.rest_mm, shown.vertices_mm, shown.normals, surface.triangles, is_cut_face)

    known: Carrier | None = field(default=None, repr=False, compare=False)
    """What carries points with the surface, where it is known from another moment."""

    @cached_property
    def carrier(self) -> Carrier:
        """What carries points with the surface."""
        return self.known or Carrier(self.rest_mm)

    def carried(self, points_mm: Float64) -> Float64:
        """Where points on or near the surface at rest, LPS mm, shape (count, 3), are at that moment."""
        return self.carrier.carried(points_mm, self.now_mm)

    @cached_property
    def tree(self) -> TriangleTree:
        """Boxes around its triangles."""
        return triangle_tree(self.now_mm, self.triangles)

    def lips(self, line: DrawnLine, whole_count: int) -> tuple[Float64, Float64]:
        """Both lips of a line, by the vertices that the surface had before it was cut: the first ``whole_count``."""
        return lips(line, self.rest_mm[:whole_count], self.now_mm[:whole_count])


@dataclass(frozen=True)
class Incision:
    """An incision, and what is looked at through it."""

    name: str
    """Its name in the figures."""
    curve_mm: Float64
    """The incision at rest, LPS mm, shape (count, 3)."""
    line: DrawnLine | None
    """Its line along the outside of the tissue, where it has one: without it nothing is said of gap and reach."""
    entry_mm: Float64
    """Its middle, LPS mm, shape (3,): the side from which the rims are seen."""
    rims: tuple[DefectRim, ...]
    """Rims of the defects on that side; none where the case has no defect."""
    whole_count: int
    """Vertices of the surface before it was cut."""


@dataclass(frozen=True)
class SeenThrough:
    """What one defect comes to; of a case without one, what there is to be said without."""

    figures: IncisionFigures
    """Its figures."""
    looks_from: tuple[float, float, float] | None
    """From it to the best eye, LPS axes, unit length; None without a defect."""
    rim_mm: Float64 | None
    """Its rim now, LPS mm, shape (count, 3); None without a defect."""


def seen_through(
    incision: Incision,
    model: LatticeModel,
    displacement: Float32,
    held: ShownHeart,
    *,
    closed: ShownHeart | None,
    cut: ShownHeart | None,
    landmarks: Sequence[Landmark],
    looking: LookingSettings,
    shaft: ShaftSettings,
    looks_from: tuple[float, float, float] | None = None,
    retraction_n: float | None = None,
    stitch_forces_n: Sequence[float] = (),
    reaches: bool = True,
    tissues: CellTissues | None = None,
) -> tuple[dict[str, SeenThrough], Float64 | None]:
    """Figures of an incision for each defect, by its name; and both lips now, one closed curve, (count, 3).

    A case without a defect has one entry without a name.

    Parameters
    ----------
    incision
        The incision.
    model, displacement
        The lattice now, and the displacement of its nodes [cells], shape (node_count, 3).
    held
        The surface now.
    closed, cut
        The surface before it was cut, and when it was cut and nothing held it open; None where that is not known.
    landmarks
        Landmarks of the case.
    looking, shaft
        From where is looked, and what is moved through the opening.
    looks_from
        From the defect to the surgeon, LPS axes; out through the opening's middle when left out.
    retraction_n, stitch_forces_n, reaches
        As of :func:`heartcase.simulator.incisions.measure.measured`.
    tissues
        What tissue fills the cells, where it is to be said what was cut.

    Raises
    ------
    SimulationError
        A curve is none, or a number is out of range.
    """
    line, opening, gap = incision.line, None, None
    if line is not None:
        sides = held.lips(line, incision.whole_count)
        gap = float(np.linalg.norm(sides[0] - sides[1], axis=1).max())
        opening = np.concatenate([sides[0], sides[1][::-1]])
    scene = Scene(
        model,
        displacement,
        held.rest_mm,
        held.now_mm,
        held.triangles,
        landmarks,
        opening_mm=opening,
        known=held.carrier,
        is_cut_face=held.is_cut_face,
        tissues=tissues,
    )
    through = incision.entry_mm if opening is None else opening.mean(axis=0)
    found = {}
    for rim in incision.rims or (None,):
        now = None if rim is None else held.carried(rim.points_mm)
        axis = looks_from or _outward(incision, None if now is None else through - now.mean(axis=0))
        view = View(axis, looking.half_angle_deg, looking.distance_mm, looking.eye_count)
        plan = IncisionPlan(
            name=incision.name,
            curve_mm=incision.curve_mm,
            rim_mm=None if rim is None else rim.points_mm,
            view=view,
            shaft=Shaft(axis, shaft.half_angle_deg, shaft.length_mm, shaft.radius_mm),
            depth_mm=shaft.depth_mm,
        )
        figures, seen = measured_and_seen(
            plan,
            scene,
            retraction_n=retraction_n,
            stitch_forces_n=stitch_forces_n,
            spacing_mm=shaft.spacing_mm,
            reaches=reaches,
        )
        figures = replace(figures, gap_mm=gap)
        if rim is None or now is None or seen is None:
            found[""] = SeenThrough(figures, None, None)
            continue
        before, after = (
            None if one is None else visibility(one.tree, one.carried(rim.points_mm), view).rim_seen
            for one in (closed, cut)
        )
        figures = replace(figures, rim_seen_closed=before, rim_seen_cut=after)
        found[rim.name] = SeenThrough(figures, _tuple(seen.best_direction), now)
    return found, opening


def _outward(incision: Incision, way: Float64 | None) -> tuple[float, float, float]:
    """Where the surgeon is: out of the defect through the opening, or at right angles to the tissue."""
    if way is None:
        line = incision.line
        way = np.array([0.0, -1.0, 0.0]) if line is None else line.outward.mean(axis=0)
    return _tuple(way)


def _tuple(values: Float64) -> tuple[float, float, float]:
    x, y, z = values.tolist()
    return x, y, z
