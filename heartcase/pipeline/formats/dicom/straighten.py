"""Filling missing slices, and straightening the slices of a tilted gantry: only when told to."""

from __future__ import annotations

import math

import numpy as np

from heartcase.pipeline.formats.dicom.stack import Stack
from heartcase.schemas.arrays import Float32, Float64, Int64

__all__ = ["straight_shape", "straightened", "with_missing"]


WHOLE = 1e-6
"""Part of a pixel that counts as none: rounded digits in headers."""


def _shifts(stack: Stack) -> tuple[Float64, Int64]:
    """How far each slice lies from the first in pixels, shape (n, 2), and the lowest and highest, rounded outwards.

    Both are (along columns, along rows), as the axes of an array.
    """
    columns_and_rows = stack.lean_mm[:, ::-1]
    spacing = np.array([np.linalg.norm(stack.affine[:3, 1]), np.linalg.norm(stack.affine[:3, 0])])
    shifts = columns_and_rows / spacing
    ends = np.array([np.floor(shifts.min(axis=0) + WHOLE), np.ceil(shifts.max(axis=0) - WHOLE)])
    return shifts, ends.astype(np.int64)


def straight_shape(stack: Stack) -> tuple[int, int, int]:
    """Shape [z, y, x] of the volume of a stack, after it is straightened and filled."""
    rows, columns = stack.slices[0].shape
    if stack.tilt_degrees == 0.0:
        return stack.places[-1] + 1, rows, columns
    _, (low, high) = _shifts(stack)
    return stack.places[-1] + 1, rows + int(high[0] - low[0]), columns + int(high[1] - low[1])


def straightened(values: Float32, stack: Stack) -> tuple[Float32, Float64]:
    """Resample the slices of a leaning stack onto pixels that lie above each other.

    Linear interpolation within each slice, whose plane and spacing stay as they are: the error is at most
    (a^2 |f_aa| + b^2 |f_bb|) / 8 for pixels of a x b and second derivatives f_aa, f_bb of the field.

    Parameters
    ----------
    values
        Values of the slices of ``stack``, shape (n, rows, columns).
    stack
        Where they lie.

    Returns
    -------
    values
        Shape (n, rows, columns), as many rows and columns as cover all slices; the lowest value where there was none.
    affine
        Map from index (i, j, k, 1) to LPS mm, shape (4, 4), at right angles.
    """
    if stack.tilt_degrees == 0.0:
        return values, stack.affine
    shifts, (low, _) = _shifts(stack)
    result = np.full((len(values), *straight_shape(stack)[1:]), values.min(), dtype=np.float32)
    for number, shift in enumerate(shifts - low):
        # A pixel p of the result lies at p - shift of the slice: between first and first + 1, at 1 - part.
        whole = [math.ceil(s - WHOLE) for s in shift]
        parts = [max(0.0, w - s) for w, s in zip(whole, shift, strict=True)]
        parts = [0.0 if part < WHOLE else part for part in parts]
        plane = values[number].astype(np.float64)
        if parts[0]:
            plane = (1.0 - parts[0]) * plane[:-1] + parts[0] * plane[1:]
        if parts[1]:
            plane = (1.0 - parts[1]) * plane[:, :-1] + parts[1] * plane[:, 1:]
        result[number, whole[0] : whole[0] + plane.shape[0], whole[1] : whole[1] + plane.shape[1]] = plane
    affine = stack.affine.copy()
    affine[:3, 3] += affine[:3, 0] * low[1] + affine[:3, 1] * low[0]
    return result, affine


def with_missing(values: Float32, stack: Stack) -> Float32:
    """Put missing slices between their neighbours, by linear interpolation at their exact places.

    Parameters
    ----------
    values
        Values of the slices of ``stack``, straightened, shape (n, rows, columns).
    stack
        Which places they have.

    Returns
    -------
    ndarray
        Values, float32, shape (n + missing, rows, columns).
    """
    if not stack.missing:
        return values
    result = np.empty((stack.places[-1] + 1, *values.shape[1:]), dtype=np.float32)
    result[list(stack.places)] = values
    for place in stack.missing:
        after = int(np.searchsorted(stack.places, place))
        below, above = stack.places[after - 1], stack.places[after]
        part = (place - below) / (above - below)
        result[place] = (1.0 - part) * values[after - 1].astype(np.float64) + part * values[after]
    return result
