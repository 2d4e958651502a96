"""Damage within lossless JPEG 2000 frames is found; sound ones of every make are never called damaged."""

from __future__ import annotations

import io
import itertools

import numpy as np
import openjpeg
import PIL.Image
import pytest
from openjpeg.utils import encode_array

from heartcase.pipeline.formats.dicom import jpeg2000_check
from heartcase.pipeline.formats.dicom.jpeg2000_check import is_contradictory

PROGRESSIONS = ("LRCP", "RLCP", "RPCL", "PCRL", "CPRL")


def picture(rows: int, columns: int, *, bits: int = 12, noise: float = 20.0) -> np.ndarray:
    j, i = np.indices((rows, columns))
    top = 2**bits - 1
    disc = 0.3 * top + 0.2 * top * ((i - columns / 2) ** 2 + (j - rows / 2) ** 2 < (rows / 4) ** 2)
    return np.clip(disc + np.random.default_rng(4).normal(0.0, noise, (rows, columns)), 0, top)


def by_pillow(values: np.ndarray, **options) -> bytes:
    buffer = io.BytesIO()
    PIL.Image.fromarray(values).save(buffer, "JPEG2000", no_jp2=True, irreversible=False, **options)
    return buffer.getvalue()


def is_followed(frame: bytes) -> bool:
    try:
        jpeg2000_check._blocks(*jpeg2000_check._parts(frame))
    except jpeg2000_check._Unread:
        return False
    return True


def test_sound_frames_of_every_layout_are_sound() -> None:
    values = picture(75, 110, bits=16, noise=90.0).astype(np.uint16)
    followed = 0
    layouts = itertools.product(
        PROGRESSIONS, ((64, 64), (16, 64), (8, 8)), (None, (64, 64)), (1, 4), (None, [30, 8, 1])
    )
    for progression, block, precinct, resolutions, layers in layouts:
        options = {"precinct_size": precinct} if precinct else {}
        options |= {"quality_mode": "rates", "quality_layers": layers} if layers else {}
        frame = by_pillow(values, progression=progression, codeblock_size=block, num_resolutions=resolutions, **options)
        np.testing.assert_array_equal(np.array(PIL.Image.open(io.BytesIO(frame))), values)
        followed += is_followed(frame)
        assert not is_contradictory(frame, values), (progression, block, precinct, resolutions, layers)
    assert followed > 90


@pytest.mark.parametrize(("bits", "is_signed"), [(8, False), (10, False), (12, True), (16, False), (16, True)])
def test_sound_frames_of_every_depth_are_sound(bits: int, is_signed: bool) -> None:
    values = picture(60, 51, bits=bits, noise=3.0)
    if is_signed:
        values = values - 2 ** (bits - 1)
    stored = values.astype({True: np.int16, False: np.uint8 if bits == 8 else np.uint16}[is_signed])
    frame = encode_array(stored, bits_stored=bits, photometric_interpretation=2)
    assert is_followed(frame)
    assert not is_contradictory(frame, stored)
    changed = stored.copy()
    changed[20:40, 20:40] += np.random.default_rng(0).integers(0, 60, (20, 20)).astype(stored.dtype)
    assert is_contradictory(frame, changed)


@pytest.mark.parametrize(("size", "least"), [((36, 34), 0.85), ((128, 128), 0.95)])
def test_zeroed_bytes_are_found_wherever_they_are(size: tuple[int, int], least: float) -> None:
    stored = picture(*size).astype(np.uint16)
    frame = encode_array(stored, bits_stored=12, photometric_interpretation=2)
    start = frame.index(b"\xff\x93") + 2
    found = []
    for place in np.linspace(start, len(frame) - 45, 60).astype(int):
        damaged = frame[:place] + bytes(40) + frame[place + 40 :]
        decoded = openjpeg.decode(damaged)
        if not np.array_equal(decoded, stored):
            found.append(is_contradictory(damaged, decoded))
    assert len(found) > 50
    assert np.mean(found) >= least


def test_whatever_the_bytes_are_it_ends() -> None:
    stored = picture(36, 34).astype(np.uint16)
    frame = encode_array(stored, bits_stored=12, photometric_interpretation=2)
    rng = np.random.default_rng(6)
    for _ in range(150):
        damaged = bytearray(frame)
        for place in rng.integers(0, len(frame), 3):
            damaged[place] ^= int(rng.integers(1, 256))
        assert is_contradictory(bytes(damaged), stored) in (True, False)
    for size in range(0, len(frame), 37):
        assert is_contradictory(frame[:size], stored) in (True, False)
