"""A window without a screen, for the tests."""

from __future__ import annotations

import os
from contextlib import contextmanager

import numpy as np

SIZE = (480, 360)


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
