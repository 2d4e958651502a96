"""Situations that are refused: what is wrong, and the words that say so."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pydicom
from pydicom import uid
from pydicom.dataset import FileDataset

from tests.pipeline.formats.dicom_series import header, put_pixels
from tests.pipeline.formats.dicom_situations import STORED, Situation, write
from tests.pipeline.formats.dicom_situations_read import POSITIONS, compressed, enhanced, lossless_jpeg
from tests.pipeline.formats.dicom_situations_stacks import LEAN, NORMAL, cine, echoes, phase, tilted, without

__all__ = ["SITUATIONS"]


def _series(**options: Any) -> Callable[[Path], None]:
    def make(folder: Path) -> None:
        write(folder, **options)

    return make


def _one(change: Callable[[Path], None], **options: Any) -> Callable[[Path], None]:
    """A series with one file spoilt: the third slice's."""

    def make(folder: Path) -> None:
        change(write(folder, order=range(len(STORED)), **options)[2])

    return make


def _edit(**tags: Any) -> Callable[[Path], None]:
    def change(path: Path) -> None:
        dataset = pydicom.dcmread(path)
        for keyword, value in tags.items():
            setattr(dataset, keyword, value)
        dataset.save_as(path, enforce_file_format=True)

    return change


def _cut(count: int) -> Callable[[Path], None]:
    return lambda path: path.write_bytes(path.read_bytes()[:-count]) and None  # type: ignore[return-value]


def _two_series(folder: Path) -> None:
    write(folder, series=2)
    write(folder, series=3, EchoTime=1.5)


def _uneven_phases(folder: Path) -> None:
    for number, time in enumerate((25.0, 50.0, 75.0, 700.0)):
        write(folder, phase(number), first_instance=1 + 100 * number, TriggerTime=time)


def _moved(*places: tuple[int, float]) -> np.ndarray:
    positions = POSITIONS.copy()
    for k, off in places:
        positions[k] += off * NORMAL
    return positions


def _shifted() -> np.ndarray:
    positions = POSITIONS.copy()
    positions[4] += 8.0 * LEAN
    return positions


def _doubled(folder: Path) -> None:
    write(folder)
    write(folder, STORED[3:4], positions=POSITIONS[3:4], first_instance=100, order=[0])


def _other_pixels(folder: Path) -> None:
    write(folder / "a")
    write(folder / "b", (STORED + 1).astype(np.uint16))


def _unexplained(folder: Path) -> None:
    for number in range(3):
        write(folder, STORED, first_instance=1 + 100 * number)


def _single_slice_cine(folder: Path) -> None:
    for number in range(8):
        write(
            folder,
            STORED[4:5],
            positions=POSITIONS[4:5],
            order=[0],
            first_instance=1 + number,
            TriggerTime=40.0 * number,
        )


def _screenshot_frames(folder: Path) -> None:
    dataset = header(sop_class="1.2.840.10008.5.1.4.1.1.7.2", modality="MR")
    put_pixels(dataset, STORED)
    dataset.save_as(folder / "one.dcm", enforce_file_format=True)


def _colour(dataset: FileDataset, index: int) -> None:
    dataset.SamplesPerPixel, dataset.PhotometricInterpretation, dataset.PlanarConfiguration = 3, "RGB", 0
    dataset.PixelData = bytes(6 * dataset.Rows * dataset.Columns)


def _modality(modality: str) -> Callable[[FileDataset, int], None]:
    return lambda dataset, index: setattr(dataset, "Modality", modality)


def _foreign_syntax(dataset: FileDataset, index: int) -> None:
    compressed(uid.JPEGLSLossless)(dataset, index)
    dataset.file_meta.TransferSyntaxUID = uid.HTJ2KLossless


def _frames_missing(folder: Path) -> None:
    enhanced(folder, whole=lambda d: d.PerFrameFunctionalGroupsSequence.pop())


def _huge(dataset: FileDataset, index: int) -> None:
    dataset.Rows, dataset.Columns = 65535, 65535


def _report_only(folder: Path) -> None:
    header(sop_class="1.2.840.10008.5.1.4.1.1.88.11", modality="SR").save_as(
        folder / "report.dcm", enforce_file_format=True
    )


def _only_padding(dataset: FileDataset, index: int) -> None:
    put_pixels(dataset, np.full(STORED.shape[1:], 5, np.uint16))
    dataset.add_new("PixelPaddingValue", "US", 5)


SITUATIONS = (
    Situation(
        "cine in one series, no time given", cine, refused="5 cardiac phases .*10, 50, 90, 130, 170 ms.*--trigger-time"
    ),
    Situation("several echoes, no echo time given", echoes, refused="3 echoes .*1.15, 3.45, 5.75 ms.*--echo-time"),
    Situation("two series, none chosen", _two_series, refused="several series: choose one with --series", lines=3),
    Situation("a series that is not there", _two_series, {"series": "7"}, refused="no series has this number", lines=3),
    Situation(
        "a trigger time, where none is stated",
        _series(),
        {"trigger_time_ms": 5.0},
        refused="no image states its trigger time",
    ),
    Situation(
        "a trigger time far from every phase",
        cine,
        {"trigger_time_ms": 1700.0},
        refused="no trigger time is near 1700 ms, .*10, 50, 90, 130, 170 ms.*trigger_time_ms in the recipe",
    ),
    Situation(
        "a trigger time just beyond half a step",
        cine,
        {"trigger_time_ms": 190.5},
        refused="no trigger time is near 190.5 ms",
    ),
    Situation(
        "a trigger time between phases that lie far apart from the others",
        _uneven_phases,
        {"trigger_time_ms": 375.0},
        refused="no trigger time is near 375 ms, .*25, 50, 75, 700 ms",
    ),
    Situation(
        "a trigger time far from the only one",
        _series(TriggerTime=375.0),
        {"trigger_time_ms": 3750.0},
        refused="no trigger time is near 3750 ms, the only one is 375 ms",
    ),
    Situation(
        "an echo time far from every echo",
        echoes,
        {"echo_time_ms": 34.5},
        refused="no echo time is near 34.5 ms, .*1.15, 3.45, 5.75 ms.*echo_time_ms in the recipe",
    ),
    Situation(
        "an echo time far from the only one",
        _series(EchoTime=1.5),
        {"echo_time_ms": 2.0},
        refused="no echo time is near 2 ms, the only one is 1.5 ms",
    ),
    Situation(
        "one slice missing",
        without(4),
        refused="1 slice is missing between slice 4 .*--interpolate-missing, or interpolate_missing = true",
    ),
    Situation(
        "three slices missing in a row, told to interpolate",
        without(3, 4, 5),
        {"interpolate_missing": True},
        refused="3 slices are missing .*at most two",
    ),
    Situation(
        "four of nine slices missing, told to interpolate",
        without(1, 2, 4, 5),
        {"interpolate_missing": True},
        refused="4 of 9 slices are missing, more than a third",
    ),
    Situation("uneven spacing", _series(positions=_moved((3, 0.3))), refused="uneven spacing"),
    Situation(
        "uneven spacing, told to interpolate",
        _series(positions=_moved((3, 0.3))),
        {"interpolate_missing": True},
        refused="uneven spacing",
    ),
    Situation("gantry tilt", tilted, refused=r"leans by 12\.0 degrees .*--straighten-tilt"),
    Situation("one slice shifted sideways", _series(positions=_shifted()), refused="shifted sideways"),
    Situation(
        "one slice shifted sideways, told to straighten",
        _series(positions=_shifted()),
        {"straighten_tilt": True},
        refused="shifted sideways",
    ),
    Situation(
        "a slice taken twice",
        _doubled,
        refused=r"1 slice is there twice \(slice 4\), with the same pixels: remove the copies",
    ),
    Situation(
        "two files with other pixels claim to be one image",
        _other_pixels,
        refused="slice 1: two files with different pixels",
    ),
    Situation(
        "three images at every position, nothing tells them apart",
        _unexplained,
        refused="3 images at every slice position and nothing",
    ),
    Situation("cine of a single slice", _single_slice_cine, refused="all 8 images show one slice"),
    Situation("a single image", _series(stored=STORED[:1], order=[0]), refused="single image"),
    Situation("multi-frame screenshots", _screenshot_frames, refused="do not say where they lie"),
    Situation("colour", _series(each=_colour), refused="in colour"),
    Situation("PET", _series(each=_modality("PT")), refused="the images are PT: a CT or MR series is needed"),
    Situation("ultrasound", _series(each=_modality("US")), refused="the images are US"),
    Situation("nuclear medicine", _series(each=_modality("NM")), refused="the images are NM"),
    Situation("reports only", _report_only, refused="there is no DICOM image here"),
    Situation("an empty folder", lambda folder: None, refused="there is no DICOM image here"),
    Situation("pixels cut short", _one(_cut(10)), refused="slice 3: the file is cut short or damaged"),
    Situation(
        "header cut short",
        _one(lambda path: path.write_bytes(path.read_bytes()[:420]) and None),
        refused="1 DICOM file is cut short",
    ),
    Situation(
        "an empty .dcm file",
        _one(lambda path: path.rename(path.with_suffix(".dcm")).write_bytes(b"") and None),
        refused="1 DICOM file is cut short",
    ),
    Situation(
        "RLE, cut short",
        _one(_cut(700), each=compressed(uid.RLELossless, encoding_plugin="pydicom")),
        refused="slice 3: the file is cut short",
    ),
    Situation(
        "JPEG lossless, cut short", _one(_cut(700), each=lossless_jpeg), refused="slice 3: the file is cut short"
    ),
    Situation(
        "JPEG-LS, cut short",
        _one(_cut(700), each=compressed(uid.JPEGLSLossless)),
        refused="slice 3: the file is cut short",
    ),
    Situation(
        "JPEG 2000, cut short",
        _one(_cut(700), each=compressed(uid.JPEG2000Lossless)),
        refused="slice 3: the file is cut short",
    ),
    Situation(
        "high-throughput JPEG 2000", _series(each=_foreign_syntax), refused="slice 1: its compression is not read"
    ),
    Situation("enhanced MR, fewer frame headers than frames", _frames_missing, refused="1 DICOM file is cut short"),
    Situation(
        "a slope of 1e300", _one(_edit(RescaleSlope="1e300")), refused="slice 3: its rescaled values are not finite"
    ),
    Situation(
        "directions not at right angles", _series(orientation=[1, 0, 0, 0.1, 0.995, 0]), refused="not at right angles"
    ),
    Situation("pixel spacing of zero", _series(pixel_spacing=(0.0, 1.0)), refused="pixel spacing of zero"),
    Situation("no pixel spacing", _series(pixel_spacing=()), refused="do not say where they lie"),
    Situation("a header that claims 65535 x 65535 pixels", _series(each=_huge), refused="more than 1024 x 1024 x 1024"),
    Situation("nothing but padding", _series(each=_only_padding), refused="all pixels hold the padding value"),
)
"""All of it is refused."""
