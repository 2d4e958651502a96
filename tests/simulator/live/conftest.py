"""Cases for the tests of live sessions."""

from __future__ import annotations

import pytest

from tests.simulator.live.scenes import write_case


@pytest.fixture(scope="session")
def live_case(tmp_path_factory):
    """The block without a scan."""
    return write_case(tmp_path_factory.mktemp("live"))
