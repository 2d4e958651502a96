"""Points are read from the fields that matter around them; what comes out is that of all fields."""

import dataclasses

import numpy as np
import pytest

from heartcase.pipeline.data import Reshaping
from heartcase.pipeline.field_layout import ALL_FIELDS
from heartcase.pipeline.fields import FieldReader, ownership_at_points, ownership_on_lattice
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


def test_blocks_that_a_reshaping_reaches_hold_all_fields():
    structures = random_heart(0).structures
    table, geometry = structures.table, structures.geometry
    middle = geometry.index_to_world((np.array(geometry.size) - 1) / 2.0)
    blood = next(label for label in table if label.role.is_blood and label.value in structures.distance_mm)
    ball = Reshaping("strokes", (tuple(map(float, middle)),), 4.0, (table[0].name,), (blood.name,))
    reader = FieldReader.of(dataclasses.replace(structures, reshapings=(ball,)))
    k, j, i = (n // 2 // 4 for n in geometry.shape)
    assert reader.layout.block_count[k, j, i] == ALL_FIELDS
    assert (reader.layout.block_count != ALL_FIELDS).any()
