"""Keeping ITK quiet: what it complains about holds file names."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager

import SimpleITK

__all__ = ["quiet_itk"]


@contextmanager
def quiet_itk() -> Iterator[None]:
    """Keep ITK's complaints, which hold file names, off the standard error stream.

    Its part for NRRD writes there on its own, past every switch, so the stream itself is turned away.
    """
    shown = SimpleITK.ProcessObject.GetGlobalWarningDisplay()
    SimpleITK.ProcessObject.SetGlobalWarningDisplay(False)
    sys.stderr.flush()
    kept, nowhere = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 2)
    try:
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)
        os.close(nowhere)
        SimpleITK.ProcessObject.SetGlobalWarningDisplay(shown)
