"""Thickness of the tissue against shells and plates of known thickness."""

import numpy as np
import pytest
import trimesh

from heartcase.pipeline.mesh.triangles.thickness import (
    thickness_figures,
    triangle_normals,
    vertex_normals,
    wall_thickness_mm,
)
from heartcase.schemas.labels import default_label_table


def shell(outer: float, inner: float, *, subdivisions: int = 4) -> tuple[np.ndarray, np.ndarray]:
    """A spherical shell: the outer sphere as it is, the inner one turned inside out."""
    sphere = trimesh.creation.icosphere(subdivisions=subdivisions)
    vertices = np.concatenate([sphere.vertices * outer, sphere.vertices * inner])
    triangles = np.concatenate([sphere.faces, sphere.faces[:, ::-1] + len(sphere.vertices)])
    return vertices, triangles


@pytest.mark.parametrize(("outer", "inner"), [(30.0, 28.5), (30.0, 26.0), (30.0, 20.0), (12.0, 9.0)])
def test_shell_has_its_thickness_at_every_vertex(outer, inner):
    vertices, triangles = shell(outer, inner)
    thickness = wall_thickness_mm(vertices, triangles)
    assert np.isfinite(thickness).all()
    assert thickness.mean() == pytest.approx(outer - inner, rel=0.01)
    assert np.abs(thickness - (outer - inner)).max() < 0.02 * (outer - inner) + 0.02


def test_coarse_triangles_do_not_thicken_a_thin_wall():
    vertices, triangles = shell(30.0, 28.0, subdivisions=3)
    edge = np.linalg.norm(vertices[triangles[:, 0]] - vertices[triangles[:, 1]], axis=1)
    assert edge.mean() > 1.9 * 2.0
    # The facets of a sphere lie up to edge**2 / (6 R) inside it.
    sag = edge.max() ** 2 / (6.0 * 28.0)
    thickness = wall_thickness_mm(vertices, triangles)
    assert np.abs(np.median(thickness) - 2.0) < sag


def test_rough_surface_is_not_taken_for_a_thin_wall():
    vertices, triangles = shell(30.0, 25.0)
    radius = np.linalg.norm(vertices, axis=1)
    rough = vertices * (1.0 + np.random.default_rng(3).normal(0.0, 0.08, len(vertices)) / radius)[:, None]
    thickness = wall_thickness_mm(rough, triangles)
    assert np.percentile(thickness, 2) > 4.0
    assert np.median(thickness) == pytest.approx(5.0, abs=0.25)


def test_solid_ball_is_as_thick_as_its_diameter_and_nan_beyond_the_largest():
    ball = trimesh.creation.icosphere(subdivisions=4, radius=10.0)
    thickness = wall_thickness_mm(ball.vertices, ball.faces, largest_mm=25.0)
    assert np.nanmedian(thickness) == pytest.approx(20.0, rel=0.02)
    assert np.isnan(wall_thickness_mm(ball.vertices, ball.faces, largest_mm=15.0)).all()


def test_cut_faces_are_no_side_of_a_wall():
    tube = trimesh.creation.annulus(r_min=10.0, r_max=13.0, height=8.0, sections=96).subdivide_to_size(1.2)
    normals = tube.face_normals
    is_cut = np.abs(normals[:, 2]) > 0.9
    thickness = wall_thickness_mm(tube.vertices, tube.faces, normals=radial(tube.vertices), triangle_is_cut=is_cut)
    on_sides = np.unique(tube.faces[~is_cut])
    only_cut = np.setdiff1d(np.arange(len(tube.vertices)), on_sides)
    assert len(only_cut) > 100
    assert np.isnan(thickness[only_cut]).all()
    assert np.abs(thickness[on_sides] - 3.0).max() < 0.06


def radial(vertices: np.ndarray) -> np.ndarray:
    """Normals of the tube's sides: outwards on the outer one, inwards on the inner one."""
    radius = np.linalg.norm(vertices[:, :2], axis=1)
    unit = np.column_stack([vertices[:, :2] / radius[:, None], np.zeros(len(vertices))])
    return np.where((radius > 11.5)[:, None], unit, -unit)


def test_figures_are_weighted_by_area():
    table = default_label_table().with_walls()
    big, small = 9, table.wall_value(2)
    vertices = np.array([[0, 0, 0], [30, 0, 0], [0, 30, 0], [0, 0, 5], [10, 0, 5], [0, 10, 5.0]])
    triangles = np.array([[0, 1, 2], [3, 4, 5], [3, 5, 4]])
    thickness = np.array([8.0, 8.0, 8.0, 4.0, 4.0, 4.0])
    figures = thickness_figures(thickness, vertices, triangles, np.array([big, small, big]), table)
    assert [one.label for one in figures] == [9, small]
    assert figures[0].area_cm2 == pytest.approx((450.0 + 50.0) / 100.0)
    assert figures[0].mean_mm == pytest.approx((8.0 * 450.0 + 4.0 * 50.0) / 500.0)
    assert figures[0].p50_mm == 8.0
    assert figures[0].p5_mm == 4.0
    assert figures[1].p95_mm == 4.0


def test_normals_agree_with_an_independent_library():
    mesh = trimesh.creation.torus(major_radius=20.0, minor_radius=6.0)
    normals, areas = triangle_normals(mesh.vertices, mesh.faces)
    assert np.allclose(normals, mesh.face_normals, atol=1e-9)
    assert np.allclose(areas, mesh.area_faces)
    centre = mesh.vertices * [1.0, 1.0, 0.0]
    centre *= 20.0 / np.linalg.norm(centre, axis=1)[:, None]
    true = (mesh.vertices - centre) / 6.0
    assert (vertex_normals(mesh.vertices, mesh.faces) * true).sum(axis=1).min() > 0.995
