"""What is seen of a defect from where a surgeon looks: the part of its rim, and how large it looks."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from heartcase.schemas.arrays import Bool, Float64
from heartcase.schemas.errors import SimulationError
from heartcase.simulator.incisions.directions import cone_directions, cone_solid_angle_sr, divided, patches
from heartcase.simulator.incisions.segments import touches
from heartcase.simulator.incisions.triangle_tree import TriangleTree

__all__ = ["View", "Visibility", "solid_angle_sr", "visibility"]


@dataclass(frozen=True)
class View:
    """From where is looked: eyes at one distance from the middle of the defect, in a cone of directions."""

    axis: tuple[float, float, float]
    """From the defect to the surgeon, LPS axes."""
    half_angle_deg: float = 30.0
    """Half of the cone's opening, degrees."""
    distance_mm: float = 400.0
    """From the defect to the eye, mm."""
    eye_count: int = 200
    """Places of the eye."""
    spacing_mm: float = 0.5
    """Longest piece of the rim that is seen or not as one, mm."""
    stop_short_mm: float = 0.5
    """How far before the rim a line of sight ends, mm: the rim lies in the tissue's surface itself."""


@dataclass(frozen=True)
class Visibility:
    """What is seen."""

    rim_seen: float
    """Part of the rim's length that is seen from one eye of the cone or another [1]."""
    rim_seen_best: float
    """Part of the rim's length that is seen from the best eye [1]."""
    rim_seen_mean: float
    """Part of the rim's length that is seen from an eye, in the mean over the cone [1]."""
    solid_angle_sr: float
    """Solid angle of what is seen of the defect from the best eye, sr."""
    middle_seen_sr: float
    """Solid angle of the directions of the cone from which the middle of the defect is seen, sr."""
    best_direction: Float64
    """From the defect to the best eye, LPS axes, unit length, shape (3,)."""
    is_seen: Bool
    """Whether each piece of the rim is seen from the best eye, shape (piece_count,)."""
    pieces_mm: Float64
    """Middles of the pieces, mm, shape (piece_count, 3)."""


def visibility(tree: TriangleTree, rim_mm: npt.ArrayLike, view: View) -> Visibility:
    """What is seen of a defect.

    Parameters
    ----------
    tree
        All that may be in the way, as it is now: the tissue's surface.
    rim_mm
        The defect's rim, a closed curve, mm, shape (count, 3), at least 3 points; carried with the tissue.
    view
        From where is looked.

    Raises
    ------
    SimulationError
        The rim is no closed curve of finite points, or the view is out of range.
    """
    rim = np.asarray(rim_mm, dtype=float)
    if rim.ndim != 2 or rim.shape[0] < 3 or rim.shape[1] != 3 or not np.isfinite(rim).all():
        raise SimulationError("the rim must be a curve of at least three finite points", place="rim_mm")
    for name in ("distance_mm", "spacing_mm"):
        if not 0.0 < getattr(view, name) < np.inf:
            raise SimulationError("must be above 0 mm", place=name)
    middle = rim.mean(axis=0)
    directions = cone_directions(view.axis, view.half_angle_deg, view.eye_count)
    eyes = middle + view.distance_mm * directions
    pieces, lengths = divided(rim, view.spacing_mm, is_closed=True)
    seen = _seen(tree, eyes, pieces, view.stop_short_mm)
    share = seen @ lengths / lengths.sum()
    best = int(np.argmax(share))
    filling = patches(rim, view.spacing_mm)
    is_patch_seen = _seen(tree, eyes[best : best + 1], filling.mean(axis=1), view.stop_short_mm)[0]
    angles = np.abs(solid_angle_sr(filling, eyes[best]))
    is_middle_seen = _seen(tree, eyes, middle[None], view.stop_short_mm)[:, 0]
    return Visibility(
        rim_seen=float(lengths[seen.any(axis=0)].sum() / lengths.sum()),
        rim_seen_best=float(share[best]),
        rim_seen_mean=float(share.mean()),
        solid_angle_sr=float(angles[is_patch_seen].sum()),
        middle_seen_sr=float(is_middle_seen.mean()) * cone_solid_angle_sr(view.half_angle_deg),
        best_direction=directions[best],
        is_seen=seen[best],
        pieces_mm=pieces,
    )


def solid_angle_sr(triangles_mm: Float64, eye_mm: Float64) -> Float64:
    """Solid angle of each triangle from a place, sr, signed by its orientation, shape (count,).

    Van Oosterom and Strackee, IEEE Trans. Biomed. Eng. 30, 1983.
    """
    a, b, c = np.moveaxis(triangles_mm - eye_mm, 1, 0)
    la, lb, lc = (np.linalg.norm(one, axis=1) for one in (a, b, c))
    volume = np.einsum("ni,ni->n", a, np.cross(b, c))
    ab, ac, bc = (np.einsum("ni,ni->n", one, other) for one, other in ((a, b), (a, c), (b, c)))
    angle: Float64 = 2.0 * np.arctan2(volume, la * lb * lc + ab * lc + ac * lb + bc * la)
    return angle


def _seen(tree: TriangleTree, eyes: Float64, points: Float64, stop_short_mm: float) -> Bool:
    """Whether each point is seen from each eye, shape (eye_count, point_count)."""
    starts = np.repeat(eyes, len(points), axis=0)
    ends = np.tile(points, (len(eyes), 1))
    way = ends - starts
    ends = ends - way * np.minimum(stop_short_mm / np.linalg.norm(way, axis=1), 1.0)[:, None]
    return ~touches(tree, starts, ends).reshape(len(eyes), len(points))
