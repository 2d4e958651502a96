"""Places of grown septa: which a stated defect opened, and which a person took for wall, on a ball in two halves."""

from __future__ import annotations

import numpy as np
import pytest

from heartcase.pipeline.bundle.assembly import labels_of
from heartcase.pipeline.checks.openings import Verdict, find_openings
from heartcase.pipeline.data import Segmentation
from heartcase.pipeline.edits.apply_edits import apply_edits
from heartcase.pipeline.walls.grow_walls import grow_walls
from heartcase.pipeline.walls.grown_places import judged_places
from heartcase.pipeline.walls.septa import open_places
from heartcase.schemas.labels import Label, LabelTable, Role
from heartcase.schemas.recipe.edit_settings import SeptalDefect
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
