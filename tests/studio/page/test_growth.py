"""Three minutes of operating leave the memory of server and page where it was after warming up."""

import pytest

from tests.simulator.live.scenes import write_case
from tests.studio.page.growth import PAGE_MB_PER_MINUTE, SERVER_MB_PER_MINUTE, operate


@pytest.mark.slow
def test_memory_stays_while_somebody_operates(chromium, tmp_path):
    found = operate(write_case(tmp_path), 180.0, chromium)
    assert len(found.times_s) > 10
    assert found.per_minute(found.server_mb) < SERVER_MB_PER_MINUTE
    assert found.per_minute(found.page_mb) < PAGE_MB_PER_MINUTE
