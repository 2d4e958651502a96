"""Intrinsics of the CUDA kernels: vectors of four in one access, and a grid-wide barrier.

In numba's CUDA simulator, which runs a single block of threads, the same names are plain Python.
"""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba import config, cuda, types

__all__ = ["IS_SIMULATED", "load_four", "register_limit", "store_four", "wait_at_grid_barrier"]

IS_SIMULATED = bool(config.ENABLE_CUDASIM)
"""Whether kernels run in numba's simulator instead of on a device."""


def register_limit(count: int) -> dict[str, int]:
    """The option of ``cuda.jit`` that keeps a kernel to a number of registers per thread."""
    return {} if IS_SIMULATED else {"max_registers": count}


if IS_SIMULATED:

    def load_four(array: Any, number: Any) -> Any:
        """The four float32 of vector ``number``."""
        return tuple(array[4 * int(number) : 4 * int(number) + 4])

    def store_four(array: Any, number: Any, x: Any, y: Any, z: Any, w: Any) -> None:
        """Write the four float32 of vector ``number``."""
        array[4 * int(number) : 4 * int(number) + 4] = x, y, z, w

    @cuda.jit(device=True)
    def wait_at_grid_barrier(arrivals, expected):
        """Wait for all threads of the grid."""
        cuda.syncthreads()

else:
    # numba-cuda keeps a registry of intrinsics of its own; numba's older CUDA target has numba's.
    try:
        from numba.cuda.extending import intrinsic
    except ImportError:
        from numba.extending import intrinsic

    _INT32, _INT64 = ir.IntType(32), ir.IntType(64)
    _FOUR = ir.VectorType(ir.FloatType(), 4)

    def _data(context: Any, builder: Any, kind: Any, array: Any) -> Any:
        return context.make_array(kind)(context, builder, array).data

    def _pointer(context: Any, builder: Any, kind: Any, array: Any, number: Any) -> Any:
        vectors = builder.bitcast(_data(context, builder, kind, array), _FOUR.as_pointer())
        return builder.gep(vectors, [builder.zext(number, _INT64)])

    @intrinsic
    def load_four(typing_context, array, number):
        """The four float32 of vector ``number``, in one access."""

        def codegen(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            vector = builder.load(_pointer(context, builder, signature.args[0], *arguments), align=16)
            parts = [builder.extract_element(vector, ir.Constant(_INT32, part)) for part in range(4)]
            return context.make_tuple(builder, signature.return_type, parts)

        return types.UniTuple(types.float32, 4)(array, types.uint32), codegen

    @intrinsic
    def store_four(typing_context, array, number, x, y, z, w):
        """Write the four float32 of vector ``number``, in one access."""

        def codegen(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            vector = ir.Constant(_FOUR, ir.Undefined)
            for part, value in enumerate(arguments[2:]):
                vector = builder.insert_element(vector, value, ir.Constant(_INT32, part))
            builder.store(vector, _pointer(context, builder, signature.args[0], *arguments[:2]), align=16)
            return context.get_dummy_value()

        return types.void(array, types.uint32, types.float32, types.float32, types.float32, types.float32), codegen

    @intrinsic
    def _arrive(typing_context, arrivals):
        """Count this block of threads; what it wrote before is seen by who sees the count."""

        def codegen(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            counter = _data(context, builder, signature.args[0], arguments[0])
            kind = ir.FunctionType(ir.VoidType(), [counter.type])
            code = "red.release.gpu.global.add.u32 [$0], 1;"
            builder.call(ir.InlineAsm(kind, code, "l,~{memory}", side_effect=True), [counter])
            return context.get_dummy_value()

        return types.void(arrivals), codegen

    @intrinsic
    def _arrived(typing_context, arrivals):
        """Blocks counted until now; what they wrote before is seen from here on."""

        def codegen(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            counter = _data(context, builder, signature.args[0], arguments[0])
            kind = ir.FunctionType(_INT32, [counter.type])
            code = "ld.acquire.gpu.global.u32 $0, [$1];"
            return builder.call(ir.InlineAsm(kind, code, "=r,l,~{memory}", side_effect=True), [counter])

        return types.uint32(arrivals), codegen

    @cuda.jit(device=True)
    def wait_at_grid_barrier(arrivals, expected):
        """Wait until ``expected`` blocks of threads were counted: half the time of numba's grid-wide barrier."""
        cuda.syncthreads()
        if cuda.threadIdx.x == 0:
            _arrive(arrivals)
            while _arrived(arrivals) < expected:
                pass
        cuda.syncthreads()
