"""What the axes of a case mean, and the way to the axes of other programs, written into every manifest as data.

A mirrored heart is another diagnosis, so nothing here is left to a reader's guess: every frame says which way its axes
point in the patient, and the sign of its determinant.
"""

from __future__ import annotations

from typing import Literal

from heartcase.schemas.base import Model, Vector3

__all__ = ["WAYS", "Coordinates", "Frame", "Way"]

Way = Literal["left", "right", "front", "back", "head", "feet"]
"""A way in the patient."""
WAYS: tuple[tuple[Way, Way], ...] = (("right", "left"), ("front", "back"), ("feet", "head"))
"""Where each axis of LPS comes from, and where it leads to."""


class Frame(Model):
    """Axes of another program."""

    name: str
    """``gltf``, ``unity`` or ``unreal``."""
    from_lps_mm: tuple[Vector3, Vector3, Vector3]
    """Rows of the matrix from LPS mm to this frame: point = matrix times (x, y, z)."""
    unit: Literal["m", "cm"]
    """Unit of length."""
    axes: tuple[Way, Way, Way]
    """The way that +X, +Y and +Z point in the patient."""
    handedness: Literal["right", "left"]
    """Handedness of the program's axes. Where it is left, the w of every tangent changes its sign."""
    determinant_sign: Literal[-1, 1]
    """Sign of the matrix's determinant: -1 turns the sign of cross products and signed volumes, not the heart."""
    reverse_triangles: bool
    """Whether the program takes triangles that are clockwise on the screen for front faces."""


class Coordinates(Model):
    """Conventions of every number in a case. They are part of the format: no case may state others."""

    space: Literal["patient LPS"] = "patient LPS"
    """World space."""
    unit: Literal["mm"] = "mm"
    """Unit of length."""
    axes: tuple[Way, Way, Way] = ("left", "back", "head")
    """The way that +x, +y and +z point in the patient."""
    handedness: Literal["right"] = "right"
    """x, y, z are right-handed; so are i, j, k of the grid."""
    index_order: Literal["cells and nodes by k, then j, then i; volumes [k][j][i]; points (x, y, z)"] = (
        "cells and nodes by k, then j, then i; volumes [k][j][i]; points (x, y, z)"
    )
    """How indices run."""
    winding: Literal["counter-clockwise from outside the tissue"] = "counter-clockwise from outside the tissue"
    """How triangles turn."""
    frames: tuple[Frame, ...] = (
        Frame(
            name="gltf",
            from_lps_mm=((0.001, 0.0, 0.0), (0.0, 0.0, 0.001), (0.0, -0.001, 0.0)),
            unit="m",
            axes=("left", "head", "front"),
            handedness="right",
            determinant_sign=1,
            reverse_triangles=False,
        ),
        Frame(
            name="unity",
            from_lps_mm=((0.001, 0.0, 0.0), (0.0, 0.0, 0.001), (0.0, 0.001, 0.0)),
            unit="m",
            axes=("left", "head", "back"),
            handedness="left",
            determinant_sign=-1,
            reverse_triangles=True,
        ),
        Frame(
            name="unreal",
            from_lps_mm=((0.0, 0.1, 0.0), (0.1, 0.0, 0.0), (0.0, 0.0, 0.1)),
            unit="cm",
            axes=("back", "left", "head"),
            handedness="left",
            determinant_sign=-1,
            reverse_triangles=False,
        ),
    )
    """The way to other programs' axes. In all of them the patient faces a viewer who looks along the default view."""
