"""The four-chamber, short-axis and surgeon's views: where they cut, and which way round they are seen."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from heartcase.pipeline.report.pictures import cutaway_picture, direction_letters, surface_picture
from heartcase.pipeline.report.render import camera_for
from heartcase.pipeline.report.views import CutView, four_chamber_view, places_of, short_axis_view
from heartcase.schemas.labels import default_label_table
from heartcase.schemas.landmarks import Landmark
from tests.pipeline.report.analytic_heart import CAVITIES, make_heart

TABLE = default_label_table()
NOTHING = (np.eye(3), np.array([[0, 1, 2]]), np.zeros(1, int), TABLE)
"""A surface of one triangle: enough where the landmarks tell all."""
APEX, MITRAL, TRICUSPID = (47.8, -36.2, -40.6), (0.7, 9.1, -0.6), (-19.5, -14.0, -7.4)
"""Of the adult phantom."""
MIRROR = np.array([-1.0, 1.0, 1.0])

coordinate = st.floats(-80.0, 80.0).map(lambda v: round(v, 2))
point = st.tuples(coordinate, coordinate, coordinate)


def landmarks(apex=APEX, mitral=MITRAL, tricuspid=TRICUSPID) -> tuple[Landmark, ...]:
    named = {"apex": apex, "mitral valve": mitral, "tricuspid valve": tricuspid}
    return tuple(
        Landmark(name=name, kind="point", points_mm=(tuple(place),))
        for name, place in named.items()
        if place is not None
    )


def height(view: CutView, place) -> float:
    return float((np.asarray(place) - view.plane[0]) @ view.plane[1])


def right_of(view: CutView) -> np.ndarray:
    return np.cross(view.up, view.plane[1])


@pytest.fixture(scope="module")
def heart():
    return make_heart(spacing_mm=(2.5, 2.5, 3.0))


@settings(deadline=None)
@given(point, point, point)
def test_four_chamber_plane_holds_apex_and_both_inlet_valves(apex, mitral, tricuspid):
    view = four_chamber_view(places_of(landmarks(apex, mitral, tricuspid)), *NOTHING)
    if "landmarks lie on one line" in view.source:
        sides = np.array([apex, mitral, tricuspid]) - np.array([mitral, tricuspid, apex])
        assert np.linalg.norm(np.cross(sides[0], sides[1])) <= 0.05001 * np.linalg.norm(sides, axis=1).max() ** 2
        return
    assert max(abs(height(view, place)) for place in (apex, mitral, tricuspid)) < 1e-6
    check_frame(view)
    # The viewer stands at the feet.
    assert view.plane[1] @ [0.0, -0.3, -1.0] >= 0.0


@settings(deadline=None)
@given(point, point)
def test_short_axis_plane_is_half_way_and_square_to_the_long_axis(apex, mitral):
    if np.linalg.norm(np.subtract(apex, mitral)) < 1.0:
        return
    view = short_axis_view(places_of(landmarks(apex, mitral, None)), *NOTHING)
    assert view is not None
    assert height(view, apex) == pytest.approx(-height(view, mitral))
    assert height(view, apex) == pytest.approx(np.linalg.norm(np.subtract(apex, mitral)) / 2.0)
    check_frame(view)


def check_frame(view: CutView) -> None:
    """Unit vectors, square to each other, and the patient's left as far to the right as the plane allows."""
    normal, up, right = view.plane[1], view.up, right_of(view)
    assert np.allclose([normal @ normal, up @ up, right @ right], 1.0)
    assert abs(normal @ up) < 1e-9
    if abs(normal[0]) < 0.97:
        assert abs(up[0]) < 1e-9
        assert right[0] > 0.2


def test_short_axis_shows_the_right_heart_on_the_left_of_the_picture():
    view = short_axis_view(places_of(landmarks()), *NOTHING)
    assert np.subtract(TRICUSPID, MITRAL) @ right_of(view) < -10.0
    # The front wall is above.
    assert view.up @ [0.0, -1.0, 1.0] > 0.9


def test_four_chamber_view_has_the_patients_right_on_the_left_and_the_apex_in_front():
    view = four_chamber_view(places_of(landmarks()), *NOTHING)
    assert direction_letters(right_of(view)).startswith("L")
    assert np.subtract(APEX, MITRAL) @ view.up > 10.0
    assert np.subtract(TRICUSPID, MITRAL) @ right_of(view) < -10.0


@pytest.mark.parametrize("make", [four_chamber_view, short_axis_view])
def test_a_mirrored_heart_is_seen_mirrored_with_the_same_letters(make):
    straight = make(places_of(landmarks()), *NOTHING)
    turned = make(places_of(landmarks(*(MIRROR * place for place in (APEX, MITRAL, TRICUSPID)))), *NOTHING)
    for place in (APEX, MITRAL, TRICUSPID):
        before, after = np.subtract(place, straight.plane[0]), MIRROR * place - turned.plane[0]
        assert after @ right_of(turned) == pytest.approx(-(before @ right_of(straight)))
        assert after @ turned.up == pytest.approx(before @ straight.up)
    assert direction_letters(right_of(turned)).startswith("L")
    assert direction_letters(right_of(straight)).startswith("L")


@pytest.mark.parametrize("name", ["four-chamber", "short-axis", "surgeon"])
def test_the_picture_of_a_mirrored_heart_differs_and_is_its_mirror_image(heart, name):
    def draw(sign: float) -> np.ndarray:
        surface = heart.surface
        flip = np.array([sign, 1.0, 1.0])
        faces = surface.triangles if sign > 0 else surface.triangles[:, ::-1]
        mesh = (surface.vertices_mm * flip, faces, surface.triangle_label)
        if name == "surgeon":
            # The surgeon moves to the other side with the mirror; the true one stays at the patient's right.
            return surface_picture(*mesh, heart.table, triangle_tissue=surface.triangle_tissue, view="surgeon")
        make = four_chamber_view if name == "four-chamber" else short_axis_view
        view = make({}, *mesh, heart.table)
        assert view is not None
        return cutaway_picture(*mesh, surface.triangle_tissue, heart.table, plane=view.plane, up=view.up)

    straight, turned = draw(1.0)[60:540, 60:740].astype(int), draw(-1.0)[60:540, 60:740].astype(int)
    assert np.abs(straight - turned).mean() > 5.0
    if name != "surgeon":
        # Light falls from one side and the cut's edge is a pixel wide: so the match is close, not exact.
        shapes = [(picture.min(axis=2) < 250) for picture in (straight, turned[:, ::-1])]
        assert np.mean(shapes[0] != shapes[1]) < 0.01


def test_surgeon_sees_the_head_on_the_left_and_the_patients_right_nearest(heart):
    camera = camera_for(heart.surface.vertices_mm, towards=(-0.5, -np.sqrt(0.75), 0.0), up=(1, 0, 0), size=(800, 600))
    head, feet, right, left = camera.project([(0, 0, 50), (0, 0, -50), (-50, 0, 0), (50, 0, 0)])
    assert head[0] < feet[0]
    assert right[1] > left[1]
    front, back = camera.project([(0, -50, 0), (0, 50, 0)])
    assert front[2] > back[2]


def test_without_landmarks_the_planes_are_estimated_and_say_so(heart):
    surface = heart.surface
    mesh = (surface.vertices_mm, surface.triangles, surface.triangle_label, heart.table)
    four = four_chamber_view(places_of(landmarks(None, MITRAL, None)), *mesh)
    assert four.source == (
        "Plane estimated from the shape of the chambers, as the recipe has no landmark for apex and tricuspid valve."
    )
    for value in (1, 2, 3, 4):
        centre, radii = CAVITIES[value]
        assert abs(height(four, centre)) < 0.6 * min(radii)
    short = short_axis_view({}, *mesh)
    assert "no landmark for apex and mitral valve" in short.source
    axis = np.subtract(CAVITIES[1][0], CAVITIES[3][0])
    assert short.plane[1] @ axis == pytest.approx(np.linalg.norm(axis), rel=0.01)
    assert abs(height(short, CAVITIES[1][0])) < 2.0


def test_no_short_axis_where_nothing_tells_it(heart):
    surface = heart.surface
    labels = np.where(surface.triangle_label == 3, 0, surface.triangle_label)
    mesh = (surface.vertices_mm, surface.triangles)
    assert short_axis_view({}, *mesh, labels, heart.table) is None
    assert short_axis_view({}, *mesh, surface.triangle_label, heart.table) is not None


@pytest.mark.parametrize(
    ("name", "place"),
    [
        ("Apex", "apex"),
        ("LV_apex", "apex"),
        ("left ventricular apex", "apex"),
        ("mitral annulus", "mitral valve"),
        ("Mitral valve annulus", "mitral valve"),
        ("centre of the mitral valve", "mitral valve"),
        ("left atrioventricular valve", "mitral valve"),
        ("tricuspid-valve", "tricuspid valve"),
        ("pulmonic valve", "pulmonary valve"),
        ("aortic annulus", "aortic valve"),
        ("atrial apex", None),
        ("anterior mitral leaflet", None),
        ("common atrioventricular valve", None),
        ("mitral", None),
        ("aortic arch", None),
    ],
)
def test_names_that_a_view_understands(name, place):
    found = places_of([Landmark(name=name, kind="point", points_mm=((1.0, 2.0, 3.0),))])
    assert list(found) == ([place] if place else [])
    if place:
        assert found[place].name == name


def test_a_ring_counts_with_its_middle_and_the_first_of_a_kind_counts():
    ring = Landmark(name="mitral annulus", kind="ring", points_mm=((0, 0, 0), (2, 0, 0), (1, 3, 0)))
    later = Landmark(name="mitral valve", kind="point", points_mm=((9, 9, 9),))
    assert np.allclose(places_of([ring, later])["mitral valve"].position_mm, (1, 1, 0))


def test_landmarks_on_the_cut_are_marked_where_they_are(heart):
    surface = heart.surface
    plane = (np.array([0.0, -12.0, 0.0]), np.array([0.0, -1.0, 0.0]))
    arrays = (surface.vertices_mm, surface.triangles, surface.triangle_label, surface.triangle_tissue)

    def draw(**marks):
        return cutaway_picture(*arrays, heart.table, plane=plane, marks=marks).astype(int)

    plain, marked = draw(), draw(x=(22.0, -11.0, -14.0), far=(22.0, -9.0, 30.0))
    rows, columns = np.nonzero(np.abs(plain - marked).sum(axis=2))
    assert len(rows) > 20
    assert np.ptp(rows) < 25
    other = draw(x=(42.0, -12.0, -14.0))
    shifted = np.nonzero(np.abs(plain - other).sum(axis=2))[1]
    assert shifted.min() > columns.min() + 40


def test_views_are_frozen():
    view = short_axis_view(places_of(landmarks()), *NOTHING)
    with pytest.raises(dataclasses.FrozenInstanceError):
        view.source = ""
