"""Drawing a coloured triangle mesh into a picture, off screen.

A small depth-buffer rasteriser draws, because it needs nothing of the machine and gives the same bytes everywhere.
VTK can draw the same picture, with the same camera and lights; but on a machine without a screen it needs a working
OpenGL library for that, and where there is none it does not raise an error: it ends the whole program.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt
from scipy.ndimage import gaussian_filter

from heartcase.compiling.kernel import kernel
from heartcase.schemas.arrays import Float64, Int64, UInt8

__all__ = ["Camera", "Mesh", "camera_for", "downsampled", "draw_mesh"]


_KEY_LIGHT = np.array((-0.45, 0.55, 0.70)) / np.linalg.norm((-0.45, 0.55, 0.70))
_KEY, _FILL, _AMBIENT = 0.55, 0.40, 0.28
_SHINE, _SHINE_POWER = 0.12, 24.0
_OVERSAMPLING = 2
_SLACK = 1e-9
_SHADE_MM, _SHADE_PER_MM, _SHADE_DARKEST, _SHADE_STEP = 3.0, 0.07, 0.6, 4


@dataclass(frozen=True)
class Mesh:
    """Triangles to draw, seen from both sides."""

    points_mm: Float64
    """Points, shape (point_count, 3)."""
    triangles: Int64
    """Point numbers, shape (triangle_count, 3)."""
    normals: Float64
    """Unit normal of each point, shape (point_count, 3)."""
    colours: UInt8
    """RGB of each triangle, shape (triangle_count, 3), or of each point, shape (point_count, 3)."""
    colours_of_points: bool = False
    """Whether ``colours`` belongs to the points."""


@dataclass(frozen=True)
class Camera:
    """A parallel projection: every length across the picture is true."""

    centre_mm: Float64
    """World point in the middle of the picture."""
    right: Float64
    """Unit vector towards the right of the picture."""
    up: Float64
    """Unit vector towards the top of the picture."""
    mm_per_pixel: float
    """Size of a pixel, mm."""
    size: tuple[int, int]
    """Width and height, pixels."""

    @property
    def towards(self) -> Float64:
        """Unit vector towards the viewer."""
        return np.cross(self.right, self.up)

    def project(self, points_mm: npt.ArrayLike) -> Float64:
        """Column, row (pixel centres at whole numbers) and height towards the viewer in mm, shape (..., 3)."""
        local = (np.asarray(points_mm, dtype=float) - self.centre_mm) @ np.stack(
            [self.right, self.up, self.towards], axis=1
        )
        width, height = self.size
        column = local[..., 0] / self.mm_per_pixel + (width - 1) / 2.0
        row = -local[..., 1] / self.mm_per_pixel + (height - 1) / 2.0
        return np.stack([column, row, local[..., 2]], axis=-1)

    def oversampled(self, factor: int) -> Camera:
        """The same view with ``factor`` times as many pixels each way."""
        width, height = self.size
        return Camera(
            self.centre_mm, self.right, self.up, self.mm_per_pixel / factor, (width * factor, height * factor)
        )


def camera_for(
    points_mm: npt.ArrayLike, *, towards: npt.ArrayLike, up: npt.ArrayLike, size: tuple[int, int], margin: float = 0.08
) -> Camera:
    """A camera that sees all points, with a margin as a fraction of the picture.

    Parameters
    ----------
    points_mm
        Points that must be in the picture, shape (n, 3).
    towards
        Direction from the object to the viewer; any length.
    up
        Direction that shows upwards; made perpendicular to ``towards``.
    size
        Width and height, pixels.
    margin
        Part of the picture to leave free at each edge.
    """
    points = np.asarray(points_mm, dtype=float)
    view = np.asarray(towards, dtype=float) / np.linalg.norm(towards)
    upward = np.asarray(up, dtype=float) - np.dot(up, view) * view
    upward /= np.linalg.norm(upward)
    right = np.cross(upward, view)
    axes = np.stack([right, upward, view])
    local = points @ axes.T
    low, high = local.min(axis=0), local.max(axis=0)
    free = 1.0 - 2.0 * margin
    extent = np.maximum(high - low, 1e-6)
    mm_per_pixel = max(extent[0] / (size[0] * free), extent[1] / (size[1] * free))
    return Camera(axes.T @ ((low + high) / 2.0), right, upward, float(mm_per_pixel), size)


def draw_mesh(
    mesh: Mesh, camera: Camera, *, depth_shading: bool = False, backend: Literal["software", "vtk"] = "software"
) -> UInt8:
    """Draw a mesh on white.

    Parameters
    ----------
    mesh
        What to draw.
    camera
        From where.
    depth_shading
        Darken what lies behind its surroundings, so that overlapping parts stand apart (software only).
    backend
        ``vtk`` only where OpenGL is known to work.

    Returns
    -------
    UInt8
        RGB picture, shape (height, width, 3).
    """
    fine = camera.oversampled(_OVERSAMPLING)
    if len(mesh.triangles) == 0:
        picture = np.full((fine.size[1], fine.size[0], 3), 255, np.uint8)
    else:
        picture = _draw_with_vtk(mesh, fine) if backend == "vtk" else _draw_in_software(mesh, fine, depth_shading)
    return downsampled(picture, _OVERSAMPLING)


def downsampled(picture: UInt8, factor: int) -> UInt8:
    """Mean of each block of ``factor`` x ``factor`` pixels."""
    means: UInt8 = _means(np.ascontiguousarray(picture), factor)
    return means


@kernel
def _means(picture, factor):
    height, width, channels = picture.shape
    means = np.empty((height // factor, width // factor, channels), np.uint8)
    for row in range(height // factor):
        for column in range(width // factor):
            for channel in range(channels):
                total = 0
                for down in range(factor):
                    for across in range(factor):
                        total += picture[row * factor + down, column * factor + across, channel]
                means[row, column, channel] = np.uint8(np.rint(total / (factor * factor)))
    return means


def _draw_with_vtk(mesh: Mesh, camera: Camera) -> UInt8:
    import pyvista

    data = pyvista.PolyData.from_regular_faces(mesh.points_mm.astype(np.float32), mesh.triangles)
    data.point_data.active_normals = mesh.normals.astype(np.float32)
    (data.point_data if mesh.colours_of_points else data.cell_data)["colour"] = mesh.colours
    with _window_without_screen():
        plotter = pyvista.Plotter(off_screen=True, window_size=list(camera.size), lighting="none")
        try:
            plotter.set_background("white")
            actor = plotter.add_mesh(data, scalars="colour", rgb=True, show_scalar_bar=False)
            look = actor.prop
            look.interpolation = "Phong"
            look.ambient, look.diffuse, look.specular, look.specular_power = _AMBIENT, 1.0, _SHINE, _SHINE_POWER
            for position, strength in ((_KEY_LIGHT, _KEY), (np.array((0.0, 0.0, 1.0)), _FILL)):
                light = pyvista.Light(light_type="camera light", intensity=strength)
                light.position, light.focal_point = tuple(position), (0.0, 0.0, 0.0)
                plotter.add_light(light)
            depth = 10.0 + float(np.abs(mesh.points_mm - camera.centre_mm).max()) * 2.0
            view = plotter.camera
            view.focal_point = camera.centre_mm
            view.position = camera.centre_mm + depth * camera.towards
            view.up = camera.up
            view.parallel_projection = True
            view.parallel_scale = 0.5 * camera.size[1] * camera.mm_per_pixel
            view.clipping_range = (0.01 * depth, 2.0 * depth)
            picture: UInt8 = np.ascontiguousarray(plotter.screenshot(return_img=True)[..., :3])
        finally:
            plotter.close()
    return picture


@contextmanager
def _window_without_screen() -> Iterator[None]:
    """Make VTK take EGL at once where there is no screen, instead of complaining of the missing X server first."""
    variable = "VTK_DEFAULT_OPENGL_WINDOW"
    if sys.platform != "linux" or os.environ.get("DISPLAY") or variable in os.environ:
        yield
        return
    os.environ[variable] = "vtkEGLRenderWindow"
    try:
        yield
    finally:
        del os.environ[variable]


def _draw_in_software(mesh: Mesh, camera: Camera, depth_shading: bool) -> UInt8:
    axes = np.stack([camera.right, camera.up, camera.towards], axis=1)
    width, height = camera.size
    picture = np.full((height, width, 3), 255, np.uint8)
    depth = np.full((height, width), -np.inf)
    owner = np.zeros((height, width), np.int32)
    points, triangles = camera.project(mesh.points_mm), np.ascontiguousarray(mesh.triangles, dtype=np.int64)
    _rasterise(points, triangles, depth, owner)
    _light_up(
        points,
        mesh.normals @ axes,
        triangles,
        np.ascontiguousarray(mesh.colours),
        mesh.colours_of_points,
        _KEY_LIGHT,
        depth,
        owner,
        picture,
    )
    if depth_shading:
        _shade_by_depth(picture, depth, camera.mm_per_pixel)
    return picture


def _shade_by_depth(picture: UInt8, depth: Float64, mm_per_pixel: float) -> None:
    """Darken pixels that lie behind the mean depth around them.

    Luft, Colditz and Deussen, Image enhancement by unsharp masking the depth buffer, ACM Transactions on Graphics
    25, 2006.
    """
    coarse = depth[::_SHADE_STEP, ::_SHADE_STEP]
    seen = np.isfinite(coarse)
    reach = _SHADE_MM / (mm_per_pixel * _SHADE_STEP)
    weight = gaussian_filter(seen.astype(float), reach)
    around = gaussian_filter(np.where(seen, coarse, 0.0), reach) / np.maximum(weight, 1e-3)
    _darken(picture, depth, around)


@kernel
def _darken(picture, depth, around):
    """Dim each drawn pixel of ``picture`` by how far it lies behind ``around``, its coarse surroundings."""
    height, width = depth.shape
    for row in range(height):
        for column in range(width):
            behind = around[row // _SHADE_STEP, column // _SHADE_STEP] - depth[row, column]
            if np.isfinite(depth[row, column]) and behind > 0.0:
                light = max(1.0 - _SHADE_PER_MM * behind, _SHADE_DARKEST)
                for channel in range(3):
                    picture[row, column, channel] = np.uint8(np.rint(picture[row, column, channel] * light))


@kernel(inline="always")
def _weights(points, triangle, column, row):
    """Barycentric coordinates of a pixel's centre."""
    a, b, c = triangle
    ax, ay, bx, by, cx, cy = points[a, 0], points[a, 1], points[b, 0], points[b, 1], points[c, 0], points[c, 1]
    area = (bx - ax) * (cy - ay) - (cx - ax) * (by - ay)
    wa = ((bx - column) * (cy - row) - (cx - column) * (by - row)) / area
    wb = ((cx - column) * (ay - row) - (ax - column) * (cy - row)) / area
    return wa, wb, 1.0 - wa - wb


@kernel
def _rasterise(points, triangles, depth, owner):
    """Find the nearest triangle at each pixel: its height in ``depth`` and its number in ``owner``."""
    height, width = depth.shape
    for t in range(len(triangles)):
        a, b, c = triangles[t]
        ax, ay, bx, by, cx, cy = points[a, 0], points[a, 1], points[b, 0], points[b, 1], points[c, 0], points[c, 1]
        area = (bx - ax) * (cy - ay) - (cx - ax) * (by - ay)
        if area == 0.0:
            continue
        az, bz, cz = points[a, 2], points[b, 2], points[c, 2]
        first_row = max(0, int(np.ceil(min(ay, by, cy))))
        last_row = min(height - 1, int(np.floor(max(ay, by, cy))))
        first_column = max(0, int(np.ceil(min(ax, bx, cx))))
        last_column = min(width - 1, int(np.floor(max(ax, bx, cx))))
        # The weights of the corners, which are linear in column and row.
        a_column, b_column = (by - cy) / area, (cy - ay) / area
        a_row, b_row = (cx - bx) / area, (ax - cx) / area
        z_column = a_column * (az - cz) + b_column * (bz - cz)
        for row in range(first_row, last_row + 1):
            wa = a_column * (first_column - cx) + a_row * (row - cy)
            wb = b_column * (first_column - cx) + b_row * (row - cy)
            z = cz + wa * (az - cz) + wb * (bz - cz)
            for step in range(last_column - first_column + 1):
                # A pixel on the side of two triangles is given to both rather than to none.
                if (
                    wa + step * a_column >= -_SLACK
                    and wb + step * b_column >= -_SLACK
                    and 1.0 - wa - wb - step * (a_column + b_column) >= -_SLACK
                ):
                    here = z + step * z_column
                    if here > depth[row, first_column + step]:
                        depth[row, first_column + step] = here
                        owner[row, first_column + step] = t


@kernel(inline="always")
def _shine(cosine):
    """A positive cosine to the power of 24."""
    third = cosine * cosine * cosine
    sixth = third * third
    twelfth = sixth * sixth
    return twelfth * twelfth


@kernel
def _light_up(points, normals, triangles, colours, colours_of_points, key_light, depth, owner, picture):
    """Colour each drawn pixel of ``picture`` as its triangle, lit by the interpolated normal."""
    height, width = depth.shape
    for row in range(height):
        for column in range(width):
            if depth[row, column] == -np.inf:
                continue
            t = owner[row, column]
            a, b, c = triangles[t]
            wa, wb, wc = _weights(points, triangles[t], column, row)
            nx = wa * normals[a, 0] + wb * normals[b, 0] + wc * normals[c, 0]
            ny = wa * normals[a, 1] + wb * normals[b, 1] + wc * normals[c, 1]
            nz = wa * normals[a, 2] + wb * normals[b, 2] + wc * normals[c, 2]
            length = np.sqrt(nx * nx + ny * ny + nz * nz)
            if nz < 0.0:
                length = -length
            if length != 0.0:
                nx, ny, nz = nx / length, ny / length, nz / length
            key = max(0.0, nx * key_light[0] + ny * key_light[1] + nz * key_light[2])
            reflected = max(0.0, 2.0 * key * nz - key_light[2])
            light = _AMBIENT + _KEY * key + _FILL * nz
            shine = 255.0 * _SHINE * (_KEY * _shine(reflected) + _FILL * _shine(max(0.0, 2.0 * nz * nz - 1.0)))
            for channel in range(3):
                if colours_of_points:
                    base = wa * colours[a, channel] + wb * colours[b, channel] + wc * colours[c, channel]
                else:
                    base = float(colours[t, channel])
                picture[row, column, channel] = np.uint8(min(255.0, base * light + shine))
