"""What must hold of walls around any boxes, on any lattice, by brute force on the bare structures' own points."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from heartcase.pipeline.data import Segmentation, Structures
from heartcase.pipeline.fields.reader import ownership_at_points
from heartcase.pipeline.walls.grow_walls import grow_walls
from heartcase.schemas.geometry import Geometry
from heartcase.schemas.labels import Label, LabelTable, Role
from heartcase.schemas.recipe.settings import WallsSettings

CAVITIES = (1, 2)
SIZE = (14, 13, 12)
FACTOR = 3
"""Brute-force points along each edge of a voxel."""


def table_of(first_mm: float, second_mm: float) -> LabelTable:
    return LabelTable(
        labels=(
            Label(value=1, name="one", role=Role.VESSEL_LUMEN, wall_thickness_mm=first_mm),
            Label(value=2, name="two", role=Role.BLOOD, wall_thickness_mm=second_mm),
            Label(value=3, name="muscle", role=Role.MYOCARDIUM),
            Label(value=4, name="open", role=Role.BLOOD),
        )
    )


@st.composite
def scenes(draw):
    """Boxes of labels on a turned lattice with voxels of up to 1:4."""
    quaternion = np.array(draw(st.tuples(*[st.floats(-1.0, 1.0)] * 4).filter(lambda q: np.linalg.norm(q) > 0.2)))
    w, x, y, z = quaternion / np.linalg.norm(quaternion)
    direction = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )
    spacing = draw(st.tuples(*[st.sampled_from([1.0, 1.5, 2.0, 4.0])] * 3))
    geometry = Geometry.of(shape=SIZE, origin_mm=(3.0, -7.0, 11.0), spacing_mm=spacing, direction=direction)
    labels = np.zeros(SIZE, np.uint8)
    corner = st.tuples(*[st.integers(0, n - 4) for n in SIZE])
    extent = st.tuples(*[st.integers(3, 8)] * 3)
    for value in (3, 4, *draw(st.permutations(CAVITIES))):
        if value in CAVITIES or draw(st.booleans()):
            (k, j, i), (dk, dj, di) = draw(corner), draw(extent)
            labels[k : k + dk, j : j + dj, i : i + di] = value
    return labels, geometry, draw(st.floats(0.3, 5.0)), draw(st.floats(0.3, 5.0))


def owners(structures: Structures, points: np.ndarray) -> np.ndarray:
    found = ownership_at_points(structures, points)
    return np.where(found.tissue_mm < 0.0, found.tissue_label, found.void_label)


# without shrinking, which takes minutes here
@settings(deadline=None, max_examples=15, phases=(Phase.explicit, Phase.reuse, Phase.generate))
@given(scenes())
def test_walls_of_any_boxes_are_what_lies_within_their_thickness(scene):
    labels, geometry, *thickness = scene
    segmentation = Segmentation(labels, geometry, table_of(*thickness))
    structures = grow_walls(segmentation, WallsSettings(), ())
    quick = grow_walls(segmentation, WallsSettings(), (), is_measured=False)
    unwalled = LabelTable(
        labels=tuple(one.model_copy(update={"wall_thickness_mm": 0.0}) for one in structures.table if one.value < 5)
    )
    bare = replace(structures, table=unwalled)
    fine = geometry.refined(FACTOR)
    k, j, i = np.indices(fine.shape).reshape(3, -1)
    points = fine.index_to_world(np.stack([i, j, k], axis=1))
    before, after = owners(bare, points), owners(structures, points)
    # without figures the walls are the same
    np.testing.assert_array_equal(owners(quick, points), after)

    # Only the background gives way to walls; a face between three structures is fuzzy by a part of a voxel.
    walls = {structures.table.wall_value(cavity): cavity for cavity in CAVITIES}
    assert np.mean((before != after) & (before != 0)) < 1e-3
    assert np.mean((before == 0) & ~np.isin(after, [0, *walls])) < 1e-3

    # Distances by brute force: to the nearest point that the bare cavity owns, exact to half a diagonal of the points.
    half = 0.5 * float(np.linalg.norm(fine.spacing_mm))
    fuzz = half + 0.5 * max(geometry.spacing_mm)
    far = np.full((2, len(points)), np.inf)
    for number, cavity in enumerate(CAVITIES):
        own = points[before == cavity]
        if len(own):
            far[number] = cKDTree(own).query(points, workers=1)[0]
    outside = before == 0
    for number, wall in enumerate(walls):
        mine = outside & (after == wall)
        if mine.any():
            assert far[number][mine].max() <= thickness[number] + fuzz
            # where walls meet the nearer cavity's wins
            other = far[1 - number][mine] - far[number][mine]
            both = far[1 - number][mine] < thickness[1 - number] - fuzz
            assert not both.any() or other[both].min() >= -2.0 * fuzz
        near = outside & (far[number] < thickness[number] - fuzz)
        assert np.isin(after[near], list(walls)).all()


@pytest.mark.parametrize("layers", [1, 2])
def test_what_ends_at_the_border_of_the_volume_makes_no_wall_there(layers):
    """A label's lead falls towards a face of two others; gone on with beyond the border it once made a ghost."""
    labels = np.zeros((20, 24, 20), np.uint8)
    labels[:, :layers] = 3
    labels[7:13, 7:13, 7:13] = 1
    geometry = Geometry.of(shape=labels.shape, spacing_mm=(1.75, 1.75, 1.75))
    structures = grow_walls(Segmentation(labels, geometry, table_of(4.0, 1.0)), WallsSettings(), ())
    there = np.argwhere(labels == 1)[:, ::-1] * 1.75
    k, j, i = np.indices(labels.shape).reshape(3, -1)
    distance = cKDTree(there).query(np.stack([i, j, k], axis=1) * 1.75)[0].reshape(labels.shape)
    outside = labels != 1
    assert (structures.distance_mm[1] - np.minimum(distance, structures.band_mm))[outside].min() > -1.75


def test_a_label_behind_another_at_the_border_of_the_volume_is_not_drawn_nearer():
    """A case that the property above found: beyond the border the lead fell towards the face of one before two."""
    labels = np.zeros((14, 13, 12), np.uint8)
    labels[8:11, 2:10, 0:4] = 2
    labels[2:10, 1:9, 1:6] = 1
    geometry = Geometry.of(shape=labels.shape, spacing_mm=(1.0, 4.0, 1.0))
    structures = grow_walls(Segmentation(labels, geometry, table_of(2.0, 4.6)), WallsSettings(), ())
    # from the middles of the first voxels to the box's face it is 7.5 mm; that face is drawn out by up to a voxel
    assert structures.distance_mm[2][0, 2:10, 0].min() > 5.0
