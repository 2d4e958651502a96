"""All figures of one incision, from the tissue and its surface as they are now."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from heartcase.schemas.arrays import Bool, Float, Float64, Int32
from heartcase.schemas.landmarks import Landmark
from heartcase.simulator.dynamics.measures import inverted_cells
from heartcase.simulator.incisions.cut_tissue import CellTissues, area_by_tissue_mm2, area_mm2, cut_triangles
from heartcase.simulator.incisions.directions import divided
from heartcase.simulator.incisions.figures import IncisionFigures
from heartcase.simulator.incisions.nearness import Carrier, as_triangles, to_vessels
from heartcase.simulator.incisions.stitch_limits import beside_measured
from heartcase.simulator.incisions.strain import Peak, Strain, cell_strain, peak
from heartcase.simulator.incisions.surgical_freedom import Shaft, freedom_at_target_mm3, reach
from heartcase.simulator.incisions.triangle_tree import TriangleTree, triangle_tree
from heartcase.simulator.incisions.visibility import View, Visibility, visibility
from heartcase.simulator.lattice.model import LatticeModel

__all__ = ["IncisionPlan", "Scene", "measured", "measured_and_seen"]


@dataclass(frozen=True)
class IncisionPlan:
    """One way to a defect."""

    name: str
    """Its name."""
    curve_mm: Float64
    """The incision along the surface at rest, an open curve, LPS mm, shape (count, 3)."""
    rim_mm: Float64 | None
    """The defect's rim at rest, a closed curve, LPS mm, shape (count, 3); without a defect nothing is said of what is
    seen."""
    view: View
    """From where the surgeon looks."""
    shaft: Shaft
    """The instrument."""
    depth_mm: float = 60.0
    """How far behind the opening places are counted that the tip comes to, mm."""


@dataclass(frozen=True)
class Scene:
    """The heart as it is held open."""

    model: LatticeModel
    """The lattice, cut."""
    displacement: Float
    """Displacement of its nodes [cells], shape (node_count, 3)."""
    rest_mm: Float
    """Vertices of its surface at rest, those of the lips too, LPS mm, shape (vertex_count, 3)."""
    now_mm: Float
    """The same vertices now, LPS mm, shape (vertex_count, 3)."""
    triangles: Int32
    """Vertex numbers, shape (triangle_count, 3)."""
    landmarks: Sequence[Landmark] = ()
    """The case's landmarks: the vessels among them are kept clear of."""
    opening_mm: Float64 | None = None
    """The lips as they are held now, one closed curve, LPS mm, shape (count, 3); without it no reach is worked out."""

    known: Carrier | None = None
    """What carries points with the surface, where it is known from another moment."""
    is_cut_face: Bool | None = None
    """Which triangles are walls of cuts, shape (triangle_count,); None where that is not known."""
    tissues: CellTissues | None = None
    """What tissue fills the cells, where it is to be said what was cut."""

    @cached_property
    def carrier(self) -> Carrier:
        """What carries points with the surface."""
        return self.known or Carrier(self.rest_mm)

    @cached_property
    def tree(self) -> TriangleTree:
        """The surface now, for what is seen and reached."""
        return triangle_tree(self.now_mm, self.triangles)

    @cached_property
    def cut_mm(self) -> Float64:
        """Walls of all cuts at rest, mm, shape (count, 3, 3)."""
        is_wall = np.zeros(len(self.triangles), np.bool_) if self.is_cut_face is None else self.is_cut_face
        return cut_triangles(self.rest_mm, self.triangles, is_wall)

    @cached_property
    def strain(self) -> Strain:
        """Stretch and stress of the cells."""
        return cell_strain(self.model, self.displacement)


def measured(
    plan: IncisionPlan,
    scene: Scene,
    *,
    retraction_n: float | None = None,
    stitch_forces_n: Sequence[float] = (),
    spacing_mm: float = 2.0,
    reaches: bool = True,
) -> IncisionFigures:
    """The figures of an incision: those of :func:`measured_and_seen`."""
    return measured_and_seen(
        plan,
        scene,
        retraction_n=retraction_n,
        stitch_forces_n=stitch_forces_n,
        spacing_mm=spacing_mm,
        reaches=reaches,
    )[0]


def measured_and_seen(
    plan: IncisionPlan,
    scene: Scene,
    *,
    retraction_n: float | None = None,
    stitch_forces_n: Sequence[float] = (),
    spacing_mm: float = 2.0,
    reaches: bool = True,
) -> tuple[IncisionFigures, Visibility | None]:
    """The figures of an incision, and what is seen of the defect where there is one.

    Parameters
    ----------
    plan
        The incision and the defect, at rest: both are carried with the tissue.
    scene
        The heart as it is held open.
    retraction_n
        Largest force with which it is held, N; the instruments know it.
    stitch_forces_n
        Force in each stitch, N, where it is closed again.
    spacing_mm
        Edge of the cubes in which places of the tip are counted, mm.
    reaches
        Whether the reach of the tip is worked out: it takes ten times as long as all else.

    Raises
    ------
    SimulationError
        A curve is none, or a number is out of range.
    """
    tree, strain = scene.tree, scene.strain
    seen, freedom, reached = None, None, None
    if plan.rim_mm is not None:
        rim = scene.carrier.carried(plan.rim_mm, scene.now_mm)
        seen = visibility(tree, rim, plan.view)
        freedom = freedom_at_target_mm3(tree, rim.mean(axis=0), plan.shaft, tip_free_mm=plan.shaft.radius_mm)
    if scene.opening_mm is not None and reaches:
        reached = reach(tree, scene.opening_mm, plan.shaft, depth_mm=plan.depth_mm, spacing_mm=spacing_mm).volume_mm3
    stretch, stress = (
        peak(scene.model, scene.displacement, values[:, 0], strain.is_known)
        for values in (strain.stretches, strain.stress_kpa)
    )
    walls = scene.cut_mm
    # What is not cut yet is as near as its line.
    vessels = to_vessels(walls if len(walls) else as_triangles(plan.curve_mm), scene.landmarks)
    figures = IncisionFigures(
        name=plan.name,
        rim_seen=None if seen is None else seen.rim_seen,
        rim_seen_best=None if seen is None else seen.rim_seen_best,
        solid_angle_sr=None if seen is None else seen.solid_angle_sr,
        freedom_mm3=freedom,
        reach_mm3=reached,
        retraction_n=retraction_n,
        stretch=stretch.value,
        stretch_high=stretch.high,
        stretch_place_mm=_place(stretch),
        stress_kpa=stress.value,
        stress_high_kpa=stress.high,
        stress_place_mm=_place(stress),
        inverted_cell_count=int(inverted_cells(scene.model, scene.displacement).sum()),
        cut_mm2=area_mm2(walls) if len(walls) else None,
        cut_structures_mm2={} if scene.tissues is None else area_by_tissue_mm2(walls, scene.tissues),
        nearest_mm={one.name: one.distance_mm for one in vessels},
        length_mm=_length_mm(plan.curve_mm),
        stitches=beside_measured(tuple(stitch_forces_n)),
    )
    return figures, seen


def _length_mm(curve_mm: npt.ArrayLike) -> float:
    return float(divided(np.asarray(curve_mm, dtype=float), 1.0, is_closed=False)[1].sum())


def _place(found: Peak) -> tuple[float, float, float]:
    x, y, z = found.place_mm.tolist()
    return x, y, z
