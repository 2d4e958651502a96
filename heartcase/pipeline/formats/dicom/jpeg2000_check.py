"""Finding damage within a lossless JPEG 2000 frame, for which its decoders do not look.

A frame without error marks has no checksum (ISO/IEC 15444-1). Where bytes within a code block are lost, OpenJPEG, which
the decoders at hand are made with, goes on with what the arithmetic decoder makes of the rest, and says nothing. But a
code block states how many bytes it has, and how many it needs follows from its coefficients, for the encoder has no
choice but in its last bits. So what was decoded is encoded again, losslessly and in blocks of the same size, and each
block must come out as long as it was: a damaged one asks for another number of bytes.
"""

from __future__ import annotations

import io
from dataclasses import dataclass, field

import numpy as np
import PIL.Image

from heartcase.schemas.arrays import Integer

__all__ = ["is_contradictory"]

SIZ, COD, SOT, SOD, EOC = 0xFF51, 0xFF52, 0xFF90, 0xFF93, 0xFFD9
OTHERS = (0xFF53, 0xFF5E, 0xFF5F, 0xFF60, 0xFF61)
"""Markers of what is not followed: components of their own kind, regions, changes of order, packed headers."""
END_BYTES = 4
"""By how many bytes encoders may differ at the end of a code block: how the last bits are flushed is left to them."""
PROGRESSIONS = ("LRCP", "RLCP", "RPCL", "PCRL", "CPRL")
LARGEST_PRECINCT = 15
LARGEST_DEPTH = 16

Block = tuple[int, int, int, int, int]
"""Resolution, precinct, band, row and column of a code block."""


class _Unread(Exception):
    """The frame uses something that is not followed: nothing can be said of it."""


class _Contradiction(Exception):
    """The headers of the packets do not fit the data."""


@dataclass(frozen=True)
class _Style:
    """How a frame is coded."""

    width: int
    height: int
    depth: int
    is_signed: bool
    progression: int
    layers: int
    levels: int
    block_bits: tuple[int, int]
    precinct_bits: tuple[tuple[int, int], ...]
    has_ends: bool
    """Whether a mark follows each packet's header."""


@dataclass
class _Coded:
    """What the packets say of a code block."""

    size: int = 0
    """Bytes."""
    passes: int = 0
    """Coding passes."""
    length_bits: int = 3
    """State of the coding of lengths."""
    is_included: bool = False
    """Whether a packet before held a part of it."""


def is_contradictory(frame: bytes, decoded: Integer) -> bool:
    """Whether a lossless frame cannot be what an encoder made of its decoded values.

    Parameters
    ----------
    frame
        A JPEG 2000 codestream that states to be lossless, of one component and one tile.
    decoded
        Its values, shape (rows, columns), whole numbers.

    Returns
    -------
    bool
        True where it is damaged for sure; False where it is sound, or uses what is not followed here.
    """
    try:
        style, data = _parts(frame)
        if decoded.shape != (style.height, style.width) or (decoded.dtype.kind == "i") != style.is_signed:
            return False
        before = _blocks(style, data)
        after = _blocks(*_parts(_encoded(style, decoded)))
    except _Unread:
        return False
    except (_Contradiction, IndexError):
        return True
    if before.keys() != after.keys():
        return False
    return any(
        one.passes != after[place].passes or abs(one.size - after[place].size) > END_BYTES
        for place, one in before.items()
    )


def _encoded(style: _Style, decoded: Integer) -> bytes:
    """The values as the encoder inside Pillow codes them, in code blocks and precincts of the same size."""
    # an encoder subtracts half of the range from values without a sign: of other depth, other values have that image
    middle = 0 if style.is_signed else 1 << (style.depth - 1)
    shifted = decoded.astype(np.int64) - middle + 2 ** (LARGEST_DEPTH - 1)
    if shifted.min() < 0 or shifted.max() >= 2**LARGEST_DEPTH:
        raise _Unread
    precinct = style.precinct_bits[-1]
    options = {"precinct_size": (1 << precinct[0], 1 << precinct[1])} if precinct[0] < LARGEST_PRECINCT else {}
    buffer = io.BytesIO()
    try:
        PIL.Image.fromarray(shifted.astype(np.uint16)).save(
            buffer,
            "JPEG2000",
            no_jp2=True,
            irreversible=False,
            num_resolutions=style.levels + 1,
            codeblock_size=(1 << style.block_bits[0], 1 << style.block_bits[1]),
            progression="LRCP",
            **options,
        )
    except (OSError, ValueError):
        raise _Unread from None
    return buffer.getvalue()


def _parts(frame: bytes) -> tuple[_Style, bytes]:
    """How a frame is coded, and its packets, those of all parts of the tile in a row."""
    place = frame.find(b"\xff\x4f\xff\x51")
    if place < 0:
        raise _Unread
    place += 2
    siz, cod, packets = b"", b"", []
    while (marker := _number(frame, place, 2)) != EOC:
        if marker in OTHERS:
            raise _Unread
        size = _number(frame, place + 2, 2)
        body = frame[place + 4 : place + 2 + size]
        if marker == SOT:
            length = _number(body, 2, 4)
            start = place + 2 + size
            while _number(frame, start, 2) != SOD:
                if _number(frame, start, 2) in (*OTHERS, COD):
                    raise _Unread
                start += 2 + _number(frame, start + 2, 2)
            end = place + length if length else frame.rindex(b"\xff\xd9")
            packets.append(frame[start + 2 : end])
            place = end
            continue
        siz, cod = (body if marker == SIZ else siz), (body if marker == COD else cod)
        place += 2 + size
    return _style(siz, cod), b"".join(packets)


def _style(siz: bytes, cod: bytes) -> _Style:
    width, height, left, top, tile_width, tile_height, tile_left, tile_top = (
        _number(siz, 2 + 4 * n, 4) for n in range(8)
    )
    is_plain = not (left or top or tile_left or tile_top) and tile_width >= width and tile_height >= height
    depth = siz[36] & 0x7F
    if not is_plain or _number(siz, 34, 2) != 1 or siz[37:39] != b"\x01\x01" or depth >= LARGEST_DEPTH:
        raise _Unread
    flags, progression, layers, levels = cod[0], cod[1], _number(cod, 2, 2), cod[5]
    style, is_reversible = cod[8], cod[9] == 1
    if style or not is_reversible or progression >= len(PROGRESSIONS) or levels > 32:
        raise _Unread
    sizes = [(byte & 15, byte >> 4) for byte in cod[10 : 11 + levels]] if flags & 1 else []
    precincts = tuple(sizes or [(LARGEST_PRECINCT, LARGEST_PRECINCT)] * (levels + 1))
    return _Style(
        width=width,
        height=height,
        depth=depth + 1,
        is_signed=bool(siz[36] & 0x80),
        progression=progression,
        layers=layers,
        levels=levels,
        block_bits=((cod[6] & 15) + 2, (cod[7] & 15) + 2),
        precinct_bits=precincts,
        has_ends=bool(flags & 4),
    )


def _number(data: bytes, place: int, count: int) -> int:
    part = data[place : place + count]
    if len(part) < count:
        raise _Contradiction
    return int.from_bytes(part, "big")


@dataclass
class _Band:
    """The code blocks of a band within a precinct."""

    rows: int
    columns: int
    blocks: list[_Coded]
    included: _TagTree
    empty_planes: _TagTree


class _TagTree:
    """Numbers of a raster, of which the smaller are coded first (ISO/IEC 15444-1, B.10.2)."""

    def __init__(self, rows: int, columns: int) -> None:
        self._shapes = [(rows, columns)]
        while self._shapes[-1] != (1, 1):
            last = self._shapes[-1]
            self._shapes.append((-(-last[0] // 2), -(-last[1] // 2)))
        self._low = [[0] * (r * c) for r, c in self._shapes]
        self._known = [[False] * (r * c) for r, c in self._shapes]

    def is_below(self, bits: _Bits, row: int, column: int, limit: int) -> bool:
        """Whether the number is less than the limit, as far as the bits tell."""
        low = 0
        for level in range(len(self._shapes) - 1, -1, -1):
            place = (row >> level) * self._shapes[level][1] + (column >> level)
            low = max(low, self._low[level][place])
            while low < limit and not self._known[level][place]:
                if bits.next():
                    self._known[level][place] = True
                else:
                    low += 1
            self._low[level][place] = low
        return self._known[0][row * self._shapes[0][1] + column] and low < limit

    def value(self, bits: _Bits, row: int, column: int) -> int:
        """The number itself."""
        limit = 1
        while not self.is_below(bits, row, column, limit):
            limit += 1
            if limit > 128:
                raise _Contradiction
        return limit - 1


@dataclass
class _Bits:
    """The bits of packet headers: after a byte of ones comes a bit that is not counted."""

    data: bytes
    place: int = 0
    _left: int = field(default=0, repr=False)
    _byte: int = field(default=0, repr=False)

    def next(self) -> int:
        if not self._left:
            if self.place >= len(self.data):
                raise _Contradiction
            self._left = 7 if self._byte == 0xFF else 8
            self._byte = self.data[self.place]
            self.place += 1
        self._left -= 1
        return self._byte >> self._left & 1

    def number(self, count: int) -> int:
        value = 0
        for _ in range(count):
            value = 2 * value + self.next()
        return value

    def finish(self) -> None:
        """Go to the next whole byte."""
        if self._byte == 0xFF:
            self.place += 1
        self._left, self._byte = 0, 0


def _blocks(style: _Style, data: bytes) -> dict[Block, _Coded]:
    """What the packets say of all code blocks."""
    precincts = [_precincts(style, resolution) for resolution in range(style.levels + 1)]
    if style.progression > 2 and any(len(one) > 1 for one in precincts):
        raise _Unread
    bits = _Bits(data)
    for layer, resolution, number in _order(style, [len(one) for one in precincts]):
        _read_packet(bits, style, precincts[resolution][number], layer)
    if bits.place != len(data):
        raise _Contradiction
    return {
        (resolution, number, band_number, *divmod(index, band.columns)): block
        for resolution, one in enumerate(precincts)
        for number, bands in enumerate(one)
        for band_number, band in enumerate(bands)
        for index, block in enumerate(band.blocks)
    }


def _order(style: _Style, counts: list[int]) -> list[tuple[int, int, int]]:
    """Layer, resolution and precinct of each packet, of one component."""
    layers, resolutions = range(style.layers), range(len(counts))
    if style.progression == 0:
        return [(layer, r, k) for layer in layers for r in resolutions for k in range(counts[r])]
    if style.progression == 1:
        return [(layer, r, k) for r in resolutions for layer in layers for k in range(counts[r])]
    return [(layer, r, k) for r in resolutions for k in range(counts[r]) for layer in layers]


def _precincts(style: _Style, resolution: int) -> list[list[_Band]]:
    """The bands of each precinct of a resolution, in raster order (ISO/IEC 15444-1, B.5 to B.7)."""
    lower = style.levels - resolution
    columns, rows = -(-style.width >> lower), -(-style.height >> lower)
    bits_x, bits_y = style.precinct_bits[resolution]
    halved = 1 if resolution else 0
    if bits_x < halved or bits_y < halved:
        raise _Unread
    block_x, block_y = min(style.block_bits[0], bits_x - halved), min(style.block_bits[1], bits_y - halved)
    level = lower + halved
    found = []
    for y in range(-(-rows >> bits_y)):
        for x in range(-(-columns >> bits_x)):
            bands = []
            for odd_x, odd_y in ((1, 0), (0, 1), (1, 1)) if resolution else ((0, 0),):
                half = 1 << (level - 1) if level else 0
                band_columns = max(0, -(-(style.width - half * odd_x) >> level))
                band_rows = max(0, -(-(style.height - half * odd_y) >> level))
                across = _count(x, bits_x - halved, band_columns, block_x)
                down = _count(y, bits_y - halved, band_rows, block_y)
                if across and down:
                    blocks = [_Coded() for _ in range(across * down)]
                    bands.append(_Band(down, across, blocks, _TagTree(down, across), _TagTree(down, across)))
            found.append(bands)
    return found


def _count(number: int, precinct_bits: int, length: int, block_bits: int) -> int:
    """Code blocks along one axis of a precinct of a band."""
    start = min(number << precinct_bits, length)
    end = min((number + 1) << precinct_bits, length)
    return (-(-end >> block_bits)) - (start >> block_bits) if end > start else 0


def _read_packet(bits: _Bits, style: _Style, bands: list[_Band], layer: int) -> None:
    """Add what one packet holds (ISO/IEC 15444-1, B.9 and B.10)."""
    if bits.data[bits.place : bits.place + 2] == b"\xff\x91":
        bits.place += 6
    parts = []
    if bits.next():
        for band in bands:
            for index, block in enumerate(band.blocks):
                row, column = divmod(index, band.columns)
                if block.is_included:
                    is_there = bool(bits.next())
                else:
                    is_there = band.included.is_below(bits, row, column, layer + 1)
                if is_there:
                    parts.append(_part_of(bits, band, block, row, column))
    bits.finish()
    if style.has_ends:
        if bits.data[bits.place : bits.place + 2] != b"\xff\x92":
            raise _Contradiction
        bits.place += 2
    bits.place += sum(parts)
    if bits.place > len(bits.data):
        raise _Contradiction


def _part_of(bits: _Bits, band: _Band, block: _Coded, row: int, column: int) -> int:
    """Bytes of a code block in a packet."""
    if not block.is_included:
        band.empty_planes.value(bits, row, column)
        block.is_included = True
    passes = _pass_count(bits)
    while bits.next():
        block.length_bits += 1
        if block.length_bits > 32:
            raise _Contradiction
    size = bits.number(block.length_bits + passes.bit_length() - 1)
    block.passes += passes
    block.size += size
    return size


def _pass_count(bits: _Bits) -> int:
    """Number of coding passes (ISO/IEC 15444-1, table B.4)."""
    if not bits.next():
        return 1
    if not bits.next():
        return 2
    if (few := bits.number(2)) < 3:
        return 3 + few
    if (more := bits.number(5)) < 31:
        return 6 + more
    return 37 + bits.number(7)
