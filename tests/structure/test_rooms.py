"""The folders of the package: what they import of one another, and how many modules each holds."""

from __future__ import annotations

import ast
from collections import defaultdict
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

import heartcase

PACKAGE = Path(heartcase.__file__).parent
MODULES_MOST = 16


def modules() -> dict[str, Path]:
    """Dotted name -> file of every module."""
    found = {}
    for file in sorted(PACKAGE.rglob("*.py")):
        parts = ("heartcase", *file.relative_to(PACKAGE).with_suffix("").parts)
        found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = file
    return found


def imports_of(source: str, known: set[str]) -> set[str]:
    """Modules of the package that a source imports anywhere."""
    found = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.ImportFrom) and node.module and node.module.split(".")[0] == "heartcase":
            for alias in node.names:
                inner = f"{node.module}.{alias.name}"
                found.add(inner if inner in known else node.module)
        elif isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names if alias.name in known}
    return found


def folders_of(files: dict[str, Path]) -> dict[Path, set[Path]]:
    """Folder -> the folders that its modules import; the package's own two modules start it, and are left out."""
    graph: dict[Path, set[Path]] = defaultdict(set)
    for file in files.values():
        for name in imports_of(file.read_text(), set(files)):
            if PACKAGE not in (file.parent, files[name].parent) and file.parent != files[name].parent:
                graph[file.parent].add(files[name].parent)
    return graph


def test_no_two_folders_import_each_other_in_any_number_of_steps():
    graph = folders_of(modules())
    assert len(graph) > 30
    order = list(TopologicalSorter(graph).static_order())
    place = {folder.relative_to(PACKAGE).as_posix(): number for number, folder in enumerate(order)}
    assert place["schemas"] < place["pipeline/fields"] < place["pipeline/checks"] < place["pipeline/stages"]
    assert place["pipeline/stages"] < place["pipeline/building"] < place["cli/commands"]


def test_a_cycle_of_folders_would_be_found():
    graph = folders_of(modules())
    graph[PACKAGE / "pipeline" / "fields"].add(PACKAGE / "pipeline" / "stages")
    with pytest.raises(CycleError):
        list(TopologicalSorter(graph).static_order())


def test_no_folder_holds_more_modules_than_a_reader_can_look_through():
    count = defaultdict(int)
    for file in modules().values():
        count[file.parent] += file.name != "__init__.py"
    crowded = {folder.relative_to(PACKAGE).as_posix(): number for folder, number in count.items()}
    assert {folder: number for folder, number in crowded.items() if number > MODULES_MOST} == {}


def test_every_folder_says_in_a_sentence_what_it_holds():
    for name, file in modules().items():
        if file.name == "__init__.py":
            text = ast.get_docstring(ast.parse(file.read_text()))
            assert text, name
            assert text.splitlines()[0].endswith((".", "::", "?")), name


def test_no_folder_has_a_name_that_tools_pass_over():
    """pytest collects nothing in a folder called build, and ruff checks nothing there, without a word."""
    names = {"build", "dist", "env", "venv", "node_modules", "site-packages", "CVS", "_darcs", "__pypackages__"}
    roots = (PACKAGE, Path(__file__).parents[1], Path(__file__).parents[2] / "benchmarks")
    found = {file.parent for root in roots for file in root.rglob("*.py")}
    assert len(found) > 60
    passed_over = {folder for folder in found if names & set(folder.parts[len(PACKAGE.parent.parts) :])}
    assert passed_over == set()
