"""Places of grown septa: which a stated defect opened, and which a person took for wall, on a ball in two halves."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from heartcase.pipeline.bundle.assembly import labels_of
from heartcase.pipeline.checks.contact_balls import open_balls
from heartcase.pipeline.checks.openings import Verdict, find_openings
from heartcase.pipeline.data import Segmentation
from heartcase.pipeline.edits.apply_edits import apply_edits
from heartcase.pipeline.walls.grow_walls import grow_walls
from heartcase.pipeline.walls.grown_places import judged_places
from heartcase.pipeline.walls.said_places import said_warnings
from heartcase.pipeline.walls.septa import open_places
from heartcase.schemas.labels import Label, LabelTable, Role
from heartcase.schemas.recipe.edit_settings import CloseDefect, SeptalDefect
from heartcase.schemas.recipe.settings import ContactPlace, SeptumThickness, WallsSettings
from tests.pipeline.lattices import lattice, points_of

LEFT, RIGHT = 1, 2
PAIR = ("left ventricle", "right ventricle")
RADIUS_MM = 8.0
TABLE = LabelTable(
    labels=tuple(
        Label(value=value, name=name, role=Role.BLOOD, wall_thickness_mm=2.0)
        for value, name in zip((LEFT, RIGHT), PAIR, strict=True)
    )
)


def grown(*, contacts=(), apart=False):
    """A ball that a plane divides into two ventricles; or a longer body with two contacts, each in a ball."""
    geometry = lattice("even", 36.0)
    x, y, z = np.moveaxis(points_of(geometry), -1, 0)
    labels = np.where(x < 0.0, LEFT, RIGHT)
    inside = x**2 + y**2 + z**2 < RADIUS_MM**2
    if apart:
        inside = np.minimum((z - 9.0) ** 2, (z + 9.0) ** 2) + x**2 + y**2 < 36.0
    labels[~inside] = 0
    settings = WallsSettings(septum=(SeptumThickness(between=PAIR, thickness_mm=1.5),), contact=contacts)
    segmentation = Segmentation(labels.astype(np.uint8), geometry, TABLE)
    return grow_walls(segmentation, settings, (), open_places=open_places((), (), TABLE, contacts))


def defect(diameter, at=(0.0, 0.0, 0.0)):
    return SeptalDefect(
        kind="septal_defect", position_mm=at, axis=(1.0, 0.0, 0.0), diameter_mm=diameter, length_mm=12.0
    )


def judged(structures, edits=(), contacts=()):
    edited = apply_edits(structures, edits)
    openings = find_openings(edited, labels_of(edited), edits, contacts=contacts)
    voxel = structures.geometry.voxel_volume_mm3 ** (1.0 / 3.0)
    figures, warnings = judged_places(edited.quality.get("septa", ()), openings, contacts, edited.table, voxel)
    states = [place["state"] for one in figures for place in one["places"]]
    return states, [one.code for one in warnings], figures, openings


def test_a_defect_that_is_cut_through_all_of_the_grown_wall_leaves_nothing_to_warn_of():
    structures = grown()
    assert judged(structures)[:2] == (["grown"], ["grown-septum"])
    assert judged(structures, [defect(2.0 * RADIUS_MM + 1.0)])[:2] == (["opened"], [])


def test_a_defect_that_is_narrower_leaves_the_wall_around_it_to_be_looked_at():
    whole, edit = grown(), [defect(8.0)]
    states, codes, ((figure),), _ = judged(whole, edit)
    assert (states, codes) == (["grown"], ["grown-septum"])
    ring = np.pi * (RADIUS_MM**2 - 16.0)
    assert figure["places"][0]["area_mm2"] == pytest.approx(ring, rel=0.15)
    assert "points_mm" not in figure["places"][0]


def test_of_two_places_the_one_that_is_open_goes_and_the_other_stays():
    structures = grown(apart=True)
    places = structures.quality["septa"][0]["places"]
    assert sorted(round(place["center_mm"][2]) for place in places) == pytest.approx([-9, 9], abs=1)
    for place in places:
        assert place["area_mm2"] == pytest.approx(36.0 * np.pi, rel=0.15)
        assert place["radius_mm"] == pytest.approx(6.0, abs=1.5)
    states, codes, figures, _ = judged(structures, [defect(14.0, (0.0, 0.0, 9.0))])
    by_side = {round(place["center_mm"][2] / 9.0): place["state"] for place in figures[0]["places"]}
    assert by_side == {1: "opened", -1: "grown"}
    assert codes == ["grown-septum"]
    assert sorted(states) == ["grown", "opened"]


def test_a_place_that_the_recipe_keeps_open_is_as_wide_as_the_scan_shows_it_and_stated():
    (place,) = grown().quality["septa"][0]["places"]
    said = ContactPlace(
        between=PAIR[::-1], position_mm=place["center_mm"], radius_mm=place["radius_mm"] + 1.0, is_open=True
    )
    structures = grown(contacts=(said,))
    states, codes, _, openings = judged(structures, contacts=(said,))
    assert (states, codes) == ([], [])
    (opening,) = openings
    assert (opening.verdict, opening.stated_by) == (Verdict.STATED, "walls.contact[1]")
    assert opening.area_mm2 == pytest.approx(np.pi * RADIUS_MM**2, rel=0.2)


def test_a_place_that_a_person_took_for_wall_is_noted_and_stays_a_wall():
    (place,) = grown().quality["septa"][0]["places"]
    said = ContactPlace(between=PAIR, position_mm=place["center_mm"], radius_mm=place["radius_mm"], is_open=False)
    structures = grown(contacts=(said,))
    assert structures.quality["septa"] == grown().quality["septa"]
    states, codes, _, openings = judged(structures, contacts=(said,))
    assert (states, codes) == (["confirmed"], ["grown-septum-confirmed"])
    assert openings == ()
    small = said.model_copy(update={"radius_mm": 2.0})
    assert judged(structures, contacts=(small,))[:2] == (["grown"], ["grown-septum"])


def told(structures, contacts, edits=()):
    openings = find_openings(structures, labels_of(structures), contacts=contacts)
    voxel = structures.geometry.voxel_volume_mm3 ** (1.0 / 3.0)
    settings, figures = WallsSettings(contact=contacts), structures.quality.get("septa", ())
    return [
        (one.grade, one.code, one.text.partition(":")[0])
        for one in said_warnings(figures, openings, settings, structures.table, voxel, edits)
    ]


@pytest.mark.parametrize("at", [(0.0, 0.0, 14.0), (0.0, 0.0, 900.0)])
def test_a_statement_of_a_place_that_is_no_longer_there_is_told(at):
    here = ContactPlace(between=PAIR, position_mm=(0.0, 0.0, 0.0), radius_mm=9.0, is_open=True)
    gone = here.model_copy(update={"position_mm": at, "radius_mm": 3.0})
    wall = gone.model_copy(update={"is_open": False})
    contacts = (gone, wall)
    structures = grown(contacts=contacts)
    assert told(structures, contacts) == [
        ("anatomy", "contact-not-open", "walls.contact[1]"),
        ("look", "contact-no-wall", "walls.contact[2]"),
    ]
    assert told(grown(contacts=(here,)), (here,)) == []
    fits = here.model_copy(update={"is_open": False})
    assert told(grown(contacts=(fits,)), (fits,)) == []
    closed = CloseDefect(kind="close_defect", position_mm=at, axis=(1.0, 0.0, 0.0), diameter_mm=6.0)
    assert told(structures, (gone,), [closed]) == []


def test_what_is_said_of_a_pair_that_every_heart_has_open_is_told():
    said = ContactPlace(between=PAIR, position_mm=(0.0, 0.0, 0.0), radius_mm=9.0, is_open=True)
    pair = ("left ventricle", "left atrium")
    table = LabelTable(
        labels=tuple(
            Label(value=value, name=name, role=Role.BLOOD, wall_thickness_mm=2.0)
            for value, name in zip((LEFT, RIGHT), pair, strict=True)
        )
    )
    geometry = lattice("even", 36.0)
    points = points_of(geometry)
    labels = np.where(points[..., 0] < 0.0, LEFT, RIGHT).astype(np.uint8)
    labels[(points**2).sum(axis=-1) >= RADIUS_MM**2] = 0
    structures = grow_walls(Segmentation(labels, geometry, table), WallsSettings(), ())
    for is_open in (True, False):
        contacts = (said.model_copy(update={"between": pair, "is_open": is_open}),)
        assert told(structures, contacts) == [("look", "contact-normal", "walls.contact[1]")]


def test_a_place_that_is_wall_stays_one_beside_an_opening_whose_ball_reaches_into_it():
    opened = ContactPlace(between=PAIR, position_mm=(0.0, 0.0, 9.0), radius_mm=16.0, is_open=True)
    wall = ContactPlace(between=PAIR[::-1], position_mm=(0.0, 0.0, -9.0), radius_mm=7.0, is_open=False)
    contacts = (opened, wall)
    structures = grown(contacts=contacts, apart=True)
    states, _, figures, openings = judged(structures, contacts=contacts)
    (opening,) = openings
    assert opening.area_mm2 == pytest.approx(36.0 * np.pi, rel=0.15)
    assert opening.points_mm[:, 2].min() > 0.0
    assert states == ["confirmed"]
    assert figures[0]["places"][0]["area_mm2"] == pytest.approx(36.0 * np.pi, rel=0.15)
    within = opened.model_copy(update={"position_mm": (0.0, 0.0, -8.0), "radius_mm": 2.0})
    assert open_balls((within, wall), TABLE) == ()


def test_the_reach_of_an_opening_is_that_of_its_largest_patch():
    structures = grown(apart=True)
    bare = replace(structures, septa=())
    (opening,) = find_openings(bare, labels_of(bare))
    assert opening.patches == 2
    assert opening.reach_mm == pytest.approx(6.0, abs=1.5)


def test_what_is_no_place_of_its_own_is_warned_of_while_it_is_large():
    place = {"center_mm": [0.0, 0.0, 0.0], "area_mm2": 5.0, "radius_mm": 1.0, "points_mm": [[0.0, 0.0, 0.0]]}
    far = {"center_mm": [20.0, 0.0, 0.0], "area_mm2": 4.0, "radius_mm": 1.0, "points_mm": [[20.0, 0.0, 0.0]]}
    figure = {"between": list(PAIR), "area_mm2": 9.0, "thickness_mm": 1.5, "center_mm": [0.0, 0.0, 0.0], "patches": 2}
    said = ContactPlace(between=PAIR, position_mm=(0.0, 0.0, 0.0), radius_mm=2.0, is_open=False)
    whole = said.model_copy(update={"radius_mm": 30.0})

    def warned(area_mm2, said):
        one = figure | {"places": [place], "others": far | {"area_mm2": area_mm2}}
        figures, warnings = judged_places([one], (), [said], TABLE, 1.0)
        assert "points_mm" not in figures[0]["others"]
        return [(one.code, one.places_mm[0][0]) for one in warnings if one.code == "grown-septum"]

    assert warned(4.0, said) == [("grown-septum", 20.0)]
    assert warned(2.0, said) == []
    assert warned(4.0, whole) == []


def test_patches_beyond_the_most_places_are_kept_together():
    geometry = lattice("even", 36.0)
    x, y, z = np.moveaxis(points_of(geometry), -1, 0)
    labels = np.where(x < 0.0, LEFT, RIGHT).astype(np.uint8)
    columns = [(b, c) for b in (-12.0, -4.0, 4.0, 12.0) for c in (-12.0, 0.0, 12.0)]
    inside = np.zeros(labels.shape, np.bool_)
    for b, c in columns:
        inside |= (np.abs(x) < 6.0) & ((y - b) ** 2 + (z - c) ** 2 < 2.5**2)
    labels[~inside] = 0
    settings = WallsSettings(septum=(SeptumThickness(between=PAIR, thickness_mm=1.5),))
    (figure,) = grow_walls(Segmentation(labels, geometry, TABLE), settings, ()).quality["septa"]
    assert figure["patches"] == len(columns)
    areas = sum(place["area_mm2"] for place in figure["places"])
    assert figure["others"]["area_mm2"] == pytest.approx(figure["area_mm2"] - areas, abs=0.5)
    assert figure["others"]["area_mm2"] == pytest.approx(figure["area_mm2"] * 4 / 12, rel=0.15)
