"""What scripts sew: stitches and rows, placed, drawn evenly, tied and taken out at their times, and patches."""

from __future__ import annotations

from collections.abc import Iterator
from statistics import fmean

from heartcase.schemas.recording.commands import (
    DrawStitch,
    PlacePatch,
    PlaceRow,
    PlaceStitch,
    TakeOutPatch,
    TakeOutStitch,
    TieStitch,
)
from heartcase.schemas.scripts.script import SimulationScript
from heartcase.schemas.scripts.suture_actions import PatchAction, RowAction, StitchAction
from heartcase.simulator.session.operating_session import OperatingSession
from heartcase.simulator.session.perform_sutures import patch_named, stitches_named

__all__ = ["Threads"]

_STITCH = {"name", "places_mm", "at_rest", "stiffness_n_m"}
_ROW = {*_STITCH, "spacing_mm", "running"}
_PATCH = {"name", "outline_mm", "at_rest", "spacing_mm", "stiffness_n_m", "thickness_mm", "scale"}


class _Timed:
    """A stitch or a row in steps instead of seconds."""

    def __init__(self, action: StitchAction | RowAction, step_s: float, step_total: int) -> None:
        self.action = action
        self.placed = min(round(action.time_s / step_s), step_total - 1)
        self.tied = max(self.placed + 1, round(action.tied_s / step_s))
        self.out = step_total + 1 if action.out_s is None else max(self.tied + 1, round(action.out_s / step_s))
        self.started_at: dict[str, float] = {}
        """Length of the thread of each stitch when it was placed, mm."""


class _TimedPatch:
    """A patch in steps instead of seconds."""

    def __init__(self, action: PatchAction, step_s: float, step_total: int) -> None:
        self.action = action
        self.placed = min(round(action.time_s / step_s), step_total - 1)
        self.out = step_total + 1 if action.out_s is None else max(self.placed + 1, round(action.out_s / step_s))


class Threads:
    """What the stitches, rows and patches of a script are told, and what they pulled with."""

    def __init__(self, session: OperatingSession, script: SimulationScript, step_total: int) -> None:
        self.session = session
        step_s = session.simulation.step_s
        threads: list[StitchAction | RowAction] = [*script.stitches, *script.stitch_rows]
        self._timed = [_Timed(action, step_s, step_total) for action in threads]
        self._patches = [_TimedPatch(action, step_s, step_total) for action in script.patches]
        self._total = step_total
        self.peak_force_n: dict[str, float] = {}
        """Stitch -> highest force in it in any frame, N."""
        self.end_force_n: dict[str, float] = {}
        """Stitch -> force in it at the last frame in which it was there, N."""
        self.tied_n: dict[str, tuple[float, float]] = {}
        """Stitch or row that is drawn with a tension -> its tension when it was tied, and that asked for, N."""
        self.patch_force_n: dict[str, tuple[float, ...]] = {}
        """Patch -> force in each stitch of its rim at the last frame in which it was there, N."""
        self.patch_peak_force_n: dict[str, float] = {}
        """Patch -> highest force in a stitch of its rim in any frame, N."""

    def stops(self) -> Iterator[int]:
        """Steps at which something is done."""
        for one in self._timed:
            yield from (stop for stop in (one.placed, one.tied, one.out) if 0 < stop < self._total)
        for patch in self._patches:
            yield from (stop for stop in (patch.placed, patch.out) if 0 < stop < self._total)

    def change(self, now: int) -> None:
        """Do what is due at this step."""
        simulation = self.session.simulation
        for one in self._timed:
            name = one.action.name
            if now == one.placed:
                if isinstance(one.action, RowAction):
                    self.session.do(PlaceRow(**one.action.model_dump(include=_ROW)))
                else:
                    self.session.do(PlaceStitch(**one.action.model_dump(include=_STITCH)))
                stitches = stitches_named(simulation, name)
                one.started_at = {stitch.name: simulation.stitch_state(stitch).length_mm for stitch in stitches}
            if now == one.tied:
                if one.action.tension_n is not None:
                    forces = [simulation.stitch_state(stitch).force_n for stitch in stitches_named(simulation, name)]
                    self.tied_n[name] = (max(forces), one.action.tension_n)
                self.session.do(TieStitch(name=name))
            if now == one.out:
                self.session.do(TakeOutStitch(name=name))
        for patch in self._patches:
            if now == patch.placed:
                self.session.do(PlacePatch(**patch.action.model_dump(include=_PATCH)))
            if now == patch.out:
                self.session.do(TakeOutPatch(name=patch.action.name))

    def draw(self, stop: int) -> None:
        """Draw each thread on its way to where it shall be at a step."""
        for one in self._timed:
            if not one.placed < stop <= one.tied:
                continue
            part = (stop - one.placed) / (one.tied - one.placed)
            if one.action.tension_n is not None:
                self.session.do(DrawStitch(name=one.action.name, tension_n=part * one.action.tension_n))
            elif one.action.length_mm is not None:
                starts = one.started_at
                if isinstance(one.action, RowAction) and one.action.running:
                    starts = {one.action.name: fmean(starts.values())}
                for name, started_at in starts.items():
                    length = started_at + part * (one.action.length_mm - started_at)
                    self.session.do(DrawStitch(name=name, length_mm=max(length, 0.0)))

    def feel(self) -> None:
        """Keep the force in each, and the highest."""
        simulation = self.session.simulation
        own = {name for one in self._timed for name in one.started_at}
        for stitch in simulation.stitches:
            if stitch.name in own:
                force = simulation.stitch_state(stitch).force_n
                self.peak_force_n[stitch.name] = max(self.peak_force_n.get(stitch.name, 0.0), force)
                self.end_force_n[stitch.name] = force
        present = {patch.name for patch in simulation.patches}
        for one in self._patches:
            name = one.action.name
            if name in present:
                forces = simulation.patch_state(patch_named(simulation, name)).forces_n.tolist()
                self.patch_force_n[name] = tuple(forces)
                self.patch_peak_force_n[name] = max(self.patch_peak_force_n.get(name, 0.0), *forces)
