"""A cache of the user's own for each test, and worker processes that draw nothing."""

from __future__ import annotations

import pytest


@pytest.fixture(autouse=True)
def own_cache(tmp_path_factory, monkeypatch):
    folder = tmp_path_factory.mktemp("own-cache")
    monkeypatch.setenv("XDG_CACHE_HOME", str(folder))
    return folder


@pytest.fixture
def plain_workers():
    """Reports have no pictures in worker processes either."""
    import dask
    import distributed  # noqa: F401  its defaults would go with the setting, were they set within

    with dask.config.set({"distributed.worker.preload": ["tests.plain_reports"]}):
        yield
