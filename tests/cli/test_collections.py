"""How often the commands have Python look for cycles of objects."""

import gc

import click
import pytest

from heartcase.cli import main as module


@pytest.mark.parametrize(("name", "is_rare"), [("build", True), ("walls", True), ("studio", False), ("view", False)])
def test_cycles_are_looked_for_rarely_where_nobody_waits_for_answers(monkeypatch, name, is_rare):
    before, seen = gc.get_threshold(), []

    class Fake:
        @staticmethod
        @click.command()
        def command():
            seen.append(gc.get_threshold())

    monkeypatch.setattr(module.importlib, "import_module", lambda _: Fake)
    assert module.main([name]) == 0
    assert (seen[0][0] > before[0]) is is_rare
    assert seen[0][1:] == before[1:]
    assert gc.get_threshold() == before
