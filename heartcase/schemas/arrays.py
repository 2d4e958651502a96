"""Types of NumPy arrays, one for each kind of number; what an array's shape and unit are, its own docstring says."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

__all__ = [
    "Bool",
    "Complex64",
    "Float",
    "Float32",
    "Float64",
    "Int8",
    "Int16",
    "Int32",
    "Int64",
    "Integer",
    "Intp",
    "UInt8",
    "UInt16",
    "UInt32",
]

Bool = npt.NDArray[np.bool_]
UInt8 = npt.NDArray[np.uint8]
UInt16 = npt.NDArray[np.uint16]
UInt32 = npt.NDArray[np.uint32]
Int8 = npt.NDArray[np.int8]
Int16 = npt.NDArray[np.int16]
Int32 = npt.NDArray[np.int32]
Int64 = npt.NDArray[np.int64]
Float32 = npt.NDArray[np.float32]
Float64 = npt.NDArray[np.float64]
Complex64 = npt.NDArray[np.complex64]
Intp = npt.NDArray[np.intp]
"""Indices of arrays, as NumPy's own functions return them."""

Float = npt.NDArray[np.floating]
"""Of any width."""

Integer = npt.NDArray[np.integer]
"""Of any width, signed or not."""
