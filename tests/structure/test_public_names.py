"""The names of the package: one path to each, nothing loaded before it is used, seen by type checkers."""

from __future__ import annotations

import ast
import json
import subprocess
import sys
from importlib import import_module, resources
from pathlib import Path

import pytest

import heartcase

SOURCE = ast.parse(Path(heartcase.__file__).read_text(encoding="utf-8"))


def test_each_name_is_the_object_of_the_module_that_defines_it():
    for name in {*heartcase.__all__} - {"__version__"}:
        found = getattr(heartcase, name)
        assert found is getattr(import_module(heartcase._MODULE_OF[name]), name)
        assert found.__module__ == heartcase._MODULE_OF[name], name
        assert found.__doc__, name


def test_type_checkers_see_the_names_that_are_loaded():
    """What the block for type checkers imports, what is loaded at run time, and ``__all__`` are the same."""
    block = next(node for node in SOURCE.body if isinstance(node, ast.If))
    assert ast.unparse(block.test) == "TYPE_CHECKING"
    seen = {alias.name: node.module for node in block.body for alias in node.names}
    assert seen == heartcase._MODULE_OF
    assert {*heartcase.__all__} == {*seen, "__version__"}
    assert len(heartcase.__all__) == len({*heartcase.__all__})


def test_the_package_says_that_it_is_typed():
    assert resources.files("heartcase").joinpath("py.typed").is_file()


def test_no_public_name_is_that_of_a_folder():
    """Importing the folder would put it in the name's place."""
    folders = {path.parent.name for path in Path(heartcase.__file__).parent.glob("*/__init__.py")}
    assert folders
    assert folders.isdisjoint(heartcase.__all__)


def test_dir_lists_names_that_are_not_loaded_yet():
    assert {*heartcase.__all__} <= {*dir(heartcase)}


def test_a_name_that_there_is_not_is_told_as_of_any_module():
    with pytest.raises(AttributeError, match="module 'heartcase' has no attribute 'load_cases'"):
        _ = heartcase.load_cases
    with pytest.raises(ImportError, match="cannot import name 'load_cases'"):
        exec("from heartcase import load_cases")


def _loaded_by(program: str) -> set[str]:
    """Top-level modules that a new process has loaded when it is through with a program."""
    tell = "import json, sys; print(json.dumps(sorted({name.split('.')[0] for name in sys.modules})))"
    done = subprocess.run([sys.executable, "-c", f"{program}\n{tell}"], capture_output=True, text=True, check=True)
    return set(json.loads(done.stdout))


def test_importing_the_package_loads_no_library():
    libraries = {"numba", "numpy", "pydantic", "scipy", "skimage", "vtk", "vtkmodules", "SimpleITK", "click", "rich"}
    assert _loaded_by("import heartcase; dir(heartcase); heartcase.__version__").isdisjoint(libraries)


def test_a_scene_loads_the_simulator_and_not_what_makes_cases():
    loaded = _loaded_by("from heartcase import Simulation, load_case")
    assert "numba" in loaded
    assert loaded.isdisjoint({"SimpleITK", "skimage", "vtk", "vtkmodules", "click", "matplotlib", "pydicom"})


def test_a_librarys_client_and_a_table_of_stages_load_no_pipeline():
    loaded = _loaded_by("import heartcase.library.plan, heartcase.pipeline.stages.table")
    assert loaded.isdisjoint({"numba", "scipy", "cc3d", "SimpleITK", "vtk", "vtkmodules", "matplotlib"})


def test_opening_a_bundle_needs_no_compiler():
    assert "numba" not in _loaded_by("from heartcase import check_bundle, load_recipe, open_bundle")
