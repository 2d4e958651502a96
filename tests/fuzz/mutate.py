"""Damages bytes: flipped bits, cut ends, lost and doubled parts, numbers of another size."""

from __future__ import annotations

import gzip
import re
import zlib

import numpy as np

__all__ = ["mutated"]

_NUMBERS = [
    *(b"0", b"-1", b"1", b"2", b"3", b"255", b"256", b"65535", b"65536", b"2147483647", b"-2147483648", b"4294967296"),
    *(b"99999999999999999999", b"1e308", b"-1e308", b"1e-320", b"nan", b"inf", b"-inf", b"1e999", b"0x10", b"", b"x"),
]
_HEAD = 4096
"""Most damage goes here, where the headers are."""


def mutated(content: bytes, rng: np.random.Generator) -> bytes:
    """A damaged copy: one to three of the ways of damage, one after the other."""
    if content[:2] == b"\x1f\x8b" and rng.random() < 0.6:
        inner = gzip.decompress(content)
        return gzip.compress(mutated(inner, rng), compresslevel=1, mtime=0)
    at = content.find(b"\n\n\x1f\x8b")
    if at > 0 and rng.random() < 0.4:
        inner = zlib.decompress(content[at + 2 :], 31)
        return content[: at + 2] + gzip.compress(_once(inner, rng), compresslevel=1, mtime=0)
    for _ in range(int(rng.integers(1, 4))):
        content = _once(content, rng)
    return content


def _once(content: bytes, rng: np.random.Generator) -> bytes:
    if not content:
        return rng.bytes(int(rng.integers(1, 64)))
    kind = int(rng.integers(0, 9))
    low = _place(content, rng)
    high = min(len(content), low + int(rng.integers(1, 200)))
    if kind == 0:
        return content[: int(rng.integers(0, len(content)))]
    if kind == 1:
        return content[:low] + content[high:]
    if kind == 2:
        return content[:low] + rng.bytes(high - low) + content[high:]
    if kind == 3:
        return content[:low] + bytes([int(rng.choice([0, 255, 128, 127]))]) * (high - low) + content[high:]
    if kind == 4:
        return content[:high] + content[low:]
    if kind in (5, 6):
        return _other_number(content, rng)
    damaged = bytearray(content)
    for _ in range(int(rng.integers(1, 17))):
        damaged[_place(content, rng)] ^= 1 << int(rng.integers(0, 8))
    return bytes(damaged)


def _place(content: bytes, rng: np.random.Generator) -> int:
    reach = min(len(content), _HEAD) if rng.random() < 0.75 else len(content)
    return int(rng.integers(0, reach))


def _other_number(content: bytes, rng: np.random.Generator) -> bytes:
    found = list(re.finditer(rb"-?\d+(?:\.\d+)?(?:e-?\d+)?", content[:_HEAD]))
    if not found:
        return content[: _place(content, rng)]
    match = found[int(rng.integers(0, len(found)))]
    return content[: match.start()] + _NUMBERS[int(rng.integers(0, len(_NUMBERS)))] + content[match.end() :]
