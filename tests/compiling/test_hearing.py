"""Who asked is told that kernels are being compiled: when that takes a while, once, and not of what the cache has."""

from __future__ import annotations

import os
import subprocess
import sys
import threading

from heartcase.compiling.hearing import compiling_now, tell_of_compiling, told_when_compiling


def test_what_takes_a_while_is_told_once():
    heard, count = threading.Event(), []

    def hear() -> None:
        count.append(1)
        heard.set()

    with told_when_compiling(hear, after_s=0.01):
        with compiling_now():
            tell_of_compiling()
            assert heard.wait(10.0)
        heard.clear()
        with compiling_now():
            tell_of_compiling()
            assert not heard.wait(0.1)
    assert len(count) == 1


def test_what_is_compiled_sooner_is_not_told_nor_is_anything_after_the_end():
    heard = threading.Event()
    with told_when_compiling(heard.set, after_s=0.05):
        with compiling_now():
            tell_of_compiling()
        assert not heard.wait(0.2)
        with compiling_now():
            tell_of_compiling()
    with compiling_now():
        assert not heard.wait(0.1)


def test_a_kernel_that_is_not_in_the_cache_is_heard_of(tmp_path):
    code = (
        "import numpy as np; from heartcase.compiling.hearing import told_when_compiling;"
        "from tests.compiling import test_calls as t;"
        "heard = told_when_compiling(lambda: print('heard'), after_s=0.001); heard.__enter__();"
        "t._all(t.outer(), np.empty(50)); print('done')"
    )
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path)}
    printed = [
        subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True).stdout
        for _ in range(2)
    ]
    assert [one.split() for one in printed] == [["heard", "done"], ["done"]]
