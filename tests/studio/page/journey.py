"""Strokes for a whole heart, drawn by mouse: made from a volume of labels, in axial slices, as a person would."""

from __future__ import annotations

import numpy as np
from scipy import ndimage

from tests.studio.page.browsing import FRAMES

INNER_MM = 1.0
"""So far a stroke keeps from the border of what it marks, where there is so much room."""


def strokes_of(labels, values, geometry, *, per_label=3, background=6):
    """Strokes [(value, [start, end] in mm)], each in an axial slice, inside its structure; the background's last.

    Parameters
    ----------
    labels
        Label of each voxel, [z, y, x].
    values
        Labels that are marked.
    geometry
        Their lattice, whose axes run along the patient's.
    """
    spacing = np.array(geometry.spacing_mm)
    found = []
    for value in values:
        areas = (labels == value).sum(axis=(1, 2))
        slices = np.flatnonzero(areas)
        shares = (np.arange(per_label) + 0.5) / per_label
        for k in sorted({int(slices[int(share * len(slices))]) for share in shares}):
            line = _longest_line(labels[k] == value, spacing[1::-1])
            found.append((value, _mm(line, k, geometry)))
    slices = np.flatnonzero((labels != 0).any(axis=(1, 2)))
    for share in (np.arange(background) + 0.5) / background:
        k = int(slices[int(share * len(slices))])
        found.append((0, _mm(_ring(labels[k] != 0, spacing[1::-1]), k, geometry)))
    return found


def _ring(mask, spacing, *, away_mm=4.0):
    """A line all around what is in a slice: pixels (j, i)."""
    middle = np.argwhere(mask).mean(axis=0)
    size = np.array(mask.shape)
    line = []
    for angle in np.linspace(0.0, 2.0 * np.pi, 17):
        way = np.array([np.sin(angle), np.cos(angle)]) / spacing
        steps = middle + np.arange(0.0, 400.0, 0.5)[:, None] * way
        steps = steps[((steps >= 0) & (steps <= size - 1)).all(axis=1)]
        j, i = np.rint(steps).astype(int).T
        last = int(np.flatnonzero(mask[j, i]).max(initial=0) + away_mm / 0.5)
        line.append(np.clip(middle + 0.5 * last * way, 1.0, size - 2.0))
    return line


def _longest_line(mask, spacing):
    """Two voxels (j, i) of a slice: from the deepest along the longest way that stays well inside."""
    depth = ndimage.distance_transform_edt(np.pad(mask, 1), sampling=spacing)[1:-1, 1:-1]
    start = np.array(np.unravel_index(depth.argmax(), depth.shape))
    deep = np.argwhere(depth >= min(0.6 * depth.max(), INNER_MM + spacing.max()))
    away = np.linalg.norm((deep - start) * spacing, axis=1)
    for n in np.argsort(-away):
        way = start + np.linspace(0.0, 1.0, 40)[:, None] * (deep[n] - start)
        j, i = np.rint(way).astype(int).T
        if (depth[j, i] >= min(0.5 * depth.max(), INNER_MM)).all():
            return start, deep[n]
    return start, start


def _mm(line, k, geometry):
    return [geometry.index_to_world((i, j, k)) for j, i in line]


class Painter:
    """The mouse over the slices of a scan, all of which are seen."""

    def __init__(self, page, geometry):
        self.page, self.tab, self.geometry = page, page.tab, geometry

    def pixel(self, view, mm):
        """Where a position is seen, in the window's pixels."""
        right, down = np.array(FRAMES[view], float)
        left, top, width, height = self.page.box(view)
        steps = self.geometry.affine[:3, :3]
        size = np.array(self.geometry.size)
        extents = [(np.abs(axis @ steps) * size).sum() for axis in (right, down)]
        scale = max(extents[0] / width, extents[1] / height)
        off = np.asarray(mm) - self.geometry.index_to_world((size - 1) / 2.0)
        return left + width / 2 + off @ right / scale, top + height / 2 + off @ down / scale

    def look_at(self, mm):
        """Take the slices to a place, by the pointer."""
        before = self.tab.evaluate("() => document.body.dataset.tool")
        # a key would go into a field that has the focus
        self.tab.locator("#axial .surface").focus()
        self.tab.keyboard.press("v")
        for view in ("axial", "sagittal"):
            self.tab.mouse.click(*self.pixel(view, mm))
        if before == "shape":
            self.tab.keyboard.press("s")
        self.page.drawn()

    def stroke(self, key, points_mm):
        """A stroke of the structure that a key picks."""
        self.look_at(points_mm[0])
        self.tab.keyboard.press("b")
        self.tab.keyboard.press(key)
        self.tab.mouse.move(*self.pixel("axial", points_mm[0]))
        self.tab.mouse.down()
        for mm in points_mm[1:]:
            self.tab.mouse.move(*self.pixel("axial", mm), steps=4)
        self.tab.mouse.up()
