"""The zip for Windows, by what can be seen without Windows: a small stand-in for all that is in it."""

import base64
import hashlib
import zipfile

import pytest
from packaging.requirements import Requirement

from installers.windows.completeness import PATH_LENGTH_MAX, problems_of
from installers.windows.make_zip import FOLDER, add_python, main, write_zip

WANTED = Requirement("heartcase[studio]")


def distribution(packages, name, version, files, requires=(), extras=()):
    """Installed as pip would: the files, and what is stated of them."""
    for path, text in files.items():
        target = packages / path
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_text(text)
    folder = packages / f"{name}-{version}.dist-info"
    folder.mkdir()
    lines = [f"Name: {name}", f"Version: {version}", *(f"Provides-Extra: {one}" for one in extras)]
    lines += [f"Requires-Dist: {one}" for one in requires]
    (folder / "METADATA").write_text("Metadata-Version: 2.1\n" + "\n".join(lines) + "\n")
    rows = []
    for path, text in files.items():
        digest = base64.urlsafe_b64encode(hashlib.sha256(text.encode()).digest()).rstrip(b"=").decode()
        rows.append(f"{path},sha256={digest},{len(text)}")
    (folder / "RECORD").write_text("\n".join([*rows, f"{folder.name}/RECORD,,"]) + "\n")


@pytest.fixture
def packages(tmp_path):
    folder = tmp_path / "packages"
    files = {
        "heartcase/__init__.py": "import json\nimport webby\n",
        "heartcase/one.py": "from heartcase.two import x\n\ndef late():\n    import optional\n",
        "heartcase/two.py": "x = 1\n",
    }
    requires = ["webby>=2; extra == 'studio'", "other>=1; sys_platform == 'linux'", "winonly; sys_platform == 'win32'"]
    distribution(folder, "heartcase", "0.1.0", files, requires, ["studio"])
    distribution(folder, "webby", "2.1", {"webby/__init__.py": "", "webby/fast.cp312-win_amd64.pyd": "MZ"})
    distribution(folder, "winonly", "1.0", {"winonly.py": ""})
    return folder


def found(packages):
    return problems_of(packages, python_version="3.12", wanted=WANTED)


def test_what_is_whole_has_no_problems(packages):
    assert found(packages) == []


def test_what_only_windows_needs_is_missed(packages):
    for path in packages.glob("winonly*"):
        if path.is_dir():
            for file in path.iterdir():
                file.unlink()
            path.rmdir()
        else:
            path.unlink()
    assert found(packages) == ["winonly is missing: heartcase needs it"]


def test_what_the_extra_needs_in_its_version(packages):
    metadata = packages / "webby-2.1.dist-info" / "METADATA"
    metadata.write_text(metadata.read_text().replace("2.1", "1.9"))
    assert "webby is 1.9: heartcase needs >=2" in found(packages)


def test_a_file_that_is_lost_or_changed(packages):
    (packages / "heartcase" / "two.py").write_text("x = 2\n")
    (packages / "webby" / "fast.cp312-win_amd64.pyd").unlink()
    assert found(packages) == [
        "heartcase/two.py of heartcase is not the file that its list states",
        "webby/fast.cp312-win_amd64.pyd of webby is missing",
    ]


@pytest.mark.parametrize("name", ["webby/slow.so", "webby/slow.cp311-win_amd64.pyd", "webby/slow.cp312-win32.pyd"])
def test_modules_of_another_system_or_python(packages, name):
    (packages / name).write_text("")
    (problem,) = found(packages)
    assert name in problem
    assert "compiled for another" in problem


def test_modules_of_any_python_are_taken(packages):
    (packages / "webby" / "stable.abi3.pyd").write_text("")
    (packages / "webby" / "plain.pyd").write_text("")
    assert found(packages) == []


def test_imports_that_lead_nowhere(packages):
    (packages / "heartcase" / "three.py").write_text("import gone\nfrom heartcase.four import y\n")
    assert found(packages) == [
        "heartcase/three.py imports gone, which is not there",
        "heartcase/three.py imports heartcase.four, which is not there",
    ]


def test_names_that_windows_cannot_keep_apart_or_hold(packages):
    (packages / "webby" / "A.txt").write_text("")
    (packages / "webby" / "a.txt").write_text("")
    (packages / "webby" / ("n" * PATH_LENGTH_MAX)).write_text("")
    problems = found(packages)
    assert len(problems) == 2
    assert "one file on Windows" in problems[0]
    assert "longer than" in problems[1]


def an_embeddable_python(path):
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("python.exe", b"MZ")
        archive.writestr("python312._pth", "python312.zip\n.\n#import site\n")
    return path


def test_python_finds_the_packages(tmp_path):
    folder = tmp_path / FOLDER
    assert add_python(an_embeddable_python(tmp_path / "python.zip"), folder) == "3.12"
    assert (folder / "python" / "python312._pth").read_text().splitlines() == [
        "python312.zip",
        ".",
        "..\\packages",
        "import site",
    ]


def test_something_else_than_an_embeddable_python(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("shutil.which", lambda name: name)
    path = tmp_path / "other.zip"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("readme.txt", "")
    assert main(["--python", str(path), "--to", str(tmp_path / "out.zip")]) == 1
    assert "is no embeddable Python" in capsys.readouterr().err
    assert main(["--python", str(tmp_path / "none.zip")]) == 1
    assert "there is no such file" in capsys.readouterr().err
    assert not (tmp_path / "out.zip").exists()


def test_the_zip_is_the_same_for_the_same_files(tmp_path):
    folder = tmp_path / "folder"
    (folder / "a").mkdir(parents=True)
    (folder / "a" / "one.txt").write_text("1")
    (folder / "two.bat").write_text("2")
    write_zip(folder, tmp_path / "first.zip")
    (folder / "two.bat").touch()
    write_zip(folder, tmp_path / "second.zip")
    assert (tmp_path / "first.zip").read_bytes() == (tmp_path / "second.zip").read_bytes()
    with zipfile.ZipFile(tmp_path / "first.zip") as archive:
        assert archive.namelist() == [f"{FOLDER}/a/one.txt", f"{FOLDER}/two.bat"]
    assert not list(tmp_path.glob("*.unfinished"))
