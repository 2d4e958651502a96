"""Versions of numba that heartcase was tested with; the range is that of the package's dependencies."""

from __future__ import annotations

import re

import numba

from heartcase.schemas.errors import UnsupportedVersionError

__all__ = ["FIRST_NUMBA", "LAST_NUMBA", "check_numba"]

FIRST_NUMBA = (0, 66)
"""Oldest minor version of numba that the tests run with."""
LAST_NUMBA = (0, 68)
"""Newest minor version of numba that the tests run with."""


def check_numba(version: str = numba.__version__) -> None:
    """Refuse a numba that nobody has tried: its inside changes between minor versions, and wrong code is silent.

    Parameters
    ----------
    version
        A version of numba, that of the process by default.

    Raises
    ------
    UnsupportedVersionError
        It lies outside FIRST_NUMBA to LAST_NUMBA.
    """
    found = re.match(r"(\d+)\.(\d+)", version)
    if found and FIRST_NUMBA <= (int(found[1]), int(found[2])) <= LAST_NUMBA:
        return
    first, last, after = ("{}.{}".format(*two) for two in (FIRST_NUMBA, LAST_NUMBA, (LAST_NUMBA[0], LAST_NUMBA[1] + 1)))
    raise UnsupportedVersionError(
        f"numba {version} is installed, and heartcase is tested with {first} to {last} only: "
        f"run  pip install 'numba>={first},<{after}'"
    )
