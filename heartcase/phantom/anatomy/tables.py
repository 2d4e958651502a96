"""True signed distances of shapes, tabulated once and read back as cubic B-splines.

A shape's value is read on a lattice near its border; the zero surface of the cubic B-spline through these values is
the structure's border from then on. It is sampled, with normal and curvature, about once per lattice step, and the
signed distance of a lattice point is that to the surface's second-order patch at the nearest sample. The B-spline
through the distances is twice continuously differentiable: it *is* the phantom's definition of the structure, so a
label is exact by definition; it equals the distance to its own zero surface within the error that tests state.

A spline cannot hold a knife edge, so convex edges are rounded and concave ones filled with a radius of about two
lattice steps where the caller asks for it (opening and closing by a ball), and edges are sampled more densely.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numba
import numpy as np
from scipy import ndimage

from heartcase.compiling.kernel import kernel, loop_kernel
from heartcase.phantom.anatomy.nearest import SampleTree
from heartcase.phantom.anatomy.shapes import Offset, Shape, complement
from heartcase.schemas.arrays import Bool, Float32, Float64, Int64

__all__ = ["DistanceTables", "table_value", "tabulate"]

COARSE = 4
_PART = 4096
"""Points that one task of a parallel loop takes; no result depends on it."""
_SAMPLE_SHIFT = 0.35
"""Steps between a crossing of the lattice and the samples around it: about as many again lie between two crossings."""
_INNER_BAND = 3.5
"""Steps inside the border where distances are computed on every lattice point."""


@dataclass(frozen=True)
class DistanceTables:
    """B-spline coefficients of several distance fields, each on a box of its own."""

    coefficients: Float32
    """All coefficients, one field after the other, each [z, y, x] in C order."""
    start: Int64
    """Where each field starts in ``coefficients``, shape (field_count,)."""
    size: Int64
    """Lattice points of each field along x, y, z, shape (field_count, 3)."""
    origin_mm: Float64
    """First lattice point of each field, shape (field_count, 3)."""
    spacing_mm: float
    """Lattice step of all fields."""
    margin_mm: float
    """Least distance from a field's surface to the border of its lattice."""

    @property
    def kernel_arguments(self) -> tuple[Float32, Int64, Int64, Float64, float, float]:
        """The arrays in the order that the kernels take them."""
        return self.coefficients, self.start, self.size, self.origin_mm, self.spacing_mm, self.margin_mm

    def evaluate(self, points: Float64) -> Float64:
        """Values of all fields at world points, shape (n, 3) -> (n, field_count), mm."""
        values: Float64 = _evaluate_tables(*self.kernel_arguments, np.ascontiguousarray(points, dtype=float))
        return values

    def distance(self, points: Float64) -> Float64:
        """Value of the first field at world points, shape (n, 3) -> (n,), mm: makes a table a shape."""
        return self.evaluate(points)[:, 0]

    def mirrored(self) -> DistanceTables:
        """The mirror image: x becomes -x."""
        parts = []
        for first, size in zip(self.start, self.size, strict=True):
            part = self.coefficients[first : first + size.prod()].reshape(*size[::-1])
            parts.append(part[:, :, ::-1].ravel())
        origin = self.origin_mm.copy()
        origin[:, 0] = -(origin[:, 0] + (self.size[:, 0] - 1) * self.spacing_mm)
        return replace(self, coefficients=np.concatenate(parts), origin_mm=origin)

    @classmethod
    def joined(cls, tables: Sequence[DistanceTables]) -> DistanceTables:
        """The fields of several tables of one spacing and margin, in order."""
        lengths = [len(table.coefficients) for table in tables]
        return cls(
            np.concatenate([table.coefficients for table in tables]),
            np.cumsum([0, *lengths[:-1]]).astype(np.int64),
            np.concatenate([table.size for table in tables]),
            np.concatenate([table.origin_mm for table in tables]),
            tables[0].spacing_mm,
            tables[0].margin_mm,
        )


def tabulate(
    shape: Shape,
    lower_mm: Float64,
    upper_mm: Float64,
    *,
    spacing_mm: float,
    band_mm: float,
    margin_mm: float,
    rounding_mm: float = 0.0,
    fillet_mm: float = 0.0,
) -> DistanceTables:
    """Tabulate the true distance of a shape.

    Parameters
    ----------
    shape
        What to tabulate: its value must be below zero inside, and change by at most 1 per mm.
    lower_mm, upper_mm
        Corners of a box that holds the shape, shape (3,).
    spacing_mm
        Lattice step.
    band_mm
        Distance outside the surface up to which the values are computed on every lattice point; beyond, on every
        fourth.
    margin_mm
        How far the lattice reaches beyond the box.
    rounding_mm
        Round convex edges with this radius (a morphological opening by a ball); two lattice steps are enough for
        the spline to hold what was an edge.
    fillet_mm
        Before that, fill concave edges with this radius (a closing): the distance outside has no crease nearer.

    Raises
    ------
    ValueError
        The box does not hold the shape.
    """
    origin = lower_mm - margin_mm
    size = np.ceil((upper_mm + margin_mm - origin) / (COARSE * spacing_mm)).astype(np.int64) * COARSE + 1
    for radius, side in ((fillet_mm, complement), (rounding_mm, _same)):
        if radius > 0.0:
            core = Offset(side(shape), -radius)
            values = _distances(core, origin, size, spacing_mm, radius + 5.0 * spacing_mm, edges=True) - radius
            coefficients = _coefficients(values)
            shape = side(
                DistanceTables(coefficients, np.zeros(1, np.int64), size[None], origin[None], spacing_mm, margin_mm)
            )
    values = _distances(shape, origin, size, spacing_mm, band_mm, edges=rounding_mm > 0.0)
    border = min(values.take(side, axis=axis).min() for axis in range(3) for side in (0, -1))
    if border < 0.5 * margin_mm:
        raise ValueError(f"the box does not hold the shape: it comes within {border:.1f} mm of the lattice's border")
    return DistanceTables(_coefficients(values), np.zeros(1, np.int64), size[None], origin[None], spacing_mm, margin_mm)


def _same(shape: Shape) -> Shape:
    return shape


def _coefficients(values: Float64) -> Float32:
    flat: Float32 = np.asarray(ndimage.spline_filter(values, order=3), dtype=np.float32).ravel()
    return flat


def _lattice(origin: Float64, size: Int64, step: float) -> Float64:
    axes = [origin[axis] + step * np.arange(size[axis]) for axis in range(3)]
    grid = np.meshgrid(axes[2], axes[1], axes[0], indexing="ij")
    return np.stack([grid[2], grid[1], grid[0]], axis=-1)


def _distances(shape: Shape, origin: Float64, size: Int64, step: float, band_mm: float, *, edges: bool) -> Float64:
    coarse_points = _lattice(origin, (size - 1) // COARSE + 1, COARSE * step)
    coarse = shape.distance(coarse_points.reshape(-1, 3)).reshape(coarse_points.shape[:3])
    values = _upsampled(coarse, order=1)
    points = _lattice(origin, size, step)
    # A value that changes by at most 1 per mm is off by 3.5 steps at most between the coarse points.
    near = np.abs(values) < 5.0 * step
    values[near] = shape.distance(points[near])
    samples, normals, curvature = _surface_samples(values, near, points, origin, size, step, edges=edges)
    tree = SampleTree.of(samples)
    # How far a foot can be from its nearest sample.
    apart = (0.5 if edges else 0.87) * step
    far = _patch_distance(coarse_points.reshape(-1, 3), tree, samples, normals, curvature, apart)
    distances = _upsampled(np.copysign(far, coarse.ravel()).reshape(coarse.shape), order=3)
    band = near | ((values > 0.0) & (distances < band_mm + step)) | ((values < 0.0) & (distances > -_INNER_BAND * step))
    found = _patch_distance(points[band], tree, samples, normals, curvature, apart)
    distances[band] = np.copysign(found, values[band])
    return distances


def _upsampled(coarse: Float64, *, order: int) -> Float64:
    size = [(n - 1) * COARSE + 1 for n in coarse.shape]
    fine = coarse
    for axis, count in enumerate(size):
        spline = ndimage.spline_filter1d(fine, 3, axis=axis) if order > 1 else fine
        fine = _interpolated_along(np.moveaxis(np.asarray(spline), axis, 0), count, order)
        fine = np.moveaxis(fine, 0, axis)
    return np.ascontiguousarray(fine)


def _interpolated_along(spline: Float64, count: int, order: int) -> Float64:
    """Values of a spline of order 1 or 3 at quarter steps along axis 0."""
    at = np.arange(count) / COARSE
    first = np.minimum(at.astype(int), len(spline) - 2)
    u = at - first
    if order == 1:
        weights = {0: 1.0 - u, 1: u}
    else:
        weights = {
            -1: (1.0 - u) ** 3 / 6.0,
            0: (4.0 - 6.0 * u**2 + 3.0 * u**3) / 6.0,
            1: (1.0 + 3.0 * u + 3.0 * u**2 - 3.0 * u**3) / 6.0,
            2: u**3 / 6.0,
        }
    value = np.zeros((count, *spline.shape[1:]))
    last = len(spline) - 1
    for shift, weight in weights.items():
        index = np.abs(first + shift)
        index = np.where(index > last, 2 * last - index, index)
        value += spline[index] * weight.reshape(-1, *([1] * (spline.ndim - 1)))
    return value


def _surface_samples(
    values: Float64,
    known: Bool,
    points: Float64,
    origin: Float64,
    size: Int64,
    step: float,
    *,
    edges: bool,
) -> tuple[Float64, Float64, Float64]:
    """Points on the zero surface, unit normals, and the curvature tensor (the Hessian of the distance) there."""
    found = []
    for axis in range(3):
        before = tuple(slice(None, -1) if a == axis else slice(None) for a in range(3))
        after = tuple(slice(1, None) if a == axis else slice(None) for a in range(3))
        crossing = ((values[before] < 0.0) != (values[after] < 0.0)) & known[before] & known[after]
        a, b = values[before][crossing], values[after][crossing]
        fraction = (a / (a - b))[:, None]
        found.append(points[before][crossing] * (1.0 - fraction) + points[after][crossing] * fraction)
    coefficients = _coefficients(values)

    def onto_surface(at: Float64) -> tuple[Float64, Float64]:
        for _ in range(3):
            value, gradient, _ = _derivatives(coefficients, size, origin, step, at)
            square = np.maximum(np.einsum("ni,ni->n", gradient, gradient), 0.04)
            at = at - gradient * (value / square)[:, None]
        return at, gradient / np.sqrt(square)[:, None]

    samples, normals = onto_surface(np.concatenate(found))
    if edges:
        samples = onto_surface(_beside(samples, normals, step))[0]
    _, gradient, hessian = _derivatives(coefficients, size, origin, step, samples)
    length = np.maximum(np.linalg.norm(gradient, axis=1), 1e-9)
    normals = gradient / length[:, None]
    tangent = np.eye(3) - normals[:, :, None] * normals[:, None, :]
    curvature = tangent @ (hessian / length[:, None, None]) @ tangent
    # On an edge the second derivatives of the spline say nothing: no curvature beyond one over a step.
    curvature /= np.maximum(1.0, step * np.linalg.norm(curvature, axis=(1, 2)))[:, None, None]
    return samples, normals, curvature


def _beside(samples: Float64, normals: Float64, step: float) -> Float64:
    """Each sample and eight around it in its tangent plane."""
    side = np.cross(normals, np.eye(3)[np.argmin(np.abs(normals), axis=1)])
    side /= np.maximum(np.linalg.norm(side, axis=1), 1e-9)[:, None]
    across = np.cross(normals, side)
    shifts = (-_SAMPLE_SHIFT * step, 0.0, _SAMPLE_SHIFT * step)
    return np.concatenate([samples + u * side + v * across for u in shifts for v in shifts])


def _patch_distance(
    points: Float64, tree: SampleTree, samples: Float64, normals: Float64, curvature: Float64, apart_mm: float
) -> Float64:
    """Unsigned distance to the second-order patch at the nearest sample, no foot being ``apart_mm`` from one."""
    plain, index = tree.query(points)
    gap = points - samples[index]
    normal = normals[index]
    height = np.einsum("ni,ni->n", gap, normal)
    tangent = gap - height[:, None] * normal
    bend = np.einsum("nij,nj->ni", curvature[index], tangent)
    along = np.einsum("ni,ni->n", bend, tangent)
    square = np.maximum(np.einsum("ni,ni->n", tangent, tangent), 1e-12)
    # The foot of a point at height a slides by tangent / (1 + a curvature); bounded near the patch's own focus.
    shrink = np.maximum(1.0 + height * along / square, 0.3)
    refined = np.abs(height + 0.5 * along / shrink)
    # Beside an edge this holds the distance.
    lower = np.sqrt(np.maximum(plain * plain - apart_mm * apart_mm, 0.0))
    result: Float64 = np.clip(refined, lower, plain)
    return result


@kernel
def _weights(u, value, first, second):
    """Cubic B-spline weights at a fraction u and their first and second derivatives, each four long."""
    v = 1.0 - u
    value[0] = v * v * v / 6.0
    value[1] = (4.0 - 6.0 * u * u + 3.0 * u * u * u) / 6.0
    value[2] = (4.0 - 6.0 * v * v + 3.0 * v * v * v) / 6.0
    value[3] = u * u * u / 6.0
    first[0] = -0.5 * v * v
    first[1] = 0.5 * u * (3.0 * u - 4.0)
    first[2] = -0.5 * v * (3.0 * v - 4.0)
    first[3] = 0.5 * u * u
    second[0] = v
    second[1] = 3.0 * u - 2.0
    second[2] = 3.0 * v - 2.0
    second[3] = u


@kernel
def _mirrored(index, count):
    index = abs(index)
    return index if index < count else 2 * (count - 1) - index


@kernel
def _derivatives_part(coefficients, size, origin, spacing, points, value, gradient, hessian, start, stop):
    weight = np.empty((3, 3, 4))
    cell = np.empty(3, np.int64)
    for n in range(start, stop):
        for axis in range(3):
            at = min(max((points[n, axis] - origin[axis]) / spacing, 0.0), size[axis] - 1.0)
            cell[axis] = min(int(at), size[axis] - 2)
            _weights(at - cell[axis], weight[axis, 0], weight[axis, 1], weight[axis, 2])
        for c in range(4):
            k = _mirrored(cell[2] - 1 + c, size[2])
            # Sums over a plane: of the values, then derived once or twice along x and y.
            v = vx = vxx = vy = vyy = vxy = 0.0
            for b in range(4):
                j = _mirrored(cell[1] - 1 + b, size[1])
                row = (k * size[1] + j) * size[0]
                r = rx = rxx = 0.0
                for a in range(4):
                    coefficient = coefficients[row + _mirrored(cell[0] - 1 + a, size[0])]
                    r += coefficient * weight[0, 0, a]
                    rx += coefficient * weight[0, 1, a]
                    rxx += coefficient * weight[0, 2, a]
                v += r * weight[1, 0, b]
                vx += rx * weight[1, 0, b]
                vxx += rxx * weight[1, 0, b]
                vy += r * weight[1, 1, b]
                vyy += r * weight[1, 2, b]
                vxy += rx * weight[1, 1, b]
            value[n] += v * weight[2, 0, c]
            gradient[n, 0] += vx * weight[2, 0, c] / spacing
            gradient[n, 1] += vy * weight[2, 0, c] / spacing
            gradient[n, 2] += v * weight[2, 1, c] / spacing
            hessian[n, 0, 0] += vxx * weight[2, 0, c] / spacing**2
            hessian[n, 1, 1] += vyy * weight[2, 0, c] / spacing**2
            hessian[n, 2, 2] += v * weight[2, 2, c] / spacing**2
            hessian[n, 0, 1] += vxy * weight[2, 0, c] / spacing**2
            hessian[n, 0, 2] += vx * weight[2, 1, c] / spacing**2
            hessian[n, 1, 2] += vy * weight[2, 1, c] / spacing**2
        hessian[n, 1, 0] = hessian[n, 0, 1]
        hessian[n, 2, 0] = hessian[n, 0, 2]
        hessian[n, 2, 1] = hessian[n, 1, 2]


def _derivatives(
    coefficients: Float32, size: Int64, origin: Float64, spacing: float, points: Float64
) -> tuple[Float64, Float64, Float64]:
    """Value (n,), gradient (n, 3) and Hessian (n, 3, 3) of one spline at points inside its lattice."""
    count = len(points)
    value, gradient, hessian = np.zeros(count), np.zeros((count, 3)), np.zeros((count, 3, 3))
    _add_derivatives(coefficients, size, origin, spacing, points, value, gradient, hessian)
    return value, gradient, hessian


@loop_kernel
def _add_derivatives(coefficients, size, origin, spacing, points, value, gradient, hessian):
    """Add them to arrays that hold 0."""
    count = points.shape[0]
    for part in numba.prange((count + _PART - 1) // _PART):
        stop = min(count, (part + 1) * _PART)
        _derivatives_part(coefficients, size, origin, spacing, points, value, gradient, hessian, part * _PART, stop)


@kernel
def table_value(coefficients, start, size, origin, spacing, margin, field, x, y, z):
    """Value of one field at one point; outside its lattice the value at the border plus the way to it.

    More than two margins outside the structure, where nothing asks for more, it is interpolated linearly.
    """
    nx, ny, nz = size[field, 0], size[field, 1], size[field, 2]
    u = (x - origin[field, 0]) / spacing
    v = (y - origin[field, 1]) / spacing
    w = (z - origin[field, 2]) / spacing
    cu = min(max(u, 0.0), nx - 1.0)
    cv = min(max(v, 0.0), ny - 1.0)
    cw = min(max(w, 0.0), nz - 1.0)
    outside = np.sqrt((u - cu) ** 2 + (v - cv) ** 2 + (w - cw) ** 2) * spacing
    i = min(int(cu), nx - 2)
    j = min(int(cv), ny - 2)
    k = min(int(cw), nz - 2)
    a = cu - i
    b = cv - j
    c = cw - k
    corner = start[field] + (k * ny + j) * nx + i
    if coefficients[corner] > 2.0 * margin:
        low = coefficients[corner] * (1.0 - a) + coefficients[corner + 1] * a
        low_y = coefficients[corner + nx] * (1.0 - a) + coefficients[corner + nx + 1] * a
        corner += nx * ny
        high = coefficients[corner] * (1.0 - a) + coefficients[corner + 1] * a
        high_y = coefficients[corner + nx] * (1.0 - a) + coefficients[corner + nx + 1] * a
        return (low * (1.0 - b) + low_y * b) * (1.0 - c) + (high * (1.0 - b) + high_y * b) * c + outside
    x0 = (1.0 - a) ** 3 / 6.0
    x1 = (4.0 - 6.0 * a * a + 3.0 * a * a * a) / 6.0
    x3 = a * a * a / 6.0
    x2 = 1.0 - x0 - x1 - x3
    before = _mirrored(i - 1, nx)
    after = _mirrored(i + 2, nx)
    total = 0.0
    for dk in range(4):
        kk = _mirrored(k - 1 + dk, nz)
        plane = 0.0
        for dj in range(4):
            row = start[field] + (kk * ny + _mirrored(j - 1 + dj, ny)) * nx
            plane += _weight(b, dj) * (
                x0 * coefficients[row + before]
                + x1 * coefficients[row + i]
                + x2 * coefficients[row + i + 1]
                + x3 * coefficients[row + after]
            )
        total += _weight(c, dk) * plane
    return total + outside


@kernel(inline="always")
def _weight(u, which):
    if which == 0:
        return (1.0 - u) ** 3 / 6.0
    if which == 1:
        return (4.0 - 6.0 * u * u + 3.0 * u * u * u) / 6.0
    if which == 2:
        return (1.0 + 3.0 * u + 3.0 * u * u - 3.0 * u * u * u) / 6.0
    return u * u * u / 6.0


@kernel
def _evaluate_tables(coefficients, start, size, origin, spacing, margin, points):
    values = np.empty((points.shape[0], start.shape[0]))
    for n in range(points.shape[0]):
        x, y, z = points[n, 0], points[n, 1], points[n, 2]
        for field in range(start.shape[0]):
            values[n, field] = table_value(coefficients, start, size, origin, spacing, margin, field, x, y, z)
    return values
