from __future__ import annotations

import gzip
import os
import re
import struct
from pathlib import Path

import nibabel
import nrrd
import numpy as np
import pytest
import SimpleITK
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from heartcase.pipeline.data import Scan, Segmentation
from heartcase.pipeline.formats.read_scan import list_series, read_labels, read_scan
from heartcase.pipeline.formats.write_images import segmentation_nrrd_bytes, write_scan, write_segmentation
from heartcase.schemas.errors import MarkerError, ScanError, UsageError
from heartcase.schemas.geometry import Geometry
from heartcase.schemas.labels import default_label_table

SUFFIXES = (".nii", ".nii.gz", ".nrrd", ".mha")
RAS_TO_LPS = np.diag([-1.0, -1.0, 1.0, 1.0])
FLOAT32_MM = 2e-4
"""NIfTI holds the geometry in float32: at 1000 mm its steps are 6e-5 mm, and there are three of them in a position."""


def rotation(angles: tuple[float, float, float]) -> np.ndarray:
    matrix = np.eye(3)
    for axis, angle in enumerate(angles):
        turn = np.eye(3)
        a, b = [n for n in range(3) if n != axis]
        turn[a, a] = turn[b, b] = np.cos(angle)
        turn[a, b], turn[b, a] = -np.sin(angle), np.sin(angle)
        matrix = turn @ matrix
    return matrix


OBLIQUE_LEFT_HANDED = Geometry.of(
    shape=(4, 5, 6),
    origin_mm=(-101.25, 33.5, 710.125),
    spacing_mm=(0.7, 1.1, 3.0),
    direction=rotation((0.3, -0.5, 0.9)) @ np.diag([1.0, 1.0, -1.0]),
)


@st.composite
def geometries(draw: st.DrawFn) -> Geometry:
    angle = st.floats(-np.pi, np.pi)
    flip = np.diag([1.0, 1.0, draw(st.sampled_from([1.0, -1.0]))])
    coordinate = st.floats(-500.0, 500.0)
    return Geometry.of(
        shape=draw(st.tuples(*[st.integers(2, 5)] * 3)),
        origin_mm=draw(st.tuples(coordinate, coordinate, coordinate)),
        spacing_mm=draw(st.tuples(*[st.floats(0.1, 12.0)] * 3)),
        direction=rotation(draw(st.tuples(angle, angle, angle))) @ flip,
    )


def numbered(geometry: Geometry) -> np.ndarray:
    return (np.arange(np.prod(geometry.shape), dtype=np.float32) * 0.37 - 5.0).reshape(geometry.shape)


@settings(max_examples=15, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(geometry=geometries())
@pytest.mark.parametrize("suffix", SUFFIXES)
def test_write_and_read_keeps_values_and_geometry(tmp_path: Path, suffix: str, geometry: Geometry) -> None:
    values = numbered(geometry)
    path = tmp_path / f"scan{suffix}"
    write_scan(Scan(values, geometry), path)
    scan = read_scan(path)
    assert scan.values.dtype == np.float32
    np.testing.assert_array_equal(scan.values, values)
    tolerance = FLOAT32_MM if suffix.startswith(".nii") else 1e-9
    np.testing.assert_allclose(scan.geometry.affine, geometry.affine, atol=tolerance, rtol=0)
    assert scan.geometry.is_right_handed == geometry.is_right_handed


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_what_is_written_is_what_other_libraries_read(tmp_path: Path, suffix: str) -> None:
    geometry = OBLIQUE_LEFT_HANDED
    path = tmp_path / f"scan{suffix}"
    write_scan(Scan(numbered(geometry), geometry), path)
    image = SimpleITK.ReadImage(str(path))
    np.testing.assert_array_equal(SimpleITK.GetArrayFromImage(image), numbered(geometry))
    far = tuple(n - 1 for n in geometry.size)
    np.testing.assert_allclose(
        image.TransformIndexToPhysicalPoint(far), geometry.index_to_world(far), atol=FLOAT32_MM, rtol=0
    )
    if suffix.startswith(".nii"):
        other = nibabel.load(path)
        np.testing.assert_allclose(RAS_TO_LPS @ other.affine, geometry.affine, atol=FLOAT32_MM, rtol=0)
        np.testing.assert_array_equal(other.get_fdata(dtype=np.float32).T, numbered(geometry))
    if suffix == ".nrrd":
        values, fields = nrrd.read(str(path))
        np.testing.assert_array_equal(values.T, numbered(geometry))
        np.testing.assert_allclose(fields["space directions"].T, geometry.affine[:3, :3], atol=1e-12)


@pytest.mark.parametrize("suffix", [".nii.gz", ".nrrd", ".mha", ".seg.nrrd"])
def test_same_segmentation_gives_same_bytes(tmp_path: Path, suffix: str) -> None:
    labels = (np.arange(120) % 10).astype(np.uint8).reshape(OBLIQUE_LEFT_HANDED.shape)
    segmentation = Segmentation(labels, OBLIQUE_LEFT_HANDED, default_label_table())
    write_segmentation(segmentation, tmp_path / f"a{suffix}")
    write_segmentation(segmentation, tmp_path / f"b{suffix}")
    content = (tmp_path / f"a{suffix}").read_bytes()
    assert content == (tmp_path / f"b{suffix}").read_bytes()
    assert sorted(path.name for path in tmp_path.iterdir()) == [f"a{suffix}", f"b{suffix}"]
    if suffix == ".seg.nrrd":
        assert content == segmentation_nrrd_bytes(segmentation)
    np.testing.assert_array_equal(read_labels(tmp_path / f"a{suffix}").values, labels)


@pytest.mark.parametrize("suffix", [".nii", ".nii.gz"])
def test_nifti_says_what_are_labels_and_a_scan_does_not(tmp_path: Path, suffix: str) -> None:
    labels = (np.arange(120) % 10).astype(np.uint8).reshape(OBLIQUE_LEFT_HANDED.shape)
    write_segmentation(Segmentation(labels, OBLIQUE_LEFT_HANDED, default_label_table()), tmp_path / f"labels{suffix}")
    write_scan(Scan(labels.astype(np.float32), OBLIQUE_LEFT_HANDED, "CT"), tmp_path / f"scan{suffix}")
    written, scan = (nibabel.load(tmp_path / f"{name}{suffix}") for name in ("labels", "scan"))
    assert written.header.get_intent()[0] == "label"
    np.testing.assert_array_equal(np.asarray(written.dataobj).T, labels)
    assert scan.header.get_intent()[0] == "none"


def test_segment_table_is_what_slicer_reads(tmp_path: Path) -> None:
    labels = np.zeros(OBLIQUE_LEFT_HANDED.shape, np.uint8)
    labels[1:3, 2:5, 4] = 5
    path = tmp_path / "labels.seg.nrrd"
    write_segmentation(Segmentation(labels, OBLIQUE_LEFT_HANDED, default_label_table()), path)
    fields = nrrd.read_header(str(path))
    index = next(n for n in range(9) if fields[f"Segment{n}_Name"] == "aorta")
    assert fields[f"Segment{index}_LabelValue"] == "5"
    assert fields[f"Segment{index}_Layer"] == "0"
    assert fields[f"Segment{index}_Extent"] == "4 4 2 4 1 2"
    assert [round(float(v) * 255) for v in fields[f"Segment{index}_Color"].split()] == [0x99, 0x38, 0x48]
    assert "SCT^15825003^Aorta" in fields[f"Segment{index}_Tags"]
    assert fields["Segmentation_MasterRepresentation"] == "Binary labelmap"
    empty = next(n for n in range(9) if fields[f"Segment{n}_Name"] == "morphologically left atrium")
    assert fields[f"Segment{empty}_Extent"] == "0 -1 0 -1 0 -1"
    volume = read_labels(path)
    assert (volume.segments[5].name, volume.segments[5].snomed) == ("aorta", "15825003")
    assert len(volume.segments) == 9
    np.testing.assert_array_equal(volume.values, labels)


def test_output_that_cannot_be_written_is_explained(tmp_path: Path) -> None:
    scan = Scan(numbered(OBLIQUE_LEFT_HANDED), OBLIQUE_LEFT_HANDED)
    with pytest.raises(UsageError, match="must end in one of"):
        write_scan(scan, tmp_path / "scan.stl")
    with pytest.raises(UsageError, match="cannot be written"):
        write_scan(scan, tmp_path / "nowhere" / "scan.nrrd")


@pytest.mark.parametrize("dtype", [np.uint8, np.int16, np.uint16, np.int32, np.float32, np.float64, np.int64])
@pytest.mark.parametrize("kind", [nibabel.Nifti1Image, nibabel.Nifti2Image])
def test_nifti_of_every_type_as_nibabel_reads_it(tmp_path: Path, dtype: type, kind: type) -> None:
    values = (np.arange(60) * 3).astype(dtype).reshape(3, 4, 5)
    affine = RAS_TO_LPS @ OBLIQUE_LEFT_HANDED.affine
    image = kind(values, affine, dtype=dtype)
    image.header.set_slope_inter(2.5, -7.0)
    nibabel.save(image, tmp_path / "s.nii.gz")
    expected = nibabel.load(tmp_path / "s.nii.gz")
    scan = read_scan(tmp_path / "s.nii.gz")
    np.testing.assert_allclose(scan.values, expected.get_fdata().T, rtol=1e-6)
    np.testing.assert_allclose(scan.geometry.affine, RAS_TO_LPS @ expected.affine, atol=1e-5, rtol=0)


@pytest.mark.parametrize("handedness", [1.0, -1.0])
def test_nifti_qform_alone_big_endian_and_in_metres(tmp_path: Path, handedness: float) -> None:
    affine = np.eye(4)
    affine[:3, :3] = rotation((2.9, 0.4, -1.2)) @ np.diag([0.0007, 0.0011, 0.003 * handedness])
    affine[:3, 3] = 0.11, -0.02, 0.3
    header = nibabel.Nifti1Header(endianness=">")
    image = nibabel.Nifti1Image(np.arange(60, dtype=">i2").reshape(3, 4, 5), None, header)
    image.set_qform(affine, 1)
    image.set_sform(None, 0)
    image.header.set_xyzt_units("meter")
    nibabel.save(image, tmp_path / "s.nii")
    scan = read_scan(tmp_path / "s.nii")
    expected = RAS_TO_LPS @ affine
    expected[:3] *= 1000.0
    np.testing.assert_allclose(scan.geometry.affine, expected, atol=1e-3, rtol=0)
    np.testing.assert_array_equal(scan.values, np.arange(60).reshape(3, 4, 5).T)
    assert "orientation" not in scan.acquisition


def test_nifti_without_orientation_is_read_as_itk_does_and_says_so(tmp_path: Path) -> None:
    image = nibabel.Nifti1Image(np.arange(60, dtype=np.int16).reshape(3, 4, 5), None)
    image.header.set_zooms((1.0, 2.0, 3.0))
    nibabel.save(image, tmp_path / "s.nii")
    scan = read_scan(tmp_path / "s.nii")
    assert "not stated" in scan.acquisition["orientation"]
    other = SimpleITK.ReadImage(str(tmp_path / "s.nii"))
    assert scan.geometry.spacing_mm == other.GetSpacing()
    np.testing.assert_array_equal(scan.geometry.direction_matrix.ravel(), other.GetDirection())
    np.testing.assert_array_equal(scan.geometry.origin_mm, other.GetOrigin())


def two_forms(path: Path, sform: np.ndarray, qform: np.ndarray) -> Path:
    image = nibabel.Nifti1Image(np.zeros((60, 50, 40), np.int16), sform)
    image.set_sform(sform, 1)
    image.set_qform(qform, 1)
    nibabel.save(image, path)
    return path


@settings(max_examples=30, deadline=None)
@given(
    turn=st.tuples(*[st.floats(-np.pi, np.pi)] * 3) | st.tuples(st.just(np.pi), *[st.floats(-1e-3, 1e-3)] * 2),
    hand=st.sampled_from((1.0, -1.0)),
    moved=st.floats(0.3, 30.0),
)
@example(turn=(0.0, 0.0, np.pi - 6e-4), hand=1.0, moved=1.0)
def test_nifti_whose_forms_agree_is_read_and_a_shifted_or_mirrored_one_refused(
    tmp_path_factory: pytest.TempPathFactory, turn: tuple[float, float, float], hand: float, moved: float
) -> None:
    """Half turns lose most digits: the first part of the quaternion is not stored (nifti1.h)."""
    affine = np.eye(4)
    affine[:3, :3] = rotation(turn) @ np.diag([4.0, 6.0, 8.0 * hand])
    affine[:3, 3] = -200.0, 150.0, 900.0
    path = tmp_path_factory.getbasetemp() / "forms.nii"
    scan = read_scan(two_forms(path, affine, affine))
    np.testing.assert_allclose(scan.geometry.affine, RAS_TO_LPS @ affine, atol=1e-4)
    other = affine.copy()
    other[0, 3] += moved + 0.1 + 2.0 * np.sqrt(5e-7) * np.linalg.norm([59 * 4, 49 * 6, 39 * 8])
    with pytest.raises(ScanError, match="two orientations"):
        read_scan(two_forms(path, affine, other))
    other = affine @ np.diag([1.0, 1.0, -1.0, 1.0])
    other[:3, 3] += 39 * affine[:3, 2]
    with pytest.raises(ScanError, match="two orientations"):
        read_scan(two_forms(path, affine, other))


@pytest.mark.parametrize(
    ("place", "numbers", "words"),
    [
        (80, (-1.0,), "voxel size below zero"),
        (88, (-3.0,), "voxel size below zero"),
        (112, (2.0, np.nan), "intercept is not a number"),
        (112, (1.0, np.inf), "intercept is not a number"),
    ],
)
def test_nifti_headers_that_other_programs_read_otherwise_are_refused(tmp_path, place, numbers, words) -> None:
    image = nibabel.Nifti1Image(np.arange(60, dtype=np.int16).reshape(3, 4, 5), None)
    image.set_qform(np.diag([1.0, 2.0, 3.0, 1.0]), 1)
    nibabel.save(image, tmp_path / "s.nii")
    content = bytearray((tmp_path / "s.nii").read_bytes())
    struct.pack_into(f"<{len(numbers)}f", content, place, *numbers)
    (tmp_path / "s.nii").write_bytes(content)
    with pytest.raises(ScanError, match=words):
        read_scan(tmp_path / "s.nii")


NRRD_BASE = ("type: short", "dimension: 3", "sizes: 2 3 4", "encoding: raw", "endian: little")
DIRECTIONS = "space directions: (1,0,0) (0,2,0) (0,0,3)"
ORIGIN = "space origin: (1,2,3)"
SHORTS = np.arange(24, dtype="<i2").tobytes()


def nrrd_file(path: Path, *lines: str, data: bytes = SHORTS) -> Path:
    path.write_bytes(("NRRD0004\n" + "\n".join(lines) + "\n\n").encode() + data)
    return path


def test_nrrd_in_ras_and_without_space(tmp_path: Path) -> None:
    ras = read_scan(nrrd_file(tmp_path / "a.nrrd", *NRRD_BASE, "space: RAS", DIRECTIONS, ORIGIN))
    assert ras.geometry.origin_mm == (-1.0, -2.0, 3.0)
    np.testing.assert_array_equal(ras.geometry.affine[:3, :3], np.diag([-1.0, -2.0, 3.0]))
    assert ras.acquisition == {}
    bare = read_scan(nrrd_file(tmp_path / "b.nrrd", *NRRD_BASE, "spacings: 1 2 3"))
    assert bare.geometry.spacing_mm == (1.0, 2.0, 3.0)
    assert "not stated" in bare.acquisition["orientation"]
    np.testing.assert_array_equal(bare.values.ravel(), np.arange(24))


@pytest.mark.parametrize(
    ("lines", "words"),
    [
        ((), "voxel spacing of every axis"),
        (("spacings: 1 2",), "voxel spacing of every axis"),
        (("spacings: 1.5 nan 3",), "voxel spacing of every axis"),
        (("spacings: 1 -2 3",), "voxel spacing of every axis"),
        (("spacings: 1 x 3",), "damaged"),
        (("space: LPS", ORIGIN), "voxel spacing of every axis"),
        (("space: LPS", "space directions: (1,0,0) none (0,0,3)"), "voxel spacing of every axis"),
        (("space: LPS", "space directions: (1,0,0) (0,nan,0) (0,0,3)"), "voxel spacing of every axis"),
        (("spacings: 1 2 3", 'units: "cm" "cm" "cm"'), "millimetres"),
        (("space: LPS", DIRECTIONS, 'space units: "mm" "cm" "mm"'), "millimetres"),
    ],
)
def test_nrrd_without_a_spacing_in_mm_is_refused(tmp_path: Path, lines: tuple[str, ...], words: str) -> None:
    with pytest.raises(ScanError, match=words):
        read_scan(nrrd_file(tmp_path / "a.nrrd", *NRRD_BASE, *lines))


def test_nrrd_layers_need_the_spacing_of_their_three_axes_alone(tmp_path: Path) -> None:
    base = ("type: short", "dimension: 4", "sizes: 2 2 2 3", "encoding: raw", "endian: little")
    path = tmp_path / "a.seg.nrrd"
    segments = [f"Segment{n}_{key}:={text}" for n in (0, 1) for key, text in (("LabelValue", "1"), ("Layer", str(n)))]
    data = np.zeros(24, "<i2").tobytes()
    axes = ("kinds: list domain domain domain", "space: LPS")
    nrrd_file(path, *base, *axes, "space directions: none (1,0,0) (0,2,0) (0,0,3)", ORIGIN, *segments, data=data)
    assert read_labels(path).geometry.spacing_mm == (1.0, 2.0, 3.0)


def test_detached_headers(tmp_path: Path) -> None:
    (tmp_path / "d.raw").write_bytes(SHORTS)
    (tmp_path / "s.nhdr").write_text(
        "NRRD0004\n" + "\n".join((*NRRD_BASE, "space: LPS", DIRECTIONS, ORIGIN, "data file: d.raw")) + "\n"
    )
    scan = read_scan(tmp_path / "s.nhdr")
    np.testing.assert_array_equal(scan.values.ravel(), np.arange(24))
    assert scan.geometry.origin_mm == (1.0, 2.0, 3.0)
    image = SimpleITK.GetImageFromArray(np.arange(24, dtype=np.int16).reshape(4, 3, 2))
    image.SetDirection(rotation((0.1, 0.2, 0.3)).ravel())
    SimpleITK.WriteImage(image, str(tmp_path / "m.mhd"))
    scan = read_scan(tmp_path / "m.mhd")
    np.testing.assert_array_equal(scan.values.ravel(), np.arange(24))
    np.testing.assert_allclose(scan.geometry.direction_matrix, rotation((0.1, 0.2, 0.3)), atol=1e-12)


def test_one_file_is_one_series(tmp_path: Path) -> None:
    write_scan(Scan(numbered(OBLIQUE_LEFT_HANDED), OBLIQUE_LEFT_HANDED), tmp_path / "s.nii.gz")
    (info,) = list_series(tmp_path / "s.nii.gz")
    assert info.slice_count == 4
    assert "6 x 5 x 4 voxels" in info.description


def _metaimage(lines: str, data: bytes) -> bytes:
    return (
        "ObjectType = Image\nNDims = 3\nBinaryData = True\nBinaryDataByteOrderMSB = False\n"
        f"{lines}\nElementType = MET_SHORT\nElementDataFile = LOCAL\n"
    ).encode() + data


def _written(suffix: str, values: np.ndarray, tmp_path: Path, **options: bool) -> bytes:
    path = tmp_path / f"made{suffix}"
    SimpleITK.WriteImage(SimpleITK.GetImageFromArray(values, **options), str(path), useCompression=True)
    return path.read_bytes()


def _nifti(values: np.ndarray, tmp_path: Path, *, shear: float = 0.0) -> bytes:
    affine = np.eye(4)
    affine[0, 1] = shear
    image = nibabel.Nifti1Image(values, affine)
    if shear:
        image.set_qform(np.eye(4), 1)
        image.set_sform(affine, 1)
    nibabel.save(image, tmp_path / "made.nii")
    return (tmp_path / "made.nii").read_bytes()


NOISE = np.random.default_rng(3).normal(size=(12, 13, 14)).astype(np.float32)


def _flipped(content: bytes, place: int) -> bytes:
    damaged = bytearray(content)
    damaged[place] ^= 0xFF
    return bytes(damaged)


def malformed(tmp_path: Path) -> dict[str, tuple[str, bytes, str]]:
    """Name -> (ending, content, words of the error)."""
    nii, mha, nrrd_gz = _nifti(NOISE, tmp_path), _written(".mha", NOISE, tmp_path), _written(".nrrd", NOISE, tmp_path)
    nan = NOISE.copy()
    nan[3, 4, 5], nan[0, 0, 0] = np.nan, np.inf
    lps = (*NRRD_BASE, "space: LPS", ORIGIN)

    def text(*lines: str, data: bytes = SHORTS) -> bytes:
        return ("NRRD0004\n" + "\n".join(lines) + "\n\n").encode() + data

    huge = bytearray(nii)
    huge[42:48] = np.array([30000, 30000, 30000], "<i2").tobytes()
    complex_values = NOISE.astype(np.complex64)
    rgb = np.zeros((3, 4, 5, 3), np.uint8)
    four = NOISE[..., np.newaxis].repeat(3, axis=3)
    meta = "DimSize = 2 3 4\nElementSpacing = 1 1 1\nOffset = 0 0 0\n"
    return {
        "nii empty": (".nii", b"", "empty"),
        "nii cut in the header": (".nii", nii[:200], "not a NIfTI"),
        "nii cut short": (".nii", nii[:-1], "cut short"),
        "nii.gz cut short": (".nii.gz", gzip.compress(nii)[:-30], "cut short"),
        "nii.gz cut at the checksum": (".nii.gz", gzip.compress(nii)[:-4], "cut short"),
        "nii.gz damaged": (".nii.gz", _flipped(gzip.compress(nii), 4000), "damaged"),
        "nii.gz too short inside": (".nii.gz", gzip.compress(nii[:-500]), "cut short"),
        "nii of random bytes": (".nii", bytes(range(256)) * 4, "not a NIfTI"),
        "nii claims too much": (".nii", bytes(huge), "1024 x 1024"),
        "nii sheared": (".nii", _nifti(NOISE, tmp_path, shear=0.3), "right angles"),
        "nii 4-D": (".nii", _nifti(four, tmp_path), "3 volumes"),
        "nii flat": (".nii", _nifti(NOISE[0], tmp_path), "flat"),
        "nii one slice": (".nii", _nifti(NOISE[..., :1], tmp_path), "single slice"),
        "nii complex": (".nii", _nifti(complex_values, tmp_path), "complex"),
        "nii colour": (".nii", _written(".nii", rgb, tmp_path, isVector=True), "colour|volumes"),
        "nii not a number": (".nii", _nifti(nan, tmp_path), "2 voxels hold no finite"),
        "nii beyond float32": (".nii", _nifti(NOISE.astype(np.float64) * 1e300, tmp_path), "finite"),
        "nrrd empty": (".nrrd", b"", "empty"),
        "nrrd random": (".nrrd", b"hello" * 50, "not an NRRD"),
        "nrrd cut short": (".nrrd", nrrd_gz[: len(nrrd_gz) // 2], "cut short"),
        "nrrd cut in the header": (".nrrd", nrrd_gz[:60], "damaged"),
        "nrrd raw cut short": (".nrrd", text(*lps, DIRECTIONS, data=SHORTS[:-1]), "cut short"),
        "nrrd damaged": (".nrrd", _flipped(nrrd_gz, len(nrrd_gz) // 2), "damaged"),
        "nrrd claims gzip": (".nrrd", text(*[s.replace("raw", "gzip") for s in lps], DIRECTIONS), "damaged"),
        "nrrd sheared": (".nrrd", text(*lps, "space directions: (1,0,0) (0.3,2,0) (0,0,3)"), "right angles"),
        "nrrd zero spacing": (".nrrd", text(*lps, "space directions: (1,0,0) (0,2,0) (0,0,0)"), "above zero"),
        "nrrd in metres": (".nrrd", text(*lps, DIRECTIONS, 'space units: "m" "m" "m"'), "millimetres"),
        "nrrd 4-D": (
            ".nrrd",
            text("type: short", "dimension: 4", "sizes: 2 3 2 2", "encoding: raw", "endian: little"),
            "4-D",
        ),
        "nrrd colour": (".nrrd", _written(".nrrd", rgb, tmp_path, isVector=True), "3 values"),
        "nrrd flat": (".nrrd", text("type: short", "dimension: 2", "sizes: 6 4", "encoding: raw"), "flat"),
        "nrrd claims too much": (
            ".nrrd",
            text("type: short", "dimension: 3", "sizes: 60000 60000 60000", "encoding: raw", "endian: little"),
            "1024 x 1024",
        ),
        "nrrd negative": (
            ".nrrd",
            text("type: short", "dimension: 3", "sizes: 2 -3 4", "encoding: raw", "endian: little"),
            "below 1",
        ),
        "nhdr elsewhere": (".nhdr", text(*lps, DIRECTIONS, "data file: ../other.raw", data=b""), "another folder"),
        "nhdr absolute": (".nhdr", text(*lps, DIRECTIONS, "data file: /etc/hostname", data=b""), "another folder"),
        "nhdr missing": (".nhdr", text(*lps, DIRECTIONS, "data file: other.raw", data=b""), "missing"),
        "nhdr list": (".nhdr", text(*lps, DIRECTIONS, "data file: LIST", data=b"a\n"), "separate files"),
        "mha empty": (".mha", b"", "empty"),
        "mha random": (".mha", b"hello" * 50, "not a MetaImage"),
        "mha cut short": (".mha", mha[: len(mha) // 2], "cut short"),
        "mha damaged": (".mha", _flipped(mha, len(mha) // 2), "damaged"),
        "mha raw cut short": (".mha", _metaimage(meta, SHORTS[:-1]), "cut short"),
        "mha sheared": (".mha", _metaimage(meta + "TransformMatrix = 1 0 0 0.3 1 0 0 0 1", SHORTS), "right angles"),
        "mha scaled": (".mha", _metaimage(meta + "TransformMatrix = 1 0 0 0 0 0 0 0 1", SHORTS), "spacing"),
        "mha bad numbers": (".mha", _metaimage("DimSize = 2 x 4", SHORTS), "damaged"),
        "mha colour": (".mha", _written(".mha", rgb, tmp_path, isVector=True), "3 values"),
        "mhd elsewhere": (
            ".mhd",
            _metaimage(meta, b"").replace(b"LOCAL", b"../x.raw"),
            "another folder",
        ),
        "unknown": (".stl", b"solid", "not read"),
    }


def test_malformed_files_are_refused_in_one_line_without_noise(tmp_path: Path, capfd: pytest.CaptureFixture) -> None:
    cases = malformed(tmp_path)
    capfd.readouterr()
    wrong = {}
    for name, (suffix, content, words) in cases.items():
        path = tmp_path / f"Secretname{suffix}"
        path.write_bytes(content)
        try:
            read_scan(path)
            wrong[name] = "was read"
        except ScanError as error:
            text = str(error)
            if "\n" in text or not re.search(words, text) or "Secret" in text or str(tmp_path) in text:
                wrong[name] = text
        path.unlink()
    assert wrong == {}
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("suffix", [".nii.gz", ".nrrd", ".mha"])
def test_a_file_damaged_anywhere_is_refused_or_read_as_it_was(tmp_path: Path, suffix: str) -> None:
    """A flipped byte of the compressed data never passes for other values."""
    path = tmp_path / f"s{suffix}"
    geometry = Geometry.of(shape=NOISE.shape)
    write_scan(Scan(NOISE, geometry), path)
    content = path.read_bytes()
    start = {".nii.gz": 12, ".nrrd": content.find(b"\n\n") + 12, ".mha": content.find(b"LOCAL\n") + 8}[suffix]
    for place in np.linspace(start, len(content) - 1, 40).astype(int):
        path.write_bytes(_flipped(content, place))
        try:
            scan = read_scan(path)
        except ScanError:
            continue
        np.testing.assert_array_equal(scan.values, NOISE)
        np.testing.assert_allclose(scan.geometry.affine, geometry.affine, atol=1e-6)


def test_what_is_no_file_is_refused_at_once(tmp_path: Path) -> None:
    with pytest.raises(ScanError, match="no such file"):
        read_scan(tmp_path / "missing.nii")
    with pytest.raises(ScanError, match="no DICOM image"):
        read_scan(tmp_path)
    if hasattr(os, "mkfifo"):
        os.mkfifo(tmp_path / "pipe.nii")
        with pytest.raises(ScanError, match="neither a file nor a folder"):
            read_scan(tmp_path / "pipe.nii")
        with pytest.raises(ScanError, match="no DICOM image"):
            read_scan(tmp_path)


def test_label_volumes_must_hold_whole_numbers(tmp_path: Path) -> None:
    path = tmp_path / "l.nii.gz"
    for values, words in ((NOISE, "whole numbers"), (np.full((3, 3, 3), -1, np.int16), "whole numbers")):
        path.write_bytes(gzip.compress(_nifti(values, tmp_path)))
        with pytest.raises(MarkerError, match=words):
            read_labels(path)
    path.write_bytes(gzip.compress(_nifti(np.full((3, 3, 1), 300.0, np.float32), tmp_path)))
    volume = read_labels(path)
    assert volume.values.dtype == np.uint16
    assert volume.values.shape == (1, 3, 3)
    assert volume.segments == {}
