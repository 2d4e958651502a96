"""What docstrings and pages refer to by its full name is there."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from tests.structure.test_rooms import PACKAGE, modules

ROOT = PACKAGE.parent
REFERENCE = re.compile(r":(?:func|mod|class|data|meth|attr|exc):`~?(heartcase(?:\.\w+)+)`")
NAMED = re.compile(r"`(heartcase(?:\.\w+)+)`")


def is_there(name: str, known: dict[str, Path]) -> bool:
    """Whether a dotted name is a module, or a name that its module speaks of."""
    module, members = name, []
    while module and module not in known:
        module, _, member = module.rpartition(".")
        members.append(member)
    if not module:
        return False
    source = known[module].read_text(encoding="utf-8")
    return all(re.search(rf"\b{member}\b", source) for member in members)


@pytest.mark.parametrize("folder", ["heartcase", "tests", "benchmarks", "docs"])
def test_every_full_name_is_that_of_something(folder):
    known = modules()
    wrong, count = [], 0
    for file in sorted((ROOT / folder).rglob("*.py" if folder != "docs" else "*.md")):
        for name in (REFERENCE if folder != "docs" else NAMED).findall(file.read_text(encoding="utf-8")):
            count += 1
            if not is_there(name, known):
                wrong.append(f"{file.relative_to(ROOT)}: {name}")
    assert wrong == []
    assert count > {"heartcase": 50, "docs": 2}.get(folder, -1)


def test_a_name_that_is_gone_would_be_found():
    known = modules()
    assert is_there("heartcase.pipeline.bundle.assembly.labels_of", known)
    assert not is_there("heartcase.pipeline.building.run.labels_of", known)
    assert not is_there("heartcase.pipeline.runner.Runner", known)
