"""A team of threads that take steps together, and the barrier at which they wait for one another.

A barrier is a counter that the last thread to arrive resets. The others wait for it without rest at first, as steps are
short, and then give their turn to whatever else wants the core: on a busy machine that may be the very thread that they
wait for.
"""

from __future__ import annotations

import os
import platform
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor, wait
from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from heartcase.compiling.emitting import array_data, named_function, nothing
from heartcase.compiling.kernel import kernel
from heartcase.schemas.arrays import Int64

__all__ = ["Barrier", "ThreadTeam", "raise_to", "wait_at"]

Barrier = Int64

PATIENCE = 30_000
"""Looks at a barrier before a thread gives its turn away, some 0.3 to 1 ms: two threads that the system has put on one
core while another is idle are moved apart only if one of them waits for longer than that."""
_ARRIVED, _ROUND, _ABANDONED = 0, 16, 32
"""Places in a barrier's array, on cache lines of their own."""
_SIZE = 48
_INT64 = ir.IntType(64)
_IS_X86 = platform.machine().lower() in ("x86_64", "amd64")


class ThreadTeam:
    """As many threads as there are parts; the caller's own is one of them. The others start when first needed."""

    def __init__(self) -> None:
        self._pool: ThreadPoolExecutor | None = None
        self._size = 0
        self._process = 0

    def run(self, thread_count: int, work: Callable[[int, int, Barrier], int]) -> int:
        """Do the parts of some work at the same time.

        Parameters
        ----------
        thread_count
            Threads, 1 for the caller's alone.
        work
            Called with the thread's number, their count, and a barrier that they may :func:`wait_at`; where they do, it
            must be the first that each does. It must let go of Python's lock.

        Returns
        -------
        int
            What the caller's own part returned. An interrupt before it began leaves the work undone.
        """
        barrier = np.zeros(_SIZE, np.int64)
        if thread_count == 1:
            return work(0, 1, barrier)

        def part(number: int) -> int:
            try:
                return work(number, thread_count, barrier)
            except BaseException:
                # The others must not wait for one that does not come.
                barrier[_ABANDONED] = 1
                raise

        pool = self._others(thread_count - 1)
        parts: list[Future[int]] = []
        try:
            for number in range(1, thread_count):
                parts.append(pool.submit(part, number))
            result = part(0)
        except BaseException:
            # Also where an interrupt came between two lines of this function.
            barrier[_ABANDONED] = 1
            raise
        finally:
            wait(parts)
        for other in parts:
            other.result()
        return result

    def _others(self, count: int) -> ThreadPoolExecutor:
        # Threads do not live on in a forked process.
        if self._pool is None or self._size < count or self._process != os.getpid():
            self._pool = ThreadPoolExecutor(count, thread_name_prefix="heartcase-steps")
            self._size, self._process = count, os.getpid()
        return self._pool


def _pointer(context: Any, builder: Any, kind: Any, array: Any, place: int) -> Any:
    return builder.gep(array_data(context, builder, kind, array), [ir.Constant(_INT64, place)])


@intrinsic
def _arrive(typing_context, barrier):
    """Count this thread in; returns how many had arrived before."""

    def codegen(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        place = _pointer(context, builder, signature.args[0], arguments[0], _ARRIVED)
        return builder.atomic_rmw("add", place, ir.Constant(_INT64, 1), "acq_rel")

    return types.int64(barrier), codegen


def _make_read(place: int) -> Any:
    @intrinsic
    def read(typing_context, barrier):
        def codegen(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            where = _pointer(context, builder, signature.args[0], arguments[0], place)
            return builder.load_atomic(where, "acquire", 8)

        return types.int64(barrier), codegen

    return read


_round, _is_abandoned = _make_read(_ROUND), _make_read(_ABANDONED)


@intrinsic
def _begin(typing_context, barrier, number):
    """Let all threads go on: the counter starts anew, then the next round begins."""

    def codegen(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        kind, array = signature.args[0], arguments[0]
        arrived = _pointer(context, builder, kind, array, _ARRIVED)
        builder.store_atomic(ir.Constant(_INT64, 0), arrived, "monotonic", 8)
        builder.store_atomic(arguments[1], _pointer(context, builder, kind, array, _ROUND), "release", 8)
        return nothing(context)

    return types.void(barrier, types.int64), codegen


@intrinsic
def _pause(typing_context):
    """Let the core rest for a moment, where it can."""

    def codegen(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        if _IS_X86:
            kind = ir.FunctionType(ir.VoidType(), [])
            builder.call(named_function(builder, kind, "llvm.x86.sse2.pause"), [])
        return nothing(context)

    return types.void(), codegen


@intrinsic
def _give_way(typing_context):
    """Give the rest of this thread's turn to others that wait for the core."""

    def codegen(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        name = "SwitchToThread" if platform.system() == "Windows" else "sched_yield"
        kind = ir.FunctionType(ir.IntType(32), [])
        builder.call(named_function(builder, kind, name), [])
        return nothing(context)

    return types.void(), codegen


@kernel
def wait_at(barrier: Barrier, thread_count: int) -> bool:
    """Wait for all threads; what they wrote before can be read after. False where the work was abandoned."""
    if thread_count == 1:
        return True
    number = _round(barrier)
    if _arrive(barrier) + 1 == thread_count:
        _begin(barrier, number + 1)
        return True
    looks = 0
    while _round(barrier) == number:
        if _is_abandoned(barrier):
            return False
        if looks < PATIENCE:
            looks += 1
            _pause()
        else:
            _give_way()
    return True


@intrinsic
def raise_to(typing_context, array, place, value):
    """Set an int8 of an array, shape (n,), to a value at least, whatever other threads do to it; values from 0 up."""

    def codegen(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        data = array_data(context, builder, signature.args[0], arguments[0])
        builder.atomic_rmw("umax", builder.gep(data, [arguments[1]]), arguments[2], "monotonic")
        return nothing(context)

    return types.void(array, types.intp, types.int8), codegen
