"""The simulation script: what the instruments do, in a TOML file."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from heartcase.schemas.base import BladePoses, Model, Name, PointMm, PositiveMm
from heartcase.schemas.migrate import SCRIPT
from heartcase.schemas.scripts.suture_actions import PatchAction, RowAction, StitchAction, suture_problems
from heartcase.schemas.scripts.tool_actions import ForcepsAction, RetractorAction, ScissorsAction
from heartcase.schemas.scripts.waypoint import Waypoint, raise_problems, time_problems

__all__ = ["CutAction", "ExciseAction", "GrabAction", "ProbeAction", "SimulationScript", "Waypoint"]


_Acceleration = Annotated[float, Field(ge=-10_000.0, le=10_000.0)]


class GrabAction(Model):
    """Close on the nodes in a sphere, move them, let go (thesis 8.7.2)."""

    kind: Literal["grab"] = "grab"
    """Which instrument."""
    name: Name = "grab"
    """Name in the summary."""
    position_mm: PointMm | None = None
    """Centre of the sphere at rest, LPS mm."""
    landmark: Name | None = None
    """Name of a landmark of the case to grab at, instead of ``position_mm``."""
    radius_mm: PositiveMm = 6.0
    """Radius of the sphere."""
    start_s: Annotated[float, Field(ge=0.0)] = 0.0
    """When the grab closes, s."""
    release_s: Annotated[float, Field(gt=0.0)] | None = None
    """When it lets go, s; it holds to the end when left out."""
    path: Annotated[tuple[Waypoint, ...], Field(min_length=1)]
    """Waypoints by ascending time. The hand moves in a straight line from where it closed, at ``start_s``, to the
    first, on from each to the next, and stays at the last."""

    @model_validator(mode="after")
    def _check(self) -> GrabAction:
        raise_problems(_problems(self))
        return self


class CutAction(Model):
    """Cut along what a blade sweeps from pose to pose."""

    name: Name = "blade"
    """Name in messages."""
    time_s: Annotated[float, Field(ge=0.0)] = 0.0
    """When, s; all of it in one moment."""
    poses_mm: BladePoses
    """Points of the blade's edge at each pose, as many in each. For a line drawn on tissue: the line, and the line at
    its depth."""
    at_rest: bool = False
    """Whether they are places of the tissue at rest; else they are places at that time."""

    @model_validator(mode="after")
    def _check(self) -> CutAction:
        if len({len(pose) for pose in self.poses_mm}) > 1:
            raise ValueError("every pose of a blade needs as many points as the others")
        return self


class ExciseAction(Model):
    """Take out a piece of tissue that was cut free of all else."""

    name: Name = "excision"
    """Name in the summary; no other has it."""
    time_s: Annotated[float, Field(ge=0.0)] = 0.0
    """When, s: after cuts and stitches of the same moment, before hands let go or close."""
    place_mm: PointMm
    """A point on it; it is taken to the nearest place on the surface."""
    at_rest: bool = False
    """Whether that is a place of the tissue at rest; else it is one at that time."""


class ProbeAction(Model):
    """Bring in a probe, move it through waypoints, withdraw it (thesis 8.7.1)."""

    name: Name = "probe"
    """Name in the summary."""
    position_mm: PointMm | None = None
    """Where its centre comes in, LPS mm: outside the tissue, or what is there has to give way at once."""
    landmark: Name | None = None
    """Name of a landmark of the case to come in at, instead of ``position_mm``."""
    semi_axes_mm: tuple[PositiveMm, PositiveMm, PositiveMm] = (6.0, 6.0, 6.0)
    """Semi-axes of an ellipsoid along the LPS axes; all alike for a ball."""
    axis_mm: PointMm | None = None
    """Vector from end to end of the line that the ball is swept along, LPS mm: a capsule."""
    start_s: Annotated[float, Field(ge=0.0)] = 0.0
    """When it comes in, s."""
    release_s: Annotated[float, Field(gt=0.0)] | None = None
    """When it is withdrawn, s; it stays to the end when left out."""
    path: Annotated[tuple[Waypoint, ...], Field(min_length=1)]
    """Waypoints by ascending time, as a grab's."""

    @model_validator(mode="after")
    def _check(self) -> ProbeAction:
        problems = _problems(self)
        if self.axis_mm is not None and len(set(self.semi_axes_mm)) > 1:
            problems.append("only a ball is swept along axis_mm: give three semi-axes that are alike")
        raise_problems(problems)
        return self


def _problems(action: GrabAction | ProbeAction) -> list[str]:
    """What is wrong with an action's place and times."""
    problems = []
    if (action.position_mm is None) == (action.landmark is None):
        problems.append("give either position_mm or landmark")
    return problems + time_problems(action.start_s, action.release_s, action.path)


class SimulationScript(Model):
    """A scripted session."""

    heartcase_script: Annotated[int, Field(ge=1, json_schema_extra={"maximum": SCRIPT.newest})] = 1
    """Version of the script's format: 1."""
    seconds: Annotated[float, Field(gt=0.0, le=3600.0)] = 2.0
    """Simulated time, s."""
    step_s: Annotated[float, Field(gt=0.0)] | None = None
    """Time step, s; the case's default when left out. A step beyond the case's limit is refused."""
    damping_per_s: Annotated[float, Field(ge=0.0)] = 10.0
    """Mass-proportional damping coefficient c in a = f/m - c v, 1/s."""
    gravity_m_s2: tuple[_Acceleration, _Acceleration, _Acceleration] = (0.0, 0.0, 0.0)
    """Acceleration of gravity in LPS axes, m/s2."""
    frames_per_second: Annotated[float, Field(gt=0.0, le=1000.0)] = 30.0
    """How often the surface is updated, in simulated time."""
    curvature: Literal["flagged", "all", "none"] = "flagged"
    """Where the surface follows the interpolated basis: per-vertex flag, everywhere, nowhere."""
    actions: tuple[GrabAction, ...] = ()
    """What the instruments do."""
    cuts: tuple[CutAction, ...] = ()
    """What blades cut; those of one moment in this order, before hands let go or close."""

    excisions: tuple[ExciseAction, ...] = ()
    """Pieces that are taken out once they are cut free."""
    case: Name | None = None
    """Name of the case that it is for: it is refused on another. It runs on any when left out."""

    @model_validator(mode="after")
    def _check_cuts(self) -> SimulationScript:
        late = {
            "cuts": [cut.name for cut in self.cuts if cut.time_s >= self.seconds],
            "excisions": [one.name for one in self.excisions if one.time_s >= self.seconds],
        }
        problems = [f"{what} come after the end: {', '.join(names)}" for what, names in late.items() if names]
        if len({one.name for one in self.excisions}) < len(self.excisions):
            problems.append("two excisions have one name: name each by itself")
        raise_problems(problems)
        return self

    probes: tuple[ProbeAction, ...] = ()
    """Probes that are led through the tissue."""
    forceps: tuple[ForcepsAction, ...] = ()
    """Forceps that hold tissue between their jaws."""
    retractors: tuple[RetractorAction, ...] = ()
    """Retractors that hold a lip of an incision."""
    scissors: tuple[ScissorsAction, ...] = ()
    """Scissors, and what they cut."""
    stitches: tuple[StitchAction, ...] = ()
    """Stitches, in the order in which those of one moment are placed: after cuts, and before hands let go or close."""

    stitch_rows: tuple[RowAction, ...] = ()
    """Rows of stitches; they are placed after single ones of the same moment."""
    patches: tuple[PatchAction, ...] = ()
    """Patches; they are sewn on after stitches of the same moment are placed."""

    @model_validator(mode="after")
    def _check_sutures(self) -> SimulationScript:
        raise_problems(suture_problems(self.seconds, self.stitches, self.stitch_rows, self.patches))
        return self
