"""The modules of the studio's page by themselves, as node runs them."""

import os
import re
import shutil
import subprocess
from pathlib import Path

import pytest

from heartcase.schemas.bundle.format import CaseManifest
from heartcase.studio.serving.app import PAGE

TESTS = sorted(Path(__file__).parent.glob("*.test.mjs"))


@pytest.mark.skipif(shutil.which("node") is None, reason="there is no node on this machine: the modules were not tried")
@pytest.mark.parametrize("file", TESTS, ids=[file.name.partition(".")[0] for file in TESTS])
def test_by_node(file):
    found = subprocess.run(["node", "--test", str(file)], capture_output=True, text=True, timeout=120, check=False)
    assert found.returncode == 0, found.stdout + found.stderr


@pytest.mark.skipif(shutil.which("node") is None, reason="there is no node on this machine: the modules were not tried")
def test_all_can_be_read():
    script = """
      import { readFileSync } from "node:fs";
      import { SourceTextModule } from "node:vm";
      for (const file of process.argv.slice(1)) new SourceTextModule(readFileSync(file, "utf8"), { identifier: file });
    """
    files = [str(file) for file in sorted(PAGE.rglob("*.js"))]
    command = ["node", "--experimental-vm-modules", "--no-warnings", "--input-type=module", "-e", script, *files]
    found = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert found.returncode == 0, found.stderr


def test_all_imports_are_there():
    for file in sorted(PAGE.rglob("*.js")):
        for target in re.findall(r'^(?:import|export) .*from "(.+)";$', file.read_text(encoding="utf-8"), re.MULTILINE):
            assert (file.parent / target).is_file(), (file.name, target)


def test_what_every_case_says_of_its_use_has_words_in_each_language():
    notice = CaseManifest.model_fields["notice"].default
    assert f'case_notice: "{notice}"' in (PAGE / "words" / "en.js").read_text()


def test_types_fit():
    """As the JSDoc comments state them; `.ci/run` fetches the compiler that package-lock.json pins."""
    compiler = os.environ.get("HEARTCASE_TSC") or shutil.which("tsc")
    if compiler is None:
        pytest.skip("there is no TypeScript on this machine (HEARTCASE_TSC): the types of the page were not checked")
    project = Path(__file__).parent / "types" / "tsconfig.json"
    found = subprocess.run([compiler, "-p", str(project)], capture_output=True, text=True, timeout=300, check=False)
    assert found.returncode == 0, found.stdout + found.stderr
