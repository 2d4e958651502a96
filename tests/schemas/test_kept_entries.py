"""Entries of a history in blocks and in a file: whatever is added, dropped and asked, they are as those of a list."""

from __future__ import annotations

import io
import tempfile
import tracemalloc

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from heartcase.schemas.errors import RecordingError
from heartcase.schemas.recording.commands import Advance, CloseGrab, Entry, LeadGrab, Mark, MoveProbe, OpenGrab
from heartcase.schemas.recording.kept_entries import BLOCK, KeptEntries

NUMBER = st.floats(allow_nan=False, allow_infinity=False)
POINT = st.tuples(NUMBER, NUMBER, NUMBER)
COMMANDS = st.one_of(
    st.builds(Advance, steps=st.integers(1, 9)),
    st.builds(LeadGrab, name=st.just("hand"), offset_mm=POINT, turn=st.none() | st.tuples(POINT, POINT, POINT)),
    st.builds(MoveProbe, name=st.just("probe"), center_mm=POINT),
    st.builds(CloseGrab, name=st.just("hand"), center_mm=POINT),
    st.builds(OpenGrab, name=st.just("hand")),
    st.builds(Mark, name=st.sampled_from(["first", "second"])),
)
KINDS = st.lists(st.sampled_from([Advance, LeadGrab, CloseGrab, OpenGrab, Mark]), min_size=1, max_size=2).map(tuple)


@settings(max_examples=150, deadline=None)
@given(data=st.data(), block=st.sampled_from([1, 2, 5]))
def test_they_are_as_those_of_a_list(data, block):
    kept, plain, origins, step = KeptEntries(block=block), [], [], 0
    told = set()
    for _ in range(data.draw(st.integers(1, 6))):
        for command in data.draw(st.lists(COMMANDS, max_size=12)):
            entry = Entry(step=step, command=command)
            step = entry.end_step
            kept.append(entry)
            plain.append(entry)
            origin = kept.origin(len(kept) - 1)
            assert origin not in told
            told.add(origin)
            origins.append(origin)
        assert kept == plain
        assert [kept.origin(at) for at in range(len(kept))] == origins
        start, end = data.draw(st.integers(0, len(plain))), data.draw(st.integers(0, len(plain)))
        assert kept[start:end] == plain[start:end]
        if plain:
            at = data.draw(st.integers(-len(plain), len(plain) - 1))
            assert repr(kept[at]) == repr(plain[at])  # -0.0 is not 0.0
            wanted = data.draw(st.integers(0, step))
            first = next((n for n, entry in enumerate(plain) if entry.end_step > wanted), len(plain))
            assert kept.first_beyond(wanted) == first
        kinds = data.draw(KINDS)
        places = [n for n in range(start, end) if isinstance(plain[n].command, kinds)]
        assert kept.has_any(kinds, start, end) == bool(places)
        rare = tuple(kind for kind in kinds if kind not in (Advance, LeadGrab))
        assert kept.places_of(rare, start, end) == [n for n in places if isinstance(plain[n].command, rare)]
        even = [n for n in range(min(end, len(plain))) if isinstance(plain[n].command, rare) and plain[n].step % 2 == 0]
        wanted = (even[-1], plain[even[-1]]) if even else None
        assert kept.last_of(rare, lambda entry: entry.step % 2 == 0, end) == wanted
        position = data.draw(st.integers(0, len(plain)))
        kept.drop_from(position)
        del plain[position:], origins[position:]
        step = plain[-1].end_step if plain else 0
    assert kept == plain


def lead(number):
    """A hand led to a place of its own, and the steps of that frame."""
    one = LeadGrab(name="hand", offset_mm=(number + 0.1, 0.2 * number, 1.0), turn=((1, 0, 0), (0, 1, 0), (0, 0, 1)))
    return [Entry(step=5 * number, command=one), Entry(step=5 * number, command=Advance(steps=5))]


def test_an_hour_of_leading_stays_out_of_memory():
    """60 entries a second; ten minutes of them after what fills the blocks at hand."""
    kept = KeptEntries()
    tracemalloc.start()
    try:
        for number in range(2 * BLOCK):
            for entry in lead(number):
                kept.append(entry)
        warm, _ = tracemalloc.get_traced_memory()
        count = 10 * 60 * 30
        for number in range(2 * BLOCK, 2 * BLOCK + count):
            for entry in lead(number):
                kept.append(entry)
        grown = tracemalloc.get_traced_memory()[0] - warm
    finally:
        tracemalloc.stop()
    assert len(kept) == 2 * (count + 2 * BLOCK)
    assert kept[2:4] == lead(1)
    assert grown < 0.3e6, f"{grown / 1e6:.2f} MB in ten minutes"


def test_a_full_disk_leaves_them_in_memory(monkeypatch):
    class Full(io.RawIOBase):
        def seek(self, place):
            return place

        def write(self, content):
            raise OSError(28, "no space")

    monkeypatch.setattr(tempfile, "TemporaryFile", lambda **how: Full())
    kept = KeptEntries(block=2)
    plain = [entry for number in range(9) for entry in lead(number)]
    for entry in plain:
        kept.append(entry)
    assert kept == plain
    kept.drop_from(3)
    assert kept == plain[:3]


def test_a_file_that_is_gone_is_told(monkeypatch):
    kept = KeptEntries((entry for number in range(9) for entry in lead(number)), block=2)
    kept._file.close()
    with pytest.raises(RecordingError, match="cannot be read any more"):
        kept[0]
