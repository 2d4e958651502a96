"""Makes the zip that starts the studio on Windows by a double click.

::

    python -m installers.windows.make_zip --python python-3.12.10-embed-amd64.zip --to heartcase-studio.zip

Runs on any system with ``uv``. The Python is the *embeddable package* of python.org, which needs no installation; its
SHA-256 is printed, to be compared with the one that python.org states. What is in the zip::

    heartcase-studio/
        heartcase studio.bat     a double click starts the studio
        read me.txt
        python/                  the embeddable package
        packages/                heartcase with all that it needs, for Windows

A folder that is unpacked anywhere a user may write runs; nothing is registered, and deleting the folder removes it.
"""

from __future__ import annotations

import argparse
import hashlib
import re
import shutil
import subprocess
import sys
import tempfile
import zipfile
from collections.abc import Sequence
from pathlib import Path

from packaging.requirements import Requirement

from installers.windows.completeness import problems_of

__all__ = ["FOLDER", "START", "add_python", "main", "write_zip"]

FOLDER = "heartcase-studio"
ROOT = Path(__file__).parents[2]
START = """\
@echo off
setlocal
title heartcase studio
set "HERE=%~dp0"
set "NUMBA_CACHE_DIR=%LOCALAPPDATA%\\heartcase\\numba-cache"
cd /d "%USERPROFILE%"
if not "%~1"=="" cd /d "%~dp1"
"%HERE%python\\python.exe" -m heartcase studio %*
if errorlevel 1 pause
"""
"""Starts the studio; a scan, recipe or case that is dropped on it is opened. Compiled code goes to the user."""
READ_ME = """\
heartcase studio

Double-click "heartcase studio.bat". Your browser opens the studio. Close the black window to end it.
The first start compiles for some minutes; the page says how far it is.
You need no administrator rights, and nothing is installed: delete this folder to remove it.
What was compiled lies in %LOCALAPPDATA%\\heartcase and may be deleted too.

Not a medical device. For teaching, research and planning beside approved means only.
"""
_DATE = (1980, 1, 1, 0, 0, 0)
"""Of every file in the zip, so that the same files make the same zip."""


def add_python(archive: Path, folder: Path) -> str:
    """Unpack an embeddable Python into ``folder/python`` and let it find ``folder/packages``; its version, as ``3.12``.

    Raises
    ------
    ValueError
        The archive is no embeddable Python for 64-bit Windows.
    """
    with zipfile.ZipFile(archive) as opened:
        names = opened.namelist()
        settings = [name for name in names if re.fullmatch(r"python3\d+\._pth", name)]
        if len(settings) != 1 or "python.exe" not in names:
            raise ValueError(
                f"{archive.name} is no embeddable Python: it must hold python.exe and one python3XY._pth; take "
                "python-3.X.Y-embed-amd64.zip of python.org"
            )
        opened.extractall(folder / "python")
    stem = settings[0].removesuffix("._pth")
    (folder / "python" / settings[0]).write_text(f"{stem}.zip\n.\n..\\packages\nimport site\n")
    digits = stem.removeprefix("python")
    return f"{digits[0]}.{digits[1:]}"


def write_zip(folder: Path, target: Path) -> None:
    """Write a folder as a zip, the same bytes for the same files; an unfinished one never stays."""
    unfinished = target.with_suffix(".unfinished")
    try:
        with zipfile.ZipFile(unfinished, "w", zipfile.ZIP_DEFLATED) as archive:
            for path in sorted(path for path in folder.rglob("*") if path.is_file()):
                entry = zipfile.ZipInfo(f"{FOLDER}/{path.relative_to(folder).as_posix()}", _DATE)
                entry.compress_type = zipfile.ZIP_DEFLATED
                with path.open("rb") as source, archive.open(entry, "w") as into:
                    shutil.copyfileobj(source, into)
        unfinished.replace(target)
    finally:
        unfinished.unlink(missing_ok=True)


def main(arguments: Sequence[str] | None = None) -> int:
    """Make the zip; 1 where something is missing in it, and then none is written."""
    parser = argparse.ArgumentParser(description="Make a zip for Windows that starts the studio by a double click.")
    parser.add_argument("--python", type=Path, required=True, help="python-3.X.Y-embed-amd64.zip of python.org")
    parser.add_argument("--to", type=Path, default=Path("heartcase-studio.zip"), help="the zip to write")
    asked = parser.parse_args(arguments)
    if shutil.which("uv") is None:
        print("uv is not there: pip install uv", file=sys.stderr)
        return 1
    if not asked.python.is_file():
        print(f"{asked.python}: there is no such file; download it from python.org", file=sys.stderr)
        return 1
    print(f"SHA-256 of {asked.python.name}: {hashlib.sha256(asked.python.read_bytes()).hexdigest()}")
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch) / FOLDER
        folder.mkdir()
        try:
            version = add_python(asked.python, folder)
        except (ValueError, zipfile.BadZipFile) as error:
            print(error, file=sys.stderr)
            return 1
        _install(Path(scratch), folder / "packages", version)
        (folder / "heartcase studio.bat").write_text(START, newline="\r\n")
        (folder / "read me.txt").write_text(READ_ME, newline="\r\n")
        problems = problems_of(folder / "packages", python_version=version, wanted=Requirement("heartcase[studio]"))
        if problems:
            print("\n".join(problems), file=sys.stderr)
            return 1
        write_zip(folder, asked.to)
    print(f"{asked.to}: {asked.to.stat().st_size / 1e6:.0f} MB, complete by what can be seen without Windows")
    return 0


def _install(scratch: Path, packages: Path, version: str) -> None:
    """Build heartcase's wheel and put it, with all that it needs on Windows, into a folder."""
    subprocess.run(["uv", "build", "--wheel", "--quiet", "--out-dir", str(scratch), str(ROOT)], check=True)
    (wheel,) = scratch.glob("heartcase-*.whl")
    command = ["uv", "pip", "install", "--quiet", "--target", str(packages), "--no-compile"]
    command += ["--python-platform", "x86_64-pc-windows-msvc", "--python-version", version, "--only-binary", ":all:"]
    subprocess.run([*command, f"{wheel}[studio]"], check=True)


if __name__ == "__main__":
    sys.exit(main())
