"""Situations of which images belong together: phases, echoes, localisers, copies, litter, missing slices, tilt."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from pydicom import uid
from pydicom.dataset import Dataset, FileDataset

from heartcase.schemas.geometry import Geometry
from tests.pipeline.formats.dicom_series import CT, header, items, put_pixels, write_series
from tests.pipeline.formats.dicom_situations import GEOMETRY, STORED, Situation, Truth, write
from tests.pipeline.formats.dicom_situations_read import POSITIONS, compressed, enhanced

__all__ = ["SITUATIONS", "cine", "echoes", "localizers", "tilted"]

COUNT = len(STORED)
PHASES = 5
AXIAL, CORONAL, SAGITTAL = (1, 0, 0, 0, 1, 0), (1, 0, 0, 0, 0, -1), (0, 1, 0, 0, 0, -1)
NORMAL = GEOMETRY.direction_matrix[:, 2]
LEAN = GEOMETRY.direction_matrix[:, 1]


def phase(number: int) -> np.ndarray:
    """Stored values of a cardiac phase: each is another volume."""
    return (STORED + 2000 * number).astype(np.uint16)


def cine(folder: Path, *, jitter: float = 0.0, count: int = COUNT, **options: Any) -> None:
    """Phases of a classic cine in one series, 40 ms apart; heartbeats differ by ``jitter`` from slice to slice."""
    beat = 1.0 + jitter * np.linspace(-1.0, 1.0, COUNT)
    for number in range(PHASES):

        def each(dataset: FileDataset, index: int, number: int = number) -> None:
            dataset.TriggerTime = f"{10.0 + 40.0 * number * beat[index]:.3f}"
            dataset.AcquisitionNumber = index + 1  # counts breath-holds

        write(folder, phase(number)[:count], each=each, first_instance=1 + 100 * number, **options)


def read_cine(folder: Path, **options: Any) -> Truth:
    """The phase at 90 ms."""
    cine(folder, **options)
    return Truth(phase(2))


def _phases_by(keyword: str, values: list[Any], **options: Any) -> Callable[[Path], Truth]:
    """The second of some volumes that differ in one tag."""

    def make(folder: Path) -> Truth:
        for number, value in enumerate(values):
            write(folder, phase(number), first_instance=1 + 100 * number, **{keyword: value}, **options)
        return Truth(phase(1))

    return make


def echoes(folder: Path) -> Truth:
    """Three echoes of one series; the second."""
    return _phases_by("EchoTime", [1.15, 3.45, 5.75])(folder)


def _enhanced_phases(group: str, tags: dict[str, list[float]], *, wanted: int = 1) -> Callable[[Path], Truth]:
    def make(folder: Path) -> Truth:
        keyword, values = next(iter(tags.items()))

        def frames(frame: Dataset, number: int) -> None:
            setattr(frame, group, items(**{keyword: values[number // COUNT]}))

        volumes = np.concatenate([phase(number) for number in range(len(values))])
        enhanced(folder, volumes, np.concatenate([POSITIONS] * len(values)), frames=frames)
        return Truth(phase(wanted) * 2.0 + 3.0)

    return make


def _one_time(folder: Path) -> Truth:
    write(folder, TriggerTime=371.5)
    return Truth(STORED)


def _phases_as_series(folder: Path) -> Truth:
    for number in range(3):
        write(folder / str(number), phase(number), series=10 + number, TriggerTime=100.0 * number)
    return Truth(phase(1))


def localizers(folder: Path, *, series: int = 9, **options: Any) -> None:
    """Three planes of three images each."""
    for plane, orientation in enumerate((AXIAL, CORONAL, SAGITTAL)):
        normal = np.cross(orientation[:3], orientation[3:])
        positions = np.array([-40.0, -40.0, 380.0]) + 30.0 * np.arange(3)[:, np.newaxis] * normal
        write_series(
            folder,
            np.full((3, 40, 40), 5, np.uint16),
            positions,
            orientation=orientation,
            pixel_spacing=(2.0, 2.0),
            modality="MR",
            series=series,
            first_instance=500 + 10 * plane,
            **options,
        )


def _with(folder: Path, *others: Callable[[Path], None]) -> Truth:
    write(folder / "scan")
    for number, other in enumerate(others):
        other(folder / f"other{number}")
    return Truth(STORED)


def _localizers_in_the_series(folder: Path) -> Truth:
    long = np.concatenate([STORED] * 5)
    write(folder, long)
    localizers(folder, series=1)
    return Truth(long)


def _marked_localizers_in_the_series(folder: Path) -> Truth:
    write(folder, ImageType=["ORIGINAL", "PRIMARY", "M"])
    localizers(folder, series=1, ImageType=["ORIGINAL", "PRIMARY", "LOCALIZER"])
    return Truth(STORED)


def _big(folder: Path) -> Truth:
    geometry = GEOMETRY.cropped((0, 0, 0), (8, 6, 200))
    stored = np.random.default_rng(11).integers(0, 4000, geometry.shape).astype(np.uint16)
    write(folder / "a" / "b", stored, geometry)
    localizers(folder / "c")
    return Truth(stored, geometry.affine)


def _other_objects(folder: Path) -> None:
    folder.mkdir()
    for number, (sop_class, modality) in enumerate(
        (("1.2.840.10008.5.1.4.1.1.88.11", "SR"), ("1.2.840.10008.5.1.4.1.1.104.1", "DOC"), (CT, "PR"))
    ):
        other = header(sop_class=sop_class, modality=modality, series=50 + number)
        other.save_as(folder / f"o{number}.dcm", enforce_file_format=True)
    screen = header(sop_class="1.2.840.10008.5.1.4.1.1.7", modality="OT", series=60)
    put_pixels(screen, STORED[0])
    screen.save_as(folder / "screen.dcm", enforce_file_format=True)
    directory = header(sop_class="1.2.840.10008.1.3.10", modality="", series=61)
    directory.DirectoryRecordSequence = items(DirectoryRecordType="PATIENT", PatientName="Sensitivus^Anna")
    directory.save_as(folder / "DICOMDIR", enforce_file_format=True)


def _litter(folder: Path) -> None:
    folder.mkdir()
    (folder / ".DS_Store").write_bytes(b"\0\0\0\1Bud1" + bytes(6000))
    (folder / "Thumbs.db").write_bytes(b"\xd0\xcf\x11\xe0" + bytes(1000))
    (folder / "Sensitivus.txt").write_text("notes " * 100)
    (folder / "empty").touch()
    (folder / "VERSION").write_bytes(b"\x08\x00")


def _colour_in_the_series(folder: Path) -> Truth:
    write(folder)
    page = header(sop_class="1.2.840.10008.5.1.4.1.1.7", modality="MR", instance=900)
    put_pixels(page, np.zeros((30, 60), np.uint8))
    page.SamplesPerPixel, page.PhotometricInterpretation, page.PlanarConfiguration = 3, "RGB", 0
    page.PixelData = bytes(3 * 30 * 60)
    page.save_as(folder / "page", enforce_file_format=True)
    return Truth(STORED)


def _copied(folder: Path) -> Truth:
    for path in write(folder / "a"):
        (folder / "b").mkdir(exist_ok=True)
        shutil.copy(path, folder / "b" / path.name)
    return Truth(STORED)


def _copied_compressed(folder: Path) -> Truth:
    write(folder / "a")
    write(folder / "b", each=compressed(uid.JPEGLSLossless), PatientComments="another export")
    return Truth(STORED)


def _mixed_in_one_series(folder: Path) -> Truth:
    write(folder, STORED[:5], slope=2.0, intercept=3.0)
    enhanced(folder, STORED[5:], POSITIONS[5:], instance=77)
    return Truth(STORED * 2.0 + 3.0)


def _enhanced_beside_classic(folder: Path) -> Truth:
    write(folder, series=4)
    enhanced(folder, phase(1), series=5)
    return Truth(phase(1) * 2.0 + 3.0)


def _pet_beside(folder: Path) -> None:
    write(folder, (STORED * 3).astype(np.uint16), series=30, each=lambda d, i: setattr(d, "Modality", "PT"))


def _turned(rows: tuple[int, ...]) -> Callable[[Path], Truth]:
    def make(folder: Path) -> Truth:
        row, column = np.array(rows[:3]), np.array(rows[3:])
        geometry = Geometry.of(
            shape=GEOMETRY.shape,
            origin_mm=GEOMETRY.origin_mm,
            spacing_mm=GEOMETRY.spacing_mm,
            direction=np.stack([row, column, np.cross(row, column)], axis=1),
        )
        write(folder, geometry=geometry)
        return Truth(STORED, geometry.affine)

    return make


def without(*gone: int, stored: np.ndarray = STORED, **options: Any) -> Callable[[Path], Truth]:
    """Slices are not there; the truth is linear between those that are."""

    def make(folder: Path) -> Truth:
        kept = [k for k in range(COUNT) if k not in gone]
        write(folder, stored[kept], positions=POSITIONS[kept], **options)
        truth = stored.astype(float)
        for k in gone:
            below, above = max(n for n in kept if n < k), min(n for n in kept if n > k)
            truth[k] = truth[below] + (k - below) / (above - below) * (truth[above] - truth[below])
        return Truth(truth, loss=1e-4)

    return make


def smooth_field(points_mm: np.ndarray) -> np.ndarray:
    """A field with bounded second derivatives: at most 400 (2 pi / 40)^2 = 9.87 per mm^2 along any direction."""
    wave = np.array([0.6, 0.48, 0.64]) * 2.0 * np.pi / 40.0
    return np.asarray(1000.0 + 400.0 * np.sin((points_mm - GEOMETRY.origin_mm) @ wave))


FIELD_BOUND = 400.0 * (2.0 * np.pi / 40.0) ** 2


def tilted(folder: Path, *, degrees: float = 12.0, gone: tuple[int, ...] = ()) -> Truth:
    """A smooth field on slices that lean along their columns, and the field at the pixels of the straight stack."""
    step = np.tan(np.radians(degrees)) * GEOMETRY.spacing_mm[2]
    positions = POSITIONS + np.arange(COUNT)[:, np.newaxis] * step * LEAN
    j, i = np.indices(STORED.shape[1:])
    in_plane = (i[..., None] * GEOMETRY.affine[:3, 0]) + (j[..., None] * GEOMETRY.affine[:3, 1])
    stored = np.round(np.stack([smooth_field(in_plane + position) for position in positions])).astype(np.uint16)
    kept = [k for k in range(COUNT) if k not in gone]
    write(folder, stored[kept], positions=positions[kept])
    more = int(np.ceil((COUNT - 1) * step / GEOMETRY.spacing_mm[1] - 1e-6))
    j, i = np.indices((STORED.shape[1] + more, STORED.shape[2]))
    in_plane = (i[..., None] * GEOMETRY.affine[:3, 0]) + (j[..., None] * GEOMETRY.affine[:3, 1])
    values = np.stack([smooth_field(in_plane + position) for position in POSITIONS])
    first = np.arange(COUNT)[:, np.newaxis] * step / GEOMETRY.spacing_mm[1]
    row = np.arange(STORED.shape[1] + more)
    outside = (row < first - 1e-6) | (row > first + STORED.shape[1] - 1 + 1e-6)
    values[outside] = stored[kept].min()
    for k in gone:  # a pixel that one of the two neighbours lacks is no measure of interpolation
        values[k][outside[k - 1] | outside[k + 1]] = np.nan
    in_slice = (GEOMETRY.spacing_mm[1] ** 2) * FIELD_BOUND / 8.0
    across = (GEOMETRY.spacing_mm[2] ** 2) * FIELD_BOUND / 2.0 if gone else 0.0
    return Truth(values, loss=in_slice + across + 0.5)


_TRIGGER = {"trigger_time_ms": 95.0}

SITUATIONS = (
    Situation("cine in one series, by trigger time", read_cine, _TRIGGER, has_acquisition={"trigger_time_ms": 90.0}),
    Situation(
        "cine in one series, a trigger time midway between two phases",
        read_cine,
        {"trigger_time_ms": 110.0},
        has_acquisition={"trigger_time_ms": 90.0},
        warns="trigger times 90 and 130 ms are as near to the given 110 ms: the earlier one was taken",
    ),
    Situation(
        "one trigger time, a rounded one given",
        _one_time,
        {"trigger_time_ms": 375.0},
        has_acquisition={"trigger_time_ms": 371.5},
    ),
    Situation("cine, the heartbeat changed a little between slices", lambda f: read_cine(f, jitter=0.05), _TRIGGER),
    Situation(
        "cine, the heartbeat changed a lot between slices",
        lambda f: read_cine(f, jitter=0.3),
        _TRIGGER,
        warns="trigger times of the slices differ by up to 48 ms",
    ),
    Situation(
        "several echoes in one series, by echo time",
        echoes,
        {"echo_time_ms": 3.0},
        has_acquisition={"echo_time_ms": 3.45},
    ),
    Situation(
        "enhanced MR with phases, by trigger time",
        _enhanced_phases("CardiacSynchronizationSequence", {"NominalCardiacTriggerDelayTime": [0.0, 310.5, 700.0]}),
        {"trigger_time_ms": 300.0},
        has_acquisition={"trigger_time_ms": 310.5},
    ),
    Situation(
        "enhanced MR with phases in percent, by number",
        _enhanced_phases("CardiacSynchronizationSequence", {"NominalPercentageOfCardiacPhase": [0.0, 37.5, 75.0]}),
        {"series": "2"},
        has_acquisition={"cardiac_phase_percent": 37.5},
    ),
    Situation(
        "enhanced MR with times (4-D), by number",
        _enhanced_phases("FrameContentSequence", {"TemporalPositionIndex": [1, 2, 3]}),
        {"series": "2"},
    ),
    Situation(
        "enhanced MR with echoes, by echo time",
        _enhanced_phases("MREchoSequence", {"EffectiveEchoTime": [2.0, 4.0]}),
        {"echo_time_ms": 4.4},
        has_acquisition={"echo_time_ms": 4.0},
    ),
    Situation("phases as series of their own, by trigger time", _phases_as_series, {"trigger_time_ms": 120.0}),
    Situation(
        "magnitude and phase images in one series, by number",
        _phases_by("ImageType", [["ORIGINAL", "PRIMARY", "M"], ["ORIGINAL", "PRIMARY", "P"]]),
        {"series": "2"},
    ),
    Situation("two acquisitions in one series, by number", _phases_by("AcquisitionNumber", [3, 4]), {"series": "2"}),
    Situation(
        "two tube voltages in one series, by number",
        _phases_by("KVP", [80, 140], modality="CT"),
        {"series": "2"},
        has_acquisition={"tube_voltage_kv": 140.0},
    ),
    Situation("b-values in one series, by number", _phases_by("DiffusionBValue", [0.0, 500.0]), {"series": "2"}),
    Situation(
        "localiser of three planes beside, called so",
        lambda f: _with(f, lambda g: localizers(g, ImageType=["ORIGINAL", "PRIMARY", "LOCALIZER"])),
    ),
    Situation("localiser in the same series, called so", _marked_localizers_in_the_series),
    Situation(
        "localiser in the same series, not called so",
        _localizers_in_the_series,
        warns="9 images of the series are left out: another size",
    ),
    Situation(
        "200 slices in subfolders, a localiser beside that is not called so",
        _big,
        warns="1 other series was passed over as small as a localiser",
    ),
    Situation("reports, screenshots, presentation states and a DICOMDIR beside", lambda f: _with(f, _other_objects)),
    Situation("files that are not DICOM beside, and empty ones", lambda f: _with(f, _litter)),
    Situation("a PET series beside", lambda f: _with(f, _pet_beside)),
    Situation(
        "a page in colour in the same series",
        _colour_in_the_series,
        warns="1 image of the series is left out: in colour",
    ),
    Situation("every file twice", _copied),
    Situation("every image twice, once compressed", _copied_compressed),
    Situation("plain and enhanced images in one series", _mixed_in_one_series),
    Situation("plain and enhanced series in one folder, by number", _enhanced_beside_classic, {"series": "2"}),
    Situation("coronal", _turned(CORONAL)),
    Situation("sagittal", _turned(SAGITTAL)),
    Situation(
        "one slice missing, told to interpolate",
        without(4),
        {"interpolate_missing": True},
        warns=r"slice 5 was missing .* \(2.00 mm per slice\)",
    ),
    Situation(
        "two slices missing in a row, told to interpolate",
        without(2, 3),
        {"interpolate_missing": True},
        warns="slices 3, 4 were missing",
    ),
    Situation("gantry tilt, told to straighten", tilted, {"straighten_tilt": True}, warns="leaned by 12.0 degrees"),
    Situation(
        "gantry tilt and a slice missing, told to do both",
        lambda f: tilted(f, gone=(4,)),
        {"straighten_tilt": True, "interpolate_missing": True},
        warns="slice 5 was missing",
    ),
)
"""Which images belong together: all of it is read."""
