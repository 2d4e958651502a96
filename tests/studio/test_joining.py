"""Pages that go while what they wait for is being opened: it is opened once, and is there for the next."""

from __future__ import annotations

import asyncio
import contextlib
import json
import threading

import pytest

from heartcase.studio.offline.exported import fitting_page_of
from heartcase.studio.operating import theatre
from heartcase.studio.operating.theatre import Theatre
from heartcase.studio.pages import Page
from heartcase.studio.painting import workplace
from heartcase.studio.painting.workplace import Workplace
from tests.simulator.live.scenes import threads, write_case
from tests.studio.talking import write_recipe


class Door:
    """Opens as the studio does, once it is let: what it opened is known."""

    def __init__(self, monkeypatch, module, name):
        self.found, self.begun, self.may_open = [], threading.Event(), threading.Event()
        really = getattr(module, name)

        def opened(*args, **options):
            self.begun.set()
            assert self.may_open.wait(60.0)
            self.found.append(really(*args, **options))
            return self.found[-1]

        monkeypatch.setattr(module, name, opened)


@pytest.fixture(params=["case", "recipe"])
def place_and_door(request, tmp_path, monkeypatch):
    if request.param == "case":
        return Theatre(write_case(tmp_path), out=tmp_path, page_of=fitting_page_of), Door(
            monkeypatch, theatre, "open_stage"
        )
    recipe, _ = write_recipe(tmp_path)
    return Workplace(recipe, out=tmp_path / "out"), Door(monkeypatch, workplace, "open_painting")


async def come_and_go(place, door):
    """A page that is gone before anything is open, as the server tells it."""
    page = Page()
    joined = asyncio.create_task(place.join(page))
    while not door.begun.is_set():
        await asyncio.sleep(0.001)
    await asyncio.sleep(0.01)
    joined.cancel()
    with contextlib.suppress(asyncio.CancelledError):
        await joined
    return asyncio.create_task(place.leave(page))


async def heard(page, *kinds):
    while True:
        message = await asyncio.wait_for(page.waiting.get(), 60.0)
        if isinstance(message, str) and json.loads(message)["kind"] in kinds:
            return json.loads(message)


def test_what_pages_that_went_had_begun_to_open_is_there_for_the_next(place_and_door):
    place, door = place_and_door
    before = threads()

    async def story():
        left = [await come_and_go(place, door) for _ in range(3)]
        page = Page()
        joined = asyncio.create_task(place.join(page))
        door.may_open.set()
        await joined
        assert (await heard(page, "opened", "failed"))["kind"] == "opened"
        await asyncio.gather(*left)
        await place.leave(page)
        await place.close()

    asyncio.run(story())
    assert len(door.found) == 1
    assert threads() == before


def test_a_server_that_ends_while_a_case_is_opened_for_nobody_ends_its_session(place_and_door):
    place, door = place_and_door
    before = threads()

    async def story():
        left = await come_and_go(place, door)
        closing = asyncio.create_task(place.close())
        await asyncio.sleep(0.01)
        door.may_open.set()
        await closing
        await left
        assert [one for one in asyncio.all_tasks() if not one.done()] == [asyncio.current_task()]

    asyncio.run(story())
    assert len(door.found) == 1
    assert threads() == before


def test_time_stands_in_a_case_that_was_opened_for_nobody(tmp_path, monkeypatch):
    place, door = (
        Theatre(write_case(tmp_path), out=tmp_path, page_of=fitting_page_of),
        Door(monkeypatch, theatre, "open_stage"),
    )

    async def story():
        await (await come_and_go(place, door))
        door.may_open.set()
        while not door.found or door.found[0].live.newest.mode != "paused":
            await asyncio.sleep(0.005)
        page = Page()
        await place.join(page)
        while door.found[0].live.newest.mode != "running":
            await asyncio.sleep(0.005)
        await place.close()

    asyncio.run(asyncio.wait_for(story(), 60.0))
    assert len(door.found) == 1
