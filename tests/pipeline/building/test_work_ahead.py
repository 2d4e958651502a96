"""Work that is begun ahead: only where it was computed, once, and given up when the build ends early."""

from __future__ import annotations

import threading
from concurrent.futures import CancelledError
from contextlib import suppress
from types import SimpleNamespace

import pytest

from heartcase.pipeline.building import work_ahead
from heartcase.pipeline.building.work_ahead import WorkAhead
from heartcase.pipeline.stages.stage import Node
from heartcase.pipeline.walls.grow_walls import structure_volumes_ml
from tests.pipeline.analytic_structures import ball, lattice, structures

ASSEMBLY = "heartcase.pipeline.bundle.assembly"


def work_with(**outputs):
    nodes = dict.fromkeys(("structures", "surface", "grid_map", "filtered", "markers")) | outputs
    return SimpleNamespace(recipe="recipe", outputs=SimpleNamespace(**nodes), begun={})


def test_what_was_computed_is_begun_once(monkeypatch):
    calls = []
    monkeypatch.setattr(work_ahead, "may_share", lambda: True)
    monkeypatch.setattr(f"{ASSEMBLY}.structure_figures", lambda *given: calls.append(given[:2]) or "m")
    monkeypatch.setattr(f"{ASSEMBLY}.normal_maps", lambda *given: calls.append(given) or "n")
    pictures = "heartcase.pipeline.report.report_pictures"
    monkeypatch.setattr(f"{pictures}.surface_thickness_mm", lambda *given: calls.append(given) or "t")
    monkeypatch.setattr(work_ahead, "sureness", lambda given: calls.append(given) or "s")
    work = work_with(structures=Node("", lambda: None))
    with WorkAhead(work) as begun:
        begun.look()
        assert work.begun == {}  # found in the cache, and not loaded by anybody
        work.outputs.structures.value = "fields"
        begun.look(), begun.look()
        work.outputs.surface = Node("", lambda: None, "surface")
        begun.look(), begun.look()
        assert "thickness" not in work.begun
        work.outputs.grid_map = Node("", lambda: None, "map")
        work.outputs.markers = Node("", lambda: None, "markers")
        begun.look(), begun.look()
        assert "sureness" not in work.begun
        work.outputs.filtered = Node("", lambda: None, "scan")
        begun.look(), begun.look()
        assert work.begun.pop("library")().__name__ == "SimpleITK"
        assert {name: result() for name, result in work.begun.items()} == {
            "structure_figures": "m",
            "normal_maps": "n",
            "thickness": "t",
            "sureness": "s",
        }
    assert calls == [("recipe", "fields"), ("recipe", "surface"), ("surface",), work]


def test_nothing_is_begun_where_there_is_one_thread(monkeypatch):
    monkeypatch.setattr(work_ahead, "may_share", lambda: False)
    work = work_with(structures=Node("", lambda: None, "fields"))
    with WorkAhead(work) as begun:
        begun.look()
    assert work.begun == {}


def test_a_build_that_ends_early_gives_it_up(monkeypatch):
    started, asked = threading.Event(), []

    def worked_out(recipe, structures, is_wanted):
        started.set()
        while is_wanted():
            asked.append(True)

    monkeypatch.setattr(work_ahead, "may_share", lambda: True)
    monkeypatch.setattr(f"{ASSEMBLY}.structure_figures", worked_out)
    work = work_with(structures=Node("", lambda: None, "fields"), surface=Node("", lambda: None, "surface"))
    with suppress(KeyboardInterrupt), WorkAhead(work) as begun:
        begun.look()
        assert started.wait(10.0)
        raise KeyboardInterrupt
    with pytest.raises(CancelledError):
        work.begun["normal_maps"]()  # it waited for the first


def test_volumes_that_nobody_wants_any_more_are_given_up():
    shapes = structures({1: ball(8.0)}, lattice(20.0))
    assert sum(structure_volumes_ml(shapes).values()) > 0.0
    with pytest.raises(CancelledError):
        structure_volumes_ml(shapes, lambda: False)
