"""Arrays of other shapes are refused with a short error by our kernels, and with numba's by all other code."""

import numba
import numpy as np
import pytest

from heartcase.compiling.kernel import kernel

SHORT = r"^an array was assigned to one of another shape$"


def assign(place, values):
    place[1:] = values


def test_the_error_of_a_kernel_is_short_and_numbas_own_is_as_it_was():
    ours, plain = kernel(assign), numba.njit(assign)
    for compiled in (ours, plain, ours):
        place = np.zeros(4)
        compiled(place, np.array([1.0, 2.0, 3.0]))
        assert place.tolist() == [0.0, 1.0, 2.0, 3.0]
    with pytest.raises(ValueError, match=SHORT):
        ours(np.zeros(4), np.ones(2))
    with pytest.raises(ValueError, match=r"cannot assign slice of shape"):
        plain(np.zeros(4), np.ones(2))
    with pytest.raises(ValueError, match=SHORT):
        kernel(assign)(np.zeros((4, 3)), np.ones((2, 3)))
