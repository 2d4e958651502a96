"""Which structure owns a point, and signed values of each structure's region: the phantom's rules, as kernels.

With d_i the distance to the lumen of cavity i, t_i the thickness of its wall, m the distance to the left epicardial
body, c_i above zero behind an end disc of i, k below zero in the canal of a defect, and s below zero in a sheet (valve
leaflets, a baffle), where the heart has any:

1. blood: e_i = max(d_i, c_i) < 0; the lowest e_i wins;
2. left ventricular myocardium: m < 0;
3. walls: d_i <= t_i and c_i <= 0; the lowest d_i wins;
4. tissue in the canal of a defect becomes blood of the cavity with the lowest e_i;
5. blood within a sheet becomes the sheet's;
6. everything else is background. Ties go to the lower label.

Each region's value is a maximum and minimum of these, scaled to change by at most 1 per mm: its zero surface is the
region's border, and its size is a lower bound on the distance to it (but for what the splines of the distances lose),
attained wherever one smooth face is nearest.
"""

from __future__ import annotations

import numba
import numpy as np

from heartcase.compiling.kernel import kernel, loop_kernel
from heartcase.phantom.anatomy.tables import table_value

__all__ = ["CAVITY_COUNT", "MYOCARDIUM", "TISSUE", "label_points", "materials", "region_value", "region_values"]

CAVITY_COUNT = 8
MYOCARDIUM = 9
_SHEET = CAVITY_COUNT + 1
"""Where the value of the sheets is among those of a point."""
TISSUE = -1
"""Region number of all tissue together."""
_FAR = 1e9
_PART = 4096
"""Points that one task of a parallel loop takes; no result depends on it."""


@kernel
def _evaluate(tables, ends, canals, x, y, z, d, c):
    """Fill d (10 values: cavities, body, sheets) and c (8 values) at a point; returns k."""
    coefficients, start, size, origin, spacing, margin = tables
    d[_SHEET] = _FAR
    for field in range(start.shape[0]):
        d[field] = table_value(coefficients, start, size, origin, spacing, margin, field, x, y, z)
    for cavity in range(CAVITY_COUNT):
        c[cavity] = -_FAR
    for end in range(ends.shape[0]):
        cavity = int(ends[end, 0])
        value = -_cylinder(ends, end, 1, x, y, z)
        c[cavity] = max(c[cavity], value)
    k = _FAR
    for canal in range(canals.shape[0]):
        k = min(k, _canal(canals, canal, x, y, z))
    return k


@kernel
def _cylinder(rows, row, first, x, y, z):
    """Value of a cylinder (start x, y, z, axis x, y, z, radius, length), below zero inside."""
    gx = x - rows[row, first]
    gy = y - rows[row, first + 1]
    gz = z - rows[row, first + 2]
    ax, ay, az = rows[row, first + 3], rows[row, first + 4], rows[row, first + 5]
    axial = gx * ax + gy * ay + gz * az
    radial = np.sqrt(max(gx * gx + gy * gy + gz * gz - axial * axial, 0.0))
    return max(radial - rows[row, first + 6], -axial, axial - rows[row, first + 7])


@kernel
def _canal(rows, row, x, y, z):
    """Value of a defect (a cylinder as above, the unit vector of its long diameter, half the short one, shape).

    Shape 0 is round, 1 an ellipse, 2 a straight slit with round ends. An ellipse's value is exact along its short
    diameter only, and less in size than the distance elsewhere.
    """
    if rows[row, 12] == 0.0:
        return _cylinder(rows, row, 0, x, y, z)
    gx = x - rows[row, 0]
    gy = y - rows[row, 1]
    gz = z - rows[row, 2]
    axial = gx * rows[row, 3] + gy * rows[row, 4] + gz * rows[row, 5]
    u = gx * rows[row, 8] + gy * rows[row, 9] + gz * rows[row, 10]
    v = np.sqrt(max(gx * gx + gy * gy + gz * gz - axial * axial - u * u, 0.0))
    long = rows[row, 6]
    short = rows[row, 11]
    if rows[row, 12] == 1.0:
        radial = short * (np.sqrt((u / long) ** 2 + (v / short) ** 2) - 1.0)
    else:
        beyond = max(abs(u) - (long - short), 0.0)
        radial = np.sqrt(beyond * beyond + v * v) - short
    return max(radial, -axial, axial - rows[row, 7])


@kernel
def _label(d, c, k, thickness, wall_label):
    label = _label_without_sheets(d, c, k, thickness, wall_label)
    return wall_label[CAVITY_COUNT] if d[_SHEET] < 0.0 and 0 < label <= CAVITY_COUNT else label


@kernel
def _label_without_sheets(d, c, k, thickness, wall_label):
    lowest = _FAR
    nearest = 0
    for i in range(CAVITY_COUNT):
        e = max(d[i], c[i])
        if e < lowest:
            lowest = e
            nearest = i
    if lowest < 0.0:
        return nearest + 1
    if d[CAVITY_COUNT] < 0.0:
        return nearest + 1 if k < 0.0 else MYOCARDIUM
    closest = _FAR
    wall = 0
    for i in range(CAVITY_COUNT):
        if thickness[i] > 0.0 and d[i] <= thickness[i] and c[i] <= 0.0 and d[i] < closest:
            closest = d[i]
            wall = wall_label[i]
    if wall > 0 and k < 0.0:
        return nearest + 1
    return wall


@kernel
def _label_points_part(tables, ends, canals, thickness, wall_label, points, labels, first, last):
    d = np.empty(CAVITY_COUNT + 2)
    c = np.empty(CAVITY_COUNT)
    for n in range(first, last):
        k = _evaluate(tables, ends, canals, points[n, 0], points[n, 1], points[n, 2], d, c)
        labels[n] = _label(d, c, k, thickness, wall_label)


@loop_kernel
def label_points(tables, ends, canals, thickness, wall_label, points, labels):
    """Fill ``labels`` at points, shape (n, 3)."""
    count = points.shape[0]
    for part in numba.prange((count + _PART - 1) // _PART):
        _label_points_part(
            tables, ends, canals, thickness, wall_label, points, labels, part * _PART, min(count, (part + 1) * _PART)
        )


@kernel
def _materials_part(tables, ends, canals, thickness, points, material, clearance, hull, first, last):
    d = np.empty(CAVITY_COUNT + 2)
    c = np.empty(CAVITY_COUNT)
    for n in range(first, last):
        k = _evaluate(tables, ends, canals, points[n, 0], points[n, 1], points[n, 2], d, c)
        blood = _FAR
        walls = _FAR
        nearest = _FAR
        least = _FAR
        kind = 0
        for i in range(CAVITY_COUNT):
            blood = min(blood, d[i])
            walls = min(walls, d[i] - thickness[i])
            least = min(least, abs(d[i]), abs(d[i] - thickness[i]))
            if d[i] <= thickness[i] and d[i] < nearest:
                nearest = d[i]
                kind = 2 if i < 4 else 3
        solid = min(d[CAVITY_COUNT], walls)
        least = min(least, abs(d[CAVITY_COUNT]))
        if d[CAVITY_COUNT] < 0.0:
            kind = 2
        if blood < 0.0 or (k < 0.0 and solid < 0.0):
            kind = 3 if d[_SHEET] < 0.0 else 1
        material[n] = kind
        clearance[n] = min(least, abs(k), abs(d[_SHEET]))
        hull[n] = solid


@loop_kernel
def materials(tables, ends, canals, thickness, points, material, clearance, hull):
    """Fill what a scanner sees at points: it knows no end discs, so vessels go on behind them.

    ``material`` is 0 outside the heart, 1 blood, 2 myocardium (left ventricle, or the wall of a chamber), 3 wall of
    a vessel; ``clearance`` a lower bound on the distance to the next border between materials, mm; ``hull`` the
    distance to the heart, mm.
    """
    count = points.shape[0]
    for part in numba.prange((count + _PART - 1) // _PART):
        _materials_part(
            tables,
            ends,
            canals,
            thickness,
            points,
            material,
            clearance,
            hull,
            part * _PART,
            min(count, (part + 1) * _PART),
        )


@kernel
def _region(d, c, k, thickness, wall_label, region):
    blood = _FAR
    hull = d[CAVITY_COUNT]
    tissue = d[CAVITY_COUNT]
    for i in range(CAVITY_COUNT):
        blood = min(blood, max(d[i], c[i]))
        if thickness[i] > 0.0:
            hull = min(hull, max(d[i] - thickness[i], c[i]))
            # An open end is no border of the wall: inside the lumen the way to the wall counts, also behind the disc.
            tissue = min(tissue, max(d[i] - thickness[i], c[i], -d[i]))
    canal = max(k, min(hull, blood))
    sheet = max(d[_SHEET], min(blood, canal))
    if region == 0:
        return -min(hull, blood)
    if region == TISSUE:
        return min(max(tissue, -blood, -canal), sheet)
    if region == wall_label[CAVITY_COUNT]:
        return sheet
    if region == MYOCARDIUM:
        return max(d[CAVITY_COUNT], -blood, -canal)
    if region <= CAVITY_COUNT:
        own = max(d[region - 1], c[region - 1])
        value = min(own, canal)
        for j in range(CAVITY_COUNT):
            if j != region - 1:
                value = max(value, 0.5 * (own - max(d[j], c[j])))
        return max(value, -d[_SHEET])
    cavity = 0
    while wall_label[cavity] != region:
        cavity += 1
    value = max(d[cavity] - thickness[cavity], c[cavity], -d[cavity])
    value = max(value, -d[CAVITY_COUNT], -blood, -canal)
    for j in range(CAVITY_COUNT):
        if j != cavity and thickness[j] > 0.0:
            rival = max(d[j] - thickness[j], c[j])
            value = max(value, min(0.5 * (d[cavity] - d[j]), -rival))
    return value


@kernel
def region_value(tables, ends, canals, thickness, wall_label, region, x, y, z, d, c):
    """A region's value at one point; ``d`` (10 values) and ``c`` (8 values) are room to work in."""
    k = _evaluate(tables, ends, canals, x, y, z, d, c)
    return _region(d, c, k, thickness, wall_label, region)


@kernel
def _region_values_part(tables, ends, canals, thickness, wall_label, region, points, values, first, last):
    d = np.empty(CAVITY_COUNT + 2)
    c = np.empty(CAVITY_COUNT)
    for n in range(first, last):
        x, y, z = points[n, 0], points[n, 1], points[n, 2]
        values[n] = region_value(tables, ends, canals, thickness, wall_label, region, x, y, z, d, c)


@loop_kernel
def region_values(tables, ends, canals, thickness, wall_label, region, points, values):
    """Fill ``values`` with a region's value at points, shape (n, 3)."""
    count = points.shape[0]
    for part in numba.prange((count + _PART - 1) // _PART):
        _region_values_part(
            tables,
            ends,
            canals,
            thickness,
            wall_label,
            region,
            points,
            values,
            part * _PART,
            min(count, (part + 1) * _PART),
        )
