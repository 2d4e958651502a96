"""What a kernel is compiled without, other code has; and the code is the same."""

import numba
import numpy as np
from numba.core.codegen import CPUCodegen, CPUCodeLibrary
from numba.core.lowering import Lower

from heartcase.compiling.kernel import kernel
from heartcase.compiling.unneeded_work import without_unneeded_work


def largest(values):
    return max(values[0], values[1]) + np.empty(3).size


def test_only_numbas_own_functions_have_no_wrapper_for_c(monkeypatch):
    wrapped, make = [], Lower.create_cfunc_wrapper

    def note(lowering):
        wrapped.append(lowering.fndesc.modname)
        make(lowering)

    monkeypatch.setattr("heartcase.compiling.unneeded_work._wrap_for_c", note)
    helper = numba.njit(lambda values: values[0] + max(values[1], 3))
    with without_unneeded_work():
        assert kernel(lambda values: helper(values) + largest_of(values), cached=False)(np.array([2, 5])) == 15
    # that of a function that nobody made as a kernel, which others may take the address of
    assert set(wrapped) == {__name__}


largest_of = kernel(largest, cached=False)


def test_only_bodies_are_optimised(monkeypatch):
    runs, make = [], CPUCodegen._function_pass_manager
    monkeypatch.setattr(CPUCodegen, "_function_pass_manager", lambda codegen: runs.append(1) or make(codegen))
    kept = CPUCodeLibrary._optimize_functions, Lower.create_cfunc_wrapper
    plain, ours = kernel(largest, cached=False), kernel(largest, cached=False)
    found, run_count = plain(np.array([2.0, 5.0])), len(runs)
    runs.clear()
    with without_unneeded_work():
        assert (CPUCodeLibrary._optimize_functions, Lower.create_cfunc_wrapper) != kept
        assert ours(np.array([2.0, 5.0])) == found == 8.0
    # what has no body has no passes
    assert 0 < len(runs) < run_count / 2
    assert (CPUCodeLibrary._optimize_functions, Lower.create_cfunc_wrapper) == kept
