"""Thin vessels on a coarse lattice: lumens between its voxels, which would be lost or come out in pieces.

Of a lumen that is thinner than a coarse voxel or two, every n-th voxel hits some parts only, or none. Each coarse voxel
of background that it passes through is given its label instead, so that a vessel in one piece stays in one piece: steps
through faces of voxels are steps through faces of coarse voxels, or none. It is up to a coarse voxel thicker then.
"""

from __future__ import annotations

import numpy as np

from heartcase.compiling.calls import copied
from heartcase.compiling.kernel import kernel
from heartcase.pipeline.data import UNMARKED
from heartcase.schemas.arrays import Bool, Int64, UInt8
from heartcase.schemas.labels import BACKGROUND, LabelTable

__all__ = ["thin_lumens"]

THIN_STEPS = 2.0
"""A lumen is thin where it is narrower than this many coarse voxels along an axis of the lattice. Wider ones come out
whole by every n-th voxel."""
REACH = 2
"""Coarse voxels over which a thin lumen is followed to where it opens into a wide one of the same label."""
THIN, WIDE = np.uint8(1), np.uint8(2)
"""What a coarse voxel of blood lies in."""


def thin_lumens(labels: UInt8, coarse: UInt8, steps: Int64, first: Int64, table: LabelTable) -> tuple[UInt8, Bool]:
    """Give coarse voxels of background the label of a thin lumen that passes through them.

    Parameters
    ----------
    labels
        Label of every voxel, shape [z, y, x]; those without a label count as background.
    coarse
        Label of every n-th voxel, shape [z, y, x].
    steps
        Every how many voxels one is taken along i, j and k.
    first
        The first voxel (i, j, k) that is taken; around each taken one lies the part that it stands for.
    table
        Which labels are blood or vessel lumen.

    Returns
    -------
    labels : UInt8
        Coarse labels with thin lumens.
    is_thin : Bool
        Where these lumens are, of the coarse shape.
    """
    is_blood = np.zeros(256, np.bool_)
    is_blood[list(table.blood_values)] = True
    step, start = steps[::-1].copy(), first[::-1].copy()
    most = np.ceil(THIN_STEPS * step).astype(np.int64) - 1
    kind = np.zeros(coarse.shape, np.uint8)
    thin = np.zeros(coarse.shape, np.uint8)
    _judge_samples(labels, coarse, step, start, most, is_blood, kind)
    _find_away(labels, coarse, kind, step, start, most, is_blood, thin)
    for _ in range(REACH):
        _follow(labels, coarse, kind, step, start, most, thin.copy(), thin)
    is_thin: Bool = thin > 0
    return np.where(is_thin, thin, coarse), is_thin


@copied
def _is_narrow(labels, k, j, i, most):
    """Whether a label goes on over so few voxels along some axis; where it reaches the border it does not."""
    value = labels[k, j, i]
    for axis in range(3):
        dk, dj, di = np.int64(axis == 0), np.int64(axis == 1), np.int64(axis == 2)
        count = 1
        is_open = True
        for way in (-1, 1):
            z, y, x = k + way * dk, j + way * dj, i + way * di
            while count <= most[axis]:
                if z < 0 or y < 0 or x < 0 or z >= labels.shape[0] or y >= labels.shape[1] or x >= labels.shape[2]:
                    is_open = False
                    break
                if labels[z, y, x] != value:
                    break
                count += 1
                z, y, x = z + way * dk, y + way * dj, x + way * di
        if is_open and count <= most[axis]:
            return True
    return False


@kernel
def _judge_samples(labels, coarse, step, start, most, is_blood, kind):
    """Of which coarse voxels of blood the voxel that was taken lies in a thin lumen, and of which in a wide one."""
    for a in range(coarse.shape[0]):
        for b in range(coarse.shape[1]):
            for c in range(coarse.shape[2]):
                if is_blood[coarse[a, b, c]]:
                    k, j, i = start[0] + a * step[0], start[1] + b * step[1], start[2] + c * step[2]
                    is_narrow = labels[k, j, i] == coarse[a, b, c] and _is_narrow(labels, k, j, i, most)
                    kind[a, b, c] = THIN if is_narrow else WIDE


@copied
def _is_beside_wide(coarse, kind, a, b, c, value):
    """Whether a wide lumen of a label lies in a coarse voxel beside, over edges and corners too."""
    for z in range(max(a - 1, 0), min(a + 2, coarse.shape[0])):
        for y in range(max(b - 1, 0), min(b + 2, coarse.shape[1])):
            for x in range(max(c - 1, 0), min(c + 2, coarse.shape[2])):
                if kind[z, y, x] == WIDE and coarse[z, y, x] == value:
                    return True
    return False


@copied
def _part(at, start, step, size):
    """First voxel along an axis of the part that a coarse voxel stands for, and the one behind its last."""
    low = start + at * step - step // 2
    return max(low, 0), min(low + step, size)


@kernel
def _find_away(labels, coarse, kind, step, start, most, is_blood, thin):
    """Labels of thin lumens in coarse voxels that lie beside no wide one of the same label: the first in each."""
    for a in range(coarse.shape[0]):
        for b in range(coarse.shape[1]):
            for c in range(coarse.shape[2]):
                sample = coarse[a, b, c]
                if sample in (BACKGROUND, UNMARKED):
                    thin[a, b, c] = _away_in(labels, coarse, kind, a, b, c, step, start, most, is_blood)
                elif kind[a, b, c] == THIN and not _is_beside_wide(coarse, kind, a, b, c, sample):
                    thin[a, b, c] = sample


@copied
def _away_in(labels, coarse, kind, a, b, c, step, start, most, is_blood):
    """The first label of such a lumen in a coarse voxel of background; 0 where there is none."""
    k0, k1 = _part(a, start[0], step[0], labels.shape[0])
    j0, j1 = _part(b, start[1], step[1], labels.shape[1])
    i0, i1 = _part(c, start[2], step[2], labels.shape[2])
    passed = np.uint8(BACKGROUND)
    for k in range(k0, k1):
        for j in range(j0, j1):
            for i in range(i0, i1):
                value = labels[k, j, i]
                if value == passed:
                    continue
                if not is_blood[value] or _is_beside_wide(coarse, kind, a, b, c, value):
                    passed = value
                elif _is_narrow(labels, k, j, i, most):
                    return value
    return np.uint8(BACKGROUND)


@kernel
def _follow(labels, coarse, kind, step, start, most, known, thin):
    """Go on from thin lumens to thin parts of the same label in the coarse voxels beside them."""
    for a, b, c in np.argwhere(known):
        value = known[a, b, c]
        for z in range(max(a - 1, 0), min(a + 2, coarse.shape[0])):
            for y in range(max(b - 1, 0), min(b + 2, coarse.shape[1])):
                for x in range(max(c - 1, 0), min(c + 2, coarse.shape[2])):
                    if thin[z, y, x] != 0:
                        continue
                    is_same = kind[z, y, x] == THIN and coarse[z, y, x] == value
                    is_free = coarse[z, y, x] in (BACKGROUND, UNMARKED)
                    if is_same or (is_free and _holds(labels, z, y, x, step, start, most, value)):
                        thin[z, y, x] = value


@copied
def _holds(labels, a, b, c, step, start, most, value):
    """Whether a coarse voxel holds a voxel of a thin lumen of a label."""
    k0, k1 = _part(a, start[0], step[0], labels.shape[0])
    j0, j1 = _part(b, start[1], step[1], labels.shape[1])
    i0, i1 = _part(c, start[2], step[2], labels.shape[2])
    for k in range(k0, k1):
        for j in range(j0, j1):
            for i in range(i0, i1):
                if labels[k, j, i] == value and _is_narrow(labels, k, j, i, most):
                    return True
    return False
