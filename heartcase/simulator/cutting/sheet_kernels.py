"""What a polyline sweeps, in triangles: kernels of :mod:`heartcase.simulator.cutting.blade_sheet`."""

from __future__ import annotations

import numpy as np

from heartcase.compiling.kernel import kernel

__all__ = ["divided", "refine", "step_lengths", "steps_of", "strips_beyond", "triangles_of"]


@kernel
def step_lengths(points):
    """Distances from pose to pose and from point to point; NaN beside a hole.

    Parameters
    ----------
    points
        Shape (pose_count, point_count, 3).
    """
    poses, count = points.shape[0], points.shape[1]
    along, across = np.empty((poses - 1, count)), np.empty((poses, count - 1))
    for pose in range(poses):
        for point in range(count):
            here = points[pose, point]
            if pose + 1 < poses:
                there = points[pose + 1, point]
                x, y, z = there[0] - here[0], there[1] - here[1], there[2] - here[2]
                along[pose, point] = np.sqrt(x * x + y * y + z * z)
            if point + 1 < count:
                there = points[pose, point + 1]
                x, y, z = there[0] - here[0], there[1] - here[1], there[2] - here[2]
                across[pose, point] = np.sqrt(x * x + y * y + z * z)
    return along, across


@kernel
def steps_of(along, across, finest):
    """Into how many steps each step from pose to pose, and from point to point, is divided (:func:`step_lengths`)."""
    return _steps(along, False, finest, np.inf), _steps(across, True, finest, np.inf)


@kernel
def divided(points, steps, more):
    """A blade whose steps from pose to pose, and from point to point, are divided into so many, (any, any, 3)."""
    poses, count = points.shape[0], points.shape[1]
    rows = np.empty((steps.sum() + 1, count, 3))
    row = 0
    for pose in range(poses - 1):
        for step in range(steps[pose] + (1 if pose == poses - 2 else 0)):
            part = _part(pose, row, row - step, steps[pose])
            for point in range(count):
                for axis in range(3):
                    start = points[pose, point, axis]
                    rows[row, point, axis] = start + part * (points[pose + 1, point, axis] - start)
            row += 1
    result = np.empty((len(rows), more.sum() + 1, 3))
    column = 0
    for point in range(count - 1):
        for step in range(more[point] + (1 if point == count - 2 else 0)):
            part = _part(point, column, column - step, more[point])
            for row in range(len(rows)):
                for axis in range(3):
                    start = rows[row, point, axis]
                    result[row, column, axis] = start + part * (rows[row, point + 1, axis] - start)
            column += 1
    return result


@kernel(cached=False)
def _part(number, at, start, steps):
    """Part of the way from a number to the next, of a place among steps, as ``numpy.interp`` has it."""
    if at - start == steps:
        return 1.0
    return (1.0 / steps * np.float64(at - start) + number) - number


@kernel(cached=False)
def _steps(lengths, is_across, finest, far):
    """Into how many steps each is divided, so that the longest beside it is no longer than the finest."""
    number = lengths.shape[1] if is_across else lengths.shape[0]
    counts = np.empty(number, np.int64)
    for at in range(number):
        longest = 0.0
        for other in range(lengths.shape[0] if is_across else lengths.shape[1]):
            length = lengths[other, at] if is_across else lengths[at, other]
            if length > longest:
                longest = length
        counts[at] = max(int(np.ceil(min(longest, far) / finest)), 1)
    return counts


@kernel
def refine(points, along, across, at_pose, at_point, finest, far):
    """Points and poses at most so far apart, with their places on the sheet laid out flat, (any, any, 5).

    Parameters
    ----------
    points
        Shape (pose_count, point_count, 3).
    along, across
        Distances as of :func:`step_lengths`.
    at_pose, at_point
        Place of each pose and of each point on the sheet laid out flat.
    finest, far
        Longest step, and what a longer one is divided as.
    """
    poses, count = points.shape[0], points.shape[1]
    both = np.empty((poses, count, 5))
    for pose in range(poses):
        for point in range(count):
            both[pose, point, :3] = points[pose, point]
            both[pose, point, 3], both[pose, point, 4] = at_pose[pose], at_point[point]
    steps = _steps(along, False, finest, far)
    rows = np.empty((steps.sum() + 1, count, 5))
    row = 0
    for pose in range(poses - 1):
        for step in range(steps[pose]):
            share = step / steps[pose]
            for point in range(count):
                for number in range(5):
                    start = both[pose, point, number]
                    rows[row, point, number] = share * (both[pose + 1, point, number] - start) + start
            row += 1
    rows[row] = both[poses - 1]
    steps = _steps(across, True, finest, far)
    result = np.empty((len(rows), steps.sum() + 1, 5))
    column = 0
    for point in range(count - 1):
        for step in range(steps[point]):
            share = step / steps[point]
            for row in range(len(rows)):
                for number in range(5):
                    start = rows[row, point, number]
                    result[row, column, number] = share * (rows[row, point + 1, number] - start) + start
            column += 1
    for row in range(len(rows)):
        result[row, column] = rows[row, count - 1]
    return result


@kernel
def triangles_of(points, quanta, furthest, longest):
    """Two triangles for each four points that are neighbours and all there, in whole numbers.

    Parameters
    ----------
    points
        Shape (pose_count, point_count, 3 and further numbers).
    quanta
        Whole numbers to a cell.
    furthest, longest
        How far from the origin corners may lie, and the largest extent of a triangle along any axis [cells].

    Returns
    -------
    tuple
        Corners (count, 3, 3), the further numbers of each (count, 3, any), and whether none lies too far, or is too
        large.
    """
    poses, count, further = points.shape[0], points.shape[1], points.shape[2] - 3
    quads = 0
    is_whole = np.empty((poses - 1, count - 1), np.bool_)
    for pose in range(poses - 1):
        for point in range(count - 1):
            total = 0.0
            for number in range(points.shape[2]):
                total += points[pose, point, number] + points[pose, point + 1, number]
                total += points[pose + 1, point, number] + points[pose + 1, point + 1, number]
            is_whole[pose, point] = np.isfinite(total)
            quads += is_whole[pose, point]
    corners, more = np.empty((2 * quads, 3, 3), np.int64), np.empty((2 * quads, 3, further))
    is_near, quad = True, 0
    for pose in range(poses - 1):
        for point in range(count - 1):
            if not is_whole[pose, point]:
                continue
            for half in range(2):
                at = quad + half * quads
                for corner in range(3):
                    # Corners a, b, c and then c, b, d.
                    which = corner if half == 0 else (2, 1, 3)[corner]
                    there = points[pose + which // 2, point + which % 2]
                    for axis in range(3):
                        corners[at, corner, axis] = np.int64(np.rint(there[axis] * quanta))
                        is_near &= abs(there[axis]) < furthest
                    for number in range(further):
                        more[at, corner, number] = there[3 + number]
                for axis in range(3):
                    low = high = points[pose + (1 if half else 0), point, axis]
                    for corner in range(3):
                        which = corner if half == 0 else (2, 1, 3)[corner]
                        place = points[pose + which // 2, point + which % 2, axis]
                        low, high = min(low, place), max(high, place)
                    is_near &= high - low <= longest
            quad += 1
    return corners, more, is_near


@kernel(cached=False)
def _continued(first, second, beyond, before, after):
    """Write what two rows of points are moved apart to, along the lines through both."""
    for point in range(len(first)):
        x, y, z = (
            second[point, 0] - first[point, 0],
            second[point, 1] - first[point, 1],
            second[point, 2] - first[point, 2],
        )
        length = np.sqrt(x * x + y * y + z * z)
        for axis in range(3):
            way = second[point, axis] - first[point, axis]
            # What ends beside a hole is not continued there.
            step = (way / length if length > 0.0 else np.nan if np.isnan(way) else 0.0) * beyond
            before[point, axis] = first[point, axis] - step
            after[point, axis] = second[point, axis] + step


@kernel
def strips_beyond(points, beyond):
    """Strips beyond the edges of a sheet: points of the first and last poses, and of the first and last points.

    Parameters
    ----------
    points
        Shape (pose_count, point_count, 3).
    beyond
        How far each is continued.

    Returns
    -------
    tuple
        Shapes (2, point_count + 2, 3), twice, and (pose_count + 2, 2, 3), twice.
    """
    poses, count = points.shape[0], points.shape[1]
    ahead, nothing = np.empty((poses + 2, count + 2, 3)), np.empty((max(poses + 2, count), 3))
    ahead[1:-1, 1:-1] = points
    _continued(points[0], points[1], beyond, ahead[0, 1:-1], nothing)
    _continued(points[poses - 2], points[poses - 1], beyond, nothing, ahead[poses + 1, 1:-1])
    _continued(ahead[:, 1], ahead[:, 2], beyond, ahead[:, 0], nothing)
    _continued(ahead[:, count - 1], ahead[:, count], beyond, nothing, ahead[:, count + 1])
    return ahead[:2].copy(), ahead[-2:].copy(), ahead[:, :2].copy(), ahead[:, -2:].copy()
