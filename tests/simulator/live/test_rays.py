"""Rays against analytic hits: a ball, a cube's corners and edges, and VTK's own picking ray."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from heartcase.simulator.live.rays import CutPlane, Eye, Ray, first_hit, first_hit_beside, on_plane

pyvista = pytest.importorskip("pyvista")

CENTRE = np.array([3.0, -20.0, 7.0])
RADIUS = 15.0


def sphere():
    made = pyvista.Icosphere(radius=RADIUS, center=CENTRE, nsub=2)
    return np.array(made.points, dtype=float), made.faces.reshape(-1, 4)[:, 1:]


SPHERE = sphere()


def unit(vector):
    return np.asarray(vector, dtype=float) / np.linalg.norm(vector)


@settings(max_examples=80, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), reach=st.floats(0.0, 2.0))
def test_a_ray_meets_a_ball_where_it_must(seed, reach):
    rng = np.random.default_rng(seed)
    start = CENTRE + unit(rng.normal(size=3)) * rng.uniform(1.5, 8.0) * RADIUS
    towards = CENTRE + reach * RADIUS * unit(rng.normal(size=3))
    ray = Ray(start, unit(towards - start))
    vertices, triangles = SPHERE
    hit = first_hit(ray, vertices, triangles)
    ahead = (CENTRE - start) @ ray.direction
    apart = np.linalg.norm(start + ahead * ray.direction - CENTRE)
    if apart > RADIUS:
        assert hit is None
    elif apart < 0.9 * RADIUS:
        distance = ahead - np.sqrt(RADIUS**2 - apart**2)
        assert hit.distance_mm == pytest.approx(distance, abs=0.1 * RADIUS)
        assert hit.point_mm == pytest.approx(ray.at(hit.distance_mm))
        assert hit.normal @ unit(hit.point_mm - CENTRE) > 0.96
        # What is nearest of all triangles by the plain formula, one at a time.
        assert hit.distance_mm == pytest.approx(plain_distance(ray, vertices, triangles), abs=1e-9)


def plain_distance(ray, vertices, triangles):
    """Moeller and Trumbore, Journal of Graphics Tools 2, 1997."""
    best = np.inf
    for a, b, c in vertices[triangles].astype(float):
        p = np.cross(ray.direction, c - a)
        det = (b - a) @ p
        if abs(det) < 1e-12:
            continue
        u = (ray.start_mm - a) @ p / det
        q = np.cross(ray.start_mm - a, b - a)
        v, t = ray.direction @ q / det, (c - a) @ q / det
        if u >= 0 and v >= 0 and u + v <= 1 and t > 0:
            best = min(best, t)
    return best


@pytest.mark.parametrize("target", [(0, 0, 0), (0.5, 0.5, 0.5), (0.25, 0.25, 0), (1, 0, 0.5), (0.5, 0, 0)])
def test_no_ray_slips_through_a_corner_or_an_edge(target):
    cube = pyvista.Cube(center=(0.5, 0.5, 0.5)).triangulate().clean()
    triangles = cube.faces.reshape(-1, 4)[:, 1:]
    vertices = np.array(cube.points, dtype=float)
    inside = np.array([0.5, 0.5, 0.5])
    for seed in range(200):
        rng = np.random.default_rng(seed)
        start = inside + rng.integers(-3, 4, 3) * 0.125 if seed % 2 else inside + rng.uniform(-0.3, 0.3, 3)
        if np.allclose(start, target):
            continue
        # From inside: whatever it goes to, it meets the cube.
        assert first_hit(Ray(start, unit(np.subtract(target, start))), vertices, triangles) is not None


@pytest.mark.parametrize("parallel", [False, True])
def test_a_ray_through_a_pixel_goes_where_the_picture_shows_it(parallel):
    """The plotter's own projection of places, the other way round."""
    plotter = pyvista.Plotter(off_screen=True, window_size=[320, 200])
    try:
        plotter.add_mesh(pyvista.Sphere(radius=20.0))
        camera = plotter.camera
        camera.position, camera.focal_point, camera.up = (40.0, -90.0, 30.0), (1.0, 2.0, 3.0), (0.1, 0.0, 1.0)
        camera.parallel_projection = parallel
        camera.parallel_scale = 33.0
        plotter.show(auto_close=False)
        eye = Eye(
            np.array(camera.position),
            np.array(camera.focal_point),
            np.array(camera.up),
            camera.view_angle,
            camera.parallel_scale if parallel else None,
        )
        for place in np.random.default_rng(2).uniform(-15.0, 15.0, (20, 3)):
            plotter.renderer.SetWorldPoint(*place, 1.0)
            plotter.renderer.WorldToDisplay()
            x, y, _ = plotter.renderer.GetDisplayPoint()
            ray = eye.ray(x, y, (320, 200))
            aside = np.linalg.norm(np.cross(place - ray.start_mm, ray.direction))
            assert aside < 1e-3
    finally:
        plotter.close()


def test_planes():
    ray = Ray(np.array([0.0, 0.0, 10.0]), np.array([0.0, 0.6, -0.8]))
    assert on_plane(ray, (5.0, 5.0, 2.0), (0, 0, 3.0)) == pytest.approx([0.0, 6.0, 2.0])
    assert on_plane(ray, (0.0, 0.0, 12.0), (0, 0, 1.0)) is None
    assert on_plane(ray, (1.0, 0.0, 0.0), (1.0, 0, 0)) is None
    assert first_hit(ray, np.zeros((0, 3)), np.zeros((0, 3), int)) is None


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), depth=st.floats(-0.95, 0.95))
def test_of_a_shell_that_is_cut_open_only_what_is_left_is_met(seed, depth):
    """A shell between two balls, against the plain formulas of balls and plane."""
    rng = np.random.default_rng(seed)
    normal = unit(rng.normal(size=3))
    plane = CutPlane(normal, float(normal @ CENTRE) + depth * RADIUS)
    outer, triangles = SPHERE
    inner = CENTRE + 0.6 * (outer - CENTRE)
    vertices = np.concatenate([outer, inner])
    # the inner ball is seen from its inside: its triangles are turned
    shell = np.concatenate([triangles, triangles[:, ::-1] + len(outer)])
    start = CENTRE + unit(rng.normal(size=3)) * rng.uniform(1.5, 8.0) * RADIUS
    ray = Ray(start, unit(CENTRE + rng.uniform(0.0, 1.2) * RADIUS * unit(rng.normal(size=3)) - start))
    hit = first_hit_beside(ray, vertices, shell, plane)
    slope = ray.direction @ normal
    across = (plane.offset_mm - start @ normal) / slope
    candidates = []
    for one in (outer, inner):
        ordered = triangles if one is outer else triangles[:, ::-1]
        for a, b, c in one[ordered]:
            distance = plain_distance(ray, np.array([a, b, c]), np.array([[0, 1, 2]]))
            if np.isfinite(distance) and ray.at(distance) @ normal <= plane.offset_mm:
                candidates.append(distance)
    place = ray.at(across)
    reach = np.linalg.norm(place - CENTRE) / RADIUS
    is_capped = slope < 0.0 < across and 0.601 < reach < 0.96
    if slope < 0.0 < across and (abs(reach - 0.6) < 0.04 or 0.96 <= reach < 1.01):
        return
    if is_capped:
        assert hit.triangle == -1
        assert hit.point_mm == pytest.approx(place)
        np.testing.assert_array_equal(hit.normal, normal)
    elif candidates:
        assert hit.distance_mm == pytest.approx(min(candidates), abs=1e-9)
        assert plane.keeps(hit.point_mm[None] - 1e-9 * normal)[0]
    else:
        assert hit is None


def test_a_ray_along_a_cut_plane_meets_what_is_on_its_side():
    vertices, triangles = SPHERE
    normal = np.array([0.0, 0.0, 1.0])
    ray = Ray(CENTRE - np.array([50.0, 0.3, 0.2]), np.array([1.0, 0.0, 0.0]))
    height = float(CENTRE[2])
    assert first_hit_beside(ray, vertices, triangles, CutPlane(normal, height + 1.0)).triangle >= 0
    assert first_hit_beside(ray, vertices, triangles, CutPlane(normal, height - 1.0)) is None
