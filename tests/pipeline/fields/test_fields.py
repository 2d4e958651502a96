"""Points are read from the fields that matter around them; what comes out is that of all fields."""

import dataclasses
import gc
import weakref

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from heartcase.pipeline.data import Reshaping
from heartcase.pipeline.fields.layout import ALL_FIELDS
from heartcase.pipeline.fields.reader import FieldReader, forget_layout, ownership_at_points, ownership_on_lattice
from heartcase.pipeline.warnings import CaseWarning
from heartcase.schemas.labels import BACKGROUND, Label, LabelTable, Role
from tests.pipeline.analytic_structures import cylinder, lattice, structures
from tests.pipeline.fields.test_lattice_kernels import reshaped
from tests.pipeline.random_phantoms import random_heart


def with_all_fields(reader):
    count = np.full_like(reader.layout.block_count, ALL_FIELDS)
    return FieldReader(reader.structures, reader.layout._replace(block_count=count), reader.tables)


@pytest.mark.parametrize("seed", range(6))
def test_fields_that_are_left_out_change_nothing(seed):
    reader = FieldReader.of(random_heart(seed).structures)
    geometry = reader.structures.geometry
    count = reader.layout.block_count
    assert (count < reader.layout.stack.shape[3]).mean() > 0.3
    random = np.random.default_rng(seed)
    index = random.uniform(-2.0, np.array(geometry.size) + 1.0, (200_000, 3))
    short, full = (
        ownership_at_points(one, geometry.index_to_world(index)) for one in (reader, with_all_fields(reader))
    )
    np.testing.assert_array_equal(short.tissue_mm, full.tissue_mm)
    np.testing.assert_array_equal(short.void_label, full.void_label)
    np.testing.assert_array_equal(short.tissue_label, full.tissue_label)
    lattice = geometry.refined(2)
    short, full = (ownership_on_lattice(one, lattice) for one in (reader, with_all_fields(reader)))
    np.testing.assert_array_equal(short.tissue_mm, full.tissue_mm)
    np.testing.assert_array_equal(short.void_label, full.void_label)
    np.testing.assert_array_equal(short.tissue_label, full.tissue_label)


@settings(deadline=None, max_examples=60)
@given(st.integers(0, 11), st.integers(0, 2**32 - 1), st.integers(1, 4))
def test_fields_are_left_out_where_no_reshaping_changes_what_is_lowest(heart, seed, shapes):
    random = np.random.default_rng(seed)
    reader = FieldReader.of(reshaped(random_heart(heart).structures, random, shapes))
    geometry = reader.structures.geometry
    points = geometry.index_to_world(random.uniform(-8.0, np.array(geometry.size) + 7.0, (20_000, 3)))
    short, full = (ownership_at_points(one, points) for one in (reader, with_all_fields(reader)))
    np.testing.assert_array_equal(short.tissue_mm, full.tissue_mm)
    np.testing.assert_array_equal(short.void_label, full.void_label)
    np.testing.assert_array_equal(short.tissue_label, full.tissue_label)


def test_blocks_in_the_box_of_a_shape_that_it_does_not_reach_are_read_without_it():
    heart = random_heart(0).structures
    size = np.array(heart.geometry.size)
    ends = heart.geometry.index_to_world(np.array([[0.1, 0.1, 0.1], [0.9, 0.9, 0.9]]) * (size - 1))
    blood = next(label for label in heart.table if label.role.is_blood and label.value in heart.distance_mm)
    across = Reshaping(
        "cylinder", tuple(tuple(map(float, end)) for end in ends), 2.0, (blood.name,), (heart.table[BACKGROUND].name,)
    )
    reader = FieldReader.of(dataclasses.replace(heart, reshapings=(across,)))
    assert 0.0 < (reader.layout.block_count == ALL_FIELDS).mean() < 0.3


def test_blocks_that_a_reshaping_reaches_hold_all_fields():
    heart = random_heart(0).structures
    table, geometry = heart.table, heart.geometry
    middle = geometry.index_to_world((np.array(geometry.size) - 1) / 2.0)
    blood = next(label for label in table if label.role.is_blood and label.value in heart.distance_mm)
    ball = Reshaping("strokes", (tuple(map(float, middle)),), 4.0, (table[0].name,), (blood.name,))
    reader = FieldReader.of(dataclasses.replace(heart, reshapings=(ball,)))
    k, j, i = (n // 2 // 4 for n in geometry.shape)
    assert reader.layout.block_count[k, j, i] == ALL_FIELDS
    assert (reader.layout.block_count != ALL_FIELDS).any()


def test_structures_are_laid_out_once():
    one = random_heart(0).structures
    assert FieldReader.of(one).layout.stack is FieldReader.of(one).layout.stack
    other = dataclasses.replace(one, reshapings=())
    assert FieldReader.of(other).layout.stack is not FieldReader.of(one).layout.stack
    alike = dataclasses.replace(one, warnings=(CaseWarning("a word"),))
    reader = FieldReader.of(one)
    reader.serves(alike)
    assert FieldReader.of(alike).layout.stack is reader.layout.stack
    assert FieldReader.of(alike).structures is alike
    # Other structures that are read in between change nothing.
    assert FieldReader.of(one).layout.stack is reader.layout.stack
    forget_layout(one)
    again = FieldReader.of(one).layout
    assert again.stack is not reader.layout.stack
    np.testing.assert_array_equal(again.stack, reader.layout.stack)


def test_structures_that_are_gone_leave_nothing_laid_out():
    structures = random_heart(0).structures
    stack = weakref.ref(FieldReader.of(structures).layout.stack)
    del structures
    gc.collect()
    assert stack() is None


def test_the_field_has_no_step_where_a_cut_vessel_touches_one_that_goes_on():
    """The wall between two tubes is the nearer one's: beyond the cut, half of it is gone, the other half is whole."""
    table = LabelTable(
        labels=(
            Label(value=1, name="cut", role=Role.VESSEL_LUMEN, wall_thickness_mm=2.0),
            Label(value=2, name="whole", role=Role.VESSEL_LUMEN, wall_thickness_mm=2.0),
            Label(value=3, name="cut wall", role=Role.WALL, wall_of=1),
            Label(value=4, name="whole wall", role=Role.WALL, wall_of=2),
        )
    )
    tubes = [cylinder(4.0, (0.0, 0.0, 1.0), (side * 4.6, 0.0, 0.0)) for side in (-1.0, 1.0)]
    plain = structures({1: tubes[0], 2: tubes[1]}, lattice(14.0, (0.5, 0.5, 0.5)), table)
    cut = Reshaping("cylinder", ((-4.6, 0.0, 0.0), (-4.6, 0.0, 20.0)), 7.0, ("cut", "cut wall"), ("background",))
    made = dataclasses.replace(plain, reshapings=(cut,), band_mm=10.0)
    random = np.random.default_rng(0)
    here = random.uniform((-3.0, -4.0, 1.0), (3.0, 4.0, 10.0), (100_000, 3))
    way = 0.02 * random.normal(size=here.shape)
    field = [ownership_at_points(made, points).tissue_mm.astype(float) for points in (here, here + way)]
    assert (np.abs(field[1] - field[0]) <= 2.0 * np.linalg.norm(way, axis=1) + 1e-4).all()
    # what is left is the whole tube's wall, up to where the two lumens were equally near
    radius = np.linalg.norm(here[:, :2] - (4.6, 0.0), axis=1)
    is_wall = (here[:, 0] > 0.0) & (radius > 4.0) & (radius < 6.0)
    sure = (np.abs(here[:, 0]) > 0.05) & (np.abs(radius - 4.0) > 0.05) & (np.abs(radius - 6.0) > 0.05)
    np.testing.assert_array_equal((field[0] < 0.0)[sure], is_wall[sure])
    # and as deep as the nearest of its borders; aside, where lumens turn away from each other, a little less
    inside = is_wall & sure
    depth = np.minimum(np.minimum(radius - 4.0, 6.0 - radius), here[:, 0])
    assert (-field[0] <= depth + 0.02)[inside].all()
    middle = inside & (np.abs(here[:, 1]) < 1.0)
    np.testing.assert_allclose(-field[0][middle], depth[middle], atol=0.02)
