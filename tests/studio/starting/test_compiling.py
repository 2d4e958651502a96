"""What the studio compiles behind its pages."""

import contextlib
import importlib
import json
import os
import sys
import tempfile
import threading

import pytest
from starlette.testclient import TestClient

from heartcase.compiling.compile_ahead import Progress
from heartcase.compiling.signatures import as_json, from_json
from heartcase.pipeline.building.kernels_ahead import kernels_in
from heartcase.studio.serving.app import make_app
from heartcase.studio.starting import compiling
from heartcase.studio.starting.compiling import LIST, kernels_of_the_studio
from heartcase.studio.starting.registry import Registry
from heartcase.studio.starting.start import Start
from tests.pipeline.building.test_kernels_ahead import called, key_of, write
from tests.studio.talking import ADDRESS, PORT, TOKEN, write_recipe

MODULE = "tests.studio.starting.kernels_called"


@pytest.fixture
def compiled(monkeypatch):
    """Compiling that goes on when it is told to; what it was asked for, and whether it was ended."""
    facts = {"goes_on": threading.Event(), "wanted": None, "ended": threading.Event()}

    @contextlib.contextmanager
    def compiled_ahead(wanted, *, processes, told, is_behind):
        assert processes >= 1
        assert is_behind
        facts["wanted"] = wanted

        def work():
            facts["goes_on"].wait(60.0)
            told(Progress(3, 1, 4, 0.0))

        told(Progress(1, 0, 4, 90.0))
        thread = threading.Thread(target=work)
        thread.start()
        yield
        facts["goes_on"].set()
        thread.join()
        facts["ended"].set()

    monkeypatch.setattr(compiling, "compiled_ahead", compiled_ahead)
    return facts


@contextlib.contextmanager
def starting(folder, recipe=None):
    """What the start page's socket says of compiling, or that of a recipe."""
    registry = Registry(TOKEN)
    start = Start(registry, roots=[folder], state=folder / "state")
    app = make_app(registry, token=TOKEN, port=PORT, start=start)
    start.begin_to_compile()
    with TestClient(app, base_url=ADDRESS, follow_redirects=False) as browser:
        browser.get("/", params={"token": TOKEN})
        line = "starting" if recipe is None else f"socket/{registry.open_recipe(recipe, out=folder / 'out').key}"
        url = f"ws://127.0.0.1:{PORT}/{line}"
        with browser.websocket_connect(url, headers={"origin": ADDRESS}) as socket:

            def hear():
                while True:
                    text = socket.receive().get("text")
                    found = json.loads(text) if text else {"kind": "bytes"}
                    if found["kind"] == "compiling":
                        return found["fraction"], found["seconds_left"]

            yield hear


def test_the_start_page_shows_how_far_it_is_until_all_is_done(compiled, tmp_path):
    with starting(tmp_path) as hear:
        # nothing is known before the list is read
        while (told := hear()) == (None, None):
            pass
        assert told == (0.25, 90.0)
        compiled["goes_on"].set()
        while (told := hear()) == (1.0, 0.0):
            pass
        assert told == (None, None)
        assert compiled["ended"].is_set()
    assert compiled["wanted"] == kernels_of_the_studio()


def test_a_recipe_that_is_opened_meanwhile_says_so_too(compiled, tmp_path):
    path, _ = write_recipe(tmp_path)
    with starting(tmp_path, path) as hear:
        assert hear() == (0.25, 90.0)
        compiled["goes_on"].set()
        while (told := hear()) == (1.0, 0.0):
            pass
        assert told == (None, None)


def test_a_studio_that_ends_ends_what_compiles_for_it(compiled, tmp_path):
    with starting(tmp_path) as hear:
        assert hear() == (0.25, 90.0)
        assert not compiled["ended"].is_set()
    assert compiled["ended"].wait(10.0)


def test_all_that_is_listed_is_there():
    wanted = kernels_of_the_studio()
    assert len({(one.module, one.name, json.dumps(one.types)) for one in wanted}) == len(wanted)
    assert set(kernels_in(LIST)) == {"paint", "operate"}
    for one in wanted:
        assert getattr(importlib.import_module(one.module), one.name).py_func.__name__ == one.name
        for kind in one.types:
            assert as_json(from_json(kind)) == kind


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_painting_and_operating_call_what_is_listed():
    """What depends on how threads come to meet may be called or not."""
    listed = {(one.module, one.name, json.dumps(one.types)) for one in kernels_of_the_studio()}
    missing = {key_of(one) for one in called(module=MODULE)} - listed
    assert missing == set(), "run python -m tests.studio.starting.test_compiling --write"


if __name__ == "__main__" and sys.argv[1:] == ["--write"]:
    with tempfile.TemporaryDirectory() as empty:
        found = called(os.environ | {"NUMBA_CACHE_DIR": empty}, MODULE)
    write({name: [one for one in found if one["stage"] == name] for name in ("paint", "operate")}, LIST)
