"""Stub to be filled."""
from __future__ import annotations
from typing import NamedTuple
import numpy as np
class SheetArcs(NamedTuple):
    pairs: object
    ends: object
    weights: object
    corners: object
def cross_sheets(mesh):
    return SheetArcs(np.zeros((0, 2), np.int64), np.zeros((0, 2), np.int64), np.zeros((0, 2, 2, 3)), np.full((0, 2), -1))
def cross_points(surface, mesh, crossed, arcs, surface_arc_count, first_node):
    return arcs, 0
