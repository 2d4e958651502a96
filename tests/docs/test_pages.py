"""The examples in the documentation do what the pages say."""

from __future__ import annotations

import io
import os
import re
import shutil
from pathlib import Path

import numpy as np
import pytest

from heartcase.cli.main import COMMANDS, main
from heartcase.pipeline.data import Segmentation
from heartcase.pipeline.formats.write_images import write_segmentation
from heartcase.schemas.geometry import Geometry
from heartcase.schemas.labels import Label, LabelTable, Role
from heartcase.schemas.published.reference import reference_page
from heartcase.schemas.recipe.recipe import Recipe
from tests.ball import write_ball_recipe, write_ball_scan
from tests.docs.pages import PAGES, ROOT, examples_of, is_run, run_page

GEOMETRY = Geometry.of(shape=(32, 32, 32), spacing_mm=(2, 2, 2), origin_mm=(-31, -31, -31))
LANDMARK = """
[[landmarks]]
name = "apex"
kind = "point"
points_mm = [[17.0, 0.0, 0.0]]
"""


@pytest.fixture(scope="module")
def stage(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What the pages take for granted: a scan, painted markers, a finished segmentation, a sample case."""
    root = tmp_path_factory.mktemp("stage")
    write_ball_scan(root / "scan.nii.gz")
    k, j, i = np.indices(GEOMETRY.shape)
    radius = np.linalg.norm(GEOMETRY.index_to_world(np.stack([i, j, k], axis=-1)), axis=-1)
    painted = np.zeros(GEOMETRY.shape, np.uint8)
    painted[radius < 6.0] = 1
    painted[(abs(radius - 17.0) < 1.5) & (i % 4 == 0)] = 2
    painted[radius > 28.0] = 3
    finished = np.where(radius < 14.0, 1, np.where(radius < 20.0, 2, 0)).astype(np.uint8)
    names = ("left ventricle", "left ventricular myocardium", "background of the heart")
    roles = (Role.BLOOD, Role.MYOCARDIUM, Role.WALL)
    table = LabelTable(labels=tuple(Label(value=n + 1, name=name, role=roles[n]) for n, name in enumerate(names)))
    for name, labels in (("markers", painted), ("finished", finished)):
        write_segmentation(Segmentation(labels, GEOMETRY, table), root / f"{name}.seg.nrrd")
        write_segmentation(Segmentation(labels, GEOMETRY, table), root / f"{name}.nii.gz")
    markers = root / "markers.seg.nrrd"
    markers.write_bytes(markers.read_bytes().replace(b"background of the heart", b"background"))
    recipe = write_ball_recipe(root / "scan.nii.gz", root / "adult-phantom.toml", cell_mm=5.0, more=LANDMARK)
    recipe.write_text(recipe.read_text().replace('name = "ball"', 'name = "adult-phantom"'))
    assert main(["build", str(recipe), "--out", str(root / "out")]) == 0
    return root


def has_examples(page: Path) -> bool:
    return any(is_run(example) for example in examples_of(page))


@pytest.mark.parametrize("page", [p for p in PAGES if has_examples(p)], ids=lambda page: page.name)
def test_examples_run(
    page: Path, stage: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    shutil.copytree(stage, tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "200")

    def run(arguments: list[str]) -> tuple[int, str]:
        capfd.readouterr()
        if arguments[0] == "approve":
            monkeypatch.setattr("sys.stdin", io.StringIO("y\n" * 2))
        code = main(arguments)
        printed = capfd.readouterr()
        return code, printed.out + printed.err

    if page.name == "identity.md":
        run_page(ROOT / "docs" / "from_scan_to_case.md", run)
    run_page(page, run)


ON_THE_SAMPLE = [
    p for p in PAGES if any(e.kind == "python" and "out/adult-phantom.case" in e.content for e in examples_of(p))
]


@pytest.mark.slow
@pytest.mark.parametrize("page", ON_THE_SAMPLE, ids=lambda page: page.name)
def test_python_runs_on_the_sample_case(page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The case that a page names, of a whole heart: another shape than that of the stage.

    With ``HEARTCASE_LIBRARY`` set to the folder of a build of ``sample_cases``, such as ``out``, what is up to date
    there is not built again.
    """
    out = Path(os.environ.get("HEARTCASE_LIBRARY", tmp_path / "out")).absolute()
    recipe = ROOT / "sample_cases" / "adult_phantom.toml"
    if out == tmp_path / "out":
        (tmp_path / "sample_cases").mkdir()
        recipe = Path(shutil.copy(recipe, tmp_path / "sample_cases"))
    assert main(["build", str(recipe), "--out", str(out)]) == 0
    monkeypatch.chdir(tmp_path)
    if out != tmp_path / "out":
        (tmp_path / "out").symlink_to(out)
    run_page(page, lambda _: (0, ""), kinds=("python",))


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_what_a_page_points_to_is_there(page: Path) -> None:
    """Paths of the repository and commands that a page names exist."""
    text = page.read_text(encoding="utf-8")
    for path in re.findall(r"`((?:docs|heartcase|tests|benchmarks|sample_cases|readers)/[\w./-]*)`", text):
        assert (ROOT / path).exists(), path
    for command in re.findall(r"`heartcase ([a-z]+(?:-[a-z]+)*)", text):
        assert command in COMMANDS, command
    for target in re.findall(r"\]\(([^)#:]+)\)", text):
        assert (page.parent / target).exists(), target


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_a_case_is_built_where_it_is_read(page: Path) -> None:
    """All but the one that ``make case`` builds; a build without ``--out`` writes into the current folder."""
    built = {"adult-phantom"}
    for example in examples_of(page):
        if example.kind not in ("sh", "bash"):
            continue
        for line in re.sub(r"\\\n", " ", example.content).splitlines():
            if "heartcase library build sample_cases --out out" in line:
                built |= {path.stem.replace("_", "-") for path in (ROOT / "sample_cases").glob("*.toml")}
            recipes = re.findall(r"heartcase build sample_cases/(\w+)\.toml --out out\b", line)
            built |= {name.replace("_", "-") for name in recipes}
            assert set(re.findall(r"\bout/([\w-]+)\.case\b", line)) <= built, f"{page.name}:{example.line}: {line}"


def test_nothing_is_installed_by_name() -> None:
    """heartcase is on no package index: it is installed from a checkout, or from a wheel."""
    code = [path for top in ("heartcase", "benchmarks") for path in (ROOT / top).rglob("*.py")]
    for path in [*PAGES, *code, ROOT / "tests" / "docs" / "api_page.py"]:
        assert not re.search(r"install [\"']?heartcase\b", path.read_text(encoding="utf-8")), path


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_no_example_approves_unasked(page: Path) -> None:
    """``--yes`` passes over the question about warnings that the anatomy may be wrong."""
    for line in page.read_text(encoding="utf-8").splitlines():
        assert not (line.lstrip("$ ").startswith("heartcase approve") and "--yes" in line)


def test_the_reference_of_the_recipe_names_every_setting() -> None:
    page = reference_page("Recipe", "", Recipe)
    for key in Recipe.model_fields:
        assert f"| `{key}` |" in page
    assert "| `iterations` | whole number, at least 1, at most 200 | `5` |" in page
    # limits of what may be left out, too
    assert "| `noise_floor` | number, at least 0, at most 20 |  |" in page
    assert "| `into` | text, no longer than 64 |  |" in page
    assert "\n## `WallsSettings`: `[walls]`\n" in page
    assert page.count("**needed**") > 10
