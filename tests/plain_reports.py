"""Builds whose reports have no pictures, which take most of a small case's time.

For tests of what is in files; what reports show is tested in ``tests/pipeline/report``. Dask's workers are told the
name of this module as one to load at their start: processes of their own have nothing of what a fixture patched.
"""

from __future__ import annotations

from importlib import import_module
from typing import Any

import pytest

PART = "heartcase.pipeline.report"


def draw_nothing(patch: pytest.MonkeyPatch) -> None:
    """Leave pictures out of reports that this process makes."""
    parts = import_module(f"{PART}.report_pictures")
    patch.setattr(f"{PART}.build_report.slice_parts", lambda *_: [])
    patch.setattr(f"{PART}.build_report.surface_parts", lambda *_: parts.SurfaceParts())
    patch.setattr(f"{PART}.confidence_part._pictures", lambda *_: [])


def dask_setup(_: Any) -> None:
    """What Dask calls where it loads this module in a worker."""
    draw_nothing(pytest.MonkeyPatch())
