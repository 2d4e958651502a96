"""Where the sample cases are: recipes, scripts and guided tours that come with heartcase."""

from __future__ import annotations

from pathlib import Path

__all__ = ["sample_folder"]

_PACKAGE = Path(__file__).parents[1]


def sample_folder() -> Path | None:
    """Where the sample cases are: in the installed package, or beside it in a checkout; None where there are none."""
    places = (_PACKAGE / "sample_cases", _PACKAGE.parent / "sample_cases")
    return next((one for one in places if one.is_dir()), None)
