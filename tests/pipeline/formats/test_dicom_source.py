"""A case is tied to the images that it was made from, known by their values, and to no others."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pydicom
import pytest

from heartcase.pipeline.data import Scan
from heartcase.pipeline.formats.dicom.source import SourceSeries, find_source
from heartcase.pipeline.formats.read_scan import list_series, read_scan
from heartcase.schemas.bundle.format import CaseManifest, StageRecord
from heartcase.schemas.errors import ScanError, UsageError
from heartcase.schemas.geometry import Geometry
from tests.pipeline.formats.dicom_series import items
from tests.pipeline.formats.dicom_situations import STORED, write
from tests.pipeline.formats.dicom_situations_read import POSITIONS, enhanced
from tests.pipeline.formats.dicom_situations_stacks import cine, localizers, phase, tilted, without

START, SIZE = (5, 4, 2), (20, 21, 5)
FRAME = {"FrameOfReferenceUID": "1.2.826.0.1.3680043.8.498.4711"}


def manifest_of(scan: Scan, *, start=START, size=SIZE, **reading) -> CaseManifest:
    """What a case that was made from a part of a scan says of it."""
    box = tuple(slice(s, s + n) for s, n in zip(start[::-1], size[::-1], strict=True))
    region = Scan(scan.values[box], scan.geometry.cropped(start, size))
    record = StageRecord(stage="read", version=1, settings=reading, output_sha256="0" * 64)
    return CaseManifest.model_construct(
        scan_geometry=Geometry.model_validate_json(region.geometry.model_dump_json()),
        scan_sha256=region.values_sha256,
        acquisition=dict(scan.acquisition),
        stages=(record,),
    )


def images_of(folder: Path) -> dict[str, pydicom.FileDataset]:
    found = [pydicom.dcmread(path) for path in sorted(folder.rglob("*")) if path.is_file()]
    return {image.SOPInstanceUID: image for image in found}


def check_pixels(source: SourceSeries, folder: Path, stored: np.ndarray) -> None:
    """Every image that is named holds the pixels of the slice that it is said to show."""
    images = images_of(folder)
    assert source.offset == START
    for one in source.images:
        pixels = images[one.sop_instance_uid].pixel_array
        plane = pixels if one.frame is None else pixels[one.frame - 1]
        np.testing.assert_array_equal(plane, stored[START[2] + one.slice])
        assert images[one.sop_instance_uid].SeriesInstanceUID == source.series_uid


def test_a_scan_of_another_patient_at_the_same_place_is_refused(tmp_path: Path) -> None:
    write(tmp_path / "own", **FRAME)
    other = STORED.copy()
    other[START[2], START[1], START[0]] += 1
    write(tmp_path / "other", other, **FRAME)
    manifest = manifest_of(read_scan(tmp_path / "own"))
    check_pixels(find_source(tmp_path / "own", manifest), tmp_path / "own", STORED)
    for series in (None, "1"):
        with pytest.raises(UsageError, match="not the scan that the case was made from") as caught:
            find_source(tmp_path / "other", manifest, series=series)
        assert str(tmp_path) not in str(caught.value)
    # what lies beside the region of interest is no part of the case
    other = STORED.copy()
    other[0, 0, 0] += 1
    shutil.rmtree(tmp_path / "other")
    write(tmp_path / "other", other, **FRAME)
    assert len(find_source(tmp_path / "other", manifest).images) == SIZE[2]


def test_another_place_or_size_is_refused(tmp_path: Path) -> None:
    write(tmp_path, **FRAME)
    scan = read_scan(tmp_path)
    manifest = manifest_of(scan)
    moved = manifest.scan_geometry.cropped((20, 0, 0), SIZE)
    for other in (moved, manifest.scan_geometry.refined(2), manifest.scan_geometry.flipped(2)):
        with pytest.raises(UsageError, match="no series there has slices"):
            find_source(tmp_path, manifest.model_copy(update={"scan_geometry": other}))


@pytest.mark.parametrize("states_time", [True, False])
def test_only_the_images_of_the_phase_are_named(tmp_path: Path, states_time: bool) -> None:
    cine(tmp_path, **FRAME)
    for number, time in ((2, 90.0), (4, 170.0)):
        manifest = manifest_of(read_scan(tmp_path, trigger_time_ms=time))
        if not states_time:
            manifest = manifest.model_copy(update={"acquisition": {}})
        source = find_source(tmp_path, manifest)
        assert [one.slice for one in source.images] == list(range(SIZE[2]))
        check_pixels(source, tmp_path, phase(number))


def test_the_time_alone_does_not_make_it_the_scan(tmp_path: Path) -> None:
    cine(tmp_path, **FRAME)
    manifest = manifest_of(read_scan(tmp_path, trigger_time_ms=90.0))
    manifest.acquisition["trigger_time_ms"] = 130.0
    with pytest.raises(UsageError, match="another patient, cardiac phase"):
        find_source(tmp_path, manifest)


def test_frames_of_the_phase_in_an_enhanced_file(tmp_path: Path) -> None:
    count = len(STORED)

    def frames(frame: pydicom.Dataset, number: int) -> None:
        frame.CardiacSynchronizationSequence = items(NominalCardiacTriggerDelayTime=100.0 * (number // count))

    volumes = np.concatenate([phase(0), phase(1)])

    def whole(dataset: pydicom.FileDataset) -> None:
        dataset.FrameOfReferenceUID = FRAME["FrameOfReferenceUID"]

    enhanced(tmp_path, volumes, np.concatenate([POSITIONS] * 2), frames=frames, whole=whole)
    source = find_source(tmp_path, manifest_of(read_scan(tmp_path, trigger_time_ms=100.0)))
    assert [one.frame for one in source.images] == [count + START[2] + n + 1 for n in range(SIZE[2])]
    check_pixels(source, tmp_path, phase(1))


def test_series_count_as_info_counts_them(tmp_path: Path) -> None:
    localizers(tmp_path / "a", series=1, **FRAME)
    write(tmp_path / "b", phase(1), series=2, **FRAME)
    write(tmp_path / "c", series=3, **FRAME)
    write(tmp_path / "d", series=4, **FRAME)
    listed = list_series(tmp_path)
    numbers = [info.number for info in listed if info.slice_count == len(STORED)]
    assert numbers == [4, 5, 6]
    manifest = manifest_of(read_scan(tmp_path, series="5"))
    with pytest.raises(UsageError, match="there 2 times, as series 5, 6 of 'heartcase info'"):
        find_source(tmp_path, manifest)
    for number in ("5", "6"):
        source = find_source(tmp_path, manifest, series=number)
        assert source.series_uid.endswith(f"9000{int(number) - 2}")
        assert source == find_source(tmp_path, manifest, series=listed[int(number) - 1].uid_code)
    with pytest.raises(UsageError, match="not the scan that the case was made from"):
        find_source(tmp_path, manifest, series="4")
    with pytest.raises(UsageError, match="no series there has slices"):
        find_source(tmp_path, manifest, series="1")
    with pytest.raises(ScanError, match="no series has this number") as caught:
        find_source(tmp_path, manifest, series="9")
    assert len(caught.value.problems) == 1 + len(listed)


def test_a_scan_with_interpolated_slices_is_compared_as_it_was_read(tmp_path: Path) -> None:
    without(4, **FRAME)(tmp_path / "own")
    scan = read_scan(tmp_path / "own", interpolate_missing=True)
    source = find_source(tmp_path / "own", manifest_of(scan, interpolate_missing=True))
    assert [one.slice for one in source.images] == [0, 1, 3, 4]
    check_pixels(source, tmp_path / "own", STORED)
    write(tmp_path / "whole", **FRAME)
    with pytest.raises(UsageError, match="not the scan"):
        find_source(tmp_path / "whole", manifest_of(scan, interpolate_missing=True))


def test_a_straightened_scan_is_tied_to_no_image(tmp_path: Path) -> None:
    tilted(tmp_path)
    scan = read_scan(tmp_path, straighten_tilt=True)
    with pytest.raises(UsageError, match=r"straightened scan .* export without --scan"):
        find_source(tmp_path, manifest_of(scan, straighten_tilt=True))


def test_what_was_never_straight_to_straighten_is_compared(tmp_path: Path) -> None:
    """The setting alone changes nothing: the stack did not lean."""
    write(tmp_path, **FRAME)
    manifest = manifest_of(read_scan(tmp_path, straighten_tilt=True), straighten_tilt=True)
    check_pixels(find_source(tmp_path, manifest), tmp_path, STORED)


def test_images_that_state_no_frame_of_reference_are_refused(tmp_path: Path) -> None:
    write(tmp_path)
    with pytest.raises(ScanError, match="do not state one study and one frame of reference"):
        find_source(tmp_path, manifest_of(read_scan(tmp_path)))
