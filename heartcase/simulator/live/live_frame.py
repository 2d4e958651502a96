"""A moment of a session, with all that a window or a page shows of it."""

from __future__ import annotations

from dataclasses import dataclass

from heartcase.schemas.arrays import Float64, Int32
from heartcase.schemas.recording.branches import Branch
from heartcase.schemas.recording.commands import Cut
from heartcase.simulator.cutting.cuts import Cuts
from heartcase.simulator.live.cuts_done import Moment
from heartcase.simulator.live.goals import held_by, probe_axes_mm
from heartcase.simulator.live.tool import Held
from heartcase.simulator.session.frame import Frame
from heartcase.simulator.session.operating_session import OperatingSession
from heartcase.simulator.surface.deform import SurfaceModel

__all__ = ["LiveFrame", "moment_of"]


@dataclass(frozen=True)
class LiveFrame:
    """A moment, with all that a window or a page shows of it. Nothing of it changes later."""

    frame: Frame
    """Tissue, instruments and stitches, with the visible surface where it is wanted."""
    surface: SurfaceModel
    """What the surface's vertices follow, and its triangles."""
    triangle_origin: Int32 | None
    """Triangle of the uncut surface that each is a part of, -1 for cut faces, shape (triangle_count,); None where
    nothing is cut."""
    tissue_cuts: Cuts | None
    """All that was cut of the lattice; None where nothing is."""
    held: tuple[Held, ...]
    """What holds tissue."""
    probes: dict[str, Float64]
    """Name of each probe -> its semi-axes in columns, then half of the line it is swept along; LPS mm, shape (3, 4)."""
    mode: str
    """``running``, ``paused`` or ``playing`` (what is known is done again)."""
    real_time_factor: float | None
    """Simulated time over time that went by, during the last second or so; None while it does not run."""
    steps_per_second: float | None
    """Steps taken for each second that went by; None while it does not run."""
    ahead_s: float
    """Simulated time that is known from here on, after going back, s."""
    recording: str | None
    """Name of the folder that is recorded into."""
    act_count: int
    """Acts that are done."""
    cuts: tuple[Cut, ...] = ()
    """Cuts that are done, as the history has them: at rest. The same object while they are the same."""
    unheld: Moment | None = None
    """The surface when it was last seen cut with no instrument in it; None where it was not seen so."""
    marks: tuple[tuple[int, str], ...] = ()
    """Steps of cuts, patches and stitches that are known, and what each is; the same object while they are the same."""
    branches: tuple[Branch, ...] = ()
    """What was left when the session went on another way, the latest first; the same object while they are the same."""


def moment_of(session: OperatingSession, frame: Frame | None = None) -> LiveFrame:
    """A session as it stands, paused; its simulation has a surface. ``frame`` is that moment's, where it is known."""
    simulation = session.simulation
    assert simulation.surface is not None
    return LiveFrame(
        frame=frame or session.frame(surface=True),
        surface=simulation.surface,
        triangle_origin=None if simulation.split is None else simulation.split.triangle_origin,
        tissue_cuts=simulation.cuts,
        held=held_by(simulation),
        probes=probe_axes_mm(simulation),
        mode="paused",
        real_time_factor=None,
        steps_per_second=None,
        ahead_s=(session.end_step - session.step_count) * simulation.step_s,
        recording=None,
        act_count=0,
    )
