from __future__ import annotations

import hashlib
import logging
import os
import re
import shutil
import warnings
from pathlib import Path

import numpy as np
import pydicom
import pytest
import SimpleITK
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from pydicom.datadict import dictionary_VR, keyword_dict
from pydicom.dataset import Dataset
from pydicom.uid import JPEG2000Lossless, RLELossless

from heartcase.pipeline.formats.dicom import pixels as dicom_pixels
from heartcase.pipeline.formats.dicom.choice import listed, named
from heartcase.pipeline.formats.dicom.headers import ImageSeries
from heartcase.pipeline.formats.dicom.phases import stack_groups
from heartcase.pipeline.formats.dicom.stack import Slice
from heartcase.pipeline.formats.read_scan import list_series, read_scan
from heartcase.schemas.errors import ScanError
from tests.pipeline.formats.dicom_series import (
    AXIAL,
    CT,
    ROOT,
    header,
    put_pixels,
    repr_ds,
    write_enhanced,
    write_series,
)

VOLUME = np.random.default_rng(1).integers(-1000, 1000, size=(7, 5, 6)).astype(np.int16)
UP = np.array([0.0, 0.0, 1.0])


def along(count: int, step: np.ndarray, start: tuple[float, float, float] = (-100.0, -50.0, 20.0)) -> np.ndarray:
    return np.array(start) + np.arange(count)[:, np.newaxis] * step


def unit_quaternion_matrix(q: tuple[float, ...]) -> np.ndarray:
    w, x, y, z = np.array(q) / np.linalg.norm(q)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


component = st.floats(-1.0, 1.0)


@settings(max_examples=15, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    quaternion=st.tuples(component, component, component, component).filter(lambda q: np.linalg.norm(q) > 0.1),
    origin=st.tuples(*[st.floats(-400.0, 400.0)] * 3),
    spacing=st.tuples(*[st.floats(0.2, 9.0)] * 3),
    order=st.permutations(range(7)),
)
def test_geometry_and_values_are_those_written(tmp_path: Path, quaternion, origin, spacing, order) -> None:
    folder = tmp_path / "series"
    shutil.rmtree(folder, ignore_errors=True)
    matrix = unit_quaternion_matrix(quaternion)
    positions = along(7, matrix[:, 2] * spacing[2], origin)
    write_series(
        folder,
        VOLUME,
        positions,
        orientation=[*matrix[:, 0], *matrix[:, 1]],
        pixel_spacing=(spacing[1], spacing[0]),
        slope=0.5,
        intercept=-24.0,
        order=order,
    )
    scan = read_scan(folder)
    np.testing.assert_array_equal(scan.values, VOLUME * np.float32(0.5) - 24)
    expected = np.eye(4)
    expected[:3, :3] = matrix * spacing
    expected[:3, 3] = origin
    # the decimal strings of the files have nine digits or more
    np.testing.assert_allclose(scan.geometry.affine, expected, atol=1e-6, rtol=0)
    assert scan.geometry.is_right_handed
    assert scan.modality == "CT"


def test_oblique_series_as_simpleitk_reads_it(tmp_path: Path) -> None:
    matrix = unit_quaternion_matrix((0.9, 0.2, -0.3, 0.1))
    write_series(
        tmp_path,
        VOLUME,
        along(7, matrix[:, 2] * 2.5)[::-1],
        orientation=[*matrix[:, 0], *matrix[:, 1]],
        pixel_spacing=(0.8, 0.6),
        slope=2.0,
        intercept=-1024.0,
    )
    scan = read_scan(tmp_path)
    series = SimpleITK.ImageSeriesReader()
    series.SetFileNames(series.GetGDCMSeriesFileNames(str(tmp_path)))
    image = series.Execute()
    np.testing.assert_array_equal(scan.values, SimpleITK.GetArrayFromImage(image))
    np.testing.assert_allclose(scan.geometry.direction_matrix.ravel(), image.GetDirection(), atol=1e-6)
    np.testing.assert_allclose(scan.geometry.origin_mm, image.GetOrigin(), atol=1e-6)
    np.testing.assert_allclose(scan.geometry.spacing_mm, image.GetSpacing(), atol=1e-6)


def test_rounded_headers_are_one_stack(tmp_path: Path) -> None:
    """Positions with two decimals and cosines with four, as some scanners write them."""
    matrix = unit_quaternion_matrix((0.9, 0.2, -0.3, 0.1))
    positions = np.round(along(7, matrix[:, 2] * 0.625), 2)
    orientation = np.round([*matrix[:, 0], *matrix[:, 1]], 4)
    write_series(tmp_path, VOLUME, positions, orientation=list(orientation))
    geometry = read_scan(tmp_path).geometry
    far = geometry.index_to_world((0, 0, 6))
    np.testing.assert_allclose(far, positions[6], atol=0.02)
    np.testing.assert_allclose(geometry.direction_matrix.T @ geometry.direction_matrix, np.eye(3), atol=1e-12)


def test_slope_of_each_slice_and_nested_folders_and_other_objects(tmp_path: Path) -> None:
    positions = along(7, 3.0 * UP)
    for index in range(7):
        write_series(
            tmp_path / "study" / f"part{index % 2}",
            VOLUME[index : index + 1],
            positions[index : index + 1],
            slope=1.0 + index,
            order=[0],
        )[0].rename(tmp_path / "study" / f"part{index % 2}" / f"file{index}.dcm")
    (tmp_path / "study" / "notes.txt").write_text("not an image")
    (tmp_path / "study" / "short").write_bytes(b"\x08\x00")
    report = header(sop_class="1.2.840.10008.5.1.4.1.1.88.11", modality="SR", series=5)
    report.save_as(tmp_path / "study" / "report.dcm", enforce_file_format=True)
    screenshot = header(sop_class="1.2.840.10008.5.1.4.1.1.7", modality="CT", series=6)
    put_pixels(screenshot, VOLUME[0])
    screenshot.save_as(tmp_path / "study" / "screen.dcm", enforce_file_format=True)
    scan = read_scan(tmp_path)
    np.testing.assert_array_equal(scan.values, VOLUME * (1.0 + np.arange(7))[:, np.newaxis, np.newaxis])


def test_files_without_preamble(tmp_path: Path) -> None:
    for path in write_series(tmp_path, VOLUME, along(7, UP)):
        dataset = pydicom.dcmread(path)
        dataset.file_meta.TransferSyntaxUID = pydicom.uid.ImplicitVRLittleEndian
        bare = Dataset()
        bare.update(dataset)
        bare.save_as(path, implicit_vr=True, little_endian=True, enforce_file_format=False)
    np.testing.assert_array_equal(read_scan(tmp_path).values, VOLUME)


def test_enhanced_multi_frame(tmp_path: Path) -> None:
    order = [3, 0, 6, 1, 2, 5, 4]
    positions = along(7, 2.0 * UP)
    write_enhanced(tmp_path / "one.dcm", VOLUME[order], positions[order], orientation=AXIAL, spacing=(1.5, 1.25))
    for path in (tmp_path, tmp_path / "one.dcm"):
        scan = read_scan(path)
        np.testing.assert_array_equal(scan.values, VOLUME * 2.0 + 3.0)
        assert scan.geometry.spacing_mm == (1.25, 1.5, 2.0)
        assert scan.geometry.origin_mm == (-100.0, -50.0, 20.0)
        assert scan.modality == "MR"


@pytest.mark.parametrize("syntax", [RLELossless, JPEG2000Lossless])
@pytest.mark.parametrize("through_itk", [False, True])
def test_compressed_series(tmp_path: Path, monkeypatch, capfd, syntax, through_itk) -> None:
    stored = np.random.default_rng(2).integers(0, 4000, size=(3, 64, 48)).astype(np.uint16)
    for path in write_series(tmp_path, stored, along(3, UP), slope=2.0, intercept=-5.0):
        dataset = pydicom.dcmread(path)
        dataset.compress(syntax)
        dataset.save_as(path, enforce_file_format=True)
    if through_itk:
        monkeypatch.setattr(dicom_pixels, "PLUGINS", {})
    np.testing.assert_array_equal(read_scan(tmp_path).values, stored * 2.0 - 5.0)
    last = sorted(tmp_path.iterdir())[2]
    _cut(last, 2000)
    capfd.readouterr()
    with pytest.raises(ScanError, match="slice 3: "):
        read_scan(tmp_path)
    assert capfd.readouterr() == ("", "")


def test_acquisition_physics_are_numbers_in_range(tmp_path: Path) -> None:
    write_series(
        tmp_path,
        VOLUME,
        along(7, UP),
        modality="MR",
        EchoTime=1.5,
        MagneticFieldStrength=1.5,
        RepetitionTime="",
        FlipAngle=19800131,
        SliceThickness=2,
    )
    scan = read_scan(tmp_path)
    assert scan.modality == "MR"
    assert scan.acquisition == {"echo_time_ms": 1.5, "magnetic_field_strength_t": 1.5, "slice_thickness_mm": 2.0}


def test_several_series_are_listed_and_chosen(tmp_path: Path) -> None:
    write_series(tmp_path / "a", VOLUME, along(7, 2.0 * UP), series=12, modality="MR", EchoTime=2.5)
    write_series(tmp_path / "b", VOLUME[:4] + 1, along(4, 5.0 * UP), series=3)
    coronal = (1.0, 0.0, 0.0, 0.0, 0.0, -1.0)
    write_series(tmp_path / "c", VOLUME[:1] + 2, along(1, UP), series=4, orientation=coronal)
    found = list_series(tmp_path)
    assert [(info.number, info.slice_count, info.modality) for info in found] == [
        (1, 4, "CT"),
        (2, 1, "CT"),
        (3, 7, "MR"),
    ]
    assert found[0].spacing_mm == (0.7, 0.7, 5.0)
    assert found[1].spacing_mm is None
    assert found[2].description == "MR, axial, 6 x 5 x 7 voxels of 0.7 x 0.7 x 2 mm, echo time 2.5 ms"
    assert all(len(info.uid_code) >= 6 for info in found)
    with pytest.raises(ScanError) as caught:
        read_scan(tmp_path)
    lines = str(caught.value).splitlines()
    assert "--series" in lines[0]
    assert len(lines) == 4
    assert found[2].description in lines[3]
    np.testing.assert_array_equal(read_scan(tmp_path, series="1").values, VOLUME[:4] + 1)
    np.testing.assert_array_equal(read_scan(tmp_path, series=found[2].uid_code).values, VOLUME)
    np.testing.assert_array_equal(read_scan(tmp_path, series=f"{ROOT}900012").values, VOLUME)
    for wrong in ("12", "17", "", "nothing", "0", "9" * 5000, found[2].uid_code[:5], f"{ROOT}9000", "900012"):
        with pytest.raises(ScanError, match="no series has this number"):
            read_scan(tmp_path, series=wrong)


def test_a_code_is_no_number_and_tells_apart() -> None:
    """Found by trial: the SHA-256 of these start with six decimal digits, or with the same six digits."""
    decimal = next(uid for n in range(1000) if _sha(uid := f"1.2.{n}")[:6].isdecimal())
    first: dict[str, str] = {}
    pair = next(
        (first[start], uid)
        for n in range(100_000)
        if first.setdefault(start := _sha(uid := f"1.3.{n}")[:6], uid) != uid
    )
    image = Slice(Path(), None, (8, 8), True, (0, 0, 0), AXIAL, (1.0, 1.0), 1.0, 0.0)
    groups = [group for uid in (decimal, *pair) for group in stack_groups(ImageSeries(uid, "CT", (image,)))]
    codes = [info.uid_code for info in listed(groups)]
    assert all(code == _sha(uid)[: len(code)] for code, uid in zip(codes, (decimal, *pair), strict=True))
    assert len(set(codes)) == 3
    assert not codes[0].isdecimal()
    assert [named(groups, code)[0] for code in codes] == groups
    with pytest.raises(ScanError, match="several series have this code"):
        named(groups, _sha(pair[0])[:6])


def _sha(uid: str) -> str:
    return hashlib.sha256(uid.encode()).hexdigest()


@settings(max_examples=10, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(order=st.permutations(range(7)), seed=st.integers(0, 99))
def test_file_names_change_nothing(tmp_path: Path, order, seed: int) -> None:
    """Directions and spacings are rounded a little differently in each header."""
    scans = []
    for names in (range(7), order):
        jitter = np.random.default_rng(seed).uniform(-2e-4, 2e-4, (7, 8))

        def each(dataset, index: int, jitter=jitter) -> None:
            dataset.ImageOrientationPatient = [repr_ds(v) for v in AXIAL + jitter[index, :6]]
            dataset.PixelSpacing = [repr_ds(v) for v in 0.7 * (1.0 + jitter[index, 6:])]

        scans.append(read_scan(_series_with(tmp_path, along(7, STEP), order=names, each=each)))
    assert scans[0].geometry == scans[1].geometry
    np.testing.assert_array_equal(scans[0].values, scans[1].values)


@pytest.mark.parametrize("is_listed", [False, True])
def test_a_folder_that_cannot_be_opened_is_not_passed_over(tmp_path: Path, monkeypatch, is_listed: bool) -> None:
    """Neither where it cannot be listed, nor where its files cannot be looked at."""
    write_series(tmp_path / "Secretname", VOLUME, along(7, UP))
    write_series(tmp_path / "Secretname" / "locked", VOLUME[:1], along(8, UP)[7:], first_instance=8)

    def refusing(function):
        def call(path, *args, **options):
            if "locked" in str(path) and (not is_listed or "s1" in str(path)):
                raise PermissionError(13, "Permission denied", str(path))
            return function(path, *args, **options)

        return call

    if is_listed:
        monkeypatch.setattr(Path, "stat", refusing(Path.stat))
    else:
        monkeypatch.setattr(os, "scandir", refusing(os.scandir))
    with pytest.raises(ScanError, match="cannot be opened, so that images may be missing") as caught:
        read_scan(tmp_path / "Secretname")
    assert "Secret" not in str(caught.value)


def test_a_localizer_of_one_image_does_not_make_a_choice_necessary(tmp_path: Path) -> None:
    write_series(tmp_path, VOLUME, along(7, UP), series=2)
    write_series(tmp_path, VOLUME[:1], along(1, UP), series=1)
    np.testing.assert_array_equal(read_scan(tmp_path).values, VOLUME)


def _series_with(tmp_path: Path, positions: np.ndarray, **options) -> Path:
    shutil.rmtree(tmp_path / "Secretname", ignore_errors=True)
    repeated = VOLUME[np.arange(len(positions)) % 7]
    write_series(tmp_path / "Secretname", repeated, positions, **options)
    return tmp_path / "Secretname"


STEP = 2.5 * UP
TILT = np.array([0.0, 0.5, 2.5])
MALFORMED_POSITIONS = {
    "missing": (np.delete(along(8, STEP), 4, axis=0), "1 slice is missing between slice 4 and the next"),
    "two missing": (np.delete(along(9, STEP), [4, 5], axis=0), "2 slices are missing between slice 4"),
    "missing in two places": (np.delete(along(12, STEP), [3, 7], axis=0), "between slice 3 .*between slice 6"),
    "doubled": (
        np.insert(along(6, STEP), 2, along(6, STEP)[2], axis=0),
        r"1 slice is there twice \(slice 3\), and the images differ, .*do not tell which",
    ),
    "phases": (np.repeat(along(4, STEP), 3, axis=0), "3 images at every slice position"),
    "all at one place": (np.repeat(along(1, STEP), 5, axis=0), "all 5 images show one slice"),
    "uneven": (along(7, STEP) + np.array([0, 0, 0, 0.3, 0, 0, 0])[:, np.newaxis] * UP, "uneven spacing .*2.80 mm"),
    "tilted": (along(7, TILT), r"leans by 11\.3 degrees"),
    "shifted": (along(7, STEP) + np.array([0, 0, 0, 4.0, 0, 0, 0])[:, np.newaxis] * (1, 0, 0), "shifted sideways"),
    "single": (along(1, STEP), "single image"),
}


@pytest.mark.parametrize("name", MALFORMED_POSITIONS)
def test_stacks_that_are_not_even_are_refused(tmp_path: Path, name: str) -> None:
    positions, words = MALFORMED_POSITIONS[name]
    folder = _series_with(tmp_path, positions, order=np.random.default_rng(0).permutation(len(positions)))
    with pytest.raises(ScanError) as caught:
        read_scan(folder)
    text = str(caught.value)
    assert re.search(words, text), text
    assert "\n" not in text
    assert "Secret" not in text
    assert list_series(folder)[0].spacing_mm is None


def test_evenness_has_the_stated_tolerance(tmp_path: Path) -> None:
    """0.1 mm from the nearest even line, which leaves 5/12 of what the last of seven slices is off."""
    for off, is_even in ((0.238, True), (0.242, False)):
        positions = along(7, STEP)
        positions[6] += off * UP
        folder = _series_with(tmp_path, positions)
        if is_even:
            assert read_scan(folder).geometry.spacing_mm[2] == pytest.approx(2.5 + off / 6, abs=1e-9)
        else:
            with pytest.raises(ScanError, match="uneven"):
                read_scan(folder)


def _edit(path: Path, **tags) -> None:
    dataset = pydicom.dcmread(path)
    for keyword, value in tags.items():
        if value is None:
            delattr(dataset, keyword)
        else:
            setattr(dataset, keyword, value)
    dataset.save_as(path, enforce_file_format=True)


def _colour(path: Path) -> None:
    dataset = pydicom.dcmread(path)
    dataset.SamplesPerPixel, dataset.PhotometricInterpretation, dataset.PlanarConfiguration = 3, "RGB", 0
    dataset.PixelData = bytes(3 * dataset.Rows * dataset.Columns * 2)
    dataset.save_as(path, enforce_file_format=True)


def _other_size(path: Path) -> None:
    dataset = pydicom.dcmread(path)
    put_pixels(dataset, np.zeros((9, 9), np.int16))
    dataset.save_as(path, enforce_file_format=True)


def _cut(path: Path, count: int) -> None:
    path.write_bytes(path.read_bytes()[:-count])


MALFORMED_SLICES = {
    "no position": (
        lambda path: _edit(path, ImagePositionPatient=None),
        "1 slice is missing .*1 image of the series is left out: no place in the patient",
    ),
    "bad position": (
        lambda path: _corrupt_tag(path, "ImagePositionPatient"),
        "1 slice is missing .*1 image of the series is left out: no place in the patient",
    ),
    "two coordinates": (
        lambda path: _edit(path, ImagePositionPatient=[1, 2]),
        "1 slice is missing .*1 image of the series is left out: no place in the patient",
    ),
    "other orientation": (
        lambda path: _edit(path, ImageOrientationPatient=[0, 1, 0, 0, 0, 1]),
        "1 slice is missing .*left out: another orientation",
    ),
    "other spacing": (
        lambda path: _edit(path, PixelSpacing=[0.8, 0.7]),
        "1 slice is missing .*left out: another pixel spacing",
    ),
    "zero spacing": (lambda path: _edit(path, PixelSpacing=[0.0, 0.7]), "another pixel spacing"),
    "other size": (_other_size, "1 slice is missing .*left out: another size"),
    "colour": (_colour, "1 slice is missing .*left out: in colour"),
    "cut in the pixels": (lambda path: _cut(path, 10), "slice 3: the file is cut short"),
    "cut in the header": (lambda path: path.write_bytes(path.read_bytes()[:420]), "1 DICOM file is cut short"),
    "empty": (lambda path: path.rename(path.with_suffix(".dcm")).write_bytes(b""), "1 DICOM file is cut short"),
    "no pixels": (lambda path: _edit(path, PixelData=None), "slice 3: the file is cut short or damaged"),
    "infinite slope": (lambda path: _edit(path, RescaleSlope="1e300"), "slice 3: .*finite"),
}


def _corrupt_tag(path: Path, keyword: str) -> None:
    content = path.read_bytes()
    dataset = pydicom.dcmread(path)
    text = "\\".join(str(v) for v in dataset[keyword].value).encode()
    assert content.count(text) == 1
    path.write_bytes(content.replace(text, b"Secretname"[: len(text)].ljust(len(text), b"x")))


@pytest.mark.parametrize("name", MALFORMED_SLICES)
def test_series_with_one_bad_slice_is_refused(tmp_path: Path, name: str, capfd: pytest.CaptureFixture) -> None:
    spoil, words = MALFORMED_SLICES[name]
    folder = _series_with(tmp_path, along(7, STEP))
    spoil(folder / "s1_0002")
    with pytest.raises(ScanError) as caught:
        read_scan(folder)
    text = str(caught.value)
    assert re.search(words, text), text
    assert "\n" not in text
    assert "Secret" not in text
    assert capfd.readouterr() == ("", "")


def test_a_file_damaged_anywhere_never_crashes(tmp_path: Path) -> None:
    folder = _series_with(tmp_path, along(7, STEP))
    path = folder / "s1_0002"
    content = path.read_bytes()
    for place in range(128, len(content), 7):
        damaged = bytearray(content)
        damaged[place] ^= 0xFF
        path.write_bytes(bytes(damaged))
        try:
            shape = read_scan(folder).values.shape
        except ScanError:
            continue
        assert shape[1:] == (5, 6)


def test_series_of_colour_images_alone(tmp_path: Path) -> None:
    folder = _series_with(tmp_path, along(7, STEP))
    for path in folder.iterdir():
        _colour(path)
    with pytest.raises(ScanError, match="in colour"):
        read_scan(folder)


def test_multi_frame_without_positions(tmp_path: Path) -> None:
    dataset = header()
    put_pixels(dataset, VOLUME)
    dataset.save_as(tmp_path / "one.dcm", enforce_file_format=True)
    with pytest.raises(ScanError, match="do not say where they lie"):
        read_scan(tmp_path / "one.dcm")


PLANTED = "Sensitivus"
TEXT_VRS = {"PN": "Sensitivus^Anna", "LO": "Sensitivus", "SH": "Sensitivus", "ST": "Sensitivus", "LT": "Sensitivus"}
TEXT_VRS |= {"UT": "Sensitivus", "UC": "Sensitivus", "CS": "SENSITIVUS"}
OF_USE = {"Modality", "PhotometricInterpretation", "TransferSyntaxUID"}


def _plant(path: Path, target: Path) -> int:
    """Write a copy with a name in every text tag and a date of birth in every date; the number of text tags."""
    dataset = pydicom.dcmread(path)
    planted = 0
    for keyword, tag in keyword_dict.items():
        if keyword in OF_USE or keyword in dataset or tag >> 16 in (0x0000, 0x0002, 0x0004, 0xFFFE):
            continue
        vr = dictionary_VR(tag)
        if vr in TEXT_VRS:
            setattr(dataset, keyword, TEXT_VRS[vr])
            planted += 1
        elif vr == "DA":
            setattr(dataset, keyword, "19770203")
    dataset.save_as(target, enforce_file_format=True)
    return planted


@pytest.mark.parametrize("is_spoilt", [False, True])
def test_no_identity_leaves_the_reader(tmp_path: Path, caplog, capfd, is_spoilt: bool) -> None:
    """Every text tag of the dictionary, file names and folder names hold a name; dates and ages are told too."""
    folder = tmp_path / f"{PLANTED}_Anna"
    write_series(folder, VOLUME, along(7, STEP))
    write_series(folder, VOLUME, along(7, STEP), series=2)
    for number, path in enumerate(sorted(folder.iterdir())):
        with warnings.catch_warnings(action="ignore"):
            planted = _plant(path, path.with_name(f"{PLANTED}{number}.dcm"))
        assert planted > 1000
        path.unlink()
    caplog.clear()
    if is_spoilt:
        content = (folder / f"{PLANTED}3.dcm").read_bytes()
        (folder / f"{PLANTED}3.dcm").write_bytes(content.replace(b"-100\\-50", b"Sensitiv"))
    logging.getLogger("pydicom").setLevel(logging.DEBUG)
    texts = []
    with caplog.at_level(logging.DEBUG):
        try:
            texts += [repr(list_series(folder))]
            texts += [repr(read_scan(folder, series="2")), repr(read_scan(folder, series="1"))]
        except ScanError as error:
            texts += [str(error), repr(error.problems)]
            assert is_spoilt
        for series in (None, "x", PLANTED):
            with pytest.raises(ScanError) as caught:
                read_scan(folder, series=series)
            texts += [str(caught.value), repr(caught.value.args), repr(caught.value.problems)]
        for path in (folder / f"{PLANTED}.nii", folder / f"{PLANTED}1.dcm", folder / f"{PLANTED}.xyz"):
            with pytest.raises(ScanError) as caught:
                read_scan(path)
            texts += [str(caught.value)]
    texts += [caplog.text, *capfd.readouterr()]
    for text in texts:
        assert PLANTED.lower() not in text.lower()
        assert "1977" not in text
        assert str(tmp_path) not in text
    assert CT not in "".join(texts)
