"""Pictures of an incision held open: from where the defect is seen best, in structures' colours and by stretch."""

from __future__ import annotations

import numpy as np

from heartcase.cli.shared.film import Seen
from heartcase.schemas.arrays import Float64, UInt8
from heartcase.schemas.errors import MissingExtraError
from heartcase.simulator.incisions.directions import divided
from heartcase.simulator.incisions.strain import vertex_colours
from heartcase.simulator.session.planned_incisions import HeldOpen, at_vertices
from heartcase.simulator.simulation import Simulation

__all__ = ["STRESS_MOST_KPA", "STRETCH_MOST", "stress_colours", "stretch_colours", "view_of_defect"]

STRETCH_MOST = 1.5
"""Stretch of the last colour; the first is that of no stretch."""
STRESS_MOST_KPA = 20.0
"""Stress of the last colour, kPa; the first is that of none."""
_RIM_COLOUR = (40, 220, 60)
_RIM_MM = 0.35
_APART_MM = 0.5
"""Marks along the rim lie no farther apart."""
_AROUND = 1.3
"""What of the heart is in the close picture: as far from the opening as it is long, times this."""
_SIZE = (520, 520)


def stretch_colours(held: HeldOpen, simulation: Simulation) -> UInt8:
    """Colour of each triangle by the largest stretch around it, shape (triangle_count, 3)."""
    return _by(held.strain.stretches[:, 0], held, simulation, 1.0, STRETCH_MOST)


def stress_colours(held: HeldOpen, simulation: Simulation) -> UInt8:
    """Colour of each triangle by the largest principal stress around it, shape (triangle_count, 3)."""
    return _by(held.strain.stress_kpa[:, 0], held, simulation, 0.0, STRESS_MOST_KPA)


def _by(values: Float64, held: HeldOpen, simulation: Simulation, lowest: float, highest: float) -> UInt8:
    assert simulation.surface is not None
    shown = at_vertices(values, held, simulation)
    return vertex_colours(shown[simulation.surface.triangles].mean(axis=1), lowest, highest)


def view_of_defect(held: HeldOpen, defect: str, simulation: Simulation, colours: UInt8) -> UInt8:
    """Four views from the best eye: the heart, the opening with the defect's rim in green, its stretch and its stress.

    Parameters
    ----------
    held
        The plan, just run.
    defect
        Name of the defect.
    simulation
        The simulation that ran it.
    colours
        Colours of the surface before any cut, shape (triangle_count, 3).

    Raises
    ------
    MissingExtraError
        What draws is not installed.
    """
    try:
        from heartcase.pipeline.report.montage import montage
        from heartcase.pipeline.report.render import Mesh, camera_for, draw_mesh
    except ImportError:
        raise MissingExtraError("A picture", "prepare") from None
    seen = Seen.now(simulation, colours)
    points, normals = seen.surface.vertices_mm.astype(float), seen.surface.normals.astype(float)
    triangles = seen.triangles.astype(np.int64)
    rim = held.rims_mm[defect]
    opening = rim if held.opening_mm is None else held.opening_mm
    middle = opening.mean(axis=0)
    size = _AROUND * max(float(np.ptp(opening, axis=0).max()), 1.0)
    corners = middle + size / 2 * np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    towards = held.looks_from[defect]
    up = (0.0, 0.0, 1.0) if abs(towards[2]) < 0.98 else (0.0, -1.0, 0.0)
    far, near = (camera_for(what, towards=towards, up=up, size=_SIZE) for what in (points, corners))
    marks, mark_normals, mark_triangles = _marks(divided(rim, _APART_MM, is_closed=True)[0])
    marked = (
        np.concatenate([points, marks]),
        np.concatenate([triangles, mark_triangles + len(points)]),
        np.concatenate([normals, mark_normals]),
    )

    def drawn(own: UInt8, camera: object) -> UInt8:
        green = np.tile(np.array(_RIM_COLOUR, np.uint8), (len(mark_triangles), 1))
        mesh = Mesh(*marked, np.ascontiguousarray(np.concatenate([own, green])))
        return draw_mesh(mesh, camera, depth_shading=True)  # type: ignore[arg-type]

    found = held.figures[defect]
    pictures = {
        held.plan.name: drawn(seen.colours, far),
        f"{found.rim_seen_best or 0.0:.0%} of the rim (green) seen from the best eye": drawn(seen.colours, near),
        f"stretch, 1 (blue) to {STRETCH_MOST:g} (red)": drawn(stretch_colours(held, simulation), near),
        f"stress, 0 (blue) to {STRESS_MOST_KPA:g} kPa (red)": drawn(stress_colours(held, simulation), near),
    }
    return montage(pictures, columns=2)


def _marks(places: Float64) -> tuple[Float64, Float64, np.ndarray]:
    """A small octahedron at each place: corners, normals, triangles."""
    corners = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]], float)
    faces = [(0, 2, 4), (2, 1, 4), (1, 3, 4), (3, 0, 4), (2, 0, 5), (1, 2, 5), (3, 1, 5), (0, 3, 5)]
    points = places[:, None] + _RIM_MM * corners
    numbers = 6 * np.arange(len(places))[:, None, None] + np.array(faces)
    return points.reshape(-1, 3), np.tile(corners, (len(places), 1)), numbers.reshape(-1, 3)
