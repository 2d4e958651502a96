"""Situations in which a header says too little or too roundly, and what may be made of them."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from pydicom.dataset import FileDataset
from scipy import ndimage

from tests.pipeline.formats.dicom_series import write_series
from tests.pipeline.formats.dicom_situations import GEOMETRY, STORED, Situation, Truth, write
from tests.pipeline.formats.dicom_situations_read import POSITIONS
from tests.pipeline.formats.dicom_situations_stacks import COUNT, phase

__all__ = ["SITUATIONS", "kernels", "slabs", "uneven_cine"]

BEAT_MS = 926.0


def uneven_cine(folder: Path, counts: tuple[int, ...]) -> None:
    """A cine with so many phases at each slice position, evenly through the heartbeat."""
    instance = 1
    for k, count in enumerate(counts):
        for number in range(count):
            time = BEAT_MS * number / count
            values = phase(round(20 * number / count))[k : k + 1]
            place = {"positions": POSITIONS[k : k + 1], "order": [0], "first_instance": instance}
            write(folder, values, **place, TriggerTime=f"{time:.1f}")
            instance += 1


def _uneven(counts: tuple[int, ...], wanted: int) -> Callable[[Path], Truth]:
    def make(folder: Path) -> Truth:
        uneven_cine(folder, counts)
        return Truth(phase(wanted))

    return make


def _rounded(folder: Path) -> Truth:
    """Slices 0.625 mm apart whose positions are written with one decimal."""
    geometry = GEOMETRY.of(shape=(41, 36, 34), origin_mm=(-30.0, -40.0, -0.6), spacing_mm=(0.7, 0.7, 0.625))
    stored = np.concatenate([STORED] * 5)[:41]
    positions = np.round(geometry.index_to_world([(0, 0, k) for k in range(41)]), 1)
    assert len(set(np.round(np.diff(positions[:, 2]), 3))) == 2
    write(folder, stored, geometry, positions=positions)
    return Truth(stored, geometry.affine, place_mm=0.1)


def slabs(folder: Path, *, each: Callable[[FileDataset, int], None] | None = None, **second: Any) -> None:
    """Two slabs of a step-and-shoot scan whose last and first slices lie at one position."""
    write(folder, STORED[:5], positions=POSITIONS[:5], order=range(5), AcquisitionNumber=1, AcquisitionTime="101500.5")
    later = {"AcquisitionNumber": 2, "AcquisitionTime": "101501.25"} | second
    values = (STORED[4:] + 3).astype(np.uint16)
    write(folder, values, positions=POSITIONS[4:], order=range(5), first_instance=50, each=each, **later)


def _slabs(wanted: str, **options: Any) -> Callable[[Path], Truth]:
    def make(folder: Path) -> Truth:
        slabs(folder, **options)
        values = STORED + 3
        values[: 5 if wanted == "earlier" else 4] -= 3
        return Truth(values)

    return make


def _no_number(dataset: FileDataset, index: int) -> None:
    del dataset.AcquisitionNumber


def _no_number_no_time(dataset: FileDataset, index: int) -> None:
    del dataset.AcquisitionNumber, dataset.AcquisitionTime


def kernels(folder: Path, *, noise_hu: float = 20.0) -> tuple[np.ndarray, np.ndarray]:
    """One CT series with two reconstructions that differ in the kernel alone: a smooth one, and one without smoothing.

    The values of both, smooth first.
    """
    j, i = np.indices((128, 128))
    disc = 40.0 + 300.0 * ((i - 64) ** 2 + (j - 80) ** 2 < 14**2) - 1000.0 * ((i - 64) ** 2 + (j - 64) ** 2 > 60**2)
    sharp = disc + np.random.default_rng(5).normal(0.0, noise_hu, (5, 128, 128))
    smooth = np.stack([ndimage.gaussian_filter(plane, 1.0) for plane in sharp])
    volumes = np.round(smooth).astype(np.int16), np.round(sharp).astype(np.int16)
    positions = np.array([[-30.0, -30.0, 3.0 * k] for k in range(5)])
    for number, (volume, kernel) in enumerate(zip(volumes, ("Sensitivus30f", "Sensitivus70f"), strict=True)):
        write_series(folder, volume, positions, first_instance=1 + 100 * number, ConvolutionKernel=kernel)
    return volumes


def _kernels(wanted: int) -> Callable[[Path], Truth]:
    def make(folder: Path) -> Truth:
        volumes = kernels(folder)
        geometry = GEOMETRY.of(shape=(5, 128, 128), origin_mm=(-30, -30, 0), spacing_mm=(0.7, 0.7, 3))
        return Truth(volumes[wanted], geometry.affine)

    return make


def _zipped(folder: Path) -> Truth:
    write(folder / "scan")
    (folder / "scan" / "notes.txt").write_text("no image")
    shutil.make_archive(str(folder / "made"), "zip", folder, "scan")
    shutil.rmtree(folder / "scan")
    return Truth(STORED)


EVERY = (2,) * (COUNT - 1)

SITUATIONS = (
    Situation(
        "cine with 20 phases at the first position and 2 at the others, by trigger time",
        _uneven((20, *EVERY), 0),
        {"trigger_time_ms": 0.0},
        warns="18 images are left out: at a time that other slice positions have no image near to",
    ),
    Situation(
        "cine with 20 phases at all positions but the last, which has 2, by trigger time",
        _uneven((*(20,) * (COUNT - 1), 2), 10),
        {"trigger_time_ms": 463.0},
    ),
    Situation(
        "cine whose last position has no image near the trigger time",
        _uneven((*(20,) * (COUNT - 1), 2), 0),
        {"trigger_time_ms": 230.0},
        refused=r"1 of 9 slice positions have no image near 231\.5 ms: slice 9 \(the nearest is at 0 ms\); "
        "all have one near 0, 463 ms",
    ),
    Situation(
        "cine with 20 phases at the first position and 2 at the others, a time between",
        _uneven((20, *EVERY), 0),
        {"trigger_time_ms": 185.0},
        warns="given trigger time is 185 ms, and the nearest one that can be taken, 0 ms, shows the heart at another",
    ),
    Situation("slices 0.625 mm apart, positions written with one decimal", _rounded),
    Situation(
        "two slabs that meet in one slice",
        _slabs("earlier"),
        refused=r"1 slice is there twice \(slice 5\), and the images differ, .*--overlap earlier or --overlap later",
    ),
    Situation(
        "two slabs that meet in one slice, the later one wanted",
        _slabs("later"),
        {"overlap": "later"},
        warns="slice 5 is there twice or more, .*of each the later image was taken",
    ),
    Situation(
        "two slabs that meet in one slice, told apart by time of day alone, the earlier one wanted",
        _slabs("earlier", each=_no_number),
        {"overlap": "earlier"},
        warns="of each the earlier image was taken",
    ),
    Situation(
        "two slabs that meet in one slice, nothing tells which was first",
        _slabs("earlier", each=_no_number_no_time),
        {"overlap": "earlier"},
        refused="slice 5 is there 2 times, and the headers do not tell which image was acquired first",
    ),
    Situation("two reconstructions that differ in kernel, none chosen", _kernels(0), refused="several series", lines=3),
    Situation("two reconstructions that differ in the kernel, by number", _kernels(1), {"series": "2"}),
    Situation("a zipped folder", _zipped, file="made.zip"),
)
"""Read where the header leaves one reading, or the user chooses."""
