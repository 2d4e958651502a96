"""What strokes went over, kept in little memory."""

from unittest.mock import patch

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from heartcase.pipeline.markers import stroke_notes
from heartcase.pipeline.markers.stroke_notes import StrokeNotes

marked = st.dictionaries(
    st.integers(0, (1 << 29) - 1) | st.integers(0, 40), st.integers(0, 2) | st.just(255), max_size=30
)


def arrays(stroke):
    return np.fromiter(stroke, np.int64, len(stroke)), np.fromiter(stroke.values(), np.uint8, len(stroke))


@settings(max_examples=150, deadline=None)
@given(
    steps=st.lists(st.one_of(marked, st.none(), st.just("extend")), max_size=25), most=st.sampled_from([0, 60, 1 << 20])
)
def test_strokes_come_back_as_they_were_noted_the_last_first(steps, most):
    with patch.object(stroke_notes, "MOST_BYTES", most):
        notes, plain = StrokeNotes(), []
        for number, step in enumerate(steps):
            if step is None:
                if plain:
                    assert dict(zip(*(one.tolist() for one in notes.pop()), strict=True)) == plain.pop()
                else:
                    with pytest.raises(IndexError):
                        notes.pop()
            elif step == "extend":
                if plain:
                    more = {(1 << 29) + number: number}
                    notes.extend(*arrays(more))
                    plain[-1] = plain[-1] | more
            else:
                notes.push(*arrays(step))
                plain.append(dict(step))
            assert len(notes) == len(plain)
            assert notes.bytes_in_memory <= most
        while plain:
            assert dict(zip(*(one.tolist() for one in notes.pop()), strict=True)) == plain.pop()


def test_a_ball_takes_a_fraction_of_its_voxels():
    z, y, x = np.indices((40, 40, 40))
    voxels = np.flatnonzero((z - 20) ** 2 + (y - 20) ** 2 + (x - 20) ** 2 <= 64)
    notes = StrokeNotes()
    notes.push(voxels, np.full(len(voxels), 255, np.uint8))
    notes.push(voxels[:1], np.zeros(1, np.uint8))
    # 9 bytes a voxel as arrays
    assert 0 < notes.bytes_in_memory < len(voxels)
