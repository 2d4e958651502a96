"""Pieces of structures that are kept or given away, against scans that never had the others."""

import cc3d
import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from heartcase.pipeline.data import Segmentation
from heartcase.pipeline.edits.apply_edits import apply_edits
from heartcase.pipeline.edits.borders import Borders
from heartcase.pipeline.fields.reader import ownership_on_lattice
from heartcase.pipeline.walls.grow_walls import grow_walls, structure_volumes_ml
from heartcase.pipeline.warnings import WarningGrade
from heartcase.schemas.errors import StageError
from heartcase.schemas.geometry import Geometry
from heartcase.schemas.labels import Label, LabelTable, Role
from heartcase.schemas.recipe.edit_settings import KeepLargest, RemoveIslands
from heartcase.schemas.recipe.settings import WallsSettings
from tests.pipeline.lattices import lattice, points_of

TABLE = LabelTable(
    labels=(
        Label(value=1, name="cavity", role=Role.BLOOD, wall_thickness_mm=1.5),
        Label(value=2, name="muscle", role=Role.MYOCARDIUM),
        Label(value=3, name="aorta", role=Role.VESSEL_LUMEN),
    )
)
SPECKS = {(16.0, 0.0, 0.0): 2.5, (0.0, -16.0, 3.0): 3.0, (-15.0, 2.0, -9.0): 4.0}
"""Centre -> radius of the stray balls around a ball of 9 mm."""


def grown(geometry, specks, *, value=1, inside=None):
    """A ball with stray balls beside it, or inside it."""
    points = points_of(geometry)
    labels = np.where(np.linalg.norm(points, axis=-1) < 9.0, 1 if inside is None else inside, 0)
    for centre, radius in specks.items():
        labels[np.linalg.norm(points - np.array(centre), axis=-1) < radius] = value
    return grow_walls(Segmentation(labels.astype(np.uint8), geometry, TABLE), WallsSettings(), ())


def differing(structures, other):
    """Points of a fine lattice with another label that are no face of the other's tissue to 0.1 mm; how many."""
    fine = structures.geometry.refined(2)
    found, true = (ownership_on_lattice(one, fine) for one in (structures, other))
    labels = [np.where(one.tissue_mm < 0.0, one.tissue_label, one.void_label) for one in (found, true)]
    return int(((labels[0] != labels[1]) & (np.abs(true.tissue_mm) > 0.1)).sum())


@pytest.mark.parametrize("kind", ["even", "oblique"])
def test_the_largest_piece_is_left_as_if_the_others_had_never_been(kind):
    geometry = lattice(kind, 50.0)
    before, clean = grown(geometry, SPECKS), grown(geometry, {})
    after = apply_edits(before, (KeepLargest(kind="keep_largest", label="cavity"),))
    assert differing(before, clean) > 1000
    assert differing(after, clean) == 0
    line = after.warnings[-1]
    assert line.edit == 1
    assert line.text.startswith("edits[1]: 3 pieces of 'cavity' given away, 0.")
    assert line.grade is WarningGrade.NOTE
    # Within the band the fields are those of the clean scan too; its blur knew nothing of the stray balls.
    for value in (0, 1):
        near = np.abs(clean.distance_mm[value]) < 0.5 * clean.band_mm
        assert np.abs(after.distance_mm[value] - clean.distance_mm[value])[near].max() < 0.1


def test_only_pieces_below_the_volume_go_and_the_largest_stays():
    geometry = lattice("even", 50.0)
    before = grown(geometry, SPECKS)
    counts = sorted(np.bincount(np.searchsorted([2.75, 3.5], list(SPECKS.values()))))
    assert counts == [1, 1, 1]
    # 4/3 pi r^3: 0.065, 0.113 and 0.268 ml.
    edit = RemoveIslands(kind="remove_islands", label="cavity", smallest_ml=0.19)
    left = {centre: radius for centre, radius in SPECKS.items() if radius > 3.5}
    assert differing(apply_edits(before, (edit,)), grown(geometry, left)) == 0
    everything = RemoveIslands(kind="remove_islands", smallest_ml=1000.0)
    assert differing(apply_edits(before, (everything,)), grown(geometry, {})) == 0


def test_a_second_time_there_is_nothing_to_do_and_that_is_a_note():
    before = grown(lattice("even", 50.0), SPECKS)
    keep = KeepLargest(kind="keep_largest", label="cavity")
    once = apply_edits(before, (keep,))
    twice = apply_edits(once, (keep, RemoveIslands(kind="remove_islands", smallest_ml=0.5)))
    assert [line.text for line in twice.warnings[len(once.warnings) :]] == [
        "edits[1]: 'cavity' is one piece, so the edit changes nothing",
        "edits[2]: no piece is below 0.5 ml, so the edit changes nothing",
    ]
    assert all(twice.distance_mm[value] is once.distance_mm[value] for value in once.distance_mm)


def test_a_piece_becomes_what_is_around_it_or_what_is_asked_for():
    geometry = lattice("even", 50.0)
    small_in_muscle = {(0.0, 0.0, 0.0): 3.0, (0.0, 0.0, 14.0): 3.9}
    before = grown(geometry, small_in_muscle, value=3, inside=2)
    volumes = structure_volumes_ml(before)
    keep = KeepLargest(kind="keep_largest", label="aorta")
    gained = structure_volumes_ml(apply_edits(before, (keep,)))[2] - volumes[2]
    other = structure_volumes_ml(grown(geometry, {(0.0, 0.0, 14.0): 3.9}, value=3, inside=2))[3]
    assert gained == pytest.approx(volumes[3] - other, abs=0.002)
    into = structure_volumes_ml(apply_edits(before, (keep.model_copy(update={"into": "background"}),)))
    assert into[0] - volumes[0] == pytest.approx(gained, rel=0.05)
    assert into[2] == pytest.approx(volumes[2], abs=0.005)


def test_holes_are_pieces_of_the_background():
    geometry = lattice("even", 50.0)
    hollow = grown(geometry, {(0.0, 0.0, 0.0): 3.0}, value=0, inside=2)
    filled = apply_edits(hollow, (RemoveIslands(kind="remove_islands", label="background", smallest_ml=0.5),))
    assert differing(filled, grown(geometry, {}, inside=2)) == 0


def test_names_that_do_not_fit_are_refused_together():
    before = grown(lattice("even", 50.0), SPECKS)
    edits = (
        KeepLargest(kind="keep_largest", label="cavity wall"),
        KeepLargest(kind="keep_largest", label="cavity", into="cavity"),
        RemoveIslands(kind="remove_islands", into="valve"),
        RemoveIslands(kind="remove_islands", label="muscle"),
    )
    with pytest.raises(StageError) as error:
        apply_edits(before, edits)
    words = ("name 'cavity'", "cannot become 'cavity'", "no label 'valve'", "nothing of 'muscle'")
    assert [problem.place for problem in error.value.problems] == [f"edits[{n}]" for n in range(1, 5)]
    assert all(part in problem.message for part, problem in zip(words, error.value.problems, strict=True))


@settings(deadline=None, max_examples=10)
@given(st.integers(0, 10_000))
@example(149)  # three fields within rounding of each other
def test_what_is_left_is_one_piece_and_the_fields_still_divide_space(seed):
    """Blobs at random, touching or not."""
    rng = np.random.default_rng(seed)
    geometry = Geometry.of(shape=(18, 20, 22), spacing_mm=(1.5, 1.2, 2.0))
    labels = np.zeros(geometry.shape, np.uint8)
    points = points_of(geometry)
    for _ in range(12):
        centre = rng.uniform((0, 0, 0), np.array(geometry.size) * geometry.spacing_mm)
        labels[np.linalg.norm(points - centre, axis=-1) < rng.uniform(1.5, 6.0)] = rng.integers(0, 4)
    if not labels.any():
        return
    before = grow_walls(Segmentation(labels, geometry, TABLE), WallsSettings(), ())
    old = Borders(before).owner()
    for label in TABLE:
        if label.value not in before.distance_mm:
            continue
        connectivity = 26 if label.role.is_tissue else 6
        after = apply_edits(before, (KeepLargest(kind="keep_largest", label=label.name),))
        new = Borders(after).owner()
        pieces = cc3d.connected_components(old == label.value, connectivity=connectivity)
        sizes = np.bincount(pieces.ravel())[1:]
        if len(sizes) == 0:
            continue
        kept = pieces == 1 + int(sizes.argmax())
        assert ((new == label.value) == kept).all()
        # Nobody else lost a voxel, and just one field is below zero at each.
        others = (old != label.value) & (new != old)
        assert not others.any()
        below = np.sum([field < -1e-3 for field in after.distance_mm.values()], axis=0)
        was = np.sum([field < -1e-3 for field in before.distance_mm.values()], axis=0)
        assert (below[was == 1] <= 1).all()
