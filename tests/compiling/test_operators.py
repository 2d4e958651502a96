"""Types of operators that are remembered are numba's own, and what is compiled with them is the same code."""

import builtins
import itertools
import operator
import re

import numba
import numpy as np
import pytest
from numba.core import types
from numba.core.errors import TypingError
from numba.core.registry import cpu_target

from heartcase.compiling import operators
from heartcase.compiling.kernel import kernel

KINDS = (
    types.int64,
    types.int32,
    types.uint8,
    types.float64,
    types.float32,
    types.boolean,
    types.literal(3),
    types.literal(True),
    types.float64[:, ::1],
    types.int32[::1],
    types.uint8[:],
    types.UniTuple(types.int64, 2),
    types.Tuple((types.int64, types.float64)),
    types.slice2_type,
)
TWO = [
    *("add", "sub", "mul", "truediv", "floordiv", "mod", "pow", "and_", "or_", "xor", "lshift", "rshift", "eq", "ne"),
    *("lt", "le", "gt", "ge", "is_", "getitem", "iadd", "isub", "imul", "itruediv", "contains"),
]
ONE = ("neg", "pos", "not_", "invert", "truth")


def worked_out(function, given):
    """Signature, or None where there is none."""
    try:
        return function(given)
    except (TypingError, AttributeError):  # numba's own, for a number that an array is added to in its place
        return None


@pytest.mark.parametrize("name", [*TWO, *ONE, "bool", "range", "len"])
def test_a_remembered_signature_is_numbas_own(name):
    context = cpu_target.typing_context
    context.refresh()
    asked = context.resolve_value_type(getattr(operator, name, None) or getattr(builtins, name))
    found = 0
    for given in itertools.product(KINDS, repeat=2 if name in TWO else 1):
        plain = worked_out(lambda one: operators._work_out(asked, context, one, {}), given)
        for _ in range(2):
            assert worked_out(lambda one: operators._call_type(asked, context, one, {}), given) == plain
        found += plain is not None
    assert found > 0


def test_what_numba_compiles_for_its_caller_is_asked_for_again():
    def compare(first, values):
        return first in values, first < len(values)

    operators._known.clear()
    with operators.remembered_operators():
        assert kernel(compare, cached=False)(2, np.array([1, 2])) == (True, False)
    names = {key[0].typing_key for key in operators._known}
    assert operator.lt in names
    assert operator.contains not in names


def work(values, weights, limit):
    total = 0.0
    for row in range(values.shape[0]):
        for column in range(values.shape[1]):
            value = values[row, column] * weights[column] ** 2 - limit // 3
            if value > limit and not (column % 2 == 1 or row & 1):
                total += value / (1.0 + abs(value))
            weights[column] -= total * 1e-3
    return total, values[1:, ::2].sum(), (row, column) == (column, row)


def code_of(compiled):
    """Assembly without the numbers that numba gives functions in the order in which it compiles them."""
    compiled.compile((types.float64[:, ::1], types.float64[::1], types.int64))
    (text,) = compiled.inspect_asm().values()
    return re.sub(r"B\d+v\d+\w*?E|v\d+|\d{9,}", "", text)


def test_what_is_compiled_is_the_same_code(monkeypatch):
    class Forgetful(dict):
        def get(self, key, default=None):
            return None

    def run(memory):
        monkeypatch.setattr(operators, "_known", memory)
        compiled = kernel(work, cached=False)
        with operators.remembered_operators():
            return code_of(compiled), compiled(np.arange(12.0).reshape(3, 4), np.linspace(0.5, 1.0, 4), 7)

    memory = {}
    forgetful, first, second = run(Forgetful()), run(memory), run(memory)
    assert memory
    assert first == second == forgetful


def test_other_code_is_compiled_by_numbas_own_way():
    kept = numba.core.types.functions.BaseFunction.get_call_type
    with pytest.raises(TypingError):
        kernel(lambda value: value + undefined)(1)  # noqa: F821
    assert numba.core.types.functions.BaseFunction.get_call_type is kept is operators._work_out
