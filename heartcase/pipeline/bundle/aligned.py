"""Safetensors whose arrays start at multiples of 64 bytes of the file, so that a mapped file can be used in place.

The format allows no holes, so the gaps are arrays of their own, ``_pad0``, ``_pad1``, ..., of type uint8 and all zero,
and the header is filled up with spaces. Any safetensors reader takes such a file; ours and others pass over the pads.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from heartcase.schemas.bundle.format import ALIGNMENT

__all__ = ["AlignedFile", "aligned_safetensors"]

_CODES = {"int32": "I32", "int16": "I16", "float32": "F32", "uint8": "U8"}


@dataclass(frozen=True)
class AlignedFile:
    """A safetensors file in memory."""

    content: bytes
    """The whole file."""
    offsets: dict[str, int]
    """Array -> bytes from the start of the file to its first element, ascending; pads are left out."""


def aligned_safetensors(arrays: Mapping[str, npt.NDArray[Any]]) -> AlignedFile:
    """Write arrays one after the other, little-endian, in C order.

    Parameters
    ----------
    arrays
        Name -> array of int32, int16, float32 or uint8; they are written in this order. A name must not start
        with an underscore.

    Returns
    -------
    AlignedFile
        The same bytes for the same arrays.

    Raises
    ------
    KeyError
        An array has another type.
    """
    header: dict[str, dict[str, Any]] = {}
    chunks: list[bytes] = []
    position = 0

    def put(name: str, code: str, shape: tuple[int, ...], data: bytes) -> None:
        nonlocal position
        header[name] = {"dtype": code, "shape": list(shape), "data_offsets": [position, position + len(data)]}
        chunks.append(data)
        position += len(data)

    for name, array in arrays.items():
        gap = -position % ALIGNMENT
        if gap:
            put(f"_pad{sum(key.startswith('_') for key in header)}", "U8", (gap,), bytes(gap))
        little = np.ascontiguousarray(array, array.dtype.newbyteorder("<"))
        put(name, _CODES[array.dtype.name], array.shape, little.tobytes())
    text = json.dumps(header, separators=(",", ":")).encode()
    text += b" " * (-(8 + len(text)) % ALIGNMENT)
    start = 8 + len(text)
    offsets = {name: start + header[name]["data_offsets"][0] for name in arrays}
    return AlignedFile(b"".join([len(text).to_bytes(8, "little"), text, *chunks]), offsets)
