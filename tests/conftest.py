"""CUDA kernels run on a device where there is one, else in numba's simulator: chosen before numba is loaded."""

import ctypes
import os

import pytest


def _has_driver() -> bool:
    try:
        ctypes.CDLL("nvcuda.dll" if os.name == "nt" else "libcuda.so.1")
    except OSError:
        return False
    return True


if not _has_driver():
    os.environ.setdefault("NUMBA_ENABLE_CUDASIM", "1")


@pytest.fixture(scope="module")
def plain_reports():
    """Reports of builds in this process have no pictures, which take most of a small case's time.

    For modules that test what is in files; what reports show is tested in ``tests/pipeline/report``.
    """
    from heartcase.pipeline.report.report_pictures import SurfaceParts

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("heartcase.pipeline.report.build_report.slice_parts", lambda *_: [])
        patch.setattr("heartcase.pipeline.report.build_report.surface_parts", lambda *_: SurfaceParts())
        patch.setattr("heartcase.pipeline.report.confidence_part._pictures", lambda *_: [])
        yield
