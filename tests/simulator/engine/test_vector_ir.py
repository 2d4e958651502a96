"""Which products and sums are fused is settled before LLVM has the code: all its copies have the same bits."""

from __future__ import annotations

import re

import numpy as np
import pytest
from llvmlite import ir
from numba import njit, types
from numba.extending import intrinsic

from heartcase.compiling.emitting import array_data
from heartcase.simulator.engine.cpu import cells
from heartcase.simulator.engine.cpu.cells import (
    element_of_window,
    gradient_of_window,
    guard_of_window,
    mean_stress_of_window,
    sharing_element_of_window,
    volume_of_window,
)
from heartcase.simulator.engine.cpu.steps import STEPS_BY_ORDER, step_of_windows_with_cells
from heartcase.simulator.engine.cpu.vector_ir import Lanes
from heartcase.simulator.engine.shared.lanes import BANK_LANES, CELL_PARTS, LANE_COUNT, PART_LANES

ONE_PRODUCT = [
    lambda a, b, c, times: times(a, b) + c,
    lambda a, b, c, times: c + times(a, b),
    lambda a, b, c, times: times(a, b) - c,
    lambda a, b, c, times: c - times(a, b),
    lambda a, b, c, times: c + -times(a, b),
    lambda a, b, c, times: -times(a, b) - c,
    lambda a, b, c, times: 1.5 - times(a, b),
    lambda a, b, c, times: times(a, 1.25 + 2.0**-20) + c,
]
SUMS = [
    *ONE_PRODUCT,
    lambda a, b, c, times: times(a, b) + times(b, c),
    lambda a, b, c, times: times(a, b) - times(b, c),
]


def make_sums(keeps_products: bool):
    """A kernel that works out the sums, each of its own row of numbers; it may keep the products, too."""

    @intrinsic
    def emitted(typing_context, numbers, sums, products):
        def codegen(context, builder, signature, arguments):
            arrays = zip(signature.args, arguments, strict=True)
            numbers, sums, products = (array_data(context, builder, *pair) for pair in arrays)

            def row(data, number):
                return builder.gep(data, [ir.Constant(ir.IntType(64), number * LANE_COUNT)])

            for number, of in enumerate(SUMS):
                made = []

                def times(a, b, made=made):
                    made.append(a * b)
                    return made[-1]

                a, b, c = (Lanes.loaded(builder, row(numbers, 3 * number + place)) for place in range(3))
                of(a, b, c, times).store(row(sums, number))
                for place, product in enumerate(made):
                    if keeps_products:
                        product.store(row(products, 2 * number + place))
            return context.get_dummy_value()

        return types.void(numbers, sums, products), codegen

    @njit
    def kernel(numbers, sums, products):
        emitted(numbers, sums, products)

    return kernel


def test_a_sum_does_not_depend_on_what_else_is_made_of_its_product():
    numbers = np.random.default_rng(1).uniform(0.5, 2.0, (len(SUMS), 3, LANE_COUNT)).astype(np.float32)
    alone, beside = np.zeros((2, len(SUMS), LANE_COUNT), np.float32)
    products = np.zeros((len(SUMS), 2, LANE_COUNT), np.float32)
    make_sums(keeps_products=False)(numbers, alone, products)
    assert not products.any()
    make_sums(keeps_products=True)(numbers, beside, products)
    np.testing.assert_array_equal(alone, beside)
    np.testing.assert_array_equal(products[0, 0], numbers[0, 0] * numbers[0, 1])

    once = [
        of(*row.astype(float), np.multiply).astype(np.float32) for of, row in zip(ONE_PRODUCT, numbers, strict=False)
    ]
    twice = [of(*row, lambda a, b: a * np.float32(b)) for of, row in zip(ONE_PRODUCT, numbers, strict=False)]
    assert (np.array(once) != np.array(twice)).any(axis=1).all()
    rounded = once if np.array_equal(alone[0], once[0]) else twice
    np.testing.assert_array_equal(alone[: len(ONE_PRODUCT)], rounded)


ARRAY, ROWS, WINDOW = types.float32[::1], types.int64[:, ::1], types.int64
CELLS = [ROWS, WINDOW, types.int8]
STEP = [
    *[ARRAY] * 4,
    types.float32[:, :, ::1],
    *[ARRAY] * 3,
    ROWS,
    types.int64[::1],
    WINDOW,
    WINDOW,
    types.UniTuple(types.float32, 7),
]
KERNELS = {
    "step": (step_of_windows_with_cells, STEP),
    "step in turn": (STEPS_BY_ORDER[False], STEP),
    "element": (element_of_window, [*[ARRAY] * 4, *CELLS]),
    "volume": (volume_of_window, [*[ARRAY] * 4, *CELLS]),
    "gradient": (gradient_of_window, [*[ARRAY] * 3, *CELLS]),
    "mean stress": (mean_stress_of_window, [*[ARRAY] * 5, ROWS, WINDOW, WINDOW]),
    "sharing element": (sharing_element_of_window, [*[ARRAY] * 6, *CELLS]),
    "guard": (guard_of_window, [*[ARRAY] * 4, *CELLS]),
}


@pytest.mark.parametrize("name", KERNELS)
def test_the_compiler_is_free_to_change_no_number_of_a_kernel(name):
    window_kernel, kinds = KERNELS[name]
    kernel = njit(lambda given: window_kernel(*given))
    kernel.compile((types.Tuple(kinds),))
    (code,) = kernel.inspect_llvm().values()
    assert re.search(r"fmul <(8|16) x float>", code)
    assert "@llvm.fmuladd" in code
    assert not re.search(r"= (f\w+|(tail )?call) (fast|contract|reassoc|nnan|ninf|nsz|arcp|afn)\b", code)


@pytest.mark.parametrize("name", ["element", "volume", "gradient", "sharing element", "guard"])
@pytest.mark.parametrize("in_pairs", [0, 1])
def test_a_window_in_halves_gives_the_bits_of_one_at_once(name, in_pairs, monkeypatch):
    """Where registers have 8 lanes, or fewer, it is worked out in halves.

    Parts lie anywhere, also over each other: the next row of one half's may be the own of the other's.
    """
    window_kernel, kinds = KERNELS[name]
    rng = np.random.default_rng(in_pairs)
    given = [rng.normal(0.0, 0.05, 16 * BANK_LANES).astype(np.float32) for _ in kinds[:-3]]
    given[-1][:6] = 2.0  # a law whose floor of corners is above them all
    starts = rng.choice(np.arange(2, 60), (40, CELL_PARTS // (1 + in_pairs), 4))
    starts = np.repeat(starts, 1 + in_pairs, axis=1) + PART_LANES * (np.arange(CELL_PARTS) % (1 + in_pairs))[:, None]
    rows = starts.reshape(len(starts), -1)
    ends = []
    for is_wide in (False, True):
        monkeypatch.setattr(cells, "has_wide_registers", lambda context, is_wide=is_wide: is_wide)
        kernel = njit(lambda given: window_kernel(*given))
        found = []
        for window in range(len(rows)):
            arrays = [array.copy() for array in given]
            kernel((*arrays, rows, window, np.int8(in_pairs)))
            found.append(b"".join(array.tobytes() for array in arrays))
        ends.append(found)
    assert ends[0] == ends[1]
    assert b"".join(array.tobytes() for array in given) not in ends[0]
