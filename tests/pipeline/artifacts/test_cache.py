import os

from heartcase.pipeline.artifacts import cache as cache_module
from heartcase.pipeline.artifacts.cache import Cache, stage_key
from heartcase.pipeline.data import SimulationGrid
from tests.crash import Crash, crash_after
from tests.factories import block_grid

KEY = stage_key(stage="grid", version=1, settings={"a": 1}, inputs={"x": "0"})


def test_the_key_depends_on_everything_that_goes_in():
    keys = {
        KEY,
        stage_key(stage="map", version=1, settings={"a": 1}, inputs={"x": "0"}),
        stage_key(stage="grid", version=2, settings={"a": 1}, inputs={"x": "0"}),
        stage_key(stage="grid", version=1, settings={"a": 2}, inputs={"x": "0"}),
        stage_key(stage="grid", version=1, settings={"a": 1}, inputs={"x": "1"}),
        stage_key(stage="grid", version=1, settings={"a": 1}, inputs={"y": "0"}),
    }
    assert len(keys) == 6


def test_what_is_stored_is_found_and_equal(tmp_path):
    cache = Cache(tmp_path)
    assert cache.find("grid", KEY) is None
    stored = cache.store("grid", KEY, block_grid(), seconds=1.5)
    assert cache.find("grid", KEY) == stored
    assert len(cache.load("grid", KEY, SimulationGrid).cells) == 12


def test_a_damaged_entry_is_absent(tmp_path):
    cache = Cache(tmp_path)
    cache.store("grid", KEY, block_grid(), seconds=1.5)
    content = tmp_path / f"grid-{KEY}.safetensors"
    data = bytearray(content.read_bytes())
    data[-1] ^= 1
    content.write_bytes(data)
    assert cache.load("grid", KEY, SimulationGrid) is None
    (tmp_path / f"grid-{KEY}.json").write_text("{")
    assert cache.find("grid", KEY) is None


def test_a_crash_while_storing_leaves_nothing_that_is_found_wrongly(tmp_path):
    for limit in range(50):
        cache = Cache(tmp_path / str(limit))
        try:
            with crash_after(limit):
                cache.store("grid", KEY, block_grid(), seconds=1.0)
        except Crash:
            entry = cache.find("grid", KEY)
            assert entry is None or cache.load("grid", KEY, SimulationGrid) is not None
            cache.clean()
            assert not list(cache.directory.glob(".heartcase-tmp-*"))
            continue
        break
    assert limit > 5


def test_the_longest_unused_entries_go_first(tmp_path, monkeypatch):
    cache = Cache(tmp_path)
    for age, name in enumerate("abc"):
        cache.store(name, KEY, block_grid(), seconds=1.0)
        os.utime(tmp_path / f"{name}-{KEY}.safetensors", (1000 + age, 1000 + age))
    size = (tmp_path / f"a-{KEY}.safetensors").stat().st_size
    monkeypatch.setattr(cache_module, "CACHE_SIZE_MAX", 2 * size)
    cache.clean()
    assert [name for name in "abc" if cache.find(name, KEY)] == ["b", "c"]
