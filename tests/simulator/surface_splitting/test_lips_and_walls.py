"""A surface split along sheets: closed, manifold, of the same volume, whatever the sheets do."""

from __future__ import annotations

from fractions import Fraction
from unittest import mock

import numpy as np
import pytest
import pyvista
from hypothesis import example, given, settings
from hypothesis import strategies as st

from heartcase.schemas.errors import SimulationError
from heartcase.simulator.cutting.blade_sheet import Sheet
from heartcase.simulator.cutting.crossings import QUANTA
from heartcase.simulator.mesh_arrangement.arrange import NOTHING_CROSSES, crossings
from heartcase.simulator.mesh_arrangement.sheet_mesh import sheet_mesh
from heartcase.simulator.mesh_arrangement.surface_crossings import cross_surface
from heartcase.simulator.mesh_arrangement.uncut_surface import UncutSurface
from heartcase.simulator.surface_splitting import lips_and_walls
from heartcase.simulator.surface_splitting.lips_and_walls import split_mesh
from tests.simulator.surface_splitting.surfaces import box, check_closed, part_volumes, plane, sheets, volume

CUBE = box((3, 3, 3), (3.0, 3.0, 3.0))


def split(surface, blades):
    places, triangles = surface
    whole = UncutSurface.of(places, triangles)
    return split_mesh(whole, crossings(whole, blades, NOTHING_CROSSES, 0))


def volumes_of(found):
    return sorted(part_volumes(found.places, found.triangles, found.triangle_part).round(9).tolist())


boxes = st.builds(
    lambda counts, size, jitter, seed: box(counts, size, jitter=jitter, seed=seed),
    st.tuples(*[st.integers(1, 4)] * 3),
    st.tuples(*[st.integers(1, 3).map(float)] * 3),
    st.sampled_from([0.0, 0.0, 0.05, 0.2]),
    st.integers(0, 9),
)


IN_A_SIDE = [
    [[(3, 0, 0), (0, 0, 1)], [(0, 3, 3), (3, 0, 2)], [(1, 0, 0), (1, 0, 3)]],
    [[(2.5, 1.5, -1.5), (-0.5, 5.5, -1.5)], [(1.5, 1.5, -1.5), (-1.5, 5.5, -1.5)], [(3.5, -0.5, 2.5), (0.5, 3.5, 2.5)]],
    [[(4, 0, 3), (3, 0, 0)], [(4, 4, 2), (0, 0, 3)]],
]
"""Blades of which a part runs in a side of a block: what they cut off of it is as thin as nothing."""


def check_split(surface, blades):
    """The surface split along blades, after everything was checked that holds for any."""
    found = split(surface, blades)
    places, triangles = surface
    check_closed(found.weld[found.triangles])
    whole = volume(places, triangles)
    assert volume(found.places, found.triangles) == pytest.approx(whole, abs=1e-9 * max(abs(whole), 1.0))
    np.testing.assert_array_equal(found.places[found.weld], found.places)
    np.testing.assert_array_equal(found.places[: len(places)], places)
    np.testing.assert_array_equal(found.weld[: len(places)], np.arange(len(places)))
    # Lips lie on the uncut surface.
    on = np.flatnonzero(found.on_triangle >= 0)
    there = np.einsum("nc,ncx->nx", found.on_weights[on], places[triangles[found.on_triangle[on]]])
    np.testing.assert_allclose(found.places[on], there, atol=1e-9)
    # What is left of each triangle of the surface has its direction, and together with what was thrown away its area.
    a, b, c = np.moveaxis(places[triangles], 1, 0)
    wanted = np.cross(b - a, c - a)
    areas = areas_by_triangle(found, len(triangles))
    along = np.einsum("tx,tx->t", areas, wanted) / np.einsum("tx,tx->t", wanted, wanted)
    assert (along >= -1e-9).all()
    assert (along <= 1 + 1e-9).all()
    np.testing.assert_allclose(areas, along[:, None] * wanted, atol=1e-9)
    with mock.patch.object(lips_and_walls, "_NO_THICKNESS", -1.0):
        everything = split(surface, blades)
    np.testing.assert_allclose(areas_by_triangle(everything, len(triangles)), wanted, atol=1e-9)
    return found


def areas_by_triangle(found, triangle_count):
    """Twice the area, as a vector, of what each triangle of the uncut surface has in a split one."""
    p, q, r = np.moveaxis(found.places[found.triangles], 1, 0)
    kept = found.triangle_origin >= 0
    columns = np.cross(q - p, r - p)[kept].T
    return np.stack([np.bincount(found.triangle_origin[kept], one, triangle_count) for one in columns], axis=1)


@example(box((1, 1, 1), (1.0, 1.0, 1.0)), [Sheet.swept(poses) for poses in IN_A_SIDE])
@settings(max_examples=150, deadline=None)
@given(boxes, sheets())
def test_a_split_surface_is_closed_and_manifold_and_keeps_its_volume(surface, blades):
    check_split(surface, blades)


@pytest.mark.slow
@settings(max_examples=10_000, deadline=None)
@given(boxes, sheets())
def test_many_split_surfaces_are_closed(surface, blades):
    check_split(surface, blades)


@settings(max_examples=30, deadline=None)
@given(boxes, sheets(), sheets())
def test_taking_a_sheet_back_gives_the_same_bytes(surface, blades, more):
    before = split(surface, blades)
    split(surface, blades + more)
    again = split(surface, list(blades))
    for name, values in vars(before).items():
        if values is None:
            assert getattr(again, name) is None
            continue
        assert values.tobytes() == getattr(again, name).tobytes(), name
    places, triangles = surface
    none = split(surface, [])
    np.testing.assert_array_equal(none.places, places)
    np.testing.assert_array_equal(none.triangles, triangles)
    np.testing.assert_array_equal(none.triangle_origin, np.arange(len(triangles)))


MOVED = (Fraction(1, 1 << 120), Fraction(1, 1 << 40), Fraction(1, 1 << 80))
"""A real movement of the surface along x, y and z: a billionth of a billionth of a cell where it is most."""
numbers = st.integers(-4, 4).map(lambda half: half * QUANTA // 2) | st.integers(-2 * QUANTA, 2 * QUANTA)
corners = st.lists(st.tuples(numbers, numbers, numbers), min_size=3, max_size=3)


def crosses(surface, sheet) -> bool:
    """Whether two triangles cross, the surface's moved, in fractions: an edge of one goes through the other."""
    one = [[Fraction(int(x)) + m for x, m in zip(corner, MOVED, strict=True)] for corner in surface]
    other = [[Fraction(int(x)) for x in corner] for corner in sheet]

    def side(a, b, c, d):
        u, v, w = ([y - x for x, y in zip(a, e, strict=True)] for e in (b, c, d))
        return (
            u[0] * (v[1] * w[2] - v[2] * w[1]) - u[1] * (v[0] * w[2] - v[2] * w[0]) + u[2] * (v[0] * w[1] - v[1] * w[0])
        )

    def pierced(triangle, a, b):
        p, q, r = triangle
        if side(p, q, r, a) * side(p, q, r, b) >= 0:
            return False
        passing = [side(a, b, p, q), side(a, b, q, r), side(a, b, r, p)]
        return all(x > 0 for x in passing) or all(x < 0 for x in passing)

    edges = ((0, 1), (1, 2), (2, 0))
    return any(pierced(two, three[i], three[j]) for two, three in ((one, other), (other, one)) for i, j in edges)


@settings(max_examples=150, deadline=None)
@given(corners, corners)
def test_triangles_cross_as_they_do_in_fractions(surface, sheet):
    """Every kind of tie is there, as corners lie on halves."""
    mesh = sheet_mesh([Sheet(np.array([sheet], np.int64))])
    if not len(mesh.triangles):
        return
    tetrahedron = np.array([(0, 1, 2), (0, 2, 3), (0, 3, 1), (1, 3, 2)])
    places = np.array([*surface, (9 * QUANTA, 8 * QUANTA, 7 * QUANTA)]) / QUANTA
    solid = UncutSurface.of(places, tetrahedron)
    pairs, ends = np.empty((99, 2), np.int64), np.empty((99, 2), np.int64)
    count = cross_surface(
        solid.vertices,
        solid.triangles,
        solid.edges,
        solid.buckets,
        mesh.vertices,
        mesh.triangles,
        mesh.edges,
        np.arange(len(mesh.triangles)),
        pairs,
        ends,
        np.empty((99, 2, 2, 3)),
    )
    ordered = mesh.vertices[mesh.triangles[0]]
    wanted = {n for n, three in enumerate(tetrahedron) if crosses(solid.vertices[three], ordered)}
    assert set(pairs[:count, 0].tolist()) == wanted
    assert count == len(wanted)


@pytest.mark.parametrize("place", [1.3, 1.0, 1.5, 2.0, 2.999, 1 + 1 / 16])
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_plane_leaves_two_boxes(place, axis):
    found = split(CUBE, [plane(axis, place)])
    kept = round(place * QUANTA) / QUANTA
    assert volumes_of(found) == pytest.approx(sorted([9 * kept, 9 * (3 - kept)]), abs=1e-9)
    p, q, r = np.moveaxis(found.places[found.triangles[found.triangle_is_wall]], 1, 0)
    areas = np.cross(q - p, r - p) / 2
    assert np.linalg.norm(areas, axis=1).sum() == pytest.approx(18.0, abs=1e-9)
    np.testing.assert_allclose(areas.sum(axis=0), 0, atol=1e-9)


@pytest.mark.parametrize("places", [(1.3, 1.7, 1.1), (1.5, 1.5, 1.5), (1.0, 2.0, 1.0), (1.25, 1.25, 1.25)])
def test_three_planes_leave_eight_boxes(places):
    found = split(CUBE, [plane(axis, place) for axis, place in enumerate(places)])
    kept = np.round(np.array(places) * QUANTA) / QUANTA
    sides = [(one, 3 - one) for one in kept]
    wanted = sorted(a * b * c for a in sides[0] for b in sides[1] for c in sides[2])
    assert volumes_of(found) == pytest.approx(wanted, abs=1e-8)


@pytest.mark.parametrize("normal", [(1.0, 0.3, -0.2), (0.2, 1.0, 1.0), (-0.5, 0.4, 0.9)])
def test_a_sphere_is_cut_as_another_library_clips_it(normal):
    """Volumes of both parts, and the area of the cut, beside VTK's clipped and capped surface."""
    sphere = pyvista.Icosphere(radius=1.7, center=(2.0, 2.0, 2.0), nsub=3)
    places, triangles = np.array(sphere.points, float), sphere.regular_faces
    normal = np.array(normal) / np.linalg.norm(normal)
    middle = np.array([2.1, 1.9, 2.2])
    u = np.cross(normal, [0.3, -0.5, 0.8])
    u /= np.linalg.norm(u)
    v = np.cross(normal, u)
    found = split(
        (places, triangles), [Sheet.swept([[middle + 4 * (a * u + b * v) for a in (-1, 1)] for b in (-1, 1)])]
    )
    check_closed(found.weld[found.triangles])
    halves = [sphere.clip_closed_surface(normal=way * normal, origin=middle) for way in (-1, 1)]
    wanted = sorted(abs(half.volume) for half in halves)
    assert volumes_of(found) == pytest.approx(wanted, rel=2e-3)
    cut = (halves[0].area + halves[1].area - sphere.area) / 2
    p, q, r = np.moveaxis(found.places[found.triangles[found.triangle_is_wall]], 1, 0)
    assert np.linalg.norm(np.cross(q - p, r - p), axis=1).sum() / 4 == pytest.approx(cut, rel=2e-3)


def ring(radius, middle, count=12):
    angle = np.arange(count + 1) % count * 2 * np.pi / count
    return np.stack([middle[0] + radius * np.cos(angle), middle[1] + radius * np.sin(angle)], axis=1)


@pytest.mark.parametrize("counts", [(3, 3, 3), (1, 1, 1)])
def test_a_sheet_that_comes_back_to_itself_cuts_out_a_plug(counts):
    """Also where all of it goes through the inside of one triangle."""
    surface = box(counts, (3.0, 3.0, 3.0))
    around = ring(0.24, (1.1, 0.9))
    found = check_split(surface, [Sheet.swept([[(x, y, -1), (x, y, 4)] for x, y in around])])
    plug = 0.5 * 12 * np.sin(np.pi / 6) * 0.24**2 * 3
    assert volumes_of(found) == pytest.approx([plug, 27 - plug], abs=2e-3)
    open_again = check_split(surface, [Sheet.swept([[(x, y, -1), (x, y, 1.5)] for x, y in around])])
    assert volumes_of(open_again) == [27.0]


def test_a_sheet_inside_the_tissue_leaves_a_closed_gap():
    found = check_split(CUBE, [Sheet.swept([[(1.3, 1, 1), (1.3, 2, 1)], [(1.3, 1, 2), (1.3, 2, 2)]])])
    assert volumes_of(found) == [0.0, 27.0]
    assert found.triangle_is_wall.sum() == len(found.triangles) - len(CUBE[1])


@pytest.mark.parametrize("place", [0.0, 3.0, -0.5, 3.5])
def test_a_sheet_that_grazes_a_face_cuts_nothing_off(place):
    found = split(CUBE, [plane(0, place)])
    check_closed(found.weld[found.triangles])
    assert volumes_of(found) == [27.0]


def test_a_blade_that_goes_back_the_way_it_came_cuts_once():
    there, back = [(1.5, -1, -1), (1.5, 4, -1)], [(1.5, -1, 4), (1.5, 4, 4)]
    for blades in ([Sheet.swept([there, back, there])], [Sheet.swept([there, back]), Sheet.swept([back, there])]):
        found = split(CUBE, blades)
        check_closed(found.weld[found.triangles])
        assert volumes_of(found) == [13.5, 13.5]


@pytest.mark.parametrize("other", [(-1.3, 4.4, -1.1, 4.3), (1, 2, 1, 2), (-1, 4, 1, 2), (-1, 4, 1.3, 5)])
def test_a_sheet_in_the_plane_of_another_changes_nothing(other):
    def sheet(low, high, start, stop):
        return Sheet.swept([[(1.5, low, at), (1.5, high, at)] for at in (start, stop)])

    found = split(box((1, 1, 1), (3.0, 3.0, 3.0)), [sheet(-1, 4, -1, 4), sheet(*other)])
    check_closed(found.weld[found.triangles])
    assert volumes_of(found) == pytest.approx([13.5, 13.5], abs=1e-9)


def test_lips_are_one_curve_and_walls_are_laid_out_to_scale():
    found = check_split(CUBE, [Sheet.swept([[(1.3, -1, 1.6), (1.3, 4, 1.6)], [(1.3, -1, 4), (1.3, 4, 4)]])])
    lips = np.flatnonzero(found.on_triangle >= 0)
    lips = lips[found.weld[lips] == lips]
    places, counts = np.unique(found.places[lips].round(9), axis=0, return_counts=True)
    ends = np.abs(places[:, 2] - 1.6) < 1e-3
    assert (counts[~ends] == 2).all()
    assert (counts[ends] == 1).all()
    walls = found.triangles[found.triangle_is_wall]
    p, q, r = np.moveaxis(found.places[walls], 1, 0)
    a, b, c = np.moveaxis(found.flat[walls], 1, 0)
    flat = np.abs((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0])
    np.testing.assert_allclose(flat, np.linalg.norm(np.cross(q - p, r - p), axis=1), atol=2e-3)


def test_an_open_surface_is_refused():
    places, triangles = CUBE
    with pytest.raises(SimulationError, match="the surface is not closed"):
        UncutSurface.of(places, triangles[1:])
