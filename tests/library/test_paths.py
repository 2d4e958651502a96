"""Paths as texts, and names that no path may have."""

from __future__ import annotations

import pytest

from heartcase.library.diff import diff_libraries
from heartcase.library.plan import plan_library
from heartcase.pipeline.formats.read_scan import list_series, read_labels, read_scan
from heartcase.schemas.errors import HeartcaseError, UsageError
from heartcase.schemas.recipe.recipe import load_recipe
from heartcase.simulator.session.script import load_script
from heartcase.studio.catalogue.site import write_catalogue


def test_folders_may_be_texts_and_a_name_that_no_path_may_have_is_none(tmp_path):
    (tmp_path / "out").mkdir()
    for name in (str(tmp_path / "out"), "a\0b", "x" * 5000):
        for call in (lambda name=name: diff_libraries(name, name), lambda name=name: write_catalogue(name)):
            with pytest.raises(UsageError, match="there is no"):
                call()
        with pytest.raises(UsageError, match=r"there is no such folder|no recipe was found"):
            plan_library(name)


@pytest.mark.parametrize("name", ["a\0b", "x" * 5000])
@pytest.mark.parametrize("read", [load_recipe, load_script, list_series, read_scan, read_labels])
def test_a_file_of_a_name_that_no_path_may_have_is_not_there(read, name):
    with pytest.raises(HeartcaseError, match="there is no such file"):
        read(name)
