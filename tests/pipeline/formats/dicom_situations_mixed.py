"""Situations in which images of one series, or files of one image, do not state the same."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pydicom
from pydicom.datadict import dictionary_VR, tag_for_keyword
from pydicom.dataelem import RawDataElement
from pydicom.dataset import Dataset, FileDataset
from pydicom.tag import Tag

from heartcase.pipeline.formats.dicom.tags import quiet_pydicom
from tests.pipeline.formats.dicom_series import items
from tests.pipeline.formats.dicom_situations import GEOMETRY, PLANTED, STORED, Situation, Truth, write
from tests.pipeline.formats.dicom_situations_read import POSITIONS, enhanced

__all__ = ["SITUATIONS"]

MAGNITUDE, VELOCITY = ["ORIGINAL", "PRIMARY", "M"], ["ORIGINAL", "PRIMARY", "P"]
HALF_STEP = 0.5 * GEOMETRY.spacing_mm[2] * GEOMETRY.direction_matrix[:, 2]
SECOND = (STORED * 2).astype(np.uint16)


def _every_second() -> Truth:
    """The slices 1, 3, 5 ... of the stack, as a stack of their own."""
    affine = GEOMETRY.affine.copy()
    affine[:, 2] *= 2.0
    return Truth(STORED[::2], affine)


def _in_turn(keyword: str, values: tuple[Any, Any]) -> Callable[[Path], Truth]:
    """A tag has one value in the slices 1, 3, 5 ... and another in those between; the former are wanted."""

    def make(folder: Path) -> Truth:
        write(folder, each=lambda dataset, index: setattr(dataset, keyword, values[index % 2]))
        return _every_second()

    return make


def _stack_ids_in_turn(folder: Path) -> Truth:
    def frames(frame: Dataset, number: int) -> None:
        frame.FrameContentSequence = items(StackID=f"{PLANTED}{number % 2}")

    enhanced(folder, frames=frames)
    truth = _every_second()
    return Truth(truth.values * 2.0 + 3.0, truth.affine)


def _in_the_gaps(first: dict[str, Any], second: dict[str, Any]) -> Callable[[Path], Truth]:
    """A stack, and another half a step further along; the second is wanted."""

    def make(folder: Path) -> Truth:
        write(folder, **first)
        write(folder, SECOND, positions=POSITIONS + HALF_STEP, first_instance=101, **second)
        affine = GEOMETRY.affine.copy()
        affine[:3, 3] += HALF_STEP
        return Truth(SECOND, affine)

    return make


def _halves(keyword: str, values: tuple[Any, Any]) -> Callable[[Path], Truth]:
    """A tag has one value in the first five slices, which are wanted, and another in the rest."""

    def make(folder: Path) -> Truth:
        write(folder, each=lambda dataset, index: setattr(dataset, keyword, values[index >= 5]))
        return Truth(STORED[:5])

    return make


def _each(keyword: str, value: Callable[[int], Any]) -> Callable[[Path], Truth]:
    def make(folder: Path) -> Truth:
        write(folder, each=lambda dataset, index: setattr(dataset, keyword, value(index)))
        return Truth(STORED)

    return make


def _raw(dataset: Dataset, keyword: str, content: bytes) -> None:
    """Put a value into a data set that pydicom would not write."""
    tag = Tag(tag_for_keyword(keyword))
    even = content + b" " * (len(content) % 2)
    dataset._dict[tag] = RawDataElement(tag, dictionary_VR(tag), len(even), even, 0, False, True)


def _spoilt(
    keyword: str, content: bytes | None, *, slices: tuple[int, ...] = tuple(range(9))
) -> Callable[[Path], None]:
    """The rescale of some slices holds what is no number, or is gone."""

    def each(dataset: FileDataset, index: int) -> None:
        if index in slices and content is None:
            del dataset.RescaleSlope, dataset.RescaleIntercept
        elif index in slices:
            _raw(dataset, keyword, content)

    return lambda folder: write(folder, modality="CT", intercept=-1024.0, each=each) and None


def _enhanced_without_intercept(folder: Path) -> None:
    def whole(dataset: FileDataset) -> None:
        dataset.SharedFunctionalGroupsSequence[0].PixelValueTransformationSequence[0].RescaleIntercept = None

    enhanced(folder, whole=whole)


def _copies(**tags: Any) -> Callable[[Path], None]:
    """Every file twice, with other tags in the copy, whose name sorts first."""

    def make(folder: Path) -> None:
        for path in write(folder, TriggerTime=100.0, intercept=-1024.0):
            dataset = pydicom.dcmread(path)
            for keyword, value in tags.items():
                setattr(dataset, keyword, value)
            dataset.save_as(folder / f"a{path.name}", enforce_file_format=True)

    return make


def _small_beside(folder: Path) -> Truth:
    """A long stack, and a short one of the same planes in a series of its own."""
    long = np.concatenate([STORED] * 5)
    write(folder / "a", long, series=1)
    write(folder / "b", SECOND, series=2)
    return Truth(long)


def _velocity_series(folder: Path) -> None:
    write(folder / "a", series=1, TriggerTime=100.0, ImageType=MAGNITUDE)
    write(folder / "b", SECOND, series=2, TriggerTime=300.0, ImageType=VELOCITY)


def _telling_uids(folder: Path) -> None:
    uids = (f"1.2.826.0.1.4711.{PLANTED}.19770203", f"1.2.840.0.2.4711.{PLANTED}.19770203", f"{PLANTED}^ANNA")
    with quiet_pydicom():
        for number, uid in enumerate(uids):
            write(folder, series=number + 1, each=lambda d, i, uid=uid: _raw(d, "SeriesInstanceUID", uid.encode()))


def _broken_link(folder: Path) -> None:
    write(folder)
    (folder / f"{PLANTED}_link").symlink_to(folder / "nowhere")


_UNKNOWN = "values are unknown"
_DISAGREE = "9 images are there more than once, and the copies state different rescales, kinds or times"

SITUATIONS = (
    Situation(
        "magnitude and phase images in turn, by number",
        _in_turn("ImageType", (MAGNITUDE, VELOCITY)),
        {"series": "1"},
        warns="4 images of the series are left out: another kind, time or acquisition",
    ),
    Situation("two echoes in turn, by echo time", _in_turn("EchoTime", (1.0, 80.0)), {"echo_time_ms": 1.0}),
    Situation(
        "two inversion times in turn, by number",
        _in_turn("InversionTime", (200.0, 900.0)),
        {"series": "1"},
        warns="4 images of the series are left out: another kind, time or acquisition",
    ),
    Situation(
        "enhanced MR, two stacks named in turn, by number",
        _stack_ids_in_turn,
        {"series": "1"},
        warns="4 images of the series are left out: another kind, time or acquisition",
    ),
    Situation(
        "phase images in the gaps between magnitude images, by number",
        _in_the_gaps({"ImageType": MAGNITUDE}, {"ImageType": VELOCITY, "InversionTime": 900.0, "TriggerTime": 500.0}),
        {"series": "2"},
    ),
    Situation(
        "a cardiac phase in the gaps of another, by trigger time",
        _in_the_gaps({"TriggerTime": 20.0}, {"TriggerTime": 320.0}),
        {"trigger_time_ms": 320.0},
    ),
    Situation(
        "two cardiac phases, one in each half of the slices, by trigger time",
        _halves("TriggerTime", (10.0, 400.0)),
        {"trigger_time_ms": 10.0},
        has_acquisition={"trigger_time_ms": 10.0},
    ),
    Situation(
        "two studies under one series UID, by number",
        _halves("StudyInstanceUID", ("1.2.4", "1.2.5")),
        {"series": "1"},
        warns="4 images of the series are left out: another study or coordinate system",
    ),
    Situation(
        "two coordinate systems under one series UID, by number",
        _halves("FrameOfReferenceUID", ("1.2.4", "1.2.5")),
        {"series": "1"},
        warns="4 images of the series are left out: another study or coordinate system",
    ),
    Situation(
        "the trigger time of a single phase changes by 10 ms from slice to slice",
        _each("TriggerTime", lambda index: 600.0 + 10.0 * index),
        warns="trigger times of the slices differ by up to 80 ms",
    ),
    Situation(
        "the inversion time was set anew for the upper slices",
        _each("InversionTime", lambda index: 280.0 + 15.0 * (index > 4)),
        warns="inversion time of the slices is not one: 280 to 295 ms",
    ),
    Situation(
        "a short stack in a series of its own beside",
        _small_beside,
        warns="1 other series was passed over as small as a localiser: if one is wanted",
    ),
    Situation(
        "one slice of another kind",
        _each("ImageType", lambda index: VELOCITY if index == 4 else MAGNITUDE),
        refused="differ in kind .such as magnitude and phase., so they are several stacks",
    ),
    Situation(
        "one slice of another echo",
        _each("EchoTime", lambda index: 3.0 if index == 4 else 1.5),
        refused="differ in echo time",
    ),
    Situation(
        "magnitude and phase images as series of their own, by trigger time",
        _velocity_series,
        {"trigger_time_ms": 300.0},
        refused="several series: choose one with --series",
        lines=3,
    ),
    Situation(
        "two studies under one series UID",
        _halves("StudyInstanceUID", ("1.2.4", "1.2.5")),
        refused="several series",
        lines=3,
    ),
    Situation("names and dates in the series UIDs", _telling_uids, refused="several series", lines=4),
    Situation(
        "an intercept with a decimal comma", _spoilt("RescaleIntercept", b"-1024,0"), refused=f"slice 1: .*{_UNKNOWN}"
    ),
    Situation("an intercept with its unit", _spoilt("RescaleIntercept", b"-1024 HU"), refused=_UNKNOWN),
    Situation("an empty intercept", _spoilt("RescaleIntercept", b""), refused=_UNKNOWN),
    Situation(
        "an unreadable intercept in one slice",
        _spoilt("RescaleIntercept", b"-1024,", slices=(4,)),
        refused=f"slice 5: .*{_UNKNOWN}",
    ),
    Situation("a slope of NaN", _spoilt("RescaleSlope", b"NaN"), refused=_UNKNOWN),
    Situation("two slopes", _spoilt("RescaleSlope", b"2\\2"), refused=_UNKNOWN),
    Situation(
        "no rescale in one slice", _spoilt("", None, slices=(4,)), refused=f"slice 5: it states no rescale .*{_UNKNOWN}"
    ),
    Situation("enhanced MR, an empty intercept", _enhanced_without_intercept, refused=_UNKNOWN),
    Situation("two files that claim to be one image, other intercept", _copies(RescaleIntercept=0), refused=_DISAGREE),
    Situation(
        "two files that claim to be one image, other trigger time", _copies(TriggerTime=500.0), refused=_DISAGREE
    ),
    Situation("a link that leads nowhere", _broken_link, refused="cannot be opened, so that images may be missing"),
)
"""Told apart and read, or refused."""
