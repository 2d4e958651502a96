"""Finds planted text in bytes, however it is packed: letters of either case, UTF-16, base 64, hexadecimal, gzip."""

from __future__ import annotations

import base64
import contextlib
import gzip
import re
import zlib
from collections.abc import Iterator
from pathlib import Path

DEPTH = 4


def found_in(content: bytes, tokens: tuple[str, ...]) -> list[str]:
    """Which of the tokens are in the content, in plain or packed form."""
    return sorted({token for layer in _layers(content, DEPTH) for token in tokens if _holds(layer, token)})


def found_in_tree(directory: Path, tokens: tuple[str, ...]) -> dict[str, list[str]]:
    """File -> tokens in its content or in its name below the directory, for all files that hold one."""
    hits = {}
    for path in sorted(directory.rglob("*")):
        name = path.relative_to(directory).as_posix()
        found = found_in(name.encode(), tokens)
        if path.is_file():
            found += found_in(path.read_bytes(), tokens)
        if found:
            hits[name] = sorted(set(found))
    return hits


def _layers(content: bytes, depth: int) -> Iterator[bytes]:
    """The content, and what is packed in it."""
    yield content
    if depth == 0:
        return
    for inner in _unpacked(content):
        yield from _layers(inner, depth - 1)


def _unpacked(content: bytes) -> Iterator[bytes]:
    for match in re.finditer(rb"\x1f\x8b\x08", content):
        with contextlib.suppress(OSError, EOFError, zlib.error):
            yield zlib.decompressobj(31).decompress(content[match.start() :])
    for match in re.finditer(rb"base64,([A-Za-z0-9+/=]+)", content):
        with contextlib.suppress(ValueError):
            yield base64.b64decode(match.group(1))
    if content.startswith(b"\x89PNG"):
        at = 8
        while at + 12 <= len(content):
            length, kind = int.from_bytes(content[at : at + 4], "big"), content[at + 4 : at + 8]
            body = content[at + 8 : at + 8 + length]
            if kind in (b"zTXt", b"iTXt", b"iCCP"):
                _, _, rest = body.partition(b"\0")
                for start in range(min(len(rest), 40)):
                    with contextlib.suppress(zlib.error):
                        yield zlib.decompressobj().decompress(rest[start:])
            at += 12 + length


def _holds(content: bytes, token: str) -> bool:
    lowered = content.lower()
    plain = token.lower().encode()
    if plain in lowered or token.lower().encode("utf-16-le") in lowered or token.lower().encode("utf-16-be") in lowered:
        return True
    if plain.hex().encode() in lowered or token.encode().hex().encode() in lowered:
        return True
    return any(part in content for part in _base64_parts(token))


def _base64_parts(token: str) -> Iterator[bytes]:
    """What a token looks like inside base 64, at each of the three ways it may fall on the groups of bytes."""
    for shift in range(3):
        packed = base64.b64encode(b"\0" * shift + token.encode())
        first = -(-shift * 4 // 3)
        last = (shift + len(token)) // 3 * 4
        if last - first >= 8:
            yield packed[first:last]


def self_check(tokens: tuple[str, ...]) -> None:
    """Every way of packing is seen through: otherwise a clean result says nothing."""
    for token in tokens:
        text = f"before {token} after"
        for packed in (
            text.encode(),
            text.upper().encode(),
            text.encode("utf-16-le"),
            b"NRRD header\n\n" + gzip.compress(text.encode()),
            b'<img src="data:image/png;base64,' + base64.b64encode(text.encode()) + b'">',
            *(base64.b64encode(b"x" * n + text.encode()) for n in range(3)),
            text.encode().hex().encode(),
        ):
            assert token in found_in(packed, tokens), (token, packed)
