"""Situations of damage that no decoder refuses by itself: files cut within their headers, bytes lost within a frame."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pydicom
from pydicom import uid
from pydicom.dataset import FileDataset
from pydicom.encaps import encapsulate, get_frame

from tests.pipeline.formats.dicom_situations import STORED, Situation, write
from tests.pipeline.formats.dicom_situations_read import _jpeg_baseline, compressed, lossless_jpeg

__all__ = ["SITUATIONS", "zeroed"]

Each = Callable[[FileDataset, int], None]


def _cut_to(size: int, place: int, **options: Any) -> Callable[[Path], None]:
    """A series with the file of one slice cut to so many bytes."""

    def make(folder: Path) -> None:
        path = write(folder, order=range(len(STORED)), **options)[place]
        path.write_bytes(path.read_bytes()[:size])

    return make


def _no_class(dataset: FileDataset, index: int) -> None:
    del dataset.SOPClassUID


def _no_class_anywhere(dataset: FileDataset, index: int) -> None:
    dataset.SOPClassUID = "1.2.826.0.1.3680043.8.498.77"
    dataset.file_meta.MediaStorageSOPClassUID = "1.2.826.0.1.3680043.8.498.77"


def zeroed(path: Path, start: int, count: int = 40) -> None:
    """Set bytes of the first frame to zero; a negative start counts from its end."""
    dataset = pydicom.dcmread(path)
    frame = bytearray(get_frame(dataset.PixelData, 0, number_of_frames=1))
    place = start % len(frame)
    frame[place : place + count] = bytes(count)
    dataset.PixelData = encapsulate([bytes(frame)])
    dataset["PixelData"].VR = "OB"
    dataset.save_as(path, enforce_file_format=True)


def _zeroed_in(each: Each, start: int) -> Callable[[Path], None]:
    def make(folder: Path) -> None:
        zeroed(write(folder, order=range(len(STORED)), each=each)[2], start)

    return make


CUT = "1 DICOM file is cut short or damaged"
COMPLAINT = "slice 3: its compressed pixels are damaged and would give wrong values"

SITUATIONS = (
    Situation("a file cut after its preamble, at the end of the stack", _cut_to(140, 8), refused=CUT),
    Situation("a file cut in its file meta information, at the end", _cut_to(200, 8), refused=CUT),
    Situation("a file cut right after its file meta information, at the end", _cut_to(316, 8), refused=CUT),
    Situation("a file cut in its first elements, in the middle", _cut_to(330, 4), refused=CUT),
    Situation("a file cut after its class, at the end", _cut_to(350, 8), refused=CUT),
    Situation("a file without a class cut in its header, at the end", _cut_to(350, 8, each=_no_class), refused=CUT),
    Situation("a file of an unknown class cut in its header", _cut_to(412, 8, each=_no_class_anywhere), refused=CUT),
    Situation(
        "RLE, 40 bytes zeroed",
        _zeroed_in(compressed(uid.RLELossless, encoding_plugin="pydicom"), 300),
        refused=COMPLAINT,
    ),
    Situation("JPEG lossless, 40 bytes zeroed", _zeroed_in(lossless_jpeg, 300), refused=COMPLAINT),
    Situation("JPEG baseline, 40 bytes zeroed", _zeroed_in(_jpeg_baseline, 700), refused=COMPLAINT),
    Situation(
        "JPEG 2000 lossless, 40 bytes zeroed",
        _zeroed_in(compressed(uid.JPEG2000Lossless), 600),
        refused=COMPLAINT,
    ),
    Situation(
        "JPEG-LS, 40 bytes zeroed",
        _zeroed_in(compressed(uid.JPEGLSLossless), 300),
        refused="slice 3: the file is cut short or damaged",
    ),
)
"""All of it is refused."""
