"""What a type checker makes of the public names: checked by mypy with the package (``make types``), never run."""

from __future__ import annotations

from pathlib import Path
from typing import assert_type

import heartcase
from heartcase import (
    BuildResult,
    Case,
    LabelTable,
    Recipe,
    Scan,
    Simulation,
    build_case,
    default_label_table,
    load_case,
    load_recipe,
    read_scan,
)


def use(path: Path) -> Simulation:
    """Each name has the type of what is behind it, and is not merely some object."""
    assert_type(load_case(path), Case)
    assert_type(load_recipe(path), Recipe)
    assert_type(build_case(load_recipe(path), directory=path, out=path), BuildResult)
    assert_type(read_scan(path), Scan)
    assert_type(default_label_table(), LabelTable)
    _ = heartcase.load_cases  # type: ignore[attr-defined]  # there is no such name, and a checker says so
    return Simulation(load_case(path).model)
