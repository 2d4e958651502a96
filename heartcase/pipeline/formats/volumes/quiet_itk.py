"""Keeping ITK quiet: what it complains about holds file names. That it complained is heard."""

from __future__ import annotations

import os
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

__all__ = ["Complaint", "quiet_itk"]


@dataclass
class Complaint:
    """Whether anything was written to the standard error stream; known when the block is left."""

    was_made: bool = False


@contextmanager
def quiet_itk() -> Iterator[Complaint]:
    """Keep ITK's complaints, which hold file names, off the standard error stream, and tell whether there were any.

    Its parts for NRRD and for DICOM write there on their own, past every switch, so the stream itself is turned away.
    """
    import SimpleITK

    complaint = Complaint()
    shown = SimpleITK.ProcessObject.GetGlobalWarningDisplay()
    SimpleITK.ProcessObject.SetGlobalWarningDisplay(False)
    sys.stderr.flush()
    with tempfile.TemporaryFile() as nowhere:
        kept = os.dup(2)
        os.dup2(nowhere.fileno(), 2)
        try:
            yield complaint
        finally:
            os.dup2(kept, 2)
            os.close(kept)
            complaint.was_made = os.fstat(nowhere.fileno()).st_size > 0
            SimpleITK.ProcessObject.SetGlobalWarningDisplay(shown)
