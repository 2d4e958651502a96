"""A lattice read row by row has what each of its points has by itself: the same numbers."""

import dataclasses

import numba
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from heartcase.pipeline.data import Reshaping
from heartcase.pipeline.fields.layout import ALL_FIELDS
from heartcase.pipeline.fields.reader import (
    FieldReader,
    _evaluate_points,
    ownership_at_points,
    ownership_on_lattice,
    steps_through,
)
from heartcase.pipeline.fields.wall_thickness import ThicknessTable
from heartcase.schemas.geometry import Geometry
from tests.pipeline.analytic_structures import ball, lattice, structures, without
from tests.pipeline.random_phantoms import random_heart
from tests.pipeline.walls.test_septa import halves, thick


def reshaped(structures, random, count):
    """Structures with so many shapes anywhere, of every kind, from and to any labels."""
    names = [label.name for label in structures.table if label.value in structures.values]
    size = np.array(structures.geometry.size)
    shapes = []
    for _ in range(count):
        kind = str(random.choice(["cylinder", "strokes", "elliptic", "slit"]))
        ends = structures.geometry.index_to_world(random.uniform(-0.1, 1.1, (2, 3)) * (size - 1))
        radius_mm = float(random.uniform(0.5, 9.0))
        points = [*ends]
        if kind in ("elliptic", "slit"):
            along = (ends[1] - ends[0]) / np.linalg.norm(ends[1] - ends[0])
            side = np.cross(along, random.normal(size=3))
            side /= np.linalg.norm(side)
            middle = ends.mean(axis=0)
            points += [middle + radius_mm * side, middle + 0.5 * radius_mm * np.cross(along, side)]
        mixed = list(random.permutation(names))
        sources, targets = mixed[: random.integers(1, 3)], mixed[3 : 3 + random.integers(1, 3)]
        if random.random() < 0.1:
            targets = []
        elif random.random() < 0.4:
            targets = ["background"] if "background" in names and "background" not in sources else targets
        points_mm = tuple(tuple(map(float, point)) for point in points)
        shapes.append(Reshaping(kind, points_mm, radius_mm, tuple(map(str, sources)), tuple(map(str, targets))))
    return dataclasses.replace(structures, reshapings=(*structures.reshapings, *shapes))


def any_lattice(geometry, random):
    """A lattice parallel to a geometry's, of any spacing, in it and beyond, to either side along one axis."""
    step, size = random.uniform(0.2, 6.0, 3), np.array(geometry.size)
    count = np.clip(1.2 * size / step, 1, [60, 40, 30]).astype(int)
    turned = np.where(np.arange(3) == random.integers(0, 4), -1.0, 1.0)
    return Geometry.of(
        shape=tuple(map(int, count[::-1])),
        origin_mm=geometry.index_to_world(np.where(turned > 0, -0.1, 1.1) * size),
        spacing_mm=step * geometry.spacing_mm,
        direction=np.array(geometry.direction) * turned,
    )


def assert_same(structures, lattice):
    reader = FieldReader.of(structures)
    k, j, i = np.indices(lattice.shape)
    on = ownership_on_lattice(reader, lattice)
    # by the very indices that the lattice's kernel takes
    start, step = steps_through(structures.geometry, lattice)
    index = np.stack([start[0] + i * step[0], start[1] + j * step[1], start[2] + k * step[2]], axis=-1).reshape(-1, 3)
    found = [np.empty(len(index), kind) for kind in (np.float32, np.uint8, np.uint8)]
    _evaluate_points(reader.layout, reader.tables, index, *found)
    np.testing.assert_array_equal(on.tissue_mm.ravel(), found[0])
    np.testing.assert_array_equal(on.void_label.ravel(), found[1])
    np.testing.assert_array_equal(on.tissue_label.ravel(), found[2])
    return reader


@settings(deadline=None, max_examples=60)
@given(st.integers(0, 11), st.integers(0, 2**32 - 1), st.integers(0, 4))
def test_a_lattice_is_as_its_points_are(heart, seed, shapes):
    random = np.random.default_rng(seed)
    structures = reshaped(random_heart(heart).structures, random, shapes)
    assert_same(structures, any_lattice(structures.geometry, random))


@pytest.mark.parametrize("seed", range(3))
def test_the_whole_volume_is_as_its_points_are(seed):
    random = np.random.default_rng(seed)
    structures = reshaped(random_heart(seed).structures, random, 3)
    reader = assert_same(structures, structures.geometry)
    alone = (reader.layout.block_count == ALL_FIELDS).mean()
    assert 0.02 < alone < 0.98


def test_septa_and_walls_that_vary_are_read_point_by_point():
    random = np.random.default_rng(1)
    septal = halves(walls=thick())
    line = ThicknessTable(1, "centreline", ((0.0, 0.0, -10.0), (0.0, 0.0, 10.0)), (1.0, 3.0))
    assert septal.grown_septa
    for one in (septal, dataclasses.replace(septal, septa=(), thickness_tables=(line,))):
        for shapes in (0, 1, 3):
            assert_same(reshaped(one, random, shapes), any_lattice(one.geometry, random))


@pytest.mark.parametrize("makes_tissue", [False, True])
def test_where_no_tissue_is_stored_a_reshaping_may_make_the_only_one(makes_tissue):
    lumen = structures({1: ball(8.0)}, lattice(12.0))
    random = np.random.default_rng(3)
    shape = Reshaping("strokes", ((0.0, 0.0, 0.0), (6.0, 0.0, 0.0)), 3.0, ("left",), ("wall",))
    one = dataclasses.replace(lumen, reshapings=(shape,) if makes_tissue else (), band_mm=4.0)
    for _ in range(3):
        assert_same(one, any_lattice(one.geometry, random))
    assert_same(one, one.geometry)


def test_a_reshaping_may_take_from_the_background_and_give_to_nobody():
    one = structures({1: ball(7.0), 3: without(ball(9.0), ball(7.0))}, lattice(14.0))
    shape = Reshaping("strokes", ((9.0, 0.0, 0.0), (12.0, 0.0, 0.0)), 4.0, ("background",), ())
    one = dataclasses.replace(one, reshapings=(shape,), band_mm=4.0)
    assert_same(one, one.geometry)
    assert_same(one, one.geometry.refined(2))


def test_points_are_ones_own_at_world_places():
    structures = random_heart(2).structures
    on = ownership_on_lattice(structures, structures.geometry)
    k, j, i = np.indices(structures.geometry.shape)
    at = ownership_at_points(
        structures, structures.geometry.index_to_world(np.stack([i, j, k], axis=-1).reshape(-1, 3))
    )
    np.testing.assert_allclose(on.tissue_mm.ravel(), at.tissue_mm, atol=1e-3)


@pytest.mark.parametrize("threads", [1, 2])
def test_any_number_of_threads_gives_the_same(threads):
    structures = random_heart(4).structures
    before = numba.get_num_threads()
    numba.set_num_threads(min(threads, before))
    try:
        assert_same(structures, structures.geometry)
    finally:
        numba.set_num_threads(before)
