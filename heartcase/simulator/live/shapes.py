"""What a window shows of a frame, as arrays: triangles with colours and the slice of the scan. Nothing is drawn."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from heartcase.schemas.arrays import Bool, Float64, Int32, UInt8
from heartcase.schemas.bundle.format import CaseManifest
from heartcase.simulator.incisions.strain import values_at_vertices, vertex_colours
from heartcase.simulator.lattice.model import LatticeModel
from heartcase.simulator.live.live_frame import LiveFrame
from heartcase.simulator.load import ScanVolume

__all__ = [
    "CUT_FACES",
    "STRETCH_SHOWN",
    "Structure",
    "Structures",
    "grey_range",
    "slice_corners_mm",
    "slice_greys",
    "stretch_colours",
    "structures_after_cuts",
]

CUT_FACES = 256
"""Number of the structure that walls of incisions are."""
_CUT_COLOUR = (150, 40, 45)
STRETCH_SHOWN = (1.0, 1.6)
"""Stretch of the first and of the last colour."""


@dataclass(frozen=True)
class Structure:
    """Something that is shown or hidden as a whole."""

    number: int
    """Its label, or CUT_FACES."""
    name: str
    """What it is called."""
    colour: tuple[int, int, int]
    """Red, green, blue."""


class Structures:
    """The structures of a case's surface, and which of them are hidden.

    Parameters
    ----------
    manifest
        What the case says of itself: names and colours.
    of_triangles
        Label of each triangle of the uncut surface, shape (triangle_count,).
    """

    def __init__(self, manifest: CaseManifest, of_triangles: UInt8) -> None:
        there = set(np.unique(of_triangles).tolist())
        found = [
            Structure(label.value, label.name, tuple(int(label.colour[at : at + 2], 16) for at in (1, 3, 5)))  # type: ignore[arg-type]
            for label in manifest.labels
            if label.value in there
        ]
        self.all: tuple[Structure, ...] = (*found, Structure(CUT_FACES, "cut faces", _CUT_COLOUR))
        self.hidden: set[int] = set()
        self._of_triangles = of_triangles.astype(np.int32)
        self._palette = np.zeros((CUT_FACES + 1, 3), np.uint8)
        for structure in self.all:
            self._palette[structure.number] = structure.colour

    def toggle(self, number: int) -> None:
        """Show a structure that is hidden, or hide it."""
        self.hidden ^= {number}

    def of(self, live: LiveFrame) -> Int32:
        """Structure of each triangle now, shape (triangle_count,)."""
        if live.triangle_origin is None:
            return self._of_triangles
        return structures_after_cuts(self._of_triangles, live.triangle_origin)

    def is_shown(self, numbers: Int32) -> Bool:
        """Whether each of some triangles' structures is shown, shape (triangle_count,)."""
        shown: Bool = ~np.isin(numbers, list(self.hidden))
        return shown

    def colours(self, numbers: Int32) -> UInt8:
        """Red, green, blue of each of some triangles' structures, shape (triangle_count, 3)."""
        return self._palette[numbers]


def structures_after_cuts(uncut: Int32, triangle_origin: Int32) -> Int32:
    """Structure of each triangle of a surface that was cut, shape (triangle_count,).

    Parameters
    ----------
    uncut
        That of each triangle of the uncut surface, shape (uncut_triangle_count,).
    triangle_origin
        Triangle of the uncut surface that each is a part of, -1 for cut faces, shape (triangle_count,).
    """
    carried = uncut[triangle_origin]
    carried[triangle_origin < 0] = CUT_FACES
    return carried


def stretch_colours(live: LiveFrame, known: tuple[LatticeModel, Float64] | None) -> UInt8 | None:
    """Colours of the vertices by how far the tissue there is stretched, shape (vertex_count, 3).

    None where what is known is of another lattice, such as that before a cut.
    """
    if known is None or known[0] is not live.frame.model:
        return None
    surface = live.surface
    return vertex_colours(values_at_vertices(surface.triangle_nodes, surface.weights, known[1]), *STRETCH_SHOWN)


def grey_range(scan: ScanVolume) -> tuple[float, float]:
    """Intensities that are black and white: what one and 99 of 100 voxels stay below."""
    low, high = np.percentile(scan.stored[::4, ::4, ::4], [1.0, 99.0])
    low, high = (float(value) * scan.values.slope + scan.values.intercept for value in (low, high))
    return low, max(high, low + scan.values.slope)


def slice_greys(scan: ScanVolume, index: int, between: tuple[float, float]) -> UInt8:
    """Grey of each voxel of a slice along k, i fastest, shape (size_j * size_i,)."""
    low, high = between
    grey: UInt8 = np.rint(255.0 * np.clip((scan.slice_at(index) - low) / (high - low), 0.0, 1.0)).astype(np.uint8)
    return grey.ravel()


def slice_corners_mm(scan: ScanVolume, index: int) -> Float64:
    """Corners of the voxels of a slice, in the plane of their centres, i fastest, LPS mm, ((nj + 1) (ni + 1), 3)."""
    ni, nj, _ = scan.geometry.size
    j, i = np.meshgrid(np.arange(nj + 1) - 0.5, np.arange(ni + 1) - 0.5, indexing="ij")
    return scan.geometry.index_to_world(np.stack([i.ravel(), j.ravel(), np.full(i.size, float(index))], axis=1))
