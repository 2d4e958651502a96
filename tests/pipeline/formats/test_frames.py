"""One volume of a 4-D file: as another library reads it, by number and by time; 0 is a number and a time."""

from __future__ import annotations

import contextlib
import gzip
from pathlib import Path

import nibabel
import nrrd
import numpy as np
import pytest
import SimpleITK
from click.testing import CliRunner

from heartcase.cli.main import cli, main
from heartcase.pipeline.formats.read_scan import read_labels, read_scan
from heartcase.pipeline.formats.volumes import frames
from heartcase.schemas.errors import MarkerError, ScanError
from heartcase.schemas.recipe.recipe import load_recipe, parse_recipe
from tests.pipeline.formats.dicom_situations import write

SHAPE = (6, 5, 4, 3)
"""Frames, z, y, x."""
VALUES = np.random.default_rng(2).integers(-900, 900, SHAPE).astype(np.int16)
STEP_S = 0.04
AFFINE = np.array([[0.0, -1.5, 0, 10], [1.25, 0, 0, -20], [0, 0, 2.0, 30], [0, 0, 0, 1]])


def nifti(path: Path, *, unit: str | None = "sec", offset: float = 0.0, kind: type = nibabel.Nifti1Image) -> Path:
    image = kind(VALUES.T, AFFINE)
    image.header.set_xyzt_units("mm", unit)
    image.header["pixdim"][4] = STEP_S * {"sec": 1.0, "msec": 1e3, "usec": 1e6}.get(unit or "", 1.0)
    image.header["toffset"] = offset
    nibabel.save(image, path)
    return path


@pytest.mark.parametrize("kind", [nibabel.Nifti1Image, nibabel.Nifti2Image])
@pytest.mark.parametrize("unit", ["sec", "msec", "usec"])
@pytest.mark.parametrize("suffix", [".nii", ".nii.gz"])
def test_nifti(tmp_path: Path, suffix: str, unit: str, kind: type) -> None:
    path = nifti(tmp_path / f"s{suffix}", unit=unit, kind=kind)
    whole = nibabel.load(path).get_fdata().T
    for frame in range(SHAPE[0]):
        for options in ({"frame": frame}, {"trigger_time_ms": 40.0 * frame + 3.0}):
            scan = read_scan(path, **options)
            np.testing.assert_array_equal(scan.values, whole[frame])
            assert scan.acquisition == {"frame": frame, "frame_time_ms": pytest.approx(40.0 * frame, abs=1e-3)}
            ras = np.diag([-1.0, -1.0, 1.0, 1.0]) @ scan.geometry.affine
            np.testing.assert_allclose(ras, AFFINE, atol=1e-5)


def slicer_volume(path: Path) -> Path:
    """As 3D Slicer writes a multi-volume: the list comes first, and each voxel's values lie together."""
    fields = {
        "type": "short",
        "kinds": ["list", "domain", "domain", "domain"],
        "space": "left-posterior-superior",
        "space directions": np.array([[np.nan] * 3, [0, 1.25, 0], [-1.5, 0, 0], [0, 0, 2.0]]),
        "space origin": [10.0, -20, 30],
        "encoding": "gzip",
        "MultiVolume.FrameLabels": ",".join(f"{40 * n}" for n in range(SHAPE[0])),
        "MultiVolume.FrameIdentifyingDICOMTagUnits": "ms",
    }
    nrrd.write(str(path), np.ascontiguousarray(np.moveaxis(VALUES, 0, -1)).T, fields)
    return path


def time_axis(path: Path) -> Path:
    """The times as a last axis with a spacing and its unit."""
    lines = (
        "type: short\ndimension: 4\nsizes: 3 4 5 6\nencoding: raw\nendian: big\nkinds: space space space time\n"
        'spacings: 1.25 1.5 2 0.04\nunits: "mm" "mm" "mm" "s"\n'
    )
    path.write_bytes(f"NRRD0004\n{lines}\n".encode() + VALUES.astype(">i2").tobytes())
    return path


def no_direction(path: Path) -> Path:
    """An axis without direction, of which no kind is stated, in RAS."""
    lines = (
        "type: short\ndimension: 4\nsizes: 3 4 5 6\nencoding: raw\nendian: little\nspace: RAS\n"
        "space directions: (1.25,0,0) (0,1.5,0) (0,0,2) none\nspace origin: (1,2,3)\ndata file: values.raw\n"
    )
    path.write_text(f"NRRD0004\n{lines}\n")
    (path.parent / "values.raw").write_bytes(VALUES.tobytes())
    return path


def itk_volume(path: Path) -> Path:
    image = SimpleITK.GetImageFromArray(VALUES, isVector=False)
    image.SetSpacing((1.25, 1.5, 2.0, 40.0))
    image.SetOrigin((1.0, 2.0, 3.0, 0.0))
    SimpleITK.WriteImage(image, str(path), useCompression=path.suffix == ".mha")
    return path


FILES = {
    "list.nrrd": (slicer_volume, True),
    "time.nrrd": (time_axis, True),
    "none.nhdr": (no_direction, False),
    "itk.nrrd": (itk_volume, False),
    "itk.mha": (itk_volume, False),
    "itk.mhd": (itk_volume, False),
}


@pytest.mark.parametrize("name", FILES)
@pytest.mark.parametrize("is_large", [False, True])
def test_nrrd_and_metaimage(tmp_path: Path, name: str, is_large: bool, monkeypatch) -> None:
    if is_large:
        monkeypatch.setattr(frames, "CHUNK", 50)
    make, has_times = FILES[name]
    path = make(tmp_path / name)
    for frame in range(SHAPE[0]):
        scan = read_scan(path, frame=frame)
        np.testing.assert_array_equal(scan.values, VALUES[frame])
        assert scan.geometry.spacing_mm == pytest.approx((1.25, 1.5, 2.0))
        assert scan.acquisition["frame"] == frame
        if has_times:
            scan = read_scan(path, trigger_time_ms=40.0 * frame)
            np.testing.assert_array_equal(scan.values, VALUES[frame])
            assert scan.acquisition["frame_time_ms"] == pytest.approx(40.0 * frame)
        else:
            with pytest.raises(ScanError, match="does not say when each is"):
                read_scan(path, trigger_time_ms=40.0 * frame)


def test_places_are_those_of_the_3d_file(tmp_path: Path) -> None:
    assert read_scan(no_direction(tmp_path / "a.nhdr"), frame=0).geometry.origin_mm == (-1.0, -2.0, 3.0)
    assert read_scan(itk_volume(tmp_path / "a.mha"), frame=0).geometry.origin_mm == (1.0, 2.0, 3.0)
    slicer = read_scan(slicer_volume(tmp_path / "a.nrrd"), frame=0).geometry
    np.testing.assert_allclose(slicer.affine, [[0, -1.5, 0, 10], [1.25, 0, 0, -20], [0, 0, 2, 30], [0, 0, 0, 1]])
    image = SimpleITK.ReadImage(str(tmp_path / "a.nrrd"))
    np.testing.assert_allclose(image.GetDirection(), slicer.direction_matrix.ravel(), atol=1e-12)
    assert image.GetOrigin() == slicer.origin_mm


@pytest.mark.parametrize("name", ["s.nii.gz", *FILES])
def test_without_a_choice_the_frames_are_listed(tmp_path: Path, name: str, capfd) -> None:
    make, has_times = FILES.get(name, (nifti, True))
    path = make(tmp_path / name)
    times = ", at 0, 40, 80, 120, 160, 200 ms" if has_times else ""
    with pytest.raises(
        ScanError, match=rf"4-D and holds 6 volumes \(frames 0 to 5{times}\): choose one with --frame N"
    ):
        read_scan(path)
    with pytest.raises(ScanError, match="there is no frame 6, they are 0 to 5"):
        read_scan(path, frame=6)
    with pytest.raises(ScanError, match="both a frame and a time"):
        read_scan(path, frame=0, trigger_time_ms=0.0)
    with pytest.raises(MarkerError):
        read_labels(path)
    assert main(["info", str(path)]) == 1
    assert "frames 0 to 5" in capfd.readouterr().err


def test_zero_is_a_choice_on_the_command_line_and_in_a_recipe(tmp_path: Path) -> None:
    path = nifti(tmp_path / "s.nii.gz")
    for option, key in (("--frame", "frame"), ("--trigger-time", "trigger_time_ms")):
        recipe = tmp_path / f"{key}.toml"
        result = CliRunner().invoke(cli, ["new", str(path), "--out", str(recipe), option, "0"])
        assert result.exit_code == 0, result.output
        source = load_recipe(recipe).scan
        assert source.choice == {key: 0}
        np.testing.assert_array_equal(read_scan(tmp_path / source.path, **source.choice).values, VALUES[0])
    with pytest.raises(Exception, match="frame"):
        parse_recipe((tmp_path / "frame.toml").read_text().replace("frame = 0", "frame = -1"))


def test_what_chooses_nothing_is_refused(tmp_path: Path) -> None:
    write(tmp_path / "dicom")
    with pytest.raises(ScanError, match="a frame number chooses in NIfTI"):
        read_scan(tmp_path / "dicom", frame=0)
    image = nibabel.Nifti1Image(VALUES[0].T, AFFINE)
    nibabel.save(image, tmp_path / "one.nii")
    np.testing.assert_array_equal(read_scan(tmp_path / "one.nii", frame=0).values, VALUES[0])
    with pytest.raises(ScanError, match="holds one volume"):
        read_scan(tmp_path / "one.nii", frame=1)
    five = nibabel.Nifti1Image(np.zeros((3, 4, 5, 2, 2), np.int16), AFFINE)
    nibabel.save(five, tmp_path / "five.nii")
    with pytest.raises(ScanError, match="5-D and holds 4 volumes"):
        read_scan(tmp_path / "five.nii", frame=0)
    with pytest.raises(ScanError, match="does not say when each is"):
        read_scan(nifti(tmp_path / "no_unit.nii", unit=None), trigger_time_ms=0.0)


def test_times_start_where_the_header_says(tmp_path: Path) -> None:
    scan = read_scan(nifti(tmp_path / "s.nii", offset=0.1), trigger_time_ms=141.0)
    np.testing.assert_array_equal(scan.values, VALUES[1])
    assert scan.acquisition["frame_time_ms"] == pytest.approx(140.0)
    with pytest.raises(ScanError, match="no trigger time is near 0 ms, they are 100, 140"):
        read_scan(tmp_path / "s.nii", trigger_time_ms=0.0)


@pytest.mark.parametrize("name", ["s.nii", "s.nii.gz", *FILES])
@pytest.mark.parametrize("frame", [0, 5])
def test_a_file_cut_short_is_refused_whichever_frame_is_wanted(tmp_path: Path, name: str, frame: int) -> None:
    make, _ = FILES.get(name, (nifti, True))
    path = make(tmp_path / name)
    data = {".nhdr": tmp_path / "values.raw", ".mhd": tmp_path / "itk.raw"}.get(path.suffix, path)
    data.write_bytes(data.read_bytes()[:-9])
    with pytest.raises(ScanError, match="cut short"):
        read_scan(path, frame=frame)


@pytest.mark.parametrize("name", ["s.nii", "s.nii.gz", "list.nrrd", "time.nrrd", "itk.mha"])
def test_a_file_damaged_anywhere_never_crashes(tmp_path: Path, name: str) -> None:
    make, _ = FILES.get(name, (nifti, True))
    path = make(tmp_path / name)
    content = path.read_bytes()
    for place in range(0, len(content), 7):
        damaged = bytearray(content)
        damaged[place] ^= 0xFF
        path.write_bytes(bytes(damaged))
        for frame in (0, 5):
            with contextlib.suppress(ScanError):
                assert read_scan(path, frame=frame).values.ndim == 3


def test_a_checksum_is_compared(tmp_path: Path) -> None:
    path = nifti(tmp_path / "s.nii.gz")
    content = bytearray(gzip.compress(gzip.decompress(path.read_bytes())))
    content[-6] ^= 0xFF
    path.write_bytes(bytes(content))
    with pytest.raises(ScanError, match="damaged"):
        read_scan(path, frame=0)
