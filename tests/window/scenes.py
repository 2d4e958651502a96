"""A small case on disk, a live session on it, and a window without a screen, for the tests."""

from __future__ import annotations

import os
import threading
import time
from contextlib import contextmanager

import numpy as np

from heartcase.pipeline.bundle.write_bundle import write_bundle
from heartcase.simulator.load import load_case
from heartcase.simulator.session.operating_session import OperatingSession
from heartcase.simulator.simulation import Simulation
from heartcase.window.live import Live
from tests.factories import block_case

SIZE = (480, 360)


def write_case(folder, **options):
    """A block of 8 x 5 x 4 cells of 3 mm on a fixed base, at 10, -20, 30 mm."""
    path = folder / "block.case"
    write_bundle(path, block_case(size=(8, 5, 4), **options))
    return path


def load(path, *more):
    return load_case(path, needs=("surface", "structures", "tissue", *more))


def live_on(case):
    simulation = Simulation(case.model, surface=case.surface, tissue=case.tissue, damping_per_s=30.0)
    return Live(OperatingSession(simulation), manifest=case.manifest)


def until(condition, *, seconds=60.0):
    """Wait for something that a thread does."""
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "it did not come to that"
        time.sleep(0.005)


def threads():
    """Threads that run, but those in which a simulation works out cuts: they wait for the next, and end with it."""
    return sorted(one.name for one in threading.enumerate() if not one.name.startswith("heartcase-cuts"))


def bytes_of(simulation):
    return simulation.model.node_count, simulation.state.displacement.tobytes(), simulation.state.velocity.tobytes()


@contextmanager
def off_screen_window(case, live, **options):
    """A window that is drawn without a screen, seen from above: x to the right, y up."""
    from heartcase.window.window import HeartWindow

    os.environ.setdefault("VTK_DEFAULT_OPENGL_WINDOW", "vtkEGLRenderWindow")
    window = HeartWindow(case, live, size=SIZE, off_screen=True, **options)
    try:
        middle = (case.surface.rest_mm.min(axis=0) + case.surface.rest_mm.max(axis=0)) / 2.0
        camera = window.plotter.camera
        camera.focal_point, camera.position = tuple(middle), tuple(middle + np.array([0.0, 0.0, 80.0]))
        camera.up = (0.0, 1.0, 0.0)
        yield window
    finally:
        window.close()


class Mouse:
    """A mouse and a keyboard that send events as a window system does."""

    def __init__(self, window):
        self.window = window
        self.interactor = window.plotter.iren.interactor

    def pixel(self, place_mm):
        """Where a place is seen, by VTK's own projection."""
        renderer = self.window.plotter.renderer
        renderer.SetWorldPoint(*place_mm, 1.0)
        renderer.WorldToDisplay()
        x, y, _ = renderer.GetDisplayPoint()
        return round(x), round(y)

    def send(self, event, place_mm, *, shift=False):
        x, y = self.pixel(place_mm) if len(place_mm) == 3 else place_mm
        self.interactor.SetEventInformation(x, y, 0, int(shift), "\0", 0, None)
        self.interactor.InvokeEvent(event)

    def press(self, place_mm, **options):
        self.send("LeftButtonPressEvent", place_mm, **options)

    def move(self, place_mm):
        self.send("MouseMoveEvent", place_mm)

    def release(self, place_mm):
        self.send("LeftButtonReleaseEvent", place_mm)

    def drag(self, *places_mm):
        """Press at the first, move along all, release at the last."""
        self.press(places_mm[0])
        for place in places_mm[1:]:
            self.move(place)
        self.release(places_mm[-1])

    def wheel(self, notches):
        name = "MouseWheelForwardEvent" if notches > 0 else "MouseWheelBackwardEvent"
        for _ in range(abs(notches)):
            self.interactor.InvokeEvent(name)

    def key(self, name):
        self.interactor.SetKeySym(name)
        self.interactor.InvokeEvent("KeyPressEvent")
        self.interactor.InvokeEvent("CharEvent")
