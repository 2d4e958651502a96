"""The case that is operated on."""

import pytest

from tests.simulator.live.scenes import write_case


@pytest.fixture(scope="session")
def operated_case(tmp_path_factory):
    """A block of 8 x 5 x 4 cells of 3 mm on a fixed base, at 10, -20, 30 mm; its upper side is at 40.5 mm."""
    return write_case(tmp_path_factory.mktemp("operated"))


@pytest.fixture(scope="package")
def operated(operated_case, tmp_path_factory):
    """A browser on the block, and its theatre, for all tests of the package."""
    from tests.studio.operating.performing import theatre

    with theatre(operated_case, tmp_path_factory.mktemp("recordings")) as (browser, opened):
        yield browser, opened
