"""The modules of the studio's page by themselves, as node runs them."""

import re
import shutil
import subprocess
from pathlib import Path

import pytest

from heartcase.studio.app import PAGE

TESTS = sorted(Path(__file__).parent.glob("*.test.mjs"))


@pytest.mark.skipif(shutil.which("node") is None, reason="there is no node on this machine: the modules were not tried")
@pytest.mark.parametrize("file", TESTS, ids=[file.name.partition(".")[0] for file in TESTS])
def test_by_node(file):
    found = subprocess.run(["node", "--test", str(file)], capture_output=True, text=True, timeout=120, check=False)
    assert found.returncode == 0, found.stdout + found.stderr


@pytest.mark.skipif(shutil.which("node") is None, reason="there is no node on this machine: the modules were not tried")
def test_all_can_be_read():
    for file in sorted(PAGE.rglob("*.js")):
        subprocess.run(["node", "--check", str(file)], check=True, timeout=60)


def test_all_imports_are_there():
    for file in sorted(PAGE.rglob("*.js")):
        for target in re.findall(r'^(?:import|export) .*from "(.+)";$', file.read_text(encoding="utf-8"), re.MULTILINE):
            assert (file.parent / target).is_file(), (file.name, target)
