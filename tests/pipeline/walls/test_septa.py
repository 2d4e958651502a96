"""Septa that are grown where cavities touch, against planes and balls, a plain oracle, and what a recipe says."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st
from scipy.ndimage import label as pieces_of

from heartcase.pipeline.artifacts.serialise import artifact_from_bytes, artifact_to_bytes
from heartcase.pipeline.bundle.assembly import labels_of
from heartcase.pipeline.checks.openings import Verdict, find_openings, opening_figures
from heartcase.pipeline.data import Reshaping, Segmentation, Septum, Structures
from heartcase.pipeline.edits.apply_edits import apply_edits
from heartcase.pipeline.fields.layout import ALL_FIELDS
from heartcase.pipeline.fields.reader import FieldReader, ownership_at_points, ownership_on_lattice
from heartcase.pipeline.fields.shapes import distance_on_lattice
from heartcase.pipeline.mesh.build_surface import build_surface
from heartcase.pipeline.walls.grow_walls import grow_walls
from heartcase.pipeline.walls.septa import ADULT_MM, OpenPlace, open_places, pairs_kept_apart, septum_thickness_mm
from heartcase.pipeline.warnings import WarningGrade
from heartcase.schemas.bundle.surface_kinds import SurfaceKind
from heartcase.schemas.errors import StageError
from heartcase.schemas.labels import Label, LabelTable, Role
from heartcase.schemas.landmarks import Landmark
from heartcase.schemas.recipe.edit_settings import SeptalDefect
from heartcase.schemas.recipe.settings import SeptumThickness, Stroke, SurfaceSettings, WallsSettings
from tests.pipeline.lattices import LATTICES, directions, lattice, points_of

LEFT, RIGHT, VENTRICLE, MUSCLE = 1, 2, 3, 4
RADIUS_MM, WALL_MM, SEPTUM_MM = 13.0, 2.0, 1.2
NORMAL = directions(1, seed=7)[0]
ATRIA = ("left atrium", "right atrium")


def table_of(first=ATRIA[0], second=ATRIA[1], third="left ventricle", *, wall_mm=WALL_MM) -> LabelTable:
    return LabelTable(
        labels=(
            *(
                Label(value=value, name=name, role=Role.BLOOD, wall_thickness_mm=wall_mm)
                for value, name in ((LEFT, first), (RIGHT, second), (VENTRICLE, third))
            ),
            Label(value=MUSCLE, name="myocardium", role=Role.MYOCARDIUM),
        )
    )


def thick(mm=SEPTUM_MM, pair=ATRIA, **more) -> WallsSettings:
    return WallsSettings(septum=(SeptumThickness(between=pair, thickness_mm=mm),), **more)


def halves(kind="even", normal=NORMAL, *, walls=None, gap_mm=0.0, table=None, places=(), radius=RADIUS_MM):
    """A ball that a plane divides into two atria."""
    geometry = lattice(kind, 36.0)
    points = points_of(geometry)
    height = points @ normal
    labels = np.where(height < 0.0, LEFT, RIGHT)
    labels[(np.abs(height) < 0.5 * gap_mm) | (np.linalg.norm(points, axis=-1) > radius)] = 0
    segmentation = Segmentation(labels.astype(np.uint8), geometry, table or table_of())
    return grow_walls(segmentation, walls or thick(), (), open_places=places)


def owners(structures, points):
    found = ownership_at_points(structures, points)
    return np.where(found.tissue_mm < 0.0, found.tissue_label, found.void_label)


def across(normal, u=0.0, v=0.0, *, reach=4.0, step=0.01):
    """Points along a normal, through a point of the plane, and their heights."""
    side = np.cross(normal, np.eye(3)[np.argmin(np.abs(normal))])
    side /= np.linalg.norm(side)
    heights = np.arange(-reach, reach, step)
    return heights, u * side + v * np.cross(normal, side) + heights[:, None] * normal


def unexpected(structures, **stated):
    openings = find_openings(structures, labels_of(structures), **stated)
    return [one for one in openings if one.verdict is Verdict.UNEXPECTED]


@pytest.mark.parametrize("kind", LATTICES)
@pytest.mark.parametrize("thickness", [0.8, 2.0])
def test_a_plane_contact_gets_a_septum_of_its_thickness_to_both_sides(kind, thickness):
    structures = halves(kind, walls=thick(thickness))
    (septum,) = structures.septa
    errors, middles = [], []
    for u, v in ((0.0, 0.0), (5.0, 0.0), (-3.0, 6.0), (0.0, -8.0)):
        heights, points = across(NORMAL, u, v)
        inside = owners(structures, points) == septum.value
        errors.append(0.01 * inside.sum() - thickness)
        middles.append(heights[inside].mean())
    # as walls: a voxel is 1.5 to 3 mm
    assert np.abs(errors).mean() < 0.1
    assert np.abs(errors).max() < 0.25
    assert np.abs(middles).max() < 0.35
    assert unexpected(structures) == []


@pytest.mark.parametrize("kind", LATTICES)
def test_without_it_the_two_are_open_to_each_other_and_the_bytes_are_those_of_no_septum(kind):
    plain = halves(kind, walls=WallsSettings(septa="as segmented"))
    (one,) = unexpected(plain)
    assert one.area_mm2 > 0.8 * np.pi * RADIUS_MM**2
    assert plain.septa == ()
    content = artifact_to_bytes(plain)
    assert b"septa" not in content
    assert b"septum_of" not in content


@pytest.mark.parametrize("kind", LATTICES)
@pytest.mark.parametrize("wall_mm", [2.0, 0.0])
def test_no_slit_is_left_where_the_septum_meets_the_grown_walls(kind, wall_mm):
    structures = halves(kind, table=table_of(wall_mm=wall_mm))
    geometry = structures.geometry.refined(4)
    owner = ownership_on_lattice(structures, geometry)
    blood = (owner.tissue_mm > 0.0) & (owner.void_label > 0)
    pieces, _ = pieces_of(blood)
    inside = owner.void_label
    sides = [set(np.unique(pieces[blood & (inside == value)])) for value in (LEFT, RIGHT)]
    assert not sides[0] & sides[1]
    if wall_mm:
        assert not any("gap" in line.text or "open to the outside" in line.text for line in structures.warnings)


@pytest.mark.parametrize("gap", [0.0, 0.5, 1.0, 1.5, 2.0, 3.0, 4.0])
def test_nothing_is_open_between_touching_and_nearly_touching(gap):
    """The plane leans against the voxels, so that the gap is there in some of them and not in others."""
    normal = np.array([0.97, 0.2, 0.14]) / np.linalg.norm([0.97, 0.2, 0.14])
    structures = halves("even", normal, gap_mm=gap, walls=thick(1.6))
    assert unexpected(structures) == []
    for u, v in np.random.default_rng(3).uniform(-6.0, 6.0, (60, 2)):
        _, points = across(normal, u, v, reach=6.0, step=0.02)
        found = owners(structures, points)
        tissue = 0.02 * (~np.isin(found, (LEFT, RIGHT))).sum()
        assert tissue > 0.5 * 1.6


def test_a_septum_that_was_seen_stays_as_it_is():
    seen = halves(gap_mm=4.0, walls=thick(2.0))
    assert seen.septa == ()
    plain = halves(gap_mm=4.0, walls=WallsSettings(septa="as segmented"))
    assert artifact_to_bytes(seen) == artifact_to_bytes(plain)


def test_a_valve_beside_a_septum_is_narrowed_by_half_its_thickness_at_most():
    """A ball of three: a ventricle below, two atria above; the left one opens into the ventricle."""
    geometry = lattice("even", 36.0)
    points = points_of(geometry)
    x, z = points[..., 0], points[..., 2]
    labels = np.select([z < 0.0, x < 0.0], [VENTRICLE, LEFT], RIGHT)
    labels[np.linalg.norm(points, axis=-1) > RADIUS_MM] = 0
    segmentation = Segmentation(labels.astype(np.uint8), geometry, table_of())
    pairs = (ATRIA, ("right atrium", "left ventricle"))
    walls = WallsSettings(septum=tuple(SeptumThickness(between=pair, thickness_mm=2.0) for pair in pairs))
    structures = grow_walls(segmentation, walls, ())
    (valve,) = find_openings(structures, labels_of(structures))
    assert valve.verdict is Verdict.EXPECTED
    across_valve = np.arange(-8.0, 8.0, 0.02)
    line = np.stack([across_valve, np.zeros_like(across_valve), np.full_like(across_valve, valve.center_mm[2])], axis=1)
    above = owners(structures, line + np.array([0.0, 0.0, 5.0]))
    septum = across_valve[~np.isin(above, (LEFT, RIGHT))].mean()
    beside = [owners(structures, line + np.array([0.0, 0.0, dz])) for dz in (-0.4, 0.4)]
    is_open = (beside[0] == VENTRICLE) & (beside[1] == LEFT)
    assert across_valve[is_open].max() == pytest.approx(septum - 1.0, abs=0.35)
    # the corner where the three meet holds no slit
    assert not (np.isin(beside[0], (LEFT, VENTRICLE)) & (beside[1] == RIGHT)).any()


def ring(radius, at=(0.0, 0.0, 0.0), name="ASD"):
    return Landmark(name=name, kind="ring", points_mm=(at,), axis=tuple(NORMAL), radius_mm=radius)


def two_strokes(radius, at=(0.0, 0.0, 0.0), apart=0.0):
    middle = np.array(at)
    ends = [
        (middle + side * np.array([8.0, apart])[0] * NORMAL, middle + side * 0.5 * apart * NORMAL) for side in (-1, 1)
    ]
    return tuple(
        Stroke(label=name, radius_mm=radius, points_mm=tuple(tuple(float(v) for v in point) for point in line))
        for name, line in zip(ATRIA, ends, strict=True)
    )


@pytest.mark.parametrize("radius", [2.0, 4.0])
@pytest.mark.parametrize("how", ["ring", "strokes", "edit"])
@pytest.mark.parametrize("kind", ["even", "oblique"])
def test_a_stated_defect_stays_open_as_wide_as_it_is_stated(radius, how, kind):
    landmarks = (ring(radius),) if how == "ring" else ()
    strokes = two_strokes(radius) if how == "strokes" else ()
    edits = (
        [SeptalDefect(kind="septal_defect", position_mm=(0.0, 0.0, 0.0), axis=tuple(NORMAL), diameter_mm=2.0 * radius)]
        if how == "edit"
        else []
    )
    structures = halves(kind, places=open_places(strokes, landmarks, table_of()))
    structures = apply_edits(structures, edits)
    (one,) = find_openings(structures, labels_of(structures), edits, landmarks, strokes=strokes)
    assert one.verdict is Verdict.STATED
    assert one.diameter_mm == pytest.approx(2.0 * radius, abs=0.45)
    assert np.linalg.norm(one.center_mm) < 1.5
    # where the hole lies, for who looks through it: figures of incisions make a ring of it
    (figure,) = opening_figures([one])
    assert abs(np.dot(figure["axis"], NORMAL)) > 0.97
    assert np.linalg.norm(figure["middle_mm"]) < 1.0


@pytest.mark.parametrize("how", ["ring", "strokes"])
def test_a_stated_opening_is_no_part_of_the_wall_that_is_told(how):
    radius, at = 4.0, tuple(float(v) for v in across(NORMAL, 2.0, 1.0)[1][400])
    landmarks = (ring(radius, at),) if how == "ring" else ()
    strokes = two_strokes(radius, at) if how == "strokes" else ()
    whole, structures = halves(), halves(places=open_places(strokes, landmarks, table_of()))
    (of_whole,), (figure,) = whole.quality["septa"], structures.quality["septa"]
    assert of_whole["area_mm2"] - figure["area_mm2"] == pytest.approx(np.pi * radius**2, rel=0.15)
    # The place is one of a wall, on the side where the most of it is, and not in the hole.
    (place,) = told_of(structures).places_mm
    assert place == tuple(figure["center_mm"])
    assert np.linalg.norm(np.subtract(place, at)) > radius - 0.5
    owner = owners(structures, np.array(place) + np.linspace(-0.6, 0.6, 61)[:, None] * NORMAL)
    assert figure["label"] in owner
    assert set(owners(structures, np.array(at) + np.linspace(-0.6, 0.6, 61)[:, None] * NORMAL)) <= {LEFT, RIGHT}
    assert f"over {figure['area_mm2']:.0f} mm²" in told_of(structures).text


@pytest.mark.parametrize("beyond_mm", [2.0, -0.5])
def test_nothing_is_told_where_the_stated_opening_is_all_of_the_contact(beyond_mm):
    """Not of a rim narrower than a voxel either; of a wider one is."""
    structures = halves(places=open_places((), (ring(RADIUS_MM + beyond_mm),), table_of()))
    assert len(structures.septa) == 1
    assert "septa" not in structures.quality
    assert not any("grown where two outlines touch" in line.text for line in structures.warnings)
    wider = halves(places=open_places((), (ring(RADIUS_MM - 4.0),), table_of()))
    rim = np.pi * (RADIUS_MM**2 - (RADIUS_MM - 4.0) ** 2)
    assert wider.quality["septa"][0]["area_mm2"] == pytest.approx(rim, rel=0.25)


def test_an_opening_of_two_other_cavities_takes_nothing_away():
    place = OpenPlace("strokes", ((0.0, 0.0, 0.0),), 5.0, (RIGHT, VENTRICLE))
    assert halves(places=(place,)).quality["septa"] == halves().quality["septa"]


@pytest.mark.parametrize(
    ("shape", "points"),
    [
        ("strokes", ((1.0, 2.0, -3.0),)),
        ("strokes", ((1.0, 2.0, -3.0), (6.0, -4.0, 2.0), (6.0, -4.0, 2.0), (-8.0, 1.0, 5.0))),
        ("cylinder", ((-4.0, 1.0, -3.0), (5.0, 3.0, 6.0))),
    ],
)
def test_what_an_open_place_holds_is_where_its_shape_cuts_the_septum(shape, points):
    geometry = lattice("oblique", 30.0)
    distance = distance_on_lattice(Reshaping(shape, points, 3.3, (), ()), geometry)
    place = OpenPlace(shape, points, 3.3)
    for margin in (0.0, 1.0) if shape == "strokes" else (0.0,):
        held = place.holds(points_of(geometry).reshape(-1, 3), margin).reshape(geometry.shape)
        clear = np.abs(distance - margin) > 1e-9
        np.testing.assert_array_equal(held[clear], (distance < margin)[clear])
        assert 20 < held.sum() < held.size / 2


def told_of(structures):
    (warning,) = (line for line in structures.warnings if "grown where two outlines touch" in line.text)
    return warning


def test_several_grown_walls_are_listed_the_largest_first():
    """A ball in three parts: an eighth, the rest of a half, and the other half."""
    geometry = lattice("even", 36.0)
    x, y, z = np.moveaxis(points_of(geometry), -1, 0)
    labels = np.where(x < 0.0, LEFT, np.where((y < 0.0) & (z < 0.0), VENTRICLE, RIGHT))
    labels[x**2 + y**2 + z**2 > RADIUS_MM**2] = 0
    table = table_of("aorta", "superior vena cava", "left atrial appendage")
    structures = grow_walls(Segmentation(labels.astype(np.uint8), geometry, table), WallsSettings(), ())
    warning = told_of(structures)
    assert warning.code == "grown-septum"
    places = [tuple(one["center_mm"]) for one in structures.quality["septa"]]
    areas = [one["area_mm2"] for one in structures.quality["septa"]]
    assert list(warning.places_mm) == places
    assert len(warning.listed) == len(places) == 3
    assert areas == sorted(areas, reverse=True)
    for listed, figure in zip(warning.listed, structures.quality["septa"], strict=True):
        assert listed.startswith(f"{' and '.join(figure['between'])} over {figure['area_mm2']:.0f} mm² near (")
    assert warning.parts.listed == warning.listed
    assert warning.parts.lead.endswith("a heart does not join these:")
    assert warning.parts.rest.startswith("If the patient has an opening there, say so")


def test_strokes_that_do_not_meet_open_nothing():
    assert open_places(two_strokes(2.0, apart=5.0), (), table_of()) == ()
    assert len(open_places(two_strokes(2.0, apart=1.0), (), table_of())) == 2
    assert open_places((), (ring(3.0, name="fossa"),), table_of()) == ()


def test_a_pair_that_is_connected_stays_open_and_is_stated():
    structures = halves(walls=WallsSettings(connected=(ATRIA,)))
    assert structures.septa == ()
    (one,) = find_openings(structures, labels_of(structures), connected=(ATRIA,))
    assert (one.verdict, one.stated_by) == (Verdict.STATED, "walls.connected")


def test_a_pair_that_the_vocabulary_does_not_know_is_divided_where_the_recipe_says_so():
    table = table_of("venous chamber", "outlet chamber")
    assert halves(walls=WallsSettings(), table=table).septa == ()
    (septum,) = halves(walls=thick(1.5, ("outlet chamber", "venous chamber")), table=table).septa
    assert septum[1:] == (LEFT, RIGHT, 1.5)


FULL = LabelTable(
    labels=tuple(
        Label(value=n, name=name, role=Role.BLOOD)
        for n, name in enumerate(
            ("LV", "RV", "LA", "RA", "aorta", "PA", "SVC", "IVC", "PV", "CS", "LAA", "RAA"), start=1
        )
    )
)
VALVES = {("LV", "LA"): 600.0, ("RV", "RA"): 700.0, ("LV", "aorta"): 300.0, ("RV", "PA"): 300.0, ("RA", "SVC"): 200.0}
VALVES |= {("RA", "IVC"): 200.0, ("LA", "PV"): 150.0, ("RA", "CS"): 50.0, ("LA", "LAA"): 150.0, ("RA", "RAA"): 150.0}


def apart(touching, *, without=(), walls=None):
    """The pairs that are kept apart in a heart with all valves but some, by their names."""
    areas = {pair: area for pair, area in VALVES.items() if pair not in without} | touching
    by_value = {tuple(sorted(FULL[name].value for name in pair)): area for pair, area in areas.items()}
    found = pairs_kept_apart(FULL, by_value, walls or WallsSettings(), np.sqrt(1.9))
    return {frozenset(FULL[value].name for value in pair): mm for pair, mm in found.items()}


@pytest.mark.parametrize(
    ("pair", "kind"),
    [
        (("LA", "RA"), "atria"),
        (("LV", "RV"), "ventricles"),
        (("aorta", "PA"), "arteries"),
        (("aorta", "RA"), "artery and atrium"),
        (("PA", "LA"), "artery and atrium"),
        (("RA", "LV"), "atrium and other ventricle"),
        (("SVC", "LA"), "vein or appendage"),
        (("SVC", "aorta"), "vein or appendage"),
        (("SVC", "PA"), "vein or appendage"),
        (("SVC", "PV"), "vein or appendage"),
        (("PV", "RA"), "vein or appendage"),
        (("IVC", "LV"), "vein or appendage"),
        (("LAA", "PA"), "vein or appendage"),
        (("SVC", "IVC"), None),
        (("PV", "LAA"), None),
        (("LV", "PA"), None),
        (("RV", "aorta"), None),
    ],
)
def test_the_names_say_who_is_kept_apart_and_how_thick(pair, kind):
    found = apart({pair: 100.0})
    assert found == ({} if kind is None else {frozenset(pair): ADULT_MM[kind]})


@pytest.mark.parametrize(
    ("pair", "lost"),
    [
        (("LA", "RA"), ("RV", "RA")),  # tricuspid atresia
        (("LA", "RA"), ("LV", "LA")),  # mitral atresia
        (("RA", "LV"), ("RV", "RA")),  # discordant connection, double inlet
        (("LV", "RV"), ("RV", "RA")),  # the right ventricle is filled by the left one
        (("aorta", "PA"), ("RV", "PA")),  # common trunk
        (("PV", "RA"), ("LA", "PV")),  # anomalous veins
        (("SVC", "PA"), ("RA", "SVC")),  # cavopulmonary anastomosis
    ],
)
def test_what_does_not_meet_its_own_is_open_to_what_takes_its_place(pair, lost):
    assert frozenset(pair) in apart({pair: 100.0})
    assert apart({pair: 100.0}, without=(lost,)) == {}
    stated = WallsSettings(septum=(SeptumThickness(between=pair, thickness_mm=1.0),))
    assert apart({pair: 100.0}, without=(lost,), walls=stated) == {frozenset(pair): 1.0}


def test_an_atrium_that_opens_far_wider_into_the_other_ventricle_is_not_divided_from_it():
    assert len(apart({("RA", "LV"): 1300.0})) == 1
    assert apart({("RA", "LV"): 1500.0}) == {}


@pytest.mark.parametrize(("area_m2", "expected"), [(1.9, 1.8), (0.23, 0.8), (1.1, 1.35), (2.9, 2.15)])
def test_septa_are_thinner_in_smaller_hearts(area_m2, expected):
    assert septum_thickness_mm("atria", float(np.sqrt(area_m2))) == pytest.approx(expected)


def test_what_was_grown_is_told_with_pair_area_thickness_and_place_and_has_a_kind_of_its_own():
    structures = halves()
    (figure,) = structures.quality["septa"]
    assert figure["between"] == list(ATRIA)
    assert figure["area_mm2"] == pytest.approx(np.pi * RADIUS_MM**2, rel=0.15)
    assert (figure["thickness_mm"], figure["patches"]) == (SEPTUM_MM, 1)
    assert np.linalg.norm(figure["center_mm"]) < 2.0
    label = structures.table[figure["label"]]
    assert (label.name, label.role, label.septum_of) == ("left atrium-right atrium septum (grown)", Role.WALL, (1, 2))
    assert told_of(structures).grade is WarningGrade.LOOK
    surface = build_surface(
        structures, SurfaceSettings(triangle_count=20_000, level_counts=(), normal_map_size=0), render=False
    )
    of_septum = surface.triangle_kind == SurfaceKind.GROWN_SEPTUM
    assert ((surface.triangle_tissue == label.value) & (surface.triangle_label > 0) == of_septum).all()
    heights = surface.vertices_mm[surface.triangles].mean(axis=1) @ NORMAL
    left, right = (np.median(heights[of_septum & (surface.triangle_label == value)]) for value in (LEFT, RIGHT))
    assert right - left == pytest.approx(SEPTUM_MM, abs=0.15)


def test_septa_are_written_and_read_back():
    structures = halves(places=open_places((), (ring(3.0),), table_of()))
    content = artifact_to_bytes(structures)
    back = artifact_from_bytes(content, Structures)
    assert back.septa == structures.septa
    assert isinstance(back.septa[0], Septum)
    assert back.table == structures.table
    assert artifact_to_bytes(back) == content


def test_a_narrow_vessel_along_another_that_a_septum_would_cut_is_told():
    """A vein with a waist of one voxel beside an artery."""
    geometry = lattice("even", 30.0)
    x, y, z = np.moveaxis(points_of(geometry), -1, 0)
    width = np.where(np.abs(z) < 3.0, 1.6, 5.0)
    labels = np.zeros(geometry.shape, np.uint8)
    labels[(x < 0.0) & (x > -8.0) & (np.abs(y) < 7.0) & (np.abs(z) < 11.0)] = LEFT
    labels[(x >= 0.0) & (x < width) & (np.abs(y) < 5.0) & (np.abs(z) < 11.0)] = RIGHT
    table = table_of("aorta", "superior vena cava")
    segmentation = Segmentation(labels, geometry, table)
    whole = grow_walls(segmentation, thick(0.4, ("aorta", "SVC")), ())
    assert not any("cut in two by a grown septum" in line.text for line in whole.warnings)
    cut = grow_walls(segmentation, thick(4.0, ("aorta", "SVC")), ())
    (warning,) = (line for line in cut.warnings if "cut in two by a grown septum" in line.text)
    assert warning.text.startswith("superior vena cava: ")
    assert warning.grade is WarningGrade.ANATOMY


def test_names_that_are_wrong_are_refused_all_at_once():
    segmentation = Segmentation(
        np.full((4, 4, 4), LEFT, np.uint8), lattice("even", 5.0).cropped((0, 0, 0), (4, 4, 4)), table_of()
    )
    walls = WallsSettings(
        connected=(("left atrium", "nobody"), ("left atrium", "LA"), ("left atrium", "myocardium")),
        septum=(
            SeptumThickness(between=ATRIA, thickness_mm=1.0),
            SeptumThickness(between=ATRIA[::-1], thickness_mm=2.0),
        ),
    )
    with pytest.raises(StageError) as error:
        grow_walls(segmentation, walls, ())
    places = [problem.place for problem in error.value.problems]
    assert places == ["walls.connected[1]", "walls.connected[2]", "walls.connected[3]", "walls.septum[2]"]


# ---- Against a plain oracle


@st.composite
def scenes(draw):
    """Three plane or round distance fields that divide space, on a turned lattice, and what is between them."""
    kind = draw(st.sampled_from(sorted(LATTICES)))
    seeds = np.array(draw(st.lists(st.tuples(*[st.floats(-9.0, 9.0)] * 3), min_size=4, max_size=4, unique=True)))
    thickness = draw(st.tuples(*[st.floats(0.5, 3.5)] * 2))
    return kind, seeds, thickness, draw(st.floats(0.0, 3.0))


@settings(deadline=None, max_examples=12, phases=(Phase.explicit, Phase.reuse, Phase.generate))
@given(scenes())
def test_the_field_is_that_of_the_plain_rule_at_any_point(scene):
    """Cells of the nearest of four seeds: the fields are worked out here, and so is what must come of them."""
    kind, seeds, thickness, wall_mm = scene
    geometry = lattice(kind, 24.0)
    points = points_of(geometry)
    away = np.stack([np.linalg.norm(points - seed, axis=-1) for seed in seeds], axis=-1)
    # half the lead over the next nearest: each other's negative where two touch, lipschitz
    fields = {}
    for n, value in enumerate((0, LEFT, RIGHT, MUSCLE)):
        others = np.delete(away, n, axis=-1).min(axis=-1)
        fields[value] = (0.5 * (away[..., n] - others)).astype(np.float32)
    table = table_of(wall_mm=wall_mm).with_walls().with_septum(LEFT, RIGHT)
    value = next(label.value for label in table if label.septum_of)
    structures = Structures(
        fields, geometry, table, band_mm=wall_mm + 4.0, septa=(Septum(value, LEFT, RIGHT, thickness[0]),)
    )
    reader = FieldReader.of(structures)
    assert (reader.layout.block_count == ALL_FIELDS).any()
    found = ownership_on_lattice(reader, geometry)
    plain = ownership_on_lattice(replace(structures, septa=()), geometry)
    a, b, muscle, bare = (fields[one].astype(np.float64) for one in (LEFT, RIGHT, MUSCLE, 0))
    half = 0.5 * thickness[0]
    septum = np.maximum(a, b) - half
    label = np.where(found.tissue_mm < 0.0, found.tissue_label, found.void_label)
    before = np.where(plain.tissue_mm < 0.0, plain.tissue_label, plain.void_label)
    sure = np.abs(np.stack([septum, muscle, a - half, b - half, a, b, bare])).min(axis=0) > 1e-3
    taken = sure & (septum < 0.0) & (muscle > 0.0) & np.isin(before, (LEFT, RIGHT))
    np.testing.assert_array_equal(label[taken], value)
    kept = sure & (septum > 0.0)
    np.testing.assert_array_equal(label[kept], before[kept])
    # what was seen stays what it was
    seen = sure & (muscle < 0.0)
    np.testing.assert_array_equal(label[seen], MUSCLE)
    # the depth in the septum and the distance to it, where nothing else is near
    alone = taken & (np.minimum(muscle, bare) > half + 4.0)
    np.testing.assert_allclose(found.tissue_mm[alone], septum[alone], atol=1e-3)


@pytest.mark.parametrize("kind", LATTICES)
def test_blocks_that_leave_fields_out_change_nothing(kind):
    structures = halves(kind)
    reader = FieldReader.of(structures)
    assert (reader.layout.block_count < ALL_FIELDS).any()
    layout = reader.layout._replace(block_count=np.full_like(reader.layout.block_count, ALL_FIELDS))
    fine = structures.geometry.refined(2)
    one, other = ownership_on_lattice(reader, fine), ownership_on_lattice(replace(reader, layout=layout), fine)
    np.testing.assert_array_equal(one.tissue_mm, other.tissue_mm)
    np.testing.assert_array_equal(one.tissue_label, other.tissue_label)
    np.testing.assert_array_equal(one.void_label, other.void_label)
