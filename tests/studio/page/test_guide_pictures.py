"""The pictures of the checklist: there is one for each kind, and the script makes them."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from heartcase.library.scans import ensure_scan
from heartcase.pipeline.formats.read_scan import read_scan
from heartcase.schemas.labels import default_label_table
from heartcase.schemas.recipe.recipe import load_recipe
from tests.studio.page.browsing import browsing
from tests.studio.page.guide_pictures import GUIDE, SIZE, kinds, pictures

SAMPLE = Path(__file__).parents[3] / "sample_cases" / "adult_phantom.toml"


def test_there_is_a_small_picture_of_each_kind_and_the_page_shows_it(chromium, painted):
    names = [*kinds(default_label_table()), "ends"]
    assert sorted(file.stem for file in GUIDE.iterdir()) == sorted(names)
    for name in names:
        assert (GUIDE / f"{name}.png").stat().st_size < 20_000
        assert Image.open(GUIDE / f"{name}.png").size == SIZE
    server, _, _ = painted
    with browsing(chromium, server) as page:
        shown = page.tab.locator("#checklist img")
        assert shown.count() == len(names)
        page.tab.wait_for_function("[...document.querySelectorAll('#checklist img')].every((one) => one.complete)")
        assert page.tab.evaluate(
            "[...document.querySelectorAll('#checklist img')].every((one) => one.naturalWidth > 0 && one.alt)"
        )


@pytest.mark.slow
def test_the_script_makes_them(tmp_path):
    recipe = load_recipe(SAMPLE)
    source = recipe.scan.model_copy(update={"path": "scan.nii.gz"})
    ensure_scan(source, tmp_path)
    for kind, made in pictures(recipe, read_scan(tmp_path / "scan.nii.gz")).items():
        there = np.asarray(Image.open(GUIDE / f"{kind}.png").convert("RGB")).astype(int)
        # palettes may be chosen otherwise by another version of Pillow
        assert np.abs(np.asarray(made.convert("RGB")).astype(int) - there).mean() < 3.0, kind
