from __future__ import annotations

import hashlib
import subprocess
import sys
import zlib
from pathlib import Path

import numpy as np
import pydicom
import pytest
from click.testing import CliRunner
from hypothesis import given, settings
from hypothesis import strategies as st
from pydicom import uid

from heartcase.cli.main import cli
from heartcase.pipeline.formats.dicom import file_meta
from heartcase.pipeline.formats.dicom.headers import ImageSeries
from heartcase.pipeline.formats.dicom.phases import stack_groups
from heartcase.pipeline.formats.dicom.stack import Slice
from heartcase.pipeline.formats.read_scan import list_series, read_scan
from heartcase.schemas.errors import ScanError
from heartcase.schemas.recipe.recipe import load_recipe
from tests.pipeline.formats import dicom_situations_read
from tests.pipeline.formats.dicom_series import items
from tests.pipeline.formats.dicom_situations import STORED, outcome_of, write
from tests.pipeline.formats.dicom_situations_doubtful import uneven_cine
from tests.pipeline.formats.dicom_situations_read import POSITIONS, enhanced, lossless_jpeg
from tests.pipeline.formats.dicom_situations_stacks import cine, localizers, phase, tilted


def image(k: int, name: str, **traits: float | str) -> Slice:
    return Slice(
        Path(name), None, (8, 8), True, (0.0, 0.0, 3.0 * k), (1, 0, 0, 0, 1, 0), (1.0, 1.0), 1.0, 0.0, traits=traits
    )


@settings(max_examples=60, deadline=None)
@given(data=st.data(), phases=st.integers(2, 6), slices=st.integers(2, 6), echoes=st.integers(1, 3))
def test_phases_and_echoes_are_found_whatever_the_order(data, phases, slices, echoes) -> None:
    """Each heartbeat is as long as it likes: the n-th time of a position is phase n, of each echo."""
    beats = data.draw(st.lists(st.floats(400.0, 1500.0), min_size=slices, max_size=slices))
    images = [
        image(k, f"{k} {n} {e}", trigger_time_ms=beats[k] * n / phases, echo_time_ms=1.0 + 2.0 * e)
        for k in range(slices)
        for n in range(phases)
        for e in range(echoes)
    ]
    (group,) = stack_groups(ImageSeries("1", "MR", tuple(data.draw(st.permutations(images)))))
    assert len(group.stacks) == phases * echoes
    for number, stack in enumerate(group.stacks):
        e, n = divmod(number, phases)
        assert {str(one.path) for one in stack.slices} == {f"{k} {n} {e}" for k in range(slices)}
        assert stack.trigger_time_ms == pytest.approx(np.median(beats) * n / phases)
        assert stack.echo_time_ms == (1.0 + 2.0 * e)
    assert not group.left_out


def test_an_image_missing_from_one_phase_leaves_the_others_whole() -> None:
    images = [image(k, f"{k} {n}", trigger_time_ms=40.0 * n + k) for k in range(5) for n in range(4)]
    lost = next(one for one in images if str(one.path) == "2 1")
    images.remove(lost)
    (group,) = stack_groups(ImageSeries("1", "MR", tuple(images)))
    assert [len(stack.slices) for stack in group.stacks] == [5, 4, 5, 5]
    for n, stack in enumerate(group.stacks):
        assert {str(one.path).split()[1] for one in stack.slices} == {str(n)}


def test_only_times_that_every_position_has_are_listed(tmp_path: Path) -> None:
    uneven_cine(tmp_path, (20, 20, 20, 2))
    (info,) = list_series(tmp_path)
    assert info.trigger_times_ms == (0.0, 463.0)
    assert info.has_choice
    assert "2 cardiac phases at 0 to 463 ms at every slice position and 18 at some of them" in info.description
    with pytest.raises(ScanError, match=r"2 cardiac phases \(trigger times 0, 463 ms\), and 18 that some slice"):
        read_scan(tmp_path)


def test_a_position_without_an_image_near_the_time_is_told_or_filled(tmp_path: Path) -> None:
    """Where it lies between others it may be filled; at an end nothing but this tells of it."""
    uneven_cine(tmp_path / "middle", (20, 20, 20, 20, 2, 20, 20, 20, 20))
    with pytest.raises(ScanError, match=r"1 of 9 .* near 92\.6 ms: slice 5 .*or have them filled .*--interpolate"):
        read_scan(tmp_path / "middle", trigger_time_ms=92.6)
    scan = read_scan(tmp_path / "middle", trigger_time_ms=92.6, interpolate_missing=True)
    assert scan.geometry.size[2] == 9
    assert any("slice 5 was missing" in warning.text for warning in scan.warnings)
    uneven_cine(tmp_path / "end", (2, 20, 20, 20, 20, 20, 20, 20, 20))
    with pytest.raises(ScanError, match="slice 1 "):
        read_scan(tmp_path / "end", trigger_time_ms=92.6, interpolate_missing=True)


@settings(max_examples=40, deadline=None)
@given(data=st.data(), slices=st.integers(3, 7), phases=st.integers(3, 12))
def test_each_position_gives_the_image_nearest_in_time(data, slices: int, phases: int) -> None:
    """Against a plain search: usual positions give phase n, the others their nearest image, or none that is near."""
    counts = [phases] * slices
    odd = data.draw(st.integers(0, slices - 1))
    counts[odd] = data.draw(st.integers(1, 2 * phases).filter(lambda n: n != phases))
    images = [
        image(k, f"{k} {n}", trigger_time_ms=round(900.0 * n / count, 3))
        for k, count in enumerate(counts)
        for n in range(count)
    ]
    (group,) = stack_groups(ImageSeries("1", "MR", tuple(data.draw(st.permutations(images)))))
    times = np.array([round(900.0 * n / phases, 3) for n in range(phases)])
    there = np.array([round(900.0 * n / counts[odd], 3) for n in range(counts[odd])])
    assert [stack.trigger_time_ms for stack in group.stacks] == pytest.approx(times.tolist())
    step = float(np.median(np.diff(times)))
    for n, stack in enumerate(group.stacks):
        of_odd = [str(one.path) for one in stack.slices if str(one.path).startswith(f"{odd} ")]
        mine = [m for m, time in enumerate(there) if np.abs(times - time).argmin() == n]
        near = [m for m in mine if abs(there[m] - times[n]) <= max(50.0, step / 2.0)]
        best = min(near, key=lambda m: abs(there[m] - times[n]), default=None)
        assert of_odd == ([] if best is None else [f"{odd} {best}"])
        assert [lack.number for lack in stack.lacks] == ([odd + 1] if best is None else [])


def test_an_image_taken_again_is_not_a_stack_of_its_own() -> None:
    """Acquisition numbers count slices here, so they tell nothing apart; which of the two is right is not guessed."""
    images = [image(k, str(k), acquisition_number=float(k)) for k in range(6)]
    images.append(image(3, "again", acquisition_number=6.0))
    (group,) = stack_groups(ImageSeries("1", "MR", tuple(images)))
    assert group.image_count == 7


def test_two_acquisitions_between_each_other_are_two_stacks() -> None:
    images = [image(k, f"a{k}", acquisition_number=1.0) for k in range(5)]
    images += [image(k, f"b{k}", acquisition_number=2.0) for k in np.arange(5) + 0.3]
    groups = stack_groups(ImageSeries("1", "CT", tuple(images)))
    assert [{str(one.path)[0] for one in group.stacks[0].slices} for group in groups] == [{"a"}, {"b"}]
    assert [group.kind for group in groups] == ["acquisition 1", "acquisition 2"]


def test_what_is_listed(tmp_path: Path) -> None:
    cine(tmp_path / "a", ImageType=["ORIGINAL", "PRIMARY", "M"])
    localizers(tmp_path / "b", ImageType=["ORIGINAL", "PRIMARY", "LOCALIZER"])
    listed = list_series(tmp_path)
    assert [info.slice_count for info in listed] == [45, 3, 3, 3]
    assert listed[0].trigger_times_ms == (10.0, 50.0, 90.0, 130.0, 170.0)
    assert listed[0].has_choice
    assert "5 cardiac phases at 10 to 170 ms" in listed[0].description
    assert all("localiser" in info.description for info in listed[1:])
    with pytest.raises(ScanError, match=r"--trigger-time MS"):
        read_scan(tmp_path)
    np.testing.assert_array_equal(read_scan(tmp_path, trigger_time_ms=110.0).values, phase(2))
    np.testing.assert_array_equal(read_scan(tmp_path, trigger_time_ms=190.0, series="1").values, phase(4))
    with pytest.raises(ScanError, match="no trigger time is near 10000 ms"):
        read_scan(tmp_path, trigger_time_ms=1e4, series="1")
    with pytest.raises(ScanError, match="the given --series holds several stacks"):
        read_scan(tmp_path, series=listed[1].uid_code.partition("-")[0])
    assert len({info.uid_code for info in listed}) == 4
    assert read_scan(tmp_path, series=listed[2].uid_code).geometry == read_scan(tmp_path, series="3").geometry
    assert read_scan(tmp_path, series="3").geometry.size == (40, 40, 3)


def test_phases_in_series_of_other_places_are_not_mixed(tmp_path: Path) -> None:
    write(tmp_path / "a", series=1, TriggerTime=100.0)
    write(tmp_path / "b", series=2, TriggerTime=200.0, positions=POSITIONS + 5.0)
    with pytest.raises(ScanError, match="several series"):
        read_scan(tmp_path, trigger_time_ms=190.0)


def test_the_recipe_of_new_reads_the_same_scan(tmp_path: Path) -> None:
    tilted(tmp_path / "scan", gone=(4,))
    options = ["--straighten-tilt", "--interpolate-missing"]
    recipe = tmp_path / "case.toml"
    missing = CliRunner().invoke(cli, ["new", str(tmp_path / "scan"), "--out", str(recipe), options[0]])
    assert isinstance(missing.exception, ScanError)
    assert not recipe.exists()
    result = CliRunner().invoke(cli, ["new", str(tmp_path / "scan"), "--out", str(recipe), *options])
    assert result.exit_code == 0, result.output
    source = load_recipe(recipe).scan
    assert source.choice == {"straighten_tilt": True, "interpolate_missing": True}
    scan = read_scan(tmp_path / source.path, **source.choice)
    assert len(scan.warnings) == 2
    assert scan.geometry.size[2] == len(STORED)


def test_a_file_that_is_not_dicom_has_no_times(tmp_path: Path) -> None:
    import SimpleITK

    SimpleITK.WriteImage(SimpleITK.GetImageFromArray(STORED), str(tmp_path / "s.nii.gz"))
    assert read_scan(tmp_path / "s.nii.gz", straighten_tilt=True, interpolate_missing=True).warnings == ()
    with pytest.raises(ScanError, match="holds one volume"):
        read_scan(tmp_path / "s.nii.gz", trigger_time_ms=1.0)


def test_a_deflated_file_does_not_fill_the_memory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (path, *_) = write(
        tmp_path, each=lambda d, i: setattr(d.file_meta, "TransferSyntaxUID", uid.DeflatedExplicitVRLittleEndian)
    )
    content = path.read_bytes()
    meta = pydicom.filereader.read_file_meta_info(path)
    start = 144 + meta.FileMetaInformationGroupLength
    body = zlib.decompress(content[start:], -15)
    packer = zlib.compressobj(wbits=-15)
    path.write_bytes(content[:start] + packer.compress(body + bytes(10_000_000)) + packer.flush())
    monkeypatch.setattr(file_meta, "INFLATED_LIMIT", 5_000_000)
    assert path.stat().st_size < 50_000
    with pytest.raises(ScanError, match="1 DICOM file is cut short or damaged"):
        read_scan(tmp_path)


def test_a_date_in_a_number_is_not_shown(tmp_path: Path) -> None:
    """A date of birth in a tag that holds a number is out of its range, so it tells nothing apart either."""
    names = ("AcquisitionNumber", "TemporalPositionIdentifier", "TriggerTime", "EchoTime", "KVP", "InversionTime")
    write(tmp_path, DiffusionBValue=19770203.0, **dict.fromkeys(names, 19770203))
    write(tmp_path, first_instance=100, DiffusionBValue=19770204.0, **dict.fromkeys(names, 19770204))
    with pytest.raises(ScanError, match="nothing in the headers tells them apart") as caught:
        read_scan(tmp_path)
    assert "1977" not in str(caught.value) + repr(list_series(tmp_path))


@pytest.mark.slow
def test_no_decoder_beyond_the_plain_install_is_needed(tmp_path: Path) -> None:
    """With the encoders of the tests out of reach all compressed series are read as before."""
    wanted = [s for s in dicom_situations_read.SITUATIONS if "JPEG" in s.name or "RLE" in s.name]
    assert len(wanted) > 12
    script = ["import sys", "sys.modules |= dict.fromkeys(('pylibjpeg', 'openjpeg', 'libjpeg', 'rle'))"]
    script += ["import hashlib", "from heartcase.pipeline.formats.read_scan import read_scan"]
    script += ["for path in sys.argv[1:]: print(hashlib.sha256(read_scan(path).values.tobytes()).hexdigest())"]
    folders, hashes = [], []
    for number, situation in enumerate(wanted):
        (tmp_path / str(number)).mkdir()
        outcome = outcome_of(situation, tmp_path / str(number))
        assert outcome.scan is not None
        hashes.append(hashlib.sha256(outcome.scan.values.tobytes()).hexdigest())
        folders.append(str(next((tmp_path / str(number)).iterdir())))
    run = subprocess.run(
        [sys.executable, "-c", "\n".join(script), *folders], capture_output=True, text=True, check=False
    )
    assert run.stdout.split() == hashes, run.stderr


@pytest.mark.slow
@pytest.mark.parametrize("modality", ["MR", "CT"])
def test_the_phantom_through_dicom(tmp_path: Path, modality: str) -> None:
    """A synthetic scan of the heart, oblique and with thick slices, comes back as it was written."""
    from heartcase.phantom.anatomy.heart import HeartPhantom
    from heartcase.phantom.scan.acquisition import acquire_ct, acquire_mri

    phantom = HeartPhantom.child()
    geometry = phantom.scan_geometry((3.0, 4.0, 8.0), oblique=True)
    scan = (acquire_mri if modality == "MR" else acquire_ct)(phantom, geometry, supersampling=1)
    intercept = 0.0 if modality == "MR" else -1024.0
    stored = np.round(scan.values - intercept).astype(np.uint16)
    write(tmp_path, stored, geometry, modality=modality, intercept=intercept)
    read = read_scan(tmp_path)
    np.testing.assert_array_equal(read.values, stored + intercept)
    np.testing.assert_allclose(read.geometry.affine, geometry.affine, atol=1e-6)
    assert np.abs(read.values - scan.values).max() <= 0.5001


@pytest.mark.parametrize("is_compressed", [False, True])
def test_a_multi_frame_file_damaged_anywhere_never_crashes(tmp_path: Path, is_compressed: bool) -> None:
    def frames(frame, number: int) -> None:
        frame.CardiacSynchronizationSequence = items(NominalCardiacTriggerDelayTime=float(number // 3))

    small = STORED[:3, :8, :8]
    enhanced(
        tmp_path,
        np.concatenate([small, small]),
        np.concatenate([POSITIONS[:3]] * 2),
        frames=frames,
        whole=lossless_jpeg if is_compressed else None,
    )
    path = tmp_path / "one.dcm"
    content = path.read_bytes()
    outcomes = set()
    for place in range(132, len(content), 29):
        damaged = bytearray(content)
        damaged[place] ^= 0xFF
        path.write_bytes(bytes(damaged))
        try:
            outcomes.add(read_scan(tmp_path, trigger_time_ms=1.0).values.shape)
        except ScanError:
            outcomes.add("refused")
    assert "refused" in outcomes
    assert (3, 8, 8) in outcomes


def test_phases_that_are_series_of_their_own_look_different_in_the_list(tmp_path: Path) -> None:
    """Rows that differ in number and code alone tell nobody which to take; a trigger time chooses as well."""
    for number, time in enumerate((50.0, 350.0, 650.0)):
        write(tmp_path / str(number), phase(number), series=301 + number, TriggerTime=time)
    listed = list_series(tmp_path)
    assert [info.trigger_times_ms for info in listed] == [(50.0,), (350.0,), (650.0,)]
    assert [info.scanner_number for info in listed] == [301, 302, 303]
    assert all(info.is_phase for info in listed)
    done = CliRunner().invoke(cli, ["info", str(tmp_path)])
    assert done.exit_code == 0
    assert "--series, or with --trigger-time MS alone" in done.output
    for number, time in enumerate((50, 350, 650)):
        assert f"trigger time {time} ms, series {301 + number} on the scanner" in done.output
    with pytest.raises(
        ScanError, match=r"--series NUMBER or --trigger-time MS, or series or trigger_time_ms in"
    ) as told:
        read_scan(tmp_path)
    assert "trigger time 350 ms" in str(told.value)
    np.testing.assert_array_equal(read_scan(tmp_path, trigger_time_ms=350.0).values, phase(1))


def test_a_series_number_that_may_be_a_patients_is_not_shown(tmp_path: Path) -> None:
    for number in range(2):
        write(tmp_path / str(number), phase(number), series=1 + number, SeriesNumber=19770203 + number)
    listed = list_series(tmp_path)
    assert [info.scanner_number for info in listed] == [None, None]
    assert not any("1977" in info.description or info.is_phase for info in listed)
