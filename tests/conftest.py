"""Where CUDA kernels run, chosen before numba is loaded; and what many modules would otherwise make again."""

import ctypes
import os
import shutil

import hypothesis
import pytest

# Speed is a matter for benchmarks: a busy machine fails no test.
hypothesis.settings.register_profile("untimed", deadline=None)
hypothesis.settings.load_profile("untimed")


def _has_driver() -> bool:
    try:
        ctypes.CDLL("nvcuda.dll" if os.name == "nt" else "libcuda.so.1")
    except OSError:
        return False
    return True


# On a device where there is one, else in numba's simulator.
if not _has_driver():
    os.environ.setdefault("NUMBA_ENABLE_CUDASIM", "1")


@pytest.fixture(scope="module")
def plain_reports():
    """Reports of builds in this process have no pictures, as ``tests/plain_reports.py`` tells."""
    from tests.plain_reports import draw_nothing

    with pytest.MonkeyPatch.context() as patch:
        draw_nothing(patch)
        yield


@pytest.fixture(scope="session", autouse=True)
def shared_anatomies(tmp_path_factory):
    """The distance tables of a phantom are made once for all test processes: 18 s a heart otherwise."""
    import hashlib
    import pickle

    from heartcase.phantom.anatomy import heart

    own = tmp_path_factory.getbasetemp()
    folder = (own.parent if "PYTEST_XDIST_WORKER" in os.environ else own) / "anatomies"
    folder.mkdir(exist_ok=True)
    build = heart.build_anatomy

    def build_once(form, told=lambda _: None):
        path = folder / f"{hashlib.sha256(form.model_dump_json().encode()).hexdigest()}.pickle"
        if not path.exists():
            unfinished = path.with_suffix(f".{os.getpid()}")
            unfinished.write_bytes(pickle.dumps(build(form, told)))
            unfinished.rename(path)
        return pickle.loads(path.read_bytes())

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(heart, "build_anatomy", build_once)
        yield


def pytest_sessionfinish(session):
    """Some hundred megabytes that nobody looks at afterwards."""
    factory = getattr(session.config, "_tmp_path_factory", None)
    if factory is not None and "PYTEST_XDIST_WORKER" not in os.environ:
        shutil.rmtree(factory.getbasetemp() / "anatomies", ignore_errors=True)
