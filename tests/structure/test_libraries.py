"""What the package imports, and what its extras install."""

from __future__ import annotations

import ast
import re
import sys
import tomllib
from importlib.metadata import packages_distributions

import pytest
from packaging.requirements import Requirement

from heartcase.cli.main import _EXTRA_OF_MODULE, _PREPARE_MODULES
from tests.structure.test_rooms import PACKAGE, modules

THROUGH = {"vtk": "pyvista", "pyjpegls": "pydicom"}
"""What the package uses through another library, and which."""
UNASKED = {"imageio", "imageio-ffmpeg"}
"""What a command asks for by name where it is missing, and no extra has."""
BROUGHT = {"annotated-types": "pydantic", "llvmlite": "numba", "pydantic-core": "pydantic"}
"""What another library brings and the package imports too."""


def libraries() -> set[str]:
    """Distributions that the package imports anywhere."""
    found = set()
    for file in modules().values():
        for node in ast.walk(ast.parse(file.read_text())):
            if isinstance(node, ast.Import):
                found |= {alias.name.split(".")[0] for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
                found.add(node.module.split(".")[0])
            elif isinstance(node, ast.Call) and ast.unparse(node.func).endswith("find_spec"):
                # Files of a library are used without importing it.
                found |= {each.value for each in node.args if isinstance(each, ast.Constant)}
    of = packages_distributions()
    return {
        plain(of.get(name, [name])[0]) for name in found - set(sys.stdlib_module_names) - {"heartcase", "benchmarks"}
    }


def plain(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()


def required() -> dict[str, set[str]]:
    """Extra -> its own distributions; those of all are under an empty name."""
    project = tomllib.loads((PACKAGE.parent / "pyproject.toml").read_text())["project"]
    extras = {"": project["dependencies"], **project["optional-dependencies"]}
    return {
        extra: {plain(re.match(r"[\w.-]+", each)[0]) for each in several} - {"heartcase"}
        for extra, several in extras.items()
    }


def test_the_package_imports_what_its_extras_install():
    extras = required()
    known = extras[""] | extras["prepare"] | extras["library"] | extras["studio"] | extras["cuda"] | {"scikit-image"}
    assert libraries() - known - UNASKED - set(BROUGHT) == set()


def test_what_prepare_installs_is_used_by_the_package():
    used = libraries()
    assert {name for name in required()["prepare"] if THROUGH.get(name, name) not in used} == set()


def test_a_module_that_is_missing_is_said_to_be_in_the_extra_that_has_it():
    of, extras = packages_distributions(), required()
    for module in _PREPARE_MODULES:
        assert plain(of.get(module, [module])[0]) in extras["prepare"], module
    for module, extra in _EXTRA_OF_MODULE.items():
        if module in of:
            assert plain(of[module][0]) in extras[extra], module


@pytest.mark.parametrize(("lock", "extras"), [
    ("requirements.lock", ("", "prepare", "studio", "dev")),
    ("requirements-lowest.lock", ("", "prepare", "studio", "dev")),
    ("requirements-prepare.lock", ("", "prepare")),
    ("requirements-plain.lock", ("",)),
])  # fmt: skip
def test_a_lock_file_pins_what_is_asked_for(lock, extras):
    text = (PACKAGE.parent / lock).read_text()
    # One name may be pinned once for each Python.
    pinned: dict[str, list[str]] = {}
    for name, version in re.findall(r"^([\w.-]+)(?:\[[\w,]+\])?==([^\s;]+)", text, re.MULTILINE):
        pinned.setdefault(plain(name), []).append(version)
    project = tomllib.loads((PACKAGE.parent / "pyproject.toml").read_text())["project"]
    several = {"": project["dependencies"], **project["optional-dependencies"]}
    for each in (Requirement(line) for extra in extras for line in several[extra]):
        if each.name != "heartcase":
            versions = pinned.get(plain(each.name), [])
            assert versions, f"{lock} has no {each.name}: run make lock"
            assert all(each.specifier.contains(version) for version in versions), f"{lock}: {each} against {versions}"
