"""What lies on ways through the fields, against dense samples and labels of what hangs together."""

import numba
import numpy as np
import pytest
from scipy import ndimage

from heartcase.compiling.tuple_addresses import lend
from heartcase.pipeline.cells.ways import (
    field_at,
    fields_in_cells,
    hangs_together,
    is_beyond_wall,
    looks_elsewhere,
    searched,
)
from heartcase.pipeline.fields.point_kernels import scratch
from heartcase.pipeline.fields.reader import FieldReader, ownership_at_points
from heartcase.schemas.geometry import Geometry
from tests.pipeline.analytic_structures import (
    LEFT,
    RIGHT,
    WALL,
    ball,
    box,
    common,
    lattice,
    rotation,
    slab,
    structures,
    union,
    without,
)

CELL_MM = 2.5


@numba.njit
def _fields(owner, places):
    fields = lend(owner)
    out, spare = np.empty((len(places), 3)), scratch(fields.layout)
    for n, p in enumerate(places):
        out[n, 0], out[n, 1], out[n, 2] = field_at(fields, p[0], p[1], p[2], spare)
    return out


@numba.njit
def _elsewhere(owner, places, normals, facing, cells):
    fields = lend(owner)
    out, spare, room = np.empty(len(places), np.bool_), scratch(fields.layout), searched()
    for n in range(len(places)):
        out[n] = looks_elsewhere(fields, spare, room, places[n], normals[n], facing[n], cells[n])
    return out


@numba.njit
def _beyond(owner, places, normals, facing, to):
    fields = lend(owner)
    out, spare = np.empty(len(places), np.bool_), scratch(fields.layout)
    for n in range(len(places)):
        out[n] = is_beyond_wall(fields, spare, places[n], normals[n], facing[n], to[n])
    return out


@numba.njit
def _together(owner, places, normals, cells, is_void):
    fields = lend(owner)
    out, spare, room = np.empty(len(places), np.bool_), scratch(fields.layout), searched()
    for n in range(len(places)):
        out[n] = hangs_together(fields, spare, room, places[n], normals[n], cells[n], is_void)
    return out


def made(direction=None):
    """Two walls with a slit between them, a hole through one, and a lump beside them."""
    walls = union(slab(-1.6, -0.5, (0.2, 0.1, 1.0)), slab(0.9, 2.4, (0.2, 0.1, 1.0)))
    shape = common(union(without(walls, ball(2.0, (1.0, 2.0, -1.0))), ball(3.0, (-3.0, -4.0, -5.0))), ball(9.0))
    own = lattice(10.0, (0.8, 1.0, 1.1), direction=direction)
    turned = np.eye(3) if direction is None else direction
    made = structures({WALL: lambda p: shape(p @ turned)}, own)
    cells = Geometry.of(
        shape=(9, 10, 11), origin_mm=turned @ (-11.3, -10.9, -9.2), spacing_mm=(CELL_MM,) * 3, direction=turned
    )
    return made, cells


@pytest.fixture(params=["straight", "left-handed"])
def heart(request):
    turn = rotation((1.0, 2.0, 3.0), 33.0) @ np.diag([1.0, 1.0, -1.0])
    return made(turn if request.param == "left-handed" else None)


def places_on_the_border(structures, cells, count, seed=0):
    """Places within a tenth of a cell of the border, and the outward normals there."""
    random = np.random.default_rng(seed)
    places = random.uniform(0.0, cells.size, (60 * count, 3))
    steps = 1e-3 * np.eye(3)
    look = slow_field(structures, cells)
    value = look(places)
    normal = np.stack([look(places + step) - value for step in steps], axis=1)
    length = np.linalg.norm(normal, axis=1)
    good = (np.abs(value) < 0.1) & (length > 0.5e-3)
    return places[good][:count], (normal / np.maximum(length, 1e-30)[:, None])[good][:count]


def slow_field(structures, cells):
    def look(places):
        world = cells.index_to_world(places - 0.5)
        index = structures.geometry.world_to_index(world)
        beyond = np.maximum(-0.5 - index, index - np.array(structures.geometry.size) + 0.5)
        beyond_mm = (beyond * structures.geometry.spacing_mm).max(axis=-1)
        inside = ownership_at_points(structures, world.reshape(-1, 3)).tissue_mm.reshape(beyond_mm.shape)
        return np.where(beyond_mm > 0.0, beyond_mm, inside) / CELL_MM

    return look


def test_the_field_is_that_of_the_structures_and_void_beyond_the_scan(heart):
    structures, cells = heart
    places = np.random.default_rng(1).uniform(-2.0, np.array(cells.size) + 2.0, (2000, 3))
    value, label, edge = _fields(fields_in_cells(FieldReader.of(structures), cells), places).T
    np.testing.assert_allclose(value, slow_field(structures, cells)(places), atol=1e-5)
    world = cells.index_to_world(places - 0.5)
    index = structures.geometry.world_to_index(world)
    size = np.array(structures.geometry.size)
    is_inside = ((index > -0.5) & (index < size - 0.5)).all(axis=1)
    assert 100 < is_inside.sum() < 1900
    np.testing.assert_array_equal(label, np.where(is_inside, ownership_at_points(structures, world).void_label, 0))
    # a sphere as wide as the edge is far does not reach it
    for step in np.eye(3).repeat(2, axis=0) * np.array([0.999, -0.999] * 3)[:, None]:
        moved = structures.geometry.world_to_index(cells.index_to_world(places - 0.5 + step * edge[:, None]))
        np.testing.assert_array_equal(((moved > -0.5) & (moved < size - 0.5)).all(axis=1)[is_inside], True)
    nearest = np.minimum(index + 0.5, size - 0.5 - index) * structures.geometry.spacing_mm / CELL_MM
    np.testing.assert_allclose(edge[is_inside], nearest.min(axis=1)[is_inside], atol=1e-9)


def test_walls_on_a_way_are_those_of_dense_samples(heart):
    structures, cells = heart
    places, normals = places_on_the_border(structures, cells, 1500)
    random = np.random.default_rng(2)
    to = places + random.normal(size=places.shape) * random.uniform(0.1, 2.5, (len(places), 1))
    facing = np.eye(3)[random.integers(0, 3, len(places))] * random.choice([-1.0, 1.0], (len(places), 1))
    found = _beyond(fields_in_cells(FieldReader.of(structures), cells), places, normals, facing, to)
    look = slow_field(structures, cells)
    begin = places + 0.05 * normals
    goes_on = (((to - begin) * facing).sum(axis=1) > 0.0) & (look(to) < 0.0)
    end = to + np.where(goes_on, 0.25, 0.0)[:, None] * facing
    value = look(begin[:, None] + np.linspace(0.0, 1.0, 1000)[:, None] * (end - begin)[:, None])

    def wall(depth, hollow):
        void, deep = value >= hollow, value < -depth
        # the border itself counts as void
        void[:, 0] |= value[:, 0] >= -0.08
        before = np.maximum.accumulate(void, axis=1)
        after = np.maximum.accumulate(void[:, ::-1], axis=1)[:, ::-1]
        return (before & deep & after).any(axis=1)

    # steps are a fiftieth of a cell at least, so between these bounds either may be found
    sure, never = wall(0.1, 0.0), ~wall(0.08, -0.01)
    assert sure.sum() > 100
    assert never.sum() > 100
    assert (sure | never).mean() > 0.95
    assert found[sure].all()
    assert not found[never].any()


@pytest.mark.parametrize("is_void", [False, True])
def test_what_hangs_together_is_what_the_labels_say(heart, is_void):
    structures, cells = heart
    # voids that are apart are rare here: look at more places
    places, normals = places_on_the_border(structures, cells, 9000 if is_void else 1500)
    size = np.array(cells.size)
    random = np.random.default_rng(3)
    target = np.clip(np.floor(places).astype(int) + random.integers(-2, 3, places.shape), 0, size - 1)
    found = _together(fields_in_cells(FieldReader.of(structures), cells), places, normals, target, is_void)
    k, j, i = np.indices(4 * size[::-1])
    samples = cells.index_to_world((np.stack((i, j, k), axis=-1) + 0.5) / 4.0 - 0.5)
    tissue_mm = ownership_at_points(structures, samples.reshape(-1, 3)).tissue_mm.reshape(i.shape)
    mask = (tissue_mm >= 0.0) == is_void
    neighbours = ndimage.generate_binary_structure(3, 1 if is_void else 3)
    begin = places + (0.05 if is_void else -0.05) * normals
    own = np.clip(np.floor(4.0 * begin).astype(int), 0, 4 * size - 1)
    asked = 0
    for n in range(len(places)):
        first, last = np.minimum(own[n] // 4, target[n]), np.maximum(own[n] // 4, target[n])
        low, high = 4 * np.maximum(first - 1, 0), 4 * (last + 2)
        box = tuple(slice(a, b) for a, b in zip(low[::-1], high[::-1], strict=True))
        labels = ndimage.label(mask[box], neighbours)[0]

        def pieces(start, stop, labels=labels, low=low):
            part = labels[
                tuple(slice(max(a, 0), b) for a, b in zip((start - low)[::-1], (stop - low)[::-1], strict=True))
            ]
            return set(np.unique(part).tolist()) - {0}

        mine, theirs = pieces(own[n] - 1, own[n] + 2), pieces(4 * target[n] - 1, 4 * target[n] + 5)
        wanted = not mine or not theirs or bool(mine & theirs)
        assert found[n] == wanted, n
        asked += not wanted
    assert asked > 50
    assert found.mean() > 0.3


def test_what_is_far_apart_does_not_hang_together():
    """Though solid tissue is all that lies between."""
    made = structures({WALL: box((12.0, 2.0, 2.0))}, lattice(14.0))
    cells = Geometry.of(shape=(4, 4, 12), origin_mm=(-13.0, -3.75, -3.75), spacing_mm=(CELL_MM,) * 3)
    vertex, normal = np.array([[0.7, 2.0, 2.0]]), np.array([[-1.0, 0.0, 0.0]])
    fields = fields_in_cells(FieldReader.of(made), cells)
    found = [_together(fields, vertex, normal, np.array([[cell, 1, 1]]), False)[0] for cell in range(10)]
    assert found == [True] * 7 + [False] * 3


def test_a_face_that_looks_into_another_void_is_told_from_one_of_the_same_void():
    """Two cavities on both sides of a wall; one of two labels that are open to each other."""
    wall = common(slab(-1.0, 1.0), ball(9.0))
    for is_open in (False, True):
        shape = without(wall, ball(4.0)) if is_open else wall
        blood = without(ball(9.0), shape)
        made = structures(
            {
                0: lambda p: -ball(9.0)(p),
                LEFT: common(blood, lambda p: p[..., 2]),
                RIGHT: common(blood, lambda p: -p[..., 2]),
                WALL: shape,
            },
            lattice(10.0),
        )
        cells = Geometry.of(shape=(9, 8, 8), origin_mm=(-8.75, -8.75, -8.75), spacing_mm=(CELL_MM,) * 3)
        place = cells.world_to_index((4.1, 0.1, -1.0))[None] + 0.5
        down, up = np.array([[0.0, 0.0, -1.0]]), np.array([[0.0, 0.0, 1.0]])
        cell = np.floor(cells.world_to_index((4.1, 0.1, 0.1)) + 0.5).astype(int)[None]
        fields = fields_in_cells(FieldReader.of(made), cells)
        assert not _elsewhere(fields, place, down, down, cell)[0]
        assert _elsewhere(fields, place, down, up, cell)[0] == (not is_open)


def test_cells_must_be_parallel_to_the_fields():
    structures, cells = made()
    turned = Geometry.of(
        shape=(9, 10, 11),
        origin_mm=(0.0, 0.0, 0.0),
        spacing_mm=cells.spacing_mm,
        direction=rotation((0.0, 0.0, 1.0), 5.0),
    )
    with pytest.raises(ValueError, match="parallel"):
        fields_in_cells(FieldReader.of(structures), turned)
