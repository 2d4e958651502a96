"""A page that operates: what it has in hand, what it shows, and which frames it has taken."""

from __future__ import annotations

import time
from dataclasses import replace
from typing import Any

import numpy as np

from heartcase.schemas.arrays import Float64, Int32
from heartcase.schemas.recording.branches import Branch
from heartcase.simulator.background.device_hand import ShownDevice
from heartcase.simulator.lattice.model import LatticeModel
from heartcase.simulator.live.cuts_done import MARKED
from heartcase.simulator.live.hands import Hands
from heartcase.simulator.live.live_frame import LiveFrame
from heartcase.simulator.live.rays import CutPlane, Hit, Pointer, Ray, first_hit, first_hit_beside
from heartcase.simulator.surface.deform import SurfaceModel, deform
from heartcase.studio.operating.incisions import is_held_open
from heartcase.studio.operating.requests import Look, Plane
from heartcase.studio.operating.scene.cell_labels import nearest_cell
from heartcase.studio.operating.scene.packing import Rounded, coarse_message, frame_message, topology_message
from heartcase.studio.operating.stage import Stage

__all__ = ["IN_FLIGHT_MAX", "Viewer", "described", "patch_arrays"]

IN_FLIGHT_MAX = 2
"""Frames that a page has not taken yet at most: one that is slow gets the newest when it is ready for it."""
_STILL_S = 0.1
"""Where nothing moves, the time alone is told so often, s."""


class Viewer:
    """One page on a stage.

    Parameters
    ----------
    stage
        What it looks at.
    """

    def __init__(self, stage: Stage) -> None:
        self._stage = stage
        self.hands = Hands(stage.live)
        self.hidden: frozenset[int] = frozenset()
        self.wants_strain = self.wants_coarser = self.wants_figures = False
        self._surface: SurfaceModel | None = None
        self._model: LatticeModel | None = None
        self._sent: Rounded | None = None
        self._shown: LiveFrame | None = None
        self._shown_s = 0.0
        self._stretch: Any = None
        self._topology = self._frame = self._taken = 0
        self._coarse_topology = 0
        self._plane: CutPlane | None = None
        self._figures: str | None = None
        self._marks: tuple[tuple[int, str], ...] | None = None
        self._branches: tuple[Branch, ...] | None = None
        self._pickable: tuple[SurfaceModel, frozenset[int], Int32] | None = None

    def begin_anew(self) -> None:
        """The stage has another session now: nothing is in hand."""
        tool = self.hands.tool
        self.hands, self._marks, self._branches = Hands(self._stage.live), None, None
        if tool is not None:
            self.hands.take(tool.key)
            assert self.hands.tool is not None
            self.hands.tool.size = tool.size

    def seen(self, frame: int) -> None:
        """The page took a frame."""
        self._taken = max(self._taken, min(frame, self._frame))

    def pointer(self, look: Look) -> Pointer:
        """Where the page points to, against the surface as it is now."""
        direction = np.array(look.direction)
        ray = Ray(np.array(look.start_mm), direction / np.linalg.norm(direction))
        hit = None
        if self.hands.needs_hit:
            newest = self._stage.live.newest
            hit = self._first_hit(ray, newest)
        return Pointer(ray, hit, np.array(look.axes), self._plane)

    def met_mm(self, look: Look) -> Float64 | None:
        """Where a look meets the heart, LPS mm, shape (3,); None where it does not."""
        direction = np.array(look.direction)
        ray = Ray(np.array(look.start_mm), direction / np.linalg.norm(direction))
        hit = self._first_hit(ray, self._stage.live.newest)
        return None if hit is None else hit.point_mm

    def cut_open(self, plane: Plane | None) -> None:
        """Point at nothing beyond a plane; at everything where there is none."""
        if plane is None:
            self._plane = None
            return
        normal = np.array(plane.normal) / np.linalg.norm(plane.normal)
        self._plane = CutPlane(normal, float(normal @ np.array(plane.point_mm)))

    def _first_hit(self, ray: Ray, newest: LiveFrame) -> Hit | None:
        # pages place the surface themselves: it is worked out here only where somebody points at it
        surface = deform(newest.frame.model, newest.surface, newest.frame.state.displacement)
        shown = self._shown_triangles(newest)
        if self._plane is None:
            return first_hit(ray, surface.vertices_mm, shown)
        every = newest.surface.triangles
        hit = first_hit_beside(ray, surface.vertices_mm, shown, self._plane, closed=every)
        if hit is None or hit.triangle >= 0 or not self.hidden:
            return hit
        # a wall that is hidden is not seen where it is cut either
        model = newest.frame.model
        cell = nearest_cell(model, newest.frame.state.displacement, hit.point_mm)
        if int(self._stage.cell_labels.of(model)[cell]) not in self.hidden:
            return hit
        return first_hit(replace(ray, start_mm=hit.point_mm), surface.vertices_mm, shown)

    def figures(self, newest: LiveFrame) -> str | None:
        """The message with the newest figures, where they are wanted and it was not sent yet; a moment is passed on."""
        if not self.wants_figures:
            self._figures = None
            return None
        self._stage.figures.ask(newest)
        message = self._stage.figures.message(newest)
        if message == self._figures:
            return None
        self._figures = message
        return message

    def messages(self, newest: LiveFrame) -> list[bytes]:
        """What is to be sent to show a moment; nothing where the page is busy, or has it already.

        Parameters
        ----------
        newest
            The moment.
        """
        if self._frame - self._taken >= IN_FLIGHT_MAX:
            return []
        stretch = self._stage.stretch(newest) if self.wants_strain else None
        is_new_stretch = stretch is not None and (self._stretch is None or not np.array_equal(stretch, self._stretch))
        if newest is self._shown and not is_new_stretch:
            return self._new_coarse(newest)
        found = []
        if newest.surface is not self._surface or newest.frame.model is not self._model:
            self._topology += 1
            structures = self._stage.structures.of(newest)
            labels = self._stage.cell_labels.of(newest.frame.model)
            found.append(topology_message(self._topology, newest, structures, self._stage.normal_map, labels))
            if self._model is None or newest.frame.model.node_count != self._model.node_count:
                self._sent = None
            self._surface, self._model = newest.surface, newest.frame.model
        found += self._new_coarse(newest)
        scale = {} if self._sent is None else {"scale": self._sent.scale}
        rounded = Rounded.of(newest.frame.state.displacement, **scale)
        now = time.monotonic()
        if not found and not is_new_stretch and now - self._shown_s < _STILL_S and self._is_still(newest, rounded):
            return []
        more = dict(patch_arrays(newest))
        if is_new_stretch:
            more["stretch"] = stretch
            self._stretch = stretch
        self._frame += 1
        hand = self._stage.device
        device = None if hand is None else hand.shown
        header: dict[str, Any] = {"device": None if device is None else _told_device(device)}
        if newest.marks is not self._marks:
            self._marks = header["marks"] = newest.marks
        if newest.branches is not self._branches:
            self._branches = newest.branches
            step_s = self._stage.live.session.simulation.step_s
            header["branches"] = [_told_branch(one, step_s) for one in newest.branches]
        header["can_hold_open"] = bool(newest.cuts) and not is_held_open(newest)
        header |= {"frame": self._frame, "topology": self._topology} | described(newest)
        found.append(frame_message(header, rounded, self._sent, more))
        self._sent, self._shown, self._shown_s = rounded, newest, now
        return found

    def _new_coarse(self, newest: LiveFrame) -> list[bytes]:
        """Coarser levels of what the page shows, where it wants them, has them not, and they are there."""
        if not self.wants_coarser or self._coarse_topology == self._topology:
            return []
        coarser = self._stage.coarser(newest)
        if coarser:
            self._coarse_topology = self._topology
        return [coarse_message(self._topology, one) for one in coarser]

    def _is_still(self, newest: LiveFrame, rounded: Rounded) -> bool:
        """Whether nothing but the time is new."""
        shown, sent = self._shown, self._sent
        device = self._stage.device
        if device is not None and device.shown is not None:
            return False
        if shown is None or sent is None or newest.mode != "running" or newest.frame.instruments:
            return False
        if newest.frame.stitches or newest.frame.patches or shown.frame.instruments:
            return False
        is_same = all(
            getattr(newest, name) == getattr(shown, name)
            for name in ("mode", "recording", "act_count", "ahead_s", "branches")
        )
        is_same = is_same and newest.frame.coming_cuts == shown.frame.coming_cuts
        return is_same and rounded.scale == sent.scale and np.array_equal(rounded.steps, sent.steps)

    def _shown_triangles(self, newest: LiveFrame) -> Int32:
        """Corners of the triangles that can be pointed at."""
        known = self._pickable
        if known is not None and known[0] is newest.surface and known[1] == self.hidden:
            return known[2]
        triangles = newest.surface.triangles
        if self.hidden:
            triangles = triangles[~np.isin(self._stage.structures.of(newest), list(self.hidden))]
        self._pickable = newest.surface, self.hidden, triangles
        return triangles


def _told_device(device: ShownDevice) -> dict[str, Any]:
    return {
        "position_mm": device.position_mm.tolist(),
        "force_n": device.force_n.tolist(),
        "part": device.part,
        "holds": device.holds,
    }


def _told_branch(branch: Branch, step_s: float) -> dict[str, Any]:
    marks = [MARKED[kind] for kind in branch.acts if kind in MARKED]
    return {
        "number": branch.number,
        "start_s": branch.start_step * step_s,
        "end_s": branch.end_step * step_s,
        "marks": {kind: marks.count(kind) for kind in sorted(set(marks))},
    }


def described(live: LiveFrame) -> dict[str, Any]:
    """What a page is told of a moment beside where the nodes are: time, instruments, stitches, patches."""
    frame = live.frame
    return {
        "step": frame.step,
        "time_s": frame.time_s,
        "end_s": frame.time_s + live.ahead_s,
        "mode": live.mode,
        "pace": live.real_time_factor,
        "cutting": frame.coming_cuts,
        "recording": live.recording,
        "act_count": live.act_count,
        "cut_count": len(live.cuts),
        "instruments": [
            {
                "name": name,
                "kind": one.kind,
                "center_mm": one.center_mm.tolist(),
                "force_n": one.force_n.tolist(),
                "axes_mm": live.probes[name].T.tolist() if name in live.probes else None,
            }
            for name, one in frame.instruments.items()
        ],
        "stitches": [
            {
                "name": name,
                "places_mm": one.places_mm.tolist(),
                "force_n": one.force_n,
                "drawn_n": one.drawn_n,
                "tied": one.is_tied,
            }
            for name, one in frame.stitches.items()
        ],
        "patches": [
            {
                "name": name,
                "force_n": float(np.max(one.forces_n, initial=0.0)),
                "stitch_count": len(one.forces_n),
                "area_mm2": one.area_mm2,
            }
            for name, one in frame.patches.items()
        ],
    }


def patch_arrays(live: LiveFrame) -> list[tuple[str, Any]]:
    """Vertices, normals and triangles of each patch."""
    found: list[tuple[str, Any]] = []
    for number, patch in enumerate(live.frame.patches.values()):
        found.append((f"patch {number} vertices", patch.vertices_mm.astype(np.float32)))
        found.append((f"patch {number} normals", patch.normals.astype(np.float32)))
        found.append((f"patch {number} triangles", patch.triangles.astype(np.uint32)))
    return found
