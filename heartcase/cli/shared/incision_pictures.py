"""Pictures and films of an incision, from where the defect is seen best: structures, stretch, stress."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from heartcase.cli.shared.film import Seen
from heartcase.schemas.arrays import Float64, UInt8
from heartcase.schemas.errors import MissingExtraError
from heartcase.simulator.incisions.directions import divided
from heartcase.simulator.incisions.nearness import carried
from heartcase.simulator.incisions.strain import vertex_colours
from heartcase.simulator.session.operating_session import OperatingSession
from heartcase.simulator.session.planned_incisions import HeldOpen, at_vertices
from heartcase.simulator.session.replay import frame_steps
from heartcase.simulator.simulation import Simulation

__all__ = [
    "STRESS_MOST_KPA",
    "STRETCH_MOST",
    "film_of_defect",
    "stretch_colours",
    "view_of_defect",
]

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
_FILM_SIZE = (416, 416)
"""Width and height of pictures and of films, pixels."""
_LAST_FRAMES = 12
"""So often an animation shows its last frame again."""


def stretch_colours(held: HeldOpen, simulation: Simulation) -> UInt8:
    """Colour of each triangle by the largest stretch around it, shape (triangle_count, 3)."""
    assert simulation.surface is not None
    shown = at_vertices(held.strain.stretches[:, 0], held, simulation)
    return vertex_colours(shown[simulation.surface.triangles].mean(axis=1), 1.0, STRETCH_MOST)


def _colours_of_vertices(held: HeldOpen, simulation: Simulation) -> tuple[UInt8, UInt8]:
    """Colours of the vertices by the largest stretch and principal stress around them, shape (vertex_count, 3) each."""
    stretch = at_vertices(held.strain.stretches[:, 0], held, simulation)
    stress = at_vertices(held.strain.stress_kpa[:, 0], held, simulation)
    return vertex_colours(stretch, 1.0, STRETCH_MOST), vertex_colours(stress, 0.0, STRESS_MOST_KPA)


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
    except ImportError:
        raise MissingExtraError("A picture", "prepare") from None
    eye = _Eye.best(held, defect)
    seen = Seen.now(simulation, colours)
    by_stretch, by_stress = _colours_of_vertices(held, simulation)
    part = held.figures[defect].rim_seen_best or 0.0
    rim = held.rims_mm[defect]
    far = eye.camera(seen.surface.vertices_mm.astype(float))
    near = eye.camera(eye.around_mm)
    pictures = {
        held.plan.name: _drawn(seen, rim, far),
        f"{part:.0%} of the rim (green) seen from the best eye": _drawn(seen, rim, near),
        f"stretch, 1 (blue) to {STRETCH_MOST:g} (red)": _drawn(seen, rim, near, by_stretch),
        f"stress, 0 (blue) to {STRESS_MOST_KPA:g} kPa (red)": _drawn(seen, rim, near, by_stress),
    }
    return montage(pictures, columns=2)


def film_of_defect(
    held: HeldOpen, defect: str, session: OperatingSession, colours: UInt8, *, frames_per_second: float
) -> list[UInt8]:
    """Frames of a plan from its start to its end, from where the best eye is at the end; the last one is held.

    Parameters
    ----------
    held
        The plan.
    defect
        Name of the defect.
    session
        The session that ran it; it is done again, to the same end.
    colours
        Colours of the surface before any cut, shape (triangle_count, 3).
    frames_per_second
        Frames in a second of simulated time.

    Raises
    ------
    MissingExtraError
        What draws is not installed.
    """
    eye = _Eye.best(held, defect)
    camera = eye.camera(eye.around_mm, size=_FILM_SIZE)
    frames = []
    session.go_to(session.start_step)
    for step in (session.start_step, *frame_steps(session, frames_per_second)):
        for _ in session.play(step):
            pass
        seen = Seen.now(session.simulation, colours)
        surface = session.simulation.surface
        assert surface is not None
        rim = carried(held.rims_at_rest_mm[defect], surface.rest_mm.astype(float), seen.surface.vertices_mm)
        frames.append(_drawn(seen, rim, camera))
    return [*frames, *frames[-1:] * _LAST_FRAMES]


@dataclass(frozen=True)
class _Eye:
    """From where is looked."""

    towards: tuple[float, float, float]
    around_mm: Float64
    """Corners of a box around the opening, LPS mm, shape (8, 3)."""

    @classmethod
    def best(cls, held: HeldOpen, defect: str) -> _Eye:
        opening = held.rims_mm[defect] if held.opening_mm is None else held.opening_mm
        size = _AROUND * max(float(np.ptp(opening, axis=0).max()), 1.0)
        corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
        return cls(held.looks_from[defect], opening.mean(axis=0) + size / 2 * corners)

    def camera(self, shown_mm: Float64, *, size: tuple[int, int] = _SIZE) -> Any:
        """A camera that shows all of some points."""
        try:
            from heartcase.pipeline.report.render import camera_for
        except ImportError:
            raise MissingExtraError("A picture", "prepare") from None
        up = (0.0, 0.0, 1.0) if abs(self.towards[2]) < 0.98 else (0.0, -1.0, 0.0)
        return camera_for(shown_mm, towards=self.towards, up=up, size=size)


def _drawn(seen: Seen, rim_mm: Float64, camera: Any, by_vertex: UInt8 | None = None) -> UInt8:
    """What is seen, in its own colours or in those of its vertices, with green marks along the rim."""
    from heartcase.pipeline.report.render import Mesh, draw_mesh

    marks, mark_normals, mark_triangles = _marks(divided(rim_mm, _APART_MM, is_closed=True)[0])
    points, colours = seen.surface.vertices_mm.astype(float), seen.colours if by_vertex is None else by_vertex
    marked = len(mark_triangles if by_vertex is None else marks)
    mesh = Mesh(
        np.concatenate([points, marks]),
        np.concatenate([seen.triangles.astype(np.int64), mark_triangles + len(points)]),
        np.concatenate([seen.surface.normals.astype(float), mark_normals]),
        np.concatenate([colours, np.tile(np.array(_RIM_COLOUR, np.uint8), (marked, 1))]),
        colours_of_points=by_vertex is not None,
    )
    return draw_mesh(mesh, camera, depth_shading=True)


def _marks(places: Float64) -> tuple[Float64, Float64, np.ndarray]:
    """A small octahedron at each place: corners, normals, triangles."""
    corners = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]], float)
    faces = [(0, 2, 4), (2, 1, 4), (1, 3, 4), (3, 0, 4), (2, 0, 5), (1, 2, 5), (3, 1, 5), (0, 3, 5)]
    points = places[:, None] + _RIM_MM * corners
    numbers = 6 * np.arange(len(places))[:, None, None] + np.array(faces)
    return points.reshape(-1, 3), np.tile(corners, (len(places), 1)), numbers.reshape(-1, 3)
