"""A zipped DICOM folder is read as the folder is; what is unsafe or without bounds is refused in a line."""

from __future__ import annotations

import shutil
import stat
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from heartcase.cli.main import cli, main
from heartcase.pipeline.formats.dicom import archive as dicom_archive
from heartcase.pipeline.formats.dicom_identity import identity_of
from heartcase.pipeline.formats.read_scan import list_series, read_labels, read_scan
from heartcase.schemas.errors import HeartcaseError, ScanError
from heartcase.schemas.recipe.recipe import load_recipe
from tests.pipeline.formats.dicom_situations import PLANTED, STORED, write
from tests.pipeline.formats.dicom_situations_stacks import cine, phase


def zipped(folder: Path, name: str = "portal.zip") -> Path:
    archive = folder.parent / name
    shutil.make_archive(str(archive.with_suffix("")), "zip", folder)
    return archive


def test_a_zipped_folder_is_the_folder(tmp_path: Path) -> None:
    cine(tmp_path / "scan" / PLANTED / "a")
    write(tmp_path / "scan" / "b", series=2, first_instance=900)
    archive = zipped(tmp_path / "scan")
    assert list_series(archive) == list_series(tmp_path / "scan")
    for options in ({"series": "1", "trigger_time_ms": 90.0}, {"series": "2"}):
        scans = [read_scan(path, **options) for path in (tmp_path / "scan", archive)]
        assert scans[0].values_sha256 == scans[1].values_sha256
        assert scans[0].geometry == scans[1].geometry
        assert scans[0].acquisition == scans[1].acquisition
    np.testing.assert_array_equal(read_scan(archive, series="1", trigger_time_ms=90.0).values, phase(2))
    assert sorted(tmp_path.iterdir()) == sorted([tmp_path / "scan", archive])
    identity = identity_of(archive, series="2")
    assert identity["patient_name"] == f"{PLANTED}^Anna"


def test_copies_are_the_same_in_an_archive(tmp_path: Path) -> None:
    """Which of two copies counts depends on the order of the files."""
    for name in ("b", "a"):
        write(tmp_path / "scan" / name)
    shutil.copy(tmp_path / "scan" / "a" / "s1_0003", tmp_path / "scan" / "z")
    archive = zipped(tmp_path / "scan")
    files = [file.name for file in dicom_archive.archived_files(archive)]
    walked = sorted(tmp_path.joinpath("scan").rglob("s1_*"))
    assert files == ["z", *(str(path.relative_to(tmp_path / "scan")) for path in walked)]
    assert read_scan(archive).values_sha256 == read_scan(tmp_path / "scan").values_sha256


@pytest.mark.parametrize("command", ["info", "new", "preview", "filter"])
def test_commands_take_an_archive(tmp_path: Path, command: str) -> None:
    write(tmp_path / "scan")
    archive = zipped(tmp_path / "scan")
    arguments = {
        "info": [],
        "new": ["--out", str(tmp_path / "case.toml")],
        "preview": ["--out", str(tmp_path / "p.png")],
        "filter": [str(tmp_path / "f.nrrd")],
    }[command]
    result = CliRunner().invoke(cli, [command, str(archive), *arguments])
    assert result.exit_code == 0, result.output
    if command == "new":
        recipe = load_recipe(tmp_path / "case.toml")
        assert recipe.scan.path == "portal.zip"
        assert CliRunner().invoke(cli, ["info", str(tmp_path / "case.toml")]).exit_code == 0


def test_a_recipe_is_not_an_archive(tmp_path: Path) -> None:
    write(tmp_path / "scan")
    with pytest.raises(HeartcaseError, match="looks like a scan, not a recipe"):
        load_recipe(zipped(tmp_path / "scan"))
    with pytest.raises(HeartcaseError, match="zip archive: unpack it"):
        read_labels(tmp_path / "portal.zip")


def _link(path: Path) -> None:
    with zipfile.ZipFile(path, "a") as archive:
        entry = zipfile.ZipInfo("link")
        entry.external_attr = (stat.S_IFLNK | 0o777) << 16
        archive.writestr(entry, "/etc/passwd")


def _named(*names: str) -> Callable[[Path], None]:
    def change(path: Path) -> None:
        with zipfile.ZipFile(path, "a") as archive:
            for name in names:
                archive.writestr(name, b"x" * 200)

    return change


def _encrypted(path: Path) -> None:
    content = bytearray(path.read_bytes())
    for mark, flags in ((b"PK\x03\x04", 6), (b"PK\x01\x02", 8)):
        content[content.index(mark) + flags] |= 1
    path.write_bytes(bytes(content))


def _bomb(path: Path) -> None:
    with zipfile.ZipFile(path, "a", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("zeros", bytes(60_000_000))


def _cut(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-500])


def _foreign_method(path: Path) -> None:
    content = bytearray(path.read_bytes())
    for mark, method in ((b"PK\x03\x04", 8), (b"PK\x01\x02", 10)):
        content[content.index(mark) + method] = 97
    path.write_bytes(bytes(content))


UNSAFE = {
    "link": (_link, "links, names that lead out"),
    "parent": (_named("../outside.dcm"), "links, names that lead out"),
    "absolute": (_named("/etc/outside.dcm"), "links, names that lead out"),
    "windows": (_named("C:\\outside.dcm"), "links, names that lead out"),
    "twice": (_named("a\\b", "a/b"), "two files of one name"),
    "encrypted": (_encrypted, "encrypted: unpack it with its password"),
    "bomb": (_bomb, "far more than a scan needs"),
    "cut short": (_cut, "archive is cut short or damaged"),
    "foreign method": (_foreign_method, "packed in a way that is not read"),
}


@pytest.mark.parametrize("name", UNSAFE)
def test_what_is_unsafe_is_refused_in_a_line(tmp_path: Path, name: str, monkeypatch, capfd) -> None:
    monkeypatch.setattr(dicom_archive, "RATIO_FREE_BYTES", 10_000_000)
    change, words = UNSAFE[name]
    write(tmp_path / "scan")
    archive = zipped(tmp_path / "scan", f"{PLANTED}.zip")
    change(archive)
    before = sorted(tmp_path.rglob("*"))
    with pytest.raises(ScanError, match=words) as caught:
        read_scan(archive)
    assert len(caught.value.problems) == 1
    assert main(["info", str(archive)]) == 1
    out, err = capfd.readouterr()
    for text in (str(caught.value), out, err):
        assert PLANTED not in text
        assert "outside" not in text
    assert sorted(tmp_path.rglob("*")) == before


def test_too_many_files_are_refused(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setattr(dicom_archive, "FILE_LIMIT", 8)
    write(tmp_path / "scan")
    with pytest.raises(ScanError, match="more than 8 files in this archive"):
        read_scan(zipped(tmp_path / "scan"))


def test_an_archive_damaged_anywhere_never_crashes(tmp_path: Path) -> None:
    write(tmp_path / "scan", STORED[:, :6, :6])
    archive = zipped(tmp_path / "scan")
    content = archive.read_bytes()
    whole = read_scan(archive).values
    outcomes = set()
    for place in range(0, len(content), 41):
        damaged = bytearray(content)
        damaged[place] ^= 0xFF
        archive.write_bytes(bytes(damaged))
        try:
            scan = read_scan(archive)
        except ScanError:
            outcomes.add("refused")
        else:
            np.testing.assert_array_equal(scan.values, whole)
            outcomes.add("read")
    assert outcomes == {"refused", "read"}


def test_what_macos_puts_into_archives_is_passed_over(tmp_path: Path) -> None:
    write(tmp_path / "scan")
    archive = zipped(tmp_path / "scan")
    with zipfile.ZipFile(archive, "a") as more:
        more.writestr("__MACOSX/._s1_0001.dcm", b"\x00\x05\x16\x07" + bytes(200))
    np.testing.assert_array_equal(read_scan(archive).values, STORED)


def test_an_archive_without_images(tmp_path: Path) -> None:
    (tmp_path / "notes").mkdir()
    (tmp_path / "notes" / "a.txt").write_text("nothing")
    with pytest.raises(ScanError, match="there is no DICOM image here"):
        read_scan(zipped(tmp_path / "notes"))
