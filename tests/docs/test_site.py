"""The documentation as a site: strict, offline, with links where texts name each other."""

from __future__ import annotations

import importlib.util
import re
import shutil
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest
import yaml

from tests.docs.pages import ROOT


def _hooks():
    spec = importlib.util.spec_from_file_location("site_hooks", ROOT / "docs" / "site_hooks.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


class _Files:
    """The pages of a site."""

    pages = ("physics.md", "schemas/recipe-reference.md", "contributing.md")

    def get_file_from_path(self, path: str) -> object | None:
        return path if path in self.pages else None


def _shown(text: str, page: str = "engine.md") -> str:
    return _hooks().on_page_markdown(text, page=SimpleNamespace(file=SimpleNamespace(src_uri=page)), files=_Files())


@pytest.mark.parametrize(
    ("page", "text", "shown"),
    [
        ("engine.md", "see `docs/physics.md`.", "see [`docs/physics.md`](physics.md)."),
        ("schemas/a.md", "`docs/physics.md`", "[`docs/physics.md`](../physics.md)"),
        ("engine.md", "`CONTRIBUTING.md`, `docs/none.md`", "[`CONTRIBUTING.md`](contributing.md), `docs/none.md`"),
        ("index.md", "[rules](../CONTRIBUTING.md)", "[rules](contributing.md)"),
        ("engine.md", "[`docs/physics.md`](physics.md)", "[`docs/physics.md`](physics.md)"),
        ("engine.md", "```console fails\n`docs/physics.md`\n```\n", "```console\n`docs/physics.md`\n```\n"),
    ],
)
def test_pages_that_a_text_names_are_links(page, text, shown):
    assert _shown(text, page) == shown


def _build(folder: Path) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "mkdocs", "build", "--site-dir", str(folder / "site")]
    return subprocess.run(command, check=False, cwd=folder, capture_output=True, text=True)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """What the site is made from."""
    for path in ("mkdocs.yml", *_hooks().OUTSIDE):
        (tmp_path / path).parent.mkdir(exist_ok=True)
        shutil.copy(ROOT / path, tmp_path / path)
    shutil.copytree(ROOT / "docs", tmp_path / "docs")
    return tmp_path


def test_the_site_fetches_nothing_from_elsewhere(folder):
    done = _build(folder)
    assert done.returncode == 0, done.stderr
    pages = sorted((folder / "site").rglob("*.html"))
    assert len(pages) > 20
    for page in pages:
        text = page.read_text(encoding="utf-8")
        loaded = re.findall(r'<(?:script|img|iframe)[^>]+src="([^"]+)"|<link[^>]+href="([^"]+)"', text)
        assert not [one for pair in loaded for one in pair if "//" in one], page.name
    assert 'href="contributing.html"' in (folder / "site" / "index.html").read_text(encoding="utf-8")


def test_wrong_links_and_pages_that_no_door_leads_to_stop_it(folder):
    wrong = "[gone](gone.md), [no such part](physics.md#no-such-part), [not a page](/physics.md)"
    (folder / "docs" / "numba.md").write_text(f"# Page\n\n{wrong}\n", encoding="utf-8")
    (folder / "docs" / "forgotten.md").write_text("# Page\n", encoding="utf-8")
    done = _build(folder)
    assert done.returncode != 0
    for told in ("'gone.md'", "'#no-such-part'", "'/physics.md'", "forgotten.md"):
        assert re.search(rf"WARNING.*\n?.*{re.escape(told)}", done.stderr), told
    assert done.stderr.count("WARNING") == 4


def test_hooks_before_a_commit_are_what_the_gate_checks():
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    checked = re.search(r"^check: (.*)$", makefile, re.M)[1].split()
    hooks = yaml.safe_load((ROOT / ".pre-commit-config.yaml").read_text(encoding="utf-8"))["repos"][0]["hooks"]
    assert [hook["entry"] for hook in hooks] == [f"make {target}" for target in checked]


def test_templates_can_be_read_and_ask_for_no_patient():
    files = sorted((ROOT / ".github" / "ISSUE_TEMPLATE").glob("*.yml"))
    bodies = [yaml.safe_load(file.read_text(encoding="utf-8")) for file in files if file.name != "config.yml"]
    assert len(bodies) == 2
    for form in bodies:
        identity = next(part for part in form["body"] if part.get("id") == "identity")
        assert identity["attributes"]["options"][0]["required"] is True
