"""A case on disk for the simulator's tests."""

from __future__ import annotations

from pathlib import Path

import pytest

from heartcase.pipeline.bundle.write_bundle import write_bundle
from tests.factories import block_case


@pytest.fixture(scope="session")
def case_path(tmp_path_factory) -> Path:
    """A block of 8 x 5 x 4 cells of 3 mm on a fixed base."""
    path = tmp_path_factory.mktemp("cases") / "block.case"
    write_bundle(path, block_case(size=(8, 5, 4)))
    return path
