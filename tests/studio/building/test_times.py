"""How long a build may take, from earlier ones."""

import pytest

from heartcase.studio.building.times import StageTimes

STAGES = ("segment", "walls", "surface")


def test_nothing_is_said_before_anything_is_known_of_this_size(tmp_path):
    times = StageTimes(tmp_path / "studio" / "times.json")
    assert times.expected(1000, STAGES) is None
    times.learn(1000, {"segment": 2.0, "walls": 3.0})
    assert times.expected(1000, STAGES) is None
    times.learn(1000, {"surface": 10.0})
    assert times.expected(1000, STAGES) == pytest.approx(15.0)
    assert times.expected(None, STAGES) is None
    # larger scans take longer, and of much larger ones nothing is known
    assert times.expected(1400, STAGES) == pytest.approx(21.0)
    assert times.expected(2000, STAGES) is None
    assert times.expected(500, STAGES) is None
    assert times.expected(2000, ()) == 0.0


def test_one_build_that_took_long_does_not_decide(tmp_path):
    times = StageTimes(tmp_path / "times.json")
    for seconds in (70.0, 10.0, 12.0, 11.0):
        times.learn(1000, {"surface": seconds})
    assert times.expected(1000, ["surface"]) == pytest.approx(11.5)
    for _ in range(20):
        times.learn(1000, {"surface": 5.0})
    assert times.expected(1000, ["surface"]) == pytest.approx(5.0)
    # also after a restart, and a damaged file is as none
    assert StageTimes(tmp_path / "times.json").expected(1000, ["surface"]) == pytest.approx(5.0)
    for text in ("", "[]", '{"surface": [[0, 1]]}', '{"surface": 3}', '{"surface": [["a", "b"]]}'):
        (tmp_path / "times.json").write_text(text)
        assert times.expected(1000, ["surface"]) is None


def test_builds_in_which_a_stage_had_nothing_to_do_do_not_count_once_it_had(tmp_path):
    times = StageTimes(tmp_path / "times.json")
    times.learn(1000, {"edit": 0.0})
    assert times.expected(1000, ["edit"]) == 0.0
    times.learn(1000, {"edit": 4.0})
    for _ in range(20):
        times.learn(1000, {"edit": 0.0})
    assert times.expected(1000, ["edit"]) == pytest.approx(4.0)
