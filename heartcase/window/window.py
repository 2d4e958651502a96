"""The window: mouse and keys in, commands to a live session out, and what came of them drawn. PyVista and VTK do it."""

from __future__ import annotations

import os
import sys
import time
from collections import deque
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from heartcase.schemas.arrays import UInt8
from heartcase.schemas.errors import MissingExtraError, UsageError
from heartcase.schemas.recording.commands import Mark
from heartcase.simulator.live.hands import Hands
from heartcase.simulator.live.live import Live
from heartcase.simulator.live.rays import Eye, Pointer, first_hit
from heartcase.simulator.live.shapes import STRETCH_SHOWN, Structures
from heartcase.simulator.live.strain_worker import StrainWorker
from heartcase.simulator.live.tool import Tool
from heartcase.simulator.load import Case
from heartcase.window.keys import KEYS, help_text
from heartcase.window.scene import Scene

__all__ = ["HeartWindow", "require_display"]

_MESSAGE_S = 8.0
"""How long a message stands, s."""
_LOOK_S = 1.0 / 60.0
"""How often the window looks for the mouse at most, s."""
_NO_SCREEN = (
    "there is no screen here that a window can be shown on ({}): run it on a machine with one, "
    "or look at pictures with  heartcase simulate --picture"
)
_WITHOUT_SCREEN = ("vtkEGLRenderWindow", "vtkOSOpenGLRenderWindow")
"""VTK's windows that are on no screen."""
_SOFTWARE = ("llvmpipe", "softpipe", "swr", "swiftshader", "microsoft basic render")
"""What renderers without a graphics card call themselves."""
_FROM_LEFT_FRONT = np.array([0.45, -1.0, 0.25])
"""From the heart to the eye at the start, LPS: front, somewhat left and above."""
_ACTIONS = {name: key.action for key in KEYS for name in key.keys}


def require_display() -> None:
    """Refuse where no window can be shown.

    Raises
    ------
    UsageError
        There is no screen.
    MissingExtraError
        What draws is not installed.
    """
    try:
        import pyvista  # noqa: F401
    except ImportError:
        raise MissingExtraError("The window", "prepare") from None
    if sys.platform == "linux" and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        raise UsageError(_NO_SCREEN.format("DISPLAY is not set"))


class HeartWindow:
    """A window on a live session.

    Parameters
    ----------
    case
        The case, loaded with surface and structures, and with its scan where it holds one.
    live
        The session; the window asks of it, and shows its newest frame. It is closed with the window.
    size
        Width and height in pixels.
    off_screen
        Whether it is drawn without a screen: for pictures and tests.
    record_folder
        Where recordings are put.
    """

    def __init__(
        self,
        case: Case,
        live: Live,
        *,
        size: tuple[int, int] = (1280, 900),
        off_screen: bool = False,
        record_folder: Path | None = None,
    ) -> None:
        import pyvista

        assert case.surface is not None
        assert case.triangle_structures is not None
        self.live = live
        self.is_open = True
        self.hands = Hands(live)
        self._folder = Path() if record_folder is None else record_folder
        self._name = case.manifest.name
        self._failure: BaseException | None = None
        self._is_dirty = True
        self._shows_help = self._shows_strain = False
        self._strain: StrainWorker | None = None
        self._message, self._message_until = "H: help", np.inf
        self._frames: deque[float] = deque(maxlen=20)
        self._drawn: Any = None
        self.plotter = pyvista.Plotter(off_screen=off_screen, window_size=list(size), title=f"heartcase: {self._name}")
        self.plotter.set_background("white")
        self.scene = Scene(self.plotter, Structures(case.manifest, case.triangle_structures), case.scan)
        self._rest_mm = case.surface.rest_mm
        self._listen()
        self._reset_view()

    def run(self) -> None:
        """Show the window until it is closed.

        Raises
        ------
        UsageError
            There is no screen that can be reached.
        BaseException
            What ended the session's thread, if something did.
        """
        # Not by PyVista's show, which would put its own interaction in place of this one.
        try:
            self.plotter.render_window.SetWindowName(self.plotter.title)
            self.draw()
            if type(self.plotter.render_window).__name__ in _WITHOUT_SCREEN and not self.plotter.off_screen:
                # VTK draws on without a screen where the display named cannot be reached, and breaks down at events.
                raise UsageError(_NO_SCREEN.format("the display that DISPLAY names cannot be reached"))
            self._interactor.Initialize()
            if self.is_drawn_in_software:
                self.live.spare_a_processor()
                self.plotter.disable_anti_aliasing()
            if self.plotter.off_screen:
                while self.is_open:
                    self._look()
                    time.sleep(_LOOK_S)
            else:
                self._interactor.AddObserver("TimerEvent", self._look)
                self._interactor.CreateRepeatingTimer(round(1e3 * _LOOK_S))
                self._interactor.Start()
        finally:
            self.close()
        if self._failure is not None:
            raise self._failure

    @property
    def tool(self) -> Tool | None:
        """The tool in hand."""
        return self.hands.tool

    @property
    def is_drawn_in_software(self) -> bool:
        """Whether the processor draws, as there is no graphics card that does."""
        told = self.plotter.render_window.ReportCapabilities().lower()
        return any(name in told for name in _SOFTWARE)

    def draw(self) -> None:
        """Show the newest frame, if anything is new.

        Raises
        ------
        BaseException
            What ended the session's thread, if something did.
        """
        if self.live.error is not None:
            raise self.live.error
        newest = self.live.newest
        for said in self.live.take_messages():
            self._say(str(said))
        if newest is self._drawn and not self._is_dirty and time.perf_counter() < self._message_until:
            return
        if self._strain is not None and newest is not self._drawn:
            self._strain.ask(newest.frame)
        stretch = None if self._strain is None else self._strain.newest
        line = np.zeros((0, 3)) if self.tool is None else self.tool.line_mm
        self.scene.draw(newest, stretch=stretch, line_mm=line)
        self._drawn, self._is_dirty = newest, False
        self._frames.append(time.perf_counter())
        self._write()
        # PyVista's own render does nothing before its show was called.
        self.plotter.render_window.Render()

    def picture(self) -> UInt8:
        """What is seen now, shape (height, width, 3)."""
        self._is_dirty = True
        self.draw()
        shown: UInt8 = np.ascontiguousarray(self.plotter.screenshot(return_img=True)[..., :3])
        return shown

    def close(self) -> None:
        """Close the window and end the session's thread; a recording is finished. A second time does nothing."""
        self.is_open = False
        self.live.close()
        if self._strain is not None:
            self._strain.close()
            self._strain = None
        self.plotter.close()

    def act(self, action: str) -> None:
        """Do what a key of :data:`heartcase.window.keys.KEYS` says, such as ``take_tool:g``."""
        name, _, what = action.partition(":")
        getattr(self, f"_{name}")(*([what] if what else []))
        self._is_dirty = True

    def pointer(self, x: float, y: float) -> Pointer:
        """Where a place of the window points to; pixels from the lower left corner, right and up."""
        camera = self.plotter.camera
        scale = camera.parallel_scale if camera.parallel_projection else None
        position, focal, up = (np.array(at, dtype=float) for at in (camera.position, camera.focal_point, camera.up))
        eye = Eye(position, focal, up, camera.view_angle, scale)
        ray = eye.ray(x, y, tuple(self.plotter.window_size))
        newest = self.live.newest
        assert newest.frame.surface is not None
        triangles = newest.surface.triangles
        pickable = self.scene.pickable
        # Between a cut and the next picture the triangles are others: all of them can be pointed at.
        if self._drawn is None or self._drawn.surface is not newest.surface:
            pickable = np.arange(len(triangles), dtype=np.int32)
        return Pointer(ray, first_hit(ray, newest.frame.surface.vertices_mm, triangles[pickable]), eye.axes)

    def _look(self, *_: Any) -> None:
        """What is done again and again while the window is shown."""
        self._guarded(self.draw)

    def _guarded(self, does: Callable[..., None], *given: Any) -> None:
        """Do something for VTK, which would swallow what is raised, Ctrl-C too: it ends the window instead."""
        if not self.is_open:
            return
        try:
            does(*given)
        except BaseException as error:
            self._failure = error
            self._leave()

    def _listen(self) -> None:
        from vtkmodules.vtkInteractionStyle import vtkInteractorStyleTrackballCamera

        interactor = self.plotter.iren.interactor
        self.plotter.iren.clear_key_event_callbacks()
        style = vtkInteractorStyleTrackballCamera()
        style.SetDefaultRenderer(self.plotter.renderer)
        for event, does in {
            "LeftButtonPressEvent": self._left_pressed,
            "LeftButtonReleaseEvent": self._left_released,
            "MouseMoveEvent": self._moved,
            "RightButtonPressEvent": self._right_pressed,
            "RightButtonReleaseEvent": self._right_released,
            "MouseWheelForwardEvent": lambda *_: self._wheeled(1),
            "MouseWheelBackwardEvent": lambda *_: self._wheeled(-1),
            "KeyPressEvent": self._key_pressed,
            "CharEvent": lambda *_: None,
        }.items():
            style.AddObserver(event, partial(self._guarded, does))
        interactor.SetInteractorStyle(style)
        interactor.AddObserver("ExitEvent", self._leave)
        self._style, self._interactor = style, interactor

    def _place(self) -> tuple[int, int]:
        x, y = self._interactor.GetEventPosition()
        return x, y

    def _left_pressed(self, *_: Any) -> None:
        x, y = self._place()
        width, height = self.plotter.window_size
        listed = self.scene.listed(x / width, y / height)
        if listed is not None:
            self.scene.structures.toggle(listed)
            self.scene.hidden_changed()
            self._is_dirty = True
            return
        uses_tool = self.tool is not None and not self._interactor.GetShiftKey()
        if uses_tool and self.hands.press(self.pointer(x, y)):
            self._is_dirty = True
            return
        self._style.OnLeftButtonDown()

    def _left_released(self, *_: Any) -> None:
        if self.hands.is_used and self.hands.release(self.pointer(*self._place())):
            self._is_dirty = True
            return
        self._style.OnLeftButtonUp()

    def _moved(self, *_: Any) -> None:
        if not self.hands.is_used or not self.hands.drag(self.pointer(*self._place())):
            self._style.OnMouseMove()
        self._is_dirty = True

    def _right_pressed(self, *_: Any) -> None:
        self._style.FindPokedRenderer(*self._place())
        self._style.StartRotate()

    def _right_released(self, *_: Any) -> None:
        self._style.EndRotate()

    def _wheeled(self, notches: int) -> None:
        if not self.hands.wheel(notches):
            if notches > 0:
                self._style.OnMouseWheelForward()
            else:
                self._style.OnMouseWheelBackward()
        self._is_dirty = True

    def _key_pressed(self, *_: Any) -> None:
        action = _ACTIONS.get(self._interactor.GetKeySym() or "")
        if action is not None:
            self.act(action)

    def _take_tool(self, key: str = "") -> None:
        self._put_down()
        self.hands.take(key)

    def _put_down(self) -> None:
        self.hands.put_down(self.pointer(*self._place()) if self.hands.is_used else None)

    def _resize(self, steps: str) -> None:
        self.hands.resize(int(steps))

    def _let_go(self) -> None:
        if not self.hands.let_go(self.pointer(*self._place())):
            self._say("nothing is held")

    def _tie(self) -> None:
        self.hands.tie()

    def _undo(self) -> None:
        self.hands.undo()

    def _redo(self) -> None:
        self.hands.redo()

    def _rewind(self) -> None:
        self.hands.rewind()

    def _play(self) -> None:
        self.hands.play()

    def _pause(self) -> None:
        self.live.pause(self.live.newest.mode != "paused")

    def _mark(self) -> None:
        name = self.hands.new_name("mark")
        self.live.do(Mark(name=name))
        self._say(f"this moment is {name}")

    def _record(self) -> None:
        if self.live.newest.recording is not None:
            self.live.stop_recording()
            return
        for number in range(1, 10_000):
            path = self._folder / f"{self._name}-{number}.recording"
            if not path.exists():
                self.live.record(path)
                return

    def _show_strain(self) -> None:
        self._shows_strain = not self._shows_strain
        if self._shows_strain:
            self._strain = StrainWorker()
            self._strain.ask(self.live.newest.frame)
        elif self._strain is not None:
            self._strain.close()
            self._strain = None

    def _show_slice(self) -> None:
        scan = self.scene.scan
        if scan is None:
            self._say('this case holds no scan: name "scan" under parts in its recipe, and build it again')
        elif self.scene.slice_index is None:
            self.scene.show_slice(scan.geometry.size[2] // 2)
        else:
            self.scene.show_slice(None)

    def _move_slice(self, steps: str) -> None:
        if self.scene.slice_index is not None:
            self.scene.show_slice(self.scene.slice_index + int(steps))

    def _show_all(self) -> None:
        self.scene.structures.hidden.clear()
        self.scene.hidden_changed()

    def _reset_view(self) -> None:
        low, high = self._rest_mm.min(axis=0).astype(float), self._rest_mm.max(axis=0).astype(float)
        middle, size = (low + high) / 2.0, float(np.linalg.norm(high - low))
        camera = self.plotter.camera
        camera.focal_point = tuple(middle)
        camera.position = tuple(middle + 1.6 * size * _FROM_LEFT_FRONT / np.linalg.norm(_FROM_LEFT_FRONT))
        camera.up = (0.0, 0.0, 1.0)
        camera.clipping_range = (0.05 * size, 8.0 * size)
        # PyVista looks at all that there is when it shows first, unless it is told that a place was chosen.
        self.plotter.renderer.camera_set = True

    def _show_help(self) -> None:
        self._shows_help = not self._shows_help

    def _leave(self, *_: Any) -> None:
        self.is_open = False
        self._interactor.TerminateApp()

    def _say(self, words: str) -> None:
        self._message, self._message_until = words, time.perf_counter() + _MESSAGE_S
        self._is_dirty = True

    def _write(self) -> None:
        """The texts of the window."""
        newest = self._drawn
        tool = "orbit" if self.tool is None else self.tool.title
        if self.tool is not None and self.tool.size_words:
            tool += f" ({self.tool.size_words.format(self.tool.size)})"
        pace = ""
        if newest.real_time_factor is not None:
            pace = f"  real time x {newest.real_time_factor:.2f} ({newest.steps_per_second:,.0f} steps/s)"
        if len(self._frames) > 1:
            pace += f"  {(len(self._frames) - 1) / max(self._frames[-1] - self._frames[0], 1e-9):.0f} pictures/s"
        ahead = f", {newest.ahead_s:.2f} s known ahead" if newest.ahead_s > 0.0 else ""
        ahead += "   cutting ..." if newest.frame.coming_cuts else ""
        recorded = "" if newest.recording is None else f"   recording: {newest.recording}"
        self.scene.text(
            "status",
            f"{tool}\n{newest.mode} at {newest.frame.time_s:.2f} s{ahead}{pace}{recorded}",
            place=(0.01, 0.985),
        )
        forces = [f"{name}: {np.linalg.norm(one.force_n):.2f} N" for name, one in newest.frame.instruments.items()]
        forces += [
            f"{name}: {one.force_n:.2f} N{'' if one.is_tied else ', not tied'}"
            for name, one in newest.frame.stitches.items()
        ]
        forces += [
            f"{name}: at most {np.max(one.forces_n, initial=0.0):.2f} N in a stitch of its rim"
            for name, one in newest.frame.patches.items()
        ]
        self.scene.text("forces", "\n".join(forces[:24]), place=(0.01, 0.92))
        if time.perf_counter() >= self._message_until:
            self._message, self._message_until = "", np.inf
        self.scene.text("message", self._message, place=(0.01, 0.05), colour="firebrick")
        low, high = STRETCH_SHOWN
        legend = f"stretched to {low:g} (blue) ... {high:g} (red) times its length" if self._shows_strain else ""
        self.scene.text("legend", legend, place=(0.01, 0.10))
        self.scene.text("notice", "Not a medical device", place=(0.77, 0.03), size=8, colour="grey")
        self.scene.text("help", help_text() if self._shows_help else "", place=(0.01, 0.86), size=9)
