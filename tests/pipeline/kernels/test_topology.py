import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from scipy import ndimage
from skimage import measure

from heartcase.pipeline.kernels.topology import (
    betti_numbers,
    components,
    distance_in_samples,
    euler_characteristic,
    piece_sizes,
)
from tests.pipeline.analytic_structures import ball, lattice, torus, union, without


def mask_of(shape, half_mm=14.0):
    geometry = lattice(half_mm, shift=(0.13, 0.21, 0.08))
    k, j, i = np.indices(geometry.shape)
    return shape(geometry.index_to_world(np.stack((i, j, k), axis=-1))) < 0.0


@pytest.mark.parametrize("connectivity", [6, 26])
@pytest.mark.parametrize(
    ("shape", "expected"),
    [
        (ball(8.0), [1, 0, 0]),
        (without(ball(10.0), ball(6.0)), [1, 0, 1]),
        (torus(8.0, 3.0), [1, 1, 0]),
        (union(ball(4.0, (-6.0, 0.0, 0.0)), ball(4.0, (6.0, 0.0, 0.0))), [2, 0, 0]),
        (union(torus(8.0, 3.0), ball(2.0)), [2, 1, 0]),
        (without(torus(8.0, 3.5), torus(8.0, 1.5)), [1, 2, 1]),
    ],
    ids=["ball", "shell", "torus", "two balls", "ball in a ring", "hollow ring"],
)
def test_betti_numbers_of_known_shapes(shape, expected, connectivity):
    assert betti_numbers(mask_of(shape), connectivity).as_list() == expected


def test_two_cubes_that_share_a_corner_depend_on_the_adjacency():
    mask = np.zeros((2, 2, 2), bool)
    mask[0, 0, 0] = mask[1, 1, 1] = True
    assert betti_numbers(mask, 26).as_list() == [1, 0, 0]
    assert betti_numbers(mask, 6).as_list() == [2, 0, 0]


def test_a_shell_that_touches_itself_diagonally_encloses_a_cavity_only_for_26_neighbours():
    mask = np.zeros((3, 3, 3), bool)
    mask[0, 1, 1] = mask[2, 1, 1] = mask[1, 0, 1] = mask[1, 2, 1] = mask[1, 1, 0] = mask[1, 1, 2] = True
    assert betti_numbers(mask, 26).as_list() == [1, 0, 1]
    assert betti_numbers(mask, 6).as_list() == [6, 0, 0]


def test_empty_and_full_masks():
    assert betti_numbers(np.zeros((3, 4, 5), bool), 26).as_list() == [0, 0, 0]
    assert betti_numbers(np.ones((3, 4, 5), bool), 6).as_list() == [1, 0, 0]


@settings(max_examples=40, deadline=None)
@given(hnp.arrays(bool, st.tuples(*[st.integers(2, 7)] * 3)))
def test_euler_characteristic_and_components_agree_with_independent_libraries(mask):
    structure = {6: ndimage.generate_binary_structure(3, 1), 26: np.ones((3, 3, 3))}
    for connectivity, order in ((6, 1), (26, 3)):
        padded = np.pad(mask, 1)
        assert euler_characteristic(mask, connectivity) == measure.euler_number(padded, connectivity=order)
        labels, count = components(mask, connectivity)
        expected, expected_count = ndimage.label(mask, structure[connectivity])
        assert count == expected_count
        np.testing.assert_array_equal(labels, expected)


def test_distance_in_samples_does_not_end_at_the_border():
    mask = np.ones((1, 1, 6), bool)
    mask[0, 0, 2] = False
    np.testing.assert_allclose(distance_in_samples(mask)[0, 0], [2.0, 1.0, 0.0, 1.0, 2.0, 3.0])


def test_sizes_of_pieces_are_counts_of_their_numbers():
    labels = np.random.default_rng(0).integers(0, 9, (7, 8, 9)).astype(np.uint32)
    np.testing.assert_array_equal(piece_sizes(labels.ravel(), 10), np.bincount(labels.ravel(), minlength=11))
